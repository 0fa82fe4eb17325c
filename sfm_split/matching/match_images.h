#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/matching/descriptor_match.h"
#include "sfm_split/matching/pair_plan.h"
#include "sfm_split/scene/io/colmap_database.h"

namespace s2gs {

struct MatchImagesOptions {
  DescriptorMatchOptions match;
  int num_threads = 0;       ///< 0: all cores.
  double cache_size_gb = 2;  ///< memory for descriptors, 0.8 MB an image of 6,000. At least two images stay.

  OptionCheck Check() const;
};

struct MatchImagesSummary {
  size_t num_pairs_matched = 0;
  size_t num_pairs_skipped = 0;  ///< those that the database had already.
  size_t num_matches = 0;        ///< of the pairs matched now.
  size_t num_image_loads = 0;    ///< how often an image's descriptors were read.
};

/// Matches pairs of images and writes the database's `matches` table, as COLMAP's matchers do before they
/// verify. Pairs that the table has already are left as they are, whatever options they were matched with.
/// Results are committed about every second: a run that was stopped or killed goes on where it ended.
/// Progress is reported as "match pairs". Throws Interrupted when the reporter asks to stop, and UserError
/// for faults of the database. \param image_ids  the database's ids of the images that the pairs number.
/// \param pairs      in any order; repetitions are matched once.
MatchImagesSummary MatchImages(const std::vector<uint32_t>& image_ids, const std::vector<ImagePair>& pairs,
                               const MatchImagesOptions& options, ColmapDatabase* database,
                               Reporter& reporter);

}  // namespace s2gs
