#include "sfm_split/circular_motion/epipolar_gain.h"

#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/match_mixture.h"

namespace s2gs {

using Eigen::Matrix3d;
using Eigen::Vector3d;

double EpipolarGain(const std::vector<RayMatch>& matches, const Rigid3& second_from_first, double focal1_px,
                    double focal2_px, double sigma_px) {
  const Matrix3d e =
      CrossMatrix<double>(second_from_first.translation) * second_from_first.rotation.toRotationMatrix();
  const double peak = 1 / (sigma_px * kRootTwoPi);
  std::vector<double> over;
  over.reserve(matches.size());
  for (const auto& [first, second, chance] : matches) {
    const Vector3d line2 = e * first;
    const Vector3d line1 = e.transpose() * second;
    const double squared = line2.head<2>().squaredNorm() / (focal2_px * focal2_px) +
                           line1.head<2>().squaredNorm() / (focal1_px * focal1_px);
    const double error = second.dot(line2);
    over.push_back(squared > 1e-30
                       ? OverChance(peak / chance, -0.5 * error * error / (squared * sigma_px * sigma_px))
                       : 0);
  }
  return MixtureGain(over, RightShare(over));
}

}  // namespace s2gs
