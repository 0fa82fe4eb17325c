#include "s2gs/training/train_messages.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "sfm_split/base/error.h"
#include "sfm_split/base/format_text.h"

namespace s2gs {
namespace {

constexpr double kMessageEvery = 0.05;  // of the run.
constexpr int kMaxBadReports = 3;       // of losses that are no numbers, in a row.

std::string Duration(double seconds) {
  if (seconds < 100) return FormatText("%.0f s", seconds);
  return FormatText("%.0f min %02.0f s", std::floor(seconds / 60), std::fmod(seconds, 60));
}

}  // namespace

void TrainMessages::BeforeStep(bool draws_part) {
  if (draws_part != draws_part_ && has_loss_) LogLoss();
  draws_part_ = draws_part;
  has_loss_ = true;
}

void TrainMessages::LogLoss() {
  const LossTerms loss = run_.backend->TakeLoss();
  run_.clock.Lap();
  run_.log.AddLoss(run_.Point(), loss, !draws_part_);
  has_loss_ = false;
  CheckFinite(loss);
  last_loss_ = loss;
}

void TrainMessages::ReportIfDue(const std::optional<HeldOutErrors>& held_out, double before, double now) {
  const TrainCursor& cursor = run_.cursor;
  const int64_t num_iterations = run_.options.num_iterations;
  const int64_t every = std::clamp<int64_t>(num_iterations / 200, 1, 100);
  if (cursor.iteration % every != 0 && now < 1) return;
  LogLoss();
  run_.reporter.Progress("train", std::min<int64_t>(cursor.iteration, num_iterations - 1), num_iterations);
  if (!Passed(before, now, kMessageEvery) && now < 1 && now - last_message_ < kMessageEvery) return;
  last_message_ = now;
  const double rate = static_cast<double>(cursor.iteration) / std::max(cursor.wall_seconds, 1e-9);
  std::string message = "iteration " + std::to_string(cursor.iteration) + ", " +
                        FormatText("%.0f", 100 * now) + " %: loss " + FormatText("%.4f", last_loss_.total) +
                        ", " + std::to_string(run_.backend->Count()) + " Gaussians, " +
                        FormatText("%.3g", rate) + " iterations/s";
  if (now > 0 && now < 1) {
    message += ", " + Duration(cursor.wall_seconds * (1 - now) / now) + " left";
  }
  if (held_out) message += FormatText(", held-out %.2f dB", held_out->psnr);
  run_.reporter.Info(message);
  if (not_finite_ > 0) {
    run_.reporter.Warn(std::to_string(not_finite_) +
                       " Gaussians with parameters that are no numbers were removed");
    not_finite_ = 0;
  }
}

void TrainMessages::CheckFinite(const LossTerms& loss) {
  if (std::isfinite(loss.total)) {
    bad_reports_ = 0;
    return;
  }
  DensifyStep prune;  // removes what is not finite and nothing else
  prune.iteration = run_.cursor.iteration;
  prune.random_seed = run_.cursor.seed;
  prune.min_opacity = 0;
  prune.grow = false;
  not_finite_ += run_.backend->Densify(prune).not_finite;
  if (++bad_reports_ < kMaxBadReports) return;
  throw UserError(
      "training diverged at iteration " + std::to_string(run_.cursor.iteration) +
      ": the loss is not a number. Lower the learning rates or the weights of the loss, and look at "
      "the poses with `s2gs scan_evaluator`");
}

}  // namespace s2gs
