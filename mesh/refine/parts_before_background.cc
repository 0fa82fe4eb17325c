#include "mesh/refine/parts_before_background.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <map>
#include <optional>
#include <utility>

#include "mesh/refine/vertex_visibility.h"
#include "mesh/surface/triangle_area.h"
#include "s2gs/image/background_votes.h"
#include "s2gs/image/image_error.h"
#include "s2gs/image/photos.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/median_of_pictures.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// What a photo must show of a part by itself for a vote [px].
constexpr int kLeastPixels = 10;
// A fused surface is so far off, and lenses blur so far, at least [px].
constexpr int kMargin = 2;
// Larger photos are shrunk: a part that is seen has many pixels then.
constexpr double kMostPixels = 1e6;
constexpr int kGainStep = 4;  // photos' brightness is compared at one pixel of so many, each way
constexpr int kMaxShrink = 16;
// Of a station, for a median and votes: more tell no better what stands behind, and all are held at once.
constexpr size_t kMostPhotos = 100;
constexpr int kRowsAtOnce = 64;  // whose counts are held at once

// Instead of a part's number.
constexpr int kNothing = -2;  // at a pixel that shows nothing of the mesh
constexpr int kOfNoPart = -1;

// A photo, and what of the mesh it shows.
struct SeenParts {
  int width = 0;
  int height = 0;
  std::vector<uint8_t> grey;
  std::vector<int> part;         // nearest at the pixel
  std::vector<int32_t> spot;     // its vertex there; negative: none
  std::vector<uint8_t> covered;  // something of the mesh is at most kMargin away
  std::vector<uint8_t> alone;    // and no other part is
  double gain = 1;
};

// Pixels of parts from which no other part is kMargin away or less.
std::vector<uint8_t> FindAlone(const std::vector<int>& parts, int width, int height) {
  std::vector<uint8_t> alone(parts.size(), 0);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const size_t at = static_cast<size_t>(y) * width + x;
      bool is_alone = parts[at] >= 0;
      for (int v = std::max(0, y - kMargin); v <= std::min(height - 1, y + kMargin); ++v) {
        for (int u = std::max(0, x - kMargin); u <= std::min(width - 1, x + kMargin); ++u) {
          const int other = parts[static_cast<size_t>(v) * width + u];
          is_alone &= other == parts[at] || other < 0;
        }
      }
      alone[at] = static_cast<uint8_t>(is_alone);
    }
  }
  return alone;
}

SeenParts See(const RefinementPhotoSource& photos, int index, const TriangleMesh& mesh,
              const std::vector<int>& part_of_triangle) {
  const ObjectView& full = photos.Camera(index);
  const double pixels = static_cast<double>(full.width) * full.height;
  int factor = 1;
  while (factor < kMaxShrink && pixels > kMostPixels * factor * factor) ++factor;
  const ImagePart whole = {0, 0, full.width / factor * factor, full.height / factor * factor};
  const ObjectView view = CutAndShrunk(full, whole, factor);
  SeenParts seen;
  seen.width = view.width;
  seen.height = view.height;
  seen.grey = CutAndShrink(photos.Load(index), whole, factor).pixels;
  std::vector<int32_t> triangles;
  RenderMeshDepth(mesh, view, &triangles);
  seen.part.resize(triangles.size());
  seen.spot.assign(triangles.size(), kNothing);
  for (size_t i = 0; i < triangles.size(); ++i) {
    seen.part[i] = triangles[i] < 0 ? kNothing : part_of_triangle[triangles[i]];
    if (triangles[i] >= 0) seen.spot[i] = static_cast<int32_t>(mesh.triangles[triangles[i]][0]);
  }
  PixelMask mesh_mask = {seen.width, seen.height, {}};
  for (const int part : seen.part) mesh_mask.inside.push_back(part == kNothing ? 0 : 1);
  seen.covered = Widened(mesh_mask, kMargin).inside;
  seen.alone = FindAlone(seen.part, seen.width, seen.height);
  return seen;
}

// The background's brightness at a pixel in each photo that shows it, brought to one exposure.
void BackgroundsAt(size_t at, const std::vector<SeenParts>& photos, std::vector<double>* values) {
  values->clear();
  for (const SeenParts& photo : photos) {
    if (photo.covered[at] == 0) values->push_back(photo.gain * photo.grey[at]);
  }
}

void FindGains(std::vector<SeenParts>* photos) {
  std::vector<std::vector<double>> ratios(photos->size());
  const SeenParts& first = photos->front();
  std::vector<double> values;
  for (int y = 0; y < first.height; y += kGainStep) {
    for (int x = 0; x < first.width; x += kGainStep) {
      const size_t at = static_cast<size_t>(y) * first.width + x;
      BackgroundsAt(at, *photos, &values);
      if (static_cast<int>(values.size()) < kLeastBackgrounds) continue;
      const double median = UpperMedian(values);
      for (size_t k = 0; k < photos->size(); ++k) {
        const SeenParts& photo = (*photos)[k];
        if (photo.covered[at] == 0 && photo.grey[at] > 0) ratios[k].push_back(median / photo.grey[at]);
      }
    }
  }
  for (size_t k = 0; k < photos->size(); ++k) {
    if (!ratios[k].empty()) (*photos)[k].gain = UpperMedian(ratios[k]);
  }
}

