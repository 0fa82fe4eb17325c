#include "s2gs/table/scene_table.h"

#include <map>
#include <string>
#include <vector>

#include "s2gs/image/photos.h"
#include "s2gs/table/before_background.h"
#include "s2gs/table/opaque_region.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// Plain tops with shadows and what stands on them have .1 to .3, speckled ones .7 and more.
constexpr double kTexturedTop = 0.5;

// Of the cells of a top (AgreedShare): a thing may stand on a few.
constexpr double kAgreedOfPlane = 0.9;

// In rounds, since a layer hides the next one.
constexpr int kStandingRounds = 20;  // more than came about
// A round renders all photos: what finds less than a hundredth of all that went is the last, a judgement.
constexpr size_t kWorthARound = 100;

// Two photos may agree on a place by chance, which the third bears out.
constexpr int kSurePhotos = 3;

std::vector<Eigen::Vector3d> SurePointsOfThings(const std::vector<ScenePoint>& points) {
  std::vector<Eigen::Vector3d> sure;
  for (const ScenePoint& point : points) {
    if (point.rotates && point.num_photos >= kSurePhotos) sure.push_back(point.x);
  }
  return sure;
}

size_t ClearStanding(const std::vector<StationPhotos>& stations, const RotatingRegion& table,
                     const std::vector<Eigen::Vector3d>& of_things, Backend* backend, Reporter& reporter) {
  size_t count = 0;
  // Asked until they have told: fewer and fewer Gaussians are left to tell it again.
  std::vector<Eigen::Vector3d> asked = of_things;
  bool spares_things = false;
  for (int round = 0; round < kStandingRounds; ++round) {
    const StandingOverTop standing = FindStandingOverTop(table, stations, RotatingDepths(stations, backend),
                                                         backend->GetPlacement(), asked);
    spares_things = spares_things || standing.spares_things;
    if (spares_things) asked.clear();
    if (standing.gaussians.empty() || !spares_things) break;
    count += standing.gaussians.size();
    LeaveOut(standing.gaussians, "over the table's top, where photos see what stands still by its tint",
             backend, reporter);
    if (kWorthARound * standing.gaussians.size() < count) break;
  }
  return count;
}

// A table's own top changes as it turns, and under shadows: it is no background.
size_t ClearBackground(const TrainingScene& scene, const std::vector<StationPhotos>& stations,
                       const std::optional<RotatingShape>& shape, const SceneTable& table, Backend* backend,
                       Reporter& reporter) {
  size_t count = 0;
  for (int round = 0; round < kStandingRounds; ++round) {
    std::vector<std::vector<PixelMask>> masks;
    for (const StationPhotos& station : stations) {
      std::vector<PixelMask>& of_station = masks.emplace_back();
      for (const PinholeView& view : station.views) {
        of_station.push_back(RotatingMask(backend->Render(MaskRequest(scene, shape, view))));
        if (table.rim) AddRegion(table.rim->region, view, &of_station.back());
      }
    }
    const std::vector<uint32_t> showing = FindShowingBackground(stations, masks, backend->GetPlacement());
    count += showing.size();
    LeaveOut(showing, "at which photos show the background", backend, reporter);
    if (kWorthARound * showing.size() <= count) break;
  }
  return count;
}

// By photo, of the rotating part.
std::map<std::string, std::vector<float>> DepthsOfPhotos(const std::vector<uint32_t>& left_out,
                                                         const TrainingScene& scene, Backend* backend) {
  const TrainState all = backend->GetState();
  backend->SetState(SelectState(all, AllBut(left_out, all.gaussians.size())));
  std::map<std::string, std::vector<float>> depths;
  for (const ScenePhoto& photo : scene.photos)
    depths[photo.name] = RotatingDepths(StationView(photo), backend);
  backend->SetState(all);
  return depths;
}

}  // namespace

void LeaveOut(const std::vector<uint32_t>& gaussians, const char* which, Backend* backend,
              Reporter& reporter) {
  if (gaussians.empty()) return;
  backend->Keep(AllBut(gaussians, static_cast<size_t>(backend->Count())));
  reporter.Info(std::to_string(gaussians.size()) + " rotating Gaussians left out " + which);
}

