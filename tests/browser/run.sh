#!/usr/bin/env bash
# Makes textures and a small report, and tries them in a browser. Needs node, npm, and Chromium at CHROMIUM or
# /usr/bin/chromium.
#
#     tests/browser/run.sh PROGRAM
set -euo pipefail
[[ $# -eq 1 ]] || { sed -n '2,5s/^# \{0,1\}//p' "$0" >&2; exit 2; }
program=$(realpath "$1")
cd "$(dirname "$0")"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

PLAYWRIGHT_SKIP_BROWSER_DOWNLOAD=1 npm ci --no-audit --no-fund
# Textures of each kind, with the functions that read them.
textures=$work/textures
mkdir "$textures"
make() {
    local name=$1
    shift
    "$program" optimize --preset quick --tile 32x16x4 --steps 50 --integrands 0 "$@" --out "$work/$name.npy"
    for format in "ktx2 $name.ktx2" "ktx2-3d $name-3d.ktx2" "raw8 $name.raw"; do
        "$program" export "$work/$name.npy" --format "${format% *}" --out "$textures/${format#* }" --force
    done
    "$program" export "$work/$name.npy" --format header --language glsl --for ktx2-3d \
        --out "$textures/$name.glsl"
}
make pair --spp 2
make scalar --dims 1
make sphere --domain sphere
# The viewer on a page of its own, then all that applies on a report.
TEXTURES=$textures npm test

# A name without a place to break, much wider than a phone.
wide=$work/$(printf 'wide%.0s' {1..50}).npy
kernel='gaussian(2.1) * fovvideovdp(60) @ 7x7x8'
"$program" optimize --steps 300 --polish 0 --integrands 16 --out "$work/ours.npy"
"$program" optimize --preset salaun --steps 300 --polish 0 --integrands 0 --out "$wide"
tiles=("$work/ours.npy" "$wide")
"$program" report "$work/report" "${tiles[@]}" --kernel "$kernel" --integrands 16
"$program" evaluate "${tiles[@]}" --kernel "$kernel" --integrands 16 --baselines white --json \
    >"$work/scores.json"
REPORT=$work/report SCORES=$work/scores.json npm test
