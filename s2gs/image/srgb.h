#pragma once

#include <cmath>

namespace s2gs {

/// Light that an sRGB value stands for, both from 0 to 1 (IEC 61966-2-1).
template <typename T>
T LightFromSrgb(T value) {
  return value <= T(0.04045) ? value / T(12.92) : std::pow((value + T(0.055)) / T(1.055), T(2.4));
}

/// The sRGB value of light, both from 0 to 1.
template <typename T>
T SrgbFromLight(T light) {
  return light <= T(0.0031308) ? T(12.92) * light : T(1.055) * std::pow(light, 1 / T(2.4)) - T(0.055);
}

/// How much the sRGB value grows with light.
template <typename T>
T SrgbSlope(T light) {
  return light <= T(0.0031308) ? T(12.92) : T(1.055) / T(2.4) * std::pow(light, 1 / T(2.4) - 1);
}

}  // namespace s2gs
