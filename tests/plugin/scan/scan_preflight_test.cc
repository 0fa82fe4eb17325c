#include "plugin/scan/scan_preflight.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <optional>
#include <string>
#include <vector>

#include "plugin/cli/options.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/stage_stamp.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/error.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

class ScanPreflight : public testing::Test {
 protected:
  void SetUp() override {
    for (int i = 0; i < 4; ++i) AddPhoto("photo" + std::to_string(i) + ".png", i);
    InstallColmap("3.8");
    request_.workspace = Workspace{folder_ / "scan"};
    request_.image_path = folder_ / "photos";
    request_.colmap_path = folder_ / "colmap";
    request_.use_gpu = "0";
    request_.steps = {{"gaussian_trainer", {"--workspace_path", "scan"}}};
  }
  void AddPhoto(const std::string& name, int grey) const {
    std::filesystem::create_directories(folder_ / "photos");
    WriteImage(folder_ / "photos" / name,
               Image8{32, 24, 1, std::vector<uint8_t>(32 * 24, static_cast<uint8_t>(grey))});
  }
  void InstallColmap(const std::string& version) const {
    folder_.Write("colmap", "#!/bin/sh\nprintf '%s\\n' 'COLMAP " + version +
                                " (Commit abc without CUDA)' 'Available commands:' '  mapper'\n");
    ::chmod((folder_ / "colmap").c_str(), 0755);
  }
  ScanCheck Check() { return CheckScan(request_, reporter_); }

  const TemporaryFolder folder_;
  ScanRequest request_;
  Reporter reporter_;
};

TEST_F(ScanPreflight, ASoundScanBegins) {
  const ScanCheck check = Check();
  EXPECT_THAT(check.option_faults, IsEmpty());
  EXPECT_THAT(check.faults, IsEmpty());
  EXPECT_NO_THROW(RequireSoundScan(request_, reporter_));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "scan"));
}

TEST_F(ScanPreflight, OptionsAreNamedAsTheyWereGiven) {
  request_.num_iterations = -1;
  request_.test_every = 1;
  request_.max_image_size = 5;
  request_.use_gpu = "yes";
  EXPECT_THAT(Check().option_faults,
              ElementsAre("--num_iterations -1 violates 1 <= num_iterations <= 1000000000",
                          HasSubstr("--max_image_size 5 violates"), HasSubstr("--test_every 1 violates"),
                          "--use_gpu yes is none of auto, 0, 1"));
  EXPECT_THROW(RequireSoundScan(request_, reporter_), CommandLineError);
}

TEST_F(ScanPreflight, OptionsOfAllCommandsAreParsed) {
  request_.steps.push_back({"tsdf_mesher", {"--workspace_path", "scan", "--Tsdf.voxel_size", "-1"}});
  request_.steps.push_back({"gaussian_renderer", {"--workspace_path", "scan", "--nonsense", "1"}});
  EXPECT_THAT(Check().option_faults, ElementsAre(HasSubstr("tsdf_mesher: Tsdf.voxel_size = -1"),
                                                 HasSubstr("gaussian_renderer: unknown option --nonsense")));
}

// Else a length would be refused after the poses.
TEST_F(ScanPreflight, PhotosInWhichPlacesAreStatedAreThere) {
  request_.marked_photos = {{"photo1.png", "point_a"}, {"photo1.heic", "point_b"}};
  EXPECT_THAT(Check().faults,
              ElementsAre(HasSubstr("has no photo \"photo1.heic\", in which --point_b states a place")));
}

TEST_F(ScanPreflight, AllFaultsComeAtOnce) {
  folder_.Write("photos/x.tif", "II*");
  folder_.Write("photos/y.png", "");
  request_.mask_path = folder_ / "none";
  request_.test_every = 1;
  InstallColmap("3.7");
  folder_.Write("scan/masks", "a file where a folder must be");
  try {
    RequireSoundScan(request_, reporter_);
    FAIL();
  } catch (const UserError& error) {
    for (const char* says : {"the scan cannot begin:", "--test_every 1", "x.tif", "y.png: is empty",
                             "no such folder of masks", "colmap is of version 3.7", "masks: is no folder"}) {
      EXPECT_THAT(error.what(), HasSubstr(says));
    }
  }
}

