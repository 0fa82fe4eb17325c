#include "plugin/report/verdict_json.h"

#include <fmt/format.h>

#include <cmath>
#include <string>

namespace s2gs {
namespace {

using nlohmann::json;

json Number(const std::optional<double>& value) {
  return value && std::isfinite(*value) ? json(*value) : json(nullptr);
}

json ToJson(const AgreeingMatches& matches) {
  return {{"all", matches.all},
          {"agreeing", matches.agreeing},
          {"by_chance", matches.by_chance},
          {"share", Number(matches.Share())}};
}

}  // namespace

json ToJson(const ScanVerdict& verdict, const ScanEvidence& evidence) {
  json measured = {{"photos", evidence.photos},
                   {"placed", evidence.placed},
                   {"stations", evidence.stations},
                   {"missing", evidence.missing},
                   {"unsupported", evidence.unsupported},
                   {"one_body", evidence.is_one_body},
                   {"looks_alike", Number(evidence.looks_alike)},
                   {"unmoved_photos", evidence.unmoved_photos},
                   {"bound_px", evidence.bound_px},
                   {"verified", ToJson(evidence.verified)},
                   {"held_back", ToJson(evidence.held_back)},
                   {"adjusted", ToJson(evidence.adjusted)},
                   {"adjusted_noise_px", Number(evidence.adjusted_noise_px)},
                   {"held_back_noise_px", Number(evidence.held_back_noise_px)},
                   {"match_noise_px", Number(evidence.match_noise_px)},
                   {"overdispersion", evidence.overdispersion},
                   {"across_stations", ToJson(evidence.across_stations)},
                   {"background_across", ToJson(evidence.background_across)},
                   {"background_noise_px", Number(evidence.background_noise_px)},
                   {"neighbours", ToJson(evidence.neighbours)},
                   {"neighbour_pairs", evidence.neighbour_pairs},
                   {"contradicted_neighbours", evidence.contradicted_neighbours},
                   {"other_bodies", evidence.other_bodies},
                   {"misturned", evidence.misturned},
                   {"worst_misturn_deg", evidence.worst_misturn_deg},
                   {"untold", evidence.untold},
                   {"untold_stations", evidence.untold_stations},
                   {"seam", ToJson(evidence.seam)},
                   {"seam_pairs", evidence.seam_pairs},
                   {"closing", ToJson(evidence.closing)},
                   {"closed_stations", evidence.closed_stations},
                   {"round_stations", evidence.round_stations},
                   {"contradicted_seams", evidence.contradicted_seams},
                   {"neighbour_apart_deg", Number(evidence.neighbour_apart_deg)},
                   {"far_pairs", evidence.far_pairs},
                   {"widest_far_pair_deg", Number(evidence.widest_far_pair_deg)},
                   {"turns_of_nothing", evidence.turns_of_nothing},
                   {"median_step_deg", Number(evidence.median_step_deg)},
                   {"least_step_deg", Number(evidence.least_step_deg)},
                   {"camera_radius_rel", Number(evidence.camera_radius_rel)},
                   {"points_one_side", Number(evidence.points_one_side)},
                   {"camera_height_rel", Number(evidence.camera_height_rel)},
                   {"focal_guessed", evidence.is_focal_guessed},
                   {"photos_cut", evidence.are_photos_cut},
                   {"wrong_exif_focal", Number(evidence.wrong_exif_focal)},
                   {"focal_widths", evidence.focal_widths},
                   {"focal_sigma_rel", Number(evidence.focal_sigma_rel)},
                   {"focal_prior_share", Number(evidence.focal_prior_share)},
                   {"angle_prior_share", Number(evidence.angle_prior_share)},
                   {"angle_sigma_median_deg", Number(evidence.angle_sigma_median_deg)},
                   {"angle_sigma_max_deg", Number(evidence.angle_sigma_max_deg)},
                   {"axis_sigma_deg", Number(evidence.axis_sigma_deg)},
                   {"scale_sigma_rel", Number(evidence.scale_sigma_rel)},
                   {"free_object", evidence.is_object_free},
                   {"sigmas_missing", evidence.are_sigmas_missing}};
  return {{"verdict", VerdictName(verdict.verdict)},
          {"reasons", verdict.reasons},
          {"advice", verdict.advice},
          {"poses_hold", verdict.poses_hold},
          {"measured", std::move(measured)}};
}

void PrintVerdict(const json& verdict, std::ostream& out) {
  if (!verdict.is_object() || !verdict.contains("verdict")) return;
  out << fmt::format("{:<24}{}\n", "verdict", verdict.value("verdict", ""));
  const auto lines = [&](const char* key, const char* title) {
    const json list = verdict.value(key, json::array());
    for (const json& line : list) {
      if (line.is_string()) out << fmt::format("{:<24}{}\n", title, line.get<std::string>());
      title = "";
    }
  };
  lines("reasons", "  because");
  lines("advice", "  next time");
}

}  // namespace s2gs
