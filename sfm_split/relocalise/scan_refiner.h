#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "sfm_split/adjust/equal_steps.h"
#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/relocalise/pose_by_points.h"
#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/relocalise/station_ties.h"
#include "sfm_split/turntable/table_angle.h"

namespace s2gs {

/// Of two reconstructions of one camera, the turn about the axis apart: share of its distance from the axis,
/// and radians.
constexpr double kMaxCameraMisfit = 0.03;
/// Of a keypoint's coordinate, in standard deviations: errors beyond are wrong.
constexpr double kErrorSigmas = 5;

/// RefineScan at work: scan_refinement.cc has the rounds, refined_tracks.cc the points that agree with the
/// poses, refined_models.cc both models and the labels made of them, scan_adjustment.cc what is adjusted;
/// relocalise_images.cc brings single images back or drops them, relocalise_stations.cc places whole
/// stations.
class ScanRefiner {
 public:
  ScanRefiner(const ScanFeatures& features, const ColmapModel* object, const JointOptions& joint_options,
              const RefineOptions& options, Reporter& reporter, AlignedScene* aligned)
      : features_(features),
        object_(object),
        joint_options_(joint_options),
        options_(options),
        reporter_(reporter),
        aligned_(aligned),
        object_pairs_(features.object_pairs),
        static_pairs_(features.static_pairs) {
    keypoints_.reserve(features.images.size());
    for (size_t i = 0; i < features.images.size(); ++i) {
      keypoints_.push_back(features.images[i].keypoints);
      image_of_name_[features.images[i].name] = static_cast<int>(i);
    }
    report_.held_back = options.held_back.empty() ? HoldBack(features) : options.held_back;
    has_background_ = !aligned->background.images.empty();
    for (const auto& [id, image] : aligned->background.images) {
      const auto found = image_of_name_.find(image.name);
      if (found != image_of_name_.end()) placed_stations_.insert(StationOf(found->second));
    }
  }

  RefineReport Run();

 private:
  void AdjustToCommonCameras();
  void MakeRound(int round, double first_error_px, double max_error_px);
  void AdjustRound(int round, JointModel* model);
  void RecordRound(int round, double seconds);
  void Finish(JointModel model, double max_error_px);
  int StationOf(int image) const { return features_.images[static_cast<size_t>(image)].station; }
  void IndexViews();
  void SortViews();
  std::vector<int> ViewsOfCameras() const;
  std::vector<PosedImage> Posed(bool of_object) const;
  std::vector<TrackPoint> Triangulate(bool of_object, double max_error_px) const;
  void FindUnmoved();
  std::vector<std::vector<double>> ErrorsOf(const std::vector<ImagePairMatches>& pairs) const;
  void MeasureNoise();
  void TakeRawMatches(double max_error_px);
  double ErrorBound(double sigma_px) const;
  void Relocalise(double max_error_px);
  void PlaceStations(double max_error_px);
  std::optional<double> TurnFromReconstruction(int station) const;
  void PlaceByReconstruction(const std::set<int>& stations, const TieOptions& options);
  void SettleLoneCameras(int enough_observations);
  void StandCamerasStill();
  void ShareCameras();
  std::vector<StationMatches> MatchesOfStations() const;
  void TurnStation(int station, double turn_rad, const RelocalisedImage& how);
  void ReportUntiedStations();
  void MakeReference(const View& reference);
  int NewStation() const;
  bool RelocaliseStationByObject(const std::vector<int>& images, double max_error_px);
  void RelocaliseStation(const std::vector<int>& images, double max_error_px);
  bool RelocaliseImage(int image, const Rigid3& cam_from_world, int station, double max_error_px);
  std::vector<MatchInPosedImage> MatchesWithPosed(int image) const;
  std::vector<MatchAcrossTurn> RawMatchesWithPosed(int image, const Rigid3& cam_from_world) const;
  std::optional<PoseByPoints> PoseFromPoints(int image, double max_error_px) const;
  bool RelocaliseByPose(int image, const View& of_station, const PoseByPoints& pose);
  void RelocaliseStationByPoints(const std::vector<int>& images, double max_error_px);
  bool RelocaliseByRawMatches(int image, const Rigid3& cam_from_world, int station, double max_error_px);
  std::optional<double> AngleByEqualSteps(int image) const;
  bool RelocaliseBySteps(int image, const Rigid3& cam_from_world, int station, double max_error_px);
  void DropDoubtful(double max_error_px);
  void DropContradictedStations(double max_error_px);
  void TakeOut(const std::set<std::string>& gone);
  void AddView(int image, int station, const Rigid3& cam_from_world, const Rigid3& world_from_object,
               double angle_rad);
  void AddCamera(uint32_t camera_id);
  const Camera& CameraOf(int image) const;
  std::vector<size_t> PointsToAdjust(const std::vector<TrackPoint>& points, int max_observations,
                                     int max_points, bool of_object) const;
  ColmapModel BuildModel(const std::vector<TrackPoint>& points, const std::vector<size_t>& chosen,
                         bool of_object) const;
  void BuildObject();
  void BuildBackground();
  std::vector<TrackElement> WholeTrack(const TrackPoint& point, bool of_object) const;
  JointReport Adjust(JointModel model, bool covariance);
  void PreferKnownAngles(const JointReport& report, JointProblem* problem);
  JointReport AdjustWith(JointOptions options, bool is_rough);
  std::vector<LensPrior> LensPriors(const JointProblem& problem) const;
  std::vector<CapturePlace> CapturePlaces(const JointProblem& problem) const;
  std::map<int, int> ImagesOf(const JointProblem& problem) const;
  std::vector<EqualStepsPrior> GivenSteps(const JointProblem& problem) const;
  std::vector<StationTurnPrior> GivenStationTurns(const JointProblem& problem) const;
  std::vector<RimPrior> GivenRims(const JointProblem& problem) const;
  void WeighGivenSteps(JointOptions options, JointProblem* problem);
  void Relabel(double max_error_px);
  void WriteModels();

  const ScanFeatures& features_;
  const ColmapModel* object_;
  const JointOptions& joint_options_;
  const RefineOptions& options_;
  Reporter& reporter_;
  AlignedScene* aligned_;
  std::vector<Keypoints> keypoints_;
  std::vector<ImagePairMatches> object_pairs_;  // verified, and raw ones that agree with the poses
  std::vector<ImagePairMatches> static_pairs_;  // verified, and raw ones of stations that only these tie
  std::map<std::string, int> image_of_name_;
  std::vector<int> view_of_image_;
  std::set<int> placed_stations_;  // in the features' numbers: those that the background ties to each other
  std::map<int, RelocalisedImage> turned_stations_;
  bool has_background_ = false;
  bool photos_are_cut_ = false;    // beside their middle: principal points are free
  bool cameras_are_free_ = false;  // each photo has its own: held by hand, or shaken
  double noise_px_ = 0;            // of the object's matches against the poses as they stand
  std::map<std::string, int> drops_;
  std::set<int> by_steps_;  // images whose angle was taken from their station's equal steps
  // Of images in static pairs: keypoints at the same pixel, [image][other image of the station][keypoint].
  std::map<int, std::map<int, std::map<uint32_t, uint32_t>>> unmoved_;
  std::vector<TrackPoint> object_points_;
  std::vector<TrackPoint> background_points_;
  RefineReport report_;
};

/// The image's keypoints that match a keypoint of a known point; of several points those with most matches.
std::vector<PointInImage> PointsSeenBy(int image, const ScanFeatures& features,
                                       const std::vector<ImagePairMatches>& pairs,
                                       const std::vector<TrackPoint>& points);

}  // namespace s2gs
