#pragma once

#include <functional>
#include <memory>
#include <ostream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#include "plugin/cli/options.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// How the message of a command that fails begins, which is the last that it prints.
constexpr std::string_view kErrorMark = "s2gs: error: ";

/// What a command works with: it declares its options, parses them, and then has a reporter.
///
///     void RunTsdfMesher(CommandContext& context) {
///       std::filesystem::path workspace_path;
///       Options& options = context.Declare("Fuses depth maps into a mesh.", "--workspace_path scan");
///       options.Add("workspace_path", &workspace_path, "the workspace").Required();
///       Reporter& reporter = context.Parse();
///       ...
///     }
class CommandContext {
 public:
  /// \param arguments  the words after the command's name.
  /// \param out        where results go that the user asked to see; the standard output in the program.
  CommandContext(std::string name, std::vector<std::string> arguments, std::ostream& out);
  ~CommandContext();
  CommandContext(const CommandContext&) = delete;
  CommandContext& operator=(const CommandContext&) = delete;

  /// Called first, once. \param summary  one or two sentences. \param example  a typical command's arguments.
  Options& Declare(const std::string& summary, const std::string& example);

  /// Called when all options are bound: see Options::Parse for what it throws. The reporter logs to the
  /// standard error stream at the level asked for and knows of Ctrl-C; it lives as long as the context.
  /// \param check  of what options must fulfil together; throws CommandLineError. A part of CheckArguments().
  Reporter& Parse(const std::function<void()>& check = {});

  Options& options() { return *options_; }
  std::ostream& out() { return out_; }

 private:
  friend void CheckArguments(const struct Command& command, const std::vector<std::string>& arguments);

  std::string name_;
  std::vector<std::string> arguments_;
  bool parses_only_ = false;
  std::ostream& out_;
  std::unique_ptr<Options> options_;
  std::unique_ptr<Reporter> reporter_;
};

/// One line of the command table. `run` returns when the promised output exists, else it throws UserError,
/// CommandLineError, DoubtfulResult or Interrupted.
struct Command {
  std::string name;
  std::string summary;  ///< one line for `s2gs help`.
  void (*run)(CommandContext& context);
};

/// Thrown where going on would spend minutes on what is doubtful or has failed; the message says why, and how
/// to go on all the same.
class DoubtfulResult : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Parses a command's arguments as the command does, and runs nothing of it. Throws like Options::Parse.
void CheckArguments(const Command& command, const std::vector<std::string>& arguments);

/// Exit codes of the program.
enum ExitCode : int {
  kExitDone = 0,           ///< the promised output exists.
  kExitUserError = 1,      ///< something the user can mend: a file, the disk, the data.
  kExitCommandLine = 2,    ///< an unknown command or a wrong option.
  kExitDoubtful = 3,       ///< what was done is kept, but it is not worth going on from without a look.
  kExitInterrupted = 130,  ///< stopped by Ctrl-C or SIGTERM; the same command goes on.
                           ///< 134 (abort) is a defect in s2gs.
};

/// Runs the program: `arguments` are the words after its name. Prints results and help to the standard
/// output, everything else to the standard error stream, and returns the exit code.
int RunProgram(const std::vector<Command>& commands, const std::vector<std::string>& arguments);

/// The commands of this build, by name.
const std::vector<Command>& AllCommands();

}  // namespace s2gs
