"""The program's commands, with progress."""

import os
import re
import shutil
import signal
import subprocess
import tempfile

PROGRESS = re.compile(r"^\[[^\]]*\] ([^:]+): (\d+)/(\d+) \(")
FINISHED = re.compile(r"^\[[^\]]*\] ([^:]+): (\d+) in ")


class Failed(RuntimeError):
    """A command did not end well. exit_code as README.md lists them, -N for signal N; what it said is the message."""

    def __init__(self, exit_code, message):
        super().__init__(message)
        self.exit_code = exit_code


class PosesDoubtful(Failed):
    """Exit code 3: what was done is kept, but the poses are doubtful or have failed. force=1 goes on with them."""


class Interrupted(Failed):
    """Exit code 130: the same command goes on where it stopped."""


def arguments(options):
    """The words of a command line: True is 1, lists are joined by commas, None is left out."""
    words = []
    for name, value in options.items():
        if value is None:
            continue
        if isinstance(value, bool):
            value = int(value)
        elif isinstance(value, (list, tuple)):
            value = ",".join(str(item) for item in value)
        words += ["--" + name, os.fspath(value) if isinstance(value, os.PathLike) else str(value)]
    return words


def run(command, options=None, *, program=None, on_progress=None, on_line=None, **more):
    """Runs `s2gs COMMAND --OPTION VALUE ...` to its end and returns what it printed as its result.

    options, more   by name; names with a point, like "Train.num_iterations", in `options`.
    program         its path; None: the environment's S2GS, else "s2gs" on PATH.
    on_progress     called as on_progress(task, done, total) now and then during long tasks, and at their ends.
    on_line         called with each line of its log.

    Raises Failed, PosesDoubtful or Interrupted. What leaves a callback, KeyboardInterrupt above all, interrupts the command,
    which ends at a safe point before run() raises it again.
    """
    program = program or os.environ.get("S2GS") or shutil.which("s2gs")
    if program is None:
        raise FileNotFoundError("s2gs is not on PATH: install it, or name it as program= or in the environment's S2GS")
    words = [os.fspath(program), command] + arguments({**(options or {}), **more})
    # Results go to a file of their own: nobody reads two pipes at once here.
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as results:
        child = subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=results, stderr=subprocess.PIPE, text=True,
                                 encoding="utf-8", errors="replace", start_new_session=True)
        error = []
        try:
            for line in child.stderr:
                line = line.rstrip("\n")
                if line.startswith("s2gs: error: ") or error:
                    error.append(line[len("s2gs: error: "):] if not error else line)
                if on_line is not None:
                    on_line(line)
                progress, finished = PROGRESS.match(line), FINISHED.match(line)
                if on_progress is not None and progress:
                    on_progress(progress.group(1), int(progress.group(2)), int(progress.group(3)))
                elif on_progress is not None and finished:
                    on_progress(finished.group(1), int(finished.group(2)), int(finished.group(2)))
            child.wait()
        except BaseException:
            child.send_signal(signal.SIGINT)
            # What it says on its way to a safe point would end it at once if nobody read it.
            while os.read(child.stderr.fileno(), 1 << 16):
                pass
            child.wait()
            raise
        finally:
            child.stderr.close()
        results.seek(0)
        text = results.read()
    if child.returncode != 0:
        kind = {3: PosesDoubtful, 130: Interrupted}.get(child.returncode, Failed)
        raise kind(child.returncode, "\n".join(error) or f"s2gs {command} ended with {child.returncode}")
    return text
