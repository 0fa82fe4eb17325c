#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "plugin/report/mesh_figures.h"
#include "plugin/report/photo_quality.h"
#include "plugin/report/report_input.h"
#include "plugin/report/residuals.h"
#include "plugin/report/table_steps.h"
#include "tests/support/synthetic_models.h"

namespace s2gs {
namespace {

SyntheticTurntable Table(double noise) {
  SyntheticTurntableOptions options;
  options.steps = 8;
  options.step_deg = 45;
  options.pixel_noise = noise;
  return MakeSyntheticTurntable(options);
}

TEST(Residuals, AreTheKeypointsNoise) {
  constexpr double kNoise = 0.5;
  const SyntheticTurntable table = Table(kNoise);
  const ColmapModel model = SyntheticObjectModel(table);
  const ModelResiduals residuals = ComputeResiduals(model);
  double squares = 0;
  size_t count = 0;
  for (const auto& [id, observations] : residuals.by_image) {
    for (const auto& observation : observations) squares += observation.residual.squaredNorm();
    count += observations.size();
    // By the truth that the image was drawn from.
    std::vector<double> exact;
    for (const SyntheticKeypoint& keypoint : table.images[id - 1].keypoints) {
      if (IsRotating(keypoint.body)) exact.push_back((keypoint.xy - keypoint.exact_xy).norm());
    }
    std::sort(exact.begin(), exact.end());
    for (const auto& observation : observations) {
      const auto at = std::lower_bound(exact.begin(), exact.end(), observation.residual.norm() - 1e-9);
      ASSERT_TRUE(at != exact.end() && *at < observation.residual.norm() + 1e-9);
    }
  }
  EXPECT_EQ(count, residuals.num_observations);
  ASSERT_GT(count, 1000u);
  // Of n squared lengths with mean 2 s^2 and standard deviation 2 s^2.
  EXPECT_NEAR(squares / static_cast<double>(count), 2 * kNoise * kNoise,
              4 * 2 * kNoise * kNoise / std::sqrt(static_cast<double>(count)));
}

TEST(Residuals, ExactModelsHaveNone) {
  const ModelResiduals residuals = ComputeResiduals(SyntheticStaticModel(Table(0)));
  for (const auto& [id, observations] : residuals.by_image) EXPECT_LT(RmsLength(observations), 1e-9);
}

// A point behind the camera is counted, and has no residual.
TEST(Residuals, PointsBehindTheCameraAreCounted) {
  ColmapModel model = SyntheticStaticModel(Table(0));
  const ModelResiduals before = ComputeResiduals(model);
  EXPECT_EQ(before.num_behind, 0U);
  auto& [id, image] = *model.images.begin();
  const auto seen =
      std::find_if(image.points2D.begin(), image.points2D.end(),
                   [](const ColmapPoint2D& keypoint) { return keypoint.point3D_id != kInvalidPoint3DId; });
  ASSERT_NE(seen, image.points2D.end());
  Eigen::Vector3d& point = model.points3D.at(seen->point3D_id).xyz;
  const Eigen::Vector3d in_camera = image.cam_from_world * point;
  point = image.cam_from_world.Inverse() * Eigen::Vector3d(-in_camera);
  const ModelResiduals after = ComputeResiduals(model);
  EXPECT_GE(after.num_behind, 1U);
  EXPECT_EQ(after.num_observations + after.num_behind, before.num_observations);
  EXPECT_EQ(after.by_image.at(id).size(), before.by_image.at(id).size() - 1);
  for (const ModelResiduals::Observation& observation : after.by_image.at(id)) {
    EXPECT_NE(observation.point3D_id, seen->point3D_id);
  }
}

TEST(Residuals, TheFieldTellsAShiftFromNoise) {
  const SyntheticTurntable table = Table(0.5);
  const ColmapModel model = SyntheticStaticModel(table);
  ModelResiduals residuals = ComputeResiduals(model);
  const Camera& camera = model.cameras.begin()->second;
  const auto systematic = [&] {
    const ResidualField field = ComputeResidualField({&model}, {&residuals}, camera, 8);
    EXPECT_EQ(field.cells.size(), 48u);  // 8 x 6 of 80 px
    return std::count_if(field.cells.begin(), field.cells.end(),
                         [](const auto& cell) { return cell.is_systematic; });
  };
  EXPECT_EQ(systematic(), 0);
  for (auto& [id, observations] : residuals.by_image) {
    for (auto& observation : observations) {
      if (observation.xy.x() < 80) observation.residual.x() += 0.5;
    }
  }
  EXPECT_EQ(systematic(), 6);  // the left column, and nothing else
}

TEST(Residuals, SharedPointsAreCountedBothWays) {
  ColmapModel model;
  for (uint32_t id = 1; id <= 3; ++id)
    model.images[id] = {id, std::string(1, static_cast<char>('a' + id)), 1, {}, {}};
  ColmapPoint3D point;
  point.track = {{1, 0}, {2, 0}, {2, 1}};
  model.points3D[1] = point;
  point.track = {{1, 0}, {2, 0}, {3, 1}};
  model.points3D[2] = point;
  // Of the three images b, c, d.
  const std::vector<std::vector<uint32_t>> counts = SharedPoints(model, {"d", "b", "c"});
  EXPECT_EQ(counts, (std::vector<std::vector<uint32_t>>{{0, 1, 1}, {1, 0, 2}, {1, 2, 0}}));
}

// An upright edge, blurred by a Gaussian: its closed form.
Image8 Edge(double sigma, int low = 40, int high = 200) {
  Image8 image{64, 64, 1, std::vector<uint8_t>(64 * 64)};
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) {
      const double share = 0.5 * std::erfc(-(x - 31.3) / (std::sqrt(2.0) * sigma));
      *image.Pixel(x, y) = static_cast<uint8_t>(std::lround(low + share * (high - low)));
    }
  }
  return image;
}

