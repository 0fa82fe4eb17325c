#include "plugin/plan/scan_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <sstream>
#include <string>

#include "plugin/cli/options.h"
#include "plugin/plan/plan_parts.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "tests/support/expected_text.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using testing::HasSubstr;

class ScanPlanTest : public testing::Test {
 protected:
  ScanPlanTest() { request_.workspace.root = folder_ / "scan"; }

  // What motion_splitter leaves, without a stamp: as if somebody else had made it.
  void WriteSplit(const std::string& scene_case, int pairs_matched, int stations) const {
    const Workspace& w = request_.workspace;
    WriteAll(w.ObjectDatabase(), "object");
    WriteAll(w.StaticDatabase(), "static");
    WriteAll(
        w.SplitLabels(),
        R"({"version": 1, "case": ")" + scene_case + R"(", "reason": "as measured", "pairs_matched": )" +
            std::to_string(pairs_matched) +
            R"(, "features_added": 0, "object_pairs": 7, "ringed_photos": 3, "station_photos": 4, "num_stations": )" +
            std::to_string(stations) + R"(, "images": [{}, {}, {}, {}]})");
  }

  void WriteTraining(const std::string& log) const {
    WriteAll(request_.workspace.PointCloud(), "model");
    WriteAll(request_.workspace.Log(), log);
  }

  PlanDecision Of(const std::string& part) const { return MakeScanPlan(request_, silent_).Of(part); }

  TemporaryFolder folder_;
  PlanRequest request_;
  mutable Reporter silent_;
};

TEST_F(ScanPlanTest, WithoutAnyStageOnlyThePhotosDecide) {
  const ScanPlan plan = MakeScanPlan(request_, silent_);
  ASSERT_EQ(plan.decisions.size(), PlanParts().size());
  for (size_t i = 0; i < plan.decisions.size(); ++i) {
    const PlanPart& part = PlanParts()[i];
    EXPECT_EQ(plan.decisions[i].part, part.name);
    EXPECT_EQ(plan.decisions[i].state == PlanState::kLater, !part.after.empty()) << part.name;
    if (!part.after.empty()) {
      EXPECT_THAT(plan.decisions[i].reason, HasSubstr(part.after));
    }
  }
  EXPECT_EQ(Of("motion").state, PlanState::kRuns);
  request_.has_masks = true;
  EXPECT_EQ(Of("motion").state, PlanState::kLeftOut);
  for (const PlanStage& stage : plan.stages) EXPECT_EQ(stage.state, "runs") << stage.name;
}

TEST_F(ScanPlanTest, StagesThatAreNotAskedForAreNamed) {
  const auto not_asked = [&] {
    std::map<std::string, std::string> reasons;
    for (const PlanStage& stage : MakeScanPlan(request_, silent_).stages) {
      if (stage.state == "not asked for") reasons[stage.name] = stage.reason;
    }
    return reasons;
  };
  EXPECT_TRUE(not_asked().empty());
  request_.textures = false;
  EXPECT_EQ(not_asked(), (std::map<std::string, std::string>{{"mesh_texturer", "--texture 0"}}));
  request_.meshes = false;
  std::map<std::string, std::string> of_mesh;
  for (const char* stage : {"image_undistorter", "gaussian_renderer", "tsdf_mesher", "mesh_texturer"})
    of_mesh[stage] = "--until";
  EXPECT_EQ(not_asked(), of_mesh);
  request_.trains = false;
  of_mesh["gaussian_trainer"] = "--until";
  EXPECT_EQ(not_asked(), of_mesh);
}

