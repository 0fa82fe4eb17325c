#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>

#include "mesh/surface/object_view.h"
#include "mesh/surface/textured_mesh.h"
#include "s2gs/image/image_error.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

struct TexturedRendering {
  Image8 image;       ///< RGB of the view's size; black where there is no mesh.
  PixelMask covered;  ///< where the mesh is.
};

/// How many times as strong the light is at a place of a triangle (barycentric, of its first two corners) as
/// it is in the texture.
using ShadeAt = std::function<Eigen::Array3f(uint32_t triangle, float u, float v)>;

/// The mesh as a view shows it, in the light of its texture or under `shade`: each pixel is the mean of
/// samples x samples points in it, each bilinear in its page.
TexturedRendering RenderTexturedMesh(const TexturedMesh& mesh, const ObjectView& view, int samples = 2,
                                     const ShadeAt& shade = {});

}  // namespace s2gs
