// turntable_mapper from two synthetic databases to a workspace. Needs the `colmap` executable.

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "plugin/cli/command.h"
#include "plugin/stage/scan_input.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "sfm_split/scene/pose_error.h"
#include "tests/support/synthetic_database.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

SyntheticTurntableOptions Options() {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 10;
  options.step_deg = 20;
  options.num_object_points = 260;
  options.num_platter_points = 100;
  options.num_background_points = 300;
  options.max_view_change_deg = 60;
  options.pixel_noise = 0.2;
  return options;
}

void WriteSplit(const Workspace& workspace, const SyntheticTurntable& turntable,
                const std::string& capture_case) {
  fs::create_directories(workspace.ObjectDatabase().parent_path());
  fs::create_directories(workspace.Images());  // COLMAP wants the folder, not the photos
  WriteSyntheticDatabase(workspace.ObjectDatabase(), turntable, SyntheticGeometries::kRotating);
  WriteSyntheticDatabase(
      workspace.StaticDatabase(), turntable,
      capture_case == "turntable" ? SyntheticGeometries::kStatic : SyntheticGeometries::kNone);
  json images = json::array();
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    std::string labels;
    for (const SyntheticKeypoint& keypoint : turntable.images[i].keypoints) {
      labels.push_back(IsRotating(keypoint.body) ? '2' : keypoint.body == SyntheticBody::kStatic ? '1' : '0');
    }
    images.push_back({{"name", turntable.scene.views[i].name},
                      {"image_id", i + 1},
                      {"station", turntable.scene.views[i].station},
                      {"labels", labels}});
  }
  std::ofstream(workspace.ObjectDatabase().parent_path() / "labels.json")
      << json{{"version", 1}, {"case", capture_case}, {"reason", "a test"}, {"images", images}};
}

json ReadJson(const fs::path& path) { return json::parse(std::ifstream(path)); }

int RunMapper(const Workspace& workspace, const std::vector<std::string>& more = {}) {
  std::vector<std::string> arguments = {"turntable_mapper", "--workspace_path", workspace.root.string(),
                                        "--log_level", "error"};
  arguments.insert(arguments.end(), more.begin(), more.end());
  return RunProgram(AllCommands(), arguments);
}

class TurntableMapper : public testing::Test {
 protected:
  void SetUp() override {
    if (std::system("QT_QPA_PLATFORM=offscreen colmap help > /dev/null 2>&1") != 0) {
      GTEST_SKIP() << "no `colmap` on PATH";
    }
  }
  std::string RunId(const std::string& stage) const {
    return ReadJson(workspace_.StageStamp(stage)).at("run_id").get<std::string>();
  }

  const TemporaryFolder folder_;
  const Workspace workspace_{folder_.path()};
};

