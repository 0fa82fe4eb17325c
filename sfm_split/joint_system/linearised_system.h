#pragma once

#include <ceres/loss_function.h>

#include <Eigen/Core>
#include <array>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/joint_system/joint_system.h"

namespace s2gs {

/// A joint system's residuals and their derivatives where its parameters stand, weighed as the robust loss
/// says, point by point, its columns scaled to a length of about 1 by the first linearisation. Sums are taken
/// over parts of the points, in the parts' order: the same bits for any number of threads.
class LinearisedSystem {
 public:
  /// Parts of the points: as many threads at most can work.
  static constexpr int kParts = 16;
  /// Two poses and COLMAP's largest camera model.
  static constexpr int kMaxColumns = 6 + 6 + 12;

  /// An observation: residual and derivatives with the loss' weight, columns scaled.
  struct Row {
    Eigen::Vector2d residual;
    Eigen::Matrix<double, 2, 3> by_point;
    Eigen::Matrix<double, 2, kMaxColumns> by_camera;  ///< its first `size` columns.
    std::array<int, kMaxColumns> columns;             ///< of the system, each of these.
    int size = 0;
  };
  struct Point {
    double* values;
    size_t begin, end;  ///< its rows.
    Eigen::Vector3d scale = Eigen::Vector3d::Ones();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    Eigen::Vector3d squares = Eigen::Vector3d::Zero();  ///< of its columns.
  };
  struct PriorRow {
    double residual = 0;
    std::vector<std::pair<int, double>> columns;  ///< scaled derivatives.
  };

  /// \param loss  null for squares.
  LinearisedSystem(const JointSystem& system, const ceres::LossFunction* loss, int num_threads);

  Eigen::Index num_columns() const { return gradient_.size(); }
  /// Calls work(part) for all parts.
  template <typename Work>
  void ForParts(const Work& work) const {
    ParallelFor(kParts, num_threads_, [&](int64_t part) { work(static_cast<size_t>(part)); });
  }
  /// Sums work(part) over the parts, in their order.
  template <typename Work>
  double SumParts(const Work& work) const {
    std::array<double, kParts> sums{};
    ForParts([&](size_t part) { sums[part] = work(part); });
    double sum = 0;
    for (const double one : sums) sum += one;
    return sum;
  }
  /// The part's points are [begin, end).
  size_t PartBegin(size_t part) const { return part_begin_[part]; }
  size_t PartEnd(size_t part) const { return part_begin_[part + 1]; }

  const std::vector<Point>& points() const { return points_; }
  const std::vector<Row>& rows() const { return rows_; }
  const std::vector<PriorRow>& prior_rows() const { return prior_rows_; }
  /// By the columns, scaled: of half the sum of squares, and the columns' squared lengths.
  const Eigen::VectorXd& gradient() const { return gradient_; }
  const Eigen::VectorXd& squares() const { return squares_; }

  /// Where the parameters stand: half the sum of the loss, priors included.
  double Cost() const;
  void Linearise();
  /// The largest derivative by a parameter, unscaled.
  double GradientNorm() const;
  /// Moves the parameters by scaled steps. Returns the lengths of the step and of what was moved.
  std::pair<double, double> MoveBy(const Eigen::VectorXd& step,
                                   const std::vector<Eigen::Vector3d>& point_steps);
  void Keep();
  void GoBack();

 private:
  struct Place {
    double* value;
    double scale = 1;  // of the column
  };

  void ListColumns();
  void SortByPoint();
  void EvaluatePrior(const PriorTerm& prior, PriorRow* row) const;
  void LineariseTerm(size_t at);
  void ScaleColumns();
  void SumColumns();

  const JointSystem& system_;
  const ceres::LossFunction* loss_;
  int num_threads_ = 1;
  std::vector<Place> columns_;
  std::vector<std::vector<int>> column_of_;  // by block and value; -1: held
  std::vector<size_t> terms_;                // by point
  std::vector<Point> points_;
  std::array<size_t, kParts + 1> part_begin_{};  // in points_
  std::vector<Row> rows_;                        // in the order of terms_
  std::vector<PriorRow> prior_rows_;
  Eigen::VectorXd gradient_, squares_;
  std::vector<double> kept_columns_;
  std::vector<Eigen::Vector3d> kept_points_;
  bool is_scaled_ = false;
};

}  // namespace s2gs
