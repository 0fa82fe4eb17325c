#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/joint_system/joint_priors.h"
#include "sfm_split/scene/scene.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// A keypoint that sees a point of one of the two bodies.
struct JointObservation {
  int image = 0;                                 ///< index into JointProblem::images.
  int point = 0;                                 ///< index into the body's points.
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();  ///< [px], COLMAP's pixel convention.
  /// How much it counts: keypoints of one background point in the photos of one station are one measurement.
  double weight = 1;
  /// Its standard deviation as a multiple of what the loss counts in: errors are taken over it.
  double spread = 1;
  bool active = true;        ///< false: taken out as an outlier, or its point is not determined.
  uint32_t point2D_idx = 0;  ///< where it came from in the image.
};

struct JointBody {
  std::vector<Eigen::Vector3d> points;
  std::vector<uint64_t> point_ids;  ///< the model's, one per point.
  std::vector<JointObservation> observations;
};

struct JointImage {
  std::string name;
  int camera = 0;  ///< index into JointProblem::cameras.
  int pose = 0;    ///< index into JointProblem::cam_from_world.
  double angle_rad = 0;
  Rigid3 world_from_object;  ///< used when JointProblem::free_object; else it follows from axis and angle.
};

/// The unknowns and data of the joint adjustment. The world is near the conventions of an aligned scene: the
/// axis meets the plane z = 0 and is closer to z than to it.
struct JointProblem {
  std::vector<Camera> cameras;
  std::vector<Rigid3> cam_from_world;  ///< one per station, or per image where these are free.
  std::vector<JointImage> images;
  /// (dx, dy, px, py): the axis runs along (dx, dy, 1) through (px, py, 0).
  Eigen::Vector4d axis = Eigen::Vector4d::Zero();
  bool free_object = false;  ///< every image has its own world_from_object: no axis, no angles.
  int reference = 0;         ///< image at which the object's frame is the world's; its angle stays.
  JointBody object;          ///< points in the object's frame.
  JointBody background;      ///< points in the world.
  JointPriors priors;        ///< what is known beside the observations.

  Eigen::Vector3d AxisDirection() const { return Eigen::Vector3d(axis(0), axis(1), 1).normalized(); }
  Eigen::Vector3d AxisPoint() const { return {axis(2), axis(3), 0}; }
  /// The object's place at an image.
  Rigid3 WorldFromObject(int image) const;
  /// At every image.
  std::vector<Rigid3> WorldFromObjects() const;
};

/// Whether two poses are one but for rounding: those of a station's photos, which share it, are.
bool AreOnePose(const Rigid3& a, const Rigid3& b);

/// Gathers unknowns and observations of an aligned scene. Views of one station that have one pose share it.
/// Views of objects that were moved on the table make it a `free_object` problem.
JointProblem MakeJointProblem(const AlignedScene& aligned);

/// Writes an adjusted problem back: poses, points, cameras, views; observations that are no longer active
/// leave their tracks, points left with fewer than two go. Then the scene is brought into the conventions
/// again (axis = z, origin at the foot of the mean object point). Tracks' reprojection errors are updated.
void ApplyJointProblem(const JointProblem& problem, AlignedScene* aligned);

}  // namespace s2gs
