#include "plugin/colmap/body_mapper.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/scene/io/colmap_database.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "tests/support/bad_input.h"
#include "tests/support/model_without_points.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

class BodyMapper : public ::testing::Test {
 protected:
  // A script in place of COLMAP, whose mapper finds what lies in `found`, whatever its settings.
  ColmapProgram Program() {
    WriteAll(folder_ / "colmap",
             "#!/bin/sh\n"
             "if [ \"$1\" = help ]; then\n"
             "  printf '%s\\n' 'COLMAP 3.8 (Commit abc on 2026-01-01)' 'Available commands:' '  mapper'\n"
             "  exit 0\nfi\n"
             "if [ \"$2\" = -h ]; then\n"
             "  for name in database_path image_path output_path Mapper.extract_colors Mapper.num_threads "
             "Mapper.min_model_size Mapper.init_min_tri_angle Mapper.init_min_num_inliers "
             "Mapper.abs_pose_min_num_inliers Mapper.abs_pose_min_inlier_ratio Mapper.filter_min_tri_angle "
             "Mapper.min_num_matches Mapper.init_max_reg_trials; do\n"
             "    echo \"  --$name arg\" >&2\n  done\n  exit 0\nfi\n"
             "while [ $# -gt 0 ]; do [ \"$1\" = --output_path ] && out=$2; shift; done\n"
             "cp -r '" +
                 (folder_ / "found").string() + "/.' \"$out\"\n");
    ::chmod((folder_ / "colmap").c_str(), 0755);
    return ColmapProgram::Find(folder_ / "colmap", reporter_);
  }
  std::vector<MappingAttempt> Map(BodyMapping mapping, int num_images) {
    mapping.database = folder_ / "database.db";
    if (!fs::exists(mapping.database)) ColmapDatabase::Create(mapping.database);
    mapping.images = folder_.path();
    mapping.output = folder_ / "models";
    mapping.num_images = num_images;
    ColmapProgram program = Program();
    return MapBody(mapping, &program, reporter_);
  }

  TemporaryFolder folder_;
  Reporter reporter_;
};

TEST_F(BodyMapper, ModelsAreReadLargestFirstWithoutDamagedOnes) {
  for (const auto& [name, num_images] : {std::pair("0", 3), std::pair("1", 7), std::pair("2", 5)})
    WriteColmapModel(folder_ / "found" / name, ModelWithoutPoints(num_images), ColmapFormat::kBinary);
  fs::create_directories(folder_ / "found" / "3");
  WriteAll(folder_ / "found" / "notes.txt", "no model");
  std::vector<size_t> sizes;
  for (const ColmapModel& model : ReadMappedModels(folder_ / "found", reporter_))
    sizes.push_back(model.images.size());
  EXPECT_THAT(sizes, ::testing::ElementsAre(7, 5, 3));
  EXPECT_TRUE(ReadMappedModels(folder_ / "none", reporter_).empty());
}

// Of ten photos the object's mapper is content with five, the background's with nine: other settings follow
// only below.
TEST_F(BodyMapper, TriesOtherSettingsWhileTooFewPhotosAreRegistered) {
  for (const auto& [mapping, enough] : {std::pair(ObjectMapping(), 5), std::pair(BackgroundMapping(), 9)}) {
    for (const int num_found : {enough - 1, enough}) {
      fs::remove_all(folder_ / "found");
      WriteColmapModel(folder_ / "found" / "0", ModelWithoutPoints(num_found), ColmapFormat::kBinary);
      const std::vector<MappingAttempt> attempts = Map(mapping, 10);
      EXPECT_EQ(attempts.size(), num_found < enough ? 3U : 1U) << mapping.body << num_found;
      ASSERT_FALSE(attempts.empty());
      EXPECT_EQ(attempts[0].images, num_found);
      EXPECT_EQ(ReadMappedModels(folder_ / "models", reporter_).size(), 1U);
    }
  }
}

}  // namespace
}  // namespace s2gs
