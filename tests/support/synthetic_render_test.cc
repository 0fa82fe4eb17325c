#include "tests/support/synthetic_render.h"

#include <gtest/gtest.h>
#include <omp.h>

#include <Eigen/Dense>
#include <cmath>
#include <map>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/scene/camera_model.h"

namespace s2gs {
namespace {

/// 200 x 150, no points.
SyntheticTurntableOptions PhotoOptions() {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 5;
  options.step_deg = 72;
  options.width = 200;
  options.height = 150;
  options.num_object_points = options.num_platter_points = options.num_background_points = 0;
  return options;
}

Eigen::Vector3d InWorld(const SyntheticTurntable& turntable, int image, int x, int y, double depth) {
  const auto ray = UnprojectFromImage(turntable.CameraOf(image), {x + 0.5, y + 0.5});
  return turntable.scene.views[static_cast<size_t>(image)].cam_from_world.Inverse() *
         Eigen::Vector3d(depth * *ray / ray->z());
}

/// Signed distance-like function: negative inside, zero on the surface, [metres].
double Implicit(const Shape& shape, const Eigen::Vector3d& x_in_frame) {
  const Eigen::Vector3d x = shape.frame_from_shape.Inverse() * x_in_frame;
  switch (shape.kind) {
    case ShapeKind::kBox:
      return (x.cwiseAbs() - shape.size).maxCoeff();
    case ShapeKind::kSphere:
      return x.norm() - shape.size.x();
    case ShapeKind::kCylinder:
      return std::max(x.head<2>().norm() - shape.size.x(), std::abs(x.z()) - shape.size.z());
    case ShapeKind::kBumpy:
      return x.norm() - BumpyRadius(shape, x.normalized());
  }
  return 1;
}

/// The least implicit value over shapes that are solid: negative inside any.
double InsideAny(const std::vector<Shape>& shapes, size_t first, const Eigen::Vector3d& x) {
  double least = 1e9;
  for (size_t i = first; i < shapes.size(); ++i) least = std::min(least, Implicit(shapes[i], x));
  return least;
}

TEST(SyntheticRender, DepthAndLabelAreTheFirstSurfacesOnTheRay) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(PhotoOptions());
  for (const bool bumpy : {false, true}) {
    SyntheticRenderOptions options;
    options.use_turntable_object = bumpy;
    const SyntheticRenderScene scene = MakeSyntheticRenderScene(turntable, options);
    std::map<uint8_t, int> seen;
    for (const int image : {0, 3, 7}) {
      const View& view = turntable.scene.views[static_cast<size_t>(image)];
      const Rigid3 object_from_world = view.world_from_object.Inverse();
      const SyntheticRendering rendering = RenderImage(scene, turntable, image);
      for (int y = 0; y < 150; y += 5) {
        for (int x = 0; x < 200; x += 5) {
          const size_t pixel = static_cast<size_t>(200 * y + x);
          const uint8_t label = rendering.label.pixels[pixel];
          ++seen[label];
          const double depth = rendering.depth[pixel];
          ASSERT_GT(depth, 0.1);  // the room is closed
          const Eigen::Vector3d at = InWorld(turntable, image, x, y, depth);
          const Eigen::Vector3d at_object = object_from_world * at;
          double on_surface = 0;
          if (label == kObjectLabel) {
            on_surface = InsideAny(scene.object, 0, at_object);
          } else if (label == kDiscLabel) {
            on_surface = Implicit(scene.platter[0], at_object);
          } else {
            // On a wall from inside or on a thing in the room.
            on_surface =
                std::min(std::abs(Implicit(scene.room[0], at)), std::abs(InsideAny(scene.room, 1, at)));
          }
          EXPECT_NEAR(on_surface, 0, 1e-12);
          for (int k = 0; k < 120; ++k) {
            const Eigen::Vector3d before = InWorld(turntable, image, x, y, depth * (k + 0.5) / 120);
            const Eigen::Vector3d before_object = object_from_world * before;
            EXPECT_GE(InsideAny(scene.object, 0, before_object), 0);
            EXPECT_GE(InsideAny(scene.platter, 0, before_object), 0);
            EXPECT_GE(InsideAny(scene.room, 1, before), 0);
            EXPECT_LE(Implicit(scene.room[0], before), 0);
          }
        }
      }
    }
    EXPECT_EQ(seen.size(), 3U);
    for (const auto& [label, count] : seen) EXPECT_GT(count, 100) << int{label};
  }
}

TEST(SyntheticRender, NormalsAreTheSurfacesGradients) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(PhotoOptions());
  for (const bool bumpy : {false, true}) {
    SyntheticRenderOptions options;
    options.use_turntable_object = bumpy;
    const SyntheticRenderScene scene = MakeSyntheticRenderScene(turntable, options);
    const View& view = turntable.scene.views[6];
    const SyntheticRendering rendering = RenderImage(scene, turntable, 6);
    int checked = 0;
    for (int y = 0; y < 150; ++y) {
      for (int x = 0; x < 200; ++x) {
        const size_t pixel = static_cast<size_t>(200 * y + x);
        const Eigen::Vector3d normal = rendering.normals[pixel];
        EXPECT_NEAR(normal.norm(), 1, 1e-12);
        const Eigen::Vector3d ray = *UnprojectFromImage(turntable.CameraOf(6), {x + 0.5, y + 0.5});
        EXPECT_LE(normal.dot(ray), 0);
        if (rendering.label.pixels[pixel] != kObjectLabel) continue;
        const Eigen::Vector3d at =
            view.world_from_object.Inverse() * InWorld(turntable, 6, x, y, rendering.depth[pixel]);
        // Central differences at a distance that stays on one side of the box's edges but for few pixels.
        const double h = 1e-6;
        Eigen::Vector3d gradient;
        for (int axis = 0; axis < 3; ++axis) {
          const Eigen::Vector3d step = h * Eigen::Vector3d::Unit(axis);
          gradient[axis] = InsideAny(scene.object, 0, at + step) - InsideAny(scene.object, 0, at - step);
        }
        const Eigen::Vector3d expected = view.CamFromObject().rotation * gradient.normalized();
        EXPECT_LT((normal - expected).norm(), 1e-6);
        ++checked;
      }
    }
    EXPECT_GT(checked, 500);
  }
}

