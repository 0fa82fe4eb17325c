#include "mesh/texture/charts.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "mesh/light/mesh_raster.h"
#include "mesh/surface/vertex_normals.h"
#include "mesh/texture/pack_rectangles.h"
#include "mesh/texture/page_fill.h"
#include "sfm_split/base/angles.h"
#include "tests/mesh/texture/box_photos.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

// A ring with folds around its tube, rough by noise on its vertices.
TriangleMesh RoughRing(double noise) {
  constexpr int kAround = 120;
  constexpr int kTube = 60;
  TriangleMesh mesh;
  RandomNumbers random(11);
  for (int i = 0; i < kAround; ++i) {
    for (int j = 0; j < kTube; ++j) {
      const double a = 2 * kPi * i / kAround;
      const double b = 2 * kPi * j / kTube;
      const double radius = 0.4 + 0.1 * std::sin(9 * b) + random.Uniform(-noise, noise);
      mesh.vertices.push_back(Eigen::Vector3d((1 + radius * std::cos(b)) * std::cos(a),
                                              (1 + radius * std::cos(b)) * std::sin(a), radius * std::sin(b))
                                  .cast<float>());
    }
  }
  const auto at = [](int i, int j) { return static_cast<uint32_t>((i % kAround) * kTube + j % kTube); };
  for (int i = 0; i < kAround; ++i) {
    for (int j = 0; j < kTube; ++j) {
      mesh.triangles.emplace_back(at(i, j), at(i + 1, j), at(i + 1, j + 1));
      mesh.triangles.emplace_back(at(i, j), at(i + 1, j + 1), at(i, j + 1));
    }
  }
  ComputeNormals(&mesh);
  return mesh;
}

double SignedArea(const Eigen::Vector2f& a, const Eigen::Vector2f& b, const Eigen::Vector2f& c) {
  const Eigen::Vector2d e = (b - a).cast<double>();
  const Eigen::Vector2d f = (c - a).cast<double>();
  return (e.x() * f.y() - e.y() * f.x()) / 2;
}

TEST(Charts, EveryTriangleOnceAndNoneOverAnother) {
  for (const double noise : {0.0, 0.01}) {
    const TriangleMesh mesh = RoughRing(noise);
    constexpr double kTexel = 0.004;
    const std::vector<Chart> charts = MakeCharts(mesh, {kTexel, 4, 8192});
    std::vector<int> uses(mesh.triangles.size(), 0);
    int64_t num_doubly = 0;
    int64_t num_covered = 0;
    int64_t num_turned = 0;
    for (const Chart& chart : charts) {
      // The middles of the triangles over each texel.
      std::vector<std::vector<Eigen::Vector3f>> covered(static_cast<size_t>(chart.width) * chart.height);
      for (const uint32_t t : chart.triangles) {
        ++uses[t];
        std::vector<Eigen::Vector2f> corners;
        for (int i = 0; i < 3; ++i) {
          corners.push_back(chart.Project(mesh.vertices[mesh.triangles[t][i]]));
          // The gutter's width from the border, or more.
          EXPECT_GE(corners.back().minCoeff(), 4.0F);
          EXPECT_LE(corners.back().x(), static_cast<float>(chart.width - 4));
          EXPECT_LE(corners.back().y(), static_cast<float>(chart.height - 4));
        }
        // Counter-clockwise from outside is clockwise where y points down, which has a negative area here.
        const double area = SignedArea(corners[0], corners[1], corners[2]);
        num_turned += area > 1e-6 ? 1 : 0;
        for (int y = 0; y < chart.height; ++y) {
          const auto low = std::min({corners[0].y(), corners[1].y(), corners[2].y()});
          const auto high = std::max({corners[0].y(), corners[1].y(), corners[2].y()});
          if (static_cast<float>(y) + 1 < low || static_cast<float>(y) > high) continue;
          for (int x = 0; x < chart.width; ++x) {
            const Eigen::Vector2f centre(static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F);
            const double u = SignedArea(centre, corners[1], corners[2]) / area;
            const double v = SignedArea(centre, corners[2], corners[0]) / area;
            if (u > 2e-3 && v > 2e-3 && 1 - u - v > 2e-3) {
              const Triangle& t3 = mesh.triangles[t];
              covered[static_cast<size_t>(y) * chart.width + x].push_back(
                  (mesh.vertices[t3[0]] + mesh.vertices[t3[1]] + mesh.vertices[t3[2]]) / 3);
            }
          }
        }
      }
      for (const auto& middles : covered) {
        num_covered += middles.empty() ? 0 : 1;
        for (const Eigen::Vector3f& middle : middles) {
          num_doubly += (middle - middles[0]).norm() > 4.1F * static_cast<float>(kTexel) ? 1 : 0;
        }
      }
    }
    for (const int count : uses) ASSERT_EQ(count, 1);
    EXPECT_EQ(num_doubly, 0);
    EXPECT_EQ(num_turned, 0);
    // A texel stands for no more than 1.4 times its size along the surface, where this is smooth.
    double area = 0;
    for (const Triangle& t : mesh.triangles) {
      const Eigen::Vector3f& a = mesh.vertices[t[0]];
      area += (mesh.vertices[t[1]] - a).cross(mesh.vertices[t[2]] - a).norm() / 2;
    }
    const double stretch = area / (static_cast<double>(num_covered) * kTexel * kTexel);
    RecordProperty("stretch", std::to_string(stretch));
    RecordProperty("charts", std::to_string(charts.size()));
    EXPECT_GT(stretch, 1.0);
    EXPECT_LT(stretch, noise > 0 ? 1.6 : 1.45);
    EXPECT_LT(charts.size(), noise > 0 ? 600u : 200u);
  }
}

