// Feature extraction with a shell script in place of COLMAP: it notes its arguments and hands out a database
// that was made before.

#include "plugin/colmap/extract_features.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <omp.h>
#include <sys/stat.h>

#include <map>
#include <sstream>
#include <string>
#include <vector>

#include "plugin/cli/command.h"
#include "s2gs/image/exif.h"
#include "s2gs/image/image_codec.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scene/io/colmap_database.h"
#include "tests/plugin/commands/split_fixture.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using testing::HasSubstr;
using testing::IsSupersetOf;
using testing::Not;
using testing::Pair;

constexpr const char* kSiftOptions[] = {"max_num_features",    "max_image_size", "first_octave",
                                        "peak_threshold",      "edge_threshold", "estimate_affine_shape",
                                        "domain_size_pooling", "num_threads",    "use_gpu"};

class ExtractFeaturesTest : public testing::Test {
 protected:
  void SetUp() override {
    for (const char* name : {"a.png", "b.png", "c.png"}) AddPhoto(name, 16, 12);
    WriteSplitFixture(folder_ / "made.db", {"c.png", "a.png", "b.png"});
    extraction_.image_path = folder_ / "photos";
    extraction_.database_path = folder_ / "scan/database.db";
    std::filesystem::create_directories(folder_ / "scan");
  }
  void AddPhoto(const std::string& name, int width, int height) const {
    std::filesystem::create_directories((folder_ / "photos" / name).parent_path());
    WriteImage(folder_ / "photos" / name,
               Image8{width, height, 1, std::vector<uint8_t>(static_cast<size_t>(width) * height, 90)});
  }
  // \param cuda    what COLMAP says of itself.
  // \param before  shell commands that come first; they see the value of use_gpu as $gpu.
  void Install(bool cuda, const std::string& before = "") const {
    std::string options =
        "  --database_path arg\n  --image_path arg\n  --ImageReader.camera_model arg\n"
        "  --ImageReader.camera_params arg\n  --ImageReader.single_camera arg\n"
        "  --ImageReader.single_camera_per_folder arg\n";
    for (const char* name : kSiftOptions) options += std::string("  --SiftExtraction.") + name + " arg\n";
    folder_.Write("colmap",
                  "#!/bin/sh\n"
                  "if [ \"$1\" = help ]; then printf '%s\\n' 'COLMAP 3.8 (Commit abc " +
                      std::string(cuda ? "with" : "without") +
                      " CUDA)' 'Available commands:' '  feature_extractor'; exit 0; fi\n"
                      "if [ \"$2\" = -h ]; then cat <<'END'\n" +
                      options + "END\nexit 0; fi\ncd '" + folder_.path().string() +
                      "'\nshift\necho run >> arguments\n"
                      "while [ $# -gt 0 ]; do echo \"$1 $2\" >> arguments\n"
                      "  case $1 in --database_path) db=$2;; *use_gpu) gpu=$2;; esac\n"
                      "  shift 2; done\n" +
                      before + "\ncp made.db \"$db\"\n");
    ::chmod((folder_ / "colmap").c_str(), 0755);
  }
  void Extract() {
    ColmapProgram colmap = ColmapProgram::Find(folder_ / "colmap", reporter_);
    ExtractFeatures(extraction_, &colmap, reporter_);
  }
  // Of the last run.
  std::map<std::string, std::string> Arguments() const {
    std::map<std::string, std::string> arguments;
    std::istringstream lines(folder_.Read("arguments"));
    for (std::string line; std::getline(lines, line);) {
      const size_t space = line.find(' ');
      if (space == std::string::npos) {
        arguments.clear();
      } else {
        arguments[line.substr(0, space)] = line.substr(space + 1);
      }
    }
    return arguments;
  }
  std::vector<std::string> ImageNames() const {
    std::vector<std::string> names;
    for (const DatabaseImage& image :
         ColmapDatabase::Open(extraction_.database_path, ColmapDatabase::Access::kReadOnly).ReadImages())
      names.push_back(image.name);
    return names;
  }

  class Listener : public Reporter {
   public:
    void Log(LogLevel level, std::string_view message) override {
      if (level == LogLevel::kWarning) warnings += std::string(message) + '\n';
    }
    std::string warnings;
  };

  const TemporaryFolder folder_;
  FeatureExtraction extraction_;
  Listener reporter_;
};

