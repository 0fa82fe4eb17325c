#include "sfm_split/scene/io/colmap_model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <map>
#include <sstream>
#include <string>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "tests/sfm_split/scene/io/colmap_model_example.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// The bytes of numbers and texts, put together without the project's writers.
template <typename T>
void AppendBytes(std::string* bytes, T value) {
  bytes->append(reinterpret_cast<const char*>(&value), sizeof(T));
}
template <typename... Ts>
std::string Pack(Ts... values) {
  std::string bytes;
  (AppendBytes(&bytes, values), ...);
  return bytes;
}

void ExpectSamePose(const Rigid3& a, const Rigid3& b) {
  EXPECT_EQ(a.rotation.coeffs(), b.rotation.coeffs());
  EXPECT_EQ(a.translation, b.translation);
}

void ExpectSameModel(const ColmapModel& a, const ColmapModel& b) {
  ASSERT_EQ(a.cameras.size(), b.cameras.size());
  for (const auto& [id, camera] : a.cameras) {
    const Camera& other = b.cameras.at(id);
    EXPECT_EQ(camera.camera_id, other.camera_id);
    EXPECT_EQ(camera.model, other.model);
    EXPECT_EQ(camera.width, other.width);
    EXPECT_EQ(camera.height, other.height);
    EXPECT_EQ(camera.params, other.params);
  }
  ASSERT_EQ(a.images.size(), b.images.size());
  for (const auto& [id, image] : a.images) {
    const ColmapImage& other = b.images.at(id);
    EXPECT_EQ(image.image_id, other.image_id);
    EXPECT_EQ(image.name, other.name);
    EXPECT_EQ(image.camera_id, other.camera_id);
    ExpectSamePose(image.cam_from_world, other.cam_from_world);
    ASSERT_EQ(image.points2D.size(), other.points2D.size());
    for (size_t i = 0; i < image.points2D.size(); ++i) {
      EXPECT_EQ(image.points2D[i].xy, other.points2D[i].xy);
      EXPECT_EQ(image.points2D[i].point3D_id, other.points2D[i].point3D_id);
    }
  }
  ASSERT_EQ(a.points3D.size(), b.points3D.size());
  for (const auto& [id, point] : a.points3D) {
    const ColmapPoint3D& other = b.points3D.at(id);
    EXPECT_EQ(point.point3D_id, other.point3D_id);
    EXPECT_EQ(point.xyz, other.xyz);
    EXPECT_EQ(point.rgb, other.rgb);
    EXPECT_EQ(point.error, other.error);
    ASSERT_EQ(point.track.size(), other.track.size());
    for (size_t i = 0; i < point.track.size(); ++i) {
      EXPECT_EQ(point.track[i].image_id, other.track[i].image_id);
      EXPECT_EQ(point.track[i].point2D_idx, other.track[i].point2D_idx);
    }
  }
  // Rigs and frames by their bytes; the byte layout is pinned by the fixtures below.
  EXPECT_EQ(Bytes(&WriteColmapRigs, ColmapFormat::kBinary, a.rigs),
            Bytes(&WriteColmapRigs, ColmapFormat::kBinary, b.rigs));
  EXPECT_EQ(Bytes(&WriteColmapFrames, ColmapFormat::kBinary, a.frames),
            Bytes(&WriteColmapFrames, ColmapFormat::kBinary, b.frames));
}

class ColmapModelFormats : public ::testing::TestWithParam<ColmapFormat> {
 protected:
  std::string File(const std::string& name) const {
    return name + (GetParam() == ColmapFormat::kBinary ? ".bin" : ".txt");
  }
};
INSTANTIATE_TEST_SUITE_P(Formats, ColmapModelFormats,
                         ::testing::Values(ColmapFormat::kBinary, ColmapFormat::kText),
                         [](const auto& format) {
                           return format.param == ColmapFormat::kBinary ? "Binary" : "Text";
                         });

TEST_P(ColmapModelFormats, RoundTripKeepsEverything) {
  const TemporaryFolder folder;
  for (const ColmapModel& model : {ExampleModel(), ExampleModelWithRigs(), ColmapModel()}) {
    WriteColmapModel(folder / "sparse/0", model, GetParam());
    ExpectSameModel(model, ReadColmapModel(folder / "sparse/0"));
    EXPECT_EQ(fs::exists(folder / ("sparse/0/" + File("frames"))), !model.frames.empty());
    EXPECT_EQ(fs::exists(folder / ("sparse/0/" + File("rigs"))), !model.rigs.empty());
  }
}

