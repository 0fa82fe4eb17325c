#include "sfm_split/circular_motion/match_mixture.h"

#include <algorithm>
#include <cmath>
#include <iterator>

namespace s2gs {
namespace {

constexpr int kShareRounds = 6;  // of expectation and maximisation, from a half

// Not summed on the way: divisions go several at a time.
void FindProbabilities(const std::vector<double>& over, double share, std::vector<double>* right) {
  const size_t num = over.size();
  right->resize(num);
  const double* const from = over.data();
  double* const to = right->data();
  for (size_t m = 0; m < num; ++m) to[m] = RightProbability(from[m], share);
}

}  // namespace

double RightShare(const std::vector<double>& over) {
  std::vector<double> possible;  // the others are wrong whatever the share
  possible.reserve(over.size());
  std::copy_if(over.begin(), over.end(), std::back_inserter(possible), [](double o) { return o != 0; });
  std::vector<double> right;
  // As if one match more were right and one more wrong: the share stays inside (0, 1).
  double share = 0.5;
  for (int k = 0; k < kShareRounds; ++k) {
    FindProbabilities(possible, share, &right);
    double sum = 1;
    for (const double probability : right) sum += probability;
    share = sum / (static_cast<double>(over.size()) + 2);
  }
  return share;
}

std::vector<double> RightProbabilities(const std::vector<double>& over, double share) {
  std::vector<double> right;
  FindProbabilities(over, share, &right);
  return right;
}

double MixtureGain(const std::vector<double>& over, double share) {
  const double wrong = std::log(1 - share);
  double gain = 0;
  for (const double o : over) gain += o == 0 ? wrong : std::log(1 - share + share * o);
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
