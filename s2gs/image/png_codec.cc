#include <png.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <csetjmp>
#include <cstdio>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

#include "s2gs/image/image_codec.h"
#include "sfm_split/base/error.h"

// libpng reports errors by a callback that must not return. Here it longjmps to the innermost function that
// called into libpng; such functions hold no C++ object of their own between setjmp and their end, and all
// that must be released belongs to a Decoder or Encoder outside them.

namespace s2gs {
namespace {

struct ErrorState {
  std::array<char, 256> message{};
};

[[noreturn]] void OnError(png_structp png, png_const_charp text) {
  auto& state = *static_cast<ErrorState*>(png_get_error_ptr(png));
  std::snprintf(state.message.data(), state.message.size(), "%s", text);
  png_longjmp(png, 1);
}

// What libpng merely warns about does not change a pixel; a bad checksum is an error below.
void OnWarning(png_structp /*png*/, png_const_charp /*text*/) {}

// --- Decoding ----------------------------------------------------------------------------------------------

struct Decoder {
  png_structp png = nullptr;
  png_infop info = nullptr;
  ErrorState errors;
  std::string_view unread;

  Decoder() = default;
  Decoder(const Decoder&) = delete;
  Decoder& operator=(const Decoder&) = delete;
  ~Decoder() { png_destroy_read_struct(&png, &info, nullptr); }
};

void OnRead(png_structp png, png_bytep target, size_t count) {
  auto& decoder = *static_cast<Decoder*>(png_get_io_ptr(png));
  if (count > decoder.unread.size()) png_error(png, "the file ends too early");
  std::memcpy(target, decoder.unread.data(), count);
  decoder.unread.remove_prefix(count);
}

// The next two return false with errors.message set.
bool ReadHeader(Decoder& decoder) {
  decoder.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &decoder.errors, OnError, OnWarning);
  if (decoder.png == nullptr) return false;
  png_structp png = decoder.png;
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  decoder.info = png_create_info_struct(png);
  if (decoder.info == nullptr) return false;
  png_set_read_fn(png, &decoder, OnRead);
  png_set_crc_action(png, PNG_CRC_ERROR_QUIT, PNG_CRC_ERROR_QUIT);
  // Leave alone every chunk that no pixel depends on: texts, colour profiles, gamma.
  png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_NEVER, nullptr, -1);
  png_set_user_limits(png, kMaxImageSide, kMaxImageSide);
  png_read_info(png, decoder.info);
  return true;
}

// \param channels  1 grey, 3 RGB, 4 RGB and alpha, which the file must have.
bool ReadPixels(Decoder& decoder, int channels, png_bytepp rows) {
  png_structp png = decoder.png;
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  png_set_expand(png);
  png_set_scale_16(png);
  if (channels < 4) png_set_strip_alpha(png);
  if (channels > 1) png_set_gray_to_rgb(png);
  png_set_interlace_handling(png);
  png_read_update_info(png, decoder.info);
  const size_t expected_bytes =
      static_cast<size_t>(png_get_image_width(png, decoder.info)) * png_get_channels(png, decoder.info);
  if (png_get_rowbytes(png, decoder.info) != expected_bytes) png_error(png, "unexpected size of a row");
  png_read_image(png, rows);
  png_read_end(png, nullptr);
  return true;
}

// --- Encoding ----------------------------------------------------------------------------------------------

struct Encoder {
  png_structp png = nullptr;
  png_infop info = nullptr;
  ErrorState errors;
  std::string bytes;

  Encoder() = default;
  Encoder(const Encoder&) = delete;
  Encoder& operator=(const Encoder&) = delete;
  ~Encoder() { png_destroy_write_struct(&png, &info); }
};

void OnWrite(png_structp png, png_bytep bytes, size_t count) {
  static_cast<Encoder*>(png_get_io_ptr(png))->bytes.append(reinterpret_cast<const char*>(bytes), count);
}

void OnFlush(png_structp /*png*/) {}

