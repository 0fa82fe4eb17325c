#include "s2gs/image/image_file.h"

#include <gtest/gtest.h>
#include <zlib.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "s2gs/image/image_codec.h"
#include "tests/support/bad_input.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

std::string BigEndian(uint32_t value, int num_bytes = 4) {
  std::string bytes;
  for (int i = num_bytes - 1; i >= 0; --i) bytes += static_cast<char>(value >> (8 * i));
  return bytes;
}

std::string Chunk(const std::string& type, const std::string& data) {
  const std::string content = type + data;
  const auto checksum = static_cast<uint32_t>(
      crc32(0, reinterpret_cast<const Bytef*>(content.data()), static_cast<uInt>(content.size())));
  return BigEndian(static_cast<uint32_t>(data.size())) + content + BigEndian(checksum);
}

// A PNG file put together by hand: `rows` are the filter byte and the packed pixels of each row.
std::string MakePng(uint32_t width, uint32_t height, int bit_depth, int color_type, const std::string& rows,
                    bool interlaced = false, const std::string& extra_chunks = "") {
  std::string packed(compressBound(rows.size()), '\0');
  uLongf size = packed.size();
  compress(reinterpret_cast<Bytef*>(packed.data()), &size, reinterpret_cast<const Bytef*>(rows.data()),
           rows.size());
  packed.resize(size);
  const std::string header = BigEndian(width) + BigEndian(height) + static_cast<char>(bit_depth) +
                             static_cast<char>(color_type) + std::string(2, '\0') +
                             static_cast<char>(interlaced ? 1 : 0);
  return "\x89PNG\r\n\x1A\n" + Chunk("IHDR", header) + extra_chunks + Chunk("IDAT", packed) +
         Chunk("IEND", "");
}

using Pixels = std::vector<uint8_t>;

TEST(ImageFile, DecodesEveryKindOfPngMadeByHand) {
  const auto pixels = [](const std::string& bytes, int channels) {
    return DecodeImage(bytes, "a.png", channels).pixels;
  };
  const std::string grey = MakePng(3, 2, 8, 0, std::string("\0\x01\x02\x03\0\x04\x05\xFF", 8));
  EXPECT_EQ(pixels(grey, 1), (Pixels{1, 2, 3, 4, 5, 255}));
  EXPECT_EQ(pixels(grey, 3), (Pixels{1, 1, 1, 2, 2, 2, 3, 3, 3, 4, 4, 4, 5, 5, 5, 255, 255, 255}));

  const std::string one_bit = MakePng(10, 1, 1, 0, std::string("\0\xA0\x40", 3));
  EXPECT_EQ(pixels(one_bit, 1), (Pixels{255, 0, 255, 0, 0, 0, 0, 0, 0, 255}));

  const std::string rgb = MakePng(2, 1, 8, 2, std::string("\0\xFF\x00\x00\x0A\x14\x1E", 7));
  EXPECT_EQ(pixels(rgb, 3), (Pixels{255, 0, 0, 10, 20, 30}));
  // .299 * 255 = 76.2; .299 * 10 + .587 * 20 + .114 * 30 = 18.15.
  EXPECT_EQ(pixels(rgb, 1), (Pixels{76, 18}));

  // Alpha is dropped, not blended in.
  const std::string rgba = MakePng(1, 1, 8, 6, std::string("\0\x0A\x14\x1E\x00", 5));
  EXPECT_EQ(pixels(rgba, 3), (Pixels{10, 20, 30}));
  EXPECT_EQ(pixels(MakePng(1, 1, 8, 4, std::string("\0\x0A\x00", 3)), 1), (Pixels{10}));

  const std::string palette = Chunk("PLTE", std::string("\x01\x02\x03\xFA\xFB\xFC", 6));
  const std::string transparency = Chunk("tRNS", std::string("\x00\x80", 2));
  for (const std::string& chunks : {palette, palette + transparency}) {
    EXPECT_EQ(pixels(MakePng(3, 1, 2, 3, std::string("\0\x44", 2), false, chunks), 3),
              (Pixels{250, 251, 252, 1, 2, 3, 250, 251, 252}));
  }

  // 16 bits: v * 255 / 65535, rounded: 0x00FF -> .992, 0x1280 -> 18.43, 0xFF00 -> 254.008.
  const std::string deep = MakePng(3, 1, 16, 0, std::string("\0\x00\xFF\x12\x80\xFF\x00", 7));
  EXPECT_EQ(pixels(deep, 1), (Pixels{1, 18, 254}));
  // Gamma and colour profile change nothing.
  const std::string gamma = Chunk("gAMA", BigEndian(100000));
  EXPECT_EQ(pixels(MakePng(1, 1, 8, 0, std::string("\0\x50", 2), false, gamma), 1), (Pixels{0x50}));

  // Interlaced: of the seven passes over 3 x 3 pixels, the non-empty ones hold (0, 0); (2, 0); (0, 2), (2,
  // 2); (1, 0), (1, 2); row 1.
  const std::string passes("\0\x01\0\x03\0\x07\x09\0\x02\0\x08\0\x04\x05\x06", 15);
  EXPECT_EQ(pixels(MakePng(3, 3, 8, 0, passes, true), 1), (Pixels{1, 2, 3, 4, 5, 6, 7, 8, 9}));
}

