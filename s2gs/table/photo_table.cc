#include "s2gs/table/photo_table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <map>
#include <utility>
#include <vector>

#include "s2gs/image/median_picture.h"
#include "s2gs/image/photos.h"
#include "s2gs/image/picture_noise.h"
#include "s2gs/image/turned_picture.h"
#include "s2gs/kernel/foreground.h"
#include "s2gs/rotating_mask.h"
#include "s2gs/scene/photo_exposure.h"
#include "s2gs/table/opaque_region.h"
#include "s2gs/table/still_witness.h"
#include "s2gs/table/table_circle.h"
#include "sfm_split/base/median_of_pictures.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr size_t kMaxPhotos = 36;  // evenly from all of a station's: ten degrees apart
constexpr int kLongSide = 480;     // [px]: a pixel is some hundredth of a table.
constexpr double kSameView = 0.5;  // [px]: as near as rims are found.
constexpr int kShadesOfOne = 4;    // photos that one outweighs in which the ground is lit: a judgement.
constexpr int kMaskedPhotos = 6;   // of all, to see what the model takes to stand still
constexpr double kFew = 0.05;      // of the points: outliers.
// Of the points at least on a thing that is much plainer than its table.
constexpr double kFewOfThing = 0.01;
// The table lies where the rotating points begin, so many of their heights about it.
constexpr double kAround = 0.5;
// The same below it, where there is none: a thing hides its lower half from cameras that look down.
constexpr double kBelow = 1;
constexpr double kReach = 4;          // the same: a small thing on a large table.
constexpr double kFootOfThing = 0.1;  // of its points' heights
constexpr size_t kThingRings = 16;
constexpr size_t kPointsOfRing = 3;  // as many as tell a median from an outlier.
// Of things on the table: none of three is beyond its rim by chance where less than .63 of them are.
constexpr size_t kPointsOfThing = 3;
constexpr int64_t kGaussiansAtOnce = 1000;  // that one thread looks at

PinholeView Reduced(const PinholeView& view) {
  const double scale = std::min(1.0, static_cast<double>(kLongSide) / std::max(view.width, view.height));
  return ResizeView(view, std::max(1, static_cast<int>(view.width * scale)),
                    std::max(1, static_cast<int>(view.height * scale)));
}

// How far what is far away has moved in a picture, at the most, because its camera has turned [px].
double TurnedBy(const PinholeView& from, const PinholeView& to) {
  const Eigen::Matrix3d turn =
      (to.cam_from_world.rotation * from.cam_from_world.rotation.conjugate()).toRotationMatrix();
  double most = 0;
  for (const double x : {0.0, static_cast<double>(from.width)}) {
    for (const double y : {0.0, static_cast<double>(from.height)}) {
      const Eigen::Vector3d ray = turn * Eigen::Vector3d((x - from.cx) / from.fx, (y - from.cy) / from.fy, 1);
      if (!(ray.z() > 0)) return std::numeric_limits<double>::infinity();
      const Eigen::Vector2d there(to.cx + to.fx * ray.x() / ray.z(), to.cy + to.fy * ray.y() / ray.z());
      most = std::max(most, (there - Eigen::Vector2d(x, y)).norm());
    }
  }
  return most;
}

// Turns the last photo back to how the first looks, if its camera has turned, as on a tripod that shakes:
// what stands still lies in the same pixels then. What has hardly moved stays as it is, and as sharp.
void TurnToFirst(StationPhotos* station) {
  PinholeView& view = station->views.back();
  const PinholeView turned = TurnedTo(station->views.front(), view);
  if (!(TurnedBy(view, turned) > kSameView)) return;
  station->images.back() = TurnedPicture(view, turned, station->images.back(), nullptr);
  view = turned;
}

// Whether photos show the ground where something would hang down from the table. A shadow that a thing throws
// comes and goes on the ground as the thing turns; but what turns may look so, too, where hardly any photo
// shows the ground itself.
bool IsGround(const StillVotes& votes) {
  return votes.same >= votes.changes - votes.shades && kShadesOfOne * votes.same >= votes.shades;
}

