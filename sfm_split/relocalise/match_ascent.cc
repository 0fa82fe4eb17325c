#include "sfm_split/relocalise/match_ascent.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <string>
#include <tuple>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/scene/axis_turn.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr size_t kTops = 3;             // of the turns of one station
constexpr size_t kMaxMatches = 30000;   // that count; of more pairs, an even choice
constexpr int kNoiseRounds = 4;         // at most; noise and places by turns
constexpr double kNoiseSettled = 0.01;  // of itself
constexpr int kMaxSteps = 40;           // at one noise
constexpr double kSettled = 0.01;       // of a logarithm of a likelihood
constexpr double kRounding = 1e-9;      // of unit vectors and poses of one camera
constexpr double kFirstDamping = 1e-3;  // Levenberg-Marquardt's usual: of the diagonal
constexpr double kLeastDamping = 1e-9;  // beside it the diagonal is what it was, to rounding
constexpr double kMostDamping = 1e6;    // steps are too short then to gain what kSettled asks for
constexpr double kUntold = 1e-6;        // of the largest curvature: what is so flat stays

// How far before a camera its optical axis is nearest to the table's.
double DepthOfAxis(const Rigid3& cam_from_world, const TurntableAxis& axis) {
  const Vector3d forward = cam_from_world.rotation.conjugate() * Vector3d::UnitZ();
  const Vector3d across = forward - forward.dot(axis.direction) * axis.direction;
  return across.dot(axis.point - CameraCentre(cam_from_world)) / std::max(across.squaredNorm(), kRounding);
}

}  // namespace

MatchAscent::MatchAscent(const ScanFeatures& features, const std::vector<PossiblePair>& object_pairs,
                         const AlignedScene& aligned)
    : axis_(aligned.scene.axis) {
  std::map<std::string, size_t> view_of_name;
  for (size_t v = 0; v < aligned.scene.views.size(); ++v) {
    const View& view = aligned.scene.views[v];
    view_of_name[view.name] = v;
    const bool is_new =
        place_of_station_.emplace(view.station, static_cast<int>(state_.stations.size())).second;
    if (is_new) state_.stations.push_back({view.cam_from_world, 0});
    const AscentStation& station = state_.stations[static_cast<size_t>(place_of_station_.at(view.station))];
    are_shared_ &= AreCamerasClose(axis_, station.cam_from_world, view.cam_from_world, kRounding);
  }
  for (const Camera& camera : aligned.scene.cameras) {
    place_of_camera_[camera.camera_id] = static_cast<int>(state_.log_focal.size());
    state_.log_focal.push_back(std::log(FocalLengths(camera).mean()));
    priors_.push_back(
        FocalPriorOf(features.cameras.at(camera.camera_id), HasPriorFocal(features, camera.camera_id)));
  }
  for (const ScanImage& image : features.images) {
    const auto found = view_of_name.find(image.name);
    view_of_.push_back(found == view_of_name.end() ? std::nullopt : std::optional<size_t>(found->second));
  }
  if (state_.stations.size() < 2) return;
  AddPairs(features, aligned, object_pairs, true);
  // Without a model of the background the cameras of different stations have no common world.
  has_background_ = !aligned.background.images.empty();
  if (has_background_) AddPairs(features, aligned, PossibleBackgroundPairs(features), false);
  Thin(kMaxMatches);
}

void MatchAscent::AddPairs(const ScanFeatures& features, const AlignedScene& aligned,
                           const std::vector<PossiblePair>& possible, bool is_object) {
  const auto undistorted = [&](const Camera& camera, const Eigen::Vector2f& xy) {
    std::optional<Vector3d> ray = UnprojectFromImage(camera, xy.cast<double>());
    std::optional<Eigen::Vector2d> result;
    if (ray) result = ray->hnormalized() * FocalLengths(camera).mean();
    return result;
  };
  for (const PossiblePair& given : possible) {
    const auto i = static_cast<size_t>(given.image1);
    const auto j = static_cast<size_t>(given.image2);
    if (!view_of_[i] || !view_of_[j]) continue;
    const View& one = aligned.scene.views[*view_of_[i]];
    const View& two = aligned.scene.views[*view_of_[j]];
    AscentPair pair;
    pair.station1 = place_of_station_.at(one.station);
    pair.station2 = place_of_station_.at(two.station);
    if (!is_object && pair.station1 == pair.station2) continue;
    pair.camera1 = place_of_camera_.at(one.camera_id);
    pair.camera2 = place_of_camera_.at(two.camera_id);
    pair.is_object = is_object;
    pair.angle1_rad = one.angle_deg * kDegree;
    pair.angle2_rad = two.angle_deg * kDegree;
    const Camera& camera1 = aligned.scene.cameras[static_cast<size_t>(pair.camera1)];
    const Camera& camera2 = aligned.scene.cameras[static_cast<size_t>(pair.camera2)];
    for (size_t m = 0; m < given.matches.size(); ++m) {
      const auto xy1 = undistorted(camera1, features.images[i].keypoints[given.matches[m].point2D_idx1]);
      const auto xy2 = undistorted(camera2, features.images[j].keypoints[given.matches[m].point2D_idx2]);
      if (!xy1 || !xy2) continue;
      pair.matches.emplace_back(*xy1, *xy2);
      pair.chance.push_back(given.chance[m]);
      if (!given.weight.empty()) pair.weight.push_back(given.weight[m]);
    }
    if (!pair.matches.empty()) pairs_.push_back(std::move(pair));
  }
}

