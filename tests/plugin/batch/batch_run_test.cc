#include "plugin/batch/batch_run.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "plugin/batch/batch_page.h"
#include "sfm_split/base/error.h"
#include "tests/plugin/commands/subprocess.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

// Stands for s2gs: does in its workspace what the first of its options says, and leaves marks of it.
constexpr const char* kProgram = R"(#!/bin/sh
[ "$1" = automatic_scanner ] && [ "$2" = --workspace_path ] && [ "$4" = --image_path ] || exit 99
w=$3
mkdir -p "$w/split"
echo x >> "$w/runs"
echo "threads ${OMP_NUM_THREADS:-} gpu ${CUDA_VISIBLE_DEVICES:-}" > "$w/environment"
verdict() { printf '{"verdict": {"verdict": "%s", "reasons": ["a reason", "another"]}}' "$1" > "$w/split/turntable_mapper.json"; }
case "$6" in
  good) verdict good ;;
  doubtful) verdict doubtful; echo "s2gs: error: the poses are doubtful" >&2; exit 3 ;;
  failed) verdict failed; exit 3 ;;
  broken) echo "on its way"; echo "s2gs: error: $5: has no photos." >&2; echo "Take some." >&2; exit 1 ;;
  faults) printf 's2gs: error: the scan cannot begin:\n  a.jpg: is empty\n  b.jpg: is empty\n\n' >&2; exit 1 ;;
  crash) kill -SEGV $$ ;;
  slow) trap 'echo stopping; touch "$w/stopped"; exit 130' INT; touch "$w/began"; i=0
        while [ $i -lt 600 ]; do sleep 0.05; i=$((i + 1)); done ;;
esac
)";

class BatchRun : public ::testing::Test {
 protected:
  BatchRun() {
    folder_.Write("program", kProgram);
    fs::permissions(folder_ / "program", fs::perms::owner_all);
    options_.program = folder_ / "program";
  }
  void Add(const std::string& name, const std::string& what) {
    BatchObject object;
    object.line = static_cast<int>(objects_.size()) + 2;
    object.images = folder_ / "photos";
    object.workspace = folder_ / name;
    object.options = {what};
    objects_.push_back(object);
  }
  // The outcomes, by object.
  std::vector<BatchOutcome> Run(const std::function<bool()>& stop = [] { return false; }) {
    std::vector<size_t> chosen;
    for (size_t i = 0; i < objects_.size(); ++i) chosen.push_back(i);
    std::vector<BatchOutcome> outcomes(objects_.size());
    int num_running = 0;
    most_running_ = 0;
    RunBatch(
        objects_, chosen, options_,
        [&](const BatchEvent& event) {
          num_running += event.has_begun ? 1 : event.has_ended ? -1 : 0;
          most_running_ = std::max(most_running_, num_running);
          if (event.has_ended) outcomes[event.object] = event.outcome;
        },
        stop);
    return outcomes;
  }
  std::vector<BatchEntry> Entries() const {
    std::vector<BatchEntry> entries;
    for (const BatchObject& object : objects_) entries.push_back(MakeBatchEntry(object));
    return entries;
  }

  TemporaryFolder folder_;
  BatchRunOptions options_;
  std::vector<BatchObject> objects_;
  int most_running_ = 0;
};

TEST_F(BatchRun, SaysWhatBecameOfEachAndWhy) {
  for (const char* what : {"good", "doubtful", "failed", "broken", "crash", "faults"}) Add(what, what);
  const std::vector<BatchOutcome> outcomes = Run();
  EXPECT_EQ(outcomes[0].state, BatchState::kDone);
  EXPECT_EQ(outcomes[1].state, BatchState::kDoubtful);
  EXPECT_EQ(outcomes[1].why, "a reason; another");
  EXPECT_EQ(outcomes[2].state, BatchState::kFailed);
  EXPECT_EQ(outcomes[3].state, BatchState::kFailed);
  EXPECT_EQ(outcomes[3].why, (folder_ / "photos").string() + ": has no photos. Take some.");
  EXPECT_EQ(outcomes[4].state, BatchState::kFailed);
  EXPECT_THAT(outcomes[4].why, HasSubstr("signal 11"));
  EXPECT_EQ(outcomes[5].why, "the scan cannot begin: a.jpg: is empty; b.jpg: is empty");
  EXPECT_THAT(folder_.Read("broken/s2gs/batch.log"),
              AllOf(HasSubstr("on its way\n"), HasSubstr("Take some.\n")));
  // The same is known afterwards, from the workspaces alone.
  const std::vector<BatchEntry> entries = Entries();
  for (size_t i = 0; i < outcomes.size(); ++i) {
    EXPECT_EQ(entries[i].outcome.state, outcomes[i].state) << i;
    EXPECT_EQ(entries[i].outcome.why, outcomes[i].why) << i;
  }
  EXPECT_EQ(CountEntries(entries), "6 objects: 1 done, 1 doubtful, 4 failed");
}

