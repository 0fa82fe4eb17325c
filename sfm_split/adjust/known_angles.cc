#include "sfm_split/adjust/known_angles.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
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

constexpr size_t kLeastStated = 3;    // a constant, and two that could contradict it
constexpr double kHalfSpacing = 0.5;  // beyond it an angle is nearer to another photo's
constexpr double kFactorSigmas = 4;   // a factor that is off by more is no chance: 6e-5 with two sides
constexpr size_t kMaxNamed = 5;       // photos that one message names

struct Image {
  int index = 0;
  double stated = 0;    // [rad]
  double adjusted = 0;  // [rad]
};

// Between stated angles that follow each other around the circle; those that are equal count once.
double Spacing(const std::vector<Image>& images) {
  std::vector<double> around;
  around.reserve(images.size());
  for (const Image& image : images) around.push_back(WrapAngle(image.stated));
  std::sort(around.begin(), around.end());
  std::vector<double> gaps;
  for (size_t i = 1; i < around.size(); ++i) {
    if (around[i] - around[i - 1] > kLeastWidthRad) gaps.push_back(around[i] - around[i - 1]);
  }
  return gaps.empty() ? 0 : UpperMedian(std::move(gaps));
}

// The constant that leaves the smallest sum of absolute deviations, among those of single images.
std::pair<double, double> BestOffset(const std::vector<Image>& images, double sign) {
  double best_offset = 0;
  double best_sum = std::numeric_limits<double>::infinity();
  for (const Image& candidate : images) {
    const double offset = candidate.adjusted - sign * candidate.stated;
    double sum = 0;
    for (const Image& image : images)
      sum += std::abs(WrapAngle(image.adjusted - sign * image.stated - offset));
    if (sum >= best_sum) continue;
    best_sum = sum;
    best_offset = offset;
  }
  return {best_offset, best_sum};
}

// Fills everything but the prior's width. Returns the scatter in the directions that the constant leaves.
AngleScatter Compare(const std::vector<Image>& images, const std::vector<int>& columns,
                     const MatrixXd& covariance, double inflation, KnownAngles* result) {
  result->spacing_rad = Spacing(images);
  const auto [offset_up, sum_up] = BestOffset(images, 1);
  const auto [offset_down, sum_down] = BestOffset(images, -1);
  const double sign = sum_up <= sum_down ? 1 : -1;
  const double rough = sum_up <= sum_down ? offset_up : offset_down;
  std::vector<Image> kept;
  for (const Image& image : images) {
    const double deviation = WrapAngle(image.adjusted - sign * image.stated - rough);
    if (std::abs(deviation) > kHalfSpacing * result->spacing_rad) {
      result->contradicts.push_back(image.index);
    } else {
      kept.push_back(image);
    }
  }
  result->is_believed =
      result->spacing_rad > 0 && kept.size() >= kLeastStated && 2 * kept.size() > images.size();
  if (!result->is_believed) return {};
  const auto num = static_cast<Eigen::Index>(kept.size());
  VectorXd deviations(num);
  VectorXd stated(num);
  MatrixXd of_angles(num, num);
  for (Eigen::Index a = 0; a < num; ++a) {
    const Image& image = kept[static_cast<size_t>(a)];
    deviations(a) = WrapAngle(image.adjusted - sign * image.stated - rough);
    stated(a) = sign * image.stated;
    for (Eigen::Index b = 0; b < num; ++b) {
      const int i = columns[static_cast<size_t>(image.index)];
      const int j = columns[static_cast<size_t>(kept[static_cast<size_t>(b)].index)];
      of_angles(a, b) = i < 0 || j < 0 ? 0 : inflation * covariance(i, j);
    }
    result->prior.places.push_back({image.index, image.stated});
  }
  const double mean = deviations.mean();
  result->prior.closes = true;  // the step is known: stated angles are angles
  result->prior.step_rad = sign;
  result->prior.offset_rad = rough + mean;
  const VectorXd centred = deviations.array() - mean;
  result->scatter_rad = std::sqrt(centred.squaredNorm() / static_cast<double>(num));
  const VectorXd lever = stated.array() - stated.mean();
  if (lever.squaredNorm() > 0 && num > 2) {
    const double slope = lever.dot(centred) / lever.squaredNorm();
    const double left = (centred - slope * lever).squaredNorm() / static_cast<double>(num - 2);
    result->factor = 1 + slope;
    // Of the scatter, and of the errors that the adjusted angles share: those of a partial turn's length.
    const double shared = lever.dot(of_angles * lever) / (lever.squaredNorm() * lever.squaredNorm());
    result->factor_sigma = std::sqrt(left / lever.squaredNorm() + shared);
  }
  return ScatterBeside(MatrixXd::Ones(num, 1), of_angles, centred);
}

