#pragma once

#include <vector>

#include "sfm_split/adjust/track_triangulation.h"

namespace s2gs {

/// Of a body's points, those of two keypoints that are likelier to be wrong matches than points of the body.
/// Two keypoints on each other's epipolar lines always meet somewhere, so that their point bears out whatever
/// geometry it was chosen by, and where it lies far from the body it has more to say on that than any right
/// one. Right ones lie among the points that three or more keypoints bear out, whose density is estimated by
/// a kernel with the width that foretells each of them best from the others; wrong ones have their keypoints
/// anywhere in the photos. How many are right, the points tell themselves.
/// \param images  of the points' tracks, posed.
/// \return  one a point; all false where too few points tell where the body is.
std::vector<bool> PointsApart(const std::vector<PosedImage>& images, const std::vector<TrackPoint>& points);

}  // namespace s2gs
