#include "sfm_split/turntable.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <random>

#include "sfm_split/rotation.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double kPi = 3.14159265358979323846;
constexpr double kDegree = kPi / 180;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kRoundingFloor = 1e-13;     // residuals below are rounding, relative to lengths of 1
constexpr double kRayleighMedian = 1.17741;  // median of |(x, y)|, x and y standard normal
constexpr double kMaxwellMedian = 1.53817;   // the same in three dimensions
constexpr int kReweightings = 30;

double Median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double TukeyWeight(double ratio) {
  const double u = 1 - ratio * ratio;
  return u > 0 ? u * u : 0;
}

// Tukey's weights for residual lengths, cut at twice the inlier bound of the current spread. The spread is
// the median of those within the bound of the last one, enlarged for few residuals (a fit goes through some
// of them) as Rousseeuw does.
struct Reweighting {
  double sigma;
  double median_of_unit;
  double inlier_sigmas;
  double floor;
  int coordinates;  // of one residual
  int parameters;   // of the fit

  std::vector<double> operator()(const std::vector<double>& residuals) {
    std::vector<double> within;
    for (const double r : residuals) {
      if (r <= inlier_sigmas * sigma) within.push_back(r);
    }
    if (!within.empty()) {
      const int redundancy = std::max(1, coordinates * static_cast<int>(within.size()) - parameters);
      sigma = std::max((1 + 5.0 / redundancy) * Median(within) / median_of_unit, floor);
    }
    std::vector<double> weights;
    weights.reserve(residuals.size());
    for (const double r : residuals) weights.push_back(TukeyWeight(r / (2 * inlier_sigmas * sigma)));
    return weights;
  }
};

// Right-handed orthonormal columns (b1, b2, axis).
Matrix3d BasisWithThirdAxis(const Vector3d& axis) {
  Matrix3d basis;
  basis.col(2) = axis;
  basis.col(0) = axis.unitOrthogonal();
  basis.col(1) = axis.cross(basis.col(0));
  return basis;
}

struct Measurement {
  Matrix3d a;            // A_t
  Vector3d from_object;  // A_t c_o(t): scaled by lambda, the camera's place relative to the object's origin
  Vector3d centre;       // C_b(t)
  int station;
};

// --- (2): the axis
// ------------------------------------------------------------------------------------------

struct AxisFit {
  Vector3d n = Vector3d::UnitZ();
  Vector3d m = Vector3d::UnitZ();
  double sigma = 0;  // of one residual coordinate [rad], from the inliers; infinite without redundancy
  double bound = 0;  // residuals above are outliers [rad]
  double axis_sigma = kInfinity;
  double spread = 0;  // sqrt(1 - q^2)
  int num_inliers = 0;
};

double AxisResidual(const Measurement& t, const Vector3d& n, const Vector3d& m) {
  const Vector3d turned = t.a * m;
  return std::atan2(turned.cross(n).norm(), turned.dot(n));
}

// The samples to try: all of them when there are few.
std::vector<std::pair<int, int>> PairsToTry(int n, int max_pairs, std::mt19937* rng) {
  std::vector<std::pair<int, int>> pairs;
  if (static_cast<int64_t>(n) * (n - 1) / 2 <= max_pairs) {
    for (int i = 0; i < n; ++i) {
      for (int j = i + 1; j < n; ++j) pairs.emplace_back(i, j);
    }
    return pairs;
  }
  while (static_cast<int>(pairs.size()) < max_pairs) {
    const int i = static_cast<int>((*rng)() % static_cast<uint32_t>(n));
    const int j = static_cast<int>((*rng)() % static_cast<uint32_t>(n));
    if (i != j) pairs.emplace_back(i, j);
  }
  return pairs;
}