// A plate whose edge is bent up by 80 degrees, finely where it bends: the flat part is seen straight on.
TEST(Charts, BeginWhereTheSurfaceIsFlattest) {
  TriangleMesh mesh;
  constexpr int kAcross = 20;
  constexpr double kRadius = 0.5;
  std::vector<Eigen::Vector2d> profile;
  for (int i = 0; i <= 4; ++i) {  // the bend first: its triangles come before those of the plate
    const double angle = 20 * (4 - i) * kDegree;
    profile.emplace_back(-kRadius * std::sin(angle), kRadius * (1 - std::cos(angle)));
  }
  for (int i = 1; i <= 20; ++i) profile.emplace_back(0.1 * i, 0);
  for (const Eigen::Vector2d& at : profile) {
    for (int j = 0; j <= kAcross; ++j) {
      mesh.vertices.emplace_back(static_cast<float>(at.x()), 0.1F * static_cast<float>(j),
                                 static_cast<float>(at.y()));
    }
  }
  const auto at = [](size_t i, int j) {
    return static_cast<uint32_t>(i) * (kAcross + 1) + static_cast<uint32_t>(j);
  };
  for (size_t i = 0; i + 1 < profile.size(); ++i) {
    for (int j = 0; j < kAcross; ++j) {
      mesh.triangles.emplace_back(at(i, j), at(i + 1, j), at(i + 1, j + 1));
      mesh.triangles.emplace_back(at(i, j), at(i + 1, j + 1), at(i, j + 1));
    }
  }
  ComputeNormals(&mesh);
  const std::vector<Chart> charts = MakeCharts(mesh, {0.01, 4, 8192});
  const auto last = static_cast<uint32_t>(mesh.triangles.size() - 1);
  int num_found = 0;
  for (const Chart& chart : charts) {
    if (std::find(chart.triangles.begin(), chart.triangles.end(), last) == chart.triangles.end()) continue;
    ++num_found;
    EXPECT_GT(std::abs(chart.right.cross(chart.down).z()), std::cos(1 * kDegree));
    EXPECT_GE(chart.triangles.size(), size_t{2} * 20 * kAcross);  // all of the plate
  }
  EXPECT_EQ(num_found, 1);
}

// Whichever two of a triangle's corners are one.
TEST(Charts, HaveNoTriangleWithoutAnArea) {
  TriangleMesh mesh = RoughRing(0);
  const auto first = static_cast<uint32_t>(mesh.triangles.size());
  mesh.triangles.emplace_back(0, 0, 1);
  mesh.triangles.emplace_back(0, 1, 1);
  mesh.triangles.emplace_back(1, 0, 1);
  size_t num_triangles = 0;
  for (const Chart& chart : MakeCharts(mesh, {0.004, 4, 8192})) {
    num_triangles += chart.triangles.size();
    for (const uint32_t triangle : chart.triangles) EXPECT_LT(triangle, first);
  }
  EXPECT_EQ(num_triangles, first);
}

TEST(Charts, NoneIsLargerThanAPage) {
  const TriangleMesh mesh = RoughRing(0);
  for (const Chart& chart : MakeCharts(mesh, {0.004, 2, 100})) {
    EXPECT_LE(chart.width, 100);
    EXPECT_LE(chart.height, 100);
  }
}