std::array<int, kAscentOfPair> MatchAscent::PlacesOf(const AscentPair& pair) const {
  std::array<int, kAscentOfPair> places{};
  for (int k = 0; k < kAscentOfStation; ++k) {
    places[static_cast<size_t>(k)] = kAscentOfStation * pair.station1 + k;
    places[static_cast<size_t>(kAscentOfStation + k)] = kAscentOfStation * pair.station2 + k;
  }
  const int focals = kAscentOfStation * static_cast<int>(state_.stations.size());
  places[2 * kAscentOfStation] = focals + pair.camera1;
  places[2 * kAscentOfStation + 1] = focals + pair.camera2;
  return places;
}

double MatchAscent::Value(const AscentNoise& noise) const {
  double value = 0;
  for (const AscentValue& sum : ValuesOf(pairs_, state_, axis_, noise)) value += sum.value;
  for (size_t c = 0; c < priors_.size(); ++c) value += priors_[c].LogDensity(state_.log_focal[c]);
  return value;
}

void MatchAscent::Linearize(const AscentNoise& noise, MatrixXd* normal, VectorXd* right) const {
  *normal = MatrixXd::Zero(NumUnknowns(), NumUnknowns());
  *right = VectorXd::Zero(NumUnknowns());
  const std::vector<AscentStep> sums = StepsOf(pairs_, state_, axis_, noise);
  for (size_t p = 0; p < pairs_.size(); ++p) {
    const std::array<int, kAscentOfPair> places = PlacesOf(pairs_[p]);
    for (int a = 0; a < kAscentOfPair; ++a) {
      (*right)(places[static_cast<size_t>(a)]) += sums[p].right(a);
      for (int b = 0; b < kAscentOfPair; ++b)
        (*normal)(places[static_cast<size_t>(a)], places[static_cast<size_t>(b)]) += sums[p].normal(a, b);
    }
  }
  const auto focals = static_cast<Eigen::Index>(kAscentOfStation * state_.stations.size());
  for (size_t c = 0; c < priors_.size(); ++c) {
    const FocalNormal& prior = priors_[c].At(state_.log_focal[c]);
    const double weight = 1 / (prior.sigma_log * prior.sigma_log);
    const Eigen::Index at = focals + static_cast<Eigen::Index>(c);
    (*normal)(at, at) += weight;
    (*right)(at) -= weight * (state_.log_focal[c] - std::log(prior.focal_px));
  }
}

AscentState MatchAscent::Moved(const VectorXd& step) const {
  State moved = state_;
  for (size_t s = 0; s < moved.stations.size(); ++s) {
    const auto at = static_cast<Eigen::Index>(kAscentOfStation * s);
    AscentStation& station = moved.stations[s];
    const Matrix3d turn = ExpRotation<double>(step.segment<3>(at));
    station.cam_from_world.rotation =
        Eigen::Quaterniond(turn * station.cam_from_world.rotation.toRotationMatrix()).normalized();
    station.cam_from_world.translation += step.segment<3>(at + 3);
    station.turn_rad += step(at + 6);
  }
  const auto focals = static_cast<Eigen::Index>(kAscentOfStation * moved.stations.size());
  for (size_t c = 0; c < moved.log_focal.size(); ++c)
    moved.log_focal[c] += step(focals + static_cast<Eigen::Index>(c));
  return moved;
}

