#pragma once

#include <vector>

#include "sfm_split/circular_motion/match_triples.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// What points in three photos in a row say of a scene's poses beside what two photos say: the logarithm of
/// how much better than chance the outer two's keypoints, met in space, tell where the middle one's lies
/// along their move. Before a camera that is level with the table, matches of two photos tell the focal
/// length over the step, and neither; a point that goes back and forth on a line tells the step by 2
/// cos(step) of its place in the middle. Over all matches that may be the object's, right and wrong ones, of
/// photos of one station. \param triples  of PossibleTriples(). \param sigma_px  of a keypoint's coordinate.
double GainOfTriples(const ScanFeatures& features, const AlignedScene& aligned,
                     const std::vector<PhotoTriple>& triples, double sigma_px);

}  // namespace s2gs
