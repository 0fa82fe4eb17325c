#include "plugin/commands/model_exporter_command.h"

#include <filesystem>
#include <optional>
#include <ostream>
#include <string>
#include <system_error>
#include <vector>

#include "plugin/outputs/camera_export.h"
#include "plugin/outputs/export_place.h"
#include "plugin/outputs/splat_export.h"
#include "plugin/stage/workspace.h"
#include "s2gs/gaussians_ply.h"
#include "s2gs/image/exif.h"
#include "s2gs/image/image_codec.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

enum class OutputType {
  kNerf,
  kMetashape,
  kSplatSet,
  kSplatPly,
  kSplatGlb,
  kMasksColmap,
  kMasksRealityScan,
  kPhotosAlpha
};

struct Settings {
  Workspace workspace;
  fs::path image_path;
  fs::path output_path;
  OutputType type = OutputType::kNerf;
};

// A file of another kind, such as a photo, is not to be replaced by a slip of the hand.
void RequireExtension(const Settings& s) {
  const char* extension = s.type == OutputType::kMetashape  ? ".xml"
                          : s.type == OutputType::kSplatPly ? ".ply"
                          : s.type == OutputType::kSplatGlb ? ".glb"
                                                            : nullptr;
  if (extension == nullptr || s.output_path.extension() == extension) return;
  throw UserError(s.output_path, std::string("is no name of such a file, which ends in ") + extension,
                  "Correct --output_path");
}

// From `folder` to `path`, with '/' at its end.
std::string RelativeFolder(const fs::path& path, const fs::path& folder) {
  const fs::path relative = ResolvedPath(path).lexically_relative(ResolvedPath(folder));
  return relative == "." ? "" : relative.generic_string() + "/";
}

// What is written names these files, and is of no use without them.
void RequirePhotos(const Settings& s, const ColmapModel& model) {
  std::vector<std::string> missing;
  for (const auto& [id, image] : model.images) {
    if (!Exists(s.image_path / image.name)) missing.push_back(image.name);
  }
  if (missing.empty()) return;
  throw UserError(s.image_path,
                  "lacks " + std::to_string(missing.size()) + " of the model's " +
                      std::to_string(model.images.size()) + " photos, such as " + missing.front(),
                  "Say where the photos are with --image_path");
}

void ExportNerf(const Settings& s) {
  const ColmapModel model = ReadColmapModel(s.workspace.ObjectModel());
  RequirePhotos(s, model);
  CreateFolder(s.output_path);
  NerfPaths paths;
  paths.images = RelativeFolder(s.image_path, s.output_path);
  if (Exists(s.workspace.Masks())) paths.masks = RelativeFolder(s.workspace.Masks(), s.output_path);
  paths.sparse_points = "sparse_pc.ply";
  const nlohmann::ordered_json json = NerfTransforms(model, paths, s.workspace.ObjectModel());
  WritePointsPly(model, s.output_path / paths.sparse_points);
  WriteFileAtomically(s.output_path / "transforms.json",
                      [&](std::ostream& stream) { stream << json.dump(1) << '\n'; });
}

void ExportMetashape(const Settings& s) {
  const ColmapModel model = ReadColmapModel(s.workspace.ObjectModel());
  WriteFileAtomically(s.output_path, [&](std::ostream& stream) {
    WriteMetashapeCameras(model, s.workspace.ObjectModel(), stream);
  });
}

// The photo with the mask as its alpha channel, and the photo's EXIF.
void WriteCutOut(const fs::path& photo_path, const fs::path& mask_path, const fs::path& path) {
  const Image8 photo = ReadImage(photo_path, 3);
  const Image8 mask = ReadImage(mask_path, 1);
  if (mask.width != photo.width || mask.height != photo.height) {
    throw UserError(mask_path, "has another size than its photo", "Run `s2gs gaussian_renderer` again");
  }
  Image8 cut_out{photo.width, photo.height, 4, {}};
  cut_out.pixels.reserve(4 * mask.pixels.size());
  for (size_t i = 0; i < mask.pixels.size(); ++i) {
    cut_out.pixels.insert(cut_out.pixels.end(), photo.pixels.begin() + static_cast<std::ptrdiff_t>(3 * i),
                          photo.pixels.begin() + static_cast<std::ptrdiff_t>(3 * i + 3));
    cut_out.pixels.push_back(mask.pixels[i]);
  }
  const std::optional<ExifTags> tags = ReadExif(photo_path);
  WriteUnlessOther(path, EncodePng(cut_out, path, tags ? MakeExif(*tags) : ""));
}

