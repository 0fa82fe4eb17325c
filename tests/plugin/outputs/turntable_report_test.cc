#include "plugin/outputs/turntable_report.h"

#include <gtest/gtest.h>

#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {
namespace {

TEST(TurntableReport, MeanErrorsAreOverPointsAndOverObservations) {
  ColmapModel model;
  EXPECT_EQ(DescribePoints(model).at("mean_reprojection_error_px"), 0);
  const auto add = [&](uint64_t id, double error, size_t length) {
    ColmapPoint3D& point = model.points3D[id];
    point.error = error;
    point.track.resize(length);
  };
  add(1, 0.25, 2);
  add(2, 1.0, 6);
  const nlohmann::json body = DescribePoints(model);
  EXPECT_EQ(body.at("points"), 2);
  EXPECT_EQ(body.at("observations"), 8);
  EXPECT_DOUBLE_EQ(body.at("mean_reprojection_error_px"), 0.625);
  EXPECT_DOUBLE_EQ(body.at("mean_observation_error_px"), (2 * 0.25 + 6 * 1.0) / 8);
}

}  // namespace
}  // namespace s2gs
