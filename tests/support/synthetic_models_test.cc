#include "tests/support/synthetic_models.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "sfm_split/base/angles.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/scene_truth.h"
#include "tests/support/synthetic_photo_set.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

SyntheticTurntable SmallTurntable(int flip_from_station = 0) {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 4;
  options.num_object_points = 120;
  options.num_platter_points = 40;
  options.num_background_points = 90;
  options.num_extra_keypoints = 3;
  options.flip_from_station = flip_from_station;
  return MakeSyntheticTurntable(options);
}

void ExpectConsistent(const ColmapModel& model) {
  size_t elements = 0;
  for (const auto& [id, point] : model.points3D) {
    EXPECT_GE(point.track.size(), 2U);
    for (const ColmapTrackElement& element : point.track) {
      ++elements;
      const ColmapImage& image = model.images.at(element.image_id);
      const ColmapPoint2D& point2D = image.points2D.at(element.point2D_idx);
      EXPECT_EQ(point2D.point3D_id, id);
      const auto xy = ProjectToImage(model.cameras.at(image.camera_id), image.cam_from_world * point.xyz);
      ASSERT_TRUE(xy.has_value());
      EXPECT_LT((*xy - point2D.xy).norm(), 1e-8);
    }
  }
  size_t seeing = 0;
  for (const auto& [id, image] : model.images) {
    for (const ColmapPoint2D& point2D : image.points2D)
      seeing += point2D.point3D_id != kInvalidPoint3DId ? 1 : 0;
  }
  EXPECT_EQ(seeing, elements);
}

TEST(SyntheticModels, PointsProjectToTheirKeypointsInAnyFrameAndUnit) {
  for (const int flip_from_station : {0, 1}) {
    const SyntheticTurntable turntable = SmallTurntable(flip_from_station);
    const Sim3 moved{2.5, Eigen::Quaterniond(0.3, -0.4, 0.5, 0.7).normalized(), {3, -1, 7}};
    for (const Sim3& model_from_body : {Sim3{}, moved}) {
      const ColmapModel object = SyntheticObjectModel(turntable, model_from_body);
      ExpectConsistent(object);
      EXPECT_GT(object.points3D.size(), 60U);
      EXPECT_EQ(object.images.size(), 8U);
      const ColmapModel background = SyntheticStaticModel(turntable, model_from_body);
      ExpectConsistent(background);
      EXPECT_GT(background.points3D.size(), 60U);
    }
  }
}

TEST(SyntheticModels, ModelsShareTheFramesOfTurntableJson) {
  const SyntheticTurntable turntable = SmallTurntable(1);
  const ColmapModel object = SyntheticObjectModel(turntable);
  const ColmapModel background = SyntheticStaticModel(turntable);
  const TurntableFile file = SyntheticTurntableFile(turntable);
  ASSERT_EQ(file.images.size(), 8U);
  for (size_t i = 0; i < 8; ++i) {
    const auto id = static_cast<uint32_t>(i + 1);
    EXPECT_EQ(object.images.at(id).name, file.images[i].name);
    EXPECT_TRUE(object.images.at(id).cam_from_world.Matrix().isApprox(
        background.images.at(id).cam_from_world.Matrix() * file.images[i].world_from_object.Matrix(), 1e-12));
  }
}

