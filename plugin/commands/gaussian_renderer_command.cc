#include "plugin/commands/gaussian_renderer_command.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "plugin/outputs/beside_table.h"
#include "plugin/outputs/dense_folder.h"
#include "plugin/shared_options/backend_choice.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/stale_outputs.h"
#include "plugin/stage/workspace.h"
#include "s2gs/gaussians_ply.h"
#include "s2gs/held_out.h"
#include "s2gs/image/image_file.h"
#include "s2gs/image/photos.h"
#include "s2gs/image/undistort.h"
#include "s2gs/render_pictures.h"
#include "s2gs/rotating_mask.h"
#include "s2gs/table/layers_over_top.h"
#include "s2gs/table/opaque_region.h"
#include "s2gs/table/photo_table.h"
#include "s2gs/table/plain_top.h"
#include "s2gs/table/textured_top.h"
#include "s2gs/table_rim.h"
#include "s2gs/training_scene.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/base/machine_share.h"
#include "sfm_split/base/task_queue.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/scene/io/colmap_maps.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr char kMapSuffix[] = ".geometric.bin";
constexpr int kOverviewWidth = 1600;
constexpr int kOverviewJpegQuality = 85;
// Plain tops with shadows and what stands on them have .1 to .3, speckled ones .7 and more.
constexpr double kTexturedTop = 0.5;

enum class DepthKind : uint8_t { kMedian, kExpected };
const EnumNames<DepthKind> kDepthNames = {{"median", DepthKind::kMedian}, {"expected", DepthKind::kExpected}};

// What depth maps, normal maps and silhouettes show.
enum class MapsOf : uint8_t { kObject, kAll };
const EnumNames<MapsOf> kMapsOfNames = {{"object", MapsOf::kObject}, {"all", MapsOf::kAll}};

// Whose a table's top is where photos do not tell whether it turns.
enum class PlainTable : uint8_t { kObject, kBackground };
const EnumNames<PlainTable> kPlainTableNames = {{"object", PlainTable::kObject},
                                                {"background", PlainTable::kBackground}};

struct Arguments {
  fs::path workspace_path;
  fs::path image_path;
  fs::path model_path;
  fs::path output_path;
  fs::path image_list;
  bool color = false;
  bool foreground = false;
  bool masks = true;
  bool stereo = true;
  bool pictures = false;
  bool comparison = false;
  bool overview = true;
  DepthKind depth = DepthKind::kMedian;
  MapsOf maps_of = MapsOf::kObject;
  bool undistort_always = false;
  PlainTable plain_table = PlainTable::kObject;
  bool cut_at_table = true;
  bool clear_plain_top = true;
  bool table_seen = true;
  int32_t num_frames = 0;
  int32_t frame_station = 0;
  BackendChoice backend;
};

