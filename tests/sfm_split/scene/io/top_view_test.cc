#include "sfm_split/scene/io/top_view.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <sstream>
#include <string>

namespace s2gs {
namespace {

int CountOf(const std::string& text, const std::string& part) {
  int count = 0;
  for (size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++count;
  return count;
}

// Two stations two units from the axis, four steps each.
TurntableScene Scene() {
  TurntableScene scene;
  scene.num_stations = 2;
  for (int i = 0; i < 8; ++i) {
    View view;
    view.name = "image" + std::to_string(i);
    view.station = i / 4;
    const double azimuth = view.station == 0 ? 0.3 : -0.4;
    Rigid3 world_from_cam;
    world_from_cam.rotation = Eigen::AngleAxisd(azimuth, Eigen::Vector3d::UnitZ()) *
                              Eigen::AngleAxisd(-1.5707963267948966, Eigen::Vector3d::UnitX());
    world_from_cam.translation = world_from_cam.rotation * Eigen::Vector3d(0, 0, -2);
    view.cam_from_world = world_from_cam.Inverse();
    view.world_from_object.rotation = Eigen::AngleAxisd(1.5707963267948966 * i, Eigen::Vector3d::UnitZ());
    scene.views.push_back(view);
  }
  return scene;
}

ColmapModel Points(int count, double distance) {
  ColmapModel model;
  for (int p = 0; p < count; ++p) {
    ColmapPoint3D point;
    point.point3D_id = p + 1;
    point.xyz = {distance, 0.001 * p, 0.1};
    model.points3D[point.point3D_id] = point;
  }
  return model;
}

TEST(TopView, DrawsEveryPointAndCameraTwice) {
  std::ostringstream out;
  WriteTopView(out, Scene(), Points(50, 0.1), Points(70, -1.5));
  const std::string svg = out.str();
  EXPECT_EQ(svg.substr(0, 4), "<svg");
  EXPECT_THAT(svg, testing::EndsWith("</svg>\n"));
  EXPECT_EQ(CountOf(svg, "r=\"1\""), 2 * (50 + 70));
  EXPECT_EQ(CountOf(svg, "r=\"4\" fill=\"#"), 2 * 8);
  EXPECT_EQ(CountOf(svg, "r=\"2\" fill=\"none\""), 2 * 8);
  EXPECT_THAT(svg, testing::Not(testing::HasSubstr("nan")));
}

TEST(TopView, LeavesOutWhatIsFarAndThinsWhatIsMany) {
  std::ostringstream out;
  WriteTopView(out, Scene(), Points(9000, 0.1), Points(10, 100));
  const int drawn = CountOf(out.str(), "r=\"1\"");
  EXPECT_LE(drawn, 2 * 4000);
  EXPECT_GE(drawn, 2 * 500);  // those of the 9,000 that lie within the cameras' distance
}

TEST(TopView, AnEmptySceneIsAPicture) {
  std::ostringstream out;
  WriteTopView(out, {}, {}, {});
  EXPECT_THAT(out.str(), testing::EndsWith("</svg>\n"));
}

}  // namespace
}  // namespace s2gs
