#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>

#include "sfm_split/base/image_name.h"
#include "sfm_split/base/printable.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  return {"a.jpg", "sub/b c.png", "../a", "/a", "\xC3\xA4/\xE6\x97\xA5.jpg"};
}

// Whatever passes stays below the folder that it is put into, and is fit to be printed as it is.
extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  const std::string shown = s2gs::Printable(text);
  if (s2gs::Printable(shown) != shown) std::abort();
  if (s2gs::ImageName::FindFault(text)) return 0;
  const std::filesystem::path path =
      (std::filesystem::path("/root/folder") / (text + ".png")).lexically_normal();
  if (path.string().rfind("/root/folder/", 0) != 0 || shown != text) std::abort();
  if (path.string() != "/root/folder/" + text + ".png") std::abort();
  return 0;
}
