#include <gtest/gtest.h>

#include <map>
#include <opencv2/core.hpp>
#include <opencv2/features2d.hpp>

#include "tests/support/synthetic_render.h"

namespace s2gs {
namespace {

TEST(SyntheticSift, FindsKeypointsOnEveryBodyAndMatchesThemAcrossSteps) {
  SyntheticTurntableOptions options;
  options.stations = 1;
  options.steps = 2;
  options.step_deg = 10;
  options.num_object_points = options.num_platter_points = options.num_background_points = 0;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  SyntheticRenderOptions render_options;
  render_options.use_turntable_object = true;
  const SyntheticRenderScene scene = MakeSyntheticRenderScene(turntable, render_options);
  std::vector<cv::KeyPoint> keypoints[2];
  cv::Mat descriptors[2];
  SyntheticRendering renderings[2];
  for (int i = 0; i < 2; ++i) {
    renderings[i] = RenderImage(scene, turntable, i);
    cv::Mat green;
    cv::extractChannel(cv::Mat(480, 640, CV_8UC3, renderings[i].rgb.pixels.data()), green, 1);
    cv::SIFT::create(8000)->detectAndCompute(green, cv::noArray(), keypoints[i], descriptors[i]);
    std::map<uint8_t, int> found;
    for (const cv::KeyPoint& keypoint : keypoints[i]) {
      ++found[*renderings[i].label.Pixel(static_cast<int>(keypoint.pt.x), static_cast<int>(keypoint.pt.y))];
    }
    for (const auto& [label, count] : found) RecordProperty("found" + std::to_string(label), count);
    EXPECT_GT(found[kObjectLabel], 150);
    EXPECT_GT(found[kDiscLabel], 100);
    EXPECT_GT(found[kStaticLabel], 500);
  }
  std::vector<std::vector<cv::DMatch>> matches;
  cv::BFMatcher(cv::NORM_L2).knnMatch(descriptors[0], descriptors[1], matches, 2);
  std::map<uint8_t, int> right;
  std::map<uint8_t, int> wrong;
  const Camera& camera = turntable.scene.cameras[0];
  for (const auto& match : matches) {
    if (match[0].distance > 0.8 * match[1].distance) continue;
    const cv::Point2f a = keypoints[0][static_cast<size_t>(match[0].queryIdx)].pt;
    const cv::Point2f b = keypoints[1][static_cast<size_t>(match[0].trainIdx)].pt;
    // OpenCV's pixel centres are at whole numbers.
    const int x = static_cast<int>(std::lround(a.x));
    const int y = static_cast<int>(std::lround(a.y));
    if (x < 0 || y < 0 || x >= 640 || y >= 480) continue;
    const uint8_t label = *renderings[0].label.Pixel(x, y);
    const double depth = renderings[0].depth[static_cast<size_t>(640 * y + x)];
    const auto ray = UnprojectFromImage(camera, {a.x + 0.5, a.y + 0.5});
    const View& view1 = turntable.scene.views[0];
    const View& view2 = turntable.scene.views[1];
    const bool rotates = label != kStaticLabel;
    const Rigid3 cam1 = rotates ? view1.CamFromObject() : view1.cam_from_world;
    const Rigid3 cam2 = rotates ? view2.CamFromObject() : view2.cam_from_world;
    const auto expected = ProjectToImage(camera, cam2 * (cam1.Inverse() * Eigen::Vector3d(depth * *ray)));
    const bool hit = expected && (*expected - Eigen::Vector2d(b.x + 0.5, b.y + 0.5)).norm() < 2;
    ++(hit ? right : wrong)[label];
  }
  for (const uint8_t label : {kObjectLabel, kDiscLabel, kStaticLabel}) {
    RecordProperty("right" + std::to_string(label), right[label]);
    RecordProperty("wrong" + std::to_string(label), wrong[label]);
    EXPECT_GT(right[label], 4 * wrong[label]) << int{label};
  }
  EXPECT_GT(right[kObjectLabel], 50);
}

}  // namespace
}  // namespace s2gs
