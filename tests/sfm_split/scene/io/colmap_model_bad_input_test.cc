#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <sstream>
#include <string>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "tests/sfm_split/scene/io/colmap_model_example.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

struct FileCase {
  std::string name;
  std::string bytes;
  std::function<void(std::istream&, const std::string& path)> read;
  std::vector<size_t> count_offsets;        ///< of 64-bit counts, binary only.
  std::vector<size_t> small_count_offsets;  ///< of 32-bit counts.
};

template <typename Items>
FileCase MakeCase(const std::string& name, ColmapFormat format,
                  void (*write)(std::ostream&, ColmapFormat, const Items&),
                  Items (*read)(std::istream&, ColmapFormat, const std::filesystem::path&),
                  const Items& items, std::vector<size_t> count_offsets = {},
                  std::vector<size_t> small_count_offsets = {}) {
  return {name, Bytes(write, format, items),
          [=](std::istream& stream, const std::string& path) { read(stream, format, path); },
          std::move(count_offsets), std::move(small_count_offsets)};
}

std::vector<FileCase> AllFiles() {
  const ColmapModel model = ExampleModelWithRigs();
  std::vector<FileCase> cases;
  for (const ColmapFormat format : {ColmapFormat::kBinary, ColmapFormat::kText}) {
    const bool binary = format == ColmapFormat::kBinary;
    const std::string ext = binary ? ".bin" : ".txt";
    cases.push_back(
        MakeCase("cameras" + ext, format, &WriteColmapCameras, &ReadColmapCameras, model.cameras, {0}));
    // The first image's name is "first.jpg": 8 + 4 + 56 + 4 + 10 bytes stand before its number of keypoints.
    cases.push_back(
        MakeCase("images" + ext, format, &WriteColmapImages, &ReadColmapImages, model.images, {0, 82}));
    cases.push_back(MakeCase("points3D" + ext, format, &WriteColmapPoints3D, &ReadColmapPoints3D,
                             model.points3D, {0, 51}));
    cases.push_back(MakeCase("rigs" + ext, format, &WriteColmapRigs, &ReadColmapRigs, model.rigs, {0}, {12}));
    cases.push_back(
        MakeCase("frames" + ext, format, &WriteColmapFrames, &ReadColmapFrames, model.frames, {0}, {72}));
    if (!binary) {
      for (FileCase& item : cases) {
        if (item.name.find(".txt") == std::string::npos) continue;
        item.count_offsets.clear();
        item.small_count_offsets.clear();
      }
    }
  }
  return cases;
}

TEST(ColmapModelBadInput, EveryDamageIsSurvived) {
  for (const FileCase& item : AllFiles()) {
    const bool binary = item.name.find(".bin") != std::string::npos;
    int num_refused = 0;
    ForEachDamage(item.bytes, [&](const std::string& damaged, const std::string& description) {
      const ScopedAllocationLimit limit(8192 + 20 * item.bytes.size());
      std::istringstream stream(damaged);
      const bool ok = ExpectOkOrUserError(
          [&] {
            try {
              item.read(stream, "sparse/" + item.name);
            } catch (const UserError& error) {
              const char* place = binary ? "at byte" : "in line";
              EXPECT_NE(std::string(error.what()).find(place), std::string::npos) << error.what();
              throw;
            }
          },
          "sparse/" + item.name, item.name + " " + description);
      num_refused += !ok;
    });
    EXPECT_GT(num_refused, static_cast<int>(item.bytes.size()) / 2) << item.name;
  }
}

TEST(ColmapModelBadInput, EveryTruncationOfABinaryFileIsRefused) {
  for (const FileCase& item : AllFiles()) {
    if (item.name.find(".bin") == std::string::npos) continue;
    for (size_t size = 0; size < item.bytes.size(); ++size) {
      std::istringstream stream(item.bytes.substr(0, size));
      ExpectUserError([&] { item.read(stream, item.name); }, {item.name, "at byte"},
                      item.name + " cut to " + std::to_string(size));
    }
    std::istringstream longer(item.bytes + '\0');
    ExpectUserError([&] { item.read(longer, item.name); }, {item.name, "1 bytes follow"});
  }
}

