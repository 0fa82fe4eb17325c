#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <regex>
#include <sstream>
#include <string>
#include <vector>

#include "plugin/outputs/camera_export.h"
#include "plugin/outputs/splat_export.h"
#include "sfm_split/base/error.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

// A lens with all terms, and a camera that looks at the origin from aside.
ColmapModel OneCamera() {
  ColmapModel model;
  model.cameras[3] = {3, CameraModelId::kOpenCV, 640, 480, {500, 510, 330, 235, -0.08, 0.02, 0.003, -0.002}};
  ColmapImage image;
  image.image_id = 7;
  image.name = "sub/a&b.jpg";
  image.camera_id = 3;
  image.cam_from_world.rotation = Eigen::Quaterniond(0.9, 0.1, -0.3, 0.2).normalized();
  image.cam_from_world.translation = {0.1, -0.2, 4};
  model.images[7] = image;
  model.points3D[1].xyz = {0.3, 0.2, -0.1};
  model.points3D[1].rgb = {1, 2, 3};
  return model;
}

const std::vector<Eigen::Vector3d>& Points() {
  static const std::vector<Eigen::Vector3d> points = {{0, 0, 0}, {0.5, -0.4, 0.3}, {-0.7, 0.6, -0.2}};
  return points;
}

Eigen::Vector2d Seen(const ColmapModel& model, const Eigen::Vector3d& point) {
  const ColmapImage& image = model.images.at(7);
  return *ProjectToImage(model.cameras.at(3), image.cam_from_world * point);
}

// By OpenCV's documented equations and NeRF's axes (x right, y up, z backwards).
TEST(NerfTransforms, ProjectsAsTheModelDoes) {
  const ColmapModel model = OneCamera();
  const auto json = NerfTransforms(model, {"../photos/", "../masks/", "points.ply"}, "model");
  const auto& frame = json.at("frames").at(0);
  EXPECT_EQ(frame.at("file_path"), "../photos/sub/a&b.jpg");
  EXPECT_EQ(frame.at("mask_path"), "../masks/sub/a&b.jpg.png");
  EXPECT_EQ(json.at("camera_model"), "OPENCV");
  Eigen::Matrix4d world_from_camera;
  for (int i = 0; i < 16; ++i)
    world_from_camera(i / 4, i % 4) = frame.at("transform_matrix").at(i / 4).at(i % 4);
  const auto value = [&](const char* name) { return frame.at(name).get<double>(); };
  for (const Eigen::Vector3d& point : Points()) {
    const Eigen::Vector4d camera = world_from_camera.inverse() * point.homogeneous();
    const double x = camera.x() / -camera.z();
    const double y = -camera.y() / -camera.z();
    const double r2 = x * x + y * y;
    const double radial = 1 + value("k1") * r2 + value("k2") * r2 * r2;
    const double u = x * radial + 2 * value("p1") * x * y + value("p2") * (r2 + 2 * x * x);
    const double v = y * radial + value("p1") * (r2 + 2 * y * y) + 2 * value("p2") * x * y;
    const Eigen::Vector2d seen(value("fl_x") * u + value("cx"), value("fl_y") * v + value("cy"));
    EXPECT_LT((seen - Seen(model, point)).norm(), 1e-9);
  }
}

// By the equations of Metashape's manual, appendix D.
TEST(MetashapeCameras, ProjectAsTheModelDoes) {
  const ColmapModel model = OneCamera();
  std::ostringstream stream;
  WriteMetashapeCameras(model, "model", stream);
  const std::string xml = stream.str();
  EXPECT_NE(xml.find("label=\"a&amp;b\""), std::string::npos);
  const auto text = [&](const std::string& tag) {
    std::smatch found;
    EXPECT_TRUE(std::regex_search(xml, found, std::regex("<" + tag + ">([^<]*)</" + tag + ">"))) << tag;
    return found[1].str();
  };
  const auto value = [&](const char* tag) { return std::stod(text(tag)); };
  Eigen::Matrix4d chunk_from_camera;
  std::istringstream numbers(text("transform"));
  for (int i = 0; i < 16; ++i) numbers >> chunk_from_camera(i / 4, i % 4);
  for (const Eigen::Vector3d& point : Points()) {
    const Eigen::Vector4d camera = chunk_from_camera.inverse() * point.homogeneous();
    const double x = camera.x() / camera.z();
    const double y = camera.y() / camera.z();
    const double r2 = x * x + y * y;
    const double radial = 1 + value("k1") * r2 + value("k2") * r2 * r2;
    const double p1 = value("p1");
    const double p2 = value("p2");
    const double xd = x * radial + (p1 * (r2 + 2 * x * x) + 2 * p2 * x * y);
    const double yd = y * radial + (p2 * (r2 + 2 * y * y) + 2 * p1 * x * y);
    const Eigen::Vector2d seen(640 * 0.5 + value("cx") + xd * value("f") + xd * value("b1"),
                               480 * 0.5 + value("cy") + yd * value("f"));
    EXPECT_LT((seen - Seen(model, point)).norm(), 1e-9);
  }
}