TEST_P(ColmapModelFormats, SingleFilesByPath) {
  const TemporaryFolder folder;
  const ColmapModel model = ExampleModelWithRigs();
  WriteColmapCameras(folder / File("cameras"), model.cameras);
  WriteColmapImages(folder / File("images"), model.images);
  WriteColmapPoints3D(folder / File("points3D"), model.points3D);
  WriteColmapRigs(folder / File("rigs"), model.rigs);
  WriteColmapFrames(folder / File("frames"), model.frames);
  ColmapModel read;
  read.cameras = ReadColmapCameras(folder / File("cameras"));
  read.images = ReadColmapImages(folder / File("images"));
  read.points3D = ReadColmapPoints3D(folder / File("points3D"));
  read.rigs = ReadColmapRigs(folder / File("rigs"));
  read.frames = ReadColmapFrames(folder / File("frames"));
  ExpectSameModel(model, read);
  ExpectSameModel(model, ReadColmapModel(folder.path()));
}

// A later COLMAP takes poses from frames.bin: one that outlives its images.bin would move every camera.
TEST_P(ColmapModelFormats, StaleRigsAndFramesGo) {
  const TemporaryFolder folder;
  for (const ColmapFormat old_format : {ColmapFormat::kBinary, ColmapFormat::kText}) {
    WriteColmapModel(folder.path(), ExampleModelWithRigs(), old_format);
    folder.Write("project.ini", "kept");
    WriteColmapModel(folder.path(), ExampleModel(), GetParam());
    size_t num_files = 0;
    for (const auto& entry : fs::directory_iterator(folder.path())) {
      EXPECT_NE(entry.path().stem(), "frames");
      EXPECT_NE(entry.path().stem(), "rigs");
      ++num_files;
    }
    EXPECT_EQ(num_files, 4u);  // Not the other format's files either.
    ExpectSameModel(ExampleModel(), ReadColmapModel(folder.path()));
  }
}

TEST_P(ColmapModelFormats, PosesComeFromFrames) {
  const TemporaryFolder folder;
  const ColmapModel model = ExampleModelWithRigs();
  WriteColmapModel(folder.path(), model, GetParam());
  ColmapModel lying = model;
  for (auto& [id, image] : lying.images) image.cam_from_world = Rigid3();
  WriteColmapImages(folder / File("images"), lying.images);
  ExpectSameModel(model, ReadColmapModel(folder.path()));
}

TEST_P(ColmapModelFormats, EmptyRigsAndFramesLeaveTheImagesTheirPoses) {
  const TemporaryFolder folder;
  WriteColmapModel(folder.path(), ExampleModel(), GetParam());
  WriteColmapRigs(folder / File("rigs"), {});
  WriteColmapFrames(folder / File("frames"), {});
  ExpectSameModel(ExampleModel(), ReadColmapModel(folder.path()));
}

TEST_P(ColmapModelFormats, FramesFollowTheImagesThatMovedTogether) {
  const TemporaryFolder folder;
  ColmapModel model = ExampleModelWithRigs();
  Rigid3 old_world_from_world;
  old_world_from_world.rotation = Eigen::Quaterniond(0.5, 0.5, -0.5, 0.5);
  old_world_from_world.translation = {3, -2, 10};
  for (auto& [id, image] : model.images) image.cam_from_world = image.cam_from_world * old_world_from_world;
  WriteColmapModel(folder.path(), model, GetParam());
  const ColmapModel read = ReadColmapModel(folder.path());
  EXPECT_EQ(read.rigs.size(), 2u);
  EXPECT_EQ(read.rigs.at(2).sensors.size(), 2u);
  EXPECT_EQ(read.frames.size(), 2u);
  for (const auto& [id, image] : model.images) {
    // Measured: at most 2e-15.
    EXPECT_LT((read.images.at(id).cam_from_world.Matrix() - image.cam_from_world.Matrix()).norm(), 1e-13);
  }
}

