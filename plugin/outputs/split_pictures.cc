#include "plugin/outputs/split_pictures.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "s2gs/image/image_file.h"
#include "s2gs/image/photos.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/base/machine_share.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/matching/weak_features.h"
#include "sfm_split/split/picture_order.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr int kMostAdded = 2000;
// Of a photo that is looked for weak features in: six Gaussians and five differences of floats at twice its
// size, a third more in the octaves above, and the photo with its part.
constexpr uint64_t kSearchBytesPerPixel = 4 * 4 * 11 * 4 / 3 + 2;

GreyPicture ReadGreyPicture(const fs::path& path, const Eigen::Vector2i& size) {
  Image8 photo = ReadImage(path, 1);
  if (photo.width != size.x() || photo.height != size.y()) {
    throw UserError(path,
                    "is " + std::to_string(photo.width) + " x " + std::to_string(photo.height) +
                        " pixels, but had " + std::to_string(size.x()) + " x " + std::to_string(size.y()) +
                        " when its features were extracted",
                    "Give the photos that the features come from");
  }
  GreyPicture picture = PictureFor(size);
  if (picture.width < size.x() || picture.height < size.y())
    photo = ResizeByArea(photo, picture.width, picture.height);
  picture.grey = std::move(photo.pixels);
  return picture;
}

template <typename T>
std::vector<T> Reordered(std::vector<T> items, const std::vector<uint32_t>& order) {
  std::vector<T> result;
  result.reserve(items.size());
  for (const uint32_t i : order) result.push_back(std::move(items[i]));
  return result;
}

void CompareAll(const StationOptions& options, ScanPictures* scan, Reporter& reporter) {
  int longest_side = 0;
  for (const GreyPicture& picture : scan->pictures)
    longest_side = std::max(longest_side, picture.photo_size.maxCoeff());
  scan->stations = FindPictureStations(scan->pictures, options.ForPhotosOf(longest_side), reporter);
  scan->changes = FindChanges(scan->pictures, scan->stations);
}

}  // namespace

std::optional<ScanPictures> ReadScanPictures(const fs::path& image_path, const SplitFeatures& features,
                                             const StationOptions& options, Reporter& reporter) {
  const size_t num = features.images.size();
  ScanPictures result;
  result.pictures.resize(num);
  std::vector<std::string> problems(num);
  ParallelFor(static_cast<int64_t>(num), 0, [&](int64_t i) {
    try {
      result.pictures[i] = ReadGreyPicture(image_path / features.images[i].name, features.images[i].size);
    } catch (const UserError& error) {
      problems[i] = error.what();
    }
  });
  for (const std::string& problem : problems) {
    if (problem.empty()) continue;
    reporter.Warn("stations are told by features alone: " + problem);
    return std::nullopt;
  }
  CompareAll(options, &result, reporter);
  return result;
}

void TakeOrderOfCapture(const StationOptions& options, ScanPictures* pictures, SplitFeatures* features,
                        Reporter& reporter) {
  std::vector<uint32_t> place_by_name(pictures->pictures.size());
  std::iota(place_by_name.begin(), place_by_name.end(), 0U);
  if (OrderOfCapture(pictures->pictures, pictures->stations, pictures->changes, place_by_name).empty())
    return;
  reporter.Info("the names are not in the order in which the table turned: the pictures tell it");
  const auto take = [&](const std::vector<uint32_t>& order) {
    pictures->pictures = Reordered(std::move(pictures->pictures), order);
    features->rows = Reordered(std::move(features->rows), order);
    features->images = Reordered(std::move(features->images), order);
    place_by_name = Reordered(std::move(place_by_name), order);
    CompareAll(options, pictures, reporter);
  };
  // A comparison depends a little on the photo that it begins with, which names must not choose.
  take(OrderByContent(pictures->pictures));
  std::vector<uint32_t> order =
      OrderOfCapture(pictures->pictures, pictures->stations, pictures->changes, place_by_name);
  if (order.empty()) {
    order.resize(place_by_name.size());
    for (uint32_t i = 0; i < order.size(); ++i) order[place_by_name[i]] = i;
  }
  take(order);
}

