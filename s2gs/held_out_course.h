#pragma once

#include <utility>
#include <vector>

namespace s2gs {

/// How the error of held-out photos falls over the last part of a run, to tell when going on buys nothing.
class HeldOutCourse {
 public:
  /// Judgement, not derivation: the mean over fewer photos follows one of them.
  static constexpr int kMinPhotos = 4;
  static constexpr double kEvery = 0.04;  ///< of the run, between two measurements.
  /// Measurements of which the slope is taken: the line through them has two degrees of freedom left, which
  /// the jitter of single iterations needs.
  static constexpr int kNumForSlope = 4;

  struct Point {
    double progress = 0;  ///< 0 to 1.
    double error = 0;     ///< RMS, above 0.
  };

  void Add(double progress, double error) { points_.push_back({progress, error}); }
  const std::vector<Point>& points() const { return points_; }
  void Set(std::vector<Point> points) { points_ = std::move(points); }

  /// How much the error would still fall by the end of the run, at the rate of the last kNumForSlope points:
  /// a share of it, below 0 where it rises [%]. The rate of training falls towards its end, so that this is
  /// more than what is to be had, unless the error jitters. Infinite while points are too few.
  double GainToComePct() const;

 private:
  std::vector<Point> points_;
};

}  // namespace s2gs
