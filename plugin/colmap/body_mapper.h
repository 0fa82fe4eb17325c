#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "plugin/colmap/colmap_process.h"
#include "plugin/colmap/mapping_attempts.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// One `colmap mapper` run on one body's database, with more tolerant runs after it where it finds little.
struct BodyMapping {
  std::string body;  ///< for messages: "the object".
  std::filesystem::path database;
  std::filesystem::path images;
  std::filesystem::path output;  ///< emptied; the best run's models are left in numbered folders.
  int min_model_size = 3;        ///< of COLMAP's mapper.
  int num_images = 0;            ///< that could be registered.
  double enough_share = 0.5;     ///< of them; with fewer registered the next run is more tolerant.
  int max_attempts = 3;
  std::vector<std::string> options;  ///< NAME=VALUE in COLMAP's spelling, for every run.
};

/// What the object's mapping asks for: photos that SfM leaves out are placed later, so that half is enough.
BodyMapping ObjectMapping();
/// The background's: two photos, one a station, are a model, and a station that it lacks is hard to place.
BodyMapping BackgroundMapping();

/// \return  the attempts made; the models are in `mapping.output`, none when every attempt failed.
/// Throws Interrupted, ColmapKilled when nothing came of it because colmap was ended by a signal, and
/// UserError when an option of `options` is no NAME=VALUE.
std::vector<MappingAttempt> MapBody(const BodyMapping& mapping, ColmapProgram* colmap, Reporter& reporter);

/// Takes away what MapBody left in and beside `output`, also where it was stopped.
void RemoveMapping(const std::filesystem::path& output);

/// The models in numbered folders, those with most images first. Models that cannot be read are left out with
/// a warning.
std::vector<ColmapModel> ReadMappedModels(const std::filesystem::path& folder, Reporter& reporter);

}  // namespace s2gs
