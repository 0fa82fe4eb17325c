#include "s2gs/training/train.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "s2gs/core/rng.h"
#include "s2gs/kernel/sh.h"
#include "s2gs/told_bands.h"
#include "s2gs/training/growth.h"
#include "s2gs/training/held_out_stop.h"
#include "s2gs/training/model_cleanup.h"
#include "s2gs/training/photo_order.h"
#include "s2gs/training/photos_at_level.h"
#include "s2gs/training/train_checkpoints.h"
#include "s2gs/training/train_messages.h"
#include "s2gs/training/train_run.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/format_text.h"

namespace s2gs {
namespace {

constexpr uint64_t kBackgroundStream = 202;  // of random numbers.

size_t CountTrained(const TrainingScene& scene) {
  size_t count = 0;
  for (const ScenePhoto& photo : scene.photos) count += photo.held_out ? 0 : 1;
  S2GS_INVARIANT(count > 0);
  return count;
}

// Bands of colour that no photo tells are not learnt. Returns the highest that is.
int DecideBands(bool resumed, TrainRun* run) {
  const int asked = run->options.sh_degree;
  if (!run->options.only_told_bands || asked < 1) return asked;
  const ToldBands told = FindToldBands(run->scene, asked);
  if (resumed) return told.degree;
  TrainDecision decision;
  decision.part = "sh_bands";
  decision.is_left_out = told.degree < asked;
  decision.measured = FormatText("band %d adds %.3g to what lower bands can do in these views",
                                 told.last.band, told.last.own_part);
  decision.threshold = FormatText("a grey level, %.3g", kGreyLevel);
  decision.reason = decision.is_left_out ? FormatText("the photos tell bands up to %d alone", told.degree)
                                         : std::string("the photos tell all bands");
  if (decision.is_left_out) {
    decision.saving =
        FormatText("%d of %d numbers of each Gaussian's colour are not learnt",
                   3 * (ShRestCount(asked) - ShRestCount(told.degree)), 3 * (1 + ShRestCount(asked)));
    run->reporter.Info(decision.reason + ": " + decision.measured);
  }
  run->log.AddDecision(run->Point(), decision);
  return told.degree;
}

class Trainer {
 public:
  Trainer(const TrainingScene& scene, const TrainOptions& options, uint64_t seed, const TrainFiles& files,
          Backend* backend, Reporter& reporter)
      : Trainer(scene, options, files, backend, reporter,
                StartOrResume(scene, options, seed, files, backend, reporter)) {}

  TrainResult Run() {
    double before = run_.cursor.progress;
    while (before < 1) {
      TrainMoment moment =
          MomentAt(run_.options, before, run_.scene.bodies(), run_.cursor.foreground_frozen, has_masks_);
      moment.sh_degree = std::min(moment.sh_degree, max_sh_degree_);
      UseLevel(moment.coarse_level);
      FindNeighboursIfNeeded(moment, before);
      StepOnce(moment);
      const double now = run_.Progress();
      run_.cursor.progress = now;
      messages_.AddNotFinite(Grow(moment, static_cast<int64_t>(training_views_.size()), before, now, &run_));
      cleanup_.FreezeIfDue(before, now);
      cleanup_.TidyIfDue(training_views_, before, now);
      messages_.ReportIfDue(held_out_.errors(), before, now);
      held_out_.MeasureIfDue(before, now);
      if (held_out_.HasStoppedFalling(before, now)) break;
      checkpoints_.SaveIfDue(before, now);
      before = now;
    }
    return Finish();
  }

