#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "mesh/surface/triangle_mesh.h"
#include "s2gs/image/image_file.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {

/// Labels as in the data sets' gt/masks.
constexpr uint8_t kObjectLabel = 255;
constexpr uint8_t kDiscLabel = 128;
constexpr uint8_t kStaticLabel = 0;

struct SyntheticRenderOptions {
  /// The object is the turntable's own bumpy one or plate; otherwise a sphere and a box side by side.
  bool use_turntable_object = false;
  /// Shortest wavelength of the object's and the platter's texture where the cameras look, in pixels of the
  /// turntable's camera; the background's is 2.5 times as long. Below about 3 the images alias.
  double finest_wavelength_px = 6;
  double object_contrast = 1;  ///< 0 (even grey) to 1.
  double platter_contrast = 1;
  double static_contrast = 1;
  /// Lit by one distant light that stands still in the world, without shadows; otherwise the texture's
  /// colour.
  bool lambert = false;
  int supersampling = 1;  ///< rays per pixel and axis, from 1 to 16.

  OptionCheck Check() const;
};

/// A solid texture: a sum of 3D sine waves, squashed into (0, 1).
struct SyntheticTexture {
  struct Wave {
    Eigen::Vector3d frequency;  ///< [radians per metre]
    double phase = 0;
    Eigen::Array3d amplitude;  ///< of red, green and blue.
  };
  std::vector<Wave> waves;
  double contrast = 1;

  /// RGB from 0 to 1.
  Eigen::Array3d At(const Eigen::Vector3d& x) const;
};

struct SyntheticRenderScene {
  SyntheticRenderOptions options;
  std::vector<Shape> object;   ///< in the object's frame.
  std::vector<Shape> platter;  ///< in the platter's frame.
  std::vector<Shape> room;     ///< in the world; the first is seen from inside.
  SyntheticTexture object_texture;
  SyntheticTexture platter_texture;
  SyntheticTexture static_texture;
  Eigen::Vector3d to_light;  ///< in the world, of unit length.
};

/// Surfaces and textures for the turntable's options, object, platter and room.
SyntheticRenderScene MakeSyntheticRenderScene(const SyntheticTurntable& turntable,
                                              const SyntheticRenderOptions& options);

/// What a ray meets first.
struct SyntheticSurfacePoint {
  double t = 0;  ///< of the ray.
  uint8_t label = kStaticLabel;
  Eigen::Vector3d normal;  ///< in the world, of unit length, towards the ray's origin.
  Eigen::Array3d color;    ///< RGB from 0 to 1.
};
std::optional<SyntheticSurfacePoint> Trace(const SyntheticRenderScene& scene, const Ray& ray_in_world,
                                           const Rigid3& world_from_object, const Rigid3& world_from_platter);

/// Row by row from the top; depth, normal and label are those at the pixels' centres.
struct SyntheticRendering {
  Image8 rgb;
  Image8 label;
  std::vector<Eigen::Array3f> color;     ///< before rounding, from 0 to 1.
  std::vector<double> depth;             ///< z in the camera's frame; 0 where the pixel has no ray.
  std::vector<Eigen::Vector3d> normals;  ///< in the camera's frame; zero where the pixel has no ray.
};

/// Through any camera that can be unprojected. The result does not depend on the number of threads.
SyntheticRendering Render(const SyntheticRenderScene& scene, const Camera& camera,
                          const Rigid3& cam_from_world, const Rigid3& world_from_object,
                          const Rigid3& world_from_platter);

/// The turntable's image i.
SyntheticRendering RenderImage(const SyntheticRenderScene& scene, const SyntheticTurntable& turntable,
                               int image);

/// Triangles with their corners exactly on the shapes' surfaces: a box with 12, round things with `segments`
/// around and half as many from pole to pole. Shapes that meet are not merged.
TriangleMesh Tessellate(const std::vector<Shape>& shapes, int segments);

}  // namespace s2gs
