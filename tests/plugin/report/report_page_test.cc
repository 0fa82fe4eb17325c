// The whole report of one made-up scan, compared with expected/: what it says of known inputs, where it draws
// them, and which words it uses. That its figures are right is what the other tests of this folder show.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <regex>
#include <set>
#include <sstream>

#include "mesh/surface/triangle_mesh.h"
#include "plugin/plan/scan_plan.h"
#include "plugin/report/scan_report.h"
#include "plugin/report/scan_summary.h"
#include "plugin/stage/stage_stamp.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "tests/support/expected_text.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

using nlohmann::json;

// Two stations of six photos, two lenses that bend outwards; the background's points are shifted in the
// left part of the frame, so that the camera model lacks something there.
SyntheticTurntable Table() {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 6;
  options.step_deg = 40;
  options.step_jitter = 0.2;
  options.pixel_noise = 0.3;
  options.width = 64;
  options.height = 48;
  options.num_object_points = 120;
  options.num_platter_points = 40;
  options.num_background_points = 2500;
  options.camera_model = CameraModelId::kSimpleRadial;
  options.distortion = {0.03};
  options.camera_per_station = true;
  SyntheticTurntable table = MakeSyntheticTurntable(options);
  for (SyntheticImage& image : table.images) {
    for (SyntheticKeypoint& keypoint : image.keypoints) {
      if (keypoint.body == SyntheticBody::kStatic && keypoint.xy.x() < 12) keypoint.xy.x() += 0.8;
    }
  }
  return table;
}

// Stripes that are sharp in all photos but one, which is bright as well.
Image8 Photo(size_t number) {
  Image8 image{64, 48, 3, std::vector<uint8_t>(64 * 48 * 3)};
  const bool is_odd = number == 3;
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      const int stripe = is_odd ? 200 + 3 * (x % 16) : ((x / 8) % 2 == 0 ? 60 : 170);
      for (int c = 0; c < 3; ++c)
        image.Pixel(x, y)[c] = static_cast<uint8_t>(stripe + 2 * c + (y > 40 ? 9 : 0));
    }
  }
  return image;
}

json Mapper(const SyntheticTurntable& table) {
  json sigmas = json::object();
  for (size_t i = 0; i < table.scene.views.size(); ++i) {
    if (i != 5) sigmas[table.scene.views[i].name] = 0.01 * static_cast<double>(i + 1);
  }
  return {{"case", "turntable"},
          {"images", 15},
          {"registered", 12},
          {"missing", json::array({"x_doubted.jpg", "x_lost.jpg"})},
          {"untied", json::array({table.scene.views[3].name})},
          {"doubted", json::array({{{"name", "x_doubted.jpg"}}})},
          {"mended", json::array({{{"name", table.scene.views[2].name}, {"how", "by its matches"}}})},
          {"rounds", json::array({{{"seconds", 0.5}, {"object_rms_px", 2.0}, {"background_rms_px", 1.0}},
                                  {{"seconds", 1.5}, {"object_rms_px", 0.5}, {"background_rms_px", 0.4}}})},
          {"object", {{"adjusted_rms_px", 0.52}, {"adjusted_observations", 1234}}},
          {"background", {{"adjusted_rms_px", 0.41}, {"adjusted_observations", 4321}}},
          {"sigma",
           {{"angle_median_deg", 0.012},
            {"angle_max_deg", 0.034},
            {"axis_direction_deg", 0.056},
            {"axis_point", 0.00078},
            {"scale_rel", 0.0009},
            {"focal_px", json::array({1.25, 0.0})},
            {"pixel", 0.31}}},
          {"angle_sigma_deg", sigmas},
          {"joint_model", {{"chosen", "shared stations"}, {"tests", json::array()}}},
          {"observability",
           {{"computed", true},
            {"nullity", 2},
            {"parameters", 99},
            {"condition", 1.5e7},
            {"null_directions", json::array({"the scale", "the slide"})}}},
          {"verdict",
           {{"verdict", "good"},
            {"poses_hold", true},
            {"reasons", json::array({"all is well"})},
            {"advice", json::array({"nothing"})},
            {"measured", {{"held_back", {{"share", 0.875}}}, {"focal_prior_share", 0.0625}}}}}};
}

