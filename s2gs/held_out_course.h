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
  /// Before so many measurements nothing is said: a line through them leaves two degrees of freedom, which
  /// tell its noise.
  static constexpr int kMinPoints = 4;
  /// Chance that a run is stopped that would have gained what it was asked for: shared by all moments at
  /// which it is asked, of which there are kMostLooks at most, since p is settled at 60 % of the run.
  static constexpr double kFalseStops = 0.05;
  static constexpr int kMostLooks = 10;

  struct Point {
    double progress = 0;  ///< 0 to 1.
    double error = 0;     ///< RMS, above 0.
  };

  void Add(double progress, double error) { points_.push_back({progress, error}); }
  const std::vector<Point>& points() const { return points_; }
  void Set(std::vector<Point> points) { points_ = std::move(points); }

  /// How much the error would still fall by the end of the run, at the rate of a line through the logarithms
  /// of all points: a share of it, below 0 where it rises [%]. The rate of training falls towards its end, so
  /// that this is more than what is to be had. Infinite while points are too few.
  double GainToComePct() const { return GainPct(0); }
  /// The same with the slope at the end of its one-sided confidence interval (Student's, by the points' own
  /// scatter about the line) where the error falls fastest: at a true gain of this or more a run is stopped
  /// with a chance of kFalseStops at most.
  double MostGainToComePct() const;

 private:
  /// \param quantile  standard errors by which the error may fall faster than the line.
  double GainPct(double quantile) const;

  std::vector<Point> points_;
};

}  // namespace s2gs
