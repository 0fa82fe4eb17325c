#!/bin/bash
# Error against run time of training and mesh on a GPU, from one binary and a folder of scans with exact poses.
#
# usage: gpu_curves.sh S2GS DATA OUTPUT [SCENE ...]
#
# S2GS is the trainer's binary (preset `trainer`), DATA holds a workspace for each scene as exact_workspace.py makes it
# with --object_model, --static_model (links followed: cp -rL) and a link or copy `gt` of the data set's; without names
# all scenes. Each knob's CSV, JSON and page go to OUTPUT; what is done is not made again. SEEDS and KNOBS may be set.
set -u
s2gs=$1 data=$2 output=$3
shift 3
scenes=${*:-$(ls "$data")}
seeds=${SEEDS:-0,1,2}
knobs=${KNOBS:-train_iterations photo_size max_gaussians local_consistency entropy_3d entropy_2d normal distortion}
held_out='test_list={workspace}/test_list.txt,truth_mask_path={workspace}/truth_masks'
mkdir -p "$output"

list() { # the scenes as one word: PREFIX/a/SUFFIX,PREFIX/b/SUFFIX
  local all=""
  for scene in $scenes; do all=${all:+$all,}$data/$scene${1:-}; done
  echo "$all"
}

for knob in $knobs; do
  iterations=",Train.num_iterations=${ITERATIONS:-15000}"
  if [ "$knob" = train_iterations ]; then iterations=""; fi
  "$s2gs" work_precision --workspace_path "$(list)" --knob "$knob" --seeds "$seeds" --use_gpu 1 \
    --arguments "$held_out$iterations" ${VALUES:+--values "$VALUES"} --output_path "$output/$knob" ||
    echo "$knob: exit code $?"
done

# The mesh needs a model and its depth maps: each scene is trained and rendered once.
for scene in $scenes; do
  "$s2gs" gaussian_trainer --workspace_path "$data/$scene" --use_gpu 1 --test_list "$data/$scene/test_list.txt" \
    --Train.num_iterations "${ITERATIONS:-15000}" --log_level warning &&
    "$s2gs" gaussian_renderer --workspace_path "$data/$scene" --use_gpu 1 --log_level warning ||
    echo "$scene: no depth maps"
done
for knob in voxel refinement; do
  "$s2gs" work_precision --workspace_path "$(list)" --knob "$knob" --seeds 0 --use_gpu 1 \
    --ground_truth_path "$(list)" --output_path "$output/$knob" || echo "$knob: exit code $?"
done
