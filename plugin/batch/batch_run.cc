#include "plugin/batch/batch_run.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <deque>
#include <exception>
#include <mutex>
#include <optional>
#include <string_view>
#include <thread>
#include <utility>

#include "plugin/cli/command.h"
#include "plugin/stage/stage_stamp.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/machine_share.h"
#include "sfm_split/base/resolved_path.h"
#include "sfm_split/base/stopwatch.h"

namespace s2gs {
namespace {

constexpr std::chrono::milliseconds kPoll{50};
constexpr size_t kMaxLogLines = 20'000;
constexpr double kLogEverySeconds = 10;

// What an object's scan prints; its end is kept in the workspace.
class ScanLog {
 public:
  explicit ScanLog(const Workspace& workspace) : workspace_(workspace) {}

  void Add(std::string_view line) {
    lines_.emplace_back(line);
    if (lines_.size() > kMaxLogLines) lines_.pop_front();
    if (line.substr(0, kErrorMark.size()) == kErrorMark) {
      error_ = line.substr(kErrorMark.size());
    } else if (const size_t begin = line.find_first_not_of(' ');
               !error_.empty() && begin != std::string_view::npos) {
      // Messages of several lines come last; a table has them in one.
      error_ += (error_.back() == ':' || error_.back() == '.' ? " " : "; ") + std::string(line.substr(begin));
    }
    if (SteadySeconds() - written_ > kLogEverySeconds) Write();
  }

  void Write() {
    written_ = SteadySeconds();
    RequireNoLinkOut(workspace_.root, workspace_.BatchLog());
    CreateFolder(workspace_.Own());
    WriteFileAtomically(workspace_.BatchLog(), [&](std::ostream& out) {
      for (const std::string& line : lines_) out << line << '\n';
    });
  }

  const std::string& error() const { return error_; }

 private:
  Workspace workspace_;
  std::deque<std::string> lines_;
  std::string error_;
  double written_ = SteadySeconds();
};

class Batch {
 public:
  Batch(const std::vector<BatchObject>& objects, const std::vector<size_t>& chosen,
        const BatchRunOptions& options)
      : objects_(objects), waiting_(chosen.begin(), chosen.end()), options_(options) {}

  void Run(const std::function<void(const BatchEvent&)>& on_event,
           const std::function<bool()>& stop_requested) {
    const size_t num_jobs = std::min<size_t>(options_.jobs, waiting_.size());
    num_running_ = num_jobs;
    std::vector<std::thread> threads;
    std::exception_ptr error;
    for (size_t job = 0; job < num_jobs; ++job) threads.emplace_back([this, job] { Work(job); });
    for (bool is_over = false; !is_over;) {
      if (stop_requested()) has_to_stop_ = true;
      std::deque<BatchEvent> events;
      {
        std::unique_lock<std::mutex> lock(mutex_);
        changed_.wait_for(lock, kPoll, [&] { return !events_.empty() || num_running_ == 0; });
        events.swap(events_);
        is_over = num_running_ == 0;
      }
      for (const BatchEvent& event : events) {
        try {
          if (!error) on_event(event);
        } catch (...) {
          error = std::current_exception();
          has_to_stop_ = true;
        }
      }
    }
    for (std::thread& thread : threads) thread.join();
    if (error) std::rethrow_exception(error);
    if (error_) std::rethrow_exception(error_);
    if (stop_requested()) throw Interrupted();
  }

 private:
  std::optional<size_t> Next() {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (waiting_.empty() || has_to_stop_) return std::nullopt;
    const size_t next = waiting_.front();
    waiting_.pop_front();
    return next;
  }

  void Report(BatchEvent event) {
    const std::lock_guard<std::mutex> lock(mutex_);
    events_.push_back(std::move(event));
    changed_.notify_one();
  }

