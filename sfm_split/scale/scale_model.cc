#include "sfm_split/scale/scale_model.h"

namespace s2gs {

void ScaleModel(double factor, ColmapModel* model) {
  for (auto& [id, image] : model->images) image.cam_from_world.translation *= factor;
  for (auto& [id, point] : model->points3D) point.xyz *= factor;
  for (auto& [id, frame] : model->frames) frame.rig_from_world.translation *= factor;
  for (auto& [id, rig] : model->rigs) {
    for (ColmapRigSensor& sensor : rig.sensors) {
      if (sensor.sensor_from_rig) sensor.sensor_from_rig->translation *= factor;
    }
  }
}

void ScaleTurntableToMetres(double metres_per_unit, TurntableFile* turntable) {
  turntable->axis.point *= metres_per_unit;
  for (TurntableImage& image : turntable->images) image.world_from_object.translation *= metres_per_unit;
  turntable->units = LengthUnit::kMetre;
}

}  // namespace s2gs
