#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Keeps what is logged on a thread of its own, for a reporter that hears its caller's thread alone. Progress
/// is not kept.
class KeepingReporter : public Reporter {
 public:
  /// \param asked  is asked whether to stop, from the thread that works.
  explicit KeepingReporter(const Reporter& asked) : asked_(asked) {}

  void Log(LogLevel level, std::string_view message) override { messages_.emplace_back(level, message); }
  bool StopRequested() const override { return asked_.StopRequested(); }

  /// What was logged, in its order.
  const std::vector<std::pair<LogLevel, std::string>>& messages() const { return messages_; }

 private:
  const Reporter& asked_;
  std::vector<std::pair<LogLevel, std::string>> messages_;
};

}  // namespace s2gs
