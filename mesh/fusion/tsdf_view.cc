#include "mesh/fusion/tsdf_view.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

#include "mesh/fusion/key_set.h"
#include "mesh/fusion/tsdf_kernel_cpu.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// How far around the object the distance to it is kept [px].
constexpr int kMargin = 40;
// Values that the slope of a depth map looks at on either side.
constexpr int kPadding = 2;
constexpr float kFar = 1e18F;
// Squares of depths must fit into floats.
constexpr float kMinDepth = 1e-15F;
constexpr float kMaxDepth = 1e15F;

void Require(bool condition, const std::string& problem) {
  if (!condition) throw UserError("A depth view cannot be fused: " + problem);
}

void CheckView(const DepthView& view) {
  const ObjectView& camera = view.camera;
  Require(camera.width > 0 && camera.height > 0 && camera.width <= kMaxImageSide &&
              camera.height <= kMaxImageSide,
          "its camera has no usable size");
  Require(camera.fx > 0 && camera.fy > 0 && std::isfinite(camera.fx) && std::isfinite(camera.fy) &&
              std::isfinite(camera.cx) && std::isfinite(camera.cy),
          "its camera has no usable focal length or principal point");
  Require(camera.cam_from_object.translation.allFinite() &&
              std::abs(camera.cam_from_object.rotation.norm() - 1) < 1e-6,
          "its camera has no usable pose");
  const size_t num_pixels = static_cast<size_t>(camera.width) * camera.height;
  Require(view.depths.size() == num_pixels, "the depth map's size is not the camera's");
  Require(view.normals.empty() || view.normals.size() == 3 * num_pixels,
          "the normal map's size is not the depth map's");
  const auto is_image = [](const Image8& image, int channels) {
    return image.pixels.empty() ||
           (image.width > 0 && image.height > 0 && image.channels == channels &&
            image.pixels.size() == static_cast<size_t>(image.width) * image.height * channels);
  };
  Require(is_image(view.colors, 3), "its colours are no RGB image");
  Require(is_image(view.mask, 1), "its mask is no image of one channel");
}

// The column or row of another image of the same field of view.
int Resample(double position, int size, int other_size) {
  return std::clamp(static_cast<int>(position * other_size / size), 0, other_size - 1);
}

struct Rectangle {
  int x0 = std::numeric_limits<int>::max();
  int y0 = std::numeric_limits<int>::max();
  int x1 = -1;  // inclusive
  int y1 = -1;
};

enum PixelState : uint8_t { kBlank = 0, kObject = 1, kDepth = 2 };

class ViewBuilder {
 public:
  ViewBuilder(const DepthView& view, const TsdfOptions& options)
      : in_(view), options_(options), width_(view.camera.width), height_(view.camera.height) {}

  TsdfView Build() {
    out_.camera = in_.camera;
    out_.first_position = in_.first_position;
    Classify();
    CutOut();
    AddDistancesToObject();
    AddPlanes();
    AddColors();
    return std::move(out_);
  }

 private:
  bool HasMask() const { return !in_.mask.pixels.empty(); }

  // The mask from 0 to 1 at a pixel of the depth map.
  float MaskAt(int x, int y) const {
    const int column = Resample(x + in_.first_position.x(), width_, in_.mask.width);
    const int row = Resample(y + in_.first_position.y(), height_, in_.mask.height);
    return static_cast<float>(*in_.mask.Pixel(column, row)) / 255.0F;
  }

  void Classify() {
    states_.assign(in_.depths.size(), kBlank);
    const auto threshold = static_cast<float>(options_.mask_threshold);
    for (int y = 0; y < height_; ++y) {
      for (int x = 0; x < width_; ++x) {
        const size_t i = static_cast<size_t>(y) * width_ + x;
        if (HasMask() && MaskAt(x, y) < threshold) continue;
        const float depth = in_.depths[i];
        const bool has_depth = depth > kMinDepth && depth < kMaxDepth;
        if (!HasMask() && !has_depth) continue;
        states_[i] = has_depth ? kDepth : kObject;
        used_.x0 = std::min(used_.x0, x);
        used_.x1 = std::max(used_.x1, x);
        used_.y0 = std::min(used_.y0, y);
        used_.y1 = std::max(used_.y1, y);
      }
    }
  }

