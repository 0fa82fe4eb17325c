#include "sfm_split/scene/io/colmap_database.h"

#include <sqlite3.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <set>
#include <string_view>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/image_name.h"
#include "sfm_split/scene/camera_check.h"
#include "sfm_split/scene/io/colmap_columns.h"
#include "sfm_split/scene/io/sqlite_connection.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr int64_t kCameraSensorType = 0;  // COLMAP's SensorType::CAMERA

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

ColmapDatabase::ColmapDatabase(std::unique_ptr<SqliteConnection> connection)
    : connection_(std::move(connection)), schema_(ReadColmapSchema(connection_.get())) {}
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
  WriteColmapSchema38(connection.get());
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
    camera.width = static_cast<uint64_t>(statement.Integer(2, 1, kMaxCameraSide));
    camera.height = static_cast<uint64_t>(statement.Integer(3, 1, kMaxCameraSide));
    const std::string_view bytes = statement.Blob(4);
    if (bytes.size() != info->NumParams() * sizeof(double)) {
      statement.FailContent("camera " + id + " has " + std::to_string(bytes.size()) +
                            " bytes of parameters, where " + std::string(info->name) + " has " +
                            std::to_string(info->NumParams()) + " numbers");
    }
    camera.params.resize(info->NumParams());
    std::memcpy(camera.params.data(), bytes.data(), bytes.size());
    if (const std::optional<std::string> fault = FindCameraFault(camera)) {
      statement.FailContent("camera " + id + " " + *fault);
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
          (schema_.has_image_priors ? ", prior_qw, prior_qx, prior_qy, prior_qz, prior_tx, prior_ty, prior_tz"
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
    if (const std::optional<std::string> fault = ImageName::FindFault(image.name)) {
      statement.FailContent("the name of image " + id + ", " + DescribeNameFault(image.name, *fault));
    }
    if (!names.insert(image.name).second) {
      statement.FailContent("two images have the name \"" + image.name + "\"");
    }
    image.camera_id = static_cast<uint32_t>(statement.Integer(2, 0, kMaxCameraId));
    if (camera_ids.count(image.camera_id) == 0) {
      statement.FailContent("image " + id + " has camera " + std::to_string(image.camera_id) +
                            ", which does not exist");
    }
    if (schema_.has_image_priors) {
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
  if (schema_.has_frames) {
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
      schema_.has_image_priors
          ? "INSERT INTO images(image_id, name, camera_id, prior_qw, prior_qx, prior_qy, "
            "prior_qz, prior_tx, prior_ty, prior_tz) VALUES(?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"
          : "INSERT INTO images(image_id, name, camera_id) VALUES(?, ?, ?)",
      "table images");
  if (image.image_id != 0) statement.BindInteger(0, image.image_id);
  statement.BindText(1, image.name);
  statement.BindInteger(2, image.camera_id);
  if (schema_.has_image_priors) {
    for (int i = 0; i < 4 && image.prior_qvec; ++i) statement.BindReal(3 + i, (*image.prior_qvec)[i]);
    for (int i = 0; i < 3 && image.prior_tvec; ++i) statement.BindReal(7 + i, (*image.prior_tvec)[i]);
  }
  statement.Run();
  const int64_t image_id = sqlite3_last_insert_rowid(connection_->handle());
  if (schema_.has_frames) {
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

void ColmapDatabase::NumberImagesByName() {
  if (schema_.has_frames) return;
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
  if (schema_.has_frames) return;
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

void ColmapDatabase::SetFocalPriors(const std::map<std::string, double>& focal_px) {
  std::map<std::string, uint32_t> camera_of_name;
  for (const DatabaseImage& image : ReadImages()) camera_of_name[image.name] = image.camera_id;
  std::map<uint32_t, double> focal_of_camera;
  for (const auto& [name, focal] : focal_px) {
    const auto found = camera_of_name.find(name);
    if (found != camera_of_name.end()) focal_of_camera.emplace(found->second, focal);
  }
  const std::vector<DatabaseCamera> cameras = ReadCameras();
  InTransaction([&] {
    for (const DatabaseCamera& row : cameras) {
      const auto focal = focal_of_camera.find(row.camera.camera_id);
      const size_t num_focal = InfoOf(row.camera.model).num_focal_params;
      if (focal == focal_of_camera.end() || num_focal == 0) continue;
      std::vector<double> params = row.camera.params;
      std::fill_n(params.begin(), num_focal, focal->second);
      SqliteStatement statement(*connection_,
                                "UPDATE cameras SET params = ?, prior_focal_length = 1 WHERE camera_id = ?",
                                "table cameras");
      statement.BindBlob(0, params.data(), params.size() * sizeof(double));
      statement.BindInteger(1, row.camera.camera_id);
      statement.Run();
    }
  });
}

}  // namespace s2gs
