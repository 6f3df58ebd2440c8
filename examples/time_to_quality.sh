#!/usr/bin/env bash
# How long it takes to reach a quality: a tenth of STBN's error in linear functions, 0.38 in
# edges, 0.45 in axis edges, 0.12 in bumps and 0.35 in disks, that is at most
# 0.0065, 0.0947, 0.0842, 0.0238, 0.1017, with a residual of at most 0.16; at 64x64x16 and at
# 128x128x30. Takes about two minutes of two cores for each program.
#
#     examples/time_to_quality.sh [PROGRAM...]
#
# PROGRAM is another build of perceptile to compare with, for example of an earlier version.
set -euo pipefail
cd "$(dirname "$0")/.."
cargo build --release --quiet
ours=target/release/perceptile
dir=$(mktemp -d)
trap 'rm -rf "$dir"' EXIT
perception='gaussian(2.1) * fovvideovdp(60) @ 7x7x8'

# try PROGRAM TITLE OPTIONS...: makes a tile; prints its seconds and scores.
try() {
    local program=$1 title=$2
    shift 2
    printf '\n%s: %s\n' "$program" "$title"
    "$program" optimize "$@" --integrands 0 --force --out "$dir/tile.npy" | sed -n '1p;3p'
    "$ours" evaluate "$dir/tile.npy" --kernel "$perception" --set 7 | sed -n '/^perceived error$/,/^tile/p'
}

# The fastest settings found for either version.
small=(--kernel "0.9: $perception + 0.04: column + 0.06: box(8)" --steps 1900 --draws 2048
    --polish 30)
large=(--kernel "0.9: $perception + 0.04: column + 0.06: box(15)" --preset paper --steps 1900
    --draws 16384 --directions 2 --polish 30)
for program in "$ours" "$@"; do
    try "$program" '64x64x16' "${small[@]}"
    try "$program" '64x64x16, other settings as by default' --steps 2000 --polish 20
    try "$program" '128x128x30' "${large[@]}"
done