  void CutOut() {
    out_.planes.resize(kFirstPixel);
    if (used_.x1 < 0) return;
    const bool carve = HasMask() && options_.carve;
    const int margin = carve ? kMargin : 0;
    out_.map_x = std::max(0, used_.x0 - margin);
    out_.map_y = std::max(0, used_.y0 - margin);
    out_.map_width = std::min(width_, used_.x1 + margin + 1) - out_.map_x;
    out_.map_height = std::min(height_, used_.y1 + margin + 1) - out_.map_y;
    out_.planes.resize(kFirstPixel + static_cast<size_t>(out_.map_width) * out_.map_height);
    if (carve) out_.planes[kOutsideMap].weight = -kMargin;
  }

  PixelState StateAt(int x, int y) const {
    return static_cast<PixelState>(states_[static_cast<size_t>(y) * width_ + x]);
  }
  PixelPlane* PlaneRow(int row) {
    return &out_.planes[kFirstPixel + static_cast<size_t>(row) * out_.map_width];
  }

  void AddDistancesToObject() {
    if (!HasMask() || !options_.carve || out_.map_width == 0) return;
    std::vector<uint8_t> object;
    object.reserve(static_cast<size_t>(out_.map_width) * out_.map_height);
    for (int row = 0; row < out_.map_height; ++row) {
      for (int column = 0; column < out_.map_width; ++column) {
        object.push_back(StateAt(out_.map_x + column, out_.map_y + row) != kBlank ? 1 : 0);
      }
    }
    const std::vector<float> distances = DistanceToSet(object, out_.map_width, out_.map_height);
    for (size_t i = 0; i < distances.size(); ++i) out_.planes[kFirstPixel + i].weight = -distances[i];
  }

  // 1 / depth, or 0 where there is none: affine along a plane. Two values of padding on all sides.
  std::vector<float> PaddedInverseDepths() const {
    const int stride = out_.map_width + 2 * kPadding;
    std::vector<float> padded(static_cast<size_t>(stride) * (out_.map_height + 2 * kPadding));
    for (int row = 0; row < out_.map_height; ++row) {
      const size_t first = static_cast<size_t>(out_.map_y + row) * width_ + out_.map_x;
      float* target = &padded[static_cast<size_t>(row + kPadding) * stride + kPadding];
      for (int column = 0; column < out_.map_width; ++column) {
        const float inverse = 1.0F / in_.depths[first + column];
        target[column] = states_[first + column] == kDepth ? inverse : 0.0F;
      }
    }
    return padded;
  }

  // Replaces the plane of a pixel where there is a normal.
  void UseNormal(int x, int y, const Eigen::Vector3f& ray, float min_cosine, PixelPlane* plane) const {
    const size_t pixel = static_cast<size_t>(y) * width_ + x;
    const size_t num_pixels = in_.depths.size();
    const Eigen::Vector3f normal(in_.normals[pixel], in_.normals[num_pixels + pixel],
                                 in_.normals[2 * num_pixels + pixel]);
    const float norm = normal.norm();
    const float along_ray = normal.dot(ray);
    if (!(norm > 0.5F) || !(norm < 2.0F) || !(along_ray < 0)) return;
    const float depth = in_.depths[pixel];
    const Eigen::Vector3f abc = normal / (along_ray * depth);
    const float cosine = -along_ray / (norm * ray.norm());
    *plane = {abc.x(), abc.y(), abc.z(), cosine >= min_cosine ? cosine / (depth * depth) : 0};
  }

