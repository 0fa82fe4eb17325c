#include "plugin/curves/work_curve.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>

#include "plugin/curves/knobs.h"
#include "plugin/curves/work_curve_files.h"
#include "plugin/curves/work_curve_page.h"
#include "tests/support/bad_input.h"
#include "tests/support/expected_text.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

WorkPoint Point(int scene, const std::string& value, uint64_t seed, double cpu_seconds, double error) {
  WorkPoint point;
  point.scene = scene;
  point.value = value;
  point.seed = seed;
  point.cpu_seconds = cpu_seconds;
  point.wall_seconds = cpu_seconds / 2;
  point.figures["error"] = error;
  return point;
}

// Two scenes, four values: b is worse and slower than a on the first; the last fails there once.
WorkCurve Curve() {
  WorkCurve curve;
  curve.knob = "knob";
  curve.what = "a <knob>";
  curve.error = "error";
  curve.error_text = "error [px]";
  curve.reference = "ground truth";
  curve.scenes = {"first", "second"};
  curve.values = {"a", "b", "c", "d"};
  for (const double wiggle : {0.9, 1.0, 1.2}) {
    const auto seed = static_cast<uint64_t>(10 * wiggle);
    curve.points.push_back(Point(0, "a", seed, 1 * wiggle, 8 * wiggle));
    curve.points.push_back(Point(0, "b", seed, 2 * wiggle, 9 * wiggle));
    curve.points.push_back(Point(0, "c", seed, 4 * wiggle, 1.005 * wiggle));
    curve.points.push_back(Point(0, "d", seed, 8 * wiggle, 1 * wiggle));
    curve.points.push_back(Point(1, "a", seed, 1 * wiggle, 1 * wiggle));
    curve.points.push_back(Point(1, "c", seed, 5 * wiggle, 1 * wiggle));
  }
  WorkPoint failed = Point(1, "d", 0, 3, 0.5);
  failed.failure = "it \"broke\", with a comma";
  curve.points.push_back(failed);
  return curve;
}

const WorkSetting& Of(const std::vector<WorkSetting>& settings, int scene, const std::string& value) {
  for (const WorkSetting& setting : settings) {
    if (setting.scene == scene && setting.value == value) return setting;
  }
  static const WorkSetting none;
  ADD_FAILURE() << value;
  return none;
}

TEST(WorkCurve, SumsUpSeeds) {
  const auto settings = SumUp(Curve());
  ASSERT_EQ(settings.size(), 7U);
  const WorkSetting& c = Of(settings, 0, "c");
  EXPECT_EQ(c.runs, 3);
  EXPECT_EQ(c.reached, 3);
  EXPECT_DOUBLE_EQ(c.error.min, 0.9 * 1.005);
  EXPECT_DOUBLE_EQ(c.error.median, 1.005);
  EXPECT_DOUBLE_EQ(c.error.max, 1.2 * 1.005);
  EXPECT_DOUBLE_EQ(c.wall_seconds.median, 2);
  const WorkSetting& d = Of(settings, 1, "d");
  EXPECT_EQ(d.reached, 0);
  EXPECT_TRUE(std::isinf(d.error.median));
}

TEST(WorkCurve, ParetoSetIsWhatNothingBeats) {
  const auto settings = SumUp(Curve());
  EXPECT_TRUE(Of(settings, 0, "a").is_pareto);
  EXPECT_FALSE(Of(settings, 0, "b").is_pareto);
  EXPECT_TRUE(Of(settings, 0, "c").is_pareto);
  EXPECT_TRUE(Of(settings, 0, "d").is_pareto);
  EXPECT_TRUE(Of(settings, 1, "a").is_pareto);
  EXPECT_FALSE(Of(settings, 1, "c").is_pareto);  // as good, but slower
  EXPECT_FALSE(Of(settings, 1, "d").is_pareto);  // not reached, however small the number
}

