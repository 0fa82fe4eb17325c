#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scale/located_marks.h"
#include "sfm_split/scale/marker_sheet.h"
#include "sfm_split/scale/markers.h"
#include "sfm_split/scale/scale_bars.h"
#include "sfm_split/scale/scale_model.h"
#include "tests/support/camera_towards_origin.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

constexpr double kUnit = 0.37;  // metres to the model's unit
constexpr double kSide = 0.033;

// Cameras around a sheet, at one unit and a half.
ColmapModel MakeModel(int num_images) {
  ColmapModel model;
  model.cameras[1] = {1, CameraModelId::kPinhole, 1280, 960, {1000, 1000, 640, 480}};
  for (int i = 0; i < num_images; ++i) {
    const double azimuth = 2 * kPi * i / num_images;
    const Eigen::Vector3d center(1.2 * std::cos(azimuth), 1.2 * std::sin(azimuth), 0.9);
    ColmapImage image;
    image.image_id = static_cast<uint32_t>(i + 1);
    image.name = "photo" + std::to_string(100 + i) + ".jpg";
    image.camera_id = 1;
    image.cam_from_world = CameraTowardsOrigin(center);
    model.images[image.image_id] = image;
  }
  return model;
}

struct Sheet {
  std::map<int, std::array<Eigen::Vector3d, 4>> corners;  // model's unit
};

// Twelve markers in three rows; one is printed 4 % too large.
Sheet MakeSheet(int wrong) {
  Sheet sheet;
  for (int id = 0; id < 12; ++id) {
    const double side = kSide / kUnit * (id == wrong ? 1.04 : 1);
    const Eigen::Vector3d low(-0.3 + 0.14 * (id % 4), -0.2 + 0.14 * (id / 4), 0.02 * (id % 3));
    sheet.corners[id] = {low + Eigen::Vector3d(0, side, 0), low + Eigen::Vector3d(side, side, 0),
                         low + Eigen::Vector3d(side, 0, 0), low};
  }
  return sheet;
}

std::map<std::string, std::vector<MarkerSighting>> See(const ColmapModel& model, const Sheet& sheet,
                                                       double noise_px, uint64_t seed) {
  RandomNumbers random(seed);
  std::map<std::string, std::vector<MarkerSighting>> sightings;
  for (const auto& [image_id, image] : model.images) {
    for (const auto& [id, corners] : sheet.corners) {
      MarkerSighting sighting;
      sighting.id = id;
      for (size_t k = 0; k < 4; ++k) {
        const Eigen::Vector3d x = image.cam_from_world * corners[k];
        sighting.corners[k] = {1000 * x.x() / x.z() + 640 + random.Uniform(-noise_px, noise_px),
                               1000 * x.y() / x.z() + 480 + random.Uniform(-noise_px, noise_px)};
      }
      sightings[image.name].push_back(sighting);
    }
  }
  return sightings;
}

TEST(MarkerScale, MarkersGiveTheScaleAndNameWhatIsWrong) {
  const ColmapModel model = MakeModel(24);
  auto sightings = See(model, MakeSheet(7), 0.3, 1);
  // A marker that one photo shows elsewhere by mistake.
  for (Eigen::Vector2d& corner : sightings["photo105.jpg"][2].corners) corner += Eigen::Vector2d(60, -25);
  const std::vector<LocatedMarker> markers = LocateMarkers(model, sightings);
  ASSERT_EQ(markers.size(), 12u);
  EXPECT_EQ(markers[2].num_photos, 23);
  EXPECT_EQ(markers[3].num_photos, 24);
  const ScaleEstimate estimate = EstimateScale(BarsOfMarkers(markers, kSide));
  // .3 px of 1.5 m at 1000 px are .3 mm in a ray; over 24 photos, four sides and eleven markers .01 %.
  EXPECT_NEAR(estimate.metres_per_unit / kUnit, 1, 5e-4);
  EXPECT_NEAR(estimate.metres_per_unit / kUnit, 1, 5 * estimate.sigma_rel);
  EXPECT_EQ(estimate.num_used, 11);
  for (const JudgedBar& bar : estimate.bars) {
    EXPECT_EQ(bar.is_outlier, bar.bar.name == "marker 7") << bar.bar.name;
    EXPECT_NEAR(bar.residual_m, bar.is_outlier ? 0.04 * kSide : 0, 1e-4);
  }
}

