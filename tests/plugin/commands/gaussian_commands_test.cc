#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "mesh/surface/triangle_mesh.h"
#include "plugin/cli/options.h"
#include "plugin/commands/gaussian_renderer_command.h"
#include "plugin/commands/gaussian_trainer_command.h"
#include "plugin/commands/mesh_texturer_command.h"
#include "plugin/commands/tsdf_mesher_command.h"
#include "plugin/outputs/texture_workspace.h"
#include "plugin/stage/stage_stamp.h"
#include "plugin/stage/workspace.h"
#include "s2gs/checkpoint.h"
#include "s2gs/gaussians_ply.h"
#include "s2gs/kernel/sh.h"
#include "sfm_split/scene/io/colmap_maps.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "tests/s2gs/expect_gaussians.h"
#include "tests/s2gs/turntable_workspace.h"
#include "tests/support/synthetic_render.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

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

// A film by a station's camera shows in turn what that station's photos were to show: its steps are the
// table's. Each comparison has the photo, the scene, and the mask.
TEST_F(GaussianCommands, FilmsAndComparisonsShowTheSameScene) {
  Train({});
  const std::string figures =
      Render({"--color", "1", "--comparison", "1", "--num_frames", "5", "--frame_station", "1"});
  EXPECT_NE(figures.find("photos rendered  10\nframes           5\n"), std::string::npos) << figures;
  const std::filesystem::path renders = workspace_.Own() / "renders";
  std::vector<TurntableImage> station;
  for (const TurntableImage& image : ReadTurntableFile(workspace_.Turntable()).images) {
    if (image.station == 1) station.push_back(image);
  }
  ASSERT_EQ(station.size(), 5U);
  std::sort(station.begin(), station.end(),
            [](const TurntableImage& a, const TurntableImage& b) { return a.name < b.name; });
  for (int frame = 0; frame < 5; ++frame) {
    const auto same = std::find_if(station.begin(), station.end(), [&](const TurntableImage& image) {
      const double off = std::remainder(image.angle_deg - station[0].angle_deg - 72.0 * frame, 360);
      return std::abs(off) < 1;
    });
    ASSERT_NE(same, station.end());
    const Image8 film = ReadImage(renders / "frames" / ("000" + std::to_string(frame) + ".png"), 3);
    const Image8 color = ReadImage(renders / "color" / (same->name + ".png"), 3);
    ASSERT_EQ(film.pixels.size(), color.pixels.size());
    size_t other = 0;
    for (size_t i = 0; i < film.pixels.size(); ++i)
      other += std::abs(film.pixels[i] - color.pixels[i]) > 1 ? 1 : 0;
    EXPECT_LT(other, film.pixels.size() / 200) << frame;
  }
  for (const std::string& name : names_) {
    const Image8 picture = ReadImage(renders / "comparison" / (name + ".png"), 3);
    const Image8 photo = ReadImage(workspace_.Images() / name, 3);
    const Image8 color = ReadImage(renders / "color" / (name + ".png"), 3);
    const Image8 mask = ReadImage(workspace_.Mask(name), 1);
    ASSERT_EQ(picture.width, 4 * 48);
    for (int y = 0; y < 36; ++y) {
      for (int x = 0; x < 48; ++x) {
        for (int c = 0; c < 3; ++c) {
          EXPECT_EQ(picture.Pixel(x, y)[c], photo.Pixel(x, y)[c]);
          EXPECT_EQ(picture.Pixel(48 + x, y)[c], color.Pixel(x, y)[c]);
          const int real = photo.Pixel(x, y)[c];
          EXPECT_EQ(picture.Pixel(3 * 48 + x, y)[c], *mask.Pixel(x, y) == 255 ? real : real / 4);
        }
      }
    }
  }
  // Four photos below each other.
  const Image8 overview = ReadImage(workspace_.Overview(), 3);
  EXPECT_EQ(overview.width, 1600);
  EXPECT_EQ(overview.height, 4 * (36 * 1600 / (4 * 48)));
  EXPECT_THROW(Render({"--num_frames", "2", "--frame_station", "7"}), CommandLineError);
  EXPECT_THROW(Render({"--num_frames", "-1"}), CommandLineError);
}