json Labels(const SyntheticTurntable& table) {
  json images = json::array();
  for (const View& view : table.scene.views) {
    images.push_back({{"name", view.name}, {"station", view.station}, {"labels", "oosu"}});
  }
  for (const char* name : {"x_doubted.jpg", "x_lost.jpg"}) {
    images.push_back({{"name", name}, {"station", 1}, {"labels", "uuus"}});
  }
  return {{"case", "turntable"}, {"reason", "two bodies"}, {"images", images}};
}

StageStamp Stamp(double seconds, const std::string& reason) {
  StageStamp stamp;
  stamp.run_id = "1";
  stamp.program_version = "0";
  stamp.finished = "2020-02-02T02:02:02Z";
  stamp.seconds = seconds;
  stamp.reason = reason;
  stamp.options = {{"Group.option", "3"}, {"other", "yes"}};
  stamp.inputs = {{"database.db", {true, 1, 77, "state", "0123456789abcdef"}}};
  return stamp;
}

// A box without a lid, on which no photo looks from below.
TriangleMesh Box() {
  TriangleMesh mesh;
  for (int i = 0; i < 8; ++i) {
    mesh.vertices.emplace_back(0.1F * static_cast<float>(i & 1), 0.2F * static_cast<float>(i >> 1 & 1),
                               0.3F * static_cast<float>(i >> 2));
    mesh.colors.push_back({static_cast<uint8_t>(20 * i), 100, 200});
  }
  mesh.triangles = {{0, 2, 1}, {1, 2, 3}, {0, 1, 5}, {0, 5, 4}, {2, 6, 3},
                    {3, 6, 7}, {0, 4, 2}, {2, 4, 6}, {1, 3, 5}, {3, 7, 5}};
  return mesh;
}

Image8 Comparison(int rows) {
  Image8 image{4 * 16, 12 * rows, 3, std::vector<uint8_t>(static_cast<size_t>(4 * 16 * 12 * rows) * 3, 77)};
  return image;
}

void WriteLogs(const Workspace& workspace) {
  const auto lines = [](const std::vector<json>& entries) {
    std::string text;
    for (const json& entry : entries) text += entry.dump() + "\n";
    return text;
  };
  WriteAll(
      workspace.Log(),
      lines({{{"stage", "train"}, {"event", "loss"}, {"wall_s", 1}, {"loss", {{"total", 0.5}, {"l1", 0.25}}}},
             {{"stage", "train"}, {"event", "loss"}, {"wall_s", 4}, {"loss", {{"total", 0.2}, {"l1", 0.1}}}},
             {{"stage", "train"},
              {"event", "loss"},
              {"wall_s", 5},
              {"whole", false},
              {"loss", {{"total", 0.01}, {"l1", 0.01}}}},
             {{"stage", "train"},
              {"event", "sights"},
              {"cameras", 2},
              {"photos", 12},
              {"other", 0.5},
              {"background", 0.125},
              {"alike", 0.25},
              {"never_free", 0.125}},
             {{"stage", "train"},
              {"event", "held_out"},
              {"wall_s", 2},
              {"psnr_db", 20},
              {"object_psnr_db", 26},
              {"ssim", 0.75},
              {"iteration", 30},
              {"count", 40}},
             {{"stage", "train"},
              {"event", "held_out"},
              {"wall_s", 8},
              {"psnr_db", 30},
              {"object_psnr_db", 32},
              {"ssim", 0.875},
              {"iteration", 300},
              {"count", 400}}}));
  WriteAll(workspace.MaskLog(), lines({{{"event", "table"},
                                        {"found", true},
                                        {"radius", 0.14},
                                        {"height", -0.05},
                                        {"share_of_directions", 0.75},
                                        {"false_alarms", 1e-9},
                                        {"static_share", 0.3},
                                        {"undecided", true},
                                        {"counts_as", "background"}}}));
  WriteAll(workspace.MeshLog(), lines({{{"stage", "mesh"}, {"wall_s", 1}, {"errors", {{"grey", 0.02}}}},
                                       {{"stage", "mesh"}, {"wall_s", 3}, {"errors", {{"grey", 0.01}}}}}));
}

