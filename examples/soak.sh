#!/usr/bin/env bash
# A long run by workers that keep dying: shows that memory stays flat and that nothing is left.
#
#   examples/soak.sh [MINUTES [FOLDER]]
#
# Four workers make a tile of 256x256x64 with 4 samples per pixel; each lives a minute on average,
# and one in four hangs instead of dying. Every ten seconds the memory of all processes together
# (proportional set size: shared pages count once) goes to FOLDER/memory.txt.
set -euo pipefail
minutes=${1:-30}
folder=${2:-$(mktemp -d)}
program=${PERCEPTILE:-target/release/perceptile}

"$program" optimize --tile 256x256x64 --spp 4 --polish 0 --steps 100000000 --integrands 0 \
    --workers 4 --threads 1 --replacements 1000000 --faults 60000ms,0.25 --checkpoint 5m \
    --time "${minutes}m" --out "$folder/tile.npy" >"$folder/out.txt" 2>"$folder/err.txt" &
coordinator=$!

# Kilobytes of a process and its children.
memory() {
    local pid sum=0
    for pid in "$coordinator" $(cat "/proc/$coordinator/task/$coordinator/children" 2>/dev/null); do
        sum=$((sum + $(awk '/^Pss:/ { print $2 }' "/proc/$pid/smaps_rollup" 2>/dev/null || echo 0)))
    done
    echo "$sum"
}

: >"$folder/memory.txt"
while kill -0 "$coordinator" 2>/dev/null; do
    sleep 10
    kilobytes=$(memory)
    if [[ $kilobytes -gt 0 ]]; then
        echo "$SECONDS $((kilobytes / 1024))" >>"$folder/memory.txt"
    fi
done
wait "$coordinator" || { cat "$folder/err.txt"; exit 1; }
cat "$folder/out.txt"
echo "workers that were lost: $(wc -l <"$folder/err.txt")"
# Without the first minute, in which it grows, and the last, in which the tile is written.
awk 'NR > 6 { line[n++] = $2 } END {
    half = int((n - 6) / 2)
    for (i = 0; i < n - 6; i++) {
        if (i < half) a = line[i] > a ? line[i] : a
        else b = line[i] > b ? line[i] : b
    }
    printf "memory: at most %d MB in the first half, %d MB in the second\n", a, b
}' "$folder/memory.txt"
