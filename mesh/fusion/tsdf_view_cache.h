#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "mesh/fusion/depth_view.h"
#include "mesh/fusion/tsdf.h"
#include "mesh/fusion/tsdf_view.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Prepared views: kept in memory when they fit, else read again, a batch at a time.
class TsdfViewCache {
 public:
  using BatchWork = std::function<void(const std::vector<const TsdfView*>& views)>;

  /// \param max_bytes  for prepared views that are in memory at once.
  TsdfViewCache(const DepthViewSource& source, const TsdfOptions& options, int num_threads,
                uint64_t max_bytes);

  /// Batches of all views in their order. Throws what the source and the preparation throw, and Interrupted.
  void ForEachBatch(const char* task, Reporter& reporter, const BatchWork& work);

  /// Of the largest batch of the passes to come; of the first one's while that runs.
  uint64_t peak_bytes() const { return peak_bytes_; }
  bool has_colors() const { return has_colors_; }

 private:
  std::vector<TsdfView> Prepare(int begin, int end) const;
  int NumFitting(int count) const;

  const DepthViewSource& source_;
  const TsdfOptions& options_;
  const int num_threads_;
  const uint64_t max_bytes_;
  bool is_complete_ = false;  // all views are in `kept_`
  std::vector<TsdfView> kept_;
  int batch_size_;
  uint64_t largest_view_ = 0;  // [bytes]
  uint64_t peak_bytes_ = 0;
  bool has_colors_ = false;
};

}  // namespace s2gs
