#!/usr/bin/env python3
"""Measures what numbers allow on one backend and writes the three pages: numerics.md, stiffness.md, numerics_stress.md.

usage: numerics.py BUILD/tests [--backend cpu|cuda] [--small] [--results FOLDER] [--commit HASH]

One command for each backend. `cpu` takes a whole build, and measures the kernels by themselves in double and float,
too; `cuda` needs a GPU, and a build of the trainer alone will do. What is measured replaces what FOLDER/numerics.jsonl
has of that backend; what it has of the other stays, with the commit and the machine that it is of.

Each case that must hold (design document, "Numerics that must hold") is a row with the tests that measure it.
The stress program runs at full size on a GPU (10 million Gaussians, photos of 8192 px: minutes and 21 GiB), with
--small and on the CPU as in every run of the tests. Exits with 1 when a value exceeds its bound, when a row has no
value, or when a program fails.
"""
import argparse
import datetime
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile

import results
import run as bench_run
import scenes

# The names in tests/support/measured_bound.h, with what is asked.
ROWS = [
    ("adjoints", "every kernel's adjoint: 1e-6 in double, 1e-3 in float, with culled splats interleaved"),
    ("hostile input", "NaN, infinities, denormals, 1e38 in any slot: culled and counted"),
    ("degenerate Gaussians", "quaternions of no or huge length, log-scales in [-80, 80], duplicates, centres at "
                             "the camera: finite or culled"),
    ("edge-on, through and behind the camera's plane", "finite, box valid, gradients capped"),
    ("2,000 layers", "transmittance within n x 4 eps32 of double"),
    ("scale and place of the scene", "x 1e-3, 1, 1e3, moved by 1e6: same image within 1e-4, same mesh within "
                                     "1e-5 of its size"),
    ("entropy and KL at all logits", "finite, relative 1e-5, no gradient at saturation"),
    ("Wigner D", "turns as the direction does, 1e-5 and 1e-12; a representation"),
    ("rotations, rank and focal length", "1e-9 in double, nullity reported"),
    ("counts past 2^31", "64-bit, or refused before allocation"),
    ("TSDF of a sphere", "bias of at most .1 voxel"),
    ("same seed twice", "the CPU to the bit for any number of threads; the GPU's spread published"),
]
# Those of the kernels alone run with either backend, and count as the CPU's.
PROGRAMS = {
    "kernel_tests": "*",
    "core_tests": "TileLists.*",
    "backend_tests": "*BackendTest.*",
    "train_tests": "Train.IsBitIdentical*",
    "mesh_tests": "*TsdfOnBackend.SphereIsUnbiased*:*TsdfOnBackend.ScaleAndPlace*:*TsdfOnBackend.FieldsFar*",
    "sfm_tests": "Rotation.*:ReprojectionCost.*:JointBa.Exact*:JointBa.Unobservable*:JointBa.ZeroBaseline*:"
                 "JointBa.FocalLengths*",
}
OF_BACKEND = {"cpu": ("cpu", "double", "float"), "cuda": ("cuda",)}
FULL_SIZE = ["--gaussians", "10000000", "--max_side", "8192"]
STIFFNESS_STEPS = "8"


def measure_bounds(folder, backend):
    """Records of the backend, and the programs that failed."""
    records, failed = [], []
    with tempfile.TemporaryDirectory() as temporary:
        path = pathlib.Path(temporary, "numerics.jsonl")
        for program, tests in PROGRAMS.items():
            binary = pathlib.Path(folder, program)
            if backend == "cuda" and program in ("core_tests", "kernel_tests", "sfm_tests"):
                continue  # nothing of them runs on a GPU
            if not binary.exists():
                failed.append(f"{program} (not built)")
                continue
            result = subprocess.run([binary, f"--gtest_filter={tests}", "--gtest_brief=1"],
                                    env={**os.environ, "S2GS_NUMERICS": str(path)}, capture_output=True, text=True)
            if result.returncode != 0:
                failed.append(program)
                print(result.stdout[-4000:], result.stderr[-1000:], file=sys.stderr)
        if path.exists():
            records = [json.loads(line) for line in path.read_text().splitlines()]
    # The last run of a test counts.
    records = {(record["row"], record["what"], record["on"]): record for record in records
               if record["on"] in OF_BACKEND[backend]}
    if not records:
        failed.append(f"every program on {backend}: nothing was measured")
    return list(records.values()), failed


