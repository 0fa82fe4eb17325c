#include "sfm_split/colmap_database.h"

#include <sqlite3.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <set>
#include <string_view>
#include <utility>

#include "sfm_split/camera_model.h"
#include "sfm_split/error.h"
#include "sfm_split/file_io.h"
#include "sfm_split/sqlite_connection.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxNumImages = 2147483647;  // COLMAP's; also the factor in the pair id.
constexpr int64_t kMaxImageId = kMaxNumImages - 1;
constexpr int64_t kMaxCameraId = std::numeric_limits<uint32_t>::max() - 1;
constexpr int64_t kMaxImageSide = int64_t{1} << 31;
constexpr int64_t kSiftType = 0;
constexpr int64_t kCameraSensorType = 0;
// Hundreds of times what reading a real schema takes.
constexpr int kMaxSchemaSteps = 10'000'000;

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

std::string PairName(uint32_t image_id1, uint32_t image_id2) {
  return "images " + std::to_string(image_id1) + " and " + std::to_string(image_id2);
}

// The columns rows, cols and data hold a row-major matrix; the blob's size has to agree.
// Returns the number of rows; `cols` stays free when it is 0.
template <typename Scalar>
int64_t CheckedRows(const SqliteStatement& statement, int first_column, int64_t* cols) {
  const int64_t rows = statement.Integer(first_column, 0, std::numeric_limits<int32_t>::max());
  *cols = statement.Integer(first_column + 1, 0, std::numeric_limits<int32_t>::max());
  const uint64_t size = statement.Blob(first_column + 2).size();
  // Both factors fit into 31 bits.
  const uint64_t elements = static_cast<uint64_t>(rows) * static_cast<uint64_t>(*cols);
  if (size % sizeof(Scalar) != 0 || size / sizeof(Scalar) != elements) {
    statement.FailContent("its data has " + std::to_string(size) + " bytes, but " + std::to_string(rows) +
                          " rows of " + std::to_string(*cols) + " columns are claimed");
  }
  return rows;
}

FeatureMatches MatchesFromColumns(const SqliteStatement& statement, int first_column) {
  static_assert(sizeof(FeatureMatch) == 2 * sizeof(uint32_t));
  int64_t cols = 0;
  const int64_t rows = CheckedRows<uint32_t>(statement, first_column, &cols);
  if (rows > 0 && cols != 2)
    statement.FailContent("matches have " + std::to_string(cols) + " columns, not 2");
  FeatureMatches matches(static_cast<size_t>(rows));
  if (rows > 0) {
    const std::string_view bytes = statement.Blob(first_column + 2);
    std::memcpy(matches.data(), bytes.data(), bytes.size());
  }
  return matches;
}

void SwapMatches(FeatureMatches* matches) {
  for (FeatureMatch& match : *matches) std::swap(match.point2D_idx1, match.point2D_idx2);
}

// A fixed-size blob of doubles; absent when NULL, empty or all zero.
template <int kRows, int kCols>
std::optional<Eigen::Matrix<double, kRows, kCols>> MatrixFromColumn(const SqliteStatement& statement,
                                                                    int column, const char* name) {
  using RowMajor = Eigen::Matrix<double, kRows, kCols, kCols == 1 ? Eigen::ColMajor : Eigen::RowMajor>;
  const std::string_view bytes = statement.Blob(column);
  if (bytes.empty()) return std::nullopt;
  RowMajor matrix;
  if (bytes.size() != sizeof(double) * kRows * kCols) {
    statement.FailContent(std::string(name) + " has " + std::to_string(bytes.size()) + " bytes, not " +
                          std::to_string(sizeof(double) * kRows * kCols));
  }
  std::memcpy(matrix.data(), bytes.data(), bytes.size());
  if (!matrix.allFinite()) statement.FailContent(std::string(name) + " is not finite");
  if (matrix.isZero(0)) return std::nullopt;
  return matrix;
}

