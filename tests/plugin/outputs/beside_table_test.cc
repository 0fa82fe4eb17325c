#include "plugin/outputs/beside_table.h"

#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <set>
#include <vector>

#include "sfm_split/base/angles.h"
#include "tests/s2gs/backend/reference_render.h"

namespace s2gs {
namespace {

constexpr double kApart = 0.05;

ReferenceGaussian Splat(const Eigen::Vector3d& x, const Eigen::Vector3d& normal) {
  ReferenceGaussian g{};
  for (int i = 0; i < 3; ++i) g[kRefCentre + i] = x[i];
  g[kRefLogScale] = g[kRefLogScale + 1] = std::log(kApart / 2);
  const Eigen::Quaterniond q = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), normal);
  g[kRefRotation] = q.w();
  for (int i = 0; i < 3; ++i) g[kRefRotation + 1 + i] = q.vec()[i];
  g[kRefOpacity] = 8;
  g[kRefForeground] = 10;
  return g;
}

// A can on a square table, all of which turns.
std::vector<ReferenceGaussian> CanOnTable() {
  std::vector<ReferenceGaussian> splats;
  for (int i = -20; i <= 20; ++i) {
    for (int j = -20; j <= 20; ++j) {
      splats.push_back(Splat({i * kApart, j * kApart, 0}, Eigen::Vector3d::UnitZ()));
      if (std::hypot(i, j) < 8)
        splats.push_back(Splat({i * kApart, j * kApart, 0.8}, Eigen::Vector3d::UnitZ()));
    }
  }
  for (int i = 0; i < 50; ++i) {
    const Eigen::Vector3d outwards(std::cos(2 * kPi * i / 50), std::sin(2 * kPi * i / 50), 0);
    for (int j = 0; j <= 16; ++j) {
      splats.push_back(Splat(0.4 * outwards + j * kApart * Eigen::Vector3d::UnitZ(), outwards));
    }
  }
  return splats;
}

// A wall below the table's edges, seen from outside. \param sides  of four.
std::vector<ReferenceGaussian> Wall(int sides, double top, double depth) {
  std::vector<ReferenceGaussian> splats;
  for (int side = 0; side < sides; ++side) {
    const Eigen::AngleAxisd turn(side * kPi / 2, Eigen::Vector3d::UnitZ());
    for (int i = -20; i <= 20; ++i) {
      for (double z = top; z > top - depth; z -= kApart) {
        splats.push_back(Splat(turn * Eigen::Vector3d(1, i * kApart, z), turn * Eigen::Vector3d::UnitX()));
      }
    }
  }
  return splats;
}

// Photos from 30 degrees above the table while it turns.
TrainingScene SceneOf() {
  TrainingScene scene;
  scene.mode = TrainMode::kS2gs;
  scene.axis = TurntableAxis();
  constexpr int kPhotos = 12;
  for (int i = 0; i < kPhotos; ++i) {
    ScenePhoto photo;
    PinholeView& view = photo.view;
    view.width = view.height = 160;
    view.fx = view.fy = 200;
    view.cx = view.cy = 80;
    const double azimuth = 2 * kPi * i / kPhotos;
    const Eigen::Vector3d back(std::cos(azimuth) * std::sqrt(0.75), std::sin(azimuth) * std::sqrt(0.75), 0.5);
    Eigen::Matrix3d rotation;
    rotation.row(2) = -back;
    rotation.row(0) = Eigen::Vector3d::UnitZ().cross(back).normalized();
    rotation.row(1) = rotation.row(2).cross(rotation.row(0));
    view.cam_from_world = view.cam_from_object = {Eigen::Quaterniond(rotation), {0, 0, 4}};
    scene.photos.push_back(photo);
  }
  return scene;
}

std::vector<uint32_t> BesideIn(const std::vector<ReferenceGaussian>& splats) {
  const std::unique_ptr<Backend> backend = MakeCpuBackend(1);
  TrainState state;
  state.gaussians = FromReference(splats, 0);
  backend->SetState(state);
  Reporter reporter;
  return FindRotatingBesideTable(SceneOf(), backend.get(), reporter);
}

std::vector<ReferenceGaussian> With(std::vector<ReferenceGaussian> splats,
                                    const std::vector<ReferenceGaussian>& more) {
  splats.insert(splats.end(), more.begin(), more.end());
  return splats;
}

TEST(BesideTable, NothingOfATableAndWhatStandsOnIt) { EXPECT_TRUE(BesideIn(CanOnTable()).empty()); }

TEST(BesideTable, AFlapOfGroundBelowOneEdge) {
  const std::vector<ReferenceGaussian> splats = With(CanOnTable(), Wall(1, -kApart, 0.5));
  const std::vector<uint32_t> found = BesideIn(splats);
  const std::set<uint32_t> beside(found.begin(), found.end());
  for (uint32_t i = 0; i < splats.size(); ++i) {
    // Between the table and three rows of splats below it either is right.
    const double z = splats[i][kRefCentre + 2];
    if (z > -0.01) EXPECT_EQ(beside.count(i), 0U) << z;
    if (z < -0.16) EXPECT_EQ(beside.count(i), 1U) << z;
  }
}

TEST(BesideTable, TheSideOfABodyIsItsOwn) {
  EXPECT_TRUE(BesideIn(With(CanOnTable(), Wall(4, -kApart, 0.3))).empty());
}

TEST(BesideTable, WhatFloatsClearOfTheObject) {
  std::vector<ReferenceGaussian> flap;
  for (int i = -4; i <= 4; ++i) {
    for (int j = -4; j <= 4; ++j) {
      flap.push_back(Splat({0.8 + i * kApart, j * kApart, 1.2}, Eigen::Vector3d::UnitZ()));
    }
  }
  const std::vector<ReferenceGaussian> splats = CanOnTable();
  const std::vector<uint32_t> beside = BesideIn(With(splats, flap));
  ASSERT_EQ(beside.size(), flap.size());
  EXPECT_EQ(beside.front(), splats.size());
}

TEST(BesideTable, NothingWithoutATableOrAnAxisOrFromSeveralStations) {
  EXPECT_TRUE(BesideIn(Wall(4, 1, 1)).empty());
  const std::unique_ptr<Backend> backend = MakeCpuBackend(1);
  TrainState state;
  state.gaussians = FromReference(With(CanOnTable(), Wall(1, -kApart, 0.5)), 0);
  backend->SetState(state);
  Reporter reporter;
  TrainingScene scene = SceneOf();
  scene.photos[0].station = 1;
  EXPECT_TRUE(FindRotatingBesideTable(scene, backend.get(), reporter).empty());
  scene = SceneOf();
  EXPECT_FALSE(FindRotatingBesideTable(scene, backend.get(), reporter).empty());
  scene.axis.reset();
  EXPECT_TRUE(FindRotatingBesideTable(scene, backend.get(), reporter).empty());
}

}  // namespace
}  // namespace s2gs
