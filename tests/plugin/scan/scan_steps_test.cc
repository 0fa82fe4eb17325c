#include "plugin/scan/scan_steps.h"

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

#include "plugin/cli/shell_quote.h"
#include "tests/support/expected_text.h"

namespace s2gs {
namespace {

ScanSettings Least() {
  ScanSettings settings;
  settings.workspace_path = "scan";
  settings.given_path = settings.image_path = "photos";
  return settings;
}

// All that can be told.
ScanSettings Most() {
  ScanSettings settings = Least();
  settings.image_path = "scan/imported";
  settings.import = ImportPlan();
  settings.ffmpeg_path = "/opt/ffmpeg";
  settings.mask_path = "masks of it";
  settings.colmap_path = "/opt/colmap";
  settings.quality = Quality::kExtreme;
  settings.use_gpu = "1";
  settings.test_every = 8;
  settings.num_iterations = 5000;
  settings.first_octave = 0;
  settings.camera_params = "500,320,240,-0.1";
  settings.max_image_size = 1200;
  settings.keep_disc = false;
  settings.plain_table = "background";
  settings.scale.marker_size_mm = 30;
  settings.angles_path = "angles.csv";
  settings.step_deg = 7.5;
  settings.random_seed = 4;
  settings.log_level = LogLevel::kWarning;
  return settings;
}

std::string TextOf(const std::string& title, const ScanSettings& settings) {
  std::string text = "# " + title + "\n";
  std::vector<ScanStep> steps = ScanSteps(settings);
  steps.push_back(ReportStep(settings));
  for (const ScanStep& step : steps)
    text += step.title + ":\n  " + step.command + " " + ShellQuoted(step.arguments) + "\n";
  return text + "\n";
}

TEST(ScanSteps, PassOnWhatTheScannerIsTold) {
  std::string text = TextOf("Nothing but photos", Least());
  text += TextOf("All options", Most());
  ScanSettings video = Least();
  video.is_video = true;
  video.given_path = "turn.mp4";
  video.image_path = "scan/imported";
  video.video_frames = 90;
  video.until = ScanUntil::kSplit;
  text += TextOf("Poses of a video", video);
  ScanSettings forced = Most();
  forced.until = ScanUntil::kTrain;
  forced.forced = {"motion", "doubtful_poses"};
  text += TextOf("The motion asked of photos with masks, as far as the model", forced);
  ScanSettings plain = Least();
  plain.texture = false;
  text += TextOf("No texture", plain);
  ScanSettings low = Least();
  low.has_gpu = false;
  text += TextOf("Without a GPU", low);
  ExpectText(text, "plugin/scan/expected/scan_steps.txt");
}

TEST(ScanSteps, QualityIsLowWhereItIsAskedForOrNoGpuIsThere) {
  ScanSettings settings = Least();
  EXPECT_FALSE(settings.IsLow());
  settings.has_gpu = false;
  EXPECT_TRUE(settings.IsLow());
  settings.quality = Quality::kMedium;
  EXPECT_FALSE(settings.IsLow());
  settings.has_gpu = true;
  settings.quality = Quality::kLow;
  EXPECT_TRUE(settings.IsLow());
}

TEST(ScanSteps, WhatIsCheckedAndPlannedIsWhatRuns) {
  const ScanSettings settings = Most();
  const std::vector<ScanStep> steps = ScanSteps(settings);
  const ScanRequest request = RequestOf(settings, steps);
  EXPECT_EQ(request.workspace.root, "scan");
  EXPECT_EQ(request.image_path, "photos");
  EXPECT_TRUE(request.import);
  EXPECT_FALSE(request.is_video);
  EXPECT_EQ(request.ffmpeg_path, "/opt/ffmpeg");
  EXPECT_EQ(request.mask_path, "masks of it");
  EXPECT_EQ(request.angles_path, "angles.csv");
  EXPECT_EQ(request.colmap_path, "/opt/colmap");
  EXPECT_EQ(request.use_gpu, "1");
  EXPECT_EQ(request.test_every, 8);
  EXPECT_EQ(request.num_iterations, 5000);
  EXPECT_EQ(request.max_image_size, 1200);
  EXPECT_EQ(request.max_num_features, 16384);
  ASSERT_EQ(request.steps.size(), steps.size());
  for (size_t i = 0; i < steps.size(); ++i)
    EXPECT_EQ(request.steps[i], std::pair(steps[i].command, steps[i].arguments));
  ScanSettings marked = settings;
  marked.scale.point_a = {"a.png:1:2"};
  marked.scale.disc_rim = {"b.png:3:4.5"};
  EXPECT_EQ(RequestOf(marked, steps).marked_photos,
            (std::vector<std::pair<std::string, std::string>>{{"a.png", "point_a"}, {"b.png", "disc_rim"}}));
  const PlanRequest plan = PlanOf(settings);
  EXPECT_EQ(plan.workspace.root, "scan");
  EXPECT_EQ(plan.image_path, "scan/imported");
  EXPECT_TRUE(plan.has_masks);
  EXPECT_FALSE(PlanOf(Least()).has_masks);
  EXPECT_EQ(RequestOf(Least(), {}).max_num_features, 8192);
}

TEST(ScanSteps, PartsThatAreNotReachedAreNotChecked) {
  using Parts = std::vector<bool>;  // training, meshing, texturing
  const auto parts = [](ScanUntil until, bool texture) {
    ScanSettings settings = Least();
    settings.until = until;
    settings.texture = texture;
    const ScanRequest request = RequestOf(settings, {});
    const PlanRequest plan = PlanOf(settings);
    EXPECT_EQ(plan.trains, request.trains);
    EXPECT_EQ(plan.meshes, request.meshes);
    EXPECT_EQ(plan.textures, texture);
    return Parts({request.trains, request.meshes, request.textures});
  };
  EXPECT_EQ(parts(ScanUntil::kSplit, true), Parts({false, false, false}));
  EXPECT_EQ(parts(ScanUntil::kTrain, true), Parts({true, false, false}));
  EXPECT_EQ(parts(ScanUntil::kMesh, true), Parts({true, true, true}));
  EXPECT_EQ(parts(ScanUntil::kMesh, false), Parts({true, true, false}));
}

}  // namespace
}  // namespace s2gs