// Smooth colours; every row and column differs.
Image8 Gradient(int width, int height, int channels) {
  Image8 image{width, height, channels, {}};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < channels; ++c) {
        image.pixels.push_back(
            static_cast<uint8_t>(128 + 60 * std::sin(.05 * x + c) + 60 * std::cos(.07 * y)));
      }
    }
  }
  return image;
}

class ImageFileOnDisk : public testing::Test {
 protected:
  void SetUp() override {
    const testing::TestInfo& test = *testing::UnitTest::GetInstance()->current_test_info();
    folder_ = fs::path(testing::TempDir()) / (std::string("s2gs_image_file_") + test.name());
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }

  fs::path Write(const std::string& name, const std::string& bytes) {
    std::ofstream(folder_ / name, std::ios::binary) << bytes;
    return folder_ / name;
  }

  fs::path folder_;
};

TEST_F(ImageFileOnDisk, PngRoundTripIsExact) {
  for (const int channels : {1, 3}) {
    for (const int width : {1, 7, 200}) {
      const Image8 image = Gradient(width, 50, channels);
      WriteImage(folder_ / "a.PNG", image);
      const Image8 read = ReadImage(folder_ / "a.PNG", channels);
      EXPECT_EQ(read.width, image.width);
      EXPECT_EQ(read.height, image.height);
      EXPECT_EQ(read.channels, channels);
      EXPECT_EQ(read.pixels, image.pixels);
      EXPECT_EQ(ReadImageSize(folder_ / "a.PNG").width, width);
      EXPECT_EQ(ReadImageSize(folder_ / "a.PNG").height, 50);
    }
  }
}

int MaxDifference(const Pixels& a, const Pixels& b) {
  EXPECT_EQ(a.size(), b.size());
  int largest = 0;
  for (size_t i = 0; i < std::min(a.size(), b.size()); ++i)
    largest = std::max(largest, std::abs(a[i] - b[i]));
  return largest;
}

TEST_F(ImageFileOnDisk, JpegRoundTripIsClose) {
  const Image8 color = Gradient(203, 101, 3);
  WriteImage(folder_ / "a.jpg", color);
  EXPECT_LE(MaxDifference(ReadImage(folder_ / "a.jpg", 3).pixels, color.pixels), 5);  // measured: 3
  EXPECT_EQ(ReadImageSize(folder_ / "a.jpg").width, 203);
  EXPECT_EQ(ReadImageSize(folder_ / "a.jpg").height, 101);
  Pixels grey;
  for (size_t i = 0; i < color.pixels.size(); i += 3) grey.push_back(GreyFromRgb(color.pixels.data() + i));
  EXPECT_LE(MaxDifference(ReadImage(folder_ / "a.jpg", 1).pixels, grey), 3);  // measured: 1

  const Image8 one_channel = Gradient(203, 101, 1);
  WriteImage(folder_ / "b.JPEG", one_channel, 100);
  EXPECT_LE(MaxDifference(ReadImage(folder_ / "b.JPEG", 1).pixels, one_channel.pixels), 1);
  WriteImage(folder_ / "c.jpg", color, 50);
  EXPECT_LT(fs::file_size(folder_ / "c.jpg"), fs::file_size(folder_ / "a.jpg"));
}

