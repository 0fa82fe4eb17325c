#include "sfm_split/scale/charuco_board.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "sfm_split/base/angles.h"
#include "tests/support/camera_towards_origin.h"

namespace s2gs {
namespace {

constexpr double kUnit = 0.25;  // metres to the model's unit
constexpr int kPixelsPerSquare = 240;

CharucoBoard Board() { return {7, 5, 24, 18, "5X5"}; }

double SquareInUnits() { return 1e-3 * Board().square_mm / kUnit; }

ColmapModel MakeModel(int num_images) {
  ColmapModel model;
  model.cameras[1] = {1, CameraModelId::kPinhole, 640, 480, {700, 700, 320, 240}};
  for (int i = 0; i < num_images; ++i) {
    const double azimuth = 2 * kPi * i / num_images;
    const Eigen::Vector3d center(0.6 * std::cos(azimuth), 0.6 * std::sin(azimuth), 1);
    ColmapImage image;
    image.image_id = static_cast<uint32_t>(i + 1);
    image.name = "photo" + std::to_string(i) + ".jpg";
    image.camera_id = 1;
    image.cam_from_world = CameraTowardsOrigin(center);
    model.images[image.image_id] = image;
  }
  return model;
}

// From the board's pixels, row 0 at its top, to the model: the board lies flat, its top towards +y.
Eigen::Vector3d InModel(double column, double row) {
  const double size = SquareInUnits() / kPixelsPerSquare;
  return {size * (column - Board().columns * kPixelsPerSquare / 2.0),
          size * (Board().rows * kPixelsPerSquare / 2.0 - row), 0};
}

// The photo, each pixel the mean of 4 x 4 rays. \param ink_px  by so much of the board's pixels black
// spreads.
std::vector<uint8_t> Render(const ColmapModel& model, const ColmapImage& image, int ink_px) {
  const Camera& camera = model.cameras.at(1);
  std::vector<uint8_t> board = DrawBoard(Board(), kPixelsPerSquare);
  const int width = Board().columns * kPixelsPerSquare;
  const int height = Board().rows * kPixelsPerSquare;
  const std::vector<uint8_t> dry = board;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int dy = -ink_px; dy <= ink_px; ++dy) {
        for (int dx = -ink_px; dx <= ink_px; ++dx) {
          if (x + dx < 0 || y + dy < 0 || x + dx >= width || y + dy >= height) continue;
          uint8_t& pixel = board[static_cast<size_t>(y) * width + x];
          pixel = std::min(pixel, dry[static_cast<size_t>(y + dy) * width + x + dx]);
        }
      }
    }
  }
  const Rigid3 world_from_cam = image.cam_from_world.Inverse();
  const double size = SquareInUnits() / kPixelsPerSquare;
  std::vector<uint8_t> grey;
  for (int y = 0; y < 480; ++y) {
    for (int x = 0; x < 640; ++x) {
      double sum = 0;
      for (int k = 0; k < 16; ++k) {
        const Eigen::Vector2d xy(x + (k % 4 + 0.5) / 4, y + (k / 4 + 0.5) / 4);
        const Eigen::Vector3d ray = world_from_cam.rotation * *UnprojectFromImage(camera, xy);
        const Eigen::Vector3d& origin = world_from_cam.translation;
        const Eigen::Vector3d place = origin - origin.z() / ray.z() * ray;
        const auto column = static_cast<int>(std::floor(place.x() / size + width / 2.0));
        const auto row = static_cast<int>(std::floor(height / 2.0 - place.y() / size));
        const bool is_board = column >= 0 && row >= 0 && column < width && row < height;
        sum += is_board ? board[static_cast<size_t>(row) * width + column] : 220;
      }
      grey.push_back(static_cast<uint8_t>(20 + sum / 16 * 0.8));
    }
  }
  return grey;
}

TEST(CharucoBoard, GivesTheScaleHoweverTheInkSpreads) {
  const ColmapModel model = MakeModel(4);
  for (const int ink_px : {0, 1}) {  // of 240 a square: edges move by .1 mm
    MarkSightings sightings;
    double largest_px = 0;
    for (const auto& [id, image] : model.images) {
      const auto corners = DetectBoardCorners(Render(model, image, ink_px), 640, 480, Board());
      EXPECT_GE(corners.size(), 20U) << image.name << " ink " << ink_px;
      for (const auto& [corner, xy] : corners) {
        const Eigen::Vector3d x =
            InModel((corner % 6 + 1) * kPixelsPerSquare, (corner / 6 + 1) * kPixelsPerSquare);
        const auto expected = ProjectToImage(model.cameras.at(1), image.cam_from_world * x);
        largest_px = std::max(largest_px, (xy - *expected).norm());
      }
      sightings[image.name] = corners;
    }
    EXPECT_LT(largest_px, 0.3) << ink_px;  // .17 measured without ink, .10 with it
    const std::vector<ScaleBar> bars = BarsOfBoard(Board(), LocateMarks(model, sightings));
    ASSERT_EQ(bars.size(), 10U);  // four rows and six columns of inner corners
    EXPECT_NEAR(bars[0].known_m, 5 * 0.024, 1e-12);
    EXPECT_NEAR(bars[4].known_m, 3 * 0.024, 1e-12);
    const ScaleEstimate estimate = EstimateScale(bars);
    EXPECT_NEAR(estimate.metres_per_unit / kUnit, 1, 1e-3) << ink_px;
    std::printf("ink %d: corners to %.2f px, scale off by %.3f %%\n", ink_px, largest_px,
                100 * (estimate.metres_per_unit / kUnit - 1));
  }
}

TEST(CharucoBoard, MeasuresBetweenTheOutermostCornersThatAreThere) {
  std::map<int, LocatedMark> located;
  for (const int corner : {1, 3, 4, 13}) located[corner].x = {0.1 * (corner % 6), 0.1 * (corner / 6), 0};
  const std::vector<ScaleBar> bars = BarsOfBoard(Board(), located);
  ASSERT_EQ(bars.size(), 2U);
  EXPECT_EQ(bars[0].name, "board row 1");
  EXPECT_NEAR(bars[0].known_m, 3 * 0.024, 1e-12);
  EXPECT_NEAR(bars[0].measured, 0.3, 1e-12);
  EXPECT_EQ(bars[1].name, "board column 2");
  EXPECT_NEAR(bars[1].known_m, 2 * 0.024, 1e-12);
}

// A length of zero tells no scale.
TEST(CharucoBoard, CornersAtOnePlaceMakeNoBar) {
  std::map<int, LocatedMark> located;
  for (const int corner : {1, 3}) located[corner].x = {0.1, 0.2, 0.3};
  EXPECT_TRUE(BarsOfBoard(Board(), located).empty());
}

TEST(CharucoBoard, ChecksItsNumbers) {
  EXPECT_FALSE(Board().Check().has_value());
  CharucoBoard board = Board();
  board.marker_mm = 24;
  EXPECT_EQ(board.Check()->field, "marker_size_mm");
  board = Board();
  board.rows = 2;
  EXPECT_EQ(board.Check()->field, "charuco_rows");
}

}  // namespace
}  // namespace s2gs
