#pragma once

#include <limits>

namespace s2gs {

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

}  // namespace s2gs
