#include "mesh/texture/texture_photo.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <vector>

#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

constexpr int kWidth = 160;  // [px]
constexpr int kHeight = 120;
constexpr double kFocalX = 300;
constexpr double kFocalY = 260;
constexpr double kCx = 75.3;
constexpr double kCy = 62.1;

// A parallelogram before the camera, in its frame.
struct Quad {
  Eigen::Vector3d corner, along, across;
};

// The same as TexturePhoto in double precision, pixel by pixel, from rays that meet the parallelograms.
class Reference {
 public:
  Reference(const std::vector<Quad>& quads, const Image8& photo, const Image8& mask,
            const Eigen::AlignedBox2i& part)
      : photo_(photo), part_(part) {
    const int width = part.sizes().x();
    const int height = part.sizes().y();
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x)
        inverse_.push_back(InverseDepth(quads, x + part.min().x(), y + part.min().y()));
    }
    FindDistances(mask);
    FindBlocks();
  }

  struct Sample {
    double weight = 0;
    Eigen::Array3d color, smooth;
  };
  // \param x  in the camera.
  std::optional<Sample> At(const Eigen::Vector3d& x, const Eigen::Vector3d& normal) const {
    const double cosine = normal.dot(-x.normalized());
    if (cosine <= 0.1) return std::nullopt;
    const Eigen::Vector2d p(kFocalX * x.x() / x.z() + kCx - part_.min().x(),
                            kFocalY * x.y() / x.z() + kCy - part_.min().y());
    const int width = part_.sizes().x();
    const int height = part_.sizes().y();
    if (p.x() < 0.5 || p.y() < 0.5 || p.x() > width - 0.5 || p.y() > height - 0.5) return std::nullopt;
    const int x0 = std::min(static_cast<int>(p.x() - 0.5), width - 2);
    const int y0 = std::min(static_cast<int>(p.y() - 0.5), height - 2);
    double farthest = std::numeric_limits<double>::infinity();
    for (const int i : {0, 1, width, width + 1}) farthest = std::min(farthest, inverse_[y0 * width + x0 + i]);
    const double slope = std::tan(std::acos(std::min(1.0, cosine)));
    if (x.z() * farthest > 1 + (2 + 1.5 * slope) / kFocalX) return std::nullopt;
    const double thirds = distances_[static_cast<int>(p.y()) * width + static_cast<int>(p.x())];
    if (thirds == 0) return std::nullopt;
    const double along = std::min(1.0, thirds / 24);
    Sample sample;
    sample.weight = std::max(1e-3, along * along * (3 - 2 * along)) * (cosine - 0.1) * kFocalX * kFocalY /
                    (x.z() * x.z());
    sample.color = Cubic(p.x() - 0.5, p.y() - 0.5);
    // The blocks around that show the same surface, as far as they reach.
    const double u = std::clamp(p.x() / 4 - 0.5, 0.0, columns_ - 1.0);
    const double v = std::clamp(p.y() / 4 - 0.5, 0.0, rows_ - 1.0);
    double share = 0;
    Eigen::Array3d sum = Eigen::Array3d::Zero();
    for (int row = 0; row < rows_; ++row) {
      for (int column = 0; column < columns_; ++column) {
        const double weight = std::max(0.0, 1 - std::abs(u - column)) * std::max(0.0, 1 - std::abs(v - row));
        if (weight == 0 || !IsSame(middles_[row * columns_ + column], 1 / x.z())) continue;
        share += weight;
        sum += weight * smooth_[row * columns_ + column];
      }
    }
    if (share < 0.05) return std::nullopt;
    sample.smooth = sum / share;
    return sample;
  }

 private:
  static double InverseDepth(const std::vector<Quad>& quads, int x, int y) {
    double nearest = 0;
    for (const Quad& quad : quads) {
      Eigen::Matrix3d matrix;
      matrix.col(0) = -quad.along;
      matrix.col(1) = -quad.across;
      matrix.col(2) = Eigen::Vector3d((x + 0.5 - kCx) / kFocalX, (y + 0.5 - kCy) / kFocalY, 1);
      const Eigen::Vector3d at = matrix.inverse() * quad.corner;
      if (at.x() > 0 && at.x() < 1 && at.y() > 0 && at.y() < 1 && at.z() > 0)
        nearest = std::max(nearest, 1 / at.z());
    }
    return nearest;
  }
  static bool IsSame(double a, double b) { return a > 0 && b > 0 && std::abs(a / b - 1) <= 8 / kFocalX; }

  // To each pixel from the nearest at which something ends: 3 a step, 4 a diagonal one.
  void FindDistances(const Image8& mask) {
    const int width = part_.sizes().x();
    const int height = part_.sizes().y();
    std::vector<Eigen::Vector2i> borders;
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        const int column = x + part_.min().x();
        const int row = y + part_.min().y();
        const double own = inverse_[y * width + x];
        bool ends = column == 0 || row == 0 || column == kWidth - 1 || row == kHeight - 1 || own == 0;
        if (!mask.pixels.empty())
          ends = ends || *mask.Pixel(column * mask.width / kWidth, row * mask.height / kHeight) < 128;
        for (const auto& [dx, dy] : {std::pair(-1, 0), std::pair(1, 0), std::pair(0, -1), std::pair(0, 1)}) {
          if (x + dx < 0 || y + dy < 0 || x + dx >= width || y + dy >= height) continue;
          ends = ends || inverse_[(y + dy) * width + x + dx] > own * (1 + 6 / kFocalX);
        }
        if (ends) borders.emplace_back(x, y);
      }
    }
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        int nearest = 24;
        for (const Eigen::Vector2i& border : borders) {
          const Eigen::Vector2i apart = (border - Eigen::Vector2i(x, y)).cwiseAbs();
          nearest = std::min(nearest, 3 * apart.maxCoeff() + apart.minCoeff());
        }
        distances_.push_back(nearest);
      }
    }
  }

  void FindBlocks() {
    const int width = part_.sizes().x();
    const int height = part_.sizes().y();
    columns_ = (width + 3) / 4;
    rows_ = (height + 3) / 4;
    std::vector<Eigen::Array3d> sums(columns_ * rows_, Eigen::Array3d::Zero());
    std::vector<double> counts(sums.size(), 0);
    middles_.assign(sums.size(), 0);
    const auto for_each = [&](const auto& use) {
      for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) {
          if (distances_[y * width + x] > 0) use(y / 4 * columns_ + x / 4, x, y);
        }
      }
    };
    std::vector<std::vector<double>> depths(sums.size());
    for_each([&](int block, int x, int y) { depths[block].push_back(inverse_[y * width + x]); });
    for (size_t i = 0; i < sums.size(); ++i) {
      std::sort(depths[i].begin(), depths[i].end());
      if (!depths[i].empty()) middles_[i] = depths[i][depths[i].size() / 2];
    }
    for_each([&](int block, int x, int y) {
      if (!IsSame(inverse_[y * width + x], middles_[block])) return;
      sums[block] += ColorAt(x, y);
      counts[block] += 1;
    });
    for (int row = 0; row < rows_; ++row) {
      for (int column = 0; column < columns_; ++column) {
        Eigen::Array3d sum = Eigen::Array3d::Zero();
        double count = 0;
        for (int j = std::max(0, row - 1); j <= std::min(rows_ - 1, row + 1); ++j) {
          for (int i = std::max(0, column - 1); i <= std::min(columns_ - 1, column + 1); ++i) {
            const int block = j * columns_ + i;
            if (!IsSame(middles_[block], middles_[row * columns_ + column])) continue;
            const double weight = (i == column ? 2 : 1) * (j == row ? 2 : 1);
            sum += weight * sums[block];
            count += weight * counts[block];
          }
        }
        smooth_.push_back((sum / count).round());
      }
    }
  }

  Eigen::Array3d ColorAt(int x, int y) const {
    const uint8_t* rgb = photo_.Pixel(part_.min().x() + x, part_.min().y() + y);
    return {double(rgb[0]), double(rgb[1]), double(rgb[2])};
  }
  // Keys's kernel for a = -1/2.
  static double Kernel(double t) {
    t = std::abs(t);
    if (t < 1) return (1.5 * t - 2.5) * t * t + 1;
    return t < 2 ? ((-0.5 * t + 2.5) * t - 4) * t + 2 : 0;
  }
  Eigen::Array3d Cubic(double x, double y) const {
    Eigen::Array3d sum = Eigen::Array3d::Zero();
    for (int row = static_cast<int>(y) - 2; row <= static_cast<int>(y) + 3; ++row) {
      for (int column = static_cast<int>(x) - 2; column <= static_cast<int>(x) + 3; ++column) {
        sum +=
            Kernel(x - column) * Kernel(y - row) *
            ColorAt(std::clamp(column, 0, part_.sizes().x() - 1), std::clamp(row, 0, part_.sizes().y() - 1));
      }
    }
    return sum.max(0).min(255);
  }

  const Image8& photo_;
  Eigen::AlignedBox2i part_;
  std::vector<double> inverse_;
  std::vector<int> distances_;
  int columns_ = 0, rows_ = 0;
  std::vector<double> middles_;
  std::vector<Eigen::Array3d> smooth_;
};

