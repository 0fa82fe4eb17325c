#include "tests/support/synthetic_render.h"

#include <Eigen/Geometry>
#include <cmath>
#include <string>

#include "sfm_split/base/angles.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

SyntheticTexture MakeTexture(uint64_t seed, uint64_t stream, double finest_wavelength, double contrast) {
  RandomNumbers random(seed, stream);
  SyntheticTexture texture;
  texture.contrast = contrast;
  constexpr int kNumWaves = 24;
  for (int i = 0; i < kNumWaves; ++i) {
    // Wavelengths over two octaves and a half, a few per octave.
    const double wavelength = finest_wavelength * std::pow(6.0, random.Uniform());
    SyntheticTexture::Wave wave;
    wave.frequency = 2 * kPi / wavelength * random.Direction();
    wave.phase = random.Uniform(0, 2 * kPi);
    for (int channel = 0; channel < 3; ++channel) {
      wave.amplitude[channel] = random.Uniform(0.3, 0.6) * std::sqrt(2.0 / kNumWaves);
    }
    texture.waves.push_back(wave);
  }
  return texture;
}

struct BodyHit {
  RayHit hit;
  const SyntheticTexture* texture = nullptr;
  const Rigid3* world_from_body = nullptr;
  uint8_t label = kStaticLabel;
};

void IntersectBody(const std::vector<Shape>& shapes, const SyntheticTexture& texture, uint8_t label,
                   const Rigid3& world_from_body, const Ray& ray_in_world, std::optional<BodyHit>* nearest) {
  const Rigid3 body_from_world = world_from_body.Inverse();
  const Ray ray{body_from_world * ray_in_world.origin, body_from_world.rotation * ray_in_world.direction};
  for (const Shape& shape : shapes) {
    const std::optional<RayHit> hit = Intersect(shape, ray);
    if (hit && (!*nearest || hit->t < (*nearest)->hit.t)) {
      *nearest = BodyHit{*hit, &texture, &world_from_body, label};
    }
  }
}

Eigen::Vector3d OnUnitSphere(int i, int rings, int k, int segments) {
  const double theta = kPi * i / rings;
  const double phi = 2 * kPi * k / segments;
  return {std::sin(theta) * std::cos(phi), std::sin(theta) * std::sin(phi), std::cos(theta)};
}

/// A surface of revolution from pole to pole: `ring(i, k)` for rings 1 to rings - 1 and k below `segments`.
template <typename Ring>
void AddRings(const Eigen::Vector3d& top, const Eigen::Vector3d& bottom, int rings, int segments, Ring ring,
              TriangleMesh* mesh) {
  const auto base = static_cast<uint32_t>(mesh->vertices.size());
  const auto n = static_cast<uint32_t>(segments);
  mesh->vertices.emplace_back(top.cast<float>());
  mesh->vertices.emplace_back(bottom.cast<float>());
  for (int i = 1; i < rings; ++i) {
    for (int k = 0; k < segments; ++k) mesh->vertices.push_back(ring(i, k).template cast<float>());
  }
  const auto index = [base, n](uint32_t i, uint32_t k) { return base + 2 + (i - 1) * n + k % n; };
  const auto last = static_cast<uint32_t>(rings - 1);
  for (uint32_t k = 0; k < n; ++k) {
    mesh->triangles.emplace_back(base, index(1, k), index(1, k + 1));
    for (uint32_t i = 1; i < last; ++i) {
      mesh->triangles.emplace_back(index(i, k), index(i + 1, k), index(i + 1, k + 1));
      mesh->triangles.emplace_back(index(i, k), index(i + 1, k + 1), index(i, k + 1));
    }
    mesh->triangles.emplace_back(base + 1, index(last, k + 1), index(last, k));
  }
}

void AddBox(const Shape& box, TriangleMesh* mesh) {
  const auto base = static_cast<uint32_t>(mesh->vertices.size());
  for (int corner = 0; corner < 8; ++corner) {
    const Eigen::Vector3d sign((corner & 1) != 0 ? 1 : -1, (corner & 2) != 0 ? 1 : -1,
                               (corner & 4) != 0 ? 1 : -1);
    const Eigen::Vector3d x = box.frame_from_shape * Eigen::Vector3d(box.size.cwiseProduct(sign));
    mesh->vertices.emplace_back(x.cast<float>());
  }
  constexpr uint32_t kFaces[6][4] = {{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4},
                                     {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}};
  for (const auto& f : kFaces) {
    mesh->triangles.emplace_back(base + f[0], base + f[1], base + f[2]);
    mesh->triangles.emplace_back(base + f[0], base + f[2], base + f[3]);
  }
}

}  // namespace

