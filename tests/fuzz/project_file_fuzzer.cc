#include <cstdint>
#include <string_view>

#include "plugin/cli/project_file.h"
#include "sfm_split/base/error.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  return {"# scan\nworkspace_path = /data/scan\nquality=high\n\n[Tsdf]\nvoxel_size = \"0.002\"\n; end"};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  try {
    s2gs::ParseProjectFile(std::string_view(reinterpret_cast<const char*>(data), size), "fuzz");
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
