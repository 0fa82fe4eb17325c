// What training asks of its backend, and when: a backend that computes nothing and notes what it is told.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "s2gs/freeze.h"
#include "s2gs/kernel/foreground.h"
#include "s2gs/training/train.h"
#include "tests/support/random_numbers.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr int64_t kIterations = 200;
constexpr int kPhotos = 7;
constexpr int kSide = 64;  // [px]
constexpr uint64_t kSeed = 5;

// By the iteration that was the last one when it was told.
template <typename T>
struct Told {
  int64_t after = 0;
  T what;
};

class NotingBackend : public Backend {
 public:
  BackendInfo Info() const override { return {}; }
  void SetPhotos(std::vector<TrainingPhoto> photos) override {
    sizes.push_back({after(), photos.front().view.width});
    num_photos = photos.size();
  }
  void SetState(const TrainState& state) override { state_ = state; }
  TrainState GetState() const override { return state_; }
  Gaussians GetGaussians() const override { return state_.gaussians; }
  int64_t Count() const override { return static_cast<int64_t>(state_.gaussians.size()); }
  Placement GetPlacement() const override {
    Placement placement = Backend::GetPlacement();
    for (const auto& [i, logit] : logits) placement.foreground_logit[i] = logit;
    return placement;
  }
  void Keep(const std::vector<uint32_t>& indices) override {
    keeps.push_back({after(), indices});
    Backend::Keep(indices);
  }
  void SetForegroundLogits(const std::vector<float>& values) override {
    told_logits.push_back({after(), values});
    logits.clear();
    Backend::SetForegroundLogits(values);
  }
  RenderedView Render(const RenderRequest& /*request*/) override { return {}; }
  void Step(const TrainStep& step) override { steps.push_back(step); }
  LossTerms TakeLoss() override {
    LossTerms loss;
    loss.steps = 1;
    loss.total = std::count(bad_losses.begin(), bad_losses.end(), after()) > 0
                     ? std::numeric_limits<double>::quiet_NaN()
                     : 0.5;
    return loss;
  }
  DensifyResult Densify(const DensifyStep& step) override {
    densified.push_back({after(), step});
    DensifyResult result;
    result.count = Count();
    result.not_finite = step.grow ? 0 : 2;
    return result;
  }
  void ResetOpacity(float max_opacity) override { resets.push_back({after(), max_opacity}); }
  std::vector<float> PeakWeights(const std::vector<PinholeView>& views, SceneBodies /*bodies*/,
                                 DrawnBody /*drawn*/) override {
    looks.push_back({after(), views.size()});
    std::vector<float> peak(state_.gaussians.size(), 1);
    for (const auto& [i, weight] : peaks) peak[i] = weight;
    peaks.clear();
    return peak;
  }
  void RefreshNeighbours(int k) override { neighbours.push_back({after(), k}); }

  // What it answers.
  std::vector<std::pair<size_t, float>> logits;  // of Gaussians, until they are replaced
  std::vector<std::pair<size_t, float>> peaks;   // once
  std::vector<int64_t> bad_losses;               // iterations
  // What it was told.
  size_t num_photos = 0;
  std::vector<TrainStep> steps;
  std::vector<Told<int>> sizes;
  std::vector<Told<std::vector<uint32_t>>> keeps;
  std::vector<Told<std::vector<float>>> told_logits;
  std::vector<Told<DensifyStep>> densified;
  std::vector<Told<float>> resets;
  std::vector<Told<size_t>> looks;
  std::vector<Told<int>> neighbours;

 private:
  int64_t after() const { return static_cast<int64_t>(steps.size()); }

  TrainState state_;
};

template <typename T>
std::vector<int64_t> MomentsOf(const std::vector<Told<T>>& told) {
  std::vector<int64_t> moments;
  for (const Told<T>& one : told) moments.push_back(one.after);
  return moments;
}

