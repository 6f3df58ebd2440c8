#!/usr/bin/env bash
# The tables of ranks in docs/clusters.md: how long they take, what travels between them, and the memory of
# each. Needs Open MPI; builds the program with MPI first. The shortest of ROUNDS runs counts.
#
#   examples/ranks.sh [ROUNDS]
set -euo pipefail
cd "$(dirname "$0")/.."
rounds=${1:-3}
cargo build --release --features mpi
program=$PWD/target/release/perceptile
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
if [[ $EUID -eq 0 ]]; then
    export OMPI_ALLOW_RUN_AS_ROOT=1 OMPI_ALLOW_RUN_AS_ROOT_CONFIRM=1
fi
kernel='gaussian(2.1) * fovvideovdp(60) @ 7x7x8'

# Makes a tile on so many ranks of one thread, and keeps the shortest run.
ranks() {
    local ranks=$1 best='' seconds
    shift
    for ((round = 0; round < rounds; round++)); do
        mpirun --oversubscribe --bind-to none -n "$ranks" "$program" optimize "$@" --threads 1 \
            --kernel "$kernel" --warp 0 --polish 0 --integrands 0 --force >run.txt
        seconds=$(sed -n 's/.*descent \([0-9.]*\) s.*/\1/p' run.txt)
        if [[ -z $best ]] || awk "BEGIN { exit !($seconds < $best) }"; then
            best=$seconds
            cp run.txt best.txt
        fi
    done
    sha256sum <tile.npy >tile.sum
    if [[ -e first.sum ]]; then
        cmp first.sum tile.sum
    else
        cp tile.sum first.sum
    fi
    # Of all ranks, the largest figures.
    awk -v ranks="$ranks" -v seconds="$best" '
        /MB of halos/ { table = 1; next }
        table && $3 > work { work = $3 }
        table && $4 > wait { wait = $4 }
        table && $5 > halo { halo = $5 }
        table && $6 > peak { peak = $6 }
        END { printf "%5d %10.1f %8.1f %10.1f %12.1f %8d\n", ranks, seconds, work, wait, halo, peak }
    ' best.txt
}

table() {
    printf '\n%s\nranks  descent s   work s  waiting s  MB of halos  peak MB\n' "$1"
    rm -f first.sum
}

table "the paper's job"
for count in 1 2 4; do
    ranks "$count" --preset paper
done
table "256x256x64, 4 spp, 60 steps of 32,768 draws"
for count in 1 2 4; do
    ranks "$count" --tile 256x256x64 --spp 4 --steps 60 --draws 32768
done
table "1 GB of samples: 512x512x64, 8 spp, 3 steps of 131,072 draws"
rounds=1
for count in 1 2 4 8; do
    ranks "$count" --tile 512x512x64 --spp 8 --steps 3 --draws 131072
done
