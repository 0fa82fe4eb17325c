#include "sfm_split/adjust/equal_steps.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <utility>

#include "sfm_split/adjust/angle_scatter.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr size_t kLeastImages = 6;  // of a station: two unknowns and some scatter
constexpr double kHalfStep = 0.5;   // scatter beyond it is no scatter about steps

// Places of images that stand about equal steps in the order of their angles, from after the widest gap on;
// none where two share a place. A gap of several steps is so many places.
std::vector<std::pair<int, int>> PlacesByAngle(const std::vector<std::pair<int, int>>& order,
                                               const JointProblem& problem) {
  if (order.size() < kLeastImages) return {};
  std::vector<std::pair<double, int>> around;
  around.reserve(order.size());
  for (const auto& [place, image] : order)
    around.emplace_back(WrapAngle(problem.images[static_cast<size_t>(image)].angle_rad), image);
  std::sort(around.begin(), around.end());
  const size_t num = around.size();
  std::vector<double> gaps;  // before each
  gaps.reserve(num);
  for (size_t k = 0; k < num; ++k)
    gaps.push_back(k == 0 ? around[0].first + 2 * kPi - around[num - 1].first
                          : around[k].first - around[k - 1].first);
  const auto first = static_cast<size_t>(std::max_element(gaps.begin(), gaps.end()) - gaps.begin());
  const double step = UpperMedian(gaps);
  std::vector<std::pair<int, int>> places = {{0, around[first].second}};
  for (size_t k = 1; k < num; ++k) {
    const size_t i = (first + k) % num;
    const auto steps = static_cast<int>(std::lround(gaps[i] / step));
    if (steps < 1) return {};
    places.emplace_back(places.back().first + steps, around[i].second);
  }
  return places;
}

double RootMeanSquare(const AngleScatter& scatter) {
  return scatter.deviations.norm() /
         std::sqrt(std::max<double>(1, static_cast<double>(scatter.deviations.size())));
}

struct Station {
  EqualStepsPrior steps;
  AngleScatter scatter;
};

// Nothing (no places) where the images are too few or their angles no steps.
Station FitSteps(std::vector<std::pair<int, int>> order, int num_photos, const JointProblem& problem,
                 const std::vector<int>& columns, const MatrixXd& covariance, double inflation) {
  Station result;
  if (order.size() < kLeastImages) return result;
  std::sort(order.begin(), order.end());
  const auto angle = [&](size_t k) { return problem.images[static_cast<size_t>(order[k].second)].angle_rad; };
  std::vector<double> single;
  for (size_t k = 1; k < order.size(); ++k) {
    if (order[k].first - order[k - 1].first == 1) single.push_back(WrapAngle(angle(k) - angle(k - 1)));
  }
  if (order.size() < kLeastImages || 2 * single.size() < order.size()) return result;
  const double step = UpperMedian(single);
  const auto num = static_cast<Eigen::Index>(order.size());
  VectorXd unwrapped(num);
  VectorXd places(num);
  unwrapped(0) = angle(0);
  places(0) = order[0].first;
  for (Eigen::Index k = 1; k < num; ++k) {
    places(k) = order[static_cast<size_t>(k)].first;
    const double expected = unwrapped(k - 1) + step * (places(k) - places(k - 1));
    unwrapped(k) = expected + WrapAngle(angle(static_cast<size_t>(k)) - expected);
  }
  MatrixXd design(num, 2);
  design.col(0).setOnes();
  design.col(1) = places;
  const Eigen::Vector2d open = design.colPivHouseholderQr().solve(unwrapped);
  const double whole = (open(1) < 0 ? -2 : 2) * kPi / num_photos;
  const bool closes = std::abs(open(1) - whole) * num_photos < kHalfStep * std::abs(whole);
  const VectorXd centred = unwrapped - (closes ? whole : open(1)) * places;
  const double offset = closes ? centred.mean() : open(0);
  if ((centred.array() - offset).abs().maxCoeff() > kHalfStep * std::abs(open(1))) return result;
  if (closes) design.conservativeResize(Eigen::NoChange, 1);

  MatrixXd of_angles(num, num);
  for (Eigen::Index a = 0; a < num; ++a) {
    for (Eigen::Index b = 0; b < num; ++b) {
      const int i = columns[static_cast<size_t>(order[static_cast<size_t>(a)].second)];
      const int j = columns[static_cast<size_t>(order[static_cast<size_t>(b)].second)];
      of_angles(a, b) = i < 0 || j < 0 ? 0 : inflation * covariance(i, j);
    }
  }
  result.scatter = ScatterBeside(design, of_angles, centred);
  result.steps.closes = closes;
  result.steps.step_rad = closes ? whole : open(1);
  result.steps.offset_rad = offset;
  for (const auto& [place, image] : order) result.steps.places.push_back({image, static_cast<double>(place)});
  return result;
}

}  // namespace

