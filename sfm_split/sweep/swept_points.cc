#include "sfm_split/sweep/swept_points.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/silhouettes/scene_silhouettes.h"
#include "sfm_split/silhouettes/silhouette.h"
#include "sfm_split/silhouettes/silhouette_rays.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kFewestPhotos = 4;      // of a station: a photo and two neighbours on either side of a gap
constexpr double kSmoothingPx = 1;    // of what is swept: steps of depth move it by less
constexpr double kDepthStepPx = 0.7;  // [px] in a neighbour
constexpr int kFewestDepths = 8;      // a judgement: of a thing that is small in the photo
constexpr int kMostDepths = 256;      // a judgement: bounds the time
constexpr double kTiltRad =
    35 * kDegree;  // of the planes that are tried: in between a patch is stretched by a tenth
constexpr double kLeastMovePx = 3;    // what moves less may stand still
constexpr double kOtherPx = 3;        // between places in a neighbour that are no one place, half a patch
constexpr double kMostAlike = 0.8;    // of how far a match is from perfect, over the next one's: Lowe's ratio
constexpr double kQuality = 1e-3;     // of a photo's best seed: the best of a photo are taken in any case
constexpr double kLeastFacing = 0.5;  // cosine, at which a point is taken for seen
// Of patches as photos have them, with all their noise: of 149 values, as many correlate so once in 1e10.
constexpr double kLeastUnsmoothed = 0.5;
constexpr double kMoveRoomPx = 4;     // that a patch may move from where poses that are not good yet put it
constexpr double kMostSigmaPx = 0.3;  // of a patch's place, in the shrunk photo

struct Photo {
  const ColmapImage* image = nullptr;
  const Camera* camera = nullptr;  // of the shrunk photo
  GreyPhoto grey;                  // shrunk
  cv::Mat allowed;                 // 8 bit: where a patch lies inside the outline, by its centre
  double reach = 0;                // of the thing, from the axis
};

cv::Mat Smoothed(const GreyPhoto& photo) {
  const cv::Mat bytes(photo.height, photo.width, CV_8UC1, const_cast<uint8_t*>(photo.grey.data()));
  cv::Mat smoothed;
  bytes.convertTo(smoothed, CV_32F);
  cv::GaussianBlur(smoothed, smoothed, {0, 0}, kSmoothingPx);
  return smoothed;
}

GreyPhoto Shrunk(const GreyPhoto& photo, int factor) {
  if (factor == 1) return photo;
  GreyPhoto result;
  result.width = photo.width / factor;
  result.height = photo.height / factor;
  const cv::Mat bytes(photo.height, photo.width, CV_8UC1, const_cast<uint8_t*>(photo.grey.data()));
  cv::Mat reduced;
  cv::resize(bytes(cv::Rect(0, 0, result.width * factor, result.height * factor)), reduced,
             {result.width, result.height}, 0, 0, cv::INTER_AREA);
  result.grey.assign(reduced.begin<uint8_t>(), reduced.end<uint8_t>());
  return result;
}

Camera Shrunk(const Camera& camera, int factor) {
  Camera result = camera;
  result.width /= static_cast<uint64_t>(factor);
  result.height /= static_cast<uint64_t>(factor);
  for (size_t k = 0; k < InfoOf(camera.model).FirstExtraParam(); ++k) result.params[k] /= factor;
  return result;
}

// Where a patch around the pixel lies inside the outline.
cv::Mat Allowed(const Silhouette& outline, const Vector2d& px_per_picture, int width, int height,
                int radius) {
  cv::Mat inside(height, width, CV_8UC1, cv::Scalar(0));
  for (int y = 0; y < height; ++y) {
    const int row = static_cast<int>((y + 0.5) / px_per_picture.y());
    for (int x = 0; x < width; ++x) {
      const int column = static_cast<int>((x + 0.5) / px_per_picture.x());
      if (row >= outline.height || column >= outline.width) continue;
      const size_t at =
          static_cast<size_t>(row) * static_cast<size_t>(outline.width) + static_cast<size_t>(column);
      inside.at<uint8_t>(y, x) = outline.inside[at] > 0 ? 255 : 0;
    }
  }
  cv::erode(inside, inside, cv::getStructuringElement(cv::MORPH_ELLIPSE, {2 * radius + 1, 2 * radius + 1}),
            {-1, -1}, 1, cv::BORDER_CONSTANT, cv::Scalar(0));
  return inside;
}

