#include <cstdint>
#include <sstream>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_fused.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  std::ostringstream stream;
  s2gs::WriteColmapVisibility(stream, {{0, 1, 3, 3}, {7, 0, 258}});
  return {stream.str()};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  std::istringstream stream(std::string(reinterpret_cast<const char*>(data), size));
  try {
    s2gs::ReadColmapVisibility(stream, "fuzz");
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
