#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/scene.h"
#include "sfm_split/split/stations.h"

namespace s2gs {

/// An image whose pose is known, for triangulation.
struct PosedImage {
  bool is_posed = false;           ///< false: its matches are not used.
  const Camera* camera = nullptr;  ///< when posed.
  Rigid3 cam_from_body;
};

struct TrackElement {
  int image = 0;
  uint32_t keypoint = 0;
};

/// A point of one rigid body and the keypoints that see it, at most one an image.
struct TrackPoint {
  Eigen::Vector3d x_in_body = Eigen::Vector3d::Zero();
  std::vector<TrackElement> track;
  double mean_error_px = 0;
};

struct TrackOptions {
  double max_error_px =
      4;  ///< reprojection error of a track's keypoints; also of their matches' epipolar lines.
  double min_triangulation_deg = 1;  ///< largest angle between two rays of a point, at least.
  int max_hypotheses = 24;           ///< pairs of rays that are tried for one point.
  uint32_t random_seed = 0;

  OptionCheck Check() const;
};

/// Joins matches that agree with the poses to tracks, and triangulates each robustly: points from pairs of
/// rays compete by how many keypoints they explain, the best is refined by Gauss-Newton. A joined track that
/// holds several points (wrong matches tie them together) gives several. The result does not depend on the
/// order of pairs. Images, keypoints [px] and pairs count alike.
std::vector<TrackPoint> TriangulateTracks(const std::vector<PosedImage>& images,
                                          const std::vector<Keypoints>& keypoints,
                                          const std::vector<ImagePairMatches>& pairs,
                                          const TrackOptions& options);

/// Reprojection error of a point [px]; infinite behind the camera.
double ReprojectionErrorPx(const PosedImage& image, const Eigen::Vector3d& x_in_body,
                           const Eigen::Vector2d& xy);

/// Projection of a point and its derivative by it. False behind the camera.
bool ProjectPoint(const PosedImage& image, const Eigen::Vector3d& x_in_body, Eigen::Vector2d* xy,
                  Eigen::Matrix<double, 2, 3>* by_x);

/// What the matches of two posed images are measured against.
class PairOfPoses {
 public:
  PairOfPoses(const PosedImage& image1, const PosedImage& image2);
  /// As MatchErrorPx, of rays in the cameras (z = 1).
  double ErrorPx(const Eigen::Vector3d& ray1, const Eigen::Vector3d& ray2) const;

 private:
  Rigid3 second_from_first_;
  double focal_px_;
};

/// Sampson's error of a match against the epipolar geometry of two poses [px], unsigned; beyond any bound
/// without a baseline, infinite where a pixel has no ray.
double MatchErrorPx(const PosedImage& image1, const PosedImage& image2, const Eigen::Vector2d& xy1,
                    const Eigen::Vector2d& xy2);

/// Moves a point to where the squared reprojection errors of its track are least. False when it runs away.
bool RefinePoint(const std::vector<PosedImage>& images, const std::vector<Keypoints>& keypoints,
                 const std::vector<TrackElement>& track, Eigen::Vector3d* x_in_body);

}  // namespace s2gs