OptionCheck SyntheticRenderOptions::Check() const {
  const auto outside = [](double contrast) { return !(contrast >= 0 && contrast <= 1); };
  if (!(finest_wavelength_px > 0)) {
    return OptionFault{"finest_wavelength_px", std::to_string(finest_wavelength_px),
                       "finest_wavelength_px > 0"};
  }
  if (outside(object_contrast)) {
    return OptionFault{"object_contrast", std::to_string(object_contrast), "0 <= object_contrast <= 1"};
  }
  if (outside(platter_contrast)) {
    return OptionFault{"platter_contrast", std::to_string(platter_contrast), "0 <= platter_contrast <= 1"};
  }
  if (outside(static_contrast)) {
    return OptionFault{"static_contrast", std::to_string(static_contrast), "0 <= static_contrast <= 1"};
  }
  if (supersampling < 1 || supersampling > 16) {
    return OptionFault{"supersampling", std::to_string(supersampling), "1 <= supersampling <= 16"};
  }
  return std::nullopt;
}

Eigen::Array3d SyntheticTexture::At(const Eigen::Vector3d& x) const {
  Eigen::Array3d sum = Eigen::Array3d::Zero();
  for (const Wave& wave : waves) sum += wave.amplitude * std::sin(wave.frequency.dot(x) + wave.phase);
  return 0.5 + 0.5 * contrast * sum.tanh();
}

SyntheticRenderScene MakeSyntheticRenderScene(const SyntheticTurntable& turntable,
                                              const SyntheticRenderOptions& options) {
  S2GS_INVARIANT(!options.Check());
  SyntheticRenderScene scene;
  scene.options = options;
  scene.platter = {turntable.platter};
  scene.room = turntable.room;
  if (options.use_turntable_object) {
    scene.object = {turntable.object};
  } else {
    const double radius = turntable.options.object_radius;
    const double foot = turntable.platter.frame_from_shape.translation.z() + turntable.platter.size.z();
    const Eigen::Vector3d middle = turntable.object.frame_from_shape.translation;
    Shape sphere;
    sphere.kind = ShapeKind::kSphere;
    sphere.size.setConstant(0.6 * radius);
    sphere.frame_from_shape.translation = {middle.x() - 0.45 * radius, middle.y(), foot + 0.6 * radius};
    Shape box;
    box.size = radius * Eigen::Vector3d(0.35, 0.25, 0.5);
    box.frame_from_shape.rotation = Eigen::AngleAxisd(0.35, Eigen::Vector3d::UnitZ());
    box.frame_from_shape.translation = {middle.x() + 0.6 * radius, middle.y() + 0.1 * radius,
                                        foot + 0.5 * radius};
    scene.object = {sphere, box};
  }
  const SyntheticTurntableOptions& table = turntable.options;
  const double pixel = table.distance / (table.focal_widths * table.width);
  const double finest = options.finest_wavelength_px * pixel;
  scene.object_texture = MakeTexture(table.seed, 1, finest, options.object_contrast);
  scene.platter_texture = MakeTexture(table.seed, 2, finest, options.platter_contrast);
  scene.static_texture = MakeTexture(table.seed, 3, 2.5 * finest, options.static_contrast);
  scene.to_light = Eigen::Vector3d(-0.5, -0.6, 0.9).normalized();
  return scene;
}

std::optional<SyntheticSurfacePoint> Trace(const SyntheticRenderScene& scene, const Ray& ray_in_world,
                                           const Rigid3& world_from_object,
                                           const Rigid3& world_from_platter) {
  const Rigid3 world_from_room;
  std::optional<BodyHit> nearest;
  IntersectBody(scene.object, scene.object_texture, kObjectLabel, world_from_object, ray_in_world, &nearest);
  IntersectBody(scene.platter, scene.platter_texture, kDiscLabel, world_from_platter, ray_in_world, &nearest);
  IntersectBody(scene.room, scene.static_texture, kStaticLabel, world_from_room, ray_in_world, &nearest);
  if (!nearest) return std::nullopt;
  SyntheticSurfacePoint point;
  point.t = nearest->hit.t;
  point.label = nearest->label;
  point.normal = nearest->world_from_body->rotation * nearest->hit.normal;
  if (point.normal.dot(ray_in_world.direction) > 0) point.normal = -point.normal;
  const Eigen::Vector3d x = ray_in_world.origin + point.t * ray_in_world.direction;
  point.color = nearest->texture->At(nearest->world_from_body->Inverse() * x);
  if (scene.options.lambert) point.color *= 0.35 + 0.65 * std::max(0.0, point.normal.dot(scene.to_light));
  return point;
}

