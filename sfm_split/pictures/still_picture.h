#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/pictures/picture_comparison.h"

namespace s2gs {

/// What a camera that stands still sees, of pictures in which it did: what turns or passes by is not in it,
/// and noise and compression hardly. Photos of other exposures are brought to the first one's light.
/// \param pictures  of one size, at least one.
GreyPicture MedianPicture(const std::vector<const GreyPicture*>& pictures);

/// The second picture as the first one's camera would show it. \param second_from_first  [px of the pictures]
GreyPicture SeenFrom(const Eigen::Matrix3d& second_from_first, const GreyPicture& second);

}  // namespace s2gs