// Columns config, F, E, H and, where the schema has them, qvec and tvec.
TwoViewGeometry GeometryFromColumns(const SqliteStatement& statement, int first_column, bool has_pose) {
  TwoViewGeometry geometry;
  geometry.inlier_matches = MatchesFromColumns(statement, first_column);
  int column = first_column + 3;
  geometry.config = static_cast<TwoViewConfig>(
      statement.Integer(column++, 0, static_cast<int>(TwoViewConfig::kCalibratedRig)));
  geometry.F = MatrixFromColumn<3, 3>(statement, column++, "F");
  geometry.E = MatrixFromColumn<3, 3>(statement, column++, "E");
  geometry.H = MatrixFromColumn<3, 3>(statement, column++, "H");
  if (!has_pose) return geometry;
  const auto qvec = MatrixFromColumn<4, 1>(statement, column++, "qvec");
  const auto tvec = MatrixFromColumn<3, 1>(statement, column++, "tvec");
  if (!qvec) return geometry;
  const double norm = qvec->stableNorm();
  const Eigen::Vector4d wxyz = *qvec / norm;
  if (!wxyz.allFinite()) statement.FailContent("qvec is not a rotation");
  const bool is_identity = wxyz.tail<3>().isZero(0);
  if (is_identity && !tvec) return geometry;
  geometry.cam2_from_cam1 =
      Rigid3{Eigen::Quaterniond(wxyz[0], wxyz[1], wxyz[2], wxyz[3]), tvec.value_or(Eigen::Vector3d::Zero())};
  return geometry;
}

class PairScan {
 public:
  // SQLite walks the table in the order of its key; a damaged tree that visits a page twice breaks the order.
  void Visit(const SqliteStatement& statement, int column) {
    pair_id_ = statement.Integer(column);
    const int64_t id1 = pair_id_ / static_cast<int64_t>(kMaxNumImages);
    const int64_t id2 = pair_id_ % static_cast<int64_t>(kMaxNumImages);
    if (pair_id_ <= last_) statement.FailContent("its rows are out of order");
    if (id1 < 0 || id1 >= id2 || id1 > kMaxImageId) {
      statement.FailContent("pair_id " + std::to_string(pair_id_) + " is not of two different images");
    }
    last_ = pair_id_;
    image_id1 = static_cast<uint32_t>(id1);
    image_id2 = static_cast<uint32_t>(id2);
  }

  uint32_t image_id1 = 0;
  uint32_t image_id2 = 0;

 private:
  int64_t pair_id_ = -1;
  int64_t last_ = -1;
};

int64_t CheckedPairId(uint32_t image_id1, uint32_t image_id2) {
  return static_cast<int64_t>(PairIdFromImageIds(image_id1, image_id2));
}

template <typename Matrix>
void BindMatrixRows(SqliteStatement& statement, int first_index, const Matrix& matrix) {
  statement.BindInteger(first_index, matrix.rows());
  statement.BindInteger(first_index + 1, matrix.cols());
  statement.BindBlob(first_index + 2, matrix.data(),
                     static_cast<uint64_t>(matrix.size()) * sizeof(typename Matrix::Scalar));
}

void BindMatches(SqliteStatement& statement, int first_index, const FeatureMatches& matches) {
  statement.BindInteger(first_index, static_cast<int64_t>(matches.size()));
  statement.BindInteger(first_index + 1, 2);
  statement.BindBlob(first_index + 2, matches.data(), matches.size() * sizeof(FeatureMatch));
}

void BindDoubles(SqliteStatement& statement, int index, const double* values, uint64_t count) {
  if (values == nullptr) {
    statement.BindNull(index);
  } else {
    statement.BindBlob(index, values, count * sizeof(double));
  }
}

// The image's priors, where the schema has them and all values of one are there.
template <int kSize>
std::optional<Eigen::Matrix<double, kSize, 1>> PriorFromColumns(const SqliteStatement& statement,
                                                                int first_column) {
  Eigen::Matrix<double, kSize, 1> prior;
  for (int i = 0; i < kSize; ++i) {
    if (statement.IsNull(first_column + i)) return std::nullopt;
    prior[i] = statement.Real(first_column + i);
  }
  if (!prior.allFinite()) return std::nullopt;
  return prior;
}

}  // namespace

uint64_t PairIdFromImageIds(uint32_t image_id1, uint32_t image_id2) {
  S2GS_INVARIANT(image_id1 != image_id2 && image_id1 < kMaxNumImages && image_id2 < kMaxNumImages);
  return kMaxNumImages * std::min(image_id1, image_id2) + std::max(image_id1, image_id2);
}

