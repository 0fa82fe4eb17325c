// COLMAP's mapper, run on synthetic databases without noise, finds the poses that they were made from. Needs
// the `colmap` executable.

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <string>

#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/pose_error.h"
#include "tests/support/synthetic_database.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

class SyntheticMapper : public testing::Test {
 protected:
  void SetUp() override {
    if (std::system("QT_QPA_PLATFORM=offscreen colmap help > /dev/null 2>&1") != 0) {
      GTEST_SKIP() << "no `colmap` on PATH";
    }
  }

  static SyntheticTurntableOptions Options() {
    SyntheticTurntableOptions options;
    options.stations = 2;
    options.steps = 6;
    options.step_deg = 12;
    options.num_object_points = 260;
    options.num_platter_points = 100;
    options.num_background_points = 300;
    options.max_view_change_deg = 60;
    return options;
  }

  /// Runs the mapper and compares its only model with the exact one.
  PoseErrors Map(const SyntheticTurntable& turntable, SyntheticGeometries geometries,
                 const ColmapModel& exact) const {
    const fs::path database = folder_.path() / "database.db";
    const fs::path log = folder_.path() / "mapper.log";
    WriteSyntheticDatabase(database, turntable, geometries);
    fs::create_directories(folder_.path() / "sparse");
    const std::string command = "QT_QPA_PLATFORM=offscreen colmap mapper --database_path '" +
                                database.string() + "' --image_path '" + folder_.path().string() +
                                "' --output_path '" + (folder_.path() / "sparse").string() +
                                "' --Mapper.extract_colors 0 --Mapper.min_model_size 3 "
                                "--Mapper.multiple_models 0 --Mapper.num_threads 2 > '" +
                                log.string() + "' 2>&1";
    EXPECT_EQ(std::system(command.c_str()), 0) << ReadAll(log);
    if (!fs::exists(folder_.path() / "sparse" / "0")) {
      ADD_FAILURE() << "no model: " << ReadAll(log);
      return {};
    }
    const ColmapModel model = ReadColmapModel(folder_.path() / "sparse" / "0");
    PoseMap estimate;
    PoseMap truth;
    for (const auto& [id, image] : model.images) estimate[image.name] = image.cam_from_world;
    for (const auto& [id, image] : exact.images) truth[image.name] = image.cam_from_world;
    return ComparePoses(estimate, truth);
  }

  TemporaryFolder folder_;
};

TEST_F(SyntheticMapper, RecoversTheObjectsPoses) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(Options());
  const PoseErrors errors = Map(turntable, SyntheticGeometries::kRotating, SyntheticObjectModel(turntable));
  ASSERT_EQ(errors.names.size(), 12U);
  ASSERT_EQ(errors.truth_from_estimate.status, FitStatus::kOk);
  for (size_t i = 0; i < errors.names.size(); ++i) {
    EXPECT_LT(errors.rotation_deg[i], 0.01) << errors.names[i];
    EXPECT_LT(errors.centre_length[i], 1e-4) << errors.names[i];  // of 0.7
  }
}

TEST_F(SyntheticMapper, RecoversTheStationsFromTheBackground) {
  SyntheticTurntableOptions options = Options();
  options.stations = 5;
  options.steps = 2;
  options.azimuth_spread_deg = 60;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const PoseErrors errors = Map(turntable, SyntheticGeometries::kStatic, SyntheticStaticModel(turntable));
  ASSERT_EQ(errors.names.size(), 10U);
  ASSERT_EQ(errors.truth_from_estimate.status, FitStatus::kOk);
  for (size_t i = 0; i < errors.names.size(); ++i) {
    EXPECT_LT(errors.rotation_deg[i], 0.01) << errors.names[i];
    EXPECT_LT(errors.centre_length[i], 1e-4) << errors.names[i];
  }
}

}  // namespace
}  // namespace s2gs
