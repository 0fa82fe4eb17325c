#include <OpenImageIO/imageio.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <string_view>
#include <vector>

#include "plugin/photos/color_profile.h"
#include "plugin/photos/foreign_exif.h"
#include "plugin/photos/foreign_photo.h"
#include "plugin/photos/whole_file.h"
#include "s2gs/image/image_codec.h"
#include "s2gs/image/srgb.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/lower_case.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using OIIO::ImageInput;
using OIIO::ImageSpec;
using OIIO::TypeDesc;

constexpr uint64_t kMaxFileBytes = uint64_t{1} << 32;
constexpr uint64_t kMaxSearchedBytes = uint64_t{1} << 28;  // for a profile or EXIF
constexpr size_t kMaxChannels = 8;                         // those of a photo and some between them

bool IsHeif(const fs::path& path) {
  const std::string extension = LowerCaseExtension(path);
  return extension == ".heic" || extension == ".heif" || extension == ".avif";
}

std::string WhatReads(const fs::path& path) {
  const std::string extension = LowerCaseExtension(path);
  if (IsHeif(path)) return "If heif-convert reads it, give its JPEG";
  if (extension == ".jxl") return "Convert it with djxl";
  if (extension == ".cr3") return "Develop it with darktable-cli, or with the camera's own program";
  return "Copy it again; if another program opens it, save it there as JPEG or PNG";
}

[[noreturn]] void Fail(const fs::path& path, const std::string& problem) {
  std::string line = problem.substr(0, problem.find('\n'));
  std::replace_if(
      line.begin(), line.end(), [](unsigned char c) { return std::iscntrl(c) != 0; }, ' ');
  throw UserError(path, "cannot be read as a photo" + (line.empty() ? "" : " (" + line + ")"),
                  WhatReads(path));
}

// Libraries below OpenImageIO trust lengths in files: no more is asked of them than the file can hold.
std::unique_ptr<ImageInput> Open(const fs::path& path, ImageSpec* spec) {
  std::error_code ec;
  if (!fs::is_regular_file(path, ec)) throw UserError(path, "is no regular file", "Remove it");
  const uint64_t num_bytes = fs::file_size(path, ec);
  if (num_bytes == 0) throw UserError(path, "is empty", "Copy it again, or remove it");
  if (num_bytes > kMaxFileBytes) throw UserError(path, "has more than 4 GB", "Reduce the photo");
  if (EndsTooEarly(path)) throw UserError(path, "ends before its pixels do", "Copy it again, or remove it");
  ImageSpec config;
  config.attribute("oiio:UnassociatedAlpha", 1);  // colours as they are, not multiplied by alpha
  std::unique_ptr<ImageInput> input;
  try {
    input = ImageInput::open(path.string(), &config);
  } catch (const std::exception& error) {  // of the libraries below it
    Fail(path, error.what());
  }
  if (!input) Fail(path, OIIO::geterror());
  *spec = input->spec();
  if (spec->width <= 0 || spec->height <= 0 || spec->depth > 1 || spec->nchannels < 1 || spec->deep) {
    Fail(path, "it holds no plain picture");
  }
  CheckImageSize(static_cast<uint64_t>(spec->width), static_cast<uint64_t>(spec->height), path);
  return input;
}

// Which channels are red, green, blue and alpha; -1 for no alpha. One grey channel is all three.
std::array<int, 4> FindChannels(const ImageSpec& spec) {
  const auto named = [&](const char* name) {
    const auto found = std::find(spec.channelnames.begin(), spec.channelnames.end(), name);
    return found == spec.channelnames.end() ? -1 : static_cast<int>(found - spec.channelnames.begin());
  };
  std::array<int, 4> channels = {named("R"), named("G"), named("B"), spec.alpha_channel};
  if (channels[0] < 0 || channels[1] < 0 || channels[2] < 0) {
    if (spec.nchannels >= 3) {
      std::copy_n(std::array<int, 3>{0, 1, 2}.begin(), 3, channels.begin());
    } else {
      std::fill_n(channels.begin(), 3, std::max(named("Y"), 0));
    }
  }
  return channels;
}

uint8_t EncodeLight(float value) {
  if (!(value > 0)) return 0;  // NaN, too
  return static_cast<uint8_t>(std::lround(255 * SrgbFromLight(std::min<double>(value, 1))));
}

bool IsProportionalToLight(const ImageSpec& spec) {
  const OIIO::string_view space = spec.get_string_attribute("oiio:ColorSpace");
  const bool is_float = spec.format.is_floating_point();
  return is_float && space != "sRGB" && space != "Rec709";
}

// The channels in a row that hold all that a photo is made of.
struct ChannelRange {
  int begin = 0;
  int end = 0;
  size_t count() const { return static_cast<size_t>(end - begin); }
};

ChannelRange RangeOf(const ImageSpec& spec) {
  ChannelRange range{spec.nchannels, 0};
  for (const int channel : FindChannels(spec)) {
    if (channel < 0) continue;
    range.begin = std::min(range.begin, channel);
    range.end = std::max(range.end, channel + 1);
  }
  return range;
}

