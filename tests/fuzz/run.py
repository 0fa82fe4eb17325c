#!/usr/bin/python3
"""Runs the fuzz targets one after another and says what came of each.

usage: run.py BUILD [--seconds N] [--only NAME ...] [--work FOLDER] [--record]

Each target starts from its own seeds and from tests/fuzz/corpus/NAME, and keeps what it finds in WORK/NAME, from which a
later run goes on. Inputs that crashed, leaked or took too long lie in WORK/NAME-faults; exit code 1 when there are any.
--record adds the figures to those in tests/bench/results/safety: executions and CPU seconds of all runs, edges covered by the
last, which starts from what the others found.
"""
import argparse
import pathlib
import re
import resource
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "bench"))
sys.dont_write_bytecode = True
import safety  # noqa: E402


def targets_of(build):
    return sorted(path.name[:-len("_fuzzer")] for path in (build / "tests" / "fuzz").glob("*_fuzzer") if path.is_file())


def cpu_seconds():
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def run_target(build, name, seconds, work):
    """Figures of one run."""
    corpus, faults = work / name, work / f"{name}-faults"
    for folder in (corpus, faults):
        folder.mkdir(parents=True, exist_ok=True)
    command = [build / "tests" / "fuzz" / f"{name}_fuzzer", corpus, f"-max_total_time={seconds}", f"-artifact_prefix={faults}/",
               "-print_final_stats=1", "-timeout=25", "-rss_limit_mb=2560"]
    kept = HERE / "corpus" / name
    if kept.is_dir():
        command.insert(2, kept)
    before = cpu_seconds()
    run = subprocess.run(command, capture_output=True, text=True, errors="replace")
    executions = re.search(r"stat::number_of_executed_units: (\d+)", run.stderr)
    edges = re.findall(r"cov: (\d+) ft: (\d+)", run.stderr)
    figures = {"executions": int(executions.group(1)) if executions else 0, "cpu_seconds": round(cpu_seconds() - before, 1),
               "edges": int(edges[-1][0]) if edges else 0, "features": int(edges[-1][1]) if edges else 0,
               "corpus": sum(path.is_file() for path in corpus.iterdir()),
               "faults": sum(path.is_file() for path in faults.iterdir())}
    if run.returncode != 0 and figures["faults"] == 0:
        figures["faults"] = 1
    if figures["faults"]:
        print("\n".join(run.stderr.splitlines()[-40:]))
    return figures


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", type=pathlib.Path)
    parser.add_argument("--seconds", type=int, default=60, help="for each target, on the wall's clock")
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--work", type=pathlib.Path, help="default: a folder that is removed")
    parser.add_argument("--record", action="store_true")
    args = parser.parse_args()
    names = args.only or targets_of(args.build)
    if not names:
        sys.exit(f"{args.build}: has no fuzz targets. Build it first: cmake --preset fuzz && cmake --build --preset fuzz")
    has_faults = False
    with tempfile.TemporaryDirectory(prefix="s2gs_fuzz_") as scratch:
        print(f"{'target':20} {'executions':>11} {'CPU s':>7} {'edges':>6} {'features':>8} {'corpus':>6} {'faults':>6}")
        for name in names:
            figures = run_target(args.build, name, args.seconds, args.work or pathlib.Path(scratch))
            has_faults = has_faults or figures["faults"] > 0
            before = safety.recorded("fuzz", name) if args.record else {}
            for key in ("executions", "cpu_seconds", "faults"):
                figures[key] = round(figures[key] + before.get(key, 0), 1)
            print(f"{name:20} {figures['executions']:11} {figures['cpu_seconds']:7.0f} {figures['edges']:6} "
                  f"{figures['features']:8} {figures['corpus']:6} {figures['faults']:6}", flush=True)
            if args.record:
                safety.record("fuzz", name, f"tests/fuzz/run.py build/fuzz --seconds {args.seconds} --only {name} --record",
                              int(figures["faults"] > 0), figures)
    return 1 if has_faults else 0


if __name__ == "__main__":
    sys.exit(main())