bool Encode(Encoder& encoder, const Image8& image, std::string_view exif) {
  encoder.png = png_create_write_struct(PNG_LIBPNG_VER_STRING, &encoder.errors, OnError, OnWarning);
  if (encoder.png == nullptr) return false;
  png_structp png = encoder.png;
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  encoder.info = png_create_info_struct(png);
  if (encoder.info == nullptr) return false;
  png_set_write_fn(png, &encoder, OnWrite, OnFlush);
  const int color_type = image.channels == 1   ? PNG_COLOR_TYPE_GRAY
                         : image.channels == 3 ? PNG_COLOR_TYPE_RGB
                                               : PNG_COLOR_TYPE_RGB_ALPHA;
  png_set_IHDR(png, encoder.info, static_cast<png_uint_32>(image.width),
               static_cast<png_uint_32>(image.height), 8, color_type, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  constexpr int kCompressionLevel = 2;
  png_set_compression_level(png, kCompressionLevel);
  png_set_filter(png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
  png_write_info(png, encoder.info);
  if (!exif.empty()) {
    png_write_chunk(png, reinterpret_cast<png_const_bytep>("eXIf"),
                    reinterpret_cast<png_const_bytep>(exif.data()), exif.size());
  }
  for (int y = 0; y < image.height; ++y) png_write_row(png, image.Pixel(0, y));
  png_write_end(png, nullptr);
  return true;
}

}  // namespace

// --- Decoding, continued -----------------------------------------------------------------------------------

namespace {

// The header, and no more pixels than the file can hold.
ImageSize BeginDecoding(std::string_view bytes, const std::filesystem::path& path, Decoder* decoder) {
  decoder->unread = bytes;
  if (!ReadHeader(*decoder)) {
    ThrowDamagedImage(path, std::string("is no valid PNG file: ") + decoder->errors.message.data());
  }
  const uint64_t width = png_get_image_width(decoder->png, decoder->info);
  const uint64_t height = png_get_image_height(decoder->png, decoder->info);
  CheckImageSize(width, height, path);
  // Deflate cannot expand by more than 1032.
  constexpr uint64_t kMaxExpansion = 1032;
  const uint64_t packed_bytes = height * png_get_rowbytes(decoder->png, decoder->info);
  if (packed_bytes / kMaxExpansion > bytes.size()) {
    ThrowDamagedImage(path, "is too short (" + std::to_string(bytes.size()) + " bytes) for its " +
                                std::to_string(width) + " x " + std::to_string(height) + " pixels");
  }
  return {static_cast<int>(width), static_cast<int>(height)};
}

Image8 FinishDecoding(const std::filesystem::path& path, const ImageSize& size, int channels,
                      Decoder* decoder) {
  Image8 image{size.width, size.height, channels, {}};
  const size_t row_bytes = static_cast<size_t>(size.width) * channels;
  image.pixels.resize(row_bytes * size.height);
  std::vector<png_bytep> rows(size.height);
  for (int y = 0; y < size.height; ++y) rows[y] = image.pixels.data() + y * row_bytes;
  if (!ReadPixels(*decoder, channels, rows.data())) {
    ThrowDamagedImage(path, std::string("cannot be decoded as PNG: ") + decoder->errors.message.data());
  }
  return image;
}

}  // namespace

Image8 DecodePng(std::string_view bytes, const std::filesystem::path& path, int channels) {
  Decoder decoder;
  const ImageSize size = BeginDecoding(bytes, path, &decoder);
  const bool is_grey = (png_get_color_type(decoder.png, decoder.info) & PNG_COLOR_MASK_COLOR) == 0;
  const int decoded_channels = is_grey && channels == 1 ? 1 : 3;
  Image8 image = FinishDecoding(path, size, decoded_channels, &decoder);
  if (decoded_channels == 3 && channels == 1) return GreyImage(image);
  image.channels = channels;
  return image;
}

std::optional<Image8> DecodePngAlpha(std::string_view bytes, const std::filesystem::path& path) {
  Decoder decoder;
  const ImageSize size = BeginDecoding(bytes, path, &decoder);
  const bool has_alpha = (png_get_color_type(decoder.png, decoder.info) & PNG_COLOR_MASK_ALPHA) != 0 ||
                         png_get_valid(decoder.png, decoder.info, PNG_INFO_tRNS) != 0;
  if (!has_alpha) return std::nullopt;
  Image8 image = FinishDecoding(path, size, 4, &decoder);
  const size_t num_pixels = image.pixels.size() / 4;
  for (size_t i = 0; i < num_pixels; ++i) image.pixels[i] = image.pixels[4 * i + 3];
  image.pixels.resize(num_pixels);
  image.channels = 1;
  return image;
}

ImageSize ReadPngSize(ByteReader& reader, PngPixels* pixels) {
  // Signature, then the first chunk: length, type, width, height, five bytes more, checksum from the type on.
  std::array<uint8_t, 33> header{};
  reader.ReadBytes(header.data(), header.size(), "the PNG header");
  const auto number = [&header](size_t at) {
    return static_cast<uint32_t>(header[at]) << 24 | static_cast<uint32_t>(header[at + 1]) << 16 |
           static_cast<uint32_t>(header[at + 2]) << 8 | static_cast<uint32_t>(header[at + 3]);
  };
  if (number(8) != 13 || std::memcmp(header.data() + 12, "IHDR", 4) != 0) {
    reader.Fail("a PNG file must begin with its header chunk");
  }
  if (crc32(0, header.data() + 12, 17) != number(29)) reader.Fail("the PNG header's checksum is wrong");
  CheckImageSize(number(16), number(20), reader.path());
  // Bits of a channel, then the colour type: 4 adds alpha to grey and to colours.
  if (pixels != nullptr) *pixels = {header[24], (header[25] & PNG_COLOR_MASK_ALPHA) != 0};
  return {static_cast<int>(number(16)), static_cast<int>(number(20))};
}

std::string EncodePng(const Image8& image, const std::filesystem::path& path, std::string_view exif) {
  Encoder encoder;
  if (!Encode(encoder, image, exif)) {
    throw UserError(path, std::string("cannot be encoded as PNG: ") + encoder.errors.message.data(), "");
  }
  return std::move(encoder.bytes);
}

}  // namespace s2gs
