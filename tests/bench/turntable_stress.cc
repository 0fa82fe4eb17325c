// Success rates and errors of the aligned, mended and jointly adjusted turntable over synthetic scenes that
// get harder in one respect at a time. No SfM runs: its result is the exact models with errors, missing and
// wrong poses.
//
//   turntable_stress [SEEDS] [THREADS] [--cells TEXT...]
//
// prints a Markdown table of all cells (angles' errors that are within two of their standard deviations, and
// how many runs were called good, and of these how many have a place that is wrong by more than a degree,
// beside the errors), or of those whose names contain one of the texts, each row as soon as it is done, and
// runs that failed on stderr.

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "sfm_split/evidence/scan_evidence.h"
#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/relocalise/station_turns.h"
#include "sfm_split/scene/pose_error.h"
#include "sfm_split/single_axis/single_axis_scene.h"
#include "sfm_split/turntable/align_scene.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {
namespace {

struct Cell {
  std::string name;
  std::function<void(SyntheticTurntableOptions*)> change;
  double focal_factor = 1;  // what SfM believes, over the truth
};

struct Outcome {
  bool success = false;
  int images = 0;
  int all_images = 0;
  JointModel model = JointModel::kSharedStations;
  double sigma_px = 0;
  double angle_median_deg = 0;
  double angle_max_deg = 0;
  double rotation_median_deg = 0;
  double rotation_max_deg = 0;
  int with_sigma = 0;     // images whose table angle has a standard deviation
  int within_sigmas = 0;  // of these, errors within two of them
  Verdict verdict = Verdict::kFailed;
  bool is_wrong = false;  // a place is wrong by more than a degree, whether or not all images are there
};

// A run succeeds when every image is there and no table angle is wrong by more.
constexpr double kMaxAngleErrorDeg = 1;

SyntheticTurntableOptions Baseline() {
  SyntheticTurntableOptions options;
  options.stations = 3;
  options.steps = 10;
  options.step_deg = 36;
  options.num_object_points = 220;
  options.num_platter_points = 80;
  options.num_background_points = 250;
  options.max_view_change_deg = 60;
  options.match_recall = 0.7;
  options.pixel_noise = 0.5;
  options.outlier_share = 0.1;
  return options;
}

std::vector<Cell> Cells() {
  std::vector<Cell> cells;
  cells.push_back({"baseline", [](SyntheticTurntableOptions*) {}});
  const auto add = [&](const std::string& name, std::function<void(SyntheticTurntableOptions*)> change,
                       double focal_factor = 1) {
    cells.push_back({name, std::move(change), focal_factor});
  };
  char text[64];
  const auto label = [&](const char* format, double value) {
    std::snprintf(text, sizeof(text), format, value);
    return std::string(text);
  };
  for (const double noise : {0.3, 1.0, 3.0}) {
    add(label("pixel noise %.1f", noise), [=](auto* o) { o->pixel_noise = noise; });
  }
  for (const double outliers : {0.3, 0.45, 0.6}) {
    add(label("outliers %.0f %%", 100 * outliers), [=](auto* o) { o->outlier_share = outliers; });
  }
  for (const double share : {0.05, 0.2, 0.8}) {
    add(label("object's share %.0f %%", 100 * share), [=](auto* o) {
      o->rotating_share = share;
      if (share < 0.2) o->num_background_points = 1500;
    });
  }
  for (const int stations : {1, 2, 6}) {
    add(label("stations %.0f", stations), [=](auto* o) { o->stations = stations; });
  }
  for (const int steps : {3, 6, 36, 72}) {
    add(label("steps %.0f", steps), [=](auto* o) {
      o->steps = steps;
      o->step_deg = steps == 3 ? 20 : 360.0 / steps;
      if (steps > 20) {
        // Few pairs, for the time it takes; but both stations have to see the same.
        o->stations = 2;
        o->min_elevation_deg = 25;
        o->max_elevation_deg = 40;
        o->max_view_change_deg = 25;
      }
    });
  }
  for (const double step : {2.0, 10.0, 60.0, 120.0}) {
    add(label("step %.0f deg", step), [=](auto* o) {
      o->step_deg = step;
      o->steps = step > 100 ? 3 : step > 50 ? 6 : 10;
      if (step > 50) o->max_view_change_deg = 100;
    });
  }
  for (const double tilt : {10.0, 30.0}) {
    add(label("table tilt %.0f deg", tilt), [=](auto* o) { o->table_tilt_deg = tilt; });
  }
  for (const double shake : {0.01, 0.05, 0.2}) {
    add(label("shake %.2f deg", shake), [=](auto* o) { o->shake_deg = shake; });
  }
  for (const double roll : {30.0, 90.0}) {
    add(label("camera roll %.0f deg", roll), [=](auto* o) { o->roll_deg = roll; });
  }
  for (const double focal : {0.5, 2.5, 5.0}) {
    add(label("focal %.1f widths", focal), [=](auto* o) {
      o->focal_widths = focal;
      o->distance = 0.7 * std::max(0.6, focal / 1.2);
    });
    add(
        label("focal %.1f widths, 5 %% wrong", focal),
        [=](auto* o) {
          o->focal_widths = focal;
          o->has_prior_focal = false;
          o->distance = 0.7 * std::max(0.6, focal / 1.2);
        },
        1.05);
  }
  for (const double k : {-0.1, 0.1}) {
    add(label("radial distortion %+.1f", k), [=](auto* o) {
      o->camera_model = CameraModelId::kSimpleRadial;
      o->distortion = {k};
    });
  }
  return cells;
}

double Median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// Errors of the table's angles against the reference's, in their standard deviations. The sense of the axis
// is that of the truth or the other one.
void CountWithinSigmas(const TurntableScene& scene, const std::map<std::string, const View*>& truth_of,
                       const std::vector<double>& sigmas, Outcome* outcome) {
  if (sigmas.size() != scene.views.size()) return;
  const View* reference = scene.Reference();
  if (reference == nullptr) return;
  const double zero = truth_of.at(reference->name)->angle_deg;
  int best = -1;
  for (const double sense : {1.0, -1.0}) {
    int all = 0;
    int within = 0;
    for (size_t i = 0; i < scene.views.size(); ++i) {
      if (!(sigmas[i] > 0) || !std::isfinite(sigmas[i])) continue;
      const View& view = scene.views[i];
      const double error =
          std::remainder(sense * view.angle_deg - (truth_of.at(view.name)->angle_deg - zero), 360.0);
      ++all;
      within += std::abs(error) <= 2 * sigmas[i] ? 1 : 0;
    }
    if (within <= best) continue;
    best = within;
    outcome->with_sigma = all;
    outcome->within_sigmas = within;
  }
}

Outcome Run(const Cell& cell, uint64_t seed, bool single_axis) {
  SyntheticTurntableOptions options = Baseline();
  options.seed = seed;
  cell.change(&options);
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  ScanFeatures features = SyntheticScanFeatures(turntable);
  ColmapModel object =
      SyntheticObjectModel(turntable, {3, Eigen::Quaterniond(0.5, 0.5, 0.5, 0.5), {1, 2, 3}});
  ColmapModel background = SyntheticStaticModel(turntable);
  // What is not told is guessed: no distortion, and a focal length that SfM left a little wrong.
  for (ColmapModel* model : {&object, &background}) {
    for (auto& [id, camera] : model->cameras) {
      for (size_t k = InfoOf(camera.model).FirstExtraParam(); k < camera.params.size(); ++k)
        camera.params[k] *= 0.8;
    }
  }
  ModelFaults faults;
  faults.rotation_deg = 0.1 + 0.1 * options.pixel_noise;
  faults.centre_rel = 0.002 + 0.002 * options.pixel_noise;
  faults.point_rel = 0.001;
  faults.focal_factor = cell.focal_factor;
  DamageModel(faults, static_cast<uint32_t>(2 * seed), &background);
  faults.missing_share = 0.1;
  faults.wrong_share = 0.1;
  DamageModel(faults, static_cast<uint32_t>(2 * seed + 1), &object);
  // The background is mapped from the stations' first images.
  std::map<int, std::string> first;
  for (const View& view : turntable.scene.views) first.emplace(view.station, view.name);
  std::vector<std::string> others;
  for (const View& view : turntable.scene.views) {
    if (first.at(view.station) != view.name) others.push_back(view.name);
  }
  RemoveImages(others, &background);
  const bool has_background = options.stations > 1;

  Reporter reporter;
  JointOptions joint;
  joint.num_threads = 1;
  AlignedScene aligned;
  RefineReport refined;
  if (single_axis) {
    SingleAxisSolution solution;
    SingleAxisOptions axis_options;
    axis_options.num_directions = 120;
    axis_options.max_search_pairs = 30;
    aligned = SceneFromSingleAxis(features, has_background ? &background : nullptr, axis_options, reporter,
                                  &solution);
    if (solution.found) refined = RefineScan(features, nullptr, joint, {}, reporter, &aligned);
  } else {
    std::map<std::string, int> stations;
    for (const ScanImage& image : features.images) stations[image.name] = image.station;
    aligned = AlignScene(object, has_background ? &background : nullptr, stations);
    if (!aligned.scene.views.empty()) refined = RefineScan(features, &object, joint, {}, reporter, &aligned);
    if (has_background && aligned.scene.views.size() < turntable.scene.views.size()) {
      // As turntable_mapper does: without the background's reconstruction.
      AlignedScene alone = AlignScene(object, nullptr, stations);
      if (!alone.scene.views.empty()) {
        const RefineReport report = RefineScan(features, &object, joint, {}, reporter, &alone);
        if (alone.scene.views.size() > aligned.scene.views.size()) {
          aligned = std::move(alone);
          refined = report;
        }
      }
    }
  }

  MatchFindings matches;
  if (!aligned.scene.views.empty()) {
    features.raw_pairs = features.object_pairs;
    matches =
        AskMatches(features, PossibleObjectPairs(features, false), aligned, {}, reporter, &refined.joint);
  }
  Outcome outcome;
  outcome.images = static_cast<int>(aligned.scene.views.size());
  outcome.all_images = static_cast<int>(turntable.scene.views.size());
  outcome.model = refined.model;
  outcome.sigma_px = refined.joint.sigma_px;
  PoseMap estimate;
  PoseMap truth;
  std::map<std::string, const View*> truth_of;
  for (const View& view : turntable.scene.views) {
    truth[view.name] = view.CamFromObject();
    truth_of[view.name] = &view;
  }
  std::vector<Eigen::Quaterniond> estimated_turns;
  std::vector<Eigen::Quaterniond> true_turns;
  // Of each station apart where nothing ties the stations to each other.
  for (const View& view : aligned.scene.views) {
    estimate[view.name] = view.CamFromObject();
    estimated_turns.push_back(view.world_from_object.rotation);
    true_turns.push_back(truth_of.at(view.name)->world_from_object.rotation);
  }
  const std::vector<double> angles =
      TurntableAngleErrorsDeg(estimated_turns, true_turns, turntable.scene.axis.direction);
  const PoseErrors errors = ComparePoses(estimate, truth);
  outcome.angle_median_deg = Median(angles);
  outcome.rotation_median_deg = Median(errors.rotation_deg);
  for (const double error : angles) outcome.angle_max_deg = std::max(outcome.angle_max_deg, error);
  for (const double error : errors.rotation_deg) {
    outcome.rotation_max_deg = std::max(outcome.rotation_max_deg, error);
  }
  outcome.is_wrong = outcome.images == 0 || outcome.angle_max_deg > kMaxAngleErrorDeg ||
                     outcome.rotation_max_deg > kMaxAngleErrorDeg;
  CountWithinSigmas(aligned.scene, truth_of, refined.joint.angle_sigma_deg, &outcome);
  if (outcome.images > 0) {
    outcome.verdict = JudgeScan(GatherEvidence(features, aligned, refined.joint, refined.priors.turns,
                                               refined.held_back, matches, RefineOptions().max_error_px))
                          .verdict;
  }
  outcome.success = outcome.images == static_cast<int>(turntable.scene.views.size()) && !angles.empty() &&
                    outcome.angle_max_deg <= kMaxAngleErrorDeg;
  return outcome;
}

std::string Summary(const std::vector<Outcome>& outcomes) {
  int successes = 0;
  std::vector<double> angle_medians;
  std::vector<double> rotation_medians;
  double angle_max = 0;
  double rotation_max = 0;
  for (const Outcome& outcome : outcomes) {
    if (!outcome.success) continue;
    ++successes;
    angle_medians.push_back(outcome.angle_median_deg);
    rotation_medians.push_back(outcome.rotation_median_deg);
    angle_max = std::max(angle_max, outcome.angle_max_deg);
    rotation_max = std::max(rotation_max, outcome.rotation_max_deg);
  }
  int with_sigma = 0;
  int within_sigmas = 0;
  int good = 0;
  int good_of_wrong = 0;
  for (const Outcome& outcome : outcomes) {
    with_sigma += outcome.with_sigma;
    within_sigmas += outcome.within_sigmas;
    good += outcome.verdict == Verdict::kGood ? 1 : 0;
    good_of_wrong += outcome.verdict == Verdict::kGood && outcome.is_wrong ? 1 : 0;
  }
  char text[200];
  std::snprintf(text, sizeof(text), "%d of %zu | %.3f / %.2f | %.3f / %.2f | %.0f %% | %d, %d", successes,
                outcomes.size(), Median(angle_medians), angle_max, Median(rotation_medians), rotation_max,
                100.0 * within_sigmas / std::max(1, with_sigma), good, good_of_wrong);
  return text;
}

// The table, filled in by all threads and printed in the cells' order.
class Table {
 public:
  Table(std::vector<std::string> names, int seeds) : names_(std::move(names)), rows_(names_.size()) {
    for (Row& row : rows_) {
      for (std::vector<Outcome>& outcomes : row.outcomes) outcomes.resize(static_cast<size_t>(seeds));
      row.left = 2 * seeds;
    }
    std::printf(
        "| | free SfM: success | angle | rotation | within 2 sigma | good, of wrong ones | single axis: "
        "success | "
        "angle | rotation | within 2 sigma | good, of wrong ones |\n");
    std::printf("|---|---|---|---|---|---|---|---|---|---|---|\n");
    std::fflush(stdout);
  }

