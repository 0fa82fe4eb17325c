#include "mesh/fusion/tsdf_view_cache.h"

#include <algorithm>
#include <iterator>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {

TsdfViewCache::TsdfViewCache(const DepthViewSource& source, const TsdfOptions& options, int num_threads,
                             uint64_t max_bytes)
    : source_(source),
      options_(options),
      num_threads_(num_threads),
      max_bytes_(max_bytes),
      batch_size_(2 * num_threads) {}

std::vector<TsdfView> TsdfViewCache::Prepare(int begin, int end) const {
  std::vector<TsdfView> views(end - begin);
  ParallelFor(end - begin, num_threads_, [&](int64_t i) {
    views[i] = PrepareTsdfView(*source_.Load(begin + static_cast<int>(i)), options_);
  });
  return views;
}

void TsdfViewCache::ForEachBatch(const char* task, Reporter& reporter, const BatchWork& work) {
  const auto pass_on = [&](const std::vector<TsdfView>& views) {
    std::vector<const TsdfView*> pointers;
    pointers.reserve(views.size());
    for (const TsdfView& view : views) pointers.push_back(&view);
    work(pointers);
  };
  const int count = source_.size();
  if (is_complete_) {
    if (reporter.StopRequested()) throw Interrupted();
    pass_on(kept_);
    reporter.Progress(task, count, count);
    return;
  }
  bool keep = peak_bytes_ == 0;
  uint64_t kept_bytes = 0;
  for (int begin = 0; begin < count;) {
    if (reporter.StopRequested()) throw Interrupted();
    // How large views are, the first one tells.
    const int end = std::min(count, begin + (largest_view_ == 0 ? 1 : batch_size_));
    std::vector<TsdfView> views = Prepare(begin, end);
    pass_on(views);
    uint64_t bytes = 0;
    for (const TsdfView& view : views) {
      bytes += view.Bytes();
      largest_view_ = std::max(largest_view_, view.Bytes());
      has_colors_ = has_colors_ || !view.colors.empty();
    }
    kept_bytes += bytes;
    peak_bytes_ = std::max(peak_bytes_, keep ? kept_bytes : bytes);
    if (keep && kept_bytes > max_bytes_) {
      keep = false;
      kept_ = {};
    }
    if (keep) std::move(views.begin(), views.end(), std::back_inserter(kept_));
    begin = end;
    batch_size_ = std::min(batch_size_, NumFitting(count));
    reporter.Progress(task, end, count);
  }
  is_complete_ = keep;
  if (keep) return;
  batch_size_ = NumFitting(count);
  peak_bytes_ = static_cast<uint64_t>(batch_size_) * largest_view_;
}

int TsdfViewCache::NumFitting(int count) const {
  const uint64_t fitting = max_bytes_ / std::max<uint64_t>(largest_view_, 1);
  return static_cast<int>(std::clamp<uint64_t>(fitting, 1, static_cast<uint64_t>(std::max(count, 1))));
}

}  // namespace s2gs
