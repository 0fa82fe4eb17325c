// Writes and prints COLMAP databases for the interoperability tests.
//
// usage: database_tool create PATH    a database with known content
//        database_tool extend PATH    one more camera, image and pair
//        database_tool dump PATH      everything as JSON; floating-point numbers survive exactly

#include <cmath>
#include <cstdio>
#include <iostream>
#include <nlohmann/json.hpp>
#include <string>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_database.h"

namespace s2gs {
namespace {

using nlohmann::json;
using Access = ColmapDatabase::Access;

// Ids run from 1, because COLMAP's merger gives them anew.
void Fill(ColmapDatabase& database) {
  database.InTransaction([&] {
    database.WriteCamera({{1, CameraModelId::kSimpleRadial, 640, 480, {500.1, 320.5, 240.25, -0.125}}, true});
    database.WriteCamera({{2, CameraModelId::kOpenCV, 800, 600, {1, 2, 3, 4, 5, 6, 7, 1.0 / 3}}, false});
    for (const uint32_t id : {1u, 2u, 3u}) {
      DatabaseImage image{id, "folder/image " + std::to_string(id) + ".jpg", id == 3 ? 2u : 1u, {}, {}};
      if (id == 2) image.prior_qvec = Eigen::Vector4d(1, 0, 0, 0);
      if (id == 2) image.prior_tvec = Eigen::Vector3d(47.5, 8.25, 400);
      database.WriteImage(image);
      const int num_keypoints = 20 + static_cast<int>(id);
      KeypointMatrix keypoints(num_keypoints, 6);
      DescriptorMatrix descriptors(num_keypoints, 128);
      for (int row = 0; row < num_keypoints; ++row) {
        // Irrational, so that the last bits count.
        for (int col = 0; col < 6; ++col) {
          keypoints(row, col) = static_cast<float>(100 * std::sqrt(1.0 + 10 * row + col + 1000 * id));
        }
        for (int col = 0; col < 128; ++col) {
          descriptors(row, col) = static_cast<uint8_t>(7 * row + 3 * col + static_cast<int>(id));
        }
      }
      database.WriteKeypoints(id, keypoints);
      database.WriteDescriptors(id, descriptors);
    }
    FeatureMatches matches;
    for (uint32_t i = 0; i < 20; ++i) matches.push_back({i, 20 - i});
    database.WriteMatches(1, 2, matches);
    database.WriteMatches(3, 1, {{22, 0}, {1, 3}});
    TwoViewGeometry geometry;
    geometry.config = TwoViewConfig::kCalibrated;
    geometry.inlier_matches = FeatureMatches(matches.begin(), matches.begin() + 15);
    geometry.F = Eigen::Matrix3d::Random();
    geometry.E = Eigen::Matrix3d::Random();
    geometry.H = Eigen::Matrix3d::Random();
    geometry.cam2_from_cam1 =
        Rigid3{Eigen::Quaterniond(0.5, -0.5, 0.5, 0.5), Eigen::Vector3d(1.0 / 3, 2, -3)};
    database.WriteTwoViewGeometry(1, 2, geometry);
    TwoViewGeometry bare;
    bare.config = TwoViewConfig::kUncalibrated;
    bare.inlier_matches = {{0, 22}};
    database.WriteTwoViewGeometry(1, 3, bare);
  });
}

void Extend(ColmapDatabase& database) {
  database.InTransaction([&] {
    const uint32_t camera_id =
        database.WriteCamera({{0, CameraModelId::kPinhole, 10, 20, {1, 2, 3, 4}}, true});
    const uint32_t image_id = database.WriteImage({0, "new.jpg", camera_id, {}, {}});
    database.WriteKeypoints(image_id, KeypointMatrix::Ones(5, 6));
    database.WriteDescriptors(image_id, DescriptorMatrix::Ones(5, 128));
    database.WriteMatches(image_id, 1, {{0, 4}});
    TwoViewGeometry geometry;
    geometry.config = TwoViewConfig::kUncalibrated;
    geometry.inlier_matches = {{0, 4}};
    geometry.F = Eigen::Matrix3d::Ones();
    database.WriteTwoViewGeometry(image_id, 1, geometry);
  });
}

template <typename Matrix>
json Rows(const Matrix& matrix) {
  json rows = json::array();
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    json row = json::array();
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) row.push_back(matrix(r, c));
    rows.push_back(row);
  }
  return rows;
}

