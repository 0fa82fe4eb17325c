#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "s2gs/scene/training_scene.h"
#include "tests/s2gs/backend/backend_fixture.h"
#include "tests/s2gs/backend/reference_render.h"
#include "tests/s2gs/usual_step.h"
#include "tests/support/measured_bound.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

struct LossCase {
  const char* name;
  LossWeights weights;
  SceneBodies bodies;
  bool freeze, cut_out;
};

std::vector<LossCase> LossCases() {
  LossWeights l1, colors, all;
  colors.dssim = all.dssim = 0.2F;
  all.normal = 0.3F;
  all.distortion = 100;
  all.local_consistency = 2;
  all.entropy_3d = 0.5F;
  all.entropy_2d = 0.5F;
  all.mask = 0.3F;
  return {{"L1", l1, SceneBodies::kBoth, false, false},
          {"L1 and SSIM", colors, SceneBodies::kBoth, false, false},
          {"all terms", all, SceneBodies::kBoth, false, false},
          {"p frozen", all, SceneBodies::kBoth, true, false},
          {"object with masks", colors, SceneBodies::kObjectOnly, false, true},
          {"static", all, SceneBodies::kStaticOnly, false, false}};
}

TEST_P(BackendTest, GradientsAndLossesEqualTheReference) {
  constexpr size_t kCount = 12;
  const auto scene = RandomScene(kCount, 11, -1.2);
  const TrainingPhoto photo = RandomPhoto(TestView(36, 21), 5);
  std::vector<uint32_t> neighbours;
  for (uint32_t i = 0; i < kCount; ++i) {
    neighbours.push_back((i + 1) % kCount);
    neighbours.push_back((i + 5) % kCount);
  }
  backend_->SetPhotos({photo});
  double worst = 0;
  for (const LossCase& one : LossCases()) {
    SCOPED_TRACE(one.name);
    TrainStep step;  // with rates of zero
    step.iteration = 1;
    step.bodies = one.bodies;
    step.freeze_foreground = one.freeze;
    step.cut_out_mask = one.cut_out;
    step.background_color = {0.3F, 0.1F, 0.7F};
    step.sh_degree = 3;
    step.weights = one.weights;
    TrainState state;
    state.gaussians = FromReference(scene, 3);
    state.neighbours = neighbours;
    state.num_neighbours = 2;
    backend_->SetState(state);
    backend_->TakeLoss();
    backend_->Step(step);
    const LossTerms loss = backend_->TakeLoss();
    const LossTerms expected_loss = ReferenceLoss(scene, photo, step, neighbours, 2);
    EXPECT_EQ(loss.steps, 1);
    EXPECT_NEAR(loss.l1, expected_loss.l1, 2e-6);
    if (one.weights.dssim != 0) {
      EXPECT_NEAR(loss.dssim, expected_loss.dssim, 1e-5);
    }
    EXPECT_NEAR(loss.normal, expected_loss.normal, 1e-5);
    EXPECT_NEAR(loss.distortion, expected_loss.distortion, 1e-8);
    EXPECT_NEAR(loss.entropy_2d, expected_loss.entropy_2d, 1e-5);
    EXPECT_NEAR(loss.entropy_3d, expected_loss.entropy_3d, 1e-6);
    EXPECT_NEAR(loss.local_consistency, expected_loss.local_consistency, 1e-5);
    EXPECT_NEAR(loss.mask, expected_loss.mask, 1e-5);
    EXPECT_NEAR(loss.total, expected_loss.total, 2e-5);

    const auto moments = ToReference(backend_->GetState().first_moment);
    // Kinds of parameter, each on its own scale.
    const int firsts[] = {kRefCentre,     kRefLogScale, kRefRotation, kRefOpacity,
                          kRefForeground, kRefDc,       kRefRest,     kRefCount};
    for (int kind = 0; kind < 7; ++kind) {
      double difference = 0, norm = 0;
      for (size_t i = 0; i < kCount; ++i) {
        for (int k = firsts[kind]; k < firsts[kind + 1]; ++k) {
          if (k >= kRefRest && k % 4 != 0) continue;  // a sample of the many alike
          auto moved = scene;
          constexpr double kStep = 2e-6;
          moved[i][k] = scene[i][k] + kStep;
          const double above = ReferenceLoss(moved, photo, step, neighbours, 2).total;
          moved[i][k] = scene[i][k] - kStep;
          const double below = ReferenceLoss(moved, photo, step, neighbours, 2).total;
          const double expected = (above - below) / (2 * kStep);
          difference = std::max(difference, std::abs(10 * moments[i][k] - expected));
          norm = std::max(norm, std::abs(expected));
        }
      }
      EXPECT_LT(difference, 1e-3 * norm + 1e-9) << "parameters from " << firsts[kind] << ", largest " << norm;
      worst = std::max(worst, std::max(0.0, difference - 1e-9) / std::max(norm, 1e-9));
    }
  }
  ExpectWithin(numerics::kAdjoints, "a whole step's gradients against differences of the reference, relative",
               Name(), worst, 1e-3);
}

