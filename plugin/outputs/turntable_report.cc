#include "plugin/outputs/turntable_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <vector>

#include "plugin/report/verdict_json.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/printable.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "sfm_split/turntable/tied_stations.h"

namespace s2gs {
namespace {

using nlohmann::json;

constexpr size_t kMaxNamed = 5;
constexpr uint64_t kMaxReportBytes = uint64_t{1} << 28;
constexpr double kWorthSaying = 0.05;  // of a variance

json ToJson(const ModelTest& test) {
  return {{"simple", JointModelName(test.simple)},
          {"general", JointModelName(test.general)},
          {"score", test.score},
          {"worst_image", test.worst_image},
          {"worst_score", test.worst_score},
          {"fitted", test.fitted},
          {"extra_parameters", test.extra_parameters},
          {"f_statistic", test.f_statistic},
          {"bic_gain", test.bic_gain},
          {"accepted", test.accepted}};
}

json ToJson(const PrincipalPointTest& test) {
  return {{"fitted", test.fitted},
          {"twice_log_odds", test.gain},
          {"overdispersion", test.overdispersion},
          {"shift", {test.shift.x(), test.shift.y()}},
          {"accepted", test.accepted}};
}

json BodyToJson(const ColmapModel& model, double rms_px, int adjusted_observations) {
  json body = DescribePoints(model);
  body["adjusted_observations"] = adjusted_observations;
  body["adjusted_rms_px"] = rms_px;
  return body;
}

// What is not observable, and what was not computed, is null in the file.
json SigmaToJson(double sigma) { return sigma >= 0 && std::isfinite(sigma) ? json(sigma) : json(nullptr); }

// The median over images whose angles have a standard deviation.
json PriorShareOfAngles(const JointReport& joint) {
  const std::optional<double> share = AnglePriorShare(joint);
  return share ? json(*share) : json(nullptr);
}

json MendedToJson(const std::vector<RelocalisedImage>& images) {
  json list = json::array();
  for (const RelocalisedImage& image : images) {
    list.push_back({{"name", image.name},
                    {"how", image.how},
                    {"inliers", image.inliers},
                    {"candidates", image.candidates},
                    {"margin", image.margin}});
  }
  return list;
}

json PlacedStationsToJson(const std::vector<RelocalisedImage>& images) {
  json list = json::array();
  for (const RelocalisedImage& image : images) {
    list.push_back({{"image", image.name},
                    {"inliers", image.inliers},
                    {"candidates", image.candidates},
                    {"margin", image.margin}});
  }
  return list;
}

json SigmasToJson(const JointReport& joint) {
  std::vector<double> angles;
  for (const double sigma : joint.angle_sigma_deg) {
    if (sigma > 0) angles.push_back(sigma);
  }
  const double none = -1;
  json focals = json::array();
  for (const double sigma : joint.focal_sigma_px) focals.push_back(SigmaToJson(sigma));
  json not_computed = json::array();
  if (joint.axis_direction_sigma_deg < 0) not_computed.push_back("axis_direction_deg");
  if (joint.axis_point_sigma < 0) not_computed.push_back("axis_point");
  if (angles.empty()) not_computed.push_back("angle_deg");
  if (joint.focal_sigma_px.empty()) not_computed.push_back("focal_px");
  if (joint.scale_sigma_rel < 0) not_computed.push_back("scale_rel");
  return {
      {"pixel", joint.sigma_px},
      {"axis_direction_deg", SigmaToJson(joint.axis_direction_sigma_deg)},
      {"axis_point", SigmaToJson(joint.axis_point_sigma)},
      {"angle_median_deg", SigmaToJson(angles.empty() ? none : UpperMedian(angles))},
      {"angle_max_deg", SigmaToJson(angles.empty() ? none : *std::max_element(angles.begin(), angles.end()))},
      {"focal_px", std::move(focals)},
      {"focal_prior_share", joint.focal_prior_share},
      {"angle_prior_share", PriorShareOfAngles(joint)},
      {"scale_rel", SigmaToJson(joint.scale_sigma_rel)},
      {"not_computed", std::move(not_computed)}};
}

json StatedAnglesToJson(const RefineReport& refined) {
  json stations = json::array();
  for (const KnownAngles& stated : refined.known_angles) {
    stations.push_back({{"station", stated.station},
                        {"believed", stated.is_believed},
                        {"photos", stated.prior.places.size()},
                        {"contradict", stated.contradicts.size()},
                        {"scatter_deg", stated.scatter_rad / kDegree},
                        {"prior_sigma_deg", stated.prior.sigma_rad / kDegree},
                        {"factor", stated.factor},
                        {"factor_sigma", stated.factor_sigma}});
  }
  return {{"contradictions", refined.angle_contradictions}, {"stations", std::move(stations)}};
}

json RoundsToJson(const std::vector<RefineRound>& rounds) {
  json list = json::array();
  for (const RefineRound& round : rounds) {
    list.push_back({{"images", round.images},
                    {"object_points", round.object_points},
                    {"background_points", round.background_points},
                    {"object_rms_px", round.object_rms_px},
                    {"background_rms_px", round.background_rms_px},
                    {"seconds", round.seconds}});
  }
  return list;
}

// A standard deviation for people.
std::string Number(const json& value, bool is_computed = true, const char* format = "{:.4g}") {
  if (!is_computed) return "not computed";
  if (!value.is_number()) return "not observable";
  return fmt::format(fmt::runtime(format), value.get<double>());
}

}  // namespace

json DescribePoints(const ColmapModel& model) {
  size_t observations = 0;
  double over_points = 0;
  double over_observations = 0;
  for (const auto& [id, point] : model.points3D) {
    observations += point.track.size();
    over_points += point.error;
    over_observations += point.error * static_cast<double>(point.track.size());
  }
  const auto mean = [](double sum, size_t count) { return count > 0 ? sum / static_cast<double>(count) : 0; };
  return {{"points", model.points3D.size()},
          {"observations", observations},
          {"mean_reprojection_error_px", mean(over_points, model.points3D.size())},
          {"mean_observation_error_px", mean(over_observations, observations)}};
}

json ToJson(const std::vector<GuidedPhoto>& photos) {
  json result = json::array();
  for (const GuidedPhoto& photo : photos) {
    result.push_back({{"image", photo.name},
                      {"inliers", photo.inliers},
                      {"elsewhere", photo.other},
                      {"chance", photo.chance},
                      {"matches", photo.matches}});
  }
  return result;
}

json ToJson(const PhotoAdjustment& photos) {
  const auto change = [](const HeldBackChange& held_back) {
    return json{{"points", held_back.points},         {"before_px", held_back.before_px},
                {"after_px", held_back.after_px},     {"gain", held_back.gain},
                {"gain_sigma", held_back.gain_sigma}, {"overdispersion", held_back.overdispersion}};
  };
  const std::map<PhotoReason, json> reasons = {{PhotoReason::kNone, nullptr},
                                               {PhotoReason::kHeldBackPatches, "held-back patches"},
                                               {PhotoReason::kStandardDeviations, "standard deviations"}};
  return {
      {"taken", photos.is_taken},
      {"taken_for", reasons.at(photos.reason)},
      {"looked_in",
       photos.looked_in == PhotosLookedIn::kFacing ? "photos that points face" : "photos of tracks"},
      {"finding", photos.finding},
      {"finding_in_facing_photos", photos.facing_finding.empty() ? json() : json(photos.facing_finding)},
      {"log_sigma_change", std::isfinite(photos.log_sigma_change) ? json(photos.log_sigma_change) : json()},
      {"tracks", photos.tracks},
      {"places", photos.places},
      {"places_beside_tracks", photos.places_beside},
      {"tied_stations", photos.tied_stations},
      {"sigma_px", photos.sigma_px},
      {"held_back", {{"patches", change(photos.patches)}, {"keypoints", change(photos.keypoints)}}},
      {"seconds", photos.seconds}};
}

json DescribeScene(const AlignedScene& aligned, const RefineReport& refined) {
  const JointReport& joint = refined.joint;
  json report;
  report["registered"] = aligned.scene.views.size();
  report["missing"] = refined.missing;
  report["mended"] = MendedToJson(refined.relocalised);
  report["doubted"] = refined.doubted;
  report["placed_stations"] = PlacedStationsToJson(refined.placed_stations);
  report["untied"] = refined.untied;
  report["stations"] = aligned.scene.num_stations;
  report["tied_stations"] = SetsOfTiedStations(aligned);
  report["scale_observable"] = aligned.scene.scale_observable;
  report["object_placements"] = json::array();
  for (const TurntableGroup& group : aligned.solution.groups)
    report["object_placements"].push_back(group.num_images);
  report["object"] = BodyToJson(aligned.object, joint.object_rms_px, joint.object_observations);
  report["background"] =
      BodyToJson(aligned.background, joint.background_rms_px, joint.background_observations);
  report["sigma"] = SigmasToJson(joint);
  if (joint.angle_sigma_deg.size() == aligned.scene.views.size()) {
    for (size_t i = 0; i < aligned.scene.views.size(); ++i)
      report["angle_sigma_deg"][aligned.scene.views[i].name] = SigmaToJson(joint.angle_sigma_deg[i]);
  }
  report["cameras"] = json::array();
  for (const Camera& camera : aligned.scene.cameras) {
    report["cameras"].push_back(
        {{"camera_id", camera.camera_id}, {"model", InfoOf(camera.model).name}, {"params", camera.params}});
  }
  const Observability& observability = joint.observability;
  report["observability"] = {{"computed", observability.computed},
                             {"parameters", observability.num_parameters},
                             {"nullity", observability.nullity},
                             {"singular_value_gap", std::sqrt(std::max(0.0, observability.gap))},
                             {"condition", std::sqrt(std::max(0.0, observability.condition))},
                             {"null_directions", observability.null_directions}};
  report["joint_model"] = {{"chosen", JointModelName(refined.model)}, {"tests", json::array()}};
  for (const ModelTest& test : refined.model_tests) report["joint_model"]["tests"].push_back(ToJson(test));
  report["joint_model"]["principal_point"] = ToJson(refined.principal_point);
  report["joint_model"]["point_correlation"] = joint.point_correlation;
  if (!refined.known_angles.empty() || !refined.angle_contradictions.empty())
    report["stated_angles"] = StatedAnglesToJson(refined);
  report["rounds"] = RoundsToJson(refined.rounds);
  report["stable"] = refined.is_stable;
  report["relabelled_keypoints"] = refined.relabelled_keypoints;
  return report;
}

namespace {

// Numbers are read by reference: a number with a fraction, or of 1e300, is then no count, but a fault.
int64_t CountAt(const json& object, const char* key) { return object.at(key).get_ref<const int64_t&>(); }

// The summary's rows, one part of the report after the other.
class SummaryPrinter {
 public:
  SummaryPrinter(const json& report, std::ostream& out) : report_(report), out_(out) {}

