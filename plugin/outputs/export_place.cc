#include "plugin/outputs/export_place.h"

#include <algorithm>
#include <cstdint>
#include <system_error>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr const char* kRemedy = "Choose another --output_path";

bool IsSameImage(const ColmapImage& a, const ColmapImage& b) {
  return a.name == b.name && a.cam_from_world.translation == b.cam_from_world.translation &&
         a.cam_from_world.rotation.coeffs() == b.cam_from_world.rotation.coeffs();
}

}  // namespace

void RequireFreePlace(const Workspace& workspace, const fs::path& image_path, const fs::path& place) {
  std::vector<fs::path> kept = {image_path, workspace.Own(), workspace.root / "split",
                                workspace.root / "sparse", workspace.root / "dense"};
  for (const auto& [path, what] : WorkspaceContents(workspace)) kept.push_back(path);
  const fs::path resolved = ResolvedPath(place);
  for (const fs::path& path : kept) {
    const fs::path own = ResolvedPath(path);
    if (IsWithin(resolved, own)) {
      throw UserError(place, "lies in " + path.string() + ", which the workspace needs as it is", kRemedy);
    }
  }
}

void WriteUnlessOther(const fs::path& path, std::string_view content) {
  std::error_code ec;
  if (fs::exists(fs::symlink_status(path, ec))) {
    const bool is_file = fs::is_regular_file(path, ec);
    const uint64_t num_bytes = is_file ? fs::file_size(path, ec) : 0;
    if (is_file && num_bytes == content.size() && ReadWholeFile(path, num_bytes) == content) return;
    throw UserError(path, "is there already and holds something else: it is not written over",
                    "Move it away, or choose another --output_path");
  }
  WriteFileAtomically(path, [&](std::ostream& stream) {
    stream.write(content.data(), static_cast<std::streamsize>(content.size()));
  });
}

void RequireNoOtherModel(const fs::path& folder, const ColmapModel& model) {
  std::error_code ec;
  if (!fs::exists(fs::symlink_status(folder, ec)) || fs::is_empty(folder, ec)) return;
  bool is_same = false;
  try {
    const ColmapModel other = ReadColmapModel(folder);
    is_same = other.cameras.size() == model.cameras.size() &&
              other.points3D.size() == model.points3D.size() &&
              std::equal(other.images.begin(), other.images.end(), model.images.begin(), model.images.end(),
                         [](const auto& a, const auto& b) { return IsSameImage(a.second, b.second); });
  } catch (const UserError&) {
    is_same = false;
  }
  if (is_same) return;
  throw UserError(folder, "holds another model: it is not written over",
                  "Move it away, or choose another --output_path");
}

}  // namespace s2gs