TrainingScene Scene(TrainMode mode) {
  TrainingScene scene;
  scene.mode = mode;
  scene.axis = TurntableAxis();
  RandomNumbers random(1);
  for (int i = 0; i < kPhotos; ++i) {
    ScenePhoto photo;
    photo.name = std::to_string(i) + ".png";
    photo.view.width = kSide;
    photo.view.height = kSide / 2;
    photo.view.fx = photo.view.fy = kSide;
    photo.view.cx = kSide / 2.0;
    photo.view.cy = kSide / 4.0;
    photo.view.cam_from_world.translation = photo.view.cam_from_object.translation = {0.1 * i, 0, 3};
    photo.image = {kSide, kSide / 2, 3, std::vector<uint8_t>(size_t{3} * kSide * kSide / 2, 99)};
    if (mode == TrainMode::kMasks) photo.mask.assign(size_t{kSide} * kSide / 2, 255);
    scene.photos.push_back(photo);
  }
  for (int i = 0; i < 60; ++i) {
    scene.points.push_back(
        {random.Direction() * 0.5, {100, 100, 100}, i % 2 == 0 && mode != TrainMode::kStatic});
  }
  return scene;
}

TrainOptions Options() {
  TrainOptions options;
  options.num_iterations = kIterations;
  options.initial.min_points = 10;
  options.only_told_bands = false;
  options.use_turn_evidence = false;
  options.use_rotating_region = false;
  options.min_coarse_size = 16;
  options.coarse_levels = 2;
  options.coarse_until = 0.2;
  options.regularise_from = 0.15;
  options.neighbours_every = 0.05;
  options.densify_from = 0.1;
  options.densify_until = 0.5;
  options.densify_every = 7;
  options.opacity_reset_every = 0.1;
  options.settle_from = 0.4;
  options.settle_until = 0.6;
  options.max_normalised_scale = 0.7;
  options.unseen_weight = options.unseen_static_weight = 0;
  return options;
}

class Messages : public Reporter {
 public:
  void Log(LogLevel level, std::string_view message) override {
    (level == LogLevel::kWarning ? warnings : infos) += std::string(message) + "\n";
  }
  std::string infos, warnings;
};

TrainResult TrainWith(const TrainingScene& scene, const TrainOptions& options, NotingBackend* backend) {
  Reporter silent;
  return Train(scene, options, kSeed, {}, backend, silent);
}

TEST(TrainCourse, EachIterationHasThePhotoTheRatesAndTheWeightsOfItsMoment) {
  const TrainOptions options = Options();
  NotingBackend backend;
  const TrainResult result = TrainWith(Scene(TrainMode::kS2gs), options, &backend);
  EXPECT_EQ(result.iterations, kIterations);
  ASSERT_EQ(backend.steps.size(), static_cast<size_t>(kIterations));
  std::vector<std::vector<int>> rounds;
  for (int64_t i = 1; i <= kIterations; ++i) {
    const TrainStep& step = backend.steps[static_cast<size_t>(i - 1)];
    const double before = static_cast<double>(i - 1) / kIterations;
    const bool is_frozen = i > 120;  // p never settles: at .6 its time is up
    const TrainMoment moment = MomentAt(options, before, SceneBodies::kBoth, is_frozen, false);
    EXPECT_EQ(step.iteration, i);
    EXPECT_EQ(step.bodies, SceneBodies::kBoth);
    EXPECT_EQ(step.freeze_foreground, is_frozen) << i;
    EXPECT_EQ(step.sh_degree, moment.sh_degree);
    EXPECT_FLOAT_EQ(step.rates.centre, moment.rates.centre);
    EXPECT_EQ(step.rates.foreground, moment.rates.foreground);
    EXPECT_EQ(step.weights.normal, moment.weights.normal);
    EXPECT_EQ(step.weights.entropy_3d, moment.weights.entropy_3d) << i;
    EXPECT_EQ(step.collect_statistics, i > 20 && i <= 100) << i;
    EXPECT_FALSE(step.only_rotating_tiles);
    EXPECT_FALSE(step.cut_out_mask);
    if ((i - 1) % kPhotos == 0) rounds.emplace_back();
    rounds.back().push_back(step.photo);
  }
  // All photos in each round, in orders of their own.
  std::set<std::vector<int>> orders;
  for (const std::vector<int>& round : rounds) {
    orders.insert(round);
    EXPECT_EQ(std::set<int>(round.begin(), round.end()).size(), round.size());
  }
  EXPECT_GT(orders.size(), rounds.size() - 3);
  // An eighth of each photo's turns at each place of a round, but for chance (28 rounds of 7).
  int first_is_first = 0;
  for (const std::vector<int>& round : rounds) first_is_first += round[0] == 0 ? 1 : 0;
  EXPECT_LT(first_is_first, 12);
  EXPECT_GT(first_is_first, 0);
}

