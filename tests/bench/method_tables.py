#!/usr/bin/env python3
"""The paper's ablation and its baselines on our scenes: trains, renders, meshes and measures every variant.

usage: method_tables.py S2GS DATA OUTPUT [--scenes a b c] [--seeds 0 1 2] [--variants ...] [--iterations 30000]
                        [--use_gpu 1] [--more NAME=VALUE ...]
       method_tables.py --records method.jsonl [...] OUTPUT    one table of runs made before

DATA holds a workspace for each scene, as exact_workspace.py makes it with --object_model, --static_model and --masks
(links followed: cp -rL), and the data set's `gt` folder beside the rest. Each run has a folder of its own in
OUTPUT/runs; one that is done is not made again (other options: another OUTPUT). Writes OUTPUT/method.jsonl (a line a
run), and OUTPUT/method.md: medians over seeds with least and largest, of the paper's weights and of our defaults.
Standard library only.
"""
import argparse
import json
import math
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import time

PAPER = {"Train.local_consistency_weight": 50, "Train.entropy_3d_weight": 0.1, "Train.entropy_2d_weight": 0.1}
OFF = {name: 0 for name in PAPER}
NEVER = {"Train.settle_from": 1, "Train.settle_until": 1}
# Name, what it is, mode, the trainer's options. "paper": the paper's weights, and p soft to the end as there.
VARIANTS = [
    ("2dgs", "2DGS without masks", "static", {}),
    ("2dgs_masks", "2DGS with true masks", "masks", {}),
    ("none", "S2GS, no regulariser, p soft to the end", "s2gs", {**OFF, **NEVER}),
    ("local", "+ local consistency (50)", "s2gs", {**OFF, **NEVER, "Train.local_consistency_weight": 50}),
    ("paper", "+ 3D and 2D terms (.1, .1): the paper's weights", "s2gs", {**PAPER, **NEVER}),
    ("paper_synthetic", "the paper's weights for synthetic scenes (50, .01, .01)", "s2gs",
     {**PAPER, **NEVER, "Train.entropy_3d_weight": 0.01, "Train.entropy_2d_weight": 0.01}),
    ("paper_random", "the paper's weights, random start", "s2gs", {**PAPER, **NEVER, "Init.init": "random"}),
    ("paper_frozen", "the paper's weights, p frozen once settled", "s2gs", PAPER),
    ("ours_none", "ours without any regulariser of p", "s2gs", OFF),
    ("ours_random", "ours, random start", "s2gs", {"Init.init": "random"}),
    ("ours_soft", "ours, p soft to the end", "s2gs", NEVER),
    ("ours", "ours: the defaults", "s2gs", {}),
]
# Column, where the number is, digits.
COLUMNS = [("PSNR [dB]", "psnr_db", 2), ("SSIM", "ssim", 4), ("object PSNR [dB]", "object_psnr_db", 2),
           ("mask IoU", "mask_iou", 4), ("Chamfer [%]", "chamfer_pct.value", 4), ("F1", "f1", 4),
           ("seconds", "train_seconds", 1), ("Gaussians", "count", 0)]


def link_scene(scene, folder):
    """A workspace of its own whose inputs are links."""
    folder.mkdir(parents=True)
    for name in os.listdir(scene):
        if name not in ("s2gs", "dense", "work_precision", "report.json", "report.html", "gt"):
            os.symlink(scene / name, folder / name)
    # What gaussian_renderer writes must not replace the scene's true masks.
    if (folder / "masks").is_symlink():
        os.rename(folder / "masks", folder / "given_masks")


def held_out(log):
    last = {}
    for line in log.read_text().splitlines():
        entry = json.loads(line)
        if entry.get("event") == "held_out":
            last = {k: v for k, v in entry.items() if isinstance(v, (int, float))}
        seconds = entry.get("wall_s")
    return {**last, "train_seconds": seconds}


def run(args, scene, variant, seed):
    name, _, mode, options = variant
    folder = args.output / "runs" / f"{scene.name}-{name}-{seed}"
    done = folder / "figures.json"
    if done.exists():
        return json.loads(done.read_text())
    shutil.rmtree(folder, ignore_errors=True)
    link_scene(scene, folder)
    figures = {"scene": scene.name, "variant": name, "seed": seed, "iterations": args.iterations}

    def call(command, *words):
        line = [args.s2gs, command, *map(str, words), "--random_seed", str(seed), "--log_level", "warning"]
        result = subprocess.run(line, capture_output=True, text=True)
        with open(folder / "run.log", "a") as log:
            log.write(" ".join(map(str, line)) + "\n" + result.stdout + result.stderr)
        if result.returncode != 0:
            raise RuntimeError(f"{command}: " + (result.stderr.strip().splitlines() or ["failed"])[-1])

    words = []
    for option, value in {"Train.num_iterations": args.iterations, **options,
                          **dict(word.split("=", 1) for word in args.more)}.items():
        words += [f"--{option}", value]
    if mode == "masks":
        words += ["--mask_path", folder / "given_masks"]
    try:
        started = time.monotonic()
        call("gaussian_trainer", "--workspace_path", folder, "--mode", mode, "--use_gpu", args.use_gpu,
             "--test_list", folder / "test_list.txt", "--truth_mask_path", folder / "truth_masks", *words)
        figures["wall_seconds"] = time.monotonic() - started
        figures.update(held_out(folder / "s2gs" / "log.jsonl"))
        call("gaussian_renderer", "--workspace_path", folder, "--use_gpu", args.use_gpu)
        call("tsdf_mesher", "--workspace_path", folder, "--use_gpu", args.use_gpu, "--Refine.enabled", 0)
        call("scan_evaluator", "--workspace_path", folder, "--ground_truth_path", scene, "--json_path",
             folder / "evaluated.json")
        evaluated = json.loads((folder / "evaluated.json").read_text())["figures"]
        for figure, values in evaluated.items():
            for statistic, value in values.items():
                if isinstance(value, (int, float)):
                    figures[f"{figure}.{statistic}"] = value
        figures["f1"] = figures.get("f1_1pct.value")
    except (RuntimeError, OSError, json.JSONDecodeError, KeyError) as error:
        figures["failure"] = str(error)
    done.write_text(json.dumps(figures, indent=1) + "\n")
    if not args.keep:
        for name in ("dense", "masks"):
            shutil.rmtree(folder / name, ignore_errors=True)
        shutil.rmtree(folder / "s2gs" / "checkpoints", ignore_errors=True)
    return figures


