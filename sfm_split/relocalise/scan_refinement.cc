#include "sfm_split/relocalise/scan_refinement.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <string>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/relocalise/scan_refiner.h"
#include "sfm_split/scene/number_stations.h"

namespace s2gs {
namespace {

constexpr double kFirstLossPx = 1;      // for reconstructions with other cameras than the common ones
constexpr double kRoughErrors = 2;      // of the error bound, where poses are rough
constexpr double kMaxScaleSigma = 0.1;  // of a scale that is called observed

}  // namespace

void ScanRefiner::IndexViews() {
  view_of_image_.assign(features_.images.size(), -1);
  for (size_t v = 0; v < aligned_->scene.views.size(); ++v) {
    const auto found = image_of_name_.find(aligned_->scene.views[v].name);
    if (found != image_of_name_.end())
      view_of_image_[static_cast<size_t>(found->second)] = static_cast<int>(v);
  }
}

void ScanRefiner::SortViews() {
  std::sort(aligned_->scene.views.begin(), aligned_->scene.views.end(),
            [](const View& a, const View& b) { return a.name < b.name; });
  IndexViews();
}

const Camera& ScanRefiner::CameraOf(int image) const {
  const uint32_t id = features_.images[static_cast<size_t>(image)].camera_id;
  const Camera* const camera = aligned_->scene.FindCamera(id);
  return camera != nullptr ? *camera : features_.cameras.at(id);
}

void ScanRefiner::AddCamera(uint32_t camera_id) {
  if (aligned_->scene.FindCamera(camera_id) != nullptr) return;
  aligned_->scene.cameras.push_back(features_.cameras.at(camera_id));
}

// The view that tells where an image's camera stands: its own, else any of its station; -1: none.
std::vector<int> ScanRefiner::ViewsOfCameras() const {
  std::map<int, int> view_of_station;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] >= 0) view_of_station.emplace(StationOf(static_cast<int>(i)), view_of_image_[i]);
  }
  std::vector<int> views = view_of_image_;
  for (size_t i = 0; i < views.size(); ++i) {
    const auto found = view_of_station.find(StationOf(static_cast<int>(i)));
    if (views[i] < 0 && found != view_of_station.end()) views[i] = found->second;
  }
  return views;
}

void ScanRefiner::AddView(int image, int station, const Rigid3& cam_from_world,
                          const Rigid3& world_from_object, double angle_rad) {
  const ScanImage& features = features_.images[static_cast<size_t>(image)];
  AddCamera(features.camera_id);
  View view;
  view.name = features.name;
  view.camera_id = features.camera_id;
  view.station = station;
  view.angle_deg = WrapAngle(angle_rad) / kDegree;
  view.cam_from_world = cam_from_world;
  view.world_from_object = world_from_object;
  view_of_image_[static_cast<size_t>(image)] = static_cast<int>(aligned_->scene.views.size());
  aligned_->scene.views.push_back(view);
}

// Everything is adjusted to the tracks of the two reconstructions, each of which fits its own cameras: this
// brings the two to common ones. Gross errors are pulled in, not cut off.
void ScanRefiner::AdjustToCommonCameras() {
  if (options_.start_is_rough) {
    object_points_ = Triangulate(true, kRoughErrors * options_.max_error_px);
    BuildObject();
  }
  if (aligned_->object.points3D.empty()) return;
  JointOptions options = joint_options_;
  options.model = JointModel::kSharedStations;
  options.loss = JointLoss::kHuber;
  options.loss_scale_px = std::max(options.loss_scale_px, kFirstLossPx);
  options.max_rounds = 1;
  options.function_tolerance = 1e-5;
  options.compute_covariance = false;
  AdjustWith(options, true);
  reporter_.Debug("adjusted both reconstructions to common cameras");
}

