#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
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
#include "plugin/commands/automatic_scanner_command.h"
#include "plugin/commands/model_exporter_command.h"
#include "plugin/commands/photo_importer_command.h"
#include "plugin/commands/work_precision_command.h"
#include "plugin/stage/workspace.h"
#include "s2gs/image/exif.h"
#include "s2gs/image/image_file.h"
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

// What it prints until colmap, which does nothing but say its version, lets it down.
class AutomaticScanner : public testing::Test {
 protected:
  void SetUp() override {
    const std::vector<Command>& all = AllCommands();
    if (std::none_of(all.begin(), all.end(), [](const Command& c) { return c.name == "motion_splitter"; }))
      GTEST_SKIP() << "this program was built without SfM";
    folder_.Write("colmap",
                  "#!/bin/sh\n[ \"$1\" = help ] || exit 1\nprintf '%s\\n' 'COLMAP 3.8 (Commit abc without "
                  "CUDA)' 'Available commands:' '  mapper'\n");
    fs::permissions(folder_ / "colmap", fs::perms::owner_all);
    fs::create_directories(folder_ / "photos");
    for (int i = 0; i < 4; ++i) WritePhoto(i, 1);
  }
  void WritePhoto(int number, int orientation) const {
    ExifTags tags;
    tags.orientation = orientation;
    WritePng(folder_ / "photos" / (std::to_string(number) + ".png"),
             Image8{32, 24, 1, std::vector<uint8_t>(32 * 24, static_cast<uint8_t>(number))}, MakeExif(tags));
  }
  std::string Scan(const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {"--workspace_path", (folder_ / "scan").string(),
                                          "--image_path",     (folder_ / "photos").string(),
                                          "--colmap_path",    (folder_ / "colmap").string(),
                                          "--use_gpu",        "0",
                                          "--log_level",      "error"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    std::ostringstream out;
    CommandContext context("automatic_scanner", arguments, out);
    EXPECT_THROW(RunAutomaticScanner(context), UserError);
    return out.str();
  }
  const TemporaryFolder folder_;
};

TEST_F(AutomaticScanner, HasTheStepsThatAreAskedForAndTheReport) {
  const std::string first = "] What stands still and what turns: s2gs motion_splitter\n";
  EXPECT_THAT(Scan({"--until", "split"}), HasSubstr("[1/3" + first));
  EXPECT_THAT(Scan({"--until", "train"}), HasSubstr("[1/4" + first));
  EXPECT_THAT(Scan({"--texture", "0"}), HasSubstr("[1/6" + first));
  EXPECT_THAT(Scan({"--texture", "1"}), HasSubstr("[1/7" + first));
  EXPECT_THAT(Scan({"--until", "split", "--marker_size_mm", "30"}), HasSubstr("[1/4" + first));
  EXPECT_FALSE(fs::exists(folder_ / "scan/imported"));
  EXPECT_TRUE(fs::exists(folder_ / "scan/s2gs/plan.json"));
}

TEST_F(AutomaticScanner, ImportsPhotosFirstWhereOneNeedsIt) {
  WritePhoto(2, 2);  // mirrored
  const std::string said = Scan({"--until", "split"});
  EXPECT_THAT(said, HasSubstr("[1/4] Photos that COLMAP reads: s2gs photo_importer\n"));
  EXPECT_THAT(said, HasSubstr("[2/4] What stands still and what turns: s2gs motion_splitter\n"));
  for (int i = 0; i < 4; ++i)
    EXPECT_TRUE(fs::exists(folder_ / "scan/imported" / (std::to_string(i) + ".png"))) << i;
}

TEST_F(AutomaticScanner, IsToldOfFaultsBeforeAnythingIsWritten) {
  EXPECT_THAT(Scan({"--mask_path", (folder_ / "none").string()}), testing::IsEmpty());
  fs::remove_all(folder_ / "photos");
  EXPECT_THAT(Scan({}), testing::IsEmpty());
  EXPECT_FALSE(fs::exists(folder_ / "scan"));
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
