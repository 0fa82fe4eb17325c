#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace s2gs {

/// A row of a list of objects.
struct BatchObject {
  int line = 0;                      ///< where it stands in the list, from 1.
  std::filesystem::path images;      ///< folder of its photos, or a video.
  std::filesystem::path workspace;   ///< folder of its scan.
  std::vector<std::string> options;  ///< of automatic_scanner, besides both paths.
  std::string fault;                 ///< why it cannot be scanned; empty: nothing is wrong with it.
};

/// Throws what is wrong with a command line of automatic_scanner, as a std::exception.
using CheckScanLine = std::function<void(const std::vector<std::string>& arguments)>;

/// Reads a list of objects: CSV (RFC 4180, a row a line) separated by commas, semicolons or tabs. The first
/// line names the columns: images, workspace, and options, which may be missing and holds words as a shell
/// has them. Paths are relative to `folder`. Empty lines, and those that begin with #, are left out. What is
/// wrong with a row is its fault, also when its folder of photos or its video is missing or its workspace is,
/// holds or lies in that of a row before it; the other rows stay. Throws UserError with `path` where the
/// columns are not named, or there is no row.
/// \param path   for messages only.
/// \param check  is asked about every row's command line.
std::vector<BatchObject> ParseBatchList(std::string_view text, const std::filesystem::path& path,
                                        const std::filesystem::path& folder, const CheckScanLine& check);

/// The same from a file, with paths relative to its folder.
std::vector<BatchObject> ReadBatchList(const std::filesystem::path& path, const CheckScanLine& check);

/// The arguments of automatic_scanner for an object.
std::vector<std::string> ScanLine(const BatchObject& object);

}  // namespace s2gs
