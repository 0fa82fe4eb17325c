#include "sfm_split/scene/io/top_view.h"

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <iomanip>
#include <set>
#include <string>
#include <vector>

#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

constexpr double kPanelPx = 620;     // two panels and their margins: 1,330 px wide
constexpr double kMarginPx = 30;     // around a panel, with its title
constexpr size_t kMaxPoints = 4000;  // of a body: the file stays under a megabyte
// Of stations in turn; bodies have the other colours.
constexpr std::array<const char*, 8> kStationColors = {"#d62728", "#2ca02c", "#9467bd", "#8c564b",
                                                       "#e377c2", "#17becf", "#bcbd22", "#1f77b4"};

// World coordinates to pixels of one panel: `u` and `v` are the world's directions to the right and up.
struct Panel {
  Eigen::Vector3d middle;
  Eigen::Vector3d u;
  Eigen::Vector3d v;
  double left_px;
  double px_per_unit;

  Eigen::Vector2d At(const Eigen::Vector3d& x) const {
    const Eigen::Vector3d d = x - middle;
    return {left_px + kPanelPx / 2 + px_per_unit * d.dot(u),
            kMarginPx + kPanelPx / 2 - px_per_unit * d.dot(v)};
  }
};

struct Cloud {
  const char* color;
  std::vector<Eigen::Vector3d> points;
};

Cloud Thinned(const ColmapModel& model, const char* color, const Eigen::Vector3d& middle, double radius) {
  Cloud cloud{color, {}};
  const size_t stride = std::max<size_t>(1, (model.points3D.size() + kMaxPoints - 1) / kMaxPoints);
  cloud.points.reserve(kMaxPoints);
  size_t at = 0;
  for (const auto& [id, point] : model.points3D) {
    if (at++ % stride != 0) continue;
    if ((point.xyz - middle).norm() <= radius) cloud.points.push_back(point.xyz);
  }
  return cloud;
}

void Line(std::ostream& out, const Eigen::Vector2d& a, const Eigen::Vector2d& b, const char* style) {
  out << "<line x1=\"" << a.x() << "\" y1=\"" << a.y() << "\" x2=\"" << b.x() << "\" y2=\"" << b.y() << "\" "
      << style << "/>\n";
}

void Text(std::ostream& out, double x, double y, const std::string& text) {
  out << "<text x=\"" << x << "\" y=\"" << y << "\" font-family=\"sans-serif\" font-size=\"14\">" << text
      << "</text>\n";
}

void DrawPanel(std::ostream& out, const Panel& panel, const std::string& title, const TurntableScene& scene,
               const std::vector<Cloud>& clouds, double radius) {
  out << "<rect x=\"" << panel.left_px << "\" y=\"" << kMarginPx << "\" width=\"" << kPanelPx
      << "\" height=\"" << kPanelPx << "\" fill=\"#ffffff\" stroke=\"#bbbbbb\"/>\n";
  Text(out, panel.left_px, kMarginPx - 10, title);
  for (const Cloud& cloud : clouds) {
    out << "<g fill=\"" << cloud.color << "\">\n";
    for (const Eigen::Vector3d& point : cloud.points) {
      const Eigen::Vector2d at = panel.At(point);
      out << "<circle cx=\"" << at.x() << "\" cy=\"" << at.y() << "\" r=\"1\"/>\n";
    }
    out << "</g>\n";
  }
  const Eigen::Vector3d half = 0.3 * radius * scene.axis.direction;
  Line(out, panel.At(scene.axis.point - half), panel.At(scene.axis.point + half),
       "stroke=\"#000000\" stroke-width=\"1.5\" stroke-dasharray=\"6 4\"");
  const Eigen::Vector2d foot = panel.At(scene.axis.point);
  out << "<circle cx=\"" << foot.x() << "\" cy=\"" << foot.y()
      << "\" r=\"4\" fill=\"none\" stroke=\"#000000\"/>\n";

  std::set<int> named;
  for (const View& view : scene.views) {
    const char* color = kStationColors[static_cast<size_t>(std::abs(view.station)) % kStationColors.size()];
    const Rigid3 world_from_cam = view.cam_from_world.Inverse();
    const Eigen::Vector3d centre = world_from_cam * Eigen::Vector3d::Zero();
    const Eigen::Vector3d ahead = world_from_cam * Eigen::Vector3d(0, 0, 0.12 * radius);
    const Eigen::Vector2d at = panel.At(centre);
    Line(out, at, panel.At(ahead), (std::string("stroke=\"") + color + "\" stroke-width=\"1\"").c_str());
    out << "<circle cx=\"" << at.x() << "\" cy=\"" << at.y() << "\" r=\"4\" fill=\"" << color << "\"/>\n";
    // Where the camera stands in the object's frame: a ring around the table.
    const Eigen::Vector3d around = view.world_from_object.Inverse() * centre;
    const Eigen::Vector2d ring = panel.At(around);
    out << "<circle cx=\"" << ring.x() << "\" cy=\"" << ring.y() << "\" r=\"2\" fill=\"none\" stroke=\""
        << color << "\"/>\n";
    if (named.size() < 30 && named.insert(view.station).second)
      Text(out, at.x() + 7, at.y() - 5, std::to_string(view.station));
  }
}

}  // namespace

void WriteTopView(std::ostream& stream, const TurntableScene& scene, const ColmapModel& object,
                  const ColmapModel& background) {
  std::vector<double> distances;
  distances.reserve(scene.views.size());
  for (const View& view : scene.views) {
    const Eigen::Vector3d centre = view.cam_from_world.Inverse() * Eigen::Vector3d::Zero();
    distances.push_back((centre - scene.axis.point).norm());
  }
  const double farthest = distances.empty() ? 1.0 : *std::max_element(distances.begin(), distances.end());
  const double radius = std::max(1e-9, 1.15 * farthest);
  const Eigen::Vector3d up = scene.axis.direction.normalized();
  const Eigen::Vector3d right = up.unitOrthogonal();
  const double scale = kPanelPx / (2 * radius);
  const Panel above{scene.axis.point, right, up.cross(right), kMarginPx, scale};
  const Panel side{scene.axis.point, right, up, 2 * kMarginPx + kPanelPx, scale};
  const std::vector<Cloud> clouds = {Thinned(background, "#7aa6d6", scene.axis.point, radius),
                                     Thinned(object, "#ff7f0e", scene.axis.point, radius)};

  const double width = 3 * kMarginPx + 2 * kPanelPx;
  const double height = 3 * kMarginPx + kPanelPx;
  stream << std::fixed << std::setprecision(2);
  stream << "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"" << width << "\" height=\"" << height
         << "\" viewBox=\"0 0 " << width << ' ' << height << "\">\n";
  stream << "<clipPath id=\"frame\"><rect x=\"0\" y=\"0\" width=\"" << width << "\" height=\"" << height
         << "\"/></clipPath>\n<g clip-path=\"url(#frame)\">\n";
  DrawPanel(stream, above, "from above, along the axis", scene, clouds, radius);
  DrawPanel(stream, side, "from the side", scene, clouds, radius);
  Text(stream, kMarginPx, height - 14,
       "orange: rotating part at the reference image; blue: background; dots: cameras, coloured by station; "
       "rings: the same cameras as the object sees them");
  stream << "</g>\n</svg>\n";
}

void WriteTopView(const std::filesystem::path& path, const TurntableScene& scene, const ColmapModel& object,
                  const ColmapModel& background) {
  WriteFileAtomically(path, [&](std::ostream& stream) { WriteTopView(stream, scene, object, background); });
}

}  // namespace s2gs