// A red disc that lies on the object, reaches farther out than anything turns and is said to turn: masks and
// maps leave it out, colours show the model as it is.
TEST_F(GaussianCommands, ColorsAreOfTheWholeModel) {
  Train({});
  // Of a picture: of color that are red, of p that turn for sure.
  const auto share = [](const Image8& picture, bool of_color) {
    size_t count = 0;
    for (size_t i = 0; i < picture.pixels.size(); i += 3) {
      const uint8_t* pixel = &picture.pixels[i];
      count += of_color ? (pixel[0] > 200 && pixel[1] < 50 && pixel[2] < 50) : pixel[0] > 250;
    }
    return 3.0 * static_cast<double>(count) / static_cast<double>(picture.pixels.size());
  };
  const auto rendered = [&] {
    Render({"--color", "1", "--foreground", "1", "--num_frames", "1"});
    std::vector<Image8> pictures;
    const std::filesystem::path renders = workspace_.Own() / "renders";
    for (const std::string& name : names_) {
      pictures.push_back(ReadImage(renders / "color" / (name + ".png"), 3));
      pictures.push_back(ReadImage(renders / "foreground" / (name + ".png"), 3));
      pictures.push_back(ReadImage(workspace_.Mask(name), 3));
    }
    pictures.push_back(ReadImage(renders / "frames/0000.png", 3));
    return pictures;
  };
  const auto depth = [&] { return ReadColmapMap(workspace_.DepthMap(names_[0]), 1).values; };
  const std::vector<Image8> before = rendered();
  const std::vector<float> depth_before = depth();

  Gaussians model = ReadGaussianPly(workspace_.PointCloud());
  const TurntableAxis axis = ReadTurntableFile(workspace_.Turntable()).axis;
  double highest = -1e9;
  for (size_t i = 0; i < model.size(); ++i) {
    const Eigen::Vector3f x(model.centre.data() + 3 * i);
    if (model.foreground_logit[i] > 0)
      highest = std::max(highest, (x.cast<double>() - axis.point).dot(axis.direction));
  }
  const Eigen::Vector3d middle = axis.point + highest * axis.direction;
  const auto up = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), axis.direction);
  const size_t disc = model.size();
  model.Resize(disc + 1);
  for (int k = 0; k < 3; ++k) {
    model.centre[3 * disc + k] = static_cast<float>(middle[k]);
    model.sh_dc[3 * disc + k] = static_cast<float>((k == 0 ? 0.5 : -0.5) / kShBand0);
    model.rotation[4 * disc + 1 + k] = static_cast<float>(up.vec()[k]);
  }
  model.rotation[4 * disc] = static_cast<float>(up.w());
  model.log_scale[2 * disc] = model.log_scale[2 * disc + 1] = std::log(10.0F);
  model.opacity_logit[disc] = model.foreground_logit[disc] = 10;
  WriteGaussianPly(workspace_.PointCloud(), model);

  const std::vector<Image8> after = rendered();
  const size_t film = after.size() - 1;
  for (size_t i = 0; i < after.size(); ++i) {
    if (i != film && i % 3 == 2) {
      EXPECT_EQ(after[i].pixels, before[i].pixels) << i;
      continue;
    }
    // Measured: .36 and more of a picture is red, and .125 and more of it turns for sure that did not.
    const bool of_color = i == film || i % 3 == 0;
    EXPECT_GT(share(after[i], of_color) - share(before[i], of_color), of_color ? 0.3 : 0.1) << i;
  }
  const std::vector<float> depth_after = depth();
  ASSERT_EQ(depth_after.size(), depth_before.size());
  // Read from a file that was written anew: 1e-6 at two pixels.
  for (size_t i = 0; i < depth_after.size(); ++i) ASSERT_NEAR(depth_after[i], depth_before[i], 1e-5) << i;
}

