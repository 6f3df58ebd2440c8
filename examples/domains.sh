#!/usr/bin/env bash
# Makes every tile of the tables in docs/domains.md, three seeds of each, and scores them beside mapped
# tiles of the square, in about 30 minutes of two cores. Tables go to the standard output.
#
#     examples/domains.sh DIR
#
# DIR receives the tiles; those that it has already are kept.
set -euo pipefail
cd "$(dirname "$0")/.."
[[ $# -eq 1 ]] || { sed -n '2,7s/^# \{0,1\}//p' "$0" >&2; exit 2; }
mkdir -p "$1"
dir=$(cd "$1" && pwd)
cargo build --release --quiet
perceptile=target/release/perceptile

# make NAME OPTIONS...: the tile NAME, unless it is there.
make() {
    local name=$1
    shift
    [[ -e $dir/$name.npy ]] && return
    "$perceptile" optimize "$@" --integrands 0 --out "$dir/$name.npy" >"$dir/$name.log"
    head -1 "$dir/$name.log"
}

# compare NAME DOMAIN [OPTIONS...]: tiles of a domain beside mapped ones, for which the options are.
compare() {
    local name=$1 domain=$2 from=square
    shift 2
    [[ $# -gt 0 ]] && from=line
    local tiles=() maps=()
    for seed in 1 2 3; do
        make "$from-$seed" --seed "$seed" "$@"
        make "$name-$seed" --seed "$seed" --domain "$domain"
        tiles+=("$dir/$name-$seed.npy")
        maps+=(--map "$dir/$from-$seed.npy")
    done
    printf '\n## %s\n\n' "$name"
    "$perceptile" evaluate "${tiles[@]}" "${maps[@]}"
}

# The circle has places on a line.
compare circle circle --dims 1
for domain in disk sphere hemisphere cosine; do
    compare "$domain" "$domain"
done
cargo run --release --quiet --example densities -- "$dir/pictures" >/dev/null
for density in star gradient landscape; do
    compare "$density" "density($dir/pictures/$density.png)"
done
