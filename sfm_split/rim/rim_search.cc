#include "sfm_split/rim/rim_search.h"

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/binomial_tail.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/rim/edge_picture.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Where circles are looked for at first: everywhere that poses may be wrong by, in a small picture.
constexpr int kCoarseSidePx = 160;
constexpr double kStepPx = 1.5;  // of the small picture: what its blurred edges let pass
constexpr double kMostLean =
    20 * kDegree;  // up and down before the camera: focal length and height trade off
constexpr double kMostRoll = 12 * kDegree;  // a camera's roll is told well
constexpr double kMostAside = 0.3;          // of the radius of what turns
constexpr double kRimOver =
    2;  // a rim's radius over that of what turns, by which steps of the normal are told
constexpr size_t kCoarseDirections = 36;
constexpr size_t kParts = 3;      // of these, one after the other
constexpr double kHopeful = 0.7;  // of the best score so far, by the first part: noise of a third
constexpr double kReach = 4;      // in radii of what turns: a small thing on a large table
constexpr double kLeast = 0.5;    // of that radius: less is a foot
constexpr double kDown = 1;       // below what turns, in its heights: a thing whose foot shows nothing
constexpr double kUp = 0.5;       // from its lowest, in its heights
constexpr size_t kStarts = 200;
constexpr double kApartPx = 3;  // of the small picture, of two starts

// How one is followed in the picture.
constexpr int kDirections = 72;
constexpr std::array<double, 6> kReachesPx = {6, 4, 3, 2, 2, 2};  // of edges, round after round
constexpr double kBesidePx = 1.5;  // lines beside each other that an edge is the mean of
constexpr double kFinePx = 0.25;   // of profiles
constexpr double kOnItPx = 1;      // an edge that is the rim's
constexpr double kAroundPx = 12;   // how far edges are counted that are not
constexpr double kDeviations = 3;  // of what changes about the rim: an edge
constexpr double kLeastSlope = 2;  // grey values over two pixels: less is compression
constexpr double kMinShare = 0.5;
constexpr double kMaxFalseAlarms = 1e-3;
constexpr int kArcs = 16;            // whose edges err together: the rim is worn, or has a shadow
constexpr double kLeastArcPx = 0.4;  // a judgement: rims are rounded; on rendered ones arcs lie .1 to .3 off

// What tells a circle: how its normal leans against the axis, about the middle of what turns, and where its
// middle lies [rad and scene units].
constexpr int kNumUnknowns = 5;
using Unknowns = Eigen::Matrix<double, kNumUnknowns, 1>;  // lean, roll, aside, height, radius

class Circles {
 public:
  Circles(const RimView& view, const RimSearch& search, const Vector2d& scale)
      : view_(view), search_(search), scale_(scale) {
    const Vector3d& up = search.axis.direction;
    pivot_height_ = (search.low + search.high) / 2;
    pivot_ = search.axis.point + pivot_height_ * up;
    Vector3d to_camera = CameraCentre(view.cam_from_world) - pivot_;
    to_camera -= to_camera.dot(up) * up;
    level_ = to_camera.norm() > 0 ? Vector3d(to_camera.normalized()) : up.unitOrthogonal();
    right_ = up.cross(level_);
  }

  struct Frame {
    Vector3d middle, right, level;
  };
  Frame FrameOf(const Unknowns& x) const {
    const Eigen::Matrix3d turn = (Eigen::AngleAxisd(x(0), right_) * Eigen::AngleAxisd(x(1), level_)).matrix();
    Frame frame;
    frame.right = turn * right_;
    frame.level = turn * level_;
    frame.middle = pivot_ + x(2) * frame.right + (x(3) - pivot_height_) * (turn * search_.axis.direction);
    return frame;
  }
  // [px of the picture, from its corner]
  std::optional<Vector2d> Place(const Frame& frame, double radius, double phi) const {
    const std::optional<Vector2d> xy = ProjectToImage(
        view_.camera, view_.cam_from_world * Vector3d(frame.middle + radius * (std::cos(phi) * frame.right +
                                                                               std::sin(phi) * frame.level)));
    if (!xy) return std::nullopt;
    return Vector2d(xy->cwiseQuotient(scale_));
  }
  // A place and the direction across the circle's picture there, outwards.
  struct Crossing {
    Vector2d xy, normal;
  };
  std::optional<Crossing> Cross(const Frame& frame, double radius, double phi) const {
    constexpr double kDelta = 1e-3;
    const std::optional<Vector2d> here = Place(frame, radius, phi);
    const std::optional<Vector2d> next = Place(frame, radius, phi + kDelta);
    const std::optional<Vector2d> farther = Place(frame, radius * (1 + kDelta), phi);
    if (!here || !next || !farther) return std::nullopt;
    const Vector2d tangent = *next - *here;
    Vector2d normal = Vector2d(-tangent.y(), tangent.x()).normalized();
    if (normal.dot(*farther - *here) < 0) normal = -normal;
    return Crossing{*here, normal};
  }
  // Of the middle of what turns, before the camera.
  double DepthOfPivot() const { return (view_.cam_from_world * pivot_).z(); }