SyntheticRendering Render(const SyntheticRenderScene& scene, const Camera& camera,
                          const Rigid3& cam_from_world, const Rigid3& world_from_object,
                          const Rigid3& world_from_platter) {
  const int width = static_cast<int>(camera.width);
  const int height = static_cast<int>(camera.height);
  const size_t num_pixels = camera.width * camera.height;
  SyntheticRendering rendering;
  rendering.rgb = {width, height, 3, std::vector<uint8_t>(3 * num_pixels)};
  rendering.label = {width, height, 1, std::vector<uint8_t>(num_pixels, kStaticLabel)};
  rendering.color.assign(num_pixels, Eigen::Array3f::Zero());
  rendering.depth.assign(num_pixels, 0);
  rendering.normals.assign(num_pixels, Eigen::Vector3d::Zero());

  const Rigid3 world_from_cam = cam_from_world.Inverse();
  const auto trace = [&](double x, double y) -> std::optional<SyntheticSurfacePoint> {
    const std::optional<Eigen::Vector3d> ray_in_cam = UnprojectFromImage(camera, {x, y});
    if (!ray_in_cam) return std::nullopt;
    const Ray ray{world_from_cam.translation, world_from_cam.rotation * *ray_in_cam};
    std::optional<SyntheticSurfacePoint> point = Trace(scene, ray, world_from_object, world_from_platter);
    if (point) point->t *= ray_in_cam->z();
    return point;
  };
  const int n = scene.options.supersampling;
#pragma omp parallel for schedule(dynamic, 4)
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const size_t pixel = static_cast<size_t>(y) * camera.width + static_cast<size_t>(x);
      const std::optional<SyntheticSurfacePoint> centre = trace(x + 0.5, y + 0.5);
      if (centre) {
        rendering.label.pixels[pixel] = centre->label;
        rendering.depth[pixel] = centre->t;
        rendering.normals[pixel] = cam_from_world.rotation * centre->normal;
      }
      Eigen::Array3d sum = Eigen::Array3d::Zero();
      for (int i = 0; i < n * n; ++i) {
        const auto sample = n == 1 ? centre : trace(x + (i % n + 0.5) / n, y + (i / n + 0.5) / n);
        if (sample) sum += sample->color;
      }
      const Eigen::Array3d color = sum / (n * n);
      rendering.color[pixel] = color.cast<float>();
      for (int channel = 0; channel < 3; ++channel) {
        rendering.rgb.pixels[3 * pixel + static_cast<size_t>(channel)] =
            static_cast<uint8_t>(std::lround(255 * color[channel]));
      }
    }
  }
  return rendering;
}

SyntheticRendering RenderImage(const SyntheticRenderScene& scene, const SyntheticTurntable& turntable,
                               int image) {
  const View& view = turntable.scene.views[static_cast<size_t>(image)];
  return Render(scene, turntable.CameraOf(image), view.cam_from_world, view.world_from_object,
                turntable.images[static_cast<size_t>(image)].world_from_platter);
}

TriangleMesh Tessellate(const std::vector<Shape>& shapes, int segments) {
  S2GS_INVARIANT(segments >= 4);
  TriangleMesh mesh;
  for (const Shape& shape : shapes) {
    if (shape.kind == ShapeKind::kBox) {
      AddBox(shape, &mesh);
      continue;
    }
    // A cylinder's two rings are its edges.
    const bool cylinder = shape.kind == ShapeKind::kCylinder;
    const int rings = cylinder ? 3 : segments / 2;
    const auto surface = [&](const Eigen::Vector3d& direction) -> Eigen::Vector3d {
      const double radius = shape.kind == ShapeKind::kBumpy ? BumpyRadius(shape, direction) : shape.size.x();
      return shape.frame_from_shape * Eigen::Vector3d(radius * direction);
    };
    const auto ring = [&](int i, int k) -> Eigen::Vector3d {
      if (!cylinder) return surface(OnUnitSphere(i, rings, k, segments));
      const Eigen::Vector3d around = OnUnitSphere(1, 2, k, segments);
      const double z = i == 1 ? shape.size.z() : -shape.size.z();
      return shape.frame_from_shape *
             Eigen::Vector3d(shape.size.x() * around.x(), shape.size.x() * around.y(), z);
    };
    const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d top =
        cylinder ? shape.frame_from_shape * Eigen::Vector3d(0, 0, shape.size.z()) : surface(up);
    const Eigen::Vector3d bottom =
        cylinder ? shape.frame_from_shape * Eigen::Vector3d(0, 0, -shape.size.z()) : surface(-up);
    AddRings(top, bottom, rings, segments, ring, &mesh);
  }
  return mesh;
}

}  // namespace s2gs
