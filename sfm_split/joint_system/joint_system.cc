#include "sfm_split/joint_system/joint_system.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/union_find.h"
#include "sfm_split/joint_system/rim_circle.h"
#include "sfm_split/joint_system/wobble_prior.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

std::array<double, 6> PoseValues(const Vector3d& last) { return {0, 0, 0, last.x(), last.y(), last.z()}; }

Eigen::Quaterniond RotationOf(const std::array<double, 6>& values, const Matrix3d& r0) {
  return Eigen::Quaterniond(Matrix3d(ExpRotation<double>(Vector3d(values[0], values[1], values[2])) * r0))
      .normalized();
}

// Of a circle that is not before the camera: no step leads there.
constexpr double kLostPx = 1000;

// A rim's offset by the values of a pose's block (w, C), the axis', the circle's and a camera's.
double RimOffsetOfValues(Camera camera, const Matrix3d& r0, const Eigen::Vector2d& place,
                         const std::vector<double>& values, std::vector<double>* derivatives) {
  const Eigen::Map<const Vector3d> w(values.data());
  const Eigen::Map<const Vector3d> centre(values.data() + 3);
  const Eigen::Map<const Eigen::Vector4d> axis(values.data() + 6);
  camera.params.assign(values.begin() + 12, values.end());
  Rigid3 cam_from_world;
  cam_from_world.rotation = Eigen::Quaterniond(Matrix3d(ExpRotation<double>(w) * r0)).normalized();
  cam_from_world.translation = -(cam_from_world.rotation * centre);
  const std::optional<RimOffset> offset =
      OffsetFromRim(camera, cam_from_world, axis, {values[10], values[11]}, place);
  if (derivatives != nullptr) derivatives->assign(values.size(), 0);
  if (!offset) return kLostPx;
  if (derivatives == nullptr) return offset->px;
  const Eigen::RowVector3d by_w = offset->by_pose.head<3>() * LeftJacobian<double>(w);
  for (int k = 0; k < 3; ++k) (*derivatives)[static_cast<size_t>(k)] = by_w(k);
  for (int k = 3; k < 6; ++k) (*derivatives)[static_cast<size_t>(k)] = offset->by_pose(k);
  for (int k = 0; k < 4; ++k) (*derivatives)[static_cast<size_t>(6 + k)] = offset->by_axis(k);
  for (int k = 0; k < 2; ++k) (*derivatives)[static_cast<size_t>(10 + k)] = offset->by_circle(k);
  for (int k = 0; k < offset->by_camera.cols(); ++k)
    (*derivatives)[static_cast<size_t>(12 + k)] = offset->by_camera(k);
  return offset->px;
}

constexpr double kLossSigmas = 2;      // of a coordinate
constexpr double kLeastLossPx = 0.05;  // of points without any error

}  // namespace

double LossScalePx(double sigma_px) { return std::max(kLossSigmas * sigma_px, kLeastLossPx); }

double SigmaOfLossPx(double loss_scale_px) { return loss_scale_px / kLossSigmas; }

std::unique_ptr<ceres::LossFunction> MakeLoss(const JointOptions& options) {
  switch (options.loss) {
    case JointLoss::kSquared:
      return nullptr;
    case JointLoss::kHuber:
      return std::make_unique<ceres::HuberLoss>(options.loss_scale_px);
    case JointLoss::kCauchy:
      return std::make_unique<ceres::CauchyLoss>(options.loss_scale_px);
  }
  return nullptr;
}

JointSystem::JointSystem(const JointProblem& problem, const JointOptions& options, bool fix_gauge)
    : num_poses_(static_cast<int>(problem.cam_from_world.size())),
      num_cameras_(static_cast<int>(problem.cameras.size())),
      free_object_(problem.free_object),
      axis_direction_(problem.AxisDirection()),
      object_points_(problem.object.points),
      background_points_(problem.background.points) {
  S2GS_INVARIANT(problem.images.empty() ||
                 (problem.reference >= 0 && problem.reference < static_cast<int>(problem.images.size())));
  if (!problem.images.empty()) anchor_ = problem.images[problem.reference].pose;
  AddBlocks(problem, options);
  terms_.reserve(problem.object.observations.size() + problem.background.observations.size());
  AddTerms(problem, problem.object, true);
  AddTerms(problem, problem.background, false);
  TieByBackground(problem);
  if (fix_gauge && !problem.images.empty()) FixGauge(problem);
  AddPriors(problem, options);
}

