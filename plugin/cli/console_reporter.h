#pragma once

#include <cstdint>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "sfm_split/base/reporter.h"

namespace s2gs {

/// How the console is written.
struct ConsoleStyle {
  bool has_bars = false;   ///< redraw a progress bar in place; plain lines now and then otherwise.
  bool has_color = false;  ///< colour warnings and errors.
  int num_columns = 0;     ///< width of the terminal; 0 when unknown (80 is taken).
};

/// The style that suits a stream: bars on a terminal that can move its cursor, colour there unless NO_COLOR
/// is set (https://no-color.org).
ConsoleStyle StyleFor(std::FILE* stream);

/// Prints log lines as "[12.3s] message" with the seconds since it was made, and the progress of long tasks.
/// Without bars a task prints a line every 10 % but at most every 5 s and at least every minute. Tasks that
/// took less than 5 s leave no line.
class ConsoleReporter : public Reporter {
 public:
  /// Writes to the standard error stream.
  explicit ConsoleReporter(LogLevel level);

  /// \param seconds  a clock that never runs backwards [s].
  ConsoleReporter(LogLevel level, std::FILE* stream, const ConsoleStyle& style,
                  std::function<double()> seconds);
  ~ConsoleReporter() override;

  void Log(LogLevel level, std::string_view message) override;
  void Progress(std::string_view task, int64_t done, int64_t total) override;
  bool StopRequested() const override;

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

/// A duration for people: "8.1s", "3m 05s", "2h 07m".
std::string FormatDuration(double seconds);

}  // namespace s2gs
