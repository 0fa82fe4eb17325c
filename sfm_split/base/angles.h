#pragma once

namespace s2gs {

inline constexpr double kPi = 3.14159265358979323846;  ///< [rad] half a turn.
inline constexpr double kDegree = kPi / 180;  ///< [rad]: `angle_deg * kDegree`, `angle_rad / kDegree`.

}  // namespace s2gs
