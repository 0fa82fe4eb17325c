#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "s2gs/scene/scene_lengths.h"
#include "sfm_split/base/angles.h"
#include "tests/s2gs/backend/backend_fixture.h"
#include "tests/s2gs/backend/reference_render.h"
#include "tests/s2gs/usual_step.h"
#include "tests/support/measured_bound.h"

namespace s2gs {
namespace {

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
// Lengths are normalised in double before anything else (s2gs/scene/training_scene.h).
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

}  // namespace
}  // namespace s2gs
