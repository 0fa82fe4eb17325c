#include "plugin/outputs/dense_views.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_maps.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class Listener : public Reporter {
 public:
  void Log(LogLevel /*level*/, std::string_view message) override { log += message; }
  std::string log;
};

// Two photos of 40 x 30 in dense/0, and the model of the photos that they were made from.
class DenseViews : public testing::Test {
 protected:
  void SetUp() override {
    ColmapModel model;
    model.cameras[4] = {4, CameraModelId::kPinhole, 40, 30, {50, 60, 21, 16}};
    for (const char* name : {"b.png", "a.png"}) {
      ColmapImage image;
      image.image_id = static_cast<uint32_t>(1 + model.images.size());
      image.name = name;
      image.camera_id = 4;
      image.cam_from_world.translation = {0, 0, static_cast<double>(image.image_id)};
      model.images[image.image_id] = image;
    }
    WriteModel(workspace_.DenseModel(), model);
    model.cameras[4] = {4, CameraModelId::kSimpleRadial, 40, 30, {50, 20, 15, 0}};
    photos_ = model;
    WriteModel(workspace_.ObjectModel(), photos_);
  }
  static void WriteModel(const fs::path& path, const ColmapModel& model) {
    fs::create_directories(path);
    WriteColmapModel(path, model, ColmapFormat::kBinary);
  }
  static Image8 Grey(int width, int height, uint8_t value) {
    return {width, height, 1, std::vector<uint8_t>(static_cast<size_t>(width) * height, value)};
  }
  void WritePicture(const fs::path& path, const Image8& image) const {
    fs::create_directories(path.parent_path());
    WriteImage(path, image);
  }
  std::vector<DenseViewFiles> Find(const DenseViewRequest& request = {}) {
    return FindDenseViews(workspace_, request, listener_);
  }

  TemporaryFolder folder_;
  Workspace workspace_{folder_.path()};
  ColmapModel photos_;
  Listener listener_;
};

TEST_F(DenseViews, AreThoseOfTheModelByNameWithWhatIsThere) {
  WritePicture(workspace_.DenseImages() / "a.png", Grey(40, 30, 1));
  for (const fs::path& folder : {workspace_.DepthMaps(), workspace_.NormalMaps()}) {
    fs::create_directories(folder);
    WriteAll(folder / "a.png.geometric.bin", "x");
    WriteAll(folder / "b.png.photometric.bin", "x");
  }
  WritePicture(workspace_.TableSeen() / "b.png.png", Grey(40, 30, 1));
  const std::vector<DenseViewFiles> views = Find();
  ASSERT_EQ(views.size(), 2U);
  EXPECT_EQ(views[0].name, "a.png");
  EXPECT_EQ(views[0].camera.cam_from_object.translation.z(), 2);
  EXPECT_EQ(views[0].camera.width, 40);
  EXPECT_EQ(views[0].camera.height, 30);
  EXPECT_EQ(views[0].camera.fx, 50);
  EXPECT_EQ(views[0].camera.fy, 60);
  EXPECT_EQ(views[0].camera.cx, 21);
  EXPECT_EQ(views[0].camera.cy, 16);
  EXPECT_EQ(views[0].image, workspace_.DenseImages() / "a.png");
  EXPECT_EQ(views[0].depth, workspace_.DepthMap("a.png"));
  EXPECT_EQ(views[0].normal, workspace_.NormalMap("a.png"));
  EXPECT_EQ(views[0].mask, "");
  EXPECT_EQ(views[0].table_seen, "");
  EXPECT_EQ(views[1].name, "b.png");
  EXPECT_EQ(views[1].image, "");
  EXPECT_EQ(views[1].depth, "");
  EXPECT_EQ(views[1].normal, "");
  EXPECT_EQ(views[1].table_seen, workspace_.TableSeen() / "b.png.png");
  const std::vector<DenseViewFiles> others = Find({{}, "photometric", false});
  EXPECT_EQ(others[0].depth, "");
  EXPECT_EQ(others[1].depth, workspace_.DepthMaps() / "b.png.photometric.bin");
  EXPECT_EQ(others[1].normal, "");
  EXPECT_EQ(listener_.log, "");
}

