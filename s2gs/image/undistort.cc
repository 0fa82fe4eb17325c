#include "s2gs/image/undistort.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <string>

#include "s2gs/image/picture_rows.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scene/camera_check.h"

namespace s2gs {
namespace {

Eigen::Vector2d PinholePoint(const Eigen::Vector3d& ray, const Eigen::Vector2d& focal,
                             const Eigen::Vector2d& principal) {
  return focal.cwiseProduct(ray.head<2>()) + principal;
}

// How far the pinhole may grow beyond the photo, in the photo's sides.
constexpr double kMaxGrowth = 4;

// Where the image's border comes to lie in the pinhole's image plane.
struct BorderBox {
  double left = -std::numeric_limits<double>::infinity();
  double top = left;
  double right = std::numeric_limits<double>::infinity();
  double bottom = right;
};

// Calls visit(x, y) for the outermost pixel centres, beyond which there is nothing to interpolate, side by
// side.
template <typename Visit>
void ForEachBorderPixel(double width, double height, const Visit& visit) {
  for (double y = 0.5; y < height; ++y) {
    visit(0.5, y);
    visit(width - 0.5, y);
  }
  for (double x = 0.5; x < width; ++x) {
    visit(x, 0.5);
    visit(x, height - 0.5);
  }
}

// The largest box in the pinhole's plane, around the principal point, whose border the photo fills, for a
// lens that turns back within the photo: as far along the plane's axes as the photo goes, then narrower and
// lower until its corners are filled, by the shares whose product is largest.
BorderBox FilledBox(const Camera& camera, const Eigen::Vector2d& focal, const Eigen::Vector2d& principal) {
  const auto width = static_cast<double>(camera.width);
  const auto height = static_cast<double>(camera.height);
  const auto fills = [&](double x, double y) {
    const Eigen::Vector2d slope = Eigen::Vector2d(x, y).cwiseQuotient(focal);
    const std::optional<Eigen::Vector2d> xy = ProjectToImage(camera, {slope.x(), slope.y(), 1});
    return xy && xy->x() >= 0.5 && xy->x() <= width - 0.5 && xy->y() >= 0.5 && xy->y() <= height - 0.5;
  };
  // The largest of [0, most] that is filled; what is nearer to the principal point than a filled place is,
  // too.
  const auto reach = [](double most, const auto& is_filled) {
    double low = 0;
    double high = most;
    while (high - low > 0.25) (is_filled(low + (high - low) / 2) ? low : high) = low + (high - low) / 2;
    return low;
  };
  const double left = reach(kMaxGrowth * width, [&](double r) { return fills(-r, 0); });
  const double right = reach(kMaxGrowth * width, [&](double r) { return fills(r, 0); });
  const double top = reach(kMaxGrowth * height, [&](double r) { return fills(0, -r); });
  const double bottom = reach(kMaxGrowth * height, [&](double r) { return fills(0, r); });
  BorderBox best{principal.x(), principal.y(), principal.x(), principal.y()};
  double largest = 0;
  constexpr int kNumShares = 64;
  for (int i = 1; i <= kNumShares; ++i) {
    const double across = static_cast<double>(i) / kNumShares;
    const double down =
        reach(std::max(top, bottom),
              [&](double r) {
                const double share = r / std::max(top, bottom);
                return fills(-across * left, -share * top) && fills(across * right, -share * top) &&
                       fills(-across * left, share * bottom) && fills(across * right, share * bottom);
              }) /
        std::max({top, bottom, 1.0});
    if (across * down <= largest) continue;
    largest = across * down;
    best = {principal.x() - across * left, principal.y() - down * top, principal.x() + across * right,
            principal.y() + down * bottom};
  }
  return best;
}

}  // namespace

bool LensTurnsBack(const Camera& camera) {
  bool turns_back = false;
  ForEachBorderPixel(static_cast<double>(camera.width), static_cast<double>(camera.height),
                     [&](double x, double y) {
                       turns_back |= !UnprojectFromImage(camera, {x, y});
                     });
  return turns_back;
}

Camera UndistortedCamera(const Camera& camera, const std::filesystem::path& path) {
  RequireProjection(camera, path);
  const Eigen::Vector2d focal = FocalLengths(camera);
  const Eigen::Vector2d principal = PrincipalPoint(camera);
  Camera pinhole;
  pinhole.camera_id = camera.camera_id;
  pinhole.model = CameraModelId::kPinhole;
  pinhole.width = camera.width;
  pinhole.height = camera.height;
  pinhole.params = {focal.x(), focal.y(), principal.x(), principal.y()};
  if (IsDistortionFree(camera)) return pinhole;

  const auto width = static_cast<double>(camera.width);
  const auto height = static_cast<double>(camera.height);
  BorderBox box;
  bool turns_back = false;
  ForEachBorderPixel(width, height, [&](double x, double y) {
    const std::optional<Eigen::Vector3d> ray = UnprojectFromImage(camera, {x, y});
    turns_back |= !ray;
    if (!ray) return;
    const Eigen::Vector2d p = PinholePoint(*ray, focal, principal);
    if (x == 0.5) box.left = std::max(box.left, p.x());
    if (x == width - 0.5) box.right = std::min(box.right, p.x());
    if (y == 0.5) box.top = std::max(box.top, p.y());
    if (y == height - 0.5) box.bottom = std::min(box.bottom, p.y());
  });
  if (turns_back) box = FilledBox(camera, focal, principal);
  // Pixel centres at whole pixels from the old principal point's raster, inside of the border.
  const double x0 = std::ceil(box.left - 0.5);
  const double y0 = std::ceil(box.top - 0.5);
  const double x1 = std::floor(box.right + 0.5);
  const double y1 = std::floor(box.bottom + 0.5);
  if (!(x1 - x0 >= 2) || !(y1 - y0 >= 2) || x1 - x0 > kMaxGrowth * width || y1 - y0 > kMaxGrowth * height ||
      x1 - x0 > kMaxCameraSide || y1 - y0 > kMaxCameraSide ||
      (x1 - x0) * (y1 - y0) > static_cast<double>(kMaxCameraPixels)) {
    throw UserError(path,
                    "the lens of camera " + std::to_string(camera.camera_id) +
                        " is too wide, or its parameters too wild, for a pinhole image",
                    "Crop the photos, or calibrate the camera again");
  }
  pinhole.width = static_cast<uint64_t>(x1 - x0);
  pinhole.height = static_cast<uint64_t>(y1 - y0);
  pinhole.params = {focal.x(), focal.y(), principal.x() - x0, principal.y() - y0};
  return pinhole;
}

Image8 UndistortImage(const Image8& image, const Camera& camera, const Camera& pinhole, Reporter& reporter) {
  const Eigen::Vector2d focal = FocalLengths(pinhole);
  const Eigen::Vector2d principal = PrincipalPoint(pinhole);
  Image8 result = {static_cast<int>(pinhole.width), static_cast<int>(pinhole.height), image.channels, {}};
  result.pixels.resize(static_cast<size_t>(result.width) * result.height * result.channels);
  ForEachRow(result.height, result.width, reporter, [&](int y) {
    for (int x = 0; x < result.width; ++x) {
      const Eigen::Vector2d center(x + 0.5, y + 0.5);
      const Eigen::Vector2d slope = (center - principal).cwiseQuotient(focal);
      const std::optional<Eigen::Vector2d> xy = ProjectToImage(camera, {slope.x(), slope.y(), 1});
      if (!xy) continue;
      const double u = std::clamp(xy->x() - 0.5, 0.0, image.width - 1.0);
      const double v = std::clamp(xy->y() - 0.5, 0.0, image.height - 1.0);
      const int column = std::min(static_cast<int>(u), std::max(image.width - 2, 0));
      const int row = std::min(static_cast<int>(v), std::max(image.height - 2, 0));
      const int next_column = std::min(column + 1, image.width - 1);
      const int next_row = std::min(row + 1, image.height - 1);
      const double share_x = u - column;
      const double share_y = v - row;
      for (int c = 0; c < image.channels; ++c) {
        const double above =
            (1 - share_x) * image.Pixel(column, row)[c] + share_x * image.Pixel(next_column, row)[c];
        const double below = (1 - share_x) * image.Pixel(column, next_row)[c] +
                             share_x * image.Pixel(next_column, next_row)[c];
        result.Pixel(x, y)[c] = static_cast<uint8_t>((1 - share_y) * above + share_y * below + 0.5);
      }
    }
  });
  return result;
}

ColmapModel UndistortedModel(const ColmapModel& model, const std::filesystem::path& path) {
  ColmapModel result = model;
  for (auto& [id, camera] : result.cameras) camera = UndistortedCamera(camera, path);
  for (auto& [id, image] : result.images) {
    const Camera& camera = model.cameras.at(image.camera_id);
    if (IsDistortionFree(camera)) continue;
    const Camera& pinhole = result.cameras.at(image.camera_id);
    const Eigen::Vector2d focal = FocalLengths(pinhole);
    const Eigen::Vector2d principal = PrincipalPoint(pinhole);
    for (ColmapPoint2D& point : image.points2D) {
      const std::optional<Eigen::Vector3d> ray = UnprojectFromImage(camera, point.xy);
      if (ray) point.xy = PinholePoint(*ray, focal, principal);
    }
  }
  return result;
}

}  // namespace s2gs
