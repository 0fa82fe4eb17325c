#include <cstddef>
#include <cstdint>
#include <sstream>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "tests/fuzz/fuzz_seeds.h"
#include "tests/sfm_split/scene/io/turntable_example.h"

std::vector<std::string> FuzzSeeds() {
  std::ostringstream stream;
  s2gs::WriteTurntableFile(stream, s2gs::ExampleTurntable(), "seed");
  return {stream.str()};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  std::istringstream stream(std::string(reinterpret_cast<const char*>(data), size));
  try {
    s2gs::ReadTurntableFile(stream, "fuzz");
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
