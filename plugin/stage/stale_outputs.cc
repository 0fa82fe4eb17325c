#include "plugin/stage/stale_outputs.h"

#include <algorithm>
#include <iterator>
#include <sstream>
#include <system_error>
#include <utility>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxListBytes = uint64_t{1} << 26;

// Folders of files that belong to photos, and what their names end in.
std::vector<std::pair<fs::path, std::string>> ImageFolders(const Workspace& w) {
  return {{w.Masks(), ".png"},   {w.DenseMasks(), ".png"},          {w.TableSeen(), ".png"},
          {w.DenseImages(), ""}, {w.DepthMaps(), ".geometric.bin"}, {w.NormalMaps(), ".geometric.bin"}};
}

std::set<std::string> ReadNames(const fs::path& path, Reporter& reporter) {
  std::set<std::string> names;
  std::error_code ec;
  if (!fs::exists(path, ec)) return names;
  try {
    std::istringstream lines(ReadWholeFile(path, kMaxListBytes));
    for (std::string line; std::getline(lines, line);) {
      if (!ImageName::FindFault(line)) names.insert(line);
    }
  } catch (const UserError& error) {
    reporter.Debug(error.what());
  }
  return names;
}

void RemoveStale(const Workspace& workspace, const ImageOutputs& outputs, const std::set<std::string>& stale,
                 const fs::path& list, Reporter& reporter) {
  std::error_code ec;
  const fs::file_time_type written = fs::last_write_time(list, ec);
  if (ec) return;
  size_t num_removed = 0;
  for (const std::string& name : stale) {
    for (const auto& [folder, suffix] : ImageFolders(workspace)) {
      try {
        const fs::path path = outputs.Locate(folder, ImageName(name, list), suffix);
        const fs::file_time_type changed = fs::last_write_time(path, ec);
        if (!ec && changed <= written && fs::is_regular_file(path, ec) && fs::remove(path, ec)) ++num_removed;
      } catch (const UserError& error) {
        reporter.Debug(error.what());
      }
    }
  }
  if (num_removed > 0) {
    reporter.Info("removed " + std::to_string(num_removed) + " files of " + std::to_string(stale.size()) +
                  " photos that are no longer there, " + *stale.begin() + " for example");
  }
}

void WarnOfOthers(const Workspace& workspace, const std::set<std::string>& names, Reporter& reporter) {
  size_t count = 0;
  std::string example;
  for (const auto& [folder, suffix] : ImageFolders(workspace)) {
    std::error_code ec;
    fs::recursive_directory_iterator entry(folder, ec);
    for (const fs::recursive_directory_iterator end; !ec && entry != end; entry.increment(ec)) {
      std::error_code type_ec;
      if (!entry->is_regular_file(type_ec)) continue;
      std::string name = entry->path().lexically_relative(folder).generic_string();
      if (name.size() <= suffix.size() ||
          name.compare(name.size() - suffix.size(), suffix.size(), suffix) != 0)
        continue;
      name.resize(name.size() - suffix.size());
      if (names.count(name) > 0) continue;
      if (count++ == 0) example = entry->path().string();
    }
  }
  if (count > 0) {
    reporter.Warn(std::to_string(count) + " files belong to none of the photos: " + example +
                  ", for example. Remove them if nothing else needs them");
  }
}

}  // namespace

void TidyImageOutputs(const Workspace& workspace, const fs::path& image_path,
                      const std::set<std::string>& names, Reporter& reporter) {
  const fs::path list = workspace.Own() / "rendered.txt";
  const std::set<std::string> earlier = ReadNames(list, reporter);
  std::set<std::string> stale;
  std::set_difference(earlier.begin(), earlier.end(), names.begin(), names.end(),
                      std::inserter(stale, stale.end()));
  const ImageOutputs outputs(workspace.root, image_path, {names.begin(), names.end()});
  RemoveStale(workspace, outputs, stale, list, reporter);
  WarnOfOthers(workspace, names, reporter);
  WriteFileAtomically(list, [&](std::ostream& stream) {
    for (const std::string& name : names) stream << name << '\n';
  });
}

}  // namespace s2gs
