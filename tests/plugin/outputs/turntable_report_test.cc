#include "plugin/outputs/turntable_report.h"

#include <gtest/gtest.h>

#include <limits>
#include <sstream>
#include <string>

#include "sfm_split/base/angles.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "tests/support/bad_input.h"
#include "tests/support/expected_text.h"
#include "tests/support/temporary_folder.h"

namespace s2gs {
namespace {

TEST(TurntableReport, MeanErrorsAreOverPointsAndOverObservations) {
  ColmapModel model;
  EXPECT_EQ(DescribePoints(model).at("mean_reprojection_error_px"), 0);
  const auto add = [&](uint64_t id, double error, size_t length) {
    ColmapPoint3D& point = model.points3D[id];
    point.error = error;
    point.track.resize(length);
  };
  add(1, 0.25, 2);
  add(2, 1.0, 6);
  const nlohmann::json body = DescribePoints(model);
  EXPECT_EQ(body.at("points"), 2);
  EXPECT_EQ(body.at("observations"), 8);
  EXPECT_DOUBLE_EQ(body.at("mean_reprojection_error_px"), 0.625);
  EXPECT_DOUBLE_EQ(body.at("mean_observation_error_px"), (2 * 0.25 + 6 * 1.0) / 8);
}

TEST(TurntableReport, StatedAnglesThatWereNotAskedAreSaid) {
  RefineReport refined;
  EXPECT_FALSE(DescribeScene({}, refined).contains("stated_angles"));
  refined.angle_contradictions = {"not asked"};
  const nlohmann::json stated = DescribeScene({}, refined).at("stated_angles");
  EXPECT_EQ(stated.at("contradictions").dump(), R"(["not asked"])");
  EXPECT_TRUE(stated.at("stations").empty());
}

// As it is written when all photos show one body.
constexpr const char* kOneBodyReport =
    R"({"case":"one_body","path":"one body","path_reason":"r","images":3,"registered":2,"missing":["c.jpg"],)"
    R"("verdict":{"verdict":"doubtful","reasons":["x"],"advice":["y"]}})";

TEST(TurntableReport, PrintsWhatTheFileSays) {
  const TemporaryFolder folder;
  WriteAll(folder / "report.json", kOneBodyReport);
  std::ostringstream out;
  PrintTurntableSummary(folder / "report.json", out);
  EXPECT_EQ(out.str(),
            "case                    one_body\n"
            "path                    one body: r\n"
            "images registered       2 of 3\n"
            "  missing               c.jpg\n"
            "verdict                 doubtful\n"
            "  because               x\n"
            "  next time             y\n");
}

// A whole scan in two stations, every kind of line once.
TEST(TurntableReport, PrintsEveryLineOfAWholeScan) {
  nlohmann::json mended = nlohmann::json::array();
  for (int i = 0; i < 7; ++i) {
    mended.push_back(
        {{"name", "m" + std::to_string(i)}, {"how", "by points"}, {"inliers", 10 + i}, {"candidates", 20}});
  }
  mended.push_back({{"name", "n"}, {"how", "by likeness"}, {"inliers", 3}, {"candidates", 9}});
  const auto test = [](const char* general, double score, bool fitted, bool accepted) {
    return nlohmann::json{{"general", general}, {"score", score},       {"fitted", fitted},
                          {"f_statistic", 2.5}, {"accepted", accepted}, {"simple", "s"}};
  };
  nlohmann::json report = {
      {"case", "turntable"},
      {"path", "both"},
      {"path_reason", "why"},
      {"images", 40},
      {"registered", 38},
      {"missing", {"a", "b"}},
      {"untied", {"b"}},
      {"verdict", {{"verdict", "good"}, {"reasons", {"r1", "r2"}}, {"advice", nlohmann::json::array()}}},
      {"mended", mended},
      {"stations", 2},
      {"placed_stations", {{{"image", "c"}, {"inliers", 5}, {"candidates", 8}}}},
      {"object_placements", {20, 18}},
      {"object", {{"points", 100}, {"observations", 400}, {"mean_reprojection_error_px", 0.1234}}},
      {"background", {{"points", 0}, {"observations", 0}, {"mean_reprojection_error_px", 0}}},
      {"joint_model",
       {{"chosen", "free"},
        {"tests",
         {test("g1", 1.5, true, true), test("g2", 0.25, false, false), test("g3", 3, true, false)}}}},
      {"sigma",
       {{"not_computed", {"scale_rel"}},
        {"axis_direction_deg", 0.01234},
        {"angle_median_deg", 0.002},
        {"angle_max_deg", nullptr},
        {"angle_prior_share", 0.4},
        {"focal_px", {1.5, nullptr}},
        {"focal_prior_share", {0.06, 0.04}},
        {"scale_rel", nullptr}}},
      {"cameras", {{{"params", {500.125, 1}}}, {{"params", {600.5}}}}},
      {"scale_observable", true},
      {"observability",
       {{"computed", true},
        {"nullity", 1},
        {"parameters", 77},
        {"singular_value_gap", 123.4},
        {"null_directions", {"the scale"}}}},
      {"seconds", {{"read", 1.25}, {"solve", 20}}}};
  const TemporaryFolder folder;
  std::ostringstream out;
  const auto print = [&] {
    WriteAll(folder / "report.json", report.dump());
    PrintTurntableSummary(folder / "report.json", out);
  };
  print();
  report["sigma"]["scale_rel"] = 0.0125;
  report["sigma"]["axis_direction_deg"] = nullptr;
  report["sigma"]["angle_prior_share"] = 0.04;
  report["sigma"]["not_computed"] = {"axis_direction_deg", "angle_deg"};
  report["object_placements"] = {38};
  report["joint_model"]["tests"] = nlohmann::json::array();
  report["observability"]["computed"] = false;
  print();
  report["scale_observable"] = false;
  report["tied_stations"] = {{0}, {1}};
  print();
  report.erase("sigma");
  print();
  ExpectText(out.str(), "plugin/outputs/expected/turntable_summary.txt");
}

// What an adjusted scene says of itself: each figure of the report under its name.
TEST(TurntableReport, DescribesAScene) {
  AlignedScene aligned;
  aligned.scene.num_stations = 3;
  aligned.scene.scale_observable = true;
  for (const char* name : {"a", "b", "c"}) {
    View view;
    view.name = name;
    aligned.scene.views.push_back(view);
  }
  Camera camera;
  camera.camera_id = 4;
  camera.model = CameraModelId::kPinhole;
  camera.params = {1, 2, 3, 4};
  aligned.scene.cameras.push_back(camera);
  aligned.solution.groups.resize(2);
  aligned.solution.groups[0].num_images = 5;
  aligned.solution.groups[1].num_images = 6;
  RefineReport refined;
  JointReport& joint = refined.joint;
  joint.object_rms_px = 0.5;
  joint.object_observations = 50;
  joint.background_rms_px = 0.25;
  joint.background_observations = 25;
  joint.sigma_px = 0.3;
  joint.point_correlation = 0.0625;
  joint.axis_direction_sigma_deg = 0.01;
  joint.axis_point_sigma = std::numeric_limits<double>::infinity();
  joint.angle_sigma_deg = {0, 0.02, 0.04};
  joint.angle_prior_share = {0, 0.5, 0.25};
  joint.focal_sigma_px = {1.5};
  joint.focal_prior_share = {0.125};
  joint.observability.computed = true;
  joint.observability.num_parameters = 30;
  joint.observability.nullity = 2;
  joint.observability.gap = 16;
  joint.observability.condition = 10000;
  joint.observability.null_directions = {"one", "two"};
  ModelTest test;
  test.score = 1;
  test.worst_image = "w";
  test.worst_score = 3;
  test.fitted = true;
  test.extra_parameters = 4;
  test.f_statistic = 5;
  test.bic_gain = 6;
  test.accepted = true;
  refined.model_tests = {test};
  refined.principal_point.fitted = true;
  refined.principal_point.gain = 7;
  refined.principal_point.overdispersion = 1.5;
  refined.principal_point.shift = {0.125, -0.25};
  refined.principal_point.accepted = true;
  refined.missing = {"d"};
  refined.untied = {"e"};
  refined.doubted = {"f"};
  RelocalisedImage image;
  image.name = "a";
  image.how = "so";
  image.inliers = 7;
  image.candidates = 8;
  image.margin = 9;
  refined.relocalised = {image};
  refined.placed_stations = {image};
  KnownAngles stated;
  stated.station = 1;
  stated.is_believed = true;
  stated.prior.places.resize(3);
  stated.prior.sigma_rad = 0.5 * kPi / 180;
  stated.contradicts.resize(2);
  stated.scatter_rad = 0.25 * kPi / 180;
  stated.factor = -1;
  stated.factor_sigma = 0.125;
  refined.known_angles = {stated};
  refined.angle_contradictions = {"g"};
  RefineRound round;
  round.images = 10;
  round.object_points = 11;
  round.background_points = 12;
  round.object_rms_px = 13;
  round.background_rms_px = 14;
  round.seconds = 15;
  refined.rounds = {round};
  refined.is_stable = true;
  refined.relabelled_keypoints = 16;
  std::string text = DescribeScene(aligned, refined).dump(1) + "\n";
  joint = JointReport();  // nothing was computed
  refined.known_angles.clear();
  refined.angle_contradictions.clear();
  text += DescribeScene(aligned, refined).dump(1) + "\n";
  GuidedPhoto guided;
  guided.name = "h";
  guided.inliers = 1;
  guided.other = 2;
  guided.chance = 3;
  guided.matches = 4;
  text += ToJson(std::vector<GuidedPhoto>{guided}).dump(1) + "\n";
  PhotoAdjustment photos;
  photos.is_taken = true;
  photos.reason = PhotoReason::kStandardDeviations;
  photos.looked_in = PhotosLookedIn::kTracks;
  photos.finding = "i";
  photos.facing_finding = "j";
  photos.tracks = 1;
  photos.places = 2;
  photos.places_beside = 3;
  photos.tied_stations = {0, 2};
  photos.sigma_px = 4;
  photos.patches = {5, 6, 7, 8, 9, 10};
  photos.keypoints = {11, 12, 13, 14, 15, 16};
  photos.log_sigma_change = -0.25;
  photos.seconds = 17;
  text += ToJson(photos).dump(1) + "\n";
  photos = PhotoAdjustment();
  photos.log_sigma_change = std::numeric_limits<double>::infinity();
  text += ToJson(photos).dump(1) + "\n";
  ExpectText(text, "plugin/outputs/expected/turntable_report.txt");
}

TEST(TurntableReport, ShowsNoControlCharacters) {
  const TemporaryFolder folder;
  WriteAll(
      folder / "report.json",
      R"({"case":"a\u001b[2J","path":"b\u0007","path_reason":"","images":1,"registered":1,"missing":[]})");
  std::ostringstream out;
  PrintTurntableSummary(folder / "report.json", out);
  EXPECT_EQ(out.str().find_first_of("\x1b\x07"), std::string::npos) << out.str();
}

TEST(TurntableReportBadInput, EveryDamage) {
  const TemporaryFolder folder;
  std::ostringstream out;
  ForEachDamage(kOneBodyReport, [&](const std::string& damaged, const std::string& description) {
    WriteAll(folder / "report.json", damaged);
    ExpectOkOrUserError([&] { PrintTurntableSummary(folder / "report.json", out); }, "report.json",
                        description);
  });
  out.str("");
  for (const char* count : {"1e300", "2.5", "-1e300"}) {
    WriteAll(folder / "report.json",
             std::string(R"({"case":"a","path":"b","path_reason":"c","images":1,"missing":[],)") +
                 R"("registered":)" + count + "}");
    ExpectUserError([&] { PrintTurntableSummary(folder / "report.json", out); },
                    {"report.json", "is damaged"}, count);
  }
  out.str("");
  WriteAll(folder / "report.json", R"({"case":"turntable","path":7})");
  ExpectUserError([&] { PrintTurntableSummary(folder / "report.json", out); },
                  {"report.json", "is damaged", "run turntable_mapper again"});
  EXPECT_EQ(out.str(), "");  // not the half of it that could be read
  ExpectUserError([&] { PrintTurntableSummary(folder / "none.json", out); },
                  {"none.json", "turntable_mapper"});
}

}  // namespace
}  // namespace s2gs
