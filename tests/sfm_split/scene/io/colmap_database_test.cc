#include "sfm_split/scene/io/colmap_database.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"
#include "tests/sfm_split/scene/io/database_fixture.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::UnorderedElementsAre;
using Access = ColmapDatabase::Access;

std::vector<std::string> FileNames(const fs::path& folder) {
  std::vector<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder)) names.push_back(entry.path().filename().string());
  return names;
}

std::map<std::string, std::string> FileContents(const fs::path& folder) {
  std::map<std::string, std::string> contents;
  for (const std::string& name : FileNames(folder)) contents[name] = ReadAll(folder / name);
  return contents;
}

// A database in WAL mode as a program that was killed leaves it: everything lies in the -wal file.
fs::path MakeUnfinishedWal(const fs::path& folder, const fs::path& scratch) {
  RawDatabase raw(scratch);
  raw.Execute("PRAGMA journal_mode=WAL; PRAGMA wal_autocheckpoint=0;");
  raw.Execute(std::string("BEGIN;") + kColmapSchema38 + kSmallContent + "COMMIT;");
  fs::create_directories(folder);
  fs::copy_file(scratch, folder / "w.db");
  fs::copy_file(scratch.string() + "-wal", folder / "w.db-wal");
  return folder / "w.db";
}

void ExpectSmallContent(const ColmapDatabase& database) {
  const std::vector<DatabaseCamera> cameras = database.ReadCameras();
  ASSERT_EQ(cameras.size(), 2u);
  EXPECT_EQ(cameras[0].camera.camera_id, 7u);
  EXPECT_EQ(cameras[0].camera.model, CameraModelId::kSimpleRadial);
  EXPECT_EQ(cameras[0].camera.width, 640u);
  EXPECT_EQ(cameras[0].camera.height, 480u);
  EXPECT_THAT(cameras[0].camera.params, ElementsAre(500, 320, 240, 0.125));
  EXPECT_TRUE(cameras[0].has_prior_focal_length);
  EXPECT_EQ(cameras[1].camera.model, CameraModelId::kPinhole);
  EXPECT_FALSE(cameras[1].has_prior_focal_length);

  const std::vector<DatabaseImage> images = database.ReadImages();
  ASSERT_EQ(images.size(), 3u);
  EXPECT_EQ(images[1].image_id, 2u);
  EXPECT_EQ(images[1].name, "sub/b.jpg");
  EXPECT_EQ(images[2].camera_id, 9u);

  const KeypointMatrix keypoints = database.ReadKeypoints(1);
  ASSERT_EQ(keypoints.rows(), 3);
  ASSERT_EQ(keypoints.cols(), 6);
  EXPECT_EQ(keypoints(0, 0), 10.5f);
  EXPECT_EQ(keypoints(0, 1), 20.25f);
  EXPECT_EQ(keypoints(0, 4), -0.5f);
  EXPECT_EQ(keypoints(2, 5), 3.0f);
  EXPECT_EQ(database.ReadKeypoints(2).cols(), 4);
  EXPECT_EQ(database.ReadKeypoints(5)(0, 1), 8.0f);
  EXPECT_EQ(database.ReadKeypoints(3).rows(), 0);
  EXPECT_EQ(database.NumKeypoints(1), 3u);
  EXPECT_EQ(database.ReadDescriptors(1).rows(), 3);
  EXPECT_EQ(database.ReadDescriptors(2).rows(), 0);

  EXPECT_TRUE(database.HasMatches(2, 1));
  EXPECT_FALSE(database.HasMatches(1, 5));
  EXPECT_THAT(database.ReadMatches(1, 2), ElementsAre(FeatureMatch{0, 1}, FeatureMatch{2, 0}));
  EXPECT_THAT(database.ReadMatches(2, 1), ElementsAre(FeatureMatch{1, 0}, FeatureMatch{0, 2}));
  EXPECT_THAT(database.ReadMatches(1, 5), IsEmpty());
  std::vector<std::pair<uint32_t, uint32_t>> pairs;
  database.ForEachMatches([&](uint32_t id1, uint32_t id2, const FeatureMatches& matches) {
    pairs.emplace_back(id1, id2);
    EXPECT_EQ(matches, database.ReadMatches(id1, id2));
  });
  EXPECT_THAT(pairs, ElementsAre(std::pair(1u, 2u), std::pair(2u, 5u)));

  const auto geometry = database.ReadTwoViewGeometry(1, 2);
  ASSERT_TRUE(geometry.has_value());
  EXPECT_EQ(geometry->config, TwoViewConfig::kCalibrated);
  EXPECT_THAT(geometry->inlier_matches, ElementsAre(FeatureMatch{2, 0}));
  ASSERT_TRUE(geometry->F && geometry->E && geometry->cam2_from_cam1);
  Eigen::Matrix3d expected_F;
  expected_F << 1, 2, 3, 4, 5, 6, 7, 8, 10;
  EXPECT_EQ(*geometry->F, expected_F);
  EXPECT_EQ((*geometry->E)(0, 1), -3);
  EXPECT_FALSE(geometry->H.has_value());  // stored as zeros
  EXPECT_EQ(geometry->cam2_from_cam1->rotation.x(), 1);
  EXPECT_EQ(geometry->cam2_from_cam1->translation, Eigen::Vector3d(1, 2, 3));
  EXPECT_FALSE(database.ReadTwoViewGeometry(2, 5).has_value());
}

