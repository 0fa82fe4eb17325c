#include "sfm_split/photo_tracks/track_places.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <optional>
#include <set>
#include <utility>

#include "sfm_split/base/infinity.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/scene/projection_jacobians.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kMostPhotos = 8;         // in memory at a time
constexpr double kSplineMarginPx = 5;  // a cubic spline's border fades by .27 a pixel: .001 is left
constexpr double kLeastFacing = 0.3;   // cosine between a first normal and the middle view

struct Observation {
  const ColmapImage* image = nullptr;
  const Camera* camera = nullptr;
  uint32_t point2D_idx = kNoKeypoint;
  bool is_beside = false;
  Vector2d predicted = Vector2d::Zero();
  double px_per_length = 0;
  PhotoPart part;
};

struct Track {
  uint64_t point3D_id = kInvalidPoint3DId;
  Vector3d xyz = Vector3d::Zero();
  std::vector<Vector3d> first_normals;  // that are tried
  std::vector<Observation> observations;
  size_t reference = 0;
};

// The view whose direction is nearest to the others'.
size_t MiddleView(const Track& track) {
  std::vector<Vector3d> directions;
  Vector3d sum = Vector3d::Zero();
  for (const Observation& o : track.observations) {
    directions.push_back((CameraCentre(o.image->cam_from_world) - track.xyz).normalized());
    sum += directions.back();
  }
  const auto best =
      std::max_element(directions.begin(), directions.end(),
                       [&](const Vector3d& a, const Vector3d& b) { return a.dot(sum) < b.dot(sum); });
  return static_cast<size_t>(best - directions.begin());
}

// Nothing where the point is behind the camera.
std::optional<Observation> Predict(const ColmapModel& model, const ColmapImage& image, const Vector3d& x) {
  Observation o;
  o.image = &image;
  o.camera = &model.cameras.at(image.camera_id);
  Eigen::Matrix<double, 2, 3> jacobian;
  if (!ProjectWithJacobians(o.camera->model, o.camera->params.data(), image.cam_from_world * x, &o.predicted,
                            &jacobian, nullptr))
    return std::nullopt;
  o.px_per_length = jacobian.norm() / std::sqrt(2.0);
  return o;
}

std::vector<Track> MakeTracks(const ColmapModel& model, int min_found) {
  std::vector<Track> tracks;
  for (const auto& [id, point] : model.points3D) {
    if (static_cast<int>(point.track.size()) < min_found) continue;
    Track track;
    track.point3D_id = id;
    track.xyz = point.xyz;
    for (const ColmapTrackElement& element : point.track) {
      std::optional<Observation> o = Predict(model, model.images.at(element.image_id), point.xyz);
      if (!o) continue;
      o->point2D_idx = element.point2D_idx;
      track.observations.push_back(std::move(*o));
    }
    if (static_cast<int>(track.observations.size()) < min_found) continue;
    track.reference = MiddleView(track);
    tracks.push_back(std::move(track));
  }
  return tracks;
}

std::vector<Track> MakeTracks(const ColmapModel& model, const std::vector<SurfacePoint>& points) {
  uint64_t next_id = model.points3D.empty() ? 1 : model.points3D.rbegin()->first + 1;
  std::vector<Track> tracks;
  for (const SurfacePoint& point : points) {
    Track track;
    track.point3D_id = next_id++;
    track.xyz = point.patch.centre;
    track.first_normals = {point.patch.normal};
    for (const uint32_t id : point.image_ids) {
      std::optional<Observation> o = Predict(model, model.images.at(id), track.xyz);
      if (o) track.observations.push_back(std::move(*o));
    }
    // The first photo stands for the others.
    if (track.observations.size() == point.image_ids.size()) tracks.push_back(std::move(track));
  }
  return tracks;
}

