#include "sfm_split/scene/io/colmap_columns.h"

#include <cstring>
#include <optional>
#include <string_view>

namespace s2gs {
namespace {

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

}  // namespace

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

void BindMatches(SqliteStatement& statement, int first_index, const FeatureMatches& matches) {
  statement.BindInteger(first_index, static_cast<int64_t>(matches.size()));
  statement.BindInteger(first_index + 1, 2);
  statement.BindBlob(first_index + 2, matches.data(), matches.size() * sizeof(FeatureMatch));
}

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

void BindDoubles(SqliteStatement& statement, int index, const double* values, uint64_t count) {
  if (values == nullptr) {
    statement.BindNull(index);
  } else {
    statement.BindBlob(index, values, count * sizeof(double));
  }
}

void PairScan::Visit(const SqliteStatement& statement, int column) {
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

}  // namespace s2gs
