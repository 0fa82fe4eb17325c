#include "sfm_split/turntable/background_cameras.h"

#include <gtest/gtest.h>

#include <map>
#include <string>
#include <vector>

namespace s2gs {
namespace {

// Photos of stations of these numbers, one after another.
ScanFeatures PhotosOf(const std::vector<int>& stations) {
  ScanFeatures features;
  for (const int station : stations) {
    ScanImage image;
    image.image_id = static_cast<uint32_t>(features.images.size() + 1);
    image.name = std::to_string(image.image_id) + ".jpg";
    image.station = station;
    features.images.push_back(image);
  }
  for (const uint32_t id : {1, 2}) {
    features.cameras[id].camera_id = id;
    features.cameras[id].model = CameraModelId::kSimplePinhole;
    features.cameras[id].params = {100, 50, 40};
  }
  return features;
}

TEST(StationPoses, AreTheLargestStationsWithoutABackground) {
  const auto station = [](const std::vector<int>& stations) {
    const std::map<int, Rigid3> poses = StationPoses(PhotosOf(stations), nullptr);
    EXPECT_EQ(poses.size(), 1U);
    EXPECT_EQ(poses.begin()->second.translation, Eigen::Vector3d::Zero());
    return poses.begin()->first;
  };
  EXPECT_EQ(station({3, 5, 5, 7}), 5);
  EXPECT_EQ(station({7, 7, 3, 5, 7, 5}), 7);
  EXPECT_EQ(station({5, 3, 5, 3}), 3);  // of equal ones the first number
  EXPECT_TRUE(StationPoses(PhotosOf({}), nullptr).empty());
}

TEST(StationPoses, AreThoseOfTheFirstPhotosThatTheBackgroundHas) {
  ColmapModel background;
  for (const auto& [id, name, x] :
       {std::tuple(4, "2.jpg", 1.0), std::tuple(6, "4.jpg", 2.0), std::tuple(9, "none.jpg", 3.0)}) {
    ColmapImage& image = background.images[static_cast<uint32_t>(id)];
    image.name = name;
    image.cam_from_world.translation = {x, 0, 0};
  }
  const std::map<int, Rigid3> poses = StationPoses(PhotosOf({3, 3, 5, 5, 7}), &background);
  ASSERT_EQ(poses.size(), 2U);
  EXPECT_EQ(poses.at(3).translation.x(), 1);
  EXPECT_EQ(poses.at(5).translation.x(), 2);
  background.images.clear();  // as none
  EXPECT_EQ(StationPoses(PhotosOf({3, 3, 5}), &background).count(3), 1U);
}

TEST(CamerasBeside, AreTheBackgroundsWhereItHasThem) {
  ColmapModel background;
  background.cameras[2].camera_id = 2;
  background.cameras[2].params = {110, 50, 40};
  const std::vector<Camera> cameras = CamerasBeside(PhotosOf({0}), &background);
  ASSERT_EQ(cameras.size(), 2U);
  EXPECT_EQ(cameras[0].params[0], 100);
  EXPECT_EQ(cameras[1].params[0], 110);
  EXPECT_EQ(CamerasBeside(PhotosOf({0}), nullptr)[1].params[0], 100);
}

}  // namespace
}  // namespace s2gs
