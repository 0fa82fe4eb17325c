#include "plugin/commands/tsdf_mesher_command.h"

#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "mesh/io/mesh_files.h"
#include "mesh/refine/parts_before_background.h"
#include "mesh/refine/table_texture.h"
#include "mesh/surface/decimate.h"
#include "mesh/surface/parts_on_table.h"
#include "mesh/surface/table_plane.h"
#include "mesh/surface/vertex_normals.h"
#include "plugin/outputs/dense_views.h"
#include "plugin/outputs/photo_gains.h"
#include "plugin/outputs/photo_turns.h"
#include "plugin/stage/stage.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/require_writable.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxMaskLogBytes = uint64_t{1} << 20;
// The table's axis as meshes have it, z: the cosine between both, and the distance in radii of the table.
constexpr double kAlongZ = 0.9999;
constexpr double kOffZ = 0.01;
// Plain tables with shadows on them have .10 to .23, speckled ones .99.
constexpr double kMaxTextured = 0.5;

// The photos of the views, grey, for the refinement.
class GreyPhotos : public RefinementPhotoSource {
 public:
  explicit GreyPhotos(const std::vector<DenseViewFiles>& files, std::optional<double> seen_height = {})
      : photos_(files), seen_height_(seen_height) {}
  int size() const override { return photos_.size(); }
  const ObjectView& Camera(int index) const override { return photos_.Camera(index); }
  Image8 Load(int index) const override { return photos_.Load(index, 1); }
  Image8 LoadPlaneSeen(int index) const override {
    return seen_height_ ? photos_.LoadTableSeen(index) : Image8();
  }
  double SeenHeight() const override { return seen_height_.value_or(0); }
  Eigen::Matrix3d WorldFromObject(int index) const override {
    return turns_.empty() ? Eigen::Matrix3d::Identity() : turns_[index];
  }
  double Gain(int index) const override { return gains_.empty() ? 1 : gains_[index]; }
  void FindGains(const std::vector<int>& stations, int num_threads) {
    gains_ = GreyGains(photos_, stations, num_threads);
  }
  // Tells how the table stands in each of the photos.
  void SetTurns(const Workspace& workspace, const std::vector<DenseViewFiles>& files) {
    const PhotoTurns turns(workspace, files);
    for (const DenseViewFiles& view : files) {
      if (!view.image.empty()) turns_.push_back(turns.Of(view.name));
    }
  }

 private:
  DensePhotos photos_;
  std::optional<double> seen_height_;
  std::vector<Eigen::Matrix3d> turns_;
  std::vector<double> gains_;
};

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

// Nothing without a table that turns.
std::optional<TurntableFile> ReadTurningTable(const Workspace& workspace) {
  if (!Exists(workspace.Turntable())) return std::nullopt;
  TurntableFile table = ReadTurntableFile(workspace.Turntable());
  if (!TableTurns(table)) return std::nullopt;
  return table;
}

// Of the views that have a photo, as GreyPhotos counts them; without a table that turns of none.
std::vector<int> StationsOf(const std::optional<TurntableFile>& table,
                            const std::vector<DenseViewFiles>& files) {
  std::map<std::string, int> station_of;
  if (table) {
    for (const TurntableImage& image : table->images) station_of[image.name] = image.station;
  }
  std::vector<int> stations;
  for (const DenseViewFiles& view : files) {
    if (view.image.empty()) continue;
    const auto found = station_of.find(view.name);
    stations.push_back(found == station_of.end() ? -1 : found->second);
  }
  return stations;
}

void Flatten(const TablePlane& plane, const std::vector<uint32_t>& top, TriangleMesh* mesh) {
  MoveToHeight(plane.height, top, mesh);
  MoveToHeight(plane.height, StepsOnPlane(plane, top, *mesh), mesh);
}

// A table's top as the renderer found it.
struct KnownTop {
  TablePlane plane;
  bool is_seen = false;   // where photos show it is known.
  bool is_plane = false;  // by its texture, photos show that.
};

std::optional<KnownTop> ReadTop(const Workspace& workspace, const TurntableAxis& axis,
                                const RefinementPhotoSource& photos) {
  if (!Exists(workspace.MaskLog())) return std::nullopt;
  const nlohmann::json line =
      nlohmann::json::parse(ReadWholeFile(workspace.MaskLog(), kMaxMaskLogBytes), nullptr, false);
  const auto is_number = [&](const char* name) { return line.contains(name) && line[name].is_number(); };
  if (!line.is_object() || !is_number("top") || !is_number("top_radius")) return std::nullopt;
  TablePlane plane = {line["top"], line["top_radius"], std::numeric_limits<double>::infinity()};
  for (int i = 0; i < photos.size(); ++i)
    plane.seen_from = std::min(plane.seen_from, photos.Camera(i).cam_from_object.Inverse().translation.z());
  const bool is_z = axis.direction.z() > kAlongZ && axis.point.head<2>().norm() < kOffZ * plane.radius;
  if (!is_z) return std::nullopt;
  const auto is_true = [&](const char* name) { return line.contains(name) && line[name] == true; };
  return KnownTop{plane, is_true("top_seen"), is_true("top_is_plane")};
}

// Where the renderer found its rim and photos see no texture on it, which would tell its shape, or its
// texture shows that it is the plane. \return  whether it was made its plane.
bool FlattenTable(const KnownTop& known, const RefinementPhotoSource& photos,
                  const MeshRefinementOptions& options, Reporter& reporter, TriangleMesh* mesh) {
  if (mesh->triangles.empty()) return false;
  const std::vector<uint32_t> top = LevelFromRim(known.plane, *mesh);
  if (top.empty()) return false;
  ComputeNormals(mesh);
  const std::optional<double> textured = TexturedShare(photos, top, options, *mesh, reporter);
  if (!textured) return false;
  const bool is_plane = known.is_plane || *textured < kMaxTextured;
  if (is_plane) Flatten(known.plane, top, mesh);
  reporter.Info(fmt::format("{:.0f} % of the table's top have texture{}: its {} vertices {}", 100 * *textured,
                            known.is_plane ? ", which shows that it is a plane" : "", top.size(),
                            is_plane ? "are moved to its plane" : "stay where photos see them"));
  return is_plane;
}

// s2gs/mesh_log.jsonl: what the photos say of the mesh over time, as the training's log does.
void WriteMeshLog(const fs::path& path, const TsdfMesherSummary& summary, const TsdfMesherOptions& mesher) {
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
       {"enabled", mesher.refinement.enabled},
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
  std::optional<KnownTop> top;
  if (table) top = ReadTop(workspace, table->axis, GreyPhotos(files));
  const bool is_flat = options.flatten_table && top &&
                       FlattenTable(*top, GreyPhotos(files), options.refinement, reporter, &mesh);
  const GreyPhotos all_photos(files);
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
    if (is_flat) Flatten(top->plane, LevelFromRim(top->plane, mesh), &mesh);
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

namespace {

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
