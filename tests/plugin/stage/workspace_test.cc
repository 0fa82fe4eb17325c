#include "plugin/stage/workspace.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <set>
#include <string>

#include "tests/plugin/commands/subprocess.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

TEST(Workspace, PathsOfTheContract) {
  const Workspace w{"/W"};
  EXPECT_EQ(w.Database(), "/W/database.db");
  EXPECT_EQ(w.ObjectDatabase(), "/W/split/object.db");
  EXPECT_EQ(w.StaticDatabase(), "/W/split/static.db");
  EXPECT_EQ(w.ObjectModel(), "/W/sparse/0");
  EXPECT_EQ(w.StaticModel(), "/W/sparse/static");
  EXPECT_EQ(w.Turntable(), "/W/turntable.json");
  EXPECT_EQ(w.Mask("sub/a.jpg"), "/W/masks/sub/a.jpg.png");
  EXPECT_EQ(w.DepthMap("a.jpg"), "/W/dense/0/stereo/depth_maps/a.jpg.geometric.bin");
  EXPECT_EQ(w.NormalMap("a.jpg"), "/W/dense/0/stereo/normal_maps/a.jpg.geometric.bin");
  EXPECT_EQ(w.TsdfMesh(), "/W/dense/0/meshed-tsdf.ply");
  EXPECT_EQ(w.PointCloud(), "/W/s2gs/point_cloud.ply");
  EXPECT_EQ(w.ReportJson(), "/W/report.json");
}

TEST(Workspace, EveryStandardOutputIsDescribed) {
  const Workspace w{"W"};
  std::set<fs::path> described;
  for (const auto& [path, meaning] : WorkspaceContents(w)) described.insert(path);
  for (const StandardStage& stage : StandardStages(w)) {
    for (const fs::path& output : stage.outputs) EXPECT_EQ(described.count(output), 1U) << output;
  }
}

// Otherwise `workspace_info` waits for a file that nothing writes.
TEST(Workspace, EveryStandardStageHasACommandThatRunsIt) {
  for (const StandardStage& stage : StandardStages(Workspace{"W"}))
    EXPECT_NE(stage.command, "") << stage.name;
}

TEST(WorkspaceLock, KeepsOthersOut) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  Reporter silent;
  {
    const WorkspaceLock lock(workspace, silent);
    const std::string process = "process " + std::to_string(::getpid());
    ExpectUserError([&] { const WorkspaceLock second(workspace, silent); },
                    {folder.path().string(), process, "Wait until"});
  }
  EXPECT_NO_THROW(WorkspaceLock(workspace, silent));
}

TEST(WorkspaceLock, EndsWithAKilledProcess) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  Reporter silent;
  ChildProcess child([&](const std::function<void()>& say_ready) {
    const WorkspaceLock lock(workspace, silent);
    say_ready();
    while (true) ::pause();
    return 0;
  });
  ASSERT_TRUE(child.WaitUntilReady());
  ExpectUserError([&] { const WorkspaceLock lock(workspace, silent); }, {"works in this workspace"});
  child.Signal(SIGKILL);
  EXPECT_EQ(child.Wait(), 128 + SIGKILL);
  EXPECT_NO_THROW(WorkspaceLock(workspace, silent));
}

TEST(WorkspaceLock, NeedsAFolder) {
  const TemporaryFolder folder;
  Reporter silent;
  ExpectUserError([&] { const WorkspaceLock lock({folder / "typo"}, silent); },
                  {"typo: no such folder", "--workspace_path"});
  EXPECT_FALSE(fs::exists(folder / "typo"));
}

TEST(Workspace, StaleTemporariesGoEverywhereButAmongThePhotos) {
  const TemporaryFolder folder;
  const std::string stale = ".s2gs-tmp-" + std::to_string(::getpid()) + "-1-a";
  for (const std::string place : {"", "sparse/0/", "dense/0/images/", "s2gs/stages/", "images/"})
    WriteAll(folder / (place + stale), "x");
  RemoveStaleWorkspaceTemporaries({folder.path()});
  for (const std::string place : {"", "sparse/0/", "dense/0/images/", "s2gs/stages/"})
    EXPECT_FALSE(fs::exists(folder / (place + stale))) << place;
  EXPECT_TRUE(fs::exists(folder / ("images/" + stale)));
}

}  // namespace
}  // namespace s2gs
