#include "tests/s2gs/backend/backend_fixture.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "s2gs/core/gpu_info.h"
#include "tests/support/random_numbers.h"

namespace s2gs {

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

INSTANTIATE_TEST_SUITE_P(Kinds, BackendTest, testing::Values(BackendKind::kCpu, BackendKind::kCuda),
                         [](const auto& info) { return std::string(BackendName(info.param)); });

}  // namespace s2gs
