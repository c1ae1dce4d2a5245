#!/usr/bin/env bash
# Renders a sweep on SLURM: one Dask worker a task, scheduler and batch on the job's first node.
#
#   sbatch slurm.sh SWEEP.yaml OUT
#
# OUT and the sweep's files lie in a folder that all nodes see, and gpusim is on each node's
# PATH. Submitted again with the same OUT, it renders the frames that are missing.
#SBATCH --job-name=gpusim
#SBATCH --ntasks=8
#SBATCH --cpus-per-task=2
#SBATCH --mem-per-cpu=4G
#SBATCH --time=04:00:00
# With a GPU for each worker: --gpus-per-task=1
set -euo pipefail
[ $# = 2 ] || { echo "usage: sbatch slurm.sh SWEEP.yaml OUT" >&2; exit 2; }
sweep=$1 out=$2

# Frames stay where their light was made.
export DASK_DISTRIBUTED__SCHEDULER__WORK_STEALING=False DASK_LOGGING__DISTRIBUTED=warning
mkdir -p "$out"
address_file=$out/.scheduler-${SLURM_JOB_ID:-$$}.json
trap 'kill $(jobs -p) 2>/dev/null; wait; rm -f "$address_file"' EXIT

dask scheduler --port 0 --no-dashboard --scheduler-file "$address_file" &
scheduler=$!
srun dask worker --nthreads 2 --nworkers 1 --no-dashboard --scheduler-file "$address_file" &
until [ -s "$address_file" ]; do
    kill -0 $scheduler 2>/dev/null || { echo "the Dask scheduler did not start" >&2; exit 1; }
    sleep 1
done
address=$(python3 -c 'import json, sys; print(json.load(open(sys.argv[1]))["address"])' "$address_file")
gpusim batch "$sweep" --out "$out" --scheduler "$address" --resume
