#include "sfm_split/colmap_database.h"

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

#include "sfm_split/error.h"
#include "tests/bad_input.h"
#include "tests/sfm_split/database_fixture.h"
#include "tests/temporary_folder.h"

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

fs::path MakeDatabase(const fs::path& path, const char* schema = kColmapSchema38,
                      const std::string& more_sql = "") {
  RawDatabase raw(path);
  raw.Execute(std::string(schema) + kSmallContent + more_sql);
  return path;
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

// Reads everything there is, which must not crash whatever the file holds.
void ReadEverything(const ColmapDatabase& database) {
  database.ReadCameras();
  for (const DatabaseImage& image : database.ReadImages()) {
    database.ReadKeypoints(image.image_id);
    database.ReadDescriptors(image.image_id);
  }
  database.ReadMatches(1, 2);
  database.ReadTwoViewGeometry(2, 1);
  database.ForEachMatches([](uint32_t, uint32_t, const FeatureMatches&) {});
  database.ForEachTwoViewGeometry([](uint32_t, uint32_t, const TwoViewGeometry&) {});
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

// ---------------------------------------------------------------------------------------------- bad input

TEST(ColmapDatabaseBadInput, NotADatabase) {
  TemporaryFolder folder;
  for (const Access access : {Access::kReadOnly, Access::kReadWrite}) {
    const auto open = [&](const std::string& name) {
      return [&folder, access, name] { ColmapDatabase::Open(folder / name, access); };
    };
    ExpectUserError(open("missing.db"), {"missing.db", "no such file", "feature_extractor"});
    ExpectUserError([&] { ColmapDatabase::Open(folder.path(), access); }, {folder.path().string(), "folder"});
    WriteAll(folder / "empty.db", "");
    ExpectUserError(open("empty.db"), {"empty.db", "no table \"cameras\"", "3.8 to 4.2"});
    WriteAll(folder / "text.db", std::string(5000, 'x'));
    ExpectUserError(open("text.db"), {"text.db", "not a SQLite database"});
    EXPECT_EQ(ReadAll(folder / "text.db"), std::string(5000, 'x'));
    EXPECT_EQ(fs::file_size(folder / "empty.db"), 0u);
  }
}

TEST(ColmapDatabaseBadInput, ForeignSchemas) {
  TemporaryFolder folder;
  struct Case {
    const char* sql;
    const char* message;
  };
  const std::vector<Case> cases = {
      {"ALTER TABLE matches RENAME TO m", "no table \"matches\""},
      {"ALTER TABLE matches RENAME TO m; CREATE VIEW matches AS SELECT * FROM m", "no table \"matches\""},
      {"ALTER TABLE keypoints RENAME COLUMN cols TO columns", "no column \"cols\""},
      {"DROP TABLE matches; CREATE TABLE matches(pair_id INTEGER, rows INTEGER, cols INTEGER, data BLOB)",
       "has not pair_id as its key"},
      {"DROP TABLE two_view_geometries; CREATE TABLE inlier_matches(pair_id INTEGER PRIMARY KEY)",
       "no table \"two_view_geometries\""},
  };
  for (const Case& c : cases) {
    const fs::path path = folder / "d.db";
    fs::remove(path);
    MakeDatabase(path, kColmapSchema38, c.sql);
    ExpectUserError([&] { ColmapDatabase::Open(path, Access::kReadOnly); },
                    {"d.db", c.message, "COLMAP 3.8 to 4.2"}, c.sql);
  }
}

TEST(ColmapDatabaseBadInput, HostileRows) {
  TemporaryFolder folder;
  struct Case {
    const char* sql;
    const char* message;
  };
  const std::vector<Case> cases = {
      {"UPDATE keypoints SET rows = 2147483647", "claimed"},
      {"UPDATE keypoints SET rows = 2147483648", "rows is 2147483648"},
      {"UPDATE keypoints SET rows = 9223372036854775807", "rows is 9223372036854775807"},
      {"UPDATE keypoints SET rows = -1, cols = -1", "rows is -1"},
      {"UPDATE keypoints SET rows = 1.5", "rows is not an integer"},
      {"UPDATE keypoints SET rows = X'0300000000000000'", "rows is not an integer"},
      {"UPDATE keypoints SET cols = 0", "claimed"},
      {"UPDATE keypoints SET rows = 6, cols = 3 WHERE image_id = 1", "3 columns"},
      {"UPDATE keypoints SET data = NULL", "0 bytes"},
      {"UPDATE keypoints SET data = 'text'", "not a blob"},
      {"UPDATE keypoints SET data = 17", "not a blob"},
      {"UPDATE keypoints SET data = X'0000c07f00000041' WHERE image_id = 5", "not finite"},
      {"UPDATE keypoints SET rows = 0 WHERE image_id = 1", "72 bytes"},
      {"UPDATE keypoints SET rows = 0, data = NULL WHERE image_id = 2", "image 2 has only 0"},
      {"DELETE FROM keypoints WHERE image_id = 5", "image 5 has only 0"},
      {"UPDATE descriptors SET rows = 4", "claimed"},
      {"UPDATE descriptors SET rows = 6, cols = 64", "not SIFT's"},
      {"UPDATE matches SET rows = 1073741824, cols = 2147483647", "claimed"},
      {"UPDATE matches SET cols = 4, rows = 1 WHERE pair_id = 2147483649", "4 columns"},
      {"UPDATE matches SET data = X'03000000010000000200000000000000' WHERE rows = 2", "refer to keypoint 3"},
      {"UPDATE matches SET data = X'ffffffffffffffff' WHERE rows = 1", "keypoint 4294967295"},
      {"UPDATE matches SET pair_id = 0 WHERE rows = 1", "not of two different images"},
      {"UPDATE matches SET pair_id = -5 WHERE rows = 1", "out of order"},
      {"UPDATE matches SET pair_id = 2147483647 * 3 + 2 WHERE rows = 1", "not of two different images"},
      {"UPDATE matches SET pair_id = 9223372036854775807 WHERE rows = 1", "not of two different images"},
      {"UPDATE two_view_geometries SET F = X'00'", "F has 1 bytes"},
      {"UPDATE two_view_geometries SET E = zeroblob(80)", "E has 80 bytes"},
      {"UPDATE two_view_geometries SET tvec = X'000000000000f87f0000000000000000' || X'0000000000000000'",
       "not a blob"},
      {"UPDATE two_view_geometries SET tvec = CAST(X'000000000000f87f' || zeroblob(16) AS BLOB)",
       "tvec is not finite"},
      {"UPDATE two_view_geometries SET config = 11", "config is 11"},
      {"UPDATE two_view_geometries SET config = -1", "config is -1"},
      {"UPDATE cameras SET params = X'00'", "1 bytes of parameters"},
      {"UPDATE cameras SET params = NULL", "0 bytes of parameters"},
      {"UPDATE cameras SET params = zeroblob(1000000)", "1000000 bytes"},
      {"UPDATE cameras SET params = CAST(zeroblob(24) || X'000000000000f07f' AS BLOB)", "not finite"},
      {"UPDATE cameras SET model = 999", "model 999"},
      {"UPDATE cameras SET model = 9223372036854775807", "model is 9223372036854775807"},
      {"UPDATE cameras SET width = 0", "width is 0"},
      {"UPDATE cameras SET height = -480", "height is -480"},
      {"UPDATE cameras SET camera_id = -1 WHERE camera_id = 9", "camera_id is -1"},
      {"UPDATE images SET camera_id = 8", "does not exist"},
      {"UPDATE images SET name = '' WHERE image_id = 1", "no usable name"},
      {"UPDATE images SET name = 'a' || char(0) || 'b' WHERE image_id = 1", "no usable name"},
      {"UPDATE images SET name = X'61' WHERE image_id = 1", "name is not text"},
      {"UPDATE images SET prior_qw = 'x', prior_qx = 1, prior_qy = 1, prior_qz = 1",
       "prior_qw is not a number"},
  };
  for (const Case& c : cases) {
    const fs::path path = folder / "d.db";
    fs::remove(path);
    MakeDatabase(path, kColmapSchema38, c.sql);
    ExpectUserError(
        [&] {
          const ScopedAllocationLimit limit(1 << 20);
          ReadEverything(ColmapDatabase::Open(path, Access::kReadOnly));
        },
        {"d.db", c.message}, c.sql);
  }
}

// A small file of many small pages, so that damage reaches every kind of them.
std::string SmallDatabaseBytes(const TemporaryFolder& folder) {
  const fs::path path = folder / "small.db";
  fs::remove(path);
  {
    RawDatabase raw(path);
    raw.Execute("PRAGMA page_size=512");
    raw.Execute(std::string("BEGIN;") + kColmapSchema38 + kSmallContent + "COMMIT");
    // Enough pairs for interior pages.
    for (int id = 6; id < 40; ++id) {
      raw.Execute("INSERT INTO matches VALUES(2147483647 * 1 + " + std::to_string(id) + ", 0, 2, NULL)");
    }
  }
  return ReadAll(path);
}

void CheckDamage(const fs::path& path, const std::string& damaged, const std::string& description) {
  WriteAll(path, damaged);
  ExpectOkOrUserError(
      [&] {
        const ScopedAllocationLimit limit(1 << 20);
        ReadEverything(ColmapDatabase::Open(path, Access::kReadOnly));
      },
      path.string(), description);
}

fs::path InMemoryFolder() {
  return fs::is_directory("/dev/shm") ? fs::path("/dev/shm") : fs::temp_directory_path();
}

class ColmapDatabaseDamage : public ::testing::Test {
 protected:
  ColmapDatabaseDamage()
      : path_(InMemoryFolder() / ("s2gs_test_damage_" + std::to_string(::getpid()) + ".db")) {}
  ~ColmapDatabaseDamage() override { fs::remove(path_); }

  TemporaryFolder folder_;
  fs::path path_;
};
using ColmapDatabaseBadInputDamage = ColmapDatabaseDamage;

TEST_F(ColmapDatabaseBadInputDamage, Truncations) {
  const std::string bytes = SmallDatabaseBytes(folder_);
  for (size_t size = 0; size < bytes.size(); size += size < 200 ? 1 : 37) {
    CheckDamage(path_, bytes.substr(0, size), "cut to " + std::to_string(size));
  }
  for (size_t size = 0; size < bytes.size(); size += 512) {
    CheckDamage(path_, bytes.substr(0, size), "cut to " + std::to_string(size));
  }
}

TEST_F(ColmapDatabaseBadInputDamage, BitFlips) {
  std::string bytes = SmallDatabaseBytes(folder_);
  // Every bit of the file's header, and of the rest every 13th, which reaches every bit of a byte.
  for (size_t bit = 0; bit < bytes.size() * 8; bit += bit < 112 * 8 ? 1 : 13) {
    const char original = bytes[bit / 8];
    bytes[bit / 8] = static_cast<char>(original ^ (1 << (bit % 8)));
    CheckDamage(path_, bytes, "bit " + std::to_string(bit) + " flipped");
    bytes[bit / 8] = original;
  }
}

// All children of an interior page are made the same: a walk would see the same rows again and again, and
// with a few such pages above each other would never end.
TEST_F(ColmapDatabaseBadInputDamage, PagesThatAreVisitedTwice) {
  const std::string bytes = SmallDatabaseBytes(folder_);
  const int root = std::stoi(
      RawDatabase(folder_ / "small.db").Query("SELECT rootpage FROM sqlite_master WHERE name = 'matches'"));
  std::string damaged = bytes;
  const size_t page = static_cast<size_t>(root - 1) * 512;
  ASSERT_EQ(damaged[page], 5) << "an interior page of a table";
  const auto byte = [&](size_t i) { return static_cast<unsigned char>(damaged[page + i]); };
  const size_t num_cells = byte(3) * 256u + byte(4);
  ASSERT_GE(num_cells, 1u);
  for (size_t i = 0; i < num_cells; ++i) {
    const size_t cell = byte(12 + 2 * i) * 256u + byte(13 + 2 * i);
    damaged.replace(page + cell, 4, damaged, page + 8, 4);
  }
  WriteAll(path_, damaged);
  ExpectUserError([&] { ReadEverything(ColmapDatabase::Open(path_, Access::kReadOnly)); },
                  {path_.string(), "damaged"});
}

}  // namespace
}  // namespace s2gs
