#include "plugin/report/data_uri.h"

#include <algorithm>
#include <cstdint>

#include "s2gs/image/image_codec.h"
#include "s2gs/image/photos.h"

namespace s2gs {

std::string Base64(std::string_view bytes) {
  constexpr std::string_view kDigits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    const size_t count = std::min<size_t>(3, bytes.size() - i);
    uint32_t group = 0;
    for (size_t k = 0; k < 3; ++k) {
      group = group << 8 | (k < count ? static_cast<unsigned char>(bytes[i + k]) : 0U);
    }
    for (size_t k = 0; k < 4; ++k) text += k <= count ? kDigits[group >> (18 - 6 * k) & 63U] : '=';
  }
  return text;
}

std::string JpegDataUri(const Image8& image, int quality) {
  return "data:image/jpeg;base64," + Base64(EncodeJpeg(image, "report.html", quality));
}

std::string JpegDataUri(const Image8& image, int quality, size_t most_bytes) {
  constexpr int kStep = 8;
  std::string uri = JpegDataUri(image, quality);
  for (int less = quality - kStep; uri.size() > most_bytes && 2 * less >= quality; less -= kStep) {
    uri = JpegDataUri(image, less);
  }
  return uri;
}

std::string PngDataUri(const Image8& image) {
  return "data:image/png;base64," + Base64(EncodePng(image, "report.html"));
}

Image8 Thumbnail(const Image8& image, int longer_side) {
  const int side = std::max(image.width, image.height);
  if (side <= longer_side) return image;
  const double scale = static_cast<double>(longer_side) / side;
  const auto shrunk = [&](int length) { return std::max(1, static_cast<int>(length * scale + 0.5)); };
  return ResizeByArea(image, shrunk(image.width), shrunk(image.height));
}

}  // namespace s2gs