TEST(TrainCourse, WhatHappensNowAndThenHappensAtItsMoments) {
  NotingBackend backend;
  TrainWith(Scene(TrainMode::kS2gs), Options(), &backend);
  EXPECT_EQ(backend.num_photos, static_cast<size_t>(kPhotos));
  // At a quarter, half and all of the size, each for a tenth of the run.
  ASSERT_THAT(MomentsOf(backend.sizes), ElementsAre(0, 20, 40));
  EXPECT_EQ(backend.sizes[0].what, 16);
  EXPECT_EQ(backend.sizes[1].what, 32);
  EXPECT_EQ(backend.sizes[2].what, 64);
  // From .1 to .5 each seventh iteration.
  EXPECT_THAT(MomentsOf(backend.densified), ElementsAre(21, 28, 35, 42, 49, 56, 63, 70, 77, 84, 91, 98));
  // Opacities are reset each tenth while the model grows, and faint ones stay until all photos had their say.
  EXPECT_THAT(MomentsOf(backend.resets), ElementsAre(40, 60, 80));
  for (const auto& reset : backend.resets) EXPECT_FLOAT_EQ(reset.what, 0.01F);
  for (const auto& [iteration, step] : backend.densified) {
    EXPECT_EQ(step.iteration, iteration);
    EXPECT_EQ(step.random_seed, kSeed);
    EXPECT_FLOAT_EQ(step.max_clone_scale, 0.01F);
    EXPECT_FLOAT_EQ(step.max_scale, 0.7F);
    EXPECT_FLOAT_EQ(step.min_gradient, 2e-4F);
    EXPECT_EQ(step.max_count, 2'000'000);
    EXPECT_TRUE(step.grow);
    EXPECT_FLOAT_EQ(step.min_opacity, iteration > 40 ? 0.005F : 0.05F) << iteration;
  }
  // Neighbours each twentieth while p is regularised.
  EXPECT_THAT(MomentsOf(backend.neighbours), ElementsAre(30, 40, 50, 60, 70, 80, 90, 100, 110));
  for (const auto& found : backend.neighbours) EXPECT_EQ(found.what, 5);
  // p is frozen once; nothing else is looked at.
  ASSERT_THAT(MomentsOf(backend.told_logits), ElementsAre(120));
  for (const float logit : backend.told_logits[0].what) EXPECT_EQ(std::abs(logit), 10);
  EXPECT_THAT(backend.keeps, IsEmpty());
  EXPECT_THAT(backend.looks, IsEmpty());
}

// Two rounds through the photos after a reset, where these are more than a hundred iterations.
TEST(TrainCourse, FaintOnesGoAgainWhenAllPhotosHadTheirSay) {
  TrainOptions options = Options();
  options.num_iterations = 400;
  options.densify_until = 0.9;
  options.opacity_reset_every = 0.3;  // at 120 and 240
  options.settle_from = options.settle_until = 0.95;
  NotingBackend backend;
  TrainWith(Scene(TrainMode::kS2gs), options, &backend);
  EXPECT_THAT(MomentsOf(backend.resets), ElementsAre(120, 240));
  for (const auto& [iteration, step] : backend.densified) {
    const bool recovers = (iteration > 120 && iteration < 220) || (iteration > 240 && iteration < 340);
    EXPECT_FLOAT_EQ(step.min_opacity, recovers ? 0.005F : 0.05F) << iteration;
  }
  EXPECT_GT(backend.densified.back().after, 340);
}

