#pragma once

namespace s2gs {

/// Makes SIGINT (Ctrl-C) and SIGTERM ask the running command to stop: StopRequested() of the program's
/// reporter then returns true. A second one ends the process at once with exit code 130. Signals that the
/// caller had ignored (as nohup and shells without job control do) stay ignored. Also turns SIGXFSZ, the
/// signal of a file size limit, into an ordinary write error.
void InstallSignalHandlers();

/// True once SIGINT or SIGTERM came.
bool InterruptRequested();

}  // namespace s2gs
