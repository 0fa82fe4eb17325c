#include "tests/support/synthetic_database.h"

#include <Eigen/Dense>
#include <vector>

#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/io/colmap_database.h"

namespace s2gs {
namespace {

constexpr size_t kMinInliers = 15;  // COLMAP's own

uint32_t ImageId(int image) { return static_cast<uint32_t>(image) + 1; }

Eigen::Matrix3d Intrinsics(const Camera& camera) {
  Eigen::Matrix3d k = Eigen::Matrix3d::Identity();
  k.topLeftCorner<2, 2>() = FocalLengths(camera).asDiagonal();
  k.topRightCorner<2, 1>() = PrincipalPoint(camera);
  return k;
}

TwoViewGeometry GeometryOf(const SyntheticTurntable& turntable, const SyntheticPair& pair, bool rotating) {
  TwoViewGeometry geometry;
  const bool flip_between = turntable.images[static_cast<size_t>(pair.image1)].flipped !=
                            turntable.images[static_cast<size_t>(pair.image2)].flipped;
  for (const SyntheticMatch& match : pair.matches) {
    const bool wanted = rotating ? match.body == SyntheticBody::kObject ||
                                       (match.body == SyntheticBody::kPlatter && !flip_between)
                                 : match.body == SyntheticBody::kStatic;
    if (wanted) geometry.inlier_matches.push_back({match.keypoint1, match.keypoint2});
  }
  const SyntheticBody body = rotating ? SyntheticBody::kObject : SyntheticBody::kStatic;
  const Rigid3 cam1_from_body = turntable.CamFromBody(pair.image1, body);
  const Rigid3 cam2_from_body = turntable.CamFromBody(pair.image2, body);
  const Rigid3 cam2_from_cam1 = cam2_from_body * cam1_from_body.Inverse();
  const Eigen::Matrix3d rotation = cam2_from_cam1.rotation.toRotationMatrix();
  const Camera& camera1 = turntable.CameraOf(pair.image1);
  const Camera& camera2 = turntable.CameraOf(pair.image2);
  const Eigen::Matrix3d inverse_k1 = Intrinsics(camera1).inverse();
  const Eigen::Matrix3d k2 = Intrinsics(camera2);
  const Eigen::Vector3d& t = cam2_from_cam1.translation;
  if (t.norm() < 1e-9 * CameraCentre(cam1_from_body).norm()) {
    geometry.config = TwoViewConfig::kPanoramic;
    geometry.H = k2 * rotation * inverse_k1;
    return geometry;
  }
  Eigen::Matrix3d cross;
  cross << 0, -t.z(), t.y(), t.z(), 0, -t.x(), -t.y(), t.x(), 0;
  geometry.config = TwoViewConfig::kCalibrated;
  geometry.E = cross / t.norm() * rotation;
  if (IsDistortionFree(camera1) && IsDistortionFree(camera2)) {
    geometry.F = k2.inverse().transpose() * *geometry.E * inverse_k1;
  }
  return geometry;
}

void Fill(const SyntheticTurntable& turntable, SyntheticGeometries geometries, ColmapDatabase* database) {
  for (const Camera& camera : turntable.scene.cameras) {
    database->WriteCamera({camera, turntable.options.has_prior_focal});
  }
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    DatabaseImage row;
    row.image_id = ImageId(static_cast<int>(i));
    row.name = turntable.scene.views[i].name;
    row.camera_id = turntable.scene.views[i].camera_id;
    database->WriteImage(row);
    const SyntheticImage& image = turntable.images[i];
    KeypointMatrix keypoints(image.keypoints.size(), 4);
    for (Eigen::Index k = 0; k < keypoints.rows(); ++k) {
      const Eigen::Vector2f xy = image.keypoints[static_cast<size_t>(k)].xy.cast<float>();
      keypoints.row(k) << xy.x(), xy.y(), 1, 0;
    }
    database->WriteKeypoints(row.image_id, keypoints);
    if (image.descriptors.empty()) continue;
    DescriptorMatrix descriptors(image.descriptors.size(), 128);
    for (Eigen::Index k = 0; k < descriptors.rows(); ++k) {
      const SiftDescriptor& descriptor = image.descriptors[static_cast<size_t>(k)];
      std::copy(descriptor.begin(), descriptor.end(), descriptors.row(k).data());
    }
    database->WriteDescriptors(row.image_id, descriptors);
  }
  for (const SyntheticPair& pair : turntable.pairs) {
    FeatureMatches matches;
    for (const SyntheticMatch& match : pair.matches) matches.push_back({match.keypoint1, match.keypoint2});
    database->WriteMatches(ImageId(pair.image1), ImageId(pair.image2), matches);
    if (geometries == SyntheticGeometries::kNone) continue;
    const TwoViewGeometry geometry =
        GeometryOf(turntable, pair, geometries == SyntheticGeometries::kRotating);
    if (geometry.inlier_matches.size() < kMinInliers) continue;
    database->WriteTwoViewGeometry(ImageId(pair.image1), ImageId(pair.image2), geometry);
  }
}

}  // namespace

void WriteSyntheticDatabase(const std::filesystem::path& path, const SyntheticTurntable& turntable,
                            SyntheticGeometries geometries) {
  ColmapDatabase::WriteAtomically(path, [&](ColmapDatabase& database) {
    database.InTransaction([&] { Fill(turntable, geometries, &database); });
  });
}

}  // namespace s2gs