std::vector<int> AngleColumns(const JointProblem& problem, const JointReport& report) {
  // As JointSystem counts: poses, cameras, the axis, angles.
  const auto first = static_cast<int>(problem.cam_from_world.size() + problem.cameras.size() + 1);
  std::vector<int> columns(problem.images.size(), -1);
  for (size_t k = 0; k < report.observability.parameters.size(); ++k) {
    const int image = report.observability.parameters[k].first - first;
    if (image >= 0 && image < static_cast<int>(columns.size())) columns[image] = static_cast<int>(k);
  }
  return columns;
}

std::vector<EqualStepsPrior> FindEqualSteps(const JointProblem& problem,
                                            const std::vector<CapturePlace>& places,
                                            const JointReport& report) {
  if (problem.free_object || !report.observability.computed) return {};
  const std::vector<int> columns = AngleColumns(problem, report);
  const double inflation = DataInflation(problem, report);
  std::map<int, std::vector<std::pair<int, int>>> of_station;
  std::map<int, int> num_photos;
  for (size_t i = 0; i < places.size(); ++i) {
    of_station[places[i].station].emplace_back(places[i].place, static_cast<int>(i));
    num_photos[places[i].station] = places[i].num_photos;
  }
  std::vector<Station> stations;
  for (const auto& [station, order] : of_station) {
    const int count = num_photos[station];
    const auto fit = [&](std::vector<std::pair<int, int>> in_order) {
      return FitSteps(std::move(in_order), count, problem, columns, report.observability.covariance,
                      inflation);
    };
    Station fitted = fit(order);
    Station by_angle = fit(PlacesByAngle(order, problem));
    // Names are no order of capture where photos lie farther from their places than from each other's.
    if (!by_angle.steps.places.empty() &&
        (fitted.steps.places.empty() ||
         RootMeanSquare(fitted.scatter) > kHalfStep * std::abs(by_angle.steps.step_rad))) {
      fitted = std::move(by_angle);
    }
    if (!fitted.steps.places.empty()) stations.push_back(std::move(fitted));
  }
  if (stations.empty()) return {};
  std::vector<AngleScatter> scatters;
  scatters.reserve(stations.size());
  for (const Station& station : stations) scatters.push_back(station.scatter);
  const double width = LargestWidthRad(scatters);
  std::vector<EqualStepsPrior> result;
  for (Station& station : stations) {
    station.steps.sigma_rad = width;
    result.push_back(std::move(station.steps));
  }
  return result;
}

double DataInflation(const JointProblem& problem, const JointReport& report) {
  if (problem.free_object || !report.observability.computed) return 1;
  const Observability& of = report.observability;
  std::vector<double> ratios;
  for (const int k : AngleColumns(problem, report)) {
    if (k < 0 || !(of.covariance(k, k) > 0)) continue;
    ratios.push_back(std::max(of.robust_covariance(k, k), of.regional_covariance(k, k)) /
                     of.covariance(k, k));
  }
  return ratios.empty() ? 1 : std::max(1.0, UpperMedian(std::move(ratios)));
}

}  // namespace s2gs
