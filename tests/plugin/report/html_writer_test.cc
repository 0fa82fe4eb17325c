#include "plugin/report/html_writer.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "plugin/report/data_uri.h"
#include "plugin/report/plot.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

TEST(EscapeHtml, NothingOfATextCanBecomeATagOrAnAttribute) {
  EXPECT_EQ(EscapeHtml("<script>alert('x')</script> & \"y\""),
            "&lt;script&gt;alert(&#39;x&#39;)&lt;/script&gt; &amp; &quot;y&quot;");
  EXPECT_EQ(EscapeHtml("a\tb\nc"), "a\tb\nc");
  // Every byte alone: what is left has none of the characters that mean something.
  for (int c = 0; c < 256; ++c) {
    const std::string escaped = EscapeHtml(std::string(1, static_cast<char>(c)));
    EXPECT_EQ(escaped.find_first_of("<>\"'"), std::string::npos) << c;
    EXPECT_TRUE(escaped.size() > 1 || (c >= 0x20 && c < 0x7f) || c == '\t' || c == '\n') << c;
  }
}

TEST(EscapeHtml, KeepsUtf8AndReplacesWhatIsNone) {
  const std::string ok = "Grüße 写真 😀";
  EXPECT_EQ(EscapeHtml(ok), ok);
  const std::string mark = "\xef\xbf\xbd";
  EXPECT_EQ(EscapeHtml("a\xff"), "a" + mark);
  EXPECT_EQ(EscapeHtml("\xc3"), mark);                                   // cut off
  EXPECT_EQ(EscapeHtml("\xc0\xbc"), mark + mark);                        // '<', overlong
  EXPECT_EQ(EscapeHtml("\xed\xa0\x80"), mark + mark + mark);             // a surrogate
  EXPECT_EQ(EscapeHtml("\xf4\x90\x80\x80"), mark + mark + mark + mark);  // past U+10FFFF
}

TEST(HtmlWriter, EscapesTextAndAttributes) {
  HtmlWriter out;
  out.Open("p", {{"title", "a\"><b"}}).Text("1 < 2").Void("img", {{"alt", "x'y"}}).Close();
  EXPECT_EQ(out.html(), "<p title=\"a&quot;&gt;&lt;b\">1 &lt; 2<img alt=\"x&#39;y\"/>\n</p>\n");
}

TEST(WriteTiles, ATileWithoutANoteHasNoPlaceForOne) {
  HtmlWriter out;
  WriteTiles({{"photos", "60", "of 61"}, {"verdict", "good", ""}}, &out);
  const std::string html = out.html();
  EXPECT_NE(html.find("<dd class=\"note\">of 61</dd>"), std::string::npos) << html;
  EXPECT_EQ(html.find("note", html.find("good")), std::string::npos) << html;
}

TEST(Numbers, ForPeople) {
  EXPECT_EQ(ShortNumber(1.5), "1.5");
  EXPECT_EQ(ShortNumber(-0.001), "0");
  EXPECT_EQ(ShortNumber(200), "200");
  EXPECT_EQ(ShortNumber(NAN), "–");
  EXPECT_EQ(Significant(0.0123456), "0.0123");
  EXPECT_EQ(Significant(123456.7), "123457");
  EXPECT_EQ(Significant(9.995, 2), "10.0");
  EXPECT_EQ(Significant(HUGE_VAL), "–");
}

// Noise is what takes most bytes: quality falls until it fits, but never below half.
TEST(JpegDataUri, HasNoMoreBytesThanAllowedWhereHalfOfTheQualityWillDo) {
  RandomNumbers random(1);
  Image8 noise{64, 64, 3, std::vector<uint8_t>(64 * 64 * 3)};
  for (uint8_t& value : noise.pixels) value = static_cast<uint8_t>(random.Uniform(0, 256));
  const size_t full = JpegDataUri(noise, 80).size();
  const size_t half = JpegDataUri(noise, 40).size();
  ASSERT_LT(half, full);
  EXPECT_EQ(JpegDataUri(noise, 80, full), JpegDataUri(noise, 80));
  const size_t between = (full + half) / 2;
  EXPECT_LE(JpegDataUri(noise, 80, between).size(), between);
  EXPECT_GT(JpegDataUri(noise, 80, between).size(), half);
  EXPECT_EQ(JpegDataUri(noise, 80, 1), JpegDataUri(noise, 40));
}