void AddOptions(Options* options, Arguments* a) {
  options->Add("workspace_path", &a->workspace_path, "the workspace, with sparse/0 and s2gs/point_cloud.ply")
      .Required();
  options->Add("image_path", &a->image_path, "the photos; empty: images in the workspace");
  options->Add("model_path", &a->model_path, "the Gaussians; empty: s2gs/point_cloud.ply in the workspace");
  options->Add("output_path", &a->output_path,
               "folder for images that are no part of a workspace; empty: s2gs/renders in the workspace");
  options->Add("image_list", &a->image_list,
               "file with the names of the photos to render, one a line; empty: all");
  options->Add("masks", &a->masks, "masks of the rotating part: masks/NAME.png in the workspace, 255 inside");
  options->Add(
      "stereo", &a->stereo,
      "depth maps, normal maps and silhouettes of the rotating part alone: dense/0/stereo/*/"
      "NAME.geometric.bin and dense/0/masks, for tsdf_mesher and colmap stereo_fusion; makes dense/0 "
      "when there is none");
  options->AddEnum("depth", &a->depth, kDepthNames, "which depth goes into the maps");
  options->AddEnum("maps_of", &a->maps_of, kMapsOfNames,
                   "what the maps show: the rotating part, or the background too");
  options->AddEnum(
      "plain_table", &a->plain_table, kPlainTableNames,
      "whose, in masks, a table is that is so plain that it may turn or stand still by the photos, "
      "where its top ends in a circle about the axis");
  options->Add("cut_at_table", &a->cut_at_table,
               "of photos of one station, leave out what rotates by the model and lies below the table's top "
               "or beyond its rim, does not "
               "stand on it and is not the side of a body: plain ground");
  options->Add(
      "clear_plain_top", &a->clear_plain_top,
      "leave out what rotates by the model over a plain table's top where photos see the top itself, "
      "in the light or, where things seldom look like one, in a shadow on it: no photo tells the shape of "
      "what is plain");
  options->Add("table_seen", &a->table_seen,
               "draw a table's top into depth and normal maps where photos show it, by its colour or its "
               "texture, whatever the model has before it; dense/0/table_seen says where");
  options->Add("undistort_always", &a->undistort_always,
               "resample photos for dense/0 even where they have no distortion and could be copied");
  options->Add("color", &a->color, "the scene as the photo should look: color/NAME.png");
  options->Add("foreground", &a->foreground, "the map of p, 255 is 1: foreground/NAME.png");
  options->Add("pictures", &a->pictures,
               "depth and normals of the rotating part to look at: depth/NAME.png, normal/NAME.png");
  options->Add("comparison", &a->comparison,
               "photo, rendering, error and mask side by side: comparison/NAME.png");
  options->Add("overview", &a->overview,
               "such a comparison of four photos to look at: s2gs/comparison.jpg in the workspace");
  options->Add(
      "num_frames", &a->num_frames,
      "frames of a film of one turn of the table, seen by one photo's camera: frames/NNNN.png; 0: none");
  options->Add("frame_station", &a->frame_station,
               "the station whose first photo lends its camera to the film");
}

std::set<std::string> ReadList(const fs::path& path, const TrainingScene& scene) {
  if (path.empty()) {
    std::set<std::string> names;
    for (const ScenePhoto& photo : scene.photos) names.insert(photo.name);
    return names;
  }
  return ReadPhotoList(path, scene.photos, "--image_list");
}

std::vector<std::string> NamesOf(const TrainingScene& scene) {
  std::vector<std::string> names;
  names.reserve(scene.photos.size());
  for (const ScenePhoto& photo : scene.photos) names.push_back(photo.name);
  return names;
}

// Of each thread that writes: a picture with all its maps, what is made of them, and the next one that waits.
constexpr uint64_t kWritingBytesPerPixel = uint64_t{2} * (10 + 4) * sizeof(float);

uint64_t LargestView(const TrainingScene& scene) {
  uint64_t largest = 1;
  for (const ScenePhoto& photo : scene.photos) {
    largest =
        std::max(largest, static_cast<uint64_t>(photo.view.width) * static_cast<uint64_t>(photo.view.height));
  }
  return largest;
}

RenderRequest WholeScene(const PinholeView& view) {
  RenderRequest request;
  request.view = view;
  request.foreground = true;
  request.hard_foreground = true;
  return request;
}

// Half transparent is outside.
PixelMask OpaqueMask(const RenderedView& view) {
  PixelMask mask{view.width, view.height, {}};
  mask.inside.reserve(view.alpha.size());
  for (const float alpha : view.alpha) mask.inside.push_back(alpha >= 0.5F ? 1 : 0);
  return mask;
}

RenderRequest ForegroundAlone(const PinholeView& view) {
  RenderRequest request;
  request.view = view;
  request.drawn = DrawnBody::kForeground;
  request.geometry = true;
  return request;
}

// A plain top, and what photos tell by showing it.
struct SeenTop {
  PlainTop top;
  TopEvidence evidence;
};

class Renderer {
 public:
  Renderer(const Arguments& arguments, const Workspace& workspace, TrainingScene scene, Backend* backend,
           Reporter& reporter)
      : a_(arguments),
        workspace_(workspace),
        scene_(std::move(scene)),
        backend_(backend),
        reporter_(reporter),
        output_(a_.output_path.empty() ? workspace.Own() / "renders" : a_.output_path),
        in_workspace_(workspace.root, a_.image_path, NamesOf(scene_)),
        in_output_(a_.output_path.empty() ? workspace.root : output_, a_.image_path, NamesOf(scene_)),
        writers_(ThreadsThatFit(kWritingBytesPerPixel * LargestView(scene_))) {
    if (scene_.mode == TrainMode::kS2gs) {
      if (a_.cut_at_table) DropBesideTable();
      if (scene_.region) {
        LeaveOut(FindReachingOut(*scene_.region, backend_->GetGaussians()),
                 "that reach farther from the axis than anything turns");
      }
      shape_ = FindRotatingShape(scene_, backend_->GetGaussians());
      FindTable();
    }
  }