 private:
  const RimView& view_;
  const RimSearch& search_;
  Vector2d scale_;
  double pivot_height_ = 0;
  Vector3d pivot_, right_, level_;
};

struct Start {
  Unknowns x;
  double score = 0;
};

// The directions of a picture's edges as a pinhole camera without distortion sees them, in few cells.
EdgeDirections DirectionsOf(const RimView& view) {
  const GreyPicture& still = view.still;
  const double per_cell = std::max(1.0, std::max(still.width, still.height) / double{kCoarseSidePx});
  const double focal = FocalLengths(view.camera).x() / still.Scale().x() / per_cell;
  EdgeDirections directions(focal, {static_cast<int>(still.width / per_cell / 2) + 1,
                                    static_cast<int>(still.height / per_cell / 2) + 1});
  for (const EdgePicture::Edge& edge : EdgePicture(still).Edges()) {
    const std::optional<Vector3d> ray = UnprojectFromImage(view.camera, edge.xy.cwiseProduct(still.Scale()));
    if (ray) directions.Add(focal * ray->head<2>(), edge.normal);
  }
  directions.Spread();
  return directions;
}

// Circles along whose pictures edges lie, in a small picture.
class CoarseSearch {
 public:
  CoarseSearch(const RimView& view, const RimSearch& search)
      : view_(view), edges_(DirectionsOf(view)), by_chance_(edges_.Share()), circles_(view, search, {1, 1}) {
    step_ = kStepPx * circles_.DepthOfPivot() / edges_.focal_px();
    const double height = search.high - search.low;
    lean_step_ = step_ / (kRimOver * search.radius);
    num_leans_ = static_cast<int>(kMostLean / lean_step_);
    num_rolls_ = static_cast<int>(kMostRoll / lean_step_);
    num_asides_ = static_cast<int>(kMostAside * search.radius / step_);
    for (double h = search.low - kDown * height; h <= search.low + kUp * height; h += step_)
      heights_.push_back(h);
    for (double r = kLeast * search.radius; r <= kReach * search.radius; r += step_) radii_.push_back(r);
  }

  // Circles that a pixel of the picture tells apart.
  double NumTried() const {
    const double finer =
        kStepPx * FocalLengths(view_.camera).x() / view_.still.Scale().x() / edges_.focal_px();
    return (2.0 * num_leans_ + 1) * (2 * num_rolls_ + 1) * (2 * num_asides_ + 1) *
           static_cast<double>(heights_.size() * radii_.size()) * std::pow(finer / kOnItPx, kNumUnknowns);
  }

  std::vector<Start> Run() const {
    const int rolls = 2 * num_rolls_ + 1;
    const int count = (2 * num_leans_ + 1) * rolls;
    std::vector<std::vector<Start>> found(static_cast<size_t>(count));
    ParallelFor(count, 0, [&](int64_t k) {
      const double lean = (static_cast<int>(k) / rolls - num_leans_) * lean_step_;
      const double roll = (static_cast<int>(k) % rolls - num_rolls_) * lean_step_;
      found[static_cast<size_t>(k)] = BestOf(lean, roll);
    });
    std::vector<Start> all;
    for (const std::vector<Start>& some : found) all.insert(all.end(), some.begin(), some.end());
    std::stable_sort(all.begin(), all.end(),
                     [](const Start& a, const Start& b) { return a.score > b.score; });
    std::vector<Start> starts;
    for (const Start& start : all) {
      if (starts.size() == kStarts) break;
      if (std::none_of(starts.begin(), starts.end(),
                       [&](const Start& other) { return AreNear(start.x, other.x); }))
        starts.push_back(start);
    }
    return starts;
  }

