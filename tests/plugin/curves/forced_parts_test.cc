#include "plugin/curves/forced_parts.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// A trained scan, and a program that stands for s2gs: held-out photos are worse where p is learnt to the end,
// and equal where the channel of distortion is on.
TEST(ForcedParts, CostAndGainAreAgainstTheRunAsPlanned) {
  TemporaryFolder folder;
  const Workspace scan{folder / "scan"};
  WriteAll(scan.PointCloud(), "model");
  WriteAll(scan.Images() / "a.jpg", "photo");
  WriteAll(
      scan.Log(),
      R"({"event": "decision", "part": "learning_p", "left_out": true, "measured": "", "threshold": "", )"
      R"("reason": "", "saving": ""})");
  folder.Write(
      "program",
      "#!/bin/sh\n"
      "echo \"$*\" >> " +
          (folder / "calls").string() +
          "\n"
          "psnr=20; while [ $# -gt 0 ]; do case $1 in\n"
          "--workspace_path) workspace=$2;; --Train.settle_until) psnr=18;; esac; shift; done\n"
          "mkdir -p \"$workspace/s2gs\"\n"
          "echo '{\"event\": \"held_out\", \"psnr_db\": '$psnr'}' > \"$workspace/s2gs/log.jsonl\"\n");
  fs::permissions(folder / "program", fs::perms::owner_all);
  SweepOptions options;
  options.scenes = {{scan.root, "", ""}};
  options.program = folder / "program";
  options.arguments = {"gaussian_trainer.quality=low", "tsdf_mesher.nothing=1"};
  Reporter silent;
  const std::vector<ForcedPart> parts =
      MeasureForcedParts(options, {"learning_p", "distortion_channel"}, silent).Parts();
  ASSERT_EQ(parts.size(), 2U);
  EXPECT_EQ(parts[0].part, "distortion_channel");
  EXPECT_NEAR(parts[0].GainPct(), 0, 1e-9);
  EXPECT_TRUE(std::isnan(parts[0].gain_sigma));
  EXPECT_EQ(parts[1].part, "learning_p");
  EXPECT_NEAR(parts[1].planned_error.median, 0.1, 1e-12);  // 20 dB
  EXPECT_NEAR(parts[1].GainPct(), 100 * (1 - std::pow(10, 0.1)), 1e-9);
  const std::string calls = folder.Read("calls");
  EXPECT_EQ(std::count(calls.begin(), calls.end(), '\n'), 3);  // as planned, and once for each
  EXPECT_THAT(calls, testing::HasSubstr("--quality low --Train.distortion_weight 100"));
  EXPECT_THAT(calls, testing::Not(testing::HasSubstr("nothing")));
  // The plan says itself what is left out: the same two.
  const std::vector<ForcedPart> planned = MeasureForcedParts(options, {}, silent).Parts();
  ASSERT_EQ(planned.size(), 2U);
  EXPECT_EQ(planned[1].part, "learning_p");
  std::ostringstream csv;
  WriteForcedCsv(parts, csv);
  EXPECT_THAT(csv.str(), testing::HasSubstr("\"scan\",learning_p,"));
}

// Seeds: errors fall by .01, .02 and .03, a mean of .02 with a standard error of .01 / sqrt(3). What the part
// sets goes before the same option among the arguments.
TEST(ForcedParts, GainOfSeedsInStandardErrors) {
  TemporaryFolder folder;
  const Workspace scan{folder / "scan"};
  WriteAll(scan.PointCloud(), "model");
  WriteAll(scan.Images() / "a.jpg", "photo");
  WriteAll(scan.Log(), "");
  // PSNR of errors 0.1, 0.2, 0.3 as planned, and of 0.09, 0.18, 0.27 when forced.
  folder.Write(
      "program",
      "#!/bin/sh\n"
      "weight=0; seed=0; while [ $# -gt 0 ]; do case $1 in\n"
      "--workspace_path) workspace=$2;; --random_seed) seed=$2;; --Train.distortion_weight) weight=$2;; "
      "esac; "
      "shift; done\n"
      "case $weight$seed in 50) psnr=20;; 51) psnr=13.979400086720375;; 52) psnr=10.457574905606752;;\n"
      "1000) psnr=20.91514981121350;; 1001) psnr=14.89454989793388;; 1002) psnr=11.37272471682025;; esac\n"
      "mkdir -p \"$workspace/s2gs\"\n"
      "echo '{\"event\": \"held_out\", \"psnr_db\": '$psnr'}' > \"$workspace/s2gs/log.jsonl\"\n");
  fs::permissions(folder / "program", fs::perms::owner_all);
  SweepOptions options;
  options.scenes = {{scan.root, "", ""}};
  options.program = folder / "program";
  options.seeds = {0, 1, 2};
  options.arguments = {"gaussian_trainer.Train.distortion_weight=5"};
  Reporter silent;
  const ForcedRuns runs = MeasureForcedParts(options, {"distortion_channel"}, silent);
  const std::vector<ForcedPart> parts = runs.Parts();
  ASSERT_EQ(parts.size(), 1U);
  EXPECT_EQ(parts[0].failure, "");
  EXPECT_NEAR(parts[0].GainPct(), 10, 1e-9);
  ASSERT_TRUE(parts[0].mean_gain.has_value());
  EXPECT_NEAR(*parts[0].mean_gain, 0.02, 1e-12);
  EXPECT_NEAR(parts[0].gain_sigma, 0.01 / std::sqrt(3.0), 1e-12);
  EXPECT_NEAR(parts[0].GainSigmas(), 2 * std::sqrt(3.0), 1e-9);
  EXPECT_EQ(parts[0].seeds, 3);
  std::ostringstream text;
  WriteForcedJson(runs, text);
  const nlohmann::json json = nlohmann::json::parse(text.str());
  EXPECT_NEAR(json["parts"][0]["mean_gain"].get<double>(), 0.02, 1e-12);
}