// Left a rotating disc that covers five columns of tiles and small splats of both kinds well inside, right of
// it small ones that stand still. Where tiles are drawn a step does what it does with all of them, elsewhere
// nothing.
TEST_P(BackendTest, OnlyRotatingTilesAreLearntFrom) {
  PinholeView view;
  view.width = 160;
  view.height = 64;
  view.fx = view.fy = 160;
  view.cx = 80;
  view.cy = 32;
  view.near_depth = 0.05;
  RandomNumbers random(11);
  const auto splat_at = [&](double pixel_x, double pixel_y, double z, bool rotates) {
    ReferenceGaussian g{};
    g[kRefCentre] = (pixel_x - view.cx) * z / view.fx;
    g[kRefCentre + 1] = (pixel_y - view.cy) * z / view.fy;
    g[kRefCentre + 2] = z;
    for (int k = 0; k < 2; ++k) g[kRefLogScale + k] = std::log(2 * z / view.fx);
    g[kRefRotation] = 1;
    for (int k = 1; k < 4; ++k) g[kRefRotation + k] = 0.2 * random.Normal();
    g[kRefOpacity] = 1;
    g[kRefForeground] = rotates ? 12 : -12;
    for (int k = 0; k < 3; ++k) g[kRefDc + k] = random.Uniform(-1, 1);
    return g;
  };
  constexpr size_t kNumLeft = 41, kNumRight = 20;
  std::vector<ReferenceGaussian> scene = {splat_at(32, 32, 6, true)};
  scene[0][kRefLogScale] = scene[0][kRefLogScale + 1] = std::log(0.54);  // reaches 47 px
  for (int k = 1; k < 4; ++k) scene[0][kRefRotation + k] = 0;
  while (scene.size() < kNumLeft)
    scene.push_back(splat_at(random.Uniform(14, 46), random.Uniform(10, 54), random.Uniform(3, 5),
                             scene.size() % 2 == 0));
  while (scene.size() < kNumLeft + kNumRight)
    scene.push_back(splat_at(random.Uniform(122, 150), random.Uniform(10, 54), random.Uniform(3, 5), false));
  TrainState state;
  state.gaussians = FromReference(scene, 0);
  TrainStep step = UsualStep();
  step.iteration = 1;
  step.freeze_foreground = true;
  step.weights.normal = 0.05F;
  const auto after = [&](bool only_rotating_tiles) {
    backend_->SetPhotos({RandomPhoto(view, 5)});
    backend_->SetState(state);
    step.only_rotating_tiles = only_rotating_tiles;
    backend_->Step(step);
    const LossTerms loss = backend_->TakeLoss();
    EXPECT_EQ(loss.steps, 1);
    EXPECT_GT(loss.l1, 0);
    return std::pair(backend_->GetState(), loss.l1);
  };
  after(false);  // the first step on a GPU finds out how many pairs there are
  const auto [whole, whole_l1] = after(false);
  const auto [part, part_l1] = after(true);
  // Five columns of ten, of a random photo.
  EXPECT_NEAR(part_l1 / whole_l1, 0.5, 0.1);
  const auto changed = [](const std::vector<float>& a, const std::vector<float>& b, size_t begin,
                          size_t end) {
    double most = 0;
    for (size_t i = begin; i < end; ++i) most = std::max(most, std::abs(static_cast<double>(a[i]) - b[i]));
    return most;
  };
  // Gradients, which the first step's moments are, of centres: sums of floats in another order on a GPU.
  EXPECT_LT(changed(part.first_moment.centre, whole.first_moment.centre, 3, 3 * kNumLeft), 1e-8);
  EXPECT_LT(changed(part.first_moment.sh_dc, whole.first_moment.sh_dc, 3, 3 * kNumLeft), 1e-9);
  const std::vector<float> zeros(whole.first_moment.centre.size());
  EXPECT_GT(changed(whole.first_moment.centre, zeros, 3, 3 * kNumLeft), 1e-5);
  EXPECT_EQ(changed(part.gaussians.centre, state.gaussians.centre, 3 * kNumLeft, 3 * scene.size()), 0);
  EXPECT_EQ(changed(part.gaussians.sh_dc, state.gaussians.sh_dc, 3 * kNumLeft, 3 * scene.size()), 0);
  EXPECT_GT(changed(whole.gaussians.sh_dc, state.gaussians.sh_dc, 3 * kNumLeft, 3 * scene.size()), 1e-4);
  // Nor by what is left of an earlier step.
  backend_->SetState(whole);
  step.iteration = 2;
  backend_->Step(step);
  const TrainState later = backend_->GetState();
  EXPECT_GT(changed(later.gaussians.centre, whole.gaussians.centre, 3, 3 * kNumLeft), 1e-6);
  EXPECT_EQ(changed(later.gaussians.centre, whole.gaussians.centre, 3 * kNumLeft, 3 * scene.size()), 0);
  EXPECT_EQ(changed(later.first_moment.sh_dc, whole.first_moment.sh_dc, 3 * kNumLeft, 3 * scene.size()), 0);
}

