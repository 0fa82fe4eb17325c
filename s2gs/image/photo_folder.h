#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "s2gs/image/image_file.h"
#include "s2gs/image/image_header.h"

namespace s2gs {

/// A photo as its header describes it.
struct PhotoFile {
  std::string name;  ///< relative to the photos' folder, with '/' between folders.
  std::filesystem::path path;
  ImageSize size;  ///< zero where the header cannot be read.
  uint64_t num_bytes = 0;
  bool is_png = false;  ///< by its content; else JPEG.
  PngPixels png;        ///< of a PNG.
};

/// What a folder of photos and the folders below it hold.
struct PhotoFolder {
  std::vector<PhotoFile> photos;    ///< JPEG and PNG files by their extension, sorted by path.
  std::vector<std::string> faults;  ///< one for each file or link to be mended, without the folder's path.
  std::vector<std::string> notes;   ///< what is left alone although it looks like a photo.
  bool has_other_files = false;     ///< any that are no photos, hidden ones too.
  std::vector<PhotoFile> foreign;   ///< photos of other formats by their extension; name and path alone.
};

/// What photos of other formats than JPEG and PNG are.
enum class ForeignPhotos {
  kFaults,  ///< each is a fault.
  kListed,  ///< whoever asks converts them.
};

/// Looks at names and headers only, a few kilobytes of each photo: at what is not JPEG or PNG (unless a photo
/// of the same name stands beside it, as of cameras that write raw files besides), names that cannot be used,
/// names that differ in case alone, empty and cut-off files, sizes out of bounds. Hidden files are left
/// alone, like the "._" files of macOS. A link to a photo is that photo; one to a folder below this one is a
/// fault and is not followed. Throws UserError when the folder cannot be listed.
PhotoFolder InspectPhotoFolder(const std::filesystem::path& folder,
                               ForeignPhotos foreign = ForeignPhotos::kFaults);

/// "HEADING:" and the faults, ten at most, one a line.
std::string ListFaults(const std::string& heading, const std::vector<std::string>& faults);

/// The mask of an image below a folder, by the names that programs give it: COLMAP's ("a.jpg.png"),
/// RealityScan's ("a.jpg.mask.png"), LichtFeld's ("a.png"), then "a.mask.png". Those of a photo "a.png" that
/// was imported from another format have its former name, "a.heic.png". Empty when there is none.
std::filesystem::path FindMask(const std::filesystem::path& folder, const std::string& image_name);

/// For messages, how FindMask() expects masks to be called.
inline constexpr const char* kMaskNames =
    "The mask of sub/a.jpg is sub/a.jpg.png (COLMAP), sub/a.jpg.mask.png (RealityScan) or sub/a.png "
    "(LichtFeld; or the cut-out photo, whose alpha channel counts)";

}  // namespace s2gs
