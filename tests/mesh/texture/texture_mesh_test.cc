#include "mesh/texture/texture_mesh.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <tuple>
#include <vector>

#include "mesh/texture/render_textured.h"
#include "mesh/texture/texture_photo.h"
#include "s2gs/image/image_error.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"
#include "tests/mesh/texture/box_photos.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

constexpr int kSide = 240;       // [px]
constexpr double kFocal = 420;   // [px]
constexpr double kDistance = 5;  // a pixel is 0.0095 at the boxes

// A pattern of about 25 pixels a wave, without red.
Eigen::Array3d Waves(const Eigen::Vector3d& x) {
  return {0, 128 + 60 * std::sin(26 * x.x() + 9 * x.z()), 128 + 60 * std::sin(24 * x.y() - 11 * x.z())};
}

// A block, and a red post that hides a part of it from some of the photos.
std::vector<PaintedBox> Scene() {
  return {{{-0.6, -0.5, -0.4}, {0.6, 0.5, 0.5}, Waves},
          {{0.8, -0.12, -0.4}, {0.95, 0.12, 0.6}, [](const Eigen::Vector3d&) {
             return Eigen::Array3d(255, 0, 0);
           }}};
}

std::vector<ObjectView> Ring(int count) {
  std::vector<ObjectView> views;
  for (const double elevation : {0.25, 0.75}) {
    for (int i = 0; i < count; ++i) {
      const double azimuth = 2 * kPi * (i + elevation) / count;
      views.push_back(LookAtOrigin(
          kDistance * Eigen::Vector3d(std::cos(azimuth) * std::cos(elevation),
                                      std::sin(azimuth) * std::cos(elevation), std::sin(elevation)),
          kSide, kFocal));
    }
  }
  return views;
}

Eigen::Array3d TexelAt(const Image8& page, const Eigen::Vector2f& position) {
  const double x = position.x() - 0.5;
  const double y = position.y() - 0.5;
  const int x0 = static_cast<int>(std::floor(x));
  const int y0 = static_cast<int>(std::floor(y));
  Eigen::Array3d value = Eigen::Array3d::Zero();
  for (int i = 0; i < 4; ++i) {
    const int column = x0 + i % 2;
    const int row = y0 + i / 2;
    EXPECT_TRUE(column >= 0 && row >= 0 && column < page.width && row < page.height);
    const double weight = (1 - std::abs(x - column)) * (1 - std::abs(y - row));
    for (int c = 0; c < 3; ++c) value[c] += weight * page.Pixel(column, row)[c];
  }
  return value;
}

struct Place {
  Eigen::Vector3d x;
  Eigen::Vector3d normal;
  Eigen::Array3d color;  // of the texture
};

// Random places on the textured mesh.
std::vector<Place> Places(const TexturedMesh& mesh, int per_triangle) {
  RandomNumbers random(3);
  std::vector<Place> places;
  for (const TexturePage& page : mesh.pages) {
    for (uint64_t t = page.first_triangle; t < page.first_triangle + page.num_triangles; ++t) {
      const Triangle& corners = mesh.triangles[t];
      const auto corner = [&](int i) -> Eigen::Vector3d { return mesh.vertices[corners[i]].cast<double>(); };
      const Eigen::Vector3d normal = (corner(1) - corner(0)).cross(corner(2) - corner(0)).normalized();
      for (int i = 0; i < per_triangle; ++i) {
        double u = random.Uniform(0, 1);
        double v = random.Uniform(0, 1);
        if (u + v > 1) {
          u = 1 - u;
          v = 1 - v;
        }
        const double w = 1 - u - v;
        const Eigen::Vector2d texel = u * mesh.texels[corners[0]].cast<double>() +
                                      v * mesh.texels[corners[1]].cast<double>() +
                                      w * mesh.texels[corners[2]].cast<double>();
        places.push_back({u * corner(0) + v * corner(1) + w * corner(2), normal,
                          TexelAt(page.image, texel.cast<float>())});
      }
    }
  }
  return places;
}

// Whether a place of the block is two pixels or more away from the block's edges, and not below it.
bool IsClearOfEdges(const Place& place) {
  if (place.normal.z() < -0.5) return false;
  const std::vector<PaintedBox> scene = Scene();
  for (int axis = 0; axis < 3; ++axis) {
    if (std::abs(place.normal[axis]) > 0.5) continue;
    if (place.x[axis] < scene[0].low[axis] + 0.02 || place.x[axis] > scene[0].high[axis] - 0.02) return false;
  }
  return place.x.x() < 0.7;  // the post's are not the block's
}

