#include "plugin/cli/command.h"

#include <algorithm>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <iostream>
#include <new>
#include <sstream>
#include <utility>

#include "plugin/cli/console_reporter.h"
#include "plugin/cli/interrupt.h"
#include "plugin/cli/suggest.h"
#include "plugin/cli/version.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/printable.h"

namespace s2gs {
namespace {

constexpr char kExitCodes[] =
    "Exit codes:\n"
    "    0  done: the promised output exists\n"
    "    1  a file, the disk or the data is at fault: the message names it and says what to do\n"
    "    2  unknown command, or an option that is unknown, missing or out of bounds\n"
    "    3  automatic_scanner stopped before training: the poses are doubtful or have failed (--force 1 goes "
    "on);\n"
    "       scan_batch: so did an object's\n"
    "  130  stopped by Ctrl-C or SIGTERM: the same command goes on where it stopped\n"
    "  134  a defect in s2gs\n";

std::string ProgramHelp(const std::vector<Command>& commands) {
  size_t width = std::string("help").size();
  for (const Command& command : commands) width = std::max(width, command.name.size());
  const auto line = [&](const std::string& name, const std::string& summary) {
    return "  " + name + std::string(width + 2 - name.size(), ' ') + summary + "\n";
  };
  std::string text = VersionText() +
                     "\nTurntable scanning for COLMAP: from photos to a clean mesh, without masks.\n\n"
                     "Usage:\n  s2gs COMMAND [options]\n"
                     "  s2gs COMMAND -h        its options and groups of options (or s2gs help COMMAND)\n"
                     "  s2gs COMMAND --help    all of its options\n"
                     "  s2gs --version\n\nCommands:\n";
  for (const Command& command : commands) text += line(command.name, command.summary);
  text += line("help", "lists the commands, or explains one");
  return text + "\n" + kExitCodes;
}

const Command& FindCommand(const std::vector<Command>& commands, const std::string& name) {
  std::vector<std::string> names;
  for (const Command& command : commands) {
    if (command.name == name) return command;
    names.push_back(command.name);
  }
  names.emplace_back("help");
  std::string message = "unknown command " + name + ".";
  const std::vector<std::string> nearest = NearestWords(name, names);
  for (size_t i = 0; i < nearest.size(); ++i) message += (i == 0 ? " Did you mean " : " or ") + nearest[i];
  if (!nearest.empty()) message += "?";
  throw CommandLineError(message + "\nRun `s2gs help` for the list of commands.");
}

void Dispatch(const std::vector<Command>& commands, const std::vector<std::string>& arguments) {
  const auto is_help = [](const std::string& word) {
    return word == "help" || word == "-h" || word == "--help";
  };
  if (arguments.empty() || (arguments.size() == 1 && is_help(arguments[0]))) {
    std::cout << ProgramHelp(commands);
    return;
  }
  if (arguments[0] == "--version" || arguments[0] == "-v" || arguments[0] == "version") {
    std::cout << VersionText() << "\n" << GpuText();
    return;
  }
  const bool asks_help = is_help(arguments[0]);
  const Command& command = FindCommand(commands, arguments[asks_help ? 1 : 0]);
  std::vector<std::string> rest(arguments.begin() + (asks_help ? 2 : 1), arguments.end());
  if (asks_help) rest.insert(rest.begin(), arguments[0] == "--help" ? "--help" : "-h");
  CommandContext context(command.name, rest, std::cout);
  try {
    command.run(context);
  } catch (const HelpRequested& help) {
    std::cout << help.what();
  } catch (const CommandLineError& error) {
    throw CommandLineError(std::string(error.what()) + "\nRun `s2gs " + command.name +
                           " -h` for its options.");
  }
}

// Ends a command after its arguments.
struct ArgumentsAccepted {};

int Complain(const std::string& message, ExitCode code) {
  std::cout.flush();
  std::cerr << kErrorMark << Printable(message) << std::endl;
  return code;
}

}  // namespace

CommandContext::CommandContext(std::string name, std::vector<std::string> arguments, std::ostream& out)
    : name_(std::move(name)), arguments_(std::move(arguments)), out_(out) {}

CommandContext::~CommandContext() = default;

Options& CommandContext::Declare(const std::string& summary, const std::string& example) {
  S2GS_INVARIANT(options_ == nullptr);
  options_ = std::make_unique<Options>(name_, summary, example);
  return *options_;
}

Reporter& CommandContext::Parse(const std::function<void()>& check) {
  options_->Parse(arguments_);
  if (check) check();
  if (parses_only_) throw ArgumentsAccepted();
  reporter_ = std::make_unique<ConsoleReporter>(options_->log_level());
  return *reporter_;
}

void CheckArguments(const Command& command, const std::vector<std::string>& arguments) {
  std::ostringstream unused;
  CommandContext context(command.name, arguments, unused);
  context.parses_only_ = true;
  try {
    command.run(context);
  } catch (const ArgumentsAccepted&) {
  }
}

int RunProgram(const std::vector<Command>& commands, const std::vector<std::string>& arguments) {
  InstallSignalHandlers();
  try {
    Dispatch(commands, arguments);
    std::cout.flush();
    if (!std::cout) return Complain("the standard output cannot be written completely", kExitUserError);
    return kExitDone;
  } catch (const CommandLineError& error) {
    return Complain(error.what(), kExitCommandLine);
  } catch (const UserError& error) {
    return Complain(error.what(), kExitUserError);
  } catch (const DoubtfulResult& result) {
    return Complain(result.what(), kExitDoubtful);
  } catch (const Interrupted&) {
    return Complain("stopped as asked. What was finished is kept: the same command goes on from there.",
                    kExitInterrupted);
  } catch (const std::filesystem::filesystem_error& error) {
    return Complain(error.what(), kExitUserError);
  } catch (const std::bad_alloc&) {
    return Complain("out of memory. Close other programs, or use smaller images or fewer of them.",
                    kExitUserError);
  } catch (const std::exception& error) {
    Complain(std::string(error.what()) + "\nThis is a defect in s2gs: please report it.", kExitUserError);
    std::abort();
  }
}

}  // namespace s2gs