// A geometry with exact numbers: a turn by 90 degrees about z.
TwoViewGeometry MakeGeometry() {
  TwoViewGeometry geometry;
  geometry.config = TwoViewConfig::kUncalibrated;
  geometry.inlier_matches = {{0, 1}, {2, 3}};
  geometry.F.emplace();
  *geometry.F << 1, 2, 3, 4, 5, 6, 7, 8, 9;
  geometry.E = *geometry.F * 0.5;
  geometry.H.emplace();
  *geometry.H << 2, 0, 10, 0, 4, 20, 0, 0, 1;
  geometry.cam2_from_cam1 =
      Rigid3{Eigen::Quaterniond(std::sqrt(0.5), 0, 0, std::sqrt(0.5)), Eigen::Vector3d(1, 2, 3)};
  return geometry;
}

void ExpectEqualGeometries(const TwoViewGeometry& a, const TwoViewGeometry& b) {
  // Inverting H or the pose twice rounds twice: measured 2e-16.
  constexpr double kTolerance = 1e-14;
  EXPECT_EQ(a.config, b.config);
  EXPECT_EQ(a.inlier_matches, b.inlier_matches);
  ASSERT_TRUE(a.F && b.F && a.E && b.E && a.H && b.H && a.cam2_from_cam1 && b.cam2_from_cam1);
  EXPECT_EQ(*a.F, *b.F);
  EXPECT_EQ(*a.E, *b.E);
  EXPECT_TRUE(a.H->isApprox(*b.H, kTolerance));
  EXPECT_TRUE(a.cam2_from_cam1->Matrix().isApprox(b.cam2_from_cam1->Matrix(), kTolerance));
}

class ColmapDatabaseSchema : public ::testing::TestWithParam<const char*> {
 protected:
  TemporaryFolder folder_;
};

std::string VersionName(const ::testing::TestParamInfo<const char*>& version) {
  const std::vector<std::string> names = {"Colmap38", "Colmap312", "Colmap42"};
  return names.at(version.index);
}

INSTANTIATE_TEST_SUITE_P(Versions, ColmapDatabaseSchema,
                         ::testing::Values(kColmapSchema38, kColmapSchema312, kColmapSchema42), VersionName);

TEST_P(ColmapDatabaseSchema, IsRead) {
  const fs::path path = MakeDatabase(folder_ / "d.db", GetParam());
  ExpectSmallContent(ColmapDatabase::Open(path, Access::kReadOnly));
  ExpectSmallContent(ColmapDatabase::Open(path, Access::kReadWrite));
}

TEST_P(ColmapDatabaseSchema, OpeningChangesNothing) {
  const fs::path path = MakeDatabase(folder_ / "d.db", GetParam());
  const auto before = FileContents(folder_.path());
  ReadEverything(ColmapDatabase::Open(path, Access::kReadOnly));
  ReadEverything(ColmapDatabase::Open(path, Access::kReadWrite));
  EXPECT_EQ(FileContents(folder_.path()), before);
}

