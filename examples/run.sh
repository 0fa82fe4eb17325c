#!/usr/bin/env bash
# Installs what is missing, builds s2gs, and takes the shipped photos from photos to mesh with `s2gs automatic_scanner`,
# then measures the result against ground truth. Two CPU cores need about ten minutes after the build.
#
# usage: bash examples/run.sh [WORKSPACE]        default: examples/work
#   QUALITY=low|medium|high|extreme   how much time to spend (default: low, for a CPU)
# Run again after an interruption: it goes on where it was.
set -euo pipefail
cd "$(dirname "$0")/.."

bash .ci/install_packages build

build_dir=${BUILD_DIR:-build/examples}
cmake -S . -B "$build_dir" -G Ninja -DCMAKE_BUILD_TYPE=Release -DCMAKE_UNITY_BUILD=ON -DS2GS_TESTS=OFF
cmake --build "$build_dir"

s2gs=$build_dir/s2gs
scene=examples/falcon_desk
workspace=${1:-examples/work}
started=$SECONDS
mkdir -p "$workspace"

"$s2gs" automatic_scanner --workspace_path "$workspace" --image_path "$scene/images" --quality "${QUALITY:-low}"
scanned=$SECONDS

echo
echo "Against ground truth: s2gs scan_evaluator"
"$s2gs" scan_evaluator --workspace_path "$workspace" --ground_truth_path "$scene" --json_path "$workspace/figures.json"

echo
echo "Photos to mesh: $((scanned - started)) s."
echo "  mesh      $workspace/dense/0/meshed-tsdf.ply"
echo "  masks     $workspace/masks"
echo "  picture   $workspace/s2gs/comparison.jpg"
echo "  log       $workspace/s2gs/log.jsonl"
echo "  figures   $workspace/figures.json"
