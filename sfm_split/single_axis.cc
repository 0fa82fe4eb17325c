#include "sfm_split/single_axis.h"

#include <ceres/jet.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <queue>
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
constexpr double kMadToSigma = 1.4826;
constexpr double kInlierSigmas = 3;
// Rays of less parallax than this [rad] between all cameras: one place.
constexpr double kLeastParallax = 2e-3;
constexpr double kDistinctAxes = 15 * kDegree;

struct Ray {
  Vector3d in_cam;    // z = 1
  Vector3d in_world;  // the same direction
};

struct Match {
  Ray first;
  Ray second;
  int index;  // in the input's pair
};

struct Pair {
  int index;  // in the input
  int image1;
  int image2;
  bool same_place;
  double focal;  // [px], mean of both cameras
  std::vector<Match> matches;
};

struct Camera3 {
  Matrix3d from_world;
  Vector3d centre;
};

struct Axis {
  Vector3d direction;
  Vector3d point;
};

// Directions across an axis: b1 across the line of sight too, so that with one camera position a move along
// b1 can be seen and one along b2 cannot.
struct Frame {
  Vector3d b1;
  Vector3d b2;
};

Frame FrameAcross(const Vector3d& direction, const Vector3d& sight) {
  Vector3d b1 = direction.cross(sight);
  if (b1.norm() < 1e-3 * sight.norm()) b1 = direction.unitOrthogonal();
  b1.normalize();
  return {b1, direction.cross(b1)};
}

double Median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// The epipolar matrix of rays in the cameras' frames, for a turn by `angle` between the images.
template <typename T>
Eigen::Matrix<T, 3, 3> Essential(const Camera3& first, const Camera3& second,
                                 const Eigen::Matrix<T, 3, 1>& direction, const Eigen::Matrix<T, 3, 1>& point,
                                 const T& angle) {
  using V = Eigen::Matrix<T, 3, 1>;
  using M = Eigen::Matrix<T, 3, 3>;
  const M turn = RotationAbout<T>(direction, angle);
  const M between = turn * CrossMatrix<T>(V(first.centre.cast<T>() - point)) -
                    CrossMatrix<T>(V(second.centre.cast<T>() - point)) * turn;
  return second.from_world.cast<T>() * between * first.from_world.transpose().cast<T>();
}

// Sampson's error in units of the rays' plane z = 1.
template <typename T>
T Sampson(const Eigen::Matrix<T, 3, 3>& e, const Match& match) {
  using std::sqrt;
  using V = Eigen::Matrix<T, 3, 1>;
  const V in_second = e * match.first.in_cam.cast<T>();
  const V in_first = e.transpose() * match.second.in_cam.cast<T>();
  const T squared = in_second(0) * in_second(0) + in_second(1) * in_second(1) + in_first(0) * in_first(0) +
                    in_first(1) * in_first(1);
  const T error =
      in_second(0) * match.second.in_cam(0) + in_second(1) * match.second.in_cam(1) + in_second(2);
  if (!(squared > T(1e-30)))
    return T(1e6);  // no turn at all between images of one place: nothing to agree with
  return error / sqrt(squared);
}

// Both depths of the point where the turned first ray passes the second are positive.
bool InFront(const Camera3& first, const Camera3& second, const Axis& axis, const Matrix3d& turn,
             const Match& match) {
  const Vector3d u = turn * match.first.in_world;
  const Vector3d& v = match.second.in_world;
  const Vector3d gap = (second.centre - axis.point) - turn * (first.centre - axis.point);
  const double uu = u.squaredNorm();
  const double vv = v.squaredNorm();
  const double uv = u.dot(v);
  // s u - t v = gap in the least-squares sense; the determinant uu vv - uv^2 is positive.
  const double s = vv * u.dot(gap) - uv * v.dot(gap);
  const double t = uv * u.dot(gap) - uu * v.dot(gap);
  return s > 0 && t > 0;
}

struct Vote {
  double angle = 0;
  double score = 0;  // sum of 1 - (error / bound)^2 over agreeing matches
};

class Solver {
 public:
  Solver(const SingleAxisInput& input, const SingleAxisOptions& options, Reporter& reporter)
      : input_(input), options_(options), reporter_(reporter), rng_(options.random_seed) {}

  SingleAxisSolution Solve();

 private:
  struct Candidate {
    Axis axis;
    double score = 0;
  };