// Poses: the gain is also told in what the adjustment as planned says of the tilt, 0.04 degrees, and a failed
// or silent adjustment tells none.
TEST(ForcedParts, GainOfPosesInStandardDeviations) {
  TemporaryFolder folder;
  const Workspace scan{folder / "scan"};
  WriteAll(scan.Images() / "a.jpg", "photo");
  WriteAll(scan.Database(), "features");
  folder.Write("program",
               "#!/bin/sh\n"
               "command=$1; rot=0.05; while [ $# -gt 0 ]; do case $1 in\n"
               "--workspace_path) w=$2;; --database_path) w=$(dirname \"$2\");; --json_path) json=$2;;\n"
               "--weak_features_always) touch \"$w/weak\";; esac; shift; done\n"
               "case $command in turntable_mapper) mkdir -p \"$w/split\"\n"
               "echo '{\"sigma\": {\"axis_direction_deg\": 0.04}}' > \"$w/split/turntable_mapper.json\";;\n"
               "scan_evaluator) [ -e \"$w/weak\" ] && rot=0.03\n"
               "echo '{\"figures\": {\"object_rot_deg\": {\"median\": '$rot'}}}' > \"$json\";; esac\n");
  fs::permissions(folder / "program", fs::perms::owner_all);
  SweepOptions options;
  options.scenes = {{scan.root, "", folder / "truth"}};
  options.program = folder / "program";
  Reporter silent;
  const ForcedRuns runs = MeasureForcedParts(options, {"weak_features"}, silent);
  const std::vector<ForcedPart> parts = runs.Parts();
  ASSERT_EQ(parts.size(), 1U);
  EXPECT_EQ(parts[0].failure, "");
  EXPECT_NEAR(parts[0].GainPct(), 40, 1e-9);
  EXPECT_NEAR(parts[0].gain_sigma, 0.04, 1e-12);
  EXPECT_NEAR(parts[0].GainSigmas(), 0.5, 1e-9);
  std::ostringstream json;
  WriteForcedJson(runs, json);
  EXPECT_THAT(json.str(), testing::HasSubstr("\"gain_sigma\": 0.04"));
}

// Calls of one seed each say together what one call of all seeds says: the second scene has another mean, the
// seed without a planned run does not count, nor does the run that failed, which is named.
TEST(ForcedParts, CallsOfSeveralSeedsAreSummedUpTogether) {
  const auto call = [](const std::string& scene, uint64_t seed,
                       std::vector<std::pair<std::string, double>> errors) {
    WorkCurve curve;
    curve.knob = "forced_training";
    curve.error = "held_out_rmse";
    curve.error_text = "RMS error";
    curve.reference = "photos held out of training";
    curve.scenes = {scene};
    curve.values = {"planned", "sh_bands", "learning_p"};
    for (const auto& [value, error] : errors) {
      WorkPoint point;
      point.value = value;
      point.seed = seed;
      point.cpu_seconds = 10 + static_cast<double>(seed);
      if (error > 0) point.figures["held_out_rmse"] = error;
      if (error <= 0) point.failure = "no memory";
      curve.points.push_back(point);
    }
    return ForcedRuns{{curve}};
  };
  TemporaryFolder folder;
  std::vector<ForcedRuns> read;
  const std::vector<ForcedRuns> calls = {
      call("a", 0, {{"planned", 4}, {"sh_bands", 3}, {"learning_p", 0}}),
      call("a", 1, {{"planned", 5}, {"sh_bands", 5}}), call("b", 0, {{"planned", 1}, {"sh_bands", 2}}),
      call("a", 2, {{"planned", 6}, {"sh_bands", 3}}), call("a", 3, {{"sh_bands", 99}})};
  for (const ForcedRuns& runs : calls) {
    std::ostringstream text;
    WriteForcedJson(runs, text);
    const fs::path path = folder / (std::to_string(read.size()) + ".json");
    WriteAll(path, text.str());
    read.push_back(ReadForced(path));
  }
  const std::vector<ForcedPart> parts = MergeForcedRuns(read).Parts();
  ASSERT_EQ(parts.size(), 3U);
  EXPECT_EQ(parts[0].scene + parts[1].scene + parts[2].scene, "aab");
  EXPECT_EQ(parts[0].part, "sh_bands");
  EXPECT_EQ(parts[0].what, "bands of colour that no photo tells");
  EXPECT_EQ(parts[0].seeds, 3);
  EXPECT_EQ(parts[0].planned_error.median, 5);
  EXPECT_EQ(parts[0].forced_error.max, 5);
  EXPECT_EQ(parts[0].planned_cpu_seconds.max, 12);
  EXPECT_NEAR(parts[0].mean_gain.value(), 4 / 3.0, 1e-12);  // of 1, 0 and 3
  EXPECT_NEAR(parts[0].gain_sigma, std::sqrt(7 / 9.0), 1e-12);
  EXPECT_NEAR(parts[0].GainPct(), 40, 1e-12);
  EXPECT_EQ(parts[1].seeds, 0);
  EXPECT_EQ(parts[1].failure, "no memory");
  EXPECT_TRUE(std::isnan(parts[1].GainPct()));
  EXPECT_NEAR(parts[2].GainPct(), -100, 1e-12);
  EXPECT_THROW(MergeForcedRuns({read[0], read[0]}), UserError);
  WriteAll(folder / "other.json", "{\"parts\": []}");
  EXPECT_THROW(ReadForced(folder / "other.json"), UserError);
}

}  // namespace
}  // namespace s2gs