TwoViewGeometry TwoViewGeometry::Swapped() const {
  TwoViewGeometry swapped = *this;
  SwapMatches(&swapped.inlier_matches);
  if (F) swapped.F = F->transpose();
  if (E) swapped.E = E->transpose();
  if (H) {
    swapped.H = H->inverse();
    if (!swapped.H->allFinite()) swapped.H.reset();
  }
  if (cam2_from_cam1) swapped.cam2_from_cam1 = cam2_from_cam1->Inverse();
  return swapped;
}

ColmapDatabase::ColmapDatabase(std::unique_ptr<SqliteConnection> connection)
    : connection_(std::move(connection)) {
  CheckSchema();
}
ColmapDatabase::ColmapDatabase(ColmapDatabase&& other) noexcept = default;
ColmapDatabase& ColmapDatabase::operator=(ColmapDatabase&& other) noexcept = default;
ColmapDatabase::~ColmapDatabase() = default;

ColmapDatabase ColmapDatabase::Open(const fs::path& path, Access access, int busy_timeout_ms) {
  const SqliteAccess sqlite_access =
      access == Access::kReadOnly ? SqliteAccess::kReadOnly : SqliteAccess::kReadWrite;
  auto connection = std::make_unique<SqliteConnection>(path, sqlite_access, busy_timeout_ms);
  if (access == Access::kReadWrite) connection->Execute("PRAGMA foreign_keys=ON");
  return ColmapDatabase(std::move(connection));
}

ColmapDatabase ColmapDatabase::Create(const fs::path& path) {
  auto connection = std::make_unique<SqliteConnection>(path, SqliteAccess::kCreate, kDefaultBusyTimeoutMs);
  connection->Execute("PRAGMA foreign_keys=ON");
  connection->Execute(std::string("BEGIN;") + kSchema38 + "COMMIT;");
  return ColmapDatabase(std::move(connection));
}

void ColmapDatabase::WriteAtomically(const fs::path& path, const std::function<void(ColmapDatabase&)>& fill) {
  WriteFileAtomicallyByPath(path, [&](const fs::path& temporary) {
    ColmapDatabase database = Create(temporary);
    fill(database);
    database.Close();
    RemoveSqliteSideFiles(path);
  });
}

void ColmapDatabase::SafeCopy(const fs::path& from, const fs::path& to, Reporter& reporter,
                              const std::function<void(ColmapDatabase&)>& edit) {
  std::error_code ec;
  if (fs::equivalent(from, to, ec)) {
    throw UserError(to, "is the database to copy from", "Give another name for the copy");
  }
  const SqliteConnection source(from, SqliteAccess::kReadOnly, kDefaultBusyTimeoutMs);
  WriteFileAtomicallyByPath(to, [&](const fs::path& temporary) {
    {
      SqliteConnection copy(temporary, SqliteAccess::kCreate, kDefaultBusyTimeoutMs);
      CopySqliteContent(source, copy, [&](int64_t done, int64_t total) {
        if (reporter.StopRequested()) throw Interrupted();
        reporter.Progress("copy database", done, total);
      });
      copy.Close();
    }
    if (edit) {
      ColmapDatabase database = Open(temporary, Access::kReadWrite);
      edit(database);
      database.Close();
    }
    RemoveSqliteSideFiles(to);
  });
}

void ColmapDatabase::Close() { connection_->Close(); }

const fs::path& ColmapDatabase::path() const { return connection_->path(); }

void ColmapDatabase::CheckSchema() {
  connection_->LimitSteps(kMaxSchemaSteps);
  {
    SqliteStatement statement(*connection_, "PRAGMA user_version", "schema version");
    if (statement.Step()) schema_version_ = statement.Integer(0);
  }
  const auto fail = [&](const std::string& problem) {
    throw UserError(path(), problem + " (schema version " + std::to_string(schema_version_) + ")",
                    "Databases of COLMAP 3.8 to 4.2 can be read. Open it once with such a version, which "
                    "updates older ones, or run feature extraction again");
  };
  for (const RequiredTable& table : RequiredTables()) {
    const TableColumns columns = ReadTableColumns(*connection_, table.name);
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
    if (table.name == std::string_view("images")) has_image_priors_ = has("prior_qw") && has("prior_tz");
    if (table.name == std::string_view("descriptors")) has_descriptor_type_ = has("type");
    if (table.name == std::string_view("two_view_geometries")) {
      has_relative_pose_ = has("qvec") && has("tvec");
    }
  }
  has_frames_ = !ReadTableColumns(*connection_, "frame_data").names.empty();
  connection_->LimitSteps(std::nullopt);
}

