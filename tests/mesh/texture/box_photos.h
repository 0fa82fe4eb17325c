#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <vector>

#include "mesh/surface/triangle_mesh.h"
#include "mesh/texture/texture_mesh.h"

namespace s2gs {

/// A box along the axes whose surface has a colour at every place, RGB from 0 to 255.
struct PaintedBox {
  Eigen::Vector3d low;
  Eigen::Vector3d high;
  std::function<Eigen::Array3d(const Eigen::Vector3d&)> color;
};

/// Twelve triangles for each box, corners shared, normals outwards.
TriangleMesh MeshOf(const std::vector<PaintedBox>& boxes);

/// A camera at `center` that looks at the origin; side x side pixels.
ObjectView LookAtOrigin(const Eigen::Vector3d& center, int side, double focal);

/// Photos of boxes, traced exactly: each pixel is the mean of 4 x 4 rays.
class BoxPhotos : public TexturePhotoSource {
 public:
  BoxPhotos(std::vector<PaintedBox> boxes, std::vector<ObjectView> views);
  int size() const override { return static_cast<int>(views_.size()); }
  const ObjectView& Camera(int index) const override { return views_[index]; }
  Image8 Load(int index) const override { return photos_[index]; }
  Image8 LoadMask(int /*index*/) const override { return {}; }
  Image8& photo(int index) { return photos_[index]; }

 private:
  std::vector<ObjectView> views_;
  std::vector<Image8> photos_;
};

}  // namespace s2gs
