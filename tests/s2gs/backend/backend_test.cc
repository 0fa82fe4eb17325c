#include "s2gs/backend/backend.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <atomic>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <set>
#include <string>

#include "s2gs/core/gpu_info.h"
#include "s2gs/training_scene.h"
#include "sfm_split/base/angles.h"
#include "tests/s2gs/backend/reference_render.h"
#include "tests/s2gs/usual_step.h"
#include "tests/support/measured_bound.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

// The backend under test, or null and a reason. Of several GPUs the last one; and they are listed again, as
// what plans memory does, which must not take the thread to another one.
std::unique_ptr<Backend> TryMakeBackend(BackendKind kind, std::string* reason) {
  if (kind == BackendKind::kCpu) return MakeCpuBackend(2);
  try {
    const int last = std::max(0, static_cast<int>(ListGpus().size()) - 1);
    std::unique_ptr<Backend> backend = MakeCudaBackend(last);
    ListGpus();
    return backend;
  } catch (const UserError& error) {
    *reason = error.what();
    return nullptr;
  }
}

class BackendTest : public testing::TestWithParam<BackendKind> {
 protected:
  void SetUp() override {
    std::string reason;
    backend_ = TryMakeBackend(GetParam(), &reason);
    if (backend_ == nullptr) GTEST_SKIP() << "no GPU, so the CUDA backend was not tested: " << reason;
    ASSERT_EQ(backend_->Info().kind, GetParam());
  }

  static std::string Name() { return GetParam() == BackendKind::kCpu ? "cpu" : "cuda"; }

  std::unique_ptr<Backend> backend_;
};

PinholeView TestView(int width, int height) {
  PinholeView view;
  view.width = width;
  view.height = height;
  view.fx = 1.3 * width;
  view.fy = 1.25 * width;
  view.cx = 0.52 * width;
  view.cy = 0.47 * height;
  view.near_depth = 0.05;
  view.cam_from_world = {Eigen::Quaterniond(Eigen::AngleAxisd(0.3, Eigen::Vector3d(1, 2, 0.5).normalized())),
                         {0.1, -0.05, 4}};
  const Rigid3 world_from_object = {Eigen::Quaterniond(Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ())),
                                    {0.05, 0.02, 0.01}};
  view.cam_from_object = view.cam_from_world * world_from_object;
  return view;
}

// Splats of all sizes about the origin; every fifth is not drawn.
std::vector<ReferenceGaussian> RandomScene(size_t count, uint64_t seed, double mean_log_scale) {
  RandomNumbers random(seed);
  std::vector<ReferenceGaussian> scene(count);
  for (size_t i = 0; i < count; ++i) {
    ReferenceGaussian& g = scene[i];
    for (int k = 0; k < 3; ++k) g[kRefCentre + k] = random.Uniform(-1, 1);
    for (int k = 0; k < 2; ++k) g[kRefLogScale + k] = mean_log_scale + random.Uniform(-0.8, 0.8);
    for (int k = 0; k < 4; ++k) g[kRefRotation + k] = random.Normal();
    g[kRefOpacity] = random.Uniform(-2, 3);
    g[kRefForeground] = random.Uniform(-3, 3.5);
    for (int k = 0; k < 3; ++k) g[kRefDc + k] = random.Uniform(-1.2, 1.2);
    for (int k = 0; k < 3 * kShRestPerChannel; ++k) g[kRefRest + k] = 0.1 * random.Normal();
    if (i % 5 == 4) g[kRefCentre + 2] -= 30;  // behind the camera
    // In float, so that both sides have the same numbers.
    for (double& value : g) value = static_cast<double>(static_cast<float>(value));
  }
  return scene;
}

TrainingPhoto RandomPhoto(const PinholeView& view, uint64_t seed) {
  RandomNumbers random(seed);
  TrainingPhoto photo;
  photo.view = view;
  photo.image = {view.width, view.height, 3, {}};
  photo.image.pixels.resize(static_cast<size_t>(view.width) * view.height * 3);
  for (uint8_t& value : photo.image.pixels) value = static_cast<uint8_t>(random.Index(256));
  photo.mask.resize(static_cast<size_t>(view.width) * view.height);
  for (size_t i = 0; i < photo.mask.size(); ++i) photo.mask[i] = i % 7 < 3 ? 255 : 0;
  return photo;
}