Image8 RandomPhoto() {
  RandomNumbers random(4);
  Image8 photo{kWidth, kHeight, 3, {}};
  for (int i = 0; i < 3 * kWidth * kHeight; ++i)
    photo.pixels.push_back(static_cast<uint8_t>(random.Uniform(0, 256)));
  return photo;
}

// Inside but for a disc and a strip; 127 is outside, 128 is not.
Image8 Mask() {
  Image8 mask{80, 40, 1, {}};
  for (int y = 0; y < mask.height; ++y) {
    for (int x = 0; x < mask.width; ++x) {
      const bool is_outside = std::hypot(x - 30, 2 * (y - 14)) < 9 || x == 55;
      mask.pixels.push_back(is_outside ? 127 : 128);
    }
  }
  return mask;
}

struct Compared {
  int seen = 0;
  int hidden = 0;
  int other_seen = 0;  // by one of the two alone
};

// \param part  of the photo that shows the parallelograms, with a margin.
Compared Compare(const std::vector<Quad>& quads, bool is_one_behind, const Image8& mask,
                 const Eigen::AlignedBox2i& part) {
  ObjectView view{kWidth, kHeight, kFocalX, kFocalY, kCx, kCy, {}};
  view.cam_from_object = {Eigen::Quaterniond(Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, -2).normalized())),
                          {0.4, -0.2, 1.1}};
  const Rigid3 object_from_cam = view.cam_from_object.Inverse();
  TriangleMesh mesh;
  const auto add = [&](const Quad& quad) {
    const auto first = static_cast<uint32_t>(mesh.vertices.size());
    for (const auto& [a, b] : {std::pair(0, 0), std::pair(1, 0), std::pair(1, 1), std::pair(0, 1)}) {
      mesh.vertices.push_back(
          (object_from_cam * (quad.corner + a * quad.along + b * quad.across)).cast<float>());
    }
    mesh.triangles.emplace_back(first, first + 1, first + 2);
    mesh.triangles.emplace_back(first, first + 2, first + 3);
  };
  for (const Quad& quad : quads) add(quad);
  if (is_one_behind) add({{-1, -1, -2}, {1, 0, 0}, {0, 1, 0}});
  const Image8 photo = RandomPhoto();
  const TexturePhoto tried(view, photo, mask, mesh);
  const Reference reference(quads, photo, mask, part);
  RandomNumbers random(5);
  Compared compared;
  for (int i = 0; i < 4000; ++i) {
    const Quad& quad = quads[i % quads.size()];
    Eigen::Vector3d x =
        quad.corner + random.Uniform(-0.02, 1.02) * quad.along + random.Uniform(-0.02, 1.02) * quad.across;
    if (i % 3 == 0) x *= random.Uniform(0.97, 1.03);
    Eigen::Vector3d normal = -x.normalized();
    if (i % 2 == 0)
      normal = (normal + Eigen::Vector3d(random.Normal(), random.Normal(), random.Normal())).normalized();
    PhotoSample sample;
    const bool is_seen = tried.Sample((object_from_cam * x).cast<float>(),
                                      (object_from_cam.rotation * normal).cast<float>(), &sample);
    const std::optional<Reference::Sample> expected = reference.At(x, normal);
    if (is_seen != expected.has_value()) {
      ++compared.other_seen;
      continue;
    }
    if (!is_seen) {
      ++compared.hidden;
      continue;
    }
    ++compared.seen;
    EXPECT_NEAR(sample.weight / expected->weight, 1, 1e-4);
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(sample.color[c], expected->color[c], 0.52);
      EXPECT_NEAR(sample.smooth[c], expected->smooth[c], 0.52);
    }
  }
  return compared;
}