TEST_F(ScanPlanTest, TheSplitDecidesWhatItMeasured) {
  WriteSplit("single_station", 5, 1);
  EXPECT_EQ(Of("two_bodies").state, PlanState::kRuns);
  EXPECT_EQ(Of("background").state, PlanState::kLeftOut);
  EXPECT_THAT(Of("pairs").measured, HasSubstr("5 of 6 pairs"));
  EXPECT_EQ(Of("pairs").state, PlanState::kLeftOut);
  EXPECT_EQ(Of("pairs").saving, "17 % of the matching");
  EXPECT_EQ(Of("weak_features").state, PlanState::kLeftOut);
  EXPECT_EQ(Of("weak_features").measured, "as measured");
  EXPECT_THAT(Of("weak_features").reason, HasSubstr("nothing is seen to change"));
  std::string labels = ReadAll(request_.workspace.SplitLabels());
  WriteAll(request_.workspace.SplitLabels(),
           labels.replace(labels.find("\"object_pairs\""), 0,
                          "\"changing_features\": 600, \"weak_features\": 400, "));
  EXPECT_EQ(
      Of("weak_features").measured,
      "600 features a photo where things change, 400 more at lower thresholds: standard deviations lower "
      "by 23 %");  // 1 - sqrt(0.6)
  EXPECT_EQ(Of("weak_features").state, PlanState::kLeftOut);
  EXPECT_THAT(Of("weak_features").reason, HasSubstr("joined worse"));
  WriteAll(request_.workspace.SplitLabels(),
           labels.replace(labels.find("\"object_pairs\""), 0, "\"takes_weak_features\": true, "));
  EXPECT_EQ(Of("weak_features").state, PlanState::kRuns);
  EXPECT_EQ(Of("scale").state, PlanState::kLater);

  WriteSplit("one_body", 6, 0);
  EXPECT_EQ(Of("two_bodies").state, PlanState::kLeftOut);
  EXPECT_EQ(Of("two_bodies").measured, "as measured");
  EXPECT_EQ(Of("pairs").state, PlanState::kRuns);

  // 25 photos have 300 pairs.
  std::string images = "{}";
  for (int i = 1; i < 25; ++i) images += ", {}";
  const auto write_pairs = [&](int matched) {
    WriteAll(request_.workspace.SplitLabels(), R"({"case": "one_body", "images": [)" + images +
                                                   R"(], "pairs_matched": )" + std::to_string(matched) + "}");
  };
  write_pairs(299);
  EXPECT_EQ(Of("pairs").state, PlanState::kRuns);
  write_pairs(298);
  EXPECT_EQ(Of("pairs").saving, "1 % of the matching");

  WriteAll(request_.workspace.SplitLabels(), R"({"case": 5, "images": 7, "pairs_matched": []})");
  EXPECT_EQ(Of("pairs").state, PlanState::kLater);  // damaged: as if it were not there
}

TEST_F(ScanPlanTest, TrainingsOwnDecisionsAreTakenOver) {
  WriteTraining(
      R"({"event": "decision", "part": "learning_p", "left_out": false, "measured": "first", "threshold": "", )"
      R"("reason": "", "saving": ""})"
      "\n"
      R"({"event": "decision", "part": "learning_p", "left_out": true, "measured": "99.9 %", "threshold": "99 %", )"
      R"("reason": "settled", "saving": "much"})"
      "\nno JSON\n");
  const PlanDecision learnt = Of("learning_p");
  EXPECT_EQ(learnt.state, PlanState::kLeftOut);
  EXPECT_EQ(learnt.measured, "99.9 %");
  EXPECT_EQ(learnt.threshold, "99 %");
  EXPECT_EQ(learnt.reason, "settled");
  EXPECT_EQ(learnt.saving, "much");
  EXPECT_EQ(Of("unseen_background").state, PlanState::kRuns);
}

TEST_F(ScanPlanTest, WhatIsForcedRuns) {
  request_.forced = {"distortion_channel"};
  const PlanDecision forced = Of("distortion_channel");
  EXPECT_EQ(forced.state, PlanState::kRuns);
  EXPECT_TRUE(forced.is_forced);
  EXPECT_THAT(forced.reason, HasSubstr("asked for"));
}

TEST_F(ScanPlanTest, IsReadAsWrittenAndPrintsOnlyWhatIsNew) {
  const ScanPlan before = MakeScanPlan(request_, silent_);
  WriteSplit("turntable", 3, 2);
  const ScanPlan now = MakeScanPlan(request_, silent_);
  const auto path = folder_ / "plan.json";
  WriteScanPlan(path, now);
  const std::vector<PlanDecision> read = ReadPlannedDecisions(path);
  ASSERT_EQ(read.size(), now.decisions.size());
  for (size_t i = 0; i < read.size(); ++i) {
    EXPECT_EQ(read[i].part, now.decisions[i].part);
    EXPECT_EQ(read[i].state, now.decisions[i].state);
    EXPECT_EQ(read[i].measured, now.decisions[i].measured);
    EXPECT_EQ(read[i].saving, now.decisions[i].saving);
  }
  std::ostringstream out;
  PrintNewDecisions(before, now, out);
  EXPECT_THAT(out.str(), HasSubstr("two_bodies"));
  EXPECT_THAT(out.str(), testing::Not(HasSubstr("distortion_channel")));
  std::ostringstream all;
  PrintScanPlan(now, all);
  for (const PlanPart& part : PlanParts()) EXPECT_THAT(all.str(), HasSubstr(part.name));
  folder_.Write("plan.json", "{\"decisions\": [{\"part\": 3}]}");
  EXPECT_TRUE(ReadPlannedDecisions(path).empty());
}

