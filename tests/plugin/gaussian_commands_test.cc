#include <gtest/gtest.h>

#include <filesystem>
#include <sstream>
#include <string>
#include <vector>

#include "plugin/gaussian_renderer_command.h"
#include "plugin/gaussian_trainer_command.h"
#include "plugin/workspace.h"
#include "s2gs/gaussians_ply.h"
#include "s2gs/image_file.h"
#include "sfm_split/colmap_maps.h"
#include "sfm_split/colmap_model.h"
#include "sfm_split/turntable_file.h"
#include "tests/synthetic_render.h"
#include "tests/synthetic_turntable.h"
#include "tests/temporary_folder.h"

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
    ColmapModel object;
    ColmapModel background;
    TurntableFile file;
    file.axis = turntable.scene.axis;
    file.num_stations = 2;
    for (const Camera& camera : turntable.scene.cameras) {
      object.cameras[camera.camera_id] = background.cameras[camera.camera_id] = camera;
    }
    for (size_t i = 0; i < turntable.scene.views.size(); ++i) {
      const View& view = turntable.scene.views[i];
      ColmapImage image;
      image.image_id = static_cast<uint32_t>(i + 1);
      image.name = "photo" + std::to_string(i) + ".png";
      names_.push_back(image.name);
      image.camera_id = view.camera_id;
      image.cam_from_world = view.CamFromObject();
      object.images[image.image_id] = image;
      image.cam_from_world = view.cam_from_world;
      background.images[image.image_id] = image;
      file.images.push_back({image.name, view.station, view.angle_deg, view.world_from_object});
      std::filesystem::create_directories(workspace_.Images());
      WriteImage(workspace_.Images() / image.name, RenderImage(scene, turntable, static_cast<int>(i)).rgb);
    }
    uint64_t id = 1;
    for (const SyntheticPoint& point : turntable.points) {
      ColmapPoint3D p;
      p.point3D_id = id++;
      p.xyz = point.x;
      p.rgb = point.color;
      (IsRotating(point.body) ? object : background).points3D[p.point3D_id] = p;
    }
    WriteColmapModel(workspace_.ObjectModel(), object, ColmapFormat::kBinary);
    WriteColmapModel(workspace_.StaticModel(), background, ColmapFormat::kBinary);
    WriteTurntableFile(workspace_.Turntable(), file);
  }

  std::string Train(std::vector<std::string> more) {
    std::vector<std::string> arguments = {"--workspace_path",
                                          workspace_.root.string(),
                                          "--use_gpu",
                                          "0",
                                          "--Train.num_iterations",
                                          "60",
                                          "--Init.min_points",
                                          "300",
                                          "--log_level",
                                          "error"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    std::ostringstream out;
    CommandContext context("gaussian_trainer", arguments, out);
    RunGaussianTrainer(context);
    return out.str();
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

  std::ostringstream out;
  CommandContext context(
      "gaussian_renderer",
      {"--workspace_path", workspace_.root.string(), "--use_gpu", "0", "--log_level", "error", "--color", "1",
       "--comparison", "1", "--pictures", "1", "--foreground", "1", "--num_frames", "2"},
      out);
  RunGaussianRenderer(context);
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
  Train({"--mode", "static"});
  for (const float logit : ReadGaussianPly(workspace_.PointCloud()).foreground_logit) EXPECT_LT(logit, -5);
  for (const std::string& name : names_) {
    std::filesystem::create_directories(workspace_.Masks());
    WriteImage(workspace_.Mask(name), {48, 36, 1, std::vector<uint8_t>(48 * 36, 255)});
  }
  Train({"--mode", "masks"});
  for (const float logit : ReadGaussianPly(workspace_.PointCloud()).foreground_logit) EXPECT_GT(logit, 5);
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
