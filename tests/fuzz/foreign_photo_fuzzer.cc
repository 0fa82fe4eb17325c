// What is done with the bytes and the metadata of photos that OpenImageIO reads: the first byte of the input
// chooses between a file that may end too early, the search for a block of EXIF, attributes of any type, and
// a sound TIFF with the attributes and the colour profile that the rest of the input gives it.

#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <vector>

#include "plugin/photos/foreign_exif.h"
#include "plugin/photos/foreign_photo.h"
#include "plugin/photos/whole_file.h"
#include "sfm_split/base/error.h"
#include "tests/fuzz/fuzz_seeds.h"
#include "tests/fuzz/scratch_path.h"

namespace {

using OIIO::ImageSpec;
using OIIO::TypeDesc;

constexpr std::array<const char*, 9> kNames = {"Exif:FocalLength",
                                               "Exif:FocalLengthIn35mmFilm",
                                               "Exif:DigitalZoomRatio",
                                               "Exif:FocalPlaneXResolution",
                                               "Exif:FocalPlaneResolutionUnit",
                                               "Exif:PixelXDimension",
                                               "Exif:PixelYDimension",
                                               "Orientation",
                                               "ICCProfile"};

class Input {
 public:
  Input(const uint8_t* data, size_t size) : data_(data), size_(size) {}
  bool IsEmpty() const { return size_ == 0; }
  uint8_t Byte() {
    if (size_ == 0) return 0;
    --size_;
    return *data_++;
  }
  template <typename T>
  T Value() {
    T value{};
    const size_t count = std::min(size_, sizeof(T));
    std::memcpy(&value, data_, count);
    data_ += count;
    size_ -= count;
    return value;
  }
  std::string_view Rest() const { return {reinterpret_cast<const char*>(data_), size_}; }

 private:
  const uint8_t* data_;
  size_t size_;
};

// Attributes of the types that readers give; a colour profile is the rest of the input.
void AddAttributes(Input& input, ImageSpec* spec) {
  while (!input.IsEmpty()) {
    const char* name = kNames[input.Byte() % kNames.size()];
    if (std::string_view(name) == "ICCProfile") {
      const std::string_view bytes = input.Rest();
      if (bytes.empty()) return;
      spec->attribute(name, TypeDesc(TypeDesc::UINT8, static_cast<int>(bytes.size())), bytes.data());
      return;
    }
    switch (input.Byte() % 5) {
      case 0:
        spec->attribute(name, input.Value<float>());
        break;
      case 1:
        spec->attribute(name, input.Value<int32_t>());
        break;
      case 2: {
        const auto value = input.Value<uint16_t>();
        spec->attribute(name, TypeDesc::UINT16, &value);
        break;
      }
      case 3: {
        const auto value = input.Value<std::array<uint32_t, 2>>();
        spec->attribute(name, TypeDesc(TypeDesc::UINT32, TypeDesc::VEC2, TypeDesc::RATIONAL), value.data());
        break;
      }
      default:
        spec->attribute(name, std::string(input.Rest().substr(0, input.Byte())));
    }
  }
}

void CheckTags(const s2gs::ExifTags& tags) {
  bool is_sound = tags.orientation >= 1 && tags.orientation <= 8 && tags.taken[0] >= 0 && tags.taken[1] >= 0;
  for (const double value : {tags.focal_mm, tags.focal_35mm_mm, tags.digital_zoom, tags.plane_px_per_mm}) {
    is_sound = is_sound && std::isfinite(value) && value >= 0;
  }
  if (!is_sound || !s2gs::ParseExif(s2gs::MakeExif(tags))) std::abort();
}

void ReadTiff(Input& input) {
  constexpr int kMaxChannels = 5;
  const int width = 1 + input.Byte() % 9;
  const int height = 1 + input.Byte() % 9;
  const int channels = 1 + input.Byte() % kMaxChannels;
  constexpr std::array<TypeDesc::BASETYPE, 3> kTypes = {TypeDesc::UINT8, TypeDesc::UINT16, TypeDesc::FLOAT};
  const TypeDesc::BASETYPE type = kTypes[input.Byte() % kTypes.size()];
  ImageSpec spec(width, height, channels, type);
  AddAttributes(input, &spec);
  const std::filesystem::path path = s2gs::ScratchPath("photo.tif");
  const auto output = OIIO::ImageOutput::create(path.string());
  const std::vector<float> pixels(static_cast<size_t>(width) * height * channels, 0.5F);
  if (!output || !output->open(path.string(), spec)) return;
  output->write_image(TypeDesc::FLOAT, pixels.data());
  output->close();
  try {
    const s2gs::ForeignPhoto photo = s2gs::ReadForeignPhoto(path);
    CheckTags(photo.tags);
    if (photo.image.pixels.size() != static_cast<size_t>(width) * height * photo.image.channels) std::abort();
  } catch (const s2gs::UserError&) {
  }
}

}  // namespace

