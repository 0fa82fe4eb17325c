#pragma once

#include <functional>
#include <string>
#include <vector>

namespace s2gs {

/// How a process ended and what it printed.
struct ProcessResult {
  int exit_code = -1;  ///< 128 + signal when a signal ended it.
  std::string out;
  std::string err;
};

/// Runs a program to its end. \param stdout_path  where its standard output goes instead of `out`.
ProcessResult RunProcess(const std::vector<std::string>& command, const std::string& stdout_path = "");

/// A child process that runs `work` and exits with what it returns.
class ChildProcess {
 public:
  /// \param work  gets a function that tells the parent's WaitUntilReady() to return; may call it often.
  explicit ChildProcess(const std::function<int(const std::function<void()>& say_ready)>& work);
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;
  ~ChildProcess();

  /// Waits for the next ready call. Returns false when the child ended without one.
  bool WaitUntilReady();
  void Signal(int signal) const;
  /// Waits for its end; exit code or 128 + signal.
  int Wait();

 private:
  int pid_ = -1;
  int ready_fd_ = -1;
};

}  // namespace s2gs
