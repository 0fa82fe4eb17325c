#include "s2gs/scene/training_scene.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "s2gs/scene/photo_list.h"
#include "s2gs/scene/scene_lengths.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "tests/s2gs/turntable_workspace.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// A workspace on disk with grey photos: 2 stations of 3 steps.
class TrainingSceneFiles : public testing::Test {
 protected:
  void SetUp() override {
    SyntheticTurntableOptions options;
    options.stations = 2;
    options.steps = 3;
    options.width = 32;
    options.height = 24;
    options.num_object_points = 60;
    options.num_platter_points = 40;
    options.num_background_points = 50;
    turntable_ = MakeSyntheticTurntable(options);
    paths_ = WriteTurntableWorkspace(folder_.path(), turntable_, [](int) { return GreyPhoto(32, 24); });
  }

  static Image8 GreyPhoto(int width, int height) {
    return {width, height, 3, std::vector<uint8_t>(static_cast<size_t>(3) * width * height, 100)};
  }
  void WritePhoto(const std::string& name, int width, int height) const {
    WriteImage(folder_ / "images" / name, GreyPhoto(width, height));
  }

  TemporaryFolder folder_;
  SyntheticTurntable turntable_;
  TrainingScenePaths paths_;
  Reporter silent_;
};

TEST_F(TrainingSceneFiles, HasPosesPointsAndRegionInScenesOfSizeOne) {
  const TrainingScene scene = ReadTrainingScene(paths_, {}, silent_);
  EXPECT_EQ(scene.mode, TrainMode::kS2gs);
  ASSERT_EQ(scene.photos.size(), 6U);
  EXPECT_GT(scene.size, 0.3);
  EXPECT_LT(scene.size, 1.5);
  for (size_t i = 0; i < 6; ++i) {
    const ScenePhoto& photo = scene.photos[i];
    const View* view = nullptr;
    for (const View& candidate : turntable_.scene.views) {
      if (candidate.name == photo.name) view = &candidate;
    }
    ASSERT_NE(view, nullptr);
    // A point lands on the same pixel in either frame's lengths.
    const Eigen::Vector3d x(0.03, -0.02, 0.05);
    const Eigen::Vector3d normalised = (x - scene.origin) / scene.size;
    EXPECT_LT((scene.size * (photo.view.cam_from_object * normalised) - view->CamFromObject() * x).norm(),
              1e-9);
    EXPECT_LT((scene.size * (photo.view.cam_from_world * normalised) - view->cam_from_world * x).norm(),
              1e-9);
    EXPECT_EQ(photo.image.width, 32);
  }
  ASSERT_TRUE(scene.region.has_value());
  size_t inside = 0;
  size_t rotating = 0;
  for (const ScenePoint& point : scene.points) {
    if (!point.rotates) continue;
    ++rotating;
    inside += scene.region->Contains(point.x, 0) ? 1 : 0;
  }
  EXPECT_EQ(rotating, 100U);
  EXPECT_GE(inside, 98U);
}

// As many as someone who walks by leaves: a tenth of all points, each seen by two photos.
TEST_F(TrainingSceneFiles, PointsOfTwoRaysDoNotWidenTheRegion) {
  const TrainingScene before = ReadTrainingScene(paths_, {}, silent_);
  ASSERT_TRUE(before.region);
  ColmapModel object = ReadColmapModel(paths_.object_model);
  const auto add_rays = [&](int count, ColmapPoint3D* point) {
    auto image = object.images.begin();
    for (int ray = 0; ray < count; ++ray, ++image) {
      point->track.push_back({image->first, static_cast<uint32_t>(image->second.points2D.size())});
      image->second.points2D.push_back({{10, 10}, point->point3D_id});
    }
  };
  for (auto& [id, point] : object.points3D) add_rays(3, &point);
  for (uint64_t id = 1000; id < 1010; ++id) {
    ColmapPoint3D& point = object.points3D[id];
    point.point3D_id = id;
    point.xyz = {3, 0.1 * static_cast<double>(id - 1000), 2};
    add_rays(2, &point);
  }
  WriteColmapModel(paths_.object_model, object, ColmapFormat::kBinary);
  const TrainingScene scene = ReadTrainingScene(paths_, {}, silent_);
  ASSERT_TRUE(scene.region);
  EXPECT_NEAR(scene.region->radius * scene.size, before.region->radius * before.size, 1e-9);
  EXPECT_NEAR((scene.region->high - scene.region->low) * scene.size,
              (before.region->high - before.region->low) * before.size, 1e-9);
}

