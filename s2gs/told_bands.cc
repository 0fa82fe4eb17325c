#include "s2gs/told_bands.h"

#include <Eigen/QR>
#include <Eigen/SVD>
#include <array>
#include <cmath>

#include "s2gs/kernel/sh.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

// Rows are directions, columns the functions of bands 0 to max_degree.
Eigen::MatrixXd Basis(const std::vector<Eigen::Vector3d>& directions, int max_degree) {
  const auto count = static_cast<Eigen::Index>(directions.size());
  Eigen::MatrixXd basis(count, 1 + ShRestCount(max_degree));
  basis.col(0).setConstant(kShBand0);
  for (Eigen::Index i = 0; i < count; ++i) {
    const Eigen::Vector3d& d = directions[static_cast<size_t>(i)];
    std::array<double, kShRestPerChannel> rest = {};
    ShRestBasis(max_degree, Vec3<double>{d.x(), d.y(), d.z()}, rest.data());
    for (int k = 0; k < ShRestCount(max_degree); ++k) basis(i, 1 + k) = rest[static_cast<size_t>(k)];
  }
  return basis;
}

ToldBands BandsOf(const std::vector<Eigen::Vector3d>& directions, int max_degree) {
  ToldBands told;
  for (const BandEvidence& band : MeasureBands(directions, max_degree)) {
    told.last = band;
    if (!(band.own_part > kGreyLevel)) break;
    told.degree = band.band;
  }
  return told;
}

}  // namespace

std::vector<BandEvidence> MeasureBands(const std::vector<Eigen::Vector3d>& directions, int max_degree) {
  const Eigen::MatrixXd basis = Basis(directions, max_degree);
  const double root = std::sqrt(static_cast<double>(directions.size()));
  std::vector<BandEvidence> bands;
  for (int band = 1; band <= max_degree; ++band) {
    const Eigen::Index lower = Eigen::Index{band} * band;
    const Eigen::MatrixXd below = basis.leftCols(lower);
    const Eigen::MatrixXd own = basis.middleCols(lower, 2 * Eigen::Index{band} + 1);
    // Where directions are few or alike, the lower bands alone have no full rank.
    const Eigen::MatrixXd left = own - below * below.completeOrthogonalDecomposition().solve(own);
    bands.push_back({band, left.jacobiSvd().singularValues()(0) / root});
  }
  return bands;
}

ToldBands FindToldBands(const TrainingScene& scene, int max_degree) {
  std::vector<Eigen::Vector3d> of_object;
  std::vector<Eigen::Vector3d> of_background;
  const Eigen::Vector3d middle = scene.region ? scene.region->axis.point : scene.focus;
  for (const ScenePhoto& photo : scene.photos) {
    if (photo.held_out) continue;
    of_object.push_back((CameraCentre(photo.view.cam_from_object) - middle).normalized());
    of_background.push_back((CameraCentre(photo.view.cam_from_world) - middle).normalized());
  }
  const ToldBands object = BandsOf(of_object, max_degree);
  if (scene.bodies() == SceneBodies::kObjectOnly || of_object.empty()) return object;
  const ToldBands background = BandsOf(of_background, max_degree);
  if (scene.bodies() == SceneBodies::kStaticOnly) return background;
  return object.degree >= background.degree ? object : background;
}

}  // namespace s2gs