TEST(WorkCurve, TimeToAShareOfTheFinalQuality) {
  const auto settings = SumUp(Curve());
  EXPECT_EQ(TimeToShare(settings, 0, 0.1), 1);    // error below 10
  EXPECT_EQ(TimeToShare(settings, 0, 0.9), 4);    // below 1.11
  EXPECT_EQ(TimeToShare(settings, 0, 0.99), 4);   // below 1.0101
  EXPECT_EQ(TimeToShare(settings, 0, 0.999), 8);  // below 1.001
  EXPECT_EQ(TimeToShare(settings, 1, 0.999), 1);
  EXPECT_EQ(TimeToShare({}, 0, 0.9), std::nullopt);
}

TEST(WorkCurve, PerformanceProfile) {
  const auto settings = SumUp(Curve());
  // Within 10 % of the best: c and d on the first scene (4 and 8 s), a and c on the second (1 and 5 s).
  EXPECT_EQ(ProfileAt(settings, 2, "a", 1, 0.1), 0.5);
  EXPECT_EQ(ProfileAt(settings, 2, "c", 1, 0.1), 0.5);
  EXPECT_EQ(ProfileAt(settings, 2, "c", 5, 0.1), 1);
  EXPECT_EQ(ProfileAt(settings, 2, "d", 1.9, 0.1), 0);
  EXPECT_EQ(ProfileAt(settings, 2, "d", 100, 0.1), 0.5);
  EXPECT_EQ(ProfileAt(settings, 2, "b", 100, 0.1), 0);
}

TEST(WorkCurve, FilesHoldEveryRun) {
  const WorkCurve curve = Curve();
  std::ostringstream csv;
  WriteCurveCsv(curve, csv);
  EXPECT_THAT(csv.str(), testing::StartsWith("knob,value,scene,seed,wall_s,cpu_s,reached,failure,error\n"));
  EXPECT_THAT(csv.str(), testing::HasSubstr("knob,d,second,0,1.5,3,0,\"it \"\"broke\"\", with a comma\",\n"));
  std::ostringstream text;
  WriteCurveJson(curve, text);
  const nlohmann::json json = nlohmann::json::parse(text.str());
  EXPECT_EQ(json["points"].size(), curve.points.size());
  EXPECT_EQ(json["settings"].size(), 7U);
  EXPECT_EQ(json["time_to"]["first"]["0.999"], 8.0);
  EXPECT_TRUE(json["settings"][6]["error"]["median"].is_null());
}

TEST(WorkCurve, PageIsSelfContainedAndEscaped) {
  std::ostringstream out;
  WriteCurvePage(Curve(), out);
  const std::string page = out.str();
  EXPECT_THAT(page, testing::HasSubstr("a &lt;knob&gt;"));
  EXPECT_THAT(page, testing::HasSubstr("not reached"));
  EXPECT_THAT(page, testing::HasSubstr("<h2>All scenes</h2>"));
  for (const char* outside : {"http", "<script", "src=", "url(", "nan", "inf,", "inf\""}) {
    EXPECT_THAT(page, testing::Not(testing::HasSubstr(outside)));
  }
  // Also where there is nothing to draw, or one point alone.
  for (const size_t kept : {0U, 1U}) {
    WorkCurve few = Curve();
    few.points.resize(kept);
    std::ostringstream small;
    WriteCurvePage(few, small);
    EXPECT_THAT(small.str(), testing::Not(testing::HasSubstr("nan")));
  }
}

std::string OneTagALine(const std::string& html) {
  std::string lines;
  for (const char c : html) {
    if (c == '<' && !lines.empty() && lines.back() != '\n') lines += '\n';
    lines += c;
  }
  return lines;
}

