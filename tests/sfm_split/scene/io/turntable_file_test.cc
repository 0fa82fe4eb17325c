#include "sfm_split/scene/io/turntable_file.h"

#include <gtest/gtest.h>

#include <cmath>
#include <sstream>

#include "sfm_split/base/error.h"
#include "tests/sfm_split/scene/io/turntable_example.h"
#include "tests/support/bad_input.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

constexpr char kFixture[] = R"({"version": 1,
  "axis": {"point": [0.5, -1, 2e-3], "direction": [0, 0, 1]},
  "stations": 2, "scale_observable": true, "units": "metre", "some later key": [1, 2],
  "images": [
    {"name": "a b.jpg", "station": 0, "angle_deg": 0,
     "object_to_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
    {"name": "sub/c.jpg", "station": 1, "angle_deg": 90.0,
     "object_to_world": [[0, -1, 0, 1.25], [1, 0, 0, -2], [0, 0, 1, 3], [0, 0, 0, 1]]}]})";

TurntableFile ReadText(const std::string& text) {
  std::istringstream stream(text);
  return ReadTurntableFile(stream, "w/turntable.json");
}

std::string Replaced(std::string text, const std::string& what, const std::string& with) {
  const size_t at = text.find(what);
  EXPECT_NE(at, std::string::npos) << what;
  return text.replace(at, what.size(), with);
}

TEST(TurntableFile, ReadsTheDocumentedForm) {
  const TurntableFile file = ReadText(kFixture);
  EXPECT_EQ(file.axis.point, Eigen::Vector3d(0.5, -1, 2e-3));
  EXPECT_EQ(file.axis.direction, Eigen::Vector3d::UnitZ());
  EXPECT_EQ(file.num_stations, 2);
  EXPECT_TRUE(file.scale_observable);
  EXPECT_EQ(file.units, LengthUnit::kMetre);
  ASSERT_EQ(file.images.size(), 2u);
  EXPECT_EQ(file.images[0].name, "a b.jpg");
  EXPECT_EQ(file.images[1].name, "sub/c.jpg");
  EXPECT_EQ(file.images[1].station, 1);
  EXPECT_EQ(file.images[1].angle_deg, 90);
  const Rigid3& world_from_object = file.images[1].world_from_object;
  EXPECT_LT((world_from_object * Eigen::Vector3d(1, 0, 0) - Eigen::Vector3d(1.25, -1, 3)).norm(), 1e-15);
}

TEST(TurntableFile, RoundTripKeepsEveryDigit) {
  const TemporaryFolder folder;
  const TurntableFile file = ExampleTurntable();
  WriteTurntableFile(folder / "turntable.json", file);
  const TurntableFile read = ReadTurntableFile(folder / "turntable.json");
  EXPECT_EQ(read.axis.point, file.axis.point);
  EXPECT_EQ(read.axis.direction, file.axis.direction);
  EXPECT_EQ(read.num_stations, file.num_stations);
  EXPECT_EQ(read.scale_observable, file.scale_observable);
  EXPECT_EQ(read.units, file.units);
  ASSERT_EQ(read.images.size(), file.images.size());
  for (size_t i = 0; i < file.images.size(); ++i) {
    EXPECT_EQ(read.images[i].name, file.images[i].name);
    EXPECT_EQ(read.images[i].station, file.images[i].station);
    EXPECT_EQ(read.images[i].angle_deg, file.images[i].angle_deg);
    EXPECT_EQ(read.images[i].world_from_object.translation, file.images[i].world_from_object.translation);
    // The file holds matrices: a rotation comes back to rounding. Measured: 2e-16.
    EXPECT_LT(
        read.images[i].world_from_object.rotation.angularDistance(file.images[i].world_from_object.rotation),
        1e-15);
  }
}

TEST(TurntableFile, KnowsBetweenWhichStationsAnglesCompare) {
  const std::string images = R"("images": [)";
  TurntableFile file = ReadText(kFixture);
  EXPECT_TRUE(file.tied_stations.empty());
  EXPECT_EQ(DescribeUntiedStations(file.tied_stations), "");
  EXPECT_EQ(DescribeUntiedStations({{0, 1}}), "");
  file = ReadText(Replaced(kFixture, images, R"("tied_stations": [[0], [1]], )" + images));
  EXPECT_EQ(file.tied_stations, (std::vector<std::vector<int>>{{0}, {1}}));
  EXPECT_EQ(DescribeUntiedStations(file.tied_stations),
            "table angles are known within, not between, 2 sets of stations (0 | 1): nothing that stands "
            "still is seen from both");
  EXPECT_NE(DescribeUntiedStations(std::vector<std::vector<int>>(7, {0})).find("7 sets"), std::string::npos);
  const TemporaryFolder folder;
  WriteTurntableFile(folder / "turntable.json", file);
  EXPECT_EQ(ReadTurntableFile(folder / "turntable.json").tied_stations, file.tied_stations);
  file.tied_stations.pop_back();
  ExpectUserError([&] { WriteTurntableFile(folder / "turntable.json", file); },
                  {"tied_stations lacks a station"}, "one set only");
}

TEST(TurntableFile, SingleSamples) {
  // Single precision is mended.
  const TurntableFile file = ReadText(Replaced(kFixture, "[0, 0, 1]}", "[0, 0.0000001, 1.0000001]}"));
  EXPECT_NEAR(file.axis.direction.norm(), 1, 1e-15);
  EXPECT_EQ(ReadText(Replaced(kFixture, "metre", "sfm")).units, LengthUnit::kSfm);
}

