#!/usr/bin/python3
"""Runs s2gs on what nobody should give it, and looks at what comes of it.

usage: run.py PROGRAM [--full] [--only WORD] [--work FOLDER] [--list] [--record]

Each case has a folder of its own: a workspace, in which the program may write, and everything else, in which it may not:
photos, models from elsewhere, files that hostile names point at. Before and after each run all of these are hashed. A case
fails when a file outside the workspace changed, appeared or went; when the program ended with a code that it does not
document (0, 1, 2, 3, 130), above all 134; when it computed for more than ten seconds, or waited for two minutes; when it
says that it is done, used or wrote fewer photos than there are, and gave no warning; or when it did not say what the case
wants to hear. The short form has every defect that was ever seen once; --full adds every name to every reader, every option
of every command, damage at every place, limits and signals. --record leaves the counts in tests/bench/results/safety.

Needs numpy and opencv of Debian, and the photos of examples/falcon_desk.
"""
import argparse
import collections
import json
import os
import pathlib
import re
import shutil
import signal
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "bench"))
sys.dont_write_bytecode = True
import cases  # noqa: E402
import safety  # noqa: E402
import sandbox  # noqa: E402

GOOD_CODES = {0, 1, 2, 3, 130}
# What a run may be found guilty of; the first five must never be.
KINDS = ["originals changed", "written outside", "exit code 134", "hangs", "partial without a warning", "other codes", "words"]


def missing_photos(box, run):
    """Whether a run that calls itself done left photos out: those of the exact workspace that it did not use or write for."""
    command = os.fspath(run.arguments[0])
    names = [image["name"] for image in json.loads((box.base / "scan" / "turntable.json").read_text())["images"]]
    if command == "gaussian_trainer" and "up to date" not in run.text:
        used = re.search(r"^photos +(\d+)$", run.text, re.M)
        return len(names) - int(used.group(1)) if used else len(names)
    if command == "gaussian_renderer":
        def is_written(name):
            places = [box.scan / "masks" / f"{name}.png", box.scan / "dense/0/images" / name,
                      box.scan / "dense/0/stereo/depth_maps" / f"{name}.geometric.bin"]
            return all(path.is_file() and path.stat().st_size > 0 for path in places)
        return sum(not is_written(name) for name in names)
    return 0


def judge(box, run, before, want):
    """What is wrong, as pairs of its kind and words; nothing when all is well."""
    faults = []
    after = box.outside()
    changed = [key for key in before if before[key] != after.get(key)]
    new = [key for key in after if key not in before]
    if changed:
        faults.append(("originals changed", f"originals changed: {changed[:3]}"))
    if new:
        faults.append(("written outside", f"written outside the workspace: {new[:3]}"))
    if run.code not in GOOD_CODES:
        faults.append(("exit code 134" if run.code in (134, -6) else "other codes", f"exit code {run.code}"))
    if run.is_hung or run.cpu_seconds > want.max_cpu_seconds:
        faults.append(("hangs", f"hangs ({run.wall_seconds:.0f} s, {run.cpu_seconds:.0f} s of CPU)"))
    if run.code == 0 and "warning" not in run.text and (left_out := missing_photos(box, run)) > 0:
        faults.append(("partial without a warning", f"says that it is done and left {left_out} photos out"))
    if want.code is not None and run.code != want.code:
        faults.append(("other codes", f"exit code {run.code}, not {want.code}"))
    for pattern in want.says:
        if not re.search(pattern, run.text, re.S):
            faults.append(("words", f"does not say /{pattern}/"))
    for pattern in want.not_says:
        if re.search(pattern, run.text, re.S):
            faults.append(("words", f"says /{pattern}/"))
    if re.search("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f]", run.text):
        faults.append(("words", "control characters on the terminal"))
    if run.code == 1 and "error:" not in run.text and want.needs_message:
        faults.append(("words", "fails without a message"))
    if want.then is not None:
        faults += [("words", fault) for fault in want.then(box, run)]
    return faults


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("--full", action="store_true")
    parser.add_argument("--only", default="")
    parser.add_argument("--work", type=pathlib.Path, help="kept afterwards; default: a folder that is removed")
    parser.add_argument("--list", action="store_true", help="print what each run said")
    parser.add_argument("--record", action="store_true")
    args = parser.parse_args()
    # A shell ignores Ctrl-C in what it starts in the background, and so would the programs started here.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    examples = pathlib.Path(__file__).resolve().parents[2] / "examples" / "falcon_desk"
    work = args.work or pathlib.Path(tempfile.mkdtemp(prefix="s2gs_hostile_"))
    work.mkdir(parents=True, exist_ok=True)
    work.chmod(0o755)
    base = work / "base"
    program = str(args.program.resolve())
    if not base.exists():
        sandbox.prepare_base(program, examples, base)
    groups = collections.Counter()
    kinds = collections.Counter()
    failed = []
    for number, case in enumerate(cases.all_cases(args.full)):
        if args.only not in f"{case.group}: {case.name}":
            continue
        folder = work / f"case{number:04d}"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        box = sandbox.Sandbox(program, folder, base)
        try:
            want, arguments, options = case.prepare(box)
        except cases.CannotRun as reason:
            print(f"LEFT OUT {case.group}: {case.name}: {reason}")
            continue
        before = box.outside()
        run = box.run(arguments, **options)
        faults = judge(box, run, before, want)
        groups[case.group] += 1
        if args.list or faults:
            message = next((line for line in run.text.splitlines() if "error:" in line), "").strip()
            print(f"{'FAILED' if faults else 'ok    '} {case.group}: {case.name}: exit code {run.code} {message}")
        for kind, fault in faults:
            kinds[case.group, kind] += 1
            print(f"    {fault}")
        if faults:
            failed.append(case)
            print("    " + "\n    ".join(run.text.strip().splitlines()[-6:]))
        shutil.rmtree(folder, ignore_errors=True)
    print(f"{'group':12} {'runs':>5}  failed")
    for group, count in groups.items():
        print(f"{group:12} {count:5}  {sum(case.group == group for case in failed)}")
    print(f"{'all':12} {sum(groups.values()):5}  {len(failed)}")
    print("; ".join(f"{kind}: {sum(n for (_, k), n in kinds.items() if k == kind)}" for kind in KINDS))
    if args.record:
        # What was left by runs of other groups stays.
        variant = "full" if args.full else "short"
        figures = {}
        for group, count in groups.items():
            figures[f"{group}.runs"] = count
            for kind in KINDS:
                figures[f"{group}.{kind}"] = kinds[group, kind]
        safety.record("hostile", variant, f"tests/hostile/run.py build/cpu/s2gs{' --full' if args.full else ''} --record",
                      int(bool(failed)), {**safety.recorded("hostile", variant), **figures})
    if args.work is None:
        shutil.rmtree(work, ignore_errors=True)
    return 1 if failed or not groups else 0


if __name__ == "__main__":
    sys.exit(main())
