#include "sfm_split/turntable/epipolar_gain.h"

#include <cmath>

#include "sfm_split/base/rotation.h"

namespace s2gs {

using Eigen::Matrix3d;
using Eigen::Vector3d;

double EpipolarGain(const std::vector<std::pair<Vector3d, Vector3d>>& rays, const Rigid3& second_from_first,
                    double focal1_px, double focal2_px, double sigma_px, double chance, size_t stride) {
  constexpr double kRootTwoPi = 2.50662827463100050;
  const Matrix3d e =
      CrossMatrix<double>(second_from_first.translation) * second_from_first.rotation.toRotationMatrix();
  const double peak = 1 / (sigma_px * kRootTwoPi * chance);
  std::vector<double> over;
  over.reserve(rays.size() / stride + 1);
  for (size_t m = 0; m < rays.size(); m += stride) {
    const auto& [first, second] = rays[m];
    const Vector3d line2 = e * first;
    const Vector3d line1 = e.transpose() * second;
    const double squared = line2.head<2>().squaredNorm() / (focal2_px * focal2_px) +
                           line1.head<2>().squaredNorm() / (focal1_px * focal1_px);
    const double error = second.dot(line2);
    over.push_back(squared > 1e-30 ? peak * std::exp(-0.5 * error * error / (squared * sigma_px * sigma_px))
                                   : 0);
  }
  double share = 0.3;
  for (int iteration = 0; iteration < 4; ++iteration) {
    double sum = 1;
    for (const double o : over) sum += share * o / (share * o + 1 - share);
    share = sum / (static_cast<double>(over.size()) + 2);
  }
  double gain = 0;
  for (const double o : over) gain += std::log(1 - share + share * o);
  return gain;
}

}  // namespace s2gs