// What is to be adjusted of the object's points.
void ScanRefiner::BuildObject() {
  aligned_->object = BuildModel(object_points_,
                                PointsToAdjust(object_points_, options_.max_adjusted_observations,
                                               std::numeric_limits<int>::max(), true),
                                true);
}

// And of the background's, where there is one.
void ScanRefiner::BuildBackground() {
  if (!has_background_) {
    aligned_->background = ColmapModel();
    return;
  }
  aligned_->background = BuildModel(background_points_,
                                    PointsToAdjust(background_points_, std::numeric_limits<int>::max(),
                                                   options_.max_adjusted_background, false),
                                    false);
}

// Drops what its matches contradict, brings back what they place, and makes both models of what agrees with
// the poses then.
void ScanRefiner::MakeRound(int round, double first_error_px, double max_error_px) {
  if (round > 0) {
    DropContradictedStations(max_error_px);
    DropDoubtful(max_error_px);
    TakeRawMatches(max_error_px);
  }
  object_points_ = Triangulate(true, max_error_px);
  for (size_t before = 0; before != aligned_->scene.views.size();) {
    before = aligned_->scene.views.size();
    if (before == features_.images.size()) break;
    // Drawn in, the bound would leave out what shook against its station.
    Relocalise(first_error_px);
    if (aligned_->scene.views.size() != before) object_points_ = Triangulate(true, max_error_px);
  }
  PlaceStations(round == 0 ? 2 * first_error_px : first_error_px);
  if (cameras_are_free_ && has_background_) SettleLoneCameras(joint_options_.min_free_observations);
  if (has_background_) background_points_ = Triangulate(false, max_error_px);
  BuildObject();
  BuildBackground();
}

// The poses' model is chosen once, when gross errors are out.
void ScanRefiner::AdjustRound(int round, JointModel* model) {
  const bool choose = round == 1 && joint_options_.model == JointModel::kAuto;
  report_.joint = Adjust(choose ? JointModel::kAuto : *model, false);
  if (choose) {
    *model = report_.joint.model;
    report_.model_tests = report_.joint.tests;
    report_.principal_point = report_.joint.principal_point;
    photos_are_cut_ = report_.principal_point.accepted;
  }
  cameras_are_free_ = *model == JointModel::kFreeCameras;
  IndexViews();
}

void ScanRefiner::RecordRound(int round, double seconds) {
  RefineRound figures;
  figures.images = static_cast<int>(aligned_->scene.views.size());
  figures.object_points = static_cast<int>(object_points_.size());
  figures.background_points = static_cast<int>(background_points_.size());
  figures.object_rms_px = report_.joint.object_rms_px;
  figures.background_rms_px = report_.joint.background_rms_px;
  figures.seconds = seconds;
  report_.rounds.push_back(figures);
  reporter_.Info("round " + std::to_string(round + 1) + ": " + std::to_string(figures.images) + " images, " +
                 std::to_string(figures.object_points) + " object points, rms " +
                 std::to_string(figures.object_rms_px) + " px; " + std::to_string(figures.background_points) +
                 " background points, rms " + std::to_string(figures.background_rms_px) + " px; " +
                 std::to_string(figures.seconds) + " s");
}

// The last adjustment, the models of all that agrees with it, and what the report says of the scene.
void ScanRefiner::Finish(JointModel model, double max_error_px) {
  ReportUntiedStations();
  if (model == JointModel::kSharedStations) ShareCameras();
  report_.joint = Adjust(model, joint_options_.compute_covariance);
  report_.model = model;
  if (cameras_are_free_ && has_background_) SettleLoneCameras(1);
  if (cameras_are_free_ && !has_background_) StandCamerasStill();
  IndexViews();
  TakeRawMatches(max_error_px);
  object_points_ = Triangulate(true, max_error_px);
  if (has_background_) background_points_ = Triangulate(false, max_error_px);
  WriteModels();
  Relabel(max_error_px);

  NumberStations(&aligned_->scene);
  for (const auto& [station, placed] : turned_stations_) report_.placed_stations.push_back(placed);
  if (!has_background_) {
    aligned_->scene.scale_observable = false;
  } else if (report_.joint.scale_sigma_rel >= 0) {
    aligned_->scene.scale_observable = report_.joint.scale_sigma_rel <= kMaxScaleSigma;
  }
  for (size_t i = 0; i < features_.images.size(); ++i) {
    if (view_of_image_[i] < 0) report_.missing.push_back(features_.images[i].name);
  }
}

