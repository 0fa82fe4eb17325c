#include "s2gs/photos.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "sfm_split/colmap_model.h"
#include "sfm_split/error.h"

namespace s2gs {
namespace {

// The source pixels that one target pixel covers along an axis, and how much of each.
struct Coverage {
  int begin = 0;
  std::vector<float> weights;  // sum 1.
};

std::vector<Coverage> CoverAxis(int source, int target) {
  std::vector<Coverage> all(target);
  const double scale = static_cast<double>(source) / target;
  for (int i = 0; i < target; ++i) {
    const double low = i * scale;
    const double high = std::min<double>((i + 1) * scale, source);
    Coverage& cover = all[i];
    cover.begin = std::min(static_cast<int>(low), source - 1);
    const int end = std::clamp(static_cast<int>(std::ceil(high)), cover.begin + 1, source);
    cover.weights.reserve(end - cover.begin);
    for (int j = cover.begin; j < end; ++j) {
      const double share = std::min<double>(high, j + 1) - std::max<double>(low, j);
      cover.weights.push_back(static_cast<float>(std::max(share, 0.0) / (high - low)));
    }
  }
  return all;
}

uint8_t Round(float value) { return static_cast<uint8_t>(std::clamp(value + 0.5F, 0.0F, 255.0F)); }

// The range of x/z (or y/z) that is seen along a whole border of the source image.
struct Border {
  double low = 0;
  double high = 0;
  bool any = false;
  void Add(double value) {
    low = any ? std::min(low, value) : value;
    high = any ? std::max(high, value) : value;
    any = true;
  }
};

Border WalkBorder(const Camera& camera, int side) {
  constexpr int kSamples = 256;
  const auto width = static_cast<double>(camera.width);
  const auto height = static_cast<double>(camera.height);
  Border border;
  for (int i = 0; i <= kSamples; ++i) {
    const double t = static_cast<double>(i) / kSamples;
    Eigen::Vector2d xy;
    if (side < 2) {
      xy = {side == 0 ? 0 : width, t * height};
    } else {
      xy = {t * width, side == 2 ? 0 : height};
    }
    const std::optional<Eigen::Vector3d> ray = UnprojectFromImage(camera, xy);
    if (ray) border.Add(side < 2 ? ray->x() : ray->y());
  }
  return border;
}

}  // namespace

Image8 ResizeByArea(const Image8& image, int width, int height) {
  S2GS_INVARIANT(width > 0 && height > 0 && image.width > 0 && image.height > 0);
  if (width == image.width && height == image.height) return image;
  const std::vector<Coverage> columns = CoverAxis(image.width, width);
  const std::vector<Coverage> rows = CoverAxis(image.height, height);
  const int channels = image.channels;
  Image8 resized{width, height, channels, {}};
  resized.pixels.resize(static_cast<size_t>(width) * height * channels);
  std::vector<float> line(static_cast<size_t>(image.width) * channels);
  for (int y = 0; y < height; ++y) {
    std::fill(line.begin(), line.end(), 0.0F);
    for (size_t j = 0; j < rows[y].weights.size(); ++j) {
      const uint8_t* source = image.Pixel(0, rows[y].begin + static_cast<int>(j));
      const float weight = rows[y].weights[j];
      for (size_t i = 0; i < line.size(); ++i) line[i] += weight * source[i];
    }
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < channels; ++c) {
        float sum = 0;
        for (size_t j = 0; j < columns[x].weights.size(); ++j) {
          sum += columns[x].weights[j] * line[(columns[x].begin + j) * channels + c];
        }
        resized.Pixel(x, y)[c] = Round(sum);
      }
    }
  }
  return resized;
}

Undistortion PlanUndistortion(const Camera& camera, const std::filesystem::path& path) {
  RequireProjection(camera, path);
  const Eigen::Vector2d focal = FocalLengths(camera);
  const Eigen::Vector2d principal = PrincipalPoint(camera);
  Undistortion plan{camera, camera};
  plan.pinhole.model = CameraModelId::kPinhole;
  plan.pinhole.params = {focal.x(), focal.y(), principal.x(), principal.y()};
  if (IsDistortionFree(camera)) return plan;

  const Border left = WalkBorder(camera, 0);
  const Border right = WalkBorder(camera, 1);
  const Border top = WalkBorder(camera, 2);
  const Border bottom = WalkBorder(camera, 3);
  // Half of the largest size on either side of the principal point, where a border sees nothing at all.
  const double max_x = static_cast<double>(camera.width) / focal.x();
  const double max_y = static_cast<double>(camera.height) / focal.y();
  const double x0 = std::max(left.any ? left.high : -max_x, -max_x);
  const double x1 = std::min(right.any ? right.low : max_x, max_x);
  const double y0 = std::max(top.any ? top.high : -max_y, -max_y);
  const double y1 = std::min(bottom.any ? bottom.low : max_y, max_y);
  const auto width = static_cast<int64_t>(std::floor((x1 - x0) * focal.x()));
  const auto height = static_cast<int64_t>(std::floor((y1 - y0) * focal.y()));
  if (width < 1 || height < 1) {
    throw UserError(path, "camera " + std::to_string(camera.camera_id) + ": its distortion leaves no image",
                    "Calibrate it again");
  }
  plan.pinhole.width = static_cast<uint64_t>(width);
  plan.pinhole.height = static_cast<uint64_t>(height);
  plan.pinhole.params[2] = -x0 * focal.x();
  plan.pinhole.params[3] = -y0 * focal.y();
  return plan;
}

