#pragma once

#include <Eigen/Core>
#include <optional>

namespace s2gs {

/// Where two rays are nearest to each other: half-way between both. Nothing where they are parallel to a
/// millionth of a radian or meet behind either centre. Rays of any length; double or ceres::Jet.
template <typename T>
std::optional<Eigen::Matrix<T, 3, 1>> MeetingOfRays(const Eigen::Matrix<T, 3, 1>& centre1,
                                                    const Eigen::Matrix<T, 3, 1>& ray1,
                                                    const Eigen::Matrix<T, 3, 1>& centre2,
                                                    const Eigen::Matrix<T, 3, 1>& ray2) {
  const T square1 = ray1.dot(ray1);
  const T square2 = ray2.dot(ray2);
  const T product = ray1.dot(ray2);
  const T determinant = square1 * square2 - product * product;
  if (!(determinant > T(1e-12) * square1 * square2)) return std::nullopt;
  const Eigen::Matrix<T, 3, 1> between = centre2 - centre1;
  const T along1 = (square2 * ray1.dot(between) - product * ray2.dot(between)) / determinant;
  const T along2 = (product * ray1.dot(between) - square1 * ray2.dot(between)) / determinant;
  if (!(along1 > T(0) && along2 > T(0))) return std::nullopt;
  return T(0.5) * (centre1 + along1 * ray1 + centre2 + along2 * ray2);
}

}  // namespace s2gs