// RFC 4648, section 10.
TEST(Base64, TestVectors) {
  EXPECT_EQ(Base64(""), "");
  EXPECT_EQ(Base64("f"), "Zg==");
  EXPECT_EQ(Base64("fo"), "Zm8=");
  EXPECT_EQ(Base64("foo"), "Zm9v");
  EXPECT_EQ(Base64("foob"), "Zm9vYg==");
  EXPECT_EQ(Base64("foobar"), "Zm9vYmFy");
  EXPECT_EQ(Base64(std::string("\xff\x00\xfe", 3)), "/wD+");
}

TEST(Plot, MarksOfAxes) {
  const auto expect = [](const std::vector<double>& marks, const std::vector<double>& expected) {
    ASSERT_EQ(marks.size(), expected.size());
    for (size_t i = 0; i < marks.size(); ++i)
      EXPECT_NEAR(marks[i], expected[i], 1e-12 * std::abs(expected[i]));
  };
  expect(AxisMarks(0, 1, false), {0, 0.2, 0.4, 0.6, 0.8, 1});
  expect(AxisMarks(-7, 31, false), {0, 10, 20, 30});
  expect(AxisMarks(0.02, 3000, true), {0.1, 1, 10, 100, 1000});
  expect(AxisMarks(3, 30, true), {5, 10, 20});
  // So short a stretch has none of 1, 2 and 5 in it.
  EXPECT_GE(AxisMarks(3.1, 3.3, true).size(), 2u);
}

TEST(Plot, LeavesOutWhatCannotBeDrawn) {
  Plot plot{"t <i>", {"x", true}, {"y", true}, {}, false};
  PlotSeries series;
  series.mark = PlotMark::kDots;
  series.points = {{1, 1}, {0, 1}, {1, NAN}, {2, -1}, {10, 3}};
  plot.series = {series};
  HtmlWriter out;
  WritePlot(plot, &out);
  size_t dots = 0;
  for (size_t at = 0; (at = out.html().find("<circle", at)) != std::string::npos; ++at) ++dots;
  EXPECT_EQ(dots, 2u);
  EXPECT_EQ(out.html().find("nan"), std::string::npos);
  EXPECT_EQ(out.html().find("<i>,"), std::string::npos);

  HtmlWriter empty;
  plot.series[0].points = {{0, 1}};
  WritePlot(plot, &empty);
  EXPECT_NE(empty.html().find("nothing was recorded"), std::string::npos);
}

// Numbers that follow `name="` in the text, in their order.
std::vector<double> NumbersAfter(const std::string& html, const std::string& name) {
  std::vector<double> numbers;
  for (size_t at = 0; (at = html.find(name + "=\"", at)) != std::string::npos;) {
    at += name.size() + 2;
    numbers.push_back(std::stod(html.substr(at)));
  }
  return numbers;
}

TEST(Plot, PlacesFollowTheAxes) {
  // On a log axis equal ratios are equal distances, on a linear one equal differences; y grows upwards.
  Plot plot{"t", {"x", true}, {"y", false}, {}, false};
  PlotSeries series;
  series.mark = PlotMark::kDots;
  series.points = {{1, 0}, {10, 1}, {100, 2}, {1000, 4}};
  plot.series = {series};
  HtmlWriter out;
  WritePlot(plot, &out);
  const std::vector<double> x = NumbersAfter(out.html(), "cx");
  const std::vector<double> y = NumbersAfter(out.html(), "cy");
  ASSERT_EQ(x.size(), 4u);
  EXPECT_GT(x[1] - x[0], 20);
  EXPECT_NEAR(x[2] - x[1], x[1] - x[0], 0.11);  // written to a tenth
  EXPECT_NEAR(x[3] - x[2], x[1] - x[0], 0.11);
  EXPECT_GT(y[0] - y[1], 20);
  EXPECT_NEAR(y[1] - y[2], y[0] - y[1], 0.11);
  EXPECT_NEAR(y[2] - y[3], 2 * (y[0] - y[1]), 0.21);
}

