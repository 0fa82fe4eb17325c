// What s2gs itself noted in a workspace, which may come from elsewhere: imported photos, rendered photos, the
// last run of a batch. The first byte of the input chooses the file. Whatever it says, photos beside the
// workspace and in it stay as they are.

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "plugin/batch/batch_record.h"
#include "plugin/photos/imported_folder.h"
#include "plugin/stage/stale_outputs.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "tests/fuzz/fuzz_seeds.h"
#include "tests/fuzz/scratch_path.h"

namespace {

namespace fs = std::filesystem;

enum File : uint8_t { kImported, kImportedThroughLink, kRendered, kBatch, kNumFiles };

const fs::path& Folder() {
  static const fs::path folder = s2gs::ScratchPath("records");
  return folder;
}

void Put(const fs::path& path, const char* data, size_t size) {
  fs::create_directories(path.parent_path());
  std::ofstream(path, std::ios::binary).write(data, static_cast<std::streamsize>(size));
}

void Import(const s2gs::Workspace& workspace) {
  try {
    s2gs::ImportedFolder folder(workspace, "photos");
    folder.Expect({"b.png"});
  } catch (const s2gs::UserError&) {
  }
}

}  // namespace

std::vector<std::string> FuzzSeeds() {
  const std::string imported =
      R"({"origin":"other","photos":["a.jpg","../a.jpg","sub/a.jpg","a/../../a.jpg"]})";
  return {std::string(1, '\0') + imported, std::string(1, '\1') + imported,
          std::string(1, '\2') + "a.jpg\n../a.jpg\n",
          std::string(1, '\3') +
              R"({"exit_code":1,"signal":11,"message":"m","finished":"f","wall_seconds":1,)"
              R"("cpu_seconds":2,"arguments":["a"]})"};
}

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size == 0) return 0;
  const s2gs::Workspace workspace{Folder() / "scan"};
  fs::remove_all(Folder());
  const std::string photo = "photo";
  for (const fs::path& path : {Folder() / "a.jpg", workspace.root / "a.jpg", workspace.Images() / "a.jpg"}) {
    Put(path, photo.data(), photo.size());
  }
  const char* text = reinterpret_cast<const char*>(data) + 1;
  const auto file = static_cast<File>(data[0] % kNumFiles);
  s2gs::Reporter silent;
  switch (file) {
    case kImportedThroughLink:
      fs::create_directories(workspace.Imported());
      fs::create_directory_symlink(workspace.Images(), workspace.Imported() / "sub");
      [[fallthrough]];
    case kImported:
      Put(workspace.ImportRecord(), text, size - 1);
      Import(workspace);
      break;
    case kRendered:
      Put(workspace.Own() / "rendered.txt", text, size - 1);
      Put(workspace.Masks() / "a.jpg.png", photo.data(), photo.size());
      s2gs::TidyImageOutputs(workspace, workspace.Images(), {"b.jpg"}, silent);
      break;
    default:
      Put(workspace.BatchRecord(), text, size - 1);
      s2gs::LookAtObject(workspace);
  }
  for (const fs::path& path : {Folder() / "a.jpg", workspace.root / "a.jpg", workspace.Images() / "a.jpg"}) {
    if (!fs::exists(path) || fs::file_size(path) != photo.size()) std::abort();
  }
  return 0;
}
