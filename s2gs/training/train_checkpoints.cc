#include "s2gs/training/train_checkpoints.h"

#include <optional>
#include <string>
#include <system_error>

#include "s2gs/initialise.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// Less is done again sooner than several copies of a large model are written.
constexpr double kWorthSaving = 30;  // [s] of training

// Nothing when the file is damaged: then it lies beside itself under another name.
std::optional<Checkpoint> ReadOrSetAside(const std::filesystem::path& path, Reporter& reporter) {
  try {
    return ReadCheckpoint(path);
  } catch (const UserError& error) {
    std::filesystem::path aside = path;
    aside += ".damaged";
    std::error_code ec;
    std::filesystem::rename(path, aside, ec);
    reporter.Warn(
        std::string("the checkpoint cannot be read: ") + error.what() + ". " +
        (ec ? "Training starts anew" : "It is now " + aside.filename().string() + "; training starts anew"));
  }
  return std::nullopt;
}

}  // namespace

TrainStart StartOrResume(const TrainingScene& scene, const TrainOptions& options, uint64_t seed,
                         const TrainFiles& files, Backend* backend, Reporter& reporter) {
  std::error_code ec;
  if (files.resume && !files.checkpoint.empty() && std::filesystem::exists(files.checkpoint, ec)) {
    const std::optional<Checkpoint> checkpoint = ReadOrSetAside(files.checkpoint, reporter);
    if (checkpoint && checkpoint->cursor.settings == files.settings && checkpoint->cursor.seed == seed) {
      backend->SetState(checkpoint->state);
      reporter.Info("going on after iteration " + std::to_string(checkpoint->cursor.iteration) + " from " +
                    files.checkpoint.string());
      return {checkpoint->cursor, true};
    }
    if (checkpoint) {
      reporter.Warn(files.checkpoint.string() +
                    " was made with other options or photos: training starts anew");
    }
  }
  TrainStart start;
  TrainState state;
  state.gaussians = InitialiseGaussians(scene, options.initial, seed, reporter);
  start.cursor.seed = seed;
  start.cursor.initial_count = static_cast<int64_t>(state.gaussians.size());
  start.cursor.settings = files.settings;
  backend->SetState(state);
  return start;
}

void TrainCheckpoints::SaveIfDue(double before, double now) {
  const bool stop = run_.reporter.StopRequested();
  if (files_.checkpoint.empty()) {
    if (stop) throw Interrupted();
    return;
  }
  const bool is_due = Passed(before, now, run_.options.checkpoint_every) && now < 1 &&
                      run_.clock.WallSeconds() - saved_at_ >= kWorthSaving;
  if (stop || is_due) Save();
  if (stop) throw Interrupted();
}

void TrainCheckpoints::Save() {
  run_.clock.Lap();
  WriteCheckpoint(files_.checkpoint, {run_.cursor, run_.backend->GetState()});
  saved_at_ = run_.cursor.wall_seconds;
  run_.log.Write();
  run_.clock.LapMeasuring();
}

}  // namespace s2gs
