#pragma once

#include <filesystem>
#include <istream>
#include <optional>
#include <ostream>
#include <string>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

struct TurntableImage {
  std::string name;          ///< path relative to the image folder, as in the COLMAP model.
  int station = 0;           ///< 0 to num_stations - 1.
  double angle_deg = 0;      ///< turn of the table since the reference image, about +axis [degrees].
  Rigid3 world_from_object;  ///< "object_to_world" in the file.
};

/// turntable.json: how the table moved.
struct TurntableFile {
  TurntableAxis axis;
  int num_stations = 0;
  bool scale_observable = false;
  LengthUnit units = LengthUnit::kSfm;
  /// Each station once, in sets between which angle_deg is known; between sets it is a choice, because
  /// nothing but the object is seen from both. Empty: it is known between all.
  std::vector<std::vector<int>> tied_stations;
  std::vector<TurntableImage> images;
};

/// Whether the object's rotation differs between two images by half a degree or more.
bool TableTurns(const TurntableFile& turntable);

/// How the images' angles contradict their own matrices, as a sentence: "the angle_deg of 3 of 36 images
/// ...". Nothing when all agree within 5 degrees, a quarter of a usual step; within each station, between
/// which the object may have been laid down in another way.
std::optional<std::string> FindContradiction(const TurntableFile& turntable);

/// Between which stations angles cannot be compared, as a sentence; empty where they can between all.
/// \param tied_stations  as in TurntableFile.
std::string DescribeUntiedStations(const std::vector<std::vector<int>>& tied_stations);

/// Reads version 1. Rotations and the axis may be off by 1e-6 (single precision) and are then made exact.
/// Throws UserError with the path and the place in the file when a value is missing, of the wrong kind or
/// impossible: unknown version, no images, a matrix that is not rigid, a name that cannot be one or occurs
/// twice, a station that does not exist or is in no or two sets of tied stations.
TurntableFile ReadTurntableFile(const std::filesystem::path& path);

/// \param path  for messages only.
TurntableFile ReadTurntableFile(std::istream& stream, const std::filesystem::path& path);

/// Writes version 1 atomically, with as many digits as the numbers need to come back unchanged.
/// Throws UserError when the content is one that ReadTurntableFile refuses, or the file cannot be written.
void WriteTurntableFile(const std::filesystem::path& path, const TurntableFile& turntable);

/// \param path  for messages only.
void WriteTurntableFile(std::ostream& stream, const TurntableFile& turntable,
                        const std::filesystem::path& path);

}  // namespace s2gs