// A file for each photo of the model; every one of them has to have a mask.
void ExportMasks(const Settings& s, Reporter& reporter) {
  const ColmapModel model = ReadColmapModel(s.workspace.ObjectModel());
  if (s.type == OutputType::kPhotosAlpha) RequirePhotos(s, model);
  const ImageOutputs outputs(s.output_path, s.image_path, {});
  size_t done = 0;
  for (const auto& [id, image] : model.images) {
    if (reporter.StopRequested()) throw Interrupted();
    const fs::path mask_path = s.workspace.Mask(image.name);
    const ImageName name(image.name, s.workspace.ObjectModel());
    if (s.type != OutputType::kPhotosAlpha) {
      const char* suffix = s.type == OutputType::kMasksColmap ? ".png" : ".mask.png";
      WriteUnlessOther(outputs.Make(s.output_path, name, suffix),
                       ReadWholeFile(mask_path, kMaxImageBytes, "Run `s2gs gaussian_renderer` first"));
    } else {
      const bool is_png = fs::path(image.name).extension() == ".png";
      WriteCutOut(s.image_path / image.name, mask_path,
                  outputs.Make(s.output_path, name, is_png ? "" : ".png"));
    }
    reporter.Progress("export", static_cast<int64_t>(++done), static_cast<int64_t>(model.images.size()));
  }
}

void Export(const Settings& s, Reporter& reporter) {
  switch (s.type) {
    case OutputType::kNerf:
      ExportNerf(s);
      break;
    case OutputType::kMetashape:
      ExportMetashape(s);
      break;
    case OutputType::kSplatSet:
      WriteSplatSet(s.workspace, s.image_path, s.output_path, reporter);
      break;
    case OutputType::kSplatPly: {
      GaussianPlyOptions layout;
      layout.layout = GaussianPlyLayout::k3dgs;
      layout.foreground_only = true;
      WriteGaussianPly(s.output_path, ReadGaussianPly(s.workspace.PointCloud()), layout);
      break;
    }
    case OutputType::kSplatGlb: {
      const Gaussians gaussians = ReadGaussianPly(s.workspace.PointCloud());
      WriteFileAtomically(s.output_path,
                          [&](std::ostream& stream) { WriteGaussianGlb(gaussians, s.output_path, stream); });
      break;
    }
    case OutputType::kMasksColmap:
    case OutputType::kMasksRealityScan:
    case OutputType::kPhotosAlpha:
      ExportMasks(s, reporter);
      break;
  }
}

}  // namespace

void RunModelExporter(CommandContext& context) {
  fs::path workspace_path;
  Settings s;
  Options& options = context.Declare(
      "Writes a finished workspace in the files of other programs: cameras (nerf: transforms.json and sparse "
      "points; metashape: camera XML), a set for trainers of splats (splat_set: photos without distortion, "
      "cameras, object masks), the object's splats alone (splat_ply: PLY of 3DGS; splat_glb: glTF with "
      "KHR_gaussian_splatting), masks (masks_colmap: NAME.EXT.png; masks_realityscan: NAME.EXT.mask.png) and "
      "photos with the mask as alpha channel (photos_alpha: PNG). Poses are the object's: z is up, lengths "
      "are the workspace's.",
      "--workspace_path scan --output_path transforms --output_type nerf");
  options.Add("workspace_path", &workspace_path, "the workspace").Required();
  options
      .Add("output_path", &s.output_path,
           "the folder, or for metashape, splat_ply and splat_glb the file (.xml, .ply, .glb)")
      .Required();
  options.AddEnum("output_type", &s.type,
                  {{"nerf", OutputType::kNerf},
                   {"metashape", OutputType::kMetashape},
                   {"splat_set", OutputType::kSplatSet},
                   {"splat_ply", OutputType::kSplatPly},
                   {"splat_glb", OutputType::kSplatGlb},
                   {"masks_colmap", OutputType::kMasksColmap},
                   {"masks_realityscan", OutputType::kMasksRealityScan},
                   {"photos_alpha", OutputType::kPhotosAlpha}},
                  "what to write");
  options.Add("image_path", &s.image_path, "the photos; empty: imported or images in the workspace");
  Reporter& reporter = context.Parse();
  s.workspace = Workspace{workspace_path};
  std::error_code ec;
  if (!fs::is_directory(workspace_path, ec)) {
    throw UserError(workspace_path, "there is no such workspace", "Check --workspace_path");
  }
  if (s.image_path.empty()) {
    s.image_path = Exists(s.workspace.Imported()) ? s.workspace.Imported() : s.workspace.Images();
  }
  RequireFreePlace(s.workspace, s.image_path, s.output_path);
  RequireExtension(s);
  Export(s, reporter);
  context.out() << "written to  " << s.output_path.string() << '\n';
}

}  // namespace s2gs