TEST(MarkerScale, MarksThatPhotosDoNotAgreeOnAreLeftOut) {
  const ColmapModel model = MakeModel(6);
  MarkSightings sightings;
  sightings["photo100.jpg"][0] = {500, 400};
  sightings["photo103.jpg"][0] = {100, 900};
  sightings["photo101.jpg"][1] = {500, 400};  // in one photo alone
  EXPECT_TRUE(LocateMarks(model, sightings).empty());
}

TEST(ScaleBars, TwoThatDifferAreBothUsed) {
  const ScaleEstimate estimate = EstimateScale({{"a", 0.1, 1, 0}, {"b", 0.3, 2, 0}});
  EXPECT_EQ(estimate.num_used, 2);
  EXPECT_NEAR(estimate.metres_per_unit, 0.125, 1e-12);
  EXPECT_NEAR(estimate.bars[0].residual_m, 0.025, 1e-12);
  EXPECT_NEAR(estimate.bars[1].residual_m, -0.05, 1e-12);
  EXPECT_TRUE(std::isnan(EstimateScale({{"a", 0.1, 1, 0}}).sigma_rel));
}

TEST(ScaleBars, OneOfUnknownErrorCountsLikeTheOthers) {
  // Three bars that are good to a thousandth, and one of which nothing is known.
  const ScaleEstimate estimate =
      EstimateScale({{"a", 1, 1, 1e-3}, {"b", 1, 1, 1e-3}, {"c", 1, 1, 1e-3}, {"d", 1.002, 1, 0}});
  EXPECT_EQ(estimate.num_used, 4);
  EXPECT_NEAR(estimate.metres_per_unit, 1.0005, 1e-9);
}

TEST(ScaleBars, WhatAllHaveInCommonIsNotAveragedAway) {
  std::vector<ScaleBar> bars;
  for (int i = 0; i < 400; ++i) bars.push_back({"marker", 0.033, 1 + 1e-4 * (i % 3), 0, 2.5e-3});
  EXPECT_NEAR(EstimateScale(bars).sigma_rel, 2.5e-3, 1e-5);
  // A marker of 33 mm whose edges are off by a printer's dot each, .0423 mm.
  LocatedMarker marker;
  marker.side = 0.1;
  EXPECT_NEAR(BarsOfMarkers({marker}, 0.033)[0].common_rel, 0.0847 / 33, 1e-5);
}

TEST(ScaleModel, ProjectionsStay) {
  ColmapModel model = MakeModel(3);
  model.points3D[5] = {5, {0.1, -0.2, 0.3}, {}, 0, {}};
  ColmapModel scaled = model;
  ScaleModel(kUnit, &scaled);
  for (const auto& [id, image] : model.images) {
    const Eigen::Vector3d before = image.cam_from_world * model.points3D.at(5).xyz;
    const Eigen::Vector3d after = scaled.images.at(id).cam_from_world * scaled.points3D.at(5).xyz;
    EXPECT_LT((after - kUnit * before).norm(), 1e-12);
  }
  TurntableFile turntable;
  turntable.axis.point = {1, 2, 3};
  turntable.images.push_back({"a", 0, 0, Rigid3()});
  turntable.images[0].world_from_object.translation = {0, 1, 0};
  ScaleTurntableToMetres(kUnit, &turntable);
  EXPECT_EQ(turntable.units, LengthUnit::kMetre);
  EXPECT_NEAR(turntable.axis.point.z(), 3 * kUnit, 1e-12);
  EXPECT_NEAR(turntable.images[0].world_from_object.translation.y(), kUnit, 1e-12);
}

