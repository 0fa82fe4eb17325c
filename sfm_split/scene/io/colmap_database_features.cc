#include <cstring>
#include <limits>
#include <string>
#include <string_view>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_columns.h"
#include "sfm_split/scene/io/colmap_database.h"

// Keypoints and descriptors of a COLMAP database.

namespace s2gs {
namespace {

constexpr int64_t kSiftType = 0;  // COLMAP's FeatureExtractorType::SIFT

}  // namespace

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
                            schema_.has_descriptor_type
                                ? "SELECT rows, cols, data, type FROM descriptors WHERE image_id = ?"
                                : "SELECT rows, cols, data FROM descriptors WHERE image_id = ?",
                            "descriptors of image " + std::to_string(image_id));
  statement.BindInteger(0, image_id);
  if (!statement.Step()) return DescriptorMatrix(0, 128);
  int64_t cols = 0;
  const int64_t rows = CheckedRows<uint8_t>(statement, 0, &cols);
  const int64_t type = schema_.has_descriptor_type ? statement.Integer(3) : kSiftType;
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
      schema_.has_descriptor_type
          ? "INSERT OR REPLACE INTO descriptors(image_id, rows, cols, data, type) VALUES(?, ?, ?, ?, ?)"
          : "INSERT OR REPLACE INTO descriptors(image_id, rows, cols, data) VALUES(?, ?, ?, ?)",
      "descriptors of image " + std::to_string(image_id));
  statement.BindInteger(0, image_id);
  BindMatrixRows(statement, 1, descriptors);
  if (schema_.has_descriptor_type) statement.BindInteger(4, kSiftType);
  statement.Run();
}

}  // namespace s2gs