TEST_F(TrainingSceneFiles, HoldsOutEveryNthOrAList) {
  TrainingSceneOptions options;
  options.test_every = 3;
  TrainingScene scene = ReadTrainingScene(paths_, options, silent_);
  for (size_t i = 0; i < 6; ++i) EXPECT_EQ(scene.photos[i].held_out, i % 3 == 0);
  options.test_every = 0;
  options.test_list = folder_ / "list.txt";
  folder_.Write("list.txt", scene.photos[4].name + "\r\n\n");
  scene = ReadTrainingScene(paths_, options, silent_);
  for (size_t i = 0; i < 6; ++i) EXPECT_EQ(scene.photos[i].held_out, i == 4);
  folder_.Write("list.txt", "nobody.jpg\n");
  ExpectUserError([&] { ReadTrainingScene(paths_, options, silent_); }, {"list.txt", "nobody.jpg"});
  // The same reader for each list: blanks and tabs behind a name are no part of it.
  folder_.Write("list.txt", scene.photos[4].name + " \t\n" + scene.photos[1].name + "  ");
  EXPECT_EQ(ReadPhotoList(options.test_list, scene.photos, "--image_list"),
            std::set<std::string>({scene.photos[1].name, scene.photos[4].name}));
  ExpectUserError([&] { ReadPhotoList(folder_ / "none", scene.photos, "--image_list"); },
                  {"none", "--image_list"});
}

TEST_F(TrainingSceneFiles, SizesAreToldBeforeTheFirstPhotoIsRead) {
  TrainingSceneOptions options;
  options.test_every = 3;
  options.max_image_size = 16;
  TrainingSize size;
  const TrainingScene scene =
      ReadTrainingScene(paths_, options, silent_, [&](const TrainingSize& told) { size = told; });
  int64_t all = 0;
  int64_t trained = 0;
  for (const ScenePhoto& photo : scene.photos) {
    const auto bytes = static_cast<int64_t>(photo.image.pixels.size());
    all += bytes;
    trained += photo.held_out ? 0 : bytes;
  }
  EXPECT_EQ(size.num_photos, 6);
  EXPECT_EQ(size.num_points, static_cast<int64_t>(scene.points.size()));
  EXPECT_EQ(size.photo_bytes, all);
  EXPECT_EQ(size.trained_bytes, trained);
  EXPECT_EQ(size.largest_view_px, 16 * 12);
  EXPECT_EQ(size.longest_side_px, 16);
  EXPECT_GE(size.loading_bytes, 32 * 24 * 6);
  // A mask takes a byte a pixel besides.
  paths_.masks = folder_ / "masks";
  for (const View& view : turntable_.scene.views) {
    fs::create_directories(paths_.masks);
    WriteImage(paths_.masks / (view.name + ".png"), {32, 24, 1, std::vector<uint8_t>(32 * 24, 255)});
  }
  options.masks_as_hint = true;
  TrainingSize with_masks;
  ReadTrainingScene(paths_, options, silent_, [&](const TrainingSize& told) { with_masks = told; });
  EXPECT_EQ(with_masks.photo_bytes, all / 3 * 4);
  EXPECT_EQ(with_masks.trained_bytes, trained / 3 * 4);
  // No photo is missed where that is refused.
  fs::remove_all(paths_.images);
  ExpectUserError(
      [&] {
        ReadTrainingScene(paths_, options, silent_,
                          [](const TrainingSize&) { throw UserError("too large"); });
      },
      {"too large"});
}