Image8 UndistortImage(const Undistortion& plan, const Image8& image) {
  if (IsDistortionFree(plan.source)) return image;
  const int width = static_cast<int>(plan.pinhole.width);
  const int height = static_cast<int>(plan.pinhole.height);
  const int channels = image.channels;
  Image8 result{width, height, channels, {}};
  result.pixels.resize(static_cast<size_t>(width) * height * channels);
  const std::vector<double>& p = plan.pinhole.params;
#pragma omp parallel for schedule(static)
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const Eigen::Vector3d ray((x + 0.5 - p[2]) / p[0], (y + 0.5 - p[3]) / p[1], 1);
      const std::optional<Eigen::Vector2d> xy = ProjectToImage(plan.source, ray);
      if (!xy) continue;  // stays black
      const double u = std::clamp(xy->x() - 0.5, 0.0, image.width - 1.0);
      const double v = std::clamp(xy->y() - 0.5, 0.0, image.height - 1.0);
      const int x0 = static_cast<int>(u);
      const int y0 = static_cast<int>(v);
      const int x1 = std::min(x0 + 1, image.width - 1);
      const int y1 = std::min(y0 + 1, image.height - 1);
      const auto a = static_cast<float>(u - x0);
      const auto b = static_cast<float>(v - y0);
      for (int c = 0; c < channels; ++c) {
        const float above = (1 - a) * image.Pixel(x0, y0)[c] + a * image.Pixel(x1, y0)[c];
        const float below = (1 - a) * image.Pixel(x0, y1)[c] + a * image.Pixel(x1, y1)[c];
        result.Pixel(x, y)[c] = Round((1 - b) * above + b * below);
      }
    }
  }
  return result;
}

std::map<std::string, Undistortion> PlanUndistortions(const std::filesystem::path& model_folder) {
  const ColmapModel model = ReadColmapModel(model_folder);
  std::map<uint32_t, Undistortion> by_camera;
  for (const auto& [id, camera] : model.cameras)
    by_camera.emplace(id, PlanUndistortion(camera, model_folder));
  std::map<std::string, Undistortion> plans;
  for (const auto& [id, image] : model.images) plans.emplace(image.name, by_camera.at(image.camera_id));
  return plans;
}

Image8 DistortMask(const Undistortion& plan, const Image8& mask) {
  const int width = static_cast<int>(plan.source.width);
  const int height = static_cast<int>(plan.source.height);
  if (IsDistortionFree(plan.source) && mask.width == width && mask.height == height) return mask;
  const std::vector<double>& p = plan.pinhole.params;
  const double scale_x = static_cast<double>(mask.width) / static_cast<double>(plan.pinhole.width);
  const double scale_y = static_cast<double>(mask.height) / static_cast<double>(plan.pinhole.height);
  Image8 result{width, height, 1, {}};
  result.pixels.resize(static_cast<size_t>(width) * height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const std::optional<Eigen::Vector3d> ray = UnprojectFromImage(plan.source, {x + 0.5, y + 0.5});
      if (!ray) continue;
      const double u = (p[0] * ray->x() + p[2]) * scale_x;
      const double v = (p[1] * ray->y() + p[3]) * scale_y;
      const int column = static_cast<int>(std::clamp(u, 0.0, mask.width - 1.0));
      const int row = static_cast<int>(std::clamp(v, 0.0, mask.height - 1.0));
      *result.Pixel(x, y) = *mask.Pixel(column, row);
    }
  }
  return result;
}

PinholeView ViewOfPinhole(const Camera& pinhole) {
  PinholeView view;
  view.width = static_cast<int>(pinhole.width);
  view.height = static_cast<int>(pinhole.height);
  const Eigen::Vector2d focal = FocalLengths(pinhole);
  const Eigen::Vector2d principal = PrincipalPoint(pinhole);
  view.fx = focal.x();
  view.fy = focal.y();
  view.cx = principal.x();
  view.cy = principal.y();
  return view;
}

PinholeView ResizeView(const PinholeView& view, int width, int height) {
  const double sx = static_cast<double>(width) / view.width;
  const double sy = static_cast<double>(height) / view.height;
  PinholeView resized = view;
  resized.width = width;
  resized.height = height;
  resized.fx *= sx;
  resized.cx *= sx;
  resized.fy *= sy;
  resized.cy *= sy;
  return resized;
}

}  // namespace s2gs
