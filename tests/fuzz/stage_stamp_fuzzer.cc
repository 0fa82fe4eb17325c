#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>

#include "plugin/stage/stage_stamp.h"
#include "sfm_split/base/reporter.h"
#include "tests/fuzz/fuzz_seeds.h"
#include "tests/fuzz/scratch_path.h"

namespace {

// Where the one file of this process lies.
const s2gs::Workspace& Workspace() {
  static const s2gs::Workspace workspace{s2gs::ScratchPath("stamp")};
  return workspace;
}

}  // namespace

std::vector<std::string> FuzzSeeds() {
  return {
      R"({"version":1,"stage":"a","run_id":"1","program_version":"2","finished":"3","seconds":4,"reason":"r","options":{"b":"c"},)"
      R"("inputs":[{"path":"d","exists":true,"files":1,"bytes":2,"state":"e","content":"f"}],"outputs":[],"upstream":{"g":"h"}})"};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  const std::filesystem::path path = Workspace().StageStamp("a");
  std::filesystem::create_directories(path.parent_path());
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
  s2gs::Reporter silent;
  const std::optional<s2gs::StageStamp> stamp = s2gs::ReadStageStamp(Workspace(), "a", silent);
  if (stamp) s2gs::WriteStageStamp(Workspace(), "a", *stamp);
  return 0;
}
