#include "plugin/commands/model_scaler_command.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <vector>

#include "plugin/cli/options.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/scale/marker_sheet.h"
#include "sfm_split/scale/markers.h"
#include "sfm_split/scene/camera_model.h"
#include "tests/s2gs/turntable_workspace.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

// A square marker in the plane z = 0 of the object's frame, from its first corner on.
struct Printed {
  int id;
  double left, bottom, side;
};
// The second is printed 3 % too small.
constexpr std::array<Printed, 3> kMarkers = {
    {{4, -0.09, -0.04, 0.08}, {7, 0.01, -0.04, 0.0776}, {9, -0.05, 0.05, 0.08}}};
constexpr char kDictionary[] = "5X5";

// One station before a table, exact poses.
class ModelScaler : public testing::Test {
 protected:
  void SetUp() override {
    SyntheticTurntableOptions options;
    options.stations = 1;
    options.steps = 8;
    options.step_deg = 45;
    options.min_elevation_deg = options.max_elevation_deg = 50;
    options.num_object_points = options.num_platter_points = options.num_background_points = 20;
    table_ = MakeSyntheticTurntable(options);
  }
  void Write(bool with_markers) {
    WriteTurntableWorkspace(folder_.path(), table_, [&](int view) {
      return with_markers ? PhotoOfMarkers(view) : Image8{640, 480, 1, std::vector<uint8_t>(640 * 480, 200)};
    });
  }
  // Where the ray of a pixel meets the markers' plane.
  Image8 PhotoOfMarkers(int index) const {
    const Rigid3 object_from_cam = table_.scene.views[index].CamFromObject().Inverse();
    const Camera& camera = table_.CameraOf(index);
    std::vector<MarkerCells> cells;
    for (const Printed& marker : kMarkers) cells.push_back(CellsOfMarker(kDictionary, marker.id));
    Image8 photo{640, 480, 1, std::vector<uint8_t>(640 * 480, 200)};
    for (int y = 0; y < 480; ++y) {
      for (int x = 0; x < 640; ++x) {
        double sum = 0;
        for (const auto& [du, dv] :
             {std::pair(0.25, 0.25), std::pair(0.75, 0.25), std::pair(0.25, 0.75), std::pair(0.75, 0.75)}) {
          const Eigen::Vector3d ray =
              object_from_cam.rotation * Eigen::Vector3d((x + du - camera.params[1]) / camera.params[0],
                                                         (y + dv - camera.params[2]) / camera.params[0], 1);
          const Eigen::Vector3d at =
              object_from_cam.translation - object_from_cam.translation.z() / ray.z() * ray;
          double grey = 200;
          for (size_t m = 0; m < kMarkers.size(); ++m) {
            const Printed& marker = kMarkers[m];
            const int column =
                static_cast<int>(std::floor((at.x() - marker.left) / marker.side * cells[m].side));
            const int row = static_cast<int>(
                std::floor((marker.bottom + marker.side - at.y()) / marker.side * cells[m].side));
            if (column < 0 || row < 0 || column >= cells[m].side || row >= cells[m].side) continue;
            grey = cells[m].is_white[static_cast<size_t>(row) * cells[m].side + column] != 0 ? 200 : 20;
          }
          sum += grey / 4;
        }
        *photo.Pixel(x, y) = static_cast<uint8_t>(sum);
      }
    }
    return photo;
  }

