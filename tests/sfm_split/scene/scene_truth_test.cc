#include "sfm_split/scene/scene_truth.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>

#include "sfm_split/base/angles.h"
#include "sfm_split/scene/pose_error.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using Json = nlohmann::json;

Json Image(const std::string& file, const std::string& split, double angle_deg) {
  const double c = std::cos(angle_deg * kPi / 180);
  const double s = std::sin(angle_deg * kPi / 180);
  // About the axis x = 1, y = 2, along z.
  return {
      {"file", file},
      {"mask", "gt/masks/a.png"},
      {"split", split},
      {"station", 1},
      {"angle_deg", angle_deg},
      {"world_to_camera", {{1, 0, 0, .5}, {0, 0, -1, .25}, {0, 1, 0, 4}, {0, 0, 0, 1}}},
      {"object_to_world", {{c, -s, 0, 1 - c + 2 * s}, {s, c, 0, 2 - s - 2 * c}, {0, 0, 1, 0}, {0, 0, 0, 1}}}};
}

Json Scene() {
  return {{"scene", "test"},
          {"units", "metres"},
          {"width", 64},
          {"height", 48},
          {"camera_model", "SIMPLE_PINHOLE"},
          {"pixel_convention", "COLMAP: centre of the first pixel at (0.5, 0.5)"},
          {"fx", 70.5},
          {"fy", 70.5},
          {"cx", 31.25},
          {"cy", 24},
          {"axis_point", {1, 2, .5}},
          {"axis_direction", {0, 0, 2}},
          {"mask_values", {{"object", 255}, {"disc", 128}, {"static", 0}}},
          {"images", {Image("images/a.jpg", "train", 0), Image("images_test/b.jpg", "test", 279)}}};
}

TEST(SceneTruth, EveryFieldIsRead) {
  TemporaryFolder folder;
  WriteAll(folder / "gt/scene.json", Scene().dump());
  const SceneTruth truth = ReadSceneTruth(folder.path());
  EXPECT_EQ(truth.folder, folder.path());
  EXPECT_EQ(truth.ObjectMeshPath(), folder.path() / "gt/object.ply");
  EXPECT_EQ(truth.scene, "test");
  EXPECT_EQ(truth.units, "metres");
  EXPECT_EQ(truth.camera.model, CameraModelId::kPinhole);
  EXPECT_EQ(truth.camera.width, 64u);
  EXPECT_EQ(truth.camera.height, 48u);
  EXPECT_THAT(truth.camera.params, testing::ElementsAre(70.5, 70.5, 31.25, 24));
  EXPECT_EQ(truth.axis.point, Eigen::Vector3d(1, 2, .5));
  EXPECT_EQ(truth.axis.direction, Eigen::Vector3d(0, 0, 1));
  ASSERT_EQ(truth.images.size(), 2u);
  EXPECT_EQ(truth.images[0].name, "a.jpg");
  EXPECT_TRUE(truth.images[0].is_train);
  const SceneTruthImage& image = truth.images[1];
  EXPECT_EQ(image.file, "images_test/b.jpg");
  EXPECT_EQ(image.mask, "gt/masks/a.png");
  EXPECT_FALSE(image.is_train);
  EXPECT_EQ(image.station, 1);
  EXPECT_EQ(image.angle_deg, 279);
  EXPECT_LT((image.cam_from_world * Eigen::Vector3d(1, 2, 3) - Eigen::Vector3d(1.5, -2.75, 6)).norm(), 1e-15);
  EXPECT_NEAR(RotationAngleDeg(image.world_from_object.rotation), 81, 1e-9);
  EXPECT_LT((image.world_from_object * truth.axis.point - truth.axis.point).norm(), 1e-14);
}

TEST(SceneTruth, CamerasWithDistortionAreRead) {
  Json scene = Scene();
  scene["camera_model"] = "SIMPLE_RADIAL";
  scene["k1"] = -.08;
  SceneTruth truth = ParseSceneTruth(scene.dump(), "set/gt/scene.json");
  EXPECT_EQ(truth.camera.model, CameraModelId::kSimpleRadial);
  EXPECT_THAT(truth.camera.params, testing::ElementsAre(70.5, 31.25, 24, -.08));
  scene["k"] = .5;
  EXPECT_THAT(ParseSceneTruth(scene.dump(), "set/gt/scene.json").camera.params[3], .5);

  scene["camera_model"] = "OPENCV";
  scene["fy"] = 71;
  scene["k2"] = .02;
  scene["p1"] = .003;
  scene["p2"] = .004;
  truth = ParseSceneTruth(scene.dump(), "set/gt/scene.json");
  EXPECT_EQ(truth.camera.model, CameraModelId::kOpenCV);
  EXPECT_THAT(truth.camera.params, testing::ElementsAre(70.5, 71, 31.25, 24, -.08, .02, .003, .004));
}