template <typename T>
std::vector<T> ReadPixels(ImageInput& input, const ImageSpec& spec, TypeDesc type, const fs::path& path) {
  const ChannelRange range = RangeOf(spec);
  if (range.count() > kMaxChannels) Fail(path, "its colours lie among too many other channels");
  std::vector<T> pixels(static_cast<size_t>(spec.width) * spec.height * range.count());
  bool is_read = false;
  try {
    is_read = input.read_image(0, 0, range.begin, range.end, type, pixels.data());
  } catch (const std::exception& error) {
    Fail(path, error.what());
  }
  if (!is_read) Fail(path, input.geterror());
  // Some readers only warn of missing data.
  if (input.has_error()) Fail(path, input.geterror());
  return pixels;
}

// Puts red, green, blue and, where there is one, alpha of ReadPixels() through `convert(value, alpha?)`.
template <typename T, typename Convert>
Image8 Pick(const std::vector<T>& pixels, const ImageSpec& spec, const Convert& convert) {
  const ChannelRange range = RangeOf(spec);
  const std::array<int, 4> from = FindChannels(spec);
  const int channels = from[3] >= 0 ? 4 : 3;
  Image8 image{spec.width, spec.height, channels, {}};
  const size_t count = static_cast<size_t>(spec.width) * spec.height;
  image.pixels.resize(count * channels);
  for (size_t i = 0; i < count; ++i) {
    for (int c = 0; c < channels; ++c) {
      image.pixels[i * channels + c] = convert(pixels[i * range.count() + (from[c] - range.begin)], c == 3);
    }
  }
  return image;
}

void DropOpaqueAlpha(Image8* image) {
  if (image->channels != 4) return;
  const size_t count = image->pixels.size() / 4;
  for (size_t i = 0; i < count; ++i) {
    if (image->pixels[4 * i + 3] != 255) return;
  }
  for (size_t i = 0; i < count; ++i) std::memmove(&image->pixels[3 * i], &image->pixels[4 * i], 3);
  image->pixels.resize(3 * count);
  image->channels = 3;
}

// Empty when the file has none. OpenImageIO 2.4 does not give that of HEIC and AVIF.
std::string ProfileOf(const ImageSpec& spec, const fs::path& path) {
  const OIIO::ParamValue* icc = spec.find_attribute("ICCProfile");
  if (icc != nullptr && icc->datasize() > 0) {
    return {static_cast<const char*>(icc->data()), static_cast<size_t>(icc->datasize())};
  }
  return IsHeif(path) ? std::string(FindHeifProfile(ReadWholeFile(path, kMaxSearchedBytes))) : "";
}

// The block of EXIF wherever a HEIC, AVIF or WebP file keeps it.
std::optional<ExifTags> SearchExif(const fs::path& path) {
  return FindExif(ReadWholeFile(path, kMaxSearchedBytes), IsHeif(path));
}

}  // namespace

std::optional<std::string> WhyNoForeignPhotos() { return std::nullopt; }

ImageSize ReadForeignSize(const fs::path& path) {
  ImageSpec spec;
  Open(path, &spec);
  return {spec.width, spec.height};
}

ForeignPhoto ReadForeignPhoto(const fs::path& path) {
  ImageSpec spec;
  const std::unique_ptr<ImageInput> input = Open(path, &spec);
  ForeignPhoto photo;
  if (IsProportionalToLight(spec)) {
    const std::vector<float> pixels = ReadPixels<float>(*input, spec, TypeDesc::FLOAT, path);
    photo.image = Pick(pixels, spec, [](float value, bool is_alpha) {
      return is_alpha ? static_cast<uint8_t>(std::lround(255 * std::clamp(value, 0.0F, 1.0F)))
                      : EncodeLight(value);
    });
    photo.color = "proportional to light, 1 is white";
  } else if (spec.format == TypeDesc::UINT8) {
    const std::vector<uint8_t> pixels = ReadPixels<uint8_t>(*input, spec, TypeDesc::UINT8, path);
    photo.image = Pick(pixels, spec, [](uint8_t value, bool /*is_alpha*/) { return value; });
  } else {
    const std::vector<uint16_t> pixels = ReadPixels<uint16_t>(*input, spec, TypeDesc::UINT16, path);
    photo.image = Pick(pixels, spec, [](uint16_t value, bool /*is_alpha*/) {
      return static_cast<uint8_t>((uint32_t{value} * 255U + 32767U) / 65535U);
    });
  }
  if (photo.color.empty()) photo.color = ConvertToSrgb(ProfileOf(spec, path), &photo.image);
  DropOpaqueAlpha(&photo.image);
  photo.tags = TagsOf(spec);
  if (!photo.tags.SaysOfLens() && photo.tags.orientation == 1) {
    const std::string extension = LowerCaseExtension(path);
    const std::optional<ExifTags> found = IsHeif(path) || extension == ".webp" ? SearchExif(path)
                                          : extension == ".png"                ? ReadExif(path)
                                                                               : std::nullopt;
    if (found) photo.tags = *found;
  }
  // Their files say by themselves how to turn the pixels, and the decoder does.
  if (IsHeif(path)) photo.tags.orientation = 1;
  return photo;
}

}  // namespace s2gs
