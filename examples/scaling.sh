#!/usr/bin/env bash
# The paper's job by threads of one process and by worker processes: the table of docs/workers.md.
#
#   examples/scaling.sh [ROUNDS]
#
# Every arrangement is timed ROUNDS times (3 by default), in turns, and the shortest time counts:
# what else the machine does only ever adds to it. All tiles must be the same.
set -euo pipefail
rounds=${1:-3}
program=${PERCEPTILE:-target/release/perceptile}
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
arrangements=("--threads 1" "--threads 2" "--workers 1 --threads 1" "--workers 2 --threads 1"
    "--workers 4 --threads 1" "--workers 8 --threads 1" "--workers 2 --threads 2")

declare -A best
for _ in $(seq "$rounds"); do
    for arrangement in "${arrangements[@]}"; do
        # shellcheck disable=SC2086 # several flags
        "$program" optimize --preset paper --kernel 'gaussian(2.1) * fovvideovdp(60) @ 7x7x8' \
            --polish 0 --warp 0 --integrands 0 $arrangement --out "$folder/tile.npy" --force \
            >"$folder/out.txt"
        seconds=$(sed -n 's/.*descent \([0-9.]*\) s.*/\1/p' "$folder/out.txt")
        best[$arrangement]=$(printf '%s\n' "${best[$arrangement]:-$seconds}" "$seconds" | sort -g | head -1)
        sha256sum "$folder/tile.npy" | cut -c1-64 >>"$folder/digests.txt"
    done
done
for arrangement in "${arrangements[@]}"; do
    printf '%-24s %6s s\n' "$arrangement" "${best[$arrangement]}"
done
printf 'different tiles: %s\n' "$(sort -u "$folder/digests.txt" | wc -l)"
"$program" profile --preset paper --kernel 'gaussian(2.1) * fovvideovdp(60) @ 7x7x8' \
    --workers 2 --threads 1 --measure 1 | sed -n '/workers of/,/^$/p'