def output_of(command, failed):
    result = subprocess.run(command, capture_output=True, text=True)
    if result.returncode != 0:
        failed.append(pathlib.Path(command[0]).name)
        print(result.stdout[-2000:], result.stderr[-1000:], file=sys.stderr)
    return result.stdout


def measure(folder, backend, small, kept, failed):
    """Replaces what is kept of the backend, a page at a time: yields after each, so that what is cut off later is
    kept. `failed` gets the programs that failed."""
    records, failed_here = measure_bounds(folder, backend)
    failed += failed_here
    kept["records"] = [r for r in kept["records"] if r["on"] not in OF_BACKEND[backend]] + records
    yield
    kept["stiffness"][backend] = output_of([folder / "stiffness", "--steps", STIFFNESS_STEPS], failed)
    yield
    size = FULL_SIZE if backend == "cuda" and not small else []
    kept["stress"][backend] = {
        "size": " ".join(size),
        "text": output_of([folder / "numerics_stress", "--use_gpu", "1" if backend == "cuda" else "0", *size], failed)}
    yield


def read_kept(path):
    """What earlier runs measured: {"records": [...], and by backend "made", "stiffness" and "stress"}."""
    kept = {"made": {}, "records": [], "stiffness": {}, "stress": {}}
    for line in path.read_text().splitlines() if path.exists() else []:
        for key, value in json.loads(line).items():
            if key == "record":
                kept["records"].append(value)
            else:
                kept[key].update(value)
    return kept


def write_kept(path, kept):
    """A line a value, so that a new measurement changes few."""
    lines = [{key: {backend: value}} for key in ("made", "stiffness", "stress") for backend, value in sorted(kept[key].items())]
    lines += [{"record": record} for record in sorted(kept["records"], key=lambda r: (r["row"], r["on"], r["test"], r["what"]))]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))


def number(value):
    if value is None:
        return "not a number"
    return "0" if value == 0 else f"{value:.2g}"


def bounds_table(records):
    """Lines, and the rows that no test measures."""
    lines = ["| case | measured on | what | value | bound | |", "|---|---|---|---|---|---|"]
    missing = []
    for row, asked in ROWS:
        of_row = sorted(((r["test"], r["what"], r["on"]), r) for r in records if r["row"] == row)
        lines.append(f"| **{row}** | | *{asked}* | | | |")
        if not of_row:
            missing.append(row)
            lines.append("| | | not measured | | | **missing** |")
        for (_, what, on), r in of_row:
            lines.append(f"| | {on} | {what} | {number(r['measured'])} | {number(r['bound'])} | "
                         f"{'holds' if r['holds'] else '**fails**'} |")
    return lines, missing


def made_line(made):
    return "; ".join(f"`{backend}`: {of['commit']}, {of['machine']}, {of['date']}" for backend, of in sorted(made.items()))


def bounds_page(kept):
    lines, missing = bounds_table(kept["records"])
    past = [record for record in kept["records"] if not record["holds"]]
    head = ["# Numerics that must hold", "",
            "Generated by `python3 tests/bench/numerics.py BUILD/tests --backend cpu` and `--backend cuda`: every value is "
            "measured by the test suite itself, which fails where a bound is exceeded. `double` and `float` are the "
            "kernels by themselves, `cpu` and `cuda` the two backends.", "",
            f"{made_line(kept['made'])}. {len(kept['records'])} values, {len(past)} past their bound.", ""]
    return "\n".join(head + lines) + "\n", missing, past


