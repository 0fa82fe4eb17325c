#include <cstdint>
#include <string_view>

#include "plugin/batch/batch_list.h"
#include "sfm_split/base/error.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  return {"images,workspace,options\nphotos,scan,\"--quality low --mask_path 'a b'\"\n# end\n",
          "images;workspace\na;b\n"};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  try {
    s2gs::ParseBatchList(std::string_view(reinterpret_cast<const char*>(data), size), "fuzz", "/nowhere",
                         [](const std::vector<std::string>&) {});
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
