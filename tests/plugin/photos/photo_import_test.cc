#include "plugin/photos/photo_import.h"

#include <OpenImageIO/imageio.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <lcms2.h>
#include <sys/stat.h>

#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "plugin/photos/color_profile.h"
#include "plugin/photos/foreign_exif.h"
#include "plugin/photos/foreign_photo.h"
#include "plugin/photos/whole_file.h"
#include "s2gs/image/exif.h"
#include "sfm_split/base/error.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr int kWidth = 40;
constexpr int kHeight = 30;

Image8 Noise(int channels = 3) {
  Image8 image{kWidth, kHeight, channels, std::vector<uint8_t>(size_t{kWidth} * kHeight * channels)};
  for (size_t i = 0; i < image.pixels.size(); ++i)
    image.pixels[i] = static_cast<uint8_t>(i * 2654435761U >> 13U);
  return image;
}

std::string Number(uint32_t value, unsigned num_bytes) {
  std::string bytes;
  for (unsigned i = 0; i < num_bytes; ++i) bytes += static_cast<char>((value >> (8U * i)) & 0xFFU);
  return bytes;
}

std::string BigNumber(uint32_t value) {
  const std::string bytes = Number(value, 4);
  return {bytes.rbegin(), bytes.rend()};
}

double LightOf(uint8_t value) {
  const double v = value / 255.0;
  return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
}

class PhotoImportTest : public testing::Test {
 protected:
  template <typename T>
  void Write(const std::string& name, const std::vector<T>& values, OIIO::ImageSpec spec) const {
    fs::create_directories((photos_ / name).parent_path());
    const auto output = OIIO::ImageOutput::create((photos_ / name).string());
    ASSERT_TRUE(output) << OIIO::geterror();
    ASSERT_TRUE(output->open((photos_ / name).string(), spec)) << output->geterror();
    ASSERT_TRUE(output->write_image(OIIO::BaseTypeFromC<T>::value, values.data())) << output->geterror();
    ASSERT_TRUE(output->close()) << output->geterror();
  }
  void Write8(const std::string& name, const Image8& image) const {
    Write(name, image.pixels, {image.width, image.height, image.channels, OIIO::TypeDesc::UINT8});
  }
  void Write16(const std::string& name, const Image8& image) const {
    std::vector<uint16_t> values;
    for (const uint8_t value : image.pixels) values.push_back(static_cast<uint16_t>(value * 257));
    Write(name, values, {image.width, image.height, image.channels, OIIO::TypeDesc::UINT16});
  }
  void Import() {
    Reporter silent;
    fs::create_directories(workspace_.root);
    ImportPhotos(PlanImport(photos_.path()), workspace_, silent);
  }
  std::vector<std::string> Imported() const {
    std::vector<std::string> names;
    for (const auto& entry : fs::recursive_directory_iterator(workspace_.Imported())) {
      if (entry.is_regular_file())
        names.push_back(entry.path().lexically_relative(workspace_.Imported()).string());
    }
    std::sort(names.begin(), names.end());
    return names;
  }
  std::string ImportFault() {
    try {
      Import();
    } catch (const UserError& error) {
      return error.what();
    }
    return "";
  }

  TemporaryFolder photos_;
  TemporaryFolder base_;
  Workspace workspace_{base_ / "w"};
};

TEST_F(PhotoImportTest, SoundPhotosStayWhereTheyAre) {
  WriteImage(photos_ / "a.jpg", Noise());
  WriteImage(photos_ / "b.PNG", Noise());
  EXPECT_FALSE(PlanImport(photos_.path()).is_needed);
}

// One photo is enough, wherever it stands among those that could stay.
TEST_F(PhotoImportTest, OnePhotoThatNeedsItIsEnough) {
  Write16("a.png", Noise());
  WriteImage(photos_ / "b.jpg", Noise());
  EXPECT_TRUE(PlanImport(photos_.path()).is_needed);
}