std::vector<std::string> FuzzSeeds() {
  const std::string tiff = std::string("II*\0\x08\0\0\0", 8) + std::string("\2\0", 2) +
                           std::string("\x11\1\4\0\1\0\0\0\x08\0\0\0", 12) +
                           std::string("\x17\1\4\0\2\0\0\0\x26\0\0\0", 12) + std::string(16, '\1');
  // A folder below and one after the first, Panasonic's places, Fujifilm's parts.
  const std::string raw = std::string("II*\0\x08\0\0\0", 8) +
                          std::string("\1\0\x4A\1\4\0\1\0\0\0\x1A\0\0\0\x1A\0\0\0", 18) + tiff.substr(8);
  const std::string panasonic =
      "IIU" + tiff.substr(3, 7) + std::string("\x18\1\4\0\1\0\0\0\x08\0\0\0", 12) + tiff.substr(22);
  const std::string fujifilm = "FUJIFILMCCD-RAW " + std::string(92, '\0');
  const std::string heic = std::string(
                               "\0\0\0\x10"
                               "ftypheic\0\0\0\0",
                               16) +
                           std::string("\0\0\0\0mdat", 8) + std::string("\0\0\0\6Exif\0\0", 10) +
                           s2gs::MakeExif({});
  const std::string webp = std::string("RIFF\x28\0\0\0WEBPEXIF\x20\0\0\0", 20) + s2gs::MakeExif({});
  const std::string attributes("\0\0\0\0\x80\x40\1\1\x1A\0\0\0\3\3\1\0\0\0\2\0\0\0\7\2\6\0", 26);
  return {std::string(1, '\0') + tiff,
          std::string(1, '\0') + raw,
          std::string(1, '\0') + panasonic,
          std::string(1, '\0') + fujifilm,
          std::string(1, '\0') + heic,
          std::string(1, '\0') + webp,
          std::string(1, '\1') + heic,
          std::string(1, '\1') + webp,
          std::string(1, '\2') + attributes,
          std::string("\3\4\4\2\0", 5) + attributes,
          std::string("\3\4\4\0\1\x08", 6) + std::string(128, '\0')};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  Input input(data, size);
  switch (input.Byte() % 4) {
    case 0: {
      const std::filesystem::path path = s2gs::ScratchPath("photo.bin");
      std::ofstream(path, std::ios::binary)
          .write(input.Rest().data(), static_cast<std::streamsize>(input.Rest().size()));
      s2gs::EndsTooEarly(path);
      break;
    }
    case 1:
      for (const bool is_heif : {false, true}) {
        const auto tags = s2gs::FindExif(input.Rest(), is_heif);
        if (tags) CheckTags(*tags);
      }
      break;
    case 2: {
      ImageSpec spec(4, 4, 3, TypeDesc::UINT8);
      AddAttributes(input, &spec);
      CheckTags(s2gs::TagsOf(spec));
      break;
    }
    default:
      ReadTiff(input);
  }
  return 0;
}