SceneTable SceneTable::Find(const TrainingScene& scene, const LoadPhoto& load,
                            const SceneTableOptions& options, std::optional<RotatingShape>* shape,
                            Backend* backend, Reporter& reporter) {
  SceneTable table;
  std::vector<StationPhotos> stations;
  try {
    stations = LoadStationPhotos(scene, load, reporter);
  } catch (const UserError& error) {
    reporter.Warn(std::string("the table's rim is not looked for in the photos: ") + error.what());
  }
  table.circle = FindTableInPhotos(scene, stations);
  if (!table.circle) {
    table.rim = FindTableRim(scene, backend);
    if (table.rim && table.rim->IsUndecided() && *shape && options.plain_is_object)
      CountTableAsRotating(*table.rim, &**shape);
    if (options.cut_around)
      table.num_around = ClearBackground(scene, stations, *shape, table, backend, reporter);
    return table;
  }
  table.rim = RimOfCircle(scene, *table.circle, *shape, backend);
  const RotatingRegion& region = table.rim->region;
  if (table.rim->IsUndecided() && !options.plain_is_object) return table;
  table.in_masks_ = region;
  // The end of a side that photos show needs no guess by the model's colours below what turns.
  if (table.circle->side_end && *shape) (*shape)->side.reset();
  table.textured_share = TexturedShareOfTop(stations, region);
  const bool is_textured = *table.textured_share >= kTexturedTop;
  std::optional<TexturedTop> texture;
  if (options.clear_plain_top || (options.draw_seen && is_textured))
    texture = TexturedTop::Learn(stations, region);
  // Photos show the shape of a top that has texture and turns, unless they show that it is the plane.
  table.is_plane = is_textured && texture && texture->AgreedShare() >= kAgreedOfPlane;
  if (table.rim->IsUndecided() || !is_textured || table.is_plane) table.in_maps_ = region;
  const std::vector<Eigen::Vector3d> of_things = SurePointsOfThings(scene.points);
  if (options.clear_plain_top)
    table.ClearPlainTop(scene, stations, of_things, options.draw_seen, backend, reporter);
  if (texture && options.clear_plain_top) {
    const std::vector<uint32_t> layers =
        FindLayersOverTexture(*texture, stations, RotatingDepths(stations, backend), backend->GetPlacement());
    table.num_over_top += layers.size();
    LeaveOut(layers, "over the table's top, where photos see its own texture", backend, reporter);
  }
  if (table.in_maps_) {
    // Splats of a table that masks and maps show anyway only blur its rim. The circle is known to a pixel.
    const double margin = PixelAtAxis(stations, region.axis);
    LeaveOut(FindRotatingIn(region, margin, backend->GetPlacement()),
             "of the table, which is known by its rim", backend, reporter);
  }
  if (options.draw_seen && is_textured) table.known_texture_ = texture;
  if (!options.cut_around) return table;
  table.num_over_top += ClearStanding(stations, region, of_things, backend, reporter);
  const std::vector<uint32_t> standing =
      FindStandingAroundTable(stations, region, backend->GetPlacement(), of_things);
  table.num_around = standing.size();
  LeaveOut(standing, "around the table, where photos show no change", backend, reporter);
  table.num_around += ClearBackground(scene, stations, *shape, table, backend, reporter);
  return table;
}

// Of what training builds over a plain top.
void SceneTable::ClearPlainTop(const TrainingScene& scene, const std::vector<StationPhotos>& stations,
                               const std::vector<Eigen::Vector3d>& of_things, bool draw_seen,
                               Backend* backend, Reporter& reporter) {
  const std::optional<PlainTop> top = PlainTop::Learn(stations, rim->region);
  if (!top) return;
  const LayersOverTop layers = FindLayersOverTop(*top, stations, RotatingDepthsWithout(stations, backend),
                                                 backend->GetPlacement(), of_things);
  num_over_top = layers.gaussians.size();
  if (draw_seen) {
    seen_top_ = SeenTop{*top, layers.evidence, {}};
    if (layers.evidence == TopEvidence::kColors)
      seen_top_->hiding_depths = DepthsOfPhotos(layers.hides_nothing, scene, backend);
  }
  LeaveOut(layers.gaussians, "over the table's plain top, where photos see the top itself", backend,
           reporter);
}

void SceneTable::AddToMask(const PinholeView& view, PixelMask* mask) const {
  if (in_masks_) AddRegion(*in_masks_, view, mask);
}

void SceneTable::DrawIntoMaps(const PinholeView& view, RenderedView* drawn) const {
  if (in_maps_) DrawOpaqueRegion(*in_maps_, view, drawn);
}

bool SceneTable::IsTopSeen() const {
  return known_texture_ || (seen_top_ && seen_top_->evidence != TopEvidence::kNone);
}

Image8 SceneTable::Seen(const ScenePhoto& photo, const LoadPhoto& load) const {
  if (!IsTopSeen()) return {};
  const PinholeView small = StationView(photo);
  const Image8 reduced = ResizeByArea(load(photo), small.width, small.height);
  Image8 seen{small.width, small.height, 1, {}};
  if (known_texture_) seen = known_texture_->Look(reduced, small);
  seen.pixels.resize(static_cast<size_t>(small.width) * small.height, 0);
  if (!seen_top_) return seen;
  std::vector<TopSight> sights = seen_top_->top.Look(reduced, small, photo.station);
  const auto hiding = seen_top_->hiding_depths.find(photo.name);
  if (hiding != seen_top_->hiding_depths.end())
    ForgetHiddenShadows(seen_top_->top.table(), small, hiding->second, &sights);
  for (size_t i = 0; i < sights.size(); ++i) {
    if (s2gs::IsTopSeen(sights[i], seen_top_->evidence)) seen.pixels[i] = 255;
  }
  return seen;
}

}  // namespace s2gs