TEST_F(ScanPreflight, EveryPhotoNeedsAMaskOfItsSize) {
  request_.mask_path = folder_ / "masks";
  std::filesystem::create_directories(request_.mask_path);
  const auto add_mask = [&](const std::string& name, int width) {
    WriteImage(request_.mask_path / name,
               Image8{width, 24, 1, std::vector<uint8_t>(static_cast<size_t>(width) * 24, 255)});
  };
  add_mask("photo0.png.png", 32);
  add_mask("photo1.png.png", 31);
  EXPECT_THAT(Check().faults,
              ElementsAre(HasSubstr("31 x 24 pixels, its photo 32 x 24"),
                          AllOf(HasSubstr("2 of 4 photos have no mask there, photo2.png for example"),
                                HasSubstr("sub/a.jpg.mask.png (RealityScan)"), HasSubstr("LichtFeld"))));
  add_mask("photo1.png.png", 32);
  add_mask("photo2.png", 32);  // the shorter name
  add_mask("photo3.png.png", 32);
  EXPECT_THAT(Check().faults, IsEmpty());
}

TEST_F(ScanPreflight, StatedAnglesAreReadBeforeAnythingRuns) {
  request_.angles_path = folder_ / "angles.csv";
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("angles.csv: no such file")));
  folder_.Write("angles.csv", "photo0.png,0\nphoto1.png,x\n");
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("line 2: the angle of photo1.png")));
  folder_.Write("angles.csv", "other.png,0\n");
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("names none of the photos")));
  folder_.Write("angles.csv", "photo0.jpg,0\n");
  EXPECT_THAT(Check().faults, IsEmpty());
  EXPECT_THAT(Check().warnings, IsEmpty());
  folder_.Write("angles.csv", "photo0.png,0\nPhoto1.png,20\nphoto9.png,40\n");
  EXPECT_THAT(Check().faults, IsEmpty());
  EXPECT_THAT(Check().warnings,
              ElementsAre(HasSubstr("angles.csv: 2 names are none of the photos': Photo1.png, for example")));
}

TEST_F(ScanPreflight, CopiesAndFewPhotos) {
  for (int i = 0; i < 4; ++i) AddPhoto("photo" + std::to_string(i) + ".png", 7);
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("its 4 photos are copies of a single one")));
  AddPhoto("photo0.png", 1);
  AddPhoto("photo1.png", 2);
  EXPECT_THAT(Check().faults, IsEmpty());
  EXPECT_THAT(Check().warnings, ElementsAre(HasSubstr("1 of the photos are copies")));
  for (const char* name : {"photo2.png", "photo3.png"}) std::filesystem::remove(folder_ / "photos" / name);
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("2 photos only")));
}

TEST_F(ScanPreflight, AtLeastThreePhotos) {
  std::filesystem::remove(folder_ / "photos/photo3.png");
  EXPECT_THAT(Check().faults, IsEmpty());
  std::filesystem::remove(folder_ / "photos/photo2.png");
  EXPECT_THAT(Check().faults,
              ElementsAre(HasSubstr("photos: has 2 photos only: a scan needs at least 3, and")));
  std::filesystem::remove(folder_ / "photos/photo1.png");
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("photos: has 1 photo only: ")));
  std::filesystem::remove(folder_ / "photos/photo0.png");
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("photos: has no photos (.jpg, .jpeg, .png)")));
}

TEST_F(ScanPreflight, CopiesOfTwoPhotosAreNoScan) {
  for (int i = 0; i < 4; ++i) AddPhoto("photo" + std::to_string(i) + ".png", i % 2);
  EXPECT_THAT(Check().faults, ElementsAre(AllOf(HasSubstr("its 4 photos are copies of two (for example "),
                                                HasSubstr("photo2.png is photo0.png"))));
}

TEST_F(ScanPreflight, ColmapIsOfVersion3Point8OrNewer) {
  for (const auto& [version, is_old] :
       {std::pair("2.9", true), std::pair("3.7", true), std::pair("3.8", false), std::pair("3.10", false),
        std::pair("4.0", false), std::pair("3", true)}) {
    InstallColmap(version);
    const std::vector<std::string> faults = Check().faults;
    EXPECT_EQ(faults.size(), is_old ? 1U : 0U) << version;
    if (is_old) {
      EXPECT_THAT(faults,
                  ElementsAre(HasSubstr(std::string("colmap is of version ") + version + ", and 3.8")));
    }
  }
}

