#include "plugin/outputs/scene_renderer.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>
#include <vector>

#include "plugin/cli/options.h"
#include "plugin/outputs/beside_table.h"
#include "plugin/stage/stale_outputs.h"
#include "s2gs/gaussians_ply.h"
#include "s2gs/held_out.h"
#include "s2gs/image/image_file.h"
#include "s2gs/image/photos.h"
#include "s2gs/image/undistort.h"
#include "s2gs/render_pictures.h"
#include "s2gs/rotating_mask.h"
#include "s2gs/scene/photo_list.h"
#include "s2gs/scene/scene_lengths.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/table/opaque_region.h"
#include "s2gs/table/scene_table.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/base/keeping_reporter.h"
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

std::vector<std::string> NamesOf(const TrainingScene& scene) {
  std::vector<std::string> names;
  names.reserve(scene.photos.size());
  for (const ScenePhoto& photo : scene.photos) names.push_back(photo.name);
  return names;
}

std::set<std::string> SetOfNames(const TrainingScene& scene) {
  const std::vector<std::string> names = NamesOf(scene);
  return {names.begin(), names.end()};
}

// Of each thread that writes: a picture with all its maps, what is made of them, and the next one that waits;
// the photo that tells where its table is seen, with its lens and without.
constexpr uint64_t kWritingBytesPerPixel = uint64_t{2} * (10 + 4) * sizeof(float) + 12;

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

RenderRequest ForegroundAlone(const PinholeView& view) {
  RenderRequest request;
  request.view = view;
  request.drawn = DrawnBody::kForeground;
  request.geometry = true;
  return request;
}

class Renderer {
 public:
  Renderer(const RendererArguments& arguments, const Workspace& workspace, TrainingScene scene,
           Backend* backend, Reporter& reporter)
      : a_(arguments),
        workspace_(workspace),
        scene_(std::move(scene)),
        backend_(backend),
        in_color_(backend),
        reporter_(reporter),
        output_(a_.output_path.empty() ? workspace.Own() / "renders" : a_.output_path),
        in_workspace_(workspace.root, a_.image_path, NamesOf(scene_)),
        in_output_(a_.output_path.empty() ? workspace.root : output_, a_.image_path, NamesOf(scene_)),
        writers_(ThreadsThatFit(kWritingBytesPerPixel * LargestView(scene_))) {
    if (scene_.mode == TrainMode::kS2gs) {
      if (a_.cut_at_table) {
        const std::vector<uint32_t> beside = FindRotatingBesideTable(scene_, backend_, reporter_);
        num_beside_table_ = beside.size();
        LeaveOut(beside, "that lie beside the table", backend_, reporter_);
      }
      if (scene_.region) {
        LeaveOut(FindReachingOut(*scene_.region, backend_->GetGaussians()),
                 "that reach farther from the axis than anything turns", backend_, reporter_);
      }
      shape_ = FindRotatingShape(scene_, backend_->GetGaussians());
      const SceneTableOptions options = {a_.plain_table == PlainTable::kObject, a_.clear_plain_top,
                                         a_.table_seen, a_.cut_at_table};
      table_ = SceneTable::Find(scene_, LoadPhotos(), options, &shape_, backend_, reporter_);
    }
  }

