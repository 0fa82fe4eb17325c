#include "plugin/cli/console_reporter.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pty.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <string>
#include <utility>
#include <vector>

namespace s2gs {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

// A reporter on a file, with a clock set by hand.
class Console {
 public:
  double now = 100;

  Console(LogLevel level, const ConsoleStyle& style)
      : stream_(std::tmpfile()), reporter_(std::in_place, level, stream_, style, [this] { return now; }) {}
  Console(const Console&) = delete;
  Console& operator=(const Console&) = delete;
  ~Console() {
    reporter_.reset();
    std::fclose(stream_);
  }

  ConsoleReporter* operator->() { return &*reporter_; }

  std::string Text() const {
    std::string text(static_cast<size_t>(std::ftell(stream_)), '\0');
    std::rewind(stream_);
    EXPECT_EQ(std::fread(text.data(), 1, text.size(), stream_), text.size());
    return text;
  }

  // What a terminal would show: understands line feeds, carriage returns and "erase to the end of the line".
  std::vector<std::string> Screen() const {
    std::vector<std::string> lines(1);
    size_t column = 0;
    const std::string text = Text();
    for (size_t i = 0; i < text.size(); ++i) {
      if (text[i] == '\n') {
        lines.emplace_back();
        column = 0;
      } else if (text[i] == '\r') {
        column = 0;
      } else if (text.compare(i, 3, "\x1b[K") == 0) {
        lines.back().resize(column);
        i += 2;
      } else {
        lines.back().resize(std::max(lines.back().size(), column + 1), ' ');
        lines.back()[column++] = text[i];
      }
    }
    return lines;
  }