// Every decision of scans of several kinds, in words and as JSON, from what their stages measured.
TEST_F(ScanPlanTest, SaysWhatEachKindOfScanNeeds) {
  const Workspace& w = request_.workspace;
  std::ostringstream said;
  const auto say = [&](const char* title) {
    said << "== " << title << "\n";
    const ScanPlan plan = MakeScanPlan(request_, silent_);
    PrintScanPlan(plan, said);
  };
  const auto write_mapping = [&](const std::string& report, int stations, bool observable,
                                 double turned_deg) {
    WriteAll(w.TurntableMapper(), report);
    TurntableFile turntable;
    turntable.num_stations = stations;
    turntable.scale_observable = observable;
    ColmapModel model;
    for (uint32_t i = 0; i < 4; ++i) {
      TurntableImage image;
      image.name = "p" + std::to_string(i);
      image.station = static_cast<int>(i) % stations;
      image.angle_deg = i * turned_deg;
      image.world_from_object.rotation =
          Eigen::Quaterniond(Eigen::AngleAxisd(i * turned_deg * kPi / 180, Eigen::Vector3d::UnitZ()));
      turntable.images.push_back(image);
      model.images[i + 1] = {i + 1, image.name, 1 + i % 2, {}, {}};
    }
    Camera camera;
    camera.camera_id = 1;
    camera.model = CameraModelId::kPinhole;
    camera.width = camera.height = 10;
    camera.params = {10, 10, 5, 5};
    model.cameras[1] = camera;
    camera.camera_id = 2;
    camera.model = CameraModelId::kSimpleRadial;
    camera.params = {10, 5, 5, observable ? 0.1 : 0};
    model.cameras[2] = camera;
    std::filesystem::create_directories(w.ObjectModel());
    WriteColmapModel(w.ObjectModel(), model, ColmapFormat::kText);
    WriteTurntableFile(w.Turntable(), turntable);
  };
  const auto write_mesh = [&](const std::string& line) {
    WriteAll(w.TsdfMesh(), "mesh");
    WriteAll(w.MeshLog(), line);
  };

  WriteSplit("turntable", 4, 2);
  WriteAll(w.StaticModel() / "images.txt", "");
  write_mapping(
      R"({"path": "both", "path_reason": "as found", "circle_alone": "", "registered": 4, "verdict": {"verdict": "good"}, "joint_model": {"chosen": )"
      R"("shared stations", "tests": [{"general": "free", "score": 1.25, "fitted": true, "bic_gain": -3.5},)"
      R"({"general": "other", "score": 0.5}]}})",
      2, true, 30);
  WriteTraining(
      R"({"event": "decision", "part": "sh_bands", "left_out": true, "measured": "m", "threshold": "t", )"
      R"("reason": "r", "saving": "s"})"
      "\n"
      R"({"event": "decision", "part": "end_of_training", "left_out": false, "measured": "n", "threshold": "u", )"
      R"("reason": "q"})"
      "\n");
  write_mesh(R"({"event": "refined", "photos": 4, "vertices": 200, "clear": 50, "moved": true})");
  say("two stations");

  WriteSplit("single_station", 6, 1);
  write_mapping(R"({"registered": 3, "verdict": {"verdict": "doubtful", "poses_hold": true}, "joint_model": )"
                R"({"chosen": "free cameras", "tests": []}, "circle_alone": "why not"})",
                1, false, 30);
  write_mesh(R"({"event": "refined", "photos": 2, "vertices": 200, "clear": 50, "moved": false})");
  request_.has_masks = true;
  say("one station, with masks");

  WriteSplit("one_body", 6, 0);
  write_mapping(R"({"path": "one body", "registered": 4, "verdict": {"verdict": "failed"}})", 4, false, 0);
  WriteTraining("");
  write_mesh(R"({"event": "refined", "photos": 9, "vertices": 200, "clear": 1, "moved": false})");
  request_.has_masks = false;
  request_.forced = {"doubtful_poses", "distortion_channel"};
  say("one body, forced");

  write_mesh(R"({"event": "refined", "photos": 9, "vertices": 0, "moved": false, "enabled": false})");
  request_.forced.clear();
  say("one body, not refined");
  said << PlanToJson(MakeScanPlan(request_, silent_)).dump(1) << "\n";
  ExpectText(said.str(), "plugin/plan/expected/plans.txt");
}

TEST(PlanParts, ForceTakesPartsStagesAndTheOldNumbers) {
  EXPECT_TRUE(ForcedParts({}).empty());
  EXPECT_TRUE(ForcedParts({"0"}).empty());
  EXPECT_EQ(ForcedParts({"1"}), std::set<std::string>({"doubtful_poses"}));
  EXPECT_EQ(ForcedParts({"pairs", "undistortion"}), std::set<std::string>({"pairs", "undistortion"}));
  const std::set<std::string> training = ForcedParts({"gaussian_trainer"});
  EXPECT_EQ(training.count("sh_bands"), 1U);
  EXPECT_EQ(training.count("doubtful_poses"), 0U);
  try {
    ForcedParts({"scale"});
    FAIL();
  } catch (const CommandLineError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("every scale explains the photos equally well"));
  }
  for (const PlanPart& part : PlanParts())
    EXPECT_EQ(part.CanBeForced(), part.never_forced.empty()) << part.name;
  EXPECT_THROW(ForcedParts({"nothing"}), CommandLineError);
  EXPECT_EQ(ForcedArguments("gaussian_trainer", {"sh_bands", "pairs"}),
            std::vector<std::string>({"--Train.only_told_bands", "0"}));
}

}  // namespace
}  // namespace s2gs
