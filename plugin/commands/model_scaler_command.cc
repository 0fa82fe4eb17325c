#include "plugin/commands/model_scaler_command.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <ostream>
#include <set>
#include <string>
#include <system_error>
#include <vector>

#include "plugin/outputs/unscaled_scene.h"
#include "plugin/shared_options/scale_options.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/scale/charuco_board.h"
#include "sfm_split/scale/disc_rim.h"
#include "sfm_split/scale/located_marks.h"
#include "sfm_split/scale/markers.h"
#include "sfm_split/scale/scale_bars.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Photos that are looked at for which dictionary the markers are of.
constexpr size_t kNumProbes = 6;
constexpr double kMetresPerMillimetre = 1e-3;
// Two lengths that differ by more cannot both be right: what is measured with a ruler is better.
constexpr double kContradiction = 0.01;
// Places that somebody marks in a photo are good to the pixel.
constexpr double kClickPx = 1;
// What is farther from the circle was not on the rim: five times what clicking explains.
constexpr double kMaxRimPx = 5 * kClickPx;

struct Settings {
  fs::path workspace_path;
  fs::path image_path;
  ScaleOptions scale;
};

// With the markers' size, which is the board's, too.
CharucoBoard BoardOf(const ScaleOptions& scale) {
  return {scale.charuco_columns, scale.charuco_rows, scale.charuco_square_mm, scale.marker_size_mm, {}};
}

using Sightings = std::map<std::string, std::vector<MarkerSighting>>;

std::vector<std::string> NamesOf(const ColmapModel& model) {
  std::vector<std::string> names;
  names.reserve(model.images.size());
  for (const auto& [id, image] : model.images) names.push_back(image.name);
  std::sort(names.begin(), names.end());
  return names;
}

Sightings Detect(const fs::path& folder, const std::vector<std::string>& names,
                 const std::string& dictionary) {
  std::vector<std::vector<MarkerSighting>> found(names.size());
  ParallelFor(static_cast<int64_t>(names.size()), 0, [&](int64_t i) {
    const Image8 photo = ReadImage(folder / names[i], 1);
    found[i] = DetectMarkers(photo.pixels, photo.width, photo.height, dictionary);
  });
  Sightings sightings;
  for (size_t i = 0; i < names.size(); ++i) sightings[names[i]] = std::move(found[i]);
  return sightings;
}

// How many markers two or more photos show: what looks like a marker by chance is not there twice.
size_t CountRepeated(const Sightings& sightings) {
  std::map<int, int> counts;
  for (const auto& [name, markers] : sightings) {
    for (const MarkerSighting& marker : markers) ++counts[marker.id];
  }
  return std::count_if(counts.begin(), counts.end(), [](const auto& entry) { return entry.second > 1; });
}

std::string FindDictionary(const Settings& settings, const std::vector<std::string>& names) {
  if (settings.scale.marker_dictionary != "auto") return settings.scale.marker_dictionary;
  // Neighbours, so that they show the same markers.
  std::vector<std::string> probes;
  for (size_t i = 0; i < std::min(kNumProbes, names.size()); ++i) {
    const size_t pair = i / 2 * names.size() * 2 / kNumProbes;
    probes.push_back(names[std::min(pair + i % 2, names.size() - 1)]);
  }
  std::string best;
  size_t most = 0;
  for (const std::string& dictionary : MarkerDictionaries()) {
    const size_t count = CountRepeated(Detect(settings.image_path, probes, dictionary));
    if (count <= most) continue;
    best = dictionary;
    most = count;
  }
  if (best.empty()) {
    throw UserError(settings.image_path, "no ArUco or AprilTag markers were found in the photos",
                    "State --known_length_mm with --point_a and --point_b, or --marker_dictionary");
  }
  return best;
}

std::vector<PhotoPlace> PlacesInModel(const std::vector<std::string>& texts, const std::string& option,
                                      const std::vector<std::string>& names, const fs::path& workspace) {
  std::vector<PhotoPlace> places = ParsePhotoPlaces(texts, option);
  for (const PhotoPlace& place : places) {
    if (!std::binary_search(names.begin(), names.end(), place.name)) {
      throw UserError(workspace, "its model has no photo \"" + place.name + "\" of --" + option,
                      "Name photos that have a place in sparse/0");
    }
  }
  return places;
}

