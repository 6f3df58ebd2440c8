#!/usr/bin/env bash
# Makes every tile of the tables in docs/comparison.md and scores them, in about ten minutes of two
# cores. Tables go to the standard output.
#
#     examples/compare.sh DIR [FOREIGN]
#
# DIR receives the tiles; those that it has already are kept. FOREIGN is a published 64x64x16 tile
# of two dimensions to compare with, for example one made with the STBN generator.
set -euo pipefail
cd "$(dirname "$0")/.."
[[ $# -ge 1 ]] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2; }
mkdir -p "$1"
dir=$(cd "$1" && pwd)
foreign=${2:-}
cargo build --release --quiet
perceptile=target/release/perceptile

# The set of integrands that all tables use; defaults were tuned on another one.
set_number=7
perception='gaussian(2.1) * fovvideovdp(60) @ 7x7x8'
taa='gaussian(2.1) * fovvideovdp(60) * ema(0.2) @ 7x7x15'

# make NAME OPTIONS...: the tile NAME, unless it is there.
make() {
    local name=$1
    shift
    [[ -e $dir/$name.npy ]] && return
    "$perceptile" optimize "$@" --integrands 0 --out "$dir/$name.npy" >"$dir/$name.log"
    head -1 "$dir/$name.log"
}

# score TITLE KERNEL OPTIONS TILES...
score() {
    local title=$1 kernel=$2 options=$3
    shift 3
    printf '\n## %s\n\n' "$title"
    # shellcheck disable=SC2086
    "$perceptile" evaluate --all --kernel "$kernel" --set "$set_number" $options "$@"
}

tiles() { for name in "$@"; do printf '%s\n' "$dir/$name.npy"; done; }

for seed in 1 2 3 4 5; do make "best-$seed" --seed "$seed"; done
make spatial --preset salaun
mapfile -t best < <(tiles best-1 best-2 best-3 best-4 best-5 spatial)
score 'Defaults, five seeds' "$perception" '--baselines white,sobol' \
    ${foreign:+"$foreign"} "${best[@]}"

make paper --preset paper
make paper-taa --preset paper-taa
make paper-spatial --preset salaun --tile 128x128x30 --steps 10000 --directions 1
score 'The preset paper' "$perception" '--baselines white,sobol' \
    "$dir/paper.npy" "$dir/paper-spatial.npy"
score 'The preset paper-taa, behind its own kernel' "$taa" '--baselines white,sobol' \
    "$dir/paper-taa.npy" "$dir/paper-spatial.npy"

for case in 'spp 4' 'spp 16' 'dims 3' 'dims 4' 'dims 8'; do
    read -r what count <<<"$case"
    steps=3000
    [[ $what = spp && $count = 16 ]] && steps=1000
    make "$what$count" "--$what" "$count" --steps "$steps"
    make "$what$count-spatial" --preset salaun "--$what" "$count" --steps "$steps"
    score "$count $what" "$perception" '--baselines white,sobol' \
        "$dir/$what$count.npy" "$dir/$what$count-spatial.npy"
done

# The kernels alone, without draws for still pictures, as in the paper's Table 3.
make ablation-gaussian --kernel 'gaussian(2.1) * gaussian_t(2.1) @ 7x7x8'
make ablation-taa --kernel 'gaussian(2.1) * ema(0.2) @ 7x7x15'
make ablation-full --kernel "$taa"
mapfile -t ablation < <(tiles ablation-full ablation-taa ablation-gaussian)
score 'Ablation: full kernel, TAA only, Gaussian, all behind the full kernel' "$taa" '' \
    "${ablation[@]}"