TEST_P(ColmapModelFormats, TrivialRigsWhenTheRigNoLongerFits) {
  const TemporaryFolder folder;
  ColmapModel model = ExampleModelWithRigs();
  model.images[2].cam_from_world.translation.x() += 1e-3;
  WriteColmapModel(folder.path(), model, GetParam());
  ColmapModel read = ReadColmapModel(folder.path());
  EXPECT_EQ(read.rigs.size(), 2u);
  EXPECT_EQ(read.frames.size(), 3u);
  EXPECT_TRUE(read.rigs.at(4).sensors.empty());
  EXPECT_EQ(read.frames.at(7).data.at(0).data_id, 7u);
  for (const auto& [id, image] : model.images)
    ExpectSamePose(read.images.at(id).cam_from_world, image.cam_from_world);

  // An image that no frame knows, and one that is gone.
  model = ExampleModelWithRigs();
  model.images[8] = {8, "new.jpg", 1, Rigid3(), {}};
  model.images.erase(7);
  WriteColmapModel(folder.path(), model, GetParam());
  read = ReadColmapModel(folder.path());
  EXPECT_EQ(read.frames.size(), 3u);
  for (const auto& [id, image] : model.images)
    ExpectSamePose(read.images.at(id).cam_from_world, image.cam_from_world);
}

TEST_P(ColmapModelFormats, NothingIsReplacedWhenTheModelCannotBeWritten) {
  const TemporaryFolder folder;
  WriteColmapModel(folder.path(), ExampleModel(), GetParam());
  ColmapModel broken = ExampleModel();
  broken.images[1].camera_id = 5;
  ExpectUserError([&] { WriteColmapModel(folder.path(), broken, GetParam()); },
                  {File("images"), "image 1", "camera 5"});
  ExpectSameModel(ExampleModel(), ReadColmapModel(folder.path()));
}

// --- Bytes -------------------------------------------------------------------------------------------------

TEST(ColmapModelBytes, Cameras) {
  const std::string bytes =
      Pack(uint64_t{2}) +  //
      Pack(uint32_t{3}, int32_t{2}, uint64_t{640}, uint64_t{480}, 500.5, 320., 240., -0.1) +
      Pack(uint32_t{9}, int32_t{17}, uint64_t{64}, uint64_t{32}, 64., 32.);
  const std::map<uint32_t, Camera> cameras = {
      {3, {3, CameraModelId::kSimpleRadial, 640, 480, {500.5, 320, 240, -0.1}}},
      {9, {9, CameraModelId::kEquirectangular, 64, 32, {64, 32}}}};
  EXPECT_EQ(Bytes(&WriteColmapCameras, ColmapFormat::kBinary, cameras), bytes);
  std::istringstream stream(bytes);
  const auto read = ReadColmapCameras(stream, ColmapFormat::kBinary, "memory");
  EXPECT_EQ(Bytes(&WriteColmapCameras, ColmapFormat::kBinary, read), bytes);
  EXPECT_EQ(read.at(3).params, cameras.at(3).params);
  EXPECT_EQ(Bytes(&WriteColmapCameras, ColmapFormat::kText, cameras),
            "# Cameras, one a line:\n"
            "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
            "# Number of cameras: 2\n"
            "3 SIMPLE_RADIAL 640 480 500.5 320 240 -0.10000000000000001\n"
            "9 EQUIRECTANGULAR 64 32 64 32\n");
}

TEST(ColmapModelBytes, Images) {
  const std::string bytes = Pack(uint64_t{1}, uint32_t{5}, 0.5, -0.5, 0.5, 0.5, 1., 2., 3., uint32_t{9}) +
                            std::string("a b.jpg\0", 8) +
                            Pack(uint64_t{2}, 1.5, 2.5, ~uint64_t{0}, 0.1, 1e-7, uint64_t{12345678901});
  ColmapImage image{5, "a b.jpg", 9, {}, {{{1.5, 2.5}, kInvalidPoint3DId}, {{0.1, 1e-7}, 12345678901}}};
  image.cam_from_world.rotation = Eigen::Quaterniond(0.5, -0.5, 0.5, 0.5);
  image.cam_from_world.translation = {1, 2, 3};
  const std::map<uint32_t, ColmapImage> images = {{5, image}};
  EXPECT_EQ(Bytes(&WriteColmapImages, ColmapFormat::kBinary, images), bytes);
  EXPECT_EQ(Bytes(&WriteColmapImages, ColmapFormat::kText, images),
            "# Images, two lines each:\n"
            "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
            "#   POINTS2D[] as (X, Y, POINT3D_ID)\n"
            "# Number of images: 1\n"
            "5 0.5 -0.5 0.5 0.5 1 2 3 9 a b.jpg\n"
            "1.5 2.5 -1 0.10000000000000001 9.9999999999999995e-08 12345678901\n");
}

