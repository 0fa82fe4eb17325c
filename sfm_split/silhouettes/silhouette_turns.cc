#include "sfm_split/silhouettes/silhouette_turns.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/scene/axis_turn.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

constexpr float kOwnSquared = 1;                // [px^2] that outlines err by themselves
constexpr int kTurns = 180;                     // of a search
constexpr size_t kSearchStride = 4;             // by one ray of so many
constexpr int kFineReach = 10;                  // turns to either side of the best that are looked at closely
constexpr int kFineTurns = 2 * kFineReach + 1;  // with the best itself
constexpr double kFineDeg = 0.2;                // a tenth of a turn of the search; a parabola tells it finer
constexpr size_t kBlocksOfStation = 8;          // of neighbouring photos, whose errors are alike
// Chance goes beyond once in e^8 times: Student's t with 15 degrees of freedom.
constexpr double kCertainT = 4.24;

// A ray through an outline: the places that the own station's outlines leave for it.
struct Ray {
  struct Place {
    Vector3d x_in_object;
    float own = 0;  // squared error by the own station's outlines [px^2]
  };
  std::vector<Place> places;
};

struct Source {
  std::vector<Ray> rays;  // of a photo
};

std::vector<Source> SourcesOf(const std::vector<SilhouetteView>& views, const TurntableAxis& axis,
                              double reach) {
  std::vector<Source> sources(views.size());
  ParallelFor(static_cast<int64_t>(views.size()), 0, [&](int64_t i) {
    const auto own = static_cast<size_t>(i);
    for (const Eigen::Vector2d& xy : views[own].silhouette->rim) {
      Ray ray;
      for (const Vector3d& x : PlacesOnRay(views[own], xy, axis, reach)) {
        const float squared = SquaredOutside(views, own, x, 0, kMostSquaredPx);
        if (squared < kMostSquaredPx) ray.places.push_back({x, squared});
      }
      std::sort(ray.places.begin(), ray.places.end(),
                [](const Ray::Place& a, const Ray::Place& b) { return a.own < b.own; });
      // A shadow's outline does not turn with the thing, as the own station's outlines tell.
      if (!ray.places.empty() && ray.places.front().own < kOwnSquared)
        sources[own].rays.push_back(std::move(ray));
    }
  });
  return sources;
}

// A sum of squares for each block of neighbouring photos.
class Contradiction {
 public:
  Contradiction(const std::vector<SilhouetteView>& first, const std::vector<SilhouetteView>& second,
                const TurntableAxis& axis)
      : first_(first), second_(second), axis_(axis) {
    const double reach = std::max(ReachOf(first, axis), ReachOf(second, axis));
    of_first_ = SourcesOf(first, axis, reach);
    of_second_ = SourcesOf(second, axis, reach);
    px_per_rad_ = reach * std::min(PxPerLength(first.front(), axis), PxPerLength(second.front(), axis));
    for (const std::vector<Source>* sources : {&of_first_, &of_second_}) {
      for (const Source& source : *sources) num_rays_ += source.rays.size();
    }
  }

  size_t num_rays() const { return num_rays_; }
  // Of the thing's outermost part, across the view [px of the pictures].
  double px_per_rad() const { return px_per_rad_; }

  // By block: those of the first station, then of the second. [px^2] \param stride  one ray of so many.
  std::vector<double> At(double turn_rad, size_t stride) const {
    std::vector<double> sums(2 * kBlocksOfStation, 0);
    Add(of_first_, second_, TurnAbout(axis_, turn_rad), stride, sums.data());
    Add(of_second_, first_, TurnAbout(axis_, -turn_rad), stride, sums.data() + kBlocksOfStation);
    return sums;
  }

 private:
  void Add(const std::vector<Source>& sources, const std::vector<SilhouetteView>& views, const Rigid3& turn,
           size_t stride, double* sums) const {
    for (size_t i = 0; i < sources.size(); ++i) {
      double sum = 0;
      for (size_t r = 0; r < sources[i].rays.size(); r += stride) {
        const Ray& ray = sources[i].rays[r];
        float least = kMostSquaredPx;
        for (const Ray::Place& place : ray.places) {
          if (place.own >= least) break;
          least = std::min(least,
                           SquaredOutside(views, views.size(), turn * place.x_in_object, place.own, least));
        }
        sum += least;
      }
      sums[i * kBlocksOfStation / sources.size()] += sum;
    }
  }

  const std::vector<SilhouetteView>& first_;
  const std::vector<SilhouetteView>& second_;
  const TurntableAxis axis_;
  std::vector<Source> of_first_;
  std::vector<Source> of_second_;
  size_t num_rays_ = 0;
  double px_per_rad_ = 0;
};

double Sum(const std::vector<double>& values, size_t without) {
  double sum = 0;
  for (size_t k = 0; k < values.size(); ++k) sum += k == without ? 0 : values[k];
  return sum;
}

