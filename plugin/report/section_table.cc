#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "plugin/report/plot.h"
#include "plugin/report/sections.h"
#include "plugin/report/table_steps.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rigid3.h"

namespace s2gs {
namespace {

constexpr double kDial = 420;  // width of a drawing
constexpr size_t kMaxPoints = 700;
constexpr double kBeside = 0.2;  // between stations' dots, of a photo's number

// Standard deviations of the angles, by photo; empty when they were not written.
std::map<std::string, double> AngleSigmas(const ReportInput& input) {
  std::map<std::string, double> sigmas;
  if (!input.mapper.is_object() || !input.mapper.contains("angle_sigma_deg")) return sigmas;
  for (const auto& [name, sigma] : input.mapper["angle_sigma_deg"].items()) {
    if (sigma.is_number()) sigmas[name] = sigma.get<double>();
  }
  return sigmas;
}

void WriteDial(const ReportInput& input, const std::map<std::string, double>& sigmas, HtmlWriter* out) {
  const int stations = std::max(1, input.turntable->num_stations);
  out->Open("figure").Element("figcaption", "Table angles, one ring a station");
  out->Open("svg", {{"class", "dial"},
                    {"viewBox", fmt::format("0 0 {0} {0}", kDial)},
                    {"role", "img"},
                    {"aria-label", "Table angles by station"}});
  const double middle = kDial / 2;
  const auto radius = [&](int station) { return 62 + (station + 0.5) * (middle - 62 - 36) / stations; };
  const auto place = [&](double degrees, double r) {
    const double angle = degrees * kPi / 180;
    return Eigen::Vector2d(middle + r * std::cos(angle), middle - r * std::sin(angle));
  };
  for (int degrees = 0; degrees < 360; degrees += 30) {
    const Eigen::Vector2d from = place(degrees, 46);
    const Eigen::Vector2d to = place(degrees, middle - 36);
    out->Void("line", {{"class", "grid"},
                       {"x1", ShortNumber(from.x())},
                       {"y1", ShortNumber(from.y())},
                       {"x2", ShortNumber(to.x())},
                       {"y2", ShortNumber(to.y())}});
    const Eigen::Vector2d label = place(degrees, middle - 19);
    out->Element(
        "text", fmt::format("{}°", degrees),
        {{"x", ShortNumber(label.x())}, {"y", ShortNumber(label.y() + 4)}, {"text-anchor", "middle"}});
  }
  for (int station = 0; station < stations; ++station) {
    out->Void("circle", {{"class", "ring"},
                         {"cx", ShortNumber(middle)},
                         {"cy", ShortNumber(middle)},
                         {"r", ShortNumber(radius(station))}});
  }
  for (const TurntableImage& image : input.turntable->images) {
    const Eigen::Vector2d at = place(image.angle_deg, radius(image.station));
    out->Open("circle", {{"class", "dot " + SeriesClass(image.station)},
                         {"cx", ShortNumber(at.x())},
                         {"cy", ShortNumber(at.y())},
                         {"r", "4"}});
    const auto sigma = sigmas.find(image.name);
    out->Element("title",
                 fmt::format("{}: {}°{}", image.name, ShortNumber(image.angle_deg, 3),
                             sigma == sigmas.end() ? "" : " ± " + Significant(sigma->second, 2) + "°"));
    out->Close();
  }
  out->Element("text", Count(input.turntable->images.size(), "photo"),
               {{"class", "axis"},
                {"x", ShortNumber(middle)},
                {"y", ShortNumber(middle + 5)},
                {"text-anchor", "middle"}});
  out->Close().Close();
}

struct Panel {
  Eigen::Vector3d middle;
  Eigen::Vector3d right;
  Eigen::Vector3d up;
  double scale = 1;

