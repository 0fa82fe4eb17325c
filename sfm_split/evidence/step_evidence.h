#pragma once

#include <cstdint>
#include <set>
#include <utility>
#include <vector>

#include "sfm_split/scene/scan_features.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// A photo, or all photos from it on, that the matches put at another angle of the table than the poses do.
struct MisturnedPhoto {
  int image = 0;
  bool are_all_from_it = false;
  double off_deg = 0;    ///< turn about the axis that the matches ask for.
  double log_ratio = 0;  ///< natural logarithm of the matches' likelihood there over that at the poses.
};

/// A turn by less is no other place of a photo.
constexpr double kLeastAwayDeg = 5;

struct StepEvidence {
  /// One for each photo at most; of photos in steps only where more than a tenth of these are.
  std::vector<MisturnedPhoto> misturned;
  /// Images whose matches are hardly less likely half a step of the table away (five degrees at least), or
  /// farther, and whose angles nothing else tells: they do not tell the photo's place in the turn.
  std::vector<int> untold;
  /// The first images of stations whose matches are not surer of how the table turned there than that it
  /// stood still, went the other way or turned twice as far.
  std::vector<int> untold_stations;
};

/// Asks the matches of photos near each other whether the table stood elsewhere. Cameras, axis and lens are
/// taken as they are, so that one unknown is left, which few matches tell: each photo by itself, and all of
/// its station from it on, are turned by a degree and more, and the likelihood of the matches, as right ones
/// with noise beside wrong ones (WrongMatches), is compared with that at the poses. Where these are right it
/// is N / risk times as large with a probability of at most risk / N; N is the number of turns that are
/// tried.
/// \param cameras, views  of each image of the features; null without a pose.
/// \param others  keypoints, as image and index, of bodies that the poses are not of.
/// \param is_in_steps  of each image: its angle was adjusted as one of a series, of equal steps or stated.
/// \param overdispersion  by how much logarithms of likelihoods are too large (StationTurns).
StepEvidence AskSteps(const ScanFeatures& features, const std::vector<const Camera*>& cameras,
                      const std::vector<const View*>& views, const TurntableAxis& axis,
                      const std::set<std::pair<int, uint32_t>>& others, const std::vector<bool>& is_in_steps,
                      double overdispersion, double risk);

}  // namespace s2gs
