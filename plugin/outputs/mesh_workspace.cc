#include "plugin/outputs/mesh_workspace.h"

#include <fmt/format.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "mesh/io/mesh_files.h"
#include "mesh/refine/parts_before_background.h"
#include "mesh/surface/decimate.h"
#include "mesh/surface/parts_on_table.h"
#include "mesh/surface/vertex_normals.h"
#include "plugin/outputs/dense_views.h"
#include "plugin/outputs/grey_photos.h"
#include "plugin/outputs/known_top.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/require_writable.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {
namespace {

std::vector<DenseViewFiles> FindDepthViews(const Workspace& workspace, const TsdfMesherOptions& options,
                                           Reporter& reporter, TsdfMesherSummary* summary) {
  std::vector<DenseViewFiles> views =
      FindDenseViews(workspace, {options.mask_path, options.input_type, options.use_normals}, reporter);
  summary->num_images = static_cast<int>(views.size());
  views.erase(std::remove_if(views.begin(), views.end(),
                             [](const DenseViewFiles& view) { return view.depth.empty(); }),
              views.end());
  summary->num_masks = static_cast<int>(std::count_if(
      views.begin(), views.end(), [](const DenseViewFiles& view) { return !view.mask.empty(); }));
  summary->num_depth_maps = static_cast<int>(views.size());
  if (views.empty()) {
    throw UserError(workspace.DepthMaps(),
                    "holds no depth map NAME." + options.input_type + ".bin of an image of dense/0/sparse",
                    "Run `s2gs gaussian_renderer` or `colmap patch_match_stereo` first");
  }
  if (summary->num_depth_maps < summary->num_images) {
    reporter.Warn(fmt::format("{} of {} images have no depth map",
                              summary->num_images - summary->num_depth_maps, summary->num_images));
  }
  return views;
}

void Report(const TsdfSummary& tsdf, Reporter& reporter) {
  reporter.Info(fmt::format(
      "fused {} depth maps on the {} ({}): {} blocks of 8^3 voxels of {:.4g}, truncated "
      "at {:.4g}; {:.2f} s to prepare, {:.2f} s to fuse",
      tsdf.num_views, tsdf.backend == TsdfBackend::kCuda ? "GPU" : "CPU", tsdf.device, tsdf.num_blocks,
      tsdf.voxel_size, tsdf.truncation, tsdf.prepare_seconds, tsdf.fuse_seconds));
  if (tsdf.num_outliers > 0) {
    reporter.Info(fmt::format("{} rays end far from everything else and were left out", tsdf.num_outliers));
  }
}

void Report(const DepthOutlineSummary& outlines, Reporter& reporter) {
  reporter.Info(
      fmt::format("{} vertices are on outlines of the depth maps; the mesh moved by {:+.2f} px outwards, "
                  "{:.2f} px rms",
                  outlines.num_vertices, outlines.mean_offset_px, outlines.rms_offset_px));
}

void Report(const MeshRefinementSummary& refinement, Reporter& reporter) {
  if (refinement.num_vertices == 0) {
    reporter.Warn(fmt::format("{} photos show the mesh: too few to refine it by", refinement.num_photos));
    return;
  }
  reporter.Info(fmt::format(
      "refined by {} photos: {} triangles dropped that hardly any of them sees and {} of which hardly two "
      "show the same, {:.0f} % of {} vertices placed by their texture; moved by {:+.2f} px outwards, {:.2f} "
      "px rms, in {:.2f} s",
      refinement.num_photos, refinement.num_unseen_triangles, refinement.num_refuted_triangles,
      100.0 * static_cast<double>(refinement.num_accepted) / static_cast<double>(refinement.num_vertices),
      refinement.num_vertices, refinement.mean_offset_px, refinement.rms_offset_px, refinement.seconds));
  if (refinement.num_shaded > 0) {
    reporter.Info(fmt::format(
        "shading moved {} vertices by {:.2f} px rms: photos left out differ by {:.2f} grey values "
        "under light that stands still, by {:.2f} under even light",
        refinement.num_shaded, refinement.rms_shaded_px, refinement.error_turn_light,
        refinement.error_even_light));
  } else if (refinement.is_lit) {
    reporter.Info("forms by shading are left out: the photos agree less on them");
  } else if (refinement.error_turn_light > refinement.error_even_light) {
    reporter.Info(
        fmt::format("no forms by shading: photos left out differ by {:.2f} grey values under the "
                    "likeliest light that stands still, by {:.2f} under even light",
                    refinement.error_turn_light, refinement.error_even_light));
  }
}

// Nothing without a table that turns.
std::optional<TurntableFile> ReadTurningTable(const Workspace& workspace) {
  if (!Exists(workspace.Turntable())) return std::nullopt;
  TurntableFile table = ReadTurntableFile(workspace.Turntable());
  if (!TableTurns(table)) return std::nullopt;
  return table;
}

void Simplify(const TsdfMesherOptions& options, double voxel_size, Reporter& reporter, TriangleMesh* mesh) {
  // A count that is asked for is a bound of its own.
  if (!(options.max_error_voxels > 0) || options.cleanup.max_triangles != 0) return;
  const size_t num_full_vertices = mesh->vertices.size();
  SimplifyMesh(options.max_error_voxels * voxel_size, mesh);
  ComputeNormals(mesh);
  reporter.Info(fmt::format("simplified within {:.3g} voxels: {} of {} vertices stay",
                            options.max_error_voxels, mesh->vertices.size(), num_full_vertices));
}

}  // namespace