TEST_F(TrainingSceneFiles, ReducesLargePhotos) {
  TrainingSceneOptions options;
  options.max_image_size = 16;
  const TrainingScene scene = ReadTrainingScene(paths_, options, silent_);
  EXPECT_EQ(scene.photos[0].image.width, 16);
  EXPECT_EQ(scene.photos[0].image.height, 12);
  EXPECT_NEAR(scene.photos[0].view.cx, turntable_.CameraOf(0).params[1] / 2, 1e-9);
}

TEST_F(TrainingSceneFiles, HeldOutPhotosHaveASizeOfTheirOwn) {
  TrainingSceneOptions options;
  options.max_image_size = 16;
  options.max_test_size = 1600;
  options.test_every = 2;
  const TrainingScene scene = ReadTrainingScene(paths_, options, silent_);
  EXPECT_EQ(scene.photos[0].image.width, 32);  // as it is
  EXPECT_EQ(scene.photos[0].view.width, 32);
  EXPECT_EQ(scene.photos[1].image.width, 16);
  options.max_test_size = 15;
  EXPECT_TRUE(options.Check().has_value());
  options.max_test_size = 0;
  EXPECT_FALSE(options.Check().has_value());
  EXPECT_EQ(ReadTrainingScene(paths_, options, silent_).photos[0].image.width, 16);
}

TEST_F(TrainingSceneFiles, WithoutATableTheSceneIsStatic) {
  fs::remove(paths_.turntable);
  const TrainingScene scene = ReadTrainingScene(paths_, {}, silent_);
  EXPECT_EQ(scene.mode, TrainMode::kStatic);
  EXPECT_EQ(scene.points.size(), 100U);  // of the object and its platter: sparse/static is not asked
  for (const ScenePoint& point : scene.points) EXPECT_FALSE(point.rotates);
  TrainingSceneOptions options;
  options.mode = TrainMode::kS2gs;
  ExpectUserError([&] { ReadTrainingScene(paths_, options, silent_); }, {"turntable.json", "missing"});
}

TEST_F(TrainingSceneFiles, ATableThatTurnsNeedsNoModelOfTheBackground) {
  fs::remove_all(paths_.static_model);
  const TrainingScene scene = ReadTrainingScene(paths_, {}, silent_);
  EXPECT_EQ(scene.mode, TrainMode::kS2gs);
  EXPECT_EQ(scene.points.size(), 100U);
  for (const ScenePoint& point : scene.points) EXPECT_TRUE(point.rotates);
}

TEST_F(TrainingSceneFiles, MasksAreReadAndNeededInTheirMode) {
  paths_.masks = folder_ / "masks";
  TrainingSceneOptions options;
  options.mode = TrainMode::kMasks;
  ExpectUserError([&] { ReadTrainingScene(paths_, options, silent_); }, {"masks", ".png"});
  fs::create_directories(paths_.masks);
  for (const View& view : turntable_.scene.views) {
    Image8 mask{32, 24, 1, std::vector<uint8_t>(32 * 24, 0)};
    mask.pixels[5] = 255;
    mask.pixels[6] = 128;
    fs::create_directories((paths_.masks / view.name).parent_path());
    WriteImage(paths_.masks / (view.name + ".png"), mask);
  }
  const TrainingScene scene = ReadTrainingScene(paths_, options, silent_);
  EXPECT_EQ(scene.photos[0].mask[5], 255);
  EXPECT_EQ(scene.photos[0].mask[6], 255);
  EXPECT_EQ(scene.photos[0].mask[7], 0);
}