AxisFit FitAxis(const std::vector<Measurement>& all, const std::vector<int>& use,
                const TurntableOptions& options, std::mt19937* rng) {
  AxisFit fit;
  const double cap = options.max_seed_error_deg * kDegree;
  double best = kInfinity;
  for (const auto& [i, j] : PairsToTry(static_cast<int>(use.size()), options.max_seeds, rng)) {
    const Measurement& first = all[use[i]];
    const Vector3d w = LogRotation<double>(Matrix3d(first.a * all[use[j]].a.transpose()));
    if (w.norm() < 1e-12) continue;
    const Vector3d n = w.normalized();
    const Vector3d m = first.a.transpose() * n;
    double cost = 0;
    for (const int t : use) cost += std::min(AxisResidual(all[t], n, m), cap);
    if (cost < best) {
      best = cost;
      fit.n = n;
      fit.m = m;
    }
  }
  if (best == kInfinity) return fit;

  std::vector<double> residuals(use.size());
  const auto measure = [&] {
    for (size_t k = 0; k < use.size(); ++k) residuals[k] = AxisResidual(all[use[k]], fit.n, fit.m);
  };
  measure();
  Reweighting reweight{
      cap / options.inlier_sigmas, kRayleighMedian, options.inlier_sigmas, kRoundingFloor, 2, 4};
  std::vector<double> weights;
  for (int iteration = 0; iteration < kReweightings; ++iteration) {
    weights = reweight(residuals);
    Matrix3d sum = Matrix3d::Zero();
    for (size_t k = 0; k < use.size(); ++k) sum += weights[k] * all[use[k]].a;
    const Eigen::JacobiSVD<Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
    if (svd.singularValues()(0) == 0) break;
    const double sign = svd.matrixU().col(0).dot(fit.n) < 0 ? -1 : 1;
    fit.n = sign * svd.matrixU().col(0);
    fit.m = sign * svd.matrixV().col(0);
    measure();
  }

  fit.bound = std::max(options.inlier_sigmas * reweight.sigma, options.min_outlier_deg * kDegree);
  const Matrix3d e = BasisWithThirdAxis(fit.n);
  const Matrix3d f = BasisWithThirdAxis(fit.m);
  Eigen::Matrix4d information = Eigen::Matrix4d::Zero();
  double cosine = 0;
  double sine = 0;
  double squares = 0;
  int within = 0;
  for (size_t k = 0; k < use.size(); ++k) {
    if (residuals[k] <= fit.bound) ++fit.num_inliers;
    if (residuals[k] > options.inlier_sigmas * reweight.sigma) continue;
    ++within;
    squares += residuals[k] * residuals[k];
    const Matrix3d turn = e.transpose() * all[use[k]].a * f;  // R_z(theta) up to noise
    Eigen::Matrix<double, 2, 4> jacobian;
    jacobian << -Eigen::Matrix2d::Identity(), turn.topLeftCorner<2, 2>();
    information += jacobian.transpose() * jacobian;
    const double angle = std::atan2(turn(1, 0) - turn(0, 1), turn(0, 0) + turn(1, 1));
    cosine += std::cos(angle);
    sine += std::sin(angle);
  }
  if (within == 0) return fit;
  const double q2 = (cosine * cosine + sine * sine) / (static_cast<double>(within) * within);
  fit.spread = std::sqrt(std::max(0.0, 1 - q2));
  fit.sigma = within > 2 ? std::max(std::sqrt(squares / (2 * within - 4)), kRoundingFloor) : kInfinity;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(information);
  if (eigen.eigenvalues()(0) > 1e-14 * eigen.eigenvalues()(3)) {
    const Eigen::Matrix2d covariance = information.inverse().topLeftCorner<2, 2>();
    const double worst = Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(covariance).eigenvalues()(1);
    // Two images leave no redundancy: their axis is as good as their own turn allows for a small noise.
    fit.axis_sigma = std::sqrt(worst) * (within > 2 ? fit.sigma : kRoundingFloor);
  }
  return fit;
}

// --- (3): scale and offsets
// ---------------------------------------------------------------------------------