 private:
  // A circle before the camera: its middle, and a radius' length outwards in each direction.
  struct InCamera {
    Vector3d middle;
    std::array<Vector3d, kCoarseDirections> outwards;
  };
  InCamera PutBeforeCamera(const Unknowns& x) const {
    const Circles::Frame frame = circles_.FrameOf(x);
    const Eigen::Matrix3d R = view_.cam_from_world.rotation.toRotationMatrix();
    InCamera circle;
    circle.middle = view_.cam_from_world * frame.middle;
    for (size_t d = 0; d < kCoarseDirections; ++d) {
      const double phi = 2 * kPi * static_cast<double>(d) / kCoarseDirections;
      circle.outwards[d] = R * (std::cos(phi) * frame.right + std::sin(phi) * frame.level);
    }
    return circle;
  }

  // The best radius for each middle.
  std::vector<Start> BestOf(double lean, double roll) const {
    std::vector<Start> best;
    for (int a = -num_asides_; a <= num_asides_; ++a) {
      for (const double height : heights_) {
        Unknowns x;
        x << lean, roll, a * step_, height, 0;
        const InCamera circle = PutBeforeCamera(x);
        Start start;
        for (const double radius : radii_) {
          const double score = Score(circle, radius, start.score);
          if (score < 0) break;  // larger ones reach farther beyond the picture
          if (!(score > start.score)) continue;
          x(4) = radius;
          start = {x, score};
        }
        if (start.score > 0) best.push_back(start);
      }
    }
    const size_t most = std::min(best.size(), kStarts);
    std::partial_sort(best.begin(), best.begin() + static_cast<std::ptrdiff_t>(most), best.end(),
                      [](const Start& one, const Start& other) { return one.score > other.score; });
    best.resize(most);
    return best;
  }

  // By how much edges along it are clearer than anywhere, in deviations but for a factor; 0 where it cannot
  // be more than `least`, -1 where the picture shows less than half of it.
  double Score(const InCamera& circle, double radius, double least) const {
    double sum = 0;
    int seen = 0;
    // Every third direction first: what no third of it shows is none.
    for (size_t first = 0; first < kParts; ++first) {
      for (size_t d = first; d < kCoarseDirections; d += kParts) {
        const Vector3d x = circle.middle + radius * circle.outwards[d];
        if (!(x.z() > 0)) continue;
        const Vector2d xy = edges_.focal_px() / x.z() * x.head<2>();
        if (!edges_.Contains(xy)) continue;
        // Around it, a quarter turn on.
        const Vector3d& around = circle.outwards[(d + kCoarseDirections / 4) % kCoarseDirections];
        const Vector2d tangent = around.head<2>() * x.z() - x.head<2>() * around.z();
        ++seen;
        sum += edges_.HasEdge(xy, Vector2d(-tangent.y(), tangent.x())) ? 1 : 0;
      }
      if (first > 0) continue;
      if (2 * seen < static_cast<int>(kCoarseDirections / kParts)) return -1;
      const double so_far = sum - by_chance_ * seen;
      if (!(so_far * std::sqrt(double{kParts}) > kHopeful * least * std::sqrt(static_cast<double>(seen))))
        return 0;
    }
    if (2 * seen < static_cast<int>(kCoarseDirections)) return -1;
    return (sum - by_chance_ * seen) / std::sqrt(static_cast<double>(seen));
  }

  bool AreNear(const Unknowns& a, const Unknowns& b) const {
    const InCamera one = PutBeforeCamera(a);
    const InCamera other = PutBeforeCamera(b);
    const auto place = [&](const InCamera& circle, double radius, size_t d) -> Vector2d {
      const Vector3d x = circle.middle + radius * circle.outwards[d];
      return edges_.focal_px() / x.z() * x.head<2>();
    };
    for (size_t d = 0; d < kCoarseDirections; d += kParts) {
      if ((place(one, a(4), d) - place(other, b(4), d)).norm() > kApartPx) return false;
    }
    return true;
  }

  const RimView& view_;
  EdgeDirections edges_;
  double by_chance_;
  Circles circles_;
  double step_ = 0;
  double lean_step_ = 0;
  int num_leans_ = 0;
  int num_rolls_ = 0;
  int num_asides_ = 0;
  std::vector<double> heights_;
  std::vector<double> radii_;
};