 private:
  std::FILE* stream_;
  std::optional<ConsoleReporter> reporter_;
};

constexpr ConsoleStyle kPlain = {};
constexpr ConsoleStyle kBars = {true, false, 100};

TEST(ConsoleReporter, PrintsTimeAndLevel) {
  Console console(LogLevel::kDebug, kPlain);
  console.now += 12.34;
  console->Info("reading 3 files {not a format}");
  console->Debug("details");
  console->Warn("odd");
  console->Error("bad");
  EXPECT_EQ(console.Text(),
            "[12.3s] reading 3 files {not a format}\n[12.3s] debug: details\n[12.3s] warning: odd\n[12.3s] "
            "error: bad\n");
}

TEST(ConsoleReporter, HidesWhatIsBelowItsLevel) {
  Console console(LogLevel::kWarning, kPlain);
  console->Debug("a");
  console->Info("b");
  for (int i = 0; i <= 100; ++i) {
    console.now += 100;
    console->Progress("task", i, 100);
  }
  EXPECT_THAT(console.Text(), IsEmpty());
  console->Warn("c");
  EXPECT_THAT(console.Text(), HasSubstr("c"));
}

TEST(ConsoleReporter, ColoursOnlyWhenAsked) {
  Console colored(LogLevel::kInfo, {false, true, 80});
  colored->Warn("odd");
  EXPECT_THAT(colored.Text(), HasSubstr("\x1b[33m[0.0s] warning: odd\x1b[0m\n"));
  Console plain(LogLevel::kInfo, kBars);
  plain->Warn("odd");
  EXPECT_THAT(plain.Text(), Not(HasSubstr("\x1b[3")));
}

TEST(ConsoleReporter, TerminalsGetNoCommandsFromMessages) {
  Console console(LogLevel::kInfo, {false, true, 0});
  console->Log(LogLevel::kInfo, "photo \x1b]0;title\a\x1b[2J.jpg\r");
  EXPECT_THAT(console.Text(), HasSubstr("photo \\x1b]0;title\\x07\\x1b[2J.jpg\\x0d\n"));
}

TEST(ConsoleReporter, BarShowsRateAndTimeLeft) {
  Console console(LogLevel::kInfo, kBars);
  for (int i = 0; i <= 250; ++i) {
    console->Progress("match pairs", i, 1000);
    console.now += 0.2;  // 5 a second
  }
  EXPECT_THAT(console.Screen(),
              ElementsAre("match pairs [######..................]  25 % 250/1000, 5/s, 2m 30s left"));
}

TEST(ConsoleReporter, BarIsRedrawnAtMostTenTimesASecond) {
  Console console(LogLevel::kInfo, kBars);
  for (int i = 0; i < 100000; ++i) {
    console->Progress("fast", i, 100000);
    console.now += 1e-5;  // one second altogether
  }
  const std::string text = console.Text();
  EXPECT_LE(std::count(text.begin(), text.end(), '\r'), 11);
}

TEST(ConsoleReporter, LogLinesAndBarsDoNotClobberOneAnother) {
  Console console(LogLevel::kInfo, kBars);
  console->Info("begin");
  for (int i = 0; i < 4; ++i) {
    console->Progress("a task with a long name", i, 4);
    console.now += 0.5;
    if (i == 1) console->Warn("x");
    if (i == 2) console->Info("y");
  }
  const std::vector<std::string> screen = console.Screen();
  ASSERT_EQ(screen.size(), 4U);
  EXPECT_EQ(screen[0], "[0.0s] begin");
  EXPECT_EQ(screen[1], "[1.0s] warning: x");
  EXPECT_EQ(screen[2], "[1.5s] y");
  EXPECT_THAT(screen[3], HasSubstr("a task with a long name [######"));
  console->Progress("a task with a long name", 4, 4);
  EXPECT_THAT(console.Screen(), ElementsAre("[0.0s] begin", "[1.0s] warning: x", "[1.5s] y", ""));
}

TEST(ConsoleReporter, BarsGiveWayToTheNextTaskAndFit) {
  Console console(LogLevel::kInfo, {true, false, 30});
  console->Progress("a first task", 1, 100);
  console.now += 1;
  console->Progress("a second task", 1, 100);
  ASSERT_EQ(console.Screen().size(), 1U);
  EXPECT_EQ(console.Screen()[0], std::string("a second task [..............").substr(0, 29));
}

TEST(ConsoleReporter, UnknownTotals) {
  Console console(LogLevel::kInfo, kBars);
  for (int i = 0; i <= 20; ++i) {
    console->Progress("grow", i, 0);
    console.now += 1;
  }
  EXPECT_THAT(console.Screen(), ElementsAre("grow: 20, 1/s, 20.0s"));
}

TEST(ConsoleReporter, LongTasksLeaveALine) {
  Console console(LogLevel::kInfo, kBars);
  for (int i = 0; i <= 10; ++i) {
    console->Progress("train", i, 10);
    console.now += 10;
  }
  EXPECT_THAT(console.Screen(), ElementsAre("[100.0s] train: 10 in 1m 40s", ""));
}

TEST(ConsoleReporter, PlainLinesAreFew) {
  Console console(LogLevel::kInfo, kPlain);
  // 1000 s: every 10 % is a line.
  for (int i = 0; i <= 1000; ++i) {
    console->Progress("train", i, 1000);
    console.now += 1;
  }
  std::string text = console.Text();
  EXPECT_NEAR(std::count(text.begin(), text.end(), '\n'), 1000.0 / 60 + 1, 2);
  EXPECT_THAT(text, HasSubstr("[60.0s] train: 60/1000 (6 %), 1/s, 15m 40s left\n"));
  EXPECT_THAT(text, Not(HasSubstr("\r")));

  // 20 s: a line every 5 s at most.
  Console fast(LogLevel::kInfo, kPlain);
  for (int i = 0; i <= 2000; ++i) {
    fast->Progress("match", i, 2000);
    fast.now += 0.01;
  }
  text = fast.Text();
  EXPECT_LE(std::count(text.begin(), text.end(), '\n'), 5);
  EXPECT_GE(std::count(text.begin(), text.end(), '\n'), 4);
  EXPECT_THAT(text, HasSubstr("match: 2000 in 20.0s\n"));

  // Nothing for what takes a moment.
  Console moment(LogLevel::kInfo, kPlain);
  for (int i = 0; i <= 100; ++i) moment->Progress("read", i, 100);
  EXPECT_THAT(moment.Text(), IsEmpty());
}

TEST(ConsoleReporter, TimeLeftFollowsARateThatChanges) {
  Console console(LogLevel::kInfo, kBars);
  int done = 0;
  for (; done < 1000; ++done, console.now += 0.01) console->Progress("train", done, 2000);  // 100 a second
  for (; done < 1500; ++done, console.now += 0.1) console->Progress("train", done, 2000);   // 10 a second
  // The rate falls from 100 towards 10 as 10 + 90 exp(-50 / 15) = 13.2, so 500 take 38 s; the plain average
  // over the task would say 20 s.
  EXPECT_THAT(console.Screen()[0], ::testing::ContainsRegex(", 13/s, 3[78]\\.[0-9]s left"));
}

TEST(ConsoleReporter, HostileProgressIsHarmless) {
  Console console(LogLevel::kInfo, kBars);
  for (const int64_t done : {int64_t{5}, int64_t{-3}, int64_t{1} << 62, int64_t{0}}) {
    console->Progress("odd", done, 3);
    console.now += 1;
    console->Progress("odd", done, -1);
    console.now += 1;
  }
  SUCCEED();
}

TEST(StyleFor, TerminalsAndNoColor) {
  const std::FILE* const file = std::tmpfile();
  EXPECT_FALSE(StyleFor(const_cast<std::FILE*>(file)).has_bars);
  int controller = -1;
  int terminal = -1;
  struct winsize size = {};
  size.ws_col = 123;
  if (::openpty(&controller, &terminal, nullptr, nullptr, &size) != 0)
    GTEST_SKIP() << "no pseudo-terminals here";
  std::FILE* stream = ::fdopen(terminal, "w");
  ::setenv("TERM", "xterm", 1);
  ::unsetenv("NO_COLOR");
  EXPECT_TRUE(StyleFor(stream).has_bars);
  EXPECT_TRUE(StyleFor(stream).has_color);
  EXPECT_EQ(StyleFor(stream).num_columns, 123);
  ::setenv("NO_COLOR", "1", 1);
  EXPECT_TRUE(StyleFor(stream).has_bars);
  EXPECT_FALSE(StyleFor(stream).has_color);
  ::setenv("TERM", "dumb", 1);
  EXPECT_FALSE(StyleFor(stream).has_bars);
  std::fclose(stream);
  ::close(controller);
}

TEST(FormatDuration, ReadsWell) {
  EXPECT_EQ(FormatDuration(0), "0.0s");
  EXPECT_EQ(FormatDuration(59.94), "59.9s");
  EXPECT_EQ(FormatDuration(59.96), "1m 00s");
  EXPECT_EQ(FormatDuration(3599.6), "1h 00m");
  EXPECT_EQ(FormatDuration(7620), "2h 07m");
  EXPECT_EQ(FormatDuration(-1), "?");
  EXPECT_EQ(FormatDuration(1e300), "277777777777h 46m");
}

}  // namespace
}  // namespace s2gs
