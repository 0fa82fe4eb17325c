#include "sfm_split/photo_tracks/patch_alignment.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "sfm_split/base/number_text.h"
#include "sfm_split/scene/projection_jacobians.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::Matrix2d;
using Eigen::MatrixX2d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Matrix6d = Eigen::Matrix<double, 6, 6>;
using MatrixX6d = Eigen::Matrix<double, Eigen::Dynamic, 6>;
using Vector6d = Eigen::Matrix<double, 6, 1>;

constexpr double kSettledPx = 0.002;   // a judgement: far below what a patch errs by
constexpr int kNormalRounds = 8;       // at most
constexpr double kSettledTilt = 0.01;  // rise over run: .07 px at the rim of a patch of 7 px
constexpr int kMeanRounds = 2;  // each moves what the others' mean is made of: a second one corrects for that
constexpr double kMaxTilt = 0.5;           // of one step of the normal
constexpr double kLeastCorrelation = 0.5;  // while the normal is not known
constexpr double kLeastFacing = 0.2;       // cosine between normal and ray

// A patch's nodes: a square grid of unit distance, of which those in a disc count.
class Grid {
 public:
  explicit Grid(int radius) : radius_(radius) {
    const double reach = (radius - 0.5) * (radius - 0.5);
    for (int v = -radius; v <= radius; ++v) {
      for (int u = -radius; u <= radius; ++u) {
        if (u * u + v * v <= reach) inner_.push_back(static_cast<int>((v + radius) * side() + u + radius));
      }
    }
  }
  int side() const { return 2 * radius_ + 1; }
  int size() const { return side() * side(); }
  Vector2d At(int node) const { return {node % side() - radius_, node / side() - radius_}; }
  const std::vector<int>& inner() const { return inner_; }
  // Whether the disc's central differences read it.
  bool IsNeeded(int node) const { return At(node).squaredNorm() <= (radius_ + 0.5) * (radius_ + 0.5); }

 private:
  int radius_;
  std::vector<int> inner_;
};

// What a photo's grey values are compared with: its columns are the values, 1, the slopes, and the place. As
// a surface turns before light that stays, its shade changes otherwise on one side of a patch than on the
// other: a ramp, which would pass for a shift.
struct Template {
  MatrixX6d design;
  Matrix6d inverse = Matrix6d::Zero();
  bool is_usable = false;
};

Template MakeTemplate(const Grid& grid, const VectorXd& values) {
  Template result;
  const std::vector<int>& inner = grid.inner();
  result.design.resize(static_cast<Eigen::Index>(inner.size()), 6);
  for (size_t i = 0; i < inner.size(); ++i) {
    const int node = inner[i];
    result.design.row(static_cast<Eigen::Index>(i)) << values[node], 1,
        (values[node + 1] - values[node - 1]) / 2,
        (values[node + grid.side()] - values[node - grid.side()]) / 2, grid.At(node).x(), grid.At(node).y();
  }
  const Matrix6d normal = result.design.transpose() * result.design;
  const Eigen::LDLT<Matrix6d> solver(normal);
  if (solver.info() != Eigen::Success || !solver.isPositive() || solver.rcond() < 1e-12) return result;
  result.inverse = solver.solve(Matrix6d::Identity());
  result.is_usable = true;
  return result;
}

// One photo's part of the alignment.
struct Aligned {
  bool is_usable = false;
  Vector2d centre;  // where the pose puts the patch [px]
  Matrix2d px_from_grid;
  Vector2d grid_per_rise;       // how the patch moves in the grid when the surface rises by a length
  std::vector<Vector2d> nodes;  // [px]
  Vector2d shift = Vector2d::Zero();
  VectorXd values;  // at the shifted nodes
  double gain = 1;
  double offset = 0;
  double correlation = 0;
  double sigma_px = std::numeric_limits<double>::infinity();
};

