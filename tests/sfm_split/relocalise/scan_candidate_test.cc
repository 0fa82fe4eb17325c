#include "sfm_split/relocalise/scan_candidate.h"

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
  std::map<std::string, int> stations;
  for (const ScanImage& image : features.images) stations[image.name] = image.station;
  ScanCandidate candidate;
  candidate.aligned = AlignScene(object, nullptr, stations);
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

}  // namespace
}  // namespace s2gs
