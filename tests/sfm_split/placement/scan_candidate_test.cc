#include "sfm_split/placement/scan_candidate.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <map>
#include <random>
#include <set>
#include <string>
#include <utility>

#include "sfm_split/relocalise/match_likelihood.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

ScanCandidate Candidate(double log_likelihood, bool is_usable = true) {
  ScanCandidate candidate;
  candidate.log_likelihood = log_likelihood;
  candidate.is_usable = is_usable;
  return candidate;
}

TEST(ScanCandidate, AUsableOneBeatsWhatIsNot) {
  EXPECT_TRUE(Candidate(-10).IsBetterThan(Candidate(100, false)));
  EXPECT_FALSE(Candidate(100, false).IsBetterThan(Candidate(-10)));
  EXPECT_TRUE(Candidate(2).IsBetterThan(Candidate(1)));
  EXPECT_FALSE(ScanCandidate().IsBetterThan(ScanCandidate()));
}

ScanCandidate Adjusted(const ScanFeatures& features, const ColmapModel& object) {
  ScanCandidate candidate;
  candidate.aligned = AlignScene(object, nullptr, StationsOf(features));
  if (candidate.aligned.scene.views.empty()) return candidate;
  Reporter reporter;
  candidate.refined = RefineScan(features, &object, JointOptions(), {}, reporter, &candidate.aligned);
  candidate.is_usable = true;
  candidate.log_likelihood =
      LikelihoodOfMatches(features, candidate.aligned, PossibleObjectPairs(features, false)).gain;
  return candidate;
}

// A model of all photos whose matches are mostly wrong against one of fewer photos that explains its matches.
TEST(ScanCandidate, MorePhotosThatHardlyAgreeLoseToFewerThatDo) {
  SyntheticTurntableOptions options;
  options.stations = 1;
  options.steps = 24;
  options.step_deg = 15;
  options.num_object_points = 220;
  options.num_platter_points = 80;
  options.num_background_points = 0;
  options.max_view_change_deg = 60;
  options.pixel_noise = 0.5;
  options.seed = 3;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const ColmapModel truth = SyntheticObjectModel(turntable, {3, Eigen::Quaterniond::Identity(), {1, 2, 3}});

  ColmapModel fewer = truth;
  std::set<std::string> last;
  for (size_t k = 20; k < features.images.size(); ++k) last.insert(features.images[k].name);
  RemoveImages({last.begin(), last.end()}, &fewer);
  // The photos of the first are all that its features show; of the second, four fifths of the matches fail.
  ScanFeatures of_first = features;
  const auto shows_last = [&](const ImagePairMatches& pair) {
    return pair.image1 >= 20 || pair.image2 >= 20;
  };
  of_first.object_pairs.erase(
      std::remove_if(of_first.object_pairs.begin(), of_first.object_pairs.end(), shows_last),
      of_first.object_pairs.end());
  ScanFeatures of_second = features;
  std::mt19937 rng(5);
  for (ImagePairMatches& pair : of_second.object_pairs) {
    for (size_t k = pair.matches.size(); k-- > 1;) {
      if (rng() % 5 != 0) std::swap(pair.matches[k].point2D_idx2, pair.matches[rng() % k].point2D_idx2);
    }
  }
  const ScanCandidate good = Adjusted(of_first, fewer);
  const ScanCandidate bad = Adjusted(of_second, truth);
  ASSERT_TRUE(good.is_usable);
  ASSERT_TRUE(bad.is_usable);
  EXPECT_EQ(good.aligned.scene.views.size(), 20U);
  EXPECT_GT(bad.aligned.scene.views.size(), good.aligned.scene.views.size());
  EXPECT_TRUE(good.IsBetterThan(bad)) << good.log_likelihood << " and " << bad.log_likelihood;
  EXPECT_FALSE(bad.IsBetterThan(good));
}

// Keypoints that stand still pass for an object that does not turn: between photos of two stations at nearly
// one table angle they agree with the object's poses almost as well as with their own.
TEST(ScanCandidate, MatchesThatStandStillDoNotAgreeWithTheObject) {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 12;
  options.step_deg = 30;
  options.station_start_deg = 1;
  options.num_object_points = 150;
  options.num_platter_points = 0;
  options.num_background_points = 300;
  options.max_view_change_deg = 70;
  options.pixel_noise = 0.1;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  ScanFeatures features = SyntheticScanFeatures(turntable);
  AlignedScene aligned;
  aligned.scene = turntable.scene;
  aligned.background = SyntheticStaticModel(turntable);
  const auto count = [](const std::vector<ImagePairMatches>& pairs) {
    size_t num = 0;
    for (const ImagePairMatches& pair : pairs) num += pair.matches.size();
    return num;
  };
  constexpr double kMaxErrorPx = 4;
  const size_t of_object = count(MatchesThatAgree(features, aligned, kMaxErrorPx).pairs);
  // The static matches pass for the object's.
  ScanFeatures mixed = features;
  mixed.object_pairs.insert(mixed.object_pairs.end(), features.static_pairs.begin(),
                            features.static_pairs.end());
  for (ScanImage& image : mixed.images)
    std::fill(image.labels.begin(), image.labels.end(), KeypointLabel::kRotating);
  const size_t with_background = count(MatchesThatAgree(mixed, aligned, kMaxErrorPx).pairs);
  AlignedScene alone = aligned;
  alone.background = ColmapModel();
  const size_t unasked = count(MatchesThatAgree(mixed, alone, kMaxErrorPx).pairs);
  // Of 134 that stand still, 140 more are measured without the background, and 1 more with it.
  EXPECT_GT(unasked, of_object + count(features.static_pairs) / 4);
  EXPECT_LT(with_background, of_object + count(features.static_pairs) / 20);
}

}  // namespace
}  // namespace s2gs
