#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace s2gs {

/// Which time of a run counts: that of all its threads, or that on the clock, where a GPU does the work and
/// one run at a time has it.
enum class CurveTime : uint8_t { kCpu, kWall };

/// One run: a scene, a knob's value and a seed.
struct WorkPoint {
  int scene = 0;      ///< index into WorkCurve::scenes.
  std::string value;  ///< of the knob, as given.
  uint64_t seed = 0;
  double wall_seconds = 0;
  double cpu_seconds = 0;                 ///< of all threads and of `colmap`.
  std::string failure;                    ///< why there is no result; empty: there is one.
  std::map<std::string, double> figures;  ///< by name.

  /// A figure; nothing where the run failed or it was not measured.
  std::optional<double> Figure(const std::string& name) const;
};

/// All runs of one knob.
struct WorkCurve {
  std::string knob;
  std::string what;                 ///< the knob in words.
  std::string error;                ///< the figure that counts as error: less is better.
  std::string error_text;           ///< it in words, with its unit.
  std::string reference;            ///< "ground truth", "the scan's own longest run" or "held-out photos".
  std::string program;              ///< version.
  std::vector<std::string> scenes;  ///< names.
  std::vector<std::string> values;  ///< in the order of the sweep, from cheap to costly.
  CurveTime time = CurveTime::kCpu;
  std::vector<WorkPoint> points;
};

/// Least, median and largest of a set.
struct Spread {
  double min = 0, median = 0, max = 0;
};
/// Infinite where there are no values.
Spread SpreadOf(const std::vector<double>& values);

/// The seeds of one value on one scene, summed up.
struct WorkSetting {
  int scene = 0;
  std::string value;
  int runs = 0;
  int reached = 0;  ///< with an error.
  Spread cpu_seconds, wall_seconds;
  Spread seconds;  ///< that of both which counts.
  Spread error;    ///< of those that were reached; infinite when none was.
  /// No other setting of its scene has both less median error and less median time, and every run of it came
  /// to a result.
  bool is_pareto = false;
};

/// By scene and value, in the curve's order.
std::vector<WorkSetting> SumUp(const WorkCurve& curve);

/// The least median time of a setting that comes to a share of the final quality: quality is 1 / error,
/// and final that of the scene's best setting. Nothing when nothing was reached.
std::optional<double> TimeToShare(const std::vector<WorkSetting>& settings, int scene, double share);

/// Performance profile (Dolan and More, "Benchmarking optimization software with performance profiles",
/// 2002): for a value, the share of scenes on which it comes within `tolerance` of the scene's least error in
/// at most `ratio` times the time of the fastest value that does.
double ProfileAt(const std::vector<WorkSetting>& settings, int num_scenes, const std::string& value,
                 double ratio, double tolerance);

/// Curves of one knob, of other scenes, seeds or values, as one; values that are numbers stand as the first
/// curve has them, rising or falling. Throws UserError when they measure different things, or two have the
/// same run.
WorkCurve MergeCurves(const std::vector<WorkCurve>& curves);

}  // namespace s2gs