TEST_F(PhotoImportTest, EveryFormatGivesTheSamePixels) {
  const Image8 image = Noise();
  Write8("sub/a.TIF", image);
  Write16("b.tiff", image);
  Write16("c.png", image);
  Write8("d.bmp", image);
  OIIO::ImageSpec lossless(kWidth, kHeight, 3, OIIO::TypeDesc::UINT8);
  lossless.attribute("compression", "webp:100");
  Write("e.webp", image.pixels, lossless);
  std::vector<float> light;
  for (const uint8_t value : image.pixels) light.push_back(static_cast<float>(LightOf(value)));
  Write("f.exr", light, {kWidth, kHeight, 3, OIIO::TypeDesc::FLOAT});
  WriteImage(photos_ / "g.png", image);
  WriteImage(photos_ / "h.jpg", image);
  fs::rename(photos_ / "h.jpg", photos_ / "h.jfif");
  const ImportPlan plan = PlanImport(photos_.path());
  EXPECT_TRUE(plan.is_needed);
  EXPECT_THAT(plan.faults, IsEmpty());
  Import();
  EXPECT_THAT(Imported(),
              ElementsAre("b.png", "c.png", "d.png", "e.png", "f.png", "g.png", "h.jpg", "sub/a.png"));
  for (const char* name : {"sub/a.png", "b.png", "c.png", "d.png", "f.png", "g.png"}) {
    EXPECT_EQ(ReadImage(workspace_.Imported() / name, 3).pixels, image.pixels) << name;
  }
  const Image8 jpeg = ReadImage(photos_ / "h.jfif", 3);
  EXPECT_EQ(ReadImage(workspace_.Imported() / "h.jpg", 3).pixels, jpeg.pixels);
  EXPECT_EQ(ReadImage(workspace_.Imported() / "e.png", 3).width, kWidth);
}

TEST_F(PhotoImportTest, SixteenBitsAreRounded) {
  // Half of a level of 8 bits, 128.5: just below and just above.
  const std::vector<uint16_t> values = {0, 128 * 257 + 128, 128 * 257 + 129, 65535};
  Write("a.tif", values, {4, 1, 1, OIIO::TypeDesc::UINT16});
  const ForeignPhoto photo = ReadForeignPhoto(photos_ / "a.tif");
  const std::vector<uint8_t> expected = {0, 0, 0, 128, 128, 128, 129, 129, 129, 255, 255, 255};
  EXPECT_EQ(photo.image.pixels, expected);
}

TEST_F(PhotoImportTest, TagsOrientationAndAlphaAreKept) {
  OIIO::ImageSpec spec(kWidth, kHeight, 4, OIIO::TypeDesc::UINT8);
  spec.attribute("Orientation", 6);
  spec.attribute("Exif:FocalLength", 4.25F);
  spec.attribute("Exif:DigitalZoomRatio", 1.5F);
  spec.attribute("oiio:UnassociatedAlpha", 1);
  Image8 image = Noise(4);
  Write("a.tif", image.pixels, spec);
  Import();
  const fs::path path = workspace_.Imported() / "a.png";
  const auto tags = ReadExif(path);
  ASSERT_TRUE(tags.has_value());
  EXPECT_EQ(tags->orientation, 6);
  EXPECT_NEAR(tags->focal_mm, 4.25, 1e-4);
  EXPECT_NEAR(tags->digital_zoom, 1.5, 1e-4);
  EXPECT_EQ(ReadImageSize(path).width, kWidth) << "pixels stay as stored";
  const Image8 mask = ReadMask(path);
  const Image8 photo = ReadImage(path, 3);
  for (size_t i = 0; i < mask.pixels.size(); ++i) {
    ASSERT_EQ(mask.pixels[i], image.pixels[4 * i + 3]) << i;
    ASSERT_EQ(photo.pixels[3 * i], image.pixels[4 * i]) << i;
  }
}

