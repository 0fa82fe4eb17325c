#pragma once

#include "mesh/surface/object_view.h"
#include "mesh/surface/textured_mesh.h"
#include "s2gs/image/image_error.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

struct TexturedRendering {
  Image8 image;       ///< RGB of the view's size; black where there is no mesh.
  PixelMask covered;  ///< where the mesh is.
};

/// The mesh as a view shows it, without light: each pixel is the mean of samples x samples points in it, each
/// bilinear in its page.
TexturedRendering RenderTexturedMesh(const TexturedMesh& mesh, const ObjectView& view, int samples = 2);

}  // namespace s2gs