void JointSystem::AddBlocks(const JointProblem& problem, const JointOptions& options) {
  // Filled before any address is taken.
  for (const Rigid3& pose : problem.cam_from_world) {
    poses_.push_back(PoseValues(CameraCentre(pose)));
    pose_rotations_.push_back(pose.rotation.toRotationMatrix());
  }
  for (const Camera& camera : problem.cameras) intrinsics_.push_back(camera.params);
  for (int k = 0; k < 4; ++k) axis_[k] = problem.axis(k);
  for (const JointImage& image : problem.images) {
    angles_.push_back(image.angle_rad);
    object_poses_.push_back(PoseValues(image.world_from_object.translation));
    object_rotations_.push_back(image.world_from_object.rotation.toRotationMatrix());
  }
  for (const EqualStepsPrior& turn : problem.priors.turns)
    equal_steps_.push_back({turn.offset_rad, turn.step_rad});
  if (problem.priors.wobble) harmonics_ = problem.priors.wobble->harmonics;

  const auto add = [&](double* values, int size, std::string name) {
    Block block;
    block.values = values;
    block.size = size;
    block.free.resize(size);
    std::iota(block.free.begin(), block.free.end(), 0);
    block.name = std::move(name);
    blocks_.push_back(std::move(block));
  };
  for (int s = 0; s < num_poses_; ++s) add(poses_[s].data(), 6, "station " + std::to_string(s));
  for (int c = 0; c < num_cameras_; ++c) {
    const CameraModelInfo& info = InfoOf(problem.cameras[c].model);
    add(intrinsics_[c].data(), static_cast<int>(intrinsics_[c].size()), "camera " + std::to_string(c));
    std::vector<int>& free = blocks_.back().free;
    free.clear();
    const std::vector<LensPrior>& lenses = problem.priors.lenses;
    const bool frees_principal =
        options.refine_principal_point || (static_cast<size_t>(c) < lenses.size() && lenses[c].principal);
    for (size_t k = 0; k < info.NumParams(); ++k) {
      const bool refine = k < info.num_focal_params    ? options.refine_focal_length
                          : k < info.FirstExtraParam() ? frees_principal
                                                       : options.refine_extra_params;
      if (refine) free.push_back(static_cast<int>(k));
    }
  }
  if (free_object_) {
    for (size_t i = 0; i < problem.images.size(); ++i) {
      add(object_poses_[i].data(), 6, "object at " + problem.images[i].name);
    }
  } else {
    add(axis_.data(), 4, "axis");
    for (size_t i = 0; i < problem.images.size(); ++i)
      add(&angles_[i], 1, "angle of " + problem.images[i].name);
  }
}

void JointSystem::AddTerms(const JointProblem& problem, const JointBody& body, bool of_object) {
  for (const JointObservation& observation : body.observations) {
    if (!observation.active) continue;
    const JointImage& image = problem.images[observation.image];
    const auto kind = !of_object     ? ReprojectionCost::Kind::kBackground
                      : free_object_ ? ReprojectionCost::Kind::kFreeObject
                                     : ReprojectionCost::Kind::kTurntable;
    Term term{
        ReprojectionCost(kind, problem.cameras[image.camera], observation.xy, &pose_rotations_[image.pose],
                         free_object_ ? &object_rotations_[observation.image] : nullptr, observation.spread)};
    term.weight = observation.weight;
    term.image = observation.image;
    term.point = observation.point;
    term.of_object = of_object;
    const auto add = [&](int block) {
      term.blocks[term.num_blocks] = block;
      term.values[term.num_blocks++] = blocks_[block].values;
      blocks_[block].used = true;
    };
    add(PoseBlock(image.pose));
    if (kind == ReprojectionCost::Kind::kFreeObject) add(ObjectPoseBlock(observation.image));
    if (kind == ReprojectionCost::Kind::kTurntable) {
      add(AxisBlock());
      add(AngleBlock(observation.image));
    }
    add(IntrinsicsBlock(image.camera));
    std::vector<Vector3d>& points = of_object ? object_points_ : background_points_;
    term.values[term.num_blocks] = points[observation.point].data();
    terms_.push_back(term);
  }
}

