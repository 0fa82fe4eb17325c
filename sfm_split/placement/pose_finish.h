#pragma once

#include <map>
#include <set>
#include <utility>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/placement/candidate_likelihood.h"
#include "sfm_split/placement/circle_refinement.h"
#include "sfm_split/placement/place_scan.h"
#include "sfm_split/scene/scan_features.h"

namespace s2gs {

/// By station of those that patches tie: the largest standard deviation that the adjustment to them states
/// for its photos, of the table's angle, or where nothing ties it to others', of the object before the
/// camera.
std::map<int, double> TurnsByPatches(const TurntableScene& scene, const JointReport& joint,
                                     const std::set<int>& tied_stations);

/// What is done to poses that were taken: they are adjusted to patches of the photos, stations whose turn
/// matches leave open are turned by silhouettes, and all matches are asked how far they bear each pose out.
/// Changes `result`; its durations are laps of `watch`. Keeps references.
class PoseFinish {
 public:
  PoseFinish(const ScanFeatures& features, const CandidateLikelihood& likelihood,
             const CircleRefinement& circles, const PlacementOptions& options, Reporter& reporter,
             Stopwatch* watch, ScanPlacement* result)
      : features_(features),
        likelihood_(likelihood),
        circles_(circles),
        options_(options),
        reporter_(reporter),
        watch_(*watch),
        result_(*result) {}

  /// Where circular motion would have an adjustment start: another start, where the table's rim is asked.
  void AddCircle(AlignedScene scene) { circle_scenes_.push_back(std::move(scene)); }

  /// All of it. \param read_photo  may be empty: then matches are asked alone.
  void Finish(const ReadGreyPhoto& read_photo);

  /// Without silhouettes.
  void FinishWithoutSilhouettes(const ReadGreyPhoto& read_photo);

 private:
  void AdjustToPhotos(const ReadGreyPhoto& read_photo);
  void AdjustToSurface(const ReadGreyPhoto& read_photo);
  bool LetTableWobble(const ReadGreyPhoto& read_photo);
  void AskAllMatches();
  bool MatchesBear(const std::vector<RimPrior>& rims, const ScanCandidate& about_rims) const;
  ScanCandidate AdjustAboutRims(const std::vector<RimPrior>& rims) const;
  void LeanByRims(const ReadGreyPhoto& read_photo);
  bool TurnBySilhouettes(const ReadGreyPhoto& read_photo, const ScanCandidate& from);

  const ScanFeatures& features_;
  const CandidateLikelihood& likelihood_;
  const CircleRefinement& circles_;
  const PlacementOptions& options_;
  Reporter& reporter_;
  Stopwatch& watch_;
  ScanPlacement& result_;
  std::vector<AlignedScene> circle_scenes_;
  std::vector<RimPrior> rims_;            // that the poses are about
  std::map<int, double> told_turns_deg_;  // by silhouettes, of a station: their standard deviations
};

}  // namespace s2gs