// Where the page draws known runs, and what its tables say of them.
TEST(WorkCurve, PageShowsEveryRun) {
  for (const CurveTime time : {CurveTime::kCpu, CurveTime::kWall}) {
    WorkCurve curve = Curve();
    curve.time = time;
    std::ostringstream page;
    WriteCurvePage(curve, page);
    const std::string text = OneTagALine(page.str());
    ExpectText(text.substr(text.find("</style>")), time == CurveTime::kCpu
                                                       ? "plugin/curves/expected/curve_cpu.html"
                                                       : "plugin/curves/expected/curve_wall.html");
  }
  std::ostringstream files;
  WriteCurveCsv(Curve(), files);
  WriteCurveJson(Curve(), files);
  ExpectText(files.str(), "plugin/curves/expected/curve.txt");
}

// Over many decades powers of ten alone; over few of them 2 and 5 as well.
TEST(WorkCurve, PageHasFewMarksOnLongAxes) {
  WorkCurve curve = Curve();
  curve.scenes = {"first"};
  curve.points = {Point(0, "a", 1, 0.003, 0.3), Point(0, "b", 1, 300, 0.2)};
  std::ostringstream page;
  WriteCurvePage(curve, page);
  const std::string svg = page.str();
  for (const char* mark : {">0.01<", ">0.1<", ">1<", ">10<", ">100<", ">0.2<"})
    EXPECT_THAT(svg, testing::HasSubstr(mark));
  for (const char* mark : {">0.02<", ">0.05<", ">2<", ">20<", ">50<"})
    EXPECT_THAT(svg, testing::Not(testing::HasSubstr(mark)));
  curve.points[1].cpu_seconds = 0.03;
  std::ostringstream shorter;
  WriteCurvePage(curve, shorter);
  for (const char* mark : {">0.005<", ">0.01<", ">0.02<"})
    EXPECT_THAT(shorter.str(), testing::HasSubstr(mark));
}

TEST(WorkCurve, PointsComeBackForTheSameSettingsAlone) {
  const TemporaryFolder folder;
  WorkPoint point = Point(1, "a", 7, 2.5, 0.25);
  point.failure = "no";
  WritePoint(folder / "point.json", "settings", point);
  const std::optional<WorkPoint> same = ReadPoint(folder / "point.json", "settings");
  ASSERT_TRUE(same.has_value());
  EXPECT_EQ(same->value, "a");
  EXPECT_EQ(same->seed, 7U);
  EXPECT_EQ(same->cpu_seconds, 2.5);
  EXPECT_EQ(same->failure, "no");
  EXPECT_EQ(same->figures, point.figures);
  EXPECT_FALSE(ReadPoint(folder / "point.json", "other settings").has_value());
  EXPECT_FALSE(ReadPoint(folder / "missing.json", "settings").has_value());
  folder.Write("damaged.json", R"({"settings": "settings", "scene": "x)");
  EXPECT_FALSE(ReadPoint(folder / "damaged.json", "settings").has_value());
}

TEST(WorkCurve, CountsTheTimeThatMeansSomething) {
  WorkCurve curve = Curve();
  for (WorkPoint& point : curve.points) {
    if (point.value == "d") point.wall_seconds = 0.1;  // the fastest, though it took the most work
  }
  curve.time = CurveTime::kWall;
  const auto settings = SumUp(curve);
  EXPECT_TRUE(Of(settings, 0, "d").is_pareto);
  EXPECT_FALSE(Of(settings, 0, "a").is_pareto);
  EXPECT_EQ(TimeToShare(settings, 0, 0.1), 0.1);
  EXPECT_EQ(ProfileAt(settings, 2, "d", 1, 0.1), 0.5);
}

