#!/usr/bin/env bash
# Installs what is missing, builds s2gs, and takes the shipped photos as far as the program goes today: features, split,
# both sparse models in one frame, and figures against ground truth. Two CPU cores need a few minutes.
#
# usage: bash examples/run.sh [WORKSPACE]        default: examples/work
set -euo pipefail
cd "$(dirname "$0")/.."

bash .ci/install_packages build

build_dir=${BUILD_DIR:-build/examples}
cmake -S . -B "$build_dir" -G Ninja -DCMAKE_BUILD_TYPE=Release -DS2GS_TESTS=OFF
cmake --build "$build_dir"

s2gs=$build_dir/s2gs
scene=examples/falcon_desk
workspace=${1:-examples/work}
started=$SECONDS
export QT_QPA_PLATFORM=offscreen
[ $# -gt 0 ] || rm -rf examples/work
if [ -e "$workspace/database.db" ]; then
  echo "run.sh: $workspace holds a database already: name another folder" >&2
  exit 1
fi
mkdir -p "$workspace"

echo
echo "1/4 Features: colmap feature_extractor (log: $workspace/feature_extractor.log)"
if ! colmap feature_extractor --database_path "$workspace/database.db" --image_path "$scene/images" \
  --ImageReader.single_camera 1 --SiftExtraction.use_gpu 0 > "$workspace/feature_extractor.log" 2>&1; then
  tail -n 20 "$workspace/feature_extractor.log" >&2
  exit 1
fi

echo
echo "2/4 What stands still, what turns: s2gs motion_splitter"
"$s2gs" motion_splitter --database_path "$workspace/database.db"

echo
echo "3/4 Both models in one frame: s2gs turntable_mapper"
"$s2gs" turntable_mapper --workspace_path "$workspace" --image_path "$scene/images"

echo
echo "4/4 Against ground truth: s2gs scan_evaluator"
"$s2gs" scan_evaluator --workspace_path "$workspace" --ground_truth_path "$scene" --json_path "$workspace/figures.json"

echo
echo "Photos to aligned scene: $((SECONDS - started)) s."
echo "  rotating part  $workspace/sparse/0          (open with: colmap gui --import_path ... --image_path $scene/images)"
echo "  background     $workspace/sparse/static"
echo "  table          $workspace/turntable.json"
echo "  figures        $workspace/figures.json"