class Alignment {
 public:
  Alignment(const std::vector<PatchView>& views, size_t reference, const PatchOptions& options,
            SurfacePatch* patch)
      : views_(views),
        reference_(reference),
        options_(options),
        patch_(patch),
        grid_(options.radius_px),
        aligned_(views.size()) {}

  std::vector<PatchPlace> Run();

 private:
  bool Lay();
  bool Project(size_t view);
  bool Sample(Aligned* aligned, size_t view) const;
  void Align(size_t view, const Template& with, double min_correlation);
  void AlignAll(double min_correlation);
  bool TurnNormal();
  VectorXd MeanWithout(size_t view) const;
  size_t NumUsable() const {
    return static_cast<size_t>(
        std::count_if(aligned_.begin(), aligned_.end(), [](const Aligned& a) { return a.is_usable; }));
  }

  const std::vector<PatchView>& views_;
  size_t reference_;
  const PatchOptions& options_;
  SurfacePatch* patch_;
  Grid grid_;
  Vector3d along_u_;
  Vector3d along_v_;
  std::vector<Aligned> aligned_;
  Template first_;
};

// The grid on the plane: a step is a pixel of the reference.
bool Alignment::Lay() {
  const PatchView& view = views_[reference_];
  const Vector3d x_in_cam = view.cam_from_body * patch_->centre;
  Vector2d xy;
  Eigen::Matrix<double, 2, 3> jacobian;
  if (!ProjectWithJacobians(view.camera->model, view.camera->params.data(), x_in_cam, &xy, &jacobian,
                            nullptr))
    return false;
  const double px_per_length = jacobian.norm() / std::sqrt(2.0);
  along_u_ = patch_->normal.unitOrthogonal() / px_per_length;
  along_v_ = patch_->normal.cross(along_u_);
  return true;
}

bool Alignment::Project(size_t view) {
  const PatchView& of = views_[view];
  Aligned& aligned = aligned_[view];
  const Eigen::Matrix3d rotation = of.cam_from_body.rotation.toRotationMatrix();
  const Vector3d centre = of.cam_from_body * patch_->centre;
  const Vector3d u = rotation * along_u_;
  const Vector3d v = rotation * along_v_;
  const Vector3d normal = rotation * patch_->normal;
  if (-normal.dot(centre) < kLeastFacing * centre.norm()) return false;
  Eigen::Matrix<double, 2, 3> jacobian;
  const double* params = of.camera->params.data();
  if (!ProjectWithJacobians(of.camera->model, params, centre, &aligned.centre, &jacobian, nullptr))
    return false;
  aligned.px_from_grid << jacobian * u, jacobian * v;
  if (std::abs(aligned.px_from_grid.determinant()) < 1e-3) return false;
  aligned.grid_per_rise = aligned.px_from_grid.inverse() * (jacobian * normal);
  aligned.nodes.assign(static_cast<size_t>(grid_.size()), Vector2d::Zero());
  for (int node = 0; node < grid_.size(); ++node) {
    if (!grid_.IsNeeded(node)) continue;
    const Vector2d at = grid_.At(node);
    if (!ProjectWithJacobians(of.camera->model, params, centre + at.x() * u + at.y() * v,
                              &aligned.nodes[static_cast<size_t>(node)], nullptr, nullptr))
      return false;
  }
  return true;
}

bool Alignment::Sample(Aligned* aligned, size_t view) const {
  const SplinePart& photo = *views_[view].photo;
  aligned->values.setZero(grid_.size());
  for (int node = 0; node < grid_.size(); ++node) {
    if (!grid_.IsNeeded(node)) continue;
    const Vector2d at = aligned->nodes[static_cast<size_t>(node)] + aligned->shift;
    if (!photo.Contains(at.x(), at.y())) return false;
    aligned->values[node] = static_cast<double>(photo.Value(at.x(), at.y()));
  }
  return true;
}