std::string Degrees(double rad) {
  std::string text = std::to_string(rad / kDegree);
  text.resize(text.find('.') + 4);
  return text;
}

}  // namespace

std::vector<KnownAngles> CompareKnownAngles(const JointProblem& problem, const std::vector<int>& stations,
                                            const std::vector<std::optional<double>>& stated_rad,
                                            const JointReport& report) {
  if (problem.free_object || !report.observability.computed) return {};
  const std::vector<int> columns = AngleColumns(problem, report);
  const double inflation = DataInflation(problem, report);
  std::map<int, std::vector<Image>> of_station;
  for (size_t i = 0; i < problem.images.size(); ++i) {
    if (!stated_rad[i]) continue;
    of_station[stations[i]].push_back({static_cast<int>(i), *stated_rad[i], problem.images[i].angle_rad});
  }
  std::vector<KnownAngles> result;
  std::vector<AngleScatter> scatters;
  for (const auto& [station, images] : of_station) {
    if (images.size() < kLeastStated) continue;
    KnownAngles angles;
    angles.station = station;
    AngleScatter scatter = Compare(images, columns, report.observability.covariance, inflation, &angles);
    if (angles.is_believed) scatters.push_back(std::move(scatter));
    result.push_back(std::move(angles));
  }
  const double width = LargestWidthRad(scatters);
  for (KnownAngles& angles : result) angles.prior.sigma_rad = width;
  return result;
}

std::optional<std::string> DescribeContradiction(const KnownAngles& angles, const JointProblem& problem) {
  std::string text;
  if (!angles.contradicts.empty()) {
    text = std::to_string(angles.contradicts.size()) + " of " +
           std::to_string(angles.contradicts.size() + angles.prior.places.size()) + " stated angles";
    if (!angles.is_believed) {
      text = "the stated angles of station " + std::to_string(angles.station) +
             " are not those of the photos, and were not used: " + std::to_string(angles.contradicts.size());
    }
    text += " differ from the photos' by more than half a step (";
    for (size_t i = 0; i < std::min(kMaxNamed, angles.contradicts.size()); ++i) {
      text += (i > 0 ? ", " : "") + problem.images[static_cast<size_t>(angles.contradicts[i])].name;
    }
    text += angles.contradicts.size() > kMaxNamed ? ", ...)" : ")";
  }
  if (angles.is_believed && std::abs(angles.factor - 1) > kFactorSigmas * angles.factor_sigma) {
    text += (text.empty() ? "the stated angles of station " + std::to_string(angles.station) : "; they") +
            " fit best when multiplied by " + std::to_string(angles.factor) + " +- " +
            std::to_string(angles.factor_sigma) + ": is the step right?";
  }
  if (text.empty()) return std::nullopt;
  if (angles.is_believed) {
    text += std::string(text.back() == '?' ? "" : ".") + " The rest scatter by " +
            Degrees(angles.scatter_rad) + " degrees";
  }
  return text;
}

}  // namespace s2gs
