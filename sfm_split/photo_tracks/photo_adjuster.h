#pragma once

#include <Eigen/Core>
#include <set>
#include <vector>

#include "sfm_split/evidence/held_back.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/photo_tracks/photo_adjustment.h"
#include "sfm_split/photo_tracks/track_places.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// The object's points: those that the scene's adjustment did not see, and the others in two halves, each of
/// which tells whether poses by the other's patches are better.
enum class PointSet { kHeldBack, kFirstHalf, kSecondHalf };

/// Distances of a point's places from it [px], by two sets of poses.
struct ErrorPair {
  std::vector<double> before;
  std::vector<double> after;
};

/// A scene's joint problem with patches' places in the stead of the object's keypoints.
class PhotoAdjuster {
 public:
  PhotoAdjuster(const ScanFeatures& features, const HeldBackKeypoints& held_back,
                const PhotoAdjustmentOptions& options, AlignedScene* aligned)
      : features_(features), held_back_(held_back), options_(options), aligned_(aligned) {}

  /// \param keypoint_sigma_px  of a coordinate of a keypoint, place_sigma_px of a place.
  /// \param min_places  photos with fewer keep the keypoints of points without patches.
  void SetUp(const std::vector<AlignedTrack>& tracks, const JointPriors& priors, double keypoint_sigma_px,
             double place_sigma_px, int min_places);
  /// The problem without the patches of a set; keypoints of its points that have no patches stay.
  JointProblem Without(PointSet set) const;
  /// Observations as they are before any adjustment takes some out.
  void ActivateAll(JointProblem* problem) const;
  /// Of a set's points, by places of patches or by keypoints. Both sets of poses see the same places of the
  /// same points, which lie where these poses put them best; what fewer than three see is left out.
  std::vector<ErrorPair> ErrorsOf(PointSet set, const JointProblem& before, const JointProblem& after,
                                  bool by_patches) const;
  /// The stations that patches tie to the reference's, itself among them.
  /// \param overdispersion  how many times larger errors are than places say (HeldBackChange).
  std::set<int> TiedStations(const JointProblem& after, double overdispersion) const;
  /// Writes the poses into the scene, with all points by them, whether they were adjusted or not.
  void Take(JointProblem* after);
  const JointProblem& problem() const { return problem_; }

 private:
  // What is known of an observation of the problem beside what the problem says.
  struct Source {
    const PatchPlace* place = nullptr;
    PointSet of = PointSet::kFirstHalf;  // its point
    Eigen::Vector2d keypoint = Eigen::Vector2d::Zero();
  };

  void AddPlaces(const std::vector<AlignedTrack>& tracks);
  void LeaveOutKeypoints(int min_places);
  void FindHeldBack();
  void ChooseBackground(double keypoint_spread);

  const ScanFeatures& features_;
  const HeldBackKeypoints& held_back_;
  const PhotoAdjustmentOptions& options_;
  AlignedScene* aligned_;
  size_t num_model_points_ = 0;  // of the object, which come first; others are of tracks alone
  JointProblem problem_;         // as the scene stands, with the observations that are to be adjusted
  std::vector<Source> sources_;  // of the object's observations
};

}  // namespace s2gs
