#include "plugin/report/scan_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "mesh/surface/triangle_mesh.h"
#include "plugin/report/scan_summary.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

struct Report {
  std::string page;
  json numbers;
};

Report Make(const Workspace& workspace) {
  Reporter reporter;
  WriteScanReport(workspace, "", reporter);
  return {ReadAll(workspace.ReportHtml()), json::parse(ReadAll(workspace.ReportJson()))};
}

// What no page of ours may hold: anything that is fetched, and numbers that are none.
void ExpectSelfContained(const std::string& page) {
  for (const char* fetched : {"http://", "https://", "src=\"/", "url(", "@import", "<link", "<iframe"}) {
    EXPECT_EQ(page.find(fetched), std::string::npos) << fetched;
  }
  for (const char* number : {"nan", "inf "}) {
    EXPECT_EQ(page.find(std::string("=\"") + number), std::string::npos) << number;
  }
}

SyntheticTurntable Table() {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 8;
  options.step_deg = 45;
  options.pixel_noise = 0.3;
  options.width = 64;
  options.height = 48;
  return MakeSyntheticTurntable(options);
}

TEST(ScanReport, OfAnEmptyWorkspaceSaysWhatIsMissing) {
  const TemporaryFolder folder;
  const Report report = Make({folder.path()});
  ExpectSelfContained(report.page);
  EXPECT_TRUE(report.numbers.at("verdict").is_null());
  EXPECT_EQ(report.numbers.at("report").at("verdict").at("next_command"), "motion_splitter");
  for (const char* missing :
       {"No photos are known yet", "There is no mesh yet", "There are no sparse models yet"}) {
    EXPECT_THAT(report.page, HasSubstr(missing));
  }
}

TEST(ScanReport, SaysWhatPhotosCannotTellOfTheRotatingPart) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  std::filesystem::create_directories(workspace.Own());
  const auto make = [&](const std::string& log) {
    WriteFileAtomically(workspace.Log(), [&](std::ostream& out) { out << log; });
    return Make(workspace);
  };
  const auto sights = [](const json& cameras, double alike) {
    const json line = {{"stage", "train"},   {"event", "sights"}, {"iteration", 9},
                       {"cameras", cameras}, {"photos", 40},      {"other", 0.5},
                       {"background", 0.0},  {"alike", alike},    {"never_free", 0.5 - alike}};
    return line.dump() + "\n";
  };
  // The last line counts.
  const Report told = make(sights(1, 0.4) + sights(2, 0.25));
  const json numbers = told.numbers.at("report").at("pictures").at("sights");
  EXPECT_EQ(numbers.at("cameras"), 2);
  EXPECT_EQ(numbers.at("alike"), 0.25);
  EXPECT_THAT(told.page, HasSubstr("25 % look like a plain background"));
  const Report untold = make(sights(0, 0));
  EXPECT_TRUE(untold.numbers.at("report").at("pictures").at("sights").is_null());
  EXPECT_THAT(untold.page, HasSubstr("No camera stood still"));
  EXPECT_FALSE(make("").numbers.at("report").at("pictures").contains("sights"));
  ExpectSelfContained(make(sights("two", 0)).page);
}

TEST(ScanReport, SaysWhoseAPlainTableIs) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  std::filesystem::create_directories(workspace.Own());
  const auto make = [&](const json& line) {
    WriteFileAtomically(workspace.MaskLog(), [&](std::ostream& out) { out << line.dump() << '\n'; });
    return Make(workspace);
  };
  const auto table = [](const json& undecided, const char* counts_as) {
    return json{{"event", "table"},         {"found", true},       {"radius", 0.25},
                {"share_of_directions", 1}, {"static_share", 0.5}, {"undecided", undecided},
                {"counts_as", counts_as}};
  };
  const Report plain = make(table(true, "background"));
  const json numbers = plain.numbers.at("report").at("pictures").at("table");
  EXPECT_EQ(numbers.at("radius"), 0.25);
  EXPECT_EQ(numbers.at("undecided"), true);
  EXPECT_EQ(numbers.at("counts_as"), "background");
  EXPECT_THAT(plain.page, HasSubstr("they count as background"));
  EXPECT_THAT(make(table(true, "object")).page, HasSubstr("they count as the object"));
  EXPECT_THAT(make(table(false, "object")).page, HasSubstr("The photos tell that it turns"));
  const Report none = make({{"event", "table"}, {"found", false}});
  EXPECT_EQ(none.numbers.at("report").at("pictures").at("table").at("found"), false);
  ExpectSelfContained(make(table("<b>", "<b>")).page);
}