void ColmapDatabase::InTransaction(const std::function<void()>& change) {
  connection_->Execute("BEGIN IMMEDIATE");
  try {
    change();
    connection_->Execute("COMMIT");
  } catch (...) {
    // Some errors, like a full disk, have rolled back already.
    if (sqlite3_get_autocommit(connection_->handle()) == 0) {
      sqlite3_exec(connection_->handle(), "ROLLBACK", nullptr, nullptr, nullptr);
    }
    throw;
  }
}

std::vector<DatabaseCamera> ColmapDatabase::ReadCameras() const {
  std::vector<DatabaseCamera> cameras;
  SqliteStatement statement(*connection_,
                            "SELECT camera_id, model, width, height, params, prior_focal_length "
                            "FROM cameras NOT INDEXED",
                            "table cameras");
  while (statement.Step()) {
    DatabaseCamera row;
    Camera& camera = row.camera;
    camera.camera_id = static_cast<uint32_t>(statement.Integer(0, 0, kMaxCameraId));
    if (!cameras.empty() && camera.camera_id <= cameras.back().camera.camera_id) {
      statement.FailContent("its rows are out of order");
    }
    const std::string id = std::to_string(camera.camera_id);
    const int64_t model = statement.Integer(1, 0, std::numeric_limits<int>::max());
    const CameraModelInfo* info = FindCameraModel(static_cast<int>(model));
    if (info == nullptr) {
      statement.FailContent("camera " + id + " has the model " + std::to_string(model) +
                            ", which COLMAP does not have");
    }
    camera.model = info->id;
    camera.width = static_cast<uint64_t>(statement.Integer(2, 1, kMaxImageSide));
    camera.height = static_cast<uint64_t>(statement.Integer(3, 1, kMaxImageSide));
    const std::string_view bytes = statement.Blob(4);
    if (bytes.size() != info->NumParams() * sizeof(double)) {
      statement.FailContent("camera " + id + " has " + std::to_string(bytes.size()) +
                            " bytes of parameters, where " + std::string(info->name) + " has " +
                            std::to_string(info->NumParams()) + " numbers");
    }
    camera.params.resize(info->NumParams());
    std::memcpy(camera.params.data(), bytes.data(), bytes.size());
    if (!std::all_of(camera.params.begin(), camera.params.end(), [](double p) { return std::isfinite(p); })) {
      statement.FailContent("camera " + id + " has parameters that are not finite");
    }
    row.has_prior_focal_length = statement.Integer(5) != 0;
    cameras.push_back(std::move(row));
  }
  return cameras;
}

std::vector<DatabaseImage> ColmapDatabase::ReadImages() const {
  std::set<uint32_t> camera_ids;
  for (const DatabaseCamera& row : ReadCameras()) camera_ids.insert(row.camera.camera_id);
  std::vector<DatabaseImage> images;
  std::set<std::string> names;
  SqliteStatement statement(
      *connection_,
      std::string("SELECT image_id, name, camera_id") +
          (has_image_priors_ ? ", prior_qw, prior_qx, prior_qy, prior_qz, prior_tx, prior_ty, prior_tz"
                             : "") +
          " FROM images NOT INDEXED",
      "table images");
  while (statement.Step()) {
    DatabaseImage image;
    image.image_id = static_cast<uint32_t>(statement.Integer(0, 0, kMaxImageId));
    const std::string id = std::to_string(image.image_id);
    if (!images.empty() && image.image_id <= images.back().image_id) {
      statement.FailContent("its rows are out of order");
    }
    image.name = statement.Text(1);
    if (image.name.empty() || image.name.find('\0') != std::string::npos) {
      statement.FailContent("image " + id + " has no usable name");
    }
    if (!names.insert(image.name).second) {
      statement.FailContent("two images have the name \"" + image.name + "\"");
    }
    image.camera_id = static_cast<uint32_t>(statement.Integer(2, 0, kMaxCameraId));
    if (camera_ids.count(image.camera_id) == 0) {
      statement.FailContent("image " + id + " has camera " + std::to_string(image.camera_id) +
                            ", which does not exist");
    }
    if (has_image_priors_) {
      image.prior_qvec = PriorFromColumns<4>(statement, 3);
      image.prior_tvec = PriorFromColumns<3>(statement, 7);
    }
    images.push_back(std::move(image));
  }
  return images;
}

