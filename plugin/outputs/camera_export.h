#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <ostream>
#include <string>

#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// A model's cameras in the files of other programs. Poses are those of the model: the object's frame, z up.

/// Where the photos of a transforms.json lie, relative to it, with '/' at the end or empty.
struct NerfPaths {
  std::string images;
  std::string masks;          ///< NAME.png below it; empty: there are none.
  std::string sparse_points;  ///< "ply_file_path"; empty: none.
};

/// NeRF's transforms.json, as instant-ngp, nerfstudio and gsplat read it: per photo camera-to-world matrices
/// with x right, y up and z backwards, and intrinsics of OpenCV's model in pixels whose top-left corner is
/// (0, 0). Throws UserError for lenses that OpenCV's model does not have. \param model_path  for messages.
nlohmann::ordered_json NerfTransforms(const ColmapModel& model, const NerfPaths& paths,
                                      const std::filesystem::path& model_path);

/// A Metashape camera file (XML, version 1.5.0): sensors with calibrations in Metashape's parameters, cameras
/// with camera-to-chunk transforms; cx and cy are from the middle of the photo, b1 is fx - fy, and P1, P2 are
/// OpenCV's p2, p1. Labels are names without folders and extensions, as Metashape gives them, unless two
/// would be equal. Throws UserError for lenses that its frame cameras do not have.
void WriteMetashapeCameras(const ColmapModel& model, const std::filesystem::path& model_path,
                           std::ostream& stream);

/// The sparse points as PLY vertices with colours.
void WritePointsPly(const ColmapModel& model, const std::filesystem::path& path);

}  // namespace s2gs