// Whether things are known to stand on the table, and none of them to reach beyond its rim.
bool StayInside(const std::vector<Eigen::Vector3d>& of_things, const RotatingRegion& body) {
  size_t over_top = 0;
  for (const Eigen::Vector3d& x : of_things) {
    const Eigen::Vector3d from_point = x - body.axis.point;
    const double height = from_point.dot(body.axis.direction);
    if (!(height > body.high)) continue;
    if ((from_point - height * body.axis.direction).norm() > body.radius) return false;
    ++over_top;
  }
  return over_top >= kPointsOfThing;
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

// What stands over the lowest points, by their places about the axis, which are not empty.
std::vector<ThingRing> ThingOver(double low, double high, const std::vector<double>& heights,
                                 const std::vector<double>& radii) {
  // A table's own points lie about its top, which may be at its lowest.
  const double first = low + kFootOfThing * (high - low);
  std::array<std::vector<double>, kThingRings> in_ring;
  for (size_t i = 0; i < heights.size(); ++i) {
    if (!(heights[i] >= first && heights[i] < high)) continue;
    const auto ring = static_cast<size_t>((heights[i] - first) / (high - first) * kThingRings);
    in_ring[std::min<size_t>(ring, kThingRings - 1)].push_back(radii[i]);
  }
  std::vector<ThingRing> thing;
  for (size_t i = 0; i < kThingRings; ++i) {
    if (in_ring[i].size() < kPointsOfRing) continue;
    const double middle = (static_cast<double>(i) + 0.5) / kThingRings;
    thing.push_back({first + middle * (high - first), Quantile(std::move(in_ring[i]), 0.5)});
  }
  return thing;
}

}  // namespace

double PixelAtAxis(const std::vector<StationPhotos>& stations, const TurntableAxis& axis) {
  double size = 0;
  for (const StationPhotos& station : stations) {
    const PinholeView& view = station.views.front();
    size = std::max(size, (view.cam_from_world * axis.point).z() / view.fx);
  }
  return size;
}

PinholeView StationView(const ScenePhoto& photo) { return Reduced(photo.view); }

std::vector<StationPhotos> LoadStationPhotos(const TrainingScene& scene, const LoadPhoto& load,
                                             Reporter& reporter) {
  if (!scene.region || scene.mode != TrainMode::kS2gs) return {};
  std::map<int, std::vector<const ScenePhoto*>> by_number;
  for (const ScenePhoto& photo : scene.photos) {
    if (photo.held_out) continue;
    std::vector<const ScenePhoto*>& station = by_number[photo.station];
    const bool fits = station.empty() || (photo.view.width == station.front()->view.width &&
                                          photo.view.height == station.front()->view.height);
    if (fits) station.push_back(&photo);
  }
  std::vector<StationPhotos> stations;
  for (const auto& [number, photos] : by_number) {
    if (photos.size() < kPicturesForMedian) continue;
    const size_t count = std::min(photos.size(), kMaxPhotos);
    StationPhotos station;
    station.number = number;
    for (size_t i = 0; i < count; ++i) {
      if (reporter.StopRequested()) throw Interrupted();
      const ScenePhoto& photo = *photos[i * photos.size() / count];
      const PinholeView view = Reduced(photo.view);
      station.views.push_back(view);
      station.images.push_back(ResizeByArea(load(photo), view.width, view.height));
      TurnToFirst(&station);
    }
    EqualiseExposure(&station.images);
    station.still = MedianPicture(station.images);
    stations.push_back(std::move(station));
  }
  return stations;
}