TEST_F(BatchRun, RunsSoManyAtATimeOnTheirGpus) {
  for (int i = 0; i < 6; ++i) Add("w" + std::to_string(i), "good");
  options_.jobs = 3;
  options_.gpus = {4, 7};
  Run();
  EXPECT_GE(most_running_, 2);
  EXPECT_LE(most_running_, 3);
  for (int i = 0; i < 6; ++i) {
    const std::string environment = folder_.Read("w" + std::to_string(i) + "/environment");
    EXPECT_THAT(environment, Not(HasSubstr("threads  ")));
    EXPECT_TRUE(environment.find("gpu 4\n") != std::string::npos ||
                environment.find("gpu 7\n") != std::string::npos)
        << environment;
  }
}

// Threads are shared out among scans that run side by side, unless the user has said how many each takes.
TEST_F(BatchRun, ThreadsAreSharedOutOnlyAmongSeveral) {
  const char* const given = std::getenv("OMP_NUM_THREADS");
  const std::optional<std::string> before =
      given == nullptr ? std::nullopt : std::make_optional<std::string>(given);
  ::unsetenv("OMP_NUM_THREADS");
  Add("alone", "good");
  Run();
  EXPECT_THAT(folder_.Read("alone/environment"), HasSubstr("threads  "));
  ::setenv("OMP_NUM_THREADS", "77", 1);
  options_.jobs = 2;
  Run();
  EXPECT_THAT(folder_.Read("alone/environment"), HasSubstr("threads 77 "));
  if (before) {
    ::setenv("OMP_NUM_THREADS", before->c_str(), 1);
  } else {
    ::unsetenv("OMP_NUM_THREADS");
  }
}

TEST_F(BatchRun, AStopEndsWhatRunsAndARepeatGoesOn) {
  Add("first", "slow");
  Add("second", "slow");
  Add("third", "slow");
  options_.jobs = 2;
  const auto both_began = [&] {
    return fs::exists(folder_ / "first/began") && fs::exists(folder_ / "second/began");
  };
  EXPECT_THROW(Run(both_began), Interrupted);
  EXPECT_TRUE(fs::exists(folder_ / "first/stopped"));
  EXPECT_TRUE(fs::exists(folder_ / "second/stopped"));
  EXPECT_FALSE(fs::exists(folder_ / "third"));
  EXPECT_EQ(Entries()[0].outcome.state, BatchState::kWaiting);
  for (BatchObject& object : objects_) object.options = {"good"};
  for (const BatchOutcome& outcome : Run()) EXPECT_EQ(outcome.state, BatchState::kDone);
}

TEST_F(BatchRun, LeavesAWorkspaceToWhoWorksInIt) {
  Add("taken", "good");
  const Workspace workspace{folder_ / "taken"};
  fs::create_directories(workspace.root);
  Reporter silent;
  {
    const WorkspaceLock lock(workspace, workspace.ScanLockFile(), silent);
    EXPECT_EQ(Run()[0].state, BatchState::kRunning);
    EXPECT_FALSE(fs::exists(folder_ / "taken/runs"));
    EXPECT_FALSE(fs::exists(workspace.BatchRecord()));
  }
  EXPECT_EQ(Run()[0].state, BatchState::kDone);
  EXPECT_TRUE(fs::exists(folder_ / "taken/runs"));
}

TEST_F(BatchRun, WritesNothingThroughLinksOutOfTheWorkspace) {
  Add("w", "good");
  fs::create_directories(folder_ / "w");
  fs::create_directories(folder_ / "elsewhere");
  fs::create_directory_symlink(folder_ / "elsewhere", folder_ / "w/s2gs");
  EXPECT_EQ(Run()[0].state, BatchState::kFailed);
  EXPECT_TRUE(fs::is_empty(folder_ / "elsewhere"));
}

TEST_F(BatchRun, ThePageLinksReportsAndEscapesNames) {
  Add("a <b> & 100%", "good");
  Add("broken", "broken");
  Run();
  folder_.Write("a <b> & 100%/report.html", "x");
  BatchObject wrong;
  wrong.line = 9;
  wrong.fault = "it does not say <which>";
  objects_.push_back(wrong);
  WriteBatchPage(folder_ / "out", "objects", Entries());
  const std::string page = folder_.Read("out/index.html");
  EXPECT_THAT(page, AllOf(HasSubstr("3 objects: 1 done, 1 failed, 1 wrong"),
                          HasSubstr("href=\"../a%20%3Cb%3E%20%26%20100%25/report.html\""),
                          HasSubstr("a &lt;b&gt; &amp; 100%"), HasSubstr("has no photos. Take some."),
                          HasSubstr("it does not say &lt;which&gt;"), HasSubstr("line 9")));
  EXPECT_THAT(page, Not(HasSubstr("<b> & ")));
  const nlohmann::json json = nlohmann::json::parse(folder_.Read("out/batch.json"));
  EXPECT_EQ(json.at("objects").at(1).at("state"), "failed");
  EXPECT_EQ(json.at("objects").at(1).at("exit_code"), 1);
  EXPECT_EQ(json.at("objects").at(2).at("state"), "wrong");
}

