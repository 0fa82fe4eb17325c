#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "plugin/colmap/child_process.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// One option of a COLMAP command, under the name of the newest COLMAP or any earlier one, without dashes.
struct ColmapOption {
  std::string name;
  std::string value;
  bool is_required = true;  ///< false: left out where this COLMAP does not have it.
};

/// A file or folder that a COLMAP command promises.
struct ColmapOutput {
  std::filesystem::path path;
  /// Whether it may stay as it was, like a database in which everything is done already.
  bool may_be_unchanged = false;
};

struct ColmapCommand {
  std::string command;  ///< e.g. "feature_extractor".
  std::vector<ColmapOption> options;
  std::vector<ColmapOutput> outputs;
};

/// A command that was ended by a signal: it crashed, was killed, or ran into a limit of the system.
class ColmapKilled : public UserError {
 public:
  using UserError::UserError;
};

/// How long COLMAP may take or be silent.
struct ColmapPatience {
  StopGrace stop;
  std::chrono::milliseconds answer{60000};   ///< to `colmap help` and `-h`, which take a second.
  std::chrono::milliseconds silence{60000};  ///< until it is said that it is silent; again at each doubling.
};

/// Progress as read from one line of COLMAP's output.
struct ColmapProgress {
  std::string_view task;
  int64_t done = 0;
  int64_t total = 0;  ///< 0: unknown.
  bool operator==(const ColmapProgress& other) const {
    return task == other.task && done == other.done && total == other.total;
  }
};

/// Recognises the progress lines of COLMAP 3.8 to 4.2, with or without a log prefix.
std::optional<ColmapProgress> ParseColmapProgress(std::string_view line);

/// The `colmap` executable of whatever version is installed.
class ColmapProgram {
 public:
  /// Finds the executable and asks for its version.
  /// \param colmap_path  the executable, or a folder that it lies in; empty: it is searched for on PATH.
  /// Throws UserError that says what to install when there is none or it does not run.
  static ColmapProgram Find(const std::filesystem::path& colmap_path, Reporter& reporter,
                            const ColmapPatience& patience = {});

  const std::filesystem::path& path() const { return path_; }
  const std::string& version() const { return version_; }  ///< e.g. "3.8" or "4.2.1".
  /// Whether it was built with CUDA. Without, feature extraction and matching on the GPU need a display, and
  /// dense stereo does not work.
  bool has_cuda() const { return has_cuda_; }
  bool HasCommand(const std::string& command) const { return commands_.count(command) > 0; }

  /// How this version spells an option of a command; nothing when it has no such option. Asks the executable
  /// once per command.
  /// \param name  in the spelling of any version, e.g. "FeatureExtraction.use_gpu".
  std::optional<std::string> SpellingOf(const std::string& command, const std::string& name,
                                        Reporter& reporter);

  /// Runs a command to its end, hands its output to the reporter (lines as debug messages, progress as such)
  /// and checks that its outputs were written.
  /// Warns when it prints nothing for a minute. Throws Interrupted when the reporter asks to stop, and
  /// UserError (ColmapKilled when a signal ended it) with the command line, how it ended and the last lines
  /// of its output when it fails or an output is missing, empty or unchanged.
  void Run(const ColmapCommand& command, Reporter& reporter);

 private:
  ColmapProgram(std::filesystem::path path, const ColmapPatience& patience)
      : path_(std::move(path)), patience_(patience) {}

  struct Ended {
    ChildExit exit;
    std::vector<std::string> lines;
  };
  Ended Ask(const std::vector<std::string>& arguments, Reporter& reporter) const;
  const std::set<std::string>& OptionsOf(const std::string& command, Reporter& reporter);

  std::filesystem::path path_;
  ColmapPatience patience_;
  std::string version_;
  bool has_cuda_ = false;
  std::set<std::string> commands_;
  std::map<std::string, std::set<std::string>> options_of_command_;
};

}  // namespace s2gs
