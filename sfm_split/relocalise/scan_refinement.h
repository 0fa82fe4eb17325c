#pragma once

#include <map>
#include <string>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/adjust/known_angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/evidence/held_back.h"
#include "sfm_split/joint_system/joint_priors.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

struct RefineOptions {
  int max_rounds = 5;                      ///< of triangulating, relocalising, adjusting and labelling.
  double max_error_px = 4;                 ///< reprojection error of a keypoint that belongs to a point.
  double min_triangulation_deg = 1.5;      ///< points whose rays all meet at less are left out.
  int min_relocalise_inliers = 5;          ///< keypoints that must agree before an image is taken back.
  double min_relocalise_share = 0.25;      ///< their share of those that could.
  int max_adjusted_observations = 150000;  ///< of the object; more are left out of the adjustment.
  int max_adjusted_background = 1200;      ///< background points in the adjustment.
  /// Table angles that are stated, by image [degrees], but for a constant and the sense of each station: a
  /// prior where the photos bear them out (CompareKnownAngles).
  std::map<std::string, double> stated_angles_deg;
  /// Standard deviation of a keypoint's coordinate, where it is known; 0: as the verified matches tell it.
  double noise_px = 0;
  /// JointPriors::chosen_variance: 1 where the bound is wide, so that few errors lie near it.
  double chosen_variance = 1;
  /// Steps that are equal by something better than the angles that the adjustment frees (StepsByMatches): a
  /// prior from its first round on, in place of what the adjusted angles say. By images of the features;
  /// offset and sense are those of the scene as it stands.
  std::vector<EqualStepsPrior> equal_steps;
  /// How stations are turned that silhouettes tell. By images of the features.
  std::vector<StationTurnPrior> station_turns;
  /// The table's rim as camera places show it. By images of the features.
  std::vector<RimPrior> rims;

  /// What no adjustment may see: where the features lack matches of which it was chosen. Empty: as HoldBack()
  /// chooses among theirs.
  HeldBackKeypoints held_back;

  /// The scene's poses are rough and have no points: before the first round these are triangulated within
  /// twice the bound, and everything is adjusted to them as to SfM's.
  bool start_is_rough = false;

  OptionCheck Check() const;
};

/// An image that was not placed by both reconstructions, and how it came back.
struct RelocalisedImage {
  std::string name;
  std::string how;
  int inliers = 0;
  int candidates = 0;
  double margin = 0;  ///< support of its table angle over that of the best other one.
};

struct RefineRound {
  int images = 0;
  int object_points = 0;
  int background_points = 0;
  double object_rms_px = 0;
  double background_rms_px = 0;
  double seconds = 0;
};

struct RefineReport {
  JointReport joint;                              ///< of the last round.
  std::vector<KnownAngles> known_angles;          ///< stations whose angles are stated, of the last round.
  std::vector<std::string> angle_contradictions;  ///< what the user has to know of them.
  std::vector<ModelTest> model_tests;             ///< of the round that chose the model.
  PrincipalPointTest principal_point;             ///< of that round.
  JointModel model = JointModel::kSharedStations;
  JointPriors priors;  ///< of the last adjustment.
  std::vector<RelocalisedImage> relocalised;
  std::vector<RelocalisedImage>
      placed_stations;              ///< turned about the axis to where the background's matches say.
  std::vector<std::string> untied;  ///< of stations that nothing on the background ties to the others.
  std::vector<std::string>
      doubted;  ///< images that were taken out for a while: their matches contradicted them.
  std::vector<std::string> missing;  ///< images with no place in the scene.
  std::vector<RefineRound> rounds;
  bool is_stable = false;                          ///< false: the last round still changed something.
  std::vector<std::vector<KeypointLabel>> labels;  ///< per image of the features, by reprojection.
  int relabelled_keypoints = 0;
  HeldBackKeypoints held_back;  ///< that no adjustment saw; the models have them.
};

/// From an aligned scene (which may lack images) to the jointly adjusted one: triangulates both bodies anew
/// from all matches that agree with the poses, takes images back whose camera their station knows and whose
/// table angle the object's points tell, adjusts everything together, and repeats until nothing changes.
/// Afterwards both models hold all images of the scene, with all their keypoints; photos of one station
/// observe its background points at the keypoints that stay at their pixels. \param object  SfM's model of
/// the object before alignment: for stations that the scene lacks; may be null.
RefineReport RefineScan(const ScanFeatures& features, const ColmapModel* object,
                        const JointOptions& joint_options, const RefineOptions& options, Reporter& reporter,
                        AlignedScene* aligned);

}  // namespace s2gs