  std::string Run(const std::vector<std::string>& more) const {
    std::vector<std::string> arguments = {"--workspace_path", folder_.path().string(), "--log_level",
                                          "error"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    std::ostringstream out;
    CommandContext context("model_scaler", arguments, out);
    RunModelScaler(context);
    return out.str();
  }
  std::string FaultOf(const std::vector<std::string>& more) const {
    try {
      Run(more);
    } catch (const UserError& error) {
      return error.what();
    } catch (const CommandLineError& error) {
      return std::string("command line: ") + error.what();
    }
    return "";
  }
  // NAME:X:Y, separated by commas.
  std::string Seen(const std::vector<std::pair<int, Eigen::Vector3d>>& in_object) const {
    std::string text;
    for (const auto& [view, x] : in_object) {
      const Eigen::Vector2d xy =
          *ProjectToImage(table_.CameraOf(view), table_.scene.views[view].CamFromObject() * x);
      text += fmt::format("{}{}:{:.9f}:{:.9f}", text.empty() ? "" : ",", table_.scene.views[view].name,
                          xy.x(), xy.y());
    }
    return text;
  }
  std::vector<std::string> Length(double mm) const {
    return {"--known_length_mm",      fmt::format("{}", mm), "--point_a",
            Seen({{0, a_}, {3, a_}}), "--point_b",           Seen({{1, b_}, {2, b_}, {6, b_}})};
  }
  // Places on a circle about the axis, each in another photo. \param radii  by turns.
  std::vector<std::string> Disc(double mm, const std::vector<double>& radii, int count) const {
    const TurntableAxis& axis = table_.scene.axis;
    const Eigen::Vector3d u = axis.direction.unitOrthogonal();
    const Eigen::Vector3d v = axis.direction.cross(u);
    std::string text;
    for (int i = 0; i < count; ++i) {
      const double angle = 2 * kPi * i / count + 0.1;
      const double radius = radii[i % radii.size()];
      const Eigen::Vector3d x =
          axis.point + 0.01 * axis.direction + radius * (std::cos(angle) * u + std::sin(angle) * v);
      const Eigen::Vector2d xy =
          *ProjectToImage(table_.CameraOf(i), table_.scene.views[i].cam_from_world * x);
      text +=
          fmt::format("{}{}:{:.9f}:{:.9f}", i == 0 ? "" : ",", table_.scene.views[i].name, xy.x(), xy.y());
    }
    return {"--disc_diameter_mm", fmt::format("{}", mm), "--disc_rim", text};
  }
  nlohmann::json Report() const { return nlohmann::json::parse(ReadAll(workspace_.ScaleReport())); }

  const Eigen::Vector3d a_{0.05, 0, 0.02};
  const Eigen::Vector3d b_{-0.03, 0.02, 0.05};
  SyntheticTurntable table_;
  TemporaryFolder folder_;
  Workspace workspace_{folder_.path()};
};

std::vector<std::string> Joined(std::vector<std::string> first, const std::vector<std::string>& second) {
  first.insert(first.end(), second.begin(), second.end());
  return first;
}

TEST_F(ModelScaler, AMarkedLengthMakesTheSceneMetric) {
  Write(false);
  const ColmapModel before = ReadColmapModel(workspace_.ObjectModel());
  const std::string said = Run(Length(123.4));
  const double scale = 0.1234 / (a_ - b_).norm();
  const nlohmann::json report = Report();
  EXPECT_NEAR(report["metres_per_former_unit"].get<double>() / scale, 1, 1e-7);
  ASSERT_EQ(report["bars"].size(), 1U);
  EXPECT_EQ(report["bars"][0]["name"], "marked length");
  EXPECT_NEAR(report["bars"][0]["known_mm"].get<double>(), 123.4, 1e-9);
  EXPECT_NEAR(report["bars"][0]["residual_mm"].get<double>(), 0, 1e-9);
  EXPECT_EQ(report["bars"][0]["is_outlier"], false);
  EXPECT_TRUE(report["markers"].empty());
  EXPECT_FALSE(report.contains("sigma_rel"));
  EXPECT_FALSE(report.contains("dictionary"));
  EXPECT_THAT(said, AllOf(HasSubstr("marked length    123.40 mm, "), HasSubstr("from 1 of 1 lengths\n"),
                          HasSubstr(fmt::format("{:.4g}", scale).substr(0, 4))));
  const ColmapModel after = ReadColmapModel(workspace_.ObjectModel());
  for (const auto& [id, point] : before.points3D)
    EXPECT_LT((after.points3D.at(id).xyz - scale * point.xyz).norm(), 1e-7);
  EXPECT_EQ(ReadTurntableFile(workspace_.Turntable()).units, LengthUnit::kMetre);
  EXPECT_THAT(Run(Length(123.4)), HasSubstr("up to date       "));
}

TEST_F(ModelScaler, PlacesAreANameAndPixels) {
  Write(false);
  const std::string name = table_.scene.views[0].name;
  const std::vector<std::string> wrong = {"1:2",          ":1:2",         name + ":1",
                                          name + "::2",   name + ":1:2x", name + ":x:2",
                                          name + ":1y:2", name + ":1:",   "::"};
  for (const std::string& place : wrong) {
    const std::string fault =
        FaultOf({"--known_length_mm", "10", "--point_a", place, "--point_b", Seen({{0, b_}, {1, b_}})});
    EXPECT_THAT(fault, testing::AnyOf(HasSubstr("--point_a: \"" + place + "\" is not NAME:X:Y"),
                                      HasSubstr("its model has no photo \"\"")))
        << place;
  }
  EXPECT_THAT(
      FaultOf({"--known_length_mm", "10", "--point_a", "other.jpg:1:2", "--point_b", Seen({{0, b_}})}),
      HasSubstr("its model has no photo \"other.jpg\" of --point_a"));
  // One ray is no point.
  EXPECT_THAT(FaultOf({"--known_length_mm", "10", "--point_a", Seen({{0, a_}}), "--point_b",
                       Seen({{0, b_}, {1, b_}})}),
              HasSubstr("the sightings of --point_a do not meet in one point"));
  EXPECT_THAT(FaultOf({"--known_length_mm", "10", "--point_b", Seen({{0, a_}}), "--point_a",
                       Seen({{0, b_}, {1, b_}})}),
              HasSubstr("the sightings of --point_b do not meet in one point"));
}

// As a scan checks them before it begins.
TEST(ModelScalerArguments, AreCheckedTogetherBeforeThereArePoses) {
  const Command command{"model_scaler", "", RunModelScaler};
  const auto fault = [&](std::vector<std::string> arguments) -> std::string {
    arguments.insert(arguments.end(), {"--workspace_path", "nowhere"});
    try {
      CheckArguments(command, arguments);
    } catch (const CommandLineError& error) {
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(fault({"--marker_size_mm", "5", "--marker_dictionary", "aruco"}),
              HasSubstr("--marker_dictionary aruco is none of auto, 4X4, "));
  EXPECT_THAT(fault({"--charuco_columns", "5", "--marker_size_mm", "5"}), HasSubstr("--charuco_rows 0"));
  EXPECT_THAT(fault({"--disc_diameter_mm", "5", "--disc_rim", "a.jpg:331"}), HasSubstr("is not NAME:X:Y"));
  EXPECT_EQ(fault({"--marker_size_mm", "5", "--marker_dictionary", "4X4"}), "");
}

TEST_F(ModelScaler, ADiscsRimTellsTheSameAsALength) {
  Write(false);
  constexpr double kRadius = 0.13;
  const double scale = 0.1 / (2 * kRadius);
  EXPECT_THAT(FaultOf(Disc(100, {kRadius}, 1)), HasSubstr("do not tell how large the disc is"));
  EXPECT_THAT(FaultOf(Disc(100, {kRadius, 0.9 * kRadius}, 8)),
              HasSubstr("px off a circle about the table's axis"));
  // 5 px are too much, and 1 px is what clicking explains: .001 of a unit are a pixel.
  EXPECT_THAT(FaultOf(Disc(100, {1.07 * kRadius, 0.93 * kRadius}, 8)), HasSubstr("px off a circle"));
  // Lengths that differ by more than a hundredth.
  const double agreeing = 1000 * scale * (a_ - b_).norm();
  EXPECT_THAT(FaultOf(Joined(Disc(100, {kRadius}, 8), Length(1.015 * agreeing))),
              HasSubstr("contradict each other"));
  EXPECT_THAT(FaultOf(Joined(Disc(100, {kRadius}, 8), Length(0.985 * agreeing))),
              HasSubstr("contradict each other"));
  const std::string said = Run(Joined(Disc(100, {kRadius}, 8), Length(1.006 * agreeing)));
  EXPECT_THAT(said, AllOf(HasSubstr("disc's diameter  100.00 mm"), HasSubstr("marked length "),
                          HasSubstr("from 2 of 2 lengths")));
  EXPECT_NEAR(Report()["metres_per_former_unit"].get<double>() / scale, 1.003, 0.0031);
}

TEST_F(ModelScaler, ADiscAloneIsEnough) {
  Write(false);
  const std::string said = Run(Disc(100, {0.13}, 8));
  EXPECT_NEAR(Report()["metres_per_former_unit"].get<double>() / (0.05 / 0.13), 1, 1e-6);
  EXPECT_EQ(Report()["bars"][0]["name"], "disc's diameter");
  EXPECT_THAT(said, HasSubstr("from 1 of 1 lengths"));
}

TEST_F(ModelScaler, MarkersAreFoundAndJudged) {
  Write(true);
  EXPECT_THAT(FaultOf({}), AllOf(HasSubstr("shows the 5X5 markers 4, 7, 9, but not how large they are")));
  EXPECT_THAT(FaultOf({"--marker_size_mm", "40", "--marker_ids", "5"}),
              HasSubstr("shows the 5X5 markers 4, 7, 9, and none of those that --marker_ids names"));
  EXPECT_THAT(FaultOf({"--marker_size_mm", "40", "--marker_dictionary", "APRILTAG_36H11"}),
              HasSubstr("no marker of the dictionary APRILTAG_36H11 is seen well enough"));
  // A length by which the markers would be twice as large.
  EXPECT_THAT(
      FaultOf(Joined({"--marker_size_mm", "40", "--marker_ids", "4,9"}, Length(1000 * (a_ - b_).norm()))),
      HasSubstr("contradict each other: by the marker"));
  const std::string said = Run({"--marker_size_mm", "40", "--marker_ids", "4,9"});
  const nlohmann::json report = Report();
  // Measured: .3 %, of corners that are found to a third of a pixel.
  EXPECT_NEAR(report["metres_per_former_unit"].get<double>() / 0.5, 1, 0.01);
  EXPECT_EQ(report["dictionary"], kDictionary);
  ASSERT_EQ(report["bars"].size(), 2U);
  EXPECT_TRUE(report.contains("sigma_rel"));
  EXPECT_THAT(said, AllOf(HasSubstr("from 2 of 2 lengths, good to "), HasSubstr("marker 4 "),
                          HasSubstr("marker 9 ")));
  // All markers are listed, in millimetres.
  ASSERT_EQ(report["markers"].size(), 3U);
  const auto& second = report["markers"][1];
  EXPECT_EQ(second["id"], 7);
  EXPECT_EQ(second["photos"], 8);
  EXPECT_NEAR(second["side_mm"].get<double>(), 500 * kMarkers[1].side, 0.4);
  EXPECT_NEAR(second["center_mm"][0].get<double>(), 500 * (kMarkers[1].left + kMarkers[1].side / 2), 0.4);
  EXPECT_NEAR(second["center_mm"][1].get<double>(), 500 * (kMarkers[1].bottom + kMarkers[1].side / 2), 0.4);
  EXPECT_NEAR(second["center_mm"][2].get<double>(), 0, 0.4);
}

TEST_F(ModelScaler, PhotosWithoutMarkersAreToldSo) {
  Write(false);
  EXPECT_THAT(FaultOf({"--marker_size_mm", "40"}),
              HasSubstr("no ArUco or AprilTag markers were found in the photos"));
}

}  // namespace
}  // namespace s2gs