TEST(TrainCourse, ABudgetIsReachedAfterFourFifthsOfTheGrowth) {
  TrainOptions options = Options();
  options.growth = GrowthStrategy::kBudget;
  options.max_gaussians = 1000;
  NotingBackend backend;
  TrainWith(Scene(TrainMode::kS2gs), options, &backend);
  const auto first = static_cast<double>(backend.Count());
  for (const auto& [iteration, step] : backend.densified) {
    const double share = std::min(1.0, (static_cast<double>(iteration) / kIterations - 0.1) / 0.32);
    EXPECT_NEAR(static_cast<double>(step.max_count), first + share * (1000 - first), 1) << iteration;
    EXPECT_EQ(step.min_gradient, 0);
  }
}

// p settles: frozen at the first look, each hundredth of the run from .4 on.
TEST(TrainCourse, PIsFrozenOnceItHasSettled) {
  for (const double needed : {0.89, 0.95}) {
    TrainOptions options = Options();
    options.settled_share = needed;
    NotingBackend backend;
    // Nine of ten have settled: p beyond .9 either way.
    for (size_t i = 0; i < 60; ++i)
      backend.logits.emplace_back(i, i % 10 == 3 ? 2.1F : i % 2 == 0 ? 2.3F : -2.3F);
    Messages messages;
    Train(Scene(TrainMode::kS2gs), options, kSeed, {}, &backend, messages);
    ASSERT_THAT(MomentsOf(backend.told_logits), ElementsAre(needed < 0.9 ? 80 : 120));
    for (size_t i = 0; i < 60; ++i) {
      const bool rotates = i % 10 == 3 || i % 2 == 0;
      EXPECT_EQ(backend.told_logits[0].what[i], rotates ? 10 : -10) << i;
    }
    EXPECT_THAT(messages.infos, HasSubstr("p is frozen: 90.00 % of it was outside [.1, .9]; 0 Gaussians"));
  }
}

TEST(TrainCourse, NothingRotatesOutsideTheRegion) {
  TrainingScene scene = Scene(TrainMode::kS2gs);
  scene.region = RotatingRegion{TurntableAxis(), 0.45, -0.3, 0.6};
  TrainOptions options = Options();
  options.use_rotating_region = true;
  options.regularise_from = 0.2;
  NotingBackend backend;
  const auto rotate_all = [&] {
    for (size_t i = 0; i < 60; ++i) backend.logits.emplace_back(i, 5.0F);
  };
  rotate_all();
  TrainWith(scene, options, &backend);
  std::vector<bool> is_inside;
  for (const ScenePoint& point : scene.points) is_inside.push_back(scene.region->Contains(point.x, 0.01));
  const auto num_outside = std::count(is_inside.begin(), is_inside.end(), false);
  ASSERT_GT(num_outside, 5);
  ASSERT_LT(num_outside, 55);
  // At .2, the tenth with which regularisation begins, p of those is told to be unknown, which the model then
  // has: too few have settled, and at .6 p's time is up.
  ASSERT_THAT(MomentsOf(backend.told_logits), ElementsAre(40, 120));
  for (size_t i = 0; i < 60; ++i) {
    EXPECT_EQ(backend.told_logits[0].what[i], is_inside[i] ? 5.0F : 0.0F) << i;
    EXPECT_EQ(backend.told_logits[1].what[i], is_inside[i] ? 10.0F : -10.0F) << i;
  }
  ASSERT_THAT(MomentsOf(backend.keeps), ElementsAre(120));
  EXPECT_EQ(backend.keeps[0].what.size(), 60U);
}

