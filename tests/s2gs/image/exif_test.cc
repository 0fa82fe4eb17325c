#include "s2gs/image/exif.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "s2gs/image/image_header.h"
#include "sfm_split/base/file_io.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

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

TEST(Exif, ReadsBothByteOrders) {
  for (const bool big_endian : {false, true}) {
    const auto tags = ParseExif(ExifJpeg(big_endian));
    ASSERT_TRUE(tags.has_value()) << big_endian;
    EXPECT_DOUBLE_EQ(tags->focal_mm, 4.2);
    EXPECT_DOUBLE_EQ(tags->focal_35mm_mm, 26);
    EXPECT_EQ(tags->orientation, 1);
    EXPECT_TRUE(tags->SaysOfLens());
  }
}

TEST(Exif, NothingWithoutExif) {
  EXPECT_FALSE(ParseExif("").has_value());
  EXPECT_FALSE(ParseExif("\x89PNG").has_value());
  EXPECT_FALSE(ParseExif(std::string("\xFF\xD8\xFF\xD9", 4)).has_value());
  EXPECT_FALSE(ReadExif("/no/such/file.jpg").has_value());
}

ExifTags AllTags() {
  ExifTags tags;
  tags.focal_mm = 4.25;
  tags.focal_35mm_mm = 26;
  tags.digital_zoom = 1.5;
  tags.plane_px_per_mm = 320.5;
  tags.taken = {4032, 3024};
  tags.orientation = 6;
  return tags;
}

void ExpectAllTags(const std::optional<ExifTags>& tags) {
  ASSERT_TRUE(tags.has_value());
  EXPECT_DOUBLE_EQ(tags->focal_mm, 4.25);
  EXPECT_DOUBLE_EQ(tags->focal_35mm_mm, 26);
  EXPECT_DOUBLE_EQ(tags->digital_zoom, 1.5);
  EXPECT_DOUBLE_EQ(tags->plane_px_per_mm, 320.5);
  EXPECT_EQ(tags->taken, (std::array<int, 2>{4032, 3024}));
  EXPECT_EQ(tags->orientation, 6);
}

TEST(Exif, WrittenIntoPngAndReadAgain) {
  ExpectAllTags(ParseExif(MakeExif(AllTags())));
  const TemporaryFolder folder;
  const Image8 image{2, 2, 4, {1, 2, 3, 0, 4, 5, 6, 255, 7, 8, 9, 255, 10, 11, 12, 128}};
  WritePng(folder / "a.png", image, MakeExif(AllTags()));
  ExpectAllTags(ReadExif(folder / "a.png"));
  EXPECT_EQ(ReadImage(folder / "a.png", 3).pixels,
            (std::vector<uint8_t>{1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}));
  EXPECT_EQ(ReadMask(folder / "a.png").pixels, (std::vector<uint8_t>{0, 255, 255, 128}));
  EXPECT_TRUE(ReadImageHeader(folder / "a.png").png.has_alpha);
}

TEST(Exif, AFocalLengthOfNoLensIsNotWrittenAsAnother) {
  ExifTags tags;
  tags.focal_35mm_mm = 65536 + 50;  // short integers have 16 bits
  EXPECT_EQ(ParseExif(MakeExif(tags))->focal_35mm_mm, 65535);
  tags.focal_35mm_mm = std::numeric_limits<double>::infinity();
  EXPECT_EQ(ParseExif(MakeExif(tags))->focal_35mm_mm, 65535);
}

TEST(Exif, WhatIsNotKnownIsNotWritten) {
  const size_t nothing = MakeExif({}).size();
  const auto grows = [&](const std::function<void(ExifTags*)>& set) {
    ExifTags tags;
    set(&tags);
    return MakeExif(tags).size() > nothing;
  };
  EXPECT_TRUE(grows([](ExifTags* tags) { tags->focal_mm = 4; }));
  EXPECT_TRUE(grows([](ExifTags* tags) { tags->focal_35mm_mm = 4; }));
  EXPECT_TRUE(grows([](ExifTags* tags) { tags->digital_zoom = 2; }));
  EXPECT_TRUE(grows([](ExifTags* tags) { tags->plane_px_per_mm = 2; }));
  EXPECT_TRUE(grows([](ExifTags* tags) { tags->taken = {2, 3}; }));
  EXPECT_FALSE(grows([](ExifTags* tags) { tags->taken = {2, 0}; }));
  EXPECT_FALSE(grows([](ExifTags* tags) { tags->taken = {0, 3}; }));
  const std::string bytes = MakeExif({});
  for (const uint16_t tag : {0x920a, 0xa405, 0xa404, 0xa20e, 0xa002}) {
    const std::string little = {static_cast<char>(tag & 255), static_cast<char>(tag >> 8)};
    const std::string big = {little[1], little[0]};
    EXPECT_EQ(bytes.find(little), std::string::npos) << tag;
    EXPECT_EQ(bytes.find(big), std::string::npos) << tag;
  }
}

