#include "s2gs/cpu/tile_kernel.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <string>
#include <vector>

#include "s2gs/cpu/view_buffers.h"
#include "s2gs/kernel/adam.h"
#include "s2gs/kernel/composite.h"
#include "s2gs/kernel/loss.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

constexpr int kSize = kTileSize;
constexpr float kNear = 0.05F;
using Full = Channels<true, true>;

std::vector<const TileKernels*> AllKernels() {
  std::vector<const TileKernels*> all = {&PortableTileKernels()};
  if (&BestTileKernels() != all[0]) all.push_back(&BestTileKernels());
  return all;
}

// A tile's splats, from near to far, some of them opaque enough to end pixels, some of one pixel.
std::vector<SplatRow> RandomRows(int count, uint64_t seed) {
  RandomNumbers random(seed);
  std::vector<SplatRow> rows;
  rows.reserve(count);
  for (int i = 0; i < count; ++i) {
    SplatRow row{};
    row.x = static_cast<float>(random.Uniform(-4, kSize + 4));
    row.y = static_cast<float>(random.Uniform(-4, kSize + 4));
    const double size = i % 5 == 0 ? 40 : random.Uniform(0.15, 0.6);  // inverse radius; large: low-pass only
    row.ux = static_cast<float>(size * random.Normal());
    row.uy = static_cast<float>(size * random.Normal());
    row.vx = static_cast<float>(size * random.Normal());
    row.vy = static_cast<float>(size * random.Normal());
    row.wx = static_cast<float>(0.02 * random.Normal());
    row.wy = static_cast<float>(0.02 * random.Normal());
    row.depth = static_cast<float>(1 + 0.05 * i);
    row.nx = 0.6F;
    row.ny = static_cast<float>(0.1 * random.Normal());
    row.nz = -0.8F;
    row.opacity = static_cast<float>(i % 3 == 0 ? 0.9995 : random.Uniform(0.02, 0.9));
    row.red = static_cast<float>(random.Uniform(0, 1));
    row.green = static_cast<float>(random.Uniform(0, 1));
    row.blue = static_cast<float>(random.Uniform(0, 1));
    row.foreground = static_cast<float>(random.Uniform(0, 1));
    row.cutoff2 = CutoffSquaredRadius(row.opacity) * 1.0005F + 1e-4F;
    // Bounds end with whole packs: the kernel trusts them to hold every pixel that is hit.
    row.x_begin = i % 4 == 0 ? kPackWidth : 0;
    row.x_end = i % 7 == 3 && i % 4 != 0 ? kPackWidth : kSize;
    row.y_begin = i % 4 == 1 ? 5 : 0;
    row.y_end = kSize;
    rows.push_back(row);
  }
  return rows;
}

Splat<double> ToSplat(const SplatRow& r) {
  Splat<double> s{};
  s.footprint = {{r.x, r.y}, {r.ux, r.uy}, {r.vx, r.vy}, {r.wx, r.wy}, r.depth, {r.nx, r.ny, r.nz}};
  s.opacity = r.opacity;
  s.color = {r.red, r.green, r.blue};
  s.foreground = r.foreground;
  return s;
}

bool Covers(const SplatRow& r, int x, int y) {
  return x >= r.x_begin && x < r.x_end && y >= r.y_begin && y < r.y_end;
}

struct Tile {
  std::vector<SplatRow> rows;
  std::vector<TileEntry> entries;
  ViewBuffers buffers;
  TileJob job{};
  std::vector<SplatGradient> by_slot;

  explicit Tile(std::vector<SplatRow> all) : rows(std::move(all)) {
    for (size_t i = 0; i < rows.size(); ++i) {
      // Slots in another order than the list.
      entries.push_back({static_cast<uint32_t>(i), static_cast<uint32_t>(rows.size() - 1 - i)});
    }
    by_slot.resize(rows.size());
    ThreadPool threads(1);
    buffers.Prepare(kSize, kSize, true, true, true, &threads);
    job.splats = rows.data();
    job.entries = entries.data();
    job.num_entries = static_cast<int32_t>(entries.size());
    job.near_depth = kNear;
    job.background[0] = 0.25F;
    job.background[1] = 0.5F;
    job.background[2] = 0.75F;
    job.planes = buffers.planes();
    job.gradients = buffers.gradients();
    job.by_slot = by_slot.data();
  }
};

// The same by kernel/composite.h, in double.
struct Reference {
  std::vector<Pixel<double>> pixels;
  std::vector<std::vector<int>> hits;  // of each pixel, from near to far
};

