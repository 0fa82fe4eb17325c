#include "plugin/curves/forced_parts.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "plugin/stage/workspace.h"
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
      MeasureForcedParts(options, {"learning_p", "distortion_channel"}, silent);
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
  const std::vector<ForcedPart> planned = MeasureForcedParts(options, {}, silent);
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
  const std::vector<ForcedPart> parts = MeasureForcedParts(options, {"distortion_channel"}, silent);
  ASSERT_EQ(parts.size(), 1U);
  EXPECT_EQ(parts[0].failure, "");
  EXPECT_NEAR(parts[0].GainPct(), 10, 1e-9);
  ASSERT_TRUE(parts[0].mean_gain.has_value());
  EXPECT_NEAR(*parts[0].mean_gain, 0.02, 1e-12);
  EXPECT_NEAR(parts[0].gain_sigma, 0.01 / std::sqrt(3.0), 1e-12);
  EXPECT_NEAR(parts[0].GainSigmas(), 2 * std::sqrt(3.0), 1e-9);
  std::ostringstream text;
  WriteForcedJson(parts, text);
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
  const std::vector<ForcedPart> parts = MeasureForcedParts(options, {"weak_features"}, silent);
  ASSERT_EQ(parts.size(), 1U);
  EXPECT_EQ(parts[0].failure, "");
  EXPECT_NEAR(parts[0].GainPct(), 40, 1e-9);
  EXPECT_NEAR(parts[0].gain_sigma, 0.04, 1e-12);
  EXPECT_NEAR(parts[0].GainSigmas(), 0.5, 1e-9);
  std::ostringstream json;
  WriteForcedJson(parts, json);
  EXPECT_THAT(json.str(), testing::HasSubstr("\"gain_sigma\": 0.04"));
}

}  // namespace
}  // namespace s2gs