  void AddPlanes() {
    if (out_.map_width == 0) return;
    const auto min_cosine = static_cast<float>(std::cos(options_.max_view_angle_deg * kPi / 180));
    const std::vector<float> inverse_depths = PaddedInverseDepths();
    const int stride = out_.map_width + 2 * kPadding;
    const TsdfCpuKernel& kernel = BestTsdfCpuKernel();
    std::vector<float> depths;
    for (int row = 0; row < out_.map_height; ++row) {
      PixelPlane* planes = PlaneRow(row);
      const int y = out_.map_y + row;
      const uint8_t* states = &states_[static_cast<size_t>(y) * width_ + out_.map_x];
      for (int column = 0; column < out_.map_width; ++column) {
        if (states[column] == kObject) planes[column].weight = 0;
      }
      TsdfRowJob job;
      for (int i = 0; i < 5; ++i) {
        job.inverse_depths[i] = &inverse_depths[static_cast<size_t>(row + i) * stride + kPadding];
      }
      const Eigen::Vector3d first_ray = out_.Ray(0, row);
      job.count = out_.map_width;
      job.fx = static_cast<float>(in_.camera.fx);
      job.fy = static_cast<float>(in_.camera.fy);
      job.first_ray_x = static_cast<float>(first_ray.x());
      job.ray_y = static_cast<float>(first_ray.y());
      job.min_cosine = min_cosine;
      job.planes = planes;
      kernel.planes_of_row(job);
      for (int column = 0; column < out_.map_width; ++column) {
        if (states[column] != kDepth) continue;
        const int x = out_.map_x + column;
        if (!in_.normals.empty()) {
          UseNormal(x, y, out_.Ray(column, row).cast<float>(), min_cosine, &planes[column]);
        }
        if (HasMask()) planes[column].weight *= MaskAt(x, y);
        if (!(planes[column].weight > 0)) continue;
        if (out_.num_depths++ % 16 == 0) depths.push_back(in_.depths[static_cast<size_t>(y) * width_ + x]);
      }
    }
    if (depths.empty()) return;
    out_.median_depth = UpperMedian(std::move(depths));
  }

  void AddColors() {
    if (in_.colors.pixels.empty()) return;
    out_.colors.resize(out_.planes.size() - kFirstPixel);
    std::vector<int> columns;
    columns.reserve(out_.map_width);
    for (int column = 0; column < out_.map_width; ++column) {
      columns.push_back(Resample(out_.map_x + column + in_.first_position.x(), width_, in_.colors.width));
    }
    uint32_t* color = out_.colors.data();
    for (int row = 0; row < out_.map_height; ++row) {
      const int y = Resample(out_.map_y + row + in_.first_position.y(), height_, in_.colors.height);
      for (const int x : columns) {
        const uint8_t* rgb = in_.colors.Pixel(x, y);
        *color++ = rgb[0] | rgb[1] << 8U | static_cast<uint32_t>(rgb[2]) << 16U;
      }
    }
  }

  const DepthView& in_;
  const TsdfOptions& options_;
  const int width_;
  const int height_;
  TsdfView out_;
  std::vector<uint8_t> states_;  // PixelState of the whole view
  Rectangle used_;
};

// Lower envelope of parabolas of one row of squared distances.
void TransformRow(const float* f, int n, float* out, std::vector<int>* sites, std::vector<float>* bounds) {
  std::vector<int>& v = *sites;
  std::vector<float>& z = *bounds;
  int k = -1;
  for (int q = 0; q < n; ++q) {
    if (f[q] >= kFar) continue;
    float s = 0;
    while (k >= 0) {
      const int p = v[k];
      s = ((f[q] + static_cast<float>(q) * q) - (f[p] + static_cast<float>(p) * p)) / (2.0F * (q - p));
      if (s > z[k]) break;
      --k;
    }
    ++k;
    v[k] = q;
    z[k] = k == 0 ? -kFar : s;
    z[k + 1] = kFar;
  }
  if (k < 0) {
    std::fill(out, out + n, kFar);
    return;
  }
  int j = 0;
  for (int q = 0; q < n; ++q) {
    while (z[j + 1] < q) ++j;
    const auto d = static_cast<float>(q - v[j]);
    out[q] = d * d + f[v[j]];
  }
}

}  // namespace