TEST_F(PhotoImportTest, MirroredPhotosAreMirroredBack) {
  const Image8 image = Noise();
  for (int orientation = 1; orientation <= 8; ++orientation) {
    ExifTags tags;
    tags.orientation = orientation;
    WritePng(photos_ / ("o" + std::to_string(orientation) + ".png"), image, MakeExif(tags));
  }
  Import();
  for (int orientation = 1; orientation <= 8; ++orientation) {
    const fs::path path = workspace_.Imported() / ("o" + std::to_string(orientation) + ".png");
    const auto tags = ReadExif(path);
    ASSERT_TRUE(tags.has_value());
    EXPECT_FALSE(IsMirrored(tags->orientation));
    EXPECT_EQ(TurnUpright(ReadImage(path, 3), tags->orientation).pixels,
              TurnUpright(image, orientation).pixels)
        << orientation;
    if (!IsMirrored(orientation)) {
      EXPECT_EQ(ReadImage(path, 3).pixels, image.pixels) << orientation;
    }
  }
}

// Adobe RGB (1998): its primaries, D65, gamma 563/256, here by the published matrix to linear sRGB.
TEST_F(PhotoImportTest, ProfilesAreConverted) {
  const cmsCIExyY white = {0.3127, 0.3290, 1};
  const cmsCIExyYTRIPLE primaries = {{0.64, 0.33, 1}, {0.21, 0.71, 1}, {0.15, 0.06, 1}};
  cmsToneCurve* curve = cmsBuildGamma(nullptr, 563.0 / 256);
  cmsToneCurve* curves[3] = {curve, curve, curve};
  cmsHPROFILE profile = cmsCreateRGBProfile(&white, &primaries, curves);
  cmsUInt32Number size = 0;
  cmsSaveProfileToMem(profile, nullptr, &size);
  std::vector<uint8_t> icc(size);
  cmsSaveProfileToMem(profile, icc.data(), &size);
  cmsCloseProfile(profile);
  cmsFreeToneCurve(curve);
  const std::vector<uint8_t> colors = {120, 120, 120, 200, 150, 120, 90, 110, 130, 60, 180, 100};
  OIIO::ImageSpec spec(4, 1, 3, OIIO::TypeDesc::UINT8);
  spec.attribute("ICCProfile", OIIO::TypeDesc(OIIO::TypeDesc::UINT8, static_cast<int>(size)), icc.data());
  Write("a.tif", colors, spec);
  const ForeignPhoto photo = ReadForeignPhoto(photos_ / "a.tif");
  EXPECT_THAT(photo.color, HasSubstr("to sRGB"));
  const double matrix[3][3] = {{1.39836, -0.39836, 0}, {0, 1, 0}, {0, -0.04293, 1.04293}};
  for (size_t i = 0; i < colors.size() / 3; ++i) {
    for (size_t row = 0; row < 3; ++row) {
      double light = 0;
      for (size_t c = 0; c < 3; ++c)
        light += matrix[row][c] * std::pow(colors[3 * i + c] / 255.0, 563.0 / 256);
      const double clipped = std::min(1.0, std::max(0.0, light));
      const double value =
          255 * (clipped <= 0.0031308 ? 12.92 * clipped : 1.055 * std::pow(clipped, 1 / 2.4) - 0.055);
      // Curves and matrices of the profile are rounded to 16 bits, pixels to 8.
      EXPECT_NEAR(photo.image.pixels[3 * i + row], value, 1.1) << i << " " << row;
    }
  }
}

// A box `colr` with a profile of 200 bytes, behind one that only names numbers and one that is cut off.
TEST(HeifProfileBadInput, FindsTheBoxThatHoldsAProfile) {
  std::string icc(200, 'p');
  icc.replace(36, 4, "acsp");
  const std::string box = std::string("\0\0\0\xD4", 4) + "colrprof" + icc;
  const std::string file = "ftypheic" + std::string("\0\0\0\x13", 4) + "colrnclx1234567" +
                           std::string("\xFF\xFF\xFF\xFF", 4) + "colrprof" + box;
  EXPECT_EQ(FindHeifProfile(file), icc);
  EXPECT_EQ(FindHeifProfile(file + "more"), icc);
  for (size_t length = 0; length < file.size(); ++length) {
    EXPECT_TRUE(FindHeifProfile(std::string_view(file).substr(0, length)).empty()) << length;
  }
  std::string other = file;
  other.replace(other.find("acsp"), 4, "none");
  EXPECT_TRUE(FindHeifProfile(other).empty());
  EXPECT_TRUE(FindHeifProfile("colrprof").empty());
}

