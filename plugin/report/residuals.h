#pragma once

#include <Eigen/Core>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// Reprojection errors of a model's observations: keypoint minus projection [px].
struct ModelResiduals {
  struct Observation {
    Eigen::Vector2d xy;        ///< the keypoint [px].
    Eigen::Vector2d residual;  ///< where the keypoint lies from where its point is projected to [px].
    uint64_t point3D_id;
  };
  std::map<uint32_t, std::vector<Observation>> by_image;  ///< key: image id.
  size_t num_behind = 0;                                  ///< points that the camera cannot see.
  size_t num_observations = 0;
};

/// Cameras without a projection here have no residuals.
ModelResiduals ComputeResiduals(const ColmapModel& model);

/// sqrt of the mean squared length; NaN when there are none.
double RmsLength(const std::vector<ModelResiduals::Observation>& observations);

/// Mean residuals over the parts of the frame. What several photos show of one point in one part counts as
/// one: photos of one station see the background's points at the same pixels, with the same error.
struct ResidualField {
  struct Cell {
    Eigen::Vector2d middle;  ///< [px]
    Eigen::Vector2d mean;    ///< [px]
    size_t count = 0;        ///< of points.
    /// Whether chance would hardly give such a mean: less than once in twenty such fields.
    bool is_systematic = false;
  };
  uint64_t width = 0;  ///< of the frame [px].
  uint64_t height = 0;
  double cell_px = 0;       ///< side of a cell.
  std::vector<Cell> cells;  ///< those with observations.
};

/// Over all images of the camera. \param across  cells along the longer side.
ResidualField ComputeResidualField(const std::vector<const ColmapModel*>& models,
                                   const std::vector<const ModelResiduals*>& residuals, const Camera& camera,
                                   int across);

/// Counts in `bins` equal parts of [0, limit); what lies beyond is in the last.
std::vector<size_t> Histogram(const std::vector<double>& values, double limit, int bins);

/// How many points each pair of images shares: counts[a][b] for places a, b in `order`, 0 on the diagonal.
/// Images that are not in `order` do not count.
std::vector<std::vector<uint32_t>> SharedPoints(const ColmapModel& model,
                                                const std::vector<std::string>& order);

}  // namespace s2gs