TsdfMesherSummary MeshWorkspace(const Workspace& workspace, const TsdfMesherOptions& options,
                                Reporter& reporter) {
  TsdfMesherSummary summary;
  Stopwatch watch;
  summary.output_path = options.output_path.empty() ? workspace.TsdfMesh() : options.output_path;
  RequireMeshExtension(summary.output_path);
  if (!options.output_path.empty()) RequireWritable(summary.output_path);
  const std::vector<DenseViewFiles> files = FindDepthViews(workspace, options, reporter, &summary);
  const WorkspaceDepthViews views(files);
  TriangleMesh mesh = MeshFromDepthMaps(views, options.tsdf, reporter, &summary.tsdf);
  Report(summary.tsdf, reporter);
  MeshCleanupOptions cleanup = options.cleanup;
  const std::optional<TurntableFile> table = ReadTurningTable(workspace);
  // Without one, z is no direction of the scene.
  cleanup.is_axis_known = table.has_value();
  const GreyPhotos all_photos(files);
  std::optional<KnownTop> top;
  if (table) top = ReadTop(workspace, table->axis, all_photos);
  const bool is_flat =
      options.flatten_table && top && FlattenTable(*top, all_photos, options.refinement, reporter, &mesh);
  const std::vector<int> stations = StationsOf(table, files);
  const PartsBeforeBackground before_background(all_photos, stations, options.refinement.num_threads,
                                                reporter);
  PartJudge judge;
  if (options.judge_by_background) {
    judge = [&](const TriangleMesh& parts, const std::vector<int>& part_of_triangle) {
      return before_background.Judge(parts, part_of_triangle);
    };
  }
  // First what is not the object: it would hide the object from the photos.
  MeshCleanupOptions clusters_only = cleanup;
  clusters_only.max_hole_edges = 0;
  clusters_only.smoothing_iterations = 0;
  clusters_only.max_triangles = 0;
  summary.cleanup = CleanMesh(clusters_only, reporter, &mesh, judge);
  std::optional<double> table_height;
  if (summary.cleanup.table) table_height = summary.cleanup.table->disc.CutHeight();
  if (options.move_to_outlines && !mesh.triangles.empty()) {
    summary.outlines =
        MoveToDepthOutlines(views, table_height, options.refinement.num_threads, reporter, &mesh);
    Report(summary.outlines, reporter);
  }
  if (options.refinement.enabled && !mesh.triangles.empty()) {
    MeshRefinementOptions refinement = options.refinement;
    // What stands around a body that is not told from it hides the body's rough parts, which are lost then.
    if (!cleanup.is_axis_known) {
      refinement.min_seen_pct = 0;
      refinement.drop_refuted = false;
      refinement.drop_seen_through = false;
    }
    refinement.table_height = table_height;
    summary.fused_seconds = watch.Lap();
    GreyPhotos photos(files, top && top->is_seen ? std::make_optional(top->plane.height) : std::nullopt);
    photos.SetTurns(workspace, files);
    if (refinement.shading) photos.FindGains(stations, refinement.num_threads);
    summary.refinement = RefineMesh(photos, refinement, reporter, &mesh);
    Report(summary.refinement, reporter);
    // Shadows stand still on a plain top that turns: what little photos see there is not its place.
    if (is_flat) FlattenTop(top->plane, &mesh);
  }
  if (table_height)
    summary.num_small_parts =
        DropSmallPartsOnTable(*table_height, cleanup.min_cluster_area_pct, &mesh, judge);
  cleanup.remove_disc = false;
  cleanup.cut_at_table = false;
  summary.cleanup.num_holes_closed = CleanMesh(cleanup, reporter, &mesh, judge).num_holes_closed;
  if (mesh.triangles.empty()) {
    throw UserError(workspace.DepthMaps(), "the depth maps agree on no surface",
                    "Check that they belong to the poses of dense/0/sparse, or set a larger voxel_size");
  }
  summary.num_full_vertices = mesh.vertices.size();
  Simplify(options, summary.tsdf.voxel_size, reporter, &mesh);
  WriteMesh(summary.output_path, mesh);
  summary.num_vertices = mesh.vertices.size();
  summary.num_triangles = mesh.triangles.size();
  return summary;
}