TEST(ScanReport, NamesOfPhotosStayText) {
  const TemporaryFolder folder;
  SyntheticTurntable table = Table();
  const std::string hostile = "\"><img src=x onerror=alert(1)>'&.jpg";
  table.scene.views[3].name = hostile;
  WriteSyntheticWorkspace(folder.path(), table);
  const Workspace workspace{folder.path()};
  for (const View& view : table.scene.views) {
    std::filesystem::create_directories(workspace.Images());
    WriteImage(workspace.Images() / view.name, Image8{64, 48, 3, std::vector<uint8_t>(64 * 48 * 3, 90)});
  }
  const Report report = Make(workspace);
  ExpectSelfContained(report.page);
  EXPECT_THAT(report.page, Not(HasSubstr("<img src=x")));
  EXPECT_THAT(report.page, HasSubstr("&quot;&gt;&lt;img src=x onerror=alert(1)&gt;&#39;&amp;.jpg"));
  bool is_listed = false;
  for (const json& photo : report.numbers.at("report").at("photos")) is_listed |= photo.at("name") == hostile;
  EXPECT_TRUE(is_listed);
}

TEST(ScanReport, NumbersOfASyntheticScan) {
  const TemporaryFolder folder;
  const SyntheticTurntable table = Table();
  WriteSyntheticWorkspace(folder.path(), table);
  const Workspace workspace{folder.path()};
  TriangleMesh mesh;
  mesh.vertices = {{0, 0, 0}, {0.1F, 0, 0}, {0, 0.1F, 0}, {0, 0, 0.1F}};
  mesh.triangles = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}};
  WriteAll(workspace.TsdfMesh(), "");
  WritePlyMesh(workspace.TsdfMesh(), mesh);
  WriteAll(workspace.Log(),
           "{\"stage\":\"train\",\"event\":\"loss\",\"wall_s\":1,\"loss\":{\"total\":0.5,\"l1\":0.25}}\n"
           "broken\n"
           "{\"stage\":\"train\",\"event\":\"held_out\",\"wall_s\":2,\"psnr_db\":20,\"object_psnr_db\":null,"
           "\"ssim\":0.9}\n");
  WriteAll(workspace.Masks() / "a.jpg.png", "no picture");
  WriteAll(workspace.Overview(), "no picture either");
  const Report report = Make(workspace);
  ExpectSelfContained(report.page);
  const json& parts = report.numbers.at("report");
  EXPECT_EQ(parts.at("photos").size(), table.scene.views.size());
  for (const json& station : parts.at("table").at("stations")) {
    EXPECT_NEAR(station.at("step_deg").get<double>(), 45, 1e-6);
    EXPECT_EQ(station.at("photos"), 8);
  }
  // Lengths of noise of .3 px in x and in y: rms .3 sqrt(2), known to a few percent from so many.
  EXPECT_NEAR(parts.at("residuals").at("object").at("rms_px").get<double>(), 0.3 * std::sqrt(2.0), 0.03);
  EXPECT_EQ(parts.at("geometry").at("cameras").at(0).at("corner_shift_px"), 0);
  EXPECT_EQ(parts.at("mesh").at("triangles"), 3);
  EXPECT_EQ(parts.at("mesh").at("holes").at("count"), 1);
  EXPECT_NEAR(parts.at("mesh").at("holes").at("rim_length").get<double>(), 0.3 * std::sqrt(2.0), 1e-6);
  EXPECT_NEAR(parts.at("curves").at("held_out").at("rms").at(0).at(1).get<double>(), 0.1, 1e-12);
  EXPECT_TRUE(parts.at("curves").at("held_out").at("object_rms").at(0).at(1).is_null());
  EXPECT_EQ(parts.at("curves").at("training").at("l1").at(0).at(1), 0.25);
}

