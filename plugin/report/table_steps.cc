#include "plugin/report/table_steps.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr double kMinStepDeg = 0.5;

// To [-180, 180].
double Wrapped(double degrees) { return std::remainder(degrees, 360.0); }

double LargestGap(std::vector<double> angles) {
  for (double& angle : angles) angle -= 360 * std::floor(angle / 360);
  std::sort(angles.begin(), angles.end());
  double gap = angles.front() + 360 - angles.back();
  for (size_t i = 1; i < angles.size(); ++i) gap = std::max(gap, angles[i] - angles[i - 1]);
  return gap;
}

StationSteps StepsOf(int station, const std::map<std::string, double>& angle_by_name) {
  StationSteps steps;
  steps.station = station;
  std::vector<double> angles;
  for (const auto& [name, angle] : angle_by_name) {
    steps.photos.push_back(name);
    angles.push_back(angle);
  }
  steps.largest_gap_deg = LargestGap(angles);
  steps.step_deg = std::numeric_limits<double>::quiet_NaN();
  steps.spread_deg = std::numeric_limits<double>::quiet_NaN();
  if (angles.size() < 2) return steps;
  std::vector<double> turns;
  for (size_t i = 1; i < angles.size(); ++i) turns.push_back(Wrapped(angles[i] - angles[i - 1]));
  steps.step_deg = Summarize(turns).median;
  if (std::abs(steps.step_deg) < kMinStepDeg || angles.size() < 3) return steps;

  // Number of steps up to each photo; then the step and the offset again, from all of them.
  std::vector<double> places = {0};
  std::vector<double> unwrapped = {angles[0]};
  for (const double turn : turns) {
    const double missed = std::max(1.0, std::round(turn / steps.step_deg));
    places.push_back(places.back() + missed);
    unwrapped.push_back(unwrapped.back() + turn);
  }
  std::vector<double> slopes;
  for (size_t a = 0; a < places.size(); ++a) {
    for (size_t b = a + 1; b < places.size(); ++b) {
      slopes.push_back((unwrapped[b] - unwrapped[a]) / (places[b] - places[a]));
    }
  }
  steps.step_deg = Summarize(slopes).median;  // Theil and Sen's
  for (size_t i = 0; i < places.size(); ++i) {
    steps.deviations_deg.push_back(unwrapped[i] - places[i] * steps.step_deg);
  }
  const double offset = Summarize(steps.deviations_deg).median;
  std::vector<double> sizes;
  for (double& deviation : steps.deviations_deg) {
    deviation -= offset;
    sizes.push_back(std::abs(deviation));
  }
  steps.spread_deg = kSigmaOfMad * Summarize(sizes).median;
  return steps;
}

}  // namespace

std::vector<StationSteps> FindSteps(const TurntableFile& turntable) {
  std::map<int, std::map<std::string, double>> stations;
  for (const TurntableImage& image : turntable.images) stations[image.station][image.name] = image.angle_deg;
  std::vector<StationSteps> steps;
  steps.reserve(stations.size());
  for (const auto& [station, angles] : stations) steps.push_back(StepsOf(station, angles));
  return steps;
}

}  // namespace s2gs
