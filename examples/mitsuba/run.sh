#!/usr/bin/env bash
# Makes the tiles, renders all scenes behind them with Mitsuba 3, compares, and draws the report:
# about an hour of two cores. Needs Python 3.11 or later with venv, a Debian or Ubuntu whose apt-get
# can download (nothing is installed; root is not needed), and the network.
#
#     examples/mitsuba/run.sh OUT [OPTIONS of compare.py]
#
# OUT receives everything; what it has already is kept, so a run that was stopped goes on. Tiles to
# compare with are given as --foreign NAME=FILE.npy, for example one made with the STBN generator.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
[[ $# -ge 1 ]] || { sed -n '2,9s/^# \{0,1\}//p' "$0" >&2; exit 2; }
mkdir -p "$1"
out=$(cd "$1" && pwd)
shift

cargo build --release --quiet --manifest-path "$here/../../Cargo.toml"
perceptile=$here/../../target/release/perceptile

if [[ ! -x $out/venv/bin/python ]]; then
    python3 -m venv "$out/venv"
fi
"$out/venv/bin/pip" install --quiet --requirement "$here/requirements.txt"

# Mitsuba compiles its kernels with LLVM, of which Dr.Jit 1.5.0 needs version 19 or later on processors with
# AVX-512.
if [[ -z ${DRJIT_LIBLLVM_PATH:-} ]] && ! ldconfig -p | grep -qE 'libLLVM[-.](so\.)?(19|2[0-9])'; then
    llvm=$out/assets/debian
    if ! compgen -G "$llvm/usr/lib/llvm-*/lib/libLLVM*.so*" >/dev/null; then
        mkdir -p "$llvm"
        (cd "$llvm" && apt-get download libllvm19 && dpkg-deb -x libllvm19_*.deb .)
    fi
    DRJIT_LIBLLVM_PATH=$(find "$llvm/usr/lib" -name 'libLLVM*.so*' -type f | head -1)
    export DRJIT_LIBLLVM_PATH
fi

"$out/venv/bin/python" "$here/compare.py" "$out" --program "$perceptile" "$@"
foreign=()
for ((i = 1; i <= $#; i++)); do
    if [[ ${!i} = --foreign ]]; then
        next=$((i + 1))
        foreign+=("${!next#*=}")
    elif [[ ${!i} = --foreign=* ]]; then
        given=${!i#--foreign=}
        foreign+=("${given#*=}")
    fi
done
"$perceptile" report "$out/report" "$out"/tiles/{small,small-taa,perception,spatial}.npy \
    "${foreign[@]}" --renders "$out" --force
printf 'The tables are in %s, the report in %s\n' "$out/tables.md" "$out/report/index.html"
