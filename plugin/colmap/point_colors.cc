#include "plugin/colmap/point_colors.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <string>
#include <utility>

#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"

namespace s2gs {

void ColorPoints(const std::filesystem::path& image_folder, const std::vector<ColmapModel*>& models,
                 Reporter& reporter) {
  std::set<std::string> names;
  for (const ColmapModel* model : models) {
    for (const auto& [id, image] : model->images) names.insert(image.name);
  }
  struct Sum {
    Eigen::Vector3d rgb = Eigen::Vector3d::Zero();
    int count = 0;
  };
  std::vector<std::map<uint64_t, Sum>> sums(models.size());
  int unreadable = 0;
  std::string first_problem;
  for (const std::string& name : names) {
    if (reporter.StopRequested()) throw Interrupted();
    Image8 photo;
    try {
      photo = ReadImage(image_folder / name, 3);
    } catch (const UserError& error) {
      if (unreadable++ == 0) first_problem = error.what();
      continue;
    }
    for (size_t m = 0; m < models.size(); ++m) {
      const auto image = std::find_if(models[m]->images.begin(), models[m]->images.end(),
                                      [&](const auto& entry) { return entry.second.name == name; });
      if (image == models[m]->images.end()) continue;
      for (const ColmapPoint2D& point : image->second.points2D) {
        if (point.point3D_id == kInvalidPoint3DId) continue;
        const int x = std::clamp(static_cast<int>(std::floor(point.xy.x())), 0, photo.width - 1);
        const int y = std::clamp(static_cast<int>(std::floor(point.xy.y())), 0, photo.height - 1);
        const uint8_t* rgb = photo.Pixel(x, y);
        Sum& sum = sums[m][point.point3D_id];
        sum.rgb += Eigen::Vector3d(rgb[0], rgb[1], rgb[2]);
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
