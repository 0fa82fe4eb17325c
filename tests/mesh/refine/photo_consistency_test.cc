#include "mesh/refine/photo_consistency.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

constexpr int kWidth = 60;  // [px]
constexpr int kHeight = 50;
constexpr double kFocalX = 300;
constexpr double kFocalY = 280;
constexpr double kDistance = 5;
constexpr double kNoise = 2;  // grey levels that are no texture

using Texture = std::function<double(double, double)>;

// Photos of the plane z = 0 about the origin.
struct Photo {
  ObjectView view;
  Image8 grey;
};

ObjectView ViewFrom(double azimuth, double elevation) {
  const Eigen::Vector3d back(std::cos(azimuth) * std::cos(elevation), std::sin(azimuth) * std::cos(elevation),
                             std::sin(elevation));
  Eigen::Matrix3d rotation;
  rotation.row(2) = -back;
  rotation.row(0) = Eigen::Vector3d::UnitZ().cross(back).normalized();
  rotation.row(1) = rotation.row(2).cross(rotation.row(0));
  return {
      kWidth, kHeight, kFocalX, kFocalY, 31, 24, {Eigen::Quaterniond(rotation), {0.01, -0.02, kDistance}}};
}

Photo PhotoOf(const ObjectView& view, const Texture& texture) {
  Photo photo{view, {kWidth, kHeight, 1, {}}};
  const Rigid3 object_from_cam = view.cam_from_object.Inverse();
  for (int row = 0; row < kHeight; ++row) {
    for (int column = 0; column < kWidth; ++column) {
      const Eigen::Vector3d ray =
          object_from_cam.rotation *
          Eigen::Vector3d((column + 0.5 - view.cx) / view.fx, (row + 0.5 - view.cy) / view.fy, 1);
      const Eigen::Vector3d x = object_from_cam.translation - object_from_cam.translation.z() / ray.z() * ray;
      photo.grey.pixels.push_back(static_cast<uint8_t>(std::clamp(texture(x.x(), x.y()), 0.0, 255.0)));
    }
  }
  return photo;
}

Texture Waves(double amplitude, double phase) {
  return [=](double x, double y) { return 120 + amplitude * std::cos(70 * x + 45 * y + phase) + 200 * x; };
}

// Half as large: means of four.
Image8 Halved(const Image8& image) {
  Image8 half{image.width / 2, image.height / 2, 1, {}};
  for (int y = 0; y < half.height; ++y) {
    for (int x = 0; x < half.width; ++x) {
      double sum = 0;
      for (const auto& [i, j] : {std::pair(0, 0), std::pair(1, 0), std::pair(0, 1), std::pair(1, 1)})
        sum += *image.Pixel(2 * x + i, 2 * y + j);
      half.pixels.push_back(static_cast<uint8_t>(sum / 4 + 0.5));
    }
  }
  return half;
}

// What a photo shows at the patch's points, whose picture is that of a plane far away: by differences.
std::vector<double> Shown(const Photo& photo, const SurfacePatch& patch, const Eigen::Vector3d& middle,
                          int level) {
  const Image8 image = level == 0 ? photo.grey : Halved(photo.grey);
  const double scale = level == 0 ? 1 : 0.5;
  const auto pixel = [&](const Eigen::Vector3d& x_in_object) -> Eigen::Vector2d {
    const Eigen::Vector3d x = photo.view.cam_from_object * x_in_object;
    return scale *
           Eigen::Vector2d(kFocalX * x.x() / x.z() + photo.view.cx, kFocalY * x.y() / x.z() + photo.view.cy);
  };
  const auto step = [&](const Eigen::Vector3f& along) -> Eigen::Vector2d {
    const Eigen::Vector3d little = 1e-5 * along.cast<double>();
    return patch.spacing * (pixel(middle + little) - pixel(middle - little)) / 2e-5;
  };
  std::vector<double> values;
  for (int k = 0; k < patch.num_points; ++k) {
    const Eigen::Vector3d point = patch.points[k].cast<double>();
    const Eigen::Vector2d p = pixel(middle) + point.x() * step(patch.u) + point.y() * step(patch.v) +
                              point.z() * step(patch.normal) - Eigen::Vector2d(0.5, 0.5);
    const double x = std::clamp(p.x(), 0.0, image.width - 1.001);
    const double y = std::clamp(p.y(), 0.0, image.height - 1.001);
    double value = 0;
    for (int j = 0; j < image.height; ++j) {
      for (int i = 0; i < image.width; ++i) {
        value += std::max(0.0, 1 - std::abs(x - i)) * std::max(0.0, 1 - std::abs(y - j)) * *image.Pixel(i, j);
      }
    }
    values.push_back(value);
  }
  return values;
}