struct ColorErrors {
  double rms = 0;      // of green and blue
  double max_red = 0;  // the block has none: red comes from the post
};

ColorErrors Compare(const TexturedMesh& mesh) {
  ColorErrors errors;
  int count = 0;
  for (const Place& place : Places(mesh, 400)) {
    if (!IsClearOfEdges(place)) continue;
    errors.rms += (place.color - Waves(place.x)).tail<2>().square().mean();
    errors.max_red = std::max(errors.max_red, place.color[0]);
    ++count;
  }
  EXPECT_GT(count, 2000);
  errors.rms = std::sqrt(errors.rms / count);
  return errors;
}

TEST(TextureMesh, ColorsAreThoseOfTheSurface) {
  const BoxPhotos photos(Scene(), Ring(12));
  TextureSummary summary;
  Reporter reporter;
  const TexturedMesh mesh = TextureMesh(MeshOf(Scene()), photos, {}, reporter, &summary);
  const ColorErrors errors = Compare(mesh);
  RecordProperty("rms", std::to_string(errors.rms));
  RecordProperty("max_red", std::to_string(errors.max_red));
  EXPECT_LT(errors.rms, 2.5);
  // No texel of the block takes the post's colour.
  EXPECT_LT(errors.max_red, 4);
  EXPECT_GT(summary.mean_photos, 3);
  EXPECT_NEAR(summary.texel_pixels, 0.7, 1e-6);
  // The side of a pixel at the block's faces: the distance less half of the block, over the focal length.
  EXPECT_NEAR(summary.texel_size, 0.7 * (kDistance - 0.5) / kFocal, 0.1 * summary.texel_size);
}

TEST(TextureMesh, WhatOnePhotoAloneShowsIsNotTaken) {
  BoxPhotos photos(Scene(), Ring(12));
  // A hand, say, in front of the block in one photo.
  for (int y = 90; y < 150; ++y) {
    for (int x = 90; x < 150; ++x) std::fill_n(photos.photo(3).Pixel(x, y), 3, uint8_t{255});
  }
  TextureSummary summary;
  Reporter reporter;
  const ColorErrors errors = Compare(TextureMesh(MeshOf(Scene()), photos, {}, reporter, &summary));
  RecordProperty("rms", std::to_string(errors.rms));
  RecordProperty("max_red", std::to_string(errors.max_red));
  EXPECT_LT(errors.rms, 3.5);
  EXPECT_LT(errors.max_red, 40);
}

// The largest step of the texture's colour across a border of charts, over places along it.
double LargestSeam(const TexturedMesh& mesh) {
  using Key = std::tuple<float, float, float>;
  const auto key = [&](uint32_t v) {
    return Key(mesh.vertices[v].x(), mesh.vertices[v].y(), mesh.vertices[v].z());
  };
  std::map<std::pair<Key, Key>, std::vector<Eigen::Array3d>> colors;  // along each edge, from either side
  double largest = 0;
  for (const TexturePage& page : mesh.pages) {
    for (uint64_t t = page.first_triangle; t < page.first_triangle + page.num_triangles; ++t) {
      for (int i = 0; i < 3; ++i) {
        uint32_t a = mesh.triangles[t][i];
        uint32_t b = mesh.triangles[t][(i + 1) % 3];
        if (key(b) < key(a)) std::swap(a, b);
        std::vector<Eigen::Array3d> line;
        for (int k = 1; k < 40; ++k) {
          line.push_back(
              TexelAt(page.image, mesh.texels[a] + (mesh.texels[b] - mesh.texels[a]) * (k / 40.0F)));
        }
        const auto [found, is_new] = colors.emplace(std::pair(key(a), key(b)), line);
        // Edges below the block, where no photo looks, and of the post do not count.
        if (is_new || mesh.vertices[a].x() > 0.7F || (mesh.vertices[a].z() < 0 && mesh.vertices[b].z() < 0))
          continue;
        for (size_t k = 0; k < line.size(); ++k) {
          largest = std::max(largest, (line[k] - found->second[k]).abs().maxCoeff());
        }
      }
    }
  }
  return largest;
}

