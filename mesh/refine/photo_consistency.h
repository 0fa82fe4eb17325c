#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "mesh/surface/object_view.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

struct SurfacePatch;

/// How alike photos are where a small piece of surface projects to them, as the piece moves along its normal:
/// greatest where the surface really is, when it has texture.

/// A grey photo in coarser and coarser copies, each half as large as the one before.
class PhotoPyramid {
 public:
  static constexpr int kNumLevels = 2;

  /// \param view  of the photo's size, which is at least 2 x 2.
  PhotoPyramid(const ObjectView& view, Image8 grey);

  const Eigen::Vector3f& center() const { return center_; }
  /// Edge of a pixel of level 0 at the point's depth, in the object's unit.
  float PixelSize(const Eigen::Vector3f& x_in_object) const;

  /// The grey value at a place of the object, from 0 to 255. Beyond the photo, that of its border.
  float GreyAt(const Eigen::Vector3f& x_in_object) const;

  /// Grey values at the patch's points when its middle is elsewhere. Beyond the photo, the values of its
  /// border.
  void SamplePatch(const SurfacePatch& patch, const Eigen::Vector3f& middle, int level, float* values) const;

 private:
  struct Level {
    Image8 grey;
    Eigen::Vector2f focal;      // [px of the level], as the next.
    Eigen::Vector2f principal;  // counted from the centre of the first pixel.
  };
  Eigen::Matrix3f rotation_;  // cam_from_object
  Eigen::Vector3f translation_;
  Eigen::Vector3f center_;  // in the object's frame
  float focal_;
  std::vector<Level> levels_;
};

constexpr int kPatchSide = 5;
constexpr int kPatchSize = kPatchSide * kPatchSide;
/// With fewer points photos agree by chance too often; so many never lie on one line.
constexpr int kLeastPatchPoints = 2 * kPatchSide;

/// A piece of surface and the photos that show it.
struct SurfacePatch {
  static constexpr int kMaxViews = 16;
  Eigen::Vector3f middle = Eigen::Vector3f::Zero();
  Eigen::Vector3f normal = Eigen::Vector3f::UnitZ();  ///< of unit length.
  int num_views = 0;
  std::array<const PhotoPyramid*, kMaxViews> views = {};
  std::array<float, kMaxViews> cosines = {};  ///< between the normal and the direction to each camera.
  float PixelSize() const;                    ///< of the photo that shows it best.

  Eigen::Vector3f u = Eigen::Vector3f::UnitX();  ///< of unit length, as v, at right angles to the normal.
  Eigen::Vector3f v = Eigen::Vector3f::UnitY();
  float spacing = 1;  ///< of the points, in the object's unit.
  int num_points = 0;
  std::array<Eigen::Vector3f, kPatchSize> points;  ///< along u, v and the normal [spacings].
  /// Chooses u, v and the spacing, a pixel of the level, and puts all points on the plane.
  void LayFlat(int level);
};

/// Gives the patch `max_views` photos or fewer: those that face it, and that look from different sides.
/// \param candidates  photos that see the patch.
void SelectPhotos(const std::vector<const PhotoPyramid*>& candidates, int max_views, SurfacePatch* patch);

/// Mean correlation of the patch's photos with each other, weighted by their cosines, when the patch is moved
/// by offset = -max_steps to max_steps times `step` along its normal. From -1 to 1; patches without texture
/// give 0, because grey values have noise. \param patch  with kLeastPatchPoints points at least.
/// \param step  in the object's unit.
void ConsistencyCurve(const SurfacePatch& patch, int level, float step, int max_steps, float* curve);

/// What the patch's photos show where it is.
struct PatchAgreement {
  float correlation = 0;  ///< as in a curve of no steps.
  float texture = 0;  ///< share of the brightness's variance that is not noise: 0 on plain surfaces, to 1.
};
PatchAgreement MeasureAgreement(const SurfacePatch& patch);

/// Whether less than a fifth of the pairs of photos are more alike than half of what two photos of one
/// surface are under their noise: nearer to that than to chance. \param least_texture  as in PatchAgreement:
/// photos with less say nothing, and nothing is said where half of them do not.
bool PhotosDisagree(const SurfacePatch& patch, float least_texture);

}  // namespace s2gs