void JointSystem::AddPriors(const JointProblem& problem, const JointOptions& options) {
  const double scale_px =
      SigmaOfLossPx(options.loss_scale_px) *
      std::sqrt(std::max(1.0, problem.priors.data_inflation) * problem.priors.chosen_variance);
  if (!(scale_px > 0)) return;
  const auto is_free = [&](int block, int value) {
    const Block& of = blocks_[block];
    return of.used && std::find(of.free.begin(), of.free.end(), value) != of.free.end();
  };
  for (size_t c = 0; c < problem.priors.lenses.size(); ++c) {
    const LensPrior& lens = problem.priors.lenses[c];
    const int block = IntrinsicsBlock(static_cast<int>(c));
    PriorTerm focal;
    const auto num_focal = static_cast<int>(InfoOf(problem.cameras[c].model).num_focal_params);
    for (int k = 0; k < num_focal; ++k) focal.parts.push_back({block, k, 1.0 / num_focal});
    focal.of_logarithms = true;
    const FocalNormal& of_focal = lens.focal.At(std::log(FocalLengths(problem.cameras[c]).mean()));
    focal.mean = std::log(of_focal.focal_px);
    focal.sigma = of_focal.sigma_log;
    focal.scale_px = scale_px;
    if (num_focal > 0 && is_free(block, 0)) priors_.push_back(std::move(focal));
    for (int xy = 0; xy < 2 && lens.principal; ++xy) {
      PriorTerm principal;
      principal.parts = {{block, num_focal + xy, 1}};
      principal.mean = lens.principal->mean_px(xy);
      principal.sigma = lens.principal->sigma_px;
      principal.scale_px = scale_px;
      if (is_free(block, num_focal + xy)) priors_.push_back(std::move(principal));
    }
    const std::optional<size_t> k = DistortionPlace(problem.cameras[c]);
    if (!k || !lens.distortion || !is_free(block, static_cast<int>(*k))) continue;
    PriorTerm distortion;
    distortion.parts = {{block, static_cast<int>(*k), 1}};
    distortion.mean = *lens.distortion;
    distortion.sigma = kDistortionSigma;
    distortion.scale_px = scale_px;
    priors_.push_back(std::move(distortion));
  }
  // Poses of objects that are moved by hand lie about no steps.
  if (!free_object_ || !harmonics_.empty()) AddTurns(problem, scale_px);
  if (free_object_) {
    if (problem.priors.wobble) AddWobble(problem, scale_px);
    return;
  }
  for (const StationTurnPrior& turn : problem.priors.station_turns) AddStationTurn(turn, scale_px);
  AddRims(problem, scale_px);
}

void JointSystem::AddRims(const JointProblem& problem, double scale_px) {
  rim_circles_.resize(problem.priors.rims.size());  // before any address is taken
  for (size_t r = 0; r < problem.priors.rims.size(); ++r) {
    const RimPrior& rim = problem.priors.rims[r];
    const JointImage& image = problem.images[static_cast<size_t>(rim.image)];
    const Camera& camera = problem.cameras[static_cast<size_t>(image.camera)];
    const int pose = PoseBlock(image.pose);
    if (!blocks_[pose].used || !blocks_[AxisBlock()].used) continue;
    const std::optional<RimCircle> circle = NearestRimCircle(
        camera, problem.cam_from_world[static_cast<size_t>(image.pose)], problem.axis, rim.places);
    if (!circle) continue;
    rim_circles_[r] = {circle->height, circle->radius};
    Block block;
    block.values = rim_circles_[r].data();
    block.size = 2;
    block.free = {0, 1};
    block.name = "rim " + std::to_string(r);
    block.used = true;
    PriorTerm term;
    const auto add = [&](int of, int size) {
      for (int k = 0; k < size; ++k) term.parts.push_back({of, k, 1});
    };
    add(pose, 6);
    add(AxisBlock(), 4);
    add(static_cast<int>(blocks_.size()), 2);
    add(IntrinsicsBlock(image.camera), static_cast<int>(camera.params.size()));
    blocks_.push_back(std::move(block));
    term.sigma = rim.sigma_px;
    term.scale_px = scale_px;
    term.is_seen = true;
    for (const Eigen::Vector2d& place : rim.places) {
      term.function = [lens = camera, r0 = pose_rotations_[static_cast<size_t>(image.pose)], place](
                          const std::vector<double>& values, std::vector<double>* derivatives) {
        return RimOffsetOfValues(lens, r0, place, values, derivatives);
      };
      priors_.push_back(term);
    }
  }
}