// Texels of a given size on boxes of a known area, six photos above and six far above.
TEST(TextureMesh, SummaryCountsWhatWasMade) {
  const BoxPhotos photos(Scene(), Ring(6));
  Reporter reporter;
  TextureOptions options;
  options.texel_size = 0.02;
  TextureSummary summary;
  const TexturedMesh mesh = TextureMesh(MeshOf(Scene()), photos, options, reporter, &summary);
  double area = 0;
  double underside = 0;
  for (const PaintedBox& box : Scene()) {
    const Eigen::Vector3d size = box.high - box.low;
    area += 2 * (size.x() * size.y() + size.y() * size.z() + size.z() * size.x());
    underside += size.x() * size.y();
  }
  EXPECT_EQ(summary.texel_size, 0.02);
  // The best photo's pixels: some 4.5 away.
  EXPECT_NEAR(summary.texel_pixels, 0.02 * kFocal / 4.5, 0.1);
  // A chart looks at two sides that stand at right angles, each at 45 degrees.
  const double texels = area / (0.02 * 0.02) / std::sqrt(2.0);
  EXPECT_NEAR(static_cast<double>(summary.num_texels), texels, 0.03 * texels);
  // No photo is from below; of the post's foot a little is hidden by the block.
  const double seen = static_cast<double>(summary.num_seen) / static_cast<double>(summary.num_texels);
  EXPECT_NEAR(seen, 1 - underside / area, 0.03);
  double page_texels = 0;
  for (const TexturePage& page : mesh.pages) {
    page_texels += static_cast<double>(page.image.width) * page.image.height;
  }
  EXPECT_NEAR(summary.page_use, static_cast<double>(summary.num_texels) / page_texels, 1e-12);
  EXPECT_EQ(summary.num_charts, 6);
  // A side is seen by fewer than half of the photos, a top by six; measured 3.9.
  EXPECT_NEAR(summary.mean_photos, 3.9, 0.2);
  EXPECT_LT(summary.gain_spread, 0.01);  // all photos are exposed alike
  EXPECT_EQ(summary.error_even, 0);      // and nothing turns
  // By default a texel is as large as the best photo's pixel times what is asked for.
  options.texel_size = 0;
  options.texel_size_pixels = 2;
  TextureSummary twice;
  TextureMesh(MeshOf(Scene()), photos, options, reporter, &twice);
  EXPECT_NEAR(twice.texel_pixels, 2, 1e-9);
  EXPECT_NEAR(twice.texel_size, 2 * summary.texel_size / summary.texel_pixels, 1e-9);
}

TEST(TextureMesh, ExposuresLeaveNoSeams) {
  const std::vector<ObjectView> views = Ring(12);
  BoxPhotos photos(Scene(), views);
  RandomNumbers random(5);
  for (size_t i = 0; i < views.size(); ++i) {
    const double gain = random.Uniform(0.75, 1.3);
    for (uint8_t& value : photos.photo(static_cast<int>(i)).pixels) {
      value = static_cast<uint8_t>(std::lround(std::min(255.0, gain * value)));
    }
  }
  Reporter reporter;
  std::vector<double> spreads;
  for (const bool equalise : {true, false}) {
    TextureOptions options;
    options.equalise = equalise;
    TextureSummary summary;
    const TexturedMesh mesh = TextureMesh(MeshOf(Scene()), photos, options, reporter, &summary);
    if (equalise) {
      const double seam = LargestSeam(mesh);
      RecordProperty("seam", std::to_string(seam));
      EXPECT_LT(seam, 20);
      // Uniform gains from .75 to 1.3 have logarithms with a standard deviation of .16.
      EXPECT_NEAR(summary.gain_spread, 0.16, 0.05);
    }
    std::vector<double> logs;
    for (const Place& place : Places(mesh, 300)) {
      if (IsClearOfEdges(place)) logs.push_back(std::log((place.color[1] + 1) / (Waves(place.x)[1] + 1)));
    }
    const double mean = Summarize(logs).mean;
    double squares = 0;
    for (const double log : logs) squares += (log - mean) * (log - mean);
    spreads.push_back(std::sqrt(squares / static_cast<double>(logs.size())));
  }
  RecordProperty("spread", std::to_string(spreads[0]));
  RecordProperty("spread_without", std::to_string(spreads[1]));
  EXPECT_LT(spreads[0], 0.03);
  EXPECT_GT(spreads[1], 2 * spreads[0]);
}

