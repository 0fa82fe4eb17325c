#!/bin/sh
# Trains falcon_desk with exact poses on a GPU, with and without masks, and prints what was measured.
#
# usage: gpu_quality.sh S2GS WORKSPACE OUTPUT [trainer options ...]
#
# WORKSPACE is one of exact_workspace.py --masks. Each run's log.jsonl and the printed figures go to OUTPUT/NAME.
set -u
s2gs=$1 workspace=$2 output=$3
shift 3

train() {
  name=$1
  shift
  mkdir -p "$output/$name"
  "$s2gs" gaussian_trainer --workspace_path "$workspace" --output_path "$output/$name" --use_gpu 1 \
    --test_list "$workspace/test_list.txt" --truth_mask_path "$workspace/truth_masks" "$@" \
    > "$output/$name/figures.txt" 2> "$output/$name/progress.txt"
  echo "== $name: exit code $?"
  cat "$output/$name/figures.txt"
  tail -n 3 "$output/$name/progress.txt"
}

train s2gs --mode s2gs "$@"
train masks --mode masks "$@"