  void Print() {
    Row("case", report_.at("case").get<std::string>());
    Row("path", report_.at("path").get<std::string>() + ": " + report_.at("path_reason").get<std::string>());
    Row("images registered",
        fmt::format("{} of {}", CountAt(report_, "registered"), CountAt(report_, "images")));
    for (const auto& name : report_.at("missing")) Row("  missing", name.get<std::string>());
    if (report_.contains("untied") && !report_.at("untied").empty()) {
      Row("  untied", fmt::format("{}: nothing on the background ties their station to the others",
                                  report_.at("untied").size()));
    }
    PrintVerdict(report_.value("verdict", json()), out_);
    if (!report_.contains("sigma")) return;
    PrintMended();
    PrintStations();
    PrintBodies();
    PrintJointModel();
    PrintSigmas();
    PrintScale();
    PrintObservability();
    std::string seconds;
    for (const auto& [step, value] : report_.at("seconds").items()) {
      seconds += fmt::format("{}{} {:.1f}", seconds.empty() ? "" : ", ", step, value.get<double>());
    }
    Row("seconds", seconds);
  }

 private:
  void Row(const std::string& what, const std::string& value) {
    out_ << fmt::format("{:<24}{}\n", what, value);
  }

  void PrintMended() {
    std::map<std::string, std::vector<std::string>> mended;
    for (const auto& image : report_.at("mended")) {
      mended[image.at("how").get<std::string>()].push_back(
          fmt::format("{} ({} of {} keypoints)", image.at("name").get<std::string>(),
                      CountAt(image, "inliers"), CountAt(image, "candidates")));
    }
    for (const auto& [how, images] : mended) {
      Row("  mended", fmt::format("{} images: {}", images.size(), how));
      for (size_t k = 0; k < std::min(images.size(), kMaxNamed); ++k) Row("", images[k]);
      if (images.size() > kMaxNamed) Row("", fmt::format("and {} more", images.size() - kMaxNamed));
    }
  }

