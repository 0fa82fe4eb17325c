#include "sfm_split/rim/rim_search.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/binomial_tail.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/rim/edge_picture.h"
#include "sfm_split/rim/edge_profile.h"
#include "sfm_split/rim/rim_candidates.h"
#include "sfm_split/rim/searched_circles.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Row = Eigen::Matrix<double, 1, kNumUnknowns>;

constexpr int kDirections = 72;  // of the circle, at which edges are looked for: every 5 degrees
constexpr std::array<double, 6> kReachesPx = {6, 4, 3, 2, 2, 2};  // of edges, round after round
constexpr double kOnItPx = 1;                                     // an edge that is the rim's
constexpr double kAroundPx = 12;                                  // how far edges are counted that are not
constexpr double kDeviations = 3;                                 // of what changes about the rim: an edge
constexpr double kLeastSlope = 2;         // grey values over two pixels: less is compression
constexpr double kMinShare = 0.5;         // half of a circle tells its middle
constexpr double kMaxFalseAlarms = 1e-3;  // circles that chance finds in a scan: one in a thousand scans
constexpr int kArcs = 16;                 // whose edges err together: the rim is worn, or has a shadow
constexpr double kLeastArcPx = 0.4;  // a judgement: rims are rounded; on rendered ones arcs lie .1 to .3 off
constexpr int kRobustRounds = 10;    // weights settle to a hundredth

// A circle in the picture itself.
class FineSearch {
 public:
  FineSearch(const RimView& view, const RimSearch& search)
      : picture_(view.still), circles_(view, search, picture_.scale()), search_(search) {}

  // Moves a circle to where edges near it lie.
  CircleUnknowns Follow(CircleUnknowns x) const {
    for (const double reach_px : kReachesPx) {
      std::vector<Row> rows;
      std::vector<double> offsets;
      const SearchedCircles::Frame frame = circles_.FrameOf(x);
      for (int d = 0; d < kDirections; ++d) {
        const double phi = 2 * kPi * d / kDirections;
        const std::optional<SearchedCircles::Crossing> at = circles_.Cross(frame, x(4), phi);
        if (!at) continue;
        const EdgeProfile profile(picture_, *at, reach_px);
        const EdgeProfile::Edge edge = Clearest(profile, reach_px);
        if (!(edge.slope > kLeastSlope)) continue;
        const std::optional<Row> row = Moves(x, phi, *at);
        if (!row) continue;
        rows.push_back(*row);
        offsets.push_back(edge.at_px);
      }
      if (rows.size() < kArcs) return x;
      x += Robust(rows, offsets);
      if (!(x(4) > 0)) return x;
    }
    return x;
  }

  // What edges say of a circle. \param num_tried  circles, of which this is one.
  FoundRim Judge(const CircleUnknowns& x, double num_tried) const {
    std::vector<float> slopes;
    const std::vector<Seen> seen = LookAcross(x, &slopes);
    FoundRim rim;
    if (2 * seen.size() < kDirections) return rim;
    const double threshold =
        std::max<double>(kLeastSlope, kDeviations * kSigmaOfMad * UpperMedian(std::move(slopes)));
    std::vector<std::pair<double, double>> on_it;  // direction, offset
    double elsewhere = 0;
    for (const Seen& at : seen) {
      const EdgeProfile::Edge* nearest = nullptr;
      for (const EdgeProfile::Edge& edge : at.edges) {
        if (!(edge.slope > threshold)) continue;
        if (std::abs(edge.at_px) > 2 * kOnItPx) {
          elsewhere += 1;
        } else if (nearest == nullptr || std::abs(edge.at_px) < std::abs(nearest->at_px)) {
          nearest = &edge;
        }
      }
      if (nearest == nullptr || std::abs(nearest->at_px) > kOnItPx) continue;
      on_it.emplace_back(at.phi, nearest->at_px);
      rim.places.push_back((at.xy + nearest->at_px * at.normal).cwiseProduct(picture_.scale()));
    }
    const auto num = static_cast<double>(seen.size());
    rim.share = static_cast<double>(on_it.size()) / num;
    const double chance = std::min(0.9, elsewhere / num * kOnItPx / (kAroundPx - 2 * kOnItPx));
    const double as_one = CountAsOne(seen, threshold);
    rim.false_alarms = num_tried * BinomialTail(static_cast<int>(static_cast<double>(on_it.size()) / as_one),
                                                static_cast<int>(num / as_one), chance);
    rim.sigma_px = picture_.scale().x() * SigmaOf(on_it);
    return rim;
  }

