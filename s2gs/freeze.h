#pragma once

#include <cstdint>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/scene/training_scene.h"

namespace s2gs {

/// Share of the Gaussians whose p is outside [.1, .9].
double SettledShare(const std::vector<float>& foreground_logits);

/// Settles p: 0 below tau, 1 from it on, as far as a logit can say so.
void FreezeForeground(std::vector<float>* foreground_logits);

/// Which Gaussians stay when nothing outside the region rotates: all that do not rotate or lie inside.
/// \param margin  beyond the region that is still inside [scene sizes].
std::vector<uint32_t> KeepInsideRegion(const Placement& placement, const RotatingRegion& region,
                                       double margin);

/// While p is still learnt: makes the rotating Gaussians outside the region undecided. Returns how many there
/// were.
int64_t DisownOutsideRegion(const RotatingRegion& region, double margin, Placement* placement);

}  // namespace s2gs
