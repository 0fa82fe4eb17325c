#!/usr/bin/env python3
"""Runs the tests of numerics of a build and writes the table of measured values beside their bounds.

usage: numerics.py BUILD/tests [--output results/numerics.md] [--json FILE] [--keep OTHER.json ...]

Each case that must hold (design document, "Numerics that must hold") is a row with the tests that measure it.
The CUDA backend is measured where there is a GPU; `--json` keeps the records, so that the table of a machine
without one can be completed by those of another (`--keep`). Exits with 1 when a value exceeds its bound, or
when a row has no value.
"""
import argparse
import datetime
import json
import os
import pathlib
import platform
import subprocess
import sys
import tempfile

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
PROGRAMS = {
    "kernel_tests": "*",
    "core_tests": "TileLists.*",
    "backend_tests": "*BackendTest.*",
    "train_tests": "Train.IsBitIdentical*",
    "mesh_tests": "*TsdfOnBackend.SphereIsUnbiased*:*TsdfOnBackend.ScaleAndPlace*:*TsdfOnBackend.FieldsFar*",
    "sfm_tests": "Rotation.*:ReprojectionCost.*:JointBa.Exact*:JointBa.Unobservable*:JointBa.ZeroBaseline*:"
                 "JointBa.FocalLengths*",
}


def run(folder):
    records = []
    with tempfile.TemporaryDirectory() as temporary:
        path = pathlib.Path(temporary, "numerics.jsonl")
        for program, tests in PROGRAMS.items():
            binary = pathlib.Path(folder, program)
            if not binary.exists():
                print(f"{binary}: not built, its rows are left out", file=sys.stderr)
                continue
            result = subprocess.run([binary, f"--gtest_filter={tests}", "--gtest_brief=1"],
                                    env={**os.environ, "S2GS_NUMERICS": str(path)}, capture_output=True, text=True)
            if result.returncode != 0:
                print(result.stdout[-4000:], file=sys.stderr)
        if path.exists():
            records = [json.loads(line) for line in path.read_text().splitlines()]
    return records


def number(value):
    if value is None:
        return "not a number"
    return "0" if value == 0 else f"{value:.2g}"


def table(records):
    lines = ["| case | measured on | what | value | bound | |", "|---|---|---|---|---|---|"]
    missing = []
    for row, asked in ROWS:
        of_row = {}
        for record in records:
            if record["row"] == row:
                of_row[record["what"], record["on"]] = record
        lines.append(f"| **{row}** | | *{asked}* | | | |")
        if not of_row:
            missing.append(row)
            lines.append("| | | not measured | | | **missing** |")
        for (what, on), r in sorted(of_row.items(), key=lambda item: (item[1]["test"], item[0])):
            lines.append(f"| | {on} | {what} | {number(r['measured'])} | {number(r['bound'])} | "
                         f"{'holds' if r['holds'] else '**fails**'} |")
    return lines, missing


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", type=pathlib.Path)
    parser.add_argument("--output", type=pathlib.Path,
                        default=pathlib.Path(__file__).parent / "results" / "numerics.md")
    parser.add_argument("--json", type=pathlib.Path)
    parser.add_argument("--keep", type=pathlib.Path, nargs="*", default=[])
    args = parser.parse_args()
    records = [record for path in args.keep for record in json.loads(path.read_text())]
    records += run(args.programs)
    # The last run of a test counts.
    records = list({(record["row"], record["what"], record["on"]): record for record in records}.values())
    if args.json:
        args.json.write_text(json.dumps(records, indent=1) + "\n")
    lines, missing = table(records)
    backends = sorted({record["on"] for record in records})
    failed = [record for record in records if not record["holds"]]
    head = ["# Numerics that must hold", "",
            "Generated by `python3 tests/bench/numerics.py BUILD/tests`: every value is measured by the test suite "
            "itself, which fails where a bound is exceeded. `double` and `float` are the kernels by themselves, "
            "`cpu` and `cuda` the two backends.", "",
            f"Measured on {', '.join(backends)}; {platform.machine()}, {datetime.date.today().isoformat()}. "
            + ("" if "cuda" in backends else "No GPU here: the rows of `cuda` are left out. ")
            + f"{len(records)} values, {len(failed)} past their bound.", ""]
    args.output.parent.mkdir(parents=True, exist_ok=True)
    args.output.write_text("\n".join(head + lines) + "\n")
    print(f"{args.output}: {len(records)} values, {len(failed)} past their bound, rows without a value: "
          f"{', '.join(missing) or 'none'}")
    return 1 if failed or missing else 0


sys.exit(main())