TEST_F(PhotoImportTest, GoesOnWhereItWasAndRemovesWhatIsStale) {
  for (const char* name : {"a.tif", "b.tif", "c.tif"}) Write8(name, Noise());
  Import();
  const auto inode = [&](const char* name) {
    struct stat status = {};
    ::stat((workspace_.Imported() / name).c_str(), &status);
    return status.st_ino;
  };
  const auto a = inode("a.png");
  fs::remove(workspace_.Imported() / "b.png");
  fs::remove(photos_ / "c.tif");
  Import();
  EXPECT_EQ(inode("a.png"), a) << "made again";
  EXPECT_THAT(Imported(), ElementsAre("a.png", "b.png"));
  // A photo that changed is made again.
  Write8("a.tif", Noise(1));
  fs::last_write_time(photos_ / "a.tif", fs::file_time_type::clock::now() + std::chrono::seconds(5));
  Import();
  EXPECT_EQ(ReadImage(workspace_.Imported() / "a.png", 1).pixels, Noise(1).pixels);
}

TEST_F(PhotoImportTest, FilesOfOthersAreLeftAlone) {
  Write8("a.tif", Noise());
  base_.Write("w/imported/mine.png", "mine");
  EXPECT_THAT(ImportFault(), HasSubstr("was not put there by s2gs"));
  EXPECT_EQ(base_.Read("w/imported/mine.png"), "mine");
  EXPECT_THAT(Imported(), ElementsAre("mine.png"));
}

// A workspace from elsewhere may hold a link to the photos, and a record that calls them its own.
TEST_F(PhotoImportTest, PhotosBehindALinkAreNeitherRemovedNorReplaced) {
  base_.Write("w/images/a.png", "original");
  Write8("sub/a.tif", Noise());
  const std::string record = R"({"origin": "another", "photos": ["a.png", "sub/a.png", "sub/b.png"]})";
  base_.Write("w/s2gs/imported.json", record);
  fs::create_directories(workspace_.Imported());
  fs::create_directory_symlink("../images", workspace_.Imported() / "sub");
  EXPECT_THAT(ImportFault(), HasSubstr("imported/sub: is a symbolic link"));
  EXPECT_EQ(base_.Read("w/images/a.png"), "original");
  fs::remove_all(workspace_.Imported());
  fs::create_directory_symlink("images", workspace_.Imported());
  EXPECT_THAT(ImportFault(), HasSubstr("imported: is a symbolic link"));
  fs::remove(workspace_.Imported());
  fs::remove(workspace_.ImportRecord());
  fs::create_symlink("../images/a.png", workspace_.ImportRecord());
  EXPECT_THAT(ImportFault(), HasSubstr("imported.json: is a symbolic link"));
  EXPECT_EQ(base_.Read("w/images/a.png"), "original");
}

TEST_F(PhotoImportTest, ARecordOfWrongKindsIsNone) {
  Write8("a.tif", Noise());
  for (const char* record :
       {R"({"origin": 5, "photos": [7, {}]})", R"({"origin": null, "photos": {}})", "[]", "{", "7"}) {
    base_.Write("w/s2gs/imported.json", record);
    EXPECT_EQ(ImportFault(), "") << record;
    EXPECT_THAT(Imported(), ElementsAre("a.png"));
    fs::remove_all(workspace_.Imported());
  }
}

