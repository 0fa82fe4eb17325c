#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <set>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "tests/support/small_turntable.h"
#include "tests/support/synthetic_shapes.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

TEST(SyntheticMatches, MatchesFollowTheirBodysEpipolarGeometry) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(SmallTurntable());
  double worst = 0;
  std::vector<double> wrong_body;
  for (const SyntheticPair& pair : turntable.pairs) {
    const bool same_station = (pair.image1 < 6) == (pair.image2 < 6);
    for (const SyntheticMatch& match : pair.matches) {
      ASSERT_NE(match.body, SyntheticBody::kNone);
      const bool rotates = IsRotating(match.body);
      if (same_station && !rotates) {
        const auto& keypoint1 = turntable.images[static_cast<size_t>(pair.image1)].keypoints[match.keypoint1];
        const auto& keypoint2 = turntable.images[static_cast<size_t>(pair.image2)].keypoints[match.keypoint2];
        EXPECT_EQ(keypoint1.xy, keypoint2.xy);
        continue;  // no baseline
      }
      worst = std::max(worst, EpipolarDistance(turntable, pair, match, match.body));
      if (!same_station) {
        wrong_body.push_back(EpipolarDistance(turntable, pair, match,
                                              rotates ? SyntheticBody::kStatic : SyntheticBody::kObject));
      }
    }
  }
  EXPECT_LT(worst, 1e-8);  // measured: 1e-10
  // Points of the wrong body are off by many pixels, but for those that happen to lie on the line, and for
  // the pairs of equal table angles, where the two motions agree.
  std::sort(wrong_body.begin(), wrong_body.end());
  ASSERT_GT(wrong_body.size(), 1000U);
  EXPECT_GT(wrong_body[wrong_body.size() / 2], 5);
}

TEST(SyntheticMatches, OutlierShareIsExactInEveryPair) {
  for (const double share : {0.1, 0.5, 0.8, 1.0}) {
    SyntheticTurntableOptions options = SmallTurntable();
    options.outlier_share = share;
    options.num_extra_keypoints = 10;
    const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
    for (const SyntheticPair& pair : turntable.pairs) {
      const auto& keypoints1 = turntable.images[static_cast<size_t>(pair.image1)].keypoints;
      const auto& keypoints2 = turntable.images[static_cast<size_t>(pair.image2)].keypoints;
      std::set<uint32_t> used1;
      std::set<uint32_t> used2;
      double outliers = 0;
      for (const SyntheticMatch& match : pair.matches) {
        EXPECT_TRUE(used1.insert(match.keypoint1).second);
        EXPECT_TRUE(used2.insert(match.keypoint2).second);
        const int point1 = keypoints1.at(match.keypoint1).point;
        const bool right = point1 >= 0 && point1 == keypoints2.at(match.keypoint2).point;
        EXPECT_EQ(right, match.body != SyntheticBody::kNone);
        outliers += right ? 0 : 1;
      }
      ASSERT_GT(pair.matches.size(), 20U);
      EXPECT_EQ(outliers, std::round(share * static_cast<double>(pair.matches.size())));
    }
  }
}

TEST(SyntheticMatches, StructuredOutliersFollowOneWrongMotion) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.repeated_share = 1;
  options.symmetry_fold = 3;
  options.outlier_share = 0.4;
  options.structured_share = 0.5;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const Eigen::Vector3d middle = turntable.object.frame_from_shape.translation;
  const Eigen::AngleAxisd third(120 * kDegree, Eigen::Vector3d::UnitZ());
  int structured = 0;
  int of_object = 0;
  for (const SyntheticPair& pair : turntable.pairs) {
    int outliers = 0;
    for (const SyntheticMatch& match : pair.matches) {
      outliers += match.body == SyntheticBody::kNone ? 1 : 0;
      if (!match.structured) continue;
      ++structured;
      const auto& keypoint1 = turntable.images[static_cast<size_t>(pair.image1)].keypoints[match.keypoint1];
      const auto& keypoint2 = turntable.images[static_cast<size_t>(pair.image2)].keypoints[match.keypoint2];
      const Eigen::Vector3d x1 = turntable.points[static_cast<size_t>(keypoint1.point)].x;
      const Eigen::Vector3d x2 = turntable.points[static_cast<size_t>(keypoint2.point)].x;
      ASSERT_EQ(keypoint1.body, keypoint2.body);
      if (keypoint1.body == SyntheticBody::kObject) {
        ++of_object;
        EXPECT_LT((middle + third * (x1 - middle) - x2).norm(), 1e-14);
        EXPECT_NEAR((x2 - middle).norm(), BumpyRadius(turntable.object, (x2 - middle).normalized()), 1e-14);
      } else {
        EXPECT_NEAR((x1 - x2).norm(), 0.1, 1e-12);
      }
    }
    EXPECT_EQ(outliers, std::lround(0.4 * static_cast<double>(pair.matches.size())));
  }
  EXPECT_GT(structured, 500);
  EXPECT_GT(of_object, 100);
}

