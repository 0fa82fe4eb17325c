#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <sstream>
#include <string>
#include <vector>

#include "plugin/commands/gaussian_renderer_command.h"
#include "plugin/commands/gaussian_trainer_command.h"
#include "plugin/commands/tsdf_mesher_command.h"
#include "plugin/stage/stage_stamp.h"
#include "plugin/stage/workspace.h"
#include "s2gs/checkpoint.h"
#include "s2gs/gaussians_ply.h"
#include "sfm_split/scene/io/colmap_maps.h"
#include "tests/s2gs/expect_gaussians.h"
#include "tests/s2gs/turntable_workspace.h"
#include "tests/support/synthetic_render.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

// A workspace with rendered photos of 2 stations x 5 steps.
class GaussianCommands : public testing::Test {
 protected:
  void SetUp() override {
    SyntheticTurntableOptions options;
    options.stations = 2;
    options.steps = 5;
    options.step_deg = 72;
    options.width = 48;
    options.height = 36;
    options.num_object_points = 200;
    options.num_platter_points = 100;
    options.num_background_points = 300;
    const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
    SyntheticRenderOptions render_options;
    render_options.use_turntable_object = true;
    const SyntheticRenderScene scene = MakeSyntheticRenderScene(turntable, render_options);
    WriteTurntableWorkspace(workspace_.root, turntable,
                            [&](int view) { return RenderImage(scene, turntable, view).rgb; });
    for (const View& view : turntable.scene.views) names_.push_back(view.name);
  }

