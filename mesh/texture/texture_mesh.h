#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/light/turn_light.h"
#include "mesh/surface/object_view.h"
#include "mesh/surface/textured_mesh.h"
#include "mesh/surface/triangle_mesh.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

struct TextureOptions {
  double texel_size = 0;           ///< edge of a texel, in the mesh's unit; 0: from the photos.
  double texel_size_pixels = 0.7;  ///< where it is chosen: in pixels of the photo that shows a place best.
  int max_page_size = 8192;        ///< longest side of a page [px].
  int gutter = 4;                  ///< texels around each chart that continue its colours [px].
  bool equalise = true;            ///< take out what exposure and white balance changed from photo to photo.
  double max_memory_gib = 4;  ///< texels are worked off in portions, and made larger where pages do not fit.
  bool unshade = true;        ///< compare photos without light that stands still while the table turns.
  int num_threads = 0;        ///< 0: one for each core.

  OptionCheck Check() const;
};

/// Photos without distortion, that need not be in memory.
class TexturePhotoSource {
 public:
  TexturePhotoSource() = default;
  TexturePhotoSource(const TexturePhotoSource&) = delete;
  TexturePhotoSource& operator=(const TexturePhotoSource&) = delete;
  virtual ~TexturePhotoSource() = default;

  virtual int size() const = 0;
  virtual const ObjectView& Camera(int index) const = 0;
  /// RGB, of the camera's size. Called from several threads at once, as is the next. May throw.
  virtual Image8 Load(int index) const = 0;
  /// How the table stands in the photo: light that stands still falls on the object from elsewhere.
  virtual Eigen::Matrix3d WorldFromObject(int /*index*/) const { return Eigen::Matrix3d::Identity(); }
  /// One channel of any size, from 128 on where the object is; without pixels where there is none.
  virtual Image8 LoadMask(int index) const = 0;
};

struct TextureSummary {
  double texel_size = 0;  ///< in the mesh's unit.
  double texel_pixels =
      0;  ///< the same in pixels of the photo that shows a place best, over the surface's median.
  int64_t num_charts = 0;
  int64_t num_texels = 0;  ///< of the surface, without gutters.
  int64_t num_seen = 0;    ///< of these, shown by at least one photo.
  double page_use = 0;     ///< share of the pages that is surface.
  double mean_photos = 0;  ///< that a seen texel is blended from.
  double gain_spread = 0;  ///< standard deviation of the photos' gains, as a share.
  /// What photos that the light was not fitted to are off what the others show of the same places: under even
  /// light and under that light [grey values, median of the smoothed photos]. 0 where nothing turns.
  double error_even = 0;
  double error_lit = 0;
  double seconds = 0;
};

/// The light under which a textured mesh is seen in photos.
struct TextureLight {
  TurnLight light;
  LightTransfer transfer;                ///< of the mesh that was textured; empty when the light is even.
  std::vector<uint32_t> mesh_triangles;  ///< of that mesh: what each triangle of the textured mesh was.
  /// Of the textured mesh's vertices: how many times as strong the light in the pages is as the light's mean
  /// over all photos.
  std::vector<Eigen::Array3f> page_lights;

  /// How many times as strong the light of a photo is as that in the pages, at a place of a triangle of the
  /// textured mesh (barycentric, of its first two corners).
  Eigen::Array3f Shade(const PhotoLight& here, const TexturedMesh& mesh, uint32_t t, float u, float v) const;
};

/// Gives a mesh the colours of photos: charts (charts.h) on pages, and for each texel the best of all photos
/// that see its place (texture_photo.h, blend_samples.h). A texel's colour depends on its place on the
/// surface alone, not on its chart, so that charts meet without seams. Where the table turns, light that
/// stands still is taken out of the photos first (turn_light.h), so that they agree; the colours are those
/// under the mean of the light in which photos show a place. Texels that no photo sees continue the colours
/// of the surface around them. The result is bit-identical for any number of threads. Throws UserError for a
/// mesh without triangles or when no photo shows it, what the source throws, and Interrupted.
TexturedMesh TextureMesh(const TriangleMesh& mesh, const TexturePhotoSource& photos,
                         const TextureOptions& options, Reporter& reporter, TextureSummary* summary,
                         TextureLight* light = nullptr);

}  // namespace s2gs