TEST(SyntheticRender, SphereSilhouetteIsCentredOnItsConic) {
  // Off the axis and with the principal point off the middle; the pinhole image of a sphere is an ellipse
  // whose centre differs from the image of the sphere's centre.
  Camera camera;
  camera.model = CameraModelId::kPinhole;
  camera.width = 400;
  camera.height = 300;
  camera.params = {380, 410, 217.3, 138.9};
  SyntheticRenderScene scene;
  Shape sphere;
  sphere.kind = ShapeKind::kSphere;
  sphere.size.setConstant(0.3);
  sphere.frame_from_shape.translation = {0.4, -0.2, 1.7};
  scene.object = {sphere};
  scene.to_light.setZero();
  const SyntheticRendering rendering = Render(scene, camera, {}, {}, {});
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  double count = 0;
  for (int y = 0; y < 300; ++y) {
    for (int x = 0; x < 400; ++x) {
      if (rendering.label.Pixel(x, y)[0] != kObjectLabel) continue;
      sum += Eigen::Vector2d(x + 0.5, y + 0.5);
      ++count;
    }
  }
  // The cone of tangents: (c . d)^2 = (|c|^2 - r^2) |d|^2.
  const Eigen::Vector3d c = sphere.frame_from_shape.translation;
  const Eigen::Matrix3d conic = c * c.transpose() - (c.squaredNorm() - 0.09) * Eigen::Matrix3d::Identity();
  const Eigen::Vector2d centre = -conic.topLeftCorner<2, 2>().inverse() * conic.topRightCorner<2, 1>();
  const Eigen::Vector2d expected(380 * centre.x() + 217.3, 410 * centre.y() + 138.9);
  // Sampled at pixel centres, the centroid has an error of about 0.03 px (measured 0.04); half a pixel is
  // 0.5.
  EXPECT_LT((sum / count - expected).norm(), 0.1) << (sum / count - expected).transpose();
  // The ellipse's area in pixels, from the conic at its centre.
  const Eigen::Matrix2d a = conic.topLeftCorner<2, 2>();
  const double at_centre = conic(2, 2) + conic.topRightCorner<2, 1>().dot(centre);
  const double area = 380 * 410 * kPi * std::abs(at_centre) / std::sqrt(a.determinant());
  EXPECT_NEAR(count / area, 1, 2e-3);
  const Eigen::Vector2d projected_centre(380 * c.x() / c.z() + 217.3, 410 * c.y() / c.z() + 138.9);
  EXPECT_GT((projected_centre - expected).norm(), 1);  // so the test tells the two apart
}