// What shows the corners, eight pixels more on each side as far as the photo goes.
Eigen::AlignedBox2i PartOf(const std::vector<Quad>& quads) {
  Eigen::AlignedBox2d box;
  for (const Quad& quad : quads) {
    for (const auto& [a, b] : {std::pair(0, 0), std::pair(1, 0), std::pair(1, 1), std::pair(0, 1)}) {
      const Eigen::Vector3d x = quad.corner + a * quad.along + b * quad.across;
      box.extend(Eigen::Vector2d(kFocalX * x.x() / x.z() + kCx, kFocalY * x.y() / x.z() + kCy));
    }
  }
  const Eigen::Array2d first = box.min().array().floor() - 8;
  const Eigen::Array2d last = box.max().array().ceil() + 8;
  return {first.max(0).cast<int>().matrix(), last.min(Eigen::Array2d(kWidth, kHeight)).cast<int>().matrix()};
}

// A wall that leans, a step before it and a post close to the camera.
std::vector<Quad> WallStepAndPost(double width) {
  return {{{-0.5, -0.45, 3.9}, {width, 0, 0.2}, {0.02, 0.8, 0.1}},
          {{-0.2, -0.1, 3.88}, {0.25, 0.01, 0}, {0, 0.25, 0}},
          {{0.21, -0.37, 3.2}, {0.03, 0, 0}, {0.01, 0.6, 0.02}}};
}

// Rounded to whole values in single precision; of the smooth values those of blocks first.
void ExpectAlike(const Compared& compared) {
  EXPECT_GT(compared.seen, 800);
  EXPECT_GT(compared.hidden, 800);
  EXPECT_LE(compared.other_seen, 3);
}

TEST(TexturePhoto, EqualsAReferenceInPartOfThePhoto) {
  const std::vector<Quad> quads = WallStepAndPost(0.9);
  ExpectAlike(Compare(quads, false, {}, PartOf(quads)));
}

TEST(TexturePhoto, EqualsAReferenceBehindAMask) {
  const std::vector<Quad> quads = WallStepAndPost(0.9);
  ExpectAlike(Compare(quads, false, Mask(), PartOf(quads)));
}

// Where a part of the mesh lies behind the camera, all of the photo is kept.
TEST(TexturePhoto, EqualsAReferenceUpToThePhotosBorders) {
  ExpectAlike(
      Compare(WallStepAndPost(2), true, Mask(), {Eigen::Vector2i(0, 0), Eigen::Vector2i(kWidth, kHeight)}));
}

}  // namespace
}  // namespace s2gs