 private:
  // What a direction shows.
  struct Seen {
    double phi = 0;
    Vector2d normal, xy;
    std::vector<EdgeProfile::Edge> edges;
  };

  // \param slopes  of what lies inside: what the top itself changes by.
  std::vector<Seen> LookAcross(const CircleUnknowns& x, std::vector<float>* slopes) const {
    std::vector<Seen> seen;
    const SearchedCircles::Frame frame = circles_.FrameOf(x);
    for (int d = 0; d < kDirections; ++d) {
      const double phi = 2 * kPi * d / kDirections;
      const std::optional<SearchedCircles::Crossing> at = circles_.Cross(frame, x(4), phi);
      if (!at) continue;
      const EdgeProfile profile(picture_, *at, kAroundPx);
      if (!profile.IsSeen()) continue;
      seen.push_back({phi, at->normal, at->xy, profile.Edges()});
      const auto inside = static_cast<std::ptrdiff_t>((kAroundPx - 2 * kOnItPx) / EdgeProfile::kStepPx);
      slopes->insert(slopes->end(), profile.slopes().begin(), profile.slopes().begin() + inside);
    }
    return seen;
  }

  // An edge of the ground may lie along many directions: as many count once as rings outside the circle
  // scatter more than they would, and likewise inside.
  static double CountAsOne(const std::vector<Seen>& seen, double threshold) {
    const auto num = static_cast<double>(seen.size());
    double as_one = 1;
    for (const double side : {-1.0, 1.0}) {
      std::vector<double> shares;
      for (double off = 3 * kOnItPx; off + kOnItPx <= kAroundPx; off += kOnItPx) {
        const auto count = std::count_if(seen.begin(), seen.end(), [&](const Seen& at) {
          return std::any_of(at.edges.begin(), at.edges.end(), [&](const EdgeProfile::Edge& edge) {
            return edge.slope > threshold && std::abs(edge.at_px - side * off) <= kOnItPx;
          });
        });
        shares.push_back(static_cast<double>(count) / num);
      }
      double mean = 0;
      for (const double share : shares) mean += share / static_cast<double>(shares.size());
      double variance = 0;
      for (const double share : shares) variance += std::pow(share - mean, 2);
      variance /= static_cast<double>(shares.size() - 1);
      as_one = std::max(as_one, num * variance / std::max(mean * (1 - mean), 1 / num));
    }
    return as_one;
  }

  static EdgeProfile::Edge Clearest(const EdgeProfile& profile, double reach_px) {
    EdgeProfile::Edge clearest;
    double most = 0;
    for (const EdgeProfile::Edge& edge : profile.Edges()) {
      // Nearer ones first: the start is near.
      const double weighed = edge.slope * (1 - 0.5 * std::pow(edge.at_px / reach_px, 2));
      if (weighed <= most) continue;
      most = weighed;
      clearest = edge;
    }
    return clearest;
  }

  std::optional<Row> Moves(const CircleUnknowns& x, double phi, const SearchedCircles::Crossing& at) const {
    Row row;
    for (int k = 0; k < kNumUnknowns; ++k) {
      const double delta = (k < 2 ? 1 : x(4)) * 1e-4;
      CircleUnknowns moved = x;
      moved(k) += delta;
      const std::optional<Vector2d> place = circles_.Place(circles_.FrameOf(moved), moved(4), phi);
      if (!place) return std::nullopt;
      row(k) = at.normal.dot(*place - at.xy) / delta;
    }
    return row;
  }