// From the frozen p on, each tenth of the run up to .95: what no photo shows goes.
TEST(TrainCourse, WhatNoPhotoShowsGoes) {
  TrainOptions options = Options();
  options.unseen_weight = 1.0 / 64;
  options.unseen_static_weight = 1.0 / 512;
  NotingBackend backend;
  for (size_t i = 0; i < 60; ++i) backend.logits.emplace_back(i, i < 30 ? 5.0F : -5.0F);
  backend.peaks = {{3, 0.015F}, {4, 1.0F / 64}, {5, 0.001F}, {40, 0.0019F}, {41, 1.0F / 512}, {42, 0.015F}};
  const TemporaryFolder folder;
  TrainFiles files;
  files.log = folder / "log.jsonl";
  Reporter silent;
  Train(Scene(TrainMode::kS2gs), options, kSeed, files, &backend, silent);
  EXPECT_THAT(MomentsOf(backend.told_logits), ElementsAre(80));  // settled
  EXPECT_THAT(MomentsOf(backend.looks), ElementsAre(100, 120, 140, 160, 180));
  for (const auto& look : backend.looks) EXPECT_EQ(look.what, static_cast<size_t>(kPhotos));
  ASSERT_THAT(MomentsOf(backend.keeps), ElementsAre(100));
  std::vector<uint32_t> kept;
  for (uint32_t i = 0; i < 60; ++i) {
    if (i != 3 && i != 5 && i != 40) kept.push_back(i);
  }
  EXPECT_EQ(backend.keeps[0].what, kept);
  const std::string log = folder.Read("log.jsonl");
  EXPECT_THAT(log, HasSubstr("3 stray Gaussians removed"));
  EXPECT_THAT(log, HasSubstr("1 so far, of them 1 of 60 at 50 % of the run"));
}

TEST(TrainCourse, WholeFramesInOneOfSoManyRounds) {
  TrainOptions options = Options();
  options.whole_every = 3;
  NotingBackend backend;
  TrainWith(Scene(TrainMode::kS2gs), options, &backend);
  for (int64_t i = 1; i <= kIterations; ++i) {
    const bool draws_part = i > 120 && (i - 1) / kPhotos % 3 != 0;
    EXPECT_EQ(backend.steps[static_cast<size_t>(i - 1)].only_rotating_tiles, draws_part) << i;
  }
}

// With masks the background has another colour each time, without a table nothing rotates.
TEST(TrainCourse, OtherModesHaveOneBody) {
  for (const TrainMode mode : {TrainMode::kMasks, TrainMode::kStatic}) {
    NotingBackend backend;
    TrainWith(Scene(mode), Options(), &backend);
    EXPECT_THAT(backend.told_logits, IsEmpty());
    EXPECT_THAT(backend.neighbours, IsEmpty());
    std::set<float> colors;
    for (const TrainStep& step : backend.steps) {
      EXPECT_EQ(step.bodies, mode == TrainMode::kMasks ? SceneBodies::kObjectOnly : SceneBodies::kStaticOnly);
      EXPECT_EQ(step.cut_out_mask, mode == TrainMode::kMasks);
      EXPECT_FALSE(step.freeze_foreground);
      for (const float value : step.background_color) {
        EXPECT_GE(value, 0);
        EXPECT_LT(value, 1);
        colors.insert(value);
      }
    }
    EXPECT_EQ(colors.size() > 500, mode == TrainMode::kMasks);
    EXPECT_EQ(colors.size() == 1, mode == TrainMode::kStatic);
  }
}

TEST(TrainCourse, ThreeLossesInARowThatAreNoNumbersEndIt) {
  NotingBackend backend;
  backend.bad_losses = {50, 51, 60, 61};  // never three in a row
  Messages messages;
  TrainOptions options = Options();
  options.densify_until = options.densify_from;  // nothing else is removed
  EXPECT_EQ(Train(Scene(TrainMode::kS2gs), options, kSeed, {}, &backend, messages).iterations, kIterations);
  ASSERT_THAT(MomentsOf(backend.densified), ElementsAre(50, 51, 60, 61));
  for (const auto& prune : backend.densified) {
    EXPECT_FALSE(prune.what.grow);
    EXPECT_EQ(prune.what.min_opacity, 0);
    EXPECT_EQ(prune.what.iteration, prune.after);
    EXPECT_EQ(prune.what.random_seed, kSeed);
  }
  EXPECT_THAT(messages.warnings, HasSubstr("Gaussians with parameters that are no numbers were removed"));
  NotingBackend diverging;
  diverging.bad_losses = {7, 8, 9};
  try {
    TrainWith(Scene(TrainMode::kS2gs), options, &diverging);
    FAIL();
  } catch (const UserError& error) {
    EXPECT_THAT(error.what(), HasSubstr("training diverged at iteration 9"));
  }
}

}  // namespace
}  // namespace s2gs
