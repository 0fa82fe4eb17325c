#include "sfm_split/evidence/verified_matches.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/evidence/chance.h"
#include "sfm_split/evidence/match_noise.h"
#include "sfm_split/evidence/pair_proof.h"

namespace s2gs {
namespace {

constexpr double kRightSigmas = 2;  // of their noise, within which 19 of 20 right matches lie

// What the matches of sets of keypoints say: a set is one detail, however many photos show it and pairs of
// them match it.
class OfSets {
 public:
  void Add(uint32_t set, double error_px, double bound_px, double chance) {
    Matches& matches = of_[set];
    matches.errors_px.push_back(error_px);
    matches.agreeing += error_px <= bound_px ? 1 : 0;
    matches.by_chance += chance;
  }

  AgreeingMatches Agreeing() const {
    AgreeingMatches sum;
    double agreeing = 0;
    for (const auto& [set, matches] : of_) {
      const auto num = static_cast<double>(matches.errors_px.size());
      agreeing += matches.agreeing / num;
      sum.by_chance += matches.by_chance / num;
    }
    sum.all = static_cast<int64_t>(of_.size());
    sum.agreeing = std::llround(agreeing);
    return sum;
  }

  // By what half of the right sets err at most [px].
  double HalfErrorPx() const {
    std::vector<double> errors;
    for (const auto& [set, matches] : of_) errors.push_back(UpperMedian(matches.errors_px));
    return Quantile(std::move(errors), std::clamp(Agreeing().Share().value_or(1), 0.0, 1.0) / 2);
  }

 private:
  struct Matches {
    std::vector<double> errors_px;
    double agreeing = 0;
    double by_chance = 0;
  };
  std::map<uint32_t, Matches> of_;
};

double ChanceOf(const AgreeingMatches& matches) {
  return matches.by_chance / static_cast<double>(std::max<int64_t>(1, matches.all));
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
  const KeypointSets sets = SetsOfKeypoints(matches.features());
  std::vector<double> adjusted_errors;
  OfSets held;
  OfSets adjusted;
  std::vector<int> verified(matches.posed().size(), 0);
  for (size_t p = 0; p < pairs.size(); ++p) {
    const ImagePairMatches& pair = pairs[p];
    const OfPair& of_pair = of_pairs[p];
    evidence->verified.Add(of_pair.compared);
    if (matches.StationOf(pair.image1) != matches.StationOf(pair.image2))
      evidence->across_stations.Add(of_pair.compared);
    for (size_t m = 0; m < of_pair.errors.size(); ++m) {
      const double error = of_pair.errors[m];
      const FeatureMatch& match = pair.matches[m];
      const auto first = static_cast<size_t>(pair.image1);
      const auto second = static_cast<size_t>(pair.image2);
      if (of_pair.is_held[m] != 0) {
        const bool is_first = held_back[first][match.point2D_idx1];
        held.Add(is_first ? sets[first][match.point2D_idx1] : sets[second][match.point2D_idx2], error,
                 matches.bound_px(), ChanceOf(of_pair.held_back));
      } else {
        // Wrong ones may lead from or to a keypoint that belongs to none.
        const uint32_t set = sets[first][match.point2D_idx1];
        adjusted.Add(set != kNoSet ? set : sets[second][match.point2D_idx2], error, matches.bound_px(),
                     ChanceOf(of_pair.compared));
        adjusted_errors.push_back(error);
      }
      if (error > matches.bound_px()) continue;
      ++verified[static_cast<size_t>(pair.image1)];
      ++verified[static_cast<size_t>(pair.image2)];
    }
  }
  evidence->held_back = held.Agreeing();
  evidence->adjusted = adjusted.Agreeing();
  if (static_cast<int>(adjusted_errors.size()) >= kLeastSupport) {
    evidence->adjusted_noise_px = FitNoise(adjusted_errors, kNoiseRange * matches.bound_px()).sigma;
  }
  // A fit of noise beside wrong ones has two answers where many slide along by a few pixels, and one of the
  // two may be given the other.
  if (evidence->adjusted_noise_px && evidence->held_back.all >= kLeastSupport) {
    evidence->held_back_noise_px =
        *evidence->adjusted_noise_px * held.HalfErrorPx() / std::max(adjusted.HalfErrorPx(), 1e-9);
  }
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
