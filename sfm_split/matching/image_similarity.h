#pragma once

#include <cstdint>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/matching/descriptor_match.h"
#include "sfm_split/matching/pair_plan.h"
#include "sfm_split/scene/io/colmap_database.h"

namespace s2gs {

/// The rows of the `num` keypoints of the largest scale, ascending. Among equal scales, and when the
/// keypoints have no scale (two columns), the lowest rows.
std::vector<uint32_t> LargestKeypoints(const KeypointMatrix& keypoints, size_t num);

/// Matches all pairs of images and counts the matches. Meant for a few hundred features an image, such as the
/// largest ones: large features survive changes of view and scale, and 256 of them cost 1/600 of the work of
/// 6,200. Progress is reported as "compare images". Throws Interrupted when the reporter asks to stop.
SimilarityMatrix CountMatchesOfAllPairs(const std::vector<PackedDescriptors>& images,
                                        DescriptorMatcher* matcher, Reporter& reporter);

/// The similarity of the database's images in the order of `image_ids`, by their num_features largest
/// features.
SimilarityMatrix CoarseSimilarity(const ColmapDatabase& database, const std::vector<uint32_t>& image_ids,
                                  size_t num_features, DescriptorMatcher* matcher, Reporter& reporter);

}  // namespace s2gs
