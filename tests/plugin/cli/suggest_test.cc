#include "plugin/cli/suggest.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <string>

namespace s2gs {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

TEST(EditDistance, CountsEdits) {
  EXPECT_EQ(EditDistance("", ""), 0);
  EXPECT_EQ(EditDistance("", "abc"), 3);
  EXPECT_EQ(EditDistance("abc", ""), 3);
  EXPECT_EQ(EditDistance("kitten", "sitting"), 3);
  EXPECT_EQ(EditDistance("voxel", "voxle"), 1);  // a swap
  EXPECT_EQ(EditDistance("ca", "abc"), 3);       // no edits inside a swapped pair
}

TEST(NearestWords, FindsTheMeantWord) {
  const std::vector<std::string> words = {"workspace_path", "image_path", "quality", "Tsdf.voxel_size",
                                          "Tsdf.truncation"};
  EXPECT_THAT(NearestWords("workspce_path", words), ElementsAre("workspace_path"));
  EXPECT_THAT(NearestWords("WorkSpace-Path", words), ElementsAre("workspace_path"));
  EXPECT_THAT(NearestWords("tsdf.voxelsize", words), ElementsAre("Tsdf.voxel_size"));
  EXPECT_THAT(NearestWords("qua", words), ElementsAre("quality"));  // abbreviated
  EXPECT_THAT(NearestWords("banana", words), IsEmpty());
  EXPECT_THAT(NearestWords("", words), IsEmpty());
  EXPECT_THAT(NearestWords(std::string(100000, 'x'), words), IsEmpty());
}

TEST(NearestWords, BestFirstAndFew) {
  const std::vector<std::string> words = {"max_error", "max_errors", "max_err", "min_error", "max_terror"};
  EXPECT_THAT(NearestWords("max_error", words, 2), ElementsAre("max_error", "max_errors"));
  EXPECT_EQ(NearestWords("max_erorr", words).size(), 3U);
}

}  // namespace
}  // namespace s2gs