std::optional<TableCircle> FindTableInPhotos(const TrainingScene& scene,
                                             const std::vector<StationPhotos>& stations) {
  if (!scene.region || stations.empty()) return std::nullopt;
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
  const double high = Quantile(heights, 1 - kFew);
  CircleSearch search;
  search.axis = axis;
  search.low = low - kAround * (high - low);
  search.high = low + kAround * (Quantile(heights, 1 - kFewOfThing) - low);
  search.thing = ThingOver(low, high, heights, radii);
  search.max_radius = kReach * Quantile(std::move(radii), 1 - kFew);
  std::vector<StillPicture> pictures;
  pictures.reserve(stations.size());
  for (const StationPhotos& station : stations) pictures.push_back({station.views.front(), station.still});
  if (const std::optional<TableCircle> circle = FindTableCircle(pictures, search)) return circle;
  search.low = low - kBelow * (high - low);
  return FindTableCircle(pictures, search);
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

double TexturedShareOfTop(const std::vector<StationPhotos>& stations, const RotatingRegion& table) {
  RotatingRegion top = table;
  top.low = top.high;
  int64_t all = 0;
  int64_t textured = 0;
  for (const StationPhotos& station : stations) {
    const PictureNoise noise = MeasurePictureNoise(station.images.data(), station.images.size());
    const float least = LeastTexture(noise);
    const PinholeView& view = station.views.front();
    PixelMask on_top{view.width, view.height, {}};
    on_top.inside.assign(static_cast<size_t>(view.width) * view.height, 0);
    AddRegion(top, view, &on_top);
    const auto is_top = [&](int x, int y) {
      return on_top.inside[static_cast<size_t>(y) * view.width + x] != 0;
    };
    for (int y = kTextureRadius; y + kTextureRadius < view.height; y += kTextureRadius) {
      for (int x = kTextureRadius; x + kTextureRadius < view.width; x += kTextureRadius) {
        // Its rim is no texture of the top.
        if (!is_top(x - kTextureRadius, y) || !is_top(x + kTextureRadius, y) ||
            !is_top(x, y - kTextureRadius) || !is_top(x, y + kTextureRadius)) {
          continue;
        }
        const auto count =
            std::count_if(station.images.begin(), station.images.end(),
                          [&](const Image8& image) { return TextureAt(image, x, y) >= least; });
        ++all;
        textured += 2 * static_cast<size_t>(count) > station.images.size() ? 1 : 0;
      }
    }
  }
  return all > 0 ? static_cast<double>(textured) / static_cast<double>(all) : 1;
}

std::vector<uint32_t> FindStandingAroundTable(const std::vector<StationPhotos>& stations,
                                              const RotatingRegion& table, const Placement& gaussians,
                                              const std::vector<Eigen::Vector3d>& of_things) {
  std::vector<StillWitness> witnesses;
  witnesses.reserve(stations.size());
  for (const StationPhotos& station : stations) witnesses.emplace_back(station, table);
  if (witnesses.empty()) return {};
  const double pixel_size = PixelAtAxis(stations, table.axis);
  // The circle is known to a pixel.
  RotatingRegion body = table;
  body.radius += pixel_size;
  const bool stay_inside = StayInside(of_things, body);
  const Eigen::Vector3d up = table.axis.direction;
  struct Around {
    uint32_t index;
    bool is_high;
    bool stands;
  };
  std::vector<Around> around;
  for (size_t i = 0; i < gaussians.size(); ++i) {
    const float* centre = gaussians.centre.data() + 3 * i;
    const Eigen::Vector3d x(centre[0], centre[1], centre[2]);
    if (!x.allFinite() || !IsForeground(gaussians.foreground_logit[i])) continue;
    const double height = (x - table.axis.point).dot(up);
    const double distance = (x - table.axis.point - height * up).norm();
    const bool is_under_side = table.low < table.high && height < table.low - pixel_size;
    if (!(distance > body.radius || is_under_side)) continue;
    around.push_back({static_cast<uint32_t>(i), !(height < table.high - pixel_size), false});
  }
  ParallelFor(static_cast<int64_t>(around.size()), 0, kGaussiansAtOnce, [&](int64_t i) {
    Around& of = around[static_cast<size_t>(i)];
    const float* centre = gaussians.centre.data() + size_t{3} * of.index;
    const StillVotes votes =
        AskWitnesses(witnesses, Eigen::Vector3d(centre[0], centre[1], centre[2]),
                     [](size_t, size_t, const Eigen::Vector2d&, double) { return false; });
    of.stands = of.is_high && !stay_inside ? votes.told > votes.changes : IsGround(votes);
  });
  std::vector<uint32_t> standing;
  for (const Around& of : around) {
    if (of.stands) standing.push_back(of.index);
  }
  return standing;
}

}  // namespace s2gs