def cell(runs, key, digits):
    values = [r[key] for r in runs if isinstance(r.get(key), (int, float)) and math.isfinite(r[key])]
    if not values:
        return "-"
    text = f"{statistics.median(values):,.{digits}f}"
    return text if len(values) == 1 else f"{text} ({min(values):,.{digits}f} to {max(values):,.{digits}f})"


def table(records, variants, scenes, iterations):
    lines = ["# The method's own tables", "",
             f"Generated by `tests/bench/method_tables.py --iterations {iterations}`: medians over seeds with least and largest. PSNR and SSIM of "
             "photos held out, mask IoU of all photos held out, Chamfer distance in % of the object's diameter and F1 "
             "at 1 % of it, of the TSDF mesh as it is fused, without refinement by the photos; seconds of training.", ""]
    for scene in scenes:
        lines += [f"## {scene}", "", "| variant | " + " | ".join(title for title, _, _ in COLUMNS) + " | runs |",
                  "|---" * (len(COLUMNS) + 2) + "|"]
        for name, what, _, _ in variants:
            runs = [r for r in records if r["scene"] == scene and r["variant"] == name]
            if runs:
                failed = sum("failure" in r for r in runs)
                lines.append(f"| {what} | " + " | ".join(cell(runs, key, digits) for _, key, digits in COLUMNS) +
                             f" | {len(runs)}" + (f", {failed} not reached" if failed else "") + " |")
        lines.append("")
    for record in records:
        if "failure" in record:
            lines.append(f"- {record['scene']}, {record['variant']}, seed {record['seed']}: {record['failure']}")
    return "\n".join(lines) + "\n"


def merge(words):
    """FILE [...] OUTPUT"""
    output = pathlib.Path(words[-1])
    runs = {}
    for path in words[:-1]:
        for line in pathlib.Path(path).read_text().splitlines():
            record = json.loads(line)
            runs[record["scene"], record["variant"], record["seed"]] = record
    order = [v[0] for v in VARIANTS]
    records = sorted(runs.values(), key=lambda r: (r["scene"], order.index(r["variant"]), r["seed"]))
    iterations = ", ".join(sorted({f"{r['iterations']}" for r in records}))
    output.mkdir(parents=True, exist_ok=True)
    (output / "method.jsonl").write_text("".join(json.dumps(r) + "\n" for r in records))
    (output / "method.md").write_text(table(records, VARIANTS, sorted({r["scene"] for r in records}), iterations))
    return 0


def main():
    if len(sys.argv) > 3 and sys.argv[1] == "--records":
        return merge(sys.argv[2:])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("s2gs")
    parser.add_argument("data", type=pathlib.Path)
    parser.add_argument("output", type=pathlib.Path)
    parser.add_argument("--scenes", nargs="*")
    parser.add_argument("--seeds", nargs="*", type=int, default=[0, 1, 2])
    parser.add_argument("--variants", nargs="*", choices=[v[0] for v in VARIANTS])
    parser.add_argument("--iterations", type=int, default=30000)
    parser.add_argument("--use_gpu", default="1")
    parser.add_argument("--more", nargs="*", default=[], help="further options of the trainer, NAME=VALUE")
    parser.add_argument("--keep", action="store_true", help="keep depth maps and checkpoints")
    args = parser.parse_args()
    args.data, args.output = args.data.resolve(), args.output.resolve()
    scenes = args.scenes or sorted(p.name for p in args.data.iterdir() if (p / "sparse").is_dir())
    variants = [v for v in VARIANTS if not args.variants or v[0] in args.variants]
    args.output.mkdir(parents=True, exist_ok=True)
    records = []
    for seed in args.seeds:
        for scene in scenes:
            for variant in variants:
                record = run(args, args.data / scene, variant, seed)
                records.append(record)
                print(f"{scene} {variant[0]} seed {seed}: " + record.get("failure", ", ".join(
                    f"{title} {cell([record], key, digits)}" for title, key, digits in COLUMNS)), flush=True)
                (args.output / "method.jsonl").write_text("".join(json.dumps(r) + "\n" for r in records))
                (args.output / "method.md").write_text(table(records, variants, scenes, args.iterations))
    return 0


if __name__ == "__main__":
    sys.exit(main())