uint32_t ColmapDatabase::WriteCamera(const DatabaseCamera& row) {
  const Camera& camera = row.camera;
  S2GS_INVARIANT(camera.camera_id <= kMaxCameraId && camera.width > 0 && camera.height > 0);
  S2GS_INVARIANT(camera.params.size() == InfoOf(camera.model).NumParams());
  SqliteStatement statement(*connection_,
                            "INSERT INTO cameras(camera_id, model, width, height, params, "
                            "prior_focal_length) VALUES(?, ?, ?, ?, ?, ?)",
                            "table cameras");
  if (camera.camera_id != 0) statement.BindInteger(0, camera.camera_id);
  statement.BindInteger(1, static_cast<int>(camera.model));
  statement.BindInteger(2, static_cast<int64_t>(camera.width));
  statement.BindInteger(3, static_cast<int64_t>(camera.height));
  statement.BindBlob(4, camera.params.data(), camera.params.size() * sizeof(double));
  statement.BindInteger(5, row.has_prior_focal_length ? 1 : 0);
  statement.Run();
  const int64_t camera_id = sqlite3_last_insert_rowid(connection_->handle());
  if (has_frames_) {
    SqliteStatement rig(*connection_, "INSERT INTO rigs(ref_sensor_id, ref_sensor_type) VALUES(?, ?)",
                        "table rigs");
    rig.BindInteger(0, camera_id);
    rig.BindInteger(1, kCameraSensorType);
    rig.Run();
  }
  return static_cast<uint32_t>(camera_id);
}

uint32_t ColmapDatabase::WriteImage(const DatabaseImage& image) {
  S2GS_INVARIANT(image.image_id <= kMaxImageId && image.camera_id <= kMaxCameraId && !image.name.empty());
  SqliteStatement statement(
      *connection_,
      has_image_priors_ ? "INSERT INTO images(image_id, name, camera_id, prior_qw, prior_qx, prior_qy, "
                          "prior_qz, prior_tx, prior_ty, prior_tz) VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
                        : "INSERT INTO images(image_id, name, camera_id) VALUES(?, ?, ?)",
      "table images");
  if (image.image_id != 0) statement.BindInteger(0, image.image_id);
  statement.BindText(1, image.name);
  statement.BindInteger(2, image.camera_id);
  if (has_image_priors_) {
    for (int i = 0; i < 4 && image.prior_qvec; ++i) statement.BindReal(3 + i, (*image.prior_qvec)[i]);
    for (int i = 0; i < 3 && image.prior_tvec; ++i) statement.BindReal(7 + i, (*image.prior_tvec)[i]);
  }
  statement.Run();
  const int64_t image_id = sqlite3_last_insert_rowid(connection_->handle());
  if (has_frames_) {
    SqliteStatement frame(*connection_,
                          "INSERT INTO frames(rig_id) SELECT rig_id FROM rigs "
                          "WHERE ref_sensor_id = ? AND ref_sensor_type = ? LIMIT 1",
                          "table frames");
    frame.BindInteger(0, image.camera_id);
    frame.BindInteger(1, kCameraSensorType);
    frame.Run();
    // A camera from before the migration has no rig yet; COLMAP then makes rig and frame by itself.
    if (sqlite3_changes(connection_->handle()) == 0) return static_cast<uint32_t>(image_id);
    SqliteStatement data(*connection_,
                         "INSERT INTO frame_data(frame_id, data_id, sensor_id, sensor_type) "
                         "VALUES(last_insert_rowid(), ?, ?, ?)",
                         "table frame_data");
    data.BindInteger(0, image_id);
    data.BindInteger(1, image.camera_id);
    data.BindInteger(2, kCameraSensorType);
    data.Run();
  }
  return static_cast<uint32_t>(image_id);
}

KeypointMatrix ColmapDatabase::ReadKeypoints(uint32_t image_id) const {
  SqliteStatement statement(*connection_, "SELECT rows, cols, data FROM keypoints WHERE image_id = ?",
                            "keypoints of image " + std::to_string(image_id));
  statement.BindInteger(0, image_id);
  if (!statement.Step()) return KeypointMatrix(0, 2);
  int64_t cols = 0;
  const int64_t rows = CheckedRows<float>(statement, 0, &cols);
  if (rows == 0) return KeypointMatrix(0, 2);
  if (cols != 2 && cols != 4 && cols != 6) {
    statement.FailContent(std::to_string(cols) + " columns, where 2, 4 or 6 are possible");
  }
  KeypointMatrix keypoints(rows, cols);
  const std::string_view bytes = statement.Blob(2);
  std::memcpy(keypoints.data(), bytes.data(), bytes.size());
  if (!keypoints.leftCols<2>().allFinite()) statement.FailContent("a coordinate is not finite");
  return keypoints;
}