TEST(PhotoQuality, BlurOfAnEdge) {
  // Whole grey values make the second differences of wide, flat edges rough: 5 % at three pixels.
  for (const double sigma : {1.5, 2.0, 3.0}) {
    EXPECT_NEAR(MeasurePhoto(Edge(sigma), nullptr).blur_px, sigma, 0.08 * sigma) << sigma;
    EXPECT_NEAR(MeasurePhoto(Edge(sigma, 40, 170), nullptr).blur_px, sigma, 0.08 * sigma) << sigma;
  }
}

TEST(PhotoQuality, BlurOfTheRotatingPartBrightnessOfTheRest) {
  Image8 photo = Edge(2);
  for (int y = 32; y < 64; ++y) {
    for (int x = 0; x < 64; ++x) *photo.Pixel(x, y) = static_cast<uint8_t>((x / 4) % 2 * 255);
  }
  Image8 mask{32, 32, 1, std::vector<uint8_t>(32 * 32, 0)};  // half the photo's size
  std::fill(mask.pixels.begin(), mask.pixels.begin() + 32 * 15, uint8_t{255});
  const PhotoQuality quality = MeasurePhoto(photo, &mask);
  EXPECT_NEAR(quality.blur_px, 2, 0.15);
  EXPECT_NEAR(quality.bright_pct, 25, 1e-9);
  EXPECT_NEAR(quality.dark_pct, 25, 1e-9);
  EXPECT_TRUE(std::isinf(MeasurePhoto(Image8{8, 8, 1, std::vector<uint8_t>(64, 9)}, nullptr).blur_px));
}

TEST(PhotoQuality, WarnsOfWhatStandsOutAndMatters) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  std::vector<PhotoQuality> photos;
  std::vector<int> stations;
  for (int i = 0; i < 200; ++i) {
    photos.push_back({true, 1.5 + 0.05 * normal(random), 0.4 * std::exp2(0.02 * normal(random)), 0, 0});
    stations.push_back(i / 50);
  }
  EXPECT_TRUE(FindPhotoWarnings(photos, stations).empty());
  photos[7].blur_px = 3;
  photos[60].brightness *= 0.7;   // 1.1 stops darker
  photos[61].brightness *= 0.95;  // stands out, .16 stops, and nobody would see it
  photos[120].blur_px = 1.55;
  const std::vector<PhotoWarning> warnings = FindPhotoWarnings(photos, stations);
  ASSERT_EQ(warnings.size(), 2u);
  EXPECT_EQ(warnings[0].photo, 7u);
  EXPECT_EQ(warnings[0].text.substr(0, 14), "blurred by 2.6");
  EXPECT_EQ(warnings[1].photo, 60u);
  EXPECT_NE(warnings[1].text.find("darker"), std::string::npos);
}

