#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/scene.h"
#include "tests/support/synthetic_shapes.h"

namespace s2gs {

enum class SyntheticObject {
  kBumpy,  ///< closed bumpy surface that hides its own back.
  kPlate,  ///< upright two-sided plate of no thickness: all object points in one plane.
};

/// A turntable capture made of points: an object and a platter that turn, in a room that does not. Lengths
/// are in metres; the room is a box around the cameras, with boxes as clutter behind and beside the table.
// NOLINTNEXTLINE(clang-analyzer-optin.performance.Padding): fields stand by topic.
struct SyntheticTurntableOptions {
  uint64_t seed = 1;

  // Cameras. Station s stands at an elevation spread evenly from min to max, all on one side of the table.
  int stations = 3;               ///< at least 1.
  double min_elevation_deg = 10;  ///< above the room's horizon, in [0, 89].
  double max_elevation_deg = 50;
  double azimuth_spread_deg = 10;  ///< stations' azimuths are uniform over +- half of this.
  double distance = 0.7;           ///< mean distance from the point looked at.
  double distance_spread = 0.1;    ///< distances are uniform over +- half of this share.
  double look_at_height = 0;       ///< of the point looked at over the object's middle, along the axis.
  double look_at_jitter = 0.01;    ///< each station looks at a point up to this far from the object's middle.
  double roll_deg = 3;             ///< greatest roll of a station's camera about its view.
  double shake_deg = 0;            ///< standard deviation of each image's rotation about its station's pose.
  double shake_distance = 0;       ///< the same for its position.
  /// Every image from a pose of its own (each a station): `steps` images, elevations and azimuths at random.
  bool hand_held = false;

  // The table.
  int steps = 24;                ///< images of one station.
  double step_deg = 15;          ///< in [0.01, 120].
  double step_jitter = 0;        ///< steps are irregular by +- half of this share, in [0, 1].
  double station_start_deg = 0;  ///< each station starts this far on from where the one before started.
  bool turning = true;           ///< false: the table stands still, nothing rotates.
  double table_tilt_deg = 0;     ///< between the axis and the room's vertical.
  Eigen::Vector2d object_offset = {0.02, -0.01};  ///< of the object's middle from the axis.
  /// From this station on the object lies upside down: turned by 180 degrees about a horizontal line through
  /// its middle and moved by `flip_offset` along the platter. The platter stays as it was. 0: never.
  int flip_from_station = 0;
  Eigen::Vector2d flip_offset = {-0.03, 0.02};

  // Points.
  SyntheticObject object = SyntheticObject::kBumpy;
  double object_radius = 0.08;    ///< the bumpy object's mean radius, half the plate's edge.
  double object_patch_deg = 180;  ///< texture only within this angle of the object's -y, in [5, 180].
  int num_object_points = 600;    ///< uniform over the surface.
  int num_platter_points = 150;   ///< uniform over the disc.
  double platter_radius = 0.14;
  int num_background_points = 1500;   ///< uniform over the images.
  double background_image_share = 1;  ///< background points lie in this left share of the images, in (0, 1].
  /// Keypoints are thinned out until this share of each image's static and rotating ones rotates, in (0, 1];
  /// 0 leaves it as it falls.
  double rotating_share = 0;
  /// This share of the object's and the background's points has a twin that looks the same: the object's is
  /// turned by 360 / symmetry_fold degrees about the object's own upright line, the background's moved by
  /// `repeat_distance` along its wall.
  double repeated_share = 0;
  int symmetry_fold = 2;  ///< also the bumpy surface's.
  double repeat_distance = 0.1;

  // Camera.
  CameraModelId camera_model = CameraModelId::kSimplePinhole;
  int width = 640;
  int height = 480;
  double focal_widths = 1.2;                        ///< focal length in image widths.
  Eigen::Vector2d principal_point_offset = {0, 0};  ///< from the image's middle, in image widths.
  std::vector<double> distortion;  ///< the model's parameters after the principal point; empty: zeros.
  bool has_prior_focal = true;     ///< what the database says of the focal length.
  bool camera_per_station =
      false;  ///< station s has its own camera, its focal length 1 + s percent of the first.

