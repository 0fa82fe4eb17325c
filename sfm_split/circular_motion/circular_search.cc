#include "sfm_split/circular_motion/circular_search.h"

#include "sfm_split/base/keeping_reporter.h"

namespace s2gs {
namespace {

// Stops also when its search is given up.
class SearchReporter : public KeepingReporter {
 public:
  SearchReporter(const Reporter& asked, const std::atomic<bool>& is_stopping)
      : KeepingReporter(asked), is_stopping_(is_stopping) {}

  bool StopRequested() const override { return is_stopping_ || KeepingReporter::StopRequested(); }

 private:
  const std::atomic<bool>& is_stopping_;
};

}  // namespace

CircularSearch::CircularSearch(const ScanFeatures& features, const CircularOptions& options,
                               const Reporter& reporter)
    : features_(features) {
  found_ = std::async(std::launch::async, [this, options, &reporter] {
             CircularOptions anew = options;
             anew.begun = nullptr;
             SearchReporter keeping(reporter, is_stopping_);
             Found found;
             found.aligned = SceneFromCircularMotion(features_, anew, keeping, &found.finding);
             found.messages = keeping.messages();
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
