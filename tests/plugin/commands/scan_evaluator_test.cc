#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>

#include "mesh/surface/triangle_mesh.h"
#include "plugin/commands/scan_evaluator_command.h"
#include "plugin/evaluation/scan_evaluation.h"
#include "plugin/stage/workspace.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "sfm_split/scene/pose_error.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Eigen::AngleAxisd;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using Json = nlohmann::json;
using testing::HasSubstr;

constexpr int kSize = 64;
constexpr double kFocal = 80;

// A camera at `centre` that looks at the origin, its x axis level.
Rigid3 LookAtOrigin(const Vector3d& centre) {
  Eigen::Matrix3d cam_from_world;
  const Vector3d z = -centre.normalized();
  const Vector3d x = z.cross(Vector3d::UnitZ()).normalized();
  cam_from_world << x.transpose(), z.cross(x).transpose(), z.transpose();
  return {Quaterniond(cam_from_world), -(cam_from_world * centre)};
}

Json Rows(const Rigid3& transform) {
  Json rows = Json::array();
  for (int i = 0; i < 4; ++i) {
    const Eigen::RowVector4d row = transform.Matrix().row(i);
    rows.push_back({row[0], row[1], row[2], row[3]});
  }
  return rows;
}

// The unit cube around the origin.
TriangleMesh Cube() {
  TriangleMesh mesh;
  for (int i = 0; i < 8; ++i) {
    mesh.vertices.emplace_back((i & 1) - 0.5f, ((i >> 1) & 1) - 0.5f, ((i >> 2) & 1) - 0.5f);
  }
  mesh.triangles = {{0, 2, 1}, {1, 2, 3}, {4, 5, 6}, {5, 7, 6}, {0, 1, 4}, {1, 5, 4},
                    {2, 6, 3}, {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
  return mesh;
}

// A data set of a cube that turns, and a perfect workspace in frames of its own.
class ScanEvaluator : public ::testing::Test {
 protected:
  struct Image {
    std::string name;
    int station;
    double angle_deg;
    Rigid3 cam_from_world;
    Rigid3 world_from_object;
  };

  void SetUp() override {
    const std::vector<Vector3d> stations = {{4, 0, 1}, {4, 0.5, 2}, {3.5, -1, 3}};
    for (int station = 0; station < 3; ++station) {
      for (int step = 0; step < 5; ++step) {
        images_.push_back(
            {std::to_string(station) + "_" + std::to_string(step) + ".png",
             station,
             72.0 * step,
             LookAtOrigin(stations[station]),
             {Quaterniond(AngleAxisd(72 * step * kPi / 180, Vector3d::UnitZ())), Vector3d::Zero()}});
      }
    }
    workspace_.root = folder_ / "scan";
    fs::create_directories(workspace_.root);
  }

  fs::path Scene() const { return folder_ / "scene"; }

  void WriteTruth() {
    Json scene = {{"scene", "cube"},
                  {"units", "metres"},
                  {"width", kSize},
                  {"height", kSize},
                  {"camera_model", "SIMPLE_PINHOLE"},
                  {"pixel_convention", "COLMAP"},
                  {"fx", kFocal},
                  {"fy", kFocal},
                  {"cx", kSize / 2},
                  {"cy", kSize / 2},
                  {"axis_point", {0, 0, 0}},
                  {"axis_direction", {0, 0, 1}},
                  {"mask_values", {{"object", 255}, {"disc", 128}, {"static", 0}}},
                  {"images", Json::array()}};
    fs::create_directories(Scene() / "gt/masks");
    fs::create_directories(Scene() / "images");
    for (const Image& image : images_) {
      scene["images"].push_back({{"file", "images/" + image.name},
                                 {"mask", "gt/masks/" + image.name},
                                 {"split", "train"},
                                 {"station", image.station},
                                 {"angle_deg", image.angle_deg},
                                 {"world_to_camera", Rows(image.cam_from_world)},
                                 {"object_to_world", Rows(image.world_from_object)}});
      WriteImage(Scene() / "gt/masks" / image.name, Labels());
      WriteImage(Scene() / "images" / image.name, Photo(100));
    }
    WriteAll(Scene() / "gt/scene.json", scene.dump());
    WritePlyMesh(Scene() / "gt/object.ply", Cube());
  }

  // The left half object, one column disc.
  static Image8 Labels() {
    Image8 labels{kSize, kSize, 1, std::vector<uint8_t>(kSize * kSize)};
    for (int y = 0; y < kSize; ++y) {
      for (int x = 0; x <= kSize / 2; ++x) *labels.Pixel(x, y) = x < kSize / 2 ? 255 : 128;
    }
    return labels;
  }
  static Image8 Photo(uint8_t grey) {
    return {kSize, kSize, 3, std::vector<uint8_t>(kSize * kSize * 3, grey)};
  }

  void WriteModel(const fs::path& folder, const Sim3& truth_from_model, bool is_object, size_t num_images) {
    ColmapModel model;
    model.cameras[1] = {1, CameraModelId::kSimplePinhole, kSize, kSize, {kFocal, kSize / 2, kSize / 2}};
    for (uint32_t i = 0; i < num_images; ++i) {
      const Image& image = images_[i];
      const Rigid3 truth = is_object ? image.cam_from_world * image.world_from_object : image.cam_from_world;
      const Quaterniond rotation = truth.rotation * truth_from_model.rotation;
      const Vector3d centre = truth_from_model.Inverse() * CameraCentre(truth);
      model.images[i + 1] = {i + 1, image.name, 1, {rotation, -(rotation * centre)}, {}};
    }
    WriteColmapModel(folder, model, ColmapFormat::kBinary);
  }

  void WriteTurntable() {
    TurntableFile file;
    file.num_stations = 3;
    file.scale_observable = true;
    // In the object model's frame, where the cube's axis is not z.
    file.axis.direction = truth_from_object_.rotation.conjugate() * Vector3d::UnitZ();
    file.axis.point = truth_from_object_.Inverse() * Vector3d(0, 0, 3);
    for (const Image& image : images_) {
      const Quaterniond turn = truth_from_object_.rotation.conjugate() * image.world_from_object.rotation *
                               truth_from_object_.rotation;
      file.images.push_back(
          {image.name, image.station, image.angle_deg, {turn, file.axis.point - turn * file.axis.point}});
    }
    WriteTurntableFile(workspace_.Turntable(), file);
  }

  void WriteMesh(const TriangleMesh& truth) {
    TriangleMesh mesh = truth;
    for (Eigen::Vector3f& vertex : mesh.vertices) {
      vertex = (truth_from_object_.Inverse() * vertex.cast<double>()).cast<float>();
    }
    fs::create_directories(workspace_.Dense());
    WritePlyMesh(workspace_.TsdfMesh(), mesh);
  }

  void WriteMasks() {
    Image8 mask = Labels();
    for (uint8_t& value : mask.pixels) value = value > 0 ? 255 : 0;
    fs::create_directories(workspace_.Masks());
    for (const Image& image : images_) WriteImage(workspace_.Mask(image.name), mask);
  }

  void WriteEverything() {
    WriteTruth();
    WriteModel(workspace_.ObjectModel(), truth_from_object_, true, images_.size());
    WriteModel(workspace_.StaticModel(), truth_from_static_, false, images_.size());
    WriteTurntable();
    WriteMasks();
    WriteMesh(Cube());
  }

  // Runs the command; the table goes to out_.
  void Run(std::vector<std::string> arguments) {
    std::ostringstream out;
    CommandContext context("scan_evaluator", std::move(arguments), out);
    try {
      RunScanEvaluator(context);
    } catch (...) {
      out_ = out.str();
      throw;
    }
    out_ = out.str();
  }

  Json RunOnWorkspace(const std::vector<std::string>& more = {}) {
    const fs::path json = folder_ / "figures.json";
    std::vector<std::string> arguments = {"--workspace_path",
                                          workspace_.root.string(),
                                          "--ground_truth_path",
                                          Scene().string(),
                                          "--json_path",
                                          json.string(),
                                          "--csv_path",
                                          (folder_ / "figures.csv").string(),
                                          "--Mesh.num_samples",
                                          "20000",
                                          "--Mesh.num_truth_samples",
                                          "50000",
                                          "--log_level",
                                          "error"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    Run(std::move(arguments));
    return Json::parse(ReadAll(json));
  }

  TemporaryFolder folder_;
  Workspace workspace_;
  std::vector<Image> images_;
  Sim3 truth_from_object_{0.5, Quaterniond(AngleAxisd(0.7, Vector3d(1, 2, 3).normalized())), {1, 2, 3}};
  // The background's scale is 2 % larger.
  Sim3 truth_from_static_{0.51, Quaterniond(AngleAxisd(-1.1, Vector3d(3, 1, 0).normalized())), {-1, 0, 3}};
  std::string out_;
};

TEST_F(ScanEvaluator, PerfectWorkspace) {
  WriteEverything();
  const Json result = RunOnWorkspace();
  EXPECT_EQ(result.at("missing"), Json::object()) << result.at("missing");
  const Json& figures = result.at("figures");
  for (const char* name :
       {"object_rot_deg", "object_centre_pct", "static_rot_deg", "static_centre_pct", "angle_deg"}) {
    EXPECT_LT(figures.at(name).at("max").get<double>(), 1e-9) << name;
  }
  for (const char* name : {"axis_deg", "axis_offset_pct"}) {
    EXPECT_LT(figures.at(name).at("value").get<double>(), 1e-9) << name;
  }
  EXPECT_NEAR(figures.at("scale_err_pct").at("value").get<double>(), 100 * (1 - 0.5 / 0.51), 1e-9);
  EXPECT_NEAR(figures.at("object_auc").at("at_0.5").get<double>(), 1, 1e-9);
  for (const char* name : {"registered", "static_registered", "angle_images", "mask_images"}) {
    EXPECT_EQ(figures.at(name).at("value"), 15) << name;
    EXPECT_EQ(figures.at(name).at("of"), 15) << name;
  }
  EXPECT_EQ(figures.at("mask_iou").at("mean"), 1);
  EXPECT_EQ(figures.at("object_iou").at("min"), 1);
  EXPECT_EQ(figures.at("faces").at("value"), 12);
  EXPECT_EQ(figures.at("outside_box_pct").at("value"), 0);
  // What is left is the rounding of the mesh's vertices to float, of a size of 3 units at a diameter of 3.46.
  EXPECT_LT(figures.at("chamfer_pct").at("value").get<double>(), 1e-5);
  for (const char* name : {"f1_0.5pct", "f1_1pct", "f1_2pct"})
    EXPECT_EQ(figures.at(name).at("value"), 1) << name;
  // Sampling alone: an area of 6, 20,000 and 50,000 points: about 1 / (2 sqrt(density)) of the diagonal.
  const double to_truth = 100 / std::sqrt(3.0) / (2 * std::sqrt(50'000 / 6.0));
  EXPECT_NEAR(figures.at("accuracy_sampled_pct").at("value").get<double>(), to_truth, 0.05 * to_truth);
  EXPECT_EQ(figures.at("f1_sampled_2pct").at("value"), 1);
  EXPECT_THAT(out_, HasSubstr("object_rot_deg"));
  EXPECT_THAT(ReadAll(folder_ / "figures.csv"), HasSubstr("mask_iou,mean,1,,\n"));
}

// A plate of the area of one side floats half a side above the cube: a seventh of the surface, at a distance
// of 1/2; and cut off by a box it is nothing.
TEST_F(ScanEvaluator, WhatFloatsIsMeasuredUnlessItIsCutOff) {
  WriteEverything();
  TriangleMesh mesh = Cube();
  const auto first = static_cast<uint32_t>(mesh.vertices.size());
  for (const auto& [x, y] :
       {std::pair(-0.5F, -0.5F), std::pair(0.5F, -0.5F), std::pair(0.5F, 0.5F), std::pair(-0.5F, 0.5F)}) {
    mesh.vertices.emplace_back(x, y, 1.0F);
  }
  mesh.triangles.emplace_back(first, first + 1, first + 2);
  mesh.triangles.emplace_back(first, first + 2, first + 3);
  mesh.triangles.emplace_back(first, first, first);  // without area
  WriteMesh(mesh);
  const auto value = [](const Json& result, const char* figure, const char* statistic = "value") {
    return result.at("figures").at(figure).at(statistic).get<double>();
  };
  const double diameter = std::sqrt(3.0);
  const Json all = RunOnWorkspace();
  EXPECT_EQ(value(all, "faces"), 15);
  EXPECT_EQ(value(all, "unusable_faces"), 1);
  // Of 20,000 samples: a standard deviation of .25 %.
  EXPECT_NEAR(value(all, "outside_box_pct"), 100 / 7.0, 1);
  EXPECT_NEAR(value(all, "accuracy_pct"), 100 * 0.5 / 7 / diameter, 0.3);
  EXPECT_LT(value(all, "completeness_pct"), 1e-5);
  EXPECT_NEAR(value(all, "chamfer_pct"), (value(all, "accuracy_pct") + value(all, "completeness_pct")) / 2,
              1e-12);
  EXPECT_NEAR(value(all, "f1_2pct", "precision"), 6 / 7.0, 0.01);
  EXPECT_EQ(value(all, "f1_2pct", "recall"), 1);
  EXPECT_NEAR(value(all, "f1_2pct"), 2 * (6 / 7.0) / (1 + 6 / 7.0), 0.01);
  const Json cut = RunOnWorkspace({"--Mesh.crop_min=-0.6,-0.6,-0.6", "--Mesh.crop_max=0.6,0.6,0.6"});
  EXPECT_EQ(value(cut, "outside_box_pct"), 0);
  EXPECT_LT(value(cut, "accuracy_pct"), 1e-5);
  EXPECT_EQ(value(cut, "f1_2pct"), 1);
}

TEST_F(ScanEvaluator, TheSameSeedGivesTheSameFigures) {
  WriteEverything();
  EXPECT_EQ(RunOnWorkspace(), RunOnWorkspace());
}

TEST_F(ScanEvaluator, AnEmptyWorkspaceIsAnErrorThatListsWhatIsMissing) {
  WriteTruth();
  ExpectUserError([&] { RunOnWorkspace(); }, {workspace_.root.string(), "nothing could be measured"});
  for (const char* reason : {"missing: no sparse/0", "missing: no sparse/static",
                             "missing: no turntable.json", "missing: no masks", "meshed-tsdf.ply"}) {
    EXPECT_THAT(out_, HasSubstr(reason));
  }
}

TEST_F(ScanEvaluator, AWorkspaceThatIsNoFolderIsNamed) {
  WriteTruth();
  workspace_.root = workspace_.root / "none";
  ExpectUserError([&] { RunOnWorkspace(); }, {(workspace_.root).string(), "no such folder"});
}

TEST_F(ScanEvaluator, OneStation) {
  for (Image& image : images_) image.cam_from_world = images_[0].cam_from_world;
  WriteEverything();
  const Json result = RunOnWorkspace();
  EXPECT_THAT(result.at("missing").at("static_rot_deg").get<std::string>(), HasSubstr("stand at one place"));
  EXPECT_THAT(result.at("missing").at("scale_err_pct").get<std::string>(), HasSubstr("stand at one place"));
  EXPECT_LT(result.at("figures").at("object_rot_deg").at("max").get<double>(), 1e-9);
  EXPECT_LT(result.at("figures").at("axis_deg").at("value").get<double>(), 1e-9);
}

TEST_F(ScanEvaluator, TwoStationsHaveAScaleButNoRotation) {
  for (Image& image : images_) image.cam_from_world = images_[image.station == 0 ? 0 : 5].cam_from_world;
  WriteEverything();
  const Json result = RunOnWorkspace();
  EXPECT_THAT(result.at("missing").at("static_rot_deg").get<std::string>(), HasSubstr("two places"));
  EXPECT_NEAR(result.at("figures").at("scale_err_pct").at("value").get<double>(), 100 * (1 - 0.5 / 0.51),
              1e-9);
}

TEST_F(ScanEvaluator, OneAndTwoImages) {
  WriteTruth();
  WriteMesh(Cube());
  WriteModel(workspace_.ObjectModel(), truth_from_object_, true, 1);
  Json result = RunOnWorkspace();
  EXPECT_EQ(result.at("figures").at("registered").at("value"), 1);
  EXPECT_THAT(result.at("missing").at("object_rot_deg").get<std::string>(), HasSubstr("one image only"));
  EXPECT_THAT(result.at("missing").at("chamfer_pct").get<std::string>(), HasSubstr("no poses to align with"));
  WriteModel(workspace_.ObjectModel(), truth_from_object_, true, 2);
  result = RunOnWorkspace();
  EXPECT_THAT(result.at("missing").at("object_rot_deg").get<std::string>(), HasSubstr("one line"));
}

TEST_F(ScanEvaluator, DamagedFilesAreMissingWithTheReason) {
  WriteEverything();
  WriteAll(workspace_.ObjectModel() / "images.bin", "xx");
  WriteAll(workspace_.Turntable(), "{");
  WriteAll(workspace_.TsdfMesh(), "ply");
  WriteAll(workspace_.Mask(images_[0].name), "not a png");
  const Json result = RunOnWorkspace();
  EXPECT_THAT(result.at("missing").at("object_rot_deg").get<std::string>(), HasSubstr("images.bin"));
  EXPECT_THAT(result.at("missing").at("angle_deg").get<std::string>(), HasSubstr("turntable.json"));
  EXPECT_THAT(result.at("missing").at("chamfer_pct").get<std::string>(), HasSubstr("meshed-tsdf.ply"));
  EXPECT_EQ(result.at("figures").at("mask_images").at("value"), 14);
  EXPECT_LT(result.at("figures").at("static_rot_deg").at("max").get<double>(), 1e-9);
}

TEST_F(ScanEvaluator, EmptyAndFlatMeshes) {
  WriteEverything();
  TriangleMesh mesh = Cube();
  mesh.triangles.clear();
  WriteMesh(mesh);
  Json result = RunOnWorkspace();
  EXPECT_EQ(result.at("figures").at("faces").at("value"), 0);
  EXPECT_EQ(result.at("missing").at("chamfer_pct"), "the mesh has no surface");
  mesh.triangles = {{0, 0, 1}, {2, 2, 2}};
  WriteMesh(mesh);
  result = RunOnWorkspace();
  EXPECT_EQ(result.at("figures").at("unusable_faces").at("value"), 2);
  EXPECT_EQ(result.at("missing").at("chamfer_pct"), "the mesh has no surface");
}

TEST_F(ScanEvaluator, UnreadableGroundTruthIsAnError) {
  ExpectUserError([&] { RunOnWorkspace(); }, {"scene.json", "no such file"});
  WriteEverything();
  WritePlyMesh(Scene() / "gt/object.ply", TriangleMesh());
  ExpectUserError([&] { RunOnWorkspace(); }, {"object.ply", "no extent"});
}

TEST_F(ScanEvaluator, RenderedImagesAgainstPhotosAndTheTruthsLabels) {
  WriteTruth();
  const fs::path rendered = folder_ / "rendered";
  fs::create_directories(rendered);
  Image8 image = Photo(100);
  for (int y = 0; y < kSize; ++y) {
    for (int c = 0; c < 3; ++c) image.Pixel(kSize - 1, y)[c] = 110;  // outside the labels.
  }
  WriteImage(rendered / images_[0].name, image);
  WriteImage(rendered / images_[1].name, Photo(101));
  WriteImage(rendered / "unknown.png", Photo(0));
  const fs::path json = folder_ / "figures.json";
  Run({"--images_path", rendered.string(), "--ground_truth_path", Scene().string(), "--json_path",
       json.string()});
  const Json figures = Json::parse(ReadAll(json)).at("figures");
  const double whole = 20 * std::log10(255.0);  // off by one everywhere
  const double column = 10 * std::log10(255.0 * 255.0 * kSize / 100);
  EXPECT_NEAR(figures.at("psnr_db").at("mean").get<double>(), (whole + column) / 2, 1e-9);
  EXPECT_NEAR(figures.at("psnr_db").at("min").get<double>(), std::min(whole, column), 1e-9);
  EXPECT_EQ(figures.at("mask_psnr_db").at("mean"), "inf");
  EXPECT_NEAR(figures.at("mask_psnr_db").at("min").get<double>(), whole, 1e-9);
  EXPECT_EQ(figures.at("image_pairs").at("value"), 2);
  EXPECT_EQ(figures.at("image_pairs").at("of"), 3);
  EXPECT_EQ(figures.at("mask_image_pairs").at("value"), 2);

  // Without ground truth: photos of another extension, and no masks.
  fs::create_directories(folder_ / "photos");
  WriteImage(folder_ / "photos/0_1.png", Photo(101));
  Run({"--images_path", rendered.string(), "--reference_path", (folder_ / "photos").string(), "--json_path",
       json.string(), "--output_path", (folder_ / "bare").string()});
  EXPECT_FALSE(fs::exists(folder_ / "bare.json"));
  EXPECT_THAT(ReadAll(folder_ / "bare.csv"), HasSubstr("image_pairs,value,1,"));
  const Json bare = Json::parse(ReadAll(json));
  EXPECT_EQ(bare.at("figures").at("psnr_db").at("mean"), "inf");
  EXPECT_EQ(bare.at("figures").at("image_pairs").at("value"), 1);
  EXPECT_THAT(bare.at("missing").at("mask_ssim").get<std::string>(), HasSubstr("no masks"));
}

// Before each mask and each image.
TEST_F(ScanEvaluator, StopsWhenItIsAskedTo) {
  class Stopping : public Reporter {
   public:
    bool StopRequested() const override { return true; }
  };
  WriteEverything();
  fs::create_directories(folder_ / "rendered");
  WriteImage(folder_ / "rendered" / images_[0].name, Photo(100));
  const SceneTruth truth = ReadScanTruth(Scene()).scene;
  Stopping stopping;
  Reporter patient;
  const auto evaluate = [&](Reporter& reporter) {
    Figures figures;
    EvaluateMasks(workspace_, truth, reporter, &figures);
    return figures.size();
  };
  const auto evaluate_images = [&](Reporter& reporter) {
    Figures figures;
    EvaluateImages({folder_ / "rendered", {}, {}}, &truth, reporter, &figures);
    return figures.size();
  };
  EXPECT_THROW(evaluate(stopping), Interrupted);
  EXPECT_THROW(evaluate_images(stopping), Interrupted);
  EXPECT_EQ(evaluate(patient), 3U);
  EXPECT_EQ(evaluate_images(patient), 7U);
}

TEST_F(ScanEvaluator, CombinationsThatMeasureNothingAreRefused) {
  EXPECT_THROW(Run({}), CommandLineError);
  EXPECT_THROW(Run({"--workspace_path", "x"}), CommandLineError);
  EXPECT_THROW(Run({"--images_path", "x"}), CommandLineError);
  EXPECT_THROW(Run({"--ground_truth_path", "x"}), CommandLineError);
  EXPECT_THROW(Run({"--images_path", "x", "--reference_path", "y", "--Mesh.crop_min", "0,0,0"}),
               CommandLineError);
  EXPECT_THROW(Run({"--images_path", "x", "--reference_path", "y", "--Mesh.thresholds_pct", "0"}),
               CommandLineError);
}

}  // namespace
}  // namespace s2gs
