#include <cstdint>
#include <string_view>

#include "s2gs/image_codec.h"
#include "sfm_split/error.h"
#include "tests/fuzz/fuzz_seeds.h"

namespace {

s2gs::Image8 Ramp(int channels) {
  s2gs::Image8 image{24, 17, channels, {}};
  for (int i = 0; i < 24 * 17 * channels; ++i) image.pixels.push_back(static_cast<uint8_t>(7 * i));
  return image;
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
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  for (const int channels : {1, 3}) {
    try {
      s2gs::DecodeImage(bytes, "fuzz", channels);
    } catch (const s2gs::UserError&) {
    }
  }
  return 0;
}