TEST_F(GaussianCommands, WhatIsNotAskedForIsNotRendered) {
  Train({});
  const std::string nothing = Render({"--masks", "0", "--stereo", "0", "--overview", "0"});
  EXPECT_NE(nothing.find("photos rendered  0\nframes           0\n"), std::string::npos) << nothing;
  for (const std::filesystem::path& path : {workspace_.Masks(), workspace_.DepthMaps(), workspace_.Overview(),
                                            workspace_.MaskLog(), workspace_.Own() / "renders"}) {
    EXPECT_FALSE(std::filesystem::exists(path)) << path;
  }
  folder_.Write("list.txt", names_[3] + "\n" + names_[6] + "\n");
  const std::string two =
      Render({"--image_list", folder_ / "list.txt", "--stereo", "0", "--foreground", "1"});
  EXPECT_NE(two.find("photos rendered  2\n"), std::string::npos) << two;
  for (size_t i = 0; i < names_.size(); ++i) {
    EXPECT_EQ(std::filesystem::exists(workspace_.Mask(names_[i])), i == 3 || i == 6) << i;
    EXPECT_EQ(std::filesystem::exists(workspace_.Own() / "renders" / "foreground" / (names_[i] + ".png")),
              i == 3 || i == 6)
        << i;
  }
  EXPECT_TRUE(std::filesystem::exists(workspace_.Overview()));
  EXPECT_FALSE(std::filesystem::exists(workspace_.DepthMaps()));
  const nlohmann::json log = nlohmann::json::parse(ReadAll(workspace_.MaskLog()));
  EXPECT_EQ(log["event"], "table");
  EXPECT_FALSE(std::filesystem::exists(workspace_.Own() / "renders" / "color"));
}

// Depths of each kind, and of the rotating part or of all.
TEST_F(GaussianCommands, MapsAreOfWhatIsAskedFor) {
  Train({});
  const auto depths = [&](const std::vector<std::string>& more) {
    Render(more);
    return ReadColmapMap(workspace_.DepthMap(names_[0]), 1).values;
  };
  const auto count = [](const std::vector<float>& values) {
    return std::count_if(values.begin(), values.end(), [](float value) { return value > 0; });
  };
  const std::vector<float> median = depths({});
  const std::vector<float> expected = depths({"--depth", "expected"});
  const std::vector<float> all = depths({"--maps_of", "all"});
  EXPECT_NE(median, expected);
  double apart = 0;
  for (size_t i = 0; i < median.size(); ++i) {
    if (median[i] > 0 && expected[i] > 0) apart = std::max<double>(apart, std::abs(median[i] - expected[i]));
  }
  EXPECT_LT(apart, 0.2);  // of the object's own size
  EXPECT_GT(count(all), 1.5 * static_cast<double>(count(median)));
}