TEST(ColmapModelBytes, Points3D) {
  const std::string bytes =
      Pack(uint64_t{1}, uint64_t{77}, 1., -2., 0.1, uint8_t{255}, uint8_t{0}, uint8_t{128}, 0.5, uint64_t{2},
           uint32_t{1}, uint32_t{20}, uint32_t{3}, uint32_t{40});
  const std::map<uint64_t, ColmapPoint3D> points = {
      {77, {77, {1, -2, 0.1}, {255, 0, 128}, 0.5, {{1, 20}, {3, 40}}}}};
  EXPECT_EQ(Bytes(&WriteColmapPoints3D, ColmapFormat::kBinary, points), bytes);
  EXPECT_EQ(Bytes(&WriteColmapPoints3D, ColmapFormat::kText, points),
            "# 3D points, one a line:\n"
            "#   POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
            "# Number of points: 1\n"
            "77 1 -2 0.10000000000000001 255 0 128 0.5 1 20 3 40\n");
}

TEST(ColmapModelBytes, RigsAndFrames) {
  const std::string rig_bytes =
      Pack(uint64_t{2}) +                                                              //
      Pack(uint32_t{1}, uint32_t{3}, int32_t{0}, uint32_t{7}) +                        // reference
      Pack(int32_t{0}, uint32_t{8}, uint8_t{1}, 0.5, 0.5, 0.5, -0.5, 0.25, -1., 2.) +  // calibrated
      Pack(int32_t{1}, uint32_t{2}, uint8_t{0}) +                                      // not
      Pack(uint32_t{4}, uint32_t{0});
  Rigid3 sensor_from_rig;
  sensor_from_rig.rotation = Eigen::Quaterniond(0.5, 0.5, 0.5, -0.5);
  sensor_from_rig.translation = {0.25, -1, 2};
  const ColmapSensor camera7{ColmapSensorType::kCamera, 7};
  const ColmapSensor camera8{ColmapSensorType::kCamera, 8};
  const ColmapSensor imu2{ColmapSensorType::kImu, 2};
  const std::map<uint32_t, ColmapRig> rigs = {
      {1, {1, camera7, {{camera8, sensor_from_rig}, {imu2, std::nullopt}}}}, {4, {4, std::nullopt, {}}}};
  EXPECT_EQ(Bytes(&WriteColmapRigs, ColmapFormat::kBinary, rigs), rig_bytes);
  std::istringstream rig_stream(rig_bytes);
  EXPECT_EQ(Bytes(&WriteColmapRigs, ColmapFormat::kBinary,
                  ReadColmapRigs(rig_stream, ColmapFormat::kBinary, "memory")),
            rig_bytes);
  EXPECT_EQ(Bytes(&WriteColmapRigs, ColmapFormat::kText, rigs),
            "# Rigs, one a line:\n"
            "#   RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, SENSOR_ID, "
            "HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])\n"
            "# Number of rigs: 2\n"
            "1 3 CAMERA 7 CAMERA 8 1 0.5 0.5 0.5 -0.5 0.25 -1 2 IMU 2 0\n"
            "4 0\n");

  const std::string frame_bytes =
      Pack(uint64_t{1}, uint32_t{6}, uint32_t{1}, 1., 0., 0., 0., 4., 5., 6., uint32_t{2}) +
      Pack(int32_t{0}, uint32_t{7}, uint64_t{70}, int32_t{1}, uint32_t{2}, uint64_t{1} << 40);
  ColmapFrame frame{6, 1, {}, {{camera7, 70}, {imu2, uint64_t{1} << 40}}};
  frame.rig_from_world.translation = {4, 5, 6};
  const std::map<uint32_t, ColmapFrame> frames = {{6, frame}};
  EXPECT_EQ(Bytes(&WriteColmapFrames, ColmapFormat::kBinary, frames), frame_bytes);
  EXPECT_EQ(Bytes(&WriteColmapFrames, ColmapFormat::kText, frames),
            "# Frames, one a line:\n"
            "#   FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, DATA_IDS[] as "
            "(SENSOR_TYPE, SENSOR_ID, DATA_ID)\n"
            "# Number of frames: 1\n"
            "6 1 1 0 0 0 4 5 6 2 CAMERA 7 70 IMU 2 1099511627776\n");
}