TEST_P(ColmapDatabaseSchema, IsWritten) {
  const fs::path path = folder_ / "d.db";
  { RawDatabase(path).Execute(GetParam()); }
  KeypointMatrix keypoints(2, 4);
  keypoints << 1, 2, 3, 4, 5, 6, 7, 8;
  DescriptorMatrix descriptors(2, 128);
  for (int i = 0; i < descriptors.size(); ++i) descriptors(i / 128, i % 128) = static_cast<uint8_t>(i);
  const FeatureMatches matches = {{4, 0}, {1, 1}};
  {
    ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadWrite);
    database.InTransaction([&] {
      EXPECT_EQ(database.WriteCamera({{3, CameraModelId::kOpenCV, 10, 20, {1, 2, 3, 4, 5, 6, 7, 8}}, true}),
                3u);
      EXPECT_EQ(database.WriteImage({11, "b.png", 3, std::nullopt, std::nullopt}), 11u);
      EXPECT_EQ(database.WriteImage({0, "a.png", 3, std::nullopt, std::nullopt}), 12u);
      database.WriteKeypoints(11, KeypointMatrix::Ones(5, 2));
      database.WriteKeypoints(11, KeypointMatrix::Zero(0, 2));
      database.WriteKeypoints(11, keypoints);
      database.WriteKeypoints(12, KeypointMatrix::Ones(5, 6));
      database.WriteDescriptors(11, descriptors);
      database.WriteMatches(12, 11, matches);
    });
    database.Close();
  }
  const ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadOnly);
  ASSERT_EQ(database.ReadCameras().size(), 1u);
  EXPECT_EQ(database.ReadCameras()[0].camera.params.back(), 8);
  ASSERT_EQ(database.ReadImages().size(), 2u);
  EXPECT_EQ(database.ReadImages()[1].name, "a.png");
  EXPECT_EQ(database.ReadKeypoints(11), keypoints);
  EXPECT_EQ(database.ReadDescriptors(11), descriptors);
  EXPECT_EQ(database.ReadMatches(12, 11), matches);
  EXPECT_THAT(FileNames(folder_.path()), ElementsAre("d.db"));

  RawDatabase raw(path);
  // (0, 4), (1, 1): the columns swapped, because 12 > 11.
  EXPECT_EQ(raw.Query("SELECT data FROM matches WHERE pair_id = 2147483647 * 11 + 12"),
            "00000000040000000100000001000000");
  if (GetParam() != kColmapSchema38) {
    EXPECT_EQ(raw.Query("SELECT group_concat(frame_data.data_id) FROM frame_data JOIN frames USING(frame_id) "
                        "JOIN rigs USING(rig_id) WHERE rigs.ref_sensor_id = 3 AND frame_data.sensor_id = 3"),
              "11,12");
  }
}

TEST_P(ColmapDatabaseSchema, GeometriesRoundTripInBothOrders) {
  const fs::path path = folder_ / "d.db";
  { RawDatabase(path).Execute(GetParam()); }
  ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadWrite);
  database.WriteCamera({{1, CameraModelId::kSimplePinhole, 10, 20, {1, 2, 3}}, true});
  for (const uint32_t id : {1u, 2u, 3u}) {
    database.WriteImage({id, std::to_string(id), 1, std::nullopt, std::nullopt});
    database.WriteKeypoints(id, KeypointMatrix::Ones(4, 2));
  }
  const TwoViewGeometry geometry = MakeGeometry();
  database.WriteTwoViewGeometry(1, 2, geometry);
  database.WriteTwoViewGeometry(3, 1, geometry);
  ExpectEqualGeometries(*database.ReadTwoViewGeometry(1, 2), geometry);
  ExpectEqualGeometries(*database.ReadTwoViewGeometry(3, 1), geometry);
  ExpectEqualGeometries(*database.ReadTwoViewGeometry(2, 1), geometry.Swapped());
  ExpectEqualGeometries(*database.ReadTwoViewGeometry(1, 3), geometry.Swapped());
  EXPECT_EQ(RawDatabase(path).Query("SELECT config FROM two_view_geometries WHERE pair_id = 2147483650"),
            "3");
}