Reference Composite(const std::vector<SplatRow>& rows) {
  Reference result;
  for (int i = 0; i < kSize * kSize; ++i) {
    const int x = i % kSize;
    const int y = i / kSize;
    Pixel<double> pixel = EmptyPixel<double>();
    std::vector<int> hits;
    for (size_t n = 0; n < rows.size(); ++n) {
      if (!Covers(rows[n], x, y)) continue;
      const Splat<double> splat = ToSplat(rows[n]);
      PixelHit<double> hit;
      if (!HitSplat(splat.footprint, splat.opacity, x + 0.5, y + 0.5, double{kNear}, &hit)) continue;
      if (!AddHit<Full>(splat, hit, double{kNear}, &pixel)) break;
      hits.push_back(static_cast<int>(n));
    }
    result.pixels.push_back(pixel);
    result.hits.push_back(hits);
  }
  return result;
}

TEST(TileKernel, CompositesAsTheScalarKernels) {
  const std::vector<SplatRow> rows = RandomRows(60, 3);
  const Reference expected = Composite(rows);
  for (const TileKernels* kernels : AllKernels()) {
    Tile tile(rows);
    kernels->forward(tile.job, true, true);
    const ViewPlanes& planes = tile.job.planes;
    int ended = 0;
    for (int i = 0; i < kSize * kSize; ++i) {
      const size_t at = i / kSize * planes.stride + i % kSize;
      const Pixel<double>& pixel = expected.pixels[i];
      // Measured: 6e-7 over these seeds.
      EXPECT_NEAR(planes.transmittance[at], pixel.transmittance, 1e-5) << kernels->name;
      EXPECT_NEAR(planes.color[0][at], pixel.color.x, 1e-5);
      EXPECT_NEAR(planes.color[1][at], pixel.color.y, 1e-5);
      EXPECT_NEAR(planes.color[2][at], pixel.color.z, 1e-5);
      EXPECT_NEAR(planes.foreground[at], pixel.foreground, 1e-5);
      EXPECT_NEAR(planes.normal[2][at], pixel.normal.z, 1e-5);
      EXPECT_NEAR(planes.depth[at], pixel.depth, 4e-5);
      EXPECT_NEAR(planes.median[at], pixel.median_depth, 4e-5);
      EXPECT_NEAR(planes.distortion[at], pixel.distortion, 1e-6);
      ended += planes.stop[at] < tile.job.num_entries ? 1 : 0;
    }
    EXPECT_GT(ended, 5) << "the case that pixels end early is not there";
  }
}

TEST(TileKernel, GradientsAsTheScalarKernels) {
  const std::vector<SplatRow> rows = RandomRows(60, 4);
  const Reference reference = Composite(rows);
  for (const TileKernels* kernels : AllKernels()) {
    Tile tile(rows);
    kernels->forward(tile.job, true, true);
    RandomNumbers random(9);
    std::vector<Splat<double>> expected(rows.size());
    const ViewGradients& out = tile.job.gradients;
    for (int i = 0; i < kSize * kSize; ++i) {
      const size_t at = i / kSize * tile.job.planes.stride + i % kSize;
      PixelGradient<double> d{};
      const auto value = [&](float* plane) {
        plane[at] = static_cast<float>(random.Normal());
        return double{plane[at]};
      };
      d.color = {value(out.color[0]), value(out.color[1]), value(out.color[2])};
      d.alpha = value(out.alpha);
      d.foreground = value(out.foreground);
      d.normal = {value(out.normal[0]), value(out.normal[1]), value(out.normal[2])};
      d.expected_depth = value(out.expected_depth);
      d.distortion = value(out.distortion);
      PixelAdjoint<double> state =
          BeginPixelAdjoint<Full>(reference.pixels[i], d, Vec3<double>{0.25, 0.5, 0.75});
      const std::vector<int>& hits = reference.hits[i];
      for (size_t n = hits.size(); n-- > 0;) {
        const Splat<double> splat = ToSplat(rows[hits[n]]);
        PixelHit<double> hit;
        HitSplat(splat.footprint, splat.opacity, i % kSize + 0.5, i / kSize + 0.5, double{kNear}, &hit);
        UndoHit<Full>(splat, hit, d, double{kNear}, &state, &expected[hits[n]]);
      }
    }
    kernels->backward(tile.job, true, true);
    double worst = 0;
    for (size_t n = 0; n < rows.size(); ++n) {
      const SplatGradient& g = tile.by_slot[rows.size() - 1 - n];
      const Footprint<double>& f = expected[n].footprint;
      const std::array<std::pair<double, double>, 17> pairs = {{{g.x, f.centre.x},
                                                                {g.y, f.centre.y},
                                                                {g.ux, f.u.x},
                                                                {g.uy, f.u.y},
                                                                {g.vx, f.v.x},
                                                                {g.vy, f.v.y},
                                                                {g.wx, f.w.x},
                                                                {g.wy, f.w.y},
                                                                {g.opacity, expected[n].opacity},
                                                                {g.red, expected[n].color.x},
                                                                {g.green, expected[n].color.y},
                                                                {g.blue, expected[n].color.z},
                                                                {g.foreground, expected[n].foreground},
                                                                {g.depth, f.depth},
                                                                {g.nx, f.normal.x},
                                                                {g.ny, f.normal.y},
                                                                {g.nz, f.normal.z}}};
      for (size_t j = 0; j < pairs.size(); ++j) {
        const auto& [got, want] = pairs[j];
        // Sums of some hundred pixels of either sign. Measured: 2e-4.
        EXPECT_NEAR(got, want, 1e-3 * std::max(1.0, std::abs(want)))
            << kernels->name << ", splat " << n << ", field " << j;
        worst = std::max(worst, std::abs(got - want) / std::max(1.0, std::abs(want)));
      }
    }
    RecordProperty(std::string("worst_") + kernels->name, std::to_string(worst));
  }
}

