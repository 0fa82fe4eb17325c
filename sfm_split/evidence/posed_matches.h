#pragma once

#include <optional>
#include <vector>

#include "sfm_split/adjust/match_errors.h"
#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/evidence/verdict.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// Fewest matches that show a motion between two photos (COLMAP's bound).
constexpr int kLeastSupport = 15;
/// That chance alone places one of a scan's photos, or turns it.
constexpr double kScanRisk = 1.0 / 400;

/// What matches are of: its poses before the photos are those that count.
enum class ScanPart { kObject, kBackground };

/// The matches of a scan's photos against their poses.
class PosedMatches {
 public:
  /// Both must outlive it. \param bound_px  distance from its epipolar line at which a match agrees.
  PosedMatches(const ScanFeatures& features, const TurntableScene& scene, double bound_px,
               ScanPart part = ScanPart::kObject);
  PosedMatches(const PosedMatches&) = delete;
  PosedMatches& operator=(const PosedMatches&) = delete;

  const ScanFeatures& features() const { return features_; }
  double bound_px() const { return bound_px_; }
  /// Of each image of the features: its pose before the object, or the background.
  const std::vector<PosedImage>& posed() const { return posed_; }
  /// Of each image of the features: its view; nullptr where it has none.
  const std::vector<const View*>& views() const { return view_of_; }

  const Keypoints& KeypointsOf(int image) const {
    return features_.images[static_cast<size_t>(image)].keypoints;
  }
  int StationOf(int image) const { return features_.images[static_cast<size_t>(image)].station; }
  bool IsPosed(int image) const { return posed_[static_cast<size_t>(image)].is_posed; }
  /// Of matches of two posed images [px].
  std::vector<double> ErrorsOf(const ImagePairMatches& pair, const FeatureMatches& matches) const {
    return errors_->Of(pair.image1, pair.image2, matches);
  }
  /// How many of these matches agree, against the same with their second keypoints exchanged among them.
  /// \param bound_px  distance from its epipolar line at which a match agrees.
  AgreeingMatches Compare(const ImagePairMatches& pair, const FeatureMatches& matches, double bound_px) const;

 private:
  const ScanFeatures& features_;
  double bound_px_;
  std::vector<PosedImage> posed_;
  std::optional<MatchErrors> errors_;  // against these
  std::vector<const View*> view_of_;
};

}  // namespace s2gs