TEST(SyntheticRender, OnlyTheRotatingPartChangesBetweenSteps) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(PhotoOptions());
  for (const bool lambert : {false, true}) {
    SyntheticRenderOptions options;
    options.lambert = lambert;
    const SyntheticRenderScene scene = MakeSyntheticRenderScene(turntable, options);
    const SyntheticRendering a = RenderImage(scene, turntable, 0);
    const SyntheticRendering b = RenderImage(scene, turntable, 1);
    int rotating = 0;
    int changed = 0;
    for (size_t pixel = 0; pixel < a.depth.size(); ++pixel) {
      const bool same = a.color[pixel].matrix() == b.color[pixel].matrix();
      if (a.label.pixels[pixel] == kStaticLabel && b.label.pixels[pixel] == kStaticLabel) {
        EXPECT_TRUE(same);
      } else {
        ++rotating;
        changed += same ? 0 : 1;
      }
    }
    EXPECT_GT(rotating, 2000);
    EXPECT_GT(changed, 0.99 * rotating);
  }
}

TEST(SyntheticRender, SupersamplingConvergesInsideSurfaces) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(PhotoOptions());
  SyntheticRenderOptions options;
  std::map<int, SyntheticRendering> renderings;
  for (const int n : {1, 3, 6}) {
    options.supersampling = n;
    renderings[n] = RenderImage(MakeSyntheticRenderScene(turntable, options), turntable, 8);
  }
  double sum1 = 0;
  double sum3 = 0;
  double count = 0;
  for (size_t pixel = 0; pixel < 200 * 150; ++pixel) {
    sum1 += (renderings[1].color[pixel] - renderings[6].color[pixel]).matrix().squaredNorm() / 3;
    sum3 += (renderings[3].color[pixel] - renderings[6].color[pixel]).matrix().squaredNorm() / 3;
    ++count;
  }
  const double rms1 = std::sqrt(sum1 / count);
  const double rms3 = std::sqrt(sum3 / count);
  RecordProperty("rms1", std::to_string(rms1));
  RecordProperty("rms3", std::to_string(rms3));
  EXPECT_LT(rms3, 0.012);
  EXPECT_LT(rms3, rms1 / 3);
  EXPECT_EQ(renderings[1].label.pixels, renderings[6].label.pixels);
}

TEST(SyntheticRender, ThreadsDoNotChangeTheImage) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(PhotoOptions());
  const SyntheticRenderScene scene = MakeSyntheticRenderScene(turntable, {});
  const int threads = omp_get_max_threads();
  omp_set_num_threads(1);
  const SyntheticRendering one = RenderImage(scene, turntable, 2);
  omp_set_num_threads(4);
  const SyntheticRendering four = RenderImage(scene, turntable, 2);
  omp_set_num_threads(threads);
  EXPECT_EQ(one.rgb.pixels, four.rgb.pixels);
  EXPECT_EQ(one.depth, four.depth);
}