struct OffsetFit {
  double scale = 1;
  Vector3d p = Vector3d::Zero();
  Vector3d a = Vector3d::Zero();
  double length = 1;  // the camera's path about the object, background units
  double sigma = kInfinity;
  double bound = 0;
  double scale_sigma = kInfinity;
  double point_sigma = kInfinity;
  double centre_sigma = 0;  // of one station's centre
  std::vector<double> singular_values;
  int num_inliers = 0;
};

class OffsetSolver {
 public:
  OffsetSolver(const std::vector<Measurement>& all, std::vector<int> use, const AxisFit& axis,
               std::optional<double> fixed_scale, const TurntableOptions& options)
      : all_(all),
        use_(std::move(use)),
        n_(axis.n),
        f_(BasisWithThirdAxis(axis.m)),
        fixed_scale_(fixed_scale),
        options_(options) {
    Vector3d mean = Vector3d::Zero();
    for (const int t : use_) mean += ObjectCentre(all_[t]);
    mean /= static_cast<double>(use_.size());
    double sum = 0;
    for (const int t : use_) sum += (ObjectCentre(all_[t]) - mean).squaredNorm();
    path_ = std::sqrt(sum / static_cast<double>(use_.size()));
    if (path_ <= 0) path_ = 1;
  }

  OffsetFit Solve(std::mt19937* rng) {
    OffsetFit fit;
    if (fixed_scale_) fit.scale = *fixed_scale_;
    const bool seeded = FindSeed(rng, &fit);
    if (!seeded) {
      const std::vector<double> weights(use_.size(), 1);
      LeastSquares(use_, weights, &fit);
    }
    fit.length = Length(fit);
    std::vector<double> residuals = Residuals(fit);
    Reweighting reweight{
        seeded ? options_.max_seed_error_rel * fit.length / options_.inlier_sigmas : kInfinity,
        kMaxwellMedian,
        options_.inlier_sigmas,
        kRoundingFloor * fit.length,
        3,
        NumColumns()};
    std::vector<double> weights;
    for (int iteration = 0; iteration < kReweightings; ++iteration) {
      weights = reweight(residuals);
      LeastSquares(use_, weights, &fit);
      residuals = Residuals(fit);
    }
    fit.length = Length(fit);
    Judge(residuals, weights, reweight.sigma, &fit);
    return fit;
  }

  double Residual(const Measurement& t, const OffsetFit& fit) const {
    return (t.centre - fit.scale * t.from_object + t.a * fit.p - fit.a).norm();
  }

 private:
  static Vector3d ObjectCentre(const Measurement& t) { return t.a.transpose() * t.from_object; }

  double Length(const OffsetFit& fit) const { return std::max(std::abs(fit.scale) * path_, 1e-300); }

  std::vector<double> Residuals(const OffsetFit& fit) const {
    std::vector<double> residuals;
    residuals.reserve(use_.size());
    for (const int t : use_) residuals.push_back(Residual(all_[t], fit));
    return residuals;
  }

  // Columns: scale (in units of 1 / path, absent when fixed), p in the basis across m, a.
  int NumColumns() const { return fixed_scale_ ? 5 : 6; }
  Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, 6> Rows(const Measurement& t) const {
    Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, 6> rows(3, NumColumns());
    int column = 0;
    if (!fixed_scale_) rows.col(column++) = t.from_object / path_;
    rows.middleCols<2>(column) = -t.a * f_.leftCols<2>();
    rows.middleCols<3>(column + 2) = Matrix3d::Identity();
    return rows;
  }