TEST(TextureMesh, RendersLikePhotosThatItWasNotMadeFrom) {
  const BoxPhotos photos(Scene(), Ring(12));
  const std::vector<ObjectView> others = {LookAtOrigin({3.1, -3.6, 1.9}, kSide, kFocal),
                                          LookAtOrigin({-4.0, 1.3, 2.6}, kSide, kFocal)};
  const BoxPhotos truth(Scene(), others);
  TextureSummary summary;
  Reporter reporter;
  const TexturedMesh mesh = TextureMesh(MeshOf(Scene()), photos, {}, reporter, &summary);
  for (int i = 0; i < truth.size(); ++i) {
    const TexturedRendering rendering = RenderTexturedMesh(mesh, others[i], 4);
    const double psnr = Psnr(rendering.image, truth.Load(i), &rendering.covered);
    RecordProperty("psnr" + std::to_string(i), std::to_string(psnr));
    EXPECT_GT(psnr, 27);
  }
}

TEST(TextureMesh, SameForAnyNumberOfThreadsAndPortions) {
  const BoxPhotos photos(Scene(), Ring(6));
  Reporter reporter;
  TextureSummary summary;
  TextureOptions options;
  options.num_threads = 1;
  const TexturedMesh one = TextureMesh(MeshOf(Scene()), photos, options, reporter, &summary);
  options.num_threads = 4;
  // 40 % of 10 MiB hold some 19,500 texels of 130,000, fewer than a face of the box has.
  options.max_memory_gib = 0.01;
  options.texel_size = summary.texel_size;
  const TexturedMesh four = TextureMesh(MeshOf(Scene()), photos, options, reporter, &summary);
  ASSERT_EQ(one.pages.size(), four.pages.size());
  EXPECT_EQ(one.pages[0].image.pixels, four.pages[0].image.pixels);
  EXPECT_EQ(one.texels, four.texels);
}

// Waves of five pixels, seen straight on between the pixels: a pixel is their mean over its width. Measured:
// off by .027 of the waves' height (root mean square), .052 at most; a mean of neighbours is off by .091 and
// .183.
TEST(TexturePhotos, FinePatternsAreNotBlurred) {
  constexpr double kPixel = (kDistance - 0.5) / kFocal;
  constexpr double kHeight = 60;
  const double frequency = 2 * kPi / (5 * kPixel);
  const PaintedBox box = {{-0.5, -0.5, -0.5}, {0.5, 0.5, 0.5}, [&](const Eigen::Vector3d& x) {
                            return Eigen::Array3d::Constant(128 + kHeight * std::sin(frequency * x.y()));
                          }};
  const ObjectView view = LookAtOrigin({kDistance, 0, 0}, kSide, kFocal);
  const BoxPhotos photos({box}, {view});
  const TriangleMesh mesh = MeshOf({box});
  const TexturePhoto photo(view, photos.Load(0), {}, mesh);
  const double of_pixel = std::sin(kPi / 5) / (kPi / 5);
  double squares = 0;
  double worst = 0;
  constexpr int kCount = 400;
  for (int i = 0; i < kCount; ++i) {
    const double y = -0.4 + 0.8 * i / kCount;
    PhotoSample sample;
    ASSERT_TRUE(
        photo.Sample(Eigen::Vector3d(0.5, y, 0.031).cast<float>(), Eigen::Vector3f::UnitX(), &sample));
    const double off = (sample.color[1] - 128) / kHeight - of_pixel * std::sin(frequency * y);
    squares += off * off;
    worst = std::max(worst, std::abs(off));
  }
  EXPECT_LT(std::sqrt(squares / kCount), 0.04);
  EXPECT_LT(worst, 0.08);
}

