#pragma once

#include <filesystem>
#include <string>
#include <utility>

#include "sfm_split/scene/io/colmap_database.h"

struct sqlite3;

namespace s2gs {

/// SQLite itself, to write and look at databases independently of the code under test.
class RawDatabase {
 public:
  /// Opens or creates.
  explicit RawDatabase(const std::filesystem::path& path);
  RawDatabase(RawDatabase&& other) noexcept : handle_(std::exchange(other.handle_, nullptr)) {}
  RawDatabase& operator=(RawDatabase&&) = delete;
  RawDatabase(const RawDatabase&) = delete;
  RawDatabase& operator=(const RawDatabase&) = delete;
  ~RawDatabase();

  /// Fails the current test when SQLite refuses.
  void Execute(const std::string& sql);
  /// The first column of the first row as text, blobs in hexadecimal; "none" without a row.
  std::string Query(const std::string& sql);

 private:
  sqlite3* handle_ = nullptr;
};

/// Schemas as COLMAP's releases create them.
extern const char kColmapSchema38[];
extern const char kColmapSchema312[];
extern const char kColmapSchema42[];

/// Two cameras (7: SIMPLE_RADIAL 640x480, 9: PINHOLE), images 1 "a.jpg", 2 "sub/b.jpg", 5 "c.jpg" with 3, 2
/// and 1 keypoints of 6, 4 and 2 columns, descriptors of image 1, matches of pairs (1, 2) and (2, 5), and the
/// geometry of (1, 2). Literal SQL that fits all three schemas.
extern const char kSmallContent[];

/// A database of kSmallContent at `path`, which is returned; `more_sql` is executed at its end.
std::filesystem::path MakeDatabase(const std::filesystem::path& path, const char* schema = kColmapSchema38,
                                   const std::string& more_sql = "");

/// Reads everything there is, which must not crash whatever the file holds.
void ReadEverything(const ColmapDatabase& database);

}  // namespace s2gs
