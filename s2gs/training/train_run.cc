#include "s2gs/training/train_run.h"

#include <algorithm>

namespace s2gs {

TrainRun::TrainRun(const TrainingScene& trained, const TrainOptions& told, Backend* by, Reporter& to,
                   const TrainCursor& from, bool resumed, const std::filesystem::path& log_path)
    : scene(trained),
      options(told),
      backend(by),
      reporter(to),
      cursor(from),
      log(log_path, resumed ? from.iteration : -1),
      clock(&cursor) {}

LogPoint TrainRun::Point() const {
  LogPoint point;
  point.iteration = cursor.iteration;
  point.progress = cursor.progress;
  point.wall_seconds = cursor.wall_seconds;
  point.cpu_seconds = cursor.cpu_seconds;
  point.measuring_seconds = cursor.measuring_seconds;
  point.count = backend->Count();
  point.width = width;
  point.height = height;
  return point;
}

double TrainRun::Progress() const {
  const double by_count = static_cast<double>(cursor.iteration) / static_cast<double>(options.num_iterations);
  if (!(options.max_seconds > 0)) return by_count;
  return std::min(1.0, std::max(by_count, clock.WallSeconds() / options.max_seconds));
}

bool Passed(double before, double now, double every) { return TimesBy(now, every) > TimesBy(before, every); }

}  // namespace s2gs