void WriteMeshLog(const std::filesystem::path& path, const TsdfMesherSummary& summary,
                  const TsdfMesherOptions& options) {
  using Json = nlohmann::ordered_json;
  std::string text;
  const MeshRefinementSummary& refinement = summary.refinement;
  const auto add = [&](const Json& line) { text += line.dump() + "\n"; };
  for (const RefinementMoment& moment : refinement.course) {
    add({{"stage", "mesh"},
         {"event", "course"},
         {"wall_s", summary.fused_seconds + moment.seconds},
         {"errors", {{"1 - correlation of photos on the surface", moment.disagreement}}}});
  }
  add({{"stage", "mesh"},
       {"event", "refined"},
       {"wall_s", summary.fused_seconds + refinement.seconds},
       {"enabled", options.refinement.enabled},
       {"photos", refinement.num_photos},
       {"vertices", refinement.num_vertices},
       {"clear", refinement.num_clear},
       {"accepted", refinement.num_accepted},
       {"moved", refinement.has_moved},
       {"carved", refinement.num_carved},
       {"refuted_triangles", refinement.num_refuted_triangles},
       {"lit", refinement.is_lit},
       {"shaded_vertices", refinement.num_shaded},
       {"shaded_rms_px", refinement.rms_shaded_px},
       {"triangles_seen_through", refinement.num_seen_through},
       {"rms_offset_px", refinement.rms_offset_px},
       {"vertices_on_outlines", summary.outlines.num_vertices},
       {"outlines_rms_offset_px", summary.outlines.rms_offset_px},
       {"small_parts_on_table", summary.num_small_parts},
       {"small_clusters_there", summary.cleanup.num_small_kept},
       {"large_clusters_not_there", summary.cleanup.num_large_dropped}});
  WriteFileAtomically(path, [&](std::ostream& out) { out << text; });
}

}  // namespace s2gs
