#include "s2gs/training/held_out_stop.h"

#include <algorithm>
#include <cmath>

#include "sfm_split/base/format_text.h"

namespace s2gs {
namespace {

constexpr double kFirstMeasurement = 0.01;  // of the run.

}  // namespace

HeldOutStop::HeldOutStop(TrainRun* run) : run_(*run) {
  for (const ScenePhoto& photo : run_.scene.photos) num_photos_ += photo.held_out ? 1 : 0;
}

bool HeldOutStop::MayStop() const {
  return run_.options.stop_gain_pct > 0 && num_photos_ >= HeldOutCourse::kMinPhotos;
}

void HeldOutStop::LogWhetherItMayStop() {
  if (MayStop()) return;
  TrainDecision decision;
  decision.part = "end_of_training";
  decision.measured = FormatText("%d photos held out", num_photos_);
  decision.threshold = FormatText("%d", HeldOutCourse::kMinPhotos);
  decision.reason = run_.options.stop_gain_pct > 0
                        ? "too few to say when their error stops falling: training runs to its end"
                        : "asked for: training runs to its end";
  run_.log.AddDecision(run_.Point(), decision);
}

void HeldOutStop::Measure() {
  run_.backend->Wait();
  run_.clock.Lap();
  errors_ = MeasureHeldOut(run_.scene, run_.backend);
  run_.clock.LapMeasuring();
  run_.log.AddHeldOut(run_.Point(), *errors_);
}

void HeldOutStop::MeasureIfDue(double before, double now) {
  if (num_photos_ == 0 || run_.options.num_measurements < 1) return;
  bool is_due = now >= 1;
  const int steps = run_.options.num_measurements - 1;
  for (int i = 0; i < steps; ++i) {
    const double moment = std::pow(kFirstMeasurement, 1 - static_cast<double>(i) / steps);
    is_due = is_due || (before < moment && now >= moment);
  }
  if (!is_due) return;
  Measure();
  run_.log.Write();
}

bool HeldOutStop::HasStoppedFalling(double before, double now) {
  if (!MayStop()) return false;
  const TrainOptions& options = run_.options;
  const bool learns_p = run_.scene.bodies() == SceneBodies::kBoth && options.settle_until < 1;
  if (learns_p && !run_.cursor.foreground_frozen) return false;
  if (before < std::max(options.densify_until, options.coarse_until)) return false;
  const bool is_end = now >= 1;
  if (!is_end && !Passed(before, now, HeldOutCourse::kEvery)) return false;
  if (!is_end) {
    Measure();
    const double error = std::pow(10.0, -errors_->psnr / 20);
    if (std::isfinite(error) && error > 0) run_.cursor.held_out_course.Add(now, error);
  }
  const bool stops = !is_end && run_.cursor.held_out_course.MostGainToComePct() < options.stop_gain_pct;
  if (stops || is_end) LogEnd(now, stops);
  return stops;
}

void HeldOutStop::LogEnd(double now, bool stops) {
  const double gain = run_.cursor.held_out_course.GainToComePct();
  const double most = run_.cursor.held_out_course.MostGainToComePct();
  TrainDecision decision;
  decision.part = "end_of_training";
  decision.is_left_out = stops;
  decision.measured =
      std::isfinite(gain)
          ? FormatText("%+.2f %% of the held-out error to come at %.0f %% of the run, ", gain, 100 * now) +
                FormatText("%+.2f %% at most", most)
          : "the course was too short to tell";
  decision.threshold = FormatText("%.3g %%", run_.options.stop_gain_pct);
  decision.reason = stops ? "the error of held-out photos has stopped falling" : "it fell to the end";
  if (stops) decision.saving = FormatText("%.0f %% of the iterations", 100 * (1 - now));
  if (stops) run_.reporter.Info("training stops: " + decision.reason + ", " + decision.measured);
  run_.log.AddDecision(run_.Point(), decision);
}

}  // namespace s2gs