  // Minimum-norm solution, so that rank-deficient samples do no harm.
  void LeastSquares(const std::vector<int>& images, const std::vector<double>& weights,
                    OffsetFit* fit) const {
    MatrixXd rows(3 * images.size(), NumColumns());
    VectorXd right(3 * images.size());
    for (size_t k = 0; k < images.size(); ++k) {
      const Measurement& t = all_[images[k]];
      const double root = std::sqrt(weights[k]);
      rows.middleRows<3>(static_cast<Eigen::Index>(3 * k)) = root * Rows(t);
      right.segment<3>(static_cast<Eigen::Index>(3 * k)) =
          root * (fixed_scale_ ? Vector3d(t.centre - *fixed_scale_ * t.from_object) : t.centre);
    }
    Eigen::CompleteOrthogonalDecomposition<MatrixXd> decomposition;
    decomposition.setThreshold(1e-12);
    const VectorXd x = decomposition.compute(rows).solve(right);
    if (!x.allFinite()) return;
    int column = 0;
    if (!fixed_scale_) fit->scale = x(column++) / path_;
    fit->p = f_.leftCols<2>() * x.segment<2>(column);
    fit->a = x.segment<3>(column + 2);
  }

  bool FindSeed(std::mt19937* rng, OffsetFit* best_fit) const {
    double best = kInfinity;
    const std::vector<double> ones(3, 1);
    const auto pick = [&] { return use_[(*rng)() % use_.size()]; };
    std::vector<int> sample(3);
    for (int seed = 0; seed < options_.max_seeds && use_.size() >= 3; ++seed) {
      for (int& t : sample) t = pick();
      if (sample[0] == sample[1] || sample[0] == sample[2] || sample[1] == sample[2]) continue;
      OffsetFit fit = *best_fit;
      LeastSquares(sample, ones, &fit);
      if (fit.scale <= 0) continue;
      const double cap = options_.max_seed_error_rel * Length(fit);
      double cost = 0;
      for (const int t : use_) cost += std::min(Residual(all_[t], fit) / cap, 1.0);
      if (cost < best) {
        best = cost;
        *best_fit = fit;
      }
    }
    return best < kInfinity;
  }

  void Judge(const std::vector<double>& residuals, const std::vector<double>& weights, double robust_sigma,
             OffsetFit* fit) const {
    fit->bound = std::max(options_.inlier_sigmas * robust_sigma, options_.min_outlier_rel * fit->length);
    const int columns = NumColumns();
    MatrixXd information = MatrixXd::Zero(columns, columns);
    std::map<int, std::vector<Vector3d>> by_station;
    std::map<int, MatrixXd> gradient_by_station;
    double squares = 0;
    int within = 0;
    for (size_t k = 0; k < use_.size(); ++k) {
      if (residuals[k] <= fit->bound) ++fit->num_inliers;
      if (residuals[k] > options_.inlier_sigmas * robust_sigma) continue;
      const Measurement& t = all_[use_[k]];
      const auto rows = Rows(t);
      ++within;
      squares += residuals[k] * residuals[k];
      information += weights[k] * rows.transpose() * rows;
      by_station[t.station].emplace_back(t.centre - fit->scale * t.from_object + t.a * fit->p - fit->a);
      MatrixXd& gradient =
          gradient_by_station.try_emplace(t.station, MatrixXd::Zero(columns, 3)).first->second;
      gradient += weights[k] * rows.transpose();
    }
    if (within == 0) return;
    const int redundancy = 3 * within - columns;
    double variance = redundancy > 0 ? squares / redundancy : kInfinity;

    // Noise that the images of a station share (its own pose's) and noise of single images.
    const int stations = static_cast<int>(by_station.size());
    double station_variance = 0;
    if (stations > 1 && within > stations + 1) {
      double inside = 0;
      double between = 0;
      double inverse_counts = 0;
      for (const auto& [station, vectors] : by_station) {
        Vector3d mean = Vector3d::Zero();
        for (const Vector3d& r : vectors) mean += r;
        mean /= static_cast<double>(vectors.size());
        for (const Vector3d& r : vectors) inside += (r - mean).squaredNorm();
        between += mean.squaredNorm();
        inverse_counts += 1.0 / static_cast<double>(vectors.size());
      }
      variance = inside / std::max(1, 3 * (within - stations) - 2);
      const int left = 3 * stations - (fixed_scale_ ? 3 : 4);
      station_variance = std::max(0.0, between - 3 * variance * inverse_counts) / left;
    }
    fit->sigma = std::max(std::sqrt(variance), kRoundingFloor * fit->length);
    fit->centre_sigma = std::sqrt(station_variance);

    const VectorXd column_scale = information.diagonal().cwiseSqrt();
    const MatrixXd normalised =
        column_scale.cwiseInverse().asDiagonal() * information * column_scale.cwiseInverse().asDiagonal();
    const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(normalised);
    for (int k = columns - 1; k >= 0; --k) {
      fit->singular_values.push_back(std::sqrt(std::max(0.0, eigen.eigenvalues()(k))));
    }
    // Eigenvalues are the squares of singular values: 1e-13 here is 3e-7 there.
    const VectorXd inverse_values =
        (eigen.eigenvalues().array() > 1e-13)
            .select(eigen.eigenvalues().cwiseInverse(), VectorXd::Constant(columns, kInfinity));
    if (!inverse_values.allFinite() || !std::isfinite(variance)) return;
    const MatrixXd half = column_scale.cwiseInverse().asDiagonal() * eigen.eigenvectors();
    const MatrixXd inverse = half * inverse_values.asDiagonal() * half.transpose();
    MatrixXd covariance = fit->sigma * fit->sigma * inverse;
    for (const auto& [station, gradient] : gradient_by_station) {
      const MatrixXd lever = inverse * gradient;
      covariance += station_variance * lever * lever.transpose();
    }
    if (!fixed_scale_) fit->scale_sigma = std::sqrt(covariance(0, 0)) / path_;
    const Matrix3d across = Matrix3d::Identity() - n_ * n_.transpose();
    const Matrix3d of_a = across * covariance.bottomRightCorner<3, 3>() * across;
    fit->point_sigma = std::sqrt(Eigen::SelfAdjointEigenSolver<Matrix3d>(of_a).eigenvalues()(2));
  }