DescriptorMatrix ColmapDatabase::ReadDescriptors(uint32_t image_id) const {
  SqliteStatement statement(*connection_,
                            has_descriptor_type_
                                ? "SELECT rows, cols, data, type FROM descriptors WHERE image_id = ?"
                                : "SELECT rows, cols, data FROM descriptors WHERE image_id = ?",
                            "descriptors of image " + std::to_string(image_id));
  statement.BindInteger(0, image_id);
  if (!statement.Step()) return DescriptorMatrix(0, 128);
  int64_t cols = 0;
  const int64_t rows = CheckedRows<uint8_t>(statement, 0, &cols);
  const int64_t type = has_descriptor_type_ ? statement.Integer(3) : kSiftType;
  DescriptorMatrix descriptors(rows, 128);
  if (rows == 0) return descriptors;
  if (type != kSiftType || cols != 128) {
    throw UserError(path(),
                    "the descriptors of image " + std::to_string(image_id) + " are not SIFT's (type " +
                        std::to_string(type) + ", " + std::to_string(cols) + " columns)",
                    "Extract SIFT features, or let COLMAP match these");
  }
  const std::string_view bytes = statement.Blob(2);
  std::memcpy(descriptors.data(), bytes.data(), bytes.size());
  return descriptors;
}

uint64_t ColmapDatabase::NumKeypoints(uint32_t image_id) const {
  SqliteStatement statement(*connection_, "SELECT rows FROM keypoints WHERE image_id = ?",
                            "keypoints of image " + std::to_string(image_id));
  statement.BindInteger(0, image_id);
  if (!statement.Step()) return 0;
  return static_cast<uint64_t>(statement.Integer(0, 0, std::numeric_limits<int32_t>::max()));
}

void ColmapDatabase::WriteKeypoints(uint32_t image_id, const KeypointMatrix& keypoints) {
  S2GS_INVARIANT(keypoints.cols() == 2 || keypoints.cols() == 4 || keypoints.cols() == 6);
  SqliteStatement statement(*connection_,
                            "INSERT OR REPLACE INTO keypoints(image_id, rows, cols, data) VALUES(?, ?, ?, ?)",
                            "keypoints of image " + std::to_string(image_id));
  statement.BindInteger(0, image_id);
  BindMatrixRows(statement, 1, keypoints);
  statement.Run();
}

void ColmapDatabase::WriteDescriptors(uint32_t image_id, const DescriptorMatrix& descriptors) {
  SqliteStatement statement(
      *connection_,
      has_descriptor_type_
          ? "INSERT OR REPLACE INTO descriptors(image_id, rows, cols, data, type) VALUES(?, ?, ?, ?, ?)"
          : "INSERT OR REPLACE INTO descriptors(image_id, rows, cols, data) VALUES(?, ?, ?, ?)",
      "descriptors of image " + std::to_string(image_id));
  statement.BindInteger(0, image_id);
  BindMatrixRows(statement, 1, descriptors);
  if (has_descriptor_type_) statement.BindInteger(4, kSiftType);
  statement.Run();
}

void ColmapDatabase::CheckMatches(const FeatureMatches& matches, uint32_t image_id1,
                                  uint32_t image_id2) const {
  if (matches.empty()) return;
  uint32_t max1 = 0;
  uint32_t max2 = 0;
  for (const FeatureMatch& match : matches) {
    max1 = std::max(max1, match.point2D_idx1);
    max2 = std::max(max2, match.point2D_idx2);
  }
  for (const auto& [image_id, max] : {std::pair(image_id1, max1), std::pair(image_id2, max2)}) {
    const uint64_t count = NumKeypoints(image_id);
    if (max >= count) {
      throw UserError(path(),
                      "is damaged: the matches of " + PairName(image_id1, image_id2) + " refer to keypoint " +
                          std::to_string(max) + ", but image " + std::to_string(image_id) + " has only " +
                          std::to_string(count),
                      "Run feature extraction and matching again, into a new database");
    }
  }
}