TEST(TileKernel, ChannelsThatAreOffChangeNothingElse) {
  const std::vector<SplatRow> rows = RandomRows(40, 5);
  for (const TileKernels* kernels : AllKernels()) {
    Tile full(rows);
    Tile plain(rows);
    kernels->forward(full.job, true, true);
    kernels->forward(plain.job, false, false);
    for (int i = 0; i < kSize * kSize; ++i) {
      const size_t at = i / kSize * full.job.planes.stride + i % kSize;
      EXPECT_EQ(full.job.planes.color[1][at], plain.job.planes.color[1][at]);
      for (int c = 0; c < 3; ++c) {
        full.job.gradients.color[c][at] = plain.job.gradients.color[c][at] = 0.1F;
      }
    }
    kernels->backward(full.job, true, true);
    kernels->backward(plain.job, false, false);
    for (size_t n = 0; n < rows.size(); ++n) {
      EXPECT_NEAR(full.by_slot[n].opacity, plain.by_slot[n].opacity, 1e-5);
      EXPECT_NEAR(full.by_slot[n].ux, plain.by_slot[n].ux, 1e-4);
    }
  }
}

TEST(TileKernel, PeakIsTheLargestWeight) {
  const std::vector<SplatRow> rows = RandomRows(30, 6);
  std::vector<double> expected(rows.size(), 0);
  for (int i = 0; i < kSize * kSize; ++i) {
    double transmittance = 1;
    for (size_t n = 0; n < rows.size(); ++n) {
      PixelHit<double> hit;
      const Splat<double> splat = ToSplat(rows[n]);
      if (!Covers(rows[n], i % kSize, i / kSize)) continue;
      if (!HitSplat(splat.footprint, splat.opacity, i % kSize + 0.5, i / kSize + 0.5, double{kNear}, &hit))
        continue;
      if (transmittance * (1 - hit.alpha) < kMinTransmittance) break;
      expected[n] = std::max(expected[n], hit.alpha * transmittance);
      transmittance *= 1 - hit.alpha;
    }
  }
  for (const TileKernels* kernels : AllKernels()) {
    Tile tile(rows);
    std::vector<float> peaks(rows.size(), -1);
    tile.job.peak_by_slot = peaks.data();
    kernels->forward(tile.job, false, false);
    for (size_t n = 0; n < rows.size(); ++n) EXPECT_NEAR(peaks[rows.size() - 1 - n], expected[n], 1e-5);
  }
}