ScaleBar MarkedLength(const Settings& settings, const ColmapModel& model) {
  MarkSightings sightings;
  const std::vector<std::string> names = NamesOf(model);
  const auto add = [&](const std::vector<std::string>& texts, const std::string& option, int mark) {
    for (const PhotoPlace& place : PlacesInModel(texts, option, names, settings.workspace_path)) {
      sightings[place.name][mark] = {place.x, place.y};
    }
  };
  add(settings.scale.point_a, "point_a", 0);
  add(settings.scale.point_b, "point_b", 1);
  const std::map<int, LocatedMark> marks = LocateMarks(model, sightings);
  for (const int mark : {0, 1}) {
    if (marks.count(mark) > 0) continue;
    throw UserError(
        settings.workspace_path,
        std::string("the sightings of --point_") + (mark == 0 ? "a" : "b") + " do not meet in one point",
        "Give it in two photos or more, from different sides, to the pixel");
  }
  return {"marked length", kMetresPerMillimetre * settings.scale.known_length_mm,
          (marks.at(0).x - marks.at(1).x).norm(), 0};
}

ScaleBar DiscDiameter(const Settings& settings, const UnscaledScene& scene) {
  std::vector<RimSighting> sightings;
  std::map<std::string, const ColmapImage*> images;
  for (const auto& [id, image] : scene.object.images) images[image.name] = &image;
  std::map<std::string, const TurntableImage*> turns;
  for (const TurntableImage& image : scene.table.images) turns[image.name] = &image;
  for (const PhotoPlace& place :
       PlacesInModel(settings.scale.disc_rim, "disc_rim", NamesOf(scene.object), settings.workspace_path)) {
    const ColmapImage& image = *images.at(place.name);
    const auto turn = turns.find(place.name);
    if (turn == turns.end()) continue;
    sightings.push_back({&scene.object.cameras.at(image.camera_id),
                         image.cam_from_world * turn->second->world_from_object.Inverse(),
                         {place.x, place.y}});
  }
  const std::optional<DiscRim> rim = FitDiscRim(scene.table.axis, sightings, kClickPx);
  if (!rim) {
    throw UserError(settings.workspace_path, "the places of --disc_rim do not tell how large the disc is",
                    "Give places on the rim's near side and on its far side, three or more");
  }
  if (rim->rms_px > kMaxRimPx) {
    throw UserError(settings.workspace_path,
                    fmt::format("the places of --disc_rim are {:.1f} px off a circle about the table's axis",
                                rim->rms_px),
                    "Give places on the rim of a round disc that turns about its middle, to the pixel");
  }
  return {"disc's diameter", kMetresPerMillimetre * settings.scale.disc_diameter_mm, 2 * rim->radius,
          2 * rim->sigma};
}

std::vector<ScaleBar> BoardLengths(const Settings& settings, const CharucoBoard& board,
                                   const ColmapModel& model) {
  const std::vector<std::string> names = NamesOf(model);
  std::vector<std::map<int, Eigen::Vector2d>> found(names.size());
  ParallelFor(static_cast<int64_t>(names.size()), 0, [&](int64_t i) {
    const Image8 photo = ReadImage(settings.image_path / names[i], 1);
    found[i] = DetectBoardCorners(photo.pixels, photo.width, photo.height, board);
  });
  MarkSightings sightings;
  for (size_t i = 0; i < names.size(); ++i) sightings[names[i]] = std::move(found[i]);
  std::vector<ScaleBar> bars = BarsOfBoard(board, LocateMarks(model, sightings));
  if (bars.empty()) {
    throw UserError(settings.image_path, "no two corners of the ChArUco board are seen in two photos or more",
                    "Check --charuco_columns, --charuco_rows and --marker_dictionary");
  }
  return bars;
}

// The markers of the body that they are seen to stand on.
std::vector<LocatedMarker> LocateOnEither(const ColmapModel& object, const ColmapModel& background,
                                          const Sightings& sightings) {
  std::map<int, LocatedMarker> best;
  for (const ColmapModel* model : {&object, &background}) {
    if (model->images.empty()) continue;
    for (const LocatedMarker& marker : LocateMarkers(*model, sightings)) {
      const auto found = best.find(marker.id);
      if (found == best.end() || found->second.num_photos < marker.num_photos) best[marker.id] = marker;
    }
  }
  std::vector<LocatedMarker> markers;
  markers.reserve(best.size());
  for (const auto& [id, marker] : best) markers.push_back(marker);
  return markers;
}

