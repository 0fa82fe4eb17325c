#include "plugin/stage/angle_list.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/error.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using testing::ElementsAre;
using testing::Pair;

std::map<std::string, double> Read(const std::string& text) { return ParseAngleList(text, "angles.csv"); }

TEST(AngleList, HeadingsCommentsAndSeparators) {
  EXPECT_THAT(
      Read("photo,angle\r\n# turn 1; the\tfirst\r\nsub/a.jpg, 0\r\nb.jpg,18.5\n\n\"c, d.jpg\",\"-1e1\"\n"
           "\"e; f.png\" , \"7\"\ni, j.jpg,8\n\"k.jpg,9\""),
      ElementsAre(Pair("b.jpg", 18.5), Pair("c, d.jpg", -10), Pair("e; f.png", 7), Pair("i, j.jpg", 8),
                  Pair("k.jpg", 9), Pair("sub/a.jpg", 0)));
  EXPECT_THAT(Read("photo;angle\n\"a; \"\"b\"\", c\";0\nd, e.jpg; 18.5\n"),
              ElementsAre(Pair("a; \"\"b\"\", c", 0), Pair("d, e.jpg", 18.5)));
  EXPECT_THAT(Read("a; b.jpg\t0\nc, d.jpg\t18.5\t\n"),
              ElementsAre(Pair("a; b.jpg", 0), Pair("c, d.jpg", 18.5)));
}

// As spreadsheets write where numbers have decimal commas. An angle of 5 for 7.5 degrees would be a silent
// fault.
TEST(AngleList, DecimalCommasAreNamed) {
  ExpectUserError([] { Read("IMG_2.jpg;7,5\n"); },
                  {"angles.csv", "line 1: the angle of IMG_2.jpg has a decimal comma. Write 7.5"});
  ExpectUserError([] { Read("photo;angle\nIMG_1.jpg;0\nIMG_2.jpg;-7,25\n"); },
                  {"line 3: the angle of IMG_2.jpg", "Write -7.25"});
  ExpectUserError([] { Read("IMG_1.jpg\t0\nIMG_2.jpg\t7,5\n"); }, {"line 2", "decimal comma", "Write 7.5"});
  ExpectUserError([] { Read("IMG_1.jpg,0\nIMG_2.jpg,\"7,5\"\n"); }, {"line 2", "decimal comma", "Write 7.5"});
}

TEST(AngleList, AByteOrderMarkIsNoPartOfTheFirstName) {
  EXPECT_THAT(Read("\xEF\xBB\xBF"
                   "IMG_1.jpg;0\nIMG_2.jpg;18.5\n"),
              ElementsAre(Pair("IMG_1.jpg", 0), Pair("IMG_2.jpg", 18.5)));
  EXPECT_THAT(Read("\xEF\xBB\xBF# turn 1\nIMG_1.jpg,0\n"), ElementsAre(Pair("IMG_1.jpg", 0)));
}

TEST(AngleList, FaultsNameTheirLine) {
  ExpectUserError([] { Read("a.jpg,0\nb.jpg,x\n"); }, {"angles.csv", "line 2", "b.jpg"});
  ExpectUserError([] { Read("a.jpg,0\na.jpg,1\n"); }, {"line 2", "twice"});
  ExpectUserError([] { Read("a.jpg,0\n../b.jpg,1\n"); }, {"line 2"});
  ExpectUserError([] { Read("a.jpg 0\n"); }, {"line 1", "comma"});
  ExpectUserError([] { Read("a.jpg;0\nb.jpg,1\n"); }, {"line 2", "has no semicolon"});
  ExpectUserError([] { Read("a.jpg,0\nb.jpg;1\nc.jpg\t2\n"); }, {"line 1", "has no tab"});
  ExpectUserError([] { Read("a.jpg,nan\nb.jpg,inf\n"); }, {"line 2"});
  ExpectUserError([] { Read(""); }, {"lists no angles"});
}

