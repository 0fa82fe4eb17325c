#include "plugin/curves/sweep.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <set>
#include <sstream>
#include <string>

#include "mesh/surface/triangle_mesh.h"
#include "plugin/curves/point_errors.h"
#include "plugin/stage/stage_stamp.h"
#include "plugin/stage/workspace.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// A square of side 1 at a height.
TriangleMesh Square(float height) {
  TriangleMesh mesh;
  mesh.vertices = {{0, 0, height}, {1, 0, height}, {1, 1, height}, {0, 1, height}};
  mesh.triangles = {{0, 1, 2}, {0, 2, 3}};
  return mesh;
}

// The last measurement counts, whatever else the log says after it.
TEST(TrainingFigures, AreThoseOfTheLastMeasurement) {
  const TemporaryFolder folder;
  const Workspace workspace{folder / "scan"};
  EXPECT_TRUE(TrainingFigures(workspace).empty());
  WriteAll(workspace.Log(), R"({"event": "held_out", "psnr_db": 20, "count": 5, "mask_iou": 0.5}
{"event": "held_out", "psnr_db": 40, "ssim": 0.75, "count": 7, "iteration": 9, "object_psnr_db": null}
{"event": "loss", "psnr_db": 1, "count": 8}
[1, 2]
"text"
{"event": "held_o)");
  EXPECT_EQ(TrainingFigures(workspace),
            (std::map<std::string, double>{
                {"psnr_db", 40}, {"ssim", 0.75}, {"count", 7}, {"iteration", 9}, {"held_out_rmse", 0.01}}));
}

// A scan with a mesh, a database and a stage that counts as done; and a program that stands for s2gs: its
// mesher takes the mesh of its value, fails for the value "bad", and notes every run.
class SweepTest : public testing::Test {
 protected:
  void SetUp() override {
    scan_.root = folder_ / "scan";
    WriteAll(scan_.Database(), "features");
    WriteAll(scan_.DepthMap("a.jpg"), "depths");
    WriteAll(scan_.TsdfMesh(), "of another run");
    WriteAll(scan_.Images() / "a.jpg", "photo");
    for (const char* value : {"1", "2", "4"}) {
      const fs::path path = folder_ / ("mesh_" + std::string(value) + ".ply");
      WritePlyMesh(path, Square(0.1F / std::stof(value)));
    }
    folder_.Write("program",
                  "#!/bin/sh\n"
                  "echo \"$*\" >> " +
                      (folder_ / "calls").string() +
                      "\n"
                      "while [ $# -gt 0 ]; do case $1 in\n"
                      "--workspace_path) workspace=$2;; --knob) value=$2;; esac; shift; done\n"
                      "test -e \"$workspace/dense/0/meshed-tsdf.ply\" && { echo left over; exit 1; }\n"
                      "test -e \"$workspace/images/a.jpg\" || { echo no photos; exit 1; }\n"
                      "[ $value = bad ] && { echo it broke; exit 1; }\n"
                      "[ $value = refused ] && { echo s2gs: error: no; echo Run it; echo; exit 2; }\n"
                      "cp " +
                      folder_.path().string() +
                      "/mesh_$value.ply "
                      "\"$workspace/dense/0/meshed-tsdf.ply\"\n");
    fs::permissions(folder_ / "program", fs::perms::owner_all);
    options_.knob = FindKnob("tsdf_mesher.knob");
    options_.scenes = {{scan_.root, "", ""}};
    options_.values = {"1", "bad", "2", "4"};
    options_.seeds = {0, 5};
    options_.program = folder_ / "program";
  }

  int Calls() const {
    const std::string calls = folder_.Read("calls");
    return static_cast<int>(std::count(calls.begin(), calls.end(), '\n'));
  }

  TemporaryFolder folder_;
  Workspace scan_;
  SweepOptions options_;
  Reporter silent_;
};

TEST_F(SweepTest, MeasuresEveryValueAgainstTheLongestRun) {
  for (const int jobs : {2, 1}) {  // the second time everything is done
    options_.jobs = jobs;
    const WorkCurve curve = RunSweep(options_, silent_);
    EXPECT_EQ(Calls(), 8);
    EXPECT_EQ(curve.values, std::vector<std::string>({"1", "bad", "2"}));
    EXPECT_THAT(curve.reference, testing::HasSubstr("longest run"));
    ASSERT_EQ(curve.points.size(), 6U);
    for (const WorkPoint& point : curve.points) {
      if (point.value == "bad") {
        EXPECT_EQ(point.failure, "tsdf_mesher: it broke");
        continue;
      }
      EXPECT_EQ(point.failure, "");
      // Parallel squares: Chamfer distance is what lies between them, over the ruler's diagonal.
      const double between = 0.1 / std::stod(point.value) - 0.1 / 4;
      EXPECT_NEAR(point.Figure("own_chamfer_pct").value_or(-1), 100 * between / std::sqrt(2.0), 1e-4);
    }
  }
  // The scan is as it was, and of the runs only what comparisons need is left.
  EXPECT_EQ(ReadAll(scan_.TsdfMesh()), "of another run");
  const Workspace run{scan_.root / "work_precision" / "tsdf_mesher.knob" / "2_seed5"};
  EXPECT_TRUE(fs::exists(run.TsdfMesh()));
  EXPECT_FALSE(fs::exists(run.Database()));
  EXPECT_FALSE(fs::exists(run.Images()));
  EXPECT_TRUE(fs::exists(scan_.Images() / "a.jpg"));
}

// A command's message is why, not what follows it.
TEST_F(SweepTest, SaysWhyARunFailed) {
  options_.values = {"1", "refused", "4"};
  options_.seeds = {0};
  const WorkCurve curve = RunSweep(options_, silent_);
  ASSERT_EQ(curve.points.size(), 2U);
  EXPECT_EQ(curve.points[1].failure, "tsdf_mesher: no Run it");
}

TEST_F(SweepTest, ArgumentsGoBeforeWhatTheKnobAsksFor) {
  options_.knob.fixed = {{"size", "1600"}, {"other", "2"}};
  options_.arguments = {"size=800"};
  RunSweep(options_, silent_);
  const std::string calls = folder_.Read("calls");
  EXPECT_THAT(calls, testing::HasSubstr("--size 800"));
  EXPECT_THAT(calls, testing::Not(testing::HasSubstr("1600")));
  EXPECT_THAT(calls, testing::HasSubstr("--other 2"));
}

// Where a value stands for several options, a run has those of its own value, for its own command.
TEST_F(SweepTest, AValueMayStandForSeveralOptions) {
  options_.values = {"1", "2", "4"};
  options_.seeds = {0};
  for (const std::string value : {"1", "2", "4"}) {
    options_.knob.settings.push_back({value, "tsdf_mesher", {{"knob", value}, {"size", value + value}}});
    options_.knob.settings.push_back({value, "mesh_texturer", {{"texels", value}}});
  }
  RunSweep(options_, silent_);
  std::istringstream calls(folder_.Read("calls"));
  std::string line;
  std::set<std::string> sizes;
  while (std::getline(calls, line)) {
    const size_t at = line.find("--size ");
    ASSERT_NE(at, std::string::npos) << line;
    EXPECT_EQ(line.find("--size ", at + 1), std::string::npos) << line;
    EXPECT_EQ(line.find("--texels"), std::string::npos) << line;
    sizes.insert(line.substr(at + 7, 2));
  }
  EXPECT_EQ(sizes, (std::set<std::string>{"11", "22", "44"}));
}

// A stage before those that run again has run anew: so do they.
TEST_F(SweepTest, EarlierStagesCount) {
  StageStamp stamp;
  stamp.run_id = "1";
  WriteStageStamp(scan_, "gaussian_renderer", stamp);
  WriteStageStamp(scan_, "tsdf_mesher", stamp);
  RunSweep(options_, silent_);
  EXPECT_EQ(Calls(), 8);
  stamp.run_id = "2";
  WriteStageStamp(scan_, "tsdf_mesher", stamp);  // which runs anyway
  RunSweep(options_, silent_);
  EXPECT_EQ(Calls(), 8);
  WriteStageStamp(scan_, "gaussian_renderer", stamp);
  RunSweep(options_, silent_);
  EXPECT_EQ(Calls(), 16);
}

TEST_F(SweepTest, OtherSettingsRunAgain) {
  RunSweep(options_, silent_);
  EXPECT_EQ(Calls(), 8);
  options_.arguments = {"more=a {workspace}/b"};
  RunSweep(options_, silent_);
  EXPECT_EQ(Calls(), 16);
  EXPECT_THAT(folder_.Read("calls"), testing::HasSubstr("--more a " + scan_.root.string() + "/b --knob "));
  options_.values.insert(options_.values.begin(), "3");  // one new value: its two runs alone, which fail
  RunSweep(options_, silent_);
  EXPECT_EQ(Calls(), 18);
}

// What a seed starts from is made once, though the runs are made again.
TEST_F(SweepTest, StartsOfSeedsAreKept) {
  folder_.Write("program",
                "#!/bin/sh\necho \"$*\" >> " + (folder_ / "calls").string() +
                    "\nwhile [ $# -gt 0 ]; do case $1 in --workspace_path) workspace=$2;; esac; shift; done\n"
                    "echo {} > \"$workspace/turntable.json\"\n");
  fs::permissions(folder_ / "program", fs::perms::owner_all);
  options_.knob = FindKnob("turntable_mapper.knob");
  const auto num_starts = [&] {
    std::istringstream lines(folder_.Read("calls"));
    int num = 0;
    for (std::string line; std::getline(lines, line);)
      num += line.find("start_seed") != std::string::npos && line.find("--knob") == std::string::npos ? 1 : 0;
    return num;
  };
  RunSweep(options_, silent_);
  EXPECT_EQ(num_starts(), 2);  // one a seed
  RunSweep(options_, silent_);
  EXPECT_EQ(num_starts(), 2);
}

// The scan's features are those that automatic_scanner asked for; a sweep of the split must not look for
// others, which the defaults of motion_splitter would.
TEST_F(SweepTest, FeaturesOfTheScanAreKept) {
  StageStamp stamp;
  stamp.run_id = "1";
  stamp.options = {{"SiftExtraction.max_num_features", "1234"}, {"SiftExtraction.num_threads", ""}};
  WriteStageStamp(scan_, "feature_extractor", stamp);
  options_.knob = FindKnob("motion_splitter.knob");
  RunSweep(options_, silent_);
  EXPECT_THAT(folder_.Read("calls"), testing::HasSubstr("--SiftExtraction.max_num_features 1234"));
  EXPECT_THAT(folder_.Read("calls"), testing::Not(testing::HasSubstr("SiftExtraction.num_threads")));
  // Asked for otherwise, they are others.
  folder_.Write("calls", "");
  options_.arguments = {"SiftExtraction.max_num_features=99"};
  RunSweep(options_, silent_);
  EXPECT_THAT(folder_.Read("calls"), testing::HasSubstr("--SiftExtraction.max_num_features 99"));
  EXPECT_THAT(folder_.Read("calls"), testing::Not(testing::HasSubstr("1234")));
  // Other stages have no such options.
  folder_.Write("calls", "");
  options_.arguments.clear();
  options_.knob = FindKnob("tsdf_mesher.knob");
  RunSweep(options_, silent_);
  EXPECT_THAT(folder_.Read("calls"), testing::HasSubstr("tsdf_mesher"));
  EXPECT_THAT(folder_.Read("calls"), testing::Not(testing::HasSubstr("SiftExtraction")));
}

TEST_F(SweepTest, RefusesWhatCannotBeSwept) {
  const auto refused = [&](const auto& change, const std::string& message) {
    SweepOptions options = options_;
    change(&options);
    ExpectUserError([&] { RunSweep(options, silent_); }, {message});
  };
  refused([](SweepOptions* o) { o->values = {"1"}; }, "two values");
  refused([](SweepOptions* o) { o->values = {"1", "2", "1"}; }, "twice");
  refused([](SweepOptions* o) { o->arguments = {"more"}; }, "NAME=VALUE");
  refused([](SweepOptions* o) { o->seeds.clear(); }, "seed");
  refused([](SweepOptions* o) { o->scenes[0].workspace = "/nowhere"; }, "no such folder");
}

}  // namespace
}  // namespace s2gs