// Rounding moves single hits over the cut at alpha = 1/255, so a few pixels may differ by as much.
void ExpectMapNear(const std::vector<float>& actual, const std::vector<double>& expected, double bound,
                   double bound_of_few, const std::string& name) {
  ASSERT_EQ(actual.size(), expected.size()) << name;
  size_t over = 0;
  double worst = 0;
  for (size_t i = 0; i < actual.size(); ++i) {
    const double error = std::abs(static_cast<double>(actual[i]) - expected[i]);
    ASSERT_TRUE(std::isfinite(error)) << name;
    over += error > bound ? 1 : 0;
    worst = std::max(worst, error);
  }
  EXPECT_LE(over, actual.size() / 500) << name;
  EXPECT_LT(worst, bound_of_few) << name;
}

TEST_P(BackendTest, ImagesEqualTheReference) {
  const auto scene = RandomScene(150, 3, -2);
  TrainState state;
  state.gaussians = FromReference(scene, 3);
  backend_->SetState(state);
  RenderRequest request;
  request.view = TestView(75, 53);
  request.geometry = true;
  request.foreground = true;
  request.background_color = {0.2F, 0.4F, 0.6F};
  const auto compare = [&] {
    const ReferenceMaps expected = RenderReference(scene, request, 3);
    const RenderedView actual = backend_->Render(request);
    ExpectMapNear(actual.color, expected.color, 2e-5, 1e-2, "color");
    ExpectMapNear(actual.alpha, expected.alpha, 2e-5, 1e-2, "alpha");
    ExpectMapNear(actual.foreground, expected.foreground, 2e-5, 1e-2, "foreground");
    ExpectMapNear(actual.normal, expected.normal, 2e-5, 1e-2, "normal");
    ExpectMapNear(actual.expected_depth, expected.expected_depth, 1e-4, 2, "expected depth");
    ExpectMapNear(actual.median_depth, expected.median_depth, 1e-4, 5, "median depth");
    ExpectMapNear(actual.distortion, expected.distortion, 1e-7, 1e-5, "distortion");
  };
  for (const DrawnBody drawn : {DrawnBody::kAll, DrawnBody::kForeground, DrawnBody::kBackground}) {
    for (const SceneBodies bodies :
         {SceneBodies::kBoth, SceneBodies::kObjectOnly, SceneBodies::kStaticOnly}) {
      for (const bool hard : {false, true}) {
        request.drawn = drawn;
        request.bodies = bodies;
        request.hard_foreground = hard;
        request.freeze_foreground = hard;
        compare();
      }
    }
  }
  // Of the static splats, about a third lies in this cylinder.
  request.drawn = DrawnBody::kAll;
  request.bodies = SceneBodies::kBoth;
  request.without_static =
      RotatingRegion{{{0.1, -0.2, 0.05}, Eigen::Vector3d(0.2, -0.1, 1).normalized()}, 0.8, -0.7, 0.6};
  compare();
  for (const float tolerance : {0.1F, 0.3F}) {
    request.hard_foreground = true;
    request.side = RotatingSide{*request.without_static, 0.3, {0.5F, 0.4F, 0.6F}, tolerance};
    request.side->region.radius = 1.2;
    compare();
  }
}

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

// Splats that reach one tile, some, and most of the seventy of an image.
TEST_P(BackendTest, SplatsReachAllTheirTiles) {
  const auto scene = RandomScene(60, 21, -1);
  TrainState state;
  state.gaussians = FromReference(scene, 3);
  backend_->SetState(state);
  RenderRequest request;
  request.view = TestView(150, 110);
  const ReferenceMaps expected = RenderReference(scene, request, 3);
  const RenderedView actual = backend_->Render(request);
  ExpectMapNear(actual.color, expected.color, 2e-5, 1e-2, "color");
  ExpectMapNear(actual.alpha, expected.alpha, 2e-5, 1e-2, "alpha");
}