  const std::vector<Measurement>& all_;
  std::vector<int> use_;
  Vector3d n_;
  Matrix3d f_;
  std::optional<double> fixed_scale_;
  const TurntableOptions& options_;
  double path_ = 1;  // of the camera about the object, object units
};

// --- Both, group by group
// -----------------------------------------------------------------------------------

struct GroupFit {
  AxisFit axis;
  OffsetFit offset;
  std::vector<int> inliers;
  bool scale_observable = false;
};

bool ScaleObservable(const OffsetFit& fit, const TurntableOptions& options) {
  return fit.scale > 0 && fit.singular_values.size() == 6 && fit.singular_values[5] > 3e-7 &&
         fit.scale_sigma <= options.max_scale_sigma_rel * fit.scale;
}

GroupFit FitGroup(const std::vector<Measurement>& all, const std::vector<int>& use,
                  std::optional<double> known_scale, const TurntableOptions& options, std::mt19937* rng) {
  GroupFit group;
  group.axis = FitAxis(all, use, options, rng);
  if (group.axis.num_inliers < 2) return group;
  std::vector<int> on_axis;
  for (const int t : use) {
    if (AxisResidual(all[t], group.axis.n, group.axis.m) <= group.axis.bound) on_axis.push_back(t);
  }
  OffsetSolver solver(all, on_axis, group.axis, known_scale, options);
  group.offset = solver.Solve(rng);
  group.scale_observable = known_scale.has_value() || ScaleObservable(group.offset, options);
  if (!group.scale_observable) {
    const std::vector<double> singular_values = group.offset.singular_values;
    const double scale_sigma = group.offset.scale_sigma / std::max(std::abs(group.offset.scale), 1e-300);
    OffsetSolver unscaled(all, on_axis, group.axis, 1.0, options);
    group.offset = unscaled.Solve(rng);
    group.offset.singular_values = singular_values;
    group.offset.scale_sigma = scale_sigma;
  }
  for (const int t : on_axis) {
    if (solver.Residual(all[t], group.offset) <= group.offset.bound) group.inliers.push_back(t);
  }
  return group;
}