  // What other stages and COLMAP work on. \param dense_view  null: no maps.
  void RenderForWorkspace(const ScenePhoto& photo, const PinholeView* dense_view) {
    if (a_.masks) {
      const Undistortion& plan = PlanOf(photo);
      Later([&plan, path = in_workspace_.Make(workspace_.Masks(), NameOf(photo), ".png"),
             mask = RotatingPart(photo)] {
        // Masks are those of the photos as they are, with their distortion.
        Reporter silent;
        WriteImage(path, DistortMask(plan, MaskImage(mask), silent));
      });
    }
    if (dense_view != nullptr) WriteStereo(photo, *dense_view);
  }

  // Images to look at.
  void RenderPictures(const ScenePhoto& photo) {
    const auto path = [&](const char* folder) {
      return in_output_.Make(output_ / folder, NameOf(photo), ".png");
    };
    if (a_.color || a_.foreground || a_.comparison) {
      const Image8 color = ToImage8(Render(WholeScene(photo.view)));
      if (a_.color) Later([path = path("color"), color] { WriteImage(path, color); });
      if (a_.foreground) {
        Later([path = path("foreground"), p = SoftForeground(photo)] { WriteImage(path, p); });
      }
      if (a_.comparison) {
        Later([path = path("comparison"), color, real = Photo(photo), mask = Mask(photo)] {
          WriteImage(path, ComparisonPicture(real, color, mask));
        });
      }
    }
    if (a_.pictures) {
      Later([depth_path = path("depth"), normal_path = path("normal"), kind = a_.depth,
             view = Render(ForegroundAlone(photo.view))] {
        const std::vector<float>& depth =
            kind == DepthKind::kMedian ? view.median_depth : view.expected_depth;
        WriteImage(depth_path, DepthPicture(depth, view.width, view.height));
        WriteImage(normal_path, NormalPicture(view));
      });
    }
  }

  // Returns when everything is written.
  void Finish() { writers_.Finish(); }

  // Comparisons of a few photos, spread evenly, below each other.
  void WriteOverview() {
    const std::vector<ScenePhoto>& all = scene_.photos;
    std::vector<const ScenePhoto*> photos;
    for (const size_t i : OverviewPhotos(all.size())) photos.push_back(&all[i]);
    std::vector<Image8> rows;
    rows.reserve(photos.size());
    Image8 overview{kOverviewWidth, 0, 3, {}};
    for (const ScenePhoto* photo : photos) {
      const RenderedView view = Render(WholeScene(photo->view));
      const Image8 row = ComparisonPicture(Photo(*photo), ToImage8(view), Mask(*photo));
      const int height = std::max(1, row.height * kOverviewWidth / row.width);
      rows.push_back(ResizeByArea(row, kOverviewWidth, height));
      overview.height += height;
    }
    for (const Image8& row : rows) {
      overview.pixels.insert(overview.pixels.end(), row.pixels.begin(), row.pixels.end());
    }
    CreateFolder(workspace_.Overview().parent_path());
    WriteImage(workspace_.Overview(), overview, kOverviewJpegQuality);
  }

  // One turn of the table before a camera that stands still.
  void RenderFrame(int frame, const PinholeView& view, const TurntableAxis& axis) {
    const double angle = 2 * kPi * frame / a_.num_frames;
    PinholeView turned = view;
    turned.cam_from_object = view.cam_from_object * TurnAbout(axis, angle);
    const ImageName name(fmt::format("{:04}", frame), output_);
    Later([path = in_output_.Make(output_ / "frames", name, ".png"), view = Render(WholeScene(turned))] {
      WriteImage(path, ToImage8(view));
    });
  }

  const TrainingScene& scene() const { return scene_; }

