#include "s2gs/image/photos.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "s2gs/image/picture_rows.h"
#include "s2gs/image/undistort.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_model.h"

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

Image8 CutAndShrink(const Image8& image, const ImagePart& part, int factor) {
  S2GS_INVARIANT(factor > 0 && part.width >= factor && part.height >= factor && part.x >= 0 && part.y >= 0);
  S2GS_INVARIANT(part.x <= image.width - part.width && part.y <= image.height - part.height);
  const int width = part.width / factor;
  const int height = part.height / factor;
  Image8 cut{width * factor, height * factor, image.channels, {}};
  const size_t row = static_cast<size_t>(cut.width) * image.channels;
  cut.pixels.reserve(row * cut.height);
  for (int y = 0; y < cut.height; ++y) {
    const uint8_t* source = image.Pixel(part.x, part.y + y);
    cut.pixels.insert(cut.pixels.end(), source, source + row);
  }
  return ResizeByArea(cut, width, height);
}

Undistortion PlanUndistortion(const Camera& camera, const std::filesystem::path& path) {
  return {camera, UndistortedCamera(camera, path)};
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

Image8 DistortMask(const Undistortion& plan, const Image8& mask, Reporter& reporter) {
  const int width = static_cast<int>(plan.source.width);
  const int height = static_cast<int>(plan.source.height);
  if (IsDistortionFree(plan.source) && mask.width == width && mask.height == height) return mask;
  const std::vector<double>& p = plan.pinhole.params;
  const double scale_x = static_cast<double>(mask.width) / static_cast<double>(plan.pinhole.width);
  const double scale_y = static_cast<double>(mask.height) / static_cast<double>(plan.pinhole.height);
  Image8 result{width, height, 1, {}};
  result.pixels.resize(static_cast<size_t>(width) * height);
  ForEachRow(height, width, reporter, [&](int y) {
    for (int x = 0; x < width; ++x) {
      const std::optional<Eigen::Vector3d> ray = UnprojectFromImage(plan.source, {x + 0.5, y + 0.5});
      if (!ray) continue;
      const double u = (p[0] * ray->x() + p[2]) * scale_x;
      const double v = (p[1] * ray->y() + p[3]) * scale_y;
      const int column = static_cast<int>(std::clamp(u, 0.0, mask.width - 1.0));
      const int row = static_cast<int>(std::clamp(v, 0.0, mask.height - 1.0));
      *result.Pixel(x, y) = *mask.Pixel(column, row);
    }
  });
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
