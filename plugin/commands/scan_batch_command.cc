#include "plugin/commands/scan_batch_command.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <optional>
#include <ostream>
#include <string>
#include <system_error>
#include <vector>

#include "plugin/batch/batch_list.h"
#include "plugin/batch/batch_page.h"
#include "plugin/batch/batch_run.h"
#include "plugin/commands/automatic_scanner_command.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/printable.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

struct Settings {
  fs::path list;
  fs::path output_path;
  std::vector<int32_t> rows;
  bool run = true;
  BatchRunOptions batch;
};

fs::path OwnProgram() {
  std::error_code ec;
  fs::path path = fs::read_symlink("/proc/self/exe", ec);
  if (ec) throw UserError("/proc/self/exe", "cannot be read (" + ec.message() + ")", "Mount /proc");
  return path;
}

void CheckScannerLine(const std::vector<std::string>& arguments) {
  CheckArguments({"automatic_scanner", "", RunAutomaticScanner}, arguments);
}

// Places of the objects to scan.
std::vector<size_t> Chosen(const Settings& settings, const std::vector<BatchObject>& objects) {
  std::vector<size_t> chosen;
  for (size_t i = 0; i < objects.size() && settings.rows.empty(); ++i) chosen.push_back(i);
  for (const int32_t row : settings.rows) {
    if (row < 1 || static_cast<size_t>(row) > objects.size()) {
      throw CommandLineError(
          fmt::format("--rows: there is no object {}: the list has {}.", row, objects.size()));
    }
    const size_t place = static_cast<size_t>(row) - 1;
    if (std::find(chosen.begin(), chosen.end(), place) == chosen.end()) chosen.push_back(place);
  }
  return chosen;
}

std::string NameOf(const BatchObject& object) {
  return fmt::format("line {}: {}", object.line, Printable(object.workspace.string()));
}

// All objects as they are now.
class Entries {
 public:
  Entries(const Settings& settings, const std::vector<BatchObject>& objects, const Reporter& reporter)
      : settings_(settings), objects_(objects) {
    entries_.reserve(objects.size());
    for (const BatchObject& object : objects) {
      if (reporter.StopRequested()) throw Interrupted();
      entries_.push_back(MakeBatchEntry(object));
    }
  }

  void LookAgain(size_t place) { entries_[place] = MakeBatchEntry(objects_[place]); }
  void SetOutcome(size_t place, const BatchOutcome& outcome) { entries_[place].outcome = outcome; }
  void Write() const { WriteBatchPage(settings_.output_path, settings_.list.stem().string(), entries_); }
  const std::vector<BatchEntry>& get() const { return entries_; }

 private:
  const Settings& settings_;
  const std::vector<BatchObject>& objects_;
  std::vector<BatchEntry> entries_;
};

void PrintTable(const std::vector<BatchEntry>& entries, std::ostream& out) {
  out << '\n';
  for (const BatchEntry& entry : entries) {
    out << fmt::format("{:<10} {}", BatchStateName(entry.outcome.state), NameOf(entry.object));
    if (entry.record) out << fmt::format(" ({:.0f} s)", entry.record->wall_seconds);
    out << '\n';
    if (!entry.outcome.why.empty()) {
      std::string why = Printable(entry.outcome.why);
      std::replace(why.begin(), why.end(), '\n', ' ');
      out << "           " << why << '\n';
    }
  }
  out << CountEntries(entries) << '\n';
}

size_t CountState(const std::vector<BatchEntry>& entries, const std::vector<size_t>& chosen,
                  BatchState state) {
  return std::count_if(chosen.begin(), chosen.end(),
                       [&](size_t place) { return entries[place].outcome.state == state; });
}

void RunObjects(const Settings& settings, const std::vector<BatchObject>& objects,
                const std::vector<size_t>& chosen, Entries* entries, Reporter& reporter, std::ostream& out) {
  std::vector<size_t> sound;
  for (const size_t place : chosen) {
    if (objects[place].fault.empty()) sound.push_back(place);
  }
  size_t num_ended = 0;
  const auto on_event = [&](const BatchEvent& event) {
    const std::string name = NameOf(objects[event.object]);
    if (event.has_begun) {
      out << fmt::format("begins     {}\n", name) << std::flush;
    } else if (event.has_ended) {
      entries->LookAgain(event.object);
      entries->SetOutcome(event.object, event.outcome);
      out << fmt::format("{:<10} {}\n", BatchStateName(event.outcome.state), name) << std::flush;
      ++num_ended;
      reporter.Progress("objects", static_cast<int64_t>(num_ended), static_cast<int64_t>(sound.size()));
      // Of several processes that each scan some rows none knows all.
      if (settings.rows.empty()) entries->Write();
    } else {
      reporter.Debug(name + ": " + event.line);
    }
  };
  RunBatch(objects, sound, settings.batch, on_event, [&] { return reporter.StopRequested(); });
}