  // Some edges are others', which count less the farther off they are.
  CircleUnknowns Robust(const std::vector<Row>& rows, const std::vector<double>& offsets) const {
    CircleUnknowns change = CircleUnknowns::Zero();
    // What edges do not tell stays: as wide as the search.
    CircleUnknowns wide;
    wide << kMostLean, kMostRoll, kMostAside * search_.radius, search_.high - search_.low, search_.radius;
    for (int round = 0; round < kRobustRounds; ++round) {
      std::vector<double> left;
      for (size_t i = 0; i < rows.size(); ++i) left.push_back(std::abs(offsets[i] - rows[i].dot(change)));
      const double sigma = std::max(kLeastArcPx, kSigmaOfMad * UpperMedian(left));
      Eigen::Matrix<double, kNumUnknowns, kNumUnknowns> normal = wide.cwiseAbs2().cwiseInverse().asDiagonal();
      CircleUnknowns right = CircleUnknowns::Zero();
      for (size_t i = 0; i < rows.size(); ++i) {
        const double weight = 1 / (sigma * sigma * (1 + std::pow(left[i] / sigma, 2)));
        normal += weight * rows[i].transpose() * rows[i];
        right += weight * offsets[i] * rows[i].transpose();
      }
      change = normal.ldlt().solve(right);
    }
    return change;
  }

  // Of one edge, as if all erred by themselves: edges of an arc err together, by as much as arcs' means
  // scatter once five numbers have been fitted to them. \param offsets  by direction.
  static double SigmaOf(const std::vector<std::pair<double, double>>& offsets) {
    std::array<double, kArcs> sums{};
    std::array<int, kArcs> counts{};
    for (const auto& [phi, offset] : offsets) {
      const auto arc = static_cast<size_t>(phi / (2 * kPi) * kArcs) % kArcs;
      sums[arc] += offset;
      ++counts[arc];
    }
    double squares = 0;
    int arcs = 0;
    int num = 0;
    for (size_t arc = 0; arc < kArcs; ++arc) {
      if (counts[arc] == 0) continue;
      squares += std::pow(sums[arc] / counts[arc], 2);
      num += counts[arc];
      ++arcs;
    }
    const double of_arc = std::sqrt(squares / std::max(1, arcs - kNumUnknowns));
    return std::max(kLeastArcPx, of_arc) * std::sqrt(static_cast<double>(num) / std::max(1, arcs));
  }

  EdgePicture picture_;
  SearchedCircles circles_;
  const RimSearch& search_;
};

// Edges of something else may lead a circle away.
bool IsWithinSearch(const CircleUnknowns& x, const RimSearch& search) {
  return std::abs(x(0)) <= kMostLean && std::abs(x(1)) <= kMostRoll &&
         std::abs(x(2)) <= kMostAside * search.radius && x(4) >= kLeastOfRadius * search.radius;
}

}  // namespace

std::optional<FoundRim> FindRim(const RimView& view, const RimSearch& search) {
  if (!(search.radius > 0) || !(search.high > search.low)) return std::nullopt;
  const RimCandidates candidates = FindRimCandidates(view, search);
  const FineSearch fine(view, search);
  std::optional<FoundRim> best;
  for (const RimCandidate& start : candidates.starts) {
    const CircleUnknowns followed = fine.Follow(start.x);
    if (!IsWithinSearch(followed, search)) continue;
    FoundRim rim = fine.Judge(followed, candidates.num_tried);
    if (rim.share < kMinShare || !(rim.false_alarms < kMaxFalseAlarms)) continue;
    if (!best || rim.false_alarms < best->false_alarms) best = std::move(rim);
  }
  return best;
}

}  // namespace s2gs
