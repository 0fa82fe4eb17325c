#pragma once

#include <cstdint>

namespace s2gs {

/// Shades of grey of what stands still behind a thing: squares of 6 px, each of its own shade.
inline double StillSquares(int x, int y) {
  const auto cell = static_cast<uint32_t>(x / 6 * 131 + y / 6);
  return 60 + static_cast<double>((cell * 2654435761U) >> 24) / 2;
}

}  // namespace s2gs