  void Add(size_t cell, int seed, bool single_axis, const Outcome& outcome) {
    const std::lock_guard<std::mutex> lock(mutex_);
    Row& row = rows_[cell];
    row.outcomes[single_axis ? 1 : 0][static_cast<size_t>(seed)] = outcome;
    --row.left;
    for (; next_ < rows_.size() && rows_[next_].left == 0; ++next_) Print(next_);
  }

 private:
  struct Row {
    std::array<std::vector<Outcome>, 2> outcomes;  // free SfM, single axis; by seed
    int left = 0;
  };

  void Print(size_t cell) const {
    const Row& row = rows_[cell];
    const char* name = names_[cell].c_str();
    for (const bool single_axis : {false, true}) {
      const std::vector<Outcome>& outcomes = row.outcomes[single_axis ? 1 : 0];
      for (size_t seed = 0; seed < outcomes.size(); ++seed) {
        const Outcome& run = outcomes[seed];
        if (run.success) continue;
        std::fprintf(
            stderr,
            "failed: %s, %s, seed %zu: %d of %d images, %s, sigma %.2f px, angle %.3f / %.2f, rotation "
            "%.3f / %.2f\n",
            name, single_axis ? "single axis" : "free SfM", seed + 1, run.images, run.all_images,
            JointModelName(run.model), run.sigma_px, run.angle_median_deg, run.angle_max_deg,
            run.rotation_median_deg, run.rotation_max_deg);
      }
    }
    std::printf("| %s | %s | %s |\n", name, Summary(row.outcomes[0]).c_str(),
                Summary(row.outcomes[1]).c_str());
    std::fflush(stdout);
  }