TEST_F(BatchRun, APageOfOthersIsNotReplaced) {
  RequireNoOtherPage(folder_ / "out");
  folder_.Write("out/index.html", "mine");
  EXPECT_THROW(RequireNoOtherPage(folder_ / "out"), UserError);
  fs::remove(folder_ / "out/index.html");
  WriteBatchPage(folder_ / "out", "objects", {});
  EXPECT_NO_THROW(RequireNoOtherPage(folder_ / "out"));
  folder_.Write("out/batch.json", "{\"mine\": 1}");
  EXPECT_THROW(RequireNoOtherPage(folder_ / "out"), UserError);
}

TEST(BatchRecord, DamagedRecordsAreNone) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  WriteBatchRecord(workspace, {3, 0, "why", "2026-01-02T03:04:05Z", 1.5, 2.5, {"--a", "b"}});
  const std::optional<BatchRecord> read = ReadBatchRecord(workspace);
  ASSERT_TRUE(read.has_value());
  EXPECT_EQ(read->exit_code, 3);
  EXPECT_EQ(read->message, "why");
  EXPECT_EQ(read->wall_seconds, 1.5);
  EXPECT_THAT(read->arguments, ElementsAre("--a", "b"));
  for (const std::string text : {"", "[]", "{}", R"({"exit_code": "x"})", "{\"exit_code\": 0, \"sig"}) {
    WriteAll(workspace.BatchRecord(), text);
    EXPECT_FALSE(ReadBatchRecord(workspace).has_value()) << text;
  }
}

// The scanner keeps its workspace from its first command to its last.
TEST(ScanBatch, TheScannerLeavesAWorkspaceThatAnotherScans) {
  const TemporaryFolder folder;
  const Workspace workspace{folder / "w"};
  fs::create_directories(workspace.root);
  Reporter silent;
  const WorkspaceLock lock(workspace, workspace.ScanLockFile(), silent);
  const ProcessResult result =
      RunProcess({S2GS_PROGRAM, "automatic_scanner", "--workspace_path", workspace.root.string(),
                  "--image_path", S2GS_PHOTOS, "--quality", "low", "--use_gpu", "0"});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, AllOf(HasSubstr("another s2gs (process "), HasSubstr("works in this workspace")));
  EXPECT_FALSE(fs::exists(workspace.Database()));
}

TEST(ScanBatch, NamesWrongRowsByLineAndScansTheOthers) {
  const TemporaryFolder folder;
  fs::create_directories(folder / "empty");
  folder.Write(
      "objects.csv",
      "images,workspace,options\nempty,w1,--qualty low\nempty,w2,--quality low --use_gpu 0\nnot,w3,\n");
  const std::string list = (folder / "objects.csv").string();
  const ProcessResult result = RunProcess({S2GS_PROGRAM, "scan_batch", "--list", list});
  EXPECT_EQ(result.exit_code, 1);
  EXPECT_THAT(result.err, AllOf(HasSubstr("objects.csv, line 2: unknown option --qualty"),
                                HasSubstr("objects.csv, line 4: "), HasSubstr("3 of 3 objects have failed")));
  EXPECT_THAT(result.out, AllOf(HasSubstr("begins     line 3: "), HasSubstr("has no photos"),
                                HasSubstr("3 objects: 1 failed, 2 wrong")));
  EXPECT_TRUE(fs::exists(folder / "objects/index.html"));
  // One row alone, as a cluster's task; its number counts objects.
  const ProcessResult row = RunProcess({S2GS_PROGRAM, "scan_batch", "--list", list, "--rows", "2"});
  EXPECT_EQ(row.exit_code, 1);
  EXPECT_THAT(row.out, AllOf(HasSubstr("1 object: 1 failed"), Not(HasSubstr("line 2"))));
  EXPECT_EQ(RunProcess({S2GS_PROGRAM, "scan_batch", "--list", list, "--rows", "4"}).exit_code, 2);
  // Looking is no failure, and runs nothing.
  const ProcessResult look = RunProcess({S2GS_PROGRAM, "scan_batch", "--list", list, "--run", "0"});
  EXPECT_EQ(look.exit_code, 0);
  EXPECT_THAT(look.out, AllOf(HasSubstr("3 objects: 1 failed, 2 wrong"), Not(HasSubstr("begins"))));
  EXPECT_THAT(look.err, AllOf(HasSubstr("line 2: "), HasSubstr("line 4: "), Not(HasSubstr("line 3: "))));
}

}  // namespace
}  // namespace s2gs
