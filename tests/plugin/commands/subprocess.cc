#include "tests/plugin/commands/subprocess.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>

namespace s2gs {
namespace {

constexpr int kCannotRun = 127;

int ExitCodeOf(int pid) {
  int status = 0;
  while (::waitpid(pid, &status, 0) < 0) {
    if (errno != EINTR) return -1;
  }
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

}  // namespace

ProcessResult RunProcess(const std::vector<std::string>& command, const std::string& stdout_path) {
  int out[2];
  int err[2];
  if (::pipe(out) != 0 || ::pipe(err) != 0) return {};
  const pid_t pid = ::fork();
  if (pid == 0) {
    const int stdout_fd = stdout_path.empty() ? out[1] : ::open(stdout_path.c_str(), O_WRONLY);
    ::dup2(stdout_fd, STDOUT_FILENO);
    ::dup2(err[1], STDERR_FILENO);
    for (const int fd : {out[0], out[1], err[0], err[1]}) ::close(fd);
    std::vector<char*> arguments;
    for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    ::execv(arguments[0], arguments.data());
    ::_exit(kCannotRun);
  }
  ::close(out[1]);
  ::close(err[1]);
  ProcessResult result;
  struct pollfd streams[2] = {{out[0], POLLIN, 0}, {err[0], POLLIN, 0}};
  for (int num_open = 2; num_open > 0;) {
    if (::poll(streams, 2, -1) < 0 && errno != EINTR) break;
    for (int i = 0; i < 2; ++i) {
      if (streams[i].fd < 0 || streams[i].revents == 0) continue;
      char buffer[4096];
      const ssize_t count = ::read(streams[i].fd, buffer, sizeof(buffer));
      if (count > 0) {
        (i == 0 ? result.out : result.err).append(buffer, static_cast<size_t>(count));
      } else if (count == 0 || errno != EINTR) {
        ::close(streams[i].fd);
        streams[i].fd = -1;
        --num_open;
      }
    }
  }
  result.exit_code = ExitCodeOf(pid);
  return result;
}

ChildProcess::ChildProcess(const std::function<int(const std::function<void()>&)>& work) {
  int ends[2];
  if (::pipe(ends) != 0) return;
  pid_ = ::fork();
  if (pid_ == 0) {
    ::close(ends[0]);
    const auto say_ready = [&] {
      const char byte = 1;
      if (::write(ends[1], &byte, 1) != 1) ::_exit(kCannotRun);
    };
    ::_exit(work(say_ready));
  }
  ::close(ends[1]);
  ready_fd_ = ends[0];
}

ChildProcess::~ChildProcess() {
  if (pid_ > 0) {
    Signal(SIGKILL);
    Wait();
  }
  ::close(ready_fd_);
}

bool ChildProcess::WaitUntilReady() {
  char byte = 0;
  ssize_t count = 0;
  do {
    count = ::read(ready_fd_, &byte, 1);
  } while (count < 0 && errno == EINTR);
  return count == 1;
}

void ChildProcess::Signal(int signal) const { ::kill(pid_, signal); }

int ChildProcess::Wait() {
  const int code = ExitCodeOf(pid_);
  pid_ = -1;
  return code;
}

}  // namespace s2gs
