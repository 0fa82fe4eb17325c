#pragma once

#include <map>
#include <string>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/scene.h"
#include "sfm_split/turntable/turntable.h"

namespace s2gs {

enum class CameraPoseSource {
  kSharedStations,  ///< one cam_from_world per station: the median over its images.
  kPerImage,        ///< each image keeps its own cam_from_world (hand-held camera).
};

struct AlignOptions {
  CameraPoseSource pose_source = CameraPoseSource::kSharedStations;
  TurntableOptions turntable;
};

struct AlignedScene {
  TurntableScene scene;
  ColmapModel object;      ///< poses are cam_from_object, points in the object's frame.
  ColmapModel background;  ///< poses are cam_from_world, points in the world; empty when none was given.
  TurntableSolution solution;
  std::vector<TurntablePose> poses;   ///< what the solution was computed from, in its order.
  std::vector<std::string> left_out;  ///< images of the models that are in neither scene nor models any more.
  /// Every camera of the background's reconstruction, by image, as it was before alignment.
  std::map<std::string, Rigid3> cam_from_background;
  Sim3 aligned_from_object;  ///< what was applied to the object's reconstruction (scale 1).
  Sim3 aligned_from_background;
};

/// Brings both reconstructions into one frame and unit: world z along the axis (up as SolveTurntable says),
/// origin at the axis' foot of the mean object point (mean along the axis after trimming 5 % at both ends),
/// x towards the reference camera, object frame = world frame at the reference image, lengths in the unit of
/// the object's reconstruction. Afterwards cam_from_object == cam_from_world * world_from_object for every
/// image of the scene, to rounding. Points, poses and tracks are transformed; images whose poses contradict
/// the turntable, or which only one model has, are taken out of both models and their tracks. Images of a
/// station that the background model lacks take the station's pose.
/// Without a background model (nullptr, or no image in it) each station's cameras are placed by the object
/// alone: the angle between stations is then 0 at the first image of each, by definition.
/// \param station_of_image  by name; images that it lacks are stations of their own.
/// The scene is empty when nothing rotates: `solution.motion` says why.
AlignedScene AlignScene(const ColmapModel& object, const ColmapModel* background,
                        const std::map<std::string, int>& station_of_image, const AlignOptions& options = {});

/// Moves an aligned scene (both models, views, axis) rigidly so that its axis is z, its origin the axis' foot
/// of the mean object point, and x points towards the reference camera again; the object's frame moves along.
void BringIntoConventions(AlignedScene* aligned);

/// cam_from_new for a camera given by cam_from_old; the camera's frame takes the new unit of length.
Rigid3 TransformPose(const Sim3& new_from_old, const Rigid3& cam_from_old);

/// Applies a similarity to a model in place: poses, points; tracks and errors stay.
void TransformModel(const Sim3& new_from_old, ColmapModel* model);

/// Takes images out of a model, with their track elements; points left with fewer than two elements go too.
void RemoveImages(const std::vector<std::string>& names, ColmapModel* model);

}  // namespace s2gs