nlohmann::json ToJson(const ScaleEstimate& estimate, const std::vector<LocatedMarker>& markers,
                      const std::string& dictionary) {
  nlohmann::json json = {{"version", 1},
                         {"metres_per_former_unit", estimate.metres_per_unit},
                         {"bars", nlohmann::json::array()},
                         {"markers", nlohmann::json::array()}};
  if (std::isfinite(estimate.sigma_rel)) json["sigma_rel"] = estimate.sigma_rel;
  for (const JudgedBar& judged : estimate.bars) {
    json["bars"].push_back({{"name", judged.bar.name},
                            {"known_mm", 1000 * judged.bar.known_m},
                            {"residual_mm", 1000 * judged.residual_m},
                            {"is_outlier", judged.is_outlier}});
  }
  if (!dictionary.empty()) json["dictionary"] = dictionary;
  for (const LocatedMarker& marker : markers) {
    const Eigen::Vector3d x = 1000 * estimate.metres_per_unit * marker.Center();
    json["markers"].push_back({{"id", marker.id},
                               {"center_mm", {x.x(), x.y(), x.z()}},
                               {"side_mm", 1000 * estimate.metres_per_unit * marker.side},
                               {"photos", marker.num_photos}});
  }
  return json;
}

void Print(const ScaleEstimate& estimate, const Workspace& workspace, std::ostream& out) {
  for (const JudgedBar& judged : estimate.bars) {
    out << fmt::format("{:<16} {:.2f} mm, {:+.3f} mm{}\n", judged.bar.name, 1000 * judged.bar.known_m,
                       1000 * judged.residual_m, judged.is_outlier ? ", an outlier: not used" : "");
  }
  out << fmt::format("scale            {:.6g} m to the former unit, from {} of {} lengths",
                     estimate.metres_per_unit, estimate.num_used, estimate.bars.size());
  if (std::isfinite(estimate.sigma_rel)) out << fmt::format(", good to {:.3f} %", 100 * estimate.sigma_rel);
  out << "\nwritten          " << workspace.ObjectModel().string() << ", " << workspace.Turntable().string()
      << '\n';
}

std::vector<ScaleBar> MarkerSides(const Settings& settings, const std::vector<LocatedMarker>& markers,
                                  const std::string& dictionary) {
  std::string found;
  for (const LocatedMarker& marker : markers)
    found += (found.empty() ? "" : ", ") + std::to_string(marker.id);
  if (markers.empty()) {
    throw UserError(
        settings.image_path,
        fmt::format("no marker of the dictionary {} is seen well enough in two photos or more", dictionary),
        "Take photos with the markers in sight, let `--marker_dictionary auto` look for other ones, or state "
        "--known_length_mm");
  }
  if (settings.scale.marker_size_mm <= 0) {
    throw UserError(settings.image_path,
                    fmt::format("shows the {} markers {}, but not how large they are", dictionary, found),
                    "State the side of their black squares as --marker_size_mm");
  }
  std::vector<LocatedMarker> used;
  const std::set<int32_t> wanted(settings.scale.marker_ids.begin(), settings.scale.marker_ids.end());
  for (const LocatedMarker& marker : markers) {
    if (wanted.empty() || wanted.count(marker.id) > 0) used.push_back(marker);
  }
  if (used.empty()) {
    throw UserError(
        settings.image_path,
        fmt::format("shows the {} markers {}, and none of those that --marker_ids names", dictionary, found),
        "Name markers that are there, or leave --marker_ids out to use all");
  }
  return BarsOfMarkers(used, kMetresPerMillimetre * settings.scale.marker_size_mm);
}

// Lengths of two kinds that cannot both be right have no mean.
void RequireAgreement(const std::vector<ScaleBar>& bars, const std::vector<ScaleBar>& more,
                      const fs::path& workspace) {
  if (bars.empty()) return;
  const double one = EstimateScale(bars).metres_per_unit;
  const double other = EstimateScale(more).metres_per_unit;
  // Ink makes small markers wrong by more.
  const double printed = std::max(bars.front().common_rel, more.front().common_rel);
  if (std::abs(one / other - 1) <= kContradiction + 2 * printed) return;
  const ScaleBar& first = bars.back();
  const ScaleBar& second = more.front();
  throw UserError(workspace,
                  fmt::format("the lengths contradict each other: by the {} the {} is {:.2f} mm, not {:.2f}, "
                              "and the other way round the {} is {:.3f} mm, not {:.3f}",
                              first.name, second.name, 1000 * one * second.measured, 1000 * second.known_m,
                              first.name, 1000 * other * first.measured, 1000 * first.known_m),
                  "Measure both again, or state only one");
}

