#pragma once

#include <vector>

#include "sfm_split/evidence/held_back.h"
#include "sfm_split/evidence/posed_matches.h"
#include "sfm_split/evidence/verdict.h"

namespace s2gs {

/// What the object's verified matches say: how many agree with the poses, of all, across stations and of
/// those held back, and the noise of both. Returns how many of each image's agree.
std::vector<int> RecordVerifiedMatches(const PosedMatches& matches, const HeldBackKeypoints& held_back,
                                       ScanEvidence* evidence);

/// The photos whose matches agree with their places no better than they might by chance.
/// \param verified            of RecordVerifiedMatches.
/// \param has_one_angle_each  a photo's place is one angle of the table, its camera another photo's.
void RecordSupportOfPhotos(const PosedMatches& matches, const std::vector<int>& verified,
                           bool has_one_angle_each, ScanEvidence* evidence);

}  // namespace s2gs
