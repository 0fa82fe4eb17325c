#include "sfm_split/evidence/scan_evidence.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/circular_motion/turn_reach.h"
#include "sfm_split/evidence/background_matches.h"
#include "sfm_split/evidence/posed_matches.h"
#include "sfm_split/evidence/proven_pairs.h"
#include "sfm_split/evidence/step_evidence.h"
#include "sfm_split/evidence/verified_matches.h"
#include "sfm_split/scene/focal_prior.h"
#include "sfm_split/turntable/tied_stations.h"

namespace s2gs {
namespace {

constexpr int kLeastUnmoved = 3;     // photos of one camera place: two may be taken from one hand
constexpr double kFarMoving = 0.8;   // of matches move less: those at the axis hardly move
constexpr double kSeriesSigmas = 2;  // of what is known of a place in a series

// What the matches of photos near each other say of each angle.
void RecordAngles(const PosedMatches& matches, const TurntableAxis& axis, const KeypointSet& of_others,
                  const std::vector<bool>& is_in_steps, ScanEvidence* evidence) {
  std::vector<const Camera*> cameras;
  for (const PosedImage& image : matches.posed()) cameras.push_back(image.camera);
  const StepEvidence steps = AskSteps(matches.features(), cameras, matches.views(), axis, of_others,
                                      is_in_steps, evidence->overdispersion, kScanRisk);
  const auto name = [&](int image) { return matches.features().images[static_cast<size_t>(image)].name; };
  for (const MisturnedPhoto& photo : steps.misturned) {
    evidence->misturned.push_back(name(photo.image));
    evidence->worst_misturn_deg = std::max(evidence->worst_misturn_deg, std::abs(photo.off_deg));
  }
  for (const int image : steps.untold) evidence->untold.push_back(name(image));
  for (const int image : steps.untold_stations) evidence->untold_stations.push_back(name(image));
}

// A point that turns by an angle moves no farther than its distance from the axis times the angle; what the
// object sweeps over a station's photos is at least that wide. Photos that share details are compared, in
// whatever order they were taken and named.
void RecordSteps(const PosedMatches& matches, ScanEvidence* evidence) {
  std::map<int, std::vector<const ImagePairMatches*>> pairs_of;
  std::map<int, std::vector<float>> x_of;
  std::map<int, std::vector<float>> y_of;
  for (const ImagePairMatches& pair : matches.features().object_pairs) {
    const int station = matches.StationOf(pair.image1);
    for (const FeatureMatch& match : pair.matches) {
      x_of[station].push_back(matches.KeypointsOf(pair.image1)[match.point2D_idx1].x());
      y_of[station].push_back(matches.KeypointsOf(pair.image1)[match.point2D_idx1].y());
    }
    if (station != matches.StationOf(pair.image2) || !matches.IsPosed(pair.image1) ||
        !matches.IsPosed(pair.image2))
      continue;
    if (pair.matches.size() >= static_cast<size_t>(kLeastSupport)) pairs_of[station].push_back(&pair);
  }
  const auto upper = [](std::vector<double> values) {
    const auto at =
        values.begin() + static_cast<std::ptrdiff_t>(kFarMoving * static_cast<double>(values.size()));
    std::nth_element(values.begin(), at, values.end());
    return *at;
  };
  std::vector<double> steps;
  std::vector<double> least;
  for (const auto& [station, pairs] : pairs_of) {
    const double swept = SweptPx(x_of[station], y_of[station]);
    if (!(swept > 0)) continue;
    for (const ImagePairMatches* pair : pairs) {
      const View& one = *matches.views()[static_cast<size_t>(pair->image1)];
      const View& two = *matches.views()[static_cast<size_t>(pair->image2)];
      steps.push_back(std::abs(WrapAngle((two.angle_deg - one.angle_deg) * kDegree)) / kDegree);
      std::vector<double> moved;
      for (const FeatureMatch& match : pair->matches) {
        moved.push_back((matches.KeypointsOf(pair->image1)[match.point2D_idx1] -
                         matches.KeypointsOf(pair->image2)[match.point2D_idx2])
                            .norm());
      }
      least.push_back(upper(moved) / (kMagnification * swept) / kDegree);
    }
  }
  if (!steps.empty()) evidence->median_step_deg = UpperMedian(steps);
  if (!least.empty()) evidence->least_step_deg = UpperMedian(least);
}

// Of each image of the features: equal steps, or angles that were stated, tell its place in the turn. Steps
// that scatter by more are no series.
std::vector<bool> InSteps(const ScanFeatures& features, const TurntableScene& scene,
                          const std::vector<EqualStepsPrior>& turns) {
  std::set<std::string> told;
  for (const EqualStepsPrior& turn : turns) {
    if (!(kSeriesSigmas * turn.sigma_rad < kLeastAwayDeg * kDegree)) continue;
    for (const EqualStepsPrior::Place& place : turn.places) {
      const auto v = static_cast<size_t>(place.image);
      if (v < scene.views.size()) told.insert(scene.views[v].name);
    }
  }
  std::vector<bool> result;
  result.reserve(features.images.size());
  for (const ScanImage& image : features.images) result.push_back(told.count(image.name) > 0);
  return result;
}

// Where the axis lies between the cameras and the object's points.
void RecordAxis(const AlignedScene& aligned, ScanEvidence* evidence) {
  const TurntableAxis& axis = aligned.scene.axis;
  const auto radial = [&](const Eigen::Vector3d& x) -> Eigen::Vector3d {
    const Eigen::Vector3d from_axis = x - axis.point;
    return from_axis - axis.direction * axis.direction.dot(from_axis);
  };
  std::vector<double> radii;
  std::vector<double> heights;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& [id, point] : aligned.object.points3D) {
    const Eigen::Vector3d r = radial(point.xyz);
    radii.push_back(r.norm());
    heights.push_back(axis.direction.dot(point.xyz));
    mean += r / std::max(r.norm(), 1e-300);
  }
  if (static_cast<int>(radii.size()) < kLeastSupport) return;
  const double radius = UpperMedian(radii);
  const double height = UpperMedian(heights);
  std::vector<double> camera_radii;
  std::vector<double> camera_heights;
  for (const View& view : aligned.scene.views) {
    const Eigen::Vector3d centre = CameraCentre(view.cam_from_world);
    camera_radii.push_back(radial(centre).norm());
    camera_heights.push_back(std::abs(axis.direction.dot(centre) - height));
  }
  if (!(radius > 0) || camera_radii.empty()) return;
  evidence->camera_radius_rel = UpperMedian(camera_radii) / radius;
  evidence->points_one_side = mean.norm() / static_cast<double>(radii.size());
  evidence->camera_height_rel = UpperMedian(camera_heights) / radius;
}

void RecordCameras(const ScanFeatures& features, const std::vector<Camera>& cameras, ScanEvidence* evidence) {
  evidence->photos = static_cast<int>(features.images.size());
  for (const auto& [station, count] : SizesOfStations(features)) {
    evidence->unmoved_photos += count >= kLeastUnmoved ? count : 0;
  }
  for (const Camera& camera : cameras) {
    const double focal_px = FocalLengths(camera).mean();
    evidence->focal_widths.push_back(FocalLengths(camera).x() / static_cast<double>(camera.width));
    const auto given = features.cameras.find(camera.camera_id);
    if (given == features.cameras.end()) continue;
    evidence->are_photos_cut |=
        PrincipalPointShift(camera, PrincipalPoint(given->second)).norm() > kMostLensShift;
    const auto is_stated = features.has_prior_focal.find(camera.camera_id);
    const FocalPrior prior =
        FocalPriorOf(given->second, is_stated != features.has_prior_focal.end() && is_stated->second);
    if (prior.otherwise && !prior.IsAsStated(std::log(focal_px)))
      evidence->wrong_exif_focal = prior.likeliest.focal_px / focal_px;
  }
}

// How surely the adjustment tells each photo's angle [degrees]; those that it holds have none.
std::vector<double> AngleSigmas(const AlignedScene& aligned, const JointReport& joint,
                                const MatchFindings& findings, bool is_object_free) {
  const std::set<int> tied = TiedStations(aligned);
  std::vector<double> sigmas;
  for (size_t v = 0; v < joint.angle_sigma_deg.size(); ++v) {
    double sigma = joint.angle_sigma_deg[v];
    // Where no background ties a station to the reference's, the angle between them is anybody's choice, and
    // how surely the object tells its poses is what counts: by its points, and where photos share a camera,
    // by all matches of their station.
    if (std::isinf(sigma) && v < aligned.scene.views.size() &&
        tied.count(aligned.scene.views[v].station) == 0) {
      const double of_points = v < joint.turn_sigma_deg.size() ? joint.turn_sigma_deg[v] : 0;
      const auto found = findings.turn_sigma_deg.find(aligned.scene.views[v].station);
      if (found != findings.turn_sigma_deg.end()) {
        sigma = std::max(found->second, of_points);
      } else if (is_object_free && of_points > 0) {
        sigma = of_points;
      }
    }
    if (sigma > 0) sigmas.push_back(sigma);
  }
  return sigmas;
}

// Standard deviations, and the shares of them that rest on priors.
void RecordSigmas(const ScanFeatures& features, const AlignedScene& aligned, const JointReport& joint,
                  const MatchFindings& findings, ScanEvidence* evidence) {
  const std::vector<double> sigmas = AngleSigmas(aligned, joint, findings, evidence->is_object_free);
  if (!sigmas.empty()) {
    evidence->angle_sigma_median_deg = UpperMedian(sigmas);
    evidence->angle_sigma_max_deg = *std::max_element(sigmas.begin(), sigmas.end());
  }
  evidence->angle_prior_share = AnglePriorShare(joint);
  for (const double share : joint.focal_prior_share)
    evidence->focal_prior_share = std::max(evidence->focal_prior_share.value_or(0), share);
  for (size_t c = 0; c < joint.focal_sigma_px.size() && c < aligned.scene.cameras.size(); ++c) {
    const double relative = joint.focal_sigma_px[c] / FocalLengths(aligned.scene.cameras[c]).x();
    if (relative > 0) evidence->focal_sigma_rel = std::max(evidence->focal_sigma_rel.value_or(0), relative);
    const auto prior = features.has_prior_focal.find(aligned.scene.cameras[c].camera_id);
    evidence->is_focal_guessed |= relative == 0 && prior != features.has_prior_focal.end() && !prior->second;
  }
  if (joint.axis_direction_sigma_deg >= 0) evidence->axis_sigma_deg = joint.axis_direction_sigma_deg;
  if (joint.scale_sigma_rel >= 0) evidence->scale_sigma_rel = joint.scale_sigma_rel;
}

}  // namespace