 private:
  Trainer(const TrainingScene& scene, const TrainOptions& options, const TrainFiles& files, Backend* backend,
          Reporter& reporter, const TrainStart& start)
      : run_(scene, options, backend, reporter, start.cursor, start.resumed, files.log),
        order_(CountTrained(scene), start.cursor.seed),
        max_sh_degree_(DecideBands(start.resumed, &run_)),
        held_out_(&run_),
        cleanup_(&run_),
        messages_(&run_),
        checkpoints_(files, &run_) {
    if (!start.resumed) held_out_.LogWhetherItMayStop();
    for (const ScenePhoto& photo : scene.photos) {
      has_masks_ = has_masks_ || (!photo.held_out && !photo.mask.empty());
    }
  }

  void UseLevel(int level) {
    if (level == level_) return;
    std::vector<TrainingPhoto> photos = PhotosAtLevel(run_.scene, level, run_.options.min_coarse_size);
    run_.width = photos.front().view.width;
    run_.height = photos.front().view.height;
    training_views_.clear();
    training_views_.reserve(photos.size());
    for (const TrainingPhoto& photo : photos) training_views_.push_back(photo.view);
    run_.backend->SetPhotos(std::move(photos));
    level_ = level;
  }

  void FindNeighboursIfNeeded(const TrainMoment& moment, double before) {
    if (!(moment.weights.local_consistency > 0)) return;
    const int64_t turn = TimesBy(before, run_.options.neighbours_every);
    if (turn == run_.cursor.neighbours_turn) return;
    run_.backend->RefreshNeighbours(run_.options.num_neighbours);
    run_.cursor.neighbours_turn = turn;
  }

  void StepOnce(const TrainMoment& moment) {
    TrainCursor* cursor = &run_.cursor;
    const bool draws_part = run_.scene.bodies() == SceneBodies::kBoth && cursor->foreground_frozen &&
                            cursor->progress >= run_.options.densify_until &&
                            order_.RoundOf(cursor->iteration + 1) % run_.options.whole_every != 0;
    messages_.BeforeStep(draws_part);
    ++cursor->iteration;
    TrainStep step;
    step.iteration = cursor->iteration;
    step.photo = order_.At(cursor->iteration);
    step.bodies = run_.scene.bodies();
    step.sh_degree = moment.sh_degree;
    step.rates = moment.rates;
    step.weights = moment.weights;
    step.freeze_foreground = cursor->foreground_frozen;
    step.collect_statistics = moment.grows;
    step.only_rotating_tiles = draws_part;
    if (run_.scene.mode == TrainMode::kMasks) {
      // A background of any colour at all: what is transparent in truth is then never cheaper to paint.
      step.cut_out_mask = true;
      const Random4 bits = RandomBits(cursor->seed, kBackgroundStream, cursor->iteration);
      for (int i = 0; i < 3; ++i) step.background_color[i] = UnitFloat(bits.words[i]);
    }
    run_.backend->Step(step);
  }

  TrainResult Finish() {
    TrainResult result;
    result.gaussians = run_.backend->GetGaussians();
    run_.clock.Lap();
    result.iterations = run_.cursor.iteration;
    result.wall_seconds = run_.cursor.wall_seconds;
    result.cpu_seconds = run_.cursor.cpu_seconds;
    result.measuring_seconds = run_.cursor.measuring_seconds;
    result.foreground_frozen = run_.cursor.foreground_frozen;
    result.held_out = held_out_.errors();
    cleanup_.LogSights();
    run_.log.Write();
    run_.reporter.Progress("train", run_.options.num_iterations, run_.options.num_iterations);
    return result;
  }

  TrainRun run_;
  PhotoOrder order_;
  int max_sh_degree_;
  HeldOutStop held_out_;
  ModelCleanup cleanup_;
  TrainMessages messages_;
  TrainCheckpoints checkpoints_;
  bool has_masks_ = false;
  int level_ = -1;
  std::vector<PinholeView> training_views_;
};

}  // namespace

TrainResult Train(const TrainingScene& scene, const TrainOptions& options, uint64_t seed,
                  const TrainFiles& files, Backend* backend, Reporter& reporter) {
  return Trainer(scene, options, seed, files, backend, reporter).Run();
}

}  // namespace s2gs