TEST(TwoViewGeometry, SwappedObeysTheSameConstraints) {
  const TwoViewGeometry geometry = MakeGeometry();
  const TwoViewGeometry swapped = geometry.Swapped();
  const Eigen::Vector3d x1(3, -2, 1);
  const Eigen::Vector3d x2(5, 7, 1);
  EXPECT_EQ(x2.dot(*geometry.F * x1), x1.dot(*swapped.F * x2));
  EXPECT_EQ(x2.dot(*geometry.E * x1), x1.dot(*swapped.E * x2));
  EXPECT_TRUE((*swapped.H * (*geometry.H * x1)).isApprox(x1, 1e-15));
  EXPECT_TRUE((*swapped.cam2_from_cam1 * (*geometry.cam2_from_cam1 * x1)).isApprox(x1, 1e-15));
  EXPECT_THAT(swapped.inlier_matches, ElementsAre(FeatureMatch{1, 0}, FeatureMatch{3, 2}));
  TwoViewGeometry singular = geometry;
  singular.H->setZero();
  EXPECT_FALSE(singular.Swapped().H.has_value());
}

TEST(ColmapDatabase, PairIdsAreColmaps) {
  EXPECT_EQ(PairIdFromImageIds(1, 2), 2147483649u);
  EXPECT_EQ(PairIdFromImageIds(2, 1), 2147483649u);
  EXPECT_EQ(PairIdFromImageIds(2147483646, 2147483645), 2147483645ull * 2147483647ull + 2147483646ull);
}

TEST(ColmapDatabase, CreateWritesTheSchemaOf38) {
  TemporaryFolder folder;
  {
    ColmapDatabase database = ColmapDatabase::Create(folder / "d.db");
    EXPECT_EQ(database.schema_version(), 3800);
    database.WriteCamera({{0, CameraModelId::kSimplePinhole, 10, 20, {1, 2, 3}}, true});
    DatabaseImage image{0, "x.jpg", 1, Eigen::Vector4d(1, 2, 3, 4), Eigen::Vector3d(5, 6, 7)};
    EXPECT_EQ(database.WriteImage(image), 1u);
    const DatabaseImage read = database.ReadImages().at(0);
    EXPECT_EQ(*read.prior_qvec, *image.prior_qvec);
    EXPECT_EQ(*read.prior_tvec, *image.prior_tvec);
  }
  EXPECT_THAT(FileNames(folder.path()), ElementsAre("d.db"));
  ExpectUserError([&] { ColmapDatabase::Create(folder / "d.db"); }, {"d.db", "exists already"});
  RawDatabase raw(folder / "d.db");
  EXPECT_EQ(raw.Query("PRAGMA user_version"), "3800");
  RawDatabase reference(folder / "reference.db");
  reference.Execute(kColmapSchema38);
  for (const char* table :
       {"cameras", "images", "keypoints", "descriptors", "matches", "two_view_geometries"}) {
    const std::string columns = std::string(
                                    "SELECT group_concat(name || ' ' || type || [notnull] || pk) FROM "
                                    "pragma_table_info('") +
                                table + "')";
    EXPECT_EQ(raw.Query(columns), reference.Query(columns)) << table;
  }
}

TEST(ColmapDatabase, CamerasWithoutARigGetImagesWithoutAFrame) {
  TemporaryFolder folder;
  const fs::path path = MakeDatabase(folder / "d.db", kColmapSchema42);
  EXPECT_EQ(ColmapDatabase::Open(path, Access::kReadWrite).WriteImage({0, "new.jpg", 7, {}, {}}), 6u);
  EXPECT_EQ(RawDatabase(path).Query("SELECT count(*) FROM frame_data"), "0");
}

TEST(ColmapDatabase, DuplicatesAreRefused) {
  TemporaryFolder folder;
  ColmapDatabase database = ColmapDatabase::Open(MakeDatabase(folder / "d.db"), Access::kReadWrite);
  ExpectUserError(
      [&] {
        database.WriteImage({0, "a.jpg", 7, std::nullopt, std::nullopt});
      },
      {"d.db", "images.name"});
  ExpectUserError(
      [&] {
        database.WriteImage({0, "new.jpg", 77, std::nullopt, std::nullopt});
      },
      {"d.db", "FOREIGN KEY"});
}