TEST(Plot, LinesGoThroughAllPointsOrAStrideOfThem) {
  for (const int count : {2, 30, 100000}) {
    Plot plot{"t", {"x", false}, {"y", false}, {}, false};
    PlotSeries series;
    for (int i = 0; i < count; ++i) series.points.emplace_back(i, i % 7);
    plot.series = {series};
    HtmlWriter out;
    WritePlot(plot, &out);
    const size_t begin = out.html().find(" d=\"M");
    ASSERT_NE(begin, std::string::npos) << count;
    const std::string path = out.html().substr(begin, out.html().find('"', begin + 4) - begin);
    const auto corners = std::count(path.begin(), path.end(), 'L');
    if (count <= 30) {
      EXPECT_EQ(corners, count - 1);
    } else {
      EXPECT_GT(corners, 100);
      EXPECT_LT(corners, 5000);
    }
    // Few points are marked, too.
    EXPECT_EQ(NumbersAfter(out.html(), "cx").size(), count <= 12 ? static_cast<size_t>(count) : 0u);
  }
}

TEST(Plot, BarsAreAsWideAsTheirDistance) {
  Plot plot{"t", {"x", false}, {"y", false}, {}, true};
  PlotSeries series;
  series.mark = PlotMark::kBars;
  series.points = {{0, 1}, {1, 2}, {2, 0}, {4, 4}};
  plot.series = {series};
  HtmlWriter out;
  WritePlot(plot, &out);
  size_t bars = 0;
  for (size_t at = 0; (at = out.html().find("class=\"bar\"", at)) != std::string::npos; ++at) ++bars;
  EXPECT_EQ(bars, 3u);  // a bar of no height is none

  plot.series[0].points = {{3, 2}};  // no distance to be as wide as
  HtmlWriter one;
  WritePlot(plot, &one);
  EXPECT_NE(one.html().find("class=\"bar\""), std::string::npos);
  EXPECT_EQ(one.html().find("inf"), std::string::npos);
}

// Bars of standard deviations that are longer than the data spread stay inside of the drawing.
TEST(Plot, ErrorBarsStayInside) {
  Plot plot{"t", {"x", false}, {"y", false}, {}, false};
  PlotSeries series;
  series.mark = PlotMark::kDots;
  series.points = {{0, 1}, {1, 1.01}};
  series.sigmas = {5, NAN};
  plot.series = {series};
  HtmlWriter out;
  WritePlot(plot, &out);
  const std::string& html = out.html();
  const size_t bar = html.find("class=\"sigma\"");
  ASSERT_NE(bar, std::string::npos);
  EXPECT_EQ(html.find("class=\"sigma\"", bar + 1), std::string::npos);  // the other has none
  const auto number = [&](const char* name) {
    return std::stod(html.substr(html.find(name, bar) + std::string(name).size() + 2));
  };
  EXPECT_LT(number("y1"), 300);
  EXPECT_GT(number("y2"), 0);
  EXPECT_GT(number("y1") - number("y2"), 100);  // nearly the drawing's height
}

// All of one value: a tenth of it is room on either side, from 36 to 44.
TEST(Plot, AValueThatDoesNotChangeHasRoomAroundIt) {
  Plot plot{"t", {"x", false}, {"y", false}, {}, false};
  PlotSeries series;
  series.mark = PlotMark::kDots;
  series.points = {{1, 40}, {2, 40}};
  plot.series = {series};
  HtmlWriter out;
  WritePlot(plot, &out);
  EXPECT_NE(out.html().find(">38<"), std::string::npos);
  EXPECT_NE(out.html().find(">42<"), std::string::npos);
}

}  // namespace
}  // namespace s2gs
