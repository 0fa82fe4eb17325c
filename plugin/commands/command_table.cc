#include "plugin/cli/command.h"
#include "plugin/commands/automatic_scanner_command.h"
#include "plugin/commands/gaussian_renderer_command.h"
#include "plugin/commands/gaussian_trainer_command.h"
#include "plugin/commands/mesh_texturer_command.h"
#include "plugin/commands/model_exporter_command.h"
#include "plugin/commands/photo_importer_command.h"
#include "plugin/commands/report_command.h"
#include "plugin/commands/scan_batch_command.h"
#include "plugin/commands/scan_evaluator_command.h"
#include "plugin/commands/scan_planner_command.h"
#include "plugin/commands/tsdf_mesher_command.h"
#include "plugin/commands/work_precision_command.h"
#include "plugin/commands/workspace_info_command.h"

#if S2GS_WITH_SFM
#include "plugin/commands/marker_sheet_command.h"
#include "plugin/commands/model_scaler_command.h"
#include "plugin/commands/motion_splitter_command.h"
#include "plugin/commands/turntable_mapper_command.h"
#endif

namespace s2gs {
namespace {

void AddSfmCommands([[maybe_unused]] std::vector<Command>* commands) {
#if S2GS_WITH_SFM
  commands->push_back(
      {"marker_sheet", "draws a sheet of markers and speckle for the table, to print", RunMarkerSheet});
  commands->push_back({"model_scaler", "makes the scene metric: by printed markers or a length that is known",
                       RunModelScaler});
  commands->push_back({"motion_splitter",
                       "splits features into static and rotating: two databases for colmap mapper",
                       RunMotionSplitter});
  commands->push_back({"turntable_mapper",
                       "maps both databases with colmap and aligns them: sparse models, turntable.json",
                       RunTurntableMapper});
#endif
}

std::vector<Command> MakeCommands() {
  std::vector<Command> commands;
  commands.push_back({"automatic_scanner", "photos to everything: poses, Gaussian model, masks and mesh",
                      RunAutomaticScanner});
  AddSfmCommands(&commands);
  commands.push_back({"gaussian_renderer", "renders a trained model: masks, depth and normal maps, images",
                      RunGaussianRenderer});
  commands.push_back({"gaussian_trainer",
                      "trains Gaussians that know whether they belong to the rotating part",
                      RunGaussianTrainer});
  commands.push_back({"mesh_texturer",
                      "gives the mesh the colours of the photos: .obj, .glb and .ply with texture",
                      RunMeshTexturer});
  commands.push_back(
      {"model_exporter",
       "writes cameras, masks and splats in the files of other programs: NeRF, Metashape, glTF",
       RunModelExporter});
  commands.push_back({"photo_importer",
                      "HEIC, RAW, TIFF, EXR and more, or a video, to photos that COLMAP reads",
                      RunPhotoImporter});
  commands.push_back(
      {"report", "report.html and report.json: what a scan did, how good it is, what to do next", RunReport});
  commands.push_back(
      {"scan_batch", "many objects, one scan each, from a list: a table and a page over all", RunScanBatch});
  commands.push_back(
      {"scan_evaluator", "measures a workspace or rendered images against ground truth", RunScanEvaluator});
  commands.push_back(
      {"scan_planner", "what a scan will do, what it leaves out and why: plan.json", RunScanPlanner});
  commands.push_back({"tsdf_mesher", "fuses depth maps into a mesh: .ply, .obj or .glb", RunTsdfMesher});
  commands.push_back({"work_precision",
                      "sweeps a knob of one stage: error against run time, as CSV, JSON and HTML",
                      RunWorkPrecision});
  commands.push_back({"workspace_info",
                      "lists the stages of a workspace, which are done and why not, and its files",
                      RunWorkspaceInfo});
  return commands;
}

}  // namespace

const std::vector<Command>& AllCommands() {
  static const std::vector<Command> commands = MakeCommands();
  return commands;
}

}  // namespace s2gs
