#include "plugin/report/residuals.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "sfm_split/scene/camera_projection.h"

namespace s2gs {
namespace {

// Once in so many fields, one cell of pure noise may look systematic.
constexpr double kFalseAlarms = 0.05;
constexpr size_t kMinPoints = 10;  // of a cell: fewer are not alike enough, seen by one photo or by many

}  // namespace

ModelResiduals ComputeResiduals(const ColmapModel& model) {
  ModelResiduals residuals;
  for (const auto& [id, image] : model.images) {
    const Camera& camera = model.cameras.at(image.camera_id);
    if (!InfoOf(camera.model).has_projection) continue;
    std::vector<ModelResiduals::Observation> observations;
    for (const ColmapPoint2D& keypoint : image.points2D) {
      if (keypoint.point3D_id == kInvalidPoint3DId) continue;
      const Eigen::Vector3d& point = model.points3D.at(keypoint.point3D_id).xyz;
      const std::optional<Eigen::Vector2d> projected = ProjectToImage(camera, image.cam_from_world * point);
      if (!projected) {
        ++residuals.num_behind;
        continue;
      }
      observations.push_back({keypoint.xy, keypoint.xy - *projected, keypoint.point3D_id});
    }
    residuals.num_observations += observations.size();
    residuals.by_image.emplace(id, std::move(observations));
  }
  return residuals;
}

double RmsLength(const std::vector<ModelResiduals::Observation>& observations) {
  if (observations.empty()) return std::numeric_limits<double>::quiet_NaN();
  double sum = 0;
  for (const ModelResiduals::Observation& observation : observations) {
    sum += observation.residual.squaredNorm();
  }
  return std::sqrt(sum / static_cast<double>(observations.size()));
}

ResidualField ComputeResidualField(const std::vector<const ColmapModel*>& models,
                                   const std::vector<const ModelResiduals*>& residuals, const Camera& camera,
                                   int across) {
  ResidualField field;
  field.width = camera.width;
  field.height = camera.height;
  field.cell_px = static_cast<double>(std::max(camera.width, camera.height)) / across;
  struct Sum {
    Eigen::Vector2d residual = Eigen::Vector2d::Zero();
    size_t count = 0;
  };
  using Point = std::pair<size_t, uint64_t>;  // model and id
  std::map<std::pair<int, int>, std::map<Point, Sum>> sums;
  for (size_t m = 0; m < models.size(); ++m) {
    for (const auto& [id, observations] : residuals[m]->by_image) {
      if (models[m]->images.at(id).camera_id != camera.camera_id) continue;
      for (const ModelResiduals::Observation& observation : observations) {
        const Eigen::Vector2d cell = observation.xy / field.cell_px;
        if (!(cell.minCoeff() >= 0 && cell.maxCoeff() < across + 1)) continue;
        Sum& sum =
            sums[{static_cast<int>(cell.x()), static_cast<int>(cell.y())}][{m, observation.point3D_id}];
        sum.residual += observation.residual;
        ++sum.count;
      }
    }
  }
  for (const auto& [at, points] : sums) {
    ResidualField::Cell cell;
    cell.middle = field.cell_px * Eigen::Vector2d(at.first + 0.5, at.second + 0.5);
    cell.count = points.size();
    cell.mean.setZero();
    double squares = 0;
    for (const auto& [point, sum] : points) {
      const Eigen::Vector2d mean = sum.residual / static_cast<double>(sum.count);
      cell.mean += mean;
      squares += mean.squaredNorm();
    }
    const auto n = static_cast<double>(points.size());
    cell.mean /= n;
    // Of n normal residuals with one unknown variance, the mean's square over that of the rest is distributed
    // as F(2, 2 (n - 1)), whose tail has this closed form.
    const double others = squares - n * cell.mean.squaredNorm();
    const double log_tail = others > 0 ? -(n - 1) * std::log1p(n * cell.mean.squaredNorm() / others)
                                       : (cell.mean.norm() > 0 ? -1e300 : 0.0);
    cell.is_systematic =
        cell.count >= kMinPoints && log_tail < std::log(kFalseAlarms / static_cast<double>(sums.size()));
    field.cells.push_back(cell);
  }
  return field;
}

std::vector<size_t> Histogram(const std::vector<double>& values, double limit, int bins) {
  std::vector<size_t> counts(bins, 0);
  for (const double value : values) {
    const int bin = static_cast<int>(std::min<double>(value / limit * bins, bins - 1));
    ++counts[std::max(0, bin)];
  }
  return counts;
}

std::vector<std::vector<uint32_t>> SharedPoints(const ColmapModel& model,
                                                const std::vector<std::string>& order) {
  std::map<std::string, size_t> place;
  for (size_t i = 0; i < order.size(); ++i) place[order[i]] = i;
  std::map<uint32_t, size_t> place_of_id;
  for (const auto& [id, image] : model.images) {
    const auto found = place.find(image.name);
    if (found != place.end()) place_of_id[id] = found->second;
  }
  std::vector<std::vector<uint32_t>> counts(order.size(), std::vector<uint32_t>(order.size(), 0));
  std::vector<size_t> seen;
  for (const auto& [id, point] : model.points3D) {
    seen.clear();
    for (const ColmapTrackElement& element : point.track) {
      const auto found = place_of_id.find(element.image_id);
      if (found != place_of_id.end()) seen.push_back(found->second);
    }
    std::sort(seen.begin(), seen.end());
    seen.erase(std::unique(seen.begin(), seen.end()), seen.end());
    for (const size_t a : seen) {
      for (const size_t b : seen) {
        if (a != b) ++counts[a][b];
      }
    }
  }
  return counts;
}

}  // namespace s2gs