void WriteScan(const Workspace& workspace) {
  const SyntheticTurntable table = Table();
  WriteSyntheticWorkspace(workspace.root, table);
  TurntableFile turntable = ReadTurntableFile(workspace.Turntable());
  turntable.tied_stations = {{0}, {1}};
  WriteTurntableFile(workspace.Turntable(), turntable);
  WriteAll(workspace.TurntableMapper(), Mapper(table).dump());
  WriteAll(workspace.SplitLabels(), Labels(table).dump());
  WriteLogs(workspace);
  std::filesystem::create_directories(workspace.Images());
  for (size_t i = 0; i < table.scene.views.size(); ++i) {
    WriteImage(workspace.Images() / table.scene.views[i].name, Photo(i));
  }
  std::filesystem::create_directories(workspace.SplitOverlays());
  for (const char* name : {"a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg", "f.jpg"}) {
    WriteImage(workspace.SplitOverlays() / name, Photo(0));
  }
  WriteImage(workspace.Overview(), Comparison(4));
  std::filesystem::create_directories(workspace.Dense());
  WritePlyMesh(workspace.TsdfMesh(), Box());
  WriteStageStamp(workspace, "motion_splitter", Stamp(12.5, "not done yet"));
  WriteStageStamp(workspace, "turntable_mapper", Stamp(50, "its options changed"));
  WriteStageStamp(workspace, "tsdf_mesher", Stamp(0.1, ""));
  ScanSummary scan;
  scan.steps = {{"motion_splitter", "The split", "s2gs motion_splitter --workspace_path W", 12, 24, true},
                {"tsdf_mesher", "The mesh", "s2gs tsdf_mesher --workspace_path W", 100, 90, true}};
  scan.stages = {{"motion_splitter", true, "not done yet", 12.5}, {"tsdf_mesher", false, "since long", 90.1}};
  WriteScanRecord(workspace.ScanRecord(), scan);
}

// Without what differs between runs, machines and releases, and one tag a line.
std::string Stable(std::string text, const Workspace& workspace) {
  const std::string root = workspace.root.string();
  const std::string name = workspace.root.filename().string();
  for (const auto& [what, with] : {std::pair(root, std::string("W")), std::pair(name, std::string("NAME"))}) {
    for (size_t at = 0; (at = text.find(what, at)) != std::string::npos;) text.replace(at, what.size(), with);
  }
  text = std::regex_replace(text, std::regex("(data:image/[a-z]*;base64,)[A-Za-z0-9+/=]*"), "$1");
  text = std::regex_replace(text, std::regex("s2gs \\d+\\.\\d+\\.\\d+[^<\"]*"), "s2gs VERSION");
  text = std::regex_replace(text, std::regex("this is \\d+\\.\\d+\\.\\d+"), "this is VERSION");
  text = std::regex_replace(text, std::regex("(bytes: \">)\\d+"), "$1BYTES");
  text = std::regex_replace(text, std::regex("(\"bytes\": )\\d\\d\\d+"), "$1BYTES");
  text = std::regex_replace(text, std::regex("([ \">])[0-9a-f]{16}\\b"), "$1HASH");
  return text;
}

// The page's own part: neither style nor scripts.
std::string Body(const std::string& page) {
  const size_t begin = page.find("<main>");
  const size_t end = page.find("</main>");
  return page.substr(begin, end - begin);
}