// The lowest place of a row of equidistant values, between them by a parabola.
double LowestPlace(const std::vector<std::vector<double>>& sums, size_t without) {
  size_t best = 0;
  std::vector<double> values;
  values.reserve(sums.size());
  for (const std::vector<double>& of_turn : sums) values.push_back(Sum(of_turn, without));
  for (size_t k = 1; k < values.size(); ++k) best = values[k] < values[best] ? k : best;
  if (best == 0 || best + 1 == values.size()) return static_cast<double>(best);
  const double bend = values[best - 1] - 2 * values[best] + values[best + 1];
  const double slope = (values[best + 1] - values[best - 1]) / 2;
  return static_cast<double>(best) - (bend > 0 ? std::clamp(slope / bend, -1.0, 1.0) : 0);
}

// The best of a circle of values that does not lie on the slopes of the very best's own valley.
size_t BestElsewhere(const std::vector<double>& values, size_t best) {
  const size_t num = values.size();
  const auto end_of_valley = [&](size_t step) {
    size_t k = best;
    for (size_t n = 0; n < num; ++n) {
      const size_t next = (k + step) % num;
      if (values[next] < values[k]) break;
      k = next;
    }
    return k;
  };
  const size_t last = end_of_valley(1);
  const size_t first = end_of_valley(num - 1);
  size_t elsewhere = best;
  for (size_t k = (last + 1) % num; k != first && k != best; k = (k + 1) % num) {
    if (elsewhere == best || values[k] < values[elsewhere]) elsewhere = k;
  }
  return elsewhere;
}

}  // namespace

SilhouetteTurn FindSilhouetteTurn(const std::vector<SilhouetteView>& first,
                                  const std::vector<SilhouetteView>& second, const TurntableAxis& axis) {
  SilhouetteTurn result;
  if (first.size() < kBlocksOfStation || second.size() < kBlocksOfStation) return result;
  const Contradiction contradiction(first, second, axis);
  if (contradiction.num_rays() == 0) return result;
  constexpr size_t kAll = SIZE_MAX;  // no block is left out
  std::vector<std::vector<double>> sums(kTurns);
  ParallelFor(kTurns, 0, [&](int64_t k) {
    sums[static_cast<size_t>(k)] = contradiction.At(2 * kPi * static_cast<double>(k) / kTurns, kSearchStride);
  });
  std::vector<double> totals;
  totals.reserve(sums.size());
  for (const std::vector<double>& of_turn : sums) totals.push_back(Sum(of_turn, kAll));
  const auto best = static_cast<size_t>(std::min_element(totals.begin(), totals.end()) - totals.begin());
  const size_t elsewhere = BestElsewhere(totals, best);
  if (elsewhere == best) return result;
  const auto rays = static_cast<double>(contradiction.num_rays());
  for (const size_t k : {best, elsewhere})
    sums[k] = contradiction.At(2 * kPi * static_cast<double>(k) / kTurns, 1);
  result.error_px = std::sqrt(Sum(sums[best], kAll) / rays);
  result.elsewhere_px = std::sqrt(Sum(sums[elsewhere], kAll) / rays);
  const size_t blocks = sums[best].size();
  double mean = 0;
  double squares = 0;
  for (size_t b = 0; b < blocks; ++b) {
    const double difference = sums[elsewhere][b] - sums[best][b];
    mean += difference / static_cast<double>(blocks);
    squares += difference * difference;
  }
  const auto n = static_cast<double>(blocks);
  const double variance = std::max(0.0, squares - n * mean * mean) / (n - 1);
  result.t = variance > 0 ? mean / std::sqrt(variance / n) : 0;
  result.is_told = result.t > kCertainT;
  std::vector<std::vector<double>> fine(kFineTurns);
  const double start_rad = 2 * kPi * static_cast<double>(best) / kTurns - kFineReach * kFineDeg * kDegree;
  ParallelFor(kFineTurns, 0, [&](int64_t k) {
    fine[static_cast<size_t>(k)] =
        contradiction.At(start_rad + static_cast<double>(k) * kFineDeg * kDegree, 1);
  });
  const double place = LowestPlace(fine, kAll);
  // On the border of what was looked at closely, the lowest place lies elsewhere than the search saw it.
  result.is_told = result.is_told && place > 0 && place < kFineTurns - 1;
  result.turn_rad = WrapAngle(start_rad + place * kFineDeg * kDegree);
  double spread = 0;
  for (size_t b = 0; b < blocks; ++b) {
    const double off = LowestPlace(fine, b) - place;
    spread += off * off;
  }
  result.sigma_rad = std::hypot(std::sqrt((n - 1) / n * spread) * kFineDeg * kDegree,
                                result.error_px / contradiction.px_per_rad());
  return result;
}

}  // namespace s2gs