// A patch's values less their mean, of unit length; false where they do not vary.
bool Normalise(std::vector<float>* values) {
  double sum = 0;
  for (const float value : *values) sum += value;
  const auto mean = static_cast<float>(sum / static_cast<double>(values->size()));
  double squares = 0;
  for (float& value : *values) {
    value -= mean;
    squares += value * value;
  }
  if (!(squares > 1e-6)) return false;
  const auto scale = static_cast<float>(1 / std::sqrt(squares));
  for (float& value : *values) value *= scale;
  return true;
}

// One photo's places, against its neighbours.
class PhotoSweep {
 public:
  struct Neighbour {
    const Photo* photo = nullptr;
    const cv::Mat* smoothed = nullptr;
  };

  PhotoSweep(const Photo& reference, const cv::Mat& smoothed, std::array<Neighbour, 2> neighbours,
             const TurntableAxis& axis, const SweepOptions& options)
      : reference_(reference), smoothed_(smoothed), neighbours_(neighbours), axis_(axis), options_(options) {
    for (int v = -options.radius_px; v <= options.radius_px; ++v) {
      for (int u = -options.radius_px; u <= options.radius_px; ++u) {
        if (u * u + v * v <= options.radius_px * options.radius_px)
          nodes_.emplace_back(static_cast<float>(u), static_cast<float>(v));
      }
    }
  }

  // Of a pixel.
  std::optional<SurfacePatch> At(int column, int row) const;

 private:
  // Of a patch at a depth in a neighbour.
  struct Sight {
    Vector2d place;
    float correlation = -1;
  };
  // What of the reference is looked for.
  struct SeedPatch {
    Vector2d xy;
    std::vector<float> values;  // normalised
    Vector3d origin;
    std::array<Vector3d, 3> rays;  // through the place, and a radius to the right and below
  };
  // A patch of the surface by both neighbours.
  struct Candidate {
    float correlation = -1;
    Vector2d place = Vector2d::Zero();  // in the first neighbour
    SurfacePatch patch;
  };
  std::optional<SeedPatch> Seed(int column, int row) const;
  std::vector<double> Depths(const Vector2d& xy) const;
  std::optional<Candidate> BestPlane(const SeedPatch& seed, const Vector3d& x,
                                     std::vector<float>* seen) const;
  std::optional<Sight> See(const Neighbour& neighbour, const Vector3d& x, const Vector3d& beside_u,
                           const Vector3d& beside_v, const std::vector<float>& values,
                           std::vector<float>* seen) const;

  const Photo& reference_;
  const cv::Mat& smoothed_;
  std::array<Neighbour, 2> neighbours_;
  const TurntableAxis& axis_;
  const SweepOptions& options_;
  std::vector<Eigen::Vector2f> nodes_;
};