  // s2gs/mask_log.jsonl: what masks rest on beside p.
  void WriteMaskLog() const {
    nlohmann::ordered_json line = {{"stage", "masks"}, {"event", "table"}, {"found", table_.has_value()}};
    line["gaussians_beside"] = num_beside_table_;
    line["gaussians_around"] = num_around_table_;
    line["gaussians_over_top"] = num_over_top_;
    line["top_seen"] = known_texture_ || (seen_top_ && seen_top_->evidence != TopEvidence::kNone);
    if (textured_top_) line["textured_share"] = *textured_top_;
    if (circle_) {
      const Eigen::Vector3d top = scene_.axis->point + circle_->height * scene_.axis->direction;
      line["top"] = (scene_.origin + scene_.size * top).dot(scene_.axis->direction);
      line["top_radius"] = circle_->radius * scene_.size;
    }
    if (table_) {
      line["radius"] = table_->region.radius * scene_.size;
      line["height"] = (table_->region.high - table_->region.low) * scene_.size;
      line["share_of_directions"] = table_->share;
      line["false_alarms"] = table_->false_alarms;
      line["static_share"] = table_->static_share;
      line["undecided"] = table_->IsUndecided();
      line["counts_as"] =
          !table_->IsUndecided() || a_.plain_table == PlainTable::kObject ? "object" : "background";
    }
    WriteFileAtomically(workspace_.MaskLog(), [&](std::ostream& out) { out << line.dump() << '\n'; });
  }

  // Of all photos, rendered or not.
  std::set<std::string> PhotoNames() const {
    std::set<std::string> names;
    for (const ScenePhoto& photo : scene_.photos) names.insert(photo.name);
    return names;
  }

 private:
  void DropBesideTable() {
    const std::vector<uint32_t> beside = FindRotatingBesideTable(scene_, backend_, reporter_);
    num_beside_table_ = beside.size();
    LeaveOut(beside, "that lie beside the table");
  }

  // \param rotating  in ascending order.
  void LeaveOut(const std::vector<uint32_t>& rotating, const char* which) {
    if (rotating.empty()) return;
    std::vector<uint32_t> others;
    const auto count = static_cast<uint32_t>(backend_->Count());
    for (uint32_t i = 0; i < count; ++i) {
      if (!std::binary_search(rotating.begin(), rotating.end(), i)) others.push_back(i);
    }
    backend_->Keep(others);
    reporter_.Info(fmt::format("{} rotating Gaussians left out {}", rotating.size(), which));
  }

  // Photos tell the rim to a fraction of a pixel; where they do not, the model may.
  void FindTable() {
    const bool is_objects = a_.plain_table == PlainTable::kObject;
    std::vector<StationPhotos> stations;
    try {
      stations = LoadStationPhotos(
          scene_, [&](const ScenePhoto& photo) { return Photo(photo); }, reporter_);
    } catch (const UserError& error) {
      reporter_.Warn(fmt::format("the table's rim is not looked for in the photos: {}", error.what()));
    }
    circle_ = FindTableInPhotos(scene_, stations);
    if (!circle_) {
      table_ = FindTableRim(scene_, backend_);
      if (table_ && table_->IsUndecided() && shape_ && is_objects) CountTableAsRotating(*table_, &*shape_);
      return;
    }
    table_ = RimOfCircle(scene_, *circle_, shape_, backend_);
    if (table_->IsUndecided() && !is_objects) return;
    in_masks_ = table_->region;
    textured_top_ = TexturedShareOfTop(stations, table_->region);
    // Photos show the shape of a top that has texture and turns.
    if (table_->IsUndecided() || *textured_top_ < kTexturedTop) in_maps_ = table_->region;
    if (a_.clear_plain_top && *textured_top_ < kTexturedTop) ClearPlainTop(stations);
    if (in_maps_) LeaveTableToItsRegion(stations);
    if (a_.table_seen && *textured_top_ >= kTexturedTop)
      known_texture_ = TexturedTop::Learn(stations, table_->region);
    if (!a_.cut_at_table) return;
    const std::vector<uint32_t> standing =
        FindStandingAroundTable(stations, table_->region, backend_->GetPlacement());
    num_around_table_ = standing.size();
    LeaveOut(standing, "around the table, where photos show no change");
  }

  // Splats of a table that masks and maps show anyway only blur its rim.
  void LeaveTableToItsRegion(const std::vector<StationPhotos>& stations) {
    // The circle is known to a pixel.
    const double margin = PixelAtAxis(stations, in_maps_->axis);
    LeaveOut(FindRotatingIn(*in_maps_, margin, backend_->GetPlacement()),
             "of the table, which is known by its rim");
  }

