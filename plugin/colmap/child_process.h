#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace s2gs {

struct ChildCommand {
  std::vector<std::string> arguments;  ///< the first is the path of the program, which is not searched for.
  std::vector<std::pair<std::string, std::string>> environment;  ///< set on top of this process's own.
};

/// How a program ended: with an exit code, or by a signal.
struct ChildExit {
  int exit_code = -1;      ///< -1 when it was ended by a signal.
  int signal = 0;          ///< 0 when it exited by itself.
  double cpu_seconds = 0;  ///< of the program and of those that it waited for.
  bool Succeeded() const { return exit_code == 0; }
};

/// How long a program that is asked to stop has until it is asked less politely.
struct StopGrace {
  std::chrono::milliseconds after_interrupt{5000};
  std::chrono::milliseconds after_terminate{5000};
};

/// A piece of what a program prints, of either of its two streams.
struct ChildOutput {
  std::string_view line;  ///< without its end; what exceeds 4096 characters is cut off.
  /// False for a line that has not ended yet: it comes again when there is more of it. Lines end with a line
  /// feed or, where a program rewrites its line, with a carriage return.
  bool is_complete = true;
};

/// Runs a program without a shell, in a process group of its own, with nothing to read on its standard input,
/// until it ends. Whatever it leaves running in its group is killed. Should this process be killed, the
/// program is ended too.
/// \param on_output       called for each line as it comes; what it throws kills the program.
/// \param stop_requested  polled about 20 times a second. Once true, the group gets SIGINT, then SIGTERM,
///                        then SIGKILL; Interrupted is thrown when it has ended, however it ended.
/// Throws UserError when the program cannot be started.
ChildExit RunChild(const ChildCommand& command, const StopGrace& grace,
                   const std::function<void(const ChildOutput&)>& on_output,
                   const std::function<bool()>& stop_requested);

}  // namespace s2gs