TEST(SyntheticModels, WorkspaceReadsBackEqual) {
  const SyntheticTurntable turntable = SmallTurntable();
  for (const ColmapFormat format : {ColmapFormat::kBinary, ColmapFormat::kText}) {
    const TemporaryFolder temporary;
    const fs::path folder = temporary.path() / "workspace";
    WriteSyntheticWorkspace(folder, turntable, format);
    const ColmapModel expected = SyntheticObjectModel(turntable);
    const ColmapModel read = ReadColmapModel(folder / "sparse" / "0");
    ASSERT_EQ(read.images.size(), expected.images.size());
    ASSERT_EQ(read.points3D.size(), expected.points3D.size());
    for (const auto& [id, image] : expected.images) {
      EXPECT_EQ(read.images.at(id).name, image.name);
      EXPECT_TRUE(read.images.at(id).cam_from_world.Matrix().isApprox(image.cam_from_world.Matrix(), 1e-14));
      EXPECT_EQ(read.images.at(id).points2D.size(), image.points2D.size());
    }
    for (const auto& [id, point] : expected.points3D) {
      EXPECT_EQ(read.points3D.at(id).xyz, point.xyz);
      EXPECT_EQ(read.points3D.at(id).rgb, point.rgb);
    }
    EXPECT_EQ(ReadColmapModel(folder / "sparse" / "static").images.size(), 8U);
    const TurntableFile file = ReadTurntableFile(folder / "turntable.json");
    ASSERT_EQ(file.images.size(), 8U);
    EXPECT_EQ(file.images[3].angle_deg, 45);
    EXPECT_TRUE(file.scale_observable);
  }
}

TEST(SyntheticPhotoSet, HasTheDataSetsLayout) {
  const TemporaryFolder temporary;
  const fs::path& folder = temporary.path();
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 3;
  options.step_deg = 120;
  options.width = 96;
  options.height = 72;
  options.num_object_points = options.num_platter_points = options.num_background_points = 0;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const SyntheticRenderScene scene = MakeSyntheticRenderScene(turntable, {});
  SyntheticPhotoSetOptions set_options;
  set_options.extension = ".jpg";
  WriteSyntheticPhotoSet(folder, turntable, scene, set_options);

  std::ifstream stream(folder / "gt" / "scene.json");
  const nlohmann::json json = nlohmann::json::parse(stream);
  EXPECT_EQ(json["width"], 96);
  EXPECT_EQ(json["camera_model"], "SIMPLE_PINHOLE");
  EXPECT_NEAR(json["fx"].get<double>(), 115.2, 1e-12);
  EXPECT_EQ(json["stations"].size(), 2U);
  ASSERT_EQ(json["images"].size(), 8U);
  const SceneTruth truth = ReadSceneTruth(folder);
  ASSERT_EQ(truth.images.size(), 8U);
  EXPECT_TRUE(truth.images[5].CamFromObject().Matrix().isApprox(
      turntable.scene.views[5].CamFromObject().Matrix(), 1e-12));
  int tests = 0;
  for (const auto& image : json["images"]) {
    const fs::path photo = folder / image["file"].get<std::string>();
    const fs::path mask = folder / image["mask"].get<std::string>();
    EXPECT_EQ(photo.stem(), mask.stem());
    EXPECT_EQ(ReadImage(photo, 3).width, 96);
    const Image8 label = ReadImage(mask, 1);
    EXPECT_EQ(label.height, 72);
    int64_t object = 0;
    for (const uint8_t value : label.pixels) {
      EXPECT_TRUE(value == 0 || value == 128 || value == 255);
      object += value == 255 ? 1 : 0;
    }
    EXPECT_GT(object, 100);
    const double angle_deg = image["angle_deg"];
    EXPECT_NEAR(image["object_to_world"][0][0].get<double>(), std::cos(angle_deg * kPi / 180), 1e-14);
    if (image["split"] == "test") {
      ++tests;
      EXPECT_EQ(angle_deg, 60);
      EXPECT_EQ(photo.parent_path().filename(), "images_test");
    }
  }
  EXPECT_EQ(tests, 2);
  // The photo itself, up to JPEG.
  const Image8 photo = ReadImage(folder / "images" / "s01_i002.jpg", 3);
  const Image8 exact = RenderImage(scene, turntable, 5).rgb;
  double sum = 0;
  for (size_t i = 0; i < exact.pixels.size(); ++i)
    sum += std::abs(double{0} + photo.pixels[i] - exact.pixels[i]);
  EXPECT_LT(sum / static_cast<double>(exact.pixels.size()), 6);
  EXPECT_GT(ReadPlyMesh(folder / "gt" / "object.ply").triangles.size(), 1000U);
  EXPECT_GT(ReadPlyMesh(folder / "gt" / "disc.ply").triangles.size(), 100U);
}

}  // namespace
}  // namespace s2gs