TEST(ColmapModelBadInput, HostileCountsAllocateNothing) {
  int num_counts = 0;
  for (const FileCase& item : AllFiles()) {
    const auto expect_refused = [&](const std::string& damaged, uint64_t count) {
      const ScopedAllocationLimit limit(10000);
      std::istringstream stream(damaged);
      ExpectUserError([&] { item.read(stream, item.name); }, {item.name, "at byte"},
                      item.name + " with count " + std::to_string(count));
      ++num_counts;
    };
    for (const size_t offset : item.count_offsets) {
      for (const uint64_t count :
           {~uint64_t{0}, uint64_t{1} << 63, uint64_t{1} << 31, uint64_t{1} << 61, uint64_t{1000}}) {
        expect_refused(WithInteger(item.bytes, offset, 8, count), count);
      }
    }
    for (const size_t offset : item.small_count_offsets) {
      for (const uint64_t count : {~uint64_t{0}, uint64_t{1} << 31, uint64_t{1000}}) {
        expect_refused(WithInteger(item.bytes, offset, 4, count), count);
      }
    }
  }
  EXPECT_EQ(num_counts, 7 * 5 + 2 * 3);
}

TEST(ColmapModelBadInput, HostileText) {
  struct Text {
    std::string file, text, problem;
  };
  for (const Text& item : std::vector<Text>{
           {"cameras.txt", "1 PINHOLE 10 10 1 1 5", "camera parameter is missing"},
           {"cameras.txt", "1 PINHOLE 10 10 1 1 5 5 5", "unexpected \"5\""},
           {"cameras.txt", "\n# c\n1 PINHOLE 10 10 1 1 5 5\n1 PINHOLE 10 10 1 1 5 5",
            "camera 1 occurs twice, in line 4"},
           {"cameras.txt", "1 PIN 10 10 1 1 5 5", "camera model is unknown"},
           {"cameras.txt", "-1 PINHOLE 10 10 1 1 5 5", "camera id is \"-1\""},
           {"cameras.txt", "4294967296 PINHOLE 10 10 1 1 5 5", "camera id is \"4294967296\""},
           {"cameras.txt", "1 PINHOLE 10 10 1 1 5 5x", "\"5x\""},
           {"cameras.txt", "1 PINHOLE 10 10 1 1 5 1e999", "\"1e999\""},
           {"cameras.txt", "1 PINHOLE 10 10 1 1 5 nan", "not finite"},
           {"cameras.txt", "1 PINHOLE 10 10 1 -1 5 5", "focal length"},
           {"cameras.txt", "1 PINHOLE 0 10 1 1 5 5", "0 x 10 pixels"},
           {"cameras.txt", "1 PINHOLE 10 4294967296 1 1 5 5", "4294967296 pixels"},
           {"images.txt", "1 0 0 0 0 0 0 0 1 a.jpg\n\n", "rotation zero"},
           {"images.txt", "1 1 0 0 0 0 inf 0 1 a.jpg\n\n", "not finite"},
           {"images.txt", "1 1 0 0 0 0 0 0 1\n\n", "the name of image 1"},
           {"images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n1 2\n", "point id of a keypoint is missing, in line 2"},
           {"images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n1 2 -2\n", "point id of a keypoint"},
           {"images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n1 nan 2\n", "keypoint that is not finite"},
           {"points3D.txt", "1 0 0 0 256 0 0 1\n", "point colour is \"256\""},
           {"points3D.txt", "1 0 0 0 1 0 0 1 5\n", "keypoint index of a track is missing"},
           {"points3D.txt", "18446744073709551615 0 0 0 1 0 0 1\n", "means no point"},
           {"points3D.txt", "1 0 0 nan 1 0 0 1\n", "not finite"},
           {"rigs.txt", "1 4294967295 CAMERA 1\n", "sensor type is missing"},
           {"rigs.txt", "1 1 LIDAR 1\n", "sensor type is unknown"},
           {"rigs.txt", "1 2 CAMERA 1 CAMERA 2 2\n", "pose mark"},
           {"rigs.txt", "1 2 CAMERA 1 CAMERA 1 0\n", "sensor 1 twice"},
           {"frames.txt", "1 1 1 0 0 0 0 0 0 4294967295 CAMERA 1 1\n", "sensor type is missing"},
           {"frames.txt", "1 1 1 0 0 0 0 0 0 0 CAMERA\n", "unexpected \"CAMERA\""},
           {"frames.txt", std::string("1 1 1 0 0 0 0 0 0 0 \0\0\n", 23), "unexpected \"??\""}}) {
    const ScopedAllocationLimit limit(10000);
    std::istringstream stream(item.text);
    const auto read = [&] {
      if (item.file == "cameras.txt") ReadColmapCameras(stream, ColmapFormat::kText, item.file);
      if (item.file == "images.txt") ReadColmapImages(stream, ColmapFormat::kText, item.file);
      if (item.file == "points3D.txt") ReadColmapPoints3D(stream, ColmapFormat::kText, item.file);
      if (item.file == "rigs.txt") ReadColmapRigs(stream, ColmapFormat::kText, item.file);
      if (item.file == "frames.txt") ReadColmapFrames(stream, ColmapFormat::kText, item.file);
    };
    ExpectUserError(read, {item.file, item.problem, "in line"}, item.text);
  }
}

