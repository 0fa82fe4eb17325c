#include "s2gs/image/image_error.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace s2gs {
namespace {

Image8 RandomImage(int width, int height, int channels, unsigned seed) {
  std::mt19937 random(seed);
  std::uniform_int_distribution<int> value(0, 255);
  Image8 image{width, height, channels, {}};
  for (int i = 0; i < width * height * channels; ++i)
    image.pixels.push_back(static_cast<uint8_t>(value(random)));
  return image;
}

Image8 Constant(int width, int height, int channels, uint8_t value) {
  return {width, height, channels,
          std::vector<uint8_t>(static_cast<size_t>(width) * height * channels, value)};
}

double At(const Image8& image, int x, int y, int channel) {
  if (x < 0 || y < 0 || x >= image.width || y >= image.height) return 0;
  return image.Pixel(x, y)[channel] / 255.0;
}

// Straight from the definition: a 2D window, zeros outside, central moments in a second pass.
double DirectSsim(const Image8& a, const Image8& b, int x, int y) {
  double total = 0;
  for (int channel = 0; channel < a.channels; ++channel) {
    double weights = 0;
    for (int dy = -5; dy <= 5; ++dy) {
      for (int dx = -5; dx <= 5; ++dx) weights += std::exp(-(dx * dx + dy * dy) / 4.5);
    }
    double mean_a = 0, mean_b = 0, var_a = 0, var_b = 0, covariance = 0;
    for (const bool is_second_pass : {false, true}) {
      for (int dy = -5; dy <= 5; ++dy) {
        for (int dx = -5; dx <= 5; ++dx) {
          const double weight = std::exp(-(dx * dx + dy * dy) / 4.5) / weights;
          const double va = At(a, x + dx, y + dy, channel), vb = At(b, x + dx, y + dy, channel);
          if (is_second_pass) {
            var_a += weight * (va - mean_a) * (va - mean_a);
            var_b += weight * (vb - mean_b) * (vb - mean_b);
            covariance += weight * (va - mean_a) * (vb - mean_b);
          } else {
            mean_a += weight * va;
            mean_b += weight * vb;
          }
        }
      }
    }
    total += (2 * mean_a * mean_b + 1e-4) * (2 * covariance + 9e-4) /
             ((mean_a * mean_a + mean_b * mean_b + 1e-4) * (var_a + var_b + 9e-4));
  }
  return total / a.channels;
}

TEST(Ssim, EqualsTheDefinitionAtEveryPixel) {
  struct Size {
    int width, height, channels;
  };
  for (const Size& size : {Size{1, 1, 1}, Size{3, 20, 3}, Size{20, 4, 1}, Size{25, 17, 3}}) {
    const Image8 a = RandomImage(size.width, size.height, size.channels, 1);
    Image8 b = RandomImage(size.width, size.height, size.channels, 2);
    // Half alike, so that structure is found.
    for (size_t i = 0; i < b.pixels.size(); ++i)
      b.pixels[i] = static_cast<uint8_t>((b.pixels[i] + a.pixels[i]) / 2);
    const SsimMap map = ComputeSsim(a, b);
    double sum = 0, sum_valid = 0;
    int num_valid = 0;
    for (int y = 0; y < size.height; ++y) {
      for (int x = 0; x < size.width; ++x) {
        const double expected = DirectSsim(a, b, x, y);
        // Measured: 5e-15.
        EXPECT_NEAR(map.values[y * size.width + x], expected, 1e-13);
        sum += expected;
        if (x >= 5 && y >= 5 && x < size.width - 5 && y < size.height - 5) {
          sum_valid += expected;
          ++num_valid;
        }
      }
    }
    EXPECT_NEAR(map.Mean(), sum / (size.width * size.height), 1e-13);
    if (num_valid > 0) {
      EXPECT_NEAR(map.MeanOfValid(), sum_valid / num_valid, 1e-13);
    } else {
      EXPECT_TRUE(std::isnan(map.MeanOfValid()));
    }
  }
}

TEST(Ssim, ClosedForms) {
  const Image8 noise = RandomImage(20, 20, 3, 3);
  EXPECT_NEAR(ComputeSsim(noise, noise).Mean(), 1, 1e-14);
  // Constants: no variance where the window is full.
  const double a = 100 / 255.0, b = 150 / 255.0;
  EXPECT_NEAR(ComputeSsim(Constant(20, 20, 1, 100), Constant(20, 20, 1, 150)).MeanOfValid(),
              (2 * a * b + 1e-4) / (a * a + b * b + 1e-4), 1e-12);
}

TEST(Ssim, MaskedMean) {
  const Image8 a = RandomImage(20, 15, 3, 4), b = RandomImage(20, 15, 3, 5);
  const SsimMap map = ComputeSsim(a, b);
  PixelMask mask{20, 15, std::vector<uint8_t>(300)};
  EXPECT_TRUE(std::isnan(map.Mean(mask)));
  mask.inside[7] = mask.inside[211] = 1;
  EXPECT_NEAR(map.Mean(mask), (map.values[7] + map.values[211]) / 2, 1e-15);
}

TEST(Psnr, ClosedForms) {
  const Image8 grey = Constant(8, 6, 3, 100);
  EXPECT_NEAR(Psnr(grey, Constant(8, 6, 3, 101)), 20 * std::log10(255.0), 1e-12);
  EXPECT_NEAR(Psnr(Constant(8, 6, 3, 0), Constant(8, 6, 3, 255)), 0, 1e-12);
  EXPECT_TRUE(std::isinf(Psnr(grey, grey)));
  // One channel of one pixel of 48 is off by 5: MSE = 25 / 144.
  Image8 other = grey;
  other.Pixel(3, 2)[1] = 105;
  EXPECT_NEAR(Psnr(grey, other), 10 * std::log10(255.0 * 255.0 * 144 / 25), 1e-12);
  PixelMask mask{8, 6, std::vector<uint8_t>(48)};
  EXPECT_TRUE(std::isnan(Psnr(grey, other, &mask)));
  mask.inside[2 * 8 + 3] = mask.inside[0] = 1;
  EXPECT_NEAR(Psnr(grey, other, &mask), 10 * std::log10(255.0 * 255.0 * 6 / 25), 1e-12);
  mask.inside[2 * 8 + 3] = 0;
  EXPECT_TRUE(std::isinf(Psnr(grey, other, &mask)));
}

TEST(MaskFromImage, BrighterThan127) {
  const PixelMask mask = MaskFromImage({4, 1, 1, {0, 127, 128, 255}});
  EXPECT_EQ(mask.inside, (std::vector<uint8_t>{0, 0, 1, 1}));
  EXPECT_EQ(mask.Count(), 2);
}

TEST(ResizeNearest, WholeFactorsAndOddOnes) {
  const PixelMask mask{3, 2, {1, 0, 1, 0, 1, 0}};
  EXPECT_EQ(ResizeNearest(mask, 6, 4).inside, (std::vector<uint8_t>{1, 1, 0, 0, 1, 1, 1, 1, 0, 0, 1, 1,  //
                                                                    0, 0, 1, 1, 0, 0, 0, 0, 1, 1, 0, 0}));
  EXPECT_EQ(ResizeNearest(mask, 3, 2).inside, mask.inside);
  // Columns floor(x * 3 / 2) = 0, 1 and row 0.
  EXPECT_EQ(ResizeNearest(mask, 2, 1).inside, (std::vector<uint8_t>{1, 0}));
  EXPECT_EQ(ResizeNearest({1, 1, {1}}, 2, 2).inside, (std::vector<uint8_t>{1, 1, 1, 1}));
}

TEST(Widened, SquaresAboutEachPixelEndAtTheBorder) {
  const PixelMask mask{5,
                       3,
                       {0, 0, 0, 0, 1,  //
                        0, 0, 0, 0, 0,  //
                        1, 0, 0, 0, 0}};
  EXPECT_EQ(Widened(mask, 0).inside, mask.inside);
  EXPECT_EQ(Widened(mask, 1).inside, (std::vector<uint8_t>{0, 0, 0, 1, 1,  //
                                                           1, 1, 0, 1, 1,  //
                                                           1, 1, 0, 0, 0}));
}

TEST(CompareMask, CountedByHand) {
  // Labels:       object object object disc disc static static static; mask: 1 1 0 1 0 1 0 0.
  const Image8 labels{8, 1, 1, {255, 255, 255, 128, 128, 0, 0, 0}};
  const MaskOverlap overlap = CompareMask({8, 1, {1, 1, 0, 1, 0, 1, 0, 0}}, labels, 255, 128, 0);
  EXPECT_DOUBLE_EQ(overlap.rotating_iou, 3.0 / 6);
  EXPECT_DOUBLE_EQ(overlap.object_iou, 2.0 / 4);
  // Twice the size, every pixel doubled.
  const MaskOverlap large = CompareMask({4, 1, {1, 1, 0, 0}}, labels, 255, 128, 0);
  EXPECT_DOUBLE_EQ(large.rotating_iou, 4.0 / 5);
  EXPECT_DOUBLE_EQ(large.object_iou, 3.0 / 3);
  const MaskOverlap empty = CompareMask({1, 1, {0}}, {1, 1, 1, {0}}, 255, 128, 0);
  EXPECT_EQ(empty.rotating_iou, 0);
  EXPECT_EQ(empty.object_iou, 0);
}

}  // namespace
}  // namespace s2gs
