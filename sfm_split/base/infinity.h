#pragma once

#include <limits>

namespace s2gs {

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();  // what no minimum stays at

}  // namespace s2gs
