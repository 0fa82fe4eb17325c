#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <memory>
#include <string>

#include "s2gs/scene/training_scene.h"
#include "tests/s2gs/backend/backend_fixture.h"
#include "tests/s2gs/backend/reference_render.h"
#include "tests/support/measured_bound.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

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

// Drawing on the CPU is long enough to be stopped: where room is made, where splats are projected, listed and
// drawn, and where the view is copied. Whenever one thread hears it, it asks no more, and leaves everything
// as it was.
TEST_P(BackendTest, DrawingHearsAStop) {
  if (GetParam() != BackendKind::kCpu) GTEST_SKIP() << "views are drawn at once there";
  TrainState state;
  state.gaussians = FromReference(RandomScene(50, 3, -2), 3);
  RenderRequest request;
  request.view = TestView(100, 90);  // 7 x 6 tiles
  request.geometry = true;
  const auto fresh = [&] {
    std::unique_ptr<Backend> backend = MakeCpuBackend(1);
    backend->SetState(state);
    return backend;
  };
  const std::unique_ptr<Backend> backend = fresh();
  int num_asked = 0;
  request.stop_requested = [&] { return ++num_asked < 0; };
  const RenderedView whole = backend->Render(request);
  const int num_looks = num_asked;
  EXPECT_GE(num_looks, 2 + 1 + 6 + 7 * 6 + 90);  // room, splats, rows of tiles, tiles, rows of pixels
  for (int at = 1; at <= num_looks; ++at) {
    const std::unique_ptr<Backend> stopped = fresh();
    num_asked = 0;
    request.stop_requested = [&] { return ++num_asked == at; };
    EXPECT_THROW(stopped->Render(request), Interrupted) << at;
    EXPECT_EQ(num_asked, at);
    request.stop_requested = nullptr;
    EXPECT_EQ(stopped->Render(request).color, whole.color);
  }
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

}  // namespace
}  // namespace s2gs
