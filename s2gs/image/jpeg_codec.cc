#include <array>
#include <csetjmp>
#include <cstdio>
#include <cstdlib>
#include <string>

#include "s2gs/image/image_codec.h"
#include "sfm_split/base/error.h"

extern "C" {
#include <jerror.h>
#include <jpeglib.h>
}

// libjpeg reports errors by a callback that must not return. Here it longjmps to the innermost function that
// called into libjpeg; such functions hold no C++ object of their own between setjmp and their end, and all
// that must be released belongs to a Decoder or Encoder outside them.

namespace s2gs {
namespace {

// A progressive file may ask for any number of passes over all coefficients; real ones have about ten.
constexpr int kMaxScans = 200;

struct ErrorState {
  jpeg_error_mgr manager;  // first: libjpeg hands back a pointer to it
  jmp_buf jump;
  std::array<char, JMSG_LENGTH_MAX> message;
};

ErrorState& StateOf(j_common_ptr info) { return *reinterpret_cast<ErrorState*>(info->err); }

[[noreturn]] void OnError(j_common_ptr info) {
  ErrorState& state = StateOf(info);
  state.manager.format_message(info, state.message.data());
  std::longjmp(state.jump, 1);
}

void OnMessage(j_common_ptr info, int level) {
  if (level >= 0) return;
  const jpeg_error_mgr& manager = *info->err;
  // Harmless, and found in what cameras write: unknown versions of application markers, and padding after
  // the last pixel.
  if (manager.msg_code == JWRN_JFIF_MAJOR || manager.msg_code == JWRN_ADOBE_XFORM) return;
  if (manager.msg_code == JWRN_EXTRANEOUS_DATA && manager.msg_parm.i[1] == JPEG_EOI) return;
  OnError(info);
}

void OnProgress(j_common_ptr info) {
  if (info->is_decompressor == 0) return;
  if (reinterpret_cast<j_decompress_ptr>(info)->input_scan_number > kMaxScans) {
    ErrorState& state = StateOf(info);
    std::snprintf(state.message.data(), state.message.size(), "more than %d scans", kMaxScans);
    std::longjmp(state.jump, 1);
  }
}

void InitErrors(ErrorState& state) {
  jpeg_std_error(&state.manager);
  state.manager.error_exit = OnError;
  state.manager.emit_message = OnMessage;
  state.message[0] = '\0';
}

// --- Decoding ----------------------------------------------------------------------------------------------

struct Decoder {
  jpeg_decompress_struct info{};
  ErrorState errors{};
  jpeg_progress_mgr progress{};

  Decoder() = default;
  Decoder(const Decoder&) = delete;
  Decoder& operator=(const Decoder&) = delete;
  ~Decoder() { jpeg_destroy_decompress(&info); }
};

// The next two return false with errors.message set.
bool ReadHeader(Decoder& decoder, std::string_view bytes) {
  InitErrors(decoder.errors);
  decoder.info.err = &decoder.errors.manager;
  if (setjmp(decoder.errors.jump) != 0) return false;
  jpeg_create_decompress(&decoder.info);
  decoder.progress.progress_monitor = OnProgress;
  decoder.info.progress = &decoder.progress;
  jpeg_mem_src(&decoder.info, reinterpret_cast<const unsigned char*>(bytes.data()),
               static_cast<unsigned long>(bytes.size()));  // NOLINT(google-runtime-int): libjpeg's type
  jpeg_read_header(&decoder.info, TRUE);
  return true;
}

bool ReadPixels(Decoder& decoder, int channels, uint8_t* pixels) {
  if (setjmp(decoder.errors.jump) != 0) return false;
  decoder.info.out_color_space = channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
  jpeg_start_decompress(&decoder.info);
  const size_t row_bytes = static_cast<size_t>(decoder.info.output_width) * channels;
  while (decoder.info.output_scanline < decoder.info.output_height) {
    JSAMPROW row = pixels + decoder.info.output_scanline * row_bytes;
    jpeg_read_scanlines(&decoder.info, &row, 1);
  }
  // Reads on to the end-of-image marker, so a file cut after the last pixel is noticed too.
  jpeg_finish_decompress(&decoder.info);
  return true;
}

// --- Encoding ----------------------------------------------------------------------------------------------

struct Encoder {
  jpeg_compress_struct info{};
  ErrorState errors{};
  unsigned char* bytes = nullptr;
  unsigned long num_bytes = 0;  // NOLINT(google-runtime-int): libjpeg's type

