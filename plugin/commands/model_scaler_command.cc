#include "plugin/commands/model_scaler_command.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <ostream>
#include <set>
#include <string>
#include <system_error>
#include <vector>

#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/scale/located_marks.h"
#include "sfm_split/scale/markers.h"
#include "sfm_split/scale/scale_bars.h"
#include "sfm_split/scale/scale_model.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Photos that are looked at for which dictionary the markers are of.
constexpr size_t kNumProbes = 6;
constexpr double kMetresPerMillimetre = 1e-3;
// Two lengths that differ by more cannot both be right: what is measured with a ruler is better.
constexpr double kContradiction = 0.01;

struct Settings {
  fs::path workspace_path;
  fs::path image_path;
  double marker_size_mm = 0;
  std::string marker_dictionary = "auto";
  std::vector<int32_t> marker_ids;
  double known_length_mm = 0;
  std::vector<std::string> point_a;
  std::vector<std::string> point_b;

  OptionCheck Check() const {
    if (!(marker_size_mm >= 0) || !(marker_size_mm <= 1e5)) {
      return OptionFault{"marker_size_mm", fmt::format("{}", marker_size_mm),
                         "0 <= marker_size_mm <= 100000"};
    }
    if (!(known_length_mm >= 0) || !(known_length_mm <= 1e6)) {
      return OptionFault{"known_length_mm", fmt::format("{}", known_length_mm),
                         "0 <= known_length_mm <= 1000000"};
    }
    return std::nullopt;
  }
};

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
  if (settings.marker_dictionary != "auto") return settings.marker_dictionary;
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

// "NAME:X:Y" of each photo that shows the point.
void AddPoint(const std::vector<std::string>& texts, const std::string& option, int mark,
              MarkSightings* sightings) {
  for (const std::string& text : texts) {
    const size_t last = text.rfind(':');
    const size_t middle = last == std::string::npos || last == 0 ? last : text.rfind(':', last - 1);
    try {
      if (middle == std::string::npos || middle == last) throw std::invalid_argument(text);
      size_t end_x = 0;
      size_t end_y = 0;
      const std::string x = text.substr(middle + 1, last - middle - 1);
      const std::string y = text.substr(last + 1);
      (*sightings)[text.substr(0, middle)][mark] = {std::stod(x, &end_x), std::stod(y, &end_y)};
      if (end_x != x.size() || end_y != y.size()) throw std::invalid_argument(text);
    } catch (const std::exception&) {
      throw CommandLineError(
          fmt::format("--{}: \"{}\" is not NAME:X:Y, a photo's name and pixels in it.", option, text));
    }
  }
}

ScaleBar MarkedLength(const Settings& settings, const ColmapModel& model) {
  MarkSightings sightings;
  AddPoint(settings.point_a, "point_a", 0, &sightings);
  AddPoint(settings.point_b, "point_b", 1, &sightings);
  const std::vector<std::string> names = NamesOf(model);
  for (const auto& [name, marks] : sightings) {
    if (!std::binary_search(names.begin(), names.end(), name)) {
      throw UserError(settings.workspace_path,
                      "its model has no photo \"" + name + "\" of --point_a or --point_b",
                      "Name photos that have a place in sparse/0");
    }
  }
  const std::map<int, LocatedMark> marks = LocateMarks(model, sightings);
  for (const int mark : {0, 1}) {
    if (marks.count(mark) > 0) continue;
    throw UserError(
        settings.workspace_path,
        std::string("the sightings of --point_") + (mark == 0 ? "a" : "b") + " do not meet in one point",
        "Give it in two photos or more, from different sides, to the pixel");
  }
  return {"marked length", kMetresPerMillimetre * settings.known_length_mm,
          (marks.at(0).x - marks.at(1).x).norm(), 0};
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

// What is scaled, as turntable_mapper left it. A run that was killed may have scaled the models and not yet
// turntable.json, which is written last: then the copy counts.
class UnscaledScene {
 public:
  explicit UnscaledScene(const Workspace& workspace)
      : workspace_(workspace), copy_(workspace.SplitLabels().parent_path() / "unscaled") {
    const std::string turntable = Read(workspace.Turntable());
    std::error_code ec;
    if (!fs::exists(copy_ / "turntable.json", ec) || Read(copy_ / "turntable.json") != turntable) {
      fs::remove_all(copy_, ec);
      CreateFolder(copy_);
      WriteColmapModel(copy_ / "0", ReadColmapModel(workspace.ObjectModel()), ColmapFormat::kBinary);
      if (fs::exists(workspace.StaticModel(), ec)) {
        WriteColmapModel(copy_ / "static", ReadColmapModel(workspace.StaticModel()), ColmapFormat::kBinary);
      }
      WriteFileAtomically(copy_ / "turntable.json", [&](std::ostream& out) { out << turntable; });
    }
    object = ReadColmapModel(copy_ / "0");
    if (fs::exists(copy_ / "static", ec)) background = ReadColmapModel(copy_ / "static");
    table = ReadTurntableFile(copy_ / "turntable.json");
  }

  void WriteInMetres(double metres_per_unit) {
    ScaleModel(metres_per_unit, &object);
    WriteColmapModel(workspace_.ObjectModel(), object, ColmapFormat::kBinary);
    if (!background.images.empty()) {
      ScaleModel(metres_per_unit, &background);
      WriteColmapModel(workspace_.StaticModel(), background, ColmapFormat::kBinary);
    }
    ScaleTurntableToMetres(metres_per_unit, &table);
    WriteTurntableFile(workspace_.Turntable(), table);
    std::error_code ec;
    fs::remove_all(copy_, ec);
  }

  ColmapModel object;
  ColmapModel background;
  TurntableFile table;

 private:
  static std::string Read(const fs::path& path) {
    return ReadWholeFile(path, uint64_t{1} << 30, "Run `s2gs turntable_mapper` first");
  }
  const Workspace& workspace_;
  fs::path copy_;
};

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

void Scale(const Settings& settings, const Workspace& workspace, Reporter& reporter, std::ostream& out) {
  UnscaledScene scene(workspace);
  std::vector<ScaleBar> bars;
  std::vector<LocatedMarker> markers;
  std::string dictionary;
  const bool has_length = settings.known_length_mm > 0;
  if (settings.marker_size_mm > 0 || !has_length) {
    const std::vector<std::string> names = NamesOf(scene.object);
    dictionary = FindDictionary(settings, names);
    const Sightings sightings = Detect(settings.image_path, names, dictionary);
    // Without a scale between both bodies only the rotating one has the model's unit.
    markers = LocateOnEither(scene.object, scene.table.scale_observable ? scene.background : ColmapModel(),
                             sightings);
    reporter.Info(fmt::format("{} markers of the dictionary {} were located", markers.size(), dictionary));
    if (settings.marker_size_mm <= 0) {
      std::string list;
      for (const LocatedMarker& marker : markers)
        list += (list.empty() ? "" : ", ") + std::to_string(marker.id);
      throw UserError(settings.image_path,
                      fmt::format("shows the {} markers {}, but not how large they are", dictionary, list),
                      "State the side of their black squares as --marker_size_mm");
    }
    std::vector<LocatedMarker> used;
    const std::set<int32_t> wanted(settings.marker_ids.begin(), settings.marker_ids.end());
    for (const LocatedMarker& marker : markers) {
      if (wanted.empty() || wanted.count(marker.id) > 0) used.push_back(marker);
    }
    if (used.empty()) {
      throw UserError(settings.image_path, "no marker is seen well enough in two photos or more",
                      "Take photos with the markers in sight, or state --known_length_mm");
    }
    bars = BarsOfMarkers(used, kMetresPerMillimetre * settings.marker_size_mm);
  }
  if (has_length) {
    const ScaleBar length = MarkedLength(settings, scene.object);
    if (!bars.empty()) {
      const double by_markers = EstimateScale(bars).metres_per_unit;
      const double by_length = length.known_m / length.measured;
      if (std::abs(by_markers / by_length - 1) > kContradiction) {
        throw UserError(
            settings.workspace_path,
            fmt::format("the lengths contradict each other: by the markers the marked length is {:.2f} mm, "
                        "not {:.2f}, and by that length their sides are {:.3f} mm, not {:.3f}",
                        1000 * by_markers * length.measured, settings.known_length_mm,
                        settings.marker_size_mm * by_length / by_markers, settings.marker_size_mm),
            "Measure both again, or state only one");
      }
    }
    bars.push_back(length);
  }
  const ScaleEstimate estimate = EstimateScale(bars);
  scene.WriteInMetres(estimate.metres_per_unit);
  WriteFileAtomically(workspace.ScaleReport(), [&](std::ostream& stream) {
    stream << ToJson(estimate, markers, dictionary).dump(1) << '\n';
  });
  Print(estimate, workspace, out);
}

}  // namespace