bool ColmapDatabase::HasMatches(uint32_t image_id1, uint32_t image_id2) const {
  SqliteStatement statement(*connection_, "SELECT 1 FROM matches WHERE pair_id = ?", "table matches");
  statement.BindInteger(0, CheckedPairId(image_id1, image_id2));
  return statement.Step();
}

FeatureMatches ColmapDatabase::ReadMatches(uint32_t image_id1, uint32_t image_id2) const {
  SqliteStatement statement(*connection_, "SELECT rows, cols, data FROM matches WHERE pair_id = ?",
                            "matches of " + PairName(image_id1, image_id2));
  statement.BindInteger(0, CheckedPairId(image_id1, image_id2));
  if (!statement.Step()) return {};
  FeatureMatches matches = MatchesFromColumns(statement, 0);
  if (image_id1 > image_id2) SwapMatches(&matches);
  CheckMatches(matches, image_id1, image_id2);
  return matches;
}

void ColmapDatabase::WriteMatches(uint32_t image_id1, uint32_t image_id2, const FeatureMatches& matches) {
  SqliteStatement statement(*connection_,
                            "INSERT OR REPLACE INTO matches(pair_id, rows, cols, data) VALUES(?, ?, ?, ?)",
                            "matches of " + PairName(image_id1, image_id2));
  FeatureMatches stored = matches;
  if (image_id1 > image_id2) SwapMatches(&stored);
  statement.BindInteger(0, CheckedPairId(image_id1, image_id2));
  BindMatches(statement, 1, stored);
  statement.Run();
}

void ColmapDatabase::ForEachMatches(
    const std::function<void(uint32_t, uint32_t, const FeatureMatches&)>& visit) const {
  SqliteStatement statement(*connection_, "SELECT pair_id, rows, cols, data FROM matches NOT INDEXED",
                            "table matches");
  PairScan scan;
  while (statement.Step()) {
    scan.Visit(statement, 0);
    const FeatureMatches matches = MatchesFromColumns(statement, 1);
    CheckMatches(matches, scan.image_id1, scan.image_id2);
    visit(scan.image_id1, scan.image_id2, matches);
  }
}

std::optional<TwoViewGeometry> ColmapDatabase::ReadTwoViewGeometry(uint32_t image_id1,
                                                                   uint32_t image_id2) const {
  SqliteStatement statement(*connection_,
                            std::string("SELECT rows, cols, data, config, F, E, H") +
                                (has_relative_pose_ ? ", qvec, tvec" : "") +
                                " FROM two_view_geometries WHERE pair_id = ?",
                            "two-view geometry of " + PairName(image_id1, image_id2));
  statement.BindInteger(0, CheckedPairId(image_id1, image_id2));
  if (!statement.Step()) return std::nullopt;
  TwoViewGeometry geometry = GeometryFromColumns(statement, 0, has_relative_pose_);
  if (image_id1 > image_id2) geometry = geometry.Swapped();
  CheckMatches(geometry.inlier_matches, image_id1, image_id2);
  return geometry;
}

void ColmapDatabase::WriteTwoViewGeometry(uint32_t image_id1, uint32_t image_id2,
                                          const TwoViewGeometry& geometry) {
  using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  const TwoViewGeometry stored = image_id1 > image_id2 ? geometry.Swapped() : geometry;
  SqliteStatement statement(
      *connection_,
      has_relative_pose_ ? "INSERT OR REPLACE INTO two_view_geometries(pair_id, rows, cols, data, config, "
                           "F, E, H, qvec, tvec) VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
                         : "INSERT OR REPLACE INTO two_view_geometries(pair_id, rows, cols, data, config, "
                           "F, E, H) VALUES(?, ?, ?, ?, ?, ?, ?, ?)",
      "two-view geometry of " + PairName(image_id1, image_id2));
  statement.BindInteger(0, CheckedPairId(image_id1, image_id2));
  BindMatches(statement, 1, stored.inlier_matches);
  statement.BindInteger(4, static_cast<int>(stored.config));
  const std::array<const std::optional<Eigen::Matrix3d>*, 3> matrices = {&stored.F, &stored.E, &stored.H};
  std::array<RowMajor3, 3> row_major;
  for (int i = 0; i < 3; ++i) {
    if (*matrices[i]) row_major[i] = **matrices[i];
    BindDoubles(statement, 5 + i, *matrices[i] ? row_major[i].data() : nullptr, 9);
  }
  Eigen::Vector4d wxyz = Eigen::Vector4d::Zero();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  const bool has_pose = stored.cam2_from_cam1.has_value();
  if (has_pose) {
    const Eigen::Quaterniond& q = stored.cam2_from_cam1->rotation;
    wxyz << q.w(), q.x(), q.y(), q.z();
    translation = stored.cam2_from_cam1->translation;
  }
  if (has_relative_pose_) {
    BindDoubles(statement, 8, has_pose ? wxyz.data() : nullptr, 4);
    BindDoubles(statement, 9, has_pose ? translation.data() : nullptr, 3);
  }
  statement.Run();
}

