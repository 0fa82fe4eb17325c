#include "tests/mesh/refine/sphere_photos.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "sfm_split/base/angles.h"
#include "tests/support/camera_towards_origin.h"
#include "tests/support/random_numbers.h"

namespace s2gs {

TriangleMesh Sphere(double radius, int rings) {
  TriangleMesh mesh;
  const int steps = 2 * rings;
  mesh.vertices.reserve(static_cast<size_t>(steps) * rings);
  mesh.triangles.reserve(2 * static_cast<size_t>(steps) * rings);
  mesh.vertices.emplace_back(0, 0, static_cast<float>(radius));
  for (int ring = 1; ring < rings; ++ring) {
    const double polar = kPi * ring / rings;
    for (int step = 0; step < steps; ++step) {
      const double turn = 2 * kPi * step / steps;
      const Eigen::Vector3d direction(std::sin(polar) * std::cos(turn), std::sin(polar) * std::sin(turn),
                                      std::cos(polar));
      mesh.vertices.emplace_back((radius * direction).cast<float>());
    }
  }
  mesh.vertices.emplace_back(0, 0, -static_cast<float>(radius));
  const auto last = static_cast<uint32_t>(mesh.vertices.size() - 1);
  const auto at = [&](int ring, int step) {
    if (ring == 0) return 0U;
    return ring == rings ? last : static_cast<uint32_t>(1 + (ring - 1) * steps + step % steps);
  };
  for (int ring = 0; ring < rings; ++ring) {
    for (int step = 0; step < steps; ++step) {
      if (ring > 0) mesh.triangles.emplace_back(at(ring, step), at(ring + 1, step), at(ring, step + 1));
      if (ring + 1 < rings) {
        mesh.triangles.emplace_back(at(ring, step + 1), at(ring + 1, step), at(ring + 1, step + 1));
      }
    }
  }
  return mesh;
}

TriangleMesh SphereWithFalseFront(double pixels, std::vector<size_t>* front) {
  TriangleMesh mesh = Sphere(1, 110);
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const double angle = std::acos(std::clamp(static_cast<double>(mesh.vertices[i].x()), -1.0, 1.0));
    if (angle > 0.25) continue;
    mesh.vertices[i] *= static_cast<float>(1 + pixels * kPixel);
    if (angle < 0.2) front->push_back(i);
  }
  return mesh;
}

ObjectView LookAtMiddle(double azimuth, double elevation, double distance) {
  const Eigen::Vector3d center =
      distance * Eigen::Vector3d(std::cos(azimuth) * std::cos(elevation),
                                 std::sin(azimuth) * std::cos(elevation), std::sin(elevation));
  return {kSide, kSide, kFocal, kFocal, kSide / 2.0 + 3.3, kSide / 2.0 - 2.6, CameraTowardsOrigin(center)};
}

SpherePhotos::SpherePhotos(int num_around, const std::vector<double>& elevations, const Texture& texture,
                           double noise, const Eigen::Vector3d& light_in_camera, double distance) {
  RandomNumbers random(7);
  views_.reserve(num_around * elevations.size());
  photos_.reserve(num_around * elevations.size());
  for (const double elevation : elevations) {
    for (int i = 0; i < num_around; ++i) {
      const ObjectView view = LookAtMiddle(2 * kPi * (i + 0.3 * elevation) / num_around, elevation, distance);
      const double gain = random.Uniform(0.7, 1.2);
      const double shift = random.Uniform(-15, 15);
      Image8 photo{kSide, kSide, 1, std::vector<uint8_t>(static_cast<size_t>(kSide) * kSide)};
      const Eigen::Matrix3d rotation = view.cam_from_object.rotation.toRotationMatrix();
      const Eigen::Vector3d center = -(rotation.transpose() * view.cam_from_object.translation);
      const Eigen::Vector3d light = rotation.transpose() * light_in_camera;
      for (int y = 0; y < kSide; ++y) {
        for (int x = 0; x < kSide; ++x) {
          const Eigen::Vector3d ray =
              (rotation.transpose() *
               Eigen::Vector3d((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1))
                  .normalized();
          const double b = center.dot(ray);
          const double root = b * b - center.squaredNorm() + 1;
          const Eigen::Vector3d hit = center + (-b - std::sqrt(std::max(0.0, root))) * ray;
          const double shade = 1 + std::max(0.0, hit.dot(light));  // the point is its own normal
          const double value = root > 0 ? shade * texture(hit) : 90;
          const double grey = gain * value + shift + random.Uniform(-noise, noise);
          *photo.Pixel(x, y) = static_cast<uint8_t>(std::clamp(grey, 0.0, 255.0) + 0.5);
        }
      }
      views_.push_back(view);
      gains_.push_back(gain);
      photos_.push_back(std::move(photo));
    }
  }
}

double Waves(const Eigen::Vector3d& x_in_object) {
  double sum = 0;
  const std::vector<Eigen::Vector3d> frequencies = {{110, 30, -50}, {-40, 100, 60}, {30, -60, 120},
                                                    {90, 90, 30},   {-70, 20, 100}, {50, 60, 40}};
  for (const Eigen::Vector3d& frequency : frequencies)
    sum += std::sin(frequency.dot(x_in_object) + frequency.x());
  return 120 + 18 * sum;
}

double Grain(const Eigen::Vector3d& x_in_object) {
  static const std::vector<Eigen::Vector3d> frequencies = [] {
    RandomNumbers random(11);
    std::vector<Eigen::Vector3d> made;
    for (int i = 0; i < 24; ++i) {
      const Eigen::Vector3d direction(random.Uniform(-1, 1), random.Uniform(-1, 1), random.Uniform(-1, 1));
      made.push_back(random.Uniform(190, 300) * direction.normalized());
    }
    return made;
  }();
  double sum = 0;
  for (const Eigen::Vector3d& frequency : frequencies)
    sum += std::sin(frequency.dot(x_in_object) + frequency.x());
  return 120 + 9 * sum;
}

double Plain(const Eigen::Vector3d& /*x_in_object*/) { return 120; }

std::pair<double, double> DistanceFromSphere(const TriangleMesh& mesh) {
  double sum = 0;
  double squares = 0;
  int count = 0;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    const double radius = vertex.cast<double>().norm();
    if (std::abs(vertex.z()) > 0.7 * radius) continue;
    sum += (radius - 1) / kPixel;
    squares += (radius - 1) * (radius - 1) / kPixel / kPixel;
    ++count;
  }
  return {sum / count, std::sqrt(squares / count)};
}

}  // namespace s2gs
