#include "tests/fuzz/fuzz_seeds.h"

#include <filesystem>
#include <fstream>

extern "C" int LLVMFuzzerInitialize(int* argc, char*** argv) {
  for (int i = 1; i < *argc; ++i) {
    const std::filesystem::path corpus = (*argv)[i];
    if (corpus.string()[0] == '-' || std::filesystem::is_regular_file(corpus)) continue;
    std::filesystem::create_directories(corpus);
    int index = 0;
    for (const std::string& seed : FuzzSeeds()) {
      std::ofstream stream(corpus / ("seed-" + std::to_string(index++)), std::ios::binary);
      stream.write(seed.data(), static_cast<std::streamsize>(seed.size()));
    }
    break;
  }
  return 0;
}
