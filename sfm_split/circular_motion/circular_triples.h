#pragma once

#include <Eigen/Core>
#include <array>

#include "sfm_split/circular_motion/circular_likelihood.h"

namespace s2gs {

/// What three photos say of a circle beside what two say: where the outer two's keypoints meet in space, the
/// middle one sees a point, and its keypoint lies beside it along their move by the error. Two photos hardly
/// tell how far the table turned, and trade it for focal length and elevation; a point that three see tells
/// it. By log focal length, distortion, turn of the frame, the angles from the first to the middle photo and
/// from there to the last.
using TripleDerivative = Eigen::Matrix<double, 7, 1>;

/// Of the triples of three photos.
class TripleErrors {
 public:
  /// \param lens, turn  must outlive it.
  TripleErrors(const CircularLens& lens, const CircularTurn& turn, const std::array<int, 3>& photos);

  /// [px]; infinite where the outer rays do not meet before all three cameras.
  /// \param derivative  filled in unless null.
  double Of(const CircularTriple& triple, TripleDerivative* derivative) const;

 private:
  const CircularLens& lens_;
  const CircularTurn& turn_;
  double focal_;
  // Of how far the table turned from the middle photo to the first and to the last.
  Eigen::Vector2d cosines_, sines_;
};

/// Of one of them.
double TripleError(const CircularTriple& triple, const CircularLens& lens, const CircularTurn& turn,
                   const std::array<int, 3>& photos, TripleDerivative* derivative);

}  // namespace s2gs
