#!/usr/bin/env bash
# Scans the objects of a list on a Slurm cluster: one task and one GPU an object, then index.html over all of them.
#
# usage: examples/cluster/submit.sh LIST [SBATCH OPTION...]      for example
#        examples/cluster/submit.sh objects.csv --partition=gpu --time=04:00:00
#   S2GS=PROGRAM    default: s2gs. In a container: S2GS="apptainer run --nv s2gs.sif"
# LIST, photos, workspaces and the program lie where all nodes see them. Submit again to go on with what is left: what is
# done is skipped.
set -euo pipefail
list=$(realpath "${1:?usage: submit.sh LIST [SBATCH OPTION...]}")
shift
here=$(dirname "$(realpath "$0")")
export S2GS=${S2GS:-s2gs}

# Also names rows that are wrong, before anything is queued.
count=$($S2GS scan_batch --list "$list" --run 0 | sed -n 's/^\([0-9][0-9]*\) objects\{0,1\}:.*/\1/p')
scans=$(sbatch --parsable --array="1-${count:?no objects in $list}" "$@" "$here/scan_array.sbatch" "$list")
page=$(sbatch --parsable --dependency="afterany:$scans" --job-name=s2gs_page --output=s2gs_page.log "$@" --gpus=0 \
  --wrap "$S2GS scan_batch --list '$list' --run 0")
echo "$count scans: job $scans; the page over all: job $page"
