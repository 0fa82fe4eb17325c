#include "plugin/mapping/mapping_output.h"

#include <fmt/format.h>

#include <algorithm>
#include <system_error>
#include <utility>

#include "plugin/colmap/point_colors.h"
#include "plugin/mapping/mapping_failure.h"
#include "plugin/outputs/turntable_report.h"
#include "plugin/report/verdict_json.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/scene/io/top_view.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "sfm_split/turntable/tied_stations.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

TurntableFile ToTurntableFile(const AlignedScene& aligned) {
  const TurntableScene& scene = aligned.scene;
  TurntableFile file;
  file.axis = scene.axis;
  file.num_stations = scene.num_stations;
  file.scale_observable = scene.scale_observable;
  file.units = scene.units;
  std::vector<std::vector<int>> tied = SetsOfTiedStations(aligned);
  if (tied.size() > 1) file.tied_stations = std::move(tied);
  for (const View& view : scene.views) {
    file.images.push_back({view.name, view.station, view.angle_deg, view.world_from_object});
  }
  return file;
}

}  // namespace

void MappingOutput::WriteReport() {
  report_["seconds"] = seconds_;
  WriteFileAtomically(ReportPath(), [&](std::ostream& stream) { stream << report_.dump(1) << '\n'; });
}

void MappingOutput::Describe(const ScanPlacement& placement) {
  for (const auto& [name, seconds] : placement.durations) AddSeconds(name, seconds);
  report_["path"] = placement.path;
  report_["path_reason"] = placement.findings;
  if (placement.outcome != PlacementOutcome::kPlaced) return;
  report_["guided"] = ToJson(placement.guided);
  if (settings_.adjust_to_photos) report_["photos"] = ToJson(placement.photos);
}

void MappingOutput::WriteScene(const ScanFeatures& steady, const SteadyCameras& cameras,
                               ScanCandidate* candidate, std::optional<ScanEvidence> evidence) {
  Stopwatch watch;
  AlignedScene& aligned = candidate->aligned;
  const RefineReport& refined = candidate->refined;
  report_.update(DescribeScene(aligned, refined));
  if (!evidence) {
    evidence = GatherEvidence(steady, aligned, refined.joint, refined.priors.turns, refined.held_back,
                              candidate->matches, settings_.placement.refine.max_error_px);
  }
  cameras.Shake(&aligned);
  ColorPoints(settings_.image_path, {&aligned.object, &aligned.background}, reporter_);
  WriteColmapModel(workspace_.ObjectModel(), aligned.object, ColmapFormat::kBinary);
  std::error_code ec;
  if (!aligned.background.images.empty()) {
    WriteColmapModel(workspace_.StaticModel(), aligned.background, ColmapFormat::kBinary);
  } else {
    fs::remove_all(workspace_.StaticModel(), ec);
  }
  WriteTurntableFile(workspace_.Turntable(), ToTurntableFile(aligned));
  WriteTopView(workspace_.TopView(), aligned.scene, aligned.object, aligned.background);
  WriteScanLabels(workspace_, input_.features.images, candidate->refined.labels);
  for (const std::string& said : refined.angle_contradictions) reporter_.Warn(said);
  for (const KnownAngles& angles : refined.known_angles) {
    if (!angles.is_believed) continue;
    reporter_.Info(fmt::format("station {}: {} stated angles hold to {:.3f} degrees", angles.station,
                               angles.prior.places.size(), angles.scatter_rad / kDegree));
  }
  report_["verdict"] = ToJson(JudgeScan(*evidence), *evidence);
  seconds_["write"] = watch.Lap();
  WriteReport();
}

// Leaves a report with the verdict where nothing has a place.
ScanVerdict MappingOutput::RecordFailure() {
  ScanEvidence evidence = GatherOneBodyEvidence(input_.features, {}, {});
  evidence.is_one_body = input_.capture_case == CaptureCase::kOneBody;
  ScanVerdict verdict = JudgeScan(evidence);
  report_["registered"] = 0;
  report_["verdict"] = ToJson(verdict, evidence);
  WriteReport();
  return verdict;
}

void MappingOutput::Fail(const std::string& problem) {
  const ScanVerdict verdict = RecordFailure();
  std::string remedy = "Look at the models in split/ with `colmap gui`. What helps: ";
  for (size_t k = 0; k < verdict.advice.size(); ++k) remedy += (k > 0 ? "; " : "") + verdict.advice[k];
  throw UserError(workspace_.ObjectDatabase(), problem, remedy);
}

void MappingOutput::WriteOneBody(const std::vector<ColmapModel>& models) {
  if (models.empty()) {
    RecordFailure();
    throw ExplainNoModel(workspace_.ObjectDatabase(), input_.features);
  }
  ColmapModel model = models[0];
  ColorPoints(settings_.image_path, {&model}, reporter_);
  WriteColmapModel(workspace_.ObjectModel(), model, ColmapFormat::kBinary);
  std::error_code ec;
  fs::remove_all(workspace_.StaticModel(), ec);
  TurntableFile file;
  std::vector<std::string> names;
  names.reserve(model.images.size());
  for (const auto& [id, image] : model.images) names.push_back(image.name);
  std::sort(names.begin(), names.end());
  for (const std::string& name : names) {
    file.images.push_back({name, file.num_stations, 0, Rigid3()});
    ++file.num_stations;
  }
  WriteTurntableFile(workspace_.Turntable(), file);
  report_["registered"] = names.size();
  report_["missing"] = json::array();
  for (const ScanImage& image : input_.features.images) {
    if (!std::binary_search(names.begin(), names.end(), image.name)) report_["missing"].push_back(image.name);
  }
  report_["object"] = DescribePoints(model);
  std::vector<Camera> cameras;
  for (const auto& [id, camera] : model.cameras) cameras.push_back(camera);
  std::vector<Rigid3> poses;
  for (const auto& [id, image] : model.images) poses.push_back(image.cam_from_world);
  const ScanEvidence evidence = GatherOneBodyEvidence(input_.features, cameras, poses);
  report_["verdict"] = ToJson(JudgeScan(evidence), evidence);
  WriteReport();
}

}  // namespace s2gs
