#define XXH_INLINE_ALL
#include <xxhash.h>

#include <cstdint>
#include <cstring>
#include <sstream>

#include "s2gs/checkpoint.h"
#include "sfm_split/base/error.h"
#include "tests/fuzz/fuzz_seeds.h"

namespace {
constexpr size_t kHeader = 28;  // magic, version, length, checksum.
}  // namespace

std::vector<std::string> FuzzSeeds() {
  s2gs::Checkpoint checkpoint;
  checkpoint.state.gaussians.Resize(2);
  checkpoint.state.num_neighbours = 1;
  checkpoint.state.neighbours = {1, 0};
  checkpoint.state.gradient_sum = {0, 1};
  checkpoint.state.view_count = {1, 1};
  std::ostringstream stream;
  s2gs::WriteCheckpoint(stream, checkpoint);
  return {stream.str()};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  std::string bytes(reinterpret_cast<const char*>(data), size);
  if (size >= kHeader) {
    // A right length and checksum, so that the content behind them is reached.
    const uint64_t length = size - kHeader;
    const uint64_t hash = XXH3_64bits(bytes.data() + kHeader, length);
    std::memcpy(bytes.data() + 12, &length, sizeof(length));
    std::memcpy(bytes.data() + 20, &hash, sizeof(hash));
  }
  try {
    std::istringstream stream(bytes);
    const s2gs::Checkpoint checkpoint = s2gs::ReadCheckpoint(stream, "fuzz");
    std::ostringstream copy;
    s2gs::WriteCheckpoint(copy, checkpoint);
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
