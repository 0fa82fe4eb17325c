#include "mesh/surface/mesh_error.h"

#include <gtest/gtest.h>
#include <omp.h>

#include <cmath>
#include <limits>
#include <random>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3f;

// The square [0, size]^2 at height z, as two triangles.
TriangleMesh Square(float z, float size = 1) {
  TriangleMesh mesh;
  mesh.vertices = {{0, 0, z}, {size, 0, z}, {size, size, z}, {0, size, z}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  return mesh;
}

// Bands between circles of latitude.
TriangleMesh Sphere(double radius, int num_rings) {
  TriangleMesh mesh;
  const int num_around = 2 * num_rings;
  for (int ring = 0; ring <= num_rings; ++ring) {
    for (int i = 0; i < num_around; ++i) {
      const double polar = kPi * ring / num_rings, azimuth = 2 * kPi * i / num_around;
      mesh.vertices.push_back((radius * Vector3d(std::sin(polar) * std::cos(azimuth),
                                                 std::sin(polar) * std::sin(azimuth), std::cos(polar)))
                                  .cast<float>());
    }
  }
  for (int ring = 0; ring < num_rings; ++ring) {
    for (int i = 0; i < num_around; ++i) {
      const uint32_t a = ring * num_around + i, b = ring * num_around + (i + 1) % num_around;
      mesh.triangles.emplace_back(a, a + num_around, b);
      mesh.triangles.emplace_back(b, a + num_around, b + num_around);
    }
  }
  return mesh;
}

std::vector<Vector3d> RandomPoints(int count, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  std::vector<Vector3d> points;
  for (int i = 0; i < count; ++i) points.emplace_back(normal(random), normal(random), normal(random));
  return points;
}

TEST(SampleSurface, UniformOverTheArea) {
  // Areas 0.5, 1.5 and 3 of three triangles in different planes.
  TriangleMesh mesh;
  mesh.vertices = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {5, 0, 0}, {5, 3, 0},
                   {5, 0, 1}, {9, 0, 0}, {9, 0, 2}, {6, 0, 0}};
  mesh.triangles = {{0, 1, 2}, {3, 4, 5}, {6, 7, 8}};
  constexpr int kCount = 60'000;
  const SurfaceSamples samples = SampleSurface(mesh, kCount, 5, 0);
  EXPECT_NEAR(samples.area, 5, 1e-12);
  ASSERT_EQ(samples.points.size(), static_cast<size_t>(kCount));
  std::vector<Vector3d> sums(3, Vector3d::Zero());
  std::vector<int> counts(3);
  for (const Vector3d& x : samples.points) {
    const int i = x.x() < 2 ? 0 : (x.x() < 5.5 ? 1 : 2);
    // Inside the triangle, by its edges; rounding may put a point an ulp outside.
    const std::vector<bool> is_inside = {
        x.minCoeff() >= 0 && x.x() + x.y() < 1 + 1e-14 && x.z() == 0,
        std::abs(x.x() - 5) < 1e-14 && x.minCoeff() >= 0 && x.y() / 3 + x.z() < 1 + 1e-14,
        x.y() == 0 && x.z() >= 0 && x.x() < 9 + 1e-14 && x.z() / 2 < (x.x() - 6) / 3 + 1e-14};
    ASSERT_TRUE(is_inside[i]) << x.transpose();
    ++counts[i];
    sums[i] += x;
  }
  for (int i = 0; i < 3; ++i) {
    const double share = std::vector<double>{0.1, 0.3, 0.6}[i];
    EXPECT_NEAR(counts[i], kCount * share, 4 * std::sqrt(kCount * share * (1 - share)));
    const Vector3d centroid =
        (mesh.vertices[3 * i] + mesh.vertices[3 * i + 1] + mesh.vertices[3 * i + 2]).cast<double>() / 3;
    // The largest standard deviation of a coordinate is 3 / sqrt(18).
    EXPECT_LT((sums[i] / counts[i] - centroid).cwiseAbs().maxCoeff(), 4 * 3 / std::sqrt(18.0 * counts[i]));
  }
}