// Without their mean and half of their slope, of length 1 but for noise. \return  and the length.
std::pair<Eigen::VectorXd, double> Normalised(const std::vector<double>& values, const SurfacePatch& patch) {
  Eigen::VectorXd grey = Eigen::Map<const Eigen::VectorXd>(values.data(), patch.num_points);
  Eigen::MatrixXd design(patch.num_points, 3);
  for (int k = 0; k < patch.num_points; ++k) design.row(k) << 1, patch.points[k].x(), patch.points[k].y();
  const Eigen::Vector3d plane = design.colPivHouseholderQr().solve(grey);
  const double mean = grey.mean();
  const Eigen::VectorXd slope = (design.rightCols(2) * plane.tail<2>()).eval();
  grey.array() -= mean;
  grey -= 0.5 * (slope.array() - slope.mean()).matrix();
  const double scale = std::sqrt(grey.squaredNorm() + patch.num_points * kNoise * kNoise);
  return {grey / scale, grey.norm() / scale};
}

class PhotoConsistency : public testing::Test {
 protected:
  void Add(double azimuth, double elevation, const Texture& texture) {
    photos_.push_back(PhotoOf(ViewFrom(azimuth, elevation), texture));
    pyramids_.push_back(std::make_unique<PhotoPyramid>(photos_.back().view, photos_.back().grey));
    all_.push_back(pyramids_.back().get());
  }
  const Photo& PhotoBehind(const PhotoPyramid* pyramid) const {
    for (size_t i = 0; i < all_.size(); ++i) {
      if (all_[i] == pyramid) return photos_[i];
    }
    return photos_.front();
  }
  SurfacePatch PatchOf(int max_views) const {
    SurfacePatch patch;
    patch.middle = {0.02F, -0.01F, 0};
    patch.normal = Eigen::Vector3f(0.1F, -0.05F, 1).normalized();
    SelectPhotos(all_, max_views, &patch);
    return patch;
  }
  PatchAgreement AgreementAt(const SurfacePatch& patch, const Eigen::Vector3d& middle, int level) const {
    std::vector<Eigen::VectorXd> values;
    double squares = 0;
    double weights = 0;
    for (int i = 0; i < patch.num_views; ++i) {
      const auto [normalised, length] =
          Normalised(Shown(PhotoBehind(patch.views[i]), patch, middle, level), patch);
      values.push_back(normalised);
      squares += patch.cosines[i] * patch.cosines[i] * length * length;
      weights += patch.cosines[i] * patch.cosines[i];
    }
    double products = 0;
    double of_pairs = 0;
    for (int i = 0; i < patch.num_views; ++i) {
      for (int j = 0; j < patch.num_views; ++j) {
        if (i == j) continue;
        products += patch.cosines[i] * patch.cosines[j] * values[i].dot(values[j]);
        of_pairs += patch.cosines[i] * patch.cosines[j];
      }
    }
    return {static_cast<float>(products / of_pairs), static_cast<float>(squares / weights)};
  }

  std::vector<Photo> photos_;
  std::vector<std::unique_ptr<PhotoPyramid>> pyramids_;
  std::vector<const PhotoPyramid*> all_;
};

