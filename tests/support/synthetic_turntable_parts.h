#pragma once

#include <cstdint>

#include "tests/support/random_numbers.h"
#include "tests/support/synthetic_turntable.h"

/// The steps that MakeSyntheticTurntable takes, in their order. Each fills its part of the scene from those
/// before, with random numbers of its own stream.
namespace s2gs::synthetic {

enum Stream : uint64_t {
  kShapes = 1,
  kObjectPoints,
  kPoses,
  kTable,
  kPlatterPoints,
  kBackground,
  kKeypoints,
  kDescriptors,
  kMatches
};

/// A generator for one stream and one of its items, e.g. an image.
inline RandomNumbers RandomFor(uint64_t seed, Stream stream, uint64_t item = 0) {
  return RandomNumbers(seed, (item << 8) | stream);
}

/// The object with its points, the platter and the room; needs nothing but the options.
void AddShapes(SyntheticTurntable* turntable);
/// Cameras and, for each image, its poses.
void AddViews(SyntheticTurntable* turntable);
/// The platter's and the background's points.
void AddSurroundingPoints(SyntheticTurntable* turntable);
void AddKeypoints(SyntheticTurntable* turntable);
void AddDescriptors(SyntheticTurntable* turntable);
void AddMatches(SyntheticTurntable* turntable);

/// How the room lies in the world: its z axis is the vertical.
Rigid3 WorldFromRoom(const SyntheticTurntable& turntable);
/// Where the axis passes the object's middle, in the world.
Eigen::Vector3d TableMiddle(const SyntheticTurntable& turntable);

}  // namespace s2gs::synthetic