TEST(CameraExport, LensesThatCannotBeSaidAreRefused) {
  ColmapModel model = OneCamera();
  model.cameras[3].model = CameraModelId::kOpenCVFisheye;
  std::ostringstream stream;
  EXPECT_THROW(NerfTransforms(model, {}, "model"), UserError);
  EXPECT_THROW(WriteMetashapeCameras(model, "model", stream), UserError);
}

uint32_t Word(const std::string& bytes, size_t at) {
  uint32_t word = 0;
  std::memcpy(&word, bytes.data() + at, 4);
  return word;
}

// The values of an attribute, by glTF's own rules.
std::vector<float> Attribute(const nlohmann::json& json, const std::string& binary, const std::string& name) {
  const auto& accessor =
      json.at("accessors")
          .at(json.at("meshes")[0].at("primitives")[0].at("attributes").at(name).get<size_t>());
  const auto& view = json.at("bufferViews").at(accessor.at("bufferView").get<size_t>());
  std::vector<float> values(view.at("byteLength").get<size_t>() / 4);
  std::memcpy(values.data(), binary.data() + view.at("byteOffset").get<size_t>(), 4 * values.size());
  return values;
}

TEST(GaussianGlb, HoldsTheObjectAlone) {
  Gaussians gaussians;
  gaussians.Resize(3);
  gaussians.sh_degree = 1;
  for (size_t i = 0; i < 3; ++i) {
    gaussians.foreground_logit[i] = i == 1 ? -5.0F : 5.0F;
    for (size_t c = 0; c < 3; ++c) {
      gaussians.centre[3 * i + c] = static_cast<float>(10 * i + c);
      gaussians.sh_dc[3 * i + c] = static_cast<float>(i) - 0.1F * static_cast<float>(c);
    }
    for (size_t k = 0; k < 45; ++k) gaussians.sh_rest[45 * i + k] = static_cast<float>(100 * i + k);
    gaussians.log_scale[2 * i] = std::log(2.0F);
    gaussians.log_scale[2 * i + 1] = std::log(0.5F);
    gaussians.rotation[4 * i] = 2;  // of any length
    gaussians.opacity_logit[i] = 0;
  }
  std::ostringstream stream;
  WriteGaussianGlb(gaussians, "a.glb", stream);
  const std::string file = stream.str();
  ASSERT_EQ(Word(file, 0), 0x46546C67U);
  ASSERT_EQ(Word(file, 8), file.size());
  const nlohmann::json json = nlohmann::json::parse(file.substr(20, Word(file, 12)));
  const std::string binary = file.substr(20 + Word(file, 12) + 8);
  EXPECT_EQ(json.at("extensionsUsed")[0], "KHR_gaussian_splatting");
  const std::string prefix = "KHR_gaussian_splatting:";
  EXPECT_EQ(Attribute(json, binary, "POSITION"), (std::vector<float>{0, 1, 2, 20, 21, 22}));
  EXPECT_EQ(Attribute(json, binary, prefix + "ROTATION"), (std::vector<float>{0, 0, 0, 1, 0, 0, 0, 1}));
  EXPECT_EQ(Attribute(json, binary, prefix + "OPACITY"), (std::vector<float>{0.5F, 0.5F}));
  const std::vector<float> scales = Attribute(json, binary, prefix + "SCALE");
  EXPECT_FLOAT_EQ(scales[0], 2);
  EXPECT_FLOAT_EQ(scales[1], 0.5F);
  EXPECT_LT(scales[2], 1e-6F);
  EXPECT_EQ(Attribute(json, binary, prefix + "SH_DEGREE_1_COEF_2"),
            (std::vector<float>{6, 7, 8, 206, 207, 208}));
  EXPECT_FALSE(
      json.at("meshes")[0].at("primitives")[0].at("attributes").contains(prefix + "SH_DEGREE_2_COEF_0"));
  std::fill(gaussians.foreground_logit.begin(), gaussians.foreground_logit.end(), -5.0F);
  EXPECT_THROW(WriteGaussianGlb(gaussians, "a.glb", stream), UserError);
}

}  // namespace
}  // namespace s2gs
