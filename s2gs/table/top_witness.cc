#include "s2gs/table/top_witness.h"

#include "s2gs/table/layers_over_top.h"
#include "s2gs/table_circle.h"

namespace s2gs {

std::vector<uint32_t> TopWitness::FindRefuted(Backend* backend, Reporter& reporter) {
  if (!has_learnt_) Learn(reporter);
  if (!top_) return {};
  return FindLayersOverTop(*top_, stations_, RotatingDepths(stations_, backend), backend->GetPlacement())
      .gaussians;
}

void TopWitness::Learn(Reporter& reporter) {
  has_learnt_ = true;
  stations_ = LoadStationPhotos(
      scene_, [](const ScenePhoto& photo) { return photo.image; }, reporter);
  const std::optional<TableCircle> circle = FindTableInPhotos(scene_, stations_);
  if (!circle) return;
  const RotatingRegion table = RegionOfCircle(scene_, *circle);
  if (TexturedShareOfTop(stations_, table) < kTexturedTop) top_ = PlainTop::Learn(stations_, table);
}

}  // namespace s2gs