VectorXd Inner(const Grid& grid, const VectorXd& values) {
  VectorXd result(static_cast<Eigen::Index>(grid.inner().size()));
  for (size_t i = 0; i < grid.inner().size(); ++i)
    result[static_cast<Eigen::Index>(i)] = values[grid.inner()[i]];
  return result;
}

// Of values of the inner nodes, whose places are symmetric: the parts of a ramp are orthogonal.
double SquaredWithoutRamp(const Grid& grid, const VectorXd& values) {
  double squared = (values.array() - values.mean()).square().sum();
  Vector2d along = Vector2d::Zero();
  Vector2d places = Vector2d::Zero();
  for (size_t i = 0; i < grid.inner().size(); ++i) {
    const Vector2d at = grid.At(grid.inner()[i]);
    along += values[static_cast<Eigen::Index>(i)] * at;
    places += at.cwiseProduct(at);
  }
  squared -= along.cwiseProduct(along).cwiseQuotient(places).sum();
  return std::max(0.0, squared);
}

void Alignment::Align(size_t view, const Template& with, double min_correlation) {
  Aligned& aligned = aligned_[view];
  aligned.is_usable = false;
  for (int i = 0; i < options_.max_iterations; ++i) {
    if (!Sample(&aligned, view)) return;
    const VectorXd values = Inner(grid_, aligned.values);
    const Vector6d fit = with.inverse * (with.design.transpose() * values);
    if (!(fit[0] > 0)) return;
    const Vector2d step = aligned.px_from_grid * (fit.segment<2>(2) / fit[0]);
    aligned.gain = fit[0];
    aligned.offset = fit[1];
    if (step.norm() > kSettledPx) {
      aligned.shift -= step;
      if (!(aligned.shift.norm() <= options_.max_move_px)) return;
      continue;
    }
    const double count = static_cast<double>(values.size());
    const double variance = SquaredWithoutRamp(grid_, values) / count;
    const double residual = (values - with.design * fit).squaredNorm() / (count - 6);
    aligned.correlation = std::sqrt(std::max(0.0, 1 - residual / std::max(variance, 1e-9)));
    const Matrix2d covariance = residual / (fit[0] * fit[0]) * aligned.px_from_grid *
                                with.inverse.block<2, 2>(2, 2) * aligned.px_from_grid.transpose();
    aligned.sigma_px = std::sqrt(
        Eigen::SelfAdjointEigenSolver<Matrix2d>(covariance, Eigen::EigenvaluesOnly).eigenvalues()[1]);
    aligned.is_usable = aligned.correlation >= min_correlation;
    return;
  }
}

// Every photo with the reference.
void Alignment::AlignAll(double min_correlation) {
  Aligned& reference = aligned_[reference_];
  reference.shift.setZero();
  reference.is_usable = Project(reference_) && Sample(&reference, reference_);
  if (!reference.is_usable) return;
  first_ = MakeTemplate(grid_, reference.values);
  reference.is_usable = first_.is_usable;
  reference.correlation = 1;
  if (!first_.is_usable) return;
  for (size_t k = 0; k < views_.size(); ++k) {
    if (k == reference_) continue;
    aligned_[k].is_usable = false;
    if (Project(k)) Align(k, first_, min_correlation);
  }
}