void ColmapDatabase::ForEachTwoViewGeometry(
    const std::function<void(uint32_t, uint32_t, const TwoViewGeometry&)>& visit) const {
  SqliteStatement statement(*connection_,
                            std::string("SELECT pair_id, rows, cols, data, config, F, E, H") +
                                (has_relative_pose_ ? ", qvec, tvec" : "") +
                                " FROM two_view_geometries NOT INDEXED",
                            "table two_view_geometries");
  PairScan scan;
  while (statement.Step()) {
    scan.Visit(statement, 0);
    const TwoViewGeometry geometry = GeometryFromColumns(statement, 1, has_relative_pose_);
    CheckMatches(geometry.inlier_matches, scan.image_id1, scan.image_id2);
    visit(scan.image_id1, scan.image_id2, geometry);
  }
}

void ColmapDatabase::NumberImagesByName() {
  if (has_frames_) return;
  InTransaction([&] {
    connection_->Execute(
        "PRAGMA defer_foreign_keys=ON;"
        "CREATE TEMP TABLE numbering(old INTEGER PRIMARY KEY, new INTEGER);"
        "INSERT INTO numbering SELECT image_id, ROW_NUMBER() OVER (ORDER BY name) FROM images;");
    // By way of numbers that no image has.
    for (const char* table : {"images", "keypoints", "descriptors"}) {
      const std::string update = std::string("UPDATE ") + table + " SET image_id = ";
      connection_->Execute(update + "image_id + 1000000000");
      connection_->Execute(update + "(SELECT new FROM numbering WHERE old = " + table +
                           ".image_id - 1000000000)");
    }
    connection_->Execute("DROP TABLE numbering;");
  });
}

void ColmapDatabase::ShareCameras(const std::vector<std::vector<std::string>>& groups) {
  if (has_frames_) return;
  std::map<std::string, DatabaseImage> image_of_name;
  for (const DatabaseImage& image : ReadImages()) image_of_name[image.name] = image;
  std::set<uint32_t> known;
  for (const DatabaseCamera& row : ReadCameras()) {
    if (row.has_prior_focal_length) known.insert(row.camera.camera_id);
  }
  InTransaction([&] {
    for (const std::vector<std::string>& group : groups) {
      std::vector<const DatabaseImage*> images;
      images.reserve(group.size());
      for (const std::string& name : group) {
        const auto found = image_of_name.find(name);
        if (found != image_of_name.end()) images.push_back(&found->second);
      }
      if (images.empty()) continue;
      const auto with_focal = std::find_if(images.begin(), images.end(), [&](const DatabaseImage* image) {
        return known.count(image->camera_id) > 0;
      });
      const DatabaseImage& source = with_focal == images.end() ? *images.front() : **with_focal;
      for (const DatabaseImage* image : images) {
        connection_->Execute("UPDATE images SET camera_id = " + std::to_string(source.camera_id) +
                             " WHERE image_id = " + std::to_string(image->image_id) + ";");
      }
    }
    connection_->Execute("DELETE FROM cameras WHERE camera_id NOT IN (SELECT camera_id FROM images);");
  });
}

void ColmapDatabase::ReplaceTwoViewGeometries(const std::vector<TwoViewGeometryOfPair>& geometries) {
  InTransaction([&] {
    connection_->Execute("DELETE FROM two_view_geometries");
    for (const TwoViewGeometryOfPair& row : geometries) {
      WriteTwoViewGeometry(row.image_id1, row.image_id2, row.geometry);
    }
  });
}

}  // namespace s2gs