void Scale(const Settings& settings, const Workspace& workspace, Reporter& reporter, std::ostream& out) {
  UnscaledScene scene(workspace);
  std::vector<ScaleBar> bars;
  std::vector<LocatedMarker> markers;
  std::string dictionary;
  const bool has_length = settings.scale.known_length_mm > 0;
  const bool has_disc = settings.scale.disc_diameter_mm > 0;
  const auto add = [&](const std::vector<ScaleBar>& more) {
    RequireAgreement(bars, more, settings.workspace_path);
    bars.insert(bars.end(), more.begin(), more.end());
  };
  if (settings.scale.HasBoard()) {
    const std::vector<std::string> names = NamesOf(scene.object);
    CharucoBoard board = BoardOf(settings.scale);
    dictionary = board.dictionary = FindDictionary(settings, names);
    // Markers that are not those of such a board yield corners all the same; their sides tell.
    const std::vector<LocatedMarker> seen =
        LocateMarkers(scene.object, Detect(settings.image_path, names, dictionary));
    if (!seen.empty()) bars = BarsOfMarkers(seen, kMetresPerMillimetre * board.marker_mm);
    const std::vector<ScaleBar> lengths = BoardLengths(settings, board, scene.object);
    RequireAgreement(bars, lengths, settings.workspace_path);
    bars = lengths;
  } else if (settings.scale.marker_size_mm > 0 || (!has_length && !has_disc)) {
    const std::vector<std::string> names = NamesOf(scene.object);
    dictionary = FindDictionary(settings, names);
    const Sightings sightings = Detect(settings.image_path, names, dictionary);
    // Without a scale between both bodies only the rotating one has the model's unit.
    markers = LocateOnEither(scene.object, scene.table.scale_observable ? scene.background : ColmapModel(),
                             sightings);
    reporter.Info(fmt::format("{} markers of the dictionary {} were located", markers.size(), dictionary));
    add(MarkerSides(settings, markers, dictionary));
  }
  if (has_length) add({MarkedLength(settings, scene.object)});
  if (has_disc) add({DiscDiameter(settings, scene)});
  const ScaleEstimate estimate = EstimateScale(bars);
  scene.WriteInMetres(estimate.metres_per_unit);
  WriteFileAtomically(workspace.ScaleReport(), [&](std::ostream& stream) {
    stream << ToJson(estimate, markers, dictionary).dump(1) << '\n';
  });
  Print(estimate, workspace, out);
}

// All that lengths can be asked before there are poses.
void RequireSoundScale(const ScaleOptions& scale) {
  RequireComplete(scale);
  const std::vector<std::string>& known = MarkerDictionaries();
  if (scale.marker_dictionary != "auto" &&
      std::find(known.begin(), known.end(), scale.marker_dictionary) == known.end()) {
    throw CommandLineError(fmt::format("--marker_dictionary {} is none of auto, {}.", scale.marker_dictionary,
                                       fmt::join(known, ", ")));
  }
  if (!scale.HasBoard()) return;
  if (const OptionCheck fault = BoardOf(scale).Check()) {
    throw CommandLineError(fmt::format("--{} {}: {}.", fault->field, fault->value, fault->bound));
  }
}

}  // namespace

void RunModelScaler(CommandContext& context) {
  Settings settings;
  Options& options = context.Declare(
      "Makes the scene metric: sparse/0, sparse/static and turntable.json in metres, and so all that is made "
      "from them. The scale comes from printed markers (ArUco, AprilTag) of stated size that the photos "
      "show, on the table or in the background, from a ChArUco board on the table, from a length between two "
      "points that are marked in photos, or from the diameter of the table's disc. The residual of each "
      "length, in mm, is printed and written to split/scale.json.",
      "--workspace_path scan --image_path photos --marker_size_mm 33");
  options.Add("workspace_path", &settings.workspace_path, "the workspace, with sparse/0 and turntable.json")
      .Required();
  options.Add("image_path", &settings.image_path, "the photos; empty: images in the workspace");
  AddScaleOptions(&options, &settings.scale);
  Reporter& reporter = context.Parse([&] { RequireSoundScale(settings.scale); });
  const Workspace workspace{settings.workspace_path};
  if (settings.image_path.empty()) settings.image_path = workspace.Images();
  StageRunner runner(workspace, reporter);
  Stage stage;
  stage.name = "model_scaler";
  stage.inputs = {settings.image_path};
  stage.options = ValuesWithout(options, {"workspace_path", "image_path"});
  stage.outputs = {workspace.ScaleReport(), workspace.ObjectModel(), workspace.Turntable()};
  stage.also_writes = {workspace.StaticModel(), workspace.TurntableMapper()};
  stage.depends_on = {"turntable_mapper"};
  if (!runner.Run(stage, [&] { Scale(settings, workspace, reporter, context.out()); })) {
    context.out() << "up to date       " << workspace.ScaleReport().string() << '\n';
  }
}

}  // namespace s2gs
