// COLMAP's own programs read the depth maps, normal maps, images and fused clouds that we write, and we read
// what they write. Needs the `colmap` executable; nothing here needs a GPU.

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "mesh/surface/triangle_mesh.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/scene/io/colmap_fused.h"
#include "sfm_split/scene/io/colmap_maps.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr int kNumImages = 12;
constexpr int kWidth = 160;
constexpr int kHeight = 120;
constexpr double kFocal = 220;
constexpr double kDistance = 4;

testing::AssertionResult RunColmap(const std::string& arguments, const fs::path& log) {
  const std::string command =
      "QT_QPA_PLATFORM=offscreen colmap " + arguments + " > '" + log.string() + "' 2>&1";
  if (std::system(command.c_str()) == 0) return testing::AssertionSuccess();
  std::ifstream stream(log);
  return testing::AssertionFailure() << command << '\n' << stream.rdbuf();
}

// A unit sphere about the origin, seen by a ring of cameras.
struct Camera {
  Eigen::Matrix3d cam_from_world;
  Eigen::Vector3d center_in_cam;  // of the sphere: also the pose's translation
};

Camera RingCamera(int index) {
  const double angle = 2 * kPi * index / kNumImages;
  const Eigen::Vector3d position =
      kDistance * Eigen::Vector3d(std::cos(angle), std::sin(angle), .3 * (index % 3 - 1)).normalized();
  Camera camera;
  const Eigen::Vector3d forward = -position.normalized();
  const Eigen::Vector3d right = forward.cross(Eigen::Vector3d::UnitZ()).normalized();
  camera.cam_from_world << right.transpose(), forward.cross(right).transpose(), forward.transpose();
  camera.center_in_cam = -camera.cam_from_world * position;
  return camera;
}

// COLMAP wants single blanks.
const Eigen::IOFormat kRow(Eigen::FullPrecision, Eigen::DontAlignCols, " ", " ");

std::string ImageName(int index) { return "view" + std::to_string(index) + ".png"; }