TEST(TurntableFile, FaultsAreNamed) {
  struct Fault {
    std::string what, with, place;
  };
  for (const Fault& fault : std::vector<Fault>{
           {R"("version": 1)", R"("version": 2)", "version is 2"},
           {R"("version": 1,)", "", "version is missing"},
           {R"("version": 1)", R"("version": "1")", "version is not a whole number"},
           {R"("version": 1)", R"("version": 18446744073709551615)", "version is not a whole number"},
           {R"("point": [0.5, -1, 2e-3])", R"("point": [0.5, -1])", "axis.point has 2 items"},
           {R"("point": [0.5, -1, 2e-3])", R"("point": [0.5, null, 1])", "axis.point[1] is not a number"},
           {R"("point": [0.5, -1, 2e-3])", R"("point": [0.5, 1e999, 1])", "not JSON"},
           {R"([0, 0, 1]})", R"([0, 0, 2]})", "axis.direction is not of unit length"},
           {R"([0, 0, 1]})", R"([0, 0, 0]})", "axis.direction is not of unit length"},
           {R"("stations": 2)", R"("stations": 0)", "stations is not a whole number from 1"},
           {R"("stations": 2)", R"("stations": 1)", "images[1].station is not a whole number from 0 to 0"},
           {R"("stations": 2)", R"("stations": 2.5)", "stations is not a whole number"},
           {R"("scale_observable": true)", R"("scale_observable": 1)",
            "scale_observable is not true or false"},
           {"metre", "inch", "units is neither"},
           {R"("images": [)", R"("tied_stations": [[0], [1, 0]], "images": [)",
            "tied_stations[1][1] occurs twice"},
           {R"("images": [)", R"("tied_stations": [[0]], "images": [)", "tied_stations lacks a station"},
           {R"("images": [)", R"("tied_stations": [0, 1], "images": [)", "tied_stations[0] is not a list"},
           {R"("images": [)", R"("tied_stations": [[0, 2]], "images": [)",
            "tied_stations[0][1] is not a whole number from 0 to 1"},
           {R"("images": [)", R"("images": {}, "x": [)", "images is not a list"},
           {R"("images": [)", R"("images": [7, )", "images[0] is not an object"},
           {"sub/c.jpg", "a b.jpg", "images[1].name occurs twice: a b.jpg"},
           {"sub/c.jpg", "", "images[1].name is no image's name"},
           {R"("station": 1)", R"("station": -1)", "images[1].station"},
           {"90.0", "\"90\"", "images[1].angle_deg is not a number"},
           {"[0, -1, 0, 1.25]", "[0, -1.001, 0, 1.25]",
            "images[1].object_to_world is not rigid: its rotation"},
           {"[0, -1, 0, 1.25]", "[0, 1, 0, 1.25]", "images[1].object_to_world is not rigid: it mirrors"},
           {"[0, 0, 1, 3], [0, 0, 0, 1]", "[0, 0, 1, 3], [0, 0, 0.1, 1]", "its last row"},
           {"[0, 0, 1, 3], [0, 0, 0, 1]", "[0, 0, 1, 3]", "images[1].object_to_world has 3 items"},
           {"[0, -1, 0, 1.25]", "[0, -1, 0]", "images[1].object_to_world[0] has 3 items"}}) {
    ExpectUserError([&] { ReadText(Replaced(kFixture, fault.what, fault.with)); },
                    {"w/turntable.json", fault.place}, fault.with);
  }
  ExpectUserError([] { ReadText("[]"); }, {"w/turntable.json", "the file is not an object"});
  ExpectUserError([] { ReadTurntableFile("none/turntable.json"); },
                  {"none/turntable.json", "turntable_mapper"});
}

TEST(TurntableFile, RefusesToWriteWhatItCannotRead) {
  const TemporaryFolder folder;
  const TurntableFile good = ExampleTurntable();
  WriteTurntableFile(folder / "turntable.json", good);
  const std::string before = folder.Read("turntable.json");
  for (int i = 0; i < 5; ++i) {
    TurntableFile bad = good;
    if (i == 0) bad.images[0].name = "\xff.jpg";
    if (i == 1) bad.images[0].name = bad.images[1].name;
    if (i == 2) bad.images[0].angle_deg = std::nan("");
    if (i == 3) bad.images[0].station = bad.num_stations;
    if (i == 4) bad.axis.direction *= 2;
    ExpectUserError([&] { WriteTurntableFile(folder / "turntable.json", bad); },
                    {(folder / "turntable.json").string()}, std::to_string(i));
    EXPECT_EQ(folder.Read("turntable.json"), before);
  }
}

TEST(TurntableFileBadInput, EveryDamageIsSurvived) {
  TurntableFile file = ExampleTurntable();
  file.images.resize(1);
  const TemporaryFolder folder;
  WriteTurntableFile(folder / "turntable.json", file);
  const std::string text = folder.Read("turntable.json");
  int num_read = 0;
  ForEachDamage(text, [&](const std::string& damaged, const std::string& description) {
    const ScopedAllocationLimit limit(100 * text.size());
    num_read += ExpectOkOrUserError([&] { ReadText(damaged); }, "w/turntable.json", description);
  });
  EXPECT_LT(num_read, static_cast<int>(text.size()) * 9);
  EXPECT_GT(num_read, 0);  // Digits far behind the point may change.
}

TEST(TurntableFileBadInput, DeepNestingIsSurvived) {
  for (const char* open : {"[", "{\"a\":"}) {
    std::string text;
    for (int i = 0; i < 200000; ++i) text += open;
    ExpectOkOrUserError([&] { ReadText(text); }, "w/turntable.json", open);
  }
}

}  // namespace
}  // namespace s2gs