TEST(ImageFile, GreyWeights) {
  const uint8_t colors[][3] = {{255, 255, 255}, {0, 0, 0}, {255, 0, 0}, {0, 255, 0}, {0, 0, 255}, {9, 9, 9}};
  const int expected[] = {255, 0, 76, 150, 29, 9};
  for (int i = 0; i < 6; ++i) EXPECT_EQ(GreyFromRgb(colors[i]), expected[i]);
}

TEST_F(ImageFileOnDisk, SizeIsFoundBehindLongHeaders) {
  // An application segment of the greatest length, with what looks like a frame in it, and fill bytes.
  std::string jpeg = EncodeJpeg(Gradient(20, 10, 3), "a.jpg", 80);
  std::string segment = "\xFF\xE1\xFF\xFF" + std::string("\xFF\xC0\x00\x11\x08\x00\x01\x00\x01", 9);
  segment.resize(65537, 'x');
  jpeg.insert(2, segment + "\xFF\xFF");
  const fs::path path = Write("a.jpg", jpeg);
  EXPECT_EQ(ReadImageSize(path).width, 20);
  EXPECT_EQ(ReadImageSize(path).height, 10);
  EXPECT_EQ(ReadImage(path, 3).width, 20);
}

TEST(ImageFile, PaddingAfterTheLastPixelAndTheEndOfAJpegIsHarmless) {
  const std::string jpeg = EncodeJpeg(Gradient(20, 10, 1), "a.jpg", 80);
  const Pixels pixels = DecodeImage(jpeg, "a.jpg", 1).pixels;
  EXPECT_EQ(DecodeImage(jpeg + "trailer", "a.jpg", 1).pixels, pixels);
  std::string padded = jpeg;
  padded.insert(padded.size() - 2, std::string(8, '\0'));
  EXPECT_EQ(DecodeImage(padded, "a.jpg", 1).pixels, pixels);
}

TEST_F(ImageFileOnDisk, FaultsAreNamed) {
  const fs::path text = Write("a.jpg", "GIF89a, not a JPEG");
  ExpectUserError([&] { ReadImage(text, 3); }, {text.string(), "neither a JPEG nor a PNG"});
  ExpectUserError([&] { ReadImageSize(text); }, {text.string(), "neither a JPEG nor a PNG"});
  const fs::path empty = Write("b.jpg", "");
  ExpectUserError([&] { ReadImage(empty, 3); }, {empty.string()});
  ExpectUserError([&] { ReadImageSize(empty); }, {empty.string()});
  ExpectUserError([&] { ReadImage(folder_ / "none.png", 3); }, {"none.png", "no such file"});
  ExpectUserError([&] { ReadImage(folder_, 3); }, {folder_.string(), "folder"});
  const Image8 image = Gradient(4, 4, 3);
  ExpectUserError([&] { WriteImage(folder_ / "a.tiff", image); }, {"a.tiff", "'.tiff'", ".png"});
  ExpectUserError([&] { WriteImage(folder_ / "none" / "a.png", image); }, {"a.png"});
  const Image8 wide{65501, 1, 1, Pixels(65501)};
  ExpectUserError([&] { WriteImage(folder_ / "a.png", wide); }, {"a.png", "65501 x 1", "65500"});
}

using ImageFileBadInput = ImageFileOnDisk;

