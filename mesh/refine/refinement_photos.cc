#include "mesh/refine/refinement_photos.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include "mesh/light/turn_light.h"
#include "s2gs/image/photos.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

// Photos need not be finer than this share of the mesh's edges.
constexpr double kPixelPerEdge = 1.0 / 3;
constexpr int kMaxShrink = 16;
// What a photo takes with its coarser level.
constexpr double kPyramidBytesPerPixel = 1.25;
// Beyond the mesh's outline in a photo: room for patches [px].
constexpr double kCropMargin = 16;  // not below kMaxShrink
// Over the plane, so that it is not of it [px].
constexpr double kClearOfPlane = 2;
// One photo that sees through a surface may be chance.
constexpr int kLeastSeeThrough = 2;
constexpr double kGiB = 1024.0 * 1024.0 * 1024.0;

struct Crop {
  int index = 0;  // of the photo, in the source
  ImagePart part;
};

// What of the photo shows the mesh; nothing when it is hardly any.
std::optional<Crop> FindCrop(const TriangleMesh& mesh, const ObjectView& view, int index) {
  Eigen::AlignedBox2d box;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    const Eigen::Vector3d x = view.cam_from_object * vertex.cast<double>();
    if (!(x.z() > 0)) continue;
    box.extend(Eigen::Vector2d(view.fx * x.x() / x.z() + view.cx, view.fy * x.y() / x.z() + view.cy));
  }
  if (box.isEmpty()) return std::nullopt;
  const auto range = [](double low, double high, int size, int* first, int* count) {
    const double begin = std::clamp(std::floor(low - kCropMargin), 0.0, static_cast<double>(size));
    const double end = std::clamp(std::ceil(high + kCropMargin), 0.0, static_cast<double>(size));
    *first = static_cast<int>(begin);
    *count = static_cast<int>(end - begin);
  };
  Crop crop;
  crop.index = index;
  ImagePart& part = crop.part;
  range(box.min().x(), box.max().x(), view.width, &part.x, &part.width);
  range(box.min().y(), box.max().y(), view.height, &part.y, &part.height);
  if (part.width < 2 * kCropMargin || part.height < 2 * kCropMargin) return std::nullopt;
  return crop;
}

ObjectView ScaleView(const ObjectView& view, int width, int height) {
  ObjectView scaled = view;
  scaled.width = width;
  scaled.height = height;
  scaled.fx *= static_cast<double>(width) / view.width;
  scaled.cx *= static_cast<double>(width) / view.width;
  scaled.fy *= static_cast<double>(height) / view.height;
  scaled.cy *= static_cast<double>(height) / view.height;
  return scaled;
}

double MeanEdge(const TriangleMesh& mesh) {
  double sum = 0;
  for (const auto& triangle : mesh.triangles) {
    sum += (mesh.vertices[triangle[0]] - mesh.vertices[triangle[1]]).norm();
  }
  return sum / static_cast<double>(mesh.triangles.size());
}

}  // namespace

