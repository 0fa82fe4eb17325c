#include "plugin/commands/tsdf_mesher_command.h"

#include <fmt/format.h>

#include <filesystem>
#include <ostream>
#include <string>

#include "plugin/outputs/mesh_workspace.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

void Print(const TsdfMesherSummary& summary, const TsdfMesherOptions& mesher, std::ostream& out) {
  out << fmt::format("depth maps       {} of {} images, {} with masks\n", summary.num_depth_maps,
                     summary.num_images, summary.num_masks)
      << fmt::format("backend          {}, {}\n", summary.tsdf.backend == TsdfBackend::kCuda ? "GPU" : "CPU",
                     summary.tsdf.device)
      << fmt::format("voxel            {:.6g}, truncation {:.6g}\n", summary.tsdf.voxel_size,
                     summary.tsdf.truncation)
      << fmt::format("clusters         {} of {} kept\n", summary.cleanup.num_clusters_kept,
                     summary.cleanup.num_clusters);
  if (summary.cleanup.num_small_kept + summary.cleanup.num_large_dropped > 0) {
    out << fmt::format(
        "before background {} small ones stay, which photos show; {} go, behind which photos show the "
        "background\n",
        summary.cleanup.num_small_kept, summary.cleanup.num_large_dropped);
  }
  if (summary.refinement.num_vertices > 0) {
    out << fmt::format(
        "refined          {:+.3f} px outwards, {} unseen, {} seen through and {} refuted triangles dropped, "
        "{} vertices carved\n",
        summary.refinement.mean_offset_px, summary.refinement.num_unseen_triangles,
        summary.refinement.num_seen_through, summary.refinement.num_refuted_triangles,
        summary.refinement.num_carved);
  }
  if (mesher.cleanup.max_hole_edges > 0) {
    out << fmt::format("holes closed     {}\n", summary.cleanup.num_holes_closed);
  }
  if (summary.cleanup.table) {
    out << fmt::format(
        "table            top at {:.6g}, rim at {:.6g} from the axis; {} triangles beside it and {} small "
        "parts on it dropped\n",
        summary.cleanup.table->disc.height, summary.cleanup.table->radius, summary.cleanup.num_beside_table,
        summary.num_small_parts);
  }
  if (summary.cleanup.cut_height)
    out << fmt::format("cut above disc   {:.6g} along ({:.4f}, {:.4f}, {:.4f})\n",
                       *summary.cleanup.cut_height, summary.cleanup.up.x(), summary.cleanup.up.y(),
                       summary.cleanup.up.z());
  out << fmt::format("mesh             {} vertices, {} triangles\n", summary.num_vertices,
                     summary.num_triangles)
      << "written          " << summary.output_path.string() << '\n';
}

void AddTsdfOptions(Options* options, TsdfOptions* fields) {
  auto tsdf = options->Group("Tsdf", fields, "how depth maps are fused: size and number of the voxels");
  tsdf.Add("voxel_size", &TsdfOptions::voxel_size, "edge of a voxel; 0: from the depth maps' resolution")
      .Unit("as the poses");
  tsdf.Add("voxel_size_pixels", &TsdfOptions::voxel_size_pixels,
           "edge of a voxel where it is chosen, in pixels on the surface")
      .Unit("px");
  tsdf.Add("max_resolution", &TsdfOptions::max_resolution,
           "voxels along the longest side where the edge is chosen");
  tsdf.Add("truncation_voxels", &TsdfOptions::truncation_voxels,
           "how far from the surface distances are known")
      .Unit("voxels");
  tsdf.Add("max_memory_gib", &TsdfOptions::max_memory_gib, "refuse what would need more").Unit("GiB");
  tsdf.Add("num_threads", &TsdfOptions::num_threads, "0: one for each core");
}

void AddCleanupOptions(Options* options, MeshCleanupOptions* fields) {
  auto cleanup = options->Group("Cleanup", fields, "what is cut off, filled, smoothed and simplified");
  cleanup.Add("cut_at_table", &MeshCleanupOptions::cut_at_table,
              "where a table turns: drop what lies below its top or beyond its rim, does not stand on it and "
              "is not the side of a body");
  cleanup.Add("remove_disc", &MeshCleanupOptions::remove_disc,
              "cut just above the table's disc, or what the object stands on where nothing turns");
  cleanup
      .Add("min_cluster_area_pct", &MeshCleanupOptions::min_cluster_area_pct,
           "drop clusters with less of the largest one's area, and parts on the table with less than the "
           "largest of these; 100 keeps the largest alone")
      .Unit("%");
  cleanup.Add("max_hole_edges", &MeshCleanupOptions::max_hole_edges,
              "close holes with so many edges or fewer; 0: none");
  cleanup.Add("smoothing_iterations", &MeshCleanupOptions::smoothing_iterations, "of Taubin's smoothing");
  cleanup.Add("max_triangles", &MeshCleanupOptions::max_triangles,
              "simplify the mesh to about so many triangles; 0: keep all");
}

