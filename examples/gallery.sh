#!/usr/bin/env bash
# Makes the set of textures that a team would check in, in some eight minutes of two cores: five kinds of
# samples for three displays, in every container, with scores, checksums, a licence, and a page.
#
#     examples/gallery.sh OUT
#
# OUT/index.html shows them. Tiles that OUT has already are kept.
set -euo pipefail
cd "$(dirname "$0")/.."
[[ $# -eq 1 ]] || { sed -n '2,8s/^# \{0,1\}//p' "$0" >&2; exit 2; }
mkdir -p "$1"
out=$(cd "$1" && pwd)
cargo build --release --quiet
perceptile=$PWD/target/release/perceptile
cd "$out"

kinds=(scalar vec2 circle sphere cosine)
displays=(60hz 60hz-taa 120hz)

# options NAME: the flags that a kind or a display stands for.
options() {
    case $1 in
    scalar) echo "--dims 1" ;;
    vec2) ;;
    circle | sphere | cosine) echo "--domain $1" ;;
    60hz) ;;
    60hz-taa) echo "--fps 60 --taa 0.1" ;;
    120hz) echo "--fps 120" ;;
    esac
}

# make NAME OPTIONS...: the tile NAME, with what the command says of it.
make() {
    local name=$1
    shift
    [[ -e $name/$name.npy ]] && return
    mkdir -p "$name"
    "$perceptile" optimize --preset engine --tile 64x64x32 "$@" --out "$name/$name.npy" >"$name/scores.txt"
}

# pack NAME: the tile in every container, and the functions that read it.
pack() {
    local name=$1
    cd "$name"
    "$perceptile" export "$name.npy" --force --format ktx2 --out "$name.ktx2"
    "$perceptile" export "$name.npy" --force --format ktx2-3d --out "$name-3d.ktx2"
    "$perceptile" export "$name.npy" --force --format raw8 --out "$name.raw"
    "$perceptile" export "$name.npy" --force --format npy --out "$name-u16.npy"
    "$perceptile" export "$name.npy" --force --format png8 --strip --out strip
    "$perceptile" export "$name.npy" --force --format exr --layers --out exr
    for language in c hlsl glsl wgsl; do
        "$perceptile" export "$name.npy" --force --format header --language "$language"
    done
    # The strip and the layers have their sidecar one folder up.
    rm -f "strip/$name.json" "exr/$name.json" "$name-3d.json" "$name-u16.json"
    cd ..
}

cat >LICENSE <<'TEXT'
To the extent possible under law, whoever made these textures with Perceptile has waived all copyright and
related rights to them: CC0 1.0, https://creativecommons.org/publicdomain/zero/1.0/. Use them for anything.
TEXT

{
    cat <<'HTML'
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Textures</title>
<style>
  body { font: 16px/1.5 system-ui, sans-serif; margin: 1rem auto; max-width: 70rem; padding: 0 1rem; }
  section { border-top: 1px solid #bbb; }
  img { max-width: 100%; height: auto; }
  pre { overflow-x: auto; font-size: .85rem; }
</style>
<h1>Textures</h1>
<p>Each is 64×64 texels of 32 frames. Scores are relative to white noise, which has 1; lower is better. A level b of
8 bits stands for (b + 0.5) / 256; the functions beside each texture read it.</p>
HTML
    for kind in "${kinds[@]}"; do
        for display in "${displays[@]}"; do
            name=$kind-$display
            # Of words, each is a flag or a value.
            # shellcheck disable=SC2046
            make "$name" $(options "$kind") $(options "$display")
            pack "$name" >/dev/null
            printf '<section><h2>%s</h2>\n<p><img src="%s/%s.png" alt="Frames, spectra and an edge of %s"></p>\n' \
                "$name" "$name" "$name" "$name"
            printf '<pre>'
            sed 's/&/\&amp;/g; s/</\&lt;/g' "$name/scores.txt"
            printf '</pre>\n<p>'
            for file in "$name"/*.ktx2 "$name"/*.raw "$name"/strip/*.png "$name"/exr/*.exr "$name"/*.npy \
                "$name"/*.h "$name"/*.hlsl "$name"/*.glsl "$name"/*.wgsl; do
                printf '<a href="%s">%s</a> (%s kB) \n' "$file" "${file#*/}" $(($(stat -c %s "$file") / 1000 + 1))
            done
            printf '</p></section>\n'
        done
    done
    printf '<p><a href="SHA256SUMS">SHA256SUMS</a>, <a href="LICENSE">LICENSE</a></p>\n'
} >index.html.part
mv index.html.part index.html
find . -type f ! -name SHA256SUMS | sort | xargs sha256sum >SHA256SUMS
printf '%s\n' "$out/index.html"