TEST_F(PhotoConsistency, PixelsAreThoseOfTheFinerAxisAtThePointsDepth) {
  Add(0.3, 1.2, Waves(40, 0));
  const Eigen::Vector3d x(0.1, 0.2, -0.3);
  EXPECT_NEAR(all_[0]->PixelSize(x.cast<float>()), (photos_[0].view.cam_from_object * x).z() / kFocalX, 1e-6);
  EXPECT_LT((all_[0]->center().cast<double>() - CameraCentre(photos_[0].view.cam_from_object)).norm(), 1e-5);
  SurfacePatch patch = PatchOf(1);
  for (const int level : {0, 1}) {
    patch.LayFlat(level);
    EXPECT_NEAR(patch.spacing, all_[0]->PixelSize(patch.middle) * (level == 0 ? 1 : 2), 1e-7);
    Eigen::Matrix3f frame;
    frame << patch.u, patch.v, patch.normal;
    EXPECT_LT((frame.transpose() * frame - Eigen::Matrix3f::Identity()).norm(), 1e-5F);
    EXPECT_GT(frame.determinant(), 0);
    ASSERT_EQ(patch.num_points, 25);
    for (int k = 0; k < 25; ++k)
      EXPECT_EQ(patch.points[k],
                Eigen::Vector3f(static_cast<float>(k % 5 - 2), static_cast<float>(k / 5 - 2), 0));
  }
}

// Of both levels, on the plane and beside it, up to beyond the photo's borders.
TEST_F(PhotoConsistency, SamplesAreThoseOfAnAffineView) {
  Add(0.3, 1.2, Waves(90, 0));
  Add(2.3, 0.7, Waves(90, 1));
  SurfacePatch patch = PatchOf(2);
  for (const int level : {0, 1}) {
    patch.LayFlat(level);
    for (int k = 0; k < 25; ++k) patch.points[k].z() = 0.1F * static_cast<float>(k % 7);
    for (const Photo& photo : photos_) {
      const PhotoPyramid pyramid(photo.view, photo.grey);
      for (const Eigen::Vector3d& middle :
           {Eigen::Vector3d(0.02, -0.01, 0), Eigen::Vector3d(0.1, 0.1, 0.05), Eigen::Vector3d(0.49, 0, 0),
            Eigen::Vector3d(-0.52, 0.1, 0), Eigen::Vector3d(0, 0.45, 0), Eigen::Vector3d(0.05, -0.45, 0)}) {
        std::array<float, kPatchSize> values{};
        pyramid.SamplePatch(patch, middle.cast<float>(), level, values.data());
        const std::vector<double> expected = Shown(photo, patch, middle, level);
        // Measured: .02, from single precision.
        for (int k = 0; k < 25; ++k) EXPECT_NEAR(values[k], expected[k], 0.1) << level << " " << k;
      }
    }
  }
}

// One after another the photo whose cosine times its angle to the nearest that is taken, .26 at most, is
// largest.
TEST_F(PhotoConsistency, TakesPhotosThatFaceThePatchFromDifferentSides) {
  RandomNumbers random(2);
  for (int i = 0; i < 30; ++i) Add(random.Uniform(0, 6.28), random.Uniform(-0.3, 1.5), Waves(0, 0));
  all_.push_back(all_[3]);  // from the same place: of no use
  for (const int most : {1, 5, 12, 16}) {
    const SurfacePatch patch = PatchOf(most);
    std::vector<const PhotoPyramid*> taken;
    const Eigen::Vector3d normal = patch.normal.cast<double>();
    const auto direction = [&](const PhotoPyramid* photo) -> Eigen::Vector3d {
      return (photo->center() - patch.middle).cast<double>().normalized();
    };
    while (static_cast<int>(taken.size()) < most) {
      const PhotoPyramid* best = nullptr;
      double best_value = 1e-3;
      for (const PhotoPyramid* photo : all_) {
        double angle = 0.26;
        for (const PhotoPyramid* other : taken)
          angle = std::min(angle, std::acos(std::min(1.0, direction(photo).dot(direction(other)))));
        const double value = normal.dot(direction(photo)) * angle;
        if (value > best_value) {
          best = photo;
          best_value = value;
        }
      }
      if (best == nullptr) break;
      taken.push_back(best);
    }
    ASSERT_EQ(patch.num_views, static_cast<int>(taken.size()));
    for (int i = 0; i < patch.num_views; ++i) {
      EXPECT_EQ(patch.views[i], taken[i]) << most << " " << i;
      EXPECT_NEAR(patch.cosines[i], normal.dot(direction(taken[i])), 1e-5);
    }
  }
}