// A step of Gauss and Newton of the plane's slopes, each photo's shift, gain, offset and ramp eliminated.
bool Alignment::TurnNormal() {
  Matrix2d normal_matrix = Matrix2d::Zero();
  Vector2d right = Vector2d::Zero();
  const std::vector<int>& inner = grid_.inner();
  for (size_t k = 0; k < views_.size(); ++k) {
    const Aligned& aligned = aligned_[k];
    if (k == reference_ || !aligned.is_usable) continue;
    const Vector2d moves = aligned.grid_per_rise - aligned_[reference_].grid_per_rise;
    MatrixX2d columns(static_cast<Eigen::Index>(inner.size()), 2);
    for (size_t i = 0; i < inner.size(); ++i) {
      const auto row = static_cast<Eigen::Index>(i);
      const double slope = -first_.design.row(row).segment<2>(2).dot(moves);
      columns.row(row) = slope * grid_.At(inner[i]).transpose();
    }
    const VectorXd values = (Inner(grid_, aligned.values).array() - aligned.offset) / aligned.gain;
    const Vector6d fit = first_.inverse * (first_.design.transpose() * values);
    const VectorXd residuals = values - first_.design * fit;
    columns -= first_.design * (first_.inverse * (first_.design.transpose() * columns)).eval();
    normal_matrix += columns.transpose() * columns;
    right += columns.transpose() * residuals;
  }
  const Eigen::SelfAdjointEigenSolver<Matrix2d> solver(normal_matrix);
  if (!(solver.eigenvalues()[0] > 0)) return false;
  Vector2d rise = normal_matrix.ldlt().solve(right);
  const double step = along_u_.norm();
  // Rises are lengths over grid steps, which are such lengths that a pixel is one of the reference.
  const double tilt = rise.norm() / step;
  if (!(tilt > kSettledTilt)) return false;
  if (tilt > kMaxTilt) rise *= kMaxTilt / tilt;
  const Vector3d normal =
      (along_u_ + rise.x() * patch_->normal).cross(along_v_ + rise.y() * patch_->normal).normalized();
  patch_->normal = normal.dot(patch_->normal) > 0 ? normal : Vector3d(-normal);
  return true;
}

VectorXd Alignment::MeanWithout(size_t view) const {
  VectorXd sum = VectorXd::Zero(grid_.size());
  int count = 0;
  for (size_t k = 0; k < aligned_.size(); ++k) {
    if (k == view || !aligned_[k].is_usable) continue;
    sum += ((aligned_[k].values.array() - aligned_[k].offset) / aligned_[k].gain).matrix();
    ++count;
  }
  return sum / std::max(1, count);
}

std::vector<PatchPlace> Alignment::Run() {
  std::vector<PatchPlace> places(views_.size());
  for (int round = 0;; ++round) {
    if (!Lay()) return places;
    const bool is_last = round == kNormalRounds;
    AlignAll(std::min(kLeastCorrelation, options_.min_correlation));
    if (NumUsable() < 2) return places;
    if (is_last || !TurnNormal()) break;
  }
  for (int round = 0; round < kMeanRounds; ++round) {
    for (size_t k = 0; k < views_.size(); ++k) {
      if (!aligned_[k].is_usable || NumUsable() < 2) continue;
      const Template mean = MakeTemplate(grid_, MeanWithout(k));
      aligned_[k].is_usable = mean.is_usable;
      if (mean.is_usable) Align(k, mean, options_.min_correlation);
    }
  }
  if (NumUsable() < 2) return places;
  for (size_t k = 0; k < views_.size(); ++k) {
    const Aligned& aligned = aligned_[k];
    places[k].is_found = aligned.is_usable;
    places[k].xy = aligned.centre + aligned.shift;
    places[k].sigma_px = aligned.sigma_px;
    places[k].correlation = aligned.correlation;
  }
  return places;
}

}  // namespace

OptionCheck PatchOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (radius_px < 2) return fault("radius_px", radius_px, "radius_px >= 2");
  if (!(min_correlation > 0 && min_correlation < 1)) {
    return fault("min_correlation", min_correlation, "0 < min_correlation < 1");
  }
  if (!(max_move_px > 0)) return fault("max_move_px", max_move_px, "max_move_px > 0");
  if (max_iterations < 1) return fault("max_iterations", max_iterations, "max_iterations >= 1");
  return std::nullopt;
}

std::vector<PatchPlace> AlignPatch(const std::vector<PatchView>& views, size_t reference,
                                   const PatchOptions& options, SurfacePatch* patch) {
  S2GS_INVARIANT(!options.Check() && reference < views.size());
  return Alignment(views, reference, options, patch).Run();
}

}  // namespace s2gs
