#!/usr/bin/env bash
# A tile by ranks on a cluster under Slurm that outlives its time limit: the job stops with a
# checkpoint before its time is up, queues itself again, and goes on, to the same bytes.
#
#   sbatch examples/slurm.sh
#
# Build the program with `cargo build --release --features mpi` against the cluster's own MPI, and
# submit from a folder that all nodes see, in which the tile is to be. The numbers below are for nodes
# of two NUMA nodes with 16 cores each: change them to yours.

#SBATCH --job-name=perceptile
#SBATCH --time=04:00:00
#SBATCH --nodes=4
#SBATCH --exclusive
# One rank for each NUMA node (for each socket, where a socket is one), with a thread on each of its
# cores: threads share samples and caches, ranks send what they share. Ranks fill one socket after the
# other, on whole cores only.
#SBATCH --ntasks-per-node=2
#SBATCH --cpus-per-task=16
#SBATCH --hint=nomultithread
# All memory of the nodes; `perceptile optimize ... --dry-run` says what a run needs.
#SBATCH --mem=0
# Ranks, but not this script, get SIGTERM two minutes before the time is up: enough to end the step and
# to write the checkpoint and the tile so far.
#SBATCH --signal=TERM@120
# Slurm may start the job again, after the loss of a node as well; what it said before is kept.
#SBATCH --requeue
#SBATCH --open-mode=append
set -euo pipefail

program=${PERCEPTILE:-perceptile}
# What is left of a run that was stopped or has died. It replaces the tile so far.
if [[ -d tile.run ]]; then
    command=(resume tile.run --force)
else
    command=(optimize --tile 256x256x64 --spp 4 --preset best --out tile.npy)
fi

# srun does not take --cpus-per-task from the job. --threads 0 takes the cores that a rank is bound to.
# When a rank dies the others cannot go on: all end, rather than wait until the time is up.
code=0
srun --mpi=pmix --cpus-per-task="$SLURM_CPUS_PER_TASK" --cpu-bind=cores --kill-on-bad-exit=1 \
    "$program" "${command[@]}" --threads 0 --checkpoint 10m || code=$?

# 143: stopped by SIGTERM, with a checkpoint. Anything else is the end, or needs a look: submit the
# script once more to go on from the last checkpoint.
if [[ $code -eq 143 && -d tile.run ]]; then
    scontrol requeue "$SLURM_JOB_ID"
fi
exit "$code"
