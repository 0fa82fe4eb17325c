#include "plugin/stage/stage.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "plugin/cli/version.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/stopwatch.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

class Recorder : public Reporter {
 public:
  void Log(LogLevel level, std::string_view message) override {
    text += std::string(message) + "\n";
    if (level >= LogLevel::kWarning) warnings += std::string(message) + "\n";
  }
  bool StopRequested() const override { return is_stopped; }
  std::string text;
  std::string warnings;
  bool is_stopped = false;
};

// A pipeline of three stages: photos -> match -> train -> mesh, where "cloud" is trained from the matches and
// the photos.
struct Pipeline {
  TemporaryFolder folder;
  Workspace workspace{folder.path()};
  Recorder log;
  std::map<std::string, std::string> match_options{{"Match.ratio", "0.8"}};
  std::map<std::string, std::string> train_options{{"Train.steps", "100"}, {"random_seed", "0"}};

  Pipeline() {
    WriteAll(folder / "images/a.jpg", "photo a");
    WriteAll(folder / "images/b.jpg", "photo b");
  }

  std::vector<Stage> Stages() const {
    return {
        {"match", {workspace.Images()}, match_options, {workspace.Database()}, {}},
        {"train", {workspace.Images(), folder / "masks"}, train_options, {workspace.PointCloud()}, {"match"}},
        {"mesh", {workspace.PointCloud()}, {}, {workspace.TsdfMesh(), folder / "maps"}, {"train"}}};
  }

  // Runs all; returns the names of those that ran.
  std::vector<std::string> Run() {
    log.text.clear();
    log.warnings.clear();
    StageRunner runner(workspace, log);
    std::vector<std::string> ran;
    for (const Stage& stage : Stages()) {
      const bool did_run = runner.Run(stage, [&] {
        for (const fs::path& output : stage.outputs)
          WriteAll(output == folder / "maps" ? output / "a" : output, "made by " + stage.name);
      });
      if (did_run) ran.push_back(stage.name);
    }
    return ran;
  }

  StageStatus Status(const std::string& name) {
    for (const StageStatus& status : CheckStages(workspace, log)) {
      if (status.name == name) return status;
    }
    return {"absent", StageState::kMissing, "not listed", {}};
  }
};

TEST(StageRunner, WritesThroughNoLinkOutOfTheWorkspace) {
  for (const char* place : {"dense", "dense/0/meshed-tsdf.ply", "maps", "s2gs/point_cloud.ply"}) {
    Pipeline p;
    const TemporaryFolder outside;
    WriteAll(outside / "photo", "photo");
    fs::create_directories((p.folder / place).parent_path());
    fs::create_symlink(outside.path() / (fs::path(place).extension() == ".ply" ? "photo" : ""),
                       p.folder / place);
    ExpectUserError([&] { p.Run(); }, {place, "nothing is written there", "Remove the link"}, place);
    EXPECT_EQ(ReadAll(outside / "photo"), "photo");
    EXPECT_EQ(std::distance(fs::directory_iterator(outside.path()), fs::directory_iterator()), 1) << place;
    fs::remove(p.folder / place);
    EXPECT_THAT(p.Run(), testing::Contains("mesh")) << place;
    // What is done needs nothing written.
    fs::rename(p.folder / "maps", outside / "maps");
    fs::create_symlink(outside / "maps", p.folder / "maps");
    EXPECT_THAT(p.Run(), IsEmpty()) << place;
  }
}

TEST(StageRunner, TakesNoPhotoForItsLock) {
  Pipeline p;
  fs::create_directories(p.workspace.Own());
  fs::create_symlink(p.folder / "images/../../photo", p.workspace.LockFile());
  ExpectUserError([&] { StageRunner(p.workspace, p.log); }, {"s2gs/lock", "symbolic link"});
  // Nor one in the workspace.
  fs::remove(p.workspace.LockFile());
  WriteAll(p.folder / "images/a.jpg", "photo");
  fs::create_symlink("../images/a.jpg", p.workspace.LockFile());
  ExpectUserError([&] { StageRunner(p.workspace, p.log); }, {"s2gs/lock", "another file"});
  EXPECT_EQ(ReadAll(p.folder / "images/a.jpg"), "photo");
}

