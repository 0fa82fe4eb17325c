#include <algorithm>
#include <array>
#include <string>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_columns.h"
#include "sfm_split/scene/io/colmap_database.h"

// What a COLMAP database knows of pairs of images: matches and two-view geometries.

namespace s2gs {
namespace {

std::string PairName(uint32_t image_id1, uint32_t image_id2) {
  return "images " + std::to_string(image_id1) + " and " + std::to_string(image_id2);
}

void SwapMatches(FeatureMatches* matches) {
  for (FeatureMatch& match : *matches) std::swap(match.point2D_idx1, match.point2D_idx2);
}

int64_t CheckedPairId(uint32_t image_id1, uint32_t image_id2) {
  return static_cast<int64_t>(PairIdFromImageIds(image_id1, image_id2));
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
                                (schema_.has_relative_pose ? ", qvec, tvec" : "") +
                                " FROM two_view_geometries WHERE pair_id = ?",
                            "two-view geometry of " + PairName(image_id1, image_id2));
  statement.BindInteger(0, CheckedPairId(image_id1, image_id2));
  if (!statement.Step()) return std::nullopt;
  TwoViewGeometry geometry = GeometryFromColumns(statement, 0, schema_.has_relative_pose);
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
      schema_.has_relative_pose
          ? "INSERT OR REPLACE INTO two_view_geometries(pair_id, rows, cols, data, config, "
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
  if (schema_.has_relative_pose) {
    BindDoubles(statement, 8, has_pose ? wxyz.data() : nullptr, 4);
    BindDoubles(statement, 9, has_pose ? translation.data() : nullptr, 3);
  }
  statement.Run();
}

void ColmapDatabase::ForEachTwoViewGeometry(
    const std::function<void(uint32_t, uint32_t, const TwoViewGeometry&)>& visit) const {
  SqliteStatement statement(*connection_,
                            std::string("SELECT pair_id, rows, cols, data, config, F, E, H") +
                                (schema_.has_relative_pose ? ", qvec, tvec" : "") +
                                " FROM two_view_geometries NOT INDEXED",
                            "table two_view_geometries");
  PairScan scan;
  while (statement.Step()) {
    scan.Visit(statement, 0);
    const TwoViewGeometry geometry = GeometryFromColumns(statement, 1, schema_.has_relative_pose);
    CheckMatches(geometry.inlier_matches, scan.image_id1, scan.image_id2);
    visit(scan.image_id1, scan.image_id2, geometry);
  }
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