  std::string Train(std::vector<std::string> more, const std::string& min_points = "300") {
    std::vector<std::string> arguments = {"--workspace_path",
                                          workspace_.root.string(),
                                          "--use_gpu",
                                          "0",
                                          "--Train.num_iterations",
                                          "60",
                                          "--Init.min_points",
                                          min_points,
                                          "--log_level",
                                          "error"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return RunCommand(RunGaussianTrainer, arguments);
  }

  std::string Render(const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {
        "--workspace_path", workspace_.root.string(), "--use_gpu", "0", "--log_level", "error"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return RunCommand(RunGaussianRenderer, arguments);
  }

  std::string Mesh(const std::vector<std::string>& more) {
    std::vector<std::string> arguments = {
        "--workspace_path", workspace_.root.string(), "--use_gpu", "0", "--log_level", "error"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return RunCommand(RunTsdfMesher, arguments);
  }

  static std::string RunCommand(void (*run)(CommandContext&), const std::vector<std::string>& arguments) {
    std::ostringstream out;
    CommandContext context("command", arguments, out);
    run(context);
    return out.str();
  }

  // Another one every time that a stage runs.
  std::string RunOf(const std::string& stage) const {
    Reporter silent;
    const auto stamp = ReadStageStamp(workspace_, stage, silent);
    return stamp ? stamp->run_id : "";
  }
  std::vector<std::string> Runs() const {
    return {RunOf("gaussian_trainer"), RunOf("image_undistorter"), RunOf("gaussian_renderer"),
            RunOf("tsdf_mesher")};
  }

  TemporaryFolder folder_;
  Workspace workspace_{folder_.path()};
  std::vector<std::string> names_;
};

TEST_F(GaussianCommands, TrainThenRender) {
  const std::string figures = Train({"--test_every", "5"});
  EXPECT_NE(figures.find("held-out photos       2"), std::string::npos) << figures;
  const Gaussians gaussians = ReadGaussianPly(workspace_.PointCloud());
  EXPECT_GT(gaussians.size(), 300U);
  EXPECT_TRUE(std::filesystem::exists(workspace_.Log()));
  EXPECT_TRUE(std::filesystem::is_empty(workspace_.Checkpoints()));

  Render({"--color", "1", "--comparison", "1", "--pictures", "1", "--foreground", "1", "--num_frames", "2"});
  for (const std::string& name : names_) {
    const Image8 mask = ReadImage(workspace_.Mask(name), 1);
    EXPECT_EQ(mask.width, 48);
    for (const uint8_t value : mask.pixels) EXPECT_TRUE(value == 0 || value == 255);
    const ColmapMap depth = ReadColmapMap(workspace_.DepthMap(name), 1);
    const ColmapMap normal = ReadColmapMap(workspace_.NormalMap(name), 3);
    EXPECT_EQ(depth.width, 48);
    size_t filled = 0;
    for (int y = 0; y < depth.height; ++y) {
      for (int x = 0; x < depth.width; ++x) {
        if (!(depth.At(x, y) > 0)) continue;
        ++filled;
        const double length = std::hypot(normal.At(x, y, 0), normal.At(x, y, 1), normal.At(x, y, 2));
        EXPECT_NEAR(length, 1, 1e-5);
        EXPECT_LT(normal.At(x, y, 2), 0.2) << "normals face the camera";
        // The camera stands about 0.7 from the table, whose object has a radius of 0.08.
        EXPECT_GT(depth.At(x, y), 0.3);
        EXPECT_LT(depth.At(x, y), 1.2);
      }
    }
    EXPECT_GT(filled, 50U) << name;
    for (const char* kind : {"color", "comparison", "depth", "normal", "foreground"}) {
      const Image8 picture = ReadImage(workspace_.Own() / "renders" / kind / (name + ".png"), 3);
      EXPECT_EQ(picture.width, std::string(kind) == "comparison" ? 4 * 48 : 48);
    }
    EXPECT_TRUE(std::filesystem::exists(workspace_.DenseImages() / name));
  }
  EXPECT_TRUE(std::filesystem::exists(workspace_.Own() / "renders" / "frames" / "0001.png"));
}

TEST_F(GaussianCommands, OtherModesWriteTheirBody) {
  // The object, which the photos look at, and what is behind it.
  Train({"--mode", "static"}, "900");
  size_t object = 0;
  size_t behind = 0;
  const Gaussians whole = ReadGaussianPly(workspace_.PointCloud());
  for (size_t i = 0; i < whole.size(); ++i) {
    const float* centre = whole.centre.data() + 3 * i;
    // The object has a radius of 0.08 about the origin, the cameras stand about 0.7 away.
    const double distance = std::hypot(centre[0], centre[1], centre[2]);
    if (distance < 0.08) {
      EXPECT_GT(whole.foreground_logit[i], 5) << i;
    }
    if (distance > 0.45) {
      EXPECT_LT(whole.foreground_logit[i], -5) << i;
    }
    object += distance < 0.08 ? 1 : 0;
    behind += distance > 0.45 ? 1 : 0;
  }
  EXPECT_GT(object, 50U);
  EXPECT_GT(behind, 50U);
  for (const std::string& name : names_) {
    std::filesystem::create_directories(workspace_.Masks());
    WriteImage(workspace_.Mask(name), {48, 36, 1, std::vector<uint8_t>(48 * 36, 255)});
  }
  Train({"--mode", "masks"});
  for (const float logit : ReadGaussianPly(workspace_.PointCloud()).foreground_logit) EXPECT_GT(logit, 5);
}

TEST_F(GaussianCommands, WhatIsDoneIsSkipped) {
  const auto run_all = [&] {
    Train({});
    Render({});
    Mesh({});
  };
  run_all();
  const std::vector<std::string> first = Runs();
  for (const std::string& run : first) EXPECT_FALSE(run.empty());
  const std::string model = ReadAll(workspace_.PointCloud());
  run_all();
  EXPECT_EQ(Runs(), first);
  EXPECT_NE(Train({"--num_threads", "2"}).find("up to date"), std::string::npos);
  EXPECT_NE(Render({"--num_threads", "2"}).find("up to date"), std::string::npos);
  EXPECT_NE(Mesh({"--Tsdf.num_threads", "2"}).find("up to date"), std::string::npos);

  // Results of one's own choice are no part of the workspace: written every time, and nothing runs for them.
  const std::filesystem::path picture = workspace_.Own() / "renders" / "color" / (names_[0] + ".png");
  Render({"--color", "1"});
  EXPECT_TRUE(std::filesystem::remove(picture));
  Render({"--color", "1"});
  EXPECT_TRUE(std::filesystem::exists(picture));
  Train({"--output_path", folder_ / "other", "--random_seed", "5"});
  EXPECT_NE(folder_.Read("other/point_cloud.ply"), model);
  Mesh({"--output_path", folder_ / "mesh.obj"});
  EXPECT_TRUE(std::filesystem::exists(folder_ / "mesh.obj"));
  EXPECT_EQ(Runs(), first);
  EXPECT_EQ(ReadAll(workspace_.PointCloud()), model);
}

TEST_F(GaussianCommands, WhatChangedRunsAgainWithWhatFollows) {
  const auto run_all = [&](const std::vector<std::string>& more) {
    const std::vector<std::string> before = Runs();
    Train(more);
    Render({});
    Mesh({});
    std::vector<bool> has_run;
    const std::vector<std::string> after = Runs();
    for (size_t i = 0; i < after.size(); ++i) has_run.push_back(after[i] != before[i]);
    return has_run;
  };
  using Ran = std::vector<bool>;  // trainer, undistorter, renderer, mesher
  EXPECT_EQ(run_all({}), Ran({true, true, true, true}));
  EXPECT_EQ(run_all({}), Ran({false, false, false, false}));
  EXPECT_EQ(run_all({"--random_seed", "3"}), Ran({true, false, true, true}));
  // A photo: a darker one, which dense/0 must show too.
  WriteImage(workspace_.Images() / names_[1], {48, 36, 3, std::vector<uint8_t>(3 * 48 * 36, 10)});
  EXPECT_EQ(run_all({"--random_seed", "3"}), Ran({true, true, true, true}));
  EXPECT_EQ(ReadAll(workspace_.DenseImages() / names_[1]), ReadAll(workspace_.Images() / names_[1]));
  // The model, by another hand.
  std::filesystem::remove(workspace_.PointCloud());
  EXPECT_EQ(run_all({"--random_seed", "3"}), Ran({true, false, true, true}));
  std::filesystem::remove(workspace_.DepthMap(names_[2]));
  EXPECT_EQ(run_all({"--random_seed", "3"}), Ran({false, false, true, true}));
  // Masks that the renderer wrote are nothing that the trainer depends on.
  std::filesystem::remove(workspace_.Mask(names_[2]));
  EXPECT_EQ(run_all({"--random_seed", "3"}), Ran({false, false, true, true}));
}

TEST_F(GaussianCommands, CheckpointsOfOtherPhotosAreNotGoneOnFrom) {
  Train({"--output_path", folder_ / "straight"});
  // Stopped half-way by a checkpoint that stays.
  const std::filesystem::path checkpoint = workspace_.Checkpoints() / "latest.checkpoint";
  const std::string settings_of_nothing = "no settings of any run";
  Checkpoint other;
  other.cursor.settings = settings_of_nothing;
  other.cursor.iteration = 30;
  other.cursor.progress = 0.5;
  other.state.gaussians = ReadGaussianPly(folder_ / "straight/point_cloud.ply");
  std::filesystem::create_directories(workspace_.Checkpoints());
  WriteCheckpoint(checkpoint, other);
  Train({});
  EXPECT_FALSE(std::filesystem::exists(checkpoint));
  ExpectSameGaussians(ReadGaussianPly(workspace_.PointCloud()),
                      ReadGaussianPly(folder_ / "straight/point_cloud.ply"));
}

TEST_F(GaussianCommands, MissingPhotosAreNamed) {
  std::filesystem::remove(workspace_.Images() / names_[3]);
  try {
    Train({});
    FAIL() << "trained without a photo";
  } catch (const UserError& error) {
    EXPECT_NE(std::string(error.what()).find(names_[3]), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace s2gs
