#include "plugin/colmap/exif_focal.h"

#include <gtest/gtest.h>

#include <string>

#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

std::string Number(uint32_t value, int size, bool big_endian) {
  std::string bytes(size, '\0');
  for (int i = 0; i < size; ++i)
    bytes[big_endian ? size - 1 - i : i] = static_cast<char>((value >> (8 * i)) & 0xFFU);
  return bytes;
}

// A JPEG's beginning: EXIF with 4.2 mm (42/10) and 26 mm on 35 mm film.
std::string ExifJpeg(bool big_endian) {
  const auto n2 = [&](uint32_t v) { return Number(v, 2, big_endian); };
  const auto n4 = [&](uint32_t v) { return Number(v, 4, big_endian); };
  std::string tiff = big_endian ? "MM" : "II";
  tiff += n2(42) + n4(8);
  tiff += n2(1) + n2(0x8769) + n2(4) + n4(1) + n4(26) + n4(0);  // at 8, 18 bytes
  tiff += n2(2);                                                // at 26
  tiff += n2(0x920A) + n2(5) + n4(1) + n4(56);
  tiff += n2(0xA405) + n2(3) + n4(1) + n2(26) + n2(0);
  tiff += n4(0);            // ends at 56
  tiff += n4(42) + n4(10);  // 4.2
  const std::string segment = std::string("Exif\0\0", 6) + tiff;
  const std::string jfif = std::string("\xFF\xE0", 2) + Number(4, 2, true) + "ab";
  return std::string("\xFF\xD8", 2) + jfif + std::string("\xFF\xE1", 2) +
         Number(static_cast<uint32_t>(segment.size() + 2), 2, true) + segment + std::string("\xFF\xD9", 2);
}

TEST(ExifFocal, ReadsBothByteOrders) {
  for (const bool big_endian : {false, true}) {
    const auto focal = ParseExifFocal(ExifJpeg(big_endian));
    ASSERT_TRUE(focal.has_value()) << big_endian;
    EXPECT_DOUBLE_EQ(focal->focal_mm, 4.2);
    EXPECT_DOUBLE_EQ(focal->focal_35mm_mm, 26);
  }
}

TEST(ExifFocal, NothingWithoutExif) {
  EXPECT_FALSE(ParseExifFocal("").has_value());
  EXPECT_FALSE(ParseExifFocal("\x89PNG").has_value());
  EXPECT_FALSE(ParseExifFocal(std::string("\xFF\xD8\xFF\xD9", 4)).has_value());
  EXPECT_FALSE(ReadExifFocal("/no/such/file.jpg").has_value());
}

TEST(ExifFocalBadInput, NeverThrows) {
  for (const bool big_endian : {false, true}) {
    ForEachDamage(ExifJpeg(big_endian), [](const std::string& damaged, const std::string& description) {
      EXPECT_NO_THROW(ParseExifFocal(damaged)) << description;
    });
  }
}

}  // namespace
}  // namespace s2gs