// By Adam's first moment after one step from zero: (1 - beta1) times the gradient.
// Drawing on the CPU is long enough to be stopped, and leaves everything as it was.
TEST_P(BackendTest, DrawingHearsAStop) {
  if (GetParam() != BackendKind::kCpu) GTEST_SKIP() << "views are drawn at once there";
  TrainState state;
  state.gaussians = FromReference(RandomScene(50, 3, -2), 3);
  backend_->SetState(state);
  RenderRequest request;
  request.view = TestView(100, 90);
  const RenderedView whole = backend_->Render(request);
  std::atomic<int> num_polled = 0;
  request.stop_requested = [&] { return ++num_polled == 3; };
  EXPECT_THROW(backend_->Render(request), Interrupted);
  request.stop_requested = [] { return false; };
  EXPECT_EQ(backend_->Render(request).color, whole.color);
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

// Two discs of which one stands behind the other by little: by two steps of the key that splats are sorted by
// on a GPU, up to 65,536 near depths and beyond.
TEST_P(BackendTest, WhatIsNearerByLittleIsInFront) {
  PinholeView view;
  view.width = view.height = 32;
  view.fx = view.fy = 32;
  view.cx = view.cy = 16;
  view.near_depth = 0.05;
  RenderRequest request;
  request.view = view;
  const auto disc = [](double z, bool is_red) {
    ReferenceGaussian g{};
    g[kRefCentre + 2] = z;
    g[kRefLogScale] = g[kRefLogScale + 1] = std::log(0.2 * z);
    g[kRefRotation] = 1;
    g[kRefOpacity] = 3;
    g[kRefForeground] = -12;
    for (int k = 0; k < 3; ++k) g[kRefDc + k] = (k == 0) == is_red ? 1.7 : -1.7;
    return g;
  };
  const std::pair<double, double> kDepthsAndShares[] = {{0.06, 4e-6}, {1, 4e-6},    {150, 4e-6},
                                                        {3000, 4e-6}, {4000, 7e-5}, {1e6, 7e-5}};
  for (const auto& [depth, share] : kDepthsAndShares) {
    for (const bool red_is_first : {true, false}) {
      for (const bool red_is_near : {true, false}) {
        SCOPED_TRACE(std::to_string(depth) + (red_is_first ? ", first" : ", last"));
        const double behind = depth * (1 + share);
        const ReferenceGaussian red = disc(red_is_near ? depth : behind, true);
        const ReferenceGaussian other = disc(red_is_near ? behind : depth, false);
        TrainState state;
        state.gaussians = FromReference(red_is_first ? std::vector<ReferenceGaussian>{red, other}
                                                     : std::vector<ReferenceGaussian>{other, red},
                                        0);
        backend_->SetState(state);
        const RenderedView drawn = backend_->Render(request);
        const float* centre = drawn.color.data() + 3 * (16 * 32 + 16);
        EXPECT_EQ(centre[0] > centre[1], red_is_near) << centre[0] << " " << centre[1];
      }
    }
  }
}

TEST_P(BackendTest, HostileNumbersAreCulled) {
  const float kHostile[] = {std::numeric_limits<float>::quiet_NaN(),
                            std::numeric_limits<float>::infinity(),
                            -std::numeric_limits<float>::infinity(),
                            1e38F,
                            -1e38F,
                            1e-42F};
  const auto base = RandomScene(8, 21, -1.5);
  const TrainingPhoto photo = RandomPhoto(TestView(33, 20), 6);
  backend_->SetPhotos({photo});
  double not_finite = 0;
  double not_counted = 0;
  for (int slot = 0; slot < kRefCount; slot += slot < kRefRest ? 1 : 7) {
    for (const float value : kHostile) {
      SCOPED_TRACE("slot " + std::to_string(slot) + " = " + std::to_string(value));
      TrainState state;
      auto scene = base;
      scene[1][slot] = static_cast<double>(value);
      state.gaussians = FromReference(scene, 3);
      state.neighbours.assign(8, 1);
      state.num_neighbours = 1;
      backend_->SetState(state);
      RenderRequest request;
      request.view = photo.view;
      request.geometry = request.foreground = true;
      const RenderedView view = backend_->Render(request);
      for (const auto* map : {&view.color, &view.alpha, &view.expected_depth, &view.median_depth,
                              &view.normal, &view.distortion, &view.foreground}) {
        not_finite += static_cast<double>(
            std::count_if(map->begin(), map->end(), [](float v) { return !std::isfinite(v); }));
      }
      TrainStep step = UsualStep();
      step.sh_degree = 3;
      step.weights.normal = step.weights.entropy_2d = step.weights.entropy_3d = 0.1F;
      step.weights.distortion = step.weights.local_consistency = 1;
      for (step.iteration = 1; step.iteration <= 3; ++step.iteration) backend_->Step(step);
      const auto after = ToReference(backend_->GetGaussians());
      for (size_t i = 0; i < after.size(); ++i) {
        for (int k = 0; k < kRefCount; ++k) {
          not_finite += std::isfinite(after[i][k]) || i == 1 ? 0 : 1;
        }
      }
      DensifyStep densify;
      densify.grow = false;
      densify.min_opacity = 0;
      const DensifyResult result = backend_->Densify(densify);
      if (!std::isfinite(value) && result.not_finite != 1) ++not_counted;
      EXPECT_EQ(result.count, 8 - result.removed - result.not_finite);
    }
  }
  ExpectWithin(numerics::kHostileInput, "numbers not finite in maps and in other Gaussians, every slot",
               Name(), not_finite, 0);
  ExpectWithin(numerics::kHostileInput, "Gaussians with NaN or infinity that are not counted", Name(),
               not_counted, 0);
}

// A quaternion without length or of huge length, log-scales at and past the end, centres at the camera and on
// the near plane, each twice: drawn or culled, never a number that is none.
TEST_P(BackendTest, DegenerateGaussiansAreFiniteOrCulled) {
  const auto base = RandomScene(1, 4, -1)[0];
  const PinholeView view = TestView(40, 30);
  const Rigid3 world_from_cam = view.cam_from_world.Inverse();
  std::vector<ReferenceGaussian> scene;
  const auto add = [&](const auto& change) {
    ReferenceGaussian g = base;
    g[kRefForeground] = -8;
    change(&g);
    scene.push_back(g);
    scene.push_back(g);
  };
  for (const double length : {0.0, 1e-30, 1e-20, 1e-10, 1e10, 1e14, 1e16, 1e30}) {
    add([&](ReferenceGaussian* g) {
      for (int k = 0; k < 4; ++k) (*g)[kRefRotation + k] = length * (k == 0 ? 0.8 : 0.3);
    });
  }
  for (const double log_scale : {-1e4, -81.0, -80.0, 80.0, 81.0, 1e4}) {
    add([&](ReferenceGaussian* g) { (*g)[kRefLogScale] = (*g)[kRefLogScale + 1] = log_scale; });
  }
  for (const double z : {0.0, 1e-30, -1e-6, 1e-6, view.near_depth, 1e11, 1e13}) {
    add([&](ReferenceGaussian* g) {
      const Eigen::Vector3d x = world_from_cam * Eigen::Vector3d(0, 0, z);
      for (int k = 0; k < 3; ++k) (*g)[kRefCentre + k] = x[k];
    });
  }
  const TrainingPhoto photo = RandomPhoto(view, 6);
  TrainState state;
  state.gaussians = FromReference(scene, 3);
  backend_->SetState(state);
  backend_->SetPhotos({photo});
  RenderRequest request;
  request.view = view;
  request.geometry = request.foreground = true;
  const RenderedView maps = backend_->Render(request);
  double not_finite = 0;
  for (const auto* map : {&maps.color, &maps.alpha, &maps.expected_depth, &maps.median_depth, &maps.normal,
                          &maps.distortion, &maps.foreground}) {
    not_finite += static_cast<double>(
        std::count_if(map->begin(), map->end(), [](float v) { return !std::isfinite(v); }));
  }
  TrainStep step = UsualStep();
  step.sh_degree = 3;
  step.weights.normal = step.weights.entropy_2d = step.weights.entropy_3d = 0.1F;
  step.weights.distortion = 1;
  step.rates.centre = 1e-4F;
  for (step.iteration = 1; step.iteration <= 5; ++step.iteration) backend_->Step(step);
  for (const ReferenceGaussian& g : ToReference(backend_->GetGaussians())) {
    not_finite +=
        static_cast<double>(std::count_if(g.begin(), g.end(), [](double v) { return !std::isfinite(v); }));
  }
  ExpectWithin(numerics::kDegenerateGaussians,
               "numbers not finite: quaternions 0 to 1e30, log-scales to 1e4, centres at the camera", Name(),
               not_finite, 0);
  // Undrawable whatever training does: quaternions shorter than 1e-15, centres past 1e12. Each stands twice.
  DensifyStep densify;
  densify.grow = false;
  densify.min_opacity = 0;
  EXPECT_GE(backend_->Densify(densify).not_finite, 2 * 5);
}

// Training and photos of a scene whose unit is another, and of one that lies far from its frame's origin.
// Lengths are normalised in double before anything else (s2gs/training_scene.h).
TEST_P(BackendTest, ScaleAndPlaceOfTheSceneDoNotMatter) {
  const auto scene = RandomScene(120, 3, -2);
  RenderRequest request;
  request.view = TestView(75, 53);
  TrainState state;
  state.gaussians = FromReference(scene, 3);
  backend_->SetState(state);
  const RenderedView reference = backend_->Render(request);
  // A few hits at the cut of alpha = 1/255 fall on its other side: they count by their mean.
  const auto compare = [&](const std::string& what, const RenderedView& view) {
    double sum = 0;
    for (size_t i = 0; i < view.color.size(); ++i) {
      sum += std::pow(static_cast<double>(view.color[i]) - static_cast<double>(reference.color[i]), 2);
    }
    ExpectWithin(numerics::kScaleAndPlace, what, Name(),
                 std::sqrt(sum / static_cast<double>(view.color.size())), 1e-4);
  };
  const auto transformed = [](PinholeView view, double scale, const Eigen::Vector3d& move) {
    for (Rigid3* pose : {&view.cam_from_world, &view.cam_from_object}) {
      pose->translation = scale * pose->translation - pose->rotation * move;
    }
    return view;
  };
  for (const double scale : {1e-3, 1e3}) {
    auto scaled = scene;
    for (ReferenceGaussian& g : scaled) {
      for (int k = 0; k < 3; ++k) g[kRefCentre + k] *= scale;
      for (int k = 0; k < 2; ++k) g[kRefLogScale + k] += std::log(scale);
    }
    state.gaussians = FromReference(scaled, 3);
    backend_->SetState(state);
    RenderRequest other = request;
    other.view = transformed(request.view, scale, Eigen::Vector3d::Zero());
    other.view.near_depth *= scale;
    compare(scale < 1 ? "image, RMS of colours, lengths x 1e-3" : "image, RMS of colours, lengths x 1e3",
            backend_->Render(other));
  }
  // Poses 1e6 scene sizes away, brought back as the reader of scenes does.
  const Eigen::Vector3d far = 1e6 * Eigen::Vector3d(0.6, -0.7, 0.4);
  for (const double scale : {1e-3, 1.0, 1e3}) {
    RenderRequest other = request;
    other.view = NormaliseView(transformed(request.view, scale, scale * far), scale * far, scale);
    other.view.near_depth = request.view.near_depth;
    state.gaussians = FromReference(scene, 3);
    backend_->SetState(state);
    compare("image, RMS of colours, moved by 1e6 sizes, lengths x " + std::string(scale < 1   ? "1e-3"
                                                                                  : scale > 1 ? "1e3"
                                                                                              : "1"),
            backend_->Render(other));
  }
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

TEST_P(BackendTest, ExtremeShapesStayFinite) {
  std::vector<ReferenceGaussian> scene;
  for (const double log_scale : {-80.0, -20.0, 0.0, 3.0, 20.0, 80.0}) {
    for (const double degrees : {0.0, 89.0, 89.9, 89.95, 89.99, 90.0}) {
      auto g = RandomScene(1, 4, 0)[0];
      const Eigen::Quaterniond turn(Eigen::AngleAxisd(degrees * kPi / 180, Eigen::Vector3d::UnitX()));
      const Eigen::Quaterniond q = TestView(64, 48).cam_from_world.rotation.conjugate() * turn;
      g[kRefRotation] = q.w();
      g[kRefRotation + 1] = q.x();
      g[kRefRotation + 2] = q.y();
      g[kRefRotation + 3] = q.z();
      g[kRefLogScale] = log_scale;
      g[kRefLogScale + 1] = -log_scale / 2;
      g[kRefForeground] = -8;
      scene.push_back(g);
      scene.push_back(g);  // a duplicate
    }
  }
  const TrainingPhoto photo = RandomPhoto(TestView(64, 48), 6);
  TrainState state;
  state.gaussians = FromReference(scene, 3);
  backend_->SetState(state);
  backend_->SetPhotos({photo});
  TrainStep step = UsualStep();
  step.sh_degree = 3;
  step.weights.normal = step.weights.entropy_2d = 0.1F;
  for (step.iteration = 1; step.iteration <= 10; ++step.iteration) backend_->Step(step);
  double not_finite = std::isfinite(backend_->TakeLoss().total) ? 0 : 1;
  for (const ReferenceGaussian& g : ToReference(backend_->GetGaussians())) {
    not_finite +=
        static_cast<double>(std::count_if(g.begin(), g.end(), [](double v) { return !std::isfinite(v); }));
  }
  ExpectWithin(numerics::kEdgeOn, "numbers not finite after 10 steps, 0 to 90 degrees, log-scales +-80",
               Name(), not_finite, 0);
}

// Discs that reach from before the image through the camera's plane, against the reference without bounds.
TEST_P(BackendTest, DiscsThroughTheCameraPlane) {
  auto scene = RandomScene(40, 8, 0);
  RandomNumbers random(3);
  for (ReferenceGaussian& g : scene) {
    g[kRefLogScale] = random.Uniform(0, 3);
    g[kRefLogScale + 1] = random.Uniform(-1, 3);
    g[kRefCentre + 2] = random.Uniform(-3.5, 1);
    for (double& value : g) value = static_cast<double>(static_cast<float>(value));
  }
  TrainState state;
  state.gaussians = FromReference(scene, 1);
  backend_->SetState(state);
  RenderRequest request;
  request.view = TestView(100, 70);
  const ReferenceMaps expected = RenderReference(scene, request, 1);
  const RenderedView actual = backend_->Render(request);
  ExpectMapNear(actual.color, expected.color, 1e-4, 2e-2, "color");
  ExpectMapNear(actual.alpha, expected.alpha, 1e-4, 2e-2, "alpha");
  double sum = 0;
  for (size_t i = 0; i < actual.color.size(); ++i) {
    sum += std::pow(static_cast<double>(actual.color[i]) - expected.color[i], 2);
  }
  ExpectWithin(numerics::kEdgeOn, "discs through the camera's plane, RMS of colours against the reference",
               Name(), std::sqrt(sum / static_cast<double>(actual.color.size())), 1e-4);
}

TEST_P(BackendTest, ManyLayersKeepTheirTransmittance) {
  constexpr int kLayers = 2000;
  for (const double opacity : {1.001 / 255, 0.5, 0.985, 0.99}) {
    std::vector<ReferenceGaussian> scene;
    for (int i = 0; i < kLayers; ++i) {
      ReferenceGaussian g{};
      g[kRefCentre + 2] = 1e-3 * i;
      g[kRefRotation] = 1;
      g[kRefLogScale] = g[kRefLogScale + 1] = 8;
      g[kRefOpacity] = std::log(opacity / (1 - opacity));
      g[kRefForeground] = -20;
      for (double& value : g) value = static_cast<double>(static_cast<float>(value));
      scene.push_back(g);
    }
    TrainState state;
    state.gaussians = FromReference(scene, 0);
    backend_->SetState(state);
    RenderRequest request;
    request.view = TestView(17, 17);
    request.view.cam_from_world.rotation.setIdentity();
    const ReferenceMaps expected = RenderReference(scene, request, 0);
    const RenderedView actual = backend_->Render(request);
    double worst = 0;
    for (size_t i = 0; i < expected.alpha.size(); ++i) {
      const double transmittance = 1 - expected.alpha[i];
      double error = std::abs(1 - static_cast<double>(actual.alpha[i]) - transmittance);
      // Two layers of .99 end on the transmittance 1e-4 that stops compositing, on either side of it.
      if (opacity == 0.99) error = std::min(error, std::abs(1 - static_cast<double>(actual.alpha[i]) - 0.01));
      worst = std::max(worst, error);
    }
    const std::string name = opacity < 0.1    ? "1/255"
                             : opacity == 0.5 ? ".5"
                             : opacity < 0.99 ? ".985"
                                              : ".99";
    ExpectWithin(numerics::kManyLayers, "transmittance against double, alpha " + name, Name(), worst,
                 kLayers * 4 * 1.19e-7);
  }
}

// 2^32 pairs of a splat and a tile are 0 in 32 bits, 2^31 + 2^16 are negative: they are counted, refused, and
// nothing is allocated for them.
TEST_P(BackendTest, CountsPairsIn64Bits) {
  if (GetParam() == BackendKind::kCpu) GTEST_SKIP() << "TileLists.CountsPairsIn64Bits";
  RenderRequest request;
  request.view = TestView(4096, 4096);  // 2^16 tiles
  request.view.cam_from_world.rotation.setIdentity();
  for (const int layers : {(1 << 15) + 1, 1 << 16}) {
    SCOPED_TRACE(layers);
    ReferenceGaussian g{};
    g[kRefRotation] = 1;
    g[kRefLogScale] = g[kRefLogScale + 1] = 8;
    g[kRefForeground] = -20;
    TrainState state;
    state.gaussians = FromReference(std::vector<ReferenceGaussian>(layers, g), 0);
    backend_->SetState(state);
    EXPECT_THROW(backend_->Render(request), UserError);
    EXPECT_LT(backend_->Info().peak_memory_bytes, int64_t{2} << 30U);
  }
  ExpectWithin(numerics::kCounts, "memory taken before 2^32 pairs of splat and tile are refused [GiB]",
               Name(), static_cast<double>(backend_->Info().peak_memory_bytes) / (1U << 30U), 2);
}

TEST_P(BackendTest, NeighboursAreTheNearest) {
  for (const size_t count : {2U, 3U, 70U, 9000U}) {
    auto scene = RandomScene(count, 17, -2);
    if (count > 60) {
      scene[7] = scene[8];                                                  // duplicates
      for (int k = 0; k < 3; ++k) scene[9][k] = 1e4;                        // an outlier
      for (size_t i = 0; i < count / 3; ++i) scene[i][kRefCentre] *= 1e-3;  // a dense part
    }
    for (auto& g : scene) {
      for (double& value : g) value = static_cast<double>(static_cast<float>(value));
    }
    TrainState state;
    state.gaussians = FromReference(scene, 0);
    backend_->SetState(state);
    backend_->RefreshNeighbours(5);
    const TrainState after = backend_->GetState();
    const auto k = static_cast<size_t>(after.num_neighbours);
    ASSERT_EQ(k, std::min<size_t>(5, count - 1));
    for (size_t i = 0; i < count; i += 1 + count / 200) {
      const auto distance = [&](size_t j) {
        double sum = 0;
        for (int axis = 0; axis < 3; ++axis) sum += std::pow(scene[i][axis] - scene[j][axis], 2);
        return sum;
      };
      std::vector<double> all;
      for (size_t j = 0; j < count; ++j) {
        if (j != i) all.push_back(distance(j));
      }
      std::sort(all.begin(), all.end());
      std::set<uint32_t> distinct;
      for (size_t j = 0; j < k; ++j) {
        const uint32_t neighbour = after.neighbours[i * k + j];
        ASSERT_LT(neighbour, count);
        EXPECT_NE(neighbour, i);
        distinct.insert(neighbour);
        EXPECT_NEAR(distance(neighbour), all[j], 1e-5 * all[j] + 1e-12);
      }
      EXPECT_EQ(distinct.size(), k);
    }
  }
}

// One Gaussian for each decision.
TEST_P(BackendTest, DensifyDecides) {
  auto scene = RandomScene(6, 31, -2);
  for (auto& g : scene) {
    g[kRefOpacity] = 2;
    g[kRefLogScale] = g[kRefLogScale + 1] = std::log(0.1);
  }
  scene[1][kRefOpacity] = -6;                 // too faint
  scene[2][kRefLogScale] = std::log(0.5);     // to be split
  scene[4][kRefLogScale + 1] = std::log(20);  // too large
  scene[5][kRefDc] = NAN;
  TrainState state;
  state.gaussians = FromReference(scene, 2);
  state.first_moment = FromReference(scene, 2);
  state.first_moment.sh_dc.assign(18, 7);
  state.second_moment = state.first_moment;
  state.gradient_sum = {0.1F, 9, 9, 9, 0, 0};
  state.view_count = {10, 1, 1, 1, 0, 1};
  backend_->SetState(state);
  DensifyStep step;
  step.iteration = 700;
  step.random_seed = 5;
  step.min_gradient = 1;
  step.max_clone_scale = 0.2F;
  step.max_scale = 10;
  const DensifyResult result = backend_->Densify(step);
  EXPECT_EQ(result.cloned, 1);
  EXPECT_EQ(result.split, 1);
  EXPECT_EQ(result.removed, 2);
  EXPECT_EQ(result.not_finite, 1);
  EXPECT_EQ(result.count, 5);
  const TrainState after = backend_->GetState();
  const auto gaussians = ToReference(after.gaussians);
  ASSERT_EQ(gaussians.size(), 5U);
  const auto expect_same = [&](size_t at, size_t original, int first, int last) {
    for (int k = first; k < last; ++k) {
      EXPECT_EQ(gaussians[at][k], static_cast<double>(static_cast<float>(scene[original][k])));
    }
  };
  expect_same(0, 0, 0, kRefCount);
  expect_same(1, 2, kRefRotation, kRefCount);  // the first child
  expect_same(2, 3, 0, kRefCount);
  expect_same(3, 2, kRefRotation, kRefCount);  // the second
  expect_same(4, 3, 0, kRefCount);             // the clone
  for (const size_t child : {1U, 3U}) {
    EXPECT_NEAR(gaussians[child][kRefLogScale], std::log(0.5 / 1.6), 1e-5);
    Eigen::Vector3d offset;
    for (int k = 0; k < 3; ++k) offset[k] = gaussians[child][k] - scene[2][k];
    EXPECT_GT(offset.norm(), 1e-4);
    EXPECT_LT(offset.norm(), 4);
    Eigen::Quaterniond q(scene[2][5], scene[2][6], scene[2][7], scene[2][8]);
    EXPECT_NEAR(q.normalized().toRotationMatrix().col(2).dot(offset), 0, 1e-5);  // within the disc's plane
  }
  EXPECT_NE(gaussians[1][0], gaussians[3][0]);
  for (int c = 0; c < 3; ++c) {
    EXPECT_EQ(after.first_moment.sh_dc[c], 7);
    EXPECT_EQ(after.first_moment.sh_dc[3 + c], 0);
    EXPECT_EQ(after.second_moment.sh_dc[6 + c], 7);
    EXPECT_EQ(after.second_moment.sh_dc[9 + c], 0);
    EXPECT_EQ(after.first_moment.sh_dc[12 + c], 0);
  }
  for (const float sum : after.gradient_sum) EXPECT_EQ(sum, 0);
}

TEST_P(BackendTest, DensifyKeepsTheBoundByGradient) {
  const auto scene = RandomScene(100, 5, -3);
  TrainState state;
  state.gaussians = FromReference(scene, 0);
  for (int i = 0; i < 100; ++i) {
    state.gradient_sum.push_back(static_cast<float>((37 * i) % 100));
    state.view_count.push_back(1);
  }
  backend_->SetState(state);
  DensifyStep step;
  step.iteration = 1;
  step.min_gradient = 10;
  step.max_clone_scale = 1e3F;
  step.min_opacity = 0;
  step.max_count = 110;
  EXPECT_EQ(backend_->Densify(step).count, 110);
  const auto after = ToReference(backend_->GetGaussians());
  std::multiset<double> expected, actual;
  for (int i = 0; i < 100; ++i) {
    if ((37 * i) % 100 >= 90) expected.insert(scene[i][0]);
  }
  for (int i = 100; i < 110; ++i) actual.insert(after[i][0]);
  EXPECT_EQ(actual, expected);
}

TEST_P(BackendTest, OpacityReset) {
  auto scene = RandomScene(4, 5, -3);
  TrainState state;
  state.gaussians = FromReference(scene, 0);
  state.gaussians.opacity_logit = {-9, 0, 3, 9};
  state.first_moment = state.second_moment = state.gaussians;
  backend_->SetState(state);
  backend_->ResetOpacity(0.01F);
  const TrainState after = backend_->GetState();
  EXPECT_EQ(after.gaussians.opacity_logit[0], -9);
  for (int i = 1; i < 4; ++i) EXPECT_NEAR(after.gaussians.opacity_logit[i], std::log(0.01 / 0.99), 1e-5);
  for (int i = 0; i < 4; ++i)
    EXPECT_EQ(after.first_moment.opacity_logit[i] + after.second_moment.opacity_logit[i], 0);
}

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

// The one body by itself, as Render draws it and as its largest weights say.
TEST_P(BackendTest, SeesOneBodyAsItIsDrawn) {
  const PinholeView view = TestView(70, 48);
  TrainState state;
  state.gaussians = FromReference(RandomScene(400, 5, 0), 1);
  for (size_t i = 0; i < state.gaussians.size(); ++i) {
    state.gaussians.foreground_logit[i] = i % 3 == 0 ? 4.0F : -4.0F;
  }
  backend_->SetState(state);
  for (const DrawnBody body : {DrawnBody::kForeground, DrawnBody::kBackground}) {
    constexpr float kMinWeight = 0.1F;
    const BodySight sight = backend_->SeeBody(view, body, kMinWeight);
    const std::vector<float> peaks = backend_->PeakWeights({view}, SceneBodies::kBoth, body);
    ASSERT_EQ(sight.is_seen.size(), state.gaussians.size());
    ASSERT_EQ(peaks.size(), state.gaussians.size());
    int num_seen = 0;
    for (size_t i = 0; i < peaks.size(); ++i) {
      EXPECT_EQ(sight.is_seen[i] != 0, peaks[i] >= kMinWeight) << i;
      const bool is_of_body = (state.gaussians.foreground_logit[i] > 0) == (body == DrawnBody::kForeground);
      EXPECT_TRUE(is_of_body || sight.is_seen[i] == 0) << i;
      num_seen += sight.is_seen[i];
    }
    EXPECT_GT(num_seen, 5);
    EXPECT_LT(num_seen, 100);
    RenderRequest request;
    request.view = view;
    request.freeze_foreground = true;
    request.drawn = body;
    EXPECT_EQ(sight.alpha, backend_->Render(request).alpha);
  }
}

INSTANTIATE_TEST_SUITE_P(Kinds, BackendTest, testing::Values(BackendKind::kCpu, BackendKind::kCuda),
                         [](const auto& info) { return std::string(BackendName(info.param)); });

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