TEST(SyntheticMatches, MatchesNeedSimilarViewsAndRecall) {
  SyntheticTurntableOptions options = SmallTurntable();
  const SyntheticTurntable all = MakeSyntheticTurntable(options);
  options.max_view_change_deg = 30;
  const SyntheticTurntable near = MakeSyntheticTurntable(options);
  size_t num_all = 0;
  size_t num_near = 0;
  size_t expected = 0;
  for (size_t p = 0; p < all.pairs.size(); ++p) {
    num_all += all.pairs[p].matches.size();
    num_near += near.pairs[p].matches.size();
    for (const SyntheticMatch& match : all.pairs[p].matches) {
      const int i = all.pairs[p].image1;
      const int j = all.pairs[p].image2;
      const auto& keypoint = all.images[static_cast<size_t>(i)].keypoints[match.keypoint1];
      const Eigen::Vector3d x = all.points[static_cast<size_t>(keypoint.point)].x;
      const Eigen::Vector3d d1 = (CameraCentre(all.CamFromBody(i, match.body)) - x).normalized();
      const Eigen::Vector3d d2 = (CameraCentre(all.CamFromBody(j, match.body)) - x).normalized();
      expected += d1.dot(d2) >= std::cos(30 * kDegree) ? 1 : 0;
    }
  }
  EXPECT_EQ(num_near, expected);
  EXPECT_LT(num_near, num_all);
  options.max_view_change_deg = 180;
  options.match_recall = 0.6;
  options.pairs = {{0, 1}, {3, 7}, {8, 2}};
  const SyntheticTurntable some = MakeSyntheticTurntable(options);
  ASSERT_EQ(some.pairs.size(), 3U);
  EXPECT_EQ(some.pairs[2].image1, 8);
  EXPECT_EQ(some.pairs[2].image2, 2);
  const double full = static_cast<double>(all.pairs[0].matches.size());  // images 0 and 1
  EXPECT_NEAR(static_cast<double>(some.pairs[0].matches.size()), 0.6 * full, 4 * std::sqrt(0.24 * full));
}

TEST(SyntheticMatches, WatermarksStayAtTheirPixels) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.num_watermarks = 5;
  options.pixel_noise = 1;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  for (const SyntheticPair& pair : turntable.pairs) {
    int marks = 0;
    for (const SyntheticMatch& match : pair.matches) {
      if (match.body != SyntheticBody::kWatermark) continue;
      ++marks;
      EXPECT_EQ(turntable.images[static_cast<size_t>(pair.image1)].keypoints[match.keypoint1].xy,
                turntable.images[static_cast<size_t>(pair.image2)].keypoints[match.keypoint2].xy);
    }
    EXPECT_EQ(marks, 5);
  }
}

TEST(SyntheticMatches, NearestDescriptorIsTheRightOne) {
  SyntheticTurntableOptions options = SmallTurntable();
  options.descriptors = true;
  options.num_extra_keypoints = 50;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const SyntheticImage& image1 = turntable.images[0];
  const SyntheticImage& image2 = turntable.images[1];
  ASSERT_EQ(image1.descriptors.size(), image1.keypoints.size());
  int passed = 0;
  int right = 0;
  for (size_t i = 0; i < image1.descriptors.size(); ++i) {
    double norm = 0;
    for (const uint8_t value : image1.descriptors[i]) norm += value * value;
    EXPECT_LT(std::sqrt(norm), 516);
    EXPECT_GT(std::sqrt(norm), 480);  // entries over 255 are clipped
    std::vector<std::pair<double, size_t>> distances;
    for (size_t k = 0; k < image2.descriptors.size(); ++k) {
      double squared = 0;
      for (size_t e = 0; e < 128; ++e) {
        squared += std::pow(double{0} + image1.descriptors[i][e] - image2.descriptors[k][e], 2);
      }
      distances.emplace_back(std::sqrt(squared), k);
    }
    std::partial_sort(distances.begin(), distances.begin() + 2, distances.end());
    if (distances[0].first > 0.8 * distances[1].first) continue;
    ++passed;
    right += image1.keypoints[i].point >= 0 &&
                     image1.keypoints[i].point == image2.keypoints[distances[0].second].point
                 ? 1
                 : 0;
  }
  const auto shared = static_cast<int>(turntable.pairs[0].matches.size());
  EXPECT_EQ(right, passed);
  EXPECT_EQ(right, shared);
}

}  // namespace
}  // namespace s2gs