// How bright the parts' spots are, by all photos of one camera, brought to one exposure.
class SpotBrightness {
 public:
  SpotBrightness(const std::vector<SeenParts>& photos, size_t num_spots)
      : sums_(num_spots), nums_(num_spots) {
    for (const SeenParts& photo : photos) {
      for (size_t at = 0; at < photo.spot.size(); ++at) {
        if (photo.alone[at] == 0) continue;
        sums_[photo.spot[at]] += photo.gain * photo.grey[at];
        ++nums_[photo.spot[at]];
      }
    }
  }

  // Without what this pixel of a photo shows; nothing where no other shows the spot.
  std::optional<double> ByOthers(const SeenParts& photo, size_t at) const {
    const int32_t spot = photo.spot[at];
    if (nums_[spot] < 2) return std::nullopt;
    return (sums_[spot] - photo.gain * photo.grey[at]) / (nums_[spot] - 1);
  }

 private:
  std::vector<double> sums_;
  std::vector<int> nums_;
};

// What a photo's pixels say of a part.
struct PixelCount {
  int known = 0;
  int differ = 0;
  double chance = 0;

  void Add(const PixelCount& other) {
    known += other.known;
    differ += other.differ;
    chance += other.chance;
  }
};

// One camera's photos vote. A part that is as bright as the background looks the same whether it is there or
// not: asked is where it would differ, as bright as the other photos show it. \param num_spots  vertices.
void CountVotes(const std::vector<SeenParts>& photos, size_t num_spots, int num_threads,
                std::vector<BackgroundVotes>* votes) {
  const SpotBrightness brightness(photos, num_spots);
  const SeenParts& first = photos.front();
  const size_t num_parts = votes->size();
  using Counts = std::vector<PixelCount>;  // by photo and part
  const auto count_row = [&](int64_t y) {
    Counts counts;
    std::vector<double> values;
    for (int x = 0; x < first.width; ++x) {
      const size_t at = static_cast<size_t>(y) * first.width + x;
      const bool is_asked = std::any_of(photos.begin(), photos.end(),
                                        [&](const SeenParts& photo) { return photo.alone[at] != 0; });
      if (!is_asked) continue;
      BackgroundsAt(at, photos, &values);
      if (static_cast<int>(values.size()) < kLeastBackgrounds) continue;
      const double median = UpperMedian(values);
      for (double& value : values) value = std::abs(value - median);
      const BackgroundRange range = FindBackgroundRange(&values);
      if (counts.empty()) counts.resize(photos.size() * num_parts);
      for (size_t k = 0; k < photos.size(); ++k) {
        const SeenParts& photo = photos[k];
        if (photo.alone[at] == 0) continue;
        const std::optional<double> own = brightness.ByOthers(photo, at);
        if (!own || std::abs(*own - median) <= range.most) continue;
        PixelCount& pixels = counts[k * num_parts + photo.part[at]];
        ++pixels.known;
        pixels.differ += std::abs(photo.gain * photo.grey[at] - median) > range.most ? 1 : 0;
        pixels.chance += range.chance;
      }
    }
    return counts;
  };
  Counts sums(photos.size() * num_parts);
  for (int begin = 0; begin < first.height; begin += kRowsAtOnce) {
    std::vector<Counts> of_rows(std::min(kRowsAtOnce, first.height - begin));
    ParallelFor(static_cast<int64_t>(of_rows.size()), num_threads,
                [&](int64_t k) { of_rows[k] = count_row(begin + k); });
    for (const Counts& counts : of_rows) {
      for (size_t i = 0; i < counts.size(); ++i) sums[i].Add(counts[i]);
    }
  }
  for (size_t k = 0; k < photos.size(); ++k) {
    for (size_t part = 0; part < num_parts; ++part) {
      const PixelCount& sum = sums[k * num_parts + part];
      if (sum.known < kLeastPixels) continue;
      BackgroundVotes& of_part = (*votes)[part];
      ++of_part.photos;
      of_part.differ += 2 * sum.differ > sum.known ? 1 : 0;
      of_part.chance += sum.chance / sum.known;
    }
  }
}

std::vector<PartSight> Decide(const std::vector<BackgroundVotes>& votes, size_t largest) {
  int judged = 0;
  for (size_t part = 0; part < votes.size(); ++part)
    judged += part != largest && votes[part].photos > 0 ? 1 : 0;
  // Where photos do not tell the largest from the background, they refute none.
  const bool may_refute = DifferBeyondChance(votes[largest]);
  const double as_largest = ShareWhereSomethingIs(votes[largest]);
  std::vector<PartSight> sights(votes.size(), PartSight::kUnknown);
  for (size_t part = 0; part < votes.size(); ++part) {
    if (part == largest) continue;
    const BackgroundSight sight = Weigh(votes[part], as_largest, judged);
    if (sight == BackgroundSight::kThere) sights[part] = PartSight::kThere;
    if (sight == BackgroundSight::kNotThere && may_refute) sights[part] = PartSight::kNotThere;
  }
  return sights;
}