TEST_F(TurntableMapper, WritesTheSceneAndRunsOnlyWhatChanged) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(Options());
  WriteSplit(workspace_, turntable, "turntable");
  ASSERT_EQ(RunMapper(workspace_), kExitDone);
  const ColmapModel object = ReadColmapModel(workspace_.ObjectModel());
  const ColmapModel background = ReadColmapModel(workspace_.StaticModel());
  const TurntableFile file = ReadTurntableFile(workspace_.Turntable());
  EXPECT_EQ(object.images.size(), 20U);
  EXPECT_EQ(background.images.size(), 20U);
  ASSERT_EQ(file.images.size(), 20U);
  EXPECT_EQ(file.num_stations, 2);
  EXPECT_TRUE(file.scale_observable);
  std::map<std::string, Rigid3> cam_from_world;
  for (const auto& [id, image] : background.images) cam_from_world[image.name] = image.cam_from_world;
  PoseMap estimate;
  for (const auto& [id, image] : object.images) estimate[image.name] = image.cam_from_world;
  for (const TurntableImage& image : file.images) {
    const Rigid3 composed = cam_from_world.at(image.name) * image.world_from_object;
    EXPECT_LT((composed.Matrix() - estimate.at(image.name).Matrix()).cwiseAbs().maxCoeff(), 1e-9);
  }
  PoseMap truth;
  for (const View& view : turntable.scene.views) truth[view.name] = view.CamFromObject();
  for (const double error : ComparePoses(estimate, truth).rotation_deg) EXPECT_LT(error, 0.1);
  const json report = ReadJson(workspace_.ObjectDatabase().parent_path() / "turntable_mapper.json");
  EXPECT_EQ(report.at("registered"), 20);
  EXPECT_EQ(report.at("joint_model").at("chosen"), "shared stations");
  EXPECT_EQ(report.at("observability").at("nullity"), 0);

  // Circular motion alone is good: COLMAP did not map the object.
  EXPECT_EQ(report.at("circle_alone"), "");
  EXPECT_FALSE(fs::exists(workspace_.StageStamp("object_mapper")));
  EXPECT_FALSE(fs::exists(workspace_.ObjectDatabase().parent_path() / "object_model"));
  const std::string alone = RunId("turntable_mapper");
  ASSERT_EQ(RunMapper(workspace_), kExitDone);
  EXPECT_EQ(RunId("turntable_mapper"), alone);
  // The same workspace and photos by another name, and where colmap lies, change nothing.
  ASSERT_EQ(RunMapper({workspace_.root / "split" / ".."},
                      {"--image_path", workspace_.Images().string() + "/.", "--colmap_path", "colmap"}),
            kExitDone);
  EXPECT_EQ(RunId("turntable_mapper"), alone);

  const std::vector<std::string> with_sfm = {"--circle_first", "0"};
  ASSERT_EQ(RunMapper(workspace_, with_sfm), kExitDone);
  EXPECT_EQ(ReadJson(workspace_.ObjectDatabase().parent_path() / "turntable_mapper.json").at("path"),
            "free_sfm");
  const std::string mapped = RunId("object_mapper");
  const std::string placed = RunId("turntable_mapper");
  ASSERT_EQ(RunMapper(workspace_, with_sfm), kExitDone);
  EXPECT_EQ(RunId("turntable_mapper"), placed);
  ASSERT_EQ(RunMapper(workspace_, {"--circle_first", "0", "--Joint.max_iterations", "99"}), kExitDone);
  EXPECT_EQ(RunId("object_mapper"), mapped);
  EXPECT_NE(RunId("turntable_mapper"), placed);
  ASSERT_EQ(RunMapper(workspace_, {"--path", "single_axis"}), kExitDone);
  EXPECT_EQ(ReadJson(workspace_.ObjectDatabase().parent_path() / "turntable_mapper.json").at("path"),
            "single_axis");
  EXPECT_EQ(ReadTurntableFile(workspace_.Turntable()).images.size(), 20U);
}

TEST_F(TurntableMapper, OneBodyHasNoTurntable) {
  SyntheticTurntableOptions options = Options();
  options.stations = 1;
  options.steps = 12;
  options.num_background_points = 0;  // as about a thing that rests: nothing stays at its pixel
  WriteSplit(workspace_, MakeSyntheticTurntable(options), "one_body");
  ASSERT_EQ(RunMapper(workspace_), kExitDone);
  EXPECT_EQ(ReadColmapModel(workspace_.ObjectModel()).images.size(), 12U);
  EXPECT_FALSE(fs::exists(workspace_.StaticModel()));
  const TurntableFile file = ReadTurntableFile(workspace_.Turntable());
  EXPECT_EQ(file.num_stations, 12);
  EXPECT_FALSE(file.scale_observable);
  for (const TurntableImage& image : file.images) EXPECT_TRUE(image.world_from_object.Matrix().isIdentity());
}

TEST_F(TurntableMapper, DamagedSplitIsAUserError) {
  EXPECT_EQ(RunMapper(workspace_), kExitUserError);
  WriteSplit(workspace_, MakeSyntheticTurntable(Options()), "turntable");
  const fs::path labels = workspace_.ObjectDatabase().parent_path() / "labels.json";
  const std::string good = json(ReadJson(labels)).dump();
  for (const std::string& bad :
       {std::string("{"), std::string(R"({"images": []})"), std::string(R"({"case": "else", "images": []})"),
        std::string(R"({"images": [{"name": 3}]})")}) {
    std::ofstream(labels) << bad;
    EXPECT_THROW(ReadScanInput(workspace_), UserError) << bad;
  }
  std::ofstream(labels) << good;
  EXPECT_EQ(ReadScanInput(workspace_).features.images.size(), 20U);
  EXPECT_EQ(RunMapper(workspace_, {"--mapper_options", "nonsense"}), kExitUserError);
}

}  // namespace
}  // namespace s2gs
