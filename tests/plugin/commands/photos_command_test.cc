#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "plugin/cli/command.h"
#include "plugin/cli/interrupt.h"
#include "plugin/commands/model_exporter_command.h"
#include "plugin/commands/photo_importer_command.h"
#include "plugin/commands/work_precision_command.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "tests/support/bad_input.h"
#include "tests/support/model_without_points.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::Not;

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

// Ctrl-C ends it between two photos. In a process of its own, since a request to stop stays.
TEST(ModelExporterDeathTest, StopsBetweenPhotosWhenItIsAskedTo) {
  testing::FLAGS_gtest_death_test_style = "threadsafe";
  const TemporaryFolder folder;
  const Workspace workspace{folder / "scan"};
  const ColmapModel model = ModelWithoutPoints(2);
  WriteColmapModel(workspace.ObjectModel(), model, ColmapFormat::kBinary);
  const auto stopped = [&] {
    InstallSignalHandlers();
    std::raise(SIGINT);
    try {
      RunCommand("model_exporter", RunModelExporter,
                 {"--workspace_path", workspace.root.string(), "--output_path", (folder / "out").string(),
                  "--output_type", "masks_colmap"});
    } catch (const Interrupted&) {
      std::_Exit(7);
    } catch (const std::exception& error) {
      std::fprintf(stderr, "%s\n", error.what());
    }
    std::_Exit(8);
  };
  EXPECT_EXIT(stopped(), testing::ExitedWithCode(7), "");
}

TEST(WorkPrecision, WantsOneFolderOfPhotosForEachWorkspace) {
  const TemporaryFolder folder;
  const auto fault = [&](const std::string& images) -> std::string {
    try {
      RunCommand("work_precision", RunWorkPrecision,
                 {"--workspace_path", (folder / "a").string() + "," + (folder / "b").string(), "--image_path",
                  images, "--output_path", (folder / "curve").string(), "--knob", "train_iterations",
                  "--values", "100,200"});
    } catch (const std::exception& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(fault((folder / "c").string()),
              HasSubstr("--image_path has 1 folders, --workspace_path has 2"));
  EXPECT_THAT(fault((folder / "c").string() + "," + (folder / "d").string()),
              Not(HasSubstr("folders, --workspace_path has")));
}

}  // namespace
}  // namespace s2gs