def cells(line):
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def backend_column(header):
    """Which column of a table says what it was measured on; None where none does."""
    names = cells(header)
    return next((names.index(name) for name in ("measured on", "backend") if name in names), None)


def tables_of(lines):
    """[(header, first line of its rows, line after the last)] of the tables of a page."""
    found = []
    for i in range(len(lines) - 1):
        if lines[i].startswith("|") and re.fullmatch(r"\|( *-+ *\|)+", lines[i + 1].strip()):
            end = i + 2
            while end < len(lines) and lines[end].startswith("|"):
                end += 1
            found.append((lines[i], i + 2, end))
    return found


def with_rows_of(page, other, backend):
    """`page`, where the rows of `backend` are those of `other`: each after the last row whose cells before the
    column of the backend are the same, or at the end of its table."""
    lines, others = page.split("\n"), other.split("\n")
    rows_of_other = {header: others[first:end] for header, first, end in tables_of(others)}
    for header, first, end in reversed(tables_of(lines)):
        column = backend_column(header)
        if column is None:
            continue
        rows = [row for row in lines[first:end] if cells(row)[column] != backend]
        for row in rows_of_other.get(header, []):
            if cells(row)[column] != backend:
                continue
            alike = [i for i, own in enumerate(rows) if cells(own)[:column] == cells(row)[:column]]
            rows.insert(alike[-1] + 1 if alike else len(rows), row)
        lines[first:end] = rows
    return "\n".join(lines)


def stiffness_page(kept):
    texts = kept["stiffness"]
    page = texts.get("cpu") or texts["cuda"]
    if texts.get("cpu") and texts.get("cuda"):
        page = with_rows_of(texts["cpu"], texts["cuda"], "cuda")
    title, rest = page.split("\n", 1)
    return f"{title}\n\n{made_line(kept['made'])}.\n{rest}"


def stress_page(kept):
    lines = ["# What numbers allow: stress at full size", "",
             "Generated by `python3 tests/bench/numerics.py BUILD/tests --backend cuda`, and by `--backend cpu` in small: trains, "
             "draws and meshes where sizes, scales and inputs end, and looks for numbers that are not finite. "
             f"{made_line(kept['made'])}.", ""]
    for backend, of in sorted(kept["stress"].items(), reverse=True):
        command = f"numerics_stress --use_gpu {1 if backend == 'cuda' else 0} {of['size']}".strip()
        lines += [f"## {backend}", "", f"`{command}`", "", of["text"].strip(), ""]
    return "\n".join(lines)


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", type=pathlib.Path)
    parser.add_argument("--backend", choices=sorted(OF_BACKEND), default="cpu")
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--results", type=pathlib.Path, default=results.RESULTS)
    parser.add_argument("--commit")
    args = parser.parse_args(arguments)
    commit = args.commit or bench_run.commit_of(scenes.REPOSITORY)
    if not commit:
        sys.exit("numerics.py: no git here: --commit says which program is measured")
    store = args.results / "numerics.jsonl"
    kept = read_kept(store)
    machine = bench_run.machine(args.backend == "cuda")
    kept["made"][args.backend] = {"commit": commit, "date": datetime.date.today().isoformat(),
                                  "machine": machine["gpu"] or f"{machine['cpu']}, {machine['cores']} cores"}
    args.results.mkdir(parents=True, exist_ok=True)
    failed = []
    for _ in measure(args.programs, args.backend, args.small, kept, failed):
        write_kept(store, kept)
        page, missing, past = bounds_page(kept)
        (args.results / "numerics.md").write_text(page)
        if kept["stiffness"]:
            (args.results / "stiffness.md").write_text(stiffness_page(kept))
        (args.results / "numerics_stress.md").write_text(stress_page(kept))
    print(f"{args.results}: {len(kept['records'])} values, {len(past)} past their bound; rows without a value: "
          f"{', '.join(missing) or 'none'}; programs that failed: {', '.join(failed) or 'none'}")
    return 1 if past or missing or failed else 0


if __name__ == "__main__":
    sys.exit(main())
