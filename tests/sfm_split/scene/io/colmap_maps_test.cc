#include "sfm_split/scene/io/colmap_maps.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>

#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

ColmapMap Parse(const std::string& bytes, int channels) {
  std::istringstream stream(bytes);
  return ReadColmapMap(stream, "a.bin", channels);
}

std::string Print(const ColmapMap& map) {
  std::ostringstream stream;
  WriteColmapMap(stream, map);
  return stream.str();
}

// 2 x 1 pixels, 3 channels: channel after channel (0, 1), (2, 3), (-1, .5).
const std::string kNormals = "2&1&3&" + std::string(
                                            "\x00\x00\x00\x00\x00\x00\x80\x3f"
                                            "\x00\x00\x00\x40\x00\x00\x40\x40"
                                            "\x00\x00\x80\xbf\x00\x00\x00\x3f",
                                            24);

TEST(ColmapMaps, ReadsPlanarBytesMadeByHandAndWritesThemBack) {
  const ColmapMap map = Parse(kNormals, 3);
  EXPECT_EQ(map.width, 2);
  EXPECT_EQ(map.height, 1);
  EXPECT_EQ(map.At(1, 0, 0), 1);
  EXPECT_EQ(map.At(0, 0, 1), 2);
  EXPECT_EQ(map.At(0, 0, 2), -1);
  EXPECT_EQ(map.At(1, 0, 2), .5F);
  EXPECT_EQ(Print(map), kNormals);
}

TEST(ColmapMaps, RowsComeBeforeColumns) {
  const ColmapMap map = Parse("1&2&1&" + std::string("\x00\x00\x80\x3f\x00\x00\x00\x40", 8), 1);
  EXPECT_EQ(map.At(0, 0), 1);
  EXPECT_EQ(map.At(0, 1), 2);
}

TEST(ColmapMaps, FileRoundTrip) {
  ColmapMap map{37, 21, 1, {}};
  for (int i = 0; i < 37 * 21; ++i) map.values.push_back(static_cast<float>(i) / 7);
  const std::filesystem::path path = std::filesystem::path(testing::TempDir()) / "s2gs_colmap_maps_test.bin";
  WriteColmapMap(path, map);
  EXPECT_EQ(ReadColmapMap(path, 1).values, map.values);
  ExpectUserError([&] { ReadColmapMap(path, 3); }, {path.string(), "1 channels, but 3"});
  std::filesystem::remove(path);
  ExpectUserError([&] { ReadColmapMap(path, 1); }, {path.string(), "no such file"});
}

TEST(ColmapMapsBadInput, EveryTruncationAndBitFlip) {
  const ScopedAllocationLimit limit(16 * kNormals.size());
  ForEachDamage(kNormals, [&](const std::string& damaged, const std::string& description) {
    const bool accepted = ExpectOkOrUserError([&] { Parse(damaged, 3); }, "a.bin", description);
    // The header has no spare bits: only the floats may change unnoticed.
    const bool same_header = damaged.size() == kNormals.size() && damaged.substr(0, 6) == "2&1&3&";
    EXPECT_EQ(accepted, same_header || damaged.substr(0, 6) == "1&2&3&") << description;
  });
}

TEST(ColmapMapsBadInput, HostileHeaders) {
  const ScopedAllocationLimit limit(4096);
  const std::string data(24, '\0');
  for (const std::string header :
       {"2147483647&2147483647&3&", "2147483648&1&3&", "18446744073709551615&1&3&", "4294967297&2&3&",
        "0&1&3&", "-2&-1&3&", "&&&", "2& 1&3&", "2&1&3", "99999999999999999999999999999999999999&1&3&"}) {
    ExpectUserError([&] { Parse(header + data, 3); }, {"a.bin", "at byte"}, header);
  }
  ExpectUserError([&] { Parse(kNormals + "x", 3); }, {"a.bin", "1 bytes follow"});
}

}  // namespace
}  // namespace s2gs