void AddRefinementOptions(Options* options, MeshRefinementOptions* fields) {
  auto refinement =
      options->Group("Refine", fields, "how photos move the surface, and what they show is not there");
  refinement.Add("enabled", &MeshRefinementOptions::enabled,
                 "move the surface to where the photos of dense/0 agree best, and drop what they do not see");
  refinement.Add("num_views", &MeshRefinementOptions::num_views, "photos in which a vertex is compared");
  refinement.Add("smoothness", &MeshRefinementOptions::smoothness,
                 "of the offsets over the mesh; larger trusts the photos less");
  refinement
      .Add("least_clear_pct", &MeshRefinementOptions::least_clear_pct,
           "no vertex moves where fewer have a clear peak at first, which may be chance or gloss; 0: they "
           "move all the same")
      .Unit("%");
  refinement
      .Add(
          "min_seen_pct", &MeshRefinementOptions::min_seen_pct,
          "drop triangles that fewer of the photos see, where a table turns; with fewer than 30 photos those "
          "that none sees; 0 keeps all")
      .Unit("%");
  refinement.Add("shading", &MeshRefinementOptions::shading,
                 "where a table turns, shape small forms by how light that stands still shades them; "
                 "automatic_scanner leaves it out at quality low");
  refinement.Add("carve", &MeshRefinementOptions::carve,
                 "let parts sink that photos contradict, where they agree deeper: hollows that were filled");
  refinement.Add(
      "drop_refuted", &MeshRefinementOptions::drop_refuted,
      "where a table turns, drop parts of which hardly two photos show the same: webs between parts of "
      "the object, and parts by themselves that photos do not bear out");
  refinement.Add("drop_seen_through", &MeshRefinementOptions::drop_seen_through,
                 "where a table turns, drop parts over its top at which two photos show the top itself");
  refinement.Add("max_memory_gib", &MeshRefinementOptions::max_memory_gib, "photos are shrunk until they fit")
      .Unit("GiB");
  refinement.Add("num_threads", &MeshRefinementOptions::num_threads, "0: one for each core");
}

}  // namespace

void RunTsdfMesher(CommandContext& context) {
  fs::path workspace_path;
  TsdfMesherOptions mesher;
  Options& options = context.Declare(
      "Fuses the depth maps of dense/0 into a mesh in the object's frame: dense/0/meshed-tsdf.ply. Skipped "
      "when it is done; with --output_path it always runs.",
      "--workspace_path scan --Cleanup.remove_disc 1");
  options.Add("workspace_path", &workspace_path, "the workspace, with dense/0").Required();
  options.Add("output_path", &mesher.output_path,
              "the mesh: .ply, .obj or .glb; empty: dense/0/meshed-tsdf.ply");
  options.Add(
      "mask_path", &mesher.mask_path,
      "masks NAME.png for the images of dense/0; empty: dense/0/masks, else masks where the photos are "
      "free of distortion");
  options.Add("input_type", &mesher.input_type, "which maps to take: NAME.<input_type>.bin");
  options.Add("use_normals", &mesher.use_normals, "use the normal maps where there are any");
  options.Add(
      "flatten_table", &mesher.flatten_table,
      "move what leads level from the rim of a table's top inwards to its plane, where photos show that "
      "rim and no texture within it");
  options.Add(
      "move_to_outlines", &mesher.move_to_outlines,
      "move the fused surface to where the outlines of the depth maps are, before the photos refine it");
  options.Add(
      "judge_by_background", &mesher.judge_by_background,
      "keep small parts that differ from what the other photos of a station show behind them, and drop "
      "parts that do not");
  options.AddEnum("use_gpu", &mesher.tsdf.backend,
                  {{"auto", TsdfBackend::kAuto}, {"0", TsdfBackend::kCpu}, {"1", TsdfBackend::kCuda}},
                  "fuse on the GPU");
  options
      .Add("max_error_voxels", &mesher.max_error_voxels,
           "simplify the finished mesh as far as it stays so close to itself, where Cleanup.max_triangles is "
           "0; "
           "0 keeps every vertex")
      .Unit("voxels");
  AddTsdfOptions(&options, &mesher.tsdf);
  AddCleanupOptions(&options, &mesher.cleanup);
  AddRefinementOptions(&options, &mesher.refinement);
  Reporter& reporter = context.Parse();
  if (!(mesher.max_error_voxels >= 0)) throw CommandLineError("--max_error_voxels must not be negative");

  const Workspace workspace{workspace_path};
  StageRunner runner(workspace, reporter);
  const auto mesh = [&] { Print(MeshWorkspace(workspace, mesher, reporter), mesher, context.out()); };
  if (!mesher.output_path.empty()) return mesh();  // no part of the workspace: always written
  Stage stage;
  stage.name = "tsdf_mesher";
  stage.inputs = {workspace.MaskLog(),   workspace.DenseModel(), workspace.DenseImages(),
                  workspace.DepthMaps(), workspace.NormalMaps(), workspace.DenseMasks(),
                  workspace.TableSeen()};
  for (const fs::path& masks : {mesher.mask_path, workspace.Masks()}) {
    if (!masks.empty()) stage.inputs.push_back(masks);
  }
  stage.options = ValuesWithout(options, {"workspace_path", "output_path", "mask_path", "use_gpu",
                                          "Tsdf.num_threads", "Tsdf.max_memory_gib", "Refine.num_threads"});
  stage.outputs = {workspace.TsdfMesh()};
  stage.depends_on = {"gaussian_renderer"};
  const auto mesh_and_log = [&] {
    const TsdfMesherSummary summary = MeshWorkspace(workspace, mesher, reporter);
    WriteMeshLog(workspace.MeshLog(), summary, mesher);
    Print(summary, mesher, context.out());
  };
  if (!runner.Run(stage, mesh_and_log)) {
    context.out() << "up to date       " << workspace.TsdfMesh().string() << '\n';
  }
}

}  // namespace s2gs