std::optional<PhotoSweep::Sight> PhotoSweep::See(const Neighbour& neighbour, const Vector3d& x,
                                                 const Vector3d& beside_u, const Vector3d& beside_v,
                                                 const std::vector<float>& values,
                                                 std::vector<float>* seen) const {
  const Camera& camera = *neighbour.photo->camera;
  const Rigid3& pose = neighbour.photo->image->cam_from_world;
  const auto at = ProjectToImage(camera, pose * x);
  const auto at_u = ProjectToImage(camera, pose * beside_u);
  const auto at_v = ProjectToImage(camera, pose * beside_v);
  if (!at || !at_u || !at_v) return std::nullopt;
  const auto radius = static_cast<double>(options_.radius_px);
  const Eigen::Vector2f centre = (*at - Vector2d(0.5, 0.5)).cast<float>();
  const Eigen::Vector2f along_u = ((*at_u - *at) / radius).cast<float>();
  const Eigen::Vector2f along_v = ((*at_v - *at) / radius).cast<float>();
  const cv::Mat& image = *neighbour.smoothed;
  const auto reach = static_cast<float>(radius) * (along_u.cwiseAbs() + along_v.cwiseAbs());
  if (!(centre.x() - reach.x() >= 0 && centre.y() - reach.y() >= 0 &&
        centre.x() + reach.x() < static_cast<float>(image.cols - 1) &&
        centre.y() + reach.y() < static_cast<float>(image.rows - 1)))
    return std::nullopt;
  for (size_t k = 0; k < nodes_.size(); ++k) {
    const Eigen::Vector2f place = centre + nodes_[k].x() * along_u + nodes_[k].y() * along_v;
    const int column = static_cast<int>(place.x());
    const int row = static_cast<int>(place.y());
    const float u = place.x() - static_cast<float>(column);
    const float v = place.y() - static_cast<float>(row);
    const float* above = image.ptr<float>(row) + column;
    const float* below = image.ptr<float>(row + 1) + column;
    const float upper = above[0] + u * (above[1] - above[0]);
    const float lower = below[0] + u * (below[1] - below[0]);
    (*seen)[k] = upper + v * (lower - upper);
  }
  if (!Normalise(seen)) return std::nullopt;
  Sight sight;
  sight.place = *at;
  float sum = 0;
  for (size_t k = 0; k < nodes_.size(); ++k) sum += values[k] * (*seen)[k];
  sight.correlation = sum;
  return sight;
}

// The best of the planes that are tried at a depth; nothing where one of the neighbours does not see it, or
// sees it move by no more than what stands still may.
std::optional<PhotoSweep::Candidate> PhotoSweep::BestPlane(const SeedPatch& seed, const Vector3d& x,
                                                           std::vector<float>* seen) const {
  const auto& [xy, values, origin, rays] = seed;
  Candidate best;
  for (const int tilt : {0, -1, 1}) {
    const Vector3d normal = Eigen::AngleAxisd(tilt * kTiltRad, axis_.direction) * Vector3d(-rays[0]);
    const double rise = normal.dot(x - origin);
    const Vector3d beside_u = origin + rise / normal.dot(rays[1]) * rays[1];
    const Vector3d beside_v = origin + rise / normal.dot(rays[2]) * rays[2];
    Candidate candidate = {0, Vector2d::Zero(), {x, normal}};
    for (size_t n = 0; n < neighbours_.size(); ++n) {
      const auto sight = See(neighbours_[n], x, beside_u, beside_v, values, seen);
      if (!sight || !((sight->place - xy).norm() > kLeastMovePx))
        return best.correlation > -1 ? std::optional<Candidate>(best) : std::nullopt;
      if (n == 0) candidate.place = sight->place;
      candidate.correlation += sight->correlation / static_cast<float>(neighbours_.size());
    }
    if (candidate.correlation > best.correlation) best = candidate;
  }
  return best.correlation > -1 ? std::optional<Candidate>(best) : std::nullopt;
}

// The depths at which the ray is no farther from the axis than the thing reaches.
std::vector<double> PhotoSweep::Depths(const Vector2d& xy) const {
  const Rigid3& pose = reference_.image->cam_from_world;
  const auto ray = RayPastAxis(*reference_.camera, pose, xy, axis_);
  if (!ray || !(ray->distance < reference_.reach) || !(ray->nearest > 0)) return {};
  const double half =
      std::sqrt((reference_.reach * reference_.reach - ray->distance * ray->distance) / ray->across_squared);
  double turn_rad = 0;
  for (const Neighbour& neighbour : neighbours_) {
    turn_rad =
        std::max(turn_rad, neighbour.photo->image->cam_from_world.rotation.angularDistance(pose.rotation));
  }
  const double px = 2 * half * std::sin(turn_rad) * FocalLengths(*reference_.camera).mean() / ray->nearest;
  const int num = std::clamp(static_cast<int>(px / kDepthStepPx), kFewestDepths, kMostDepths);
  std::vector<double> depths;
  for (int k = 0; k < num; ++k) {
    const double depth = ray->nearest + half * (2 * (k + 0.5) / num - 1);
    if (depth > 0) depths.push_back(depth);
  }
  return depths;
}