// The slope across a line through a place, each step the mean of three lines beside each other.
class Profile {
 public:
  // \param reach_px  on either side.
  Profile(const EdgePicture& picture, const Circles::Crossing& at, double reach_px) {
    const Vector2d along(-at.normal.y(), at.normal.x());
    const int reach = static_cast<int>(std::lround(reach_px / kFinePx));
    const int apart = static_cast<int>(std::lround(1 / kFinePx));  // two pixels from one side to the other
    std::vector<float> grey;
    for (int i = -reach - apart; i <= reach + apart; ++i) {
      float sum = 0;
      for (const int line : {-1, 0, 1}) {
        const Vector2d xy = at.xy + i * kFinePx * at.normal + line * kBesidePx * along;
        if (!picture.Contains(xy)) return;
        sum += picture.BrightnessAt(xy);
      }
      grey.push_back(sum / 3);
    }
    for (size_t i = 0; i + 2 * static_cast<size_t>(apart) < grey.size(); ++i)
      slopes_.push_back(std::abs(grey[i + 2 * static_cast<size_t>(apart)] - grey[i]));
    reach_ = reach;
  }

  bool IsSeen() const { return !slopes_.empty(); }
  struct Edge {
    double at_px = 0;  // outwards
    double slope = 0;
  };
  // Where slopes are steeper than beside.
  std::vector<Edge> Edges() const {
    std::vector<Edge> edges;
    for (size_t i = 1; i + 1 < slopes_.size(); ++i) {
      const double before = slopes_[i - 1];
      const double here = slopes_[i];
      const double after = slopes_[i + 1];
      if (!(here > before && here >= after)) continue;
      const double curvature = before - 2 * here + after;
      const double aside = curvature < 0 ? 0.5 * (before - after) / curvature : 0;
      edges.push_back({(static_cast<double>(i) - reach_ + aside) * kFinePx, here});
    }
    return edges;
  }
  const std::vector<float>& slopes() const { return slopes_; }

 private:
  std::vector<float> slopes_;
  int reach_ = 0;
};

class FineSearch {
 public:
  FineSearch(const RimView& view, const RimSearch& search)
      : picture_(view.still), circles_(view, search, picture_.scale()), search_(search) {}

