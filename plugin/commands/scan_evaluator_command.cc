#include "plugin/commands/scan_evaluator_command.h"

#include <filesystem>
#include <optional>
#include <ostream>

#include "plugin/evaluation/scan_evaluation.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/require_writable.h"

namespace s2gs {
namespace {

struct Paths {
  std::filesystem::path workspace;
  std::filesystem::path ground_truth;
  std::filesystem::path mesh;
  std::filesystem::path json;
  std::filesystem::path csv;
  std::filesystem::path output;
  ImagePaths images;
};

void AddOptions(Options& options, Paths* paths, MeshEvaluationOptions* mesh) {
  options.Add("workspace_path", &paths->workspace, "the workspace to measure");
  options.Add("ground_truth_path", &paths->ground_truth,
              "the data set's folder, with gt/scene.json, gt/object.ply, gt/disc.ply and gt/masks");
  options.Add("mesh_path", &paths->mesh,
              "the mesh, in the frame of sparse/0; empty: dense/0/meshed-tsdf.ply");
  options.Add("images_path", &paths->images.rendered,
              "rendered images to compare with photos of the same names");
  options.Add("reference_path", &paths->images.reference, "the photos; empty: those of the ground truth");
  options.Add(
      "mask_path", &paths->images.masks,
      "masks NAME.jpg.png or NAME.png in which to measure the images too; empty: those of the ground truth");
  options.Add("json_path", &paths->json, "file for the figures as JSON, with definitions and all digits");
  options.Add("csv_path", &paths->csv, "file for the figures as CSV");
  options.Add("output_path", &paths->output,
              "beginning of the names of both: PATH.json and PATH.csv, where they are not given");
  auto group =
      options.Group("Mesh", mesh, "how meshes are measured: points, thresholds, the box that counts");
  group.Add("num_samples", &MeshEvaluationOptions::num_samples, "points sampled on the mesh");
  group.Add("num_truth_samples", &MeshEvaluationOptions::num_truth_samples,
            "points sampled on the true surface");
  group.Add("thresholds_pct", &MeshEvaluationOptions::thresholds_pct, "distances of the F-scores")
      .Unit("% of diameter");
  group
      .Add("crop_min", &MeshEvaluationOptions::crop_min,
           "lower corner x,y,z of a box in the true object frame outside which nothing counts")
      .Unit("as the ground truth");
  group.Add("crop_max", &MeshEvaluationOptions::crop_max, "upper corner of that box")
      .Unit("as the ground truth");
}

void CheckCombination(const Paths& paths) {
  const bool has_truth = !paths.ground_truth.empty();
  if (!paths.workspace.empty() && !has_truth) {
    throw CommandLineError("--workspace_path needs --ground_truth_path to be measured against.");
  }
  if (!paths.images.rendered.empty() && paths.images.reference.empty() && !has_truth) {
    throw CommandLineError(
        "--images_path needs --reference_path or --ground_truth_path to be measured against.");
  }
  if (paths.workspace.empty() && paths.images.rendered.empty()) {
    throw CommandLineError("nothing to measure: give --workspace_path, --images_path or both.");
  }
}

}  // namespace

void RunScanEvaluator(CommandContext& context) {
  Paths paths;
  MeshEvaluationOptions mesh_options;
  Options& options = context.Declare(
      "Measures a workspace against ground truth: poses, turntable angles, axis, scale, masks and mesh; and "
      "rendered images against photos. What the workspace lacks is listed as missing.",
      "--workspace_path scan --ground_truth_path data/falcon_desk --json_path scan/figures.json");
  AddOptions(options, &paths, &mesh_options);
  Reporter& reporter = context.Parse();
  CheckCombination(paths);
  if (!paths.output.empty() && paths.json.empty()) paths.json = paths.output.string() + ".json";
  if (!paths.output.empty() && paths.csv.empty()) paths.csv = paths.output.string() + ".csv";

  std::optional<ScanTruth> truth;
  if (!paths.ground_truth.empty()) truth = ReadScanTruth(paths.ground_truth);
  for (const std::filesystem::path& path : {paths.json, paths.csv}) {
    if (!path.empty()) RequireWritable(path);
  }
  Figures figures;
  if (!paths.workspace.empty()) {
    const Workspace workspace{paths.workspace};
    std::error_code ec;
    if (!std::filesystem::is_directory(workspace.root, ec)) {
      throw UserError(workspace.root, "no such folder", "Check --workspace_path");
    }
    const ScanAlignment alignment = EvaluatePoses(workspace, *truth, &figures);
    EvaluateMasks(workspace, truth->scene, reporter, &figures);
    EvaluateMesh(paths.mesh.empty() ? workspace.TsdfMesh() : paths.mesh, alignment, *truth, mesh_options,
                 options.random_seed(), &figures);
  }
  if (!paths.images.rendered.empty()) {
    EvaluateImages(paths.images, truth.has_value() ? &truth->scene : nullptr, reporter, &figures);
  }

  PrintFigures(figures, context.out());
  if (!paths.json.empty()) {
    WriteFileAtomically(paths.json, [&](std::ostream& stream) { WriteFiguresJson(figures, stream); });
  }
  if (!paths.csv.empty()) {
    WriteFileAtomically(paths.csv, [&](std::ostream& stream) { WriteFiguresCsv(figures, stream); });
  }
  if (!IsAnythingMeasured(figures)) {
    throw UserError(paths.workspace.empty() ? paths.images.rendered : paths.workspace,
                    "nothing could be measured", "The table says what is missing");
  }
}

}  // namespace s2gs
