#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <vector>

#include "mesh/light/mesh_raster.h"
#include "mesh/surface/object_view.h"
#include "mesh/surface/triangle_mesh.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

/// What a photo says about a point of the surface.
struct PhotoSample {
  float weight = 0;  ///< how well it shows the point: above 0, of no meaning but beside other photos'.
  std::array<uint8_t, 3> color = {};   ///< RGB, bicubic.
  std::array<uint8_t, 3> smooth = {};  ///< the same in the smoothed photo.
};

inline Eigen::Array3f ColorOf(const std::array<uint8_t, 3>& rgb) {
  return {static_cast<float>(rgb[0]), static_cast<float>(rgb[1]), static_cast<float>(rgb[2])};
}

/// A photo as texture is taken from it, prepared so that a point costs one projection.
class TexturePhoto {
 public:
  /// \param view   of the photo's size, which is at least 2 x 2.
  /// \param photo  RGB.
  /// \param mask   one channel, of any size and from 128 on where the object is; or without pixels.
  /// \param mesh   what hides what.
  TexturePhoto(const ObjectView& view, const Image8& photo, const Image8& mask, const TriangleMesh& mesh);

  /// Whether the photo shows the point: within the photo and the mask, on a surface that faces the camera
  /// and that nothing hides. The weight is the area that a unit of the surface has in the photo, and falls
  /// to nearly nothing towards outlines and places where something stands in front, which poses and shape
  /// move by a pixel: so no photo begins or ends abruptly on the surface.
  /// \param normal  of the smooth surface, of unit length.
  bool Sample(const Eigen::Vector3f& x_in_object, const Eigen::Vector3f& normal, PhotoSample* sample) const;

  /// Bytes that a photo of `num_pixels` takes.
  static double BytesPerPixel() { return 8.25; }

 private:
  void FindBorders(const ObjectView& view, const Image8& mask);
  void Smooth();
  bool IsSameSurface(float inverse_depth1, float inverse_depth2) const;
  /// The smoothed photo on the surface at that inverse depth alone; false when there is none of it.
  bool SampleSmooth(const Eigen::Vector2f& p, float inverse_depth, std::array<uint8_t, 3>* rgb) const;

  Eigen::Matrix3f rotation_;  // cam_from_object
  Eigen::Vector3f translation_;
  Eigen::Vector3f center_;  // in the object's frame
  Eigen::Vector2f focal_;
  Eigen::Vector2f principal_;
  int first_x_ = 0;  // of the part of the photo that shows the mesh
  int first_y_ = 0;
  Image8 color_;
  Image8 smooth_;                             // at 1 / kShrink of the size
  std::vector<float> smooth_inverse_depths_;  // of its pixels; 0: no mesh there
  std::vector<float> inverse_depths_;
  std::vector<uint8_t> border_distances_;  // thirds of a pixel to the nearest border, capped
};

}  // namespace s2gs
