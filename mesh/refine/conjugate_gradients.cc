#include "mesh/refine/conjugate_gradients.h"

#include <cstddef>

namespace s2gs {
namespace {

constexpr int kMaxIterations = 300;
// Of the residual's square, preconditioned.
constexpr double kConverged = 1e-8;

double Dot(const std::vector<double>& a, const std::vector<double>& b) {
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
  return sum;
}

}  // namespace

std::vector<double> SolveByConjugateGradients(const MatrixProduct& multiply,
                                              const std::vector<double>& diagonal,
                                              const std::vector<double>& right) {
  const size_t count = right.size();
  std::vector<double> x(count, 0);
  std::vector<double> residual = right;
  std::vector<double> scaled(count);
  for (size_t i = 0; i < count; ++i) scaled[i] = residual[i] / diagonal[i];
  std::vector<double> direction = scaled;
  std::vector<double> image(count);
  double error = Dot(residual, scaled);
  const double first_error = error;
  for (int iteration = 0; iteration < kMaxIterations && error > kConverged * first_error; ++iteration) {
    multiply(direction, &image);
    const double length = error / Dot(direction, image);
    for (size_t i = 0; i < count; ++i) {
      x[i] += length * direction[i];
      residual[i] -= length * image[i];
      scaled[i] = residual[i] / diagonal[i];
    }
    const double next_error = Dot(residual, scaled);
    for (size_t i = 0; i < count; ++i) direction[i] = scaled[i] + next_error / error * direction[i];
    error = next_error;
  }
  return x;
}

}  // namespace s2gs
