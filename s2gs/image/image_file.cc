#include "s2gs/image/image_file.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "s2gs/image/image_codec.h"
#include "s2gs/image/image_header.h"
#include "sfm_split/base/byte_reader.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/lower_case.h"

namespace s2gs {
namespace {

constexpr std::string_view kJpegBegin = "\xFF\xD8\xFF";
constexpr std::string_view kPngBegin = "\x89PNG\r\n\x1A\n";

enum class Kind { kJpeg, kPng };

Kind KindOf(std::string_view begin, const std::filesystem::path& path) {
  if (begin.substr(0, kJpegBegin.size()) == kJpegBegin) return Kind::kJpeg;
  if (begin.substr(0, kPngBegin.size()) == kPngBegin) return Kind::kPng;
  throw UserError(path, "is neither a JPEG nor a PNG file",
                  "Convert it to one of them, or remove it from the image folder");
}

}  // namespace

void CheckImageSize(uint64_t width, uint64_t height, const std::filesystem::path& path) {
  if (width == 0 || height == 0) ThrowDamagedImage(path, "has no pixels by its header");
  if (width > kMaxImageSide || height > kMaxImageSide ||
      width * height > static_cast<uint64_t>(kMaxImagePixels)) {
    throw UserError(path,
                    "has " + std::to_string(width) + " x " + std::to_string(height) +
                        " pixels; the bounds are " + std::to_string(kMaxImageSide) + " pixels a side and " +
                        std::to_string(kMaxImagePixels) + " in all",
                    "Reduce the image, or restore it if it is damaged");
  }
}

void ThrowDamagedImage(const std::filesystem::path& path, const std::string& problem) {
  throw UserError(path, problem, "The image is damaged: restore it, or remove it from the image folder");
}

Image8 DecodeImage(std::string_view bytes, const std::filesystem::path& path, int channels) {
  S2GS_INVARIANT(channels == 1 || channels == 3);
  return KindOf(bytes, path) == Kind::kJpeg ? DecodeJpeg(bytes, path, channels)
                                            : DecodePng(bytes, path, channels);
}

Image8 ReadImage(const std::filesystem::path& path, int channels) {
  return DecodeImage(ReadWholeFile(path, kMaxImageBytes), path, channels);
}

Image8 ReadMask(const std::filesystem::path& path) {
  const std::string bytes = ReadWholeFile(path, kMaxImageBytes);
  if (KindOf(bytes, path) == Kind::kPng) {
    std::optional<Image8> alpha = DecodePngAlpha(bytes, path);
    const auto is_opaque = [](uint8_t value) { return value == 255; };
    if (alpha && !std::all_of(alpha->pixels.begin(), alpha->pixels.end(), is_opaque))
      return *std::move(alpha);
  }
  return DecodeImage(bytes, path, 1);
}

ImageHeader ReadImageHeader(const std::filesystem::path& path) {
  std::ifstream stream = OpenForReading(path);
  std::string begin(kPngBegin.size(), '\0');
  stream.read(begin.data(), static_cast<std::streamsize>(begin.size()));
  stream.clear();
  stream.seekg(0);
  const Kind kind = KindOf(begin, path);
  ByteReader reader(stream, path);
  ImageHeader header;
  header.is_jpeg = kind == Kind::kJpeg;
  const uint64_t num_bytes = reader.remaining();
  header.size = header.is_jpeg ? ReadJpegSize(reader) : ReadPngSize(reader, &header.png);
  header.num_bytes = num_bytes - reader.remaining();
  return header;
}

ImageSize ReadImageSize(const std::filesystem::path& path) { return ReadImageHeader(path).size; }

void WritePng(const std::filesystem::path& path, const Image8& image, std::string_view exif) {
  CheckImageSize(static_cast<uint64_t>(image.width), static_cast<uint64_t>(image.height), path);
  S2GS_INVARIANT(image.pixels.size() == static_cast<size_t>(image.width) * image.height * image.channels);
  const std::string bytes = EncodePng(image, path, exif);
  WriteFileAtomically(path, [&](std::ostream& stream) {
    stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  });
}

void WriteImage(const std::filesystem::path& path, const Image8& image, int jpeg_quality) {
  S2GS_INVARIANT(image.channels == 1 || image.channels == 3 || image.channels == 4);
  S2GS_INVARIANT(jpeg_quality >= 1 && jpeg_quality <= 100);
  CheckImageSize(static_cast<uint64_t>(image.width), static_cast<uint64_t>(image.height), path);
  S2GS_INVARIANT(image.pixels.size() == static_cast<size_t>(image.width) * image.height * image.channels);
  const std::string extension = LowerCaseExtension(path);
  std::string bytes;
  if (extension == ".png") {
    bytes = EncodePng(image, path);
  } else if (image.channels < 4 && (extension == ".jpg" || extension == ".jpeg")) {
    bytes = EncodeJpeg(image, path, jpeg_quality);
  } else {
    throw UserError(path, "cannot be written as an image: '" + extension + "' is no known extension",
                    "Use .png, .jpg or .jpeg");
  }
  WriteFileAtomically(path, [&](std::ostream& stream) {
    stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  });
}

Image8 GreyImage(const Image8& rgb) {
  Image8 grey{rgb.width, rgb.height, 1, {}};
  grey.pixels.resize(static_cast<size_t>(rgb.width) * rgb.height);
  for (size_t i = 0; i < grey.pixels.size(); ++i) grey.pixels[i] = GreyFromRgb(&rgb.pixels[3 * i]);
  return grey;
}

}  // namespace s2gs
