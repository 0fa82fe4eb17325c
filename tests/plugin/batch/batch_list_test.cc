#include "plugin/batch/batch_list.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <stdexcept>
#include <string>
#include <vector>

#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

class BatchList : public ::testing::Test {
 protected:
  BatchList() {
    for (const char* name : {"a", "b c", "d,e"}) fs::create_directories(folder_ / name);
  }
  std::vector<BatchObject> Parse(const std::string& text) const {
    return ParseBatchList(text, "objects.csv", folder_.path(), [](const std::vector<std::string>& line) {
      if (line.back() == "--bad") throw std::runtime_error("unknown option --bad.");
    });
  }
  TemporaryFolder folder_;
};

TEST_F(BatchList, ReadsRowsAsSpreadsheetsWriteThem) {
  const std::vector<BatchObject> objects = Parse(
      "\xEF\xBB\xBFworkspace,images,options\r\n"
      "# the first shelf\r\n"
      "w1,a,--quality low --force 1\r\n"
      "\r\n"
      "w2,b c,\r\n"
      "\"w3, \"\"new\"\"\" , \"d,e\" ,\"--mask_path 'my masks'\"\r\n"
      "/w4,a");
  ASSERT_EQ(objects.size(), 4U);
  for (const BatchObject& object : objects) EXPECT_EQ(object.fault, "") << object.line;
  EXPECT_EQ(objects[0].line, 3);
  EXPECT_EQ(objects[0].images, folder_ / "a");
  EXPECT_EQ(objects[0].workspace, folder_ / "w1");
  EXPECT_THAT(objects[0].options, ElementsAre("--quality", "low", "--force", "1"));
  EXPECT_EQ(objects[1].line, 5);
  EXPECT_EQ(objects[1].images, folder_ / "b c");
  EXPECT_THAT(objects[1].options, ElementsAre());
  EXPECT_EQ(objects[2].workspace, folder_ / "w3, \"new\"");
  EXPECT_EQ(objects[2].images, folder_ / "d,e");
  EXPECT_THAT(objects[2].options, ElementsAre("--mask_path", "my masks"));
  EXPECT_EQ(objects[3].workspace, "/w4");
  EXPECT_THAT(ScanLine(objects[0]),
              ElementsAre("--workspace_path", (folder_ / "w1").string(), "--image_path",
                          (folder_ / "a").string(), "--quality", "low", "--force", "1"));
}

TEST_F(BatchList, AnObjectMayBeAVideo) {
  folder_.Write("turn.mp4", "");
  const std::vector<BatchObject> objects = Parse("images,workspace,options\nturn.mp4,w1,--video_frames 40\n");
  ASSERT_EQ(objects.size(), 1U);
  EXPECT_EQ(objects[0].fault, "");
  EXPECT_EQ(objects[0].images, folder_ / "turn.mp4");
}

TEST_F(BatchList, TakesSemicolonsAndTabs) {
  EXPECT_EQ(Parse("images;workspace\na;w1\n")[0].workspace, folder_ / "w1");
  EXPECT_EQ(Parse("images\tworkspace\nd,e\tw1\n")[0].images, folder_ / "d,e");
}

TEST_F(BatchList, NamesWrongRowsAndKeepsTheOthers) {
  const std::vector<BatchObject> objects = Parse(
      "images,workspace,options\n"
      "a,w1,\n"
      "nothing here,w2,\n"
      "a,w3,--bad\n"
      "a,w4,\"--quality low\n"
      "a,w5,--quality 'low\n"
      "a\n"
      ",w6\n"
      "a,w7,--a 1,--b 2\n"
      "a,\"w8\"x,\n"
      "b c,./w1/../w1/,\n"
      "b c,w1/inner,\n"
      "b c,.,\n"
      "b c,w9,\n");
  const std::vector<std::string> faults = {
      "",
      "nothing here: there is no such folder of photos, and no such video",
      "unknown option --bad.",
      "a quote is not closed, or something follows it",
      "a quote in its options is not closed",
      "does not say which workspace",
      "does not say which folder of images",
      "it has 4 cells, and there are 3 columns",
      "a quote is not closed, or something follows it",
      "the workspace is also that of line 2",
      "the workspace lies in that of line 2",
      "the workspace holds that of line 2",
      ""};
  ASSERT_EQ(objects.size(), faults.size());
  for (size_t i = 0; i < faults.size(); ++i) {
    EXPECT_EQ(objects[i].line, static_cast<int>(i) + 2);
    if (faults[i].empty()) {
      EXPECT_EQ(objects[i].fault, "") << i;
    } else {
      EXPECT_THAT(objects[i].fault, HasSubstr(faults[i]));
    }
  }
}

TEST_F(BatchList, ALinkToAWorkspaceIsThatWorkspace) {
  fs::create_directories(folder_ / "w1");
  fs::create_directory_symlink(folder_ / "w1", folder_ / "link");
  EXPECT_THAT(Parse("images,workspace\na,w1\na,link\n")[1].fault, HasSubstr("is also that of line 2"));
}

TEST_F(BatchList, AWorkspaceDoesNotLieAmongPhotos) {
  fs::create_directories(folder_ / "a/b");
  const auto objects = Parse("images,workspace\na,w1\na/b,a/b2/w2\na/b,a/b/w3\na,w4\n");
  EXPECT_EQ(objects[0].fault, "");
  EXPECT_THAT(objects[1].fault, HasSubstr("a/b2/w2: the workspace lies among the photos of line 2"));
  EXPECT_THAT(objects[2].fault, HasSubstr("lies among the photos of line 3"));
  EXPECT_EQ(objects[3].fault, "") << "photos may be scanned twice";
}

TEST_F(BatchList, RefusesListsWithoutColumnsOrRows) {
  for (const std::string text : {"", "\n\n", "images,workspace\n", "images,options\na,b\n", "a,w1\n",
                                 "images,workspace,images\na,w1,a\n", "\"images,workspace\na,w1\n"}) {
    ExpectUserError([&] { Parse(text); }, {"objects.csv", "images,workspace,options"}, text);
  }
  ExpectUserError([&] { ReadBatchList(folder_ / "missing.csv", [](const auto&) {}); }, {"missing.csv"});
}

TEST(BatchListBadInput, DamagedLists) {
  const TemporaryFolder folder;
  int num_read = 0;
  ForEachDamage("images,workspace,options\n\"a\",w1,\"--x 'y z' \\\\\"\nb;w2\n",
                [&](const std::string& damaged, const std::string& description) {
                  num_read += ExpectOkOrUserError(
                      [&] { ParseBatchList(damaged, "objects.csv", folder.path(), [](const auto&) {}); },
                      "objects.csv", description);
                });
  EXPECT_GT(num_read, 100);  // most damage is in one row, and leaves the list a list
}

}  // namespace
}  // namespace s2gs
