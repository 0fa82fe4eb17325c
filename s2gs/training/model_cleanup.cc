#include "s2gs/training/model_cleanup.h"

#include <algorithm>
#include <numeric>
#include <string>
#include <utility>

#include "s2gs/freeze.h"
#include "sfm_split/base/format_text.h"

namespace s2gs {
namespace {

constexpr double kTidyEvery = 0.1;          // of the run: strays are looked for.
constexpr double kStandingEvery = 0.2;      // of the run: those before what photos show, which takes longer.
constexpr double kTidyUntil = 0.95;         // of the run: what goes later could not be made up for.
constexpr double kSettleCheckEvery = 0.01;  // of the run.
constexpr double kRegionMargin = 0.01;      // [scene sizes]

}  // namespace

ModelCleanup::ModelCleanup(TrainRun* run) : run_(*run) {
  // It depends on the photos alone, and a GPU leaves the cores idle.
  if (UsesEvidence() && run_.options.settle_until < 1 && run_.backend->Info().kind == BackendKind::kCuda) {
    evidence_to_come_ = std::async(std::launch::async, [&scene = run_.scene] { return TurnEvidence(scene); });
  }
}

bool ModelCleanup::UsesEvidence() const {
  return run_.options.use_turn_evidence && run_.scene.bodies() == SceneBodies::kBoth;
}

void ModelCleanup::TakeEvidence() {
  evidence_.emplace(evidence_to_come_.valid() ? evidence_to_come_.get() : TurnEvidence(run_.scene));
}

void ModelCleanup::FreezeIfDue(double before, double now) {
  const TrainOptions& options = run_.options;
  if (run_.scene.bodies() != SceneBodies::kBoth || run_.cursor.foreground_frozen) return;
  if (now < options.settle_from || options.settle_until >= 1) return;
  const bool is_last_chance = now >= options.settle_until;
  if (!is_last_chance && !Passed(before, now, kSettleCheckEvery)) return;
  Placement placement = run_.backend->GetPlacement();
  const double share = SettledShare(placement.foreground_logit);
  if (!is_last_chance && share < options.settled_share) return;
  Freeze(std::move(placement), share, now);
}

void ModelCleanup::Freeze(Placement placement, double share, double now) {
  const TrainOptions& options = run_.options;
  const auto count = static_cast<int64_t>(placement.size());
  FreezeForeground(&placement.foreground_logit);
  run_.backend->SetForegroundLogits(placement.foreground_logit);
  if (options.use_rotating_region && run_.scene.region) {
    run_.backend->Keep(KeepInsideRegion(placement, *run_.scene.region, kRegionMargin));
  }
  const int64_t dropped = count - run_.backend->Count();
  run_.cursor.foreground_frozen = true;
  RemoveStanding();
  const std::string note = "p is frozen: " + FormatText("%.2f", 100 * share) +
                           " % of it was outside [.1, .9]; " + std::to_string(dropped) +
                           " Gaussians that rotated outside the rotating part's region removed";
  run_.reporter.Info(note);
  run_.log.AddNote(run_.Point(), note);
  TrainDecision decision;
  decision.part = "learning_p";
  decision.is_left_out = true;
  decision.measured =
      FormatText("%.2f %% of p outside [.1, .9] at %.0f %% of the run", 100 * share, 100 * now);
  decision.threshold =
      FormatText("%.4g %%, or %.0f %% of the run", 100 * options.settled_share, 100 * options.settle_until);
  decision.reason = share < options.settled_share ? "its time was up" : "p has settled";
  decision.saving = FormatText("the map of p, its three terms and its gradient in %.0f %% of the iterations",
                               100 * (1 - now));
  run_.log.AddDecision(run_.Point(), decision);
}

// Rotating Gaussians where photos show the background, once p is frozen: others take their place.
void ModelCleanup::RemoveStanding() {
  if (!UsesEvidence()) return;
  if (!evidence_) {
    TakeEvidence();
    if (!evidence_->IsAvailable()) {
      run_.log.AddNote(
          run_.Point(),
          "no camera stood still for enough photos to show what stands behind the rotating part");
    }
  }
  const std::vector<uint32_t> standing = FindStandingGaussians(*evidence_, run_.backend);
  const int64_t count = run_.backend->Count();
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
  run_.backend->Keep(kept);
  const std::string note =
      std::to_string(standing.size()) + " rotating Gaussians removed where photos show the background";
  run_.reporter.Info(note);
  run_.log.AddNote(run_.Point(), note);
}

void ModelCleanup::TidyIfDue(const std::vector<PinholeView>& views, double before, double now) {
  if (!Passed(before, now, kTidyEvery) || now > kTidyUntil) return;
  const TrainingScene& scene = run_.scene;
  const TrainOptions& options = run_.options;
  const bool all_stand = scene.bodies() == SceneBodies::kStaticOnly;
  if (all_stand && !(options.unseen_static_weight > 0)) return;
  const bool has_region = !all_stand && options.use_rotating_region && scene.region.has_value();
  if (!run_.cursor.foreground_frozen && scene.bodies() == SceneBodies::kBoth) {
    if (!has_region || now < options.regularise_from) return;
    Placement placement = run_.backend->GetPlacement();
    if (DisownOutsideRegion(*scene.region, kRegionMargin, &placement) > 0) {
      run_.backend->SetForegroundLogits(placement.foreground_logit);
    }
    return;
  }
  if (now < options.densify_until - 1e-9) return;
  if (Passed(before, now, kStandingEvery)) RemoveStanding();
  const Placement placement = run_.backend->GetPlacement();
  std::vector<uint32_t> kept =
      has_region ? KeepInsideRegion(placement, *scene.region, kRegionMargin) : std::vector<uint32_t>();
  if (!has_region) {
    kept.resize(placement.size());
    std::iota(kept.begin(), kept.end(), 0U);
  }
  RemoveUnseen(views, placement, &kept);
  if (kept.size() == placement.size() || kept.empty()) return;
  run_.log.AddNote(run_.Point(), std::to_string(placement.size() - kept.size()) + " stray Gaussians removed");
  run_.backend->Keep(kept);
}

void ModelCleanup::RemoveUnseen(const std::vector<PinholeView>& views, const Placement& placement,
                                std::vector<uint32_t>* kept) {
  const TrainOptions& options = run_.options;
  if (!(options.unseen_weight > 0 || options.unseen_static_weight > 0)) return;
  const SceneBodies bodies = run_.scene.bodies();
  const std::vector<float> peak = run_.backend->PeakWeights(views, bodies, DrawnBody::kAll);
  if (peak.empty()) return;
  int64_t num_unseen_static = 0;
  const auto is_unseen = [&](uint32_t i) {
    const bool rotates = bodies != SceneBodies::kStaticOnly && placement.foreground_logit[i] > 0;
    const bool goes = peak[i] < (rotates ? options.unseen_weight : options.unseen_static_weight);
    num_unseen_static += goes && !rotates ? 1 : 0;
    return goes;
  };
  kept->erase(std::remove_if(kept->begin(), kept->end(), is_unseen), kept->end());
  if (num_unseen_static > 0) LogUnseen(num_unseen_static, static_cast<int64_t>(placement.size()));
}

void ModelCleanup::LogUnseen(int64_t count, int64_t of) {
  run_.cursor.num_unseen_static += count;
  TrainDecision decision;
  decision.part = "unseen_background";
  decision.is_left_out = true;
  decision.measured = std::to_string(run_.cursor.num_unseen_static) + " so far, of them " +
                      FormatText("%.0f of %.0f at %.0f %% of the run", static_cast<double>(count),
                                 static_cast<double>(of), 100 * run_.cursor.progress);
  decision.threshold = FormatText("a weight of %.2g in some pixel of some photo, half a grey level",
                                  run_.options.unseen_static_weight);
  decision.reason = "no photo shows them";
  decision.saving = "their share of each iteration from then on";
  run_.log.AddDecision(run_.Point(), decision);
}

void ModelCleanup::LogSights() {
  if (!run_.cursor.foreground_frozen || !UsesEvidence()) return;
  if (!evidence_) TakeEvidence();
  if (const std::optional<SightShares> shares = MeasureSights(*evidence_, run_.backend)) {
    run_.log.AddSights(run_.Point(), *shares);
  }
}

}  // namespace s2gs