// The longest tracks stay.
void DropShort(int max_observations, std::vector<Track>* tracks) {
  std::stable_sort(tracks->begin(), tracks->end(), [](const Track& a, const Track& b) {
    return a.observations.size() > b.observations.size();
  });
  size_t sum = 0;
  size_t kept = 0;
  while (kept < tracks->size()) {
    sum += (*tracks)[kept].observations.size();
    if (sum > static_cast<size_t>(max_observations)) break;
    ++kept;
  }
  tracks->erase(tracks->begin() + static_cast<std::ptrdiff_t>(kept), tracks->end());
}

PhotoPart Cut(const GreyPhoto& photo, const Vector2d& centre, double reach) {
  PhotoPart part;
  const int x1 = std::clamp(static_cast<int>(std::floor(centre.x() - reach)), 0, photo.width);
  const int y1 = std::clamp(static_cast<int>(std::floor(centre.y() - reach)), 0, photo.height);
  const int x2 = std::clamp(static_cast<int>(std::ceil(centre.x() + reach)), 0, photo.width);
  const int y2 = std::clamp(static_cast<int>(std::ceil(centre.y() + reach)), 0, photo.height);
  part.x = x1;
  part.y = y1;
  part.width = x2 - x1;
  part.height = y2 - y1;
  part.grey.reserve(static_cast<size_t>(part.width) * static_cast<size_t>(part.height));
  for (int y = y1; y < y2; ++y) {
    const auto row = photo.grey.begin() + static_cast<std::ptrdiff_t>(y) * photo.width;
    part.grey.insert(part.grey.end(), row + x1, row + x2);
  }
  return part;
}

// Of all observations that have none yet.
void CutParts(const ReadGreyPhoto& read, const TrackPlacesOptions& options, std::vector<Track>* tracks,
              Reporter& reporter) {
  std::map<const ColmapImage*, std::vector<std::pair<Track*, Observation*>>> of_image;
  for (Track& track : *tracks) {
    for (Observation& o : track.observations) {
      if (o.part.grey.empty()) of_image[o.image].emplace_back(&track, &o);
    }
  }
  std::vector<const ColmapImage*> images;
  images.reserve(of_image.size());
  for (const auto& [image, parts] : of_image) images.push_back(image);
  const int num_threads = std::min(kMostPhotos, NumThreadsOf(0));
  ParallelFor(static_cast<int64_t>(images.size()), num_threads, [&](int64_t i) {
    if (reporter.StopRequested()) throw Interrupted();
    const ColmapImage* image = images[static_cast<size_t>(i)];
    const GreyPhoto photo = read(image->name);
    for (const auto& [track, o] : of_image.at(image)) {
      const double ratio = o->px_per_length / track->observations[track->reference].px_per_length;
      o->part = Cut(photo, o->predicted,
                    (options.patch.radius_px + 1) * std::max(1.0, ratio) * 1.1 + options.patch.max_move_px +
                        kSplineMarginPx);
    }
  });
}

// Normals of planes through each point's neighbours, towards the cameras; the direction to the cameras where
// these do not lie in a plane that faces them.
class FirstNormals {
 public:
  FirstNormals(const ColmapModel& model, int num_neighbours) : num_(static_cast<size_t>(num_neighbours)) {
    for (const auto& [id, point] : model.points3D) points_.push_back(point.xyz);
    std::sort(points_.begin(), points_.end(), [](const Vector3d& a, const Vector3d& b) {
      return std::lexicographical_compare(a.data(), a.data() + 3, b.data(), b.data() + 3);
    });
  }

  Vector3d At(const Vector3d& x, const Vector3d& towards) const {
    const std::vector<std::pair<double, size_t>> nearest = Nearest(x);
    if (nearest.size() < 4) return towards;
    Vector3d mean = Vector3d::Zero();
    for (const auto& [distance, i] : nearest) mean += points_[i] / static_cast<double>(nearest.size());
    Matrix3d scatter = Matrix3d::Zero();
    for (const auto& [distance, i] : nearest) {
      const Vector3d d = points_[i] - mean;
      scatter += d * d.transpose();
    }
    Vector3d normal = Eigen::SelfAdjointEigenSolver<Matrix3d>(scatter).eigenvectors().col(0);
    if (normal.dot(towards) < 0) normal = -normal;
    return normal.dot(towards) > kLeastFacing ? normal : towards;
  }

