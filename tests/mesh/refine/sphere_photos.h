#pragma once

#include <Eigen/Core>
#include <functional>
#include <utility>
#include <vector>

#include "mesh/refine/refinement_photos.h"

namespace s2gs {

// Photos of a textured sphere of radius 1 from all around, and meshes of it.

inline constexpr double kDistance = 5;  // of the cameras from the sphere's middle
inline constexpr double kFocal = 600;   // [px]
inline constexpr int kSide = 280;       // [px]
inline constexpr double kPixel = (kDistance - 1) / kFocal;

/// Rings of vertices from pole to pole.
TriangleMesh Sphere(double radius, int rings);

/// Where the mesh stands so many pixels before the sphere, in a circle of .25 about the x axis.
/// \param front  gets the vertices of it, but for its rim.
TriangleMesh SphereWithFalseFront(double pixels, std::vector<size_t>* front);

/// A camera of `kSide` pixels a side that looks at the sphere's middle. \param azimuth, elevation  [rad]
ObjectView LookAtMiddle(double azimuth, double elevation, double distance = kDistance);

/// Each photo has another exposure. Where light falls, it stands still beside the camera while the sphere
/// turns.
class SpherePhotos : public RefinementPhotoSource {
 public:
  using Texture = std::function<double(const Eigen::Vector3d& x_in_object)>;

  /// \param elevations  of each ring of `num_around` photos [rad].
  /// \param noise  uniform, at most [grey levels].
  SpherePhotos(int num_around, const std::vector<double>& elevations, const Texture& texture,
               double noise = 0, const Eigen::Vector3d& light_in_camera = Eigen::Vector3d::Zero(),
               double distance = kDistance);

  int size() const override { return static_cast<int>(views_.size()); }
  const ObjectView& Camera(int index) const override { return views_[index]; }
  Image8 Load(int index) const override { return photos_[index]; }
  double Gain(int index) const override { return gains_[index]; }

 private:
  std::vector<ObjectView> views_;
  std::vector<double> gains_;
  std::vector<Image8> photos_;
};

/// Textures: waves of 6 to 14 pixels; waves of 3 to 5 pixels in all directions, of a patch of 6 pixels
/// another place has nothing; none.
double Waves(const Eigen::Vector3d& x_in_object);
double Grain(const Eigen::Vector3d& x_in_object);
double Plain(const Eigen::Vector3d& x_in_object);

/// Elevations [rad].
inline const std::vector<double> kThreeRings = {-0.5, 0, 0.5};

/// Mean and root mean square of the distance from the unit sphere, of the part that the cameras face [px].
std::pair<double, double> DistanceFromSphere(const TriangleMesh& mesh);

}  // namespace s2gs