std::vector<float> DistanceToSet(const std::vector<uint8_t>& set, int width, int height) {
  S2GS_INVARIANT(set.size() == static_cast<size_t>(width) * height);
  std::vector<float> squared(set.size());
  const int longest = std::max(width, height);
  std::vector<int> sites(longest + 1);
  std::vector<float> bounds(longest + 2);
  std::vector<float> line(longest);
  std::vector<float> out(longest);
  for (int x = 0; x < width; ++x) {
    for (int y = 0; y < height; ++y) line[y] = set[static_cast<size_t>(y) * width + x] != 0 ? 0 : kFar;
    TransformRow(line.data(), height, out.data(), &sites, &bounds);
    for (int y = 0; y < height; ++y) squared[static_cast<size_t>(y) * width + x] = out[y];
  }
  for (int y = 0; y < height; ++y) {
    float* row = &squared[static_cast<size_t>(y) * width];
    std::copy(row, row + width, line.begin());
    TransformRow(line.data(), width, out.data(), &sites, &bounds);
    for (int x = 0; x < width; ++x) row[x] = std::sqrt(out[x]);
  }
  return squared;
}

TsdfView PrepareTsdfView(const DepthView& view, const TsdfOptions& options) {
  CheckView(view);
  return ViewBuilder(view, options).Build();
}

TsdfViewParams ViewParams(const TsdfView& view, const Eigen::Vector3d& origin_in_object, double voxel_size) {
  TsdfViewParams params{};
  const Eigen::Matrix3d rotation = view.camera.cam_from_object.rotation.toRotationMatrix() * voxel_size;
  const Eigen::Vector3d translation = view.camera.cam_from_object * origin_in_object;
  for (int i = 0; i < 3; ++i) {
    params.translation[i] = translation[i];
    for (int j = 0; j < 3; ++j) params.rotation[3 * i + j] = rotation(i, j);
  }
  params.fx = static_cast<float>(view.camera.fx);
  params.fy = static_cast<float>(view.camera.fy);
  params.focal = std::max(params.fx, params.fy);
  params.cx = static_cast<float>(view.camera.cx - view.first_position.x() + 0.5);
  params.cy = static_cast<float>(view.camera.cy - view.first_position.y() + 0.5);
  params.width = static_cast<float>(view.camera.width);
  params.height = static_cast<float>(view.camera.height);
  params.map_x = static_cast<float>(view.map_x);
  params.map_y = static_cast<float>(view.map_y);
  params.map_width = static_cast<float>(view.map_width);
  params.map_height = static_cast<float>(view.map_height);
  params.planes = view.planes.data();
  return params;
}

std::vector<TsdfSurfaceSample> SampleTsdfSurface(const TsdfView& view, int max_samples) {
  std::vector<TsdfSurfaceSample> samples;
  if (view.num_depths == 0) return samples;
  const int64_t stride = (view.num_depths + max_samples - 1) / max_samples;
  samples.reserve(static_cast<size_t>(view.num_depths / stride + 1));
  const Rigid3 object_from_cam = view.camera.cam_from_object.Inverse();
  const auto focal = static_cast<float>(std::sqrt(view.camera.fx * view.camera.fy));
  int64_t count = 0;
  for (int row = 0; row < view.map_height; ++row) {
    const PixelPlane* planes = &view.planes[kFirstPixel + static_cast<size_t>(row) * view.map_width];
    for (int column = 0; column < view.map_width; ++column) {
      const PixelPlane& plane = planes[column];
      if (!(plane.weight > 0) || count++ % stride != 0) continue;
      const Eigen::Vector3d ray = view.Ray(column, row);
      const double depth = 1 / (plane.a * ray.x() + plane.b * ray.y() + plane.c);
      samples.push_back(
          {object_from_cam * (depth * ray), static_cast<float>(depth), static_cast<float>(depth) / focal});
    }
  }
  return samples;
}