std::string OneTagALine(const std::string& html) {
  std::string lines;
  for (const char c : html) {
    if (c == '<' && !lines.empty() && lines.back() != '\n') lines += '\n';
    lines += c;
  }
  return lines;
}

TEST(ReportPage, SaysWhatTheScanHolds) {
  const TemporaryFolder folder;
  const Workspace workspace{folder / "made_up_scan"};
  WriteScan(workspace);
  Reporter reporter;
  WriteScanReport(workspace, "", reporter);
  const json numbers = json::parse(ReadAll(workspace.ReportJson()));
  ExpectText(Stable(numbers.dump(1) + "\n", workspace), "plugin/report/expected/report.json");
  ExpectText(OneTagALine(Stable(Body(ReadAll(workspace.ReportHtml())), workspace)),
             "plugin/report/expected/report.html");
}

// The picture that follows these words in the page.
Image8 PictureAfter(const std::string& page, const std::string& words, const TemporaryFolder& folder) {
  const std::string begin = "base64,";
  const size_t at = page.find(begin, page.find(words)) + begin.size();
  std::string bytes;
  uint32_t bits = 0;
  int num_bits = 0;
  const std::string digits = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  for (size_t i = at; digits.find(page[i]) != std::string::npos; ++i) {
    bits = (bits << 6U) | static_cast<uint32_t>(digits.find(page[i]));
    num_bits += 6;
    if (num_bits < 8) continue;
    num_bits -= 8;
    bytes += static_cast<char>((bits >> static_cast<unsigned>(num_bits)) & 0xFFU);
  }
  WriteAll(folder / "picture", bytes);
  return ReadImage(folder / "picture", 3);
}

// One photo of the object shares no point with the others: its row and column stay black.
TEST(ReportPage, ShowsHowManyPointsPairsOfPhotosShare) {
  const TemporaryFolder folder;
  const Workspace workspace{folder / "made_up_scan"};
  WriteScan(workspace);
  ColmapModel object = ReadColmapModel(workspace.ObjectModel());
  const std::string alone = Table().scene.views[4].name;
  for (auto& [id, image] : object.images) {
    if (image.name != alone) continue;
    for (ColmapPoint2D& keypoint : image.points2D) keypoint.point3D_id = kInvalidPoint3DId;
    for (auto& [point_id, point] : object.points3D) {
      point.track.erase(std::remove_if(point.track.begin(), point.track.end(),
                                       [&, own = id](const auto& seen) { return seen.image_id == own; }),
                        point.track.end());
    }
  }
  WriteColmapModel(workspace.ObjectModel(), object, ColmapFormat::kBinary);
  Reporter reporter;
  WriteScanReport(workspace, "", reporter);
  const Image8 picture =
      PictureAfter(ReadAll(workspace.ReportHtml()), "Which photos see the same points", folder);
  // By station and table angle.
  const TurntableFile table = ReadTurntableFile(workspace.Turntable());
  std::vector<TurntableImage> order = table.images;
  std::sort(order.begin(), order.end(), [](const TurntableImage& a, const TurntableImage& b) {
    const auto angle = [](const TurntableImage& image) {
      return image.angle_deg < 0 ? image.angle_deg + 360 : image.angle_deg;
    };
    return std::pair(a.station, angle(a)) < std::pair(b.station, angle(b));
  });
  const size_t n = order.size();
  ASSERT_EQ(picture.width, static_cast<int>(n));
  ASSERT_EQ(picture.height, static_cast<int>(n));
  const auto shared = [&](const ColmapModel& model) {
    std::map<uint32_t, size_t> place;
    for (const auto& [id, image] : model.images) {
      for (size_t i = 0; i < n; ++i) {
        if (order[i].name == image.name) place[id] = i;
      }
    }
    std::vector<std::vector<double>> counts(n, std::vector<double>(n, 0));
    for (const auto& [id, point] : model.points3D) {
      std::set<size_t> seen;
      for (const auto& element : point.track) seen.insert(place.at(element.image_id));
      for (const size_t a : seen) {
        for (const size_t b : seen) counts[a][b] += a != b ? 1 : 0;
      }
    }
    return counts;
  };
  const auto object_counts = shared(object);
  const auto background_counts = shared(ReadColmapModel(workspace.StaticModel()));
  const auto most_of = [](const std::vector<std::vector<double>>& counts) {
    double most = 1;
    for (const std::vector<double>& row : counts)
      most = std::max(most, *std::max_element(row.begin(), row.end()));
    return most;
  };
  int black = 0;
  for (size_t y = 0; y < n; ++y) {
    for (size_t x = 0; x < n; ++x) {
      const auto& counts = x < y ? object_counts : background_counts;
      std::array<double, 3> expected = {20, 20, 20};
      if (x != y && counts[x][y] > 0) {
        const std::array<std::array<double, 3>, 5> stops = {
            {{38, 32, 80}, {48, 86, 132}, {34, 140, 130}, {112, 194, 96}, {250, 230, 60}}};
        const double at = 4 * std::log(1 + counts[x][y]) / std::log(1 + most_of(counts));
        const auto first = static_cast<size_t>(std::min(at, 3.0));
        for (size_t c = 0; c < 3; ++c)
          expected[c] =
              stops[first][c] + (at - static_cast<double>(first)) * (stops[first + 1][c] - stops[first][c]);
      }
      black += expected[0] == 20 ? 1 : 0;
      for (size_t c = 0; c < 3; ++c)
        EXPECT_NEAR(picture.Pixel(static_cast<int>(x), static_cast<int>(y))[c], expected[c], 0.51)
            << x << " " << y;
    }
  }
  EXPECT_GE(black, static_cast<int>(2 * n - 1));  // the diagonal, and one photo with the others
  const json numbers = json::parse(ReadAll(workspace.ReportJson()));
  EXPECT_EQ(numbers["report"]["residuals"]["object"]["photos_without_shared_points"], 1);
}