int CountDistinctStations(const std::vector<TurntablePose>& poses, const std::vector<Measurement>& all,
                          const std::vector<int>& use, double tolerance) {
  std::map<int, std::pair<Vector3d, int>> sums;
  for (const int t : use) {
    auto& [sum, count] = sums.try_emplace(poses[t].station, Vector3d::Zero(), 0).first->second;
    sum += all[t].centre;
    ++count;
  }
  std::vector<Vector3d> distinct;
  for (const auto& [station, sum] : sums) {
    const Vector3d centre = sum.first / sum.second;
    const bool known = std::any_of(distinct.begin(), distinct.end(), [&](const Vector3d& other) {
      return (other - centre).norm() <= tolerance;
    });
    if (!known) distinct.push_back(centre);
  }
  return static_cast<int>(distinct.size());
}

// +1 when `axis` points to where the cameras look down from.
double UpSign(const std::vector<TurntablePose>& poses, const std::vector<int>& use, const Vector3d& axis) {
  Vector3d view = Vector3d::Zero();
  Vector3d up = Vector3d::Zero();
  for (const int t : use) {
    const Matrix3d world_from_cam = poses[t].cam_from_world.rotation.conjugate().toRotationMatrix();
    view += world_from_cam.col(2);
    up -= world_from_cam.col(1);
  }
  view /= static_cast<double>(use.size());
  const double down = -axis.dot(view);
  if (std::abs(down) > std::sin(5 * kDegree)) return down > 0 ? 1 : -1;
  return axis.dot(up) >= 0 ? 1 : -1;
}

Matrix3d WorldFromObjectRotation(const TurntableGroup& group, double angle) {
  return BasisWithThirdAxis(group.axis_in_world) * RotationAbout<double>(Vector3d::UnitZ(), angle) *
         BasisWithThirdAxis(group.axis_in_object).transpose();
}

// Steps between images of one station that are next to each other by name.
void MeasureSteps(const std::vector<TurntablePose>& poses, TurntableSolution* solution) {
  std::vector<int> order(poses.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](int i, int j) { return poses[i].name < poses[j].name; });
  std::map<int, int> last;
  std::vector<double> steps;
  for (const int t : order) {
    const TurntableImageFit& fit = solution->images[t];
    if (!fit.inlier || fit.group != 0) continue;
    const auto found = last.find(poses[t].station);
    if (found != last.end()) {
      steps.push_back(WrapAngle(fit.angle_rad - solution->images[found->second].angle_rad) / kDegree);
    }
    last[poses[t].station] = t;
  }
  if (steps.empty()) return;
  int sum = 0;
  for (const double step : steps) sum += step > 0 ? 1 : -1;
  solution->sense = sum > 0 ? 1 : (sum < 0 ? -1 : 0);
  solution->median_step_deg = Median(steps);
}

}  // namespace

OptionCheck TurntableOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, std::to_string(value), bound};
  };
  if (max_seeds < 1) return fault("max_seeds", max_seeds, "max_seeds >= 1");
  if (!(max_seed_error_deg > 0))
    return fault("max_seed_error_deg", max_seed_error_deg, "max_seed_error_deg > 0");
  if (!(max_seed_error_rel > 0))
    return fault("max_seed_error_rel", max_seed_error_rel, "max_seed_error_rel > 0");
  if (!(inlier_sigmas >= 2)) return fault("inlier_sigmas", inlier_sigmas, "inlier_sigmas >= 2");
  if (!(min_outlier_deg >= 0)) return fault("min_outlier_deg", min_outlier_deg, "min_outlier_deg >= 0");
  if (!(min_outlier_rel >= 0)) return fault("min_outlier_rel", min_outlier_rel, "min_outlier_rel >= 0");
  if (!(max_axis_sigma_deg > 0))
    return fault("max_axis_sigma_deg", max_axis_sigma_deg, "max_axis_sigma_deg > 0");
  if (!(max_scale_sigma_rel > 0)) {
    return fault("max_scale_sigma_rel", max_scale_sigma_rel, "max_scale_sigma_rel > 0");
  }
  if (known_scale && !(*known_scale > 0)) return fault("known_scale", *known_scale, "known_scale > 0");
  return std::nullopt;
}