// Files that are sound one by one but do not fit together.
TEST(ColmapModelBadInput, BrokenReferencesAreNamed) {
  struct Fault {
    std::function<void(ColmapModel*)> make;
    std::string file;
    std::string problem;
  };
  const std::vector<Fault> faults = {
      {[](ColmapModel* m) { m->images[1].camera_id = 3; }, "images", "camera 3, which does not exist"},
      {[](ColmapModel* m) { m->images[7].name = "first.jpg"; }, "images",
       "two images have the name first.jpg"},
      {[](ColmapModel* m) { m->images[1].points2D[0].point3D_id = 11; }, "points3D", "does not confirm"},
      {[](ColmapModel* m) { m->images[1].points2D[1].point3D_id = 11; }, "images",
       "point 11, which does not exist"},
      {[](ColmapModel* m) { m->images[1].points2D[1].point3D_id = 99; }, "points3D",
       "3 keypoints with a point"},
      {[](ColmapModel* m) {
         m->points3D[10].track.push_back({1, 0});
       },
       "points3D", "3 elements"},
      {[](ColmapModel* m) { m->points3D[10].track[0].image_id = 6; }, "points3D",
       "image 6, which does not exist"},
      {[](ColmapModel* m) { m->points3D[10].track[0].point2D_idx = 2; }, "points3D", "keypoint 2 of image 1"},
      {[](ColmapModel* m) { m->rigs[5].ref_sensor->id = 6; }, "rigs", "camera 6, which does not exist"},
      {[](ColmapModel* m) { m->frames[3].rig_id = 6; }, "frames", "rig 6, which does not exist"},
      {[](ColmapModel* m) {
         m->frames[3].rig_id = 2;
         m->frames[3].data[0].sensor.id = 9;
       },
       "frames", "sensor 9"},
      {[](ColmapModel* m) { m->frames[3].data[0].data_id = 2; }, "frames", "image 2 occurs in two frames"},
      {[](ColmapModel* m) { m->frames[3].data[0].data_id = 8; }, "frames", "image 8, which does not exist"},
      {[](ColmapModel* m) { m->frames[3].data[0].data_id = (uint64_t{1} << 32) + 7; }, "frames",
       "4294967303"},
      {[](ColmapModel* m) { m->frames[3].data.clear(); }, "frames", "image 7 is in no frame"},
      {[](ColmapModel* m) { m->frames[1].data.erase(m->frames[1].data.begin()); }, "frames",
       "image 1 is in no frame"},
      {[](ColmapModel* m) { m->rigs[2].sensors[0].sensor_from_rig.reset(); }, "frames",
       "camera 4 is not calibrated"},
  };
  for (const ColmapFormat format : {ColmapFormat::kBinary, ColmapFormat::kText}) {
    const std::string ext = format == ColmapFormat::kBinary ? ".bin" : ".txt";
    for (const Fault& fault : faults) {
      const TemporaryFolder folder;
      ColmapModel model = ExampleModelWithRigs();
      fault.make(&model);
      WriteColmapCameras(folder / ("cameras" + ext), model.cameras);
      WriteColmapImages(folder / ("images" + ext), model.images);
      WriteColmapPoints3D(folder / ("points3D" + ext), model.points3D);
      WriteColmapRigs(folder / ("rigs" + ext), model.rigs);
      WriteColmapFrames(folder / ("frames" + ext), model.frames);
      ExpectUserError([&] { ReadColmapModel(folder.path()); },
                      {(folder / (fault.file + ext)).string(), fault.problem}, fault.problem);
    }
  }
}

}  // namespace
}  // namespace s2gs