// What the plan would leave out, but was asked for, has run.
TEST(ReportPage, WhatWasForcedIsNotLeftOut) {
  const TemporaryFolder folder;
  const Workspace workspace{folder / "made_up_scan"};
  WriteScan(workspace);
  Reporter reporter;
  PlanRequest request;
  request.workspace = workspace;
  request.forced = {"distortion_channel"};
  WriteScanPlan(workspace.Plan(), MakeScanPlan(request, reporter));
  WriteScanReport(workspace, "", reporter);
  int found = 0;
  const json numbers = json::parse(ReadAll(workspace.ReportJson()));
  for (const json& decision : numbers["report"]["stages"]["plan"]) {
    if (decision["part"] != "distortion_channel") continue;
    ++found;
    EXPECT_EQ(decision["state"], "runs");
    EXPECT_EQ(decision["forced"], true);
  }
  EXPECT_EQ(found, 1);
  ScanSummary summary;
  CollectFigures(workspace, &summary);
  for (const auto& [what, why] : summary.left_out)
    EXPECT_NE(what, "the map of depth distortion and its term");
}

TEST(ReportPage, SummaryAndPlanOfTheSameScan) {
  const TemporaryFolder folder;
  const Workspace workspace{folder / "made_up_scan"};
  WriteScan(workspace);
  ScanSummary summary = ReadScanRecord(workspace.ScanRecord());
  CollectFigures(workspace, &summary);
  std::ostringstream shown;
  PrintScanSummary(summary, shown);
  PlanRequest request;
  request.workspace = workspace;
  Reporter reporter;
  const ScanPlan plan = MakeScanPlan(request, reporter);
  PrintScanPlan(plan, shown);
  ExpectText(Stable(shown.str() + PlanToJson(plan).dump(1) + "\n", workspace),
             "plugin/report/expected/summary.txt");
}

}  // namespace
}  // namespace s2gs
