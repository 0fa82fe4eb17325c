#include "plugin/colmap/attempt_beside.h"

#include <atomic>
#include <exception>
#include <future>
#include <string_view>

#include "sfm_split/base/error.h"
#include "sfm_split/base/keeping_reporter.h"

namespace s2gs {
namespace {

// A judgement: with fewer, work of one thread takes a third or more of what the attempt has.
constexpr int kEnoughThreads = 4;

// Speaks through another one, and stops by a flag of its own as well.
class StoppableReporter : public Reporter {
 public:
  StoppableReporter(Reporter& other, const std::atomic<bool>& stops) : other_(other), stops_(stops) {}

  void Log(LogLevel level, std::string_view message) override { other_.Log(level, message); }
  void Progress(std::string_view task, int64_t done, int64_t total) override {
    other_.Progress(task, done, total);
  }
  bool StopRequested() const override { return stops_ || other_.StopRequested(); }

 private:
  Reporter& other_;
  const std::atomic<bool>& stops_;
};

}  // namespace

bool AttemptBeside(const std::function<bool(Reporter&)>& attempt, const NeedlessWork& needless,
                   int num_threads, Reporter& reporter) {
  if (num_threads < kEnoughThreads) {
    const bool has_succeeded = attempt(reporter);
    if (has_succeeded) {
      needless.undo();
    } else {
      needless.work(reporter);
    }
    return has_succeeded;
  }
  std::atomic<bool> is_needless = false;
  KeepingReporter keeping(reporter);
  std::future<bool> attempted = std::async(std::launch::async, [&] {
    const bool has_succeeded = attempt(keeping);
    is_needless = has_succeeded;
    return has_succeeded;
  });
  std::exception_ptr failure;
  try {
    StoppableReporter stoppable(reporter, is_needless);
    needless.work(stoppable);
  } catch (...) {
    failure = std::current_exception();
  }
  attempted.wait();
  for (const auto& [level, message] : keeping.messages()) reporter.Log(level, message);
  const bool has_succeeded = attempted.get();
  if (has_succeeded) {
    needless.undo();
  } else if (failure) {
    std::rethrow_exception(failure);
  }
  return has_succeeded;
}

}  // namespace s2gs