  bool Prepare();
  std::vector<Pair> SearchPairs();
  std::vector<Candidate> CoarseSearch(const std::vector<Pair>& pairs);
  Candidate Refine(const std::vector<Pair>& pairs, Candidate candidate, double last_bound);
  Vote BestAngle(const Pair& pair, const Axis& axis, double bound_px, int max_proposals) const;
  double SearchBound(const Pair& pair, double factor) const;
  void AddRoots(const Pair& pair, const Axis& axis, const Match& match, std::vector<double>* angles) const;
  void Score(const Pair& pair, const Axis& axis, double angle, double bound_px, Vote* best) const;
  int AxisParameters() const { return scale_observable_ ? 4 : 3; }
  Axis Moved(const Axis& axis, const Frame& frame, const VectorXd& step) const;
  template <typename Accumulate>
  void Linearize(const Pair& pair, const Axis& axis, const Frame& frame, double angle, double scale_px,
                 const Accumulate& accumulate) const;
  void Synchronize(const std::vector<Vote>& votes);
  void AdjustAll(Axis* axis, double scale_px, int iterations, bool covariance);
  double MarkInliers(const Axis& axis, double bound_px);
  void FindConnected();
  void Orient();
  void MeasureSteps();

  const SingleAxisInput& input_;
  const SingleAxisOptions& options_;
  Reporter& reporter_;
  std::mt19937 rng_;
  std::vector<Camera3> cameras_;
  std::vector<Pair> pairs_;
  Vector3d target_ = Vector3d::Zero();  // about where the images look
  Vector3d sight_ = Vector3d::UnitZ();  // from the mean camera to the target
  double radius_ = 0;                   // of the object, about
  bool scale_observable_ = false;
  std::vector<double> angles_;
  std::vector<char> connected_;
  SingleAxisSolution solution_;
};

bool Solver::Prepare() {
  for (const SingleAxisImage& image : input_.images) {
    cameras_.push_back(
        {image.cam_from_world.rotation.toRotationMatrix(), CameraCentre(image.cam_from_world)});
  }
  for (size_t p = 0; p < input_.pairs.size(); ++p) {
    const SingleAxisPair& given = input_.pairs[p];
    if (given.image1 == given.image2 || static_cast<int>(given.matches.size()) < options_.min_matches)
      continue;
    Pair pair{};
    pair.index = static_cast<int>(p);
    pair.image1 = given.image1;
    pair.image2 = given.image2;
    const Camera& camera1 = input_.cameras[input_.images[given.image1].camera];
    const Camera& camera2 = input_.cameras[input_.images[given.image2].camera];
    pair.focal = 0.25 * (FocalLengths(camera1).sum() + FocalLengths(camera2).sum());
    std::vector<int> order(given.matches.size());
    std::iota(order.begin(), order.end(), 0);
    std::shuffle(order.begin(), order.end(), rng_);
    for (const int k : order) {
      const std::optional<Vector3d> first = UnprojectFromImage(camera1, given.matches[k].first);
      const std::optional<Vector3d> second = UnprojectFromImage(camera2, given.matches[k].second);
      if (!first || !second) continue;
      Match match;
      match.first = {*first, cameras_[pair.image1].from_world.transpose() * *first};
      match.second = {*second, cameras_[pair.image2].from_world.transpose() * *second};
      match.index = k;
      pair.matches.push_back(match);
      if (static_cast<int>(pair.matches.size()) == options_.max_matches) break;
    }
    if (static_cast<int>(pair.matches.size()) >= options_.min_matches) pairs_.push_back(std::move(pair));
  }
  if (pairs_.empty()) {
    solution_.reason = "no pair of images has enough matches";
    return false;
  }

  // The point closest to the images' mean rays, and how wide the rays scatter.
  std::vector<Vector3d> sums(cameras_.size(), Vector3d::Zero());
  for (const Pair& pair : pairs_) {
    for (const Match& match : pair.matches) {
      sums[pair.image1] += match.first.in_world.normalized();
      sums[pair.image2] += match.second.in_world.normalized();
    }
  }
  Matrix3d normal = Matrix3d::Zero();
  Vector3d right = Vector3d::Zero();
  Vector3d mean_centre = Vector3d::Zero();
  Vector3d mean_ray = Vector3d::Zero();
  int count = 0;
  for (size_t i = 0; i < cameras_.size(); ++i) {
    if (sums[i].norm() == 0) continue;
    const Vector3d ray = sums[i].normalized();
    const Matrix3d across = Matrix3d::Identity() - ray * ray.transpose();
    normal += across;
    right += across * cameras_[i].centre;
    mean_centre += cameras_[i].centre;
    mean_ray += ray;
    ++count;
  }
  mean_centre /= count;
  double extent = 0;  // of the cameras' places
  for (size_t i = 0; i < cameras_.size(); ++i) {
    if (sums[i].norm() > 0) extent = std::max(extent, (cameras_[i].centre - mean_centre).norm());
  }
  mean_ray.normalize();
  // Rays of one place meet in the camera: what they look at has to lie well in front, seen from places that
  // differ.
  target_ = normal.completeOrthogonalDecomposition().solve(right);
  const double depth = mean_ray.dot(target_ - mean_centre);
  scale_observable_ = target_.allFinite() && depth > 0 && extent > 1e-10 * mean_centre.norm() &&
                      extent > kLeastParallax * depth && depth > 0.1 * extent;
  if (!scale_observable_) target_ = mean_centre + mean_ray;
  sight_ = target_ - mean_centre;
  const double distance = sight_.norm();
  if (!target_.allFinite() || distance == 0) {
    solution_.reason = "the cameras look at no common place";
    return false;
  }
  std::vector<double> spread;
  for (Pair& pair : pairs_) {
    const double apart = (cameras_[pair.image1].centre - cameras_[pair.image2].centre).norm();
    pair.same_place = apart < 1e-6 * distance;
    const Vector3d mean = sums[pair.image1].normalized();
    for (const Match& match : pair.matches) {
      spread.push_back(match.first.in_world.normalized().cross(mean).norm());
    }
  }
  radius_ = 2 * Median(spread) * distance;
  return true;
}

