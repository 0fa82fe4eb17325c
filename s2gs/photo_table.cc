#include "s2gs/photo_table.h"

#include <algorithm>
#include <cstddef>
#include <map>
#include <vector>

#include "s2gs/image/photos.h"
#include "s2gs/opaque_region.h"
#include "s2gs/rotating_mask.h"
#include "s2gs/table_circle.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr size_t kMinPhotos = 8;   // of a station: of fewer the object is in the median.
constexpr size_t kMaxPhotos = 15;  // evenly from all of a station's
constexpr int kLongSide = 480;     // [px]: a pixel is some hundredth of a table.
constexpr int kMaskedPhotos = 6;   // of all, to see what the model takes to stand still
constexpr double kFew = 0.05;      // of the points: outliers.
// The table lies where the rotating points begin, so many of their heights about it.
constexpr double kAround = 0.5;
constexpr double kReach = 4;  // the same: a small thing on a large table.

PinholeView Reduced(const PinholeView& view) {
  const double scale = std::min(1.0, static_cast<double>(kLongSide) / std::max(view.width, view.height));
  return ResizeView(view, std::max(1, static_cast<int>(view.width * scale)),
                    std::max(1, static_cast<int>(view.height * scale)));
}

std::vector<StillPicture> StillPictures(const TrainingScene& scene, const LoadPhoto& load,
                                        Reporter& reporter) {
  std::map<int, std::vector<const ScenePhoto*>> stations;
  for (const ScenePhoto& photo : scene.photos) {
    if (photo.held_out) continue;
    std::vector<const ScenePhoto*>& station = stations[photo.station];
    const bool fits = station.empty() || (photo.view.width == station.front()->view.width &&
                                          photo.view.height == station.front()->view.height);
    if (fits) station.push_back(&photo);
  }
  std::vector<StillPicture> pictures;
  for (const auto& [number, photos] : stations) {
    if (photos.size() < kMinPhotos) continue;
    const size_t count = std::min(photos.size(), kMaxPhotos);
    const PinholeView view = Reduced(photos.front()->view);
    std::vector<Image8> images;
    for (size_t i = 0; i < count; ++i) {
      if (reporter.StopRequested()) throw Interrupted();
      images.push_back(ResizeByArea(load(*photos[i * photos.size() / count]), view.width, view.height));
    }
    pictures.push_back({view, MedianPicture(images)});
  }
  return pictures;
}

// Pixels that the model does not take to rotate.
struct StillPixels {
  int64_t all = 0;
  int64_t still = 0;
  void Add(const PixelMask& mask, size_t p) {
    ++all;
    still += mask.inside[p] == 0 ? 1 : 0;
  }
  double Share() const { return all > 0 ? static_cast<double>(still) / static_cast<double>(all) : 0; }
};

// Of the pixels that show the table's top, or its side, whichever has more, in some photos: on the one photos
// may tell the motion, and not on the other.
double StaticShare(const TrainingScene& scene, const RotatingRegion& region,
                   const std::optional<RotatingShape>& shape, Backend* backend) {
  RotatingRegion top_alone = region;
  top_alone.low = top_alone.high;
  StillPixels top;
  StillPixels side;
  const size_t count = std::min<size_t>(kMaskedPhotos, scene.photos.size());
  for (size_t i = 0; i < count; ++i) {
    const PinholeView view = Reduced(scene.photos[i * scene.photos.size() / count].view);
    const PixelMask mask = RotatingMask(backend->Render(MaskRequest(scene, shape, view)));
    PixelMask on_top{mask.width, mask.height, std::vector<uint8_t>(mask.inside.size(), 0)};
    PixelMask on_table = on_top;
    AddRegion(top_alone, view, &on_top);
    AddRegion(region, view, &on_table);
    for (size_t p = 0; p < mask.inside.size(); ++p) {
      if (on_top.inside[p] != 0) {
        top.Add(mask, p);
      } else if (on_table.inside[p] != 0) {
        side.Add(mask, p);
      }
    }
  }
  return std::max(top.Share(), side.Share());
}

}  // namespace

std::optional<TableCircle> FindTableInPhotos(const TrainingScene& scene, const LoadPhoto& load,
                                             Reporter& reporter) {
  if (!scene.region || scene.mode != TrainMode::kS2gs) return std::nullopt;
  const TurntableAxis& axis = scene.region->axis;
  std::vector<double> heights;
  std::vector<double> radii;
  for (const ScenePoint& point : scene.points) {
    if (!point.rotates) continue;
    const Eigen::Vector3d from_axis = point.x - axis.point;
    heights.push_back(from_axis.dot(axis.direction));
    radii.push_back((from_axis - heights.back() * axis.direction).norm());
  }
  if (heights.empty()) return std::nullopt;
  const double low = Quantile(heights, kFew);
  const double around = kAround * (Quantile(std::move(heights), 1 - kFew) - low);
  CircleSearch search;
  search.axis = axis;
  search.low = low - around;
  search.high = low + around;
  search.max_radius = kReach * Quantile(std::move(radii), 1 - kFew);
  return FindTableCircle(StillPictures(scene, load, reporter), search);
}

TableRim RimOfCircle(const TrainingScene& scene, const TableCircle& circle,
                     const std::optional<RotatingShape>& shape, Backend* backend) {
  TableRim rim;
  rim.region = {scene.region->axis, circle.radius, circle.side_end.value_or(circle.height), circle.height};
  rim.share = circle.share;
  rim.false_alarms = circle.false_alarms;
  rim.static_share = StaticShare(scene, rim.region, shape, backend);
  return rim;
}

}  // namespace s2gs