// A drawn marker's corners, whole pixels in COLMAP's convention, and its number, in every dictionary.
TEST(Markers, DrawnOnesAreFoundWhereTheyAre) {
  for (const std::string& dictionary : MarkerDictionaries()) {
    constexpr int kWidth = 300;
    constexpr int kHeight = 260;
    constexpr int kCell = 14;
    constexpr int kLeft = 60;
    constexpr int kTop = 45;
    constexpr int kId = 17;
    const MarkerCells cells = CellsOfMarker(dictionary, kId);
    std::vector<uint8_t> grey(static_cast<size_t>(kWidth) * kHeight, 230);
    for (int y = 0; y < cells.side * kCell; ++y) {
      for (int x = 0; x < cells.side * kCell; ++x) {
        grey[static_cast<size_t>(kTop + y) * kWidth + kLeft + x] =
            cells.is_white[static_cast<size_t>(y / kCell) * cells.side + x / kCell] != 0 ? 230 : 20;
      }
    }
    const std::vector<MarkerSighting> found = DetectMarkers(grey, kWidth, kHeight, dictionary);
    ASSERT_EQ(found.size(), 1u) << dictionary;
    EXPECT_EQ(found[0].id, kId) << dictionary;
    const double right = kLeft + cells.side * kCell;
    const double bottom = kTop + cells.side * kCell;
    const std::array<Eigen::Vector2d, 4> expected = {
        Eigen::Vector2d(kLeft, kTop), Eigen::Vector2d(right, kTop), Eigen::Vector2d(right, bottom),
        Eigen::Vector2d(kLeft, bottom)};
    for (size_t k = 0; k < 4; ++k)
      EXPECT_LT((found[0].corners[k] - expected[k]).norm(), 0.35) << dictionary << k;
  }
  EXPECT_THROW(CellsOfMarker("7X7", 1000), UserError);
  EXPECT_THROW(CellsOfMarker("8X8", 0), UserError);
}

// Drawn from the sheet's description at 4 pixels a millimetre, every marker is found where it should be.
TEST(MarkerSheet, EveryMarkerIsFound) {
  MarkerSheetOptions options;
  options.diameter_mm = 200;
  options.marker_size_mm = 22;
  options.first_id = 40;
  const MarkerSheet sheet = MakeMarkerSheet(options, 3);
  ASSERT_GE(sheet.markers.size(), 10u);
  EXPECT_GT(sheet.speckles.size(), 300u);
  constexpr int kPixels = 800;
  constexpr double kScale = 4;
  std::vector<uint8_t> grey(static_cast<size_t>(kPixels) * kPixels, 255);
  for (int y = 0; y < kPixels; ++y) {
    for (int x = 0; x < kPixels; ++x) {
      const Eigen::Vector2d p((x + 0.5 - kPixels / 2.0) / kScale, (y + 0.5 - kPixels / 2.0) / kScale);
      uint8_t& pixel = grey[static_cast<size_t>(y) * kPixels + x];
      for (const auto& speckle : sheet.speckles) {
        if ((speckle.center - p).norm() < speckle.radius) pixel = static_cast<uint8_t>(speckle.grey);
      }
      for (const auto& marker : sheet.markers) {
        const Eigen::Vector2d in_marker = Eigen::Rotation2Dd(-marker.angle) * (p - marker.center);
        if (in_marker.cwiseAbs().maxCoeff() >= options.marker_size_mm / 2) continue;
        const MarkerCells cells = CellsOfMarker(options.marker_dictionary, marker.id);
        const double cell = options.marker_size_mm / cells.side;
        const auto column = static_cast<size_t>((in_marker.x() + options.marker_size_mm / 2) / cell);
        const auto row = static_cast<size_t>((in_marker.y() + options.marker_size_mm / 2) / cell);
        pixel = cells.is_white[row * cells.side + column] != 0 ? 255 : 0;
      }
    }
  }
  const std::vector<MarkerSighting> found = DetectMarkers(grey, kPixels, kPixels, options.marker_dictionary);
  ASSERT_EQ(found.size(), sheet.markers.size());
  for (size_t i = 0; i < found.size(); ++i) {
    EXPECT_EQ(found[i].id, 40 + static_cast<int>(i));
    const Eigen::Vector2d center =
        (found[i].corners[0] + found[i].corners[1] + found[i].corners[2] + found[i].corners[3]) / 4;
    EXPECT_LT((center - (kScale * sheet.markers[i].center + Eigen::Vector2d::Constant(kPixels / 2.0))).norm(),
              0.5);
    // The first side runs as the description says.
    const Eigen::Vector2d side = (found[i].corners[1] - found[i].corners[0]) / kScale;
    EXPECT_NEAR(side.norm(), options.marker_size_mm, 0.3);
    EXPECT_NEAR(std::cos(std::atan2(side.y(), side.x()) - sheet.markers[i].angle), 1, 1e-3);
  }
}

TEST(MarkerSheet, WhatDoesNotFitIsRefused) {
  MarkerSheetOptions options;
  options.diameter_mm = 60;
  options.marker_size_mm = 50;
  EXPECT_THROW(MakeMarkerSheet(options, 0), UserError);
  options = {};
  options.hole_diameter_mm = 270;
  EXPECT_THROW(MakeMarkerSheet(options, 0), UserError);
}

}  // namespace
}  // namespace s2gs