TEST(StageRunner, MayWriteMoreThanItsOutputs) {
  Pipeline p;
  const TemporaryFolder outside;
  fs::create_symlink(outside.path(), p.folder / "sparse");
  Stage stage{"match", {}, {}, {p.workspace.Database()}, {}, {p.folder / "sparse/static"}};
  StageRunner runner(p.workspace, p.log);
  ExpectUserError([&] { runner.Run(stage, [] { FAIL() << "was begun"; }); },
                  {"sparse", outside.path().string()});
}

TEST(StageRunner, SkipsWhatIsDone) {
  Pipeline p;
  EXPECT_THAT(p.Run(), ElementsAre("match", "train", "mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("match: runs (not done yet)\nmatch: done in 0."));
  EXPECT_THAT(p.Run(), IsEmpty());
  EXPECT_EQ(p.log.text, "match: up to date\ntrain: up to date\nmesh: up to date\n");
  EXPECT_THAT(p.log.warnings, IsEmpty());
}

TEST(StageRunner, AChangedOptionRunsItsStageAndWhatFollows) {
  Pipeline p;
  p.Run();
  p.train_options["Train.steps"] = "200";
  EXPECT_THAT(p.Run(), ElementsAre("train", "mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("train: runs (option Train.steps changed from \"100\" to \"200\")"));
  EXPECT_THAT(p.log.text, HasSubstr("mesh: runs (train ran again)"));
  EXPECT_THAT(p.Run(), IsEmpty());
  p.train_options["Train.new"] = "1";
  EXPECT_THAT(p.Run(), ElementsAre("train", "mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("option Train.new is new"));
  p.train_options.erase("Train.new");
  EXPECT_THAT(p.Run(), ElementsAre("train", "mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("option Train.new is gone"));
}

TEST(StageRunner, AChangedInputRunsWhatReadsIt) {
  Pipeline p;
  p.Run();
  WriteAll(p.folder / "images/b.jpg", "photo B");  // of the same size
  EXPECT_THAT(p.Run(), ElementsAre("match", "train", "mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("match: runs (images changed)"));
  WriteAll(p.folder / "images/c.jpg", "photo c");
  EXPECT_THAT(p.Run(), ElementsAre("match", "train", "mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("match: runs (images has 3 files, not 2)"));
  WriteAll(p.folder / "masks/a.png", "mask");
  EXPECT_THAT(p.Run(), ElementsAre("train", "mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("train: runs (masks appeared)"));
  fs::remove_all(p.folder / "masks");
  EXPECT_THAT(p.Run(), ElementsAre("train", "mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("train: runs (masks is gone)"));
}

TEST(StageRunner, TouchedOrCopiedInputsRunNothing) {
  Pipeline p;
  p.Run();
  fs::last_write_time(p.folder / "images/a.jpg", fs::file_time_type::clock::now() - std::chrono::hours(5));
  EXPECT_THAT(p.Run(), IsEmpty());
  // A workspace that was moved, or copied without its times.
  const TemporaryFolder other;
  fs::copy(p.folder.path(), other / "copy", fs::copy_options::recursive);
  p.workspace.root = other / "copy";
  StageRunner runner(p.workspace, p.log);
  const Stage match = {"match", {p.workspace.Images()}, p.match_options, {p.workspace.Database()}, {}};
  EXPECT_FALSE(runner.Run(match, [] { FAIL(); }));
}

TEST(StageRunner, MissingOutputsAreMadeAgain) {
  Pipeline p;
  p.Run();
  fs::remove(p.workspace.PointCloud());
  EXPECT_THAT(p.Run(), ElementsAre("train", "mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("train: runs (s2gs/point_cloud.ply is missing)"));
  WriteAll(p.folder / "maps/b", "by another program");
  EXPECT_THAT(p.Run(), IsEmpty());
  fs::remove(p.folder / "maps/a");
  fs::remove(p.folder / "maps/b");
  EXPECT_THAT(p.Run(), ElementsAre("mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("1 of the 1 files of maps are missing"));
  WriteAll(p.workspace.Database(), "");
  EXPECT_THAT(p.Run(), ElementsAre("match", "train", "mesh"));
  EXPECT_THAT(p.log.text, HasSubstr("database.db is empty"));
  // A later stage, or the user, may add to an output.
  WriteAll(p.workspace.Database(), "made by match and more");
  EXPECT_THAT(p.Run(), IsEmpty());
}

TEST(StageRunner, OtherFilesOrStagesCount) {
  Pipeline p;
  StageRunner runner(p.workspace, p.log);
  Stage stage = p.Stages()[0];
  const auto work = [&] { WriteAll(p.workspace.Database(), "x"); };
  EXPECT_TRUE(runner.Run(stage, work));
  EXPECT_FALSE(runner.Run(stage, work));
  stage.inputs.push_back(p.folder / "more");
  EXPECT_TRUE(runner.Run(stage, work));
  EXPECT_THAT(p.log.text, HasSubstr("reads other files than before"));
  stage.depends_on = {"plan"};
  EXPECT_TRUE(runner.Run(stage, work));
  EXPECT_FALSE(runner.Run(stage, work));
  // The stage before it runs for the first time.
  EXPECT_TRUE(runner.Run({"plan", {}, {}, {}, {}}, [] {}));
  EXPECT_TRUE(runner.Run(stage, work));
  EXPECT_THAT(p.log.text, HasSubstr("match: runs (plan ran again)"));
}

TEST(StageRunner, WhatFailedRunsAgain) {
  Pipeline p;
  p.Run();
  p.match_options["Match.ratio"] = "0.7";
  {
    StageRunner runner(p.workspace, p.log);
    EXPECT_THROW(runner.Run(p.Stages()[0], [] { throw std::runtime_error("no"); }), std::runtime_error);
  }
  // Its old output is still there, but it is not done: not with the new options, nor with the old ones.
  p.match_options["Match.ratio"] = "0.8";
  EXPECT_EQ(p.Status("match").state, StageState::kMissing);
  EXPECT_THAT(p.Run(), ElementsAre("match", "train", "mesh"));
}

TEST(StageRunner, PromisedOutputsMustExist) {
  Pipeline p;
  StageRunner runner(p.workspace, p.log);
  ExpectUserError([&] { runner.Run(p.Stages()[0], [] {}); },
                  {p.workspace.Database().string(), "match ended without writing it"});
  EXPECT_FALSE(fs::exists(p.workspace.StageStamp("match")));
}

TEST(StageRunner, InterruptedPipelinesResume) {
  Pipeline p;
  {
    StageRunner runner(p.workspace, p.log);
    const std::vector<Stage> stages = p.Stages();
    runner.Run(stages[0], [&] { WriteAll(p.workspace.Database(), "x"); });
    p.log.is_stopped = true;
    EXPECT_THROW(runner.Run(stages[1], [] { FAIL(); }), Interrupted);
    p.log.is_stopped = false;
  }
  EXPECT_THAT(p.Run(), ElementsAre("train", "mesh"));
}

TEST(StageRunner, RefusesASecondRunInTheWorkspace) {
  Pipeline p;
  const StageRunner runner(p.workspace, p.log);
  ExpectUserError([&] { StageRunner(p.workspace, p.log); }, {"another s2gs"});
}

TEST(StageRunner, StampsSayWhatWasDone) {
  Pipeline p;
  p.Run();
  const auto json = nlohmann::json::parse(ReadAll(p.workspace.StageStamp("train")));
  EXPECT_EQ(json.at("stage"), "train");
  EXPECT_EQ(json.at("options").at("Train.steps"), "100");
  EXPECT_EQ(json.at("inputs").at(0).at("path"), "images");
  EXPECT_EQ(json.at("inputs").at(0).at("files"), 2);
  EXPECT_EQ(json.at("inputs").at(1).at("exists"), false);
  EXPECT_EQ(json.at("outputs").at(0).at("path"), "s2gs/point_cloud.ply");
  EXPECT_EQ(json.at("upstream").at("match").get<std::string>().size(), 16U);
  EXPECT_GE(json.at("seconds").get<double>(), 0);
}

// Both stages' seconds add up to what both took, unless the inner one is given up.
TEST(StageRunner, SecondsOfAStageInsideAreItsOwn) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  Reporter reporter;
  for (const bool is_given_up : {false, true}) {
    StageRunner runner(workspace, reporter);
    const std::string inner = is_given_up ? "given_up" : "inner";
    const double begin = SteadySeconds();
    double inner_seconds = 0;
    runner.Run({is_given_up ? "without" : "outer", {}, {}, {}, {}}, [&] {
      const double inner_begin = SteadySeconds();
      runner.Run({inner, {}, {}, {}, {}}, [] { std::this_thread::sleep_for(std::chrono::milliseconds(20)); });
      inner_seconds = SteadySeconds() - inner_begin;
      if (is_given_up) RemoveStageStamp(workspace, inner);
    });
    const double total = SteadySeconds() - begin;
    const double outer = ReadStageStamp(workspace, is_given_up ? "without" : "outer", reporter)->seconds;
    if (is_given_up) {
      EXPECT_GE(outer, inner_seconds);
    } else {
      EXPECT_LE(outer + ReadStageStamp(workspace, inner, reporter)->seconds, total);
    }
  }
}

TEST(CheckStages, TellsDoneStaleMissingAndForeign) {
  Pipeline p;
  p.Run();
  for (const std::string name : {"match", "train", "mesh"})
    EXPECT_EQ(p.Status(name).state, StageState::kDone) << name;
  EXPECT_EQ(p.Status("turntable_mapper").state, StageState::kMissing);
  // database.db is there, but no stage of that name wrote it.
  EXPECT_EQ(p.Status("feature_extractor").state, StageState::kForeign);
  WriteAll(p.folder / "masks/a.png", "mask");
  EXPECT_EQ(p.Status("match").state, StageState::kDone);
  EXPECT_EQ(p.Status("train").state, StageState::kStale);
  EXPECT_EQ(p.Status("train").reason, "masks appeared");
  EXPECT_EQ(p.Status("mesh").reason, "train is stale");
  fs::remove(p.workspace.StageStamp("match"));
  EXPECT_EQ(p.Status("train").reason, "masks appeared");
  fs::remove_all(p.folder / "masks");
  EXPECT_EQ(p.Status("train").reason, "match is not done");
}

TEST(CheckStages, SurvivesStampsThatDependOnEachOther) {
  Pipeline p;
  Reporter silent;
  for (const std::string name : {"a", "b"}) {
    StageStamp stamp;
    stamp.run_id = "1";
    stamp.program_version = Version();
    stamp.upstream = {{name == "a" ? "b" : "a", "1"}};
    if (name == "a") stamp.outputs = {{"missing.txt", {}}};
    WriteStageStamp(p.workspace, name, stamp);
  }
  EXPECT_EQ(p.Status("a").reason, "missing.txt is missing");
  EXPECT_EQ(p.Status("b").reason, "a is stale");
}

TEST(StageRunner, AnotherVersionRunsEveryStageAgain) {
  Pipeline pipeline;
  pipeline.Run();
  EXPECT_THAT(pipeline.Run(), IsEmpty());
  std::optional<StageStamp> stamp = ReadStageStamp(pipeline.workspace, "match", pipeline.log);
  ASSERT_TRUE(stamp);
  stamp->program_version = "0.0.1";
  WriteStageStamp(pipeline.workspace, "match", *stamp);
  EXPECT_EQ(pipeline.Status("match").state, StageState::kStale);
  EXPECT_THAT(pipeline.Status("match").reason, HasSubstr("0.0.1"));
  EXPECT_THAT(pipeline.Run(), ElementsAre("match", "train", "mesh"));
  EXPECT_THAT(pipeline.Run(), IsEmpty());
}

TEST(StageRunner, ADamagedStampMakesTheStageRunAgain) {
  Pipeline p;
  p.Run();
  WriteAll(p.workspace.StageStamp("mesh"), "{");
  EXPECT_THAT(p.Run(), ElementsAre("mesh"));
}

}  // namespace
}  // namespace s2gs
