#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <set>
#include <utility>
#include <vector>

#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// Matches of two photos of one station, one a detail, with how likely they are when they are wrong.
struct TurnPair {
  struct Match {
    Eigen::Vector2d xy1;
    Eigen::Vector2d xy2;
    double chance = 0;  ///< density of a wrong match's error [1 / px].
  };
  size_t image1 = 0;
  size_t image2 = 0;
  std::vector<Match> matches;
};

/// The pairs of a station whose photos are near each other by name or by their places.
/// \param views  of each image of the features: a thing of revolution goes around (OrbitingThing) at their
/// angles, or at those of a turn that the station closes, whichever explains more.
/// \param by_name, by_angle  the station's images in either order.
/// \param others  keypoints, as image and index, of bodies that the poses are not of.
std::vector<TurnPair> NearPairs(const ScanFeatures& features, const std::vector<const View*>& views,
                                const std::vector<int>& by_name, const std::vector<int>& by_angle,
                                const std::set<std::pair<int, uint32_t>>& others);

/// How likely matches are where the second photo of a pair stands at another angle of the table than its view
/// says, with everything else as it is.
class TurnLikelihood {
 public:
  /// \param cameras, views  of each image of the features; null without a pose. They and the axis must
  /// outlive this.
  TurnLikelihood(const std::vector<const Camera*>& cameras, const std::vector<const View*>& views,
                 const TurntableAxis& axis)
      : cameras_(cameras), views_(views), axis_(axis) {}

  /// Logarithm of the likelihood of a pair's matches over that of all being wrong, by the second photo's
  /// turn; the share of right ones is the best at each.
  std::vector<double> OfTurns(const TurnPair& pair, const std::vector<double>& turns_deg,
                              double noise_px) const;

  /// Standard deviation of the right matches' errors at the poses [px], by expectation and maximisation.
  double Noise(const std::vector<TurnPair>& pairs) const;

 private:
  PosedImage Posed(size_t image, double turn_deg) const;

  const std::vector<const Camera*>& cameras_;
  const std::vector<const View*>& views_;
  const TurntableAxis& axis_;
};

}  // namespace s2gs