TEST(ColmapDatabase, FailedTransactionLeavesNothing) {
  TemporaryFolder folder;
  ColmapDatabase database = ColmapDatabase::Open(MakeDatabase(folder / "d.db"), Access::kReadWrite);
  EXPECT_THROW(database.InTransaction([&] {
    database.WriteMatches(1, 2, {});
    database.WriteMatches(1, 5, {{0, 0}});
    throw Interrupted();
  }),
               Interrupted);
  ExpectSmallContent(database);
  database.InTransaction([&] { database.WriteMatches(1, 5, {{0, 0}}); });
  EXPECT_TRUE(database.HasMatches(1, 5));
}

TEST(ColmapDatabase, ReplaceTwoViewGeometriesLeavesTheRest) {
  TemporaryFolder folder;
  const fs::path path = MakeDatabase(folder / "d.db");
  {
    ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadWrite);
    TwoViewGeometry geometry;
    geometry.config = TwoViewConfig::kPlanar;
    geometry.inlier_matches = {{0, 1}};
    database.ReplaceTwoViewGeometries({{5, 2, geometry}});
  }
  const ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadOnly);
  int count = 0;
  database.ForEachTwoViewGeometry([&](uint32_t id1, uint32_t id2, const TwoViewGeometry& geometry) {
    ++count;
    EXPECT_EQ(id1, 2u);
    EXPECT_EQ(id2, 5u);
    EXPECT_THAT(geometry.inlier_matches, ElementsAre(FeatureMatch{1, 0}));
    EXPECT_FALSE(geometry.F || geometry.E || geometry.H || geometry.cam2_from_cam1);
  });
  EXPECT_EQ(count, 1);
  EXPECT_EQ(database.ReadMatches(1, 2).size(), 2u);
  EXPECT_THAT(FileNames(folder.path()), ElementsAre("d.db"));
}

TEST(ColmapDatabase, ImagesAreNumberedByName) {
  TemporaryFolder folder;
  // a.jpg 1, sub/b.jpg 2, c.jpg 5 become a.jpg 1, c.jpg 2, sub/b.jpg 3.
  const fs::path path =
      MakeDatabase(folder / "d.db", kColmapSchema38,
                   "DELETE FROM matches; DELETE FROM two_view_geometries;"
                   "DELETE FROM keypoints; DELETE FROM descriptors;"
                   "INSERT INTO keypoints VALUES (1, 11, 6, X''), (2, 12, 6, X''), (5, 15, 6, X'');"
                   "INSERT INTO descriptors(image_id, rows, cols, data) VALUES (5, 15, 128, X'');");
  ColmapDatabase::Open(path, Access::kReadWrite).NumberImagesByName();
  RawDatabase raw(path);
  const auto at = [&](const std::string& column, const std::string& table, int id) {
    return raw.Query("SELECT " + column + " FROM " + table + " WHERE image_id = " + std::to_string(id));
  };
  EXPECT_EQ(at("name", "images", 1), "a.jpg");
  EXPECT_EQ(at("name", "images", 2), "c.jpg");
  EXPECT_EQ(at("camera_id", "images", 2), "9");
  EXPECT_EQ(at("name", "images", 3), "sub/b.jpg");
  EXPECT_EQ(at("rows", "keypoints", 1), "11");
  EXPECT_EQ(at("rows", "keypoints", 2), "15");
  EXPECT_EQ(at("rows", "keypoints", 3), "12");
  EXPECT_EQ(at("rows", "descriptors", 2), "15");
  EXPECT_EQ(raw.Query("SELECT count(*) FROM images"), "3");
}

