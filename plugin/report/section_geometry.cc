#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "plugin/report/plot.h"
#include "plugin/report/sections.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/scene/camera_projection.h"

namespace s2gs {
namespace {

using Json = nlohmann::json;

constexpr double kFilmWidthMm = 36;

const Json& Part(const Json& object, const char* key) {
  static const Json nothing;
  if (!object.is_object()) return nothing;
  const auto found = object.find(key);
  return found == object.end() ? nothing : *found;
}

std::string PlusMinus(double sigma, const std::string& unit, double factor = 1) {
  if (std::isnan(sigma)) return "not observable";
  if (sigma == 0) return "held";
  return "± " + Significant(factor * sigma, 2) + unit;
}

struct Row {
  std::string what;
  std::string value;
  std::string sigma;
  std::string rests_on;
};

// How far the lens moves a point from where a pinhole would show it, at a distance from the principal point.
struct LensCurve {
  std::vector<std::pair<double, double>> points;  // distance in the pinhole's photo, shift [px]
  double corner_px = 0;                           // shift at the corner farthest from the principal point
};

LensCurve CurveOf(const Camera& camera) {
  LensCurve curve;
  if (!InfoOf(camera.model).has_projection) return curve;
  const Eigen::Vector2d focal = FocalLengths(camera);
  const Eigen::Vector2d principal = PrincipalPoint(camera);
  const Eigen::Vector2d size(static_cast<double>(camera.width), static_cast<double>(camera.height));
  const Eigen::Vector2d corner = principal.cwiseMax(size - principal);
  constexpr int kSteps = 40;
  for (int i = 0; i <= kSteps; ++i) {
    const Eigen::Vector2d d = corner * i / kSteps;
    const std::optional<Eigen::Vector2d> xy =
        ProjectToImage(camera, Eigen::Vector3d(d.x() / focal.x(), d.y() / focal.y(), 1));
    if (!xy) break;
    const double shift = (*xy - principal).norm() - d.norm();
    curve.points.emplace_back(d.norm(), shift);
    curve.corner_px = shift;
  }
  return curve;
}

std::string Observations(const Json& body, const char* name) {
  const double count = NumberOr(body, "adjusted_observations");
  if (std::isnan(count) || count == 0) return "";
  return fmt::format("{} keypoints of the {}", count, name);
}

// How much of the focal length's standard deviation is what was assumed before, not what the photos say.
std::string PriorShare(const ReportInput& input) {
  const double share = NumberOr(Part(Part(input.mapper, "verdict"), "measured"), "focal_prior_share");
  return std::isnan(share) ? ""
                           : fmt::format("; {} % on what was assumed before", ShortNumber(100 * share, 1));
}

void AddCameras(const ReportInput& input, const std::string& keypoints, std::vector<Row>* rows, Plot* plot,
                nlohmann::ordered_json* numbers) {
  const Json& focal_sigmas = Part(Part(input.mapper, "sigma"), "focal_px");
  size_t place = 0;
  for (const auto& [id, camera] : input.object->cameras) {
    const CameraModelInfo& info = InfoOf(camera.model);
    const bool has_sigma =
        focal_sigmas.is_array() && place < focal_sigmas.size() && focal_sigmas[place].is_number();
    const double sigma = has_sigma ? focal_sigmas[place].get<double>() : std::nan("");
    ++place;
    if (info.num_focal_params == 0) continue;
    const std::string of_camera = input.object->cameras.size() > 1 ? fmt::format(", camera {}", id) : "";
    const Eigen::Vector2d focal = FocalLengths(camera);
    const auto longer = static_cast<double>(std::max(camera.width, camera.height));
    const double field = 2 * std::atan(longer / (2 * focal.x())) * 180 / kPi;
    rows->push_back(
        {"focal length" + of_camera,
         fmt::format("{} px ({} mm on 35 mm film, {}° across the longer side)", ShortNumber(focal.x(), 1),
                     ShortNumber(focal.x() * kFilmWidthMm / longer, 1), ShortNumber(field, 1)),
         input.mapper.is_null() ? "–" : PlusMinus(sigma, " px"), keypoints + PriorShare(input)});
    const LensCurve curve = CurveOf(camera);
    std::string params;
    for (size_t i = info.FirstExtraParam(); i < camera.params.size(); ++i) {
      params += (params.empty() ? "" : ", ") + Significant(camera.params[i], 3);
    }
    rows->push_back({"distortion" + of_camera,
                     params.empty() ? "none: " + std::string(info.name)
                                    : fmt::format("{}: {}; it moves the corners by {} px", info.name, params,
                                                  Significant(curve.corner_px, 2)),
                     "–", params.empty() ? "" : keypoints});
    if (!params.empty() && !curve.points.empty()) {
      plot->series.push_back({fmt::format("camera {}", id),
                              static_cast<int>(plot->series.size()),
                              PlotMark::kLine,
                              curve.points,
                              {},
                              {}});
    }
    (*numbers)["cameras"].push_back({{"camera_id", id},
                                     {"model", info.name},
                                     {"width", camera.width},
                                     {"height", camera.height},
                                     {"params", camera.params},
                                     {"focal_sigma_px", FiniteOrNull(sigma)},
                                     {"corner_shift_px", FiniteOrNull(curve.corner_px)}});
  }
}

void AddTable(const ReportInput& input, const std::string& object_keypoints, const std::string& keypoints,
              std::vector<Row>* rows, nlohmann::ordered_json* numbers) {
  const Json& sigma = Part(input.mapper, "sigma");
  if (!sigma.is_object()) return;
  rows->push_back({"table angles",
                   fmt::format("{} of them", input.turntable ? input.turntable->images.size() : 0),
                   PlusMinus(NumberOr(sigma, "angle_median_deg"), "°") + " (worst " +
                       PlusMinus(NumberOr(sigma, "angle_max_deg"), "°") + ")",
                   object_keypoints});
  rows->push_back({"axis, direction", "z of the scene", PlusMinus(NumberOr(sigma, "axis_direction_deg"), "°"),
                   keypoints});
  rows->push_back({"axis, place", "origin of the scene",
                   PlusMinus(NumberOr(sigma, "axis_point"), std::string(" ") + input.LengthUnitName()),
                   keypoints});
  const int stations = input.turntable ? input.turntable->num_stations : 0;
  const bool is_observable = input.turntable && input.turntable->scale_observable;
  rows->push_back({"scale of the object against the background",
                   is_observable ? "observed" : "1, by definition",
                   is_observable ? PlusMinus(NumberOr(sigma, "scale_rel"), " %", 100) : "not observable",
                   is_observable  ? fmt::format("the distances between {} stations", stations)
                   : stations > 1 ? "nothing: no background ties the stations"
                                  : "nothing: one station cannot tell it"});
  rows->push_back({"unit of length",
                   input.turntable && input.turntable->units == LengthUnit::kMetre ? "metre" : "SfM's own",
                   "–",
                   input.turntable && input.turntable->units == LengthUnit::kMetre ? "a known length"
                                                                                   : "no length is known"});
  const double pixel = NumberOr(sigma, "pixel");
  rows->push_back({"one coordinate of a keypoint", "",
                   pixel > 0 ? "± " + Significant(pixel, 2) + " px" : "not observable",
                   "the residuals of the adjustment, robustly"});
  for (const auto& [key, value] : sigma.items()) (*numbers)["sigma"][key] = value;
}

void AddObservability(const Json& mapper, std::vector<Tile>* tiles, nlohmann::ordered_json* numbers) {
  const Json& observability = Part(mapper, "observability");
  if (!observability.is_object() || !observability.value("computed", false)) return;
  const auto found = observability.find("nullity");
  const int64_t nullity =
      found != observability.end() && found->is_number_integer() ? found->get<int64_t>() : 0;
  std::string free;
  const Json& directions = Part(observability, "null_directions");
  for (const auto& direction : directions) {
    if (direction.is_string()) free += (free.empty() ? "" : "; ") + direction.get<std::string>();
  }
  tiles->push_back(
      {"Undetermined directions", std::to_string(nullity),
       nullity == 0 ? fmt::format("of {} parameters", NumberOr(observability, "parameters")) : free});
  tiles->push_back({"Condition number", Significant(NumberOr(observability, "condition"), 2),
                    "of the adjustment, its parameters scaled"});
  (*numbers)["observability"] = observability;
}

}  // namespace

ReportSection GeometrySection(const ReportInput& input) {
  ReportSection section{"geometry", "Camera and scale", {}, {}};
  section.numbers = nlohmann::ordered_json::object();
  HtmlWriter& out = section.html;
  if (!input.object) {
    WriteMissing("The cameras are not known yet: turntable_mapper finds them.", &out);
    return section;
  }
  const std::string object = Observations(Part(input.mapper, "object"), "rotating part");
  const std::string background = Observations(Part(input.mapper, "background"), "background");
  const std::string both = object + (object.empty() || background.empty() ? "" : ", ") + background;
  std::vector<Row> rows;
  Plot plot{"What the lens does",
            {"distance from the principal point [px]", false},
            {"shift outwards [px]", false},
            {},
            false};
  AddCameras(input, both, &rows, &plot, &section.numbers);
  AddTable(input, object, both, &rows, &section.numbers);
  out.Open("div", {{"class", "scroll"}}).Open("table", {{"class", "wide stacked"}});
  const std::vector<std::string> head = {"", "value", "standard deviation", "rests on"};
  WriteRow(head, &out, "th");
  for (const Row& row : rows) WriteHeadedRow(head, {row.what, row.value, row.sigma, row.rests_on}, &out);
  out.Close().Close();
  std::vector<Tile> tiles;
  AddObservability(input.mapper, &tiles, &section.numbers);
  const Json& joint = Part(input.mapper, "joint_model");
  if (joint.is_object()) {
    tiles.push_back({"Joint model", joint.value("chosen", ""), "chosen by comparing what each explains"});
    section.numbers["joint_model"] = joint;
  }
  if (!tiles.empty()) WriteTiles(tiles, &out);
  if (!plot.series.empty()) {
    out.Open("div", {{"class", "figures"}});
    WritePlot(plot, &out);
    out.Close();
  }
  return section;
}

}  // namespace s2gs
