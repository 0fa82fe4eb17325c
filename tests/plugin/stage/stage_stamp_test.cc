#include "plugin/stage/stage_stamp.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

#include "sfm_split/base/file_io.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using ::testing::HasSubstr;

class Recorder : public Reporter {
 public:
  void Log(LogLevel level, std::string_view message) override {
    if (level >= LogLevel::kWarning) warnings += std::string(message) + "\n";
  }
  std::string warnings;
};

StageStamp FullStamp(const Workspace& workspace) {
  StageStamp stamp;
  stamp.run_id = "17";
  stamp.program_version = "1.2";
  stamp.finished = "2001-02-03T04:05:06Z";
  stamp.seconds = 12.5;
  stamp.options = {{"Mesh.voxel_size", "0.1"}, {"random_seed", "0"}};
  WriteAll(workspace.root / "in.txt", "input");
  stamp.inputs = {{StampPath(workspace, workspace.root / "in.txt"), TakeState(workspace.root / "in.txt")}};
  stamp.outputs = {{"out.ply", {}}};
  stamp.upstream = {{"train", "16"}, {"split", ""}};
  return stamp;
}

TEST(StampPath, IsOneHoweverAFolderIsSpelled) {
  const Workspace workspace{"/a/scan"};
  for (const char* images :
       {"/a/scan/images", "/a/scan/images/", "/a/scan/images/.", "/a/scan/./b/../images//"}) {
    EXPECT_EQ(StampPath(workspace, images), "images") << images;
    EXPECT_EQ(StampPath({"/a/scan/"}, images), "images") << images;
  }
  EXPECT_EQ(StampPath(workspace, "/a/photos/"), "/a/photos");
  EXPECT_EQ(StampPath(workspace, "/"), "/");
}

TEST(StageStamp, ReadsWhatItWrote) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  const StageStamp written = FullStamp(workspace);
  WriteStageStamp(workspace, "mesh", written);
  Recorder log;
  const auto read = ReadStageStamp(workspace, "mesh", log);
  ASSERT_TRUE(read.has_value());
  EXPECT_EQ(read->run_id, written.run_id);
  EXPECT_EQ(read->program_version, written.program_version);
  EXPECT_EQ(read->finished, written.finished);
  EXPECT_EQ(read->seconds, written.seconds);
  EXPECT_EQ(read->options, written.options);
  EXPECT_EQ(read->upstream, written.upstream);
  ASSERT_EQ(read->inputs.size(), 1u);
  EXPECT_EQ(read->inputs[0].path, "in.txt");
  EXPECT_EQ(read->outputs.size(), 1u);
  EXPECT_EQ(log.warnings, "");
}

TEST(StageStampBadInput, DamagedStampsCountAsMissing) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  WriteStageStamp(workspace, "mesh", FullStamp(workspace));
  const std::filesystem::path path = workspace.StageStamp("mesh");
  const std::string good = ReadAll(path);
  int num_refused = 0;
  ForEachDamage(good, [&](const std::string& damaged, const std::string& description) {
    WriteAll(path, damaged);
    Recorder log;
    const ScopedAllocationLimit limit(1 << 16);
    if (ReadStageStamp(workspace, "mesh", log).has_value()) return;
    ++num_refused;
    EXPECT_THAT(log.warnings, HasSubstr(path.string())) << description;
    EXPECT_THAT(log.warnings, HasSubstr("counts as not done")) << description;
  });
  // All truncations at least, but for those that drop white space at the end.
  EXPECT_GE(num_refused, static_cast<int>(good.size()) - 2);
  for (const std::string& content : {std::string("[]"), std::string("null"), std::string("{\"version\": 2}"),
                                     std::string(100000, '['), std::string("{\"version\": 1e400}")}) {
    WriteAll(path, content);
    Recorder log;
    EXPECT_FALSE(ReadStageStamp(workspace, "mesh", log).has_value());
    EXPECT_THAT(log.warnings, HasSubstr("mesh counts as not done"));
  }
}

}  // namespace
}  // namespace s2gs