TEST(ColmapDatabase, ImagesShareTheCameraWhoseFocalLengthIsKnown) {
  TemporaryFolder folder;
  const fs::path path = MakeDatabase(
      folder / "d.db", kColmapSchema38,
      "DELETE FROM matches; DELETE FROM two_view_geometries;"
      "INSERT INTO cameras SELECT 21, model, width, height, params, 0 FROM cameras LIMIT 1;"
      "INSERT INTO cameras SELECT 22, model, width, height, params, 1 FROM cameras LIMIT 1;"
      "INSERT INTO cameras SELECT 23, model, width, height, params, 0 FROM cameras LIMIT 1;"
      "UPDATE images SET camera_id = 21 WHERE name = 'a.jpg'; UPDATE images SET camera_id = 22 WHERE "
      "name = 'c.jpg'; UPDATE images SET camera_id = 23 WHERE name = 'sub/b.jpg';");
  const auto cameras = [&] {
    return RawDatabase(path).Query(
        "SELECT group_concat(camera_id) FROM (SELECT * FROM images ORDER BY name)");
  };
  ColmapDatabase::Open(path, Access::kReadWrite).ShareCameras({{"a.jpg", "missing.jpg"}, {"sub/b.jpg"}});
  EXPECT_EQ(cameras(), "21,22,23");
  EXPECT_EQ(RawDatabase(path).Query("SELECT count(*) FROM cameras"), "3");
  ColmapDatabase::Open(path, Access::kReadWrite).ShareCameras({{"a.jpg", "c.jpg"}, {"sub/b.jpg"}});
  EXPECT_EQ(cameras(), "22,22,23");
  EXPECT_EQ(RawDatabase(path).Query("SELECT group_concat(camera_id) FROM cameras"), "22,23");
}

TEST(ColmapDatabase, IdentityPoseMeansNone) {
  TemporaryFolder folder;
  const fs::path path = MakeDatabase(folder / "d.db", kColmapSchema38,
                                     "UPDATE two_view_geometries SET tvec = zeroblob(24), qvec = "
                                     "CAST(X'000000000000f03f' || zeroblob(24) AS BLOB)");
  EXPECT_EQ(RawDatabase(path).Query("SELECT length(qvec) FROM two_view_geometries"), "32");
  EXPECT_FALSE(ColmapDatabase::Open(path, Access::kReadOnly).ReadTwoViewGeometry(1, 2)->cam2_from_cam1);
}

TEST(ColmapDatabase, SiftDescriptorsOnly) {
  TemporaryFolder folder;
  const fs::path path = MakeDatabase(folder / "d.db", kColmapSchema42, "UPDATE descriptors SET type = 2");
  ExpectUserError([&] { ColmapDatabase::Open(path, Access::kReadOnly).ReadDescriptors(1); },
                  {"d.db", "not SIFT's (type 2"});
}

// ---------------------------------------------------------------------------------- reading without a trace

TEST(ColmapDatabase, ReadOnlyReadsAnUnfinishedLogAndLeavesNoTrace) {
  TemporaryFolder folder;
  const fs::path path = MakeUnfinishedWal(folder / "w", folder / "scratch.db");
  const auto before = FileContents(folder / "w");
  ASSERT_EQ(before.size(), 2u);
  {
    const ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadOnly);
    ExpectSmallContent(database);
    EXPECT_EQ(FileContents(folder / "w"), before);
  }
  EXPECT_EQ(FileContents(folder / "w"), before);
}

TEST(ColmapDatabase, ReadOnlyReadsWalModeWithoutALog) {
  TemporaryFolder folder;
  const fs::path path = folder / "odd name %23?#.db";
  { RawDatabase(path).Execute("PRAGMA journal_mode=WAL"); }
  MakeDatabase(path);
  const auto before = FileContents(folder.path());
  ASSERT_EQ(before.size(), 1u);
  {
    const ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadOnly);
    ExpectSmallContent(database);
    EXPECT_EQ(FileContents(folder.path()), before);
  }
  EXPECT_EQ(FileContents(folder.path()), before);
}

// Runs as a user without write permission, which root always has.
class AsNobody {
 public:
  AsNobody() : is_root_(::geteuid() == 0) { EXPECT_EQ(is_root_ ? ::seteuid(65534) : 0, 0); }
  AsNobody(const AsNobody&) = delete;
  AsNobody& operator=(const AsNobody&) = delete;
  ~AsNobody() { EXPECT_EQ(is_root_ ? ::seteuid(0) : 0, 0); }

 private:
  bool is_root_;
};

