#pragma once

#include <cstdint>
#include <limits>
#include <string>

#include "sfm_split/scene/io/colmap_database.h"
#include "sfm_split/scene/io/sqlite_connection.h"

namespace s2gs {

// Between columns of a COLMAP database and values. Readers throw UserError where a column holds something
// impossible.

inline constexpr uint64_t kMaxNumImages = 2147483647;      ///< COLMAP's; also the factor in the pair id.
inline constexpr int64_t kMaxImageId = kMaxNumImages - 1;  ///< pairs' ids stay unambiguous
/// The largest is COLMAP's "none".
inline constexpr int64_t kMaxCameraId = std::numeric_limits<uint32_t>::max() - 1;

/// The columns rows, cols and data hold a row-major matrix; the blob's size has to agree.
/// \return the number of rows; `cols` stays free when it is 0.
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

FeatureMatches MatchesFromColumns(const SqliteStatement& statement, int first_column);
void BindMatches(SqliteStatement& statement, int first_index, const FeatureMatches& matches);

/// Columns of matches, then config, F, E, H and, where the schema has them, qvec and tvec.
TwoViewGeometry GeometryFromColumns(const SqliteStatement& statement, int first_column, bool has_pose);

/// The matrix' rows, columns and data, row by row.
template <typename Matrix>
void BindMatrixRows(SqliteStatement& statement, int first_index, const Matrix& matrix) {
  statement.BindInteger(first_index, matrix.rows());
  statement.BindInteger(first_index + 1, matrix.cols());
  statement.BindBlob(first_index + 2, matrix.data(),
                     static_cast<uint64_t>(matrix.size()) * sizeof(typename Matrix::Scalar));
}

/// NULL for none.
void BindDoubles(SqliteStatement& statement, int index, const double* values, uint64_t count);

/// Image ids of the rows of a walk through a table by pair_id.
class PairScan {
 public:
  /// SQLite walks the table in the order of its key; a damaged tree that visits a page twice breaks the
  /// order.
  void Visit(const SqliteStatement& statement, int column);

  uint32_t image_id1 = 0;
  uint32_t image_id2 = 0;

 private:
  int64_t pair_id_ = -1;
  int64_t last_ = -1;
};

}  // namespace s2gs