TEST(TileKernel, PhotoLossIsThatOfTheScalarKernels) {
  constexpr int kWidth = 21;
  constexpr int kHeight = 17;
  RandomNumbers random(8);
  std::array<std::vector<double>, 2> images;
  for (auto& image : images) {
    for (int i = 0; i < kWidth * kHeight; ++i) image.push_back(random.Uniform(0, 1));
  }
  // Brute force, in double: the loss as a function of the image.
  const auto loss = [&](const std::vector<double>& x, double* l1, double* ssim) {
    *l1 = *ssim = 0;
    for (int py = 0; py < kHeight; ++py) {
      for (int px = 0; px < kWidth; ++px) {
        double mx = 0, my = 0, xx = 0, yy = 0, xy = 0;
        for (int dy = -kSsimRadius; dy <= kSsimRadius; ++dy) {
          for (int dx = -kSsimRadius; dx <= kSsimRadius; ++dx) {
            const int qx = px + dx, qy = py + dy;
            if (qx < 0 || qy < 0 || qx >= kWidth || qy >= kHeight) continue;
            const double w = SsimWeight<double>(dx + kSsimRadius) * SsimWeight<double>(dy + kSsimRadius);
            const double a = x[qy * kWidth + qx], b = images[1][qy * kWidth + qx];
            mx += w * a, my += w * b, xx += w * a * a, yy += w * b * b, xy += w * a * b;
          }
        }
        *ssim += ComputeSsimPoint(mx, my, xx, yy, xy).value;
        *l1 += std::abs(x[py * kWidth + px] - images[1][py * kWidth + px]);
      }
    }
    return 0.3 * *l1 - 0.7 * *ssim;
  };
  double l1 = 0;
  double ssim = 0;
  loss(images[0], &l1, &ssim);
  for (const TileKernels* kernels : AllKernels()) {
    ViewBuffers buffers;
    ThreadPool threads(1);
    buffers.Prepare(kWidth, kHeight, false, false, true, &threads);
    std::vector<double> l1_rows(kHeight), ssim_rows(kHeight);
    PhotoLossJob job{};
    job.width = kWidth;
    job.height = kHeight;
    job.stride = buffers.stride();
    job.rendered = buffers.image(0);
    job.photo = buffers.photo(0);
    for (int i = 0; i < 5; ++i) job.scratch[i] = buffers.scratch(i);
    job.by_square = buffers.scratch(5);
    job.by_product = buffers.scratch(6);
    job.d_rendered = buffers.gradients().color[0];
    job.l1_weight = 0.3F;
    job.ssim_weight = -0.7F;
    job.l1_rows = l1_rows.data();
    job.ssim_rows = ssim_rows.data();
    for (int i = 0; i < kWidth * kHeight; ++i) {
      const size_t at = i / kWidth * job.stride + i % kWidth;
      buffers.image(0)[at] = static_cast<float>(images[0][i]);
      buffers.photo(0)[at] = static_cast<float>(images[1][i]);
    }
    for (int pass = 0; pass < 4; ++pass) kernels->photo_loss(job, pass, 0, kHeight);
    double l1_sum = 0;
    double ssim_sum = 0;
    for (int y = 0; y < kHeight; ++y) {
      l1_sum += l1_rows[y];
      ssim_sum += ssim_rows[y];
    }
    EXPECT_NEAR(l1_sum, l1, 1e-3);
    EXPECT_NEAR(ssim_sum, ssim, 1e-3);
    for (const int i : {0, 5, kWidth - 1, 8 * kWidth + 10, 16 * kWidth + 20, 3 * kWidth + 2}) {
      std::vector<double> moved = images[0];
      constexpr double kStep = 1e-5;
      double unused1 = 0, unused2 = 0;
      moved[i] += kStep;
      const double up = loss(moved, &unused1, &unused2);
      moved[i] -= 2 * kStep;
      const double down = loss(moved, &unused1, &unused2);
      const double expected = (up - down) / (2 * kStep);
      // Measured: 3e-5.
      EXPECT_NEAR(job.d_rendered[i / kWidth * job.stride + i % kWidth], expected, 1e-3)
          << kernels->name << " " << i;
    }
  }
}

TEST(TileKernel, AdamIsThatOfTheScalarKernel) {
  RandomNumbers random(10);
  for (const TileKernels* kernels : AllKernels()) {
    std::vector<float> p, m, v, g;
    for (int i = 0; i < 29; ++i) {
      p.push_back(static_cast<float>(random.Normal()));
      m.push_back(static_cast<float>(0.1 * random.Normal()));
      v.push_back(static_cast<float>(random.Uniform(0, 0.01)));
      g.push_back(static_cast<float>(random.Normal()));
    }
    g[3] = std::nanf("");
    g[4] = 1e30F;
    g[5] = -INFINITY;
    g[6] = 0;
    v[6] = 0;
    m[6] = 0;
    std::vector<float> p2 = p, m2 = m, v2 = v;
    const AdamStep<float> step = MakeAdamStep<float>(7);
    kernels->adam(0.01F, step.first_correction, step.second_correction, g.data(), g.size(), p.data(),
                  m.data(), v.data());
    for (size_t i = 0; i < g.size(); ++i) {
      UpdateByAdam(step, 0.01F, g[i], &p2[i], &m2[i], &v2[i]);
      EXPECT_NEAR(p[i], p2[i], 1e-6) << i;
      EXPECT_NEAR(m[i], m2[i], 1e-6 * std::max(1.0F, std::abs(m2[i]))) << i;
      EXPECT_NEAR(v[i], v2[i], 1e-6 * std::max(1.0F, std::abs(v2[i]))) << i;
    }
  }
}

}  // namespace
}  // namespace s2gs