std::optional<PhotoSweep::SeedPatch> PhotoSweep::Seed(int column, int row) const {
  const int radius = options_.radius_px;
  if (column < radius || row < radius || column + radius >= smoothed_.cols || row + radius >= smoothed_.rows)
    return std::nullopt;
  SeedPatch seed;
  for (const Eigen::Vector2f& node : nodes_)
    seed.values.push_back(
        smoothed_.at<float>(row + static_cast<int>(node.y()), column + static_cast<int>(node.x())));
  if (!Normalise(&seed.values)) return std::nullopt;
  const Rigid3& pose = reference_.image->cam_from_world;
  seed.xy = Vector2d(column + 0.5, row + 0.5);
  seed.origin = CameraCentre(pose);
  for (size_t k = 0; k < 3; ++k) {
    const auto in_cam = UnprojectFromImage(*reference_.camera, seed.xy + radius * Vector2d(k == 1, k == 2));
    if (!in_cam) return std::nullopt;
    seed.rays[k] = (pose.rotation.inverse() * *in_cam).normalized();
  }
  return seed;
}

std::optional<SurfacePatch> PhotoSweep::At(int column, int row) const {
  const std::optional<SeedPatch> seed = Seed(column, row);
  if (!seed) return std::nullopt;
  std::vector<Candidate> candidates;
  std::vector<float> seen(nodes_.size());
  for (const double depth : Depths(seed->xy)) {
    const auto candidate = BestPlane(*seed, seed->origin + depth * seed->rays[0], &seen);
    if (candidate) candidates.push_back(*candidate);
  }
  const auto best =
      std::max_element(candidates.begin(), candidates.end(),
                       [](const Candidate& a, const Candidate& b) { return a.correlation < b.correlation; });
  if (best == candidates.end() || !(best->correlation >= options_.min_correlation)) return std::nullopt;
  float next = -1;
  for (const Candidate& candidate : candidates) {
    if ((candidate.place - best->place).norm() > kOtherPx) next = std::max(next, candidate.correlation);
  }
  if (!(1 - best->correlation < kMostAlike * (1 - next))) return std::nullopt;
  return best->patch;
}

}  // namespace

struct SurfaceSweep::Data {
  int factor = 1;
  SweepOptions options;
  ColmapModel model;  // of the shrunk photos, without points
  std::map<std::string, Photo> photos;
  std::vector<SurfacePoint> points;
  uint64_t first_id = 1;
  TurntableAxis axis;

  void ReadStation(const TurntableScene& scene, int station, const ReadGreyPhoto& read, Reporter& reporter);
  void SweepStation(const TurntableScene& scene, int station, Reporter& reporter);
  void MarkKnown(const Photo& photo, cv::Mat* mask) const;
};