TEST_F(ScanPreflight, StepsThatThisProgramDoesNotHaveAreNamed) {
  request_.steps.push_back({"cake_baker", {}});
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("this program was built without cake_baker")));
}

// Nothing is written through links out of the workspace, wherever results go.
TEST_F(ScanPreflight, LinksOutOfTheWorkspaceAreFound) {
  std::filesystem::create_directories(folder_ / "scan");
  std::filesystem::create_directories(folder_ / "elsewhere");
  for (const char* place :
       {"s2gs", "masks", "dense", "split", "sparse", "report.html", "report.json", "turntable.json"}) {
    std::filesystem::create_symlink(folder_ / "elsewhere", folder_ / "scan" / place);
    EXPECT_THAT(Check().faults, Contains(AllOf(HasSubstr(place), HasSubstr("is a symbolic link out of"))))
        << place;
    std::filesystem::remove(folder_ / "scan" / place);
  }
  EXPECT_THAT(Check().faults, IsEmpty());
}

// Where every stage is done nothing will be written, and where one is not, something will.
TEST_F(ScanPreflight, LinksDoNotMatterOnceEverythingIsDone) {
  const std::vector<std::string> stages = {"feature_extractor", "motion_splitter",   "turntable_mapper",
                                           "gaussian_trainer",  "gaussian_renderer", "tsdf_mesher",
                                           "mesh_texturer"};
  std::filesystem::create_directories(folder_ / "scan");
  std::filesystem::create_directories(folder_ / "elsewhere");
  {
    StageRunner runner(request_.workspace, reporter_);
    for (const std::string& name : stages) runner.Run({name, {}, {}, {}, {}}, [] {});
  }
  std::filesystem::create_symlink(folder_ / "elsewhere", folder_ / "scan/dense");
  EXPECT_THAT(Check().faults, IsEmpty());
  for (const std::string& name : stages) {
    const std::optional<StageStamp> stamp = ReadStageStamp(request_.workspace, name, reporter_);
    ASSERT_TRUE(stamp) << name;
    RemoveStageStamp(request_.workspace, name);
    EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("is a symbolic link out of"))) << name;
    WriteStageStamp(request_.workspace, name, *stamp);
  }
  // What is not asked for need not be done.
  for (const char* name : {"gaussian_renderer", "tsdf_mesher", "mesh_texturer"})
    RemoveStageStamp(request_.workspace, name);
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("is a symbolic link out of")));
  request_.meshes = request_.textures = false;
  EXPECT_THAT(Check().faults, IsEmpty());
}

// Photos that were cut out are their own masks, each of them.
TEST_F(ScanPreflight, PhotosAsTheirOwnMasksNeedAnAlphaChannel) {
  request_.mask_path = request_.image_path;
  const auto cut_out = [&](int i) {
    Image8 image{32, 24, 4, std::vector<uint8_t>(32 * 24 * 4, static_cast<uint8_t>(10 + i))};
    WriteImage(folder_ / "photos" / ("photo" + std::to_string(i) + ".png"), image);
  };
  for (int i = 0; i < 4; ++i) {
    EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("holds the photos, and photo" + std::to_string(i) +
                                                      ".png has no alpha channel")));
    cut_out(i);
  }
  EXPECT_THAT(Check().faults, IsEmpty());
}

// Photos that are imported, as far as their headers tell.
class ScanOfImportedPhotos : public ScanPreflight {
 protected:
  void SetUp() override {
    ScanPreflight::SetUp();
    request_.import = ImportPlan();
    for (int i = 0; i < 3; ++i) {
      PhotoToImport photo;
      photo.file.name = "raw" + std::to_string(i) + ".tif";
      photo.file.path = folder_ / "photos" / photo.file.name;
      photo.file.size = {1'000'000, 1'000'000};
      photo.file.num_bytes = 1000 + static_cast<uint64_t>(i);
      photo.name = "raw" + std::to_string(i) + ".png";
      photo.is_foreign = true;
      request_.import->photos.push_back(photo);
    }
    request_.trains = request_.meshes = request_.textures = false;
  }
  void SetSize(int width, int height) {
    for (PhotoToImport& photo : request_.import->photos) photo.file.size = {width, height};
  }
};

