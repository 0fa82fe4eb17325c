#pragma once

#include <Eigen/Core>
#include <functional>
#include <utility>
#include <vector>

namespace s2gs {

/// A normal prior on a sum of parameters or of their logarithms, or on what a function makes of them, in the
/// unit of reprojection errors.
struct PriorTerm {
  struct Part {
    int block = 0;
    int value = 0;  ///< place in the block.
    double factor = 1;
  };
  std::vector<Part> parts;
  bool of_logarithms = false;
  /// In place of the sum: of the parts' values, with the derivatives by these unless they are null.
  std::function<double(const std::vector<double>& values, std::vector<double>* derivatives)> function;
  double mean = 0;
  double sigma = 1;
  double scale_px = 1;   ///< residual of one sigma.
  bool is_seen = false;  ///< by the photos: what results owe to it is no share of what was known before.

  /// \param values      one per part.
  /// \param derivatives null, or one per part.
  double Residual(const std::vector<double>& values, std::vector<double>* derivatives) const;
};

}  // namespace s2gs
