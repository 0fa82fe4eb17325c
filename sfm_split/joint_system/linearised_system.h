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

/// The normal equations of a joint system where its parameters stand, weighed as the robust loss says, its
/// columns scaled to a length of about 1 by the first linearisation. What observations of a photo see of one
/// body they see by the same columns, so that products of derivatives are summed photo by photo, and by point
/// for the points' part; no derivative is kept. Sums are taken over parts of the points, in the parts' order:
/// the same bits for any number of threads.
class LinearisedSystem {
 public:
  /// Parts of the points: as many threads at most can work.
  static constexpr int kParts = 16;
  /// Two poses and COLMAP's largest camera model.
  static constexpr int kMaxColumns = 6 + 6 + 12;

  /// Columns by the point's coordinates.
  using PointRows = Eigen::Matrix<double, Eigen::Dynamic, 3>;

  struct Point {
    double* values;
    size_t begin, end;             ///< its observations.
    const int* columns = nullptr;  ///< that its observations depend on, ascending.
    double* by_both = nullptr;     ///< second derivatives by these and by itself: three columns.
    int num_columns = 0;
    Eigen::Vector3d scale = Eigen::Vector3d::Ones();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    Eigen::Matrix3d square = Eigen::Matrix3d::Zero();  ///< second derivatives by itself.
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
  /// Second derivatives by the columns, priors included: the lower triangle.
  const Eigen::MatrixXd& square() const { return square_; }
  /// By the columns, of half the sum of squares.
  const Eigen::VectorXd& gradient() const { return gradient_; }

  /// Where the parameters stand: half the sum of the loss, priors included.
  double Cost();
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
  struct PriorRow {
    double residual = 0;
    std::vector<std::pair<int, double>> columns;  // derivatives
  };
  // What a photo sees of one body.
  struct Sight {
    size_t term = 0;  // any of its own, which stands for all
    int size = 0;     // columns
    std::array<int, kMaxColumns> columns;
    std::array<std::pair<int, int>, kMaxColumns>
        values;                     // of each column: block among the term's, and place in it
    size_t first_sum = 0;           // in a part's sums
    ReprojectionCost::Frame frame;  // where the parameters stand
    int NumSums() const { return size * (size + 1) / 2 + size; }
  };

  // What its points have.
  struct Part {
    std::vector<int> columns;  // point by point
    std::vector<double> by_both;
    std::vector<int> places;   // of a sight's columns among the point's, observation by observation
    std::vector<double> sums;  // of all sights: lower triangles, and gradients
  };

  void ListColumns();
  void SortByPoint();
  void ListSights();
  void ListColumnsOfPoints(size_t part);
  void EvaluatePrior(const PriorTerm& prior, PriorRow* row) const;
  void TakeFrames(bool with_derivatives);
  void LinearisePart(size_t part);
  void AddTerm(size_t at, Part* part, Point* point);
  void ScalePoint(const Eigen::Vector3d& scale, Point* point);
  void SumSights();
  void AddPriors();
  void ScaleColumns();

  const JointSystem& system_;
  const ceres::LossFunction* loss_;
  int num_threads_ = 1;
  std::array<Part, kParts> parts_;
  std::vector<Place> columns_;
  std::vector<std::vector<int>> column_of_;  // by block and value; -1: held
  std::vector<size_t> terms_;                // by point
  std::vector<Point> points_;
  std::array<size_t, kParts + 1> part_begin_{};  // in points_
  std::vector<Sight> sights_;
  std::vector<int> sight_of_;        // in the order of terms_
  std::vector<size_t> first_place_;  // likewise: in its part's places
  Eigen::MatrixXd square_;
  Eigen::VectorXd gradient_;
  std::vector<double> kept_columns_;
  std::vector<Eigen::Vector3d> kept_points_;
  bool is_scaled_ = false;
};

}  // namespace s2gs
