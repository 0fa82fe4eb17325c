#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <exception>
#include <filesystem>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "plugin/cli/command.h"
#include "plugin/commands/model_exporter_command.h"
#include "plugin/commands/photo_importer_command.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "tests/support/bad_input.h"
#include "tests/support/model_without_points.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

void RunCommand(const char* name, void (*command)(CommandContext&), std::vector<std::string> arguments) {
  std::ostringstream out;
  CommandContext context(name, std::move(arguments), out);
  command(context);
}

// What is exported for a trainer names the photos: one that is missing is told by its name.
TEST(ModelExporter, NeedsThePhotosThatItNames) {
  const TemporaryFolder folder;
  const Workspace workspace{folder / "scan"};
  const ColmapModel model = ModelWithoutPoints(2);
  fs::create_directories(workspace.Images());
  for (const auto& [id, image] : model.images) WriteAll(workspace.Images() / image.name, "a photo");
  WriteColmapModel(workspace.ObjectModel(), model, ColmapFormat::kBinary);
  const auto write = [&](const char* output) {
    RunCommand("model_exporter", RunModelExporter,
               {"--workspace_path", workspace.root.string(), "--output_path", (folder / output).string(),
                "--output_type", "nerf"});
  };
  write("nerf");
  EXPECT_TRUE(fs::exists(folder / "nerf" / "transforms.json"));
  fs::remove(workspace.Images() / "2.jpg");
  ExpectUserError([&] { write("again"); }, {"lacks 1 of the model's 2 photos", "2.jpg"});
  EXPECT_FALSE(fs::exists(folder / "again" / "transforms.json"));
}

// 8,000 frames are the most: the fault of a folder that is missing is found after that of an option.
TEST(PhotoImporter, TakesUpTo8000FramesOfAVideo) {
  const TemporaryFolder folder;
  const auto fault = [&](const char* frames) -> std::string {
    try {
      RunCommand("photo_importer", RunPhotoImporter,
                 {"--workspace_path", (folder / "scan").string(), "--image_path", (folder / "none").string(),
                  "--video_frames", frames});
    } catch (const std::exception& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(fault("8000"), HasSubstr("neither a folder of photos nor a video file"));
  EXPECT_THAT(fault("8001"), HasSubstr("video_frames = 8001 violates <= 8000"));
  EXPECT_THAT(fault("3"), HasSubstr("neither a folder of photos nor a video file"));
  EXPECT_THAT(fault("2"), HasSubstr("video_frames = 2 violates >= 3"));
}

}  // namespace
}  // namespace s2gs