TEST(TableSteps, AreFoundThroughGapsAndTheSeam) {
  TurntableFile turntable;
  turntable.num_stations = 2;
  for (int i = 0; i < 24; ++i) {
    if (i == 9) continue;  // a photo is missing
    TurntableImage image;
    image.name = "a" + std::to_string(100 + i);
    image.angle_deg = std::remainder(70 - 15.0 * i + (i == 5 ? 0.3 : 0), 360.0);
    turntable.images.push_back(image);
  }
  TurntableImage alone;
  alone.name = "b";
  alone.station = 1;
  turntable.images.push_back(alone);
  const std::vector<StationSteps> steps = FindSteps(turntable);
  ASSERT_EQ(steps.size(), 2u);
  EXPECT_NEAR(steps[0].step_deg, -15, 1e-9);
  EXPECT_NEAR(steps[0].largest_gap_deg, 30, 1e-9);
  ASSERT_EQ(steps[0].deviations_deg.size(), 23u);
  for (size_t i = 0; i < 23; ++i) EXPECT_NEAR(steps[0].deviations_deg[i], i == 5 ? 0.3 : 0, 1e-9) << i;
  EXPECT_NEAR(steps[0].spread_deg, 0, 1e-9);
  EXPECT_TRUE(std::isnan(steps[1].step_deg));
  EXPECT_NEAR(steps[1].largest_gap_deg, 360, 1e-9);
}

// Photos of one body from a ring around it, which looks at its middle from above; `up` is any direction.
ReportInput OneBody(const Eigen::Vector3d& up, int count, bool upright) {
  ReportInput input;
  input.object.emplace();
  input.turntable.emplace();
  input.turntable->axis.direction = Eigen::Vector3d::UnitX();
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  const Eigen::Vector3d side = up.unitOrthogonal();
  for (int i = 0; i < count; ++i) {
    const double turn = 2 * 3.14159265358979323846 * i / count;
    const Eigen::Vector3d out = std::cos(turn) * side + std::sin(turn) * up.cross(side);
    const Eigen::Vector3d forward = -(out + 0.5 * up).normalized();
    const Eigen::Vector3d above =
        upright ? up : Eigen::Vector3d(normal(random), normal(random), normal(random));
    Eigen::Matrix3d rows;  // right, down, forward
    rows.row(0) = forward.cross(above).normalized();
    rows.row(2) = forward;
    rows.row(1) = forward.cross(Eigen::Vector3d(rows.row(0)));
    ColmapImage image;
    image.name = "p" + std::to_string(i);
    image.cam_from_world.rotation = Eigen::Quaterniond(rows);
    const auto id = static_cast<uint32_t>(i + 1);
    input.object->images[id] = image;
    input.object_ids[image.name] = id;
    TurntableImage row;
    row.name = image.name;
    input.turntable->images.push_back(row);
  }
  return input;
}

TEST(ReportInput, OneBodysUpIsThePhotos) {
  const Eigen::Vector3d up = Eigen::Vector3d(0.3, -0.9, 0.2).normalized();
  const ReportInput upright = OneBody(up, 12, true);
  EXPECT_TRUE(upright.IsOneBody());
  EXPECT_NEAR((upright.Up() - up).norm(), 0, 1e-9);
  // Photos that are turned any way about what they look at tell nothing but that they look from above.
  EXPECT_NEAR((OneBody(up, 12, false).Up() - Eigen::Vector3d::UnitX()).norm(), 0, 1e-9);
  // Where something turns, the axis is upright.
  ReportInput turning = upright;
  turning.turntable->images[1].angle_deg = 15;
  EXPECT_FALSE(turning.IsOneBody());
  EXPECT_NEAR((turning.Up() - Eigen::Vector3d::UnitX()).norm(), 0, 1e-9);
}