  void PrintStations() {
    Row("stations", std::to_string(CountAt(report_, "stations")));
    const std::string apart =
        DescribeUntiedStations(report_.value("tied_stations", std::vector<std::vector<int>>()));
    if (!apart.empty()) Row("  apart", apart);
    for (const auto& placed : report_.at("placed_stations")) {
      Row("  placed",
          fmt::format("{}: by {} of {} matches on the background", placed.at("image").get<std::string>(),
                      CountAt(placed, "inliers"), CountAt(placed, "candidates")));
    }
    if (report_.at("object_placements").size() > 1) {
      Row("object moved", fmt::format("it lay in {} ways on the table, so its pose is free in every image",
                                      report_.at("object_placements").size()));
    }
  }

  void PrintBodies() {
    for (const char* body : {"object", "background"}) {
      const json& figures = report_.at(body);
      if (CountAt(figures, "points") == 0) {
        Row(body, "none");
        continue;
      }
      Row(body, fmt::format("{} points, {} observations, mean reprojection error {:.3f} px over points",
                            CountAt(figures, "points"), CountAt(figures, "observations"),
                            figures.at("mean_reprojection_error_px").get<double>()));
    }
  }

  void PrintJointModel() {
    const json& joint = report_.at("joint_model");
    std::string why;
    for (const json& test : joint.at("tests")) {
      why += fmt::format("{}{}: score {:.2f}{}", why.empty() ? " (" : "; ",
                         test.at("general").get<std::string>(), test.at("score").get<double>(),
                         test.at("fitted").get<bool>()
                             ? fmt::format(", F {:.2f}, {}", test.at("f_statistic").get<double>(),
                                           test.at("accepted").get<bool>() ? "taken" : "not taken")
                             : "");
    }
    Row("joint model", joint.at("chosen").get<std::string>() + why + (why.empty() ? "" : ")"));
    if (joint.value("principal_point", json::object()).value("accepted", false))
      Row("photos", "look cut from larger ones: the lens does not meet them in their middle");
  }

