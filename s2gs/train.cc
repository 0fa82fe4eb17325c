#include "s2gs/train.h"

#include <time.h>

#include <algorithm>
#include <cmath>
#include <future>
#include <numeric>
#include <optional>
#include <system_error>

#include "s2gs/checkpoint.h"
#include "s2gs/core/rng.h"
#include "s2gs/freeze.h"
#include "s2gs/image/photos.h"
#include "s2gs/kernel/sh.h"
#include "s2gs/told_bands.h"
#include "s2gs/train_log.h"
#include "s2gs/turn_evidence.h"
#include "sfm_split/base/format_text.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/stopwatch.h"

namespace s2gs {
namespace {

// Streams of random numbers.
enum Stream : uint64_t { kOrderStream = 201, kBackgroundStream = 202 };

constexpr double kFirstMeasurement = 0.01;
constexpr double kTidyEvery = 0.1;          // of the run: strays are looked for.
constexpr double kStandingEvery = 0.2;      // of the run: those before what photos show, which takes longer.
constexpr double kTidyUntil = 0.95;         // what goes later could not be made up for.
constexpr double kSettleCheckEvery = 0.01;  // of the run.
constexpr double kMessageEvery = 0.05;      // of the run.
constexpr double kRegionMargin = 0.01;      // [scene sizes]
// Less is done again sooner than several copies of a large model are written.
constexpr double kWorthSaving = 30;  // [s] of training
constexpr int kMaxBadReports = 3;    // of losses that are no numbers, in a row.

double CpuNow() {
  timespec now = {};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

// Counts the time of training and leaves out that of measuring.
class Stopwatch {
 public:
  explicit Stopwatch(TrainCursor* cursor) : cursor_(cursor) {}

  // Adds what passed since the last call.
  void Lap() { Advance(&cursor_->wall_seconds, &cursor_->cpu_seconds); }
  void LapMeasuring() {
    double unused = 0;
    Advance(&cursor_->measuring_seconds, &unused);
  }
  double WallSeconds() const { return cursor_->wall_seconds + SteadySeconds() - wall_; }

 private:
  void Advance(double* wall, double* cpu) {
    const double wall_now = SteadySeconds();
    const double cpu_now = CpuNow();
    *wall += wall_now - wall_;
    *cpu += cpu_now - cpu_;
    wall_ = wall_now;
    cpu_ = cpu_now;
  }

  TrainCursor* cursor_;
  double wall_ = SteadySeconds();
  double cpu_ = CpuNow();
};

// Which photo an iteration sees: all in a random order, then all in another one.
class PhotoOrder {
 public:
  PhotoOrder(size_t count, uint64_t seed) : order_(count), seed_(seed) {}

  int64_t RoundOf(int64_t iteration) const { return (iteration - 1) / static_cast<int64_t>(order_.size()); }
  int At(int64_t iteration) {
    const int64_t epoch = RoundOf(iteration);
    if (epoch != epoch_) Shuffle(epoch);
    return order_[(iteration - 1) % static_cast<int64_t>(order_.size())];
  }

 private:
  void Shuffle(int64_t epoch) {
    std::iota(order_.begin(), order_.end(), 0);
    for (size_t i = order_.size(); i > 1; --i) {
      const Random4 bits = RandomBits(seed_, kOrderStream + (static_cast<uint64_t>(epoch) << 16U), i);
      const auto j = static_cast<size_t>(UnitDouble(bits.words[0]) * static_cast<double>(i));
      std::swap(order_[i - 1], order_[j]);
    }
    epoch_ = epoch;
  }

  std::vector<int> order_;
  uint64_t seed_;
  int64_t epoch_ = -1;
};

std::string Duration(double seconds) {
  if (seconds < 100) return FormatText("%.0f s", seconds);
  return FormatText("%.0f min %02.0f s", std::floor(seconds / 60), std::fmod(seconds, 60));
}

class Trainer {
 public:
  Trainer(const TrainingScene& scene, const TrainOptions& options, uint64_t seed, const TrainFiles& files,
          Backend* backend, Reporter& reporter)
      : scene_(scene),
        options_(options),
        files_(files),
        backend_(backend),
        reporter_(reporter),
        resumed_(Begin(seed)),
        log_(files.log, resumed_ ? cursor_.iteration : -1),
        order_(CountTrained(scene), seed),
        clock_(&cursor_),
        saved_at_(cursor_.wall_seconds) {
    for (const ScenePhoto& photo : scene.photos) {
      has_held_out_ = has_held_out_ || photo.held_out;
      has_masks_ = has_masks_ || (!photo.held_out && !photo.mask.empty());
      num_held_out_ += photo.held_out ? 1 : 0;
    }
    DecideBands();
    if (!resumed_) DecideWhetherToStop();
    // It depends on the photos alone, and a GPU leaves the cores idle.
    if (UsesEvidence() && options_.settle_until < 1 && backend_->Info().kind == BackendKind::kCuda) {
      evidence_to_come_ = std::async(std::launch::async, [&scene] { return TurnEvidence(scene); });
    }
  }

  TrainResult Run() {
    double before = cursor_.progress;
    while (before < 1) {
      TrainMoment moment = MomentAt(options_, before, scene_.bodies(), cursor_.foreground_frozen, has_masks_);
      moment.sh_degree = std::min(moment.sh_degree, max_sh_degree_);
      UseLevel(moment.coarse_level);
      FindNeighboursIfNeeded(moment, before);
      StepOnce(moment);
      const double now = Progress();
      cursor_.progress = now;
      Grow(moment, before, now);
      Settle(before, now);
      Tidy(before, now);
      Report(before, now);
      Measure(before, now);
      if (HasStoppedFalling(before, now)) break;
      SaveIfDue(before, now);
      before = now;
    }
    return Finish();
  }

 private:
  static size_t CountTrained(const TrainingScene& scene) {
    size_t count = 0;
    for (const ScenePhoto& photo : scene.photos) count += photo.held_out ? 0 : 1;
    S2GS_INVARIANT(count > 0);
    return count;
  }

  // Nothing when the file is damaged: then it lies beside itself under another name, for who wants to look at
  // it.
  std::optional<Checkpoint> ReadOrSetAside() {
    try {
      return ReadCheckpoint(files_.checkpoint);
    } catch (const UserError& error) {
      std::filesystem::path aside = files_.checkpoint;
      aside += ".damaged";
      std::error_code ec;
      std::filesystem::rename(files_.checkpoint, aside, ec);
      reporter_.Warn(std::string("the checkpoint cannot be read: ") + error.what() + ". " +
                     (ec ? "Training starts anew"
                         : "It is now " + aside.filename().string() + "; training starts anew"));
    }
    return std::nullopt;
  }

  // Loads the checkpoint, or makes the first Gaussians. Returns whether training goes on from before.
  bool Begin(uint64_t seed) {
    std::error_code ec;
    if (files_.resume && !files_.checkpoint.empty() && std::filesystem::exists(files_.checkpoint, ec)) {
      const std::optional<Checkpoint> checkpoint = ReadOrSetAside();
      if (checkpoint && checkpoint->cursor.settings == files_.settings && checkpoint->cursor.seed == seed) {
        cursor_ = checkpoint->cursor;
        backend_->SetState(checkpoint->state);
        reporter_.Info("going on after iteration " + std::to_string(cursor_.iteration) + " from " +
                       files_.checkpoint.string());
        return true;
      }
      if (checkpoint) {
        reporter_.Warn(files_.checkpoint.string() +
                       " was made with other options or photos: training starts anew");
      }
    }
    TrainState state;
    state.gaussians = InitialiseGaussians(scene_, options_.initial, seed, reporter_);
    cursor_.seed = seed;
    cursor_.initial_count = static_cast<int64_t>(state.gaussians.size());
    cursor_.settings = files_.settings;
    backend_->SetState(state);
    return false;
  }

  // Bands of colour that no photo tells are not learnt.
  void DecideBands() {
    max_sh_degree_ = options_.sh_degree;
    if (!options_.only_told_bands || options_.sh_degree < 1) return;
    const ToldBands told = FindToldBands(scene_, options_.sh_degree);
    max_sh_degree_ = told.degree;
    if (resumed_) return;
    TrainDecision decision;
    decision.part = "sh_bands";
    decision.is_left_out = told.degree < options_.sh_degree;
    decision.measured = FormatText("band %d adds %.3g to what lower bands can do in these views",
                                   told.last.band, told.last.own_part);
    decision.threshold = FormatText("a grey level, %.3g", kGreyLevel);
    decision.reason = decision.is_left_out ? FormatText("the photos tell bands up to %d alone", told.degree)
                                           : std::string("the photos tell all bands");
    if (decision.is_left_out) {
      decision.saving = FormatText("%d of %d numbers of each Gaussian's colour are not learnt",
                                   3 * (ShRestCount(options_.sh_degree) - ShRestCount(told.degree)),
                                   3 * (1 + ShRestCount(options_.sh_degree)));
      reporter_.Info(decision.reason + ": " + decision.measured);
    }
    log_.AddDecision(Point(), decision);
  }

  bool MayStop() const { return options_.stop_gain_pct > 0 && num_held_out_ >= HeldOutCourse::kMinPhotos; }

  // Why it will not, where that is known from the start.
  void DecideWhetherToStop() {
    if (MayStop()) return;
    TrainDecision decision;
    decision.part = "end_of_training";
    decision.measured = FormatText("%.0f photos held out", static_cast<double>(num_held_out_));
    decision.threshold = FormatText("%d", HeldOutCourse::kMinPhotos);
    decision.reason = options_.stop_gain_pct > 0
                          ? "too few to say when their error stops falling: training runs to its end"
                          : "asked for: training runs to its end";
    log_.AddDecision(Point(), decision);
  }

  // Where the model has stopped growing and p is settled, the rest of the run only polishes.
  bool HasStoppedFalling(double before, double now) {
    if (!MayStop()) return false;
    const bool learns_p = scene_.bodies() == SceneBodies::kBoth && options_.settle_until < 1;
    if (learns_p && !cursor_.foreground_frozen) return false;
    if (before < std::max(options_.densify_until, options_.coarse_until)) return false;
    const bool is_end = now >= 1;
    if (!is_end && !Passed(before, now, HeldOutCourse::kEvery)) return false;
    if (!is_end) {
      backend_->Wait();
      clock_.Lap();
      held_out_ = MeasureHeldOut(scene_, backend_);
      clock_.LapMeasuring();
      log_.AddHeldOut(Point(), *held_out_);
      const double error = std::pow(10.0, -held_out_->psnr / 20);
      if (std::isfinite(error) && error > 0) cursor_.held_out_course.Add(now, error);
    }
    const double gain = cursor_.held_out_course.GainToComePct();
    const double most = cursor_.held_out_course.MostGainToComePct();
    const bool stops = !is_end && most < options_.stop_gain_pct;
    if (!stops && !is_end) return false;
    TrainDecision decision;
    decision.part = "end_of_training";
    decision.is_left_out = stops;
    decision.measured =
        std::isfinite(gain)
            ? FormatText("%+.2f %% of the held-out error to come at %.0f %% of the run, ", gain, 100 * now) +
                  FormatText("%+.2f %% at most", most)
            : "the course was too short to tell";
    decision.threshold = FormatText("%.3g %%", options_.stop_gain_pct);
    decision.reason = stops ? "the error of held-out photos has stopped falling" : "it fell to the end";
    if (stops) decision.saving = FormatText("%.0f %% of the iterations", 100 * (1 - now));
    if (stops) reporter_.Info("training stops: " + decision.reason + ", " + decision.measured);
    log_.AddDecision(Point(), decision);
    return stops;
  }

  double Progress() const {
    const double by_count =
        static_cast<double>(cursor_.iteration) / static_cast<double>(options_.num_iterations);
    if (!(options_.max_seconds > 0)) return by_count;
    return std::min(1.0, std::max(by_count, clock_.WallSeconds() / options_.max_seconds));
  }

  // Whether a moment of the schedule lies between two points of the course.
  static bool Passed(double before, double now, double every) {
    return TimesBy(now, every) > TimesBy(before, every);
  }

  void UseLevel(int level) {
    if (level == level_) return;
    std::vector<TrainingPhoto> photos = PhotosAtLevel(scene_, level, options_.min_coarse_size);
    width_ = photos.front().view.width;
    height_ = photos.front().view.height;
    training_views_.clear();
    training_views_.reserve(photos.size());
    for (const TrainingPhoto& photo : photos) training_views_.push_back(photo.view);
    backend_->SetPhotos(std::move(photos));
    level_ = level;
  }

  void FindNeighboursIfNeeded(const TrainMoment& moment, double before) {
    if (!(moment.weights.local_consistency > 0)) return;
    const int64_t turn = TimesBy(before, options_.neighbours_every);
    if (turn == cursor_.neighbours_turn) return;
    backend_->RefreshNeighbours(options_.num_neighbours);
    cursor_.neighbours_turn = turn;
  }

  // Losses of whole photos and of a part of them are no mean of one thing.
  void LogLoss() {
    const LossTerms loss = backend_->TakeLoss();
    clock_.Lap();
    log_.AddLoss(Point(), loss, !draws_part_);
    has_loss_ = false;
    CheckFinite(loss);
    last_loss_ = loss;
  }

  void StepOnce(const TrainMoment& moment) {
    const bool draws_part = scene_.bodies() == SceneBodies::kBoth && cursor_.foreground_frozen &&
                            cursor_.progress >= options_.densify_until &&
                            order_.RoundOf(cursor_.iteration + 1) % options_.whole_every != 0;
    if (draws_part != draws_part_ && has_loss_) LogLoss();
    draws_part_ = draws_part;
    has_loss_ = true;
    ++cursor_.iteration;
    TrainStep step;
    step.iteration = cursor_.iteration;
    step.photo = order_.At(cursor_.iteration);
    step.bodies = scene_.bodies();
    step.sh_degree = moment.sh_degree;
    step.rates = moment.rates;
    step.weights = moment.weights;
    step.freeze_foreground = cursor_.foreground_frozen;
    step.collect_statistics = moment.grows;
    step.only_rotating_tiles = draws_part;
    if (scene_.mode == TrainMode::kMasks) {
      // A background of any colour at all: what is transparent in truth is then never cheaper to paint.
      step.cut_out_mask = true;
      const Random4 bits = RandomBits(cursor_.seed, kBackgroundStream, cursor_.iteration);
      for (int i = 0; i < 3; ++i) step.background_color[i] = UnitFloat(bits.words[i]);
    }
    backend_->Step(step);
  }

  void Grow(const TrainMoment& moment, double before, double now) {
    if (!moment.grows) return;
    if (cursor_.iteration - cursor_.last_densified >= options_.densify_every) {
      cursor_.last_densified = cursor_.iteration;
      DensifyStep step;
      step.iteration = cursor_.iteration;
      step.random_seed = cursor_.seed;
      step.max_clone_scale = static_cast<float>(options_.dense_scale);
      step.max_scale = static_cast<float>(options_.max_normalised_scale);
      step.min_opacity = static_cast<float>(MinOpacity());
      step.min_gradient = static_cast<float>(options_.densify_gradient);
      step.max_count = options_.max_gaussians;
      if (options_.growth == GrowthStrategy::kBudget) {
        step.min_gradient = 0;
        step.max_count = BudgetAt(now);
      }
      const DensifyResult result = backend_->Densify(step);
      not_finite_ += result.not_finite;
    }
    if (Passed(before, now, options_.opacity_reset_every) && now < options_.densify_until - 1e-9) {
      backend_->ResetOpacity(static_cast<float>(options_.opacity_reset_to));
      cursor_.last_reset = cursor_.iteration;
    }
  }

  // After a reset every Gaussian is faint: none is removed for it before all photos had their say twice.
  double MinOpacity() const {
    const auto turns = 2 * static_cast<int64_t>(training_views_.size());
    const bool recovers =
        cursor_.last_reset > 0 && cursor_.iteration - cursor_.last_reset < std::max<int64_t>(turns, 100);
    return recovers ? std::min(options_.min_opacity, options_.opacity_reset_to / 2) : options_.min_opacity;
  }

  // The budget is reached when four fifths of the time for growth are over: the last ones need some to learn.
  int64_t BudgetAt(double progress) const {
    const double span = 0.8 * (options_.densify_until - options_.densify_from);
    const double share = std::clamp((progress - options_.densify_from) / std::max(span, 1e-9), 0.0, 1.0);
    const auto start = static_cast<double>(cursor_.initial_count);
    return static_cast<int64_t>(start + share * (static_cast<double>(options_.max_gaussians) - start));
  }

  // Freezes p once it has settled, or its time is up.
  void Settle(double before, double now) {
    if (scene_.bodies() != SceneBodies::kBoth || cursor_.foreground_frozen) return;
    if (now < options_.settle_from || options_.settle_until >= 1) return;
    const bool is_last_chance = now >= options_.settle_until;
    if (!is_last_chance && !Passed(before, now, kSettleCheckEvery)) return;
    Placement placement = backend_->GetPlacement();
    const double share = SettledShare(placement.foreground_logit);
    if (!is_last_chance && share < options_.settled_share) return;
    const auto count = static_cast<int64_t>(placement.size());
    FreezeForeground(&placement.foreground_logit);
    backend_->SetForegroundLogits(placement.foreground_logit);
    if (options_.use_rotating_region && scene_.region) {
      backend_->Keep(KeepInsideRegion(placement, *scene_.region, kRegionMargin));
    }
    const int64_t dropped = count - backend_->Count();
    cursor_.foreground_frozen = true;
    RemoveStanding();
    const std::string note = "p is frozen: " + FormatText("%.2f", 100 * share) +
                             " % of it was outside [.1, .9]; " + std::to_string(dropped) +
                             " Gaussians that rotated outside the rotating part's region removed";
    reporter_.Info(note);
    log_.AddNote(Point(), note);
    TrainDecision decision;
    decision.part = "learning_p";
    decision.is_left_out = true;
    decision.measured =
        FormatText("%.2f %% of p outside [.1, .9] at %.0f %% of the run", 100 * share, 100 * now);
    decision.threshold = FormatText("%.4g %%, or %.0f %% of the run", 100 * options_.settled_share,
                                    100 * options_.settle_until);
    decision.reason = share < options_.settled_share ? "its time was up" : "p has settled";
    decision.saving = FormatText(
        "the map of p, its three terms and its gradient in %.0f %% of the iterations", 100 * (1 - now));
    log_.AddDecision(Point(), decision);
  }

  bool UsesEvidence() const { return options_.use_turn_evidence && scene_.bodies() == SceneBodies::kBoth; }
  void TakeEvidence() {
    evidence_.emplace(evidence_to_come_.valid() ? evidence_to_come_.get() : TurnEvidence(scene_));
  }

  // Rotating Gaussians where photos show the background, once p is frozen: others take their place.
  void RemoveStanding() {
    if (!UsesEvidence()) return;
    if (!evidence_) {
      TakeEvidence();
      if (!evidence_->IsAvailable()) {
        log_.AddNote(Point(),
                     "no camera stood still for enough photos to show what stands behind the rotating part");
      }
    }
    const std::vector<uint32_t> standing = FindStandingGaussians(*evidence_, backend_);
    const int64_t count = backend_->Count();
    if (standing.empty() || static_cast<int64_t>(standing.size()) == count) return;
    std::vector<uint32_t> kept;
    kept.reserve(static_cast<size_t>(count) - standing.size());
    size_t next = 0;
    for (int64_t i = 0; i < count; ++i) {
      if (next < standing.size() && standing[next] == i) {
        ++next;
      } else {
        kept.push_back(static_cast<uint32_t>(i));
      }
    }
    backend_->Keep(kept);
    const std::string note =
        std::to_string(standing.size()) + " rotating Gaussians removed where photos show the background";
    reporter_.Info(note);
    log_.AddNote(Point(), note);
  }

  // Strays: rotating Gaussians where nothing rotates, and those that no photo shows.
  void Tidy(double before, double now) {
    if (!Passed(before, now, kTidyEvery) || now > kTidyUntil) return;
    const bool all_stand = scene_.bodies() == SceneBodies::kStaticOnly;
    if (all_stand && !(options_.unseen_static_weight > 0)) return;
    const bool has_region = !all_stand && options_.use_rotating_region && scene_.region.has_value();
    if (!cursor_.foreground_frozen && scene_.bodies() == SceneBodies::kBoth) {
      if (!has_region || now < options_.regularise_from) return;
      Placement placement = backend_->GetPlacement();
      if (DisownOutsideRegion(*scene_.region, kRegionMargin, &placement) > 0) {
        backend_->SetForegroundLogits(placement.foreground_logit);
      }
      return;
    }
    if (now < options_.densify_until - 1e-9) return;
    if (Passed(before, now, kStandingEvery)) RemoveStanding();
    const Placement placement = backend_->GetPlacement();
    std::vector<uint32_t> kept =
        has_region ? KeepInsideRegion(placement, *scene_.region, kRegionMargin) : std::vector<uint32_t>();
    if (!has_region) {
      kept.resize(placement.size());
      std::iota(kept.begin(), kept.end(), 0U);
    }
    if (options_.unseen_weight > 0 || options_.unseen_static_weight > 0) {
      const std::vector<float> peak =
          backend_->PeakWeights(training_views_, scene_.bodies(), DrawnBody::kAll);
      if (!peak.empty()) {
        int64_t num_unseen_static = 0;
        const auto is_unseen = [&](uint32_t i) {
          const bool rotates = !all_stand && placement.foreground_logit[i] > 0;
          const bool goes = peak[i] < (rotates ? options_.unseen_weight : options_.unseen_static_weight);
          num_unseen_static += goes && !rotates ? 1 : 0;
          return goes;
        };
        kept.erase(std::remove_if(kept.begin(), kept.end(), is_unseen), kept.end());
        if (num_unseen_static > 0) AddUnseen(num_unseen_static, static_cast<int64_t>(placement.size()));
      }
    }
    if (kept.size() == placement.size() || kept.empty()) return;
    log_.AddNote(Point(), std::to_string(placement.size() - kept.size()) + " stray Gaussians removed");
    backend_->Keep(kept);
  }

  void AddUnseen(int64_t count, int64_t of) {
    cursor_.num_unseen_static += count;
    TrainDecision decision;
    decision.part = "unseen_background";
    decision.is_left_out = true;
    decision.measured = std::to_string(cursor_.num_unseen_static) + " so far, of them " +
                        FormatText("%.0f of %.0f at %.0f %% of the run", static_cast<double>(count),
                                   static_cast<double>(of), 100 * cursor_.progress);
    decision.threshold = FormatText("a weight of %.2g in some pixel of some photo, half a grey level",
                                    options_.unseen_static_weight);
    decision.reason = "no photo shows them";
    decision.saving = "their share of each iteration from then on";
    log_.AddDecision(Point(), decision);
  }

  LogPoint Point() const {
    LogPoint point;
    point.iteration = cursor_.iteration;
    point.progress = cursor_.progress;
    point.wall_seconds = cursor_.wall_seconds;
    point.cpu_seconds = cursor_.cpu_seconds;
    point.measuring_seconds = cursor_.measuring_seconds;
    point.count = backend_->Count();
    point.width = width_;
    point.height = height_;
    return point;
  }

  void Report(double before, double now) {
    const int64_t every = std::clamp<int64_t>(options_.num_iterations / 200, 1, 100);
    if (cursor_.iteration % every != 0 && now < 1) return;
    LogLoss();
    reporter_.Progress("train", std::min<int64_t>(cursor_.iteration, options_.num_iterations - 1),
                       options_.num_iterations);
    if (!Passed(before, now, kMessageEvery) && now < 1 && now - last_message_ < kMessageEvery) return;
    last_message_ = now;
    const double rate = static_cast<double>(cursor_.iteration) / std::max(cursor_.wall_seconds, 1e-9);
    std::string message = "iteration " + std::to_string(cursor_.iteration) + ", " +
                          FormatText("%.0f", 100 * now) + " %: loss " + FormatText("%.4f", last_loss_.total) +
                          ", " + std::to_string(backend_->Count()) + " Gaussians, " +
                          FormatText("%.3g", rate) + " iterations/s";
    if (now > 0 && now < 1) {
      message += ", " + Duration(cursor_.wall_seconds * (1 - now) / now) + " left";
    }
    if (held_out_) message += FormatText(", held-out %.2f dB", held_out_->psnr);
    reporter_.Info(message);
    if (not_finite_ > 0) {
      reporter_.Warn(std::to_string(not_finite_) +
                     " Gaussians with parameters that are no numbers were removed");
      not_finite_ = 0;
    }
  }

  void CheckFinite(const LossTerms& loss) {
    if (std::isfinite(loss.total)) {
      bad_reports_ = 0;
      return;
    }
    DensifyStep prune;  // removes what is not finite and nothing else
    prune.iteration = cursor_.iteration;
    prune.random_seed = cursor_.seed;
    prune.min_opacity = 0;
    prune.grow = false;
    not_finite_ += backend_->Densify(prune).not_finite;
    if (++bad_reports_ < kMaxBadReports) return;
    throw UserError(
        "training diverged at iteration " + std::to_string(cursor_.iteration) +
        ": the loss is not a number. Lower the learning rates or the weights of the loss, and look at "
        "the poses with `s2gs scan_evaluator`");
  }

  void Measure(double before, double now) {
    if (!has_held_out_ || options_.num_measurements < 1) return;
    bool is_due = now >= 1;
    const int steps = options_.num_measurements - 1;
    for (int i = 0; i < steps; ++i) {
      const double moment = std::pow(kFirstMeasurement, 1 - static_cast<double>(i) / steps);
      is_due = is_due || (before < moment && now >= moment);
    }
    if (!is_due) return;
    backend_->Wait();
    clock_.Lap();
    held_out_ = MeasureHeldOut(scene_, backend_);
    clock_.LapMeasuring();
    log_.AddHeldOut(Point(), *held_out_);
    log_.Write();
  }

  void SaveIfDue(double before, double now) {
    const bool stop = reporter_.StopRequested();
    if (files_.checkpoint.empty()) {
      if (stop) throw Interrupted();
      return;
    }
    const bool is_due = Passed(before, now, options_.checkpoint_every) && now < 1 &&
                        clock_.WallSeconds() - saved_at_ >= kWorthSaving;
    if (stop || is_due) Save();
    if (stop) throw Interrupted();
  }

  void Save() {
    clock_.Lap();
    WriteCheckpoint(files_.checkpoint, {cursor_, backend_->GetState()});
    saved_at_ = cursor_.wall_seconds;
    log_.Write();
    clock_.LapMeasuring();
  }

  TrainResult Finish() {
    TrainResult result;
    result.gaussians = backend_->GetGaussians();
    clock_.Lap();
    result.iterations = cursor_.iteration;
    result.wall_seconds = cursor_.wall_seconds;
    result.cpu_seconds = cursor_.cpu_seconds;
    result.measuring_seconds = cursor_.measuring_seconds;
    result.foreground_frozen = cursor_.foreground_frozen;
    result.held_out = held_out_;
    if (cursor_.foreground_frozen && UsesEvidence()) {
      if (!evidence_) TakeEvidence();
      if (const std::optional<SightShares> shares = MeasureSights(*evidence_, backend_)) {
        log_.AddSights(Point(), *shares);
      }
    }
    log_.Write();
    reporter_.Progress("train", options_.num_iterations, options_.num_iterations);
    return result;
  }

  const TrainingScene& scene_;
  const TrainOptions& options_;
  const TrainFiles& files_;
  Backend* backend_;
  Reporter& reporter_;
  TrainCursor cursor_;
  bool resumed_;
  TrainLog log_;
  PhotoOrder order_;
  Stopwatch clock_;
  double saved_at_ = 0;  // of the wall time of training
  bool has_held_out_ = false;
  int64_t num_held_out_ = 0;
  int max_sh_degree_ = 0;
  bool has_masks_ = false;
  int level_ = -1;
  int width_ = 0;
  int height_ = 0;
  std::vector<PinholeView> training_views_;
  std::optional<HeldOutErrors> held_out_;
  std::optional<TurnEvidence> evidence_;  // taken, or made, when it is first asked.
  std::future<TurnEvidence> evidence_to_come_;
  int64_t not_finite_ = 0;
  int bad_reports_ = 0;
  double last_message_ = 0;
  bool draws_part_ = false;  // the steps since the last line of losses draw the rotating part alone
  bool has_loss_ = false;    // there are such steps
  LossTerms last_loss_;
};

}  // namespace

std::vector<TrainingPhoto> PhotosAtLevel(const TrainingScene& scene, int level, int min_size) {
  std::vector<const ScenePhoto*> trained;
  for (const ScenePhoto& photo : scene.photos) {
    if (!photo.held_out) trained.push_back(&photo);
  }
  std::vector<TrainingPhoto> photos(trained.size());
  ParallelFor(static_cast<int64_t>(trained.size()), 0, [&](int64_t i) {
    const ScenePhoto& photo = *trained[static_cast<size_t>(i)];
    int own_level = level;
    while (own_level > 0 && std::max(photo.view.width, photo.view.height) >> own_level < min_size)
      --own_level;
    const int width = std::max(1, photo.view.width >> own_level);
    const int height = std::max(1, photo.view.height >> own_level);
    TrainingPhoto& reduced = photos[static_cast<size_t>(i)];
    reduced.view = ResizeView(photo.view, width, height);
    reduced.image = ResizeByArea(photo.image, width, height);
    if (photo.mask.empty()) return;
    const Image8 mask{photo.view.width, photo.view.height, 1, photo.mask};
    reduced.mask = ResizeByArea(mask, width, height).pixels;
    for (uint8_t& value : reduced.mask) value = value > 127 ? 255 : 0;
  });
  return photos;
}

TrainResult Train(const TrainingScene& scene, const TrainOptions& options, uint64_t seed,
                  const TrainFiles& files, Backend* backend, Reporter& reporter) {
  return Trainer(scene, options, seed, files, backend, reporter).Run();
}

}  // namespace s2gs
