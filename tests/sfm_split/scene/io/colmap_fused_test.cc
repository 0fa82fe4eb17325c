#include "sfm_split/scene/io/colmap_fused.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>

#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

ColmapVisibility ParseVisibility(const std::string& bytes) {
  std::istringstream stream(bytes);
  return ReadColmapVisibility(stream, "a.vis");
}

std::string FileBytes(const fs::path& path) {
  std::ifstream stream(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(stream), {}};
}

void WriteBytes(const fs::path& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary) << bytes;
}

ColmapFusedCloud TwoPoints() {
  ColmapFusedCloud cloud;
  cloud.points = {{1, 2, 3}, {-4, .5F, 6}};
  cloud.normals = {{0, 0, 1}, {1, 0, 0}};
  cloud.colors = {{255, 0, 1}, {2, 3, 4}};
  cloud.visibility.begins = {0, 1, 3};
  cloud.visibility.image_indices = {7, 0, 258};
  return cloud;
}

const std::string kVisibility(
    "\x02\x00\x00\x00\x00\x00\x00\x00"
    "\x01\x00\x00\x00\x07\x00\x00\x00"
    "\x02\x00\x00\x00\x00\x00\x00\x00\x02\x01\x00\x00",
    28);

class ColmapFused : public testing::Test {
 protected:
  void SetUp() override {
    const testing::TestInfo& test = *testing::UnitTest::GetInstance()->current_test_info();
    folder_ = fs::path(testing::TempDir()) / (std::string("s2gs_fused_") + test.name());
    fs::create_directories(folder_);
    path_ = folder_ / "fused.ply";
  }
  void TearDown() override { fs::remove_all(folder_); }

  fs::path folder_;
  fs::path path_;
};

TEST_F(ColmapFused, WritesTheBytesOfColmapsFormat) {
  WriteColmapFusedCloud(path_, TwoPoints());
  EXPECT_EQ(FileBytes(path_.string() + ".vis"), kVisibility);
  const std::string header =
      "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
      "property float z\nproperty float nx\nproperty float ny\nproperty float nz\nproperty uchar red\n"
      "property uchar green\nproperty uchar blue\nend_header\n";
  const std::string rows(
      "\x00\x00\x80\x3f\x00\x00\x00\x40\x00\x00\x40\x40"
      "\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x80\x3f\xff\x00\x01"
      "\x00\x00\x80\xc0\x00\x00\x00\x3f\x00\x00\xc0\x40"
      "\x00\x00\x80\x3f\x00\x00\x00\x00\x00\x00\x00\x00\x02\x03\x04",
      54);
  EXPECT_EQ(FileBytes(path_), header + rows);
}

TEST_F(ColmapFused, RoundTrip) {
  const ColmapFusedCloud cloud = TwoPoints();
  WriteColmapFusedCloud(path_, cloud);
  const ColmapFusedCloud read = ReadColmapFusedCloud(path_);
  EXPECT_EQ(read.points, cloud.points);
  EXPECT_EQ(read.normals, cloud.normals);
  EXPECT_EQ(read.colors, cloud.colors);
  EXPECT_EQ(read.visibility.begins, cloud.visibility.begins);
  EXPECT_EQ(read.visibility.image_indices, cloud.visibility.image_indices);
}

TEST_F(ColmapFused, EmptyCloud) {
  WriteColmapFusedCloud(path_, {});
  EXPECT_TRUE(ReadColmapFusedCloud(path_).points.empty());
}

TEST_F(ColmapFused, BadFilesAreNamed) {
  WriteColmapFusedCloud(path_, TwoPoints());
  const std::string visibility_path = path_.string() + ".vis";
  WriteBytes(visibility_path, std::string(8, '\0'));
  ExpectUserError([&] { ReadColmapFusedCloud(path_); },
                  {visibility_path, "has 0 points, but fused.ply has 2"});
  fs::remove(visibility_path);
  ExpectUserError([&] { ReadColmapFusedCloud(path_); }, {visibility_path, "no such file", "stereo_fusion"});
  fs::remove(path_);
  ExpectUserError([&] { ReadColmapFusedCloud(path_); }, {path_.string(), "no such file"});
  WriteBytes(path_, "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nend_header\n");
  ExpectUserError([&] { ReadColmapFusedCloud(path_); }, {path_.string(), "'y'"});
  WriteBytes(path_, "ply\nformat ascii 1.0\nend_header\n");
  ExpectUserError([&] { ReadColmapFusedCloud(path_); }, {path_.string(), "'vertex'"});
  const std::string columns =
      "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
      "property float nx\nproperty float ny\nproperty float nz\n";
  WriteBytes(path_, columns +
                        "property uchar red\nproperty uchar green\nproperty int blue\nend_header\n"
                        "0 0 0 0 0 1 5 6 7\n");
  ExpectUserError([&] { ReadColmapFusedCloud(path_); }, {path_.string(), "'blue'"});
  WriteBytes(path_, columns +
                        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
                        "0 inf 0 0 0 1 5 6 7\n");
  ExpectUserError([&] { ReadColmapFusedCloud(path_); }, {path_.string(), "point 0 is not finite"});
}

TEST(ColmapVisibilityBadInput, EveryTruncationAndBitFlip) {
  const ScopedAllocationLimit limit(16 * kVisibility.size());
  ForEachDamage(kVisibility, [&](const std::string& damaged, const std::string& description) {
    const bool accepted = ExpectOkOrUserError([&] { ParseVisibility(damaged); }, "a.vis", description);
    EXPECT_FALSE(accepted && damaged.size() < kVisibility.size()) << description;
  });
}

TEST(ColmapVisibilityBadInput, HostileCounts) {
  const ScopedAllocationLimit limit(4096);
  for (const uint64_t count :
       {uint64_t{3}, uint64_t{1} << 31, uint64_t{1} << 62, uint64_t{1} << 63, ~uint64_t{0}}) {
    ExpectUserError([&] { ParseVisibility(WithInteger(kVisibility, 0, 8, count)); }, {"a.vis", "at byte"});
    ExpectUserError([&] { ParseVisibility(WithInteger(kVisibility, 8, 4, count | 0x80000000U)); },
                    {"a.vis", "at byte 12"});
  }
}

}  // namespace
}  // namespace s2gs
