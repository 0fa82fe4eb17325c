#include "plugin/outputs/turntable_report.h"

#include <gtest/gtest.h>

#include <sstream>
#include <string>

#include "sfm_split/scene/io/colmap_model.h"
#include "tests/support/bad_input.h"
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