// As the firmware of OpenScan3 writes them: PROJECT/scan01/scan01_001.jpg and
// PROJECT/scan01/metadata/scan01_001.json.
TEST(AngleList, OpenScansFoldersAreRead) {
  const TemporaryFolder folder;
  const auto photo = [&](const std::string& name, const std::string& angle) {
    folder.Write(name, R"({"camera_metadata": {"camera_name": "imx519"}, "scan_metadata": {"step": 1,
      "polar_coordinates": {"theta": 62.5, "fi": )" +
                           angle + R"(, "r": 1.0}, "scan_index": 1}})");
  };
  photo("scan01/metadata/scan01_001.json", "0.0");
  photo("scan01/metadata/scan01_002.json", "137.5");
  photo("scan02/metadata/scan02_001.json", "22");
  folder.Write("scan01/scan.json", "{}");
  folder.Write("openscan_project.json", "{}");
  EXPECT_THAT(ReadAngleList(folder.path()),
              ElementsAre(Pair("scan01/scan01_001", 0), Pair("scan01/scan01_002", 137.5),
                          Pair("scan02/scan02_001", 22)));
  const std::map<std::string, double> scan = ReadAngleList(folder / "scan01");
  EXPECT_THAT(scan, ElementsAre(Pair("scan01_001", 0), Pair("scan01_002", 137.5)));
  std::vector<std::string> unknown;
  EXPECT_THAT(
      AnglesOfPhotos(scan, {"scan01_001.jpg", "scan01_002.jpg", "scan01_003.jpg"}, folder.path(), &unknown),
      ElementsAre(Pair("scan01_001.jpg", 0), Pair("scan01_002.jpg", 137.5)));
  EXPECT_TRUE(unknown.empty());

  photo("scan02/metadata/scan02_002.json", "\"many\"");
  ExpectUserError([&] { ReadAngleList(folder.path()); }, {"scan02_002.json", "polar_coordinates.fi"});
  photo("scan02/metadata/scan02_002.json", "1e300");
  ExpectUserError([&] { ReadAngleList(folder.path()); }, {"scan02_002.json"});
  folder.Write("scan02/metadata/scan02_002.json", "{\"scan_metadata\": [");
  ExpectUserError([&] { ReadAngleList(folder.path()); }, {"scan02_002.json"});
  ExpectUserError([&] { ReadAngleList(folder / "scan01/metadata"); }, {"holds no metadata"});
}

TEST(AngleList, AFileThatIsNoListIsNotTakenIntoMemory) {
  const TemporaryFolder folder;
  folder.Write("angles.csv", "");
  std::filesystem::resize_file(folder / "angles.csv", uint64_t{1} << 40U);  // takes no room on the disk
  ExpectUserError([&] { ReadAngleList(folder / "angles.csv"); },
                  {"angles.csv", "bytes long", "--angles_path"});
}

TEST(AngleList, PhotosThatWereImportedHaveAnotherExtension) {
  std::vector<std::string> unknown;
  const auto angles = AnglesOfPhotos({{"a.heic", 1}, {"b.jpg", 2}, {"c.tif", 3}, {"x.jpg", 4}},
                                     {"a.png", "b.jpg", "b.png", "c.png", "c.jpg"}, "angles.csv", &unknown);
  EXPECT_THAT(angles, ElementsAre(Pair("a.png", 1), Pair("b.jpg", 2)));
  EXPECT_THAT(unknown, ElementsAre("c.tif", "x.jpg"));
  EXPECT_THROW(AnglesOfPhotos({{"x.jpg", 1}}, {"a.jpg"}, "angles.csv", &unknown), UserError);
}

TEST(AngleListBadInput, AnyDamageIsReadOrNamed) {
  ForEachDamage("name,angle\na.jpg,0\nb.jpg,18.25\n",
                [](const std::string& damaged, const std::string& what) {
                  ExpectOkOrUserError([&] { Read(damaged); }, "angles.csv", what);
                });
}

}  // namespace
}  // namespace s2gs
