#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "s2gs/kernel/adam.h"
#include "s2gs/kernel/foreground.h"
#include "s2gs/kernel/loss.h"
#include "s2gs/kernel/sh.h"
#include "s2gs/kernel/wigner_d.h"
#include "sfm_split/base/angles.h"
#include "tests/s2gs/kernel/kernel_scene.h"
#include "tests/support/measured_bound.h"

namespace s2gs {
namespace {

Mat3<double> RandomRotation(RandomNumbers& random) {
  const Quat<double> q = {random.Normal(), random.Normal(), random.Normal(), random.Normal()};
  return RotationMatrix(q, 1 / std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z));
}

Vec3<double> RandomUnit(RandomNumbers& random) {
  const Eigen::Vector3d d = random.Direction();
  return {d.x(), d.y(), d.z()};
}

// --- Spherical harmonics -----------------------------------------------------------------------------------
TEST(ShBasis, IsOrthonormal) {
  // Exact for these polynomials: equal steps about z, Simpson's rule over z.
  constexpr int kZ = 2000, kPhi = 16;
  std::vector<double> sums(15 * 15);
  for (int i = 0; i <= kZ; ++i) {
    const double z = -1 + 2.0 * i / kZ;
    const double weight = (i == 0 || i == kZ ? 1 : i % 2 == 1 ? 4 : 2) * (2.0 / kZ) / 3 * (2 * kPi / kPhi);
    for (int j = 0; j < kPhi; ++j) {
      const double phi = 2 * kPi * (j + 0.3) / kPhi, ring = std::sqrt(1 - z * z);
      double basis[15];
      ShRestBasis(3, Vec3<double>{ring * std::cos(phi), ring * std::sin(phi), z}, basis);
      for (int a = 0; a < 15; ++a) {
        for (int b = 0; b < 15; ++b) sums[15 * a + b] += weight * basis[a] * basis[b];
      }
    }
  }
  for (int a = 0; a < 15; ++a) {
    for (int b = 0; b < 15; ++b) EXPECT_NEAR(sums[15 * a + b], a == b ? 1 : 0, 1e-9) << a << " " << b;
  }
}

TEST(ShBasis, AdjointEqualsCentralDifferences) {
  RandomNumbers random(1);
  double worst = 0;
  for (int degree = 0; degree <= 3; ++degree) {
    const Vec3<double> d = RandomUnit(random);
    double weights[15];
    for (double& weight : weights) weight = random.Normal();
    const auto value = [&](const Vec3<double>& at) {
      double basis[15] = {}, sum = 0;
      ShRestBasis(degree, at, basis);
      for (int k = 0; k < ShRestCount(degree); ++k) sum += weights[k] * basis[k];
      return sum;
    };
    const Vec3<double> gradient = ShRestBasisAdjoint(degree, d, weights);
    constexpr double kStep = 1e-5;
    const double by[3] = {(value({d.x + kStep, d.y, d.z}) - value({d.x - kStep, d.y, d.z})) / (2 * kStep),
                          (value({d.x, d.y + kStep, d.z}) - value({d.x, d.y - kStep, d.z})) / (2 * kStep),
                          (value({d.x, d.y, d.z + kStep}) - value({d.x, d.y, d.z - kStep})) / (2 * kStep)};
    worst = std::max(
        {worst, std::abs(gradient.x - by[0]), std::abs(gradient.y - by[1]), std::abs(gradient.z - by[2])});
  }
  ExpectWithin(numerics::kAdjoints, "SH colours by the direction, against differences", "double", worst,
               1e-8);
}

// (9): turned coefficients seen from the world, and plain ones seen from the object, are one colour.
template <typename T>
double WignerError(uint64_t seed) {
  RandomNumbers random(seed);
  const Mat3<double> world_from_object = RandomRotation(random);
  const WignerD<T> d(Convert<T>(world_from_object));
  std::array<T, kShRestPerChannel> coefficients{};
  for (T& value : coefficients) value = T(random.Normal());
  const auto turned = d * coefficients;
  const Vec3<double> direction_in_object = RandomUnit(random);
  T plain[15], seen[15];
  ShRestBasis(3, Convert<T>(direction_in_object), plain);
  ShRestBasis(3, Convert<T>(world_from_object * direction_in_object), seen);
  T in_object(0), in_world(0);
  for (int k = 0; k < 15; ++k) {
    in_object += coefficients[k] * plain[k];
    in_world += turned[k] * seen[k];
  }
  return std::abs(static_cast<double>(in_object - in_world));
}

TEST(WignerD, EqualsTurningTheDirection) {
  double worst = 0, worst_float = 0;
  for (uint64_t seed = 0; seed < 200; ++seed) {
    worst = std::max(worst, WignerError<double>(seed));
    worst_float = std::max(worst_float, WignerError<float>(seed));
  }
  ExpectWithin(numerics::kWignerD, "turned coefficients against the turned direction", "double", worst,
               1e-12);
  ExpectWithin(numerics::kWignerD, "turned coefficients against the turned direction", "float", worst_float,
               1e-5);
}

TEST(WignerD, IsARepresentation) {
  RandomNumbers random(3);
  double worst = 0;
  for (int i = 0; i < 20; ++i) {
    const Mat3<double> a = RandomRotation(random), b = RandomRotation(random);
    const WignerD<double> of_a(a), of_b(b), of_ab({a * b.x, a * b.y, a * b.z});
    for (int row = 0; row < 15; ++row) {
      for (int column = 0; column < 15; ++column) {
        double product = 0;
        for (int k = 0; k < 15; ++k) product += of_a(row, k) * of_b(k, column);
        worst = std::max(worst, std::abs(product - of_ab(row, column)));
      }
    }
  }
  ExpectWithin(numerics::kWignerD, "D(a) D(b) against D(a b)", "double", worst, 1e-12);
}

// --- p -----------------------------------------------------------------------------------------------------
TEST(Foreground, ThresholdIsAtTau) {
  EXPECT_FALSE(IsForeground(std::log(4.0) - 1e-9));
  EXPECT_TRUE(IsForeground(std::log(4.0) + 1e-9));
  EXPECT_TRUE(IsForeground(-9.0, ForegroundRule::kObject));
  EXPECT_FALSE(IsForeground(9.0, ForegroundRule::kStatic));
}

// In long double, without any trick.
long double PlainEntropy(long double x) {
  const long double p = 1 / (1 + std::exp(-x)), q = 1 / (1 + std::exp(x));
  return -(p > 0 ? p * std::log(p) : 0) - (q > 0 ? q * std::log(q) : 0);
}
long double PlainKl(long double a, long double b) {
  const long double p = 1 / (1 + std::exp(-a)), q = 1 / (1 + std::exp(a));
  const long double r = 1 / (1 + std::exp(-b)), s = 1 / (1 + std::exp(b));
  return p * std::log(p / r) + q * std::log(q / s);
}

TEST(Foreground, EntropyAtAllLogits) {
  double worst = 0;
  double saturated = 0;
  for (const float sign : {-1.0F, 1.0F}) {
    for (const float magnitude : {0.0F, 0.3F, 5.0F, 20.0F, 28.0F}) {
      const float x = sign * magnitude;
      const auto expected = static_cast<double>(PlainEntropy(x));
      worst = std::max(worst, std::abs(static_cast<double>(EntropyOfLogit(x)) - expected) / expected);
      const double slope = static_cast<double>(PlainEntropy(x + 1e-4L) - PlainEntropy(x - 1e-4L)) / 2e-4;
      EXPECT_NEAR(EntropyOfLogitAdjoint(x), slope, 1e-5 * std::abs(slope) + 1e-13) << x;
    }
    for (const float magnitude : {88.0F, 104.0F, 1e4F, 1e30F}) {
      EXPECT_LT(EntropyOfLogit(sign * magnitude), 1e-30F);
      EXPECT_LT(std::abs(EntropyOfLogitAdjoint(sign * magnitude)), 1e-30F);
    }
    saturated = std::max(saturated, std::abs(static_cast<double>(EntropyOfLogitAdjoint(sign * 1e4F))));
  }
  ExpectWithin(numerics::kLogits, "entropy against long double, relative", "float", worst, 1e-5);
  ExpectWithin(numerics::kLogits, "gradient of the entropy where p is saturated", "float", saturated, 0);
}

TEST(Foreground, KlAtAllLogits) {
  const float kLogits[] = {0, 0.5F, 3, 20, 88, 104, 1e4F};
  double worst = 0;
  double not_finite = 0;
  for (const float sign_a : {-1.0F, 1.0F}) {
    for (const float sign_b : {-1.0F, 1.0F}) {
      for (const float a_size : kLogits) {
        for (const float b_size : kLogits) {
          const float a = sign_a * a_size, b = sign_b * b_size;
          float by_a = 0, by_b = 0;
          KlOfLogitsAdjoint(a, b, &by_a, &by_b);
          for (const float value : {KlOfLogits(a, b), by_a, by_b}) not_finite += std::isfinite(value) ? 0 : 1;
          if (a_size > 30 || b_size > 30) continue;
          const auto expected = static_cast<double>(PlainKl(a, b));
          // Divergences below 1e-9 are those of equal p.
          worst = std::max(
              worst, std::abs(static_cast<double>(KlOfLogits(a, b)) - expected) / std::max(expected, 1e-9));
          const double slope_a = static_cast<double>(PlainKl(a + 1e-4L, b) - PlainKl(a - 1e-4L, b)) / 2e-4;
          const double slope_b = static_cast<double>(PlainKl(a, b + 1e-4L) - PlainKl(a, b - 1e-4L)) / 2e-4;
          EXPECT_NEAR(by_a, slope_a, 1e-5 * std::abs(slope_a) + 1e-9) << a << " " << b;
          EXPECT_NEAR(by_b, slope_b, 1e-5 * std::abs(slope_b) + 1e-9) << a << " " << b;
        }
      }
    }
  }
  float by_a = 1, by_b = 1;
  KlOfLogitsAdjoint(1e4F, 1e4F, &by_a, &by_b);
  ExpectWithin(numerics::kLogits, "KL against long double, relative", "float", worst, 1e-5);
  ExpectWithin(numerics::kLogits, "values of KL and its gradient that are not finite", "float", not_finite,
               0);
  ExpectWithin(numerics::kLogits, "gradient of KL where both p are saturated", "float",
               static_cast<double>(std::max(std::abs(by_a), std::abs(by_b))), 0);
}

TEST(Foreground, MapTermsAtTheEdges) {
  for (const float p : {-1e-7F, 0.0F, 1e-7F, 0.5F, 1.0F, 1.0000002F}) {
    EXPECT_TRUE(std::isfinite(EntropyOfProbability(p)) && std::isfinite(EntropyOfProbabilityAdjoint(p)));
    for (const bool inside : {false, true}) {
      EXPECT_TRUE(std::isfinite(MaskCrossEntropy(p, inside)) &&
                  std::isfinite(MaskCrossEntropyAdjoint(p, inside)));
    }
  }
  for (const double p : {0.01, 0.3, 0.97}) {
    constexpr double kStep = 1e-6;
    const auto slope = [&](const auto& of) { return (of(p + kStep) - of(p - kStep)) / (2 * kStep); };
    EXPECT_NEAR(EntropyOfProbabilityAdjoint(p), slope([](double x) { return EntropyOfProbability(x); }),
                1e-6);
    for (const bool inside : {false, true}) {
      EXPECT_NEAR(MaskCrossEntropyAdjoint(p, inside),
                  slope([&](double x) { return MaskCrossEntropy(x, inside); }), 1e-5);
    }
  }
}

// --- Image losses ------------------------------------------------------------------------------------------
TEST(Ssim, PartialDerivativesEqualCentralDifferences) {
  RandomNumbers random(4);
  double worst = 0;
  for (int i = 0; i < 100; ++i) {
    double m[5] = {random.Uniform(), random.Uniform(), 0, 0, 0};
    m[2] = m[0] * m[0] + 0.05 * random.Uniform();
    m[3] = m[1] * m[1] + 0.05 * random.Uniform();
    m[4] = m[0] * m[1] + 0.02 * random.Normal();
    const auto value = [&](int which, double by) {
      double moved[5] = {m[0], m[1], m[2], m[3], m[4]};
      moved[which] += by;
      return ComputeSsimPoint(moved[0], moved[1], moved[2], moved[3], moved[4]).value;
    };
    const auto slope = [&](int which) { return (value(which, 1e-6) - value(which, -1e-6)) / 2e-6; };
    const SsimPoint<double> point = ComputeSsimPoint(m[0], m[1], m[2], m[3], m[4]);
    // Differences over 1e-6 have 1e-7 of rounding in themselves where the slope is 10.
    for (const auto& [by, which] :
         {std::pair(point.by_mean, 0), std::pair(point.by_square, 2), std::pair(point.by_product, 4)}) {
      worst = std::max(worst, std::abs(by - slope(which)) / (1 + std::abs(slope(which))));
    }
  }
  ExpectWithin(numerics::kAdjoints, "SSIM, against differences", "double", worst, 1e-6);
  double sum = 0;
  for (int i = 0; i < kSsimWindow; ++i) sum += SsimWeight<double>(i);
  EXPECT_NEAR(sum, 1, 1e-14);
}

TEST(NormalFromDepth, OfAPlaneAndItsAdjoint) {
  RandomNumbers random(6);
  double worst = 0;
  constexpr double fx = 70, fy = 60, cx = 30, cy = 20;
  for (int i = 0; i < 50; ++i) {
    Eigen::Vector3d n = random.Direction();
    if (n.z() > 0) n = -n;
    if (n.z() > -0.3) continue;
    const double px = random.Uniform(0, 60), py = random.Uniform(0, 40);
    const auto depth_at = [&](double x, double y) {
      return 3 * n.z() / n.dot(Eigen::Vector3d((x - cx) / fx, (y - cy) / fy, 1));
    };
    DepthStencil<double> z = {depth_at(px - 1, py), depth_at(px + 1, py), depth_at(px, py - 1),
                              depth_at(px, py + 1)};
    if (z.left < 0 || z.right < 0 || z.up < 0 || z.down < 0) continue;
    Vec3<double> normal{};
    double length = 0;
    ASSERT_TRUE(NormalFromDepth(z, px, py, fx, fy, cx, cy, &normal, &length));
    EXPECT_NEAR(normal.x, n.x(), 1e-9);
    EXPECT_NEAR(normal.y, n.y(), 1e-9);
    EXPECT_NEAR(normal.z, n.z(), 1e-9);
    const Vec3<double> weights = {random.Normal(), random.Normal(), random.Normal()};
    const DepthStencil<double> d = NormalFromDepthAdjoint(z, px, py, fx, fy, cx, cy, normal, length, weights);
    double DepthStencil<double>::*const kFields[] = {&DepthStencil<double>::left,
                                                     &DepthStencil<double>::right, &DepthStencil<double>::up,
                                                     &DepthStencil<double>::down};
    for (const auto field : kFields) {
      const auto value = [&](double by) {
        DepthStencil<double> moved = z;
        moved.*field += by;
        Vec3<double> result{};
        double unused = 0;
        NormalFromDepth(moved, px, py, fx, fy, cx, cy, &result, &unused);
        return Dot(result, weights);
      };
      worst = std::max(worst,
                       std::abs(d.*field - (value(1e-6) - value(-1e-6)) / 2e-6) / (1 + std::abs(d.*field)));
    }
  }
  ExpectWithin(numerics::kAdjoints, "normals of a depth map, against differences", "double", worst, 1e-6);
}

// --- Adam --------------------------------------------------------------------------------------------------
TEST(Adam, EqualsItsDefinition) {
  RandomNumbers random(8);
  double x = 1, m = 0, v = 0, own_x = 1, own_m = 0, own_v = 0;
  for (int t = 1; t <= 50; ++t) {
    const double g = random.Normal();
    own_m = 0.9 * own_m + 0.1 * g;
    own_v = 0.999 * own_v + 0.001 * g * g;
    own_x -= 0.01 * (own_m / (1 - std::pow(0.9, t))) / (std::sqrt(own_v / (1 - std::pow(0.999, t))) + 1e-15);
    UpdateByAdam(MakeAdamStep<double>(t), 0.01, g, &x, &m, &v);
    EXPECT_NEAR(x, own_x, 1e-12);
  }
}

TEST(Adam, HostileGradientsLeaveNumbers) {
  double not_finite = 0;
  for (const float g : {NAN, INFINITY, -INFINITY, 1e38F, -1e38F, 1e-44F}) {
    float x = 1, m = 0.5F, v = 0.25F;
    for (int t = 1; t < 5; ++t) UpdateByAdam(MakeAdamStep<float>(t), 0.1F, g, &x, &m, &v);
    for (const float value : {x, m, v}) not_finite += std::isfinite(value) ? 0 : 1;
  }
  ExpectWithin(numerics::kHostileInput, "Adam's parameters and moments that are not finite", "float",
               not_finite, 0);
}

// --- Bounds ------------------------------------------------------------------------------------------------
struct BoundCounts {
  int visible = 0, outside = 0, outside_tile = 0, outside_pixels = 0, in_rect = 0, in_tiles = 0,
      in_pixels = 0, hit = 0;
};

// Compares the rectangle, the tile test and the rows of pixels with every pixel. `outside`: pixels hit that
// the bounds exclude.
BoundCounts CheckBounds(const SurfelParameters<float>& g, const SplatCamera<float>& camera) {
  BoundCounts counts;
  Surfel<float> surfel;
  Footprint<float> footprint;
  if (!TransformSurfel(g, camera, ForegroundRule::kStatic, &surfel)) return counts;
  if (!ComputeFootprint(surfel, camera, &footprint)) return counts;
  PixelRect rect{};
  const bool is_bounded = BoundSplat(surfel, footprint, camera, &rect);
  if (!is_bounded) rect = {0, 0, 0, 0};
  counts.visible = is_bounded ? 1 : 0;
  constexpr int kBlock = 4;
  const float cutoff2 = CutoffSquaredRadius(surfel.opacity);
  for (int y0 = 0; y0 < camera.height; y0 += kBlock) {
    for (int x0 = 0; x0 < camera.width; x0 += kBlock) {
      const bool reaches =
          ReachesRect(footprint, cutoff2, static_cast<float>(x0) + 0.5F, static_cast<float>(y0) + 0.5F,
                      static_cast<float>(x0 + kBlock) - 0.5F, static_cast<float>(y0 + kBlock) - 0.5F);
      for (int y = y0; y < std::min(y0 + kBlock, camera.height); ++y) {
        for (int x = x0; x < std::min(x0 + kBlock, camera.width); ++x) {
          PixelHit<float> hit;
          const bool is_hit = HitSplat(footprint, surfel.opacity, static_cast<float>(x) + 0.5F,
                                       static_cast<float>(y) + 0.5F, camera.near_depth, &hit);
          const bool in_rect = x >= rect.x_begin && x < rect.x_end && y >= rect.y_begin && y < rect.y_end;
          const int x8 = x / 8 * 8, y4 = y / 4 * 4;
          const uint32_t pixels =
              PixelsMayHit(footprint, cutoff2, static_cast<float>(x8) + 0.5F, static_cast<float>(y4) + 0.5F);
          const bool in_pixels = (pixels >> (8 * (y - y4) + x - x8) & 1U) != 0;
          counts.in_pixels += in_pixels ? 1 : 0;
          counts.in_rect += in_rect ? 1 : 0;
          counts.in_tiles += reaches ? 1 : 0;
          if (!is_hit) continue;
          ++counts.hit;
          EXPECT_TRUE(std::isfinite(hit.alpha) && std::isfinite(hit.depth));
          counts.outside += in_rect ? 0 : 1;
          counts.outside_tile += reaches ? 0 : 1;
          counts.outside_pixels += in_pixels ? 0 : 1;
        }
      }
    }
  }
  return counts;
}

TEST(Bounds, HoldEveryPixelThatIsHit) {
  RandomNumbers random(10);
  auto camera = Convert<float>(KernelCamera(random));
  BoundCounts total;
  for (int i = 0; i < 3000; ++i) {
    SurfelParameters<double> g = RandomSurfel(random);
    // Every second disc is so large and near that it passes through the camera's plane.
    if (i % 2 == 1) g.log_scale = {random.Uniform(-1, 4), random.Uniform(-1, 4)};
    if (i % 2 == 1) g.centre.z -= random.Uniform(0, 3.9);
    g.opacity_logit = random.Uniform(-6, 6);
    const SurfelParameters<float> single = {
        {static_cast<float>(g.centre.x), static_cast<float>(g.centre.y), static_cast<float>(g.centre.z)},
        {static_cast<float>(g.log_scale.x), static_cast<float>(g.log_scale.y)},
        {static_cast<float>(g.rotation.w), static_cast<float>(g.rotation.x), static_cast<float>(g.rotation.y),
         static_cast<float>(g.rotation.z)},
        static_cast<float>(g.opacity_logit),
        static_cast<float>(g.foreground_logit)};
    const BoundCounts counts = CheckBounds(single, camera);
    total.visible += counts.visible;
    total.outside += counts.outside;
    total.outside_tile += counts.outside_tile;
    total.outside_pixels += counts.outside_pixels;
    if (i % 2 == 0) {
      total.in_rect += counts.in_rect;
      total.in_tiles += counts.in_tiles;
      total.in_pixels += counts.in_pixels;
      total.hit += counts.hit;
    }
  }
  EXPECT_GT(total.visible, 1500);
  ExpectWithin(numerics::kEdgeOn, "pixels hit outside the splat's rectangle, 3,000 splats", "float",
               total.outside, 0);
  ExpectWithin(numerics::kEdgeOn, "pixels hit outside the splat's tiles, 3,000 splats", "float",
               total.outside_tile, 0);
  ExpectWithin(numerics::kEdgeOn, "pixels hit outside the splat's rows of pixels, 3,000 splats", "float",
               total.outside_pixels, 0);
  // Tight: an ellipse fills pi / 4 of an upright rectangle about it, less when it lies askew.
  EXPECT_GT(total.hit, 0.5 * total.in_rect);
  // Of the pixels of blocks of 4 x 4 that are reached 65 % are hit: splats are small, and blocks lie across
  // their borders.
  EXPECT_GT(total.hit, 0.62 * total.in_tiles);
  // Of the pixels of a row's bounds 99.8 % are hit.
  EXPECT_GT(total.hit, 0.99 * total.in_pixels);
}

// From 89 to 90 degrees in steps of a thousandth, and in all sizes.
TEST(Bounds, EdgeOnDiscsStayFinite) {
  RandomNumbers random(12);
  auto camera = Convert<float>(KernelCamera(random));
  camera.cam_from_world_rotation = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  camera.cam_from_world_translation = {0, 0, 4};
  int visible = 0;
  double not_finite = 0;
  double steepest = 0;
  for (const float log_scale : {-80.0F, -5.0F, 0.0F, 5.0F, 80.0F}) {
    for (int i = 0; i <= 1000; i += log_scale == 0 ? 1 : 50) {
      const auto half = static_cast<float>((89 + i * 1e-3) * kPi / 360);
      SurfelParameters<float> g{};
      g.rotation = {std::cos(half), std::sin(half), 0, 0};
      g.log_scale = {log_scale, log_scale};
      g.opacity_logit = 2;
      const BoundCounts counts = CheckBounds(g, camera);
      visible += counts.visible;
      EXPECT_EQ(counts.outside + counts.outside_tile + counts.outside_pixels, 0) << log_scale << " " << i;
      Surfel<float> surfel;
      Footprint<float> footprint;
      ASSERT_TRUE(TransformSurfel(g, camera, ForegroundRule::kStatic, &surfel));
      ASSERT_TRUE(ComputeFootprint(surfel, camera, &footprint));
      Footprint<float> d{};
      d.u = d.v = d.w = d.centre = {1, 1};
      d.depth = 1;
      Surfel<float> d_surfel{};
      ComputeFootprintAdjoint(surfel, camera, footprint, d, &d_surfel);
      for (const float value : {d_surfel.centre.x, d_surfel.centre.y, d_surfel.centre.z, d_surfel.axis_u.x,
                                d_surfel.axis_v.y, d_surfel.log_scale.x, d_surfel.log_scale.y}) {
        not_finite += std::isfinite(value) ? 0 : 1;
      }
      if (log_scale == 0) {
        for (const float value : {d_surfel.axis_u.x, d_surfel.axis_u.y, d_surfel.axis_u.z, d_surfel.axis_v.x,
                                  d_surfel.axis_v.y, d_surfel.axis_v.z}) {
          steepest = std::max(steepest, std::abs(static_cast<double>(value)));
        }
      }
    }
  }
  EXPECT_GT(visible, 1000);
  ExpectWithin(numerics::kEdgeOn, "derivatives that are not finite, 89 to 90 degrees", "float", not_finite,
               0);
  // Each of the footprint's six terms weighs 1; at |c| = 4 they are four of |c| / f and two of 1 / f over the
  // cosine squared, whose least is kMinCosine.
  ExpectWithin(numerics::kEdgeOn, "largest derivative by a disc's axes over its cap", "float",
               steepest / (18 / 55.0 / (kMinCosine * kMinCosine)), 1);
}

// The low-pass branch has the centre's depth, not that of the plane extrapolated to the pixel.
TEST(Bounds, LowPassBranchHasTheCentresDepth) {
  RandomNumbers random(14);
  const SplatCamera<double> camera = KernelCamera(random);
  SurfelParameters<double> g = RandomSurfel(random);
  g.centre = {0, 0, 0};
  g.log_scale = {-12, -12};
  g.opacity_logit = 3;
  Surfel<double> surfel;
  Footprint<double> footprint;
  ASSERT_TRUE(TransformSurfel(g, camera, ForegroundRule::kStatic, &surfel));
  ASSERT_TRUE(ComputeFootprint(surfel, camera, &footprint));
  PixelHit<double> hit;
  ASSERT_TRUE(HitSplat(footprint, surfel.opacity, footprint.centre.x + 0.7, footprint.centre.y - 0.3,
                       camera.near_depth, &hit));
  EXPECT_TRUE(hit.is_low_pass);
  EXPECT_EQ(hit.depth, surfel.centre.z);
}

// A scene a thousand times larger or smaller, its near plane with it, is the same image.
TEST(Bounds, ScaleOfTheSceneDoesNotMatter) {
  RandomNumbers random(16);
  double worst = 0;
  const SplatCamera<double> camera = KernelCamera(random);
  for (int i = 0; i < 200; ++i) {
    const SurfelParameters<double> g = RandomSurfel(random);
    Surfel<double> surfel;
    Footprint<double> footprint;
    if (!TransformSurfel(g, camera, ForegroundRule::kSoft, &surfel)) continue;
    ASSERT_TRUE(ComputeFootprint(surfel, camera, &footprint));
    for (const double scale : {1e-3, 1e3}) {
      SplatCamera<float> scaled = Convert<float>(camera);
      scaled.near_depth = static_cast<float>(scale * camera.near_depth);
      scaled.cam_from_world_translation = Convert<float>(scale * camera.cam_from_world_translation);
      scaled.cam_from_object_translation = Convert<float>(scale * camera.cam_from_object_translation);
      const SurfelParameters<float> h = {Convert<float>(scale * g.centre),
                                         {static_cast<float>(g.log_scale.x + std::log(scale)),
                                          static_cast<float>(g.log_scale.y + std::log(scale))},
                                         {static_cast<float>(g.rotation.w), static_cast<float>(g.rotation.x),
                                          static_cast<float>(g.rotation.y), static_cast<float>(g.rotation.z)},
                                         static_cast<float>(g.opacity_logit),
                                         static_cast<float>(g.foreground_logit)};
      Surfel<float> other;
      Footprint<float> single;
      ASSERT_TRUE(TransformSurfel(h, scaled, ForegroundRule::kSoft, &other));
      ASSERT_TRUE(ComputeFootprint(other, scaled, &single));
      for (double x = 4.5; x < 48; x += 5) {
        PixelHit<double> a;
        PixelHit<float> b;
        const double y = 36 - 0.7 * x;
        HitSplat(footprint, surfel.opacity, x, y, camera.near_depth, &a);
        HitSplat(single, other.opacity, static_cast<float>(x), static_cast<float>(y), scaled.near_depth, &b);
        worst = std::max(worst, std::abs(static_cast<double>(b.alpha) - a.alpha));
      }
    }
  }
  ExpectWithin(numerics::kScaleAndPlace, "alpha of single splats, lengths x 1e-3 and 1e3", "float", worst,
               1e-4);
}

}  // namespace
}  // namespace s2gs