TEST_F(ExtractFeaturesTest, OptionsLeftEmptyStayColmapsOwn) {
  Install(/*cuda=*/false);
  Extract();
  const auto arguments = Arguments();
  EXPECT_THAT(arguments, IsSupersetOf({Pair("--image_path", extraction_.image_path.string()),
                                       Pair("--ImageReader.camera_model", std::string("SIMPLE_RADIAL")),
                                       Pair("--ImageReader.single_camera", std::string("1")),
                                       Pair("--ImageReader.single_camera_per_folder", std::string("0")),
                                       Pair("--SiftExtraction.max_num_features", std::string("16384")),
                                       Pair("--SiftExtraction.use_gpu", std::string("0"))}));
  EXPECT_EQ(arguments.size(), 8U);
  EXPECT_EQ(ImageNames(), (std::vector<std::string>{"a.png", "b.png", "c.png"}));  // by ascending id
  EXPECT_FALSE(std::filesystem::exists(extraction_.database_path.string() + ".extracting"));
}

// COLMAP itself takes a thread for each core of the machine.
TEST_F(ExtractFeaturesTest, AThreadForEachCoreThatMayBeUsed) {
  Install(/*cuda=*/false);
  const int before = omp_get_max_threads();
  for (const int cores : {1, 3}) {
    omp_set_num_threads(cores);
    Extract();
    EXPECT_EQ(Arguments().at("--SiftExtraction.num_threads"), std::to_string(cores));
  }
  omp_set_num_threads(before);
}

// Resident memory of COLMAP 3.8 for two threads less that for one, photos of 1,280 x 960.
TEST(FeatureMemory, IsWhatColmapTakes) {
  constexpr struct {
    int first_octave;
    double measured_bytes;
  } kMeasured[] = {{-1, 348.4e6}, {0, 84.4e6}};
  for (const auto& [first_octave, measured] : kMeasured) {
    SiftExtractionOptions options;
    options.first_octave = first_octave;
    const auto stated = static_cast<double>(FeatureMemoryBytes({1280, 960}, options));
    EXPECT_GT(stated, measured);
    EXPECT_LT(stated, 1.15 * measured);
  }
  // COLMAP reduces larger photos to 3,200 px; the photo itself is read as it is.
  const uint64_t reduced = FeatureMemoryBytes({3200, 2400}, {});
  EXPECT_EQ(FeatureMemoryBytes({6400, 4800}, {}), reduced + uint64_t{4} * (6400 * 4800 - 3200 * 2400));
}

TEST_F(ExtractFeaturesTest, OptionsOfTheCommandLineReachColmap) {
  Install(/*cuda=*/true);
  const std::map<std::string, std::string> given = {{"--ImageReader.camera_model", "RADIAL"},
                                                    {"--ImageReader.camera_params", "500,320,240,-0.1,2e-3"},
                                                    {"--SiftExtraction.max_num_features", "1234"},
                                                    {"--SiftExtraction.max_image_size", "2000"},
                                                    {"--SiftExtraction.first_octave", "-1"},
                                                    {"--SiftExtraction.peak_threshold", "0.0125"},
                                                    {"--SiftExtraction.edge_threshold", "7.5"},
                                                    {"--SiftExtraction.estimate_affine_shape", "1"},
                                                    {"--SiftExtraction.domain_size_pooling", "0"},
                                                    {"--SiftExtraction.num_threads", "3"},
                                                    {"--SiftExtraction.use_gpu", "0"}};
  std::vector<std::string> line = {"motion_splitter",      "--log_level",      "error",
                                   "--colmap_path",        folder_ / "colmap", "--image_path",
                                   extraction_.image_path, "--database_path",  extraction_.database_path};
  for (const auto& [name, value] : given) {
    line.push_back(name);
    line.push_back(value);
  }
  testing::internal::CaptureStdout();
  EXPECT_EQ(RunProgram(AllCommands(), line), kExitDone);
  testing::internal::GetCapturedStdout();
  const auto arguments = Arguments();
  for (const auto& [name, value] : given) {
    ASSERT_EQ(arguments.count(name), 1U) << name;
    EXPECT_EQ(arguments.at(name), value) << name;
  }
}

TEST(ImageReaderOptions, ParametersAreThoseOfTheModel) {
  ImageReaderOptions reader;
  EXPECT_FALSE(reader.Check());
  reader.camera_params = "500,320,240,-0.1";
  EXPECT_FALSE(reader.Check());
  for (const char* wrong : {"500", "500,320,240", "500,320,240,0,0", "500 320 240 0", "500,320,240,",
                            "f,320,240,0", "500,320,240,nan", ",500,320,240,0"}) {
    reader.camera_params = wrong;
    const OptionCheck fault = reader.Check();
    ASSERT_TRUE(fault) << wrong;
    EXPECT_EQ(fault->field, "camera_params");
  }
  reader.camera_model = "PINHOLE";
  reader.camera_params = "500,510,320,240";
  EXPECT_FALSE(reader.Check());
  reader.camera_params = "500,320,240";
  EXPECT_THAT(reader.Check()->bound, HasSubstr("fx, fy, cx, cy"));
}