// --- What other programs' files look like ------------------------------------------------------------------

TEST(ColmapModelText, ToleratesBlankLinesCarriageReturnsAndTabs) {
  std::istringstream stream(
      "# comment\r\n\r\n1 1 0 0 0 0 0 0 2  my photo.jpg \r\n\r\n2\t1 0 0 0 0 0 0 2 b.jpg\r\n1 2 -1\r\n");
  const auto images = ReadColmapImages(stream, ColmapFormat::kText, "images.txt");
  ASSERT_EQ(images.size(), 2u);
  EXPECT_EQ(images.at(1).name, "my photo.jpg");
  EXPECT_EQ(images.at(1).points2D.size(), 0u);
  EXPECT_EQ(images.at(2).points2D.size(), 1u);
}

TEST(ColmapModelText, TheLastImageMayLackItsBlankLine) {
  std::istringstream stream("1 1 0 0 0 0 0 0 2 a.jpg\n\n2 1 0 0 0 0 0 0 2 b.jpg\n");
  EXPECT_EQ(ReadColmapImages(stream, ColmapFormat::kText, "images.txt").size(), 2u);
  std::istringstream cut("1 1 0 0 0 0 0 0 2 a.jpg\n\n2 1 0 0 0 0 0 0 2 b.jp");
  ExpectUserError([&] { ReadColmapImages(cut, ColmapFormat::kText, "images.txt"); },
                  {"images.txt", "line 3"});
}

TEST(ColmapModel, QuaternionsAreNormalisedUnlessTheyAreUnit) {
  std::istringstream stream("1 2 0 0 2 0 0 0 2 a.jpg\n\n");
  const auto images = ReadColmapImages(stream, ColmapFormat::kText, "images.txt");
  EXPECT_NEAR(images.at(1).cam_from_world.rotation.w(), std::sqrt(0.5), 1e-15);
  EXPECT_NEAR(images.at(1).cam_from_world.rotation.z(), std::sqrt(0.5), 1e-15);
}

TEST(ColmapModel, BinaryIsPreferred) {
  const TemporaryFolder folder;
  const TemporaryFolder text_folder;
  WriteColmapModel(folder.path(), ExampleModel(), ColmapFormat::kBinary);
  for (const char* name : {"cameras.txt", "images.txt", "points3D.txt"}) folder.Write(name, "nonsense");
  ExpectSameModel(ExampleModel(), ReadColmapModel(folder.path()));
  // Without a complete binary model the text counts.
  fs::remove(folder / "images.bin");
  ExpectUserError([&] { ReadColmapModel(folder.path()); }, {"cameras.txt", "line 1"});
}

TEST(ColmapModel, MissingFilesAreNamed) {
  const TemporaryFolder folder;
  ExpectUserError([&] { ReadColmapModel(folder / "none"); }, {(folder / "none").string(), "no such folder"});
  ExpectUserError([&] { ReadColmapModel(folder.path()); },
                  {folder.path().string(), "points3D.bin", "mapper"});
  WriteColmapModel(folder.path(), ExampleModelWithRigs(), ColmapFormat::kBinary);
  fs::remove(folder / "frames.bin");
  ExpectUserError([&] { ReadColmapModel(folder.path()); }, {"frames.bin", "no such file"});
  ExpectUserError([&] { ReadColmapCameras(folder / "cameras.ply"); }, {"cameras.ply", ".bin"});
}

// The shortest that the format allows.
TEST(ColmapModel, FramesWithoutDataAreRead) {
  std::map<uint32_t, ColmapFrame> frames;
  for (const uint32_t id : {3U, 4U, 9U}) frames[id].frame_id = id;
  std::istringstream stream(Bytes(&WriteColmapFrames, ColmapFormat::kBinary, frames));
  const std::map<uint32_t, ColmapFrame> read = ReadColmapFrames(stream, ColmapFormat::kBinary, "frames.bin");
  EXPECT_EQ(Bytes(&WriteColmapFrames, ColmapFormat::kBinary, read),
            Bytes(&WriteColmapFrames, ColmapFormat::kBinary, frames));
  EXPECT_EQ(read.size(), 3U);
}

}  // namespace
}  // namespace s2gs
