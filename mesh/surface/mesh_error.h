#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstdint>
#include <optional>
#include <vector>

#include "mesh/surface/object_view.h"
#include "mesh/surface/triangle_mesh.h"
#include "mesh/surface/triangle_tree.h"
#include "sfm_split/base/rigid3.h"

namespace s2gs {

/// Points drawn from a mesh's surface.
struct SurfaceSamples {
  std::vector<Eigen::Vector3d> points;
  double area = 0;                     ///< of the whole surface.
  int64_t num_unusable_triangles = 0;  ///< without area, or with a corner that is not finite: never drawn.
};

/// `count` points, uniform over the surface's area: the same for equal arguments, whatever the thread count.
/// No points when no triangle has area.
/// \param stream  samples of different streams are independent.
SurfaceSamples SampleSurface(const TriangleMesh& mesh, int64_t count, uint64_t seed, uint64_t stream);

/// The distance of each query to the nearest of `points`, exact up to rounding. `points` must not be empty
/// and all must be finite.
std::vector<double> NearestDistances(const std::vector<Eigen::Vector3d>& queries,
                                     const std::vector<Eigen::Vector3d>& points);

/// The part of space in which surfaces count.
struct CropRegion {
  std::optional<Eigen::AlignedBox3d> box;
  std::optional<Eigen::Hyperplane<double, 3>> plane;  ///< only the side that its normal points to.

  bool Contains(const Eigen::Vector3d& x) const {
    return (!box || box->contains(x)) && (!plane || plane->signedDistance(x) > 0);
  }
};

/// The triangles that count in a region: those with area of which a corner lies on the plane's side and whose
/// bounding box overlaps the region's. They are taken whole.
std::vector<TriangleCorners> TrianglesInside(const TriangleMesh& mesh, const Sim3& region_from_mesh,
                                             const CropRegion& region);

/// In how many views each point is seen: in a view, a point is hidden when some other point, of `points` or
/// of `occluders`, falls into the same pixel and is nearer by more than `depth_tolerance`. The points must be
/// dense enough to fill the pixels.
std::vector<int> CountViewsSeen(const std::vector<Eigen::Vector3d>& points,
                                const std::vector<Eigen::Vector3d>& occluders,
                                const std::vector<ObjectView>& views, double depth_tolerance);

/// What an estimated mesh is compared with, in the truth's frame and unit.
struct TruthSurface {
  std::vector<TriangleCorners> triangles;    ///< the whole surface inside the crop region.
  std::vector<Eigen::Vector3d> points;       ///< samples of it.
  std::vector<Eigen::Vector3d> seen_points;  ///< the part of it that the estimate can be asked for.
  double seen_share = 0;                     ///< of the points inside the crop region, before any limit.
};

struct TruthSurfaceOptions {
  int64_t num_samples = 1'000'000;         ///< drawn from the truth before cropping.
  int64_t num_occluder_samples = 300'000;  ///< drawn from what stands in front of it.
  int64_t max_num_seen_points = 200'000;   ///< the first ones are kept.
  int min_num_views = 2;                   ///< that must see a point; ignored without views.
  double depth_tolerance_ratio = 0.004;    ///< of the bounding box's diagonal of the samples.
  uint64_t seed = 0;
};

/// \param occluder  another surface that hides the truth in the views, e.g. the table; may be empty.
/// \param views     of the photos; empty: every point counts as seen.
TruthSurface MakeTruthSurface(const TriangleMesh& truth, const TriangleMesh& occluder,
                              const std::vector<ObjectView>& views, const CropRegion& region,
                              const TruthSurfaceOptions& options);

/// Precision, recall and their harmonic mean at a distance.
struct FScore {
  double threshold = 0;  ///< in the truth's unit, as given.
  double precision = 0;  ///< share of the estimate nearer than the threshold to the truth.
  double recall = 0;     ///< share of the seen truth nearer than the threshold to the estimate.
  double f_score = 0;    ///< 0 when both are 0.
};

/// Distances between two surfaces, in the truth's unit. Unseen truth is not missed, but reconstructing it is
/// not wrong either: accuracy is measured against the whole truth, completeness over the seen part. Means are
/// over samples of one surface.
struct SurfaceErrors {
  double accuracy = 0;      ///< mean distance of the estimate's points to the truth.
  double completeness = 0;  ///< mean distance of the seen truth's points to the estimate.
  double chamfer_l1 = 0;    ///< (accuracy + completeness) / 2.
  std::vector<FScore> f_scores;
};

/// An estimated surface, in the truth's frame, cropped to the same region.
struct EstimatedSurface {
  std::vector<TriangleCorners> triangles;
  std::vector<Eigen::Vector3d> points;  ///< samples of it.
};

/// Distances of one surface's samples to the other's triangles: equal surfaces have none.
/// Nothing when the estimate or the truth has no triangles or no points.
/// \param thresholds  in the truth's unit, positive.
std::optional<SurfaceErrors> CompareSurfaces(const EstimatedSurface& estimate, const TruthSurface& truth,
                                             const std::vector<double>& thresholds);

/// The same with distances to the other's samples: longer by what lies between these, .5 / sqrt(samples per
/// area) where both surfaces are equal. Nothing when the estimate or the truth has no points.
std::optional<SurfaceErrors> CompareSamples(const std::vector<Eigen::Vector3d>& estimate,
                                            const TruthSurface& truth, const std::vector<double>& thresholds);

/// The points inside a region, in order.
std::vector<Eigen::Vector3d> Crop(const std::vector<Eigen::Vector3d>& points, const CropRegion& region);

}  // namespace s2gs