void RefinementPhotos::Load(const RefinementPhotoSource& source, const TriangleMesh& mesh,
                            double max_memory_gib) {
  std::vector<Crop> crops;
  crops.reserve(source.size());
  double bytes = 0;
  double finest = std::numeric_limits<double>::infinity();  // pixel at the mesh
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3f& vertex : mesh.vertices) middle += vertex.cast<double>();
  middle /= static_cast<double>(mesh.vertices.size());
  for (int i = 0; i < source.size(); ++i) {
    const ObjectView& view = source.Camera(i);
    const std::optional<Crop> crop = FindCrop(mesh, view, i);
    if (!crop) continue;
    crops.push_back(*crop);
    bytes += kPyramidBytesPerPixel * crop->part.width * crop->part.height;
    // A photo of one end of the mesh may have the middle behind it.
    const double depth = (view.cam_from_object * middle).z();
    if (depth > 0) finest = std::min(finest, depth / std::max(view.fx, view.fy));
  }
  const double edge = MeanEdge(mesh);
  int factor = 1;
  while (factor < kMaxShrink &&
         (finest * 2 * factor < kPixelPerEdge * edge || bytes / (factor * factor) > max_memory_gib * kGiB)) {
    ++factor;
  }
  if (bytes / (factor * factor) > max_memory_gib * kGiB) {
    throw UserError(
        fmt::format("{} photos need {:.1f} GiB to refine the mesh even at {} of their size, but "
                    "max_memory_gib is {}. Raise it, or leave the refinement out",
                    crops.size(), bytes / (factor * factor) / kGiB, 1.0 / factor, max_memory_gib));
  }
  views_.resize(crops.size());
  sights_.resize(crops.size());
  seen_height_ = source.SeenHeight();
  turns_.clear();
  gains_.clear();
  for (const Crop& crop : crops) {
    turns_.push_back(source.WorldFromObject(crop.index));
    gains_.push_back(static_cast<float>(source.Gain(crop.index)));
  }
  std::vector<std::unique_ptr<PhotoPyramid>> photos(crops.size());
  const auto group = static_cast<size_t>(4 * num_threads_);
  for (size_t begin = 0; begin < crops.size(); begin += group) {
    if (reporter_.StopRequested()) throw Interrupted();
    const size_t end = std::min(begin + group, crops.size());
    ParallelFor(static_cast<int64_t>(end - begin), num_threads_, [&](int64_t i) {
      const Crop& crop = crops[begin + i];
      const Image8 photo = source.Load(crop.index);
      const ObjectView& view = source.Camera(crop.index);
      S2GS_INVARIANT(photo.channels == 1 && photo.width == view.width && photo.height == view.height);
      views_[begin + i] = CutAndShrunk(view, crop.part, factor);
      Image8 seen = source.LoadPlaneSeen(crop.index);
      if (seen.width > 0) {
        const ObjectView small = ScaleView(view, seen.width, seen.height);
        sights_[begin + i] = {std::move(seen), small};
      }
      photos[begin + i] =
          std::make_unique<PhotoPyramid>(views_[begin + i], CutAndShrink(photo, crop.part, factor));
    });
    reporter_.Progress("read photos", static_cast<int64_t>(end), static_cast<int64_t>(crops.size()));
  }
  photos_ = std::move(photos);
}

std::vector<VertexFlags> RefinementPhotos::FindVisible(const TriangleMesh& mesh,
                                                       const VisibilityRule& rule) const {
  if (reporter_.StopRequested()) throw Interrupted();
  std::vector<VertexFlags> visible(views_.size());
  ParallelFor(static_cast<int64_t>(views_.size()), num_threads_,
              [&](int64_t i) { visible[i] = FindVisibleVertices(mesh, views_[i], rule); });
  return visible;
}

bool RefinementPhotos::ShowPlane() const {
  return std::any_of(sights_.begin(), sights_.end(),
                     [](const PlaneSight& sight) { return sight.seen.width > 0; });
}

std::vector<uint8_t> RefinementPhotos::FindSeenThrough(const TriangleMesh& mesh,
                                                       const std::vector<VertexFlags>& visible) const {
  std::vector<uint8_t> is_seen_through(mesh.vertices.size(), 0);
  ParallelFor(static_cast<int64_t>(mesh.vertices.size()), num_threads_, 1024, [&](int64_t i) {
    const Eigen::Vector3d x = mesh.vertices[i].cast<double>();
    int count = 0;
    for (size_t k = 0; k < sights_.size(); ++k) {
      const ObjectView& view = sights_[k].view;
      if (sights_[k].seen.width == 0 || !visible[k].Get(i)) continue;
      const Eigen::Vector3d in_cam = view.cam_from_object * x;
      if (!(x.z() - seen_height_ > kClearOfPlane * in_cam.z() / view.fx)) continue;
      const double column = std::floor(view.fx * in_cam.x() / in_cam.z() + view.cx);
      const double row = std::floor(view.fy * in_cam.y() / in_cam.z() + view.cy);
      if (!(column >= 0 && row >= 0 && column < view.width && row < view.height)) continue;
      count += *sights_[k].seen.Pixel(static_cast<int>(column), static_cast<int>(row)) == 255 ? 1 : 0;
    }
    is_seen_through[i] = count >= kLeastSeeThrough ? 1 : 0;
  });
  return is_seen_through;
}

