#include "plugin/commands/turntable_mapper_command.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <sstream>

#include "plugin/cli/command.h"
#include "plugin/stage/workspace.h"
#include "tests/plugin/commands/split_fixture.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

// Of one body: nothing is searched before COLMAP maps it.
TEST(TurntableMapperCommand, TakesThePhotosFromTheFolderThatIsGiven) {
  const TemporaryFolder folder;
  const Workspace workspace{folder / "scan"};
  std::filesystem::create_directories(workspace.Images());
  std::filesystem::create_directories(workspace.ObjectDatabase().parent_path());
  WriteSplitFixture(workspace.ObjectDatabase(), {"a.jpg", "b.jpg"});
  WriteSplitFixture(workspace.StaticDatabase(), {"a.jpg", "b.jpg"});
  WriteAll(workspace.ObjectDatabase().parent_path() / "labels.json",
           R"({"version": 1, "case": "one_body", "reason": "a test", "images": [
             {"name": "a.jpg", "image_id": 1, "station": 0, "labels": "22"},
             {"name": "b.jpg", "image_id": 2, "station": 0, "labels": "22"}]})");
  std::ostringstream out;
  CommandContext context("turntable_mapper",
                         {"--workspace_path", workspace.root.string(), "--image_path",
                          (folder / "elsewhere").string(), "--colmap_path", (folder / "none").string()},
                         out);
  ExpectUserError([&] { RunTurntableMapper(context); },
                  {(folder / "elsewhere").string(), "no such folder of photos"});
}

}  // namespace
}  // namespace s2gs