// Why photos have no pose: by what the mapper and the split say of them.
TEST(ScanReport, SaysWhyPhotosHaveNoPose) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  TurntableFile turntable;
  turntable.num_stations = 1;
  for (const char* name : {"doubted.jpg", "featureless.jpg", "few.jpg"}) {
    TurntableImage image;
    image.name = name;
    turntable.images.push_back(image);
  }
  WriteTurntableFile(workspace.Turntable(), turntable);
  const auto reasons = [&] {
    std::map<std::string, std::string> of_name;
    const Report report = Make(workspace);
    for (const json& photo : report.numbers.at("report").at("photos")) {
      of_name[photo.at("name")] = photo.at("missing");
    }
    return of_name;
  };
  EXPECT_THAT(reasons().at("few.jpg"), HasSubstr("not been computed"));
  WriteAll(workspace.TurntableMapper(), R"({"doubted": [{"name": "doubted.jpg"}]})");
  EXPECT_THAT(reasons().at("featureless.jpg"), HasSubstr("too few of its matches"));
  json images = json::array();
  for (const char* name : {"doubted.jpg", "few.jpg"}) {
    images.push_back({{"name", name}, {"station", 0}, {"labels", "o"}});
  }
  WriteAll(workspace.SplitLabels(), json{{"case", "turntable"}, {"images", images}}.dump());
  const std::map<std::string, std::string> all = reasons();
  EXPECT_THAT(all.at("doubted.jpg"), HasSubstr("contradict"));
  EXPECT_THAT(all.at("featureless.jpg"), HasSubstr("it has no features"));
  EXPECT_THAT(all.at("few.jpg"), HasSubstr("too few of its matches"));
}

TEST(ScanReport, OneBodyHasNoTableAngles) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  const auto shown = [&](double angle_deg) {
    TurntableFile turntable;
    turntable.num_stations = 2;
    for (int i = 0; i < 2; ++i) {
      TurntableImage image;
      image.name = "photo" + std::to_string(i) + ".jpg";
      image.station = i;
      image.angle_deg = i * angle_deg;
      turntable.images.push_back(image);
    }
    WriteTurntableFile(workspace.Turntable(), turntable);
    return Make(workspace).page;
  };
  EXPECT_THAT(shown(0), AllOf(HasSubstr("Nothing turned"), Not(HasSubstr("one ring a station")),
                              Not(HasSubstr("station 1"))));
  EXPECT_THAT(shown(30), AllOf(Not(HasSubstr("Nothing turned")), HasSubstr("one ring a station"),
                               HasSubstr("station 1, 30")));
}

TEST(ScanReport, TellsTheMappersVerdict) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  WriteAll(
      workspace.TurntableMapper(),
      "{\"images\": 60, \"registered\": 41, \"verdict\": {\"verdict\": \"doubtful\", \"poses_hold\": false, "
      "\"reasons\": [\"the <seam> is "
      "open\"], \"advice\": [\"smaller steps\"], \"measured\": {\"held_back\": {\"share\": 0.875}}}, "
      "\"object\": {\"adjusted_rms_px\": 0}, \"sigma\": {\"angle_median_deg\": 0}}");
  const Report report = Make(workspace);
  EXPECT_EQ(report.numbers.at("verdict").at("verdict"), "doubtful");
  EXPECT_EQ(report.numbers.at("report").at("verdict").at("advice").at(0), "smaller steps");
  for (const char* shown : {"The scan is doubtful: 41 of 60 photos have a pose, but they may be wrong.",
                            "<li>the &lt;seam&gt; is open</li>", "<li>smaller steps</li>", "87.5 %",
                            "class=\"verdict doubtful\"", "s2gs automatic_scanner --workspace_path "}) {
    EXPECT_THAT(report.page, HasSubstr(shown));
  }
  // No point was adjusted: no residual to be proud of.
  EXPECT_THAT(report.page, Not(HasSubstr("rms of the rotating part")));
  EXPECT_THAT(report.page, Not(HasSubstr("median standard deviation")));  // held angles have none
}