  Eigen::Vector2d At(const Eigen::Vector3d& x) const {
    const Eigen::Vector3d d = x - middle;
    return {kDial / 2 + scale * d.dot(right), kDial / 2 - scale * d.dot(up)};
  }
};

// One path of dots; those outside of the drawing are left out.
void WriteCloud(const ColmapModel& model, const Panel& panel, const char* kind, HtmlWriter* out) {
  const size_t stride = model.points3D.size() / kMaxPoints + 1;
  std::string path;
  size_t at = 0;
  for (const auto& [id, point] : model.points3D) {
    if (at++ % stride != 0) continue;
    const Eigen::Vector2d xy = panel.At(point.xyz);
    if (!(xy.minCoeff() > 0 && xy.maxCoeff() < kDial)) continue;
    path += fmt::format("M{} {}h0", ShortNumber(xy.x(), 1), ShortNumber(xy.y(), 1));
  }
  out->Void("path", {{"class", kind}, {"d", path}});
}

void WriteView(const ReportInput& input, const Panel& panel, double reach, const std::string& title,
               HtmlWriter* out) {
  out->Open("figure").Element("figcaption", title);
  out->Open("svg", {{"class", "scene"},
                    {"viewBox", fmt::format("0 0 {0} {0}", kDial)},
                    {"role", "img"},
                    {"aria-label", title}});
  if (input.background) WriteCloud(*input.background, panel, "cloud still", out);
  WriteCloud(*input.object, panel, "cloud turning", out);
  if (!input.IsOneBody()) {
    const TurntableAxis& axis = input.turntable->axis;
    const Eigen::Vector2d low = panel.At(axis.point - 0.3 * reach * axis.direction);
    const Eigen::Vector2d high = panel.At(axis.point + 0.3 * reach * axis.direction);
    out->Void("line", {{"class", "tableaxis"},
                       {"x1", ShortNumber(low.x())},
                       {"y1", ShortNumber(low.y())},
                       {"x2", ShortNumber(high.x())},
                       {"y2", ShortNumber(high.y())}});
  }
  for (const TurntableImage& image : input.turntable->images) {
    const ColmapImage* pose = input.ObjectImage(image.name);
    if (pose == nullptr) continue;
    const Rigid3 world_from_cam = image.world_from_object * pose->cam_from_world.Inverse();
    const Eigen::Vector2d at = panel.At(world_from_cam.translation);
    const Eigen::Vector2d ahead = panel.At(world_from_cam * Eigen::Vector3d(0, 0, 0.14 * reach));
    out->Open("g", {{"class", SeriesClass(image.station)}});
    out->Void("line", {{"class", "look"},
                       {"x1", ShortNumber(at.x(), 1)},
                       {"y1", ShortNumber(at.y(), 1)},
                       {"x2", ShortNumber(ahead.x(), 1)},
                       {"y2", ShortNumber(ahead.y(), 1)}});
    out->Open("circle",
              {{"class", "dot"}, {"cx", ShortNumber(at.x(), 1)}, {"cy", ShortNumber(at.y(), 1)}, {"r", "4"}});
    out->Element("title", fmt::format("station {}, {}", image.station, image.name)).Close().Close();
  }
  out->Close().Close();
}

void WriteScene(const ReportInput& input, HtmlWriter* out) {
  if (!input.object) return;
  double reach = 0;
  for (const TurntableImage& image : input.turntable->images) {
    const ColmapImage* pose = input.ObjectImage(image.name);
    if (pose == nullptr) continue;
    const Eigen::Vector3d centre = image.world_from_object * CameraCentre(pose->cam_from_world);
    reach = std::max(reach, (centre - input.turntable->axis.point).norm());
  }
  if (!(reach > 0)) return;
  const Eigen::Vector3d up = input.Up();
  const Eigen::Vector3d right = up.unitOrthogonal();
  const double scale = kDial / (2 * 1.15 * reach);
  WriteView(input, {input.turntable->axis.point, right, up.cross(right), scale}, reach,
            input.IsOneBody() ? "From above" : "From above, along the table's axis", out);
  WriteView(input, {input.turntable->axis.point, right, up, scale}, reach, "From the side", out);
}

// Of each station's angles, beside each other where several stations have a photo of that number.
Plot PlotOfSteps(const std::vector<StationSteps>& stations, const std::map<std::string, double>& sigmas) {
  Plot plot{"How far the steps are from equal ones",
            {"photo of its station", false},
            {"deviation [degrees]", false},
            {},
            false};
  for (const StationSteps& station : stations) {
    if (station.deviations_deg.empty()) continue;
    PlotSeries series;
    series.name = fmt::format("station {}", station.station);
    series.color = station.station;
    series.mark = PlotMark::kDots;
    const double beside = kBeside * (static_cast<double>(&station - stations.data()) -
                                     0.5 * static_cast<double>(stations.size() - 1));
    for (size_t i = 0; i < station.photos.size(); ++i) {
      series.points.emplace_back(static_cast<double>(i) + beside, station.deviations_deg[i]);
      const auto sigma = sigmas.find(station.photos[i]);
      if (!sigmas.empty()) {
        series.sigmas.push_back(sigma == sigmas.end() ? std::nan("") : sigma->second);
      }
      series.titles.push_back(
          fmt::format("{}: {}°", station.photos[i], ShortNumber(station.deviations_deg[i], 3)));
    }
    plot.series.push_back(std::move(series));
  }
  return plot;
}

}  // namespace

ReportSection TableSection(const ReportInput& input) {
  ReportSection section{"table", "Table and stations", {}, {}};
  section.numbers = nlohmann::ordered_json::object();
  HtmlWriter& out = section.html;
  if (!input.turntable || input.turntable->images.empty()) {
    WriteMissing("The table's angles are not known yet: turntable_mapper finds them.", &out);
    return section;
  }
  const std::map<std::string, double> sigmas = AngleSigmas(input);
  const std::vector<StationSteps> stations = FindSteps(*input.turntable);
  section.numbers["stations"] = nlohmann::ordered_json::array();
  out.Open("div", {{"class", "figures"}});
  if (input.ShowsATurn()) WriteDial(input, sigmas, &out);
  WriteScene(input, &out);
  const Plot plot = PlotOfSteps(stations, sigmas);
  if (!plot.series.empty()) WritePlot(plot, &out);
  out.Close();
  if (!input.ShowsATurn()) {
    out.Element("p", "Nothing turned: each photo is from a place of its own. Orange: points; dots: cameras.",
                {{"class", "note"}});
    return section;
  }
  out.Open("div", {{"class", "scroll"}}).Open("table");
  WriteRow({"station", "photos", "step", "spread of the steps", "largest gap"}, &out, "th");
  for (const StationSteps& station : stations) {
    WriteRow({std::to_string(station.station), std::to_string(station.photos.size()),
              Significant(station.step_deg, 4) + "°", Significant(station.spread_deg, 2) + "°",
              Significant(station.largest_gap_deg, 3) + "°"},
             &out);
    section.numbers["stations"].push_back({{"station", station.station},
                                           {"photos", station.photos.size()},
                                           {"step_deg", FiniteOrNull(station.step_deg)},
                                           {"spread_deg", FiniteOrNull(station.spread_deg)},
                                           {"largest_gap_deg", FiniteOrNull(station.largest_gap_deg)}});
  }
  out.Close().Close();
  section.numbers["tied_stations"] = input.turntable->tied_stations;
  const std::string apart = DescribeUntiedStations(input.turntable->tied_stations);
  if (!apart.empty()) out.Element("p", "Note: " + apart + ".", {{"class", "note"}});
  out.Element(
      "p",
      "Orange: points of the rotating part; grey: background; dots: cameras, one colour a station, with the "
      "direction in which they look. A gap is the widest arc of the table that a station did not photograph.",
      {{"class", "note"}});
  return section;
}

}  // namespace s2gs