TEST_F(PhotoImportTest, ColoursAmongOtherChannelsAreFound) {
  OIIO::ImageSpec spec(2, 1, 12, OIIO::TypeDesc::UINT8);
  std::vector<uint8_t> values(24);
  for (size_t i = 0; i < values.size(); ++i) values[i] = static_cast<uint8_t>(10 * i);
  Write("a.tif", values, spec);
  const std::vector<uint8_t> expected = {0, 10, 20, 30, 120, 130, 140, 150};  // the fourth is alpha
  EXPECT_EQ(ReadForeignPhoto(photos_ / "a.tif").image.pixels, expected);
  spec.channelnames = {"G", "x1", "x2", "x3", "x4", "x5", "x6", "x7", "x8", "x9", "R", "B"};
  spec.format = OIIO::TypeDesc::HALF;
  Write("b.exr", values, spec);
  EXPECT_TRUE(ReadForeignPhoto(photos_ / "b.exr").image.pixels.size() == 6)
      << "OpenImageIO puts colours first";
}

TEST_F(PhotoImportTest, NumbersThatNoLensHasAreNone) {
  OIIO::ImageSpec spec(1, 1, 3, OIIO::TypeDesc::UINT8);
  spec.attribute("Exif:FocalLength", -4.0F);
  spec.attribute("Exif:FocalLengthIn35mmFilm", std::numeric_limits<float>::infinity());
  spec.attribute("Exif:DigitalZoomRatio", std::numeric_limits<float>::quiet_NaN());
  spec.attribute("Exif:FocalPlaneXResolution", 100.0F);
  spec.attribute("Exif:FocalPlaneResolutionUnit", 9);  // of no kind that EXIF has
  spec.attribute("Exif:PixelXDimension", -5);
  spec.attribute("Exif:PixelYDimension", 2000000000);
  spec.attribute("Orientation", 77);
  const ExifTags tags = TagsOf(spec);
  EXPECT_EQ(tags.focal_mm, 0);
  EXPECT_EQ(tags.focal_35mm_mm, 0);
  EXPECT_EQ(tags.digital_zoom, 0);
  EXPECT_EQ(tags.plane_px_per_mm, 0);
  EXPECT_THAT(tags.taken, ElementsAre(0, kMaxImageSide));
  EXPECT_EQ(tags.orientation, 1);
}

TEST_F(PhotoImportTest, NamesAllThatCannotBeUsedAtOnce) {
  Write8("a.tif", Noise());
  Write8("a.bmp", Noise());
  photos_.Write("text.heic", "no picture at all");
  photos_.Write("empty.exr", "");
  photos_.Write("raw.cr3", "no picture at all");
  const ImportPlan plan = PlanImport(photos_.path());
  EXPECT_TRUE(plan.is_needed);
  EXPECT_THAT(plan.faults, Contains(HasSubstr("under the same name")));
  EXPECT_THAT(plan.faults, Contains(HasSubstr("text.heic: cannot be read as a photo")));
  EXPECT_THAT(plan.faults, Contains(HasSubstr("empty.exr: is empty")));
  EXPECT_THAT(plan.faults, Contains(HasSubstr("darktable")));
  EXPECT_EQ(plan.faults.size(), 4U);
  EXPECT_THAT(ImportFault(), HasSubstr("text.heic"));
  EXPECT_FALSE(fs::exists(workspace_.Imported()));
}

// Before any pixel is decoded.
TEST_F(PhotoImportTest, EveryCutIsFound) {
  for (const char* name : {"a.tif", "a.webp", "a.bmp"}) {
    Write8(name, Noise());
    const std::string whole = photos_.Read(name);
    EXPECT_FALSE(EndsTooEarly(photos_ / name)) << name;
    // A TIFF may have its pixels first and be padded at its end.
    for (size_t length = 16; length + 2 < whole.size(); length += 1 + length / 8) {
      photos_.Write(name, whole.substr(0, length));
      EXPECT_TRUE(EndsTooEarly(photos_ / name)) << name << " of " << length << " bytes";
    }
  }
  // A folder of 65,535 tags, each with a million offsets: they are read once, not for hours.
  std::string tiff = "II*" + std::string(1, '\0') + Number(8, 4) + Number(65535, 2);
  for (int i = 0; i < 65535; ++i) tiff += Number(273, 2) + Number(4, 2) + Number(1 << 20, 4) + Number(8, 4);
  photos_.Write("tags.tif", tiff + std::string(size_t{1} << 22, '\0'));
  EXPECT_FALSE(EndsTooEarly(photos_ / "tags.tif"));
  const std::string box =
      std::string("\0\0\0\x0C", 4) + "ftypheic" + std::string("\0\0\0\x10", 4) + "mdat12345678";
  photos_.Write("a.heic", box);
  EXPECT_FALSE(EndsTooEarly(photos_ / "a.heic"));
  photos_.Write("a.heic", box.substr(0, box.size() - 1));
  EXPECT_TRUE(EndsTooEarly(photos_ / "a.heic"));
}