TEST(SyntheticRender, RendersAgreeWithTheKeypointsThroughDistortedCameras) {
  for (const CameraModelId model :
       {CameraModelId::kSimplePinhole, CameraModelId::kOpenCV, CameraModelId::kOpenCVFisheye}) {
    SyntheticTurntableOptions options = PhotoOptions();
    options.width = 320;
    options.height = 240;
    options.camera_model = model;
    if (model != CameraModelId::kSimplePinhole) options.distortion = {-0.15, 0.04, 0.002, -0.001};
    options.principal_point_offset = {0.04, 0.02};
    options.num_object_points = 200;
    options.num_platter_points = 100;
    options.num_background_points = 300;
    options.flip_from_station = 1;
    const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
    SyntheticRenderOptions render_options;
    render_options.use_turntable_object = true;
    const SyntheticRenderScene scene = MakeSyntheticRenderScene(turntable, render_options);
    for (const int image : {1, 8}) {  // before and after the flip
      const SyntheticRendering rendering = RenderImage(scene, turntable, image);
      int right = 0;
      int total = 0;
      for (const SyntheticKeypoint& keypoint : turntable.images[static_cast<size_t>(image)].keypoints) {
        const Eigen::Vector3d x = turntable.CamFromBody(image, keypoint.body) *
                                  turntable.points[static_cast<size_t>(keypoint.point)].x;
        const Eigen::Vector2i at = keypoint.xy.cast<int>();
        const size_t pixel = static_cast<size_t>(320 * at.y() + at.x());
        const uint8_t label = keypoint.body == SyntheticBody::kObject    ? kObjectLabel
                              : keypoint.body == SyntheticBody::kPlatter ? kDiscLabel
                                                                         : kStaticLabel;
        ++total;
        // Half a pixel of a surface seen at 3 degrees is 0.001 / sin 3 degrees deep.
        right +=
            rendering.label.pixels[pixel] == label && std::abs(rendering.depth[pixel] - x.z()) < 0.02 ? 1 : 0;
      }
      EXPECT_GT(total, 150);
      EXPECT_GT(right, 0.97 * total) << static_cast<int>(model) << " image " << image;
    }
  }
}

TEST(SyntheticRender, ContrastZeroLeavesABodyGrey) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(PhotoOptions());
  SyntheticRenderOptions options;
  options.static_contrast = 0;
  const SyntheticRendering rendering =
      RenderImage(MakeSyntheticRenderScene(turntable, options), turntable, 0);
  double lowest = 255;
  double highest = 0;
  for (size_t pixel = 0; pixel < 200 * 150; ++pixel) {
    const double green = rendering.rgb.pixels[3 * pixel + 1];
    if (rendering.label.pixels[pixel] == kStaticLabel) {
      EXPECT_EQ(green, 128);
    } else {
      lowest = std::min(lowest, green);
      highest = std::max(highest, green);
    }
  }
  EXPECT_GT(highest - lowest, 120);
}

TEST(SyntheticRender, MeshesAreClosedAndOnTheSurfaces) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(PhotoOptions());
  SyntheticRenderOptions options;
  SyntheticRenderScene scene = MakeSyntheticRenderScene(turntable, options);
  const double radius = turntable.options.object_radius;
  std::vector<std::pair<Shape, double>> cases = {
      {scene.object[0], 4 * kPi / 3 * std::pow(0.6 * radius, 3)},
      {scene.object[1], 8 * 0.35 * 0.25 * 0.5 * std::pow(radius, 3)},
      {scene.platter[0], kPi * 0.14 * 0.14 * 0.018},
      {turntable.object, -1}};
  for (const auto& [shape, volume] : cases) {
    const TriangleMesh mesh = Tessellate({shape}, 128);
    std::map<std::pair<uint32_t, uint32_t>, int> edges;
    double six_volumes = 0;
    for (const auto& t : mesh.triangles) {
      for (int k = 0; k < 3; ++k) ++edges[{t[k], t[(k + 1) % 3]}];
      const Eigen::Vector3d a = mesh.vertices[t[0]].cast<double>();
      const Eigen::Vector3d b = mesh.vertices[t[1]].cast<double>();
      const Eigen::Vector3d c = mesh.vertices[t[2]].cast<double>();
      six_volumes += a.dot(b.cross(c));
    }
    for (const auto& [edge, count] : edges) {
      EXPECT_EQ(count, 1);
      EXPECT_EQ(edges.count({edge.second, edge.first}), 1U);
    }
    for (size_t i = 0; i < mesh.vertices.size(); ++i) {
      EXPECT_NEAR(Implicit(shape, mesh.vertices[i].cast<double>()), 0, 1e-7);  // float
    }
    EXPECT_GT(six_volumes, 0);  // counter-clockwise seen from outside
    // A 128-gon's area is 1 - (2 pi / 128)^2 / 6 of the circle's: 4e-4 less.
    if (volume > 0) {
      EXPECT_NEAR(six_volumes / 6 / volume, 1, 1.5e-3);
    }
  }
}

}  // namespace
}  // namespace s2gs