// A million pixels a side: 48 TB of maps, 12 TB in training at that size, 7 TB to decode one.
TEST_F(ScanOfImportedPhotos, WhatCannotFitIsRefused) {
  const std::string decoding = "the largest photo needs about 7000.0 GB of memory while it is read";
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr(decoding)));
  request_.meshes = true;
  EXPECT_THAT(Check().faults,
              ElementsAre(HasSubstr("about 48000.0 GB are needed on that disk"), HasSubstr(decoding)));
  request_.meshes = false;
  request_.trains = true;
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr(decoding)));
  request_.max_image_size = 1'000'000;
  EXPECT_THAT(
      Check().faults,
      ElementsAre(HasSubstr(decoding), HasSubstr("the photos need about 12000.0 GB of memory in training")));
  request_.max_image_size = 500'000;
  EXPECT_THAT(
      Check().faults,
      ElementsAre(HasSubstr(decoding), HasSubstr("the photos need about 3000.0 GB of memory in training")));
  SetSize(32, 24);
  EXPECT_THAT(Check().faults, IsEmpty());
  SetSize(0, 0);  // unknown
  EXPECT_THAT(Check().faults, IsEmpty());
}

// 8,192 features of 152 bytes of each photo that has room for them, one on 80 pixels.
TEST_F(ScanOfImportedPhotos, FeaturesNeedFilesThatMayBeWritten) {
  rlimit before = {};
  ASSERT_EQ(::getrlimit(RLIMIT_FSIZE, &before), 0);
  const auto faults_with = [&](rlim_t bytes) {
    rlimit limit = before;
    limit.rlim_cur = bytes;
    ::setrlimit(RLIMIT_FSIZE, &limit);
    const std::vector<std::string> faults = Check().faults;
    ::setrlimit(RLIMIT_FSIZE, &before);
    return faults;
  };
  SetSize(1000, 1000);
  constexpr rlim_t kAll = 3 * 8192 * 152;
  EXPECT_THAT(
      faults_with(kAll - 1),
      ElementsAre(HasSubstr("files may have 4 MB at most here (`ulimit -f`), the photos' features need "
                            "about 4 MB")));
  EXPECT_THAT(faults_with(kAll), IsEmpty());
  SetSize(400, 400);  // 2,000 features each
  EXPECT_THAT(faults_with(3 * 2000 * 152 - 1), ElementsAre(HasSubstr("files may have 1 MB at most")));
  EXPECT_THAT(faults_with(3 * 2000 * 152), IsEmpty());
}

TEST_F(ScanOfImportedPhotos, MirroredPhotosHaveNoMasksBeside) {
  SetSize(32, 24);
  request_.mask_path = folder_ / "masks";
  std::filesystem::create_directories(request_.mask_path);
  for (int i = 0; i < 3; ++i) {
    WriteImage(request_.mask_path / ("raw" + std::to_string(i) + ".png.png"),
               Image8{32, 24, 1, std::vector<uint8_t>(32 * 24, 255)});
  }
  EXPECT_THAT(Check().faults, IsEmpty());
  request_.import->photos[1].is_mirrored = true;
  EXPECT_THAT(Check().faults,
              ElementsAre(HasSubstr("raw1.tif: is mirrored by its EXIF, and its mask would not fit")));
  // Their own alpha channel is mirrored along.
  request_.mask_path = request_.image_path;
  EXPECT_THAT(Check().faults, IsEmpty());
  request_.import->photos[2].is_foreign = false;
  EXPECT_THAT(Check().faults, ElementsAre(HasSubstr("raw2.png has no alpha channel")));
}

TEST_F(ScanPreflight, WorkspaceAndPhotosStayApart) {
  request_.workspace = Workspace{folder_ / "photos/scan"};
  EXPECT_THAT(Check().faults, Contains(HasSubstr("lies in the photos' folder")));
  request_.workspace = Workspace{folder_ / "scan"};
  std::filesystem::create_directories(folder_ / "scan");
  std::filesystem::rename(folder_ / "photos", folder_ / "scan/masks");
  request_.image_path = folder_ / "scan/masks";
  EXPECT_THAT(Check().faults, Contains(HasSubstr("where results are written")));
  // images in the workspace is where photos belong.
  std::filesystem::rename(folder_ / "scan/masks", folder_ / "scan/images");
  request_.image_path = folder_ / "scan/images";
  EXPECT_THAT(Check().faults, IsEmpty());
}

}  // namespace
}  // namespace s2gs
