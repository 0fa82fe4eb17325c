#pragma once

#include <Eigen/Core>
#include <vector>

#include "s2gs/scene/training_scene.h"

namespace s2gs {

/// The change of colour, of 0 to 1, that a photo of 8 bits shows.
constexpr double kGreyLevel = 1.0 / 255;

/// What a band of spherical harmonics adds to what the bands below it can do, along the directions from which
/// a body is seen.
struct BandEvidence {
  int band = 0;
  /// The largest root mean square over the directions of any function of the band with a coefficient of
  /// length 1, after its best approximation by lower bands is taken off. Colours lie in 0 to 1, and so do
  /// coefficients: what is less than a grey level here, no photo shows.
  double own_part = 0;
};

/// \param directions  of unit length, in the body's frame; at least one.
std::vector<BandEvidence> MeasureBands(const std::vector<Eigen::Vector3d>& directions, int max_degree);

/// The highest band that the training photos tell from the lower ones: that of the body which is seen from
/// more sides. From the middle of what the photos look at, held-out photos left out.
struct ToldBands {
  int degree = 0;
  BandEvidence last;  ///< of the lowest band that is left out; of the highest where none is.
};
ToldBands FindToldBands(const TrainingScene& scene, int max_degree);

}  // namespace s2gs