RefineReport ScanRefiner::Run() {
  IndexViews();
  // Principal points that were found beside the middle before have their prior, and are not held there.
  for (const Camera& camera : aligned_->scene.cameras)
    photos_are_cut_ |= PrincipalPoint(camera) != PrincipalPoint(features_.cameras.at(camera.camera_id));
  AdjustToCommonCameras();
  FindUnmoved();

  MeasureNoise();
  const double first_error_px = std::max(options_.max_error_px, ErrorBound(0));
  double max_error_px = first_error_px;
  JointModel model =
      joint_options_.model == JointModel::kAuto ? JointModel::kSharedStations : joint_options_.model;
  int last_observations = 0;
  for (int round = 0; round < options_.max_rounds; ++round) {
    if (reporter_.StopRequested()) throw Interrupted();
    const double start = SteadySeconds();
    MakeRound(round, first_error_px, max_error_px);
    AdjustRound(round, &model);
    RecordRound(round, SteadySeconds() - start);
    MeasureNoise();
    max_error_px = ErrorBound(report_.joint.sigma_px);
    const int observations = report_.joint.object_observations;
    const bool is_settled = std::abs(observations - last_observations) <= 0.01 * observations;
    last_observations = observations;
    if (round >= 2 && is_settled) {
      report_.is_stable = true;
      break;
    }
  }
  Finish(model, max_error_px);
  return report_;
}

OptionCheck RefineOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (!(noise_px >= 0)) return fault("noise_px", noise_px, "noise_px >= 0");
  if (!(chosen_variance >= 1)) return fault("chosen_variance", chosen_variance, "chosen_variance >= 1");
  if (max_rounds < 1) return fault("max_rounds", max_rounds, "max_rounds >= 1");
  if (!(max_error_px > 0)) return fault("max_error_px", max_error_px, "max_error_px > 0");
  if (!(min_triangulation_deg > 0 && min_triangulation_deg < 90)) {
    return fault("min_triangulation_deg", min_triangulation_deg, "0 < min_triangulation_deg < 90");
  }
  if (min_relocalise_inliers < 3)
    return fault("min_relocalise_inliers", min_relocalise_inliers, "min_relocalise_inliers >= 3");
  if (!(min_relocalise_share >= 0 && min_relocalise_share <= 1)) {
    return fault("min_relocalise_share", min_relocalise_share, "0 <= min_relocalise_share <= 1");
  }
  if (max_adjusted_observations < 1000) {
    return fault("max_adjusted_observations", max_adjusted_observations, "max_adjusted_observations >= 1000");
  }
  if (max_adjusted_background < 50) {
    return fault("max_adjusted_background", max_adjusted_background, "max_adjusted_background >= 50");
  }
  return std::nullopt;
}

RefineReport RefineScan(const ScanFeatures& features, const ColmapModel* object,
                        const JointOptions& joint_options, const RefineOptions& options, Reporter& reporter,
                        AlignedScene* aligned) {
  S2GS_INVARIANT(!options.Check() && !joint_options.Check());
  RefineReport report = ScanRefiner(features, object, joint_options, options, reporter, aligned).Run();
  if (!options.stated_angles_deg.empty() && report.known_angles.empty()) {
    report.angle_contradictions.emplace_back(
        "the stated table angles were neither checked nor used: the photos have poses of their own, as where "
        "a plate wobbles or an object is moved by hand");
  }
  return report;
}

}  // namespace s2gs
