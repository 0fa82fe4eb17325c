#pragma once

#include <cstdint>
#include <vector>

#include "sfm_split/matching/pair_plan.h"

namespace s2gs {

/// The photos of a turn in the order in which the table took them, by how much each two have in common: the
/// angle of each photo in the plane of the second and third eigenvectors of the normalised graph Laplacian
/// (Atkins, Boman and Hendrickson 1998), which goes once around for a full turn and half around for a part of
/// one. Where the turn begins, and its sense, are arbitrary; photo 0 comes first.
std::vector<uint32_t> OrderBySimilarity(const SimilarityMatrix& similarity);

}  // namespace s2gs
