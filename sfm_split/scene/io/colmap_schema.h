#pragma once

#include <cstdint>

namespace s2gs {

class SqliteConnection;

/// Which of COLMAP's schemas a database has, by what differs between versions.
struct ColmapSchema {
  int64_t version = 0;               ///< COLMAP's that wrote it: 3800 is 3.8, 4020100 is 4.2.1.
  bool has_image_priors = false;     ///< images have the columns prior_q* and prior_t*.
  bool has_descriptor_type = false;  ///< descriptors say whether they are SIFT's.
  bool has_relative_pose = false;    ///< two-view geometries have qvec and tvec.
  bool has_frames = false;           ///< COLMAP 3.12 and newer: cameras belong to rigs, images to frames.
};

/// The tables and columns that all versions share have to be there. Throws UserError with the path.
ColmapSchema ReadColmapSchema(SqliteConnection* connection);

/// Makes the tables of COLMAP 3.8 in an empty database.
void WriteColmapSchema38(SqliteConnection* connection);

}  // namespace s2gs