void SurfaceSweep::Data::ReadStation(const TurntableScene& scene, int station, const ReadGreyPhoto& read,
                                     Reporter& reporter) {
  std::map<std::string, const ColmapImage*> image_of_name;
  for (const auto& [id, image] : model.images) image_of_name[image.name] = &image;
  std::vector<const View*> views;
  std::vector<GreyPicture> pictures;
  std::vector<Photo> read_photos;
  for (const View* view : ViewsByAngle(scene, station)) {
    if (reporter.StopRequested()) throw Interrupted();
    const auto image = image_of_name.find(view->name);
    if (image == image_of_name.end()) continue;
    const GreyPhoto grey = read(view->name);
    if (grey.grey.empty()) continue;
    GreyPicture picture = PictureOf(grey);
    if (!pictures.empty() && picture.photo_size != pictures.front().photo_size) continue;
    views.push_back(view);
    pictures.push_back(std::move(picture));
    Photo photo;
    photo.image = image->second;
    photo.camera = &model.cameras.at(photo.image->camera_id);
    photo.grey = Shrunk(grey, factor);
    read_photos.push_back(std::move(photo));
  }
  if (static_cast<int>(views.size()) < kFewestPhotos) return;
  const std::vector<Silhouette> outlines = FindSilhouettes(pictures, 60);
  std::vector<SilhouetteView> silhouette_views;
  for (size_t k = 0; k < views.size(); ++k) {
    if (const Camera* camera = scene.FindCamera(views[k]->camera_id))
      silhouette_views.push_back({&outlines[k], camera, views[k]->CamFromObject()});
  }
  const double reach = ReachOf(silhouette_views, axis);
  for (size_t k = 0; k < views.size(); ++k) {
    Photo& photo = read_photos[k];
    photo.reach = reach;
    if (outlines[k].IsFound()) {
      photo.allowed = Allowed(outlines[k], outlines[k].photo_px / factor, photo.grey.width, photo.grey.height,
                              options.radius_px);
    }
    photos.emplace(views[k]->name, std::move(photo));
  }
}

// Where points that are known already lie: their patches are no other witnesses.
void SurfaceSweep::Data::MarkKnown(const Photo& photo, cv::Mat* mask) const {
  const Vector3d centre = CameraCentre(photo.image->cam_from_world);
  for (const SurfacePoint& point : points) {
    if (point.patch.normal.dot((centre - point.patch.centre).normalized()) < kLeastFacing) continue;
    const auto xy = ProjectToImage(*photo.camera, photo.image->cam_from_world * point.patch.centre);
    if (!xy || !(xy->cwiseAbs().maxCoeff() < 1e6)) continue;
    cv::circle(*mask, {static_cast<int>(xy->x()), static_cast<int>(xy->y())}, options.spacing_px,
               cv::Scalar(0), cv::FILLED);
  }
}

void SurfaceSweep::Data::SweepStation(const TurntableScene& scene, int station, Reporter& reporter) {
  std::vector<const Photo*> ring;
  for (const View* view : ViewsByAngle(scene, station)) {
    const auto found = photos.find(view->name);
    if (found != photos.end()) ring.push_back(&found->second);
  }
  const size_t count = ring.size();
  if (static_cast<int>(count) < kFewestPhotos) return;
  const auto turn_deg = [&](size_t a, size_t b) {
    return ring[a]->image->cam_from_world.rotation.angularDistance(ring[b]->image->cam_from_world.rotation) /
           kDegree;
  };
  std::map<size_t, cv::Mat> smoothed;
  const auto smooth = [&](size_t k) -> const cv::Mat& {
    if (smoothed.count(k) == 0) smoothed[k] = Smoothed(ring[k]->grey);
    return smoothed[k];
  };
  for (size_t k = 0; k < count; ++k) {
    if (reporter.StopRequested()) throw Interrupted();
    if (ring[k]->allowed.empty()) continue;
    std::vector<size_t> near;
    for (const size_t n :
         {(k + 1) % count, (k + count - 1) % count, (k + 2) % count, (k + count - 2) % count}) {
      if (turn_deg(k, n) <= options.max_turn_deg && near.size() < 2) near.push_back(n);
    }
    if (near.size() < 2) continue;
    cv::Mat mask = ring[k]->allowed.clone();
    MarkKnown(*ring[k], &mask);
    std::vector<cv::Point2f> seeds;
    cv::goodFeaturesToTrack(smooth(k), seeds, options.max_seeds, kQuality, options.spacing_px, mask,
                            2 * options.radius_px + 1);
    const PhotoSweep sweep(*ring[k], smooth(k),
                           {PhotoSweep::Neighbour{ring[near[0]], &smooth(near[0])},
                            PhotoSweep::Neighbour{ring[near[1]], &smooth(near[1])}},
                           axis, options);
    std::vector<std::optional<SurfacePatch>> found(seeds.size());
    ParallelFor(static_cast<int64_t>(seeds.size()), 0, [&](int64_t i) {
      const cv::Point2f& seed = seeds[static_cast<size_t>(i)];
      found[static_cast<size_t>(i)] = sweep.At(static_cast<int>(seed.x), static_cast<int>(seed.y));
    });
    for (const auto& patch : found) {
      if (patch) {
        points.push_back(
            {*patch,
             {ring[k]->image->image_id, ring[near[0]]->image->image_id, ring[near[1]]->image->image_id}});
      }
    }
    if (k >= 2) smoothed.erase(k - 2);
  }
}

