#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>
#include <string>

#include "s2gs/scene/training_scene.h"
#include "tests/s2gs/backend/backend_fixture.h"
#include "tests/s2gs/backend/reference_render.h"
#include "tests/s2gs/usual_step.h"

namespace s2gs {
namespace {

// A state that is taken and given back trains on exactly as if it had stayed.
TEST_P(BackendTest, StateComesBackAsItWas) {
  const auto scene = RandomScene(200, 9, -2.5);
  TrainState state;
  state.gaussians = FromReference(scene, 3);
  const TrainingPhoto photo = RandomPhoto(TestView(60, 40), 6);
  backend_->SetPhotos({photo});
  backend_->SetState(state);
  backend_->RefreshNeighbours(4);
  TrainStep step = UsualStep();
  step.sh_degree = 3;
  step.collect_statistics = true;
  for (step.iteration = 1; step.iteration <= 4; ++step.iteration) backend_->Step(step);
  const TrainState taken = backend_->GetState();
  backend_->SetState(taken);
  const TrainState again = backend_->GetState();
  EXPECT_EQ(again.gaussians.sh_rest, taken.gaussians.sh_rest);
  EXPECT_EQ(again.gaussians.centre, taken.gaussians.centre);
  EXPECT_EQ(again.second_moment.rotation, taken.second_moment.rotation);
  EXPECT_EQ(again.gradient_sum, taken.gradient_sum);
  EXPECT_EQ(again.view_count, taken.view_count);
  EXPECT_EQ(again.neighbours, taken.neighbours);
  EXPECT_EQ(again.num_neighbours, 4);
  EXPECT_EQ(*std::max_element(taken.view_count.begin(), taken.view_count.end()), 4);
}

// A step from zero moments moves each number by its rate. Whatever looks at the model next, or changes it,
// sees that, also of the colours' bands, which a backend may still have to move then.
TEST_P(BackendTest, WhateverComesNextSeesTheLastStep) {
  constexpr size_t kCount = 12;
  const TrainingPhoto photo = RandomPhoto(TestView(36, 21), 5);
  TrainState state;
  state.gaussians = FromReference(RandomScene(kCount, 11, -1.2), 3);
  backend_->SetPhotos({photo});
  TrainStep step = UsualStep();
  step.sh_degree = 3;
  step.rates = {};
  step.rates.sh_rest = 1e-3F;
  TrainStep still = step;  // moves nothing
  still.rates = {};
  still.iteration = 2;
  const auto after = [&](const std::function<void()>& next) {
    backend_->SetState(state);
    step.iteration = 1;
    backend_->Step(step);
    next();
    return backend_->GetGaussians().sh_rest;
  };
  const std::vector<float> moved = after([] {});
  double most = 0;
  for (size_t i = 0; i < moved.size(); ++i)
    most = std::max(most, std::abs(static_cast<double>(moved[i]) - state.gaussians.sh_rest[i]));
  EXPECT_NEAR(most, 1e-3, 1e-6);
  const auto expect_moved = [&](const char* what, const std::vector<float>& values) {
    ASSERT_EQ(values.size(), moved.size()) << what;
    for (size_t i = 0; i < moved.size(); ++i) EXPECT_NEAR(values[i], moved[i], 1e-6) << what << ", " << i;
  };
  std::vector<uint32_t> all(kCount);
  std::iota(all.begin(), all.end(), 0U);
  DensifyStep densify;
  densify.grow = false;
  densify.min_opacity = 0;
  RenderRequest request;
  request.view = photo.view;
  RenderedView drawn;
  expect_moved("state", after([&] { backend_->GetState(); }));
  expect_moved("choice", after([&] { backend_->Keep(all); }));
  expect_moved("removal", after([&] { backend_->Densify(densify); }));
  expect_moved("drawing", after([&] { drawn = backend_->Render(request); }));
  expect_moved("step", after([&] { backend_->Step(still); }));
  still.sh_degree = 1;
  expect_moved("step of fewer bands", after([&] { backend_->Step(still); }));
  // The picture, too.
  TrainState moved_state = state;
  moved_state.gaussians.sh_rest = moved;
  backend_->SetState(moved_state);
  const RenderedView expected = backend_->Render(request);
  for (size_t i = 0; i < expected.color.size(); ++i)
    EXPECT_NEAR(drawn.color[i], expected.color[i], 1e-5) << i;
}

// Steps of a model that is looked at after each of them, so that all of it must have been learnt then, and of
// one that is looked at once, in the middle or at the end: a backend may put off what colours alone need.
TEST_P(BackendTest, WhenItIsLookedAtDoesNotMatter) {
  constexpr int kSteps = 11;
  const TrainingPhoto photo = RandomPhoto(TestView(96, 64), 8);
  TrainState state;
  state.gaussians = FromReference(RandomScene(1500, 14, -3), 3);
  backend_->SetPhotos({photo});
  TrainStep step = UsualStep();
  step.sh_degree = 3;
  step.weights.dssim = 0;
  step.rates = {};
  step.rates.sh_rest = 1e-3F;
  RenderRequest request;
  request.view = photo.view;
  const auto train = [&](const std::function<bool(int64_t)>& looks) {
    backend_->SetState(state);
    for (step.iteration = 1; step.iteration <= kSteps; ++step.iteration) {
      backend_->Step(step);
      if (looks(step.iteration)) backend_->Render(request);
    }
    return backend_->GetState();
  };
  const TrainState expected = train([](int64_t /*i*/) { return true; });
  const auto expect_near = [&](const std::vector<float>& actual, const std::vector<float>& wanted,
                               const char* what) {
    double square = 0, difference = 0;
    for (size_t i = 0; i < wanted.size(); ++i) {
      square += std::pow(static_cast<double>(wanted[i]), 2);
      difference += std::pow(static_cast<double>(actual[i]) - static_cast<double>(wanted[i]), 2);
    }
    ASSERT_GT(square, 0) << what;
    EXPECT_LE(std::sqrt(difference / square), GetParam() == BackendKind::kCpu ? 0 : 1e-4) << what;
  };
  for (const int64_t once : {0, 3, 4, 5, 10}) {
    const TrainState actual = train([&](int64_t i) { return i == once; });
    std::vector<float> moved = actual.gaussians.sh_rest, wanted = expected.gaussians.sh_rest;
    for (size_t i = 0; i < moved.size(); ++i) {
      moved[i] -= state.gaussians.sh_rest[i];
      wanted[i] -= state.gaussians.sh_rest[i];
    }
    expect_near(moved, wanted, "coefficients' movement");
    expect_near(actual.first_moment.sh_rest, expected.first_moment.sh_rest, "first moments");
    expect_near(actual.second_moment.sh_rest, expected.second_moment.sh_rest, "second moments");
  }
}

// What is given is what the next call reads, whatever lies between the host and the device: arrays larger
// than what a driver stages at once, other values each time, and no wait between giving and reading.
TEST_P(BackendTest, WhatIsGivenHasArrivedWhenItIsRead) {
  constexpr size_t kCount = 300000;  // 1.2 MB for each of a Gaussian's numbers
  TrainState state;
  const std::vector<ReferenceGaussian> scene(kCount, RandomScene(1, 10, -3)[0]);
  state.gaussians = FromReference(scene, 0);
  std::vector<float> logits(kCount);
  for (int round = 0; round < 3; ++round) {
    for (size_t i = 0; i < kCount; ++i) {
      state.gaussians.centre[3 * i + 2] = static_cast<float>(round) + static_cast<float>(i % 1000);
      logits[i] = static_cast<float>(round) - static_cast<float>(i % 7);
    }
    backend_->SetState(state);
    ASSERT_EQ(backend_->GetPlacement().centre, state.gaussians.centre) << round;
    backend_->SetForegroundLogits(logits);
    ASSERT_EQ(backend_->GetPlacement().foreground_logit, logits) << round;
    // The last ones alone: gathered from what was given just now.
    backend_->Keep({static_cast<uint32_t>(kCount - 2), static_cast<uint32_t>(kCount - 1)});
    EXPECT_EQ(backend_->GetPlacement().foreground_logit, std::vector<float>(logits.end() - 2, logits.end()));
  }
}

// The two backends, step by step on a scene too large for the reference.
TEST(BackendParity, CudaTrainsAsTheCpuDoes) {
  std::string reason;
  const auto cuda = TryMakeBackend(BackendKind::kCuda, &reason);
  if (cuda == nullptr) GTEST_SKIP() << "no GPU, so the backends were not compared: " << reason;
  const auto cpu = MakeCpuBackend(0);
  ASSERT_EQ(cuda->Info().kind, BackendKind::kCuda);
  ASSERT_EQ(cpu->Info().kind, BackendKind::kCpu);
  const auto scene = RandomScene(20000, 12, -4);
  const TrainingPhoto photo = RandomPhoto(TestView(320, 200), 6);
  TrainState state;
  state.gaussians = FromReference(scene, 2);
  for (Backend* backend : {cuda.get(), cpu.get()}) {
    backend->SetPhotos({photo});
    backend->SetState(state);
    backend->RefreshNeighbours(5);
    TrainStep step = UsualStep();
    step.sh_degree = 2;
    step.weights.normal = step.weights.entropy_2d = step.weights.entropy_3d = 0.1F;
    step.weights.local_consistency = 1;
    step.collect_statistics = true;
    for (step.iteration = 1; step.iteration <= 10; ++step.iteration) backend->Step(step);
  }
  const LossTerms cuda_loss = cuda->TakeLoss(), cpu_loss = cpu->TakeLoss();
  EXPECT_EQ(cuda_loss.steps, 10);
  EXPECT_NEAR(cuda_loss.total, cpu_loss.total, 1e-4 * cpu_loss.total);
  EXPECT_NEAR(cuda_loss.normal, cpu_loss.normal, 1e-3 * std::abs(cpu_loss.normal));
  RenderRequest request;
  request.view = photo.view;
  const RenderedView a = cuda->Render(request), b = cpu->Render(request);
  double sum = 0;
  for (size_t i = 0; i < a.color.size(); ++i) sum += std::pow(a.color[i] - b.color[i], 2);
  EXPECT_LT(std::sqrt(sum / static_cast<double>(a.color.size())), 5e-3);
  DensifyStep densify;
  densify.iteration = 10;
  densify.min_gradient = 1e-4F;
  densify.max_clone_scale = 0.02F;
  const DensifyResult from_cuda = cuda->Densify(densify), from_cpu = cpu->Densify(densify);
  EXPECT_GT(from_cpu.cloned + from_cpu.split, 100);
  EXPECT_NEAR(from_cuda.cloned, from_cpu.cloned, 20);
  EXPECT_NEAR(from_cuda.split, from_cpu.split, 20);
  EXPECT_NEAR(from_cuda.removed, from_cpu.removed, 5);
  const auto peaks = cuda->PeakWeights({photo.view}, SceneBodies::kBoth, DrawnBody::kAll);
  EXPECT_EQ(peaks.size(), static_cast<size_t>(cuda->Count()));
}

}  // namespace
}  // namespace s2gs
