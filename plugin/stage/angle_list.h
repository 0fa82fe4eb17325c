#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace s2gs {

/// Table angles by the photos' names [degrees], of the text of a CSV file: one "NAME,ANGLE" a line; a first
/// line without a number is a heading, lines that begin with '#', empty ones and a byte-order mark do not
/// count. All lines have one separator, the last of which in a line counts: a tab if a line has one, else a
/// semicolon if a line has one, else a comma, where those within double quotes are none. Throws UserError
/// that names the line of a name that cannot be one or occurs twice, of an angle that is no number or has a
/// decimal comma, and of a line without the separator. \param path  for messages.
std::map<std::string, double> ParseAngleList(std::string_view text, const std::filesystem::path& path);
/// \param path  such a file, or a folder of OpenScan's: what the firmware keeps of each photo, a
/// metadata/NAME.json beside the photos, holds the turntable's angle ("fi"). The folder of one scan, or of a
/// project with scans in it, whose names then begin with their folder's; names are without extension. Throws
/// UserError for a file that holds no angle, and where there is none.
std::map<std::string, double> ReadAngleList(const std::filesystem::path& path);

/// The listed angles under the names of a scan's photos: the same name, or the same but for the extension
/// where one photo alone has that (photos that were imported have another). Throws UserError when no name is
/// a photo's. \param unknown  gets the names that are none's.
std::map<std::string, double> AnglesOfPhotos(const std::map<std::string, double>& listed,
                                             const std::vector<std::string>& photos,
                                             const std::filesystem::path& path,
                                             std::vector<std::string>* unknown);

}  // namespace s2gs