const char* TurntableMotionName(TurntableMotion motion) {
  switch (motion) {
    case TurntableMotion::kRotates:
      return "rotates";
    case TurntableMotion::kNothingRotates:
      return "nothing rotates";
    case TurntableMotion::kStepsTooSmall:
      return "steps too small";
    case TurntableMotion::kTooFewImages:
      return "too few images";
  }
  return "";
}

TurntableSolution SolveTurntable(const std::vector<TurntablePose>& poses, const TurntableOptions& options) {
  S2GS_INVARIANT(!options.Check());
  TurntableSolution solution;
  solution.images.resize(poses.size());
  std::vector<Measurement> all;
  std::vector<int> use;
  for (size_t t = 0; t < poses.size(); ++t) {
    Measurement measurement;
    const Matrix3d world_from_cam = poses[t].cam_from_world.rotation.conjugate().toRotationMatrix();
    measurement.a = world_from_cam * poses[t].cam_from_object.rotation.toRotationMatrix();
    measurement.from_object = -(world_from_cam * poses[t].cam_from_object.translation);
    measurement.centre = CameraCentre(poses[t].cam_from_world);
    measurement.station = poses[t].station;
    if (measurement.a.allFinite() && measurement.from_object.allFinite() && measurement.centre.allFinite()) {
      use.push_back(static_cast<int>(t));
    }
    all.push_back(measurement);
  }
  std::mt19937 rng(options.random_seed);
  const size_t smallest_group = std::max<size_t>(4, (use.size() + 9) / 10);

  std::optional<double> scale = options.known_scale;
  std::vector<int> rest = use;
  while (solution.groups.empty() ? rest.size() >= 2 : rest.size() >= smallest_group) {
    GroupFit group = FitGroup(all, rest, scale, options, &rng);
    const bool first = solution.groups.empty();
    if (first) {
      solution.rotation_sigma_deg = group.axis.sigma / kDegree;
      solution.axis_sigma_deg = group.axis.axis_sigma / kDegree;
      const double q = std::sqrt(std::max(0.0, 1 - group.axis.spread * group.axis.spread));
      solution.angle_spread_deg = q > 0 ? std::sqrt(-2 * std::log(q)) / kDegree : kInfinity;
      // Of noise alone the fit takes the direction with the largest spread for the axis: the fewer the
      // images, the larger that looks.
      const double least = (2 + 8 / std::sqrt(static_cast<double>(rest.size()))) * group.axis.sigma;
      if (group.axis.spread < 1e-7 || (group.axis.num_inliers > 2 && group.axis.spread < least)) {
        solution.motion = TurntableMotion::kNothingRotates;
        return solution;
      }
      if (group.axis.axis_sigma > options.max_axis_sigma_deg * kDegree) {
        solution.motion = TurntableMotion::kStepsTooSmall;
        return solution;
      }
      if (group.inliers.size() < 2) break;
      solution.motion = TurntableMotion::kRotates;
    } else if (group.inliers.size() < smallest_group || group.axis.axis_sigma > 3 * kDegree) {
      break;
    }
    TurntableGroup out;
    const double sign = first ? UpSign(poses, group.inliers, group.axis.n)
                              : (group.axis.n.dot(solution.groups[0].axis_in_world) < 0 ? -1.0 : 1.0);
    out.axis_in_world = sign * group.axis.n;
    out.axis_in_object = sign * group.axis.m;
    out.point_in_world = group.offset.a;
    out.point_in_object = group.offset.p / group.offset.scale;
    out.num_images = static_cast<int>(group.inliers.size());
    if (first) {
      scale = group.offset.scale;
      solution.scale = group.offset.scale;
      solution.scale_observable = group.scale_observable;
      solution.scale_sigma_rel =
          group.scale_observable ? group.offset.scale_sigma / group.offset.scale : group.offset.scale_sigma;
      solution.offset_sigma_rel = group.offset.sigma / group.offset.length;
      solution.point_sigma = group.offset.point_sigma;
      solution.singular_values = group.offset.singular_values;
      if (solution.singular_values.size() == 6) {
        const double smallest = solution.singular_values[5];
        solution.scale_singular_gap = smallest > 3e-7 ? smallest / solution.singular_values[4] : 0;
      }
      const double tolerance =
          std::max(4 * std::hypot(group.offset.centre_sigma, group.offset.sigma), 1e-4 * group.offset.length);
      solution.num_distinct_stations = CountDistinctStations(
          poses, all, group.inliers, std::isfinite(tolerance) ? tolerance : 1e-4 * group.offset.length);
      if (!solution.scale_observable) solution.num_distinct_stations = 1;
    }
    const int index = static_cast<int>(solution.groups.size());
    solution.groups.push_back(out);
    const Matrix3d e = BasisWithThirdAxis(out.axis_in_world);
    const Matrix3d f = BasisWithThirdAxis(out.axis_in_object);
    for (const int t : rest) {
      TurntableImageFit& fit = solution.images[t];
      const double axis_error = AxisResidual(all[t], group.axis.n, group.axis.m);
      const double offset_error = (all[t].centre - group.offset.scale * all[t].from_object +
                                   all[t].a * group.offset.p - group.offset.a)
                                      .norm();
      const bool inlier = axis_error <= group.axis.bound && offset_error <= group.offset.bound;
      if (!first && !inlier) continue;
      const Matrix3d turn = e.transpose() * all[t].a * f;
      fit.angle_rad = AngleAbout(Vector3d::UnitZ(), turn);
      fit.rotation_residual_deg = axis_error / kDegree;
      fit.offset_residual_rel = offset_error / group.offset.length;
      fit.inlier = inlier;
      fit.group = inlier ? index : -1;
    }
    std::vector<int> left;
    for (const int t : rest) {
      if (!solution.images[t].inlier) left.push_back(t);
    }
    rest = left;
  }
  if (solution.groups.empty()) return solution;

  for (size_t t = 0; t < poses.size(); ++t) {
    if (!solution.images[t].inlier || solution.images[t].group != 0) continue;
    if (solution.reference < 0 || poses[t].name < poses[solution.reference].name) {
      solution.reference = static_cast<int>(t);
    }
  }
  // Angle 0 at the reference: the bases that define angles turn along, for every group.
  const double zero = solution.images[solution.reference].angle_rad;
  for (TurntableImageFit& fit : solution.images) {
    fit.angle_rad = fit.inlier ? WrapAngle(fit.angle_rad - zero) : 0;
  }
  solution.reference_angle_rad = zero;
  MeasureSteps(poses, &solution);
  return solution;
}

Sim3 WorldFromObjectAtAngle(const TurntableSolution& solution, int group, double angle_rad) {
  S2GS_INVARIANT(group >= 0 && group < static_cast<int>(solution.groups.size()));
  const TurntableGroup& fit = solution.groups[group];
  const Matrix3d a = WorldFromObjectRotation(fit, angle_rad + solution.reference_angle_rad);
  Sim3 world_from_object;
  world_from_object.scale = solution.scale;
  world_from_object.rotation = Eigen::Quaterniond(a).normalized();
  world_from_object.translation = fit.point_in_world - solution.scale * (a * fit.point_in_object);
  return world_from_object;
}

}  // namespace s2gs
