#include "sfm_split/evidence/pair_proof.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include "sfm_split/base/angles.h"
#include "sfm_split/evidence/chance.h"
#include "sfm_split/split/two_view_motion.h"

namespace s2gs {
namespace {

constexpr int kDirections = 24;      // in which a wrong match may go: 15 degrees apart
constexpr size_t kMaxSampled = 200;  // matches whose directions are looked at: chance needs no more
// Shifts the directions from match to match, so that none is preferred.
constexpr double kGolden = 0.6180339887498949;
constexpr int kChoosing = 7;       // matches that choose a fundamental matrix ...
constexpr double kChosen = 3;      // ... or up to three
constexpr float kOneDetailPx = 4;  // side of a cell: keypoints in one show one detail, and count once
constexpr double kBounds = 2;      // at which a geometry is asked how many agree

struct Pair {
  const Keypoints& keypoints1;
  const Keypoints& keypoints2;
  const FeatureMatches& matches;

  Eigen::Vector2f First(int m) const { return keypoints1[matches[static_cast<size_t>(m)].point2D_idx1]; }
  Eigen::Vector2f Second(int m) const { return keypoints2[matches[static_cast<size_t>(m)].point2D_idx2]; }
  double Error(const MatchError& error, int m) const {
    return error(First(m).cast<double>(), Second(m).cast<double>());
  }
  int Agreeing(const std::vector<int>& subset, const MatchError& error, double max_error_px) const {
    return static_cast<int>(
        std::count_if(subset.begin(), subset.end(), [&](int m) { return Error(error, m) <= max_error_px; }));
  }
  FeatureMatches Of(const std::vector<int>& subset) const {
    FeatureMatches chosen;
    for (const int m : subset) chosen.push_back(matches[static_cast<size_t>(m)]);
    return chosen;
  }
  double Chance(const std::vector<int>& subset, const MatchError& error, double max_error_px) const {
    return ChanceOfDirections(keypoints1, keypoints2, Of(subset), error, max_error_px);
  }
};

double Choices(int all) {
  return kChosen *
         std::exp(std::lgamma(all + 1.0) - std::lgamma(kChoosing + 1.0) - std::lgamma(all - kChoosing + 1.0));
}

}  // namespace

double ChanceOfDirections(const Keypoints& keypoints1, const Keypoints& keypoints2,
                          const FeatureMatches& matches, const MatchError& error, double max_error_px) {
  const size_t stride = std::max<size_t>(1, matches.size() / kMaxSampled);
  int agreeing = 0;
  int all = 0;
  double phase = 0.5;
  for (size_t m = 0; m < matches.size(); m += stride) {
    const Eigen::Vector2d xy1 = keypoints1[matches[m].point2D_idx1].cast<double>();
    const double moved = (keypoints2[matches[m].point2D_idx2].cast<double>() - xy1).norm();
    phase = std::fmod(phase + kGolden, 1.0);
    for (int d = 0; d < kDirections; ++d) {
      const double angle = 2 * kPi * (d + phase) / kDirections;
      const Eigen::Vector2d xy2 = xy1 + moved * Eigen::Vector2d(std::cos(angle), std::sin(angle));
      agreeing += error(xy1, xy2) <= max_error_px ? 1 : 0;
      ++all;
    }
  }
  return (agreeing + 1.0) / (all + 1.0);
}

std::vector<int> DistinctDetails(const Keypoints& keypoints1, const Keypoints& keypoints2,
                                 const FeatureMatches& matches) {
  std::set<std::array<int, 4>> seen;
  std::vector<int> details;
  for (size_t m = 0; m < matches.size(); ++m) {
    const Eigen::Vector2f first = keypoints1[matches[m].point2D_idx1] / kOneDetailPx;
    const Eigen::Vector2f second = keypoints2[matches[m].point2D_idx2] / kOneDetailPx;
    const std::array<int, 4> cell = {static_cast<int>(first.x()), static_cast<int>(first.y()),
                                     static_cast<int>(second.x()), static_cast<int>(second.y())};
    if (seen.insert(cell).second) details.push_back(static_cast<int>(m));
  }
  return details;
}

PairProof ProvePair(const Keypoints& keypoints1, const Keypoints& keypoints2, const FeatureMatches& matches,
                    const MatchError& posed, double bound_px, double risk) {
  PairProof proof;
  const Pair pair = {keypoints1, keypoints2, matches};
  const std::vector<int> details = DistinctDetails(keypoints1, keypoints2, matches);
  if (details.empty()) return proof;
  TwoViewMotionOptions options;
  options.min_inliers = kChoosing + 1;  // how many are enough, chance tells

  // The poses were not chosen by this pair alone: they count as one motion.
  const auto are_proven = [&](double max_error_px) {
    const double chance = pair.Chance(details, posed, max_error_px);
    return pair.Agreeing(details, posed, max_error_px) >=
           LeastAgreeingMatches(static_cast<int64_t>(details.size()), chance, kBounds, risk);
  };
  const bool borne_out = are_proven(bound_px) || are_proven(std::min(bound_px, options.max_error_px));

  std::vector<int> explained;
  std::vector<int> rest;
  for (const int m : details) (pair.Error(posed, m) <= bound_px ? explained : rest).push_back(m);
  const TwoViewMotion own = FitMotion(keypoints1, keypoints2, matches, rest, options);
  const MatchError by_own = [&](const Eigen::Vector2d& xy1, const Eigen::Vector2d& xy2) {
    return SampsonErrorPx(own.F, xy1.cast<float>(), xy2.cast<float>());
  };
  const int others = static_cast<int>(rest.size());
  const bool has_own =
      !own.inliers.empty() &&
      static_cast<int64_t>(own.inliers.size()) - kChoosing >=
          LeastAgreeingMatches(others - kChoosing, pair.Chance(rest, by_own, options.max_error_px),
                               Choices(others), risk);
  if (has_own) {
    // A wrong pose of one body leaves matches that its true motion explains together with the others.
    const bool is_one_body =
        !explained.empty() &&
        pair.Agreeing(explained, by_own, options.max_error_px) >=
            LeastAgreeingMatches(static_cast<int64_t>(explained.size()),
                                 pair.Chance(explained, by_own, options.max_error_px), 1, risk);
    proof.has_other_body = borne_out && !is_one_body;
    proof.is_contradicted = !proof.has_other_body && own.inliers.size() > explained.size();
  }
  if (proof.has_other_body) proof.others = own.inliers;
  proof.is_proven = borne_out || has_own;
  if (!proof.is_proven) return proof;
  proof.proven = explained;
  if (has_own && !proof.has_other_body) {
    proof.proven.insert(proof.proven.end(), own.inliers.begin(), own.inliers.end());
    std::sort(proof.proven.begin(), proof.proven.end());
  }
  return proof;
}

}  // namespace s2gs
