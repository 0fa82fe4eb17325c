#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "plugin/stage/angle_list.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/image_name.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  return {"name,angle\na.jpg,0\nb/c.jpg,-12.5\n# end\n", "\"a.jpg\";1e2\r\nb.JPG;350\r\n",
          "\xEF\xBB\xBFphoto\tangle\n\"a, \"\"b\"\"; c.jpg\"\t350\nb.jpg\t7,5\n"};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  try {
    const std::map<std::string, double> listed =
        s2gs::ParseAngleList(std::string_view(reinterpret_cast<const char*>(data), size), "fuzz");
    for (const auto& [name, angle] : listed) {
      if (s2gs::ImageName::FindFault(name) || !std::isfinite(angle)) std::abort();
    }
    std::vector<std::string> unknown;
    s2gs::AnglesOfPhotos(listed, {"a.jpg", "b/c.png", "b/c.tif"}, "fuzz", &unknown);
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
