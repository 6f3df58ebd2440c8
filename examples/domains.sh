#!/usr/bin/env bash
# Makes every tile of the table in docs/domains.md, three seeds of each, and scores them beside mapped
# tiles of the square, in about 20 minutes of two cores. Tables go to the standard output.
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

for domain in circle disk sphere hemisphere cosine; do
    # The circle has places on a line; a tile of them gets a polish as others do.
    from=square options=()
    [[ $domain = circle ]] && from=line options=(--dims 1 --polish 150)
    tiles=() maps=()
    for seed in 1 2 3; do
        make "$from-$seed" --seed "$seed" "${options[@]}"
        make "$domain-$seed" --seed "$seed" --domain "$domain"
        tiles+=("$dir/$domain-$seed.npy")
        maps+=(--map "$dir/$from-$seed.npy")
    done
    printf '\n## %s\n\n' "$domain"
    "$perceptile" evaluate "${tiles[@]}" "${maps[@]}"
done
