#include "mesh/io/dense_workspace.h"

#include <map>
#include <ostream>
#include <string>
#include <system_error>
#include <vector>

#include "s2gs/image/image_file.h"
#include "s2gs/image/undistort.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxPhotoBytes = kMaxImageBytes;

void CheckSize(const fs::path& path, const Camera& camera) {
  const ImageSize size = ReadImageSize(path);
  if (static_cast<uint64_t>(size.width) == camera.width &&
      static_cast<uint64_t>(size.height) == camera.height) {
    return;
  }
  throw UserError(path,
                  "is " + std::to_string(size.width) + " x " + std::to_string(size.height) +
                      ", but its camera is " + std::to_string(camera.width) + " x " +
                      std::to_string(camera.height),
                  "Give the photos that the model was made from");
}

// Writes the picture as the pinhole sees it. `channels` of the decoded picture.
void WritePicture(const fs::path& from, const fs::path& to, const Camera& camera, const Camera& pinhole,
                  int channels, bool resample_always, Reporter& reporter) {
  CheckSize(from, camera);
  if (IsDistortionFree(camera) && !resample_always) {
    const std::string bytes = ReadWholeFile(from, kMaxPhotoBytes);
    WriteFileAtomically(to, [&](std::ostream& stream) {
      stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    });
    return;
  }
  WriteImage(to, UndistortImage(ReadImage(from, channels), camera, pinhole, reporter));
}

}  // namespace

ColmapModel WriteDenseWorkspace(const fs::path& folder, const ColmapModel& model,
                                const DenseWorkspaceSource& source, Reporter& reporter) {
  ColmapModel dense = UndistortedModel(model, source.model);
  const fs::path stereo = folder / "stereo";
  for (const char* name : {"depth_maps", "normal_maps", "consistency_graphs"}) CreateFolder(stereo / name);
  CreateFolder(folder / "images");
  std::map<std::string, const ColmapImage*> by_name;
  std::vector<std::string> all_names;
  for (const auto& [id, image] : model.images) {
    by_name[image.name] = &image;
    all_names.push_back(image.name);
  }
  const ImageOutputs outputs(source.root.empty() ? folder : source.root, source.images, all_names);
  int64_t count = 0;
  std::string names;
  std::string patch_match;
  for (const auto& [name, image] : by_name) {
    if (reporter.StopRequested()) throw Interrupted();
    const Camera& camera = model.cameras.at(image->camera_id);
    const Camera& pinhole = dense.cameras.at(image->camera_id);
    const ImageName image_name(name, source.model);
    WritePicture(source.images / name, outputs.Make(folder / "images", image_name, ""), camera, pinhole, 3,
                 source.resample_always, reporter);
    const fs::path mask = source.masks / (name + ".png");
    std::error_code ec;
    if (!source.masks.empty() && fs::exists(mask, ec)) {
      WritePicture(mask, outputs.Make(folder / "masks", image_name, ".png"), camera, pinhole, 1,
                   source.resample_always, reporter);
    }
    // For COLMAP, which writes there but makes no folders.
    for (const char* maps : {"depth_maps", "normal_maps"}) outputs.Make(stereo / maps, image_name, "");
    names += name + "\n";
    // Twenty source images a view, chosen by COLMAP.
    patch_match += name + "\n__auto__, 20\n";
    reporter.Progress("write dense images", ++count, static_cast<int64_t>(by_name.size()));
  }
  WriteFilesTogether({{stereo / "patch-match.cfg", [&](std::ostream& stream) { stream << patch_match; }},
                      {stereo / "fusion.cfg", [&](std::ostream& stream) { stream << names; }}});
  // Last: its presence says that the rest is complete.
  CreateFolder(folder / "sparse");
  WriteColmapModel(folder / "sparse", dense, ColmapFormat::kBinary);
  return dense;
}

}  // namespace s2gs