  void Work(size_t job) {
    try {
      while (const std::optional<size_t> object = Next()) {
        BatchEvent event;
        event.object = *object;
        event.has_begun = true;
        Report(event);
        event.outcome = Scan(*object, job);
        event.has_begun = false;
        event.has_ended = true;
        Report(std::move(event));
      }
    } catch (const Interrupted&) {
      // Run() says so when all jobs have ended.
    } catch (...) {
      const std::lock_guard<std::mutex> lock(mutex_);
      error_ = std::current_exception();
      has_to_stop_ = true;
    }
    const std::lock_guard<std::mutex> lock(mutex_);
    --num_running_;
    changed_.notify_one();
  }

  ChildCommand CommandOf(const BatchObject& object, size_t job) const {
    ChildCommand command;
    command.arguments = {options_.program.string(), "automatic_scanner"};
    const std::vector<std::string> line = ScanLine(object);
    command.arguments.insert(command.arguments.end(), line.begin(), line.end());
    const int cores = UsableCores();
    if (options_.jobs > 1 && std::getenv("OMP_NUM_THREADS") == nullptr) {
      command.environment.emplace_back("OMP_NUM_THREADS", std::to_string(std::max(1, cores / options_.jobs)));
    }
    if (!options_.gpus.empty()) {
      command.environment.emplace_back("CUDA_VISIBLE_DEVICES",
                                       std::to_string(options_.gpus[job % options_.gpus.size()]));
    }
    return command;
  }

  BatchOutcome Scan(size_t place, size_t job) {
    const BatchObject& object = objects_[place];
    const Workspace workspace{object.workspace};
    BatchOutcome before = LookAtObject(workspace);
    if (before.state == BatchState::kRunning) return before;
    const double begin = SteadySeconds();
    ScanLog log(workspace);
    BatchRecord record;
    record.arguments = ScanLine(object);
    bool is_interrupted = false;
    try {
      const ChildExit exit = RunChild(
          CommandOf(object, job), options_.grace,
          [&](const ChildOutput& output) {
            if (!output.is_complete) return;
            log.Add(output.line);
            BatchEvent event;
            event.object = place;
            event.line = output.line;
            Report(std::move(event));
          },
          [&] { return has_to_stop_.load(); });
      record.exit_code = exit.exit_code;
      record.signal = exit.signal;
      record.cpu_seconds = exit.cpu_seconds;
    } catch (const Interrupted&) {
      record.exit_code = kExitInterrupted;
      is_interrupted = true;
    }
    record.message = log.error();
    record.finished = UtcNow();
    record.wall_seconds = SteadySeconds() - begin;
    BatchOutcome outcome = JudgeRecord(record, ReadPoseVerdict(workspace));
    try {
      log.Write();
      WriteBatchRecord(workspace, record);
    } catch (const UserError& error) {
      // The object's own disk or folder, of which its scan has had more to say.
      if (outcome.state == BatchState::kDone) outcome = {BatchState::kFailed, error.what()};
    }
    if (is_interrupted) throw Interrupted();
    return outcome;
  }

  const std::vector<BatchObject>& objects_;
  std::deque<size_t> waiting_;
  const BatchRunOptions& options_;
  std::atomic<bool> has_to_stop_{false};
  std::mutex mutex_;  // of all below, and of waiting_
  std::condition_variable changed_;
  std::deque<BatchEvent> events_;
  std::exception_ptr error_;
  size_t num_running_ = 0;
};

}  // namespace

OptionCheck BatchRunOptions::Check() const {
  if (jobs < 1 || jobs > 1024) return OptionFault{"jobs", std::to_string(jobs), "1 <= jobs <= 1024"};
  return std::nullopt;
}

void RunBatch(const std::vector<BatchObject>& objects, const std::vector<size_t>& chosen,
              const BatchRunOptions& options, const std::function<void(const BatchEvent&)>& on_event,
              const std::function<bool()>& stop_requested) {
  Batch(objects, chosen, options).Run(on_event, stop_requested);
}

}  // namespace s2gs