// Cameras keep a preview in the first folder of tags and the pixels at the file's end.
TEST_F(PhotoImportTest, EveryCutOfRawFilesIsFound) {
  using Tags = std::vector<std::array<uint32_t, 2>>;
  const auto folder = [](const Tags& tags, uint32_t next) {
    std::string bytes = Number(static_cast<uint32_t>(tags.size()), 2);
    for (const auto& [tag, value] : tags)
      bytes += Number(tag, 2) + Number(4, 2) + Number(1, 4) + Number(value, 4);
    return bytes + Number(next, 4);
  };
  const std::string zero(1, '\0');
  const auto tiff = [&](const std::string& magic, const Tags& first, uint32_t next, const Tags& second) {
    std::string bytes = magic + Number(8, 4) + folder(first, next);
    bytes.resize(100, '\0');
    bytes += folder(second, 0);
    bytes.resize(300, '\0');
    return bytes;
  };
  const Tags preview = {{273, 90}, {279, 8}};
  std::string raf = "FUJIFILMCCD-RAW " + std::string(68, ' ');
  for (const uint32_t offset : {110U, 160U, 200U})
    raf += BigNumber(offset) + BigNumber(offset == 200 ? 100 : 10);
  raf.resize(300, '\0');
  const std::map<std::string, std::string> whole = {
      {"sub.dng", tiff("II*" + zero, {{273, 90}, {279, 8}, {330, 100}}, 0, {{273, 200}, {279, 100}})},
      {"next.cr2", tiff("II*" + zero, preview, 100, {{273, 200}, {279, 100}})},
      {"tiles.dng", tiff("II*" + zero, {{330, 100}}, 0, {{324, 200}, {325, 100}})},
      {"jpeg.nef", tiff("II*" + zero, {{330, 100}}, 0, {{513, 200}, {514, 100}})},
      {"olympus.orf", tiff("IIRO", {{273, 200}, {279, 100}}, 0, {})},
      // 273 is no place in these.
      {"panasonic.rw2", tiff("IIU" + zero, {{273, 0xFFFFFFFF}, {279, 100}, {280, 200}}, 0, {})},
      // A folder that names itself is read once.
      {"loop.dng", tiff("II*" + zero, {{273, 200}, {279, 100}, {330, 8}}, 8, {})},
      {"fuji.raf", raf}};
  for (const auto& [name, bytes] : whole) {
    ASSERT_EQ(bytes.size(), 300U) << name;
    photos_.Write(name, bytes);
    EXPECT_FALSE(EndsTooEarly(photos_ / name)) << name;
    for (size_t length = 20; length < bytes.size(); ++length) {
      photos_.Write(name, bytes.substr(0, length));
      EXPECT_TRUE(EndsTooEarly(photos_ / name)) << name << " of " << length << " bytes";
    }
  }
}

TEST_F(PhotoImportTest, TruncatedPhotosAreNamedAndTheRestIsKept) {
  Write8("a.tif", Noise());
  for (const char* name : {"b.tif", "c.webp", "d.bmp"}) {
    Write8(name, Noise());
    const std::string whole = photos_.Read(name);
    photos_.Write(name, whole.substr(0, whole.size() * 2 / 3));
  }
  const std::string fault = ImportFault();
  for (const char* name : {"b.tif", "c.webp", "d.bmp"}) EXPECT_THAT(fault, HasSubstr(name));
  EXPECT_THAT(fault, testing::Not(HasSubstr("a.tif")));
}

}  // namespace
}  // namespace s2gs