void JointSystem::AddTurnOf(int image, double factor, PriorTerm* term) const {
  if (!free_object_) {
    term->parts.push_back({AngleBlock(image), 0, factor});
    return;
  }
  // A pose's rotation is exp(w) R: about the axis it turns by w's part along it, to first order in its tilt.
  for (int k = 0; k < 3; ++k) term->parts.push_back({ObjectPoseBlock(image), k, factor * axis_direction_(k)});
}

void JointSystem::AddTurns(const JointProblem& problem, double scale_px) {
  for (size_t t = 0; t < problem.priors.turns.size(); ++t) {
    const EqualStepsPrior& turn = problem.priors.turns[t];
    Block steps;
    steps.values = equal_steps_[t].data();
    steps.size = 2;
    steps.free = turn.closes ? std::vector<int>{0} : std::vector<int>{0, 1};
    steps.name = "equal steps " + std::to_string(t);
    const auto block = static_cast<int>(blocks_.size());
    for (const EqualStepsPrior::Place& place : turn.places) {
      if (!blocks_[free_object_ ? ObjectPoseBlock(place.image) : AngleBlock(place.image)].used) continue;
      steps.used = true;
      const double angle =
          free_object_ ? AngleAbout(axis_direction_, object_rotations_[place.image]) : angles_[place.image];
      // Angles are known but for whole turns.
      const double expected = turn.offset_rad + turn.step_rad * place.steps;
      PriorTerm term;
      AddTurnOf(place.image, 1, &term);
      term.parts.push_back({block, 0, -1});
      term.parts.push_back({block, 1, -place.steps});
      term.mean = 2 * kPi * std::round((angle - expected) / (2 * kPi)) - (free_object_ ? angle : 0);
      term.sigma = turn.sigma_rad;
      term.scale_px = scale_px;
      priors_.push_back(std::move(term));
    }
    blocks_.push_back(std::move(steps));
  }
}

void JointSystem::AddStationTurn(const StationTurnPrior& turn, double scale_px) {
  PriorTerm term;
  term.sigma = turn.sigma_rad;
  term.scale_px = scale_px;
  for (const auto& [places, sign] : {std::make_pair(&turn.first, -1.0), std::make_pair(&turn.second, 1.0)}) {
    std::vector<StationTurnPrior::Place> used;
    for (const StationTurnPrior::Place& place : *places) {
      if (blocks_[AngleBlock(place.image)].used) used.push_back(place);
    }
    if (used.empty()) return;
    const double factor = sign / static_cast<double>(used.size());
    for (const StationTurnPrior::Place& place : used) {
      term.parts.push_back({AngleBlock(place.image), 0, factor});
      // Angles are known but for whole turns.
      const double whole_turns = std::round((angles_[place.image] - place.angle_rad) / (2 * kPi));
      term.mean += factor * (place.angle_rad + 2 * kPi * whole_turns);
    }
  }
  priors_.push_back(std::move(term));
}

