#include "plugin/colmap/colmap_process.h"

#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <csignal>
#include <cstring>
#include <deque>
#include <system_error>
#include <utility>

#include "plugin/cli/shell_quote.h"
#include "plugin/colmap/find_executable.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr char kInstallRemedy[] =
    "Install COLMAP 3.8 or newer (on Debian: apt install colmap), or name its executable with --colmap_path";
constexpr size_t kTailLines = 20;
constexpr size_t kMaxHelpLines = 10000;

using Clock = std::chrono::steady_clock;

// Reads a decimal number at the front of `text` and removes it.
std::optional<int64_t> TakeNumber(std::string_view* text) {
  int64_t value = 0;
  const auto [end, error] = std::from_chars(text->data(), text->data() + text->size(), value);
  if (error != std::errc() || value < 0 || value > 1'000'000'000) return std::nullopt;
  text->remove_prefix(static_cast<size_t>(end - text->data()));
  return value;
}

bool TakeText(std::string_view* text, std::string_view expected) {
  if (text->substr(0, expected.size()) != expected) return false;
  text->remove_prefix(expected.size());
  return true;
}

// "3/100", also "3 / 100".
std::optional<std::pair<int64_t, int64_t>> TakeFraction(std::string_view* text) {
  const auto done = TakeNumber(text);
  if (!done || !(TakeText(text, "/") || TakeText(text, " / "))) return std::nullopt;
  const auto total = TakeNumber(text);
  if (!total || *done > *total) return std::nullopt;
  return std::pair(*done, *total);
}

struct FractionLine {
  std::string_view prefix;
  std::string_view task;
  bool is_at_end;  // printed when the unit is finished, not when it begins.
};
constexpr std::array<FractionLine, 8> kFractionLines = {{
    {"Processed file [", "extract features", true},
    {"Matching image [", "match pairs", false},
    {"Processing image [", "match pairs", false},
    {"Matching block [", "match pairs", false},
    {"Processing block [", "match pairs", false},
    {"Undistorting image [", "undistort images", false},
    {"Processing view ", "dense stereo", false},
    {"Fusing image [", "fuse depth maps", false},
}};

struct CountLine {
  std::string_view prefix;
  std::string_view task;
};
constexpr std::array<CountLine, 2> kCountLines = {{
    {"Registering image #", "register images"},
    {"Triangulating image #", "triangulate images"},
}};

// Groups and fields of options that COLMAP renamed, and that mean the same.
constexpr std::array<std::array<std::string_view, 3>, 2> kRenamedGroups = {{
    {"FeatureMatching", "TwoViewGeometry", "SiftMatching"},
    {"FeatureExtraction", "SiftExtraction", ""},
}};
constexpr std::array<std::array<std::string_view, 2>, 2> kRenamedWords = {{
    {"images_freq", "frames_freq"},
    {"images_ratio", "frames_ratio"},
}};

// Every spelling that an option ever had, its own first.
std::vector<std::string> SpellingsEver(const std::string& name) {
  std::vector<std::string> spellings = {name};
  const size_t dot = name.find('.');
  const std::string group = name.substr(0, dot);
  const std::string field = dot == std::string::npos ? "" : name.substr(dot + 1);
  for (const auto& groups : kRenamedGroups) {
    if (std::find(groups.begin(), groups.end(), group) == groups.end()) continue;
    for (const std::string_view other : groups) {
      if (!other.empty() && other != group) spellings.push_back(std::string(other) + "." + field);
    }
  }
  for (const auto& [older, newer] : kRenamedWords) {
    for (const auto& [from, to] : {std::pair(older, newer), std::pair(newer, older)}) {
      const size_t at = name.find(from);
      if (at != std::string::npos) spellings.push_back(std::string(name).replace(at, from.size(), to));
    }
  }
  return spellings;
}

// What changes when a file, or any file of a folder, is written.
struct OutputState {
  uint64_t num_files = 0;
  uint64_t num_bytes = 0;
  int64_t last_written_ns = 0;
  uint64_t inodes = 0;
  bool operator==(const OutputState& other) const {
    return num_files == other.num_files && num_bytes == other.num_bytes &&
           last_written_ns == other.last_written_ns && inodes == other.inodes;
  }
};

void AddFile(const fs::path& path, OutputState* state) {
  struct stat status {};
  if (::stat(path.c_str(), &status) != 0 || !S_ISREG(status.st_mode)) return;
  ++state->num_files;
  state->num_bytes += static_cast<uint64_t>(status.st_size);
  state->inodes += status.st_ino;
  state->last_written_ns = std::max<int64_t>(state->last_written_ns,
                                             status.st_mtim.tv_sec * 1'000'000'000 + status.st_mtim.tv_nsec);
}

OutputState StateOf(const fs::path& path) {
  OutputState state;
  std::error_code ec;
  if (!fs::is_directory(path, ec)) {
    AddFile(path, &state);
    return state;
  }
  for (fs::recursive_directory_iterator it(path, ec), end; !ec && it != end; it.increment(ec)) {
    AddFile(it->path(), &state);
  }
  return state;
}

std::string Describe(const ChildExit& exit) {
  if (exit.signal == 0) return "exit code " + std::to_string(exit.exit_code);
  return "ended by signal " + std::to_string(exit.signal) + " (" + ::strsignal(exit.signal) + ")";
}

}  // namespace

std::optional<ColmapProgress> ParseColmapProgress(std::string_view line) {
  for (const FractionLine& known : kFractionLines) {
    const size_t at = line.find(known.prefix);
    if (at == std::string_view::npos) continue;
    std::string_view rest = line.substr(at + known.prefix.size());
    const auto outer = TakeFraction(&rest);
    if (!outer) return std::nullopt;
    auto [done, total] = *outer;
    if (TakeText(&rest, ", ")) {
      // Blocks of a square: [row/n, column/n].
      const auto inner = TakeFraction(&rest);
      if (!inner || done < 1) return std::nullopt;
      done = (done - 1) * inner->second + inner->first;
      total *= inner->second;
    }
    // Without what follows, the last number may not be there as a whole yet.
    if (rest.empty() || total < 1) return std::nullopt;
    return ColmapProgress{known.task, known.is_at_end ? done : std::max<int64_t>(done - 1, 0), total};
  }
  for (const CountLine& known : kCountLines) {
    const size_t at = line.find(known.prefix);
    if (at == std::string_view::npos) continue;
    std::string_view rest = line.substr(at + known.prefix.size());
    if (!TakeNumber(&rest) || !TakeText(&rest, " (")) return std::nullopt;
    TakeText(&rest, "num_reg_frames=");
    const auto count = TakeNumber(&rest);
    if (!count || !TakeText(&rest, ")")) return std::nullopt;
    return ColmapProgress{known.task, *count, 0};
  }
  return std::nullopt;
}

ColmapProgram ColmapProgram::Find(const fs::path& colmap_path, Reporter& reporter,
                                  const ColmapPatience& patience) {
  ColmapProgram program(FindExecutable("colmap", colmap_path, "", kInstallRemedy), patience);
  const Ended help = program.Ask({"help"}, reporter);
  // "COLMAP 3.8 -- Structure-from-Motion ..." or "COLMAP 4.2.1 (Commit ... with CUDA)".
  bool is_in_commands = false;
  for (const std::string& line : help.lines) {
    const size_t at = line.find("COLMAP ");
    if (program.version_.empty() && at != std::string::npos) {
      const size_t begin = at + 7;
      program.version_ = line.substr(begin, line.find_first_not_of("0123456789.", begin) - begin);
    }
    if (line.find("with CUDA") != std::string::npos) program.has_cuda_ = true;
    const size_t first = line.find_first_not_of(' ');
    if (is_in_commands && first != std::string::npos) program.commands_.insert(line.substr(first));
    if (line.find("Available commands") != std::string::npos) is_in_commands = true;
  }
  if (!help.exit.Succeeded() || program.version_.empty() || program.commands_.empty()) {
    throw UserError(program.path_,
                    "does not answer `colmap help` as COLMAP does (" + Describe(help.exit) + ")" +
                        (help.lines.empty() ? "" : ": " + help.lines.back()),
                    kInstallRemedy);
  }
  return program;
}

ColmapProgram::Ended ColmapProgram::Ask(const std::vector<std::string>& arguments, Reporter& reporter) const {
  ChildCommand child{{path_.string()}, {{"QT_QPA_PLATFORM", "offscreen"}}};
  child.arguments.insert(child.arguments.end(), arguments.begin(), arguments.end());
  Ended ended;
  const Clock::time_point begin = Clock::now();
  bool is_late = false;
  try {
    ended.exit = RunChild(
        child, patience_.stop,
        [&](const ChildOutput& output) {
          if (output.is_complete && ended.lines.size() < kMaxHelpLines) ended.lines.emplace_back(output.line);
        },
        [&] {
          is_late = is_late || Clock::now() - begin > patience_.answer;
          return is_late || reporter.StopRequested();
        });
  } catch (const Interrupted&) {
    if (!is_late || reporter.StopRequested()) throw;
    throw UserError(
        path_,
        "does not answer `" + ShellQuoted(arguments) + "` within " +
            std::to_string(std::chrono::duration_cast<std::chrono::seconds>(patience_.answer).count()) +
            " seconds",
        kInstallRemedy);
  }
  return ended;
}

const std::set<std::string>& ColmapProgram::OptionsOf(const std::string& command, Reporter& reporter) {
  const auto known = options_of_command_.find(command);
  if (known != options_of_command_.end()) return known->second;
  std::set<std::string> options;
  const Ended help = Ask({command, "-h"}, reporter);
  for (const std::string& line : help.lines) {
    const size_t at = line.find("--");
    if (at == std::string::npos || line.find_first_not_of(' ') != at) continue;
    const size_t begin = at + 2;
    options.insert(line.substr(begin, line.find_first_of(" =", begin) - begin));
  }
  if (options.empty()) {
    throw UserError(path_,
                    "cannot be asked for the options of " + command + " (" + Describe(help.exit) + ")" +
                        (help.lines.empty() ? ", and prints nothing" : ": " + help.lines.back()),
                    "Check that `colmap " + command + " -h` works; if not, install COLMAP again");
  }
  return options_of_command_.emplace(command, std::move(options)).first->second;
}

std::optional<std::string> ColmapProgram::SpellingOf(const std::string& command, const std::string& name,
                                                     Reporter& reporter) {
  const std::set<std::string>& options = OptionsOf(command, reporter);
  for (std::string& spelling : SpellingsEver(name)) {
    if (options.count(spelling) > 0) return std::move(spelling);
  }
  return std::nullopt;
}

void ColmapProgram::Run(const ColmapCommand& command, Reporter& reporter) {
  const std::string command_name = "colmap " + command.command;
  if (!HasCommand(command.command)) {
    throw UserError(path_, "COLMAP " + version_ + " has no command \"" + command.command + "\"",
                    "Install another version of COLMAP, built with all its parts");
  }
  ChildCommand child{{path_.string(), command.command}, {{"QT_QPA_PLATFORM", "offscreen"}}};
  for (const ColmapOption& option : command.options) {
    // A project file makes COLMAP 3.8 ignore every other option.
    S2GS_INVARIANT(option.name != "project_path");
    const auto spelling = SpellingOf(command.command, option.name, reporter);
    if (!spelling && option.is_required) {
      throw UserError(path_,
                      "COLMAP " + version_ + " has no option --" + option.name + " for " + command.command,
                      "Install another version of COLMAP, or leave the option out");
    }
    if (!spelling) {
      reporter.Debug(command_name + " has no option --" + option.name + ": left out");
      continue;
    }
    child.arguments.push_back("--" + *spelling);
    child.arguments.push_back(option.value);
  }

  std::vector<OutputState> before;
  before.reserve(command.outputs.size());
  for (const ColmapOutput& output : command.outputs) before.push_back(StateOf(output.path));
  const std::string command_line = ShellQuoted(child.arguments);
  reporter.Debug(command_line);

  std::deque<std::string> tail;
  std::optional<ColmapProgress> progress;
  Clock::time_point heard = Clock::now();
  std::chrono::milliseconds patience = patience_.silence;
  const auto mind_silence = [&] {
    const auto silent = std::chrono::duration_cast<std::chrono::milliseconds>(Clock::now() - heard);
    if (silent < patience) return;
    reporter.Warn(command_name + " has printed nothing for " + std::to_string(silent.count() / 1000) +
                  " seconds. It may be busy (a large adjustment is silent for minutes) or stuck: `top` "
                  "tells. Ctrl-C stops "
                  "it; what was finished is kept");
    patience *= 2;
  };
  const ChildExit exit = RunChild(
      child, patience_.stop,
      [&](const ChildOutput& output) {
        heard = Clock::now();
        patience = patience_.silence;
        const auto now = ParseColmapProgress(output.line);
        if (now && !(progress && *now == *progress)) {
          progress = now;
          reporter.Progress(now->task, now->done, now->total);
        }
        if (!output.is_complete) return;
        reporter.Debug(output.line);
        tail.emplace_back(output.line);
        if (tail.size() > kTailLines) tail.pop_front();
      },
      [&] {
        mind_silence();
        return reporter.StopRequested();
      });

  const auto fail = [&](const std::string& problem) {
    std::string message = command_name + " " + problem + ".\nThe command was: " + command_line +
                          "\nHow it ended: " + Describe(exit) + "\nThe end of its output:";
    for (const std::string& line : tail) message += "\n  " + line;
    if (tail.empty()) message += " nothing";
    if (exit.signal == 0) throw UserError(message);
    if (exit.signal == SIGXFSZ)
      message += "\nA limit on file sizes ended it: `ulimit -f unlimited` raises it.";
    if (exit.signal == SIGKILL)
      message += "\nThe system kills what needs too much memory: smaller photos need less.";
    throw ColmapKilled(message);
  };
  if (!exit.Succeeded()) fail("failed");
  for (size_t i = 0; i < command.outputs.size(); ++i) {
    const ColmapOutput& output = command.outputs[i];
    const OutputState after = StateOf(output.path);
    if (after.num_bytes == 0) fail("did not write " + output.path.string() + ", though it did not complain");
    if (!output.may_be_unchanged && after == before[i]) {
      fail("left " + output.path.string() + " as it was, though it did not complain");
    }
  }
  if (progress && progress->total > 0 && progress->done < progress->total) {
    reporter.Progress(progress->task, progress->total, progress->total);
  }
}

}  // namespace s2gs
