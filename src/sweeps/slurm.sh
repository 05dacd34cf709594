#!/bin/sh
# slurm: a task of the array that computes a sweep on Slurm; submitted in the sweep's folder, with TASKS and the list of
# chunks in the file missing.  Each task computes every TASKS-th of them.
#SBATCH --job-name=anmech_sweep
#SBATCH --output=/dev/null
set -u
cd "${SLURM_SUBMIT_DIR:-.}" || exit 1
for number in $(awk -v task="$SLURM_ARRAY_TASK_ID" -v tasks="$TASKS" 'NR % tasks == task % tasks' missing); do
  sh ./run_chunk "$number" 2>> errors
done