// What the mesher and the texturer print and log is what they wrote.
TEST_F(GaussianCommands, SaysWhatWasMeshedAndTextured) {
  Train({});
  Render({});
  const auto last_log = [&] {
    std::istringstream lines(ReadAll(workspace_.MeshLog()));
    std::string line, last;
    while (std::getline(lines, line)) last = line;
    return nlohmann::json::parse(last);
  };
  const auto expect_mesh = [&](const std::string& said) {
    const TriangleMesh mesh = ReadPlyMesh(workspace_.TsdfMesh());
    EXPECT_THAT(said, HasSubstr(fmt::format(
                          "mesh             {} vertices, {} triangles\nwritten          {}\n",
                          mesh.vertices.size(), mesh.triangles.size(), workspace_.TsdfMesh().string())));
  };
  const std::string refined = Mesh({});
  EXPECT_THAT(refined, HasSubstr("depth maps       10 of 10 images, 10 with masks\nbackend          CPU, "));
  EXPECT_THAT(refined, HasSubstr("px outwards, "));
  EXPECT_THAT(refined, Not(HasSubstr("holes closed     ")));
  expect_mesh(refined);
  EXPECT_EQ(last_log()["event"], "refined");
  EXPECT_EQ(last_log()["enabled"], true);
  EXPECT_EQ(last_log()["photos"], 10);
  const std::string plain = Mesh({"--Refine.enabled", "0", "--Cleanup.max_hole_edges", "8"});
  EXPECT_THAT(plain, Not(HasSubstr("px outwards, ")));
  EXPECT_THAT(plain, HasSubstr("holes closed     "));
  expect_mesh(plain);
  EXPECT_EQ(last_log()["enabled"], false);
  EXPECT_EQ(last_log()["photos"], 0);
  // No vertex goes where none may.
  const size_t simplified = ReadPlyMesh(workspace_.TsdfMesh()).vertices.size();
  expect_mesh(Mesh({"--Refine.enabled", "0", "--max_error_voxels", "0"}));
  EXPECT_GT(ReadPlyMesh(workspace_.TsdfMesh()).vertices.size(), simplified);

  TextureWorkspaceOptions options;
  options.output_path = folder_ / "direct";
  Reporter silent;
  const TextureWorkspaceSummary summary = TextureWorkspace(workspace_, options, silent);
  const TextureSummary& texture = summary.texture;
  const std::string textured =
      RunCommand(RunMeshTexturer, {"--workspace_path", workspace_.root.string(), "--output_path",
                                   (folder_ / "line").string(), "--log_level", "error"});
  EXPECT_THAT(textured, HasSubstr(fmt::format("photos           {}, {} with masks; {:.1f} for each texel\n",
                                              summary.num_photos, summary.num_masks, texture.mean_photos)));
  EXPECT_THAT(textured,
              HasSubstr(fmt::format(
                  "texels           {}, {:.1f} % of them seen, in {} charts\n", texture.num_texels,
                  static_cast<double>(texture.num_seen) / (0.01 * static_cast<double>(texture.num_texels)),
                  texture.num_charts)));
  EXPECT_THAT(textured, HasSubstr(fmt::format("{} x {}, {:.0f} % of them used\n", summary.pages.back().width,
                                              summary.pages.back().height, texture.page_use / 0.01)));
  EXPECT_THAT(textured, HasSubstr(fmt::format("differs by {:.1f} % from photo to photo\n",
                                              texture.gain_spread / 0.01)));
  EXPECT_THAT(textured, HasSubstr("written          " + (folder_ / "line").string()));
  EXPECT_THAT(textured, Not(HasSubstr("held out")));
  // Pictures of another texture leave that in the workspace.
  const auto texture_workspace = [&](std::vector<std::string> more) {
    more.insert(more.end(), {"--workspace_path", workspace_.root.string(), "--log_level", "error"});
    return RunCommand(RunMeshTexturer, more);
  };
  texture_workspace({});
  EXPECT_THAT(texture_workspace({}), HasSubstr("up to date"));
  texture_workspace({"--render_path", folder_ / "drawn", "--Texture.texel_size_pixels", "4"});
  EXPECT_THAT(texture_workspace({}), Not(HasSubstr("up to date")));

  std::filesystem::remove(workspace_.DepthMap(names_[0]));
  EXPECT_THAT(Mesh({}), HasSubstr("depth maps       9 of 10 images, 9 with masks\n"));
  for (const std::string& name : names_) std::filesystem::remove(workspace_.DepthMap(name));
  EXPECT_THROW(Mesh({}), UserError);
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
  // What a quality would say and the line says otherwise counts.
  Train({"--max_image_size", "40"});
  EXPECT_NE(RunOf("gaussian_trainer"), first[0]);
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