// A turn that is held has no step. The part of a camera's small turn that is about the axis is held by a
// weight beside which nothing else counts.
void MatchAscent::Hold(MatrixXd* normal, VectorXd* right) const {
  const double heavy = normal->diagonal().maxCoeff() / kUntold;
  for (const size_t station : held_turns_) {
    const auto first = static_cast<Eigen::Index>(kAscentOfStation * station);
    if (!has_background_) {
      const Vector3d about_axis = state_.stations[station].cam_from_world.rotation * axis_.direction;
      normal->block<3, 3>(first, first) += heavy * about_axis * about_axis.transpose();
    }
    const Eigen::Index held = first + 6;
    normal->row(held).setZero();
    normal->col(held).setZero();
    (*normal)(held, held) = 1;
    (*right)(held) = 0;
  }
}

double MatchAscent::Climb(const AscentNoise& noise, int max_steps, Reporter& reporter) {
  double damping = kFirstDamping;
  double value = Value(noise);
  MatrixXd normal;
  VectorXd right;
  for (int k = 0; k < max_steps && damping < kMostDamping; ++k) {
    if (reporter.StopRequested()) throw Interrupted();
    Linearize(noise, &normal, &right);
    Hold(&normal, &right);
    double gained = 0;
    while (damping < kMostDamping) {
      MatrixXd damped = normal;
      // What nothing tells, the common place, turn and unit of length of all, stays.
      damped.diagonal() += damping * normal.diagonal();
      damped.diagonal().array() += damping * kUntold * normal.diagonal().maxCoeff();
      State before = std::exchange(state_, Moved(damped.ldlt().solve(right)));
      gained = Value(noise) - value;
      if (gained > 0) break;
      state_ = std::move(before);
      damping *= 10;
    }
    if (!(gained > 0)) break;
    value += gained;
    damping = std::max(damping / 10, kLeastDamping);
    if (gained < kSettled) break;
  }
  return value;
}

AscentNoise MatchAscent::NoiseBy(const AscentNoise& noise) const {
  std::array<double, 2> squares{};  // of the object, of the background
  std::array<double, 2> inliers{};
  const std::vector<AscentValue> sums = ValuesOf(pairs_, state_, axis_, noise);
  for (size_t p = 0; p < pairs_.size(); ++p) {
    if (pairs_[p].is_object && pairs_[p].station1 != pairs_[p].station2) continue;
    const size_t body = pairs_[p].is_object ? 0 : 1;
    inliers[body] += sums[p].inliers;
    squares[body] += sums[p].squares;
  }
  const auto of = [&](size_t body) {
    return std::clamp(std::sqrt(squares[body] / std::max(inliers[body], 1e-9)), kLeastSigmaPx, kMostSigmaPx);
  };
  return {of(0), of(1)};
}

AscentNoise MatchAscent::Settle(AscentNoise noise, Reporter& reporter) {
  for (int k = 0; k < kNoiseRounds; ++k) {
    Climb(noise, kMaxSteps, reporter);
    const AscentNoise next = NoiseBy(noise);
    const bool is_settled = std::abs(next.object - noise.object) <= kNoiseSettled * next.object &&
                            std::abs(next.background - noise.background) <= kNoiseSettled * next.background;
    noise = next;
    if (is_settled) break;
  }
  return noise;
}

// The world may turn about the axis, move along it and grow, and the object's frame turn, and nothing
// changes; without a background each station's camera may turn about the axis by itself, as its table angles
// turn back.
int MatchAscent::NumTold() const {
  const int untold = has_background_ ? 4 : 3 + static_cast<int>(state_.stations.size());
  return NumUnknowns() - untold;
}

// Whole pairs, evenly of each two stations: of a few matches of each pair nobody knows which are right.
void MatchAscent::Thin(size_t max_matches) {
  size_t total = 0;
  for (const AscentPair& pair : pairs_) total += pair.matches.size();
  const size_t stride = 1 + total / max_matches;
  std::map<std::tuple<bool, int, int>, size_t> next;
  std::vector<AscentPair> kept;
  for (AscentPair& pair : pairs_) {
    if (next[{pair.is_object, pair.station1, pair.station2}]++ % stride == 0) kept.push_back(std::move(pair));
  }
  pairs_ = std::move(kept);
}

// How far the object's points lie from its middle [px]: those that have nothing to do with each other are
// twice as far apart, squared.
double MatchAscent::RadiusPx() const {
  double squares = 0;
  double num = 0;
  for (const AscentPair& pair : pairs_) {
    if (!pair.is_object) continue;
    for (const auto& [xy1, xy2] : pair.matches) squares += (xy1 - xy2).squaredNorm();
    num += static_cast<double>(pair.matches.size());
  }
  return std::max(1.0, std::sqrt(squares / std::max(1.0, 2 * num)));
}