SurfaceSweep::SurfaceSweep(const AlignedScene& aligned, const ReadGreyPhoto& read,
                           const SweepOptions& options, Reporter& reporter)
    : data_(std::make_unique<Data>()) {
  S2GS_INVARIANT(!options.Check());
  data_->options = options;
  data_->axis = aligned.scene.axis;
  uint64_t longest = 1;
  for (const auto& [id, camera] : aligned.object.cameras)
    longest = std::max({longest, camera.width, camera.height});
  data_->factor = std::max(1, static_cast<int>(std::lround(static_cast<double>(longest) / options.side_px)));
  for (const auto& [id, camera] : aligned.object.cameras)
    data_->model.cameras.emplace(id, Shrunk(camera, data_->factor));
  for (const auto& [id, image] : aligned.object.images) {
    ColmapImage without = image;
    without.points2D.clear();
    data_->model.images.emplace(id, std::move(without));
  }
  if (!aligned.object.points3D.empty()) data_->first_id = aligned.object.points3D.rbegin()->first + 1;
  std::vector<int> stations;
  for (const View& view : aligned.scene.views) stations.push_back(view.station);
  std::sort(stations.begin(), stations.end());
  stations.erase(std::unique(stations.begin(), stations.end()), stations.end());
  for (const int station : stations) {
    data_->ReadStation(aligned.scene, station, read, reporter);
    data_->SweepStation(aligned.scene, station, reporter);
  }
}

SurfaceSweep::~SurfaceSweep() = default;

int SurfaceSweep::NumPoints() const { return static_cast<int>(data_->points.size()); }

std::vector<AlignedTrack> SurfaceSweep::Tracks(PhotosLookedIn where, Reporter& reporter) const {
  TrackPlacesOptions places;
  places.patch.radius_px = data_->options.radius_px;
  places.patch.min_correlation = kLeastUnsmoothed;
  places.patch.max_move_px = kMoveRoomPx;
  places.max_sigma_px = kMostSigmaPx;
  if (where == PhotosLookedIn::kTracks) places.min_facing = 1;
  const ReadGreyPhoto read = [&](const std::string& name) {
    const auto found = data_->photos.find(name);
    return found != data_->photos.end() ? found->second.grey : GreyPhoto();
  };
  std::vector<AlignedTrack> tracks = AlignPoints(data_->model, data_->points, read, places, reporter);
  for (AlignedTrack& track : tracks) {
    track.point3D_id += data_->first_id - 1;
    for (TrackPlace& place : track.places) {
      place.place.xy *= data_->factor;
      place.place.sigma_px *= data_->factor;
    }
  }
  return tracks;
}

OptionCheck SweepOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (side_px < 100) return fault("side_px", side_px, "side_px >= 100");
  if (radius_px < 2) return fault("radius_px", radius_px, "radius_px >= 2");
  if (spacing_px < 1) return fault("spacing_px", spacing_px, "spacing_px >= 1");
  if (max_seeds < 1) return fault("max_seeds", max_seeds, "max_seeds >= 1");
  if (!(max_turn_deg > 0 && max_turn_deg < 90))
    return fault("max_turn_deg", max_turn_deg, "0 < max_turn_deg < 90");
  if (!(min_correlation > 0 && min_correlation < 1))
    return fault("min_correlation", min_correlation, "0 < min_correlation < 1");
  return std::nullopt;
}

}  // namespace s2gs
