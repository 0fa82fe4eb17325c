#include "sfm_split/turntable/match_mixture.h"

#include <algorithm>
#include <cmath>

namespace s2gs {
namespace {

constexpr int kShareRounds = 6;

}  // namespace

double RightShare(const std::vector<double>& over) {
  double share = 0.5;
  for (int k = 0; k < kShareRounds; ++k) {
    double sum = 1;
    for (const double o : over) sum += RightProbability(o, share);
    share = sum / (static_cast<double>(over.size()) + 2);
  }
  return share;
}

double MixtureGain(const std::vector<double>& over, double share) {
  double gain = 0;
  for (const double o : over) gain += std::log(1 - share + share * o);
  return gain;
}

void KeypointExtent::Add(const Eigen::Vector2d& xy) {
  sum_ += xy;
  squares_ += xy.cwiseAbs2();
  num_ += 1;
}

double KeypointExtent::Px() const {
  if (num_ == 0) return 1;
  return kUniformWidth * std::sqrt(std::max(1.0, (squares_ / num_ - (sum_ / num_).cwiseAbs2()).mean()));
}

}  // namespace s2gs
