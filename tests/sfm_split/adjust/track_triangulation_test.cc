#include "sfm_split/adjust/track_triangulation.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>
#include <vector>

#include "tests/sfm_split/relocalise/small_scan.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

TEST(TrackTriangulation, TracksHoldOnePointDespiteWrongMatches) {
  SyntheticTurntableOptions options = SmallScan();
  options.outlier_share = 0.3;
  options.pixel_noise = 0.2;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const std::vector<PosedImage> posed = TruePosesOfObject(turntable);
  const std::vector<Keypoints> keypoints = KeypointsOf(features);
  TrackOptions track_options;
  track_options.max_error_px = 2;
  const std::vector<TrackPoint> points =
      TriangulateTracks(posed, keypoints, features.object_pairs, track_options);
  std::vector<ImagePairMatches> reversed(features.object_pairs.rbegin(), features.object_pairs.rend());
  const std::vector<TrackPoint> again = TriangulateTracks(posed, keypoints, reversed, track_options);
  ASSERT_EQ(points.size(), again.size());
  size_t right = 0;
  size_t all = 0;
  for (size_t p = 0; p < points.size(); ++p) {
    EXPECT_EQ(points[p].x_in_body, again[p].x_in_body);
    std::map<int, size_t> votes;
    std::set<int> images;
    for (const TrackElement& element : points[p].track) {
      EXPECT_TRUE(images.insert(element.image).second);
      ++votes[turntable.images[static_cast<size_t>(element.image)].keypoints[element.keypoint].point];
    }
    size_t most = 0;
    for (const auto& [point, count] : votes) most = std::max(most, count);
    all += points[p].track.size();
    if (points[p].track.size() > 2)
      right += most;
    else
      right += most == 2 ? 2 : 0;
  }
  EXPECT_GT(points.size(), 250U);
  EXPECT_GT(static_cast<double>(right), 0.97 * static_cast<double>(all));
}

TEST(TrackTriangulation, NoParallaxGivesNoPoint) {
  Camera camera;
  camera.model = CameraModelId::kSimplePinhole;
  camera.width = camera.height = 640;
  camera.params = {700, 320, 320};
  const Rigid3 pose{Eigen::Quaterniond::Identity(), {0, 0, 2}};
  const std::vector<PosedImage> posed = {{true, &camera, pose}, {true, &camera, pose}};
  const std::vector<Keypoints> keypoints(2, Keypoints{{300, 310}});
  EXPECT_TRUE(TriangulateTracks(posed, keypoints, {{0, 1, {{0, 0}}}}, {}).empty());
}

}  // namespace
}  // namespace s2gs
