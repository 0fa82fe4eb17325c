#pragma once

#include <atomic>
#include <future>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/circular_motion/circular_scene.h"
#include "sfm_split/scene/scan_features.h"

namespace s2gs {

/// SceneFromCircularMotion on a thread of its own, for a caller that waits for another program meanwhile. It
/// is found by `CircularOptions::begun`.
class CircularSearch {
 public:
  /// Begins. \param features  not changed before this dies.
  /// \param reporter  is asked whether to stop, and hears of the search when it is awaited.
  CircularSearch(const ScanFeatures& features, const CircularOptions& options, const Reporter& reporter);
  CircularSearch(const CircularSearch&) = delete;
  CircularSearch& operator=(const CircularSearch&) = delete;
  /// Stops the search if it has not ended.
  ~CircularSearch();

  /// Whether it searches these very features, not others that are alike.
  bool IsOf(const ScanFeatures& features) const { return &features == &features_; }

  /// Waits for the search to end. What it logged goes to the reporter, and what it threw is thrown.
  AlignedScene Await(Reporter& reporter, CircularFinding* finding) const;

 private:
  struct Found {
    AlignedScene aligned;
    CircularFinding finding;
    std::vector<std::pair<LogLevel, std::string>> messages;
  };

  const ScanFeatures& features_;
  std::atomic<bool> is_stopping_ = false;
  std::shared_future<Found> found_;
};

}  // namespace s2gs