  // Of what training builds over a plain top.
  void ClearPlainTop(const std::vector<StationPhotos>& stations) {
    const std::optional<PlainTop> top = PlainTop::Learn(stations, table_->region);
    if (!top) return;
    const LayersOverTop layers =
        FindLayersOverTop(*top, stations, RotatingDepths(stations, backend_), backend_->GetPlacement());
    num_over_top_ = layers.gaussians.size();
    if (a_.table_seen) seen_top_ = SeenTop{*top, layers.evidence};
    LeaveOut(layers.gaussians, "over the table's plain top, where photos see the top itself");
  }

  RenderedView Render(RenderRequest request) {
    if (reporter_.StopRequested()) throw Interrupted();
    request.stop_requested = [this] { return reporter_.StopRequested(); };
    return backend_->Render(request);
  }

  // Compresses and writes while the next picture is drawn.
  template <typename Task>
  void Later(Task task) {
    writers_.Add([shared = std::make_shared<Task>(std::move(task))] { (*shared)(); });
  }

  ImageName NameOf(const ScenePhoto& photo) const { return {photo.name, workspace_.ObjectModel()}; }

  PixelMask RotatingPart(const ScenePhoto& photo) {
    PixelMask mask = RotatingMask(Render(MaskRequest(scene_, shape_, photo.view)));
    if (in_masks_) AddRegion(*in_masks_, photo.view, &mask);
    return mask;
  }

  Image8 Mask(const ScenePhoto& photo) { return MaskImage(RotatingPart(photo)); }

  Image8 SoftForeground(const ScenePhoto& photo) {
    RenderRequest request = WholeScene(photo.view);
    request.hard_foreground = false;
    const RenderedView view = Render(request);
    Image8 image{view.width, view.height, 1, {}};
    image.pixels.reserve(view.foreground.size());
    for (const float p : view.foreground) {
      image.pixels.push_back(static_cast<uint8_t>(std::clamp(p, 0.0F, 1.0F) * 255 + 0.5F));
    }
    return image;
  }

  const Undistortion& PlanOf(const ScenePhoto& photo) {
    if (plans_.empty()) plans_ = PlanUndistortions(workspace_.ObjectModel());
    return plans_.at(photo.name);
  }

  Image8 Photo(const ScenePhoto& photo) {
    const Undistortion& plan = PlanOf(photo);
    return UndistortImage(ReadImage(a_.image_path / photo.name, 3), plan.source, plan.pinhole, reporter_);
  }

  RenderRequest ForMaps(const PinholeView& view) const {
    RenderRequest request = ForegroundAlone(view);
    if (a_.maps_of == MapsOf::kAll) request.drawn = DrawnBody::kAll;
    return request;
  }

  // Where the photo shows the table's plain top itself; without pixels where nothing is known of it.
  Image8 TableSeen(const ScenePhoto& photo) {
    const PinholeView view = StationView(photo);
    if (known_texture_)
      return known_texture_->Look(ResizeByArea(Photo(photo), view.width, view.height), view);
    if (!seen_top_ || seen_top_->evidence == TopEvidence::kNone) return {};
    const std::vector<TopSight> sights =
        seen_top_->top.Look(ResizeByArea(Photo(photo), view.width, view.height), view, photo.station);
    Image8 seen{view.width, view.height, 1, {}};
    seen.pixels.reserve(sights.size());
    for (const TopSight sight : sights)
      seen.pixels.push_back(IsTopSeen(sight, seen_top_->evidence) ? 255 : 0);
    return seen;
  }