TEST(ColmapDatabase, ReadOnlyFoldersAreRead) {
  TemporaryFolder folder;
  ::chmod(folder.path().c_str(), 0755);
  fs::create_directory(folder / "r");
  const std::vector<fs::path> paths = {
      MakeDatabase(folder / "r" / "rollback.db"),
      MakeUnfinishedWal(folder / "r", folder / "scratch.db"),
      [&] {
        const fs::path path = folder / "r" / "wal.db";
        { RawDatabase(path).Execute("PRAGMA journal_mode=WAL"); }
        return MakeDatabase(path);
      }(),
  };
  for (const auto& entry : fs::directory_iterator(folder / "r")) ::chmod(entry.path().c_str(), 0444);
  ::chmod((folder / "r").c_str(), 0555);
  {
    const AsNobody nobody;
    for (const fs::path& path : paths) {
      SCOPED_TRACE(path);
      ExpectSmallContent(ColmapDatabase::Open(path, Access::kReadOnly));
      ExpectUserError([&] { ColmapDatabase::Open(path, Access::kReadWrite); },
                      {path.string(), "cannot be written"});
      ExpectUserError([&] { ColmapDatabase::Create(folder / "r" / "new.db"); }, {"new.db", "cannot be"});
    }
  }
  ::chmod((folder / "r").c_str(), 0755);
}

TEST(ColmapDatabase, ChangesByOthersWhileReadingAreNoticed) {
  TemporaryFolder folder;
  const fs::path path = folder / "d.db";
  { RawDatabase(path).Execute("PRAGMA journal_mode=WAL"); }
  MakeDatabase(path);
  const ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadOnly);
  database.ReadCameras();
  RawDatabase other(path);
  other.Execute("DELETE FROM matches");
  ExpectUserError([&] { database.ReadCameras(); }, {"d.db", "changed by another program"});
}

TEST(ColmapDatabase, LockedDatabase) {
  TemporaryFolder folder;
  const fs::path path = MakeDatabase(folder / "d.db");
  RawDatabase other(path);
  other.Execute("BEGIN EXCLUSIVE");
  ExpectUserError([&] { ColmapDatabase::Open(path, Access::kReadOnly, 1); },
                  {"d.db", "locked by another program"});
  ExpectUserError([&] { ColmapDatabase::Open(path, Access::kReadWrite, 1); },
                  {"d.db", "locked by another program"});
  other.Execute("COMMIT");
  ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadWrite, 1);
  other.Execute("BEGIN IMMEDIATE");
  ExpectUserError([&] { database.WriteMatches(1, 5, {}); }, {"d.db", "locked by another program"});
}

TEST(ColmapDatabase, WritesToWalModeLeaveNoOtherFiles) {
  TemporaryFolder folder;
  const fs::path path = folder / "d.db";
  { RawDatabase(path).Execute("PRAGMA journal_mode=WAL"); }
  MakeDatabase(path);
  {
    ColmapDatabase database = ColmapDatabase::Open(path, Access::kReadWrite);
    database.WriteMatches(1, 5, {{0, 0}});
  }
  EXPECT_THAT(FileNames(folder.path()), ElementsAre("d.db"));
  EXPECT_TRUE(ColmapDatabase::Open(path, Access::kReadOnly).HasMatches(1, 5));
}

// ------------------------------------------------------------------------------------------------- copies

TEST(ColmapDatabase, SafeCopyTakesTheLogAlong) {
  TemporaryFolder folder;
  const fs::path from = MakeUnfinishedWal(folder / "w", folder / "scratch.db");
  const auto before = FileContents(folder / "w");
  fs::create_directory(folder / "to");
  Reporter reporter;
  ColmapDatabase::SafeCopy(from, folder / "to" / "c.db", reporter);
  EXPECT_EQ(FileContents(folder / "w"), before);
  EXPECT_THAT(FileNames(folder / "to"), ElementsAre("c.db"));
  ExpectSmallContent(ColmapDatabase::Open(folder / "to" / "c.db", Access::kReadOnly));
  EXPECT_THAT(FileNames(folder / "to"), ElementsAre("c.db"));
  EXPECT_EQ(RawDatabase(folder / "to" / "c.db").Query("PRAGMA integrity_check"), "ok");
}

