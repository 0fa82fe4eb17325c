#include "plugin/outputs/texture_workspace.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "mesh/surface/triangle_mesh.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "tests/mesh/texture/box_photos.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr int kSide = 120;  // [px]
constexpr int kPhotos = 12;

Eigen::Array3d Slopes(const Eigen::Vector3d& x) {
  return {128 + 100 * x.x(), 128 + 100 * x.y(), 128 + 100 * x.z()};
}

// A workspace with photos of a painted box and, where asked, its mesh.
class TextureWorkspaceTest : public testing::Test {
 protected:
  void SetUp() override {
    std::vector<ObjectView> views;
    for (int i = 0; i < kPhotos; ++i) {
      const double azimuth = 2 * kPi * i / kPhotos;
      const double elevation = i % 2 == 0 ? 0.9 : -0.9;
      views.push_back(
          LookAtOrigin(5 * Eigen::Vector3d(std::cos(azimuth) * std::cos(elevation),
                                           std::sin(azimuth) * std::cos(elevation), std::sin(elevation)),
                       kSide, 210));
    }
    const BoxPhotos photos(boxes_, views);
    ColmapModel model;
    const ObjectView& first = views[0];
    model.cameras[1] = {1, CameraModelId::kPinhole, kSide, kSide, {first.fx, first.fy, first.cx, first.cy}};
    fs::create_directories(workspace_.DenseImages());
    for (int i = 0; i < kPhotos; ++i) {
      ColmapImage image;
      image.image_id = static_cast<uint32_t>(i + 1);
      image.name = std::string(1, static_cast<char>('a' + i)) + ".png";
      image.camera_id = 1;
      image.cam_from_world = views[i].cam_from_object;
      model.images[image.image_id] = image;
      WriteImage(workspace_.DenseImages() / image.name, photos.Load(i));
    }
    fs::create_directories(workspace_.DenseModel());
    WriteColmapModel(workspace_.DenseModel(), model, ColmapFormat::kBinary);
  }

  void WriteMesh() { WritePlyMesh(workspace_.TsdfMesh(), MeshOf(boxes_)); }

  TextureWorkspaceSummary Run(const TextureWorkspaceOptions& options = {}) {
    Reporter silent;
    return TextureWorkspace(workspace_, options, silent);
  }

  // What the user is told.
  std::string FaultOf(const TextureWorkspaceOptions& options = {}) {
    try {
      Run(options);
    } catch (const UserError& error) {
      return error.what();
    }
    return "";
  }

  const std::vector<PaintedBox> boxes_ = {{{-0.6, -0.5, -0.4}, {0.6, 0.5, 0.4}, Slopes}};
  TemporaryFolder folder_;
  Workspace workspace_{folder_.path()};
};

TEST_F(TextureWorkspaceTest, ColoursAreThoseOfPhotosThatGaveNone) {
  WriteMesh();
  TextureWorkspaceOptions options;
  options.test_every = 4;
  options.render_path = folder_ / "held_out";
  const TextureWorkspaceSummary summary = Run(options);
  EXPECT_EQ(summary.num_photos, 9);  // the 1st, 5th and 9th give no texture
  EXPECT_EQ(summary.held_out.num_photos, 3);
  EXPECT_EQ(summary.num_masks, 0);
  // The mask is what the mesh covers, where there is no other.
  EXPECT_EQ(summary.held_out.covered_share, 1);
  EXPECT_GT(summary.held_out.psnr, 48);                         // measured: 50.8 dB
  EXPECT_EQ(summary.held_out.psnr_lit, summary.held_out.psnr);  // nothing turns: the light is even
  for (const fs::path& path : summary.written) EXPECT_TRUE(fs::exists(path)) << path;
  EXPECT_FALSE(summary.written.empty());
  for (const char* name : {"a.png.png", "e.png.png", "i.png.png"}) {
    const Image8 rendered = ReadImage(folder_ / "held_out" / name, 3);
    EXPECT_EQ(rendered.width, kSide);
  }
  EXPECT_FALSE(fs::exists(folder_ / "held_out" / "b.png.png"));
}

TEST_F(TextureWorkspaceTest, AllPhotosGiveTextureWhereNoneIsHeldOut) {
  WriteMesh();
  TextureWorkspaceOptions options;
  options.output_path = folder_ / "elsewhere";
  const TextureWorkspaceSummary summary = Run(options);
  EXPECT_EQ(summary.num_photos, kPhotos);
  EXPECT_EQ(summary.held_out.num_photos, 0);
  EXPECT_TRUE(std::isnan(summary.held_out.psnr));
  for (const fs::path& path : summary.written) EXPECT_EQ(path.parent_path(), folder_.path()) << path;
}

TEST_F(TextureWorkspaceTest, WhatIsMissingIsNamed) {
  EXPECT_THAT(FaultOf(), HasSubstr("there is no mesh to texture"));
  WritePlyMesh(workspace_.TsdfMesh(), {});
  EXPECT_THAT(FaultOf(), HasSubstr("has no triangles"));
  WriteMesh();
  fs::remove_all(workspace_.DenseImages());
  EXPECT_THAT(FaultOf(), HasSubstr("holds no photo"));
}

TEST(TextureWorkspaceOptions, OneOfEveryPhotoIsNoOption) {
  TextureWorkspaceOptions options;
  EXPECT_FALSE(options.Check());
  options.test_every = 2;
  EXPECT_FALSE(options.Check());
  for (const int wrong : {1, -1}) {
    options.test_every = wrong;
    ASSERT_TRUE(options.Check()) << wrong;
    EXPECT_EQ(options.Check()->field, "test_every");
  }
}

}  // namespace
}  // namespace s2gs
