#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <string>
#include <vector>

#include "sfm_split/scene/io/colmap_database.h"
#include "tests/sfm_split/scene/io/database_fixture.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Access = ColmapDatabase::Access;

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
      {"UPDATE images SET name = '' WHERE image_id = 1", "the name of image 1"},
      {"UPDATE images SET name = 'a' || char(0) || 'b' WHERE image_id = 1", "the name of image 1"},
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