TEST(ColmapDatabase, SafeCopyReplacesADatabaseAndItsLog) {
  TemporaryFolder folder;
  const fs::path to = MakeUnfinishedWal(folder / "w", folder / "scratch.db");
  const fs::path from = MakeDatabase(folder / "from.db");
  Reporter reporter;
  ColmapDatabase::SafeCopy(from, to, reporter,
                           [](ColmapDatabase& copy) { copy.ReplaceTwoViewGeometries({}); });
  EXPECT_THAT(FileNames(folder / "w"), ElementsAre("w.db"));
  const ColmapDatabase copy = ColmapDatabase::Open(to, Access::kReadOnly);
  EXPECT_FALSE(copy.ReadTwoViewGeometry(1, 2).has_value());
  EXPECT_EQ(copy.ReadMatches(1, 2).size(), 2u);
  ExpectSmallContent(ColmapDatabase::Open(from, Access::kReadOnly));
}

TEST(ColmapDatabase, FailedSafeCopyLeavesTheOldFile) {
  class Stopped : public Reporter {
    bool StopRequested() const override { return true; }
  };
  TemporaryFolder folder;
  const fs::path from = folder / "from.db";
  // More pages than one step of the copy takes, so that it can be stopped in between.
  { RawDatabase(from).Execute("PRAGMA page_size=512; CREATE TABLE filler(data BLOB)"); }
  MakeDatabase(from, kColmapSchema38, "INSERT INTO filler VALUES(zeroblob(4194304))");
  WriteAll(folder / "to.db", "old");
  Stopped stopped;
  EXPECT_THROW(ColmapDatabase::SafeCopy(from, folder / "to.db", stopped), Interrupted);
  Reporter reporter;
  EXPECT_THROW(ColmapDatabase::SafeCopy(from, folder / "to.db", reporter,
                                        [](ColmapDatabase&) { throw UserError("no"); }),
               UserError);
  EXPECT_EQ(ReadAll(folder / "to.db"), "old");
  EXPECT_THAT(FileNames(folder.path()), UnorderedElementsAre("from.db", "to.db"));
  ExpectUserError([&] { ColmapDatabase::SafeCopy(from, folder / "." / "from.db", reporter); },
                  {"from.db", "is the database to copy from"});
}

// Pages are copied 4,096 at a time.
TEST(ColmapDatabase, SafeCopySaysHowFarItIs) {
  class Listener : public Reporter {
   public:
    void Progress(std::string_view task, int64_t done, int64_t total) override {
      EXPECT_EQ(task, "copy database");
      EXPECT_GT(total, 16384);  // of 512 bytes
      EXPECT_LT(total, 16640);
      told.push_back(done);
    }
    std::vector<int64_t> told;
  };
  TemporaryFolder folder;
  const fs::path from = folder / "from.db";
  { RawDatabase(from).Execute("PRAGMA page_size=512; CREATE TABLE filler(data BLOB)"); }
  MakeDatabase(from, kColmapSchema38, "INSERT INTO filler VALUES(zeroblob(8388608))");
  Listener listener;
  ColmapDatabase::SafeCopy(from, folder / "to.db", listener);
  EXPECT_THAT(listener.told, ElementsAre(4096, 8192, 12288, 16384));
}

TEST(ColmapDatabase, WriteAtomicallyShowsFinishedFilesOnly) {
  TemporaryFolder folder;
  const fs::path path = folder / "d.db";
  EXPECT_THROW(ColmapDatabase::WriteAtomically(path, [](ColmapDatabase&) { throw Interrupted(); }),
               Interrupted);
  EXPECT_THAT(FileNames(folder.path()), IsEmpty());
  ColmapDatabase::WriteAtomically(path, [&](ColmapDatabase& database) {
    EXPECT_FALSE(fs::exists(path));
    database.WriteCamera({{1, CameraModelId::kSimplePinhole, 10, 20, {1, 2, 3}}, true});
  });
  EXPECT_THAT(FileNames(folder.path()), ElementsAre("d.db"));
  EXPECT_EQ(ColmapDatabase::Open(path, Access::kReadOnly).ReadCameras().size(), 1u);
}

}  // namespace
}  // namespace s2gs