// A box without its lid, its normals outside.
TriangleMesh OpenBox(float x, float y, float z) {
  TriangleMesh mesh;
  for (int i = 0; i < 8; ++i) {
    mesh.vertices.emplace_back(i & 1 ? x : 0.F, i & 2 ? y : 0.F, i & 4 ? z : 0.F);
  }
  const auto face = [&](uint32_t a, uint32_t b, uint32_t c, uint32_t d) {
    mesh.triangles.emplace_back(a, b, c);
    mesh.triangles.emplace_back(a, c, d);
  };
  face(0, 2, 3, 1);
  face(0, 1, 5, 4);
  face(1, 3, 7, 5);
  face(3, 2, 6, 7);
  face(2, 0, 4, 6);
  return mesh;
}

TEST(MeshFigures, OfABoxWithoutItsLid) {
  TriangleMesh box = OpenBox(2, 3, 5);
  const MeshFigures open = MeasureMesh(box);
  EXPECT_NEAR(open.area, 2 * (2 * 5 + 3 * 5) + 2 * 3, 1e-5);
  EXPECT_EQ(open.num_clusters, 1u);
  ASSERT_EQ(open.holes.size(), 1u);
  EXPECT_EQ(open.holes[0].num_edges, 4u);
  EXPECT_NEAR(open.holes[0].length, 10, 1e-6);
  EXPECT_TRUE((open.high - open.low).isApprox(Eigen::Vector3d(2, 3, 5)));
  box.triangles.emplace_back(4, 5, 7);
  box.triangles.emplace_back(4, 7, 6);
  const MeshFigures closed = MeasureMesh(box);
  EXPECT_TRUE(closed.holes.empty());
  EXPECT_NEAR(closed.volume, 30, 1e-5);
}

TEST(MeshFigures, PackedPositionsComeBackToHalfAStep) {
  const TriangleMesh box = OpenBox(2, 3, 5);
  const PackedMesh packed = PackMesh(box, {0, 1, 2, 3, 4, 5, 6, 300}, FindHoles(box));
  ASSERT_EQ(packed.positions.size(), 8u * 6);
  EXPECT_FLOAT_EQ(packed.size, 5);
  for (size_t i = 0; i < 24; ++i) {
    const auto value = static_cast<unsigned>(static_cast<unsigned char>(packed.positions[2 * i])) |
                       static_cast<unsigned>(static_cast<unsigned char>(packed.positions[2 * i + 1])) << 8;
    const float coordinate =
        packed.low[static_cast<int>(i % 3)] + packed.size * static_cast<float>(value) / 65535;
    EXPECT_NEAR(coordinate, box.vertices[i / 3][static_cast<int>(i % 3)], 0.5 * 5 / 65535 + 1e-6);
  }
  EXPECT_EQ(static_cast<unsigned char>(packed.views[7]), 255);
  EXPECT_EQ(packed.index_bytes, 2);
  EXPECT_EQ(packed.triangles.size(), box.triangles.size() * 6);
  EXPECT_EQ(packed.holes.size(), 4u * 4);
}

TEST(MeshFigures, ViewsOfAVertex) {
  TriangleMesh box = OpenBox(1, 1, 1);
  box.normals.clear();
  for (const Eigen::Vector3f& vertex : box.vertices) {
    box.normals.push_back((vertex - Eigen::Vector3f(0.5F, 0.5F, 0.5F)).normalized());
  }
  // From the box's corner (0, 0, 0), and once more at twice the size of what is looked at.
  ObjectView view{600, 600, 600, 600, 300, 300, {}};
  view.cam_from_object.rotation =
      Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d(1, 1, 1), Eigen::Vector3d::UnitZ());
  view.cam_from_object.translation = Eigen::Vector3d(0, 0, 3);
  ObjectView large = view;
  large.width = large.height = 2048;
  large.fx = large.fy = 2048;
  large.cx = large.cy = 1024;
  const std::vector<int> counts = CountViewsOfVertices(box, {view, large});
  EXPECT_EQ(counts[0], 2);  // the corner that the views look at
  EXPECT_EQ(counts[7], 0);  // the one behind
}

}  // namespace
}  // namespace s2gs
