#include <zlib.h>

#include <cstdint>
#include <string>
#include <utility>

#include "s2gs/image/image_codec.h"
#include "sfm_split/base/error.h"
#include "tests/fuzz/fuzz_seeds.h"

namespace {

s2gs::Image8 Ramp(int channels) {
  s2gs::Image8 image{24, 17, channels, {}};
  for (int i = 0; i < 24 * 17 * channels; ++i) image.pixels.push_back(static_cast<uint8_t>(7 * i));
  return image;
}

// The same with every PNG chunk's checksum made right: behind a wrong one, nothing would be tried.
std::string WithRightChecksums(std::string bytes) {
  constexpr size_t kSignatureBytes = 8;
  const auto at = [&bytes](size_t i) { return static_cast<uint32_t>(static_cast<unsigned char>(bytes[i])); };
  size_t chunk = kSignatureBytes;
  while (chunk + 12 <= bytes.size()) {
    const size_t length = at(chunk) << 24 | at(chunk + 1) << 16 | at(chunk + 2) << 8 | at(chunk + 3);
    if (length > bytes.size() - chunk - 12) break;
    const auto* content = reinterpret_cast<const Bytef*>(bytes.data() + chunk + 4);
    const auto checksum = static_cast<uint32_t>(crc32(0, content, static_cast<uInt>(length + 4)));
    for (size_t i = 0; i < 4; ++i)
      bytes[chunk + 8 + length + i] = static_cast<char>(checksum >> (24 - 8 * i));
    chunk += 12 + length;
  }
  return bytes;
}

}  // namespace

std::vector<std::string> FuzzSeeds() {
  std::vector<std::string> seeds;
  for (const int channels : {1, 3}) {
    seeds.push_back(s2gs::EncodePng(Ramp(channels), "fuzz"));
    seeds.push_back(s2gs::EncodeJpeg(Ramp(channels), "fuzz", 95));
    seeds.push_back(s2gs::EncodeJpeg(Ramp(channels), "fuzz", 30));
  }
  return seeds;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  std::string bytes(reinterpret_cast<const char*>(data), size);
  if (size > 4 && bytes.substr(1, 3) == "PNG") bytes = WithRightChecksums(std::move(bytes));
  for (const int channels : {1, 3}) {
    try {
      s2gs::DecodeImage(bytes, "fuzz", channels);
    } catch (const s2gs::UserError&) {
    }
  }
  return 0;
}