template <typename Matrix>
json RowsOrNull(const std::optional<Matrix>& matrix) {
  return matrix ? Rows(*matrix) : json();
}

json Pairs(const FeatureMatches& matches) {
  json pairs = json::array();
  for (const FeatureMatch& match : matches) pairs.push_back({match.point2D_idx1, match.point2D_idx2});
  return pairs;
}

json Dump(const ColmapDatabase& database) {
  json root = {{"cameras", json::array()},
               {"images", json::array()},
               {"matches", json::object()},
               {"geometries", json::object()}};
  for (const DatabaseCamera& row : database.ReadCameras()) {
    const Camera& camera = row.camera;
    root["cameras"].push_back({{"id", camera.camera_id},
                               {"model", static_cast<int>(camera.model)},
                               {"width", camera.width},
                               {"height", camera.height},
                               {"params", camera.params},
                               {"has_prior_focal_length", row.has_prior_focal_length}});
  }
  for (const DatabaseImage& image : database.ReadImages()) {
    root["images"].push_back({{"id", image.image_id},
                              {"name", image.name},
                              {"camera_id", image.camera_id},
                              {"prior_qvec", RowsOrNull(image.prior_qvec)},
                              {"prior_tvec", RowsOrNull(image.prior_tvec)},
                              {"keypoints", Rows(database.ReadKeypoints(image.image_id))},
                              {"descriptors", Rows(database.ReadDescriptors(image.image_id))}});
  }
  const auto name = [](uint32_t id1, uint32_t id2) {
    return std::to_string(id1) + " " + std::to_string(id2);
  };
  database.ForEachMatches([&](uint32_t id1, uint32_t id2, const FeatureMatches& matches) {
    root["matches"][name(id1, id2)] = Pairs(matches);
  });
  database.ForEachTwoViewGeometry([&](uint32_t id1, uint32_t id2, const TwoViewGeometry& geometry) {
    std::optional<Eigen::Vector4d> wxyz;
    std::optional<Eigen::Vector3d> translation;
    if (geometry.cam2_from_cam1) {
      const Eigen::Quaterniond& q = geometry.cam2_from_cam1->rotation;
      wxyz = Eigen::Vector4d(q.w(), q.x(), q.y(), q.z());
      translation = geometry.cam2_from_cam1->translation;
    }
    root["geometries"][name(id1, id2)] = {{"config", static_cast<int>(geometry.config)},
                                          {"inlier_matches", Pairs(geometry.inlier_matches)},
                                          {"F", RowsOrNull(geometry.F)},
                                          {"E", RowsOrNull(geometry.E)},
                                          {"H", RowsOrNull(geometry.H)},
                                          {"qvec", RowsOrNull(wxyz)},
                                          {"tvec", RowsOrNull(translation)}};
  });
  return root;
}

int Main(const std::string& action, const std::string& path) {
  if (action == "create") {
    ColmapDatabase::WriteAtomically(path, Fill);
  } else if (action == "extend") {
    ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadWrite);
    Extend(database);
    database.Close();
  } else if (action == "dump") {
    std::cout << Dump(ColmapDatabase::Open(path, Access::kReadOnly)) << "\n";
  } else {
    return 2;
  }
  return 0;
}

}  // namespace
}  // namespace s2gs

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  try {
    return s2gs::Main(argv[1], argv[2]);
  } catch (const s2gs::UserError& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