  // What other stages and COLMAP work on. \param dense_view  null: no maps.
  void RenderForWorkspace(const ScenePhoto& photo, const PinholeView* dense_view) {
    if (a_.masks) {
      const Undistortion& plan = PlanOf(photo);
      Later([this, &plan, &photo, path = in_workspace_.Make(workspace_.Masks(), NameOf(photo), ".png"),
             drawn = Render(MaskRequest(scene_, shape_, photo.view))] {
        // Masks are those of the photos as they are, with their distortion.
        KeepingReporter silent(reporter_);
        WriteImage(path, DistortMask(plan, MaskImage(WithTable(photo, RotatingMask(drawn))), silent));
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
      const Image8 color = ToImage8(RenderInColor(WholeScene(photo.view)));
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
        WriteImage(depth_path, DepthPicture(DepthsOf(view, kind), view.width, view.height));
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
      const RenderedView view = RenderInColor(WholeScene(photo->view));
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
    Later([path = in_output_.Make(output_ / "frames", name, ".png"),
           view = RenderInColor(WholeScene(turned))] { WriteImage(path, ToImage8(view)); });
  }

  const TrainingScene& scene() const { return scene_; }

  /// \param trained  the model as it was trained. Masks and maps know a table by its rim, and leave its
  /// Gaussians out; photos show the table.
  void ShowColorsOf(Backend* trained) { in_color_ = trained; }

  // s2gs/mask_log.jsonl: what masks rest on beside p.
  void WriteMaskLog() const {
    const std::optional<TableRim>& rim = table_.rim;
    nlohmann::ordered_json line = {{"stage", "masks"}, {"event", "table"}, {"found", rim.has_value()}};
    line["gaussians_beside"] = num_beside_table_;
    line["gaussians_around"] = table_.num_around;
    line["gaussians_over_top"] = table_.num_over_top;
    line["top_seen"] = table_.IsTopSeen();
    if (table_.textured_share) line["textured_share"] = *table_.textured_share;
    line["top_is_plane"] = table_.is_plane;
    if (table_.circle) {
      const Eigen::Vector3d top = scene_.axis->point + table_.circle->height * scene_.axis->direction;
      line["top"] = (scene_.origin + scene_.size * top).dot(scene_.axis->direction);
      line["top_radius"] = table_.circle->radius * scene_.size;
    }
    if (rim) {
      line["radius"] = rim->region.radius * scene_.size;
      line["height"] = (rim->region.high - rim->region.low) * scene_.size;
      line["share_of_directions"] = rim->share;
      line["false_alarms"] = rim->false_alarms;
      line["static_share"] = rim->static_share;
      line["undecided"] = rim->IsUndecided();
      line["counts_as"] =
          !rim->IsUndecided() || a_.plain_table == PlainTable::kObject ? "object" : "background";
    }
    WriteFileAtomically(workspace_.MaskLog(), [&](std::ostream& out) { out << line.dump() << '\n'; });
  }

 private:
  RenderedView RenderBy(Backend* backend, RenderRequest request) {
    ThrowIfStopped();
    request.stop_requested = [this] { return reporter_.StopRequested(); };
    return backend->Render(request);
  }
  RenderedView Render(const RenderRequest& request) { return RenderBy(backend_, request); }
  RenderedView RenderInColor(const RenderRequest& request) { return RenderBy(in_color_, request); }

  // From any thread.
  void ThrowIfStopped() const {
    if (reporter_.StopRequested()) throw Interrupted();
  }

  // Compresses and writes while the next picture is drawn.
  template <typename Task>
  void Later(Task task) {
    writers_.Add([shared = std::make_shared<Task>(std::move(task))] { (*shared)(); });
  }

  ImageName NameOf(const ScenePhoto& photo) const { return {photo.name, workspace_.ObjectModel()}; }

  PixelMask WithTable(const ScenePhoto& photo, PixelMask mask) const {
    table_.AddToMask(photo.view, &mask);
    return mask;
  }

  Image8 Mask(const ScenePhoto& photo) {
    return MaskImage(WithTable(photo, RotatingMask(Render(MaskRequest(scene_, shape_, photo.view)))));
  }

  Image8 SoftForeground(const ScenePhoto& photo) {
    RenderRequest request = WholeScene(photo.view);
    request.hard_foreground = false;
    return ForegroundPicture(RenderInColor(request));
  }

  const Undistortion& PlanOf(const ScenePhoto& photo) {
    if (plans_.empty()) plans_ = PlanUndistortions(workspace_.ObjectModel());
    return plans_.at(photo.name);
  }

  Image8 Photo(const ScenePhoto& photo) {
    const Undistortion& plan = PlanOf(photo);
    return UndistortImage(ReadImage(a_.image_path / photo.name, 3), plan.source, plan.pinhole, reporter_);
  }

  LoadPhoto LoadPhotos() {
    return [this](const ScenePhoto& photo) { return Photo(photo); };
  }

  RenderRequest ForMaps(const PinholeView& view) const {
    RenderRequest request = ForegroundAlone(view);
    if (a_.maps_of == MapsOf::kAll) request.drawn = DrawnBody::kAll;
    return request;
  }

  void WriteStereo(const ScenePhoto& photo, PinholeView view) {
    const ImageName name = NameOf(photo);
    RenderRequest silhouette = ForMaps(view);
    silhouette.geometry = false;
    Later([this, view, path = in_workspace_.Make(workspace_.DenseMasks(), name, ".png"),
           drawn = Render(silhouette)] {
      PixelMask opaque = OpaqueMask(drawn);
      table_.AddToMask(view, &opaque);
      WriteImage(path, MaskImage(opaque));
    });
    // COLMAP's maps hold the values of the pixels' top-left corners (colmap_maps.h).
    view.cx += 0.5;
    view.cy += 0.5;
    PlanOf(photo);  // what is asked for the first time is read, which is for one thread
    fs::path seen_path;
    if (table_.IsTopSeen()) seen_path = in_workspace_.Make(workspace_.TableSeen(), name, ".png");
    Later([this, &photo, view, seen_path,
           depth_path = in_workspace_.Make(workspace_.DepthMaps(), name, kMapSuffix),
           normal_path = in_workspace_.Make(workspace_.NormalMaps(), name, kMapSuffix),
           drawn = Render(ForMaps(view))]() mutable {
      ThrowIfStopped();
      table_.DrawIntoMaps(view, &drawn);
      const Image8 seen = table_.Seen(photo, LoadPhotos());
      if (seen.width > 0) {
        DrawRegionWhereSeen(table_.rim->region, {seen, StationView(photo)}, view, &drawn);
        WriteImage(seen_path, seen);
      }
      ThrowIfStopped();
      const ViewMaps maps = ColmapMapsOf(drawn, a_.depth, scene_.size);
      WriteColmapMap(depth_path, maps.depth);
      ThrowIfStopped();
      WriteColmapMap(normal_path, maps.normal);
    });
  }

  const RendererArguments& a_;
  const Workspace& workspace_;
  TrainingScene scene_;
  Backend* backend_;  // less what is left out
  Backend* in_color_;
  Reporter& reporter_;
  std::optional<RotatingShape> shape_;
  SceneTable table_;
  size_t num_beside_table_ = 0;  // Gaussians
  fs::path output_;
  ImageOutputs in_workspace_;
  ImageOutputs in_output_;
  std::map<std::string, Undistortion> plans_;
  TaskQueue writers_;  // the last member: its threads end before what they use.
};

}  // namespace

// The model and the scene, loaded when the first picture is wanted.
class SceneRenderer::LazyRenderer {
 public:
  LazyRenderer(const RendererArguments& arguments, const Workspace& workspace, Reporter& reporter)
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
    names_ = a_.image_list.empty() ? SetOfNames(scene)
                                   : ReadPhotoList(a_.image_list, scene.photos, "--image_list");
    renderer_.emplace(a_, workspace_, std::move(scene), backend_.get(), reporter_);
    if (AsksForColors() && backend_->Count() < static_cast<int64_t>(state.gaussians.size())) {
      KeepingReporter silent(reporter_);
      in_color_ = MakeBackend(a_.backend, silent);
      in_color_->SetState(state);
      renderer_->ShowColorsOf(in_color_.get());
    }
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
  bool AsksForColors() const {
    return a_.overview || a_.color || a_.foreground || a_.comparison || a_.num_frames > 0;
  }

  const RendererArguments& a_;
  const Workspace& workspace_;
  Reporter& reporter_;
  std::unique_ptr<Backend> backend_;
  std::unique_ptr<Backend> in_color_;  // null where nothing is left out
  std::optional<Renderer> renderer_;
  std::set<std::string> names_;
};

SceneRenderer::SceneRenderer(const RendererArguments& arguments, const Workspace& workspace,
                             Reporter& reporter)
    : a_(arguments),
      workspace_(workspace),
      reporter_(reporter),
      lazy_(std::make_unique<LazyRenderer>(a_, workspace_, reporter)) {}
SceneRenderer::~SceneRenderer() = default;

void SceneRenderer::RenderForWorkspace(const std::map<std::string, PinholeView>& dense_views) {
  lazy_->ForEachPhoto("render", [&](Renderer& renderer, const ScenePhoto& photo) {
    const auto dense = dense_views.find(photo.name);
    if (dense == dense_views.end()) return renderer.RenderForWorkspace(photo, nullptr);
    PinholeView view = dense->second;
    view.cam_from_object = photo.view.cam_from_object;
    view.cam_from_world = photo.view.cam_from_world;
    renderer.RenderForWorkspace(photo, &view);
  });
  if (a_.overview) lazy_->Get().WriteOverview();
  if (a_.masks) lazy_->Get().WriteMaskLog();
}

void SceneRenderer::RenderPictures() {
  lazy_->ForEachPhoto("render pictures",
                      [](Renderer& renderer, const ScenePhoto& photo) { renderer.RenderPictures(photo); });
}

void SceneRenderer::RenderFrames() {
  Renderer& renderer = lazy_->Get();
  const auto& photos = renderer.scene().photos;
  const auto first = std::find_if(photos.begin(), photos.end(),
                                  [&](const ScenePhoto& photo) { return photo.station == a_.frame_station; });
  if (first == photos.end()) throw CommandLineError("--frame_station: there is no such station");
  if (!renderer.scene().axis) {
    throw UserError(workspace_.Turntable(), "is missing, so there is no axis for --num_frames to turn about",
                    "Leave --num_frames out");
  }
  for (int frame = 0; frame < a_.num_frames; ++frame) {
    if (reporter_.StopRequested()) throw Interrupted();
    renderer.RenderFrame(frame, first->view, *renderer.scene().axis);
    if (frame + 1 == a_.num_frames) renderer.Finish();
    reporter_.Progress("frames", frame + 1, a_.num_frames);
  }
}

std::set<std::string> SceneRenderer::PhotoNames() { return SetOfNames(lazy_->Get().scene()); }
size_t SceneRenderer::num_photos() const { return lazy_->num_photos(); }

}  // namespace s2gs