// Of a surface seen head-on from as near as any of the cameras that stand still is.
double MostPixelsPerArea(const TriangleMesh& mesh, const RefinementPhotoSource& photos,
                         const std::vector<int>& station_of_photo) {
  double most = 0;
  for (size_t i = 0; i < station_of_photo.size(); ++i) {
    if (station_of_photo[i] < 0) continue;
    const ObjectView& view = photos.Camera(static_cast<int>(i));
    double nearest = std::numeric_limits<double>::infinity();
    for (const Eigen::Vector3f& vertex : mesh.vertices) {
      const double depth = (view.cam_from_object * vertex.cast<double>()).z();
      if (depth > 0) nearest = std::min(nearest, depth);
    }
    most = std::max(most, view.fx * view.fy / (nearest * nearest));
  }
  return most;
}

// Of a station's photos kMostPhotos at most, evenly chosen, in their order.
std::vector<int> MostPhotosOf(const std::vector<int>& indices) {
  if (indices.size() <= kMostPhotos) return indices;
  std::vector<int> chosen;
  chosen.reserve(kMostPhotos);
  for (size_t k = 0; k < kMostPhotos; ++k) chosen.push_back(indices[k * indices.size() / kMostPhotos]);
  return chosen;
}

// Parts that are large enough for a vote: numbered anew from 0 by number, the largest too.
struct Candidates {
  std::vector<int> of_triangle;
  std::vector<int> part;  // as it was numbered
  size_t largest = 0;
};

Candidates FindCandidates(const TriangleMesh& mesh, const std::vector<int>& part_of_triangle, int num_parts,
                          double most_pixels_per_area) {
  std::vector<double> areas(num_parts, 0);
  for (size_t t = 0; t < part_of_triangle.size(); ++t) {
    if (part_of_triangle[t] >= 0) areas[part_of_triangle[t]] += TriangleArea(mesh, mesh.triangles[t]);
  }
  const auto largest = std::max_element(areas.begin(), areas.end()) - areas.begin();
  Candidates found;
  std::vector<int> number(num_parts, kOfNoPart);
  for (int part = 0; part < num_parts; ++part) {
    if (areas[part] * most_pixels_per_area < kLeastPixels && part != largest) continue;
    if (part == largest) found.largest = found.part.size();
    number[part] = static_cast<int>(found.part.size());
    found.part.push_back(part);
  }
  for (const int part : part_of_triangle) found.of_triangle.push_back(part < 0 ? kOfNoPart : number[part]);
  return found;
}

}  // namespace

PartsBeforeBackground::PartsBeforeBackground(const RefinementPhotoSource& photos,
                                             std::vector<int> station_of_photo, int num_threads,
                                             Reporter& reporter)
    : photos_(photos),
      station_of_photo_(std::move(station_of_photo)),
      num_threads_(num_threads),
      reporter_(reporter) {}

std::vector<PartSight> PartsBeforeBackground::Judge(const TriangleMesh& mesh,
                                                    const std::vector<int>& part_of_triangle) const {
  int num_parts = 0;
  for (const int part : part_of_triangle) num_parts = std::max(num_parts, part + 1);
  std::vector<PartSight> sights(num_parts, PartSight::kUnknown);
  if (num_parts < 2) return sights;
  std::map<int, std::vector<int>> photos_of_station;
  for (size_t i = 0; i < station_of_photo_.size(); ++i) {
    if (station_of_photo_[i] >= 0) photos_of_station[station_of_photo_[i]].push_back(static_cast<int>(i));
  }
  const Candidates candidates =
      FindCandidates(mesh, part_of_triangle, num_parts, MostPixelsPerArea(mesh, photos_, station_of_photo_));
  if (candidates.part.size() < 2) return sights;

  std::vector<BackgroundVotes> votes(candidates.part.size());
  for (const auto& of_station : photos_of_station) {
    const std::vector<int> indices = MostPhotosOf(of_station.second);
    if (indices.size() < kPicturesForMedian) continue;
    std::vector<SeenParts> photos(indices.size());
    ParallelFor(static_cast<int64_t>(indices.size()), num_threads_, [&](int64_t k) {
      if (reporter_.StopRequested()) throw Interrupted();
      photos[k] = See(photos_, indices[k], mesh, candidates.of_triangle);
    });
    const bool is_one_size = std::all_of(photos.begin(), photos.end(), [&](const SeenParts& photo) {
      return photo.width == photos.front().width && photo.height == photos.front().height;
    });
    if (!is_one_size) continue;
    FindGains(&photos);
    CountVotes(photos, mesh.vertices.size(), num_threads_, &votes);
  }
  const std::vector<PartSight> decided = Decide(votes, candidates.largest);
  for (size_t i = 0; i < decided.size(); ++i) sights[candidates.part[i]] = decided[i];
  return sights;
}

}  // namespace s2gs