  void WriteStereo(const ScenePhoto& photo, PinholeView view) {
    const ImageName name = NameOf(photo);
    RenderRequest silhouette = ForMaps(view);
    silhouette.geometry = false;
    PixelMask opaque = OpaqueMask(Render(silhouette));
    if (in_masks_) AddRegion(*in_masks_, view, &opaque);
    Later([path = in_workspace_.Make(workspace_.DenseMasks(), name, ".png"), opaque = std::move(opaque)] {
      WriteImage(path, MaskImage(opaque));
    });
    // COLMAP's maps hold the values of the pixels' top-left corners (colmap_maps.h).
    view.cx += 0.5;
    view.cy += 0.5;
    RenderedView drawn = Render(ForMaps(view));
    if (in_maps_) DrawOpaqueRegion(*in_maps_, view, &drawn);
    const Image8 seen = TableSeen(photo);
    if (seen.width > 0) {
      DrawRegionWhereSeen(table_->region, {seen, StationView(photo)}, view, &drawn);
      Later([path = in_workspace_.Make(workspace_.TableSeen(), name, ".png"), seen] {
        WriteImage(path, seen);
      });
    }
    Later([depth_path = in_workspace_.Make(workspace_.DepthMaps(), name, kMapSuffix),
           normal_path = in_workspace_.Make(workspace_.NormalMaps(), name, kMapSuffix),
           drawn = std::move(drawn), kind = a_.depth,
           size = scene_.size] { WriteMaps(drawn, kind, size, depth_path, normal_path); });
  }

  static void WriteMaps(const RenderedView& rendered, DepthKind kind, double scene_size,
                        const fs::path& depth_path, const fs::path& normal_path) {
    const std::vector<float>& depth =
        kind == DepthKind::kMedian ? rendered.median_depth : rendered.expected_depth;
    ColmapMap depth_map{rendered.width, rendered.height, 1, {}};
    ColmapMap normal_map{rendered.width, rendered.height, 3, {}};
    const size_t count = depth.size();
    depth_map.values.assign(count, 0);
    normal_map.values.assign(3 * count, 0);
    for (size_t i = 0; i < count; ++i) {
      if (!(depth[i] > 0) || rendered.alpha[i] < 0.5F) continue;
      const Eigen::Vector3f normal(rendered.normal[3 * i], rendered.normal[3 * i + 1],
                                   rendered.normal[3 * i + 2]);
      const float length = normal.norm();
      if (!(length > 0)) continue;
      depth_map.values[i] = static_cast<float>(depth[i] * scene_size);
      for (int c = 0; c < 3; ++c) normal_map.values[c * count + i] = normal[c] / length;
    }
    WriteColmapMap(depth_path, depth_map);
    WriteColmapMap(normal_path, normal_map);
  }

  const Arguments& a_;
  const Workspace& workspace_;
  TrainingScene scene_;
  Backend* backend_;
  Reporter& reporter_;
  std::optional<RotatingShape> shape_;
  std::optional<TableRim> table_;
  std::optional<TableCircle> circle_;
  std::optional<RotatingRegion> in_masks_;  // the table, where it is known whose it is
  std::optional<RotatingRegion> in_maps_;   // the same, where photos do not show its shape
  std::optional<double> textured_top_;
  std::optional<SeenTop> seen_top_;
  std::optional<TexturedTop> known_texture_;
  size_t num_beside_table_ = 0;  // Gaussians
  size_t num_around_table_ = 0;
  size_t num_over_top_ = 0;
  fs::path output_;
  ImageOutputs in_workspace_;
  ImageOutputs in_output_;
  std::map<std::string, Undistortion> plans_;
  TaskQueue writers_;  // the last member: its threads end before what they use.
};

// The model and the scene, loaded when the first picture is wanted.
class LazyRenderer {
 public:
  LazyRenderer(const Arguments& arguments, const Workspace& workspace, Reporter& reporter)
      : a_(arguments), workspace_(workspace), reporter_(reporter) {}

  Renderer& Get() {
    if (renderer_) return *renderer_;
    TrainingScene scene = ReadScenePoses(
        {workspace_.ObjectModel(), workspace_.StaticModel(), workspace_.Turntable(), a_.image_path, {}, {}},
        TrainMode::kAuto, reporter_);
    TrainState state;
    state.gaussians = NormaliseGaussians(ReadGaussianPly(a_.model_path), scene.origin, scene.size);
    backend_ = MakeBackend(a_.backend, reporter_);
    backend_->SetState(state);
    names_ = ReadList(a_.image_list, scene);
    renderer_.emplace(a_, workspace_, std::move(scene), backend_.get(), reporter_);
    return *renderer_;
  }

