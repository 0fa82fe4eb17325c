#include "plugin/cli/interrupt.h"

#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <initializer_list>

namespace s2gs {
namespace {

constexpr int kExitInterruptedAtOnce = 130;

std::atomic<bool> interrupt_requested{false};
static_assert(std::atomic<bool>::is_always_lock_free, "a signal handler may not wait");

// Only what POSIX allows in a signal handler.
void OnInterrupt(int /*signal*/) {
  if (interrupt_requested.exchange(true)) ::_exit(kExitInterruptedAtOnce);
  const int error = errno;
  constexpr char kNotice[] = "\ns2gs: stopping at the next safe point; once more ends it at once\n";
  // Nothing can be done here when the notice cannot be written.
  [[maybe_unused]] const ssize_t written = ::write(STDERR_FILENO, kNotice, sizeof(kNotice) - 1);
  errno = error;
}

}  // namespace

void InstallSignalHandlers() {
  struct sigaction action = {};
  action.sa_handler = OnInterrupt;
  action.sa_flags = SA_RESTART;
  sigemptyset(&action.sa_mask);
  for (const int signal : {SIGINT, SIGTERM}) {
    struct sigaction old = {};
    if (::sigaction(signal, nullptr, &old) == 0 && old.sa_handler != SIG_IGN) {
      ::sigaction(signal, &action, nullptr);
    }
  }
  ::signal(SIGXFSZ, SIG_IGN);
}

bool InterruptRequested() { return interrupt_requested.load(); }

}  // namespace s2gs