int64_t AddWeakFeatures(const fs::path& image_path, const ScanPictures& pictures, bool always,
                        SplitFeatures* features, Reporter& reporter) {
  const size_t num = features->images.size();
  // Found twice rather than kept: a byte a pixel of all photos is much.
  const auto part_of = [&](int64_t i) {
    const int station = pictures.stations.station_of_image[i];
    return ActivePart(pictures.pictures[i], pictures.stations.photo_from_first[i],
                      pictures.changes.stations[station]);
  };
  std::vector<std::optional<int>> changing_of(num);
  ParallelFor(static_cast<int64_t>(num), 0, [&](int64_t i) {
    const std::vector<uint8_t> part = part_of(i);
    if (part.empty()) return;
    const SplitImage& image = features->images[i];
    const auto is_changing = [&](const Eigen::Vector2f& xy) {
      const int x = std::clamp(static_cast<int>(xy.x()), 0, image.size.x() - 1);
      const int y = std::clamp(static_cast<int>(xy.y()), 0, image.size.y() - 1);
      return part[static_cast<size_t>(y) * image.size.x() + x] != 0;
    };
    changing_of[i] =
        static_cast<int>(std::count_if(image.keypoints.begin(), image.keypoints.end(), is_changing));
  });
  std::vector<int> num_changing;
  int64_t most_pixels = 1;
  for (size_t i = 0; i < num; ++i) {
    if (changing_of[i]) num_changing.push_back(*changing_of[i]);
    most_pixels = std::max(most_pixels, int64_t{features->images[i].size.x()} * features->images[i].size.y());
  }
  if (num_changing.empty()) return 0;
  const int typical = UpperMedian(num_changing);
  features->changing = typical;
  std::vector<SiftFeatures> found(num);
  const int num_threads = ThreadsThatFit(kSearchBytesPerPixel * static_cast<uint64_t>(most_pixels));
  ParallelFor(static_cast<int64_t>(num), num_threads, [&](int64_t i) {
    if (!changing_of[i]) return;
    const std::vector<uint8_t> part = part_of(i);
    const SplitImage& image = features->images[i];
    Image8 photo;
    try {
      photo = ReadImage(image_path / image.name, 1);
    } catch (const UserError&) {
      return;  // it was read before: somebody is changing it
    }
    found[i] = FindWeakFeatures({photo.width, photo.height, photo.pixels.data(), part.data()},
                                image.keypoints, image.scales, kMostAdded);
  });
  std::vector<int> num_found;
  int64_t total = 0;
  for (size_t i = 0; i < num; ++i) {
    if (changing_of[i]) num_found.push_back(static_cast<int>(found[i].keypoints.size()));
    total += static_cast<int64_t>(found[i].keypoints.size());
  }
  features->found = UpperMedian(num_found);
  if (!always && GainOfFeatures(typical, features->found) < kLeastFeatureGain) return 0;
  for (size_t i = 0; i < num; ++i) {
    SplitImage& image = features->images[i];
    const SiftFeatures& added = found[i];
    image.keypoints.insert(image.keypoints.end(), added.keypoints.begin(), added.keypoints.end());
    image.scales.insert(image.scales.end(), added.scales.begin(), added.scales.end());
    image.descriptors.insert(image.descriptors.end(), added.descriptors.begin(), added.descriptors.end());
  }
  features->added = std::move(found);
  features->takes_found = true;
  reporter.Info("what changes from photo to photo has " + std::to_string(typical) +
                " features a photo: looked again at lower thresholds, " +
                std::to_string(total / static_cast<int64_t>(num)) + " more a photo");
  return total;
}

void WriteChangeMaps(const fs::path& folder, const fs::path& image_path, const SceneChanges& changes,
                     const SplitFeatures& features) {
  std::vector<std::string> names;
  names.reserve(features.images.size());
  for (const SplitImage& image : features.images) names.push_back(image.name);
  const ImageOutputs outputs(folder, image_path, names);
  std::vector<fs::path> paths(changes.photos.size());
  for (size_t i = 0; i < paths.size(); ++i) {
    if (!changes.photos[i].deviation.empty())
      paths[i] = outputs.Make(folder, ImageName(names[i], image_path), ".png");
  }
  ParallelFor(static_cast<int64_t>(paths.size()), 0, [&](int64_t k) {
    const auto i = static_cast<size_t>(k);
    const ChangeMap& map = changes.photos[i];
    if (!map.deviation.empty()) WriteImage(paths[i], {map.width, map.height, 1, map.deviation});
  });
}

}  // namespace s2gs
