#include "sfm_split/scale/disc_rim.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace s2gs {
namespace {

constexpr int kHeights = 400;         // that are tried first, over the range of the cameras' distances
constexpr int kSteps = 30;            // at most, of Gauss-Newton
constexpr double kConverged = 1e-12;  // of the radius
// A radius that is less sure than this says nothing of the scale.
constexpr double kMaxSigmaRel = 0.1;

struct SideLine {
  Eigen::Vector3d origin, direction;  // in a frame whose z axis is the table's
};

// Where a line meets the plane at a height: its distance from the axis. Nothing behind the camera.
std::optional<double> RadiusAt(const SideLine& line, double height) {
  const double depth = (height - line.origin.z()) / line.direction.z();
  if (!(depth > 0) || !std::isfinite(depth)) return std::nullopt;
  return (line.origin + depth * line.direction).head<2>().norm();
}

// A place's line, and those of its neighbours one pixel to the right and one below.
using Lines = std::array<SideLine, 3>;

// Its radius at a height, and the standard deviation of that for one of a pixel.
struct Place {
  double radius = 0, sigma = 0;
};

std::optional<Place> PlaceAt(const Lines& lines, double height) {
  std::array<double, 3> radius = {};
  for (size_t k = 0; k < 3; ++k) {
    const std::optional<double> at = RadiusAt(lines[k], height);
    if (!at) return std::nullopt;
    radius[k] = *at;
  }
  const double sigma = std::hypot(radius[1] - radius[0], radius[2] - radius[0]);
  if (!(sigma > 0)) return std::nullopt;
  return Place{radius[0], sigma};
}

// The radius that suits all places at a height, and the squares of what is left, in pixels.
struct Level {
  double radius = 0, squares = 0, weight = 0;
};

std::optional<Level> LevelAt(const std::vector<Lines>& all, double height) {
  Level level;
  std::vector<Place> places;
  for (const Lines& lines : all) {
    const std::optional<Place> place = PlaceAt(lines, height);
    if (!place) return std::nullopt;
    places.push_back(*place);
    const double weight = 1 / (place->sigma * place->sigma);
    level.weight += weight;
    level.radius += weight * place->radius;
  }
  level.radius /= level.weight;
  for (const Place& place : places) level.squares += std::pow((place.radius - level.radius) / place.sigma, 2);
  return level;
}

std::vector<Lines> LinesOf(const TurntableAxis& axis, const std::vector<RimSighting>& sightings) {
  const Eigen::Quaterniond turn =
      Eigen::Quaterniond::FromTwoVectors(axis.direction, Eigen::Vector3d::UnitZ());
  std::vector<Lines> all;
  for (const RimSighting& sighting : sightings) {
    const Rigid3 world_from_cam = sighting.cam_from_world.Inverse();
    Lines lines;
    bool is_seen = true;
    for (size_t k = 0; k < 3; ++k) {
      const Eigen::Vector2d xy = sighting.xy + Eigen::Vector2d(k == 1 ? 1 : 0, k == 2 ? 1 : 0);
      const std::optional<Eigen::Vector3d> ray = UnprojectFromImage(*sighting.camera, xy);
      is_seen = is_seen && ray.has_value();
      if (!is_seen) break;
      lines[k].origin = turn * (world_from_cam.translation - axis.point);
      lines[k].direction = turn * (world_from_cam.rotation * *ray);
    }
    if (is_seen) all.push_back(lines);
  }
  return all;
}

}  // namespace

std::optional<DiscRim> FitDiscRim(const TurntableAxis& axis, const std::vector<RimSighting>& sightings,
                                  double click_px) {
  const std::vector<Lines> all = LinesOf(axis, sightings);
  if (all.size() < 2) return std::nullopt;
  double low = std::numeric_limits<double>::infinity();
  double high = -low;
  double distance = 0;
  for (const Lines& lines : all) {
    low = std::min(low, lines[0].origin.z());
    high = std::max(high, lines[0].origin.z());
    distance = std::max(distance, lines[0].origin.head<2>().norm());
  }
  low -= 4 * distance;
  high += 4 * distance;
  // The cost has one minimum for each side of the cameras that the disc may lie on.
  double height = 0;
  double least = std::numeric_limits<double>::infinity();
  for (int i = 0; i <= kHeights; ++i) {
    const double at = low + (high - low) * i / kHeights;
    const std::optional<Level> level = LevelAt(all, at);
    if (!level || level->squares >= least) continue;
    least = level->squares;
    height = at;
  }
  if (!std::isfinite(least)) return std::nullopt;
  // Gauss-Newton for height and radius; dr/dh of a line is the difference quotient.
  Eigen::Matrix2d normal;
  double radius = LevelAt(all, height)->radius;
  for (int step = 0; step < kSteps; ++step) {
    normal.setZero();
    Eigen::Vector2d right = Eigen::Vector2d::Zero();
    const double delta = 1e-6 * distance;
    for (const Lines& lines : all) {
      const std::optional<Place> place = PlaceAt(lines, height);
      const std::optional<double> above = RadiusAt(lines[0], height + delta);
      if (!place || !above) return std::nullopt;
      const Eigen::Vector2d row = Eigen::Vector2d((*above - place->radius) / delta, -1) / place->sigma;
      normal += row * row.transpose();
      right -= row * (place->radius - radius) / place->sigma;
    }
    const Eigen::Vector2d change = normal.ldlt().solve(right);
    if (!change.allFinite()) return std::nullopt;
    height += change.x();
    radius += change.y();
    if (change.norm() < kConverged * distance) break;
  }
  const std::optional<Level> level = LevelAt(all, height);
  if (!level) return std::nullopt;
  DiscRim rim;
  rim.radius = level->radius;
  rim.height = height;
  const auto freedom = static_cast<double>(all.size()) - 2;
  rim.rms_px = freedom > 0 ? std::sqrt(level->squares / freedom) : 0;
  rim.sigma = std::max(click_px, rim.rms_px) * std::sqrt(normal.inverse()(1, 1));
  if (!(rim.radius > 0) || !(rim.sigma < kMaxSigmaRel * rim.radius)) return std::nullopt;
  return rim;
}

}  // namespace s2gs