// Turns of one station against the others at which, the rest held, the matches are likelier than at the turns
// beside, the likeliest first [rad].
std::vector<double> MatchAscent::TurnsAlone(size_t station, double sigma_px, double step_px) const {
  const auto num = static_cast<int64_t>(std::ceil(2 * kPi * RadiusPx() / step_px));
  const double step = 2 * kPi / static_cast<double>(num);
  std::vector<double> values(static_cast<size_t>(num));
  ParallelFor(num, 0, [&](int64_t k) {
    State turned = state_;
    turned.stations[station].turn_rad += static_cast<double>(k) * step;
    for (const AscentPair& pair : pairs_) {
      const bool is_first = static_cast<size_t>(pair.station1) == station;
      const bool is_second = static_cast<size_t>(pair.station2) == station;
      if (pair.is_object && is_first != is_second)
        values[static_cast<size_t>(k)] += ValueOf(pair, turned, axis_, sigma_px).value;
    }
  });
  std::vector<std::pair<double, double>> tops;  // value and turn
  for (size_t k = 0; k < values.size(); ++k) {
    const double before = values[(k + values.size() - 1) % values.size()];
    const double after = values[(k + 1) % values.size()];
    if (k > 0 && values[k] > before && values[k] >= after)
      tops.emplace_back(values[k], WrapAngle(static_cast<double>(k) * step));
  }
  std::sort(tops.begin(), tops.end(), std::greater<>());
  if (tops.size() > kTops) tops.resize(kTops);
  std::vector<double> turns;
  turns.reserve(tops.size());
  for (const auto& [value, turn_rad] : tops) turns.push_back(turn_rad);
  return turns;
}

void MatchAscent::Apply(AlignedScene* aligned) const {
  TurntableScene& scene = aligned->scene;
  // The unit of length is that of the cameras' mean distance from the axis.
  double before = 0;
  double after = 0;
  for (const View& view : scene.views) {
    const AscentStation& station = state_.stations[static_cast<size_t>(place_of_station_.at(view.station))];
    const auto distance = [&](const Rigid3& cam_from_world) {
      return (CameraCentre(cam_from_world) - axis_.point).cross(axis_.direction).norm();
    };
    before += distance(view.cam_from_world);
    after += distance(station.cam_from_world);
  }
  double scale = after > 0 ? before / after : 1;
  // Epipolar errors are the same for cameras that stand opposite, with all they see behind them.
  const auto num_facing =
      std::count_if(state_.stations.begin(), state_.stations.end(),
                    [&](const auto& station) { return DepthOfAxis(station.cam_from_world, axis_) > 0; });
  if (2 * static_cast<size_t>(num_facing) < state_.stations.size()) scale = -scale;
  Sim3 about_axis;
  about_axis.scale = scale;
  about_axis.translation = (1 - scale) * axis_.point;
  std::map<std::string, Rigid3> pose_of;
  double reference_rad = 0;
  for (const View& view : scene.views) {
    if (&view == scene.Reference())
      reference_rad = state_.stations[static_cast<size_t>(place_of_station_.at(view.station))].turn_rad;
  }
  for (View& view : scene.views) {
    const AscentStation& station = state_.stations[static_cast<size_t>(place_of_station_.at(view.station))];
    view.cam_from_world = TransformPose(about_axis, station.cam_from_world);
    const double angle = view.angle_deg * kDegree + station.turn_rad - reference_rad;
    view.angle_deg = WrapAngle(angle) / kDegree;
    view.world_from_object = TurnAbout(axis_, angle);
    pose_of[view.name] = view.cam_from_world;
  }
  for (size_t c = 0; c < scene.cameras.size(); ++c) {
    Camera& camera = scene.cameras[c];
    const double factor = std::exp(state_.log_focal[c]) / FocalLengths(camera).mean();
    for (size_t p = 0; p < InfoOf(camera.model).num_focal_params; ++p)
      camera.params[static_cast<size_t>(p)] *= factor;
    if (const std::optional<size_t> k = DistortionPlace(camera)) camera.params[*k] *= factor * factor;
    const auto in_background = aligned->background.cameras.find(camera.camera_id);
    if (in_background != aligned->background.cameras.end()) in_background->second = camera;
  }
  for (auto& [id, image] : aligned->background.images) {
    const auto found = pose_of.find(image.name);
    if (found != pose_of.end()) image.cam_from_world = found->second;
  }
  BringIntoConventions(aligned);
}

}  // namespace s2gs