// The CPU gives the same bits; additions on a GPU come in another order every time.
TEST_P(BackendTest, TheSameStepsTwice) {
  const auto scene = RandomScene(2000, 12, -3);
  const TrainingPhoto photo = RandomPhoto(TestView(96, 64), 6);
  TrainState state;
  state.gaussians = FromReference(scene, 2);
  RenderRequest request;
  request.view = photo.view;
  std::vector<float> first;
  double worst = 0;
  for (int run = 0; run < 3; ++run) {
    backend_->SetPhotos({photo});
    backend_->SetState(state);
    backend_->RefreshNeighbours(5);
    TrainStep step = UsualStep();
    step.sh_degree = 2;
    step.weights.normal = step.weights.entropy_2d = step.weights.entropy_3d = 0.1F;
    step.weights.local_consistency = 1;
    step.rates.centre = 1e-4F;
    for (step.iteration = 1; step.iteration <= 30; ++step.iteration) backend_->Step(step);
    const RenderedView view = backend_->Render(request);
    if (run == 0) first = view.color;
    double sum = 0;
    for (size_t i = 0; i < first.size(); ++i) {
      sum += std::pow(static_cast<double>(view.color[i]) - static_cast<double>(first[i]), 2);
    }
    worst = std::max(worst, std::sqrt(sum / static_cast<double>(first.size())));
  }
  ExpectWithin(numerics::kRepeatability, "image after 30 steps, RMS of colours between three runs", Name(),
               worst, GetParam() == BackendKind::kCpu ? 0 : 5e-3);
}

}  // namespace
}  // namespace s2gs