  // Observations.
  double pixel_noise = 0;       ///< standard deviation in x and in y [px].
  double dropout = 0;           ///< share of the visible points that are not found, in [0, 1).
  int num_extra_keypoints = 0;  ///< of each image, that see no point.
  int num_watermarks = 0;       ///< keypoints at the same pixels of every image, matched in every pair.

  // Matches.
  std::vector<std::pair<int, int>> pairs;  ///< image indices; empty: all pairs.
  double max_view_change_deg = 180;  ///< points match while the direction they are seen from differs by less.
  double match_recall = 1;           ///< share of the points that could match and do, in (0, 1].
  double outlier_share = 0;          ///< of each pair's matches (watermarks apart), in [0, 1].
  double structured_share = 0;       ///< of the outliers: a point with its twin, as far as there are any.
  bool descriptors = false;
  double descriptor_noise = 6;  ///< standard deviation of each of the 128 entries of norm 512.

  OptionCheck Check() const;
};

enum class SyntheticBody { kNone, kStatic, kObject, kPlatter, kWatermark };

inline bool IsRotating(SyntheticBody body) {
  return body == SyntheticBody::kObject || body == SyntheticBody::kPlatter;
}

struct SyntheticPoint {
  SyntheticBody body = SyntheticBody::kStatic;
  Eigen::Vector3d x = Eigen::Vector3d::Zero();        ///< in the world, the object's or the platter's frame.
  Eigen::Vector3d normal = Eigen::Vector3d::UnitZ();  ///< in the same frame.
  bool two_sided = false;                             ///< a point of a plate, seen from both sides.
  Eigen::Matrix<uint8_t, 3, 1> color = Eigen::Matrix<uint8_t, 3, 1>::Zero();
  int twin = -1;  ///< index of the point that looks the same, or -1.
};

struct SyntheticKeypoint {
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();        ///< [px], with noise.
  Eigen::Vector2d exact_xy = Eigen::Vector2d::Zero();  ///< [px]
  SyntheticBody body = SyntheticBody::kNone;
  int point = -1;  ///< index into SyntheticTurntable::points; a watermark's number; or -1.
};

using SiftDescriptor = std::array<uint8_t, 128>;

/// What image i, whose pose is scene.views[i], shows.
struct SyntheticImage {
  int step = 0;               ///< within its station.
  bool flipped = false;       ///< the object lies upside down.
  Rigid3 world_from_platter;  ///< differs from the view's world_from_object once the object was flipped.
  std::vector<SyntheticKeypoint> keypoints;  ///< in random order.
  std::vector<SiftDescriptor> descriptors;   ///< one per keypoint, or none.
};

struct SyntheticMatch {
  uint32_t keypoint1 = 0;
  uint32_t keypoint2 = 0;
  SyntheticBody body = SyntheticBody::kNone;  ///< kNone: an outlier.
  bool structured = false;                    ///< an outlier between twins.
};

struct SyntheticPair {
  int image1 = 0;
  int image2 = 0;
  std::vector<SyntheticMatch> matches;  ///< one-to-one, in random order.
};

struct SyntheticTurntable {
  SyntheticTurntableOptions options;
  /// Aligned: the axis is the world's z axis, the object points' mean has z = 0, the object's frame is the
  /// world's at the first image, and all lengths share one unit.
  TurntableScene scene;
  std::vector<SyntheticImage> images;  ///< as scene.views.
  std::vector<SyntheticPoint> points;
  std::vector<SyntheticPair> pairs;
  Shape object;             ///< in the object's frame.
  Shape platter;            ///< in the platter's frame, which is the object's until the flip.
  std::vector<Shape> room;  ///< in the world: the room's walls (seen from inside), then the clutter.

  const Camera& CameraOf(int image) const;
  /// Camera from the frame that a body's points are given in.
  Rigid3 CamFromBody(int image, SyntheticBody body) const;
};

/// The scene that the options describe, the same for the same options on every machine. Invalid options break
/// an invariant.
SyntheticTurntable MakeSyntheticTurntable(const SyntheticTurntableOptions& options);

}  // namespace s2gs
