#include "plugin/commands/gaussian_renderer_command.h"

#include <fmt/format.h>

#include <map>
#include <string>

#include "plugin/commands/renderer_options.h"
#include "plugin/outputs/dense_folder.h"
#include "plugin/outputs/scene_renderer.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/stale_outputs.h"
#include "plugin/stage/workspace.h"

namespace s2gs {

void RunGaussianRenderer(CommandContext& context) {
  RendererArguments a;
  Options& options = context.Declare(
      "Renders a trained model: masks, depth and normal maps of the rotating part into the workspace, which "
      "is skipped when it is done, and images to look at. The maps are what tsdf_mesher and colmap "
      "stereo_fusion need.",
      "--workspace_path scan --comparison 1");
  AddRendererOptions(&options, &a);
  Reporter& reporter = context.Parse();
  if (a.num_frames < 0) throw CommandLineError("--num_frames must not be negative");

  const Workspace workspace{a.workspace_path};
  StageRunner runner(workspace, reporter);
  if (a.image_path.empty()) a.image_path = workspace.Images();
  if (a.model_path.empty()) a.model_path = workspace.PointCloud();
  std::map<std::string, PinholeView> dense_views;
  if (a.stereo)
    dense_views = PrepareDenseFolder(workspace, a.image_path, a.undistort_always, &runner, reporter);

  SceneRenderer renderer(a, workspace, reporter);
  Stage stage;
  stage.name = "gaussian_renderer";
  stage.inputs = {workspace.ObjectModel(), workspace.StaticModel(), workspace.Turntable(), a.image_path,
                  a.model_path};
  if (!a.image_list.empty()) stage.inputs.push_back(a.image_list);
  const std::map<std::string, std::string> values = options.Values();
  for (const char* name : {"masks", "stereo", "overview", "depth", "maps_of", "undistort_always",
                           "plain_table", "cut_at_table", "clear_plain_top", "table_seen"})
    stage.options[name] = values.at(name);
  stage.depends_on = {"gaussian_trainer"};
  if (a.masks) stage.outputs.push_back(workspace.Masks());
  if (a.overview) stage.outputs.push_back(workspace.Overview());
  if (a.stereo) {
    stage.outputs.insert(stage.outputs.end(),
                         {workspace.DepthMaps(), workspace.NormalMaps(), workspace.DenseMasks()});
    stage.depends_on.emplace_back(kUndistorterStage);
  }
  const auto render = [&] {
    renderer.RenderForWorkspace(dense_views);
    TidyImageOutputs(workspace, a.image_path, renderer.PhotoNames(), reporter);
  };
  if (!stage.outputs.empty() && !runner.Run(stage, render)) {
    context.out() << "up to date       " << workspace.root.string() << '\n';
  }
  if (a.color || a.foreground || a.pictures || a.comparison) renderer.RenderPictures();
  if (a.num_frames > 0) renderer.RenderFrames();
  context.out() << fmt::format("photos rendered  {}\nframes           {}\n", renderer.num_photos(),
                               a.num_frames);
}

}  // namespace s2gs