  // Moves a circle to where edges near it lie.
  Unknowns Follow(Unknowns x) const {
    for (const double reach_px : kReachesPx) {
      std::vector<Eigen::Matrix<double, 1, 5>> rows;
      std::vector<double> offsets;
      const Circles::Frame frame = circles_.FrameOf(x);
      for (int d = 0; d < kDirections; ++d) {
        const double phi = 2 * kPi * d / kDirections;
        const std::optional<Circles::Crossing> at = circles_.Cross(frame, x(4), phi);
        if (!at) continue;
        const Profile profile(picture_, *at, reach_px);
        const Profile::Edge edge = Clearest(profile, reach_px);
        if (!(edge.slope > kLeastSlope)) continue;
        const std::optional<Eigen::Matrix<double, 1, 5>> row = Moves(x, phi, *at);
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
  FoundRim Judge(const Unknowns& x, double num_tried) const {
    struct Seen {
      double phi = 0;
      Vector2d normal, xy;
      std::vector<Profile::Edge> edges;
    };
    std::vector<Seen> seen;
    std::vector<float> slopes;
    const Circles::Frame frame = circles_.FrameOf(x);
    for (int d = 0; d < kDirections; ++d) {
      const double phi = 2 * kPi * d / kDirections;
      const std::optional<Circles::Crossing> at = circles_.Cross(frame, x(4), phi);
      if (!at) continue;
      const Profile profile(picture_, *at, kAroundPx);
      if (!profile.IsSeen()) continue;
      seen.push_back({phi, at->normal, at->xy, profile.Edges()});
      // Inside: what the top itself changes by.
      const auto inside = static_cast<std::ptrdiff_t>((kAroundPx - 2 * kOnItPx) / kFinePx);
      slopes.insert(slopes.end(), profile.slopes().begin(), profile.slopes().begin() + inside);
    }
    FoundRim rim;
    if (2 * seen.size() < kDirections) return rim;
    const double threshold =
        std::max<double>(kLeastSlope, kDeviations * kSigmaOfMad * UpperMedian(std::move(slopes)));
    std::vector<std::pair<double, double>> on_it;  // direction, offset
    double elsewhere = 0;
    for (const Seen& at : seen) {
      const Profile::Edge* nearest = nullptr;
      for (const Profile::Edge& edge : at.edges) {
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
    // An edge of the ground may lie along many directions: as many count once as rings outside it scatter
    // more than they would, and likewise inside.
    double as_one = 1;
    for (const double side : {-1.0, 1.0}) {
      std::vector<double> shares;
      for (double off = 3 * kOnItPx; off + kOnItPx <= kAroundPx; off += kOnItPx) {
        const auto count = std::count_if(seen.begin(), seen.end(), [&](const Seen& at) {
          return std::any_of(at.edges.begin(), at.edges.end(), [&](const Profile::Edge& edge) {
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
    rim.false_alarms = num_tried * BinomialTail(static_cast<int>(static_cast<double>(on_it.size()) / as_one),
                                                static_cast<int>(num / as_one), chance);
    rim.sigma_px = picture_.scale().x() * SigmaOf(on_it);
    return rim;
  }

 private:
  static Profile::Edge Clearest(const Profile& profile, double reach_px) {
    Profile::Edge clearest;
    double most = 0;
    for (const Profile::Edge& edge : profile.Edges()) {
      // Nearer ones first: the start is near.
      const double weighed = edge.slope * (1 - 0.5 * std::pow(edge.at_px / reach_px, 2));
      if (weighed <= most) continue;
      most = weighed;
      clearest = edge;
    }
    return clearest;
  }

  std::optional<Eigen::Matrix<double, 1, 5>> Moves(const Unknowns& x, double phi,
                                                   const Circles::Crossing& at) const {
    Eigen::Matrix<double, 1, 5> row;
    for (int k = 0; k < 5; ++k) {
      const double delta = (k < 2 ? 1 : x(4)) * 1e-4;
      Unknowns moved = x;
      moved(k) += delta;
      const std::optional<Vector2d> place = circles_.Place(circles_.FrameOf(moved), moved(4), phi);
      if (!place) return std::nullopt;
      row(k) = at.normal.dot(*place - at.xy) / delta;
    }
    return row;
  }

  // Some edges are others', which count less the farther off they are.
  Unknowns Robust(const std::vector<Eigen::Matrix<double, 1, 5>>& rows,
                  const std::vector<double>& offsets) const {
    Unknowns change = Unknowns::Zero();
    // What edges do not tell stays: as wide as the search.
    Unknowns wide;
    wide << kMostLean, kMostRoll, kMostAside * search_.radius, search_.high - search_.low, search_.radius;
    for (int round = 0; round < 10; ++round) {
      std::vector<double> left;
      for (size_t i = 0; i < rows.size(); ++i) left.push_back(std::abs(offsets[i] - rows[i].dot(change)));
      const double sigma = std::max(kLeastArcPx, kSigmaOfMad * UpperMedian(left));
      Eigen::Matrix<double, 5, 5> normal = wide.cwiseAbs2().cwiseInverse().asDiagonal();
      Unknowns right = Unknowns::Zero();
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
    const double of_arc = std::sqrt(squares / std::max(1, arcs - 5));
    return std::max(kLeastArcPx, of_arc) * std::sqrt(static_cast<double>(num) / std::max(1, arcs));
  }

  EdgePicture picture_;
  Circles circles_;
  const RimSearch& search_;
};

}  // namespace

namespace {

// Edges of something else may lead a circle away.
bool IsWithinSearch(const Unknowns& x, const RimSearch& search) {
  return std::abs(x(0)) <= kMostLean && std::abs(x(1)) <= kMostRoll &&
         std::abs(x(2)) <= kMostAside * search.radius && x(4) >= kLeast * search.radius;
}

}  // namespace

std::optional<FoundRim> FindRim(const RimView& view, const RimSearch& search) {
  if (!(search.radius > 0) || !(search.high > search.low)) return std::nullopt;
  const CoarseSearch coarse(view, search);
  const FineSearch fine(view, search);
  std::optional<FoundRim> best;
  for (const Start& start : coarse.Run()) {
    const Unknowns followed = fine.Follow(start.x);
    if (!IsWithinSearch(followed, search)) continue;
    FoundRim rim = fine.Judge(followed, coarse.NumTried());
    if (rim.share < kMinShare || !(rim.false_alarms < kMaxFalseAlarms)) continue;
    if (!best || rim.false_alarms < best->false_alarms) best = std::move(rim);
  }
  return best;
}

}  // namespace s2gs