TEST(Exif, MaskWithoutAlphaIsGrey) {
  const TemporaryFolder folder;
  WriteImage(folder / "grey.png", {2, 1, 1, {0, 255}});
  EXPECT_EQ(ReadMask(folder / "grey.png").pixels, (std::vector<uint8_t>{0, 255}));
  // An opaque alpha channel masks nothing.
  WriteImage(folder / "opaque.png", {2, 1, 4, {9, 9, 9, 255, 200, 200, 200, 255}});
  EXPECT_EQ(ReadMask(folder / "opaque.png").pixels, (std::vector<uint8_t>{9, 200}));
}

// By the definitions: 35 mm film has a diagonal of sqrt(36^2 + 24^2) mm.
TEST(Exif, FocalLengthInPixels) {
  const double film = std::sqrt(36.0 * 36 + 24 * 24);
  ExifTags tags;
  EXPECT_FALSE(FocalPixels(tags, {4000, 3000}).has_value());
  tags.focal_35mm_mm = 26;
  EXPECT_DOUBLE_EQ(*FocalPixels(tags, {4000, 3000}), 26 * 5000 / film);
  EXPECT_DOUBLE_EQ(*FocalPixels(tags, {3000, 4000}), 26 * 5000 / film);
  tags.taken = {4000, 3000};
  EXPECT_DOUBLE_EQ(*FocalPixels(tags, {2000, 1500}), 26 * 2500 / film) << "resized";
  EXPECT_DOUBLE_EQ(*FocalPixels(tags, {1500, 1500}), 26 * 5000 / film) << "cut";
  EXPECT_TRUE(IsCut(tags, {1500, 1500}));
  EXPECT_FALSE(IsCut(tags, {1000, 750}));
  EXPECT_FALSE(IsCut(tags, {750, 1000})) << "turned";
  // A sensor of 5 mm over 4000 pixels: a lens of 4 mm has 3200 pixels, and digital zoom enlarges them.
  tags.focal_35mm_mm = 0;
  tags.focal_mm = 4;
  tags.plane_px_per_mm = 800;
  EXPECT_DOUBLE_EQ(*FocalPixels(tags, {4000, 3000}), 3200);
  EXPECT_DOUBLE_EQ(*FocalPixels(tags, {2000, 1500}), 1600);
  tags.digital_zoom = 2;
  EXPECT_DOUBLE_EQ(*FocalPixels(tags, {4000, 3000}), 6400);
}

// Orientations as the TIFF specification draws them: where row 0 and column 0 of the stored pixels belong.
TEST(Exif, EveryOrientationTurnsUpright) {
  const Image8 upright{3, 2, 1, {1, 2, 3, 4, 5, 6}};
  const std::array<std::vector<uint8_t>, 9> stored = {
      std::vector<uint8_t>{}, {1, 2, 3, 4, 5, 6}, {3, 2, 1, 6, 5, 4}, {6, 5, 4, 3, 2, 1}, {4, 5, 6, 1, 2, 3},
      {1, 4, 2, 5, 3, 6},     {3, 6, 2, 5, 1, 4}, {6, 3, 5, 2, 4, 1}, {4, 1, 5, 2, 6, 3}};
  for (int orientation = 1; orientation <= 8; ++orientation) {
    Image8 image{orientation < 5 ? 3 : 2, orientation < 5 ? 2 : 3, 1,
                 stored[static_cast<size_t>(orientation)]};
    EXPECT_EQ(TurnUpright(image, orientation).pixels, upright.pixels) << orientation;
    if (!IsMirrored(orientation)) continue;
    const int turn = OrientationOfMirrored(orientation);
    EXPECT_FALSE(IsMirrored(turn));
    EXPECT_EQ(TurnUpright(MirrorRows(image), turn).pixels, upright.pixels) << orientation;
  }
}

TEST(ExifBadInput, NeverThrows) {
  for (const bool big_endian : {false, true}) {
    ForEachDamage(ExifJpeg(big_endian), [](const std::string& damaged, const std::string& description) {
      EXPECT_NO_THROW(ParseExif(damaged)) << description;
    });
  }
  const TemporaryFolder folder;
  WritePng(folder / "a.png", {8, 8, 1, std::vector<uint8_t>(64)}, MakeExif(AllTags()));
  ForEachDamage(ReadWholeFile(folder / "a.png", 10000),
                [](const std::string& damaged, const std::string& description) {
                  EXPECT_NO_THROW(ParseExif(damaged)) << description;
                });
}

}  // namespace
}  // namespace s2gs
