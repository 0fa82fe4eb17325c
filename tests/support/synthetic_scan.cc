#include "tests/support/synthetic_scan.h"

#include <map>
#include <random>
#include <set>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

ScanFeatures SyntheticScanFeatures(const SyntheticTurntable& turntable) {
  ScanFeatures features;
  for (const Camera& camera : turntable.scene.cameras) {
    features.cameras[camera.camera_id] = camera;
    features.has_prior_focal[camera.camera_id] = turntable.options.has_prior_focal;
  }
  std::map<int, int> first_of_station;
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    const View& view = turntable.scene.views[i];
    ScanImage image;
    image.name = view.name;
    image.image_id = static_cast<uint32_t>(i + 1);
    image.camera_id = view.camera_id;
    image.station = view.station;
    first_of_station.emplace(view.station, static_cast<int>(i));
    for (const SyntheticKeypoint& keypoint : turntable.images[i].keypoints) {
      image.keypoints.push_back(keypoint.xy.cast<float>());
      image.labels.push_back(IsRotating(keypoint.body)                 ? KeypointLabel::kRotating
                             : keypoint.body == SyntheticBody::kStatic ? KeypointLabel::kStatic
                                                                       : KeypointLabel::kUnknown);
    }
    features.images.push_back(std::move(image));
  }
  for (const SyntheticPair& pair : turntable.pairs) {
    ImagePairMatches rotating{pair.image1, pair.image2, {}};
    ImagePairMatches fixed{pair.image1, pair.image2, {}};
    const auto is_representative = [&](int image) {
      return first_of_station.at(turntable.scene.views[static_cast<size_t>(image)].station) == image;
    };
    const bool are_representatives = is_representative(pair.image1) && is_representative(pair.image2);
    for (const SyntheticMatch& match : pair.matches) {
      const SyntheticBody body =
          turntable.images[static_cast<size_t>(pair.image1)].keypoints[match.keypoint1].body;
      if (IsRotating(body)) {
        rotating.matches.push_back({match.keypoint1, match.keypoint2});
      } else if (are_representatives && body == SyntheticBody::kStatic) {
        fixed.matches.push_back({match.keypoint1, match.keypoint2});
      }
    }
    if (!rotating.matches.empty()) features.object_pairs.push_back(std::move(rotating));
    if (!fixed.matches.empty()) features.static_pairs.push_back(std::move(fixed));
  }
  return features;
}

std::vector<PosedImage> TruePosesOfObject(const SyntheticTurntable& turntable) {
  std::vector<PosedImage> posed;
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    posed.push_back(
        {true, &turntable.CameraOf(static_cast<int>(i)), turntable.scene.views[i].CamFromObject()});
  }
  return posed;
}

std::map<std::string, int> StationsOf(const ScanFeatures& features) {
  std::map<std::string, int> stations;
  for (const ScanImage& image : features.images) stations[image.name] = image.station;
  return stations;
}

std::vector<Keypoints> KeypointsOf(const ScanFeatures& features) {
  std::vector<Keypoints> keypoints;
  for (const ScanImage& image : features.images) keypoints.push_back(image.keypoints);
  return keypoints;
}

void DamageModel(const ModelFaults& faults, uint32_t seed, ColmapModel* model) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform;
  const auto vector = [&] { return Eigen::Vector3d(normal(rng), normal(rng), normal(rng)); };
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const auto& [id, point] : model->points3D) mean += point.xyz;
  mean /= std::max<double>(1, static_cast<double>(model->points3D.size()));
  double distance = 0;
  std::vector<std::string> missing;
  for (auto& [id, image] : model->images) {
    Eigen::Vector3d centre = CameraCentre(image.cam_from_world);
    distance = (centre - mean).norm();
    const bool is_wrong = uniform(rng) < faults.wrong_share;
    const double degree = kPi / 180;
    centre += (is_wrong ? 0.5 : faults.centre_rel) * distance * vector();
    image.cam_from_world.rotation =
        (Eigen::Quaterniond(
             ExpRotation<double>(Eigen::Vector3d((is_wrong ? 1 : faults.rotation_deg * degree) * vector()))) *
         image.cam_from_world.rotation)
            .normalized();
    image.cam_from_world.translation = -(image.cam_from_world.rotation * centre);
    if (uniform(rng) < faults.missing_share) missing.push_back(image.name);
  }
  for (auto& [id, point] : model->points3D) point.xyz += faults.point_rel * distance * vector();
  for (auto& [id, camera] : model->cameras) {
    for (size_t k = 0; k < InfoOf(camera.model).num_focal_params; ++k)
      camera.params[k] *= faults.focal_factor;
  }
  RemoveImages(missing, model);
}

}  // namespace s2gs