 private:
  // Outwards along x until what follows is farther than the farthest that is kept.
  std::vector<std::pair<double, size_t>> Nearest(const Vector3d& x) const {
    std::vector<std::pair<double, size_t>> heap;
    const auto begin = std::lower_bound(points_.begin(), points_.end(), x.x(),
                                        [](const Vector3d& a, double value) { return a.x() < value; });
    auto above = static_cast<size_t>(begin - points_.begin());
    size_t below = above;
    while (below > 0 || above < points_.size()) {
      const double up = above < points_.size() ? points_[above].x() - x.x() : kInfinity;
      const double down = below > 0 ? x.x() - points_[below - 1].x() : kInfinity;
      const double least = std::min(up, down);
      if (heap.size() == num_ && least * least > heap.front().first) break;
      const size_t next = up <= down ? above++ : --below;
      heap.emplace_back((points_[next] - x).squaredNorm(), next);
      std::push_heap(heap.begin(), heap.end());
      if (heap.size() <= num_) continue;
      std::pop_heap(heap.begin(), heap.end());
      heap.pop_back();
    }
    return heap;
  }

  std::vector<Vector3d> points_;
  size_t num_;
};

// Adds the photos that a patch faces. Returns how many.
int AddFacingPhotos(const ColmapModel& model, const TrackPlacesOptions& options, const SurfacePatch& patch,
                    Track* track) {
  std::set<const ColmapImage*> known;
  for (const Observation& o : track->observations) known.insert(o.image);
  const size_t before = track->observations.size();
  for (const auto& [id, image] : model.images) {
    if (known.count(&image) > 0) continue;
    const Vector3d ray = (CameraCentre(image.cam_from_world) - track->xyz).normalized();
    if (!(patch.normal.dot(ray) >= options.min_facing)) continue;
    std::optional<Observation> o = Predict(model, image, track->xyz);
    if (!o) continue;
    const double margin = options.patch.radius_px;
    if (o->predicted.x() < margin || o->predicted.y() < margin ||
        o->predicted.x() > o->camera->width - margin || o->predicted.y() > o->camera->height - margin)
      continue;
    o->is_beside = true;
    track->observations.push_back(std::move(*o));
  }
  return static_cast<int>(track->observations.size() - before);
}

AlignedTrack AlignOne(const Track& track, const std::vector<Vector3d>& first_normals,
                      const TrackPlacesOptions& options) {
  AlignedTrack result;
  result.point3D_id = track.point3D_id;
  std::vector<SplinePart> parts;
  std::vector<size_t> source;
  parts.reserve(track.observations.size());
  size_t reference = track.observations.size();
  for (size_t k = 0; k < track.observations.size(); ++k) {
    const PhotoPart& part = track.observations[k].part;
    if (part.width < 4 || part.height < 4) continue;
    if (k == track.reference) reference = parts.size();
    parts.emplace_back(part);
    source.push_back(k);
  }
  if (reference == track.observations.size()) return result;
  std::vector<PatchView> views;
  for (size_t i = 0; i < parts.size(); ++i) {
    const Observation& o = track.observations[source[i]];
    views.push_back({&parts[i], o.camera, o.image->cam_from_world});
  }
  result.patch.centre = track.xyz;
  std::vector<PatchPlace> places;
  int64_t most = 0;
  for (const Vector3d& normal : first_normals) {
    SurfacePatch patch = {track.xyz, normal};
    std::vector<PatchPlace> found = AlignPatch(views, reference, options.patch, &patch);
    const int64_t num_found =
        std::count_if(found.begin(), found.end(), [](const PatchPlace& place) { return place.is_found; });
    if (num_found <= most) continue;
    most = num_found;
    places = std::move(found);
    result.patch = patch;
    if (2 * most > static_cast<int64_t>(views.size())) break;
  }
  for (size_t i = 0; i < places.size(); ++i) {
    if (!places[i].is_found || places[i].sigma_px > options.max_sigma_px) continue;
    const Observation& o = track.observations[source[i]];
    result.places.push_back({o.image->image_id, o.point2D_idx, o.is_beside, places[i]});
  }
  return result;
}