TEST(SceneTruth, TheObjectMayLieOtherwiseInAnotherStation) {
  Json scene = Scene();
  EXPECT_TRUE(ParseSceneTruth(scene.dump(), "set/gt/scene.json").AxisIsFixedInObject());
  // Laid on its side.
  Json flipped = Image("images/c.jpg", "train", 0);
  flipped["station"] = 2;
  flipped["object_to_world"] = {{1, 0, 0, .1}, {0, 0, -1, .2}, {0, 1, 0, .3}, {0, 0, 0, 1}};
  scene["images"].push_back(flipped);
  EXPECT_FALSE(ParseSceneTruth(scene.dump(), "set/gt/scene.json").AxisIsFixedInObject());
  // The next photo of that station, after a turn by 90 degrees.
  Json turned = Image("images/d.jpg", "train", 90);
  turned["station"] = 2;
  turned["object_to_world"] = {{0, 0, 1, 2.8}, {1, 0, 0, 1.1}, {0, 1, 0, .3}, {0, 0, 0, 1}};
  scene["images"].push_back(turned);
  EXPECT_EQ(ParseSceneTruth(scene.dump(), "set/gt/scene.json").images.size(), 4u);
  scene["images"].back()["angle_deg"] = 89;
  ExpectUserError([&] { ParseSceneTruth(scene.dump(), "set/gt/scene.json"); },
                  {"images[3] has an object_to_world that is not turned", "c.jpg"});
}

TEST(SceneTruthBadInput, EachFaultIsNamed) {
  struct Fault {
    std::function<void(Json&)> damage;
    std::string message;
  };
  const std::vector<Fault> faults = {
      {[](Json& j) { j.erase("fx"); }, "has no \"fx\""},
      {[](Json& j) { j["fx"] = "768"; }, "fx is not a number"},
      {[](Json& j) { j["fy"] = -1; }, "fy is not positive"},
      {[](Json& j) { j["width"] = 1e300; }, "width is out of range"},
      {[](Json& j) { j["width"] = 6.5; }, "width is not a whole number"},
      {[](Json& j) { j["camera_model"] = "FOV"; }, "camera_model is \"FOV\""},
      {[](Json& j) { j["camera_model"] = "NONE"; }, "camera_model is \"NONE\""},
      {[](Json& j) { j["camera_model"] = "SIMPLE_RADIAL"; }, "has no \"k\""},
      {[](Json& j) {
         j["camera_model"] = "SIMPLE_RADIAL";
         j["k1"] = 0;
         j["fy"] = 71;
       },
       "fy is not fx"},
      {[](Json& j) { j["pixel_convention"] = "OpenCV: (0, 0)"; }, "pixel_convention does not begin"},
      {[](Json& j) {
         j["axis_direction"] = {0, 0, 0};
       },
       "axis_direction has no length"},
      {[](Json& j) {
         j["axis_point"] = {0, 0};
       },
       "axis_point does not have 3 numbers"},
      {[](Json& j) { j["mask_values"]["disc"] = 255; }, "mask_values gives two things the same value"},
      {[](Json& j) { j["images"] = Json::array(); }, "images is empty"},
      {[](Json& j) { j["images"] = 3; }, "images is not a list"},
      {[](Json& j) { j["images"][1] = nullptr; }, "images[1] is not an object"},
      {[](Json& j) { j["images"][1]["file"] = "other/a.jpg"; }, "images[1] has the file name of an earlier"},
      {[](Json& j) { j["images"][1]["file"] = "../a.jpg"; }, "images[1].file is not a file below"},
      {[](Json& j) { j["images"][1]["split"] = "val"; }, "images[1].split is neither"},
      {[](Json& j) { j["images"][1]["station"] = -1; }, "images[1].station is not a whole number"},
      {[](Json& j) { j["images"][1]["world_to_camera"][0][0] = 1.1; },
       "images[1].world_to_camera is not a rot"},
      {[](Json& j) { j["images"][0]["world_to_camera"][0][0] = -1; },
       "images[0].world_to_camera is not a rot"},
      {[](Json& j) { j["images"][1]["world_to_camera"][3][0] = 1; }, "does not end in the row 0 0 0 1"},
      {[](Json& j) { j["images"][1]["angle_deg"] = 278; },
       "images[1] has an object_to_world that is not turned"},
      {[](Json& j) { j["images"][1]["object_to_world"][0][3] = 1; },
       "images[1] has an object_to_world that is not"},
  };
  for (const Fault& fault : faults) {
    Json scene = Scene();
    fault.damage(scene);
    ExpectUserError([&] { ParseSceneTruth(scene.dump(), "set/gt/scene.json"); },
                    {"set/gt/scene.json", fault.message}, fault.message);
  }
  TemporaryFolder folder;
  ExpectUserError([&] { ReadSceneTruth(folder.path()); }, {folder.path().string(), "no such file"});
}

TEST(SceneTruthBadInput, TruncationsAndBitFlips) {
  Json scene = Scene();
  scene["images"] = {Image("images/a.jpg", "train", 0)};
  const std::string bytes = scene.dump();
  ForEachDamage(bytes, [](const std::string& damaged, const std::string& description) {
    const ScopedAllocationLimit limit(1 << 20);
    ExpectOkOrUserError([&] { ParseSceneTruth(damaged, "set/gt/scene.json"); }, "set/gt/scene.json",
                        description);
  });
}

TEST(SceneTruthBadInput, DeepNesting) {
  const std::string deep(200'000, '[');
  ExpectUserError([&] { ParseSceneTruth(deep, "set/gt/scene.json"); },
                  {"set/gt/scene.json", "not valid JSON"});
  ExpectUserError([&] { ParseSceneTruth(deep + std::string(deep.size(), ']'), "set/gt/scene.json"); },
                  {"set/gt/scene.json", "is not an object"});
}

}  // namespace
}  // namespace s2gs
