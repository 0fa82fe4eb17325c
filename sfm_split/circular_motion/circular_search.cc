#include "sfm_split/circular_motion/circular_search.h"

#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace s2gs {
namespace {

// Keeps what is logged: a reporter hears its caller's thread alone.
class KeepingReporter : public Reporter {
 public:
  KeepingReporter(const Reporter& asked, const std::atomic<bool>& is_stopping)
      : asked_(asked), is_stopping_(is_stopping) {}

  void Log(LogLevel level, std::string_view message) override { messages_.emplace_back(level, message); }
  bool StopRequested() const override { return is_stopping_ || asked_.StopRequested(); }

  std::vector<std::pair<LogLevel, std::string>> Take() { return std::move(messages_); }

 private:
  const Reporter& asked_;
  const std::atomic<bool>& is_stopping_;
  std::vector<std::pair<LogLevel, std::string>> messages_;
};

}  // namespace

CircularSearch::CircularSearch(const ScanFeatures& features, const CircularOptions& options,
                               const Reporter& reporter)
    : features_(features) {
  found_ = std::async(std::launch::async, [this, options, &reporter] {
             CircularOptions anew = options;
             anew.begun = nullptr;
             KeepingReporter keeping(reporter, is_stopping_);
             Found found;
             found.aligned = SceneFromCircularMotion(features_, anew, keeping, &found.finding);
             found.messages = keeping.Take();
             return found;
           }).share();
}

CircularSearch::~CircularSearch() {
  is_stopping_ = true;
  found_.wait();
}

AlignedScene CircularSearch::Await(Reporter& reporter, CircularFinding* finding) const {
  const Found& found = found_.get();
  for (const auto& [level, message] : found.messages) reporter.Log(level, message);
  *finding = found.finding;
  return found.aligned;
}

}  // namespace s2gs
