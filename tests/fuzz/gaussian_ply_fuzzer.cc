#include <cstdint>
#include <sstream>

#include "s2gs/gaussians_ply.h"
#include "sfm_split/base/error.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  s2gs::Gaussians gaussians;
  gaussians.Resize(2);
  gaussians.rotation.assign(8, 0.5F);
  std::ostringstream stream;
  s2gs::WriteGaussianPly(stream, gaussians);
  return {stream.str()};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  try {
    std::istringstream stream(std::string(reinterpret_cast<const char*>(data), size));
    const s2gs::Gaussians gaussians = s2gs::ReadGaussianPly(stream, "fuzz");
    std::ostringstream copy;
    s2gs::WriteGaussianPly(copy, gaussians);
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