TEST_F(ImageFileBadInput, DecompressionBombs) {
  const ScopedAllocationLimit limit(1 << 20);
  const auto expect_refused = [&](const std::string& bytes, const char* problem) {
    ExpectUserError([&] { DecodeImage(bytes, "a.img", 3); }, {"a.img", problem});
  };
  const std::string row(2, '\0');
  expect_refused(MakePng(60000, 60000, 8, 2, row), "60000 x 60000 pixels; the bounds are");
  expect_refused(MakePng(20000, 13000, 8, 2, row), "too short");
  expect_refused(MakePng(20000, 13000, 1, 0, row), "too short");
  expect_refused(MakePng(0x7FFFFFFF, 1, 8, 0, row), "no valid PNG");
  expect_refused(MakePng(0, 1, 8, 0, row), "no valid PNG");
  const fs::path png = Write("a.png", MakePng(60000, 60000, 8, 2, row));
  ExpectUserError([&] { ReadImageSize(png); }, {png.string(), "60000 x 60000"});

  std::string jpeg = EncodeJpeg(Gradient(8, 8, 1), "a.jpg", 80);
  const size_t frame = jpeg.find("\xFF\xC0");
  ASSERT_NE(frame, std::string::npos);
  const auto with_size = [&](uint32_t width, uint32_t height) {
    return std::string(jpeg).replace(frame + 5, 4, BigEndian(height, 2) + BigEndian(width, 2));
  };
  EXPECT_EQ(DecodeImage(with_size(8, 8), "a.jpg", 3).width, 8);
  expect_refused(with_size(20000, 13000), "too short");
  expect_refused(with_size(65500, 65500), "65500 x 65500 pixels; the bounds are");
  expect_refused(with_size(65535, 8), "65500");
  expect_refused(with_size(8, 0), "no valid JPEG");
  const fs::path path = Write("a.jpg", with_size(65500, 65500));
  ExpectUserError([&] { ReadImageSize(path); }, {path.string(), "65500 x 65500"});
}

TEST_F(ImageFileBadInput, DamagedPngIsAlwaysRefused) {
  const std::string palette =
      Chunk("PLTE", std::string("\x01\x02\x03\xFA\xFB\xFC", 6)) + Chunk("tEXt", "a b");
  const std::string files[] = {
      MakePng(3, 2, 8, 0, std::string("\0\x01\x02\x03\0\x04\x05\xFF", 8)),
      MakePng(3, 1, 2, 3, std::string("\0\x44", 2), true, palette),
      EncodePng(Gradient(5, 4, 3), "a.png"),
  };
  for (const std::string& bytes : files) {
    const ScopedAllocationLimit limit(1 << 16);
    // Every byte of the file is part of the signature, a length, or what a checksum covers.
    ForEachDamage(bytes, [&](const std::string& damaged, const std::string& description) {
      ExpectUserError([&] { DecodeImage(damaged, "a.png", 1); }, {"a.png"}, description);
    });
  }
}

TEST_F(ImageFileBadInput, CutJpegIsAlwaysRefused) {
  for (const int channels : {1, 3}) {
    const std::string bytes = EncodeJpeg(Gradient(40, 24, channels), "a.jpg", 85);
    const ScopedAllocationLimit limit(1 << 20);
    for (size_t size = 0; size < bytes.size(); ++size) {
      ExpectUserError([&] { DecodeImage(bytes.substr(0, size), "a.jpg", 3); }, {"a.jpg"},
                      "cut to " + std::to_string(size) + " bytes");
    }
    // The end-of-image marker in the middle of the pixels.
    const std::string early_end = bytes.substr(0, bytes.size() - 30) + "\xFF\xD9";
    ExpectUserError([&] { DecodeImage(early_end, "a.jpg", 3); }, {"a.jpg"});
  }
}

TEST_F(ImageFileBadInput, FlippedJpegAndSizes) {
  const std::string bytes = EncodeJpeg(Gradient(16, 16, 3), "a.jpg", 50);
  const ScopedAllocationLimit limit(2 << 20);
  // JPEG has no checksum: a flipped bit may go unnoticed, but must not do harm.
  ForEachDamage(bytes, [&](const std::string& damaged, const std::string& description) {
    ExpectOkOrUserError([&] { DecodeImage(damaged, "a.jpg", 3); }, "a.jpg", description);
  });
  const std::string png = EncodePng(Gradient(3, 3, 1), "a.png");
  for (const std::string& file : {bytes.substr(0, 300), png}) {
    ForEachDamage(file, [&](const std::string& damaged, const std::string& description) {
      const fs::path path = Write("size", damaged);
      ExpectOkOrUserError([&] { ReadImageSize(path); }, path.string(), description);
    });
  }
}

}  // namespace
}  // namespace s2gs