TEST(SampleSurface, SameForAnyThreadCountAndOnlyThen) {
  const TriangleMesh mesh = Sphere(1, 10);
  const int num_threads = omp_get_max_threads();
  omp_set_num_threads(1);
  const std::vector<Vector3d> one = SampleSurface(mesh, 1000, 5, 0).points;
  omp_set_num_threads(4);
  const std::vector<Vector3d> four = SampleSurface(mesh, 1000, 5, 0).points;
  omp_set_num_threads(num_threads);
  EXPECT_EQ(one, four);
  EXPECT_NE(one, SampleSurface(mesh, 1000, 6, 0).points);
  EXPECT_NE(one, SampleSurface(mesh, 1000, 5, 1).points);
  // More samples begin with the same ones.
  const std::vector<Vector3d> more = SampleSurface(mesh, 2000, 5, 0).points;
  EXPECT_TRUE(std::equal(one.begin(), one.end(), more.begin()));
}

TEST(SampleSurface, UnusableTrianglesAreNeverDrawn) {
  TriangleMesh mesh = Square(0);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const float infinity = std::numeric_limits<float>::infinity();
  mesh.vertices.insert(mesh.vertices.end(), {{nan, 0, 0}, {0, infinity, 0}, {7, 7, 7}, {8, 8, 8}, {9, 9, 9}});
  mesh.triangles.insert(mesh.triangles.begin(), {{4, 1, 2}, {6, 6, 6}, {6, 7, 8}});
  mesh.triangles.insert(mesh.triangles.end(), {{5, 1, 2}, {6, 6, 7}});
  const SurfaceSamples samples = SampleSurface(mesh, 10'000, 1, 0);
  EXPECT_EQ(samples.num_unusable_triangles, 5);
  EXPECT_DOUBLE_EQ(samples.area, 1);
  for (const Vector3d& x : samples.points) {
    ASSERT_TRUE(x.z() == 0 && x.x() >= 0 && x.x() <= 1 && x.y() >= 0 && x.y() <= 1) << x.transpose();
  }
  mesh.triangles = {{4, 1, 2}, {6, 7, 8}};
  EXPECT_TRUE(SampleSurface(mesh, 100, 1, 0).points.empty());
  EXPECT_TRUE(SampleSurface(TriangleMesh(), 100, 1, 0).points.empty());
  EXPECT_TRUE(SampleSurface(Square(0), 0, 1, 0).points.empty());
}

TEST(NearestDistances, EqualBruteForce) {
  for (const double shift : {0.0, 1e6}) {
    std::vector<Vector3d> points = RandomPoints(700, 1), queries = RandomPoints(300, 2);
    for (Vector3d& x : points) x.x() += shift;
    for (Vector3d& x : queries) x.x() += shift;
    queries.push_back(points[5]);
    const std::vector<double> distances = NearestDistances(queries, points);
    for (size_t i = 0; i < queries.size(); ++i) {
      double nearest = HUGE_VAL;
      for (const Vector3d& x : points) nearest = std::min(nearest, (x - queries[i]).norm());
      EXPECT_NEAR(distances[i], nearest, 1e-14 * std::max(1.0, nearest));
    }
  }
}

TEST(NearestDistances, FewAndEqualPoints) {
  EXPECT_TRUE(NearestDistances({}, {Vector3d::Zero()}).empty());
  EXPECT_EQ(NearestDistances({{3, 4, 0}}, {Vector3d::Zero()}), std::vector<double>{5});
  const std::vector<Vector3d> equal(1000, Vector3d(1, 1, 1));
  EXPECT_EQ(NearestDistances({{1, 1, 3}}, equal), std::vector<double>{2});
  std::vector<Vector3d> line;
  for (int i = 0; i < 1000; ++i) line.emplace_back(i, 0, 0);
  EXPECT_EQ(NearestDistances({{500.25, 0, 0}}, line), std::vector<double>{0.25});
}

TruthSurface Everything(std::vector<Vector3d> points) {
  TruthSurface truth;
  truth.points = points;
  truth.seen_points = std::move(points);
  truth.seen_share = 1;
  return truth;
}

TEST(CompareSamples, EqualsBruteForce) {
  const std::vector<Vector3d> a = RandomPoints(200, 3), b = RandomPoints(300, 4);
  TruthSurface truth = Everything(b);
  truth.seen_points.resize(100);
  double to_truth = 0, to_estimate = 0;
  int num_precise = 0, num_recalled = 0;
  for (const Vector3d& x : a) {
    double nearest = HUGE_VAL;
    for (const Vector3d& y : b) nearest = std::min(nearest, (x - y).norm());
    to_truth += nearest / 200;
    num_precise += nearest < 0.4;
  }
  for (const Vector3d& y : truth.seen_points) {
    double nearest = HUGE_VAL;
    for (const Vector3d& x : a) nearest = std::min(nearest, (x - y).norm());
    to_estimate += nearest / 100;
    num_recalled += nearest < 0.4;
  }
  const SurfaceErrors errors = CompareSamples(a, truth, {0.4}).value();
  EXPECT_NEAR(errors.accuracy, to_truth, 1e-13);
  EXPECT_NEAR(errors.completeness, to_estimate, 1e-13);
  EXPECT_NEAR(errors.chamfer_l1, (to_truth + to_estimate) / 2, 1e-13);
  const double p = num_precise / 200.0, r = num_recalled / 100.0;
  EXPECT_DOUBLE_EQ(errors.f_scores.at(0).precision, p);
  EXPECT_DOUBLE_EQ(errors.f_scores.at(0).recall, r);
  EXPECT_NEAR(errors.f_scores.at(0).f_score, 2 * p * r / (p + r), 1e-15);
}

// Among points of density rho, the nearest one's squared distance within the plane is exponential with mean
// 1 / (pi rho), so a plane at height h is sqrt(h^2 + that) away: h + 1 / (2 pi rho h) for large h, 1 / (2
// sqrt(rho)) for h = 0. The borders of the square add little: the points there have half the neighbours.
TEST(CompareSamples, ParallelPlanes) {
  constexpr int kCount = 100'000;
  const std::vector<Vector3d> estimate = SampleSurface(Square(0), kCount, 1, 0).points;
  for (const double height : {0.0, 0.05}) {
    const std::vector<Vector3d> truth =
        SampleSurface(Square(static_cast<float>(height)), kCount, 1, 1).points;
    const SurfaceErrors errors = CompareSamples(estimate, Everything(truth), {0.04, 0.06}).value();
    const double expected =
        height > 0 ? height + 1 / (2 * kPi * kCount * height) : 1 / (2 * std::sqrt(double{kCount}));
    // Measured: 0.4 % above for h = 0 (borders), 3e-7 otherwise.
    const double tolerance = height > 0 ? 1e-6 : 0.01 * expected;
    EXPECT_NEAR(errors.accuracy, expected, tolerance);
    EXPECT_NEAR(errors.completeness, expected, tolerance);
    EXPECT_NEAR(errors.chamfer_l1, expected, tolerance);
    EXPECT_EQ(errors.f_scores.at(0).f_score, height > 0.04 ? 0 : 1);
    EXPECT_EQ(errors.f_scores.at(1).f_score, 1);
  }
}

TEST(CompareSamples, ConcentricSpheres) {
  constexpr int kCount = 100'000;
  const std::vector<Vector3d> estimate = SampleSurface(Sphere(1.0, 200), kCount, 1, 0).points;
  const std::vector<Vector3d> truth = SampleSurface(Sphere(1.1, 200), kCount, 1, 1).points;
  const SurfaceErrors errors = CompareSamples(estimate, Everything(truth), {0.05, 0.11}).value();
  // As between planes, with the density of the sphere that is measured against; seen from the other sphere,
  // whose normals diverge or converge, a step along it costs more or less height by the ratio of the radii.
  // Measured: both 5e-6 below.
  EXPECT_NEAR(errors.accuracy, 0.1 + (1 / 1.1) * 4 * 1.21 / (2 * kCount * 0.1), 1.5e-5);
  EXPECT_NEAR(errors.completeness, 0.1 + 1.1 * 4 / (2 * kCount * 0.1), 1.5e-5);
  EXPECT_EQ(errors.f_scores.at(0).f_score, 0);
  EXPECT_EQ(errors.f_scores.at(1).f_score, 1);
}

TEST(CompareSamples, NothingToCompare) {
  const std::vector<Vector3d> some = RandomPoints(3, 5);
  EXPECT_FALSE(CompareSamples({}, Everything(some), {1}).has_value());
  EXPECT_FALSE(CompareSamples(some, TruthSurface(), {1}).has_value());
  TruthSurface unseen = Everything(some);
  unseen.seen_points.clear();
  EXPECT_FALSE(CompareSamples(some, unseen, {1}).has_value());
}

EstimatedSurface Estimated(const TriangleMesh& mesh, int count) {
  return {TrianglesInside(mesh, Sim3(), {}), SampleSurface(mesh, count, 1, 0).points};
}

TruthSurface AllOf(const TriangleMesh& mesh, int count) {
  TruthSurface truth = Everything(SampleSurface(mesh, count, 1, 1).points);
  truth.triangles = TrianglesInside(mesh, Sim3(), {});
  return truth;
}

TEST(CompareSurfaces, ParallelPlanesAreTheirHeightApart) {
  for (const float height : {0.0f, 0.0625f}) {
    const SurfaceErrors errors =
        CompareSurfaces(Estimated(Square(0), 1000), AllOf(Square(height), 1000), {0.05, 0.07}).value();
    // Measured: 1e-17.
    EXPECT_NEAR(errors.accuracy, height, 1e-15);
    EXPECT_NEAR(errors.completeness, height, 1e-15);
    EXPECT_NEAR(errors.chamfer_l1, height, 1e-15);
    EXPECT_EQ(errors.f_scores.at(0).f_score, height > 0.05 ? 0 : 1);
    EXPECT_EQ(errors.f_scores.at(1).f_score, 1);
  }
}

// The larger square reaches past the smaller one by 1 on two sides: its points there are max(x - 1, 0) and
// max(y - 1, 0) away, whose mean length over [0, 2]^2 is (2 * 1/2 + J) / 4 with J the mean distance of the
// unit square's points to a corner, (sqrt(2) + asinh(1)) / 3.
TEST(CompareSurfaces, WhatReachesPast) {
  constexpr int kCount = 200'000;
  const SurfaceErrors errors =
      CompareSurfaces(Estimated(Square(0, 2), kCount), AllOf(Square(0, 1), kCount), {0.5}).value();
  const double expected = (1 + (std::sqrt(2.0) + std::asinh(1.0)) / 3) / 4;
  // A point's distance has a standard deviation of .36: four standard errors of the mean.
  EXPECT_NEAR(errors.accuracy, expected, 4 * 0.36 / std::sqrt(double{kCount}));
  EXPECT_LT(errors.completeness, 1e-15);
  EXPECT_NEAR(errors.chamfer_l1, errors.accuracy / 2, 1e-15);
  // Nearer than .5: the unit square, two strips and a quarter of a disc.
  const double precision = (1 + 2 * 0.5 + kPi / 16) / 4;
  EXPECT_NEAR(errors.f_scores.at(0).precision, precision, 4 * 0.5 / std::sqrt(double{kCount}));
  EXPECT_EQ(errors.f_scores.at(0).recall, 1);
}

TEST(CompareSurfaces, ConcentricSpheres) {
  const SurfaceErrors errors =
      CompareSurfaces(Estimated(Sphere(1.0, 200), 20'000), AllOf(Sphere(1.1, 200), 20'000), {}).value();
  // Both meshes lie within 1 - cos(half a cell's diagonal) = 6e-5 of their spheres. Measured: .1000 + 1.0e-5,
  // + 9e-6.
  EXPECT_NEAR(errors.accuracy, 0.1, 7e-5);
  EXPECT_NEAR(errors.completeness, 0.1, 7e-5);
}

TEST(CompareSurfaces, NothingToCompare) {
  const EstimatedSurface estimate = Estimated(Square(0), 10);
  const TruthSurface truth = AllOf(Square(1), 10);
  EXPECT_TRUE(CompareSurfaces(estimate, truth, {}).has_value());
  EXPECT_FALSE(CompareSurfaces({estimate.triangles, {}}, truth, {}).has_value());
  EXPECT_FALSE(CompareSurfaces({{}, estimate.points}, truth, {}).has_value());
  TruthSurface other = truth;
  other.triangles.clear();
  EXPECT_FALSE(CompareSurfaces(estimate, other, {}).has_value());
  other = truth;
  other.seen_points.clear();
  EXPECT_FALSE(CompareSurfaces(estimate, other, {}).has_value());
}

TEST(TrianglesInside, WholeTrianglesThatReachIn) {
  TriangleMesh mesh = Square(0);
  mesh.vertices.insert(mesh.vertices.end(), {{0, 0, 5}, {9, 9, 9}});
  mesh.triangles.insert(mesh.triangles.end(), {{0, 1, 4}, {1, 1, 4}, {5, 5, 5}});
  EXPECT_EQ(TrianglesInside(mesh, Sim3(), {}).size(), 3u);  // without those that have no area.
  CropRegion region;
  region.plane = Eigen::Hyperplane<double, 3>(Vector3d(0, 0, 1), Vector3d(0, 0, 0.5));
  const std::vector<TriangleCorners> above = TrianglesInside(mesh, Sim3(), region);
  ASSERT_EQ(above.size(), 1u);
  EXPECT_EQ(above[0], (TriangleCorners{Vector3d(0, 0, 0), Vector3d(1, 0, 0), Vector3d(0, 0, 5)}));
  // Moved by 10 and doubled, the square lies above the plane too.
  const Sim3 moved{2, Eigen::Quaterniond::Identity(), {0, 0, 10}};
  EXPECT_EQ(TrianglesInside(mesh, moved, region).size(), 3u);
  EXPECT_EQ(TrianglesInside(mesh, moved, region)[2][2], Vector3d(0, 0, 20));
  region.box = Eigen::AlignedBox3d(Vector3d(0, 0, 15), Vector3d(1, 1, 16));
  EXPECT_EQ(TrianglesInside(mesh, moved, region).size(), 1u);
  EXPECT_TRUE(TrianglesInside(mesh, Sim3(), region).empty());
}

TEST(CropRegion, BoxAndPlane) {
  CropRegion region;
  EXPECT_TRUE(region.Contains({1e9, 0, 0}));
  region.plane = Eigen::Hyperplane<double, 3>(Vector3d(0, 0, 1), Vector3d(0, 0, 2));
  EXPECT_FALSE(region.Contains({0, 0, 2}));
  EXPECT_TRUE(region.Contains({1e9, 0, 2.001}));
  region.box = Eigen::AlignedBox3d(Vector3d(0, 0, 0), Vector3d(1, 1, 3));
  EXPECT_FALSE(region.Contains({1e9, 0, 2.5}));
  EXPECT_TRUE(region.Contains({1, 1, 2.5}));
  EXPECT_EQ(Crop({{0, 0, 0}, {1, 1, 3}, {1, 1, 4}}, region), std::vector<Vector3d>{Vector3d(1, 1, 3)});
}

// Looks along +z of the object's frame from z = -1, so that the unit square fills the image at z = 0.
ObjectView FrontView() {
  ObjectView view{20, 20, 20, 20, 0, 0, {}};
  view.cam_from_object.translation = {0, 0, 1};
  return view;
}

TEST(CountViewsSeen, NearerPointsHide) {
  const std::vector<Vector3d> points = {
      {.51, .51, 0}, {.53 * 2, .53 * 2, 1}, {.1, .1, 0.5}, {.1, .1, -2}, {2, .1, 0}};
  // The second lies behind the first, the fourth behind the camera, the fifth outside the image.
  EXPECT_EQ(CountViewsSeen(points, {}, {FrontView()}, 0.1), (std::vector<int>{1, 0, 1, 0, 0}));
  EXPECT_EQ(CountViewsSeen(points, {}, {FrontView()}, 1.1), (std::vector<int>{1, 1, 1, 0, 0}));
  // An occluder in the third one's pixel.
  EXPECT_EQ(CountViewsSeen(points, {{.07, .07, 0}}, {FrontView()}, 0.1), (std::vector<int>{1, 0, 0, 0, 0}));
  const ObjectView view = FrontView();
  EXPECT_EQ(CountViewsSeen(points, {}, {view, view, view}, 0.1), (std::vector<int>{3, 0, 3, 0, 0}));
  EXPECT_EQ(CountViewsSeen(points, {}, {}, 0.1), (std::vector<int>{0, 0, 0, 0, 0}));
}

TEST(MakeTruthSurface, HiddenAndCroppedPartsAreLeftOut) {
  // Two squares one behind the other; the camera sees the front one and, past its edge, nothing of the back
  // one.
  TriangleMesh mesh = Square(0);
  const TriangleMesh back = Square(0.5);
  for (const Vector3f& x : back.vertices) mesh.vertices.push_back(x);
  mesh.triangles.emplace_back(4, 5, 6);
  mesh.triangles.emplace_back(4, 6, 7);
  TruthSurfaceOptions options;
  options.num_samples = 100'000;
  options.max_num_seen_points = 1000;
  options.min_num_views = 1;
  options.depth_tolerance_ratio = 0.01;
  const TruthSurface surface = MakeTruthSurface(mesh, {}, {FrontView()}, {}, options);
  EXPECT_EQ(surface.points.size(), 100'000u);
  EXPECT_EQ(surface.seen_points.size(), 1000u);
  for (const Vector3d& x : surface.seen_points) ASSERT_EQ(x.z(), 0);
  EXPECT_NEAR(surface.seen_share, 0.5, 4 * 0.5 / std::sqrt(1e5));

  options.min_num_views = 2;
  EXPECT_TRUE(MakeTruthSurface(mesh, {}, {FrontView()}, {}, options).seen_points.empty());
  EXPECT_EQ(MakeTruthSurface(mesh, {}, {}, {}, options).seen_share, 1);
  options.min_num_views = 1;
  EXPECT_EQ(MakeTruthSurface(mesh, Square(-0.1f), {FrontView()}, {}, options).seen_points.size(), 0u);

  CropRegion region;
  region.plane = Eigen::Hyperplane<double, 3>(Vector3d(0, 0, 1), Vector3d(0, 0, 0.25));
  const TruthSurface cropped = MakeTruthSurface(mesh, {}, {FrontView()}, region, options);
  ASSERT_FALSE(cropped.points.empty());
  for (const Vector3d& x : cropped.points) ASSERT_NEAR(x.z(), 0.5, 1e-15);
  EXPECT_EQ(surface.triangles.size(), 4u);
  ASSERT_EQ(cropped.triangles.size(), 2u);
  EXPECT_EQ(cropped.triangles[0][1], Vector3d(1, 0, 0.5));
  EXPECT_EQ(cropped.seen_share, 0);
  EXPECT_TRUE(MakeTruthSurface({}, {}, {FrontView()}, {}, options).points.empty());
}

}  // namespace
}  // namespace s2gs