std::vector<int> JointSystem::AddHarmonics(const JointProblem& problem, double scale_px) {
  std::vector<int> block_of_image(problem.images.size(), -1);
  for (WobbleHarmonics& wobble : harmonics_) {
    Block block;
    block.values = wobble.coefficients.data();
    block.size = WobbleHarmonics::kCoefficients;
    block.free.resize(static_cast<size_t>(block.size));
    std::iota(block.free.begin(), block.free.end(), 0);
    block.name = "wobble " + std::to_string(&wobble - harmonics_.data());
    for (const int i : wobble.images) {
      if (static_cast<int>(blocks_[ObjectPoseBlock(i)].free.size()) < 6) continue;
      block_of_image[static_cast<size_t>(i)] = static_cast<int>(blocks_.size());
      block.used |= blocks_[ObjectPoseBlock(i)].used;
    }
    for (int k = 0; block.used && k < block.size; ++k) {
      const WobblePrior& prior = *problem.priors.wobble;
      const bool is_tilt = k < 2 * WobbleHarmonics::kTerms;
      PriorTerm term;
      term.parts = {{static_cast<int>(blocks_.size()), k, 1}};
      term.sigma = is_tilt ? prior.sigma_harmonic_tilt_rad : prior.sigma_harmonic_shift;
      term.scale_px = scale_px;
      (is_tilt ? wobble_terms_.harmonic_tilts : wobble_terms_.harmonic_shifts).push_back(priors_.size());
      priors_.push_back(std::move(term));
    }
    blocks_.push_back(std::move(block));
  }
  return block_of_image;
}

// Small deviations from pure turns: tilts add up like vectors, and the axis' point stays where they turn.
void JointSystem::AddWobble(const JointProblem& problem, double scale_px) {
  const auto [across, beside] = AcrossAxis(axis_direction_);
  const std::vector<int> harmonics = AddHarmonics(problem, scale_px);
  for (size_t i = 0; i < problem.images.size(); ++i) {
    const int block = ObjectPoseBlock(static_cast<int>(i));
    if (!blocks_[block].used || blocks_[block].free.size() < 6) continue;
    const WobbleOfPose wobble =
        DeviationFromTurn(axis_direction_, problem.AxisPoint(), problem.images[i].world_from_object);
    const WobbleHarmonics::Terms terms =
        WobbleHarmonics::TermsAt(AngleAbout(axis_direction_, object_rotations_[i]));
    const auto add = [&](int part, PriorTerm term) {
      for (int k = 0; harmonics[i] >= 0 && k < WobbleHarmonics::kTerms; ++k)
        term.parts.push_back({harmonics[i], part * WobbleHarmonics::kTerms + k, -terms(k)});
      term.scale_px = scale_px;
      (part < 2 ? wobble_terms_.tilts : wobble_terms_.shifts).push_back(priors_.size());
      priors_.push_back(std::move(term));
    };
    for (const auto& [part, about] : {std::make_pair(0, across), std::make_pair(1, beside)}) {
      PriorTerm term;
      term.sigma = problem.priors.wobble->sigma_tilt_rad;
      term.parts = {{block, 0, about.x()}, {block, 1, about.y()}, {block, 2, about.z()}};
      term.mean = -about.dot(wobble.tilt_rad);
      add(part, std::move(term));
    }
    for (int k = 0; k < 3; ++k) {
      PriorTerm term;
      term.sigma = problem.priors.wobble->sigma_shift;
      term.parts = {{block, 3 + k, 1}};
      term.mean = problem.images[i].world_from_object.translation(k) - wobble.shift(k);
      add(2 + k, std::move(term));
    }
  }
}

int JointSystem::NumFree() const {
  int free = 0;
  for (const Block& block : blocks_) free += block.used ? static_cast<int>(block.free.size()) : 0;
  return free;
}

void JointSystem::Hold(int block, int value) {
  std::vector<int>& free = blocks_[block].free;
  free.erase(std::remove(free.begin(), free.end(), value), free.end());
}