TEST_F(TrainingSceneFiles, MasksOf128AreThoseOf255ThroughALensToo) {
  for (Camera& camera : turntable_.scene.cameras) {
    const double focal = FocalLengths(camera).x();
    camera.model = CameraModelId::kSimpleRadial;
    camera.params = {focal, 16, 12, 0.3};
  }
  paths_ = WriteTurntableWorkspace(folder_ / "lens", turntable_, [](int) { return GreyPhoto(32, 24); });
  TrainingSceneOptions options;
  options.mode = TrainMode::kMasks;
  const auto mask_of_disc = [&](uint8_t inside) {
    paths_.masks = folder_ / ("masks_" + std::to_string(inside));
    Image8 mask{32, 24, 1, {}};
    for (int y = 0; y < 24; ++y) {
      for (int x = 0; x < 32; ++x) mask.pixels.push_back(std::hypot(x - 15, y - 12) < 8 ? inside : 0);
    }
    for (const View& view : turntable_.scene.views) {
      fs::create_directories((paths_.masks / view.name).parent_path());
      WriteImage(paths_.masks / (view.name + ".png"), mask);
    }
    return ReadTrainingScene(paths_, options, silent_).photos[0].mask;
  };
  const std::vector<uint8_t> mask = mask_of_disc(255);
  EXPECT_GT(std::count(mask.begin(), mask.end(), 255), 150);
  EXPECT_EQ(mask_of_disc(128), mask);
}

TEST_F(TrainingSceneFiles, PhotosOfAnotherSizeAreRefusedWithTheirPath) {
  const std::string name = turntable_.scene.views[2].name;
  WritePhoto(name, 24, 32);
  ExpectUserError([&] { ReadTrainingScene(paths_, {}, silent_); }, {name, "24 x 32", "EXIF"});
  WritePhoto(name, 30, 24);
  ExpectUserError([&] { ReadTrainingScene(paths_, {}, silent_); }, {name, "30 x 24"});
  fs::remove(folder_ / "images" / name);
  ExpectUserError([&] { ReadTrainingScene(paths_, {}, silent_); }, {name});
}

// Cameras on a ring that look at one place: what a photo shows there is a sphere of its distance times the
// sine of half the longer side's angle of view.
TEST_F(TrainingSceneFiles, PhotosThatTheTableDoesNotKnowAreLeftOutWithAWarning) {
  class Recorder : public Reporter {
   public:
    void Log(LogLevel /*level*/, std::string_view message) override { log += message; }
    std::string log;
  } recorder;
  TurntableFile table = ReadTurntableFile(paths_.turntable);
  table.images.erase(table.images.begin() + 3, table.images.begin() + 5);
  WriteTurntableFile(paths_.turntable, table);
  EXPECT_EQ(ReadTrainingScene(paths_, {}, recorder).photos.size(), 4U);
  EXPECT_NE(recorder.log.find("2 images of "), std::string::npos);
  EXPECT_NE(recorder.log.find("are not in turntable.json and are left out"), std::string::npos)
      << recorder.log;
}

TEST_F(TrainingSceneFiles, NoPhotoAtAllIsRefused) {
  TurntableFile table = ReadTurntableFile(paths_.turntable);
  for (TurntableImage& image : table.images) image.name = "other_" + image.name;
  WriteTurntableFile(paths_.turntable, table);
  ExpectUserError([&] { ReadTrainingScene(paths_, {}, silent_); },
                  {paths_.object_model.string(), "has no images to train on"});
}

// A background's pose that says otherwise than the table's, by a tenth of a turn, is told.
TEST_F(TrainingSceneFiles, PosesThatContradictTheBackgroundsAreTold) {
  class Recorder : public Reporter {
   public:
    void Log(LogLevel /*level*/, std::string_view message) override { log += message; }
    std::string log;
  } recorder;
  ReadTrainingScene(paths_, {}, recorder);
  EXPECT_EQ(recorder.log.find("have another pose"), std::string::npos) << recorder.log;
  ColmapModel background = ReadColmapModel(paths_.static_model);
  Rigid3& pose = background.images.begin()->second.cam_from_world;
  pose.rotation = Eigen::AngleAxisd(0.2 * kPi, Eigen::Vector3d::UnitY()) * pose.rotation;
  WriteColmapModel(paths_.static_model, background, ColmapFormat::kBinary);
  EXPECT_EQ(ReadTrainingScene(paths_, {}, recorder).photos.size(), 6U);
  EXPECT_NE(recorder.log.find("1 images have another pose in " + paths_.static_model.string()),
            std::string::npos)
      << recorder.log;
}

