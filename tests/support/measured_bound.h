#pragma once

#include <string>

namespace s2gs {

/// The cases of the table of numerics (tests/bench/numerics.py), in its order.
namespace numerics {
inline constexpr const char* kAdjoints = "adjoints";
inline constexpr const char* kHostileInput = "hostile input";
inline constexpr const char* kDegenerateGaussians = "degenerate Gaussians";
inline constexpr const char* kEdgeOn = "edge-on, through and behind the camera's plane";
inline constexpr const char* kManyLayers = "2,000 layers";
inline constexpr const char* kScaleAndPlace = "scale and place of the scene";
inline constexpr const char* kLogits = "entropy and KL at all logits";
inline constexpr const char* kWignerD = "Wigner D";
inline constexpr const char* kGeometry = "rotations, rank and focal length";
inline constexpr const char* kCounts = "counts past 2^31";
inline constexpr const char* kTsdf = "TSDF of a sphere";
inline constexpr const char* kRepeatability = "same seed twice";
}  // namespace numerics

/// Fails the current test unless `measured` <= `bound` (NaN fails), and records both: as a property of the
/// test, and as a line of JSON at the end of the file that the environment variable S2GS_NUMERICS names, if
/// it does.
/// \param row   one of `numerics`.
/// \param what  the error that was measured, with its unit.
/// \param on    which arithmetic or backend: "double", "float", "cpu" or "cuda".
void ExpectWithin(const char* row, const std::string& what, const std::string& on, double measured,
                  double bound);

}  // namespace s2gs
