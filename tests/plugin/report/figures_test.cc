#include "plugin/report/figures.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>

namespace s2gs {
namespace {

Figures Example() {
  return {{"angle_deg", "degrees", "an angle", {{"median", 1.0 / 3}, {"max", 2}}, ""},
          {"psnr_db", "dB", "a ratio", {{"mean", HUGE_VAL}}, ""},
          {"faces", "triangles", "a count", {}, "no \"mesh\", sorry"}};
}

TEST(Figures, AnythingMeasured) {
  EXPECT_TRUE(IsAnythingMeasured(Example()));
  EXPECT_FALSE(IsAnythingMeasured({Example()[2]}));
  EXPECT_FALSE(IsAnythingMeasured({}));
}

TEST(Figures, Table) {
  std::ostringstream out;
  PrintFigures(Example(), out);
  EXPECT_EQ(out.str(),
            "angle_deg   median 0.33333       max 2         degrees\n"
            "psnr_db       mean inf       dB\n"
            "faces      missing: no \"mesh\", sorry\n");
}

TEST(Figures, JsonKeepsEveryDigit) {
  std::ostringstream out;
  WriteFiguresJson(Example(), out);
  const nlohmann::json document = nlohmann::json::parse(out.str());
  EXPECT_EQ(document.at("version"), 1);
  const nlohmann::json& angle = document.at("figures").at("angle_deg");
  EXPECT_EQ(angle.at("median").get<double>(), 1.0 / 3);
  EXPECT_EQ(angle.at("max"), 2);
  EXPECT_EQ(angle.at("unit"), "degrees");
  EXPECT_EQ(angle.at("definition"), "an angle");
  EXPECT_EQ(document.at("figures").at("psnr_db").at("mean"), "inf");
  EXPECT_FALSE(document.at("figures").contains("faces"));
  EXPECT_EQ(document.at("missing").at("faces"), "no \"mesh\", sorry");
  EXPECT_EQ(document.at("missing").size(), 1u);
}

TEST(Figures, JsonSurvivesNamesThatAreNotUtf8) {
  std::ostringstream out;
  WriteFiguresJson({{"faces", "", "", {}, "no \xff.ply"}}, out);
  EXPECT_EQ(nlohmann::json::parse(out.str()).at("missing").at("faces"), "no \xef\xbf\xbd.ply");
}

TEST(Figures, Csv) {
  std::ostringstream out;
  WriteFiguresCsv(Example(), out);
  EXPECT_EQ(out.str(),
            "figure,statistic,value,unit,missing\n"
            "angle_deg,median,0.3333333333333333,degrees,\n"
            "angle_deg,max,2,degrees,\n"
            "psnr_db,mean,inf,dB,\n"
            "faces,,,triangles,\"no \"\"mesh\"\", sorry\"\n");
}

}  // namespace
}  // namespace s2gs