void RunModelScaler(CommandContext& context) {
  Settings settings;
  Options& options = context.Declare(
      "Makes the scene metric: sparse/0, sparse/static and turntable.json in metres, and so all that is made "
      "from them. The scale comes from printed markers (ArUco, AprilTag) of stated size that the photos "
      "show, on the table or in the background, or from a length between two points that are marked in "
      "photos. The residual of each length, in mm, is printed and written to split/scale.json.",
      "--workspace_path scan --image_path photos --marker_size_mm 33");
  options.Add("workspace_path", &settings.workspace_path, "the workspace, with sparse/0 and turntable.json")
      .Required();
  options.Add("image_path", &settings.image_path, "the photos; empty: images in the workspace");
  auto own = options.Group("", &settings);
  own.Add("marker_size_mm", &Settings::marker_size_mm, "side of the markers' black squares; 0: no markers")
      .Unit("mm");
  options.Add("marker_dictionary", &settings.marker_dictionary,
              "4X4, 5X5, 6X6, 7X7, ARUCO_ORIGINAL, APRILTAG_16H5, APRILTAG_25H9, APRILTAG_36H10 or "
              "APRILTAG_36H11; auto: the one of which most are seen");
  options.Add("marker_ids", &settings.marker_ids, "use these markers alone; empty: all that are found");
  own.Add("known_length_mm", &Settings::known_length_mm,
          "distance of two points of the rotating part; 0: none")
      .Unit("mm");
  options.Add("point_a", &settings.point_a,
              "the first point where photos show it: NAME:X:Y in pixels, two or more");
  options.Add("point_b", &settings.point_b, "the second point, in the same way");
  Reporter& reporter = context.Parse();
  if ((settings.known_length_mm > 0) != (!settings.point_a.empty() && !settings.point_b.empty())) {
    throw CommandLineError("--known_length_mm, --point_a and --point_b belong together.");
  }
  const Workspace workspace{settings.workspace_path};
  if (settings.image_path.empty()) settings.image_path = workspace.Images();
  StageRunner runner(workspace, reporter);
  Stage stage;
  stage.name = "model_scaler";
  stage.inputs = {settings.image_path};
  stage.options = ValuesWithout(options, {"workspace_path", "image_path"});
  stage.outputs = {workspace.ScaleReport(), workspace.ObjectModel(), workspace.Turntable()};
  stage.depends_on = {"turntable_mapper"};
  if (!runner.Run(stage, [&] { Scale(settings, workspace, reporter, context.out()); })) {
    context.out() << "up to date       " << workspace.ScaleReport().string() << '\n';
  }
}

}  // namespace s2gs