std::vector<uint64_t> FindViewBlocks(const TsdfView& view, const TsdfBlockRequest& request,
                                     int64_t* num_outliers) {
  KeySet keys;
  const double pixel = view.median_depth / std::sqrt(view.camera.fx * view.camera.fy);
  // Rays every two voxels: closer than the band is thick, so that no block slips through.
  const int stride = std::clamp(static_cast<int>(std::lround(2 * request.voxel_size / pixel)), 1, 64);
  const int rays_per_pixel = std::clamp(static_cast<int>(std::ceil(pixel / (2 * request.voxel_size))), 1, 64);
  const int num_steps = static_cast<int>(std::ceil(request.truncation_voxels)) + 1;
  const double step_blocks = 2 * request.truncation_voxels / (num_steps - 1) / kBlockSide;
  const Rigid3 object_from_cam = view.camera.cam_from_object.Inverse();
  const Eigen::Matrix3d rotation = object_from_cam.rotation.toRotationMatrix() / request.voxel_size;
  const Eigen::Vector3d start =
      (object_from_cam.translation - request.origin) / request.voxel_size + Eigen::Vector3d::Constant(0.5);
  // Keeps coordinates positive, where a cast rounds down.
  const Eigen::Vector3d bias = Eigen::Vector3d::Constant(TsdfBlockIndex::kMaxCoordinate);
  const Eigen::AlignedBox3d region((request.region.min() - request.origin) / request.voxel_size,
                                   (request.region.max() - request.origin) / request.voxel_size);
  std::vector<Eigen::Array3i> last(num_steps, Eigen::Array3i::Constant(-1));
  for (int row = 0; row < view.map_height; row += stride) {
    const PixelPlane* planes = &view.planes[kFirstPixel + static_cast<size_t>(row) * view.map_width];
    for (int column = 0; column < view.map_width; column += stride) {
      const PixelPlane& plane = planes[column];
      if (!(plane.weight > 0)) continue;
      for (int sub = 0; sub < rays_per_pixel * rays_per_pixel; ++sub) {
        const int sub_column = sub % rays_per_pixel;
        const int sub_row = sub / rays_per_pixel;
        const double shift_x = (sub_column + 0.5) / rays_per_pixel - 0.5;
        const double shift_y = (sub_row + 0.5) / rays_per_pixel - 0.5;
        const Eigen::Vector3d ray = view.Ray(column + shift_x, row + shift_y);
        const double inverse_depth = plane.a * ray.x() + plane.b * ray.y() + plane.c;
        if (!(inverse_depth > 0)) continue;
        const Eigen::Vector3d direction = rotation * ray;  // [voxels] for a depth of 1
        const Eigen::Vector3d middle = start + direction / inverse_depth;
        if (!region.contains(middle)) {
          if (sub == 0) ++*num_outliers;
          continue;
        }
        const Eigen::Vector3d unit = direction.normalized();
        const Eigen::Vector3d to_next = step_blocks * unit;
        Eigen::Vector3d block = (middle - request.truncation_voxels * unit) / kBlockSide + bias;
        for (int step = 0; step < num_steps; ++step, block += to_next) {
          const Eigen::Array3i biased = block.array().cast<int>();
          if ((biased == last[step]).all()) continue;
          last[step] = biased;
          keys.Insert(TsdfBlockIndex::BlockKey(biased.matrix() -
                                               Eigen::Vector3i::Constant(TsdfBlockIndex::kMaxCoordinate)));
        }
      }
    }
    if (keys.size() > request.max_blocks) break;
  }
  return keys.Sorted();
}

}  // namespace s2gs
