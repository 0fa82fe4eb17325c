#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "plugin/colmap/mapping_attempts.h"
#include "sfm_split/base/error.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  return {s2gs::ToJson({{"default", 2, 41, 12.5}, {"a", 0, 0, 0}}).dump(1)};
}

// What was accepted comes back the same.
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  try {
    const std::string text(reinterpret_cast<const char*>(data), size);
    const std::string written = s2gs::ToJson(s2gs::ParseMappingAttempts(text, "fuzz")).dump();
    if (s2gs::ToJson(s2gs::ParseMappingAttempts(written, "fuzz")).dump() != written) std::abort();
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