std::vector<bool> RefinementPhotos::FindClosing(const TriangleMesh& mesh, const std::vector<bool>& keep,
                                                int least_photos) const {
  if (reporter_.StopRequested()) throw Interrupted();
  std::vector<std::atomic<int32_t>> num_open(keep.size());  // photos
  std::vector<std::atomic<int32_t>> num_covered(keep.size());
  ParallelFor(static_cast<int64_t>(views_.size()), num_threads_, [&](int64_t k) {
    const Eigen::Vector3f center = CameraCentre(views_[k].cam_from_object).cast<float>();
    const auto shows_front = [&](int32_t triangle) {
      const auto& corners = mesh.triangles[triangle];
      const Eigen::Vector3f& a = mesh.vertices[corners[0]];
      return (mesh.vertices[corners[1]] - a).cross(mesh.vertices[corners[2]] - a).dot(center - a) > 0;
    };
    const ShownTriangles shown = FindShownTriangles(mesh, keep, views_[k]);
    const std::vector<int32_t>& now = shown.of_all;
    const std::vector<int32_t>& then = shown.of_kept;
    // Pixels that would be open, less those that would show a surface.
    std::vector<int32_t> balance(keep.size());
    for (size_t pixel = 0; pixel < now.size(); ++pixel) {
      const int32_t triangle = now[pixel];
      if (triangle < 0 || keep[triangle] || !shows_front(triangle)) continue;
      const bool is_open = then[pixel] < 0 || !shows_front(then[pixel]);
      balance[triangle] += is_open ? 1 : -1;
    }
    for (size_t i = 0; i < keep.size(); ++i) {
      if (balance[i] > 0) num_open[i].fetch_add(1, std::memory_order_relaxed);
      if (balance[i] < 0) num_covered[i].fetch_add(1, std::memory_order_relaxed);
    }
  });
  std::vector<bool> is_closing;
  is_closing.reserve(keep.size());
  for (size_t i = 0; i < keep.size(); ++i) {
    is_closing.push_back(num_open[i] >= least_photos && num_open[i] > num_covered[i]);
  }
  return is_closing;
}

float RefinementPhotos::FinestPixel(const Eigen::Vector3f& x_in_object) const {
  float finest = std::numeric_limits<float>::infinity();
  for (const auto& photo : photos_) {
    const float size = photo->PixelSize(x_in_object);
    if (size > 0) finest = std::min(finest, size);
  }
  return finest;
}

std::vector<ShadedSample> RefinementPhotos::SampleShading(const TriangleMesh& mesh, const VertexGraph& graph,
                                                          const std::vector<VertexFlags>& visible) const {
  const size_t count = mesh.vertices.size();
  std::vector<size_t> first(count + 1, 0);
  for (size_t i = 0; i < count; ++i) {
    first[i + 1] =
        first[i] + static_cast<size_t>(std::count_if(visible.begin(), visible.end(),
                                                     [i](const VertexFlags& flags) { return flags.Get(i); }));
  }
  std::vector<ShadedSample> samples(first[count]);
  ParallelFor(static_cast<int64_t>(count), num_threads_, 1024, [&](int64_t i) {
    // A vertex stands for half of each edge. What texture lies under the very place of one that is not quite
    // where the surface is changes from photo to photo.
    std::vector<Eigen::Vector3f> places = {mesh.vertices[i]};
    for (const uint32_t j : graph.Neighbors(static_cast<size_t>(i)))
      places.emplace_back((mesh.vertices[i] + mesh.vertices[j]) / 2);
    size_t at = first[i];
    for (size_t k = 0; k < photos_.size(); ++k) {
      if (!visible[k].Get(i)) continue;
      float sum = 0;
      for (const Eigen::Vector3f& place : places) sum += photos_[k]->GreyAt(place);
      const float grey = sum / static_cast<float>(places.size());
      samples[at++] = {static_cast<uint32_t>(i), static_cast<uint16_t>(k),
                       grey > kBrightestGrey ? grey : grey / gains_[k]};
    }
  });
  return samples;
}

SurfacePatch RefinementPhotos::PatchAt(const TriangleMesh& mesh, size_t vertex,
                                       const std::vector<VertexFlags>& visible, int max_views) const {
  std::vector<const PhotoPyramid*> candidates;
  candidates.reserve(photos_.size());
  for (size_t i = 0; i < photos_.size(); ++i) {
    if (visible[i].Get(vertex)) candidates.push_back(photos_[i].get());
  }
  SurfacePatch patch;
  patch.middle = mesh.vertices[vertex];
  patch.normal = mesh.normals[vertex];
  SelectPhotos(candidates, max_views, &patch);
  return patch;
}

}  // namespace s2gs