// A workspace whose mapper's file has one value of a wrong kind: the part that needs it is left out and
// named, the rest is there.
TEST(ScanReportBadInput, WrongKindsInTheMappersFile) {
  const TemporaryFolder folder;
  WriteSyntheticWorkspace(folder.path(), Table());
  const Workspace workspace{folder.path()};
  const json good = {
      {"case", "turntable"},
      {"path", "p"},
      {"path_reason", "r"},
      {"images", 16},
      {"registered", 15},
      {"missing", json::array({"a.jpg"})},
      {"untied", json::array()},
      {"stations", 2},
      {"rounds", json::array()},
      {"mended", json::array({{{"name", "a.jpg"}, {"how", "h"}, {"inliers", 1}, {"candidates", 2}}})},
      {"object", {{"points", 1}, {"observations", 2}, {"mean_reprojection_error_px", 0.5}}},
      {"sigma", {{"angle_median_deg", 0.1}, {"focal_px", json::array({1})}, {"pixel", 0.3}}},
      {"angle_sigma_deg", {{"a.jpg", 0.1}}},
      {"joint_model",
       {{"chosen", "c"}, {"tests", json::array({{{"general", "g"}, {"score", 1}, {"fitted", true}}})}}},
      {"observability",
       {{"computed", true}, {"nullity", 0}, {"parameters", 9}, {"null_directions", json::array()}}},
      {"verdict", {{"verdict", "good"}, {"reasons", json::array()}, {"advice", json::array()}}},
      {"seconds", {{"read", 1}}}};
  std::vector<json::json_pointer> places;
  for (const auto& [key, value] : good.items()) {
    places.push_back(json::json_pointer("/" + key));
    if (!value.is_structured()) continue;
    for (const auto& [inner, unused] : value.items()) places.push_back(json::json_pointer("/" + key) / inner);
  }
  int left_out = 0;
  for (const json::json_pointer& place : places) {
    for (const json& wrong :
         {json(7), json("x"), json::array({7}), json({{"a", "b"}}), json(1e300), json()}) {
      json damaged = good;
      damaged[place] = wrong;
      WriteAll(workspace.TurntableMapper(), damaged.dump());
      const Report report = Make(workspace);
      EXPECT_THAT(report.page, HasSubstr("How to make it again")) << damaged;
      left_out += report.page.find("of the report is left out") != std::string::npos ? 1 : 0;
    }
  }
  EXPECT_GT(left_out, 0);
}

TEST(ScanSummary, LongNamesStandApartFromTheirValues) {
  ScanSummary summary;
  summary.left_out = {{"short", "why"}, {"a part whose name is longer than its column", "because"}};
  std::ostringstream shown;
  PrintScanSummary(summary, shown);
  EXPECT_THAT(shown.str(), HasSubstr("\n  short                           why\n"));
  EXPECT_THAT(shown.str(), HasSubstr("\n  a part whose name is longer than its column\n"
                                     "                                  because\n"));
}

TEST(ScanRecord, CountsThatAreNoneAreNotShown) {
  const TemporaryFolder folder;
  const Workspace workspace{folder.path()};
  WriteAll(workspace.Log(), "{\"iteration\":1e300,\"count\":2.5}\n");
  ScanSummary summary;
  CollectFigures(workspace, &summary);
  ASSERT_EQ(summary.figures.size(), 2U);
  EXPECT_EQ(summary.figures[0].second, "0");
  EXPECT_EQ(summary.figures[1].second, "0");
}

TEST(ScanRecord, ARunThatDidNothingLeavesItAsItWas) {
  const TemporaryFolder folder;
  ScanSummary first;
  first.steps = {{"tsdf_mesher", "The mesh", "s2gs tsdf_mesher --workspace_path 'a b'", 10, 20, true}};
  first.stages = {{"tsdf_mesher", true, "not done yet", 9}};
  WriteScanRecord(folder / "scan.json", first);
  const std::string written = ReadAll(folder / "scan.json");
  ScanSummary second = first;
  second.steps[0].wall_seconds = 0.01;
  second.steps[0].has_run = false;
  second.stages[0] = {"tsdf_mesher", false, "done", 9};
  WriteScanRecord(folder / "scan.json", second);
  EXPECT_EQ(ReadAll(folder / "scan.json"), written);
  EXPECT_EQ(ReadScanRecord(folder / "scan.json").steps.at(0).wall_seconds, 10);
  second.steps[0].has_run = true;
  WriteScanRecord(folder / "scan.json", second);
  EXPECT_EQ(ReadScanRecord(folder / "scan.json").steps.at(0).wall_seconds, 0.01);
  WriteAll(folder / "scan.json", "{\"steps\": 3}");
  EXPECT_TRUE(ReadScanRecord(folder / "scan.json").steps.empty());
}

}  // namespace
}  // namespace s2gs