void JointSystem::FixGauge(const JointProblem& problem) {
  HoldAll(PoseBlock(anchor_));
  const Vector3d anchor = CentreOfPose(anchor_);
  std::vector<bool> has_background(num_poses_, false);
  for (const Term& term : terms_) {
    if (!term.of_object) has_background[problem.images[term.image].pose] = true;
  }

  if (free_object_) {
    HoldAll(ObjectPoseBlock(problem.reference));
    // A change of scale about the anchor that leaves the reference's object pose moves the others by
    // C - x_in_world(C of the object's frame).
    int farthest = -1;
    int coordinate = 0;
    double most = 0;
    for (size_t i = 0; i < problem.images.size(); ++i) {
      if (!blocks_[ObjectPoseBlock(static_cast<int>(i))].used || static_cast<int>(i) == problem.reference)
        continue;
      const Vector3d moved = anchor - problem.images[i].world_from_object * anchor;
      int k = 0;
      const double distance = moved.cwiseAbs().maxCoeff(&k);
      if (distance > most) {
        most = distance;
        farthest = static_cast<int>(i);
        coordinate = k;
      }
    }
    if (farthest >= 0) Hold(ObjectPoseBlock(farthest), 3 + coordinate);
    // Objects that move freely have a scale of their own: the background's unit is held too.
    int far_pose = -1;
    most = 0;
    for (int pose = 0; pose < num_poses_; ++pose) {
      if (!has_background[pose] || !has_background[anchor_]) continue;
      int k = 0;
      const double distance = (CentreOfPose(pose) - anchor).cwiseAbs().maxCoeff(&k);
      if (distance <= most) continue;
      most = distance;
      far_pose = pose;
      coordinate = k;
    }
    if (far_pose >= 0) Hold(PoseBlock(far_pose), 3 + coordinate);
    for (int pose = 0; pose < num_poses_; ++pose) {
      if (!has_background[pose]) HoldAll(PoseBlock(pose));
    }
    return;
  }

  HoldAll(AngleBlock(problem.reference));
  const Eigen::Vector2d away(anchor.x() - axis_[2], anchor.y() - axis_[3]);
  Hold(AxisBlock(), std::abs(away.x()) >= std::abs(away.y()) ? 2 : 3);
  // One held angle for each set of stations that nothing else keeps from turning about the axis.
  std::vector<bool> held(num_poses_, false);
  held[ties_[anchor_]] = true;
  for (size_t i = 0; i < problem.images.size(); ++i) {
    const int set = ties_[problem.images[i].pose];
    if (held[set] || !blocks_[AngleBlock(static_cast<int>(i))].used) continue;
    HoldAll(AngleBlock(static_cast<int>(i)));
    held[set] = true;
  }
}

void JointSystem::TieByBackground(const JointProblem& problem) {
  UnionFind tied(num_poses_);
  std::map<int, int> pose_of_point;
  for (const Term& term : terms_) {
    if (term.of_object) continue;
    const int pose = problem.images[term.image].pose;
    tied.Join(pose, pose_of_point.try_emplace(term.point, pose).first->second);
  }
  ties_.resize(num_poses_);
  for (int pose = 0; pose < num_poses_; ++pose) ties_[pose] = static_cast<int>(tied.Root(pose));
}

Vector3d JointSystem::CentreOfPose(int pose) const {
  return {poses_[pose][3], poses_[pose][4], poses_[pose][5]};
}

void JointSystem::WriteBack(JointProblem* problem) const {
  for (int s = 0; s < num_poses_; ++s) {
    Rigid3& pose = problem->cam_from_world[s];
    pose.rotation = RotationOf(poses_[s], pose_rotations_[s]);
    pose.translation = -(pose.rotation * CentreOfPose(s));
  }
  for (int c = 0; c < num_cameras_; ++c) problem->cameras[c].params = intrinsics_[c];
  for (int k = 0; k < 4; ++k) problem->axis(k) = axis_[k];
  for (size_t i = 0; i < problem->images.size(); ++i) {
    JointImage& image = problem->images[i];
    image.angle_rad = angles_[i];
    if (!free_object_) continue;
    image.world_from_object.rotation = RotationOf(object_poses_[i], object_rotations_[i]);
    image.world_from_object.translation = {object_poses_[i][3], object_poses_[i][4], object_poses_[i][5]};
  }
  for (size_t t = 0; t < equal_steps_.size(); ++t) {
    problem->priors.turns[t].offset_rad = equal_steps_[t][0];
    problem->priors.turns[t].step_rad = equal_steps_[t][1];
  }
  if (problem->priors.wobble) problem->priors.wobble->harmonics = harmonics_;
  problem->object.points = object_points_;
  problem->background.points = background_points_;
}

}  // namespace s2gs
