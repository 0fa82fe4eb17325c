#include "sfm_split/scene/io/colmap_schema.h"

#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/sqlite_connection.h"

namespace s2gs {
namespace {

// Hundreds of times what reading a real schema takes.
constexpr int kMaxSchemaSteps = 10'000'000;

// COLMAP 3.8's, which later versions upgrade.
constexpr char kSchema38[] = R"sql(
CREATE TABLE cameras(
  camera_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
  model INTEGER NOT NULL,
  width INTEGER NOT NULL,
  height INTEGER NOT NULL,
  params BLOB,
  prior_focal_length INTEGER NOT NULL);
CREATE TABLE images(
  image_id INTEGER PRIMARY KEY AUTOINCREMENT NOT NULL,
  name TEXT NOT NULL UNIQUE,
  camera_id INTEGER NOT NULL,
  prior_qw REAL, prior_qx REAL, prior_qy REAL, prior_qz REAL,
  prior_tx REAL, prior_ty REAL, prior_tz REAL,
  CONSTRAINT image_id_check CHECK(image_id >= 0 and image_id < 2147483647),
  FOREIGN KEY(camera_id) REFERENCES cameras(camera_id));
CREATE UNIQUE INDEX index_name ON images(name);
CREATE TABLE keypoints(
  image_id INTEGER PRIMARY KEY NOT NULL,
  rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB,
  FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE descriptors(
  image_id INTEGER PRIMARY KEY NOT NULL,
  rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB,
  FOREIGN KEY(image_id) REFERENCES images(image_id) ON DELETE CASCADE);
CREATE TABLE matches(
  pair_id INTEGER PRIMARY KEY NOT NULL,
  rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB);
CREATE TABLE two_view_geometries(
  pair_id INTEGER PRIMARY KEY NOT NULL,
  rows INTEGER NOT NULL, cols INTEGER NOT NULL, data BLOB,
  config INTEGER NOT NULL,
  F BLOB, E BLOB, H BLOB, qvec BLOB, tvec BLOB);
PRAGMA user_version = 3800;
)sql";

struct RequiredTable {
  const char* name;
  const char* key;
  std::vector<const char*> columns;
};

const std::vector<RequiredTable>& RequiredTables() {
  static const std::vector<RequiredTable> tables = {
      {"cameras", "camera_id", {"model", "width", "height", "params", "prior_focal_length"}},
      {"images", "image_id", {"name", "camera_id"}},
      {"keypoints", "image_id", {"rows", "cols", "data"}},
      {"descriptors", "image_id", {"rows", "cols", "data"}},
      {"matches", "pair_id", {"rows", "cols", "data"}},
      {"two_view_geometries", "pair_id", {"rows", "cols", "data", "config", "F", "E", "H"}},
  };
  return tables;
}

struct TableColumns {
  std::set<std::string> names;
  std::string key;  // of a primary key of one column.
};

TableColumns ReadTableColumns(const SqliteConnection& connection, const std::string& table) {
  TableColumns columns;
  int num_key_columns = 0;
  SqliteStatement statement(connection,
                            "SELECT info.name, info.pk FROM sqlite_master AS master, "
                            "pragma_table_info(?) AS info "
                            "WHERE master.name = ? AND master.type = 'table' AND master.rootpage > 0",
                            "schema");
  statement.BindText(0, table);
  statement.BindText(1, table);
  while (statement.Step()) {
    const std::string name(statement.Text(0));
    columns.names.insert(name);
    if (statement.Integer(1) > 0) {
      columns.key = ++num_key_columns == 1 ? name : "";
    }
  }
  return columns;
}

}  // namespace

ColmapSchema ReadColmapSchema(SqliteConnection* connection) {
  ColmapSchema schema;
  connection->LimitSteps(kMaxSchemaSteps);
  {
    SqliteStatement statement(*connection, "PRAGMA user_version", "schema version");
    if (statement.Step()) schema.version = statement.Integer(0);
  }
  const auto fail = [&](const std::string& problem) {
    throw UserError(connection->path(), problem + " (schema version " + std::to_string(schema.version) + ")",
                    "Databases of COLMAP 3.8 to 4.2 can be read. Open it once with such a version, which "
                    "updates older ones, or run feature extraction again");
  };
  for (const RequiredTable& table : RequiredTables()) {
    const TableColumns columns = ReadTableColumns(*connection, table.name);
    if (columns.names.empty()) {
      fail("has no table \"" + std::string(table.name) + "\" as COLMAP's databases have");
    }
    if (columns.key != table.key) {
      fail("the table \"" + std::string(table.name) + "\" has not " + table.key + " as its key");
    }
    for (const char* column : table.columns) {
      if (columns.names.count(column) == 0) {
        fail("the table \"" + std::string(table.name) + "\" has no column \"" + column + "\"");
      }
    }
    const auto has = [&](const char* column) { return columns.names.count(column) > 0; };
    if (table.name == std::string_view("images"))
      schema.has_image_priors = has("prior_qw") && has("prior_tz");
    if (table.name == std::string_view("descriptors")) schema.has_descriptor_type = has("type");
    if (table.name == std::string_view("two_view_geometries")) {
      schema.has_relative_pose = has("qvec") && has("tvec");
    }
  }
  schema.has_frames = !ReadTableColumns(*connection, "frame_data").names.empty();
  connection->LimitSteps(std::nullopt);
  return schema;
}

void WriteColmapSchema38(SqliteConnection* connection) {
  connection->Execute(std::string("BEGIN;") + kSchema38 + "COMMIT;");
}

}  // namespace s2gs