// The pairs that judge axes: those with most matches, no image too often.
std::vector<Pair> Solver::SearchPairs() {
  std::vector<int> order(pairs_.size());
  std::iota(order.begin(), order.end(), 0);
  std::shuffle(order.begin(), order.end(), rng_);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    const size_t most = static_cast<size_t>(options_.max_search_matches);
    return std::min(pairs_[a].matches.size(), most) > std::min(pairs_[b].matches.size(), most);
  });
  std::vector<Pair> chosen;
  std::vector<char> taken(pairs_.size(), 0);
  std::vector<int> uses(cameras_.size(), 0);
  for (int limit = 1; limit <= 64 && static_cast<int>(chosen.size()) < options_.max_search_pairs;
       limit *= 2) {
    for (const int p : order) {
      if (static_cast<int>(chosen.size()) == options_.max_search_pairs) break;
      if (taken[p] != 0 || uses[pairs_[p].image1] >= limit || uses[pairs_[p].image2] >= limit) continue;
      taken[p] = 1;
      ++uses[pairs_[p].image1];
      ++uses[pairs_[p].image2];
      chosen.push_back(pairs_[p]);
      if (static_cast<int>(chosen.back().matches.size()) > options_.max_search_matches) {
        chosen.back().matches.resize(options_.max_search_matches);
      }
    }
  }
  return chosen;
}

void Solver::AddRoots(const Pair& pair, const Axis& axis, const Match& match,
                      std::vector<double>* angles) const {
  const Vector3d& n = axis.direction;
  const Vector3d& d1 = match.first.in_world;
  const Vector3d& d2 = match.second.in_world;
  const Vector3d m1 = (cameras_[pair.image1].centre - axis.point).cross(d1);
  const Vector3d m2 = (cameras_[pair.image2].centre - axis.point).cross(d2);
  const double alpha = d2.dot(n) * n.dot(m1) + m2.dot(n) * n.dot(d1);
  const double beta = d2.dot(m1) + m2.dot(d1) - alpha;
  const double gamma = n.dot(m1.cross(d2)) + n.dot(d1.cross(m2));
  const double phase = std::atan2(gamma, beta);
  if (pair.same_place) {  // the roots are 0 and 2 phase
    angles->push_back(2 * phase);
    return;
  }
  const double amplitude = std::hypot(beta, gamma);
  if (amplitude == 0) return;
  const double cosine = -alpha / amplitude;
  if (std::abs(cosine) >= 1) {
    angles->push_back(cosine > 0 ? phase : phase + kPi);
    return;
  }
  const double half = std::acos(cosine);
  angles->push_back(phase + half);
  angles->push_back(phase - half);
}

void Solver::Score(const Pair& pair, const Axis& axis, double angle, double bound_px, Vote* best) const {
  const Camera3& first = cameras_[pair.image1];
  const Camera3& second = cameras_[pair.image2];
  const Matrix3d e = Essential<double>(first, second, axis.direction, axis.point, angle);
  const Matrix3d turn = RotationAbout<double>(axis.direction, angle);
  const double factor = pair.focal / bound_px;
  double score = 0;
  double possible = static_cast<double>(pair.matches.size());
  for (const Match& match : pair.matches) {
    const double ratio = factor * Sampson<double>(e, match);
    const double gain = 1 - ratio * ratio;
    if (gain > 0 && InFront(first, second, axis, turn, match)) {
      score += gain;
    } else {
      possible -= 1;
      if (possible <= best->score) return;
    }
  }
  if (score > best->score) *best = {angle, score};
}

Vote Solver::BestAngle(const Pair& pair, const Axis& axis, double bound_px, int max_proposals) const {
  std::vector<double> angles;
  for (const Match& match : pair.matches) {
    if (static_cast<int>(angles.size()) >= max_proposals) break;
    AddRoots(pair, axis, match, &angles);
  }
  Vote best;
  for (const double angle : angles) Score(pair, axis, angle, bound_px, &best);
  return best;
}