// Throws what gives the exit code, unless all that were chosen are done and sound.
void RequireAllDone(const Settings& settings, const std::vector<BatchEntry>& entries,
                    const std::vector<size_t>& chosen) {
  const size_t num_failed =
      CountState(entries, chosen, BatchState::kFailed) + CountState(entries, chosen, BatchState::kWrong);
  if (num_failed > 0) {
    throw UserError(settings.list, fmt::format("{} of {} objects have failed", num_failed, chosen.size()),
                    "The table says why; mend them and give the same command again");
  }
  // Whoever waits for them must not take them for done.
  const size_t num_elsewhere = CountState(entries, chosen, BatchState::kRunning);
  if (num_elsewhere > 0) {
    throw UserError(settings.list,
                    fmt::format("other processes work on {} of {} objects", num_elsewhere, chosen.size()),
                    "Give the same command again when they are done");
  }
  const size_t num_doubtful = CountState(entries, chosen, BatchState::kDoubtful);
  if (num_doubtful > 0) {
    throw DoubtfulResult(
        fmt::format("{} of {} objects are doubtful: the table says why.", num_doubtful, chosen.size()));
  }
}

void DeclareOptions(CommandContext& context, Settings* settings) {
  Options& options = context.Declare(
      "Scans many objects, each by automatic_scanner in a process of its own. The list is a CSV file whose "
      "first line is `images,workspace,options`: the folder of an object's photos, or a video, the folder of "
      "its scan (both relative to the list's), and options of automatic_scanner. A row that is wrong is "
      "named with its line, and the others run. Ends with a table that says done, doubtful or failed and "
      "why, and writes "
      "index.html, one page with a link to each report, and batch.json. Given again, it goes on where it "
      "was: what is done is skipped. Each workspace keeps s2gs/batch.log. Exit code 1 when an object has "
      "failed, 3 when one is doubtful and none has failed.",
      "--list objects.csv --jobs 2");
  options.Add("list", &settings->list, "the list of objects").Required();
  options.Add("output_path", &settings->output_path,
              "folder of index.html and batch.json; empty: the list's name without its ending");
  options.Add("rows", &settings->rows,
              "scan these objects of the list alone, counted from 1, and leave index.html as it is, as the "
              "tasks of a cluster's array do; empty: all");
  options.Add("run", &settings->run, "0: scan nothing, only look at how far all are");
  auto batch = options.Fields(&settings->batch);
  batch.Add("jobs", &BatchRunOptions::jobs, "objects at the same time, which share the cores");
  batch.Add("gpus", &BatchRunOptions::gpus,
            "numbers of the GPUs that the jobs take in turn; empty: the one that each job finds");
}

}  // namespace

void RunScanBatch(CommandContext& context) {
  Settings settings;
  DeclareOptions(context, &settings);
  Reporter& reporter = context.Parse();
  settings.batch.program = OwnProgram();
  if (settings.output_path.empty()) settings.output_path = fs::path(settings.list).replace_extension();
  if (settings.output_path == settings.list) settings.output_path += "_scans";

  const std::vector<BatchObject> objects =
      ReadBatchList(settings.list, [&](const std::vector<std::string>& line) {
        if (reporter.StopRequested()) throw Interrupted();
        CheckScannerLine(line);
      });
  const std::vector<size_t> chosen = Chosen(settings, objects);
  if (settings.rows.empty()) RequireNoOtherPage(settings.output_path);
  for (const size_t place : chosen) {
    if (objects[place].fault.empty()) continue;
    reporter.Warn(
        fmt::format("{}, line {}: {}", settings.list.string(), objects[place].line, objects[place].fault));
  }
  Entries entries(settings, objects, reporter);
  if (settings.run) {
    try {
      RunObjects(settings, objects, chosen, &entries, reporter, context.out());
    } catch (const Interrupted&) {
      for (const size_t place : chosen) entries.LookAgain(place);
      if (settings.rows.empty()) entries.Write();
      PrintTable(entries.get(), context.out());
      throw;
    }
  }
  if (settings.rows.empty()) entries.Write();
  std::vector<BatchEntry> shown;
  shown.reserve(chosen.size());
  for (const size_t place : chosen) shown.push_back(entries.get()[place]);
  PrintTable(shown, context.out());
  if (settings.rows.empty()) {
    context.out() << "written          " << (settings.output_path / "index.html").string() << '\n';
  }
  if (settings.run) RequireAllDone(settings, entries.get(), chosen);
}

}  // namespace s2gs
