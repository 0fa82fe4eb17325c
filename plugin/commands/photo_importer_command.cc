#include "plugin/commands/photo_importer_command.h"

#include <filesystem>
#include <ostream>
#include <system_error>

#include "plugin/photos/photo_import.h"
#include "plugin/photos/video_frames.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr int kMinVideoFrames = 3;
constexpr int kMaxVideoFrames =
    8000;  // whose numbers still fit into one argument of ffmpeg, 128 KiB on Linux

struct VideoOptions {
  int video_frames = 120;

  OptionCheck Check() const {
    if (video_frames < kMinVideoFrames) {
      return OptionFault{"video_frames", std::to_string(video_frames),
                         ">= " + std::to_string(kMinVideoFrames)};
    }
    if (video_frames > kMaxVideoFrames) {
      return OptionFault{"video_frames", std::to_string(video_frames),
                         "<= " + std::to_string(kMaxVideoFrames)};
    }
    return std::nullopt;
  }
};

}  // namespace

void RunPhotoImporter(CommandContext& context) {
  fs::path workspace_path;
  fs::path image_path;
  fs::path ffmpeg_path;
  VideoOptions video;
  Options& options = context.Declare(
      "Makes photos that COLMAP reads of those that came otherwise, once, in imported/ of the workspace: "
      "HEIC, AVIF, WebP, TIFF, BMP, EXR, raw files and PNG of 16 bits become PNG of 8 bits in sRGB, JPEG and "
      "PNG are copied. Pixels stay as they are stored, but for HEIC, AVIF and raw files, whose decoders turn "
      "them upright; EXIF's lens and orientation are kept, and photos that EXIF mirrors are mirrored back. "
      "Of a video, the sharpest frame of each of --video_frames intervals is taken. The photos themselves "
      "are only read. automatic_scanner runs this by itself where it is needed; the other commands then take "
      "imported/ as --image_path.",
      "--workspace_path scan --image_path photos");
  options.Add("workspace_path", &workspace_path, "the workspace; created when it does not exist").Required();
  options.Add("image_path", &image_path, "the folder of photos, with folders below it, or a video file")
      .Required();
  auto group = options.Fields(&video);
  group.Add("video_frames", &VideoOptions::video_frames,
            "frames taken of a video: steps of the table of up to 20 degrees work best");
  options.Add("ffmpeg_path", &ffmpeg_path,
              "the ffmpeg executable or its folder, for videos; empty: searched for on PATH");
  Reporter& reporter = context.Parse();

  std::error_code ec;
  const bool is_video = fs::is_regular_file(image_path, ec);
  if (!is_video && !fs::is_directory(image_path, ec)) {
    throw UserError(image_path, "is neither a folder of photos nor a video file", "Check --image_path");
  }
  const Workspace workspace{workspace_path};
  const fs::path photos = ResolvedPath(image_path);
  const fs::path imported = ResolvedPath(workspace.Imported());
  if (IsWithin(photos, imported) || IsWithin(imported, photos)) {
    throw UserError(image_path,
                    IsWithin(photos, imported)
                        ? "is where imported photos are written"
                        : "holds " + imported.string() + ", where imported photos are written",
                    "Give the folder that the photos came in, and a --workspace_path outside it");
  }
  CreateFolder(workspace.root);
  StageRunner runner(workspace, reporter);
  Stage stage{"photo_importer", {image_path}, {}, {workspace.Imported()}, {}};
  stage.also_writes = {workspace.ImportRecord()};
  if (is_video) stage.options["video_frames"] = std::to_string(video.video_frames);
  const bool has_run = runner.Run(stage, [&] {
    if (is_video) {
      ImportVideo(FindFfmpeg(ffmpeg_path), image_path, video.video_frames, workspace, reporter);
    } else {
      const ImportPlan plan = PlanImport(image_path);
      if (plan.photos.empty() && plan.faults.empty()) {
        throw UserError(image_path, "has no photos by their suffixes", "Check --image_path");
      }
      ImportPhotos(plan, workspace, reporter);
    }
  });
  context.out() << (has_run ? "photos are in  " : "up to date: ") << workspace.Imported().string() << '\n';
}

}  // namespace s2gs
