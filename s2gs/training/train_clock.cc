#include "s2gs/training/train_clock.h"

#include <time.h>

#include "sfm_split/base/stopwatch.h"

namespace s2gs {
namespace {

double CpuNow() {
  timespec now = {};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

}  // namespace

TrainClock::TrainClock(TrainCursor* cursor) : cursor_(cursor), wall_(SteadySeconds()), cpu_(CpuNow()) {}

void TrainClock::Lap() { Advance(&cursor_->wall_seconds, &cursor_->cpu_seconds); }

void TrainClock::LapMeasuring() {
  double unused = 0;
  Advance(&cursor_->measuring_seconds, &unused);
}

double TrainClock::WallSeconds() const { return cursor_->wall_seconds + SteadySeconds() - wall_; }

void TrainClock::Advance(double* wall, double* cpu) {
  const double wall_now = SteadySeconds();
  const double cpu_now = CpuNow();
  *wall += wall_now - wall_;
  *cpu += cpu_now - cpu_;
  wall_ = wall_now;
  cpu_ = cpu_now;
}

}  // namespace s2gs
