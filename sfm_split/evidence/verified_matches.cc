#include "sfm_split/evidence/verified_matches.h"

#include <algorithm>
#include <cstdint>
#include <map>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/base/union_find.h"
#include "sfm_split/evidence/chance.h"
#include "sfm_split/evidence/match_noise.h"
#include "sfm_split/evidence/pair_proof.h"

namespace s2gs {
namespace {

constexpr double kRightSigmas = 2;  // of their noise, within which 19 of 20 right matches lie

// Sets of keypoints that matches tie together.
class TiedKeypoints {
 public:
  void Tie(const ImagePairMatches& pair, const FeatureMatch& match) {
    ties_.emplace_back(PlaceOf(pair.image1, match.point2D_idx1), PlaceOf(pair.image2, match.point2D_idx2));
  }

  int NumSets() const {
    UnionFind sets(place_.size());
    auto num = static_cast<int>(place_.size());
    for (const auto& [a, b] : ties_) num -= sets.Join(a, b) ? 1 : 0;
    return num;
  }

 private:
  uint32_t PlaceOf(int image, uint32_t keypoint) {
    return place_.try_emplace({image, keypoint}, static_cast<uint32_t>(place_.size())).first->second;
  }

  std::map<std::pair<int, uint32_t>, uint32_t> place_;
  std::vector<std::pair<uint32_t, uint32_t>> ties_;
};

// How much larger errors are than others of which as many are right: by what half of the right ones stay
// within. A fit of noise beside wrong ones has two answers where many slide along by a few pixels, and one of
// the two may be given the other.
double NoiseRatio(std::vector<double> errors, std::vector<double> others, double right_share) {
  const double share = std::clamp(right_share, 0.0, 1.0) / 2;
  return Quantile(std::move(errors), share) / std::max(Quantile(std::move(others), share), 1e-9);
}

}  // namespace

std::vector<int> RecordVerifiedMatches(const PosedMatches& matches, const HeldBackKeypoints& held_back,
                                       ScanEvidence* evidence) {
  struct OfPair {
    AgreeingMatches compared;
    AgreeingMatches held_back;
    std::vector<double> errors;
    std::vector<char> is_held;
  };
  const std::vector<ImagePairMatches>& pairs = matches.features().object_pairs;
  std::vector<OfPair> of_pairs(pairs.size());
  ParallelFor(static_cast<int64_t>(pairs.size()), 0, [&](int64_t p) {
    const ImagePairMatches& pair = pairs[static_cast<size_t>(p)];
    OfPair& of_pair = of_pairs[static_cast<size_t>(p)];
    if (!matches.IsPosed(pair.image1) || !matches.IsPosed(pair.image2)) return;
    of_pair.compared = matches.Compare(pair, pair.matches, matches.bound_px());
    FeatureMatches held;
    of_pair.errors = matches.ErrorsOf(pair, pair.matches);
    for (const FeatureMatch& match : pair.matches) {
      const bool is_held = held_back[static_cast<size_t>(pair.image1)][match.point2D_idx1] ||
                           held_back[static_cast<size_t>(pair.image2)][match.point2D_idx2];
      of_pair.is_held.push_back(is_held ? 1 : 0);
      if (is_held) held.push_back(match);
    }
    of_pair.held_back = matches.Compare(pair, held, matches.bound_px());
  });
  std::vector<double> held_errors;
  std::vector<double> adjusted_errors;
  TiedKeypoints held;
  std::vector<int> verified(matches.posed().size(), 0);
  for (size_t p = 0; p < pairs.size(); ++p) {
    const ImagePairMatches& pair = pairs[p];
    const OfPair& of_pair = of_pairs[p];
    evidence->verified.Add(of_pair.compared);
    if (matches.StationOf(pair.image1) != matches.StationOf(pair.image2))
      evidence->across_stations.Add(of_pair.compared);
    evidence->held_back.Add(of_pair.held_back);
    for (size_t m = 0; m < of_pair.errors.size(); ++m) {
      const double error = of_pair.errors[m];
      (of_pair.is_held[m] != 0 ? held_errors : adjusted_errors).push_back(error);
      if (of_pair.is_held[m] != 0) held.Tie(pair, pair.matches[m]);
      if (error > matches.bound_px()) continue;
      ++verified[static_cast<size_t>(pair.image1)];
      ++verified[static_cast<size_t>(pair.image2)];
    }
  }
  if (static_cast<int>(adjusted_errors.size()) >= kLeastSupport) {
    evidence->adjusted_noise_px = FitNoise(adjusted_errors, kNoiseRange * matches.bound_px()).sigma;
  }
  if (evidence->adjusted_noise_px && static_cast<int>(held_errors.size()) >= kLeastSupport) {
    const double right = evidence->verified.Share().value_or(1);
    evidence->held_back_noise_px =
        *evidence->adjusted_noise_px * NoiseRatio(std::move(held_errors), std::move(adjusted_errors), right);
  }
  evidence->held_back_sets = held.NumSets();
  return verified;
}

// A photo whose place on the turntable is one angle is told by fewer matches than a motion between two
// photos: all its matches, right and wrong ones, must agree with its angle as they would not with the best of
// the angles that they can tell apart.
void RecordSupportOfPhotos(const PosedMatches& matches, const std::vector<int>& verified,
                           bool has_one_angle_each, ScanEvidence* evidence) {
  std::vector<size_t> weak;
  for (size_t i = 0; i < matches.posed().size(); ++i) {
    if (matches.posed()[i].is_posed && verified[i] < kLeastSupport) weak.push_back(i);
  }
  // Within what holds nearly all right matches, where their noise is known: chance puts the fewer there.
  const double bound_px =
      std::min(matches.bound_px(), kRightSigmas * evidence->match_noise_px.value_or(matches.bound_px()));
  std::vector<AgreeingMatches> of_photo(matches.posed().size());
  AgreeingMatches sum;
  if (has_one_angle_each && !weak.empty()) {
    for (const ImagePairMatches& pair : AllPairs(matches.features())) {
      if (!matches.IsPosed(pair.image1) || !matches.IsPosed(pair.image2)) continue;
      const AgreeingMatches compared =
          matches.Compare(pair, PossibleObjectMatches(matches.features(), pair), bound_px);
      sum.Add(compared);
      of_photo[static_cast<size_t>(pair.image1)].Add(compared);
      of_photo[static_cast<size_t>(pair.image2)].Add(compared);
    }
  }
  const double by_chance = static_cast<double>(sum.by_chance + 1) / static_cast<double>(sum.all + 1);
  for (const size_t i : weak) {
    // Points half a photo from the axis move by the bound, to both sides, from one such angle to the next.
    const double angles = kPi * static_cast<double>(matches.posed()[i].camera->width) / (2 * bound_px);
    const double risk = kScanRisk / static_cast<double>(matches.posed().size());
    const AgreeingMatches& own = of_photo[i];
    const bool is_told =
        has_one_angle_each && own.agreeing >= LeastAgreeingMatches(own.all, by_chance, angles, risk);
    if (!is_told) evidence->unsupported.push_back(matches.features().images[i].name);
  }
}

}  // namespace s2gs