class MapsInterop : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    has_colmap_ = std::system("QT_QPA_PLATFORM=offscreen colmap help > /dev/null 2>&1") == 0;
  }

  void SetUp() override {
    if (!has_colmap_) GTEST_SKIP() << "no `colmap` on PATH";
    const testing::TestInfo& test = *testing::UnitTest::GetInstance()->current_test_info();
    folder_ = fs::path(testing::TempDir()) / (std::string("s2gs_maps_interop_") + test.name());
    fs::remove_all(folder_);
    for (const char* name : {"images", "sparse", "stereo/depth_maps", "stereo/normal_maps"}) {
      fs::create_directories(folder_ / name);
    }
  }
  void TearDown() override {
    if (!folder_.empty()) fs::remove_all(folder_);
  }

  // The dense workspace of the sphere. Map values are those on the ray through image position
  // (column + offset, row + offset).
  void WriteWorkspace(double offset) const {
    Image8 image{kWidth, kHeight, 3, {}};
    for (int i = 0; i < kWidth * kHeight; ++i) image.pixels.insert(image.pixels.end(), {200, 100, 50});
    std::ofstream fusion_list(folder_ / "stereo/fusion.cfg");
    for (int i = 0; i < kNumImages; ++i) {
      WriteImage(folder_ / "images" / ImageName(i), image);
      WriteMaps(i, offset);
      fusion_list << ImageName(i) << '\n';
    }
    WriteSparseModel();
  }

  void WriteMaps(int index, double offset) const {
    const Eigen::Vector3d center = RingCamera(index).center_in_cam;
    ColmapMap depths{kWidth, kHeight, 1, std::vector<float>(kWidth * kHeight)};
    ColmapMap normals{kWidth, kHeight, 3, std::vector<float>(3 * kWidth * kHeight)};
    for (int row = 0; row < kHeight; ++row) {
      for (int column = 0; column < kWidth; ++column) {
        const Eigen::Vector3d ray((column + offset - .5 * kWidth) / kFocal,
                                  (row + offset - .5 * kHeight) / kFocal, 1);
        // |depth * ray - center| = 1
        const double half = ray.dot(center) / ray.squaredNorm();
        const double root = half * half - (center.squaredNorm() - 1) / ray.squaredNorm();
        if (root <= 0) continue;
        const double depth = half - std::sqrt(root);
        depths.At(column, row) = static_cast<float>(depth);
        const Eigen::Vector3d normal = depth * ray - center;
        for (int c = 0; c < 3; ++c) normals.At(column, row, c) = static_cast<float>(normal[c]);
      }
    }
    const std::string name = ImageName(index) + ".geometric.bin";
    WriteColmapMap(folder_ / "stereo/depth_maps" / name, depths);
    WriteColmapMap(folder_ / "stereo/normal_maps" / name, normals);
  }

  // Points all around, each in the track of the images that face it: fusion takes the images' overlap from
  // it.
  void WriteSparseModel() const {
    std::ofstream cameras(folder_ / "sparse/cameras.txt");
    cameras << "1 PINHOLE " << kWidth << ' ' << kHeight << ' ' << kFocal << ' ' << kFocal << ' '
            << .5 * kWidth << ' ' << .5 * kHeight << '\n';
    std::vector<Eigen::Vector3d> points;
    for (int i = 0; i < 200; ++i) {
      const double z = 1 - (i + .5) / 100;
      const double angle = i * kPi * (3 - std::sqrt(5.0));
      points.emplace_back(std::sqrt(1 - z * z) * std::cos(angle), std::sqrt(1 - z * z) * std::sin(angle), z);
    }
    std::vector<std::string> tracks(points.size());
    std::ofstream images(folder_ / "sparse/images.txt");
    images.precision(17);
    for (int i = 0; i < kNumImages; ++i) {
      const Camera camera = RingCamera(i);
      const Eigen::Quaterniond q(camera.cam_from_world);
      images << i + 1 << ' ' << q.w() << ' ' << q.x() << ' ' << q.y() << ' ' << q.z() << ' '
             << camera.center_in_cam.transpose().format(kRow) << " 1 " << ImageName(i) << '\n';
      int num_keypoints = 0;
      for (size_t p = 0; p < points.size(); ++p) {
        const Eigen::Vector3d x_in_cam = camera.cam_from_world * points[p] + camera.center_in_cam;
        if (x_in_cam.dot(camera.cam_from_world * points[p]) > -1) continue;
        images << kFocal * x_in_cam.x() / x_in_cam.z() + .5 * kWidth << ' '
               << kFocal * x_in_cam.y() / x_in_cam.z() + .5 * kHeight << ' ' << p + 1 << ' ';
        tracks[p] += ' ' + std::to_string(i + 1) + ' ' + std::to_string(num_keypoints++);
      }
      images << '\n';
    }
    std::ofstream points_file(folder_ / "sparse/points3D.txt");
    for (size_t p = 0; p < points.size(); ++p) {
      if (!tracks[p].empty())
        points_file << p + 1 << ' ' << points[p].transpose().format(kRow) << " 9 9 9 0" << tracks[p] << '\n';
    }
  }

  ColmapFusedCloud Fuse() const {
    EXPECT_TRUE(RunColmap("stereo_fusion --workspace_path '" + folder_.string() + "' --output_path '" +
                              (folder_ / "fused.ply").string() +
                              "' --StereoFusion.min_num_pixels 3 --StereoFusion.num_threads 1",
                          folder_ / "log"));
    return ReadColmapFusedCloud(folder_ / "fused.ply");
  }

  static bool has_colmap_;
  fs::path folder_;
};

bool MapsInterop::has_colmap_ = false;

double RmsRadiusError(const std::vector<Eigen::Vector3f>& points) {
  double sum = 0;
  for (const Eigen::Vector3f& point : points) sum += std::pow(point.cast<double>().norm() - 1, 2);
  return std::sqrt(sum / static_cast<double>(points.size()));
}

