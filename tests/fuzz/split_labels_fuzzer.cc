#include <cstddef>
#include <cstdint>

#include "plugin/stage/split_labels.h"
#include "sfm_split/base/error.h"
#include "tests/fuzz/fuzz_seeds.h"

std::vector<std::string> FuzzSeeds() {
  const std::string split =
      R"({"case":"turntable","reason":"r","images":[{"name":"a","station":0,"labels":"012"},{"name":"b","station":1,"labels":""}]})";
  return {split, s2gs::ReplaceSplitLabels(split, {{"a", "210"}}, "seed")};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  try {
    std::map<std::string, std::string> labels;
    for (const auto& [name, image] : s2gs::ParseSplitLabels(text, "fuzz").images) labels[name] = image.labels;
    s2gs::ReplaceSplitLabels(text, labels, "fuzz");
  } catch (const s2gs::UserError&) {
  }
  return 0;
}
