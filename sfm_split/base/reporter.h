#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace s2gs {

enum class LogLevel { kDebug, kInfo, kWarning, kError };

/// How library code talks to whoever runs it. Libraries never print: they take a Reporter&, and the program
/// decides between a progress bar, plain lines and silence. The default implementation is silent and never
/// asks to stop. All calls come from the thread that called the library function, but for StopRequested(),
/// which any thread may call.
class Reporter {
 public:
  Reporter() = default;
  Reporter(const Reporter&) = delete;
  Reporter& operator=(const Reporter&) = delete;
  virtual ~Reporter() = default;

  virtual void Log(LogLevel /*level*/, std::string_view /*message*/) {}

  /// Progress of one long task.
  /// \param task   a short name, constant over the task, e.g. "match pairs".
  /// \param done   finished units; the task ends when done == total.
  /// \param total  all units; 0 when unknown.
  virtual void Progress(std::string_view /*task*/, int64_t /*done*/, int64_t /*total*/) {}

  /// True once the user asked to stop. Loops that run longer than about a second poll it, finish or discard
  /// their current unit, and throw Interrupted.
  virtual bool StopRequested() const { return false; }

  void Debug(std::string_view message) { Log(LogLevel::kDebug, message); }
  void Info(std::string_view message) { Log(LogLevel::kInfo, message); }
  void Warn(std::string_view message) { Log(LogLevel::kWarning, message); }
  void Error(std::string_view message) { Log(LogLevel::kError, message); }
};

}  // namespace s2gs
