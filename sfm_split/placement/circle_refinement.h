#pragma once

#include <utility>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/evidence/held_back.h"
#include "sfm_split/evidence/step_width.h"
#include "sfm_split/placement/candidate_likelihood.h"
#include "sfm_split/placement/scan_candidate.h"
#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// Whether most photos of a scene see points of the object. Epipolar errors do not tell a motion from one
/// that puts the points behind the cameras: then hardly a photo sees any that is left.
bool MostPhotosSeePoints(const AlignedScene& aligned);

/// What photos show beside their matches. By images of the features.
struct SeenBesideMatches {
  std::vector<StationTurnPrior> turns;  ///< of stations, that silhouettes told.
  std::vector<RimPrior> rims;           ///< of the table.
};

/// Adjusts scenes that circular motion placed, by the matches that agree with it. Keeps references.
class CircleRefinement {
 public:
  CircleRefinement(const ScanFeatures& features, const CandidateLikelihood& likelihood,
                   const RefineOptions& refine, const JointOptions& joint, Reporter& reporter)
      : features_(features),
        likelihood_(likelihood),
        refine_(refine),
        joint_(joint),
        reporter_(reporter),
        held_back_(HoldBack(features)) {}

  /// The same, which tells another.
  CircleRefinement(const CircleRefinement& other, Reporter& reporter)
      : features_(other.features_),
        likelihood_(other.likelihood_),
        refine_(other.refine_),
        joint_(other.joint_),
        reporter_(reporter),
        held_back_(other.held_back_) {}

  /// Moves stations to where all matches are likeliest. Returns the noise of right ones [px], by these
  /// matches where they tell it, otherwise the one given.
  double MoveStations(double sigma_px, AlignedScene* aligned) const;

  /// Free angles follow wrong matches where right ones are few; equal steps may be those of a turn that does
  /// not close. Both are adjusted where the steps may be equal, and the likelihood of all matches decides, in
  /// which angles that are free cost what is not known of them. \param sigma_px  noise of right matches.
  /// \param may_be_equal  whether equal steps are asked for. Returns a candidate that may not be usable.
  ScanCandidate Refine(const AlignedScene& aligned, double sigma_px, bool may_be_equal,
                       const SeenBesideMatches& seen) const;

  /// A first look at what Refine() comes to, in a small part of its time: the model, and whether steps are
  /// given, stay as another candidate has them, and no narrower bounds are tried.
  ScanCandidate RefineAs(const ScanCandidate& other, const AlignedScene& aligned, double sigma_px,
                         const SeenBesideMatches& seen) const;

 private:
  // What an adjustment is told besides the matches.
  struct Told {
    double sigma_px;
    double bound_px;  // of what agrees
    StepsFinding steps;
    const SeenBesideMatches& seen;
  };
  void RefineAgreeing(const Told& told, JointModel model, ScanCandidate* candidate) const;
  // Whether it can be used, and what all matches say of it.
  void Judge(ScanCandidate* candidate) const;
  ScanCandidate RefineSimplest(const AlignedScene& aligned, const Told& told) const;
  ScanCandidate RefineWithin(const AlignedScene& aligned, const Told& told) const;
  // About equal steps, then with free angles: side by side where there are cores for both.
  std::pair<ScanCandidate, ScanCandidate> RefineBoth(const AlignedScene& aligned, const Told& about_steps,
                                                     const Told& free) const;
  StepsFinding EqualSteps(const TurntableScene& scene) const;
  static bool IsWorthItsAngles(const ScanCandidate& free, const ScanCandidate& about_steps);

  const ScanFeatures& features_;
  const CandidateLikelihood& likelihood_;
  const RefineOptions& refine_;
  const JointOptions& joint_;
  Reporter& reporter_;
  HeldBackKeypoints held_back_;
};

}  // namespace s2gs
