#include "plugin/colmap/point_colors.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {

namespace {

constexpr int kMostPhotos = 8;  // in memory at a time

struct PointColor {
  uint64_t point3D_id = 0;
  std::array<uint8_t, 3> rgb{};
};

// What one photo shows of each model's points, and why it could not be read.
struct PhotoColors {
  std::vector<std::vector<PointColor>> by_model;
  std::string problem;
};

PhotoColors ColorsOf(const std::filesystem::path& path, const std::string& name,
                     const std::vector<ColmapModel*>& models) {
  PhotoColors colors;
  Image8 photo;
  try {
    photo = ReadImage(path, 3);
  } catch (const UserError& error) {
    colors.problem = error.what();
    return colors;
  }
  colors.by_model.resize(models.size());
  for (size_t m = 0; m < models.size(); ++m) {
    const auto image = std::find_if(models[m]->images.begin(), models[m]->images.end(),
                                    [&](const auto& entry) { return entry.second.name == name; });
    if (image == models[m]->images.end()) continue;
    for (const ColmapPoint2D& point : image->second.points2D) {
      if (point.point3D_id == kInvalidPoint3DId) continue;
      const int x = std::clamp(static_cast<int>(std::floor(point.xy.x())), 0, photo.width - 1);
      const int y = std::clamp(static_cast<int>(std::floor(point.xy.y())), 0, photo.height - 1);
      const uint8_t* rgb = photo.Pixel(x, y);
      colors.by_model[m].push_back({point.point3D_id, {rgb[0], rgb[1], rgb[2]}});
    }
  }
  return colors;
}

}  // namespace

void ColorPoints(const std::filesystem::path& image_folder, const std::vector<ColmapModel*>& models,
                 Reporter& reporter) {
  std::set<std::string> distinct;
  for (const ColmapModel* model : models) {
    for (const auto& [id, image] : model->images) distinct.insert(image.name);
  }
  const std::vector<std::string> names(distinct.begin(), distinct.end());
  std::vector<PhotoColors> photos(names.size());
  const int num_threads = std::min(kMostPhotos, NumThreadsOf(0));
  ParallelFor(static_cast<int64_t>(names.size()), num_threads, [&](int64_t i) {
    if (reporter.StopRequested()) throw Interrupted();
    const std::string& name = names[static_cast<size_t>(i)];
    photos[static_cast<size_t>(i)] = ColorsOf(image_folder / name, name, models);
  });
  struct Sum {
    Eigen::Vector3d rgb = Eigen::Vector3d::Zero();
    int count = 0;
  };
  std::vector<std::map<uint64_t, Sum>> sums(models.size());
  int unreadable = 0;
  std::string first_problem;
  for (const PhotoColors& photo : photos) {
    if (!photo.problem.empty() && unreadable++ == 0) first_problem = photo.problem;
    for (size_t m = 0; m < photo.by_model.size(); ++m) {
      for (const PointColor& color : photo.by_model[m]) {
        Sum& sum = sums[m][color.point3D_id];
        sum.rgb += Eigen::Vector3d(color.rgb[0], color.rgb[1], color.rgb[2]);
        ++sum.count;
      }
    }
  }
  for (size_t m = 0; m < models.size(); ++m) {
    for (const auto& [id, sum] : sums[m]) {
      const Eigen::Vector3d mean = sum.rgb / sum.count;
      for (int c = 0; c < 3; ++c)
        models[m]->points3D.at(id).rgb(c) = static_cast<uint8_t>(std::lround(mean(c)));
    }
  }
  if (unreadable > 0) {
    reporter.Warn(std::to_string(unreadable) +
                  " photos could not be read for the points' colours, first: " + first_problem);
  }
}

}  // namespace s2gs
