#include "sfm_split/motion_split.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <string>
#include <vector>

#include "tests/synthetic_turntable.h"

namespace s2gs {
namespace {

std::vector<SplitImage> ToSplitImages(const SyntheticTurntable& turntable) {
  std::vector<SplitImage> images;
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    SplitImage image;
    image.name = turntable.scene.views[i].name;
    image.size = {turntable.options.width, turntable.options.height};
    for (const SyntheticKeypoint& keypoint : turntable.images[i].keypoints) {
      image.keypoints.emplace_back(keypoint.xy.cast<float>());
    }
    for (const SiftDescriptor& descriptor : turntable.images[i].descriptors) {
      image.descriptors.insert(image.descriptors.end(), descriptor.begin(), descriptor.end());
    }
    images.push_back(std::move(image));
  }
  return images;
}

MotionSplit Split(const SyntheticTurntable& turntable) {
  Reporter reporter;
  return SplitMotion(ToSplitImages(turntable), {}, &reporter);
}

// Keypoints by what they are (static, rotating) and how they were labelled (unknown, static, rotating).
struct LabelCounts {
  int64_t count[2][3] = {};

  double StaticPrecision() const { return Precision(0, KeypointLabel::kStatic); }
  double RotatingPrecision() const { return Precision(1, KeypointLabel::kRotating); }
  double Recall(int body, KeypointLabel label) const {
    const int64_t all = count[body][0] + count[body][1] + count[body][2];
    return static_cast<double>(count[body][static_cast<int>(label)]) / static_cast<double>(all);
  }

 private:
  double Precision(int body, KeypointLabel label) const {
    const int l = static_cast<int>(label);
    return static_cast<double>(count[body][l]) / static_cast<double>(count[0][l] + count[1][l]);
  }
};

LabelCounts CountLabels(const SyntheticTurntable& turntable, const MotionSplit& split) {
  LabelCounts counts;
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    for (size_t k = 0; k < turntable.images[i].keypoints.size(); ++k) {
      const SyntheticBody body = turntable.images[i].keypoints[k].body;
      if (body == SyntheticBody::kNone || body == SyntheticBody::kWatermark) continue;
      ++counts.count[IsRotating(body) ? 1 : 0][static_cast<int>(split.labels[i][k])];
    }
  }
  return counts;
}

SyntheticTurntableOptions TestScene(uint64_t seed) {
  SyntheticTurntableOptions options;
  options.seed = seed;
  options.stations = 3;
  options.steps = 12;
  options.step_deg = 30;
  options.pixel_noise = 0.5;
  options.dropout = 0.2;
  options.num_extra_keypoints = 100;
  options.descriptors = true;
  return options;
}

class MotionSplitSeeds : public testing::TestWithParam<uint64_t> {};

TEST_P(MotionSplitSeeds, LabelsAndStationsAreRight) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(TestScene(GetParam()));
  const MotionSplit split = Split(turntable);

  ASSERT_EQ(split.stations.images.size(), 3U);
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    EXPECT_EQ(split.stations.station_of_image[i], turntable.scene.views[i].station) << i;
  }
  const LabelCounts counts = CountLabels(turntable, split);
  // Lowest over seeds 1 to 3: 1.0, 0.9993, 0.9406, 0.9984.
  EXPECT_GE(counts.StaticPrecision(), 0.99);
  EXPECT_GE(counts.RotatingPrecision(), 0.98);
  EXPECT_GE(counts.Recall(0, KeypointLabel::kStatic), 0.92);
  EXPECT_GE(counts.Recall(1, KeypointLabel::kRotating), 0.98);
  EXPECT_EQ(split.static_pairs.size(), 3U);
}

TEST_P(MotionSplitSeeds, PairsFollowTheirBody) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(TestScene(GetParam()));
  const MotionSplit split = Split(turntable);
  const auto share_of_one_point = [&](const std::vector<VerifiedPair>& pairs, bool rotating) {
    int64_t good = 0;
    int64_t all = 0;
    for (const VerifiedPair& pair : pairs) {
      for (const FeatureMatch& match : pair.matches) {
        const SyntheticKeypoint& keypoint1 = turntable.images[pair.image1].keypoints[match.point2D_idx1];
        const SyntheticKeypoint& keypoint2 = turntable.images[pair.image2].keypoints[match.point2D_idx2];
        const bool same = keypoint1.point >= 0 && keypoint1.point == keypoint2.point;
        good += same && IsRotating(keypoint1.body) == rotating ? 1 : 0;
        ++all;
      }
    }
    return static_cast<double>(good) / static_cast<double>(all);
  };
  EXPECT_GE(share_of_one_point(split.object_pairs, true), 0.98);
  EXPECT_GE(share_of_one_point(split.static_pairs, false), 0.99);
}