TEST_F(ExtractFeaturesTest, TheProcessorWhereTheGpuFails) {
  Install(/*cuda=*/true, "if [ \"$gpu\" = 1 ]; then echo no device; exit 1; fi");
  Extract();
  EXPECT_EQ(Arguments().at("--SiftExtraction.use_gpu"), "0");
  EXPECT_THAT(reporter_.warnings, HasSubstr("on the GPU failed"));
  extraction_.sift.use_gpu = true;
  ExpectUserError([&] { Extract(); }, {"no device"});
}

TEST_F(ExtractFeaturesTest, PhotosWithoutFeatures) {
  Install(/*cuda=*/false);
  AddPhoto("d.png", 16, 12);
  Extract();
  EXPECT_THAT(reporter_.warnings, HasSubstr("only 3 of the 4 photos"));
  const std::string before = ReadAll(extraction_.database_path);
  WriteSplitFixture(folder_ / "made.db", {});
  ExpectUserError([&] { Extract(); }, {extraction_.image_path.string(), "none of the photos"});
  Install(/*cuda=*/false, "echo broken photo; exit 3");
  ExpectUserError([&] { Extract(); }, {"broken photo", "feature_extractor"});
  EXPECT_EQ(ReadAll(extraction_.database_path), before);
}

TEST_F(ExtractFeaturesTest, OneCameraForWhatIsOfOneSize) {
  EXPECT_EQ(ReadPhotoSet(extraction_.image_path).sharing, CameraSharing::kOne);
  AddPhoto("sub/d.png", 12, 16);
  AddPhoto("sub/e.png", 12, 16);
  EXPECT_EQ(ReadPhotoSet(extraction_.image_path).sharing, CameraSharing::kPerFolder);
  AddPhoto("sub/f.png", 16, 12);
  EXPECT_EQ(ReadPhotoSet(extraction_.image_path).sharing, CameraSharing::kPerLook);
  std::filesystem::create_directories(folder_ / "empty");
  folder_.Write("empty/notes.txt", "no photo");
  ExpectUserError([&] { ReadPhotoSet(folder_ / "empty"); }, {(folder_ / "empty").string(), "no photos"});
  ExpectUserError([&] { ReadPhotoSet(folder_ / "none"); }, {(folder_ / "none").string()});
  folder_.Write("photos/z.jpg", "not a JPEG");
  ExpectUserError([&] { ReadPhotoSet(extraction_.image_path); }, {"z.jpg"});
}

// Photos whose EXIF names another focal length are another camera's; those without go with any.
TEST_F(ExtractFeaturesTest, OneCameraForWhatIsOfOneLens) {
  const auto add = [&](const char* name, double focal_mm) {
    ExifTags tags;
    tags.focal_mm = focal_mm;
    const std::filesystem::path path = folder_ / "photos" / name;
    WriteAll(path,
             EncodePng(Image8{16, 12, 1, std::vector<uint8_t>(size_t{16} * 12, 90)}, path, MakeExif(tags)));
  };
  add("d.png", 35);
  add("e.png", 35);
  EXPECT_EQ(ReadPhotoSet(extraction_.image_path).sharing, CameraSharing::kOne);
  add("f.png", 50);
  EXPECT_NE(ReadPhotoSet(extraction_.image_path).sharing, CameraSharing::kOne);
}

TEST_F(ExtractFeaturesTest, FeaturesFromElsewhereStay) {
  Install(/*cuda=*/false);
  EXPECT_TRUE(NeedsFeatures(extraction_.database_path));
  WriteAll(extraction_.database_path, "");
  EXPECT_TRUE(NeedsFeatures(extraction_.database_path));
  std::filesystem::remove(extraction_.database_path);
  WriteSplitFixture(extraction_.database_path, {"x.png", "y.png", "z.png"});
  EXPECT_FALSE(NeedsFeatures(extraction_.database_path));
  const Workspace workspace{extraction_.database_path.parent_path()};
  const auto run = [&] {
    StageRunner runner(workspace, reporter_);
    RunFeatureStage(extraction_, folder_ / "colmap", {}, workspace, &runner, reporter_);
  };
  run();
  EXPECT_FALSE(std::filesystem::exists(folder_ / "arguments"));
  std::filesystem::remove(extraction_.database_path);
  run();
  EXPECT_TRUE(std::filesystem::exists(folder_ / "arguments"));
  std::filesystem::remove(folder_ / "arguments");
  run();  // done already
  EXPECT_FALSE(std::filesystem::exists(folder_ / "arguments"));
  AddPhoto("e.png", 16, 12);
  run();
  EXPECT_TRUE(std::filesystem::exists(folder_ / "arguments"));
}

}  // namespace
}  // namespace s2gs
