#include "plugin/photos/imported_folder.h"

#include <nlohmann/json.hpp>
#include <set>
#include <system_error>

#include "plugin/cli/version.h"
#include "plugin/stage/json_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {

namespace fs = std::filesystem;
using nlohmann::json;

ImportedFolder::ImportedFolder(const Workspace& workspace, const std::string& origin)
    : workspace_(workspace), origin_(origin + ", s2gs " + Version()) {
  const fs::path folder = workspace_.Imported();
  RequireNoLinkOut(workspace_.root, folder);
  RequireNoLinkOut(workspace_.root, workspace_.ImportRecord());
  // A link to a folder of the workspace may lead to the photos.
  const auto refuse_link = [](const fs::path& path) {
    std::error_code ec;
    if (!fs::is_symlink(path, ec)) return;
    throw UserError(path, "is a symbolic link, through which no photos are imported",
                    "Remove the link, or replace it by a folder");
  };
  refuse_link(folder);
  const json record = ReadJsonFile(workspace_.ImportRecord());
  std::set<std::string> known;
  if (record.is_object() && record.contains("photos") && record["photos"].is_array()) {
    for (const json& name : record["photos"]) {
      if (name.is_string() && !ImageName::FindFault(name.get<std::string>())) known.insert(name);
    }
  }
  std::error_code ec;
  fs::recursive_directory_iterator entry(folder, ec);
  for (const fs::recursive_directory_iterator end; !ec && entry != end; entry.increment(ec)) {
    std::error_code type_ec;
    refuse_link(entry->path());
    if (entry->is_directory(type_ec)) continue;
    const std::string name = entry->path().lexically_relative(folder).generic_string();
    if (known.count(name) > 0 || IsTemporaryName(entry->path().filename().string())) continue;
    throw UserError(entry->path(), "was not put there by s2gs, and photos are imported into its folder",
                    "Move " + folder.string() + " away, or give another --workspace_path");
  }
  earlier_.assign(known.begin(), known.end());
  if (!record.is_object() || !record.contains("origin") || record["origin"] != origin_) {
    for (const std::string& name : earlier_) fs::remove(folder / name, ec);
    earlier_.clear();
  }
}

void ImportedFolder::Expect(const std::vector<std::string>& names) {
  const std::set<std::string> wanted(names.begin(), names.end());
  std::error_code ec;
  for (const std::string& name : earlier_) {
    if (wanted.count(name) == 0) fs::remove(workspace_.Imported() / name, ec);
  }
  CreateFolder(workspace_.Own());
  CreateFolder(workspace_.Imported());
  const json record = {{"origin", origin_}, {"photos", wanted}};
  WriteFileAtomically(workspace_.ImportRecord(),
                      [&](std::ostream& stream) { stream << record.dump(1) << '\n'; });
}

fs::path ImportedFolder::Make(const std::string& name) const {
  return ImageOutputs(workspace_.root, {}, {}).Make(workspace_.Imported(), ImageName(name, "the photos"), "");
}

bool ImportedFolder::IsDone(const std::string& name, const fs::path& source) const {
  std::error_code ec;
  const fs::file_time_type made = fs::last_write_time(workspace_.Imported() / name, ec);
  if (ec) return false;
  const fs::file_time_type changed = fs::last_write_time(source, ec);
  return !ec && made == changed;
}

void ImportedFolder::Done(const std::string& name, const fs::path& source) const {
  std::error_code ec;
  const fs::file_time_type changed = fs::last_write_time(source, ec);
  if (!ec) fs::last_write_time(workspace_.Imported() / name, changed, ec);
}

}  // namespace s2gs