  std::vector<std::string> names_;
  std::vector<Row> rows_;
  size_t next_ = 0;
  std::mutex mutex_;
};

}  // namespace
}  // namespace s2gs

int main(int argc, char** argv) {
  std::vector<int> numbers;
  std::vector<std::string> wanted;
  bool are_cells = false;
  for (int k = 1; k < argc; ++k) {
    const std::string argument = argv[k];
    if (argument == "--cells") {
      are_cells = true;
    } else if (are_cells) {
      wanted.push_back(argument);
    } else {
      numbers.push_back(std::max(1, std::atoi(argv[k])));
    }
  }
  const int seeds = numbers.empty() ? 20 : numbers[0];
  const int threads = numbers.size() > 1 ? numbers[1] : 2;
  std::vector<s2gs::Cell> cells;
  std::vector<std::string> names;
  for (s2gs::Cell& cell : s2gs::Cells()) {
    const bool is_wanted = wanted.empty() || std::any_of(wanted.begin(), wanted.end(), [&](const auto& text) {
                             return cell.name.find(text) != std::string::npos;
                           });
    if (!is_wanted) continue;
    names.push_back(cell.name);
    cells.push_back(std::move(cell));
  }
  const size_t runs_of_cell = 2 * static_cast<size_t>(seeds);
  s2gs::Table table(std::move(names), seeds);
  std::atomic<size_t> next{0};
  std::vector<std::thread> workers;
  workers.reserve(static_cast<size_t>(threads));
  for (int t = 0; t < threads; ++t) {
    workers.emplace_back([&] {
      for (size_t k = next++; k < cells.size() * runs_of_cell; k = next++) {
        const size_t cell = k / runs_of_cell;
        const auto seed = static_cast<int>(k % runs_of_cell / 2);
        const bool single_axis = k % 2 == 1;
        table.Add(cell, seed, single_axis,
                  s2gs::Run(cells[cell], static_cast<uint64_t>(seed) + 1, single_axis));
      }
    });
  }
  for (std::thread& worker : workers) worker.join();
  return 0;
}