  bool IsComputed(const char* name) const {
    const json left = report_.at("sigma").value("not_computed", json::array());
    return std::find(left.begin(), left.end(), name) == left.end();
  }

  // \param of  the name under which it is among those that were not computed.
  std::string Degrees(const char* name, const char* of) const {
    const json& sigma = report_.at("sigma").at(name);
    const std::string number = Number(sigma, IsComputed(of));
    return sigma.is_number() ? "+- " + number + " degrees" : "standard deviation " + number;
  }

  void PrintSigmas() {
    const json& sigma = report_.at("sigma");
    Row("axis direction", Degrees("axis_direction_deg", "axis_direction_deg"));
    Row("table angles", Degrees("angle_median_deg", "angle_deg") + " (worst " +
                            Number(sigma.at("angle_max_deg"), IsComputed("angle_deg")) + ")");
    const json angle_share = sigma.value("angle_prior_share", json());
    if (angle_share.is_number() && angle_share.get<double>() >= kWorthSaying) {
      Row("",
          fmt::format("{:.0f} % of the variance is that of equal steps", 100 * angle_share.get<double>()));
    }
    const json focal_shares = sigma.value("focal_prior_share", json::array());
    for (size_t c = 0; c < sigma.at("focal_px").size(); ++c) {
      const double share = c < focal_shares.size() ? focal_shares.at(c).get<double>() : 0;
      Row("focal length",
          fmt::format(
              "{:.2f} +- {} px{}", report_.at("cameras").at(c).at("params").at(0).get<double>(),
              Number(sigma.at("focal_px").at(c)),
              share >= kWorthSaying
                  ? fmt::format(", of whose variance {:.0f} % is that of what was known before", 100 * share)
                  : ""));
    }
  }

  void PrintScale() {
    if (!report_.at("scale_observable").get<bool>()) {
      Row("object / background", CountAt(report_, "stations") > 1
                                     ? "scale cannot be observed: no background ties the stations"
                                     : "scale cannot be observed from one station");
      return;
    }
    const json& scale = report_.at("sigma").at("scale_rel");
    Row("object / background", scale.is_number()
                                   ? fmt::format("+- {:.3g} % of scale", 100 * scale.get<double>())
                                   : "scale " + Number(scale, IsComputed("scale_rel")));
  }

  void PrintObservability() {
    const json& observability = report_.at("observability");
    if (!observability.at("computed").get<bool>()) return;
    Row("observability", fmt::format("nullity {} of {} parameters, gap {}", CountAt(observability, "nullity"),
                                     CountAt(observability, "parameters"),
                                     Number(observability.at("singular_value_gap"), true, "{:.2g}")));
    for (const auto& direction : observability.at("null_directions"))
      Row("  free", direction.get<std::string>());
  }

  const json& report_;
  std::ostream& out_;
};

}  // namespace

void PrintTurntableSummary(const std::filesystem::path& path, std::ostream& out) {
  constexpr const char* kRemedy = "Delete it and run turntable_mapper again";
  std::ostringstream summary;
  try {
    const json report = json::parse(ReadWholeFile(path, kMaxReportBytes, kRemedy));
    SummaryPrinter(report, summary).Print();
  } catch (const json::exception& error) {
    throw UserError(path, std::string("is damaged: ") + error.what(), kRemedy);
  }
  out << Printable(summary.str());  // its names come from a file
}

}  // namespace s2gs