ScanEvidence GatherEvidence(const ScanFeatures& features, const AlignedScene& aligned,
                            const JointReport& joint, const std::vector<EqualStepsPrior>& turns,
                            const HeldBackKeypoints& held_back, const MatchFindings& findings,
                            double max_error_px) {
  const TurntableScene& scene = aligned.scene;
  ScanEvidence evidence;
  evidence.bound_px = max_error_px;
  if (findings.noise_px > 0) evidence.match_noise_px = findings.noise_px;
  evidence.overdispersion = findings.overdispersion;
  evidence.placed = static_cast<int>(scene.views.size());
  evidence.is_object_free =
      joint.model == JointModel::kFreeObject || joint.model == JointModel::kWobblingTable;
  RecordCameras(features, scene.cameras, &evidence);
  std::set<std::string> placed;
  std::set<int> stations;
  for (const View& view : scene.views) {
    placed.insert(view.name);
    stations.insert(view.station);
  }
  evidence.stations = static_cast<int>(stations.size());
  for (const ScanImage& image : features.images) {
    if (placed.count(image.name) == 0) evidence.missing.push_back(image.name);
  }
  const PosedMatches matches(features, scene, max_error_px);
  const std::vector<int> verified = RecordVerifiedMatches(matches, held_back, &evidence);
  // What a wobbling table does goes smoothly with its angle.
  const bool has_one_angle_each =
      joint.model == JointModel::kSharedStations || joint.model == JointModel::kWobblingTable;
  RecordSupportOfPhotos(matches, verified, has_one_angle_each, &evidence);
  const KeypointSet of_others = RecordProvenPairs(matches, &evidence);
  RecordAngles(matches, scene.axis, of_others, InSteps(features, scene, turns), &evidence);
  RecordSteps(matches, &evidence);
  RecordBackgroundMatches(features, aligned, max_error_px, &evidence);
  RecordAxis(aligned, &evidence);

  evidence.are_sigmas_missing = !joint.observability.computed && joint.observability.num_parameters > 0;
  if (joint.observability.computed) RecordSigmas(features, aligned, joint, findings, &evidence);
  return evidence;
}

ScanEvidence GatherOneBodyEvidence(const ScanFeatures& features, const std::vector<Camera>& cameras,
                                   const std::vector<Rigid3>& cam_from_world) {
  ScanEvidence evidence;
  evidence.is_one_body = true;
  evidence.placed = static_cast<int>(cam_from_world.size());
  Eigen::Vector3d sum = Eigen::Vector3d::Zero();
  for (const Rigid3& pose : cam_from_world) sum += pose.rotation.conjugate() * Eigen::Vector3d::UnitZ();
  if (!cam_from_world.empty()) evidence.looks_alike = sum.norm() / static_cast<double>(cam_from_world.size());
  RecordCameras(features, cameras, &evidence);
  return evidence;
}

}  // namespace s2gs