  // Calls `render` for every photo that is asked for.
  void ForEachPhoto(const char* task, const std::function<void(Renderer&, const ScenePhoto&)>& render) {
    Renderer& renderer = Get();
    int64_t done = 0;
    for (const ScenePhoto& photo : renderer.scene().photos) {
      if (names_.count(photo.name) == 0) continue;
      if (reporter_.StopRequested()) throw Interrupted();
      render(renderer, photo);
      // The last photo counts when its files are there.
      if (++done == static_cast<int64_t>(names_.size())) renderer.Finish();
      reporter_.Progress(task, done, static_cast<int64_t>(names_.size()));
    }
  }

  size_t num_photos() const { return names_.size(); }

 private:
  const Arguments& a_;
  const Workspace& workspace_;
  Reporter& reporter_;
  std::unique_ptr<Backend> backend_;
  std::optional<Renderer> renderer_;
  std::set<std::string> names_;
};

void RenderForWorkspace(const Arguments& a, const std::map<std::string, PinholeView>& dense_views,
                        LazyRenderer* lazy) {
  lazy->ForEachPhoto("render", [&](Renderer& renderer, const ScenePhoto& photo) {
    const auto dense = dense_views.find(photo.name);
    if (dense == dense_views.end()) return renderer.RenderForWorkspace(photo, nullptr);
    PinholeView view = dense->second;
    view.cam_from_object = photo.view.cam_from_object;
    view.cam_from_world = photo.view.cam_from_world;
    renderer.RenderForWorkspace(photo, &view);
  });
  if (a.overview) lazy->Get().WriteOverview();
  if (a.masks) lazy->Get().WriteMaskLog();
}

void RenderFrames(const Arguments& a, const Workspace& workspace, LazyRenderer* lazy, Reporter& reporter) {
  Renderer& renderer = lazy->Get();
  const auto& photos = renderer.scene().photos;
  const auto first = std::find_if(photos.begin(), photos.end(),
                                  [&](const ScenePhoto& photo) { return photo.station == a.frame_station; });
  if (first == photos.end()) throw CommandLineError("--frame_station: there is no such station");
  if (!renderer.scene().axis) {
    throw UserError(workspace.Turntable(), "is missing, so there is no axis for --num_frames to turn about",
                    "Leave --num_frames out");
  }
  for (int frame = 0; frame < a.num_frames; ++frame) {
    if (reporter.StopRequested()) throw Interrupted();
    renderer.RenderFrame(frame, first->view, *renderer.scene().axis);
    if (frame + 1 == a.num_frames) renderer.Finish();
    reporter.Progress("frames", frame + 1, a.num_frames);
  }
}

}  // namespace

void RunGaussianRenderer(CommandContext& context) {
  Arguments a;
  Options& options = context.Declare(
      "Renders a trained model: masks, depth and normal maps of the rotating part into the workspace, which "
      "is skipped when it is done, and images to look at. The maps are what tsdf_mesher and colmap "
      "stereo_fusion need.",
      "--workspace_path scan --comparison 1");
  AddOptions(&options, &a);
  AddBackendOptions(&options, &a.backend);
  Reporter& reporter = context.Parse();
  if (a.num_frames < 0) throw CommandLineError("--num_frames must not be negative");

  const Workspace workspace{a.workspace_path};
  StageRunner runner(workspace, reporter);
  if (a.image_path.empty()) a.image_path = workspace.Images();
  if (a.model_path.empty()) a.model_path = workspace.PointCloud();
  std::map<std::string, PinholeView> dense_views;
  if (a.stereo)
    dense_views = PrepareDenseFolder(workspace, a.image_path, a.undistort_always, &runner, reporter);

  LazyRenderer lazy(a, workspace, reporter);
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
    RenderForWorkspace(a, dense_views, &lazy);
    TidyImageOutputs(workspace, a.image_path, lazy.Get().PhotoNames(), reporter);
  };
  if (!stage.outputs.empty() && !runner.Run(stage, render)) {
    context.out() << "up to date       " << workspace.root.string() << '\n';
  }
  if (a.color || a.foreground || a.pictures || a.comparison) {
    lazy.ForEachPhoto("render pictures",
                      [](Renderer& renderer, const ScenePhoto& photo) { renderer.RenderPictures(photo); });
  }
  if (a.num_frames > 0) RenderFrames(a, workspace, &lazy, reporter);
  context.out() << fmt::format("photos rendered  {}\nframes           {}\n", lazy.num_photos(), a.num_frames);
}

}  // namespace s2gs