TEST(TrainingSceneFocus, IsWhereThePhotosLook) {
  const Eigen::Vector3d place(3, -2, 1);
  TrainingScene scene;
  scene.mode = TrainMode::kStatic;
  for (int i = 0; i < 8; ++i) {
    const double angle = 0.7 * i;
    const Eigen::Vector3d back(std::cos(angle) * 0.8, std::sin(angle) * 0.8, 0.6);
    const double distance = 2 + 0.1 * i;
    ScenePhoto photo;
    photo.view.width = 60;
    photo.view.height = 80;
    photo.view.fx = 50;
    photo.view.fy = 100;
    photo.view.cx = 30;
    photo.view.cy = 40;
    Eigen::Matrix3d rotation;
    rotation.row(2) = -back;
    rotation.row(0) = Eigen::Vector3d::UnitZ().cross(back).normalized();
    rotation.row(1) = rotation.row(2).cross(rotation.row(0));
    photo.view.cam_from_object = {Eigen::Quaterniond(rotation), -(rotation * (place + distance * back))};
    photo.view.cam_from_world = photo.view.cam_from_object;
    scene.photos.push_back(photo);
  }
  NormaliseScene(&scene);
  // Nothing else is known: the scene's middle is where the axes meet, its size the median distance.
  EXPECT_LT((scene.origin - place).norm(), 1e-9);
  EXPECT_NEAR(scene.size, 2.35, 0.051);
  EXPECT_LT(scene.focus.norm(), 1e-9);
  const double half_angle = std::atan(std::max(60 / 50.0, 80 / 100.0) / 2);
  EXPECT_NEAR(scene.focus_radius, std::sin(half_angle), 0.03);
  EXPECT_NEAR(scene.focus_radius * scene.size, 2.35 * std::sin(half_angle), 0.03);
  // Cameras that all look the same way meet nowhere; those that look away from each other at nothing.
  for (const bool outwards : {false, true}) {
    TrainingScene other = scene;
    for (size_t i = 0; i < other.photos.size(); ++i) {
      Rigid3& pose = other.photos[i].view.cam_from_object;
      if (outwards) {
        const Eigen::AngleAxisd turned(kPi, Eigen::Vector3d::UnitY());
        pose = Rigid3{Eigen::Quaterniond(turned), Eigen::Vector3d::Zero()} * pose;
      } else {
        pose = {Eigen::Quaterniond::Identity(), {0.1 * static_cast<double>(i), 0, 0}};
      }
      other.photos[i].view.cam_from_world = pose;
    }
    other.focus_radius = 0;
    NormaliseScene(&other);
    EXPECT_EQ(other.focus_radius, 0) << outwards;
  }
}

TEST(TrainingSceneLengths, GaussiansGoThereAndBack) {
  Gaussians g;
  g.Resize(2);
  g.centre = {1, 2, 3, -4, 5, -6};
  g.log_scale = {-1, -2, -3, -4};
  const Eigen::Vector3d origin(0.5, -1, 2);
  const Gaussians there = NormaliseGaussians(g, origin, 2.5);
  EXPECT_NEAR(there.centre[0], 0.2, 1e-6);
  const Gaussians back = DenormaliseGaussians(there, origin, 2.5);
  for (size_t i = 0; i < 6; ++i) EXPECT_NEAR(back.centre[i], g.centre[i], 1e-5);
  for (size_t i = 0; i < 4; ++i) EXPECT_NEAR(back.log_scale[i], g.log_scale[i], 1e-6);
}

}  // namespace
}  // namespace s2gs