INSTANTIATE_TEST_SUITE_P(Seeds, MotionSplitSeeds, testing::Values(1, 2, 3));

TEST(MotionSplit, NothingRotates) {
  SyntheticTurntableOptions options = TestScene(4);
  options.turning = false;
  const MotionSplit split = Split(MakeSyntheticTurntable(options));
  EXPECT_EQ(split.capture_case, CaptureCase::kOneBody);
  EXPECT_THAT(split.reason, testing::HasSubstr("nothing turns"));
  EXPECT_TRUE(split.static_pairs.empty());
  // Every pair that has a baseline shows the one body.
  EXPECT_EQ(split.object_pairs.size(), 3U * 12U * 12U);
}

TEST(MotionSplit, OneStationHasNoBackgroundPairs) {
  SyntheticTurntableOptions options = TestScene(5);
  options.stations = 1;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const MotionSplit split = Split(turntable);
  EXPECT_EQ(split.stations.images.size(), 1U);
  EXPECT_TRUE(split.static_pairs.empty());
  EXPECT_GE(CountLabels(turntable, split).RotatingPrecision(), 0.98);
}

TEST(MotionSplit, ShakeWithinAStation) {
  SyntheticTurntableOptions options = TestScene(6);
  options.shake_deg = 0.05;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const MotionSplit split = Split(turntable);
  EXPECT_EQ(split.stations.images.size(), 3U);
  EXPECT_GE(CountLabels(turntable, split).StaticPrecision(), 0.99);
}

TEST(MotionSplit, Probe) {
  const auto report = [](const char* name, const SyntheticTurntableOptions& options) {
    const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
    const MotionSplit split = Split(turntable);
    const LabelCounts counts = CountLabels(turntable, split);
    int64_t good = 0, all = 0; int bad_pairs = 0;
    for (const VerifiedPair& pair : split.object_pairs) {
      int g = 0;
      for (const FeatureMatch& match : pair.matches) g += turntable.images[pair.image1].keypoints[match.point2D_idx1].point >= 0 && turntable.images[pair.image1].keypoints[match.point2D_idx1].point == turntable.images[pair.image2].keypoints[match.point2D_idx2].point;
      good += g; all += pair.matches.size(); bad_pairs += 2 * g < (int)pair.matches.size();
    }
    printf("good matches %.4f bad pairs %d ", double(good) / all, bad_pairs);
    printf("%-18s seed %d %s | %s | pairs %zu %zu | precision %.4f %.4f recall %.4f %.4f\n", name, (int)options.seed, CaptureCaseName(split.capture_case), split.reason.c_str(), split.object_pairs.size(), split.static_pairs.size(), counts.StaticPrecision(), counts.RotatingPrecision(), counts.Recall(0, KeypointLabel::kStatic), counts.Recall(1, KeypointLabel::kRotating));
    fflush(stdout);
  };
  for (uint64_t seed = 1; seed <= 1; ++seed) {
    SyntheticTurntableOptions options = TestScene(seed);
    options.hand_held = true; options.steps = 30; 
    report("hand_held 30deg", options);
    options.num_watermarks = 40;
    report("watermarks hh", options);
    options = TestScene(seed);
    report("plain", options);
    options = TestScene(seed); options.shake_deg = 0.2;
    report("shake .2", options);
    options = TestScene(seed); options.pixel_noise = 1.0;
    report("noise 1.0", options);
    options = TestScene(seed); options.pixel_noise = 1.5;
    report("noise 1.5", options);
  }
}

TEST(MotionSplit, StopsWhenAsked) {
  class Stopping : public Reporter {
   public:
    bool StopRequested() const override { return true; }
  } reporter;
  const std::vector<SplitImage> images = ToSplitImages(MakeSyntheticTurntable(TestScene(7)));
  EXPECT_THROW(SplitMotion(images, {}, &reporter), Interrupted);
}

}  // namespace
}  // namespace s2gs