// A square that faces the camera, in a part of the photo: away from outlines its weight is the area that a
// unit of it has in the photo, (focal length / depth)^2, times the cosine over that of the steepest that
// counts.
TEST(TexturePhotos, WeightsAreEvenAwayFromOutlines) {
  for (const auto& [low_x, low_y] :
       {std::pair(0.1F, 0.2F), std::pair(-0.9F, 0.15F), std::pair(0.15F, -0.9F)}) {
    TriangleMesh mesh;
    mesh.vertices = {{0, low_x, low_y},
                     {0, low_x + 0.8F, low_y},
                     {0, low_x + 0.8F, low_y + 0.7F},
                     {0, low_x, low_y + 0.7F}};
    mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
    const ObjectView view = LookAtOrigin({kDistance, 0, 0}, kSide, kFocal);
    const Image8 photo{kSide, kSide, 3, std::vector<uint8_t>(3 * kSide * kSide, 99)};
    const Image8 mask{kSide / 2, kSide / 3, 1, std::vector<uint8_t>(kSide / 2 * (kSide / 3), 128)};
    const TexturePhoto whole(view, photo, {}, mesh);
    const TexturePhoto masked(view, photo, mask, mesh);  // 128 is inside
    const auto expected = [&](const Eigen::Vector3f& x, double distance) {
      const Eigen::Vector3d to_camera = Eigen::Vector3d(distance, 0, 0) - x.cast<double>();
      return (to_camera.normalized().x() - 0.1) * kFocal * kFocal / (distance * distance);
    };
    for (int i = 0; i <= 20; ++i) {
      for (int j = 0; j <= 20; ++j) {
        // 10 pixels of .012 from its outline.
        const Eigen::Vector3f x(0, low_x + 0.12F + 0.56F * static_cast<float>(i) / 20,
                                low_y + 0.12F + 0.46F * static_cast<float>(j) / 20);
        PhotoSample sample;
        ASSERT_TRUE(whole.Sample(x, Eigen::Vector3f::UnitX(), &sample)) << x.transpose();
        EXPECT_NEAR(sample.weight / expected(x, kDistance), 1, 1e-5) << x.transpose();
        EXPECT_EQ(sample.color[0], 99);
        EXPECT_EQ(sample.smooth[1], 99);
        PhotoSample other;
        ASSERT_TRUE(masked.Sample(x, Eigen::Vector3f::UnitX(), &other)) << x.transpose();
        EXPECT_EQ(other.weight, sample.weight);
      }
    }
    PhotoSample outside;
    EXPECT_FALSE(whole.Sample({0, low_x - 0.1F, low_y}, Eigen::Vector3f::UnitX(), &outside));
    // From twice as far the same square metre has a quarter of the area.
    const TexturePhoto far(LookAtOrigin({2 * kDistance, 0, 0}, kSide, kFocal), photo, {}, mesh);
    PhotoSample small;
    const Eigen::Vector3f middle(0, low_x + 0.4F, low_y + 0.35F);
    ASSERT_TRUE(far.Sample(middle, Eigen::Vector3f::UnitX(), &small));
    EXPECT_NEAR(small.weight / expected(middle, 2 * kDistance), 1, 1e-5);
  }
}

// A plate before a wall, on each of its four sides in turn: where the wall begins to be hidden it counts as
// little as at its outline, four pixels away less than in the open.
TEST(TexturePhotos, WallsFadeWhereSomethingStandsBeforeThem) {
  const ObjectView view = LookAtOrigin({kDistance, 0, 0}, kSide, kFocal);
  const Image8 photo{kSide, kSide, 3, std::vector<uint8_t>(3 * kSide * kSide, 99)};
  for (int side = 0; side < 4; ++side) {
    // (along, across) in the wall's plane; the plate covers what is beyond 0 along.
    const auto place = [&](float x, float along, float across) {
      const float signed_along = side % 2 == 0 ? along : -along;
      return side < 2 ? Eigen::Vector3f(x, signed_along, across) : Eigen::Vector3f(x, across, signed_along);
    };
    TriangleMesh mesh;
    const auto add = [&](float x, float from, float to) {
      const auto first = static_cast<uint32_t>(mesh.vertices.size());
      for (const auto& [along, across] :
           {std::pair(from, -1.0F), std::pair(to, -1.0F), std::pair(to, 1.0F), std::pair(from, 1.0F)}) {
        mesh.vertices.push_back(place(x, along, across));
      }
      mesh.triangles.emplace_back(first, first + 1, first + 2);
      mesh.triangles.emplace_back(first, first + 2, first + 3);
    };
    add(0, -1, 1);
    add(0.5F, 0, 1);
    const TexturePhoto textured(view, photo, {}, mesh);
    const auto weight = [&](float along) {
      PhotoSample sample;
      return textured.Sample(place(0, along, 0.05F), Eigen::Vector3f::UnitX(), &sample) ? sample.weight : 0;
    };
    constexpr float kPixel = static_cast<float>(kDistance / kFocal);
    EXPECT_EQ(weight(0.3F), 0) << side;  // hidden
    const float open = weight(-0.5F);
    EXPECT_GT(open, 0) << side;
    EXPECT_LT(weight(-2 * kPixel), 0.3F * open) << side;
    EXPECT_LT(weight(-4 * kPixel), 0.75F * open) << side;
    EXPECT_NEAR(weight(-12 * kPixel) / open, 1, 0.02) << side;
  }
}

