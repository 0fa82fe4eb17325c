#pragma once

#include <functional>
#include <vector>

namespace s2gs {

/// A symmetric positive definite matrix: writes its product with the first vector into the second, which has
/// the size already.
using MatrixProduct = std::function<void(const std::vector<double>&, std::vector<double>*)>;

/// The solution of matrix x = right from x = 0, preconditioned by the matrix's diagonal: until the residual's
/// square has fallen to 1e-8, or after 300 steps. Sums are in one order, whatever the number of threads.
std::vector<double> SolveByConjugateGradients(const MatrixProduct& multiply,
                                              const std::vector<double>& diagonal,
                                              const std::vector<double>& right);

}  // namespace s2gs