// In the photos of the tracks, and then in others that patches face.
std::vector<AlignedTrack> Align(const ColmapModel& model, const ReadGreyPhoto& read,
                                const TrackPlacesOptions& options, std::vector<Track> tracks,
                                Reporter& reporter) {
  CutParts(read, options, &tracks, reporter);
  std::vector<AlignedTrack> aligned(tracks.size());
  const auto for_all = [&](const std::function<void(Track*, AlignedTrack*)>& run) {
    ParallelFor(static_cast<int64_t>(tracks.size()), 0, 16, [&](int64_t i) {
      if (reporter.StopRequested()) throw Interrupted();
      run(&tracks[static_cast<size_t>(i)], &aligned[static_cast<size_t>(i)]);
    });
  };
  for_all(
      [&](Track* track, AlignedTrack* result) { *result = AlignOne(*track, track->first_normals, options); });
  int left = options.min_facing < 1 ? options.max_beside : 0;
  for (size_t t = 0; t < tracks.size() && left > 0; ++t) {
    if (static_cast<int>(aligned[t].places.size()) >= options.min_found)
      left -= AddFacingPhotos(model, options, aligned[t].patch, &tracks[t]);
  }
  CutParts(read, options, &tracks, reporter);
  for_all([&](Track* track, AlignedTrack* result) {
    if (!track->observations.back().is_beside) return;
    AlignedTrack longer = AlignOne(*track, {result->patch.normal}, options);
    if (longer.places.size() > result->places.size()) *result = std::move(longer);
  });
  aligned.erase(std::remove_if(aligned.begin(), aligned.end(),
                               [&](const AlignedTrack& track) {
                                 return static_cast<int>(track.places.size()) < options.min_found;
                               }),
                aligned.end());
  return aligned;
}

}  // namespace

OptionCheck TrackPlacesOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (min_found < 3) return fault("min_found", min_found, "min_found >= 3");
  if (!(max_sigma_px > 0)) return fault("max_sigma_px", max_sigma_px, "max_sigma_px > 0");
  if (num_neighbours < 4) return fault("num_neighbours", num_neighbours, "num_neighbours >= 4");
  if (!(min_facing > 0 && min_facing <= 1)) return fault("min_facing", min_facing, "0 < min_facing <= 1");
  if (max_beside < 0) return fault("max_beside", max_beside, "max_beside >= 0");
  if (max_observations < 1000) return fault("max_observations", max_observations, "max_observations >= 1000");
  return patch.Check();
}

std::vector<AlignedTrack> AlignTracks(const ColmapModel& model, const ReadGreyPhoto& read,
                                      const TrackPlacesOptions& options, Reporter& reporter) {
  S2GS_INVARIANT(!options.Check());
  std::vector<Track> tracks = MakeTracks(model, options.min_found);
  DropShort(options.max_observations, &tracks);
  const FirstNormals normals(model, options.num_neighbours);
  ParallelFor(static_cast<int64_t>(tracks.size()), 0, 16, [&](int64_t i) {
    Track& track = tracks[static_cast<size_t>(i)];
    const Observation& middle = track.observations[track.reference];
    const Vector3d towards = (CameraCentre(middle.image->cam_from_world) - track.xyz).normalized();
    track.first_normals = {normals.At(track.xyz, towards), towards};
  });
  return Align(model, read, options, std::move(tracks), reporter);
}

std::vector<AlignedTrack> AlignPoints(const ColmapModel& model, const std::vector<SurfacePoint>& points,
                                      const ReadGreyPhoto& read, const TrackPlacesOptions& options,
                                      Reporter& reporter) {
  S2GS_INVARIANT(!options.Check());
  return Align(model, read, options, MakeTracks(model, points), reporter);
}

}  // namespace s2gs
