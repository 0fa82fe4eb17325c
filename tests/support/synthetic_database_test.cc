#include "tests/support/synthetic_database.h"

#include <gtest/gtest.h>

#include <set>

#include "sfm_split/scene/io/colmap_database.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

SyntheticTurntable SmallTurntable() {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 3;
  options.step_deg = 20;
  options.num_object_points = 200;
  options.num_platter_points = 60;
  options.num_background_points = 200;
  options.outlier_share = 0.3;
  options.num_watermarks = 2;
  options.descriptors = true;
  options.pixel_noise = 0.4;
  options.pairs = {{0, 1}, {4, 0}, {3, 5}};
  return MakeSyntheticTurntable(options);
}

TEST(SyntheticDatabase, ReadsBackEqual) {
  const TemporaryFolder folder;
  const std::filesystem::path path = folder.path() / "database.db";
  const SyntheticTurntable turntable = SmallTurntable();
  WriteSyntheticDatabase(path, turntable, SyntheticGeometries::kNone);
  const ColmapDatabase database = ColmapDatabase::Open(path, ColmapDatabase::Access::kReadOnly);
  const std::vector<DatabaseCamera> cameras = database.ReadCameras();
  ASSERT_EQ(cameras.size(), 1U);
  EXPECT_EQ(cameras[0].camera.params, turntable.scene.cameras[0].params);
  EXPECT_TRUE(cameras[0].has_prior_focal_length);
  const std::vector<DatabaseImage> images = database.ReadImages();
  ASSERT_EQ(images.size(), 6U);
  for (size_t i = 0; i < 6; ++i) {
    EXPECT_EQ(images[i].name, turntable.scene.views[i].name);
    const SyntheticImage& image = turntable.images[i];
    const KeypointMatrix keypoints = database.ReadKeypoints(images[i].image_id);
    const DescriptorMatrix descriptors = database.ReadDescriptors(images[i].image_id);
    ASSERT_EQ(static_cast<size_t>(keypoints.rows()), image.keypoints.size());
    ASSERT_EQ(descriptors.rows(), keypoints.rows());
    for (Eigen::Index k = 0; k < keypoints.rows(); ++k) {
      const auto index = static_cast<size_t>(k);
      EXPECT_LT((keypoints.row(k).head<2>().transpose().cast<double>() - image.keypoints[index].xy).norm(),
                1e-4);
      EXPECT_EQ(descriptors(k, 77), image.descriptors[index][77]);
    }
  }
  for (const SyntheticPair& pair : turntable.pairs) {
    const FeatureMatches matches =
        database.ReadMatches(static_cast<uint32_t>(pair.image1 + 1), static_cast<uint32_t>(pair.image2 + 1));
    ASSERT_EQ(matches.size(), pair.matches.size());
    for (size_t m = 0; m < matches.size(); ++m) {
      EXPECT_EQ(matches[m].point2D_idx1, pair.matches[m].keypoint1);
      EXPECT_EQ(matches[m].point2D_idx2, pair.matches[m].keypoint2);
    }
  }
  EXPECT_FALSE(database.ReadTwoViewGeometry(1, 2).has_value());
}

TEST(SyntheticDatabase, GeometriesHoldForTheirInliersOnly) {
  const TemporaryFolder folder;
  const SyntheticTurntable turntable = SmallTurntable();
  for (const SyntheticGeometries kind : {SyntheticGeometries::kRotating, SyntheticGeometries::kStatic}) {
    const bool rotating = kind == SyntheticGeometries::kRotating;
    const std::filesystem::path path = folder.path() / (rotating ? "object.db" : "static.db");
    WriteSyntheticDatabase(path, turntable, kind);
    const ColmapDatabase database = ColmapDatabase::Open(path, ColmapDatabase::Access::kReadOnly);
    for (const SyntheticPair& pair : turntable.pairs) {
      const auto geometry = database.ReadTwoViewGeometry(static_cast<uint32_t>(pair.image1 + 1),
                                                         static_cast<uint32_t>(pair.image2 + 1));
      ASSERT_TRUE(geometry.has_value());
      size_t expected = 0;
      for (const SyntheticMatch& match : pair.matches) {
        const bool of_body = rotating ? IsRotating(match.body) : match.body == SyntheticBody::kStatic;
        expected += of_body ? 1 : 0;
      }
      EXPECT_EQ(geometry->inlier_matches.size(), expected);
      const bool same_station = pair.image1 / 3 == pair.image2 / 3;
      if (!rotating && same_station) {
        EXPECT_EQ(geometry->config, TwoViewConfig::kPanoramic);
        ASSERT_TRUE(geometry->H.has_value());
        continue;
      }
      EXPECT_EQ(geometry->config, TwoViewConfig::kCalibrated);
      ASSERT_TRUE(geometry->E.has_value() && geometry->F.has_value());
      for (const FeatureMatch& match : geometry->inlier_matches) {
        const auto& keypoint1 =
            turntable.images[static_cast<size_t>(pair.image1)].keypoints[match.point2D_idx1];
        const auto& keypoint2 =
            turntable.images[static_cast<size_t>(pair.image2)].keypoints[match.point2D_idx2];
        EXPECT_EQ(keypoint1.point, keypoint2.point);
        const Eigen::Vector3d line = *geometry->F * keypoint1.exact_xy.homogeneous();
        EXPECT_LT(std::abs(line.dot(keypoint2.exact_xy.homogeneous())) / line.head<2>().norm(), 1e-8);
        const Eigen::Vector3d ray1((keypoint1.exact_xy.x() - 320) / 768, (keypoint1.exact_xy.y() - 240) / 768,
                                   1);
        const Eigen::Vector3d ray2((keypoint2.exact_xy.x() - 320) / 768, (keypoint2.exact_xy.y() - 240) / 768,
                                   1);
        EXPECT_NEAR(ray2.dot(*geometry->E * ray1), 0, 1e-12);
      }
    }
  }
}

}  // namespace
}  // namespace s2gs