TEST(WorkCurve, PartsOfACurveBecomeOne) {
  const WorkCurve whole = Curve();
  WorkCurve second = whole;
  second.scenes = {"second"};
  second.points.clear();
  WorkCurve first = second;
  first.scenes = {"first"};
  first.values.pop_back();
  WorkCurve late = first;
  late.values = {"d"};
  for (const WorkPoint& point : whole.points) {
    WorkCurve* own = point.scene == 1 ? &second : point.value == "d" ? &late : &first;
    own->points.push_back(point);
    own->points.back().scene = 0;
  }
  const WorkCurve merged = MergeCurves({first, late, second});
  EXPECT_EQ(merged.scenes, whole.scenes);
  EXPECT_EQ(merged.values, whole.values);
  const auto expected = SumUp(whole);
  const auto found = SumUp(merged);
  ASSERT_EQ(found.size(), expected.size());
  for (size_t i = 0; i < found.size(); ++i) {
    EXPECT_EQ(found[i].scene, expected[i].scene);
    EXPECT_EQ(found[i].value, expected[i].value);
    EXPECT_EQ(found[i].runs, expected[i].runs);
    EXPECT_EQ(found[i].error.median, expected[i].error.median);
    EXPECT_EQ(found[i].is_pareto, expected[i].is_pareto);
  }
  ExpectUserError([&] { MergeCurves({first, first}); }, {"first, a, seed 9", "twice"});
  WorkCurve other = second;
  other.error = "other";
  ExpectUserError([&] { MergeCurves({first, other}); }, {"not the same measurement"});
}

// Numbers stand from cheap to costly, which the first curve shows, however the runs were dealt out.
TEST(WorkCurve, ValuesOfPartsStandInOrder) {
  const auto merged = [](const std::vector<std::string>& first, const std::vector<std::string>& second) {
    WorkCurve a, b;
    a.values = first;
    b.values = second;
    return MergeCurves({a, b}).values;
  };
  EXPECT_THAT(merged({"190", "6000"}, {"375", "1500"}), testing::ElementsAre("190", "375", "1500", "6000"));
  EXPECT_THAT(merged({"1e-1", "1e-8"}, {"1e-4", "1e-1"}), testing::ElementsAre("1e-1", "1e-4", "1e-8"));
  EXPECT_THAT(merged({"6", "2"}, {"4", "1.5"}), testing::ElementsAre("6", "4", "2", "1.5"));
  EXPECT_THAT(merged({"b", "2"}, {"a", "1"}), testing::ElementsAre("b", "2", "a", "1"));
}

TEST(WorkCurve, CurvesComeBackFromTheirFiles) {
  const TemporaryFolder folder;
  WorkCurve curve = Curve();
  curve.time = CurveTime::kWall;
  std::ostringstream text;
  WriteCurveJson(curve, text);
  folder.Write("curve.json", text.str());
  std::ostringstream again;
  WriteCurveJson(ReadCurve(folder / "curve.json"), again);
  EXPECT_EQ(again.str(), text.str());
  folder.Write("damaged.json", text.str().substr(0, 300));
  ExpectUserError([&] { ReadCurve(folder / "damaged.json"); }, {"damaged.json", "no curve"});
  folder.Write("scene.json", R"({"knob": "k", "what": "", "error": "", "error_text": "", "reference": "",
      "program": "", "scenes": [], "values": [], "points": [{"scene": 0, "value": "1", "seed": 0, "wall_s": 1,
      "cpu_s": 1, "failure": "", "figures": {}}]})");
  ExpectUserError([&] { ReadCurve(folder / "scene.json"); }, {"scene.json", "not named"});
}

TEST(Knobs, AreFoundByNameOrAsOptions) {
  for (const Knob& knob : AllKnobs()) {
    EXPECT_EQ(FindKnob(knob.name).option, knob.option);
    EXPECT_GE(knob.values.size(), 5U) << knob.name;
    EXPECT_FALSE(ErrorOf(knob.stage, true).figure.empty());
  }
  const Knob other = FindKnob("tsdf_mesher.Tsdf.truncation_voxels");
  EXPECT_EQ(other.command, "tsdf_mesher");
  EXPECT_EQ(other.option, "Tsdf.truncation_voxels");
  EXPECT_EQ(other.from, "tsdf_mesher");
  ExpectUserError([] { FindKnob("colour"); }, {"colour", "joint_tolerance", "COMMAND.OPTION"});
  ExpectUserError([] { FindKnob("no_command.option"); }, {"no_command"});
}

}  // namespace
}  // namespace s2gs