TEST_F(DenseViews, MasksAreTheirOwnElseThoseOfPhotosWithoutDistortion) {
  WritePicture(workspace_.Mask("a.png"), Grey(40, 30, 255));
  EXPECT_EQ(Find()[0].mask, workspace_.Mask("a.png"));
  EXPECT_EQ(listener_.log, "");
  photos_.cameras[4].params[3] = 0.1;
  WriteModel(workspace_.ObjectModel(), photos_);
  EXPECT_EQ(Find()[0].mask, "");
  EXPECT_THAT(listener_.log, HasSubstr("masks: not used, because the photos were undistorted"));
  WritePicture(workspace_.DenseMasks() / "a.png.png", Grey(40, 30, 255));
  listener_.log.clear();
  EXPECT_EQ(Find()[0].mask, workspace_.DenseMasks() / "a.png.png");
  EXPECT_EQ(listener_.log, "");
  WritePicture(folder_ / "others" / "a.png.png", Grey(40, 30, 255));
  EXPECT_EQ(Find({folder_ / "others"})[0].mask, folder_ / "others" / "a.png.png");
  try {
    Find({folder_ / "none"});
    FAIL();
  } catch (const UserError& error) {
    EXPECT_THAT(error.what(), HasSubstr("none: no such folder"));
  }
}

TEST_F(DenseViews, CamerasWithDistortionAreRefused) {
  WriteModel(workspace_.DenseModel(), photos_);
  EXPECT_EQ(Find().size(), 2U);  // none in truth
  photos_.cameras[4].params[3] = 0.1;
  WriteModel(workspace_.DenseModel(), photos_);
  try {
    Find();
    FAIL();
  } catch (const UserError& error) {
    EXPECT_THAT(error.what(), HasSubstr("camera 4 is a SIMPLE_RADIAL with distortion"));
  }
}

// Maps and photos of a smaller size show the whole image all the same.
TEST_F(DenseViews, CamerasAreThoseOfTheMapsSizeAndOfThePhotos) {
  fs::create_directories(workspace_.DepthMaps());
  fs::create_directories(workspace_.NormalMaps());
  std::vector<float> depths(20 * 10, 3);
  depths[7] = 5;
  WriteColmapMap(workspace_.DepthMap("a.png"), {20, 10, 1, depths});
  WriteColmapMap(workspace_.NormalMap("a.png"), {20, 10, 3, std::vector<float>(600, 1)});
  WritePicture(workspace_.DenseImages() / "a.png", Grey(80, 45, 9));
  WritePicture(workspace_.DenseMasks() / "a.png.png", Grey(40, 30, 200));
  WritePicture(workspace_.TableSeen() / "a.png.png", Grey(40, 30, 150));
  const std::vector<DenseViewFiles> files = Find();
  const std::shared_ptr<const DepthView> view = WorkspaceDepthViews(files).Load(0);
  EXPECT_EQ(view->camera.width, 20);
  EXPECT_EQ(view->camera.height, 10);
  EXPECT_DOUBLE_EQ(view->camera.fx, 25);
  EXPECT_DOUBLE_EQ(view->camera.fy, 20);
  EXPECT_DOUBLE_EQ(view->camera.cx, 10.5);
  EXPECT_DOUBLE_EQ(view->camera.cy, 16 / 3.0);
  EXPECT_EQ(view->depths, depths);
  EXPECT_EQ(view->normals.size(), 600U);
  EXPECT_EQ(view->colors.channels, 3);
  EXPECT_EQ(view->colors.width, 80);
  EXPECT_EQ(view->mask.pixels, std::vector<uint8_t>(1200, 200));
  const DensePhotos photos(files);
  ASSERT_EQ(photos.size(), 1);
  EXPECT_EQ(photos.Camera(0).width, 80);
  EXPECT_EQ(photos.Camera(0).height, 45);
  EXPECT_DOUBLE_EQ(photos.Camera(0).fx, 100);
  EXPECT_DOUBLE_EQ(photos.Camera(0).fy, 90);
  EXPECT_DOUBLE_EQ(photos.Camera(0).cx, 42);
  EXPECT_DOUBLE_EQ(photos.Camera(0).cy, 24);
  EXPECT_EQ(photos.LoadMask(0).pixels, std::vector<uint8_t>(1200, 200));
  EXPECT_EQ(photos.LoadTableSeen(0).pixels, std::vector<uint8_t>(1200, 150));
  EXPECT_EQ(photos.Load(0, 1).pixels, std::vector<uint8_t>(80 * 45, 9));
  // Normals of another size are none of these depths.
  for (const auto& [width, height] : {std::pair(10, 10), std::pair(20, 20)}) {
    WriteColmapMap(workspace_.NormalMap("a.png"),
                   {width, height, 3, std::vector<float>(static_cast<size_t>(3 * width * height), 1)});
    try {
      WorkspaceDepthViews(files).Load(0);
      FAIL();
    } catch (const UserError& error) {
      EXPECT_THAT(error.what(), HasSubstr("but the depth map is 20 x 10"));
    }
  }
  fs::remove(workspace_.DenseMasks() / "a.png.png");
  fs::remove(workspace_.TableSeen() / "a.png.png");
  const DensePhotos bare(Find());
  EXPECT_TRUE(bare.LoadMask(0).pixels.empty());
  EXPECT_TRUE(bare.LoadTableSeen(0).pixels.empty());
}

}  // namespace
}  // namespace s2gs