TEST(PackRectangles, NoneOverlapsAndLittleIsLost) {
  RandomNumbers random(2);
  std::vector<RectangleSize> sizes;
  double area = 0;
  for (int i = 0; i < 700; ++i) {
    const RectangleSize size{1 + static_cast<int>(random.Uniform(0, 60)),
                             1 + static_cast<int>(random.Uniform(0, 40))};
    sizes.push_back(size);
    area += static_cast<double>(size.width) * size.height;
  }
  for (const int side : {4096, 200, 60}) {
    const Packing packing = PackRectangles(sizes, side);
    ASSERT_EQ(packing.places.size(), sizes.size());
    std::vector<std::vector<uint8_t>> used;
    double page_area = 0;
    for (const RectangleSize& page : packing.pages) {
      EXPECT_LE(std::max(page.width, page.height), side);
      used.emplace_back(static_cast<size_t>(page.width) * page.height, 0);
      page_area += static_cast<double>(page.width) * page.height;
    }
    for (size_t i = 0; i < sizes.size(); ++i) {
      const PackedRectangle& place = packing.places[i];
      const RectangleSize& page = packing.pages.at(place.page);
      ASSERT_TRUE(place.x >= 0 && place.y >= 0 && place.x + sizes[i].width <= page.width &&
                  place.y + sizes[i].height <= page.height);
      for (int y = 0; y < sizes[i].height; ++y) {
        for (int x = 0; x < sizes[i].width; ++x) {
          ++used[place.page][static_cast<size_t>(place.y + y) * page.width + place.x + x];
        }
      }
    }
    for (const auto& page : used) {
      for (const uint8_t count : page) ASSERT_LE(count, 1);
    }
    EXPECT_GT(area / page_area, 0.75) << side;
    if (side != 4096) continue;
    EXPECT_EQ(packing.pages.size(), 1u);
  }
}

// A plane's depth is linear in its inverse over the image, however large its triangles are.
TEST(MeshRaster, DepthsOfAPlaneAreExact) {
  TriangleMesh mesh;
  mesh.vertices = {{-2, -1, 2}, {3, -1, 9}, {3, 2, 9}, {-2, 2, 2}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  const ObjectView view{60, 50, 40, 40, 30, 20, Rigid3()};
  const MeshRaster raster = RasterizeMesh(mesh.vertices, mesh.triangles, view, true);
  int count = 0;
  for (int y = 0; y < 50; ++y) {
    for (int x = 0; x < 60; ++x) {
      const size_t at = static_cast<size_t>(y) * 60 + x;
      if (raster.triangles[at] == MeshRaster::kNone) {
        EXPECT_EQ(raster.inverse_depths[at], 0);
        continue;
      }
      // z = 2 + 1.4 (x + 2) and x = z (column - 30) / 40.
      const double slope = (x + 0.5 - 30) / 40;
      const double z = 4.8 / (1 - 1.4 * slope);
      EXPECT_NEAR(1 / raster.inverse_depths[at], z, 1e-5 * z);
      ++count;
    }
  }
  EXPECT_GT(count, 1000);
}

TEST(PageFill, ColoursSpreadFromKnownVertices) {
  TriangleMesh mesh;  // a strip, and a triangle apart
  for (int i = 0; i < 12; ++i) mesh.vertices.emplace_back(static_cast<float>(i), 0.0F, 0.0F);
  for (uint32_t i = 0; i + 2 < 9; ++i) mesh.triangles.emplace_back(i, i + 1, i + 2);
  mesh.triangles.emplace_back(9, 10, 11);
  std::vector<Eigen::Array4f> sums(12, Eigen::Array4f::Zero());
  sums[0] = {20, 40, 60, 2};
  sums[1] = {10, 20, 30, 1};
  const std::vector<Eigen::Array3f> colors = SpreadVertexColors(mesh, sums);
  for (const Eigen::Array3f& color : colors)
    EXPECT_LT((color - Eigen::Array3f(10, 20, 30)).abs().maxCoeff(), 1e-4F);
}

TEST(PageFill, GuttersContinueAndTheRestIsTheMean) {
  Image8 page{20, 1, 3, std::vector<uint8_t>(60, 0)};
  std::vector<uint8_t> states(20, kBlankTexel);
  for (int c = 0; c < 3; ++c) page.Pixel(4, 0)[c] = 100;
  states[4] = kSeenTexel;
  for (int c = 0; c < 3; ++c) page.Pixel(15, 0)[c] = 200;
  states[15] = kSeenTexel;
  FillGutters(3, &states, &page);
  for (int x = 0; x < 20; ++x) {
    const int expected = x >= 1 && x <= 7 ? 100 : x >= 12 && x <= 18 ? 200 : 150;
    EXPECT_EQ(page.Pixel(x, 0)[1], expected) << x;
  }
}

}  // namespace
}  // namespace s2gs
