#include "tests/fuzz/colmap_model_fuzzer.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() { return s2gs::ColmapSeeds(s2gs::ColmapFormat::kText); }

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  return s2gs::FuzzColmapFile(data, size, s2gs::ColmapFormat::kText);
}