  Encoder() = default;
  Encoder(const Encoder&) = delete;
  Encoder& operator=(const Encoder&) = delete;
  ~Encoder() {
    jpeg_destroy_compress(&info);
    std::free(bytes);
  }
};

bool Encode(Encoder& encoder, const Image8& image, int quality) {
  InitErrors(encoder.errors);
  jpeg_compress_struct& info = encoder.info;
  info.err = &encoder.errors.manager;
  if (setjmp(encoder.errors.jump) != 0) return false;
  jpeg_create_compress(&info);
  jpeg_mem_dest(&info, &encoder.bytes, &encoder.num_bytes);
  info.image_width = static_cast<JDIMENSION>(image.width);
  info.image_height = static_cast<JDIMENSION>(image.height);
  info.input_components = image.channels;
  info.in_color_space = image.channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
  jpeg_set_defaults(&info);
  jpeg_set_quality(&info, quality, TRUE);
  constexpr int kFullColorQuality = 90;
  if (quality >= kFullColorQuality) {
    info.comp_info[0].h_samp_factor = 1;
    info.comp_info[0].v_samp_factor = 1;
  }
  jpeg_start_compress(&info, TRUE);
  while (info.next_scanline < info.image_height) {
    auto* row = const_cast<JSAMPLE*>(image.Pixel(0, static_cast<int>(info.next_scanline)));
    jpeg_write_scanlines(&info, &row, 1);
  }
  jpeg_finish_compress(&info);
  return true;
}

uint16_t ReadBigEndian16(ByteReader& reader, const char* what) {
  const auto high = reader.Read<uint8_t>(what);
  const auto low = reader.Read<uint8_t>(what);
  return static_cast<uint16_t>(high << 8 | low);
}

}  // namespace

Image8 DecodeJpeg(std::string_view bytes, const std::filesystem::path& path, int channels) {
  Decoder decoder;
  if (!ReadHeader(decoder, bytes)) {
    ThrowDamagedImage(path, std::string("is no valid JPEG file: ") + decoder.errors.message.data());
  }
  const jpeg_decompress_struct& info = decoder.info;
  CheckImageSize(info.image_width, info.image_height, path);
  if (info.jpeg_color_space == JCS_CMYK || info.jpeg_color_space == JCS_YCCK) {
    throw UserError(path, "is a CMYK JPEG, which is not supported", "Convert it to RGB");
  }
  if (info.arith_code != 0) {
    // Arithmetic codes go on for ever after the data's end, so a short file would not be noticed.
    throw UserError(path, "is an arithmetic-coded JPEG, which is not supported",
                    "Save it as a baseline JPEG");
  }
  // A Huffman-coded block of 8 x 8 pixels takes one bit or more, even in the emptiest progressive file.
  constexpr uint64_t kMaxPixelsPerByte = 8 * 64;
  const uint64_t num_pixels = static_cast<uint64_t>(info.image_width) * info.image_height;
  if (num_pixels / kMaxPixelsPerByte > bytes.size()) {
    ThrowDamagedImage(path, "is too short (" + std::to_string(bytes.size()) + " bytes) for its " +
                                std::to_string(info.image_width) + " x " + std::to_string(info.image_height) +
                                " pixels");
  }
  Image8 image;
  image.width = static_cast<int>(info.image_width);
  image.height = static_cast<int>(info.image_height);
  image.channels = channels;
  image.pixels.resize(num_pixels * static_cast<uint64_t>(channels));
  if (!ReadPixels(decoder, channels, image.pixels.data())) {
    ThrowDamagedImage(path, std::string("cannot be decoded as JPEG: ") + decoder.errors.message.data());
  }
  return image;
}

ImageSize ReadJpegSize(ByteReader& reader) {
  constexpr const char* kWhat = "the JPEG header";
  ReadBigEndian16(reader, kWhat);  // start of image
  std::array<char, 65536> skipped{};
  while (true) {
    auto marker = reader.Read<uint8_t>(kWhat);
    if (marker != 0xFF) reader.Fail("a JPEG marker is missing");
    while (marker == 0xFF) marker = reader.Read<uint8_t>(kWhat);
    if (marker == 0x01 || (marker >= 0xD0 && marker <= 0xD8)) continue;  // without content
    if (marker == 0xD9 || marker == 0xDA || marker == 0x00)
      reader.Fail("the JPEG header holds no image size");
    const uint16_t length = ReadBigEndian16(reader, kWhat);
    if (length < 2) reader.Fail("a JPEG header segment is shorter than its own length field");
    const bool is_frame =
        marker >= 0xC0 && marker <= 0xCF && marker != 0xC4 && marker != 0xC8 && marker != 0xCC;
    if (!is_frame) {
      reader.ReadBytes(skipped.data(), length - 2U, kWhat);
      continue;
    }
    reader.Read<uint8_t>(kWhat);  // bits per sample
    ImageSize size;
    size.height = ReadBigEndian16(reader, kWhat);
    size.width = ReadBigEndian16(reader, kWhat);
    CheckImageSize(static_cast<uint64_t>(size.width), static_cast<uint64_t>(size.height), reader.path());
    return size;
  }
}

std::string EncodeJpeg(const Image8& image, const std::filesystem::path& path, int quality) {
  Encoder encoder;
  if (!Encode(encoder, image, quality)) {
    throw UserError(path, std::string("cannot be encoded as JPEG: ") + encoder.errors.message.data(), "");
  }
  return std::string(reinterpret_cast<const char*>(encoder.bytes), encoder.num_bytes);
}

}  // namespace s2gs