// While the axis is far off, errors are a share of how far the matches moved.
double Solver::SearchBound(const Pair& pair, double factor) const {
  std::vector<double> moved;
  for (const Match& match : pair.matches) {
    moved.push_back((match.first.in_cam - match.second.in_cam).head<2>().norm() * pair.focal);
  }
  return std::clamp(factor * Median(moved), kInlierSigmas * options_.noise_px, 40 * options_.noise_px);
}

std::vector<Solver::Candidate> Solver::CoarseSearch(const std::vector<Pair>& pairs) {
  std::vector<double> bounds;
  bounds.reserve(pairs.size());
  for (const Pair& pair : pairs) bounds.push_back(SearchBound(pair, 0.1));
  const double golden = kPi * (3 - std::sqrt(5.0));
  std::vector<Candidate> candidates;
  for (int k = 0; k < options_.num_directions; ++k) {
    reporter_.Progress("search for the axis", k, options_.num_directions);
    if (reporter_.StopRequested()) throw Interrupted();
    const double z = (k + 0.5) / options_.num_directions;
    const double r = std::sqrt(1 - z * z);
    const Vector3d direction(r * std::cos(golden * k), r * std::sin(golden * k), z);
    const Frame frame = FrameAcross(direction, sight_);
    Candidate best_here;
    const int side = options_.offsets_per_side;
    const auto offset = [&](int i) { return side > 1 ? radius_ * (2.0 * i / (side - 1) - 1) : 0.0; };
    for (int i = 0; i < side; ++i) {
      for (int j = 0; j < (scale_observable_ ? side : 1); ++j) {
        Candidate candidate;
        candidate.axis.direction = direction;
        candidate.axis.point = target_ + offset(i) * frame.b1;
        if (scale_observable_) candidate.axis.point += offset(j) * frame.b2;
        for (size_t p = 0; p < pairs.size(); ++p) {
          candidate.score += BestAngle(pairs[p], candidate.axis, bounds[p], 8).score;
        }
        if (candidate.score > best_here.score) best_here = candidate;
      }
    }
    candidates.push_back(best_here);
  }
  std::sort(candidates.begin(), candidates.end(),
            [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  return candidates;
}

Axis Solver::Moved(const Axis& axis, const Frame& frame, const VectorXd& step) const {
  Axis moved;
  moved.direction = (axis.direction + step(0) * frame.b1 + step(1) * frame.b2).normalized();
  moved.point = axis.point + radius_ * step(2) * frame.b1;
  if (scale_observable_) moved.point += radius_ * step(3) * frame.b2;
  return moved;
}

// Calls accumulate(match, residual [px], derivative by (axis step, angle), weight) for every match of a pair.
template <typename Accumulate>
void Solver::Linearize(const Pair& pair, const Axis& axis, const Frame& frame, double angle, double scale_px,
                       const Accumulate& accumulate) const {
  using Jet = ceres::Jet<double, 5>;
  using V = Eigen::Matrix<Jet, 3, 1>;
  V direction = axis.direction.cast<Jet>();
  direction += V(Jet(0, 0) * frame.b1.cast<Jet>() + Jet(0, 1) * frame.b2.cast<Jet>());
  direction.normalize();
  V point = axis.point.cast<Jet>();
  point += V(Jet(0, 2) * Jet(radius_) * frame.b1.cast<Jet>());
  if (scale_observable_) point += V(Jet(0, 3) * Jet(radius_) * frame.b2.cast<Jet>());
  const Eigen::Matrix<Jet, 3, 3> e =
      Essential<Jet>(cameras_[pair.image1], cameras_[pair.image2], direction, point, Jet(angle, 4));
  for (size_t k = 0; k < pair.matches.size(); ++k) {
    const Jet error = Jet(pair.focal) * Sampson<Jet>(e, pair.matches[k]);
    if (!std::isfinite(error.a) || !error.v.allFinite()) continue;
    const double ratio = error.a / scale_px;
    const double weight = 1 / ((1 + ratio * ratio) * (1 + ratio * ratio));  // Geman-McClure: far ones vanish
    accumulate(static_cast<int>(k), error.a, error.v, weight);
  }
}

// Votes and Gauss-Newton steps in turn, with the bound drawn in to `last_bound`; each pair's angle is
// eliminated from the normal equations.
Solver::Candidate Solver::Refine(const std::vector<Pair>& pairs, Candidate candidate, double last_bound) {
  const int num = AxisParameters();
  for (double factor = 0.1; factor > 0.003; factor *= 0.6) {
    const Frame frame = FrameAcross(candidate.axis.direction, sight_);
    MatrixXd normal = 1e-9 * MatrixXd::Identity(num, num);
    VectorXd right = VectorXd::Zero(num);
    for (const Pair& pair : pairs) {
      const double bound = std::max(last_bound, SearchBound(pair, factor));
      const Vote vote = BestAngle(pair, candidate.axis, bound, 24);
      if (vote.score < 3) continue;
      MatrixXd of_pair = MatrixXd::Zero(num, num);
      VectorXd gradient = VectorXd::Zero(num);
      VectorXd mixed = VectorXd::Zero(num);
      double of_angle = 1e-12;
      double gradient_angle = 0;
      Linearize(pair, candidate.axis, frame, vote.angle, 0.5 * bound,
                [&](int, double error, const Eigen::Matrix<double, 5, 1>& derivative, double weight) {
                  if (std::abs(error) > bound) return;
                  const VectorXd j = derivative.head(num);
                  of_pair += weight * j * j.transpose();
                  gradient += weight * j * error;
                  mixed += weight * j * derivative(4);
                  of_angle += weight * derivative(4) * derivative(4);
                  gradient_angle += weight * derivative(4) * error;
                });
      // In units of the pair's bound, so that pairs of long and of short moves count alike.
      normal += (of_pair - mixed * mixed.transpose() / of_angle) / (bound * bound);
      right -= (gradient - mixed * gradient_angle / of_angle) / (bound * bound);
    }
    VectorXd step = normal.ldlt().solve(right);
    if (!step.allFinite()) break;
    const double longest = step.cwiseAbs().maxCoeff();
    if (longest > 0.3) step *= 0.3 / longest;
    candidate.axis = Moved(candidate.axis, frame, step);
  }
  candidate.score = 0;
  for (const Pair& pair : pairs) {
    candidate.score += std::max(0.0, BestAngle(pair, candidate.axis, last_bound, 48).score - 2);
  }
  return candidate;
}

// Angles of images from angles of pairs: a maximum spanning tree by votes, then reweighted least squares on
// the circle over all pairs.
void Solver::Synchronize(const std::vector<Vote>& votes) {
  const size_t num = cameras_.size();
  std::vector<std::vector<size_t>> edges(num);
  for (size_t p = 0; p < pairs_.size(); ++p) {
    if (votes[p].score < 2.5) continue;  // two matches agree by chance
    edges[pairs_[p].image1].push_back(p);
    edges[pairs_[p].image2].push_back(p);
  }
  angles_.assign(num, 0);
  connected_.assign(num, 0);
  // The largest tree: grown from every image that is not in one yet.
  std::vector<char> seen(num, 0);
  size_t largest = 0;
  for (size_t root = 0; root < num; ++root) {
    if (seen[root] != 0) continue;
    std::vector<char> in_tree(num, 0);
    std::vector<double> angles(num, 0);
    std::priority_queue<std::pair<double, std::pair<size_t, size_t>>> queue;  // votes, (pair, new image)
    size_t size = 0;
    const auto enter = [&](size_t image) {
      in_tree[image] = seen[image] = 1;
      ++size;
      for (const size_t p : edges[image]) {
        const auto other =
            static_cast<size_t>(pairs_[p].image1) == image ? pairs_[p].image2 : pairs_[p].image1;
        if (in_tree[other] == 0) queue.push({votes[p].score, {p, static_cast<size_t>(other)}});
      }
    };
    enter(root);
    while (!queue.empty()) {
      const auto [p, image] = queue.top().second;
      queue.pop();
      if (in_tree[image] != 0) continue;
      angles[image] = static_cast<size_t>(pairs_[p].image2) == image
                          ? angles[pairs_[p].image1] + votes[p].angle
                          : angles[pairs_[p].image2] - votes[p].angle;
      enter(image);
    }
    if (size <= largest) continue;
    largest = size;
    angles_ = angles;
    connected_ = in_tree;
  }

  const auto n = static_cast<Eigen::Index>(num);
  for (double scale = 40 * kDegree; scale > 0.2 * kDegree; scale *= 0.7) {
    MatrixXd normal = 1e-9 * MatrixXd::Identity(n, n);
    VectorXd right = VectorXd::Zero(n);
    for (size_t p = 0; p < pairs_.size(); ++p) {
      const int i = pairs_[p].image1;
      const int j = pairs_[p].image2;
      if (votes[p].score < 2.5 || connected_[i] == 0 || connected_[j] == 0) continue;
      const double error = WrapAngle(votes[p].angle - (angles_[j] - angles_[i]));
      const double ratio = error / scale;
      const double weight = votes[p].score / ((1 + ratio * ratio) * (1 + ratio * ratio));
      normal(i, i) += weight;
      normal(j, j) += weight;
      normal(i, j) -= weight;
      normal(j, i) -= weight;
      right(j) += weight * error;
      right(i) -= weight * error;
    }
    const VectorXd step = normal.ldlt().solve(right);
    for (size_t i = 0; i < num; ++i) angles_[i] += step(static_cast<Eigen::Index>(i));
  }
}

// Which matches agree with the axis and the images' angles; the robust standard deviation of their errors.
double Solver::MarkInliers(const Axis& axis, double bound_px) {
  solution_.inliers.assign(input_.pairs.size(), {});
  for (size_t p = 0; p < input_.pairs.size(); ++p)
    solution_.inliers[p].assign(input_.pairs[p].matches.size(), 0);
  for (SingleAxisImageFit& fit : solution_.images) fit.inliers = 0;
  std::vector<double> errors;
  size_t all = 0;
  for (const Pair& pair : pairs_) {
    if (connected_[pair.image1] == 0 || connected_[pair.image2] == 0) continue;
    const double angle = angles_[pair.image2] - angles_[pair.image1];
    const Camera3& first = cameras_[pair.image1];
    const Camera3& second = cameras_[pair.image2];
    const Matrix3d e = Essential<double>(first, second, axis.direction, axis.point, angle);
    const Matrix3d turn = RotationAbout<double>(axis.direction, angle);
    all += pair.matches.size();
    for (const Match& match : pair.matches) {
      const double error = std::abs(pair.focal * Sampson<double>(e, match));
      if (!(error <= bound_px) || !InFront(first, second, axis, turn, match)) continue;
      errors.push_back(error);
      solution_.inliers[pair.index][match.index] = 1;
      ++solution_.images[pair.image1].inliers;
      ++solution_.images[pair.image2].inliers;
    }
  }
  solution_.inlier_ratio = all > 0 ? static_cast<double>(errors.size()) / static_cast<double>(all) : 0;
  return kMadToSigma * Median(errors);
}

// Images that agreeing matches tie to the reference.
void Solver::FindConnected() {
  std::vector<std::vector<int>> neighbours(cameras_.size());
  for (const Pair& pair : pairs_) {
    const std::vector<char>& inliers = solution_.inliers[pair.index];
    const auto agreeing = std::count(inliers.begin(), inliers.end(), 1);
    if (agreeing < 3) continue;
    neighbours[pair.image1].push_back(pair.image2);
    neighbours[pair.image2].push_back(pair.image1);
  }
  std::vector<char> best(cameras_.size(), 0);
  std::vector<char> seen(cameras_.size(), 0);
  std::ptrdiff_t largest = 0;
  for (size_t root = 0; root < cameras_.size(); ++root) {
    if (seen[root] != 0 || connected_[root] == 0) continue;
    std::vector<char> component(cameras_.size(), 0);
    std::vector<int> stack = {static_cast<int>(root)};
    seen[root] = component[root] = 1;
    while (!stack.empty()) {
      const int image = stack.back();
      stack.pop_back();
      for (const int next : neighbours[image]) {
        if (seen[next] != 0) continue;
        seen[next] = component[next] = 1;
        stack.push_back(next);
      }
    }
    const auto size = std::count(component.begin(), component.end(), 1);
    if (size <= largest) continue;
    largest = size;
    best = component;
  }
  connected_ = best;
}

// Gauss-Newton over axis and images' angles on all matches.
void Solver::AdjustAll(Axis* axis, double scale_px, int iterations, bool covariance) {
  const int num = AxisParameters();
  std::vector<int> column(cameras_.size(), -1);
  int size = num;
  int reference = -1;
  for (size_t i = 0; i < cameras_.size(); ++i) {
    if (connected_[i] == 0) continue;
    if (reference < 0 || input_.images[i].name < input_.images[reference].name)
      reference = static_cast<int>(i);
  }
  if (reference < 0) return;
  for (size_t i = 0; i < cameras_.size(); ++i) {
    if (connected_[i] != 0 && static_cast<int>(i) != reference) column[i] = size++;
  }
  MatrixXd normal;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    if (reporter_.StopRequested()) throw Interrupted();
    const Frame frame = FrameAcross(axis->direction, sight_);
    normal = MatrixXd::Zero(size, size);
    VectorXd right = VectorXd::Zero(size);
    for (const Pair& pair : pairs_) {
      if (connected_[pair.image1] == 0 || connected_[pair.image2] == 0) continue;
      Eigen::Matrix<double, 5, 5> of_pair = Eigen::Matrix<double, 5, 5>::Zero();
      Eigen::Matrix<double, 5, 1> gradient = Eigen::Matrix<double, 5, 1>::Zero();
      Linearize(pair, *axis, frame, angles_[pair.image2] - angles_[pair.image1], scale_px,
                [&](int, double error, const Eigen::Matrix<double, 5, 1>& derivative, double weight) {
                  of_pair += weight * derivative * derivative.transpose();
                  gradient += weight * derivative * error;
                });
      const int first = column[pair.image1];
      const int second = column[pair.image2];
      normal.topLeftCorner(num, num) += of_pair.topLeftCorner(num, num);
      right.head(num) -= gradient.head(num);
      for (const auto& [at, sign] : {std::make_pair(first, -1.0), std::make_pair(second, 1.0)}) {
        if (at < 0) continue;
        normal.block(0, at, num, 1) += sign * of_pair.block(0, 4, num, 1);
        normal.block(at, 0, 1, num) += sign * of_pair.block(4, 0, 1, num);
        normal(at, at) += of_pair(4, 4);
        right(at) -= sign * gradient(4);
      }
      if (first >= 0 && second >= 0) {
        normal(first, second) -= of_pair(4, 4);
        normal(second, first) -= of_pair(4, 4);
      }
    }
    const VectorXd diagonal = normal.diagonal();
    normal.diagonal() += 1e-9 * diagonal;
    VectorXd step = normal.ldlt().solve(right);
    normal.diagonal() = diagonal;
    if (!step.allFinite()) return;
    const double longest = step.cwiseAbs().maxCoeff();
    if (longest > 0.2) step *= 0.2 / longest;
    *axis = Moved(*axis, frame, step);
    for (size_t i = 0; i < cameras_.size(); ++i) {
      if (column[i] >= 0) angles_[i] += step(column[i]);
    }
    if (longest < 1e-13) break;
  }
  solution_.reference = reference;
  if (!covariance) return;
  const MatrixXd inverse = normal.completeOrthogonalDecomposition().pseudoInverse();
  const double variance = solution_.sigma_px * solution_.sigma_px;
  const auto worst = [&](int at, int count, double unit) {
    const MatrixXd block = variance * inverse.block(at, at, count, count);
    return unit *
           std::sqrt(std::max(0.0, Eigen::SelfAdjointEigenSolver<MatrixXd>(block).eigenvalues()(count - 1)));
  };
  solution_.axis_direction_sigma_deg = worst(0, 2, 1 / kDegree);
  solution_.axis_point_sigma = worst(2, num - 2, radius_);
  for (size_t i = 0; i < cameras_.size(); ++i) {
    if (column[i] >= 0) solution_.images[i].sigma_deg = worst(column[i], 1, 1 / kDegree);
  }
}

// The axis' sign: cameras look down, or image tops are up where they look level.
void Solver::Orient() {
  Vector3d view = Vector3d::Zero();
  Vector3d up = Vector3d::Zero();
  int count = 0;
  for (size_t i = 0; i < cameras_.size(); ++i) {
    if (connected_[i] == 0) continue;
    view += cameras_[i].from_world.row(2).transpose();
    up -= cameras_[i].from_world.row(1).transpose();
    ++count;
  }
  const double down = -solution_.axis.direction.dot(view) / std::max(1, count);
  const bool turn = std::abs(down) > std::sin(5 * kDegree) ? down < 0 : solution_.axis.direction.dot(up) < 0;
  if (!turn) return;
  solution_.axis.direction = -solution_.axis.direction;
  for (double& angle : angles_) angle = -angle;
}

void Solver::MeasureSteps() {
  std::map<int, std::vector<std::pair<std::string, size_t>>> stations;
  for (size_t i = 0; i < cameras_.size(); ++i) {
    if (solution_.images[i].found) stations[input_.images[i].station].emplace_back(input_.images[i].name, i);
  }
  for (auto& [station, images] : stations) {
    if (images.size() < 4) continue;
    std::sort(images.begin(), images.end());
    std::vector<double> steps;
    for (size_t k = 1; k < images.size(); ++k) {
      steps.push_back(WrapAngle(solution_.images[images[k].second].angle_rad -
                                solution_.images[images[k - 1].second].angle_rad));
    }
    // Unwrapped along the median step, then a line.
    const double median = Median(steps);
    const double first = solution_.images[images[0].second].angle_rad;
    const auto n = static_cast<double>(images.size());
    double sum_k = 0;
    double sum_kk = 0;
    double sum_r = 0;
    double sum_kr = 0;
    double variance = 0;
    std::vector<double> rest;
    for (size_t k = 0; k < images.size(); ++k) {
      const SingleAxisImageFit& fit = solution_.images[images[k].second];
      const auto x = static_cast<double>(k);
      const double r = WrapAngle(fit.angle_rad - first - median * x);
      rest.push_back(r);
      sum_k += x;
      sum_kk += x * x;
      sum_r += r;
      sum_kr += x * r;
      variance += fit.sigma_deg * fit.sigma_deg / n;
    }
    const double slope = (n * sum_kr - sum_k * sum_r) / (n * sum_kk - sum_k * sum_k);
    const double start = (sum_r - slope * sum_k) / n;
    double squares = 0;
    for (size_t k = 0; k < rest.size(); ++k) {
      const double r = rest[k] - start - slope * static_cast<double>(k);
      squares += r * r / n;
    }
    EqualSteps steps_of_station;
    steps_of_station.station = station;
    steps_of_station.step_deg = (median + slope) / kDegree;
    steps_of_station.rms_deg = std::sqrt(squares) / kDegree;
    steps_of_station.consistent = steps_of_station.rms_deg <= 3 * std::sqrt(variance) + 1e-9;
    solution_.steps.push_back(steps_of_station);
  }
}

SingleAxisSolution Solver::Solve() {
  solution_.images.resize(input_.images.size());
  solution_.inliers.resize(input_.pairs.size());
  for (size_t p = 0; p < input_.pairs.size(); ++p)
    solution_.inliers[p].assign(input_.pairs[p].matches.size(), 0);
  if (!Prepare()) return solution_;
  solution_.scale_observable = scale_observable_;

  const double bound = kInlierSigmas * options_.noise_px;
  const std::vector<Pair> search = SearchPairs();
  std::vector<Candidate> candidates = CoarseSearch(search);
  if (static_cast<int>(candidates.size()) > options_.num_refined) candidates.resize(options_.num_refined);
  for (Candidate& candidate : candidates) {
    if (reporter_.StopRequested()) throw Interrupted();
    candidate = Refine(search, candidate, bound);
  }
  std::sort(candidates.begin(), candidates.end(),
            [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  Axis axis = candidates[0].axis;
  solution_.margin = std::numeric_limits<double>::infinity();
  for (const Candidate& other : candidates) {
    if (std::abs(other.axis.direction.dot(axis.direction)) > std::cos(kDistinctAxes)) continue;
    solution_.margin = candidates[0].score / std::max(other.score, 1e-9);
    break;
  }

  // Twice: the axis adjusted to all pairs tells the pairs' angles better than the one of the search.
  for (int pass = 0; pass < 2; ++pass) {
    std::vector<Vote> votes;
    votes.reserve(pairs_.size());
    for (const Pair& pair : pairs_) votes.push_back(BestAngle(pair, axis, bound, 120));
    Synchronize(votes);
    for (const double scale : {8.0, 4.0, 2.0, 1.0}) {
      AdjustAll(&axis, scale * bound, 5, false);
    }
  }
  double sigma = MarkInliers(axis, bound);
  FindConnected();
  for (int round = 0; round < 2; ++round) {
    // Drawn in to what the noise turns out to be, but not to nothing: rounding is no noise.
    const double least = std::max(sigma, 1e-9);
    AdjustAll(&axis, 2.5 * least, 15, false);
    solution_.sigma_px = sigma;
    sigma = MarkInliers(axis, std::max(std::min(bound, 4 * least), 1e-6));
    FindConnected();
  }
  solution_.sigma_px = sigma;
  AdjustAll(&axis, 2.5 * std::max(sigma, 1e-9), 20, true);
  MarkInliers(axis, bound);

  solution_.axis = {axis.point, axis.direction};
  Orient();
  const auto found = std::count(connected_.begin(), connected_.end(), 1);
  if (found < 2) {
    solution_.reason = "no two images agree on a turn";
    return solution_;
  }
  if (solution_.inlier_ratio < options_.min_inlier_ratio) {
    solution_.reason = "too few matches agree with any one axis";
    return solution_;
  }
  const double zero = angles_[solution_.reference];
  for (size_t i = 0; i < cameras_.size(); ++i) {
    SingleAxisImageFit& fit = solution_.images[i];
    fit.found = connected_[i] != 0;
    fit.angle_rad = fit.found ? WrapAngle(angles_[i] - zero) : 0;
  }
  solution_.found = true;
  MeasureSteps();
  return solution_;
}

}  // namespace

OptionCheck SingleAxisOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, std::to_string(value), bound};
  };
  if (!(noise_px > 0)) return fault("noise_px", noise_px, "noise_px > 0");
  if (min_matches < 3) return fault("min_matches", min_matches, "min_matches >= 3");
  if (max_search_pairs < 1) return fault("max_search_pairs", max_search_pairs, "max_search_pairs >= 1");
  if (max_search_matches < 3)
    return fault("max_search_matches", max_search_matches, "max_search_matches >= 3");
  if (num_directions < 1) return fault("num_directions", num_directions, "num_directions >= 1");
  if (offsets_per_side < 1) return fault("offsets_per_side", offsets_per_side, "offsets_per_side >= 1");
  if (num_refined < 1) return fault("num_refined", num_refined, "num_refined >= 1");
  if (max_matches < 3) return fault("max_matches", max_matches, "max_matches >= 3");
  return std::nullopt;
}

Rigid3 SingleAxisSolution::WorldFromObject(int image) const {
  const Matrix3d turn = RotationAbout<double>(axis.direction, images[image].angle_rad);
  return {Eigen::Quaterniond(turn), axis.point - turn * axis.point};
}

SingleAxisSolution SolveSingleAxis(const SingleAxisInput& input, const SingleAxisOptions& options,
                                   Reporter& reporter) {
  S2GS_INVARIANT(!options.Check());
  return Solver(input, options, reporter).Solve();
}

}  // namespace s2gs
