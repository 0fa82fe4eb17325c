#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/pinhole_view.h"
#include "tests/s2gs/backend/reference_render.h"

namespace s2gs {

/// The backend under test, or null and a reason. Of several GPUs the last one; and they are listed again, as
/// what plans memory does, which must not take the thread to another one.
std::unique_ptr<Backend> TryMakeBackend(BackendKind kind, std::string* reason);

/// Runs each of its tests with both backends; CUDA's are skipped where there is no GPU.
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

/// A camera before the origin whose object is turned and moved a little.
PinholeView TestView(int width, int height);

/// Splats of all sizes about the origin; every fifth is not drawn.
std::vector<ReferenceGaussian> RandomScene(size_t count, uint64_t seed, double mean_log_scale);

/// Noise; three of seven pixels of its mask rotate.
TrainingPhoto RandomPhoto(const PinholeView& view, uint64_t seed);

/// Rounding moves single hits over the cut at alpha = 1/255, so a few pixels may differ by as much.
void ExpectMapNear(const std::vector<float>& actual, const std::vector<double>& expected, double bound,
                   double bound_of_few, const std::string& name);

}  // namespace s2gs