TEST_F(PhotoConsistency, IsTheMeanCorrelationOfAllPairs) {
  Add(0.3, 1.3, Waves(40, 0));
  Add(1.6, 0.9, Waves(30, 0));
  Add(3.1, 0.8, Waves(5, 0.4));
  Add(4.4, 1.1, Waves(60, 1.2));
  SurfacePatch patch = PatchOf(4);
  ASSERT_EQ(patch.num_views, 4);
  for (const int level : {0, 1}) {
    patch.LayFlat(level);
    std::array<float, 7> curve{};
    constexpr float kStep = 0.01F;
    ConsistencyCurve(patch, level, kStep, 3, curve.data());
    for (int offset = -3; offset <= 3; ++offset) {
      const Eigen::Vector3f middle = patch.middle + static_cast<float>(offset) * kStep * patch.normal;
      EXPECT_NEAR(curve[offset + 3], AgreementAt(patch, middle.cast<double>(), level).correlation, 1e-3);
    }
  }
  patch.LayFlat(0);
  for (const int count : {25, 12}) {
    patch.num_points = count;
    const PatchAgreement expected = AgreementAt(patch, patch.middle.cast<double>(), 0);
    const PatchAgreement found = MeasureAgreement(patch);
    EXPECT_NEAR(found.correlation, expected.correlation, 1e-3);
    EXPECT_NEAR(found.texture, expected.texture, 1e-3);
    EXPECT_GT(found.texture, 0.3);
  }
}

// By the rule of its docstring, pair by pair, for photos of two textures and of none.
TEST_F(PhotoConsistency, PhotosDisagreeWhereFewPairsAreAlike) {
  RandomNumbers random(7);
  int num_disagree = 0;
  for (int trial = 0; trial < 60; ++trial) {
    photos_.clear();
    pyramids_.clear();
    all_.clear();
    const int count = 3 + trial % 6;
    for (int i = 0; i < count; ++i) {
      const double amplitude = random.Uniform() < 0.3 ? random.Uniform(0, 6) : 40;
      const double own = random.Uniform() < 0.25 ? 0 : random.Uniform(0, 6.28);
      Add(6.28 * i / count, 1.1, Waves(amplitude, own));
    }
    SurfacePatch patch = PatchOf(count);
    patch.LayFlat(0);
    for (const float least : {0.1F, 0.7F}) {
      std::vector<std::pair<Eigen::VectorXd, double>> textured;
      for (int i = 0; i < patch.num_views; ++i) {
        const auto shown =
            Normalised(Shown(PhotoBehind(patch.views[i]), patch, patch.middle.cast<double>(), 0), patch);
        if (shown.second * shown.second > least) textured.push_back(shown);
      }
      const auto num = static_cast<int>(textured.size());
      int alike = 0;
      for (int i = 0; i < num; ++i) {
        for (int j = 0; j < i; ++j) {
          const double both = textured[i].second * textured[j].second - 0.5;
          alike += textured[i].first.dot(textured[j].first) >= both ? 1 : 0;
        }
      }
      const bool says_something = num >= 2 && 2 * num >= patch.num_views;
      const bool expected = says_something && 5 * alike < num * (num - 1) / 2;
      EXPECT_EQ(PhotosDisagree(patch, least), expected) << trial << " " << alike << " of " << num;
      num_disagree += expected ? 1 : 0;
    }
  }
  EXPECT_GT(num_disagree, 20);
  EXPECT_LT(num_disagree, 100);
}

}  // namespace
}  // namespace s2gs
