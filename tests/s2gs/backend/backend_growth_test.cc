#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <set>

#include "tests/s2gs/backend/backend_fixture.h"
#include "tests/s2gs/backend/reference_render.h"

namespace s2gs {
namespace {

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

}  // namespace
}  // namespace s2gs