// What is smooth stays as it is in the smoothed photo: ramps along both axes.
TEST(TexturePhotos, SmoothPhotosKeepRamps) {
  TriangleMesh mesh;
  mesh.vertices = {{0, -0.9F, -0.9F}, {0, 0.9F, -0.9F}, {0, 0.9F, 0.9F}, {0, -0.9F, 0.9F}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  const ObjectView view = LookAtOrigin({kDistance, 0, 0}, kSide, kFocal);
  Image8 photo{kSide, kSide, 3, std::vector<uint8_t>(3 * kSide * kSide)};
  for (int y = 0; y < kSide; ++y) {
    for (int x = 0; x < kSide; ++x) {
      photo.Pixel(x, y)[0] = static_cast<uint8_t>(x);
      photo.Pixel(x, y)[1] = static_cast<uint8_t>(y);
      photo.Pixel(x, y)[2] = static_cast<uint8_t>((x + y) / 2);
    }
  }
  const TexturePhoto textured(view, photo, {}, mesh);
  for (float a = -0.7F; a <= 0.7F; a += 0.1F) {
    for (float b = -0.7F; b <= 0.7F; b += 0.1F) {
      const Eigen::Vector3d in_cam = view.cam_from_object * Eigen::Vector3d(0, a, b);
      const double column = view.fx * in_cam.x() / in_cam.z() + view.cx - 0.5;
      const double row = view.fy * in_cam.y() / in_cam.z() + view.cy - 0.5;
      PhotoSample sample;
      ASSERT_TRUE(textured.Sample({0, a, b}, Eigen::Vector3f::UnitX(), &sample));
      // Both are rounded to whole values, the smoothed one twice.
      EXPECT_NEAR(sample.color[0], column, 0.6);
      EXPECT_NEAR(sample.color[1], row, 0.6);
      EXPECT_NEAR(sample.smooth[0], column, 1.1);
      EXPECT_NEAR(sample.smooth[1], row, 1.1);
      EXPECT_NEAR(sample.smooth[2], (column + row) / 2, 1.3);
    }
  }
}

TEST(TextureMesh, LargeTexturesTakeSeveralPages) {
  const BoxPhotos photos(Scene(), Ring(4));
  Reporter reporter;
  TextureSummary summary;
  TextureOptions options;
  options.max_page_size = 192;
  const TexturedMesh mesh = TextureMesh(MeshOf(Scene()), photos, options, reporter, &summary);
  EXPECT_GT(mesh.pages.size(), 2u);
  uint64_t num_triangles = 0;
  for (const TexturePage& page : mesh.pages) {
    EXPECT_LE(std::max(page.image.width, page.image.height), 192);
    EXPECT_EQ(page.image.pixels.size(), 3 * static_cast<size_t>(page.image.width) * page.image.height);
    EXPECT_EQ(page.first_triangle, num_triangles);
    num_triangles += page.num_triangles;
  }
  EXPECT_EQ(num_triangles, mesh.triangles.size());
  EXPECT_EQ(num_triangles, 24u);
}

TEST(TextureMesh, MeshesThatNoPhotoShowsAreRefused) {
  const BoxPhotos photos(Scene(), Ring(2));
  Reporter reporter;
  TextureSummary summary;
  EXPECT_THROW(TextureMesh({}, photos, {}, reporter, &summary), UserError);
  TriangleMesh far = MeshOf(Scene());
  for (Eigen::Vector3f& vertex : far.vertices) vertex.z() -= 1000;
  EXPECT_THROW(TextureMesh(far, photos, {}, reporter, &summary), UserError);
}

TEST(TextureOptionsCheck, NamesTheBound) {
  TextureOptions options;
  EXPECT_FALSE(options.Check().has_value());
  options.max_page_size = 8193;
  ASSERT_TRUE(options.Check().has_value());
  EXPECT_EQ(options.Check()->field, "max_page_size");
}

}  // namespace
}  // namespace s2gs
