#pragma once

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// Widens the standard deviations of table angles and focal lengths by what poses of single photos differ in
/// from those of stations, where the adjusted points ask for the former: the latter then err by more than the
/// noise of keypoints, as they do on a plate that wobbles. Angles are compared from the middle of those at
/// the reference's station. What has no standard deviation (0, negative or infinite) stays.
/// \param joint  of the stations' scene, its angles in the order of that scene's views.
void WidenByDifference(const TurntableScene& of_photos, const TurntableScene& of_stations,
                       JointReport* joint);

}  // namespace s2gs
