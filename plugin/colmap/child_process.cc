#include "plugin/colmap/child_process.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <utility>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

using Clock = std::chrono::steady_clock;

constexpr size_t kMaxLineLength = 4096;
constexpr int kPollMs = 50;

class FileDescriptor {
 public:
  explicit FileDescriptor(int fd = -1) : fd_(fd) {}
  FileDescriptor(FileDescriptor&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  FileDescriptor& operator=(FileDescriptor&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  FileDescriptor(const FileDescriptor&) = delete;
  FileDescriptor& operator=(const FileDescriptor&) = delete;
  ~FileDescriptor() { Close(); }

  int get() const { return fd_; }
  bool IsOpen() const { return fd_ >= 0; }
  void Close() {
    if (fd_ >= 0) ::close(fd_);
    fd_ = -1;
  }

 private:
  int fd_;
};

struct Pipe {
  FileDescriptor read_end;
  FileDescriptor write_end;
};

[[noreturn]] void ThrowCannotStart(const std::string& program, int error) {
  throw UserError(program, std::string("cannot be started (") + std::strerror(error) + ")",
                  "Check the path, that the file may be executed, and the system's limits");
}

Pipe MakePipe(const std::string& program) {
  std::array<int, 2> ends{};
  if (::pipe2(ends.data(), O_CLOEXEC) != 0) ThrowCannotStart(program, errno);
  return {FileDescriptor(ends[0]), FileDescriptor(ends[1])};
}

// Cuts a stream into lines.
class LineSplitter {
 public:
  explicit LineSplitter(const std::function<void(const ChildOutput&)>& on_output) : on_output_(on_output) {}

  void Add(std::string_view bytes) {
    for (const char c : bytes) {
      if (c == '\n' || c == '\r') {
        Flush();
      } else if (line_.size() < kMaxLineLength) {
        line_ += c;
      }
    }
    if (!line_.empty()) on_output_({line_, false});
  }

  void Flush() {
    if (!line_.empty()) on_output_({line_, true});
    line_.clear();
  }

 private:
  const std::function<void(const ChildOutput&)>& on_output_;
  std::string line_;
};

// Reads what is there now, closing the descriptor at the stream's end.
// Returns whether there may be more.
bool ReadSome(FileDescriptor& fd, LineSplitter& splitter) {
  std::array<char, 65536> buffer{};
  const ssize_t size = ::read(fd.get(), buffer.data(), buffer.size());
  if (size > 0) {
    splitter.Add({buffer.data(), static_cast<size_t>(size)});
    return true;
  }
  if (size < 0 && (errno == EAGAIN || errno == EINTR)) return false;
  fd.Close();
  return false;
}

// A started program and its group. Kills and reaps them when it is left by an exception.
class Group {
 public:
  explicit Group(pid_t pid) : pid_(pid) {}
  Group(const Group&) = delete;
  Group& operator=(const Group&) = delete;
  ~Group() {
    if (pid_ > 0) Reap();
  }

  void Signal(int signal) const { ::kill(-pid_, signal); }

  bool HasEnded() const {
    siginfo_t info{};
    return ::waitid(P_PID, static_cast<id_t>(pid_), &info, WEXITED | WNOHANG | WNOWAIT) == 0 &&
           info.si_pid == pid_;
  }

  // The leader is reaped last: until then no other group can have its number.
  ChildExit Reap() {
    Signal(SIGKILL);
    int status = 0;
    rusage usage = {};
    while (::wait4(pid_, &status, 0, &usage) < 0 && errno == EINTR) {
    }
    pid_ = -1;
    ChildExit result;
    for (const timeval& time : {usage.ru_utime, usage.ru_stime}) {
      result.cpu_seconds += static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
    }
    if (WIFEXITED(status)) result.exit_code = WEXITSTATUS(status);
    if (WIFSIGNALED(status)) result.signal = WTERMSIG(status);
    return result;
  }

 private:
  pid_t pid_;
};

// What execve takes: pointers into strings that outlive it.
std::vector<char*> Pointers(std::vector<std::string>& strings) {
  std::vector<char*> pointers;
  pointers.reserve(strings.size() + 1);
  for (std::string& text : strings) pointers.push_back(text.data());
  pointers.push_back(nullptr);
  return pointers;
}

std::vector<std::string> Environment(const std::vector<std::pair<std::string, std::string>>& changes) {
  std::vector<std::string> environment;
  for (char** entry = environ; *entry != nullptr; ++entry) {
    const std::string_view text = *entry;
    const auto is_changed = [&](const auto& change) {
      return text.substr(0, text.find('=')) == change.first;
    };
    if (std::none_of(changes.begin(), changes.end(), is_changed)) environment.emplace_back(text);
  }
  for (const auto& [name, value] : changes)
    environment.push_back(std::string(name).append("=").append(value));
  return environment;
}

// Runs in the new process, where only async-signal-safe calls are allowed.
[[noreturn]] void BecomeProgram(char* const* argv, char* const* envp, int null_fd, int out_fd, int err_fd,
                                int error_fd, pid_t parent) {
  ::setpgid(0, 0);
  ::prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (::getppid() != parent) ::_exit(127);
  for (const int signal : {SIGINT, SIGTERM, SIGQUIT, SIGHUP, SIGPIPE, SIGCHLD, SIGXFSZ})
    ::signal(signal, SIG_DFL);
  sigset_t none;
  ::sigemptyset(&none);
  ::sigprocmask(SIG_SETMASK, &none, nullptr);
  if (::dup2(null_fd, STDIN_FILENO) >= 0 && ::dup2(out_fd, STDOUT_FILENO) >= 0 &&
      ::dup2(err_fd, STDERR_FILENO) >= 0) {
    ::execve(argv[0], argv, envp);
  }
  const int error = errno;
  [[maybe_unused]] const ssize_t written = ::write(error_fd, &error, sizeof(error));
  ::_exit(127);
}

}  // namespace

ChildExit RunChild(const ChildCommand& command, const StopGrace& grace,
                   const std::function<void(const ChildOutput&)>& on_output,
                   const std::function<bool()>& stop_requested) {
  S2GS_INVARIANT(!command.arguments.empty());
  const std::string& program = command.arguments.front();
  std::vector<std::string> arguments = command.arguments;
  std::vector<std::string> environment = Environment(command.environment);
  const std::vector<char*> argv = Pointers(arguments);
  const std::vector<char*> envp = Pointers(environment);
  const FileDescriptor null_file(::open("/dev/null", O_RDONLY | O_CLOEXEC));
  if (!null_file.IsOpen()) ThrowCannotStart(program, errno);
  Pipe out = MakePipe(program);
  Pipe err = MakePipe(program);
  Pipe start_error = MakePipe(program);

  const pid_t parent = ::getpid();
  const pid_t pid = ::fork();
  if (pid < 0) ThrowCannotStart(program, errno);
  if (pid == 0) {
    BecomeProgram(argv.data(), envp.data(), null_file.get(), out.write_end.get(), err.write_end.get(),
                  start_error.write_end.get(), parent);
  }
  Group group(pid);
  ::setpgid(pid, pid);  // also here, so that signals sent from now on reach it
  out.write_end.Close();
  err.write_end.Close();
  start_error.write_end.Close();
  int error = 0;
  if (::read(start_error.read_end.get(), &error, sizeof(error)) == sizeof(error)) {
    ThrowCannotStart(program, error);
  }

  struct Stream {
    FileDescriptor& fd;
    LineSplitter splitter;
  };
  std::array<Stream, 2> streams = {Stream{out.read_end, LineSplitter(on_output)},
                                   Stream{err.read_end, LineSplitter(on_output)}};
  for (const Stream& stream : streams) ::fcntl(stream.fd.get(), F_SETFL, O_NONBLOCK);

  int next_signal = SIGINT;
  Clock::time_point signal_at = Clock::time_point::max();
  bool is_stopping = false;
  while (!group.HasEnded()) {
    std::array<pollfd, 2> polled{};
    for (size_t i = 0; i < streams.size(); ++i) polled[i] = {streams[i].fd.get(), POLLIN, 0};
    ::poll(polled.data(), polled.size(), kPollMs);
    for (size_t i = 0; i < streams.size(); ++i) {
      if (polled[i].revents != 0) ReadSome(streams[i].fd, streams[i].splitter);
    }
    if (!is_stopping && stop_requested()) {
      is_stopping = true;
      signal_at = Clock::now();
    }
    if (is_stopping && Clock::now() >= signal_at) {
      group.Signal(next_signal);
      signal_at = Clock::now() + (next_signal == SIGINT ? grace.after_interrupt : grace.after_terminate);
      next_signal = next_signal == SIGINT ? SIGTERM : SIGKILL;
    }
  }
  // What it left running would go on writing into the pipes.
  group.Signal(SIGKILL);
  for (Stream& stream : streams) {
    while (stream.fd.IsOpen() && ReadSome(stream.fd, stream.splitter)) {
    }
    stream.splitter.Flush();
  }
  const ChildExit result = group.Reap();
  if (is_stopping) throw Interrupted();
  return result;
}

}  // namespace s2gs
