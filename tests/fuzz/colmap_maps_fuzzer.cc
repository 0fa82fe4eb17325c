#include <cstdint>
#include <sstream>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_maps.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  std::vector<std::string> seeds;
  for (const int channels : {1, 3}) {
    std::ostringstream stream;
    s2gs::WriteColmapMap(stream, {4, 3, channels, std::vector<float>(12 * channels, 1.5F)});
    seeds.push_back(stream.str());
  }
  return seeds;
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  for (const int channels : {1, 3}) {
    std::istringstream stream(std::string(reinterpret_cast<const char*>(data), size));
    try {
      s2gs::ReadColmapMap(stream, "fuzz", channels);
    } catch (const s2gs::UserError&) {
    }
  }
  return 0;
}
