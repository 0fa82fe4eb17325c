#include "plugin/outputs/dense_folder.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "plugin/stage/stage_stamp.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "tests/support/bad_input.h"
#include "tests/support/model_without_points.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// A workspace of three photos of 40 x 30 pixels.
class DenseFolder : public testing::Test {
 protected:
  DenseFolder() {
    for (auto& [id, image] : model_.images) {
      image.cam_from_world.translation = {0.1 * id, 0, 1};
      image.name = std::to_string(id) + ".png";
      fs::create_directories(workspace_.Images());
      WriteImage(workspace_.Images() / image.name, Image8{40, 30, 3, std::vector<uint8_t>(3600, 100)});
    }
    WriteColmapModel(workspace_.ObjectModel(), model_, ColmapFormat::kBinary);
  }
  std::map<std::string, PinholeView> Prepare(bool resample_always = false) {
    StageRunner runner(workspace_, silent_);
    return PrepareDenseFolder(workspace_, workspace_.Images(), resample_always, &runner, silent_);
  }
  // As COLMAP would leave it, with a focal length that this program would not write.
  void MakeForeign(double off) {
    ColmapModel dense = model_;
    dense.cameras[1].params = {47, 47, 20, 15};
    dense.images[2].cam_from_world.translation.y() += off;
    WriteColmapModel(workspace_.DenseModel(), dense, ColmapFormat::kBinary);
  }

  const TemporaryFolder folder_;
  const Workspace workspace_{folder_.path()};
  ColmapModel model_ = ModelWithoutPoints(3);
  Reporter silent_;
};

TEST_F(DenseFolder, HasPhotosAndTheirCameras) {
  const std::map<std::string, PinholeView> views = Prepare();
  ASSERT_EQ(views.size(), 3U);
  const PinholeView& view = views.at("2.png");
  EXPECT_EQ(view.width, 40);
  EXPECT_EQ(view.height, 30);
  EXPECT_EQ(view.fx, 50);
  EXPECT_EQ(view.fy, 50);
  EXPECT_EQ(view.cx, 20);
  EXPECT_EQ(view.cy, 15);
  EXPECT_TRUE(fs::exists(workspace_.DenseImages() / "3.png"));
  EXPECT_TRUE(fs::exists(workspace_.Dense() / "stereo/patch-match.cfg"));
}

// COLMAP's own folder stays as it is while it has the poses of the model.
TEST_F(DenseFolder, OfTheSamePosesIsLeftAlone) {
  MakeForeign(0);
  EXPECT_EQ(Prepare().at("1.png").fx, 47);
  EXPECT_FALSE(ReadStageStamp(workspace_, kUndistorterStage, silent_));
  MakeForeign(1e-10);
  EXPECT_EQ(Prepare().at("1.png").fx, 47);
  MakeForeign(1e-8);
  EXPECT_EQ(Prepare().at("1.png").fx, 50);
  EXPECT_TRUE(ReadStageStamp(workspace_, kUndistorterStage, silent_));
}

TEST_F(DenseFolder, OfOtherPhotosIsMadeAgain) {
  ColmapModel dense = model_;
  dense.cameras[1].params = {47, 47, 20, 15};
  dense.images[3].name = "4.png";
  WriteColmapModel(workspace_.DenseModel(), dense, ColmapFormat::kBinary);
  EXPECT_EQ(Prepare().at("3.png").fx, 50);
}

TEST_F(DenseFolder, WithDistortionIsRefused) {
  ColmapModel dense = model_;
  dense.cameras[1].model = CameraModelId::kSimpleRadial;
  dense.cameras[1].params = {47, 20, 15, 0.1};
  WriteColmapModel(workspace_.DenseModel(), dense, ColmapFormat::kBinary);
  EXPECT_THROW(Prepare(), UserError);
}

}  // namespace
}  // namespace s2gs