TEST_F(MapsInterop, ColmapFusesOurMapsAndWeReadTheCloud) {
  WriteWorkspace(0);
  const ColmapFusedCloud cloud = Fuse();
  ASSERT_GT(cloud.points.size(), 5000u);
  EXPECT_LT(RmsRadiusError(cloud.points), 2e-3);  // measured: 1.1e-3, a third of half a pixel
  double worst_cosine = 1;
  for (size_t i = 0; i < cloud.points.size(); ++i) {
    EXPECT_EQ(cloud.colors[i], (Eigen::Matrix<uint8_t, 3, 1>(200, 100, 50)));
    worst_cosine = std::min(worst_cosine, double{cloud.normals[i].dot(cloud.points[i].normalized())});
    const auto begin = cloud.visibility.image_indices.begin();
    EXPECT_GE(cloud.visibility.begins[i + 1] - cloud.visibility.begins[i], 1u);
    for (uint64_t j = cloud.visibility.begins[i]; j < cloud.visibility.begins[i + 1]; ++j) {
      // Image indices count from 0 in the order of the images file, and every such camera faces the point.
      ASSERT_LT(begin[j], static_cast<uint32_t>(kNumImages));
      const Camera camera = RingCamera(static_cast<int>(begin[j]));
      const Eigen::Vector3d point = cloud.points[i].cast<double>();
      const Eigen::Vector3d x_in_cam = camera.cam_from_world * point + camera.center_in_cam;
      EXPECT_LT(x_in_cam.dot(camera.cam_from_world * point), .1) << i;
    }
  }
  EXPECT_GT(worst_cosine, .999);
}

// stereo_fusion takes a map's column and row as the image position, without the half pixel to a pixel's
// centre: maps rendered at pixel centres come out shifted by half a pixel.
TEST_F(MapsInterop, FusionPlacesMapValuesAtPixelCorners) {
  WriteWorkspace(0);
  const double corners = RmsRadiusError(Fuse().points);
  WriteWorkspace(.5);
  const double centers = RmsRadiusError(Fuse().points);
  EXPECT_LT(2 * corners, centers);  // measured: 1.1e-3 and 3.7e-3
}

TEST_F(MapsInterop, ColmapMeshesOurCloudAndWeReadTheMesh) {
  ColmapFusedCloud cloud;
  constexpr int kNumPoints = 20000;
  for (int i = 0; i < kNumPoints; ++i) {
    const double z = 1 - 2 * (i + .5) / kNumPoints;
    const double angle = i * kPi * (3 - std::sqrt(5.0));
    cloud.points.emplace_back(std::sqrt(1 - z * z) * std::cos(angle), std::sqrt(1 - z * z) * std::sin(angle),
                              z);
    cloud.normals.push_back(cloud.points.back());
    cloud.colors.emplace_back(10, 20, 30);
    cloud.visibility.image_indices.push_back(0);
    cloud.visibility.begins.push_back(i + 1);
  }
  WriteColmapFusedCloud(folder_ / "cloud.ply", cloud);
  ASSERT_TRUE(
      RunColmap("poisson_mesher --input_path '" + (folder_ / "cloud.ply").string() + "' --output_path '" +
                    (folder_ / "mesh.ply").string() +
                    "' --PoissonMeshing.depth 6 --PoissonMeshing.trim 0 --PoissonMeshing.num_threads 1",
                folder_ / "log"));
  const TriangleMesh mesh = ReadPlyMesh(folder_ / "mesh.ply");
  ASSERT_GT(mesh.vertices.size(), 1000u);
  EXPECT_LT(RmsRadiusError(mesh.vertices), 1e-3);  // measured: 2.4e-4
  // A closed surface of genus 0.
  EXPECT_EQ(mesh.triangles.size(), 2 * mesh.vertices.size() - 4);
  double volume = 0;
  for (const auto& triangle : mesh.triangles) {
    volume +=
        double{mesh.vertices[triangle[0]].dot(mesh.vertices[triangle[1]].cross(mesh.vertices[triangle[2]]))} /
        6;
  }
  EXPECT_NEAR(volume, 4 * kPi / 3, .01);
}

}  // namespace
}  // namespace s2gs
