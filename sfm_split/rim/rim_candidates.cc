#include "sfm_split/rim/rim_candidates.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/rim/edge_picture.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Where circles are looked for at first: everywhere that poses may be wrong by, in a small picture.
constexpr int kCoarseSidePx = 160;
constexpr double kStepPx = 1.5;  // of the small picture: what its blurred edges let pass
// A rim's radius over that of what turns, by which steps of the normal are told.
constexpr double kRimOver = 2;
constexpr size_t kCoarseDirections = 36;
constexpr size_t kParts = 3;      // of these, one after the other
constexpr double kHopeful = 0.7;  // of the best score so far, by the first part: noise of a third
constexpr double kReach = 4;      // in radii of what turns: a small thing on a large table
constexpr double kDown = 1;       // below what turns, in its heights: a thing whose foot shows nothing
constexpr double kUp = 0.5;       // from its lowest, in its heights
constexpr size_t kStarts = 200;   // a judgement: among clutter 24 missed the rim
constexpr double kApartPx = 3;    // of the small picture, of two starts
constexpr double kOnePx = 1;      // that tells two circles of the picture apart

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
    if (!(step_ > 0)) return;  // what turns is not before the camera
    const double height = search.high - search.low;
    lean_step_ = step_ / (kRimOver * search.radius);
    num_leans_ = static_cast<int>(kMostLean / lean_step_);
    num_rolls_ = static_cast<int>(kMostRoll / lean_step_);
    num_asides_ = static_cast<int>(kMostAside * search.radius / step_);
    for (double h = search.low - kDown * height; h <= search.low + kUp * height; h += step_)
      heights_.push_back(h);
    for (double r = kLeastOfRadius * search.radius; r <= kReach * search.radius; r += step_)
      radii_.push_back(r);
  }

  // Circles that a pixel of the picture tells apart.
  double NumTried() const {
    const double finer =
        kStepPx * FocalLengths(view_.camera).x() / view_.still.Scale().x() / edges_.focal_px();
    return (2.0 * num_leans_ + 1) * (2 * num_rolls_ + 1) * (2 * num_asides_ + 1) *
           static_cast<double>(heights_.size() * radii_.size()) * std::pow(finer / kOnePx, kNumUnknowns);
  }

  std::vector<RimCandidate> Run() const {
    const int rolls = 2 * num_rolls_ + 1;
    const int count = (2 * num_leans_ + 1) * rolls;
    std::vector<std::vector<RimCandidate>> found(static_cast<size_t>(count));
    ParallelFor(count, 0, [&](int64_t k) {
      const int lean = static_cast<int>(k) / rolls - num_leans_;
      const int roll = static_cast<int>(k) % rolls - num_rolls_;
      found[static_cast<size_t>(k)] = BestOf(lean * lean_step_, roll * lean_step_);
    });
    std::vector<RimCandidate> all;
    for (const std::vector<RimCandidate>& some : found) all.insert(all.end(), some.begin(), some.end());
    std::stable_sort(all.begin(), all.end(),
                     [](const RimCandidate& a, const RimCandidate& b) { return a.score > b.score; });
    std::vector<RimCandidate> starts;
    for (const RimCandidate& start : all) {
      if (starts.size() == kStarts) break;
      if (std::none_of(starts.begin(), starts.end(),
                       [&](const RimCandidate& other) { return AreNear(start.x, other.x); }))
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
  InCamera PutBeforeCamera(const CircleUnknowns& x) const {
    const SearchedCircles::Frame frame = circles_.FrameOf(x);
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
  std::vector<RimCandidate> BestOf(double lean, double roll) const {
    std::vector<RimCandidate> best;
    for (int a = -num_asides_; a <= num_asides_; ++a) {
      for (const double height : heights_) {
        CircleUnknowns x;
        x << lean, roll, a * step_, height, 0;
        const InCamera circle = PutBeforeCamera(x);
        RimCandidate start;
        for (const double radius : radii_) {
          const double score = Score(circle, radius, start.score);
          if (score < 0) break;  // larger ones reach farther beyond the picture
          if (!(score > start.score) || IsLine(circle, radius)) continue;
          x(4) = radius;
          start = {x, score};
        }
        if (start.score > 0) best.push_back(start);
      }
    }
    const size_t most = std::min(best.size(), kStarts);
    std::partial_sort(
        best.begin(), best.begin() + static_cast<std::ptrdiff_t>(most), best.end(),
        [](const RimCandidate& one, const RimCandidate& other) { return one.score > other.score; });
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

  Vector2d Place(const InCamera& circle, double radius, size_t d) const {
    const Vector3d x = circle.middle + radius * circle.outwards[d];
    return edges_.focal_px() / x.z() * x.head<2>();
  }

  // Seen from the side a circle is a line, and the foot of a wall is as long.
  bool IsLine(const InCamera& circle, double radius) const {
    constexpr size_t kNear = kCoarseDirections / 4;     // of the directions from the one across the view:
    constexpr size_t kFar = 3 * kCoarseDirections / 4;  // towards the camera, and away
    return (Place(circle, radius, kNear) - Place(circle, radius, kFar)).norm() < kApartPx;
  }

  bool AreNear(const CircleUnknowns& a, const CircleUnknowns& b) const {
    const InCamera one = PutBeforeCamera(a);
    const InCamera other = PutBeforeCamera(b);
    for (size_t d = 0; d < kCoarseDirections; d += kParts) {
      if ((Place(one, a(4), d) - Place(other, b(4), d)).norm() > kApartPx) return false;
    }
    return true;
  }

  const RimView& view_;
  EdgeDirections edges_;
  double by_chance_;
  SearchedCircles circles_;
  double step_ = 0;
  double lean_step_ = 0;
  int num_leans_ = 0;
  int num_rolls_ = 0;
  int num_asides_ = 0;
  std::vector<double> heights_;
  std::vector<double> radii_;
};

}  // namespace

RimCandidates FindRimCandidates(const RimView& view, const RimSearch& search) {
  const CoarseSearch coarse(view, search);
  return {coarse.Run(), coarse.NumTried()};
}

}  // namespace s2gs
