//! Exports as programs that are not ours read them: the ktx2 crate, a C compiler, shader compilers.

use std::fs;
use std::path::Path;
use std::process::Command;

use perceptile::domain::Domain;
use perceptile::export::header::{Header, HeaderError, Language, Storage};
use perceptile::format::exact::exact;
use perceptile::format::ktx2::{self, Layout};
use perceptile::format::png::Depth;
use perceptile::format::slices::{Picture, SliceOptions, Stack, write_slices};
use perceptile::format::source::{SourceError, TileSource};
use perceptile::format::texture::{self, Texels};
use perceptile::format::write::Existing;
use perceptile::format::{npy, raw};
use perceptile::tile::{Tile, TileShape};
use proptest::prelude::*;

use crate::child::output;
use crate::format::{bits, quantized, scattered, shape};

const DEPTHS: [Depth; 2] = [Depth::Eight, Depth::Sixteen];

/// The level of one coordinate, by its definition.
fn level(x: f32, depth: Depth) -> u16 {
    (f64::from(x) * f64::from(depth.levels())).floor() as u16
}

fn ktx2_of(tile: &Tile, texels: Texels, depth: Depth, layout: Layout) -> Vec<u8> {
    let mut bytes = Vec::new();
    ktx2::write(tile, (texels, depth), layout, &mut bytes).unwrap();
    bytes
}

#[test]
fn the_ktx2_crate_reads_every_texel() {
    use ::ktx2::Format;
    let formats = [
        [Format::R8_UNORM, Format::R16_UNORM],
        [Format::R8G8_UNORM, Format::R16G16_UNORM],
        [Format::R8G8B8_UNORM, Format::R16G16B16_UNORM],
        [Format::R8G8B8A8_UNORM, Format::R16G16B16A16_UNORM],
    ];
    for (texels, formats) in Texels::ALL.into_iter().zip(formats) {
        for (depth, format) in DEPTHS.into_iter().zip(formats) {
            for layout in [Layout::Array, Layout::Volume] {
                for dims in 1..=texels.channels() {
                    let tile = scattered(shape(5, 3, 4, 2, dims));
                    let bytes = ktx2_of(&tile, texels, depth, layout);
                    let reader = ::ktx2::Reader::new(&bytes[..]).unwrap();
                    let header = reader.header();
                    assert_eq!(header.format, Some(format));
                    assert_eq!(header.type_size as usize, depth.bytes());
                    assert_eq!((header.pixel_width, header.pixel_height), (5, 3));
                    let stack = match layout {
                        Layout::Array => (0, 8),
                        Layout::Volume => (8, 0),
                    };
                    assert_eq!((header.pixel_depth, header.layer_count), stack);
                    assert_eq!((header.face_count, header.level_count), (1, 1));
                    assert_eq!(header.supercompression_scheme, None);
                    let keys: Vec<&str> = reader.key_value_data().map(|(key, _)| key).collect();
                    assert_eq!(keys, ["KTXorientation", "KTXwriter", "PerceptileSample"]);
                    let (described, _) = ::ktx2::dfd::Basic::from_format(format).unwrap();
                    assert_eq!(reader.dfd_blocks(), [::ktx2::dfd::Block::Basic(described)]);
                    let levels: Vec<_> = reader.levels().collect();
                    assert_eq!(levels.len(), 1);
                    let mut data = levels[0].data.chunks_exact(depth.bytes()).map(|bytes| {
                        bytes.iter().rev().fold(0_u16, |level, &byte| level << 8 | u16::from(byte))
                    });
                    let full = (depth.levels() - 1) as u16;
                    for layer in 0..8 {
                        for (y, x) in (0..3).flat_map(|y| (0..5).map(move |x| (y, x))) {
                            let point = tile.point(x, y, layer / 2, layer % 2);
                            for channel in 0..texels.channels() {
                                let padding = if channel == 3 { full } else { 0 };
                                let expected =
                                    point.get(channel).map_or(padding, |&x| level(x, depth));
                                assert_eq!(data.next(), Some(expected));
                            }
                        }
                    }
                    assert_eq!(data.next(), None);
                }
            }
        }
    }
}

/// Everything that an export writes of a tile, read back.
fn there_and_back(tile: &Tile) -> Vec<(String, Tile, Tile)> {
    let folder = tempfile::tempdir().unwrap();
    let mut all = Vec::new();
    let mut check = |what: String, path: &Path, expected: Tile| {
        let read = TileSource::new(path).read().unwrap_or_else(|error| panic!("{what}: {error}"));
        all.push((what, read, expected));
    };
    let dims = tile.shape().dims();
    for depth in DEPTHS {
        let rounded = quantized(tile, depth.levels().into());
        for texels in Texels::ALL.into_iter().filter(|it| it.channels() >= dims) {
            for layout in [Layout::Array, Layout::Volume] {
                let path = folder.path().join("t.ktx2");
                fs::write(&path, ktx2_of(tile, texels, depth, layout)).unwrap();
                check(format!("ktx2 {texels} {depth:?} {layout:?}"), &path, rounded.clone());
            }
            let path = folder.path().join("t.raw");
            let mut bytes = Vec::new();
            let description = raw::write(tile, (texels, depth), &mut bytes).unwrap();
            fs::write(&path, bytes).unwrap();
            let text = serde_json::to_vec(&description).unwrap();
            fs::write(raw::description_of(&path), text).unwrap();
            check(format!("raw {texels} {depth:?}"), &path, rounded.clone());
        }
        let path = folder.path().join("t.npy");
        let mut bytes = Vec::new();
        npy::write_levels(tile, depth, &mut bytes).unwrap();
        fs::write(&path, bytes).unwrap();
        check(format!("npy {depth:?}"), &path, rounded.clone());
    }
    for (stack, padded) in [(Stack::Files, true), (Stack::Files, false), (Stack::Layers, true)] {
        for picture in [Picture::Exr, Picture::Png(Depth::Sixteen)] {
            if picture != Picture::Exr && stack == Stack::Layers {
                continue;
            }
            let texels = (dims < 4 && !padded).then_some(Texels::Rgba);
            let options = SliceOptions { picture, stack, padded, texels };
            let place = tempfile::tempdir().unwrap();
            write_slices(tile, options, place.path(), "t", Existing::Keep).unwrap();
            let expected = match picture {
                Picture::Exr => tile.clone(),
                Picture::Png(_) => quantized(tile, 65536.0),
            };
            check(format!("{picture:?} {stack:?} {padded}"), place.path(), expected);
        }
    }
    all
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn what_is_exported_is_read_back(
        size in [2_usize..7, 2..7, 1..13, 1..4],
        dims in 1_usize..5,
    ) {
        let [width, height, frames, spp] = size;
        let tile = scattered(shape(width, height, frames, spp, dims));
        for (what, read, expected) in there_and_back(&tile) {
            prop_assert_eq!(read.shape(), expected.shape(), "{}", &what);
            prop_assert_eq!(bits(&read), bits(&expected), "{}", what);
        }
    }
}

#[test]
fn many_dimensions_go_into_pictures_in_pairs() {
    for (spp, dims) in [(1, 5), (2, 6), (1, 16)] {
        let tile = scattered(shape(4, 3, 11, spp, dims));
        for (stack, padded) in [(Stack::Files, true), (Stack::Files, false), (Stack::Layers, true)]
        {
            let options = SliceOptions { picture: Picture::Exr, stack, padded, texels: None };
            let folder = tempfile::tempdir().unwrap();
            write_slices(&tile, options, folder.path(), "t", Existing::Keep).unwrap();
            assert_eq!(TileSource::new(folder.path()).read().unwrap(), tile, "{stack:?}");
        }
    }
}

#[test]
fn a_texture_without_our_words_is_read_as_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.ktx2");
    let tile = scattered(shape(4, 4, 6, 2, 2));
    let mut bytes = ktx2_of(&tile, Texels::Rgba, Depth::Eight, Layout::Array);
    let ours = bytes.windows(16).position(|it| it == b"PerceptileSample").unwrap();
    bytes[ours] = b'X';
    fs::write(&path, &bytes).unwrap();
    let source = TileSource::new(&path);
    assert_eq!(source.read().unwrap().shape(), shape(4, 4, 12, 1, 2));
    let told = TileSource { spp: Some(2), ..source.clone() };
    assert_eq!(told.read().unwrap(), quantized(&tile, 256.0));
    let told = TileSource { spp: Some(2), frames: Some(5), ..source.clone() };
    assert!(matches!(told.read(), Err(SourceError::Frames { found: 6, .. })));
    let told = TileSource { spp: Some(5), ..source.clone() };
    assert!(matches!(told.read(), Err(SourceError::Spp { .. })));
    let green = TileSource { channels: Some("g".parse().unwrap()), ..source };
    let second = green.read().unwrap();
    assert_eq!(second.point(1, 2, 7, 0), [quantized(&tile, 256.0).point(1, 2, 3, 1)[1]]);
}

#[test]
fn padding_is_no_dimension() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.ktx2");
    let dims = |texels: Texels, ours: bool, dims: usize, points: &[f32]| {
        let shape = shape(points.len() / dims, 1, 1, 1, dims);
        let tile = Tile::new(shape, points.to_vec()).unwrap();
        let mut bytes = ktx2_of(&tile, texels, Depth::Eight, Layout::Array);
        let words = bytes.windows(16).position(|it| it == b"PerceptileSample").unwrap();
        bytes[words] = if ours { bytes[words] } else { b'X' };
        fs::write(&path, &bytes).unwrap();
        TileSource::new(&path).read().unwrap().shape().dims()
    };
    assert_eq!(dims(Texels::Rgba, false, 2, &[0.1, 0.2, 0.3, 0.4]), 2);
    assert_eq!(dims(Texels::Rgba, false, 4, &[0.1, 0.2, 0.0, 0.999, 0.3, 0.4, 0.0, 0.99]), 4);
    assert_eq!(dims(Texels::Rgba, false, 3, &[0.0, 0.0, 0.0]), 1);
    assert_eq!(dims(Texels::Rgba, true, 3, &[0.0, 0.0, 0.0]), 3);
    assert_eq!(dims(Texels::Rg, false, 1, &[0.5]), 1);
}

fn header(shape: TileShape, domain: Domain, depth: Depth, storage: Storage) -> Header<'static> {
    Header { name: "a tile-2", shape, domain, texels: None, depth, storage }
}

/// The place that the header's functions read for a decision of a sample, by their description.
fn place(shape: TileShape, [x, y, index, number]: [usize; 4]) -> [usize; 3] {
    let other = (number + 1009 * (index / shape.spp())) as u64;
    let shift = |factor: u64, size: usize| {
        let sequence = (other * factor) % (1 << 32);
        (((sequence >> 16) * size as u64) >> 16) as usize
    };
    let (width, height) = (shape.width(), shape.height());
    let column = (x + shift(3_242_174_889, width)) % width;
    [column, (y + shift(2_447_445_414, height)) % height, index % shape.spp()]
}

#[test]
fn the_c_header_reads_the_tile() {
    let cases = [
        (shape(5, 7, 3, 2, 2), Domain::Square, Depth::Eight),
        (shape(8, 4, 2, 1, 1), Domain::Square, Depth::Sixteen),
        (shape(4, 4, 2, 1, 3), Domain::Sphere, Depth::Eight),
        (shape(4, 4, 2, 3, 2), Domain::Disk, Depth::Sixteen),
    ];
    for (shape, domain, depth) in cases {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let tile = domain.map(&scattered(shape)).unwrap_or_else(|_| scattered(shape));
        let tile = if domain.is_square() { scattered(shape) } else { tile };
        let texels = texture::texels_for(shape, None).unwrap();
        let mut bytes = Vec::new();
        raw::write(&tile, (texels, depth), &mut bytes).unwrap();
        fs::write(at("t.raw"), bytes).unwrap();
        let text = header(shape, domain, depth, Storage::Memory).text(Language::C).unwrap();
        fs::write(at("t.h"), &text).unwrap();
        let (dims, spp) = (shape.dims(), shape.spp());
        let kind = 8 * depth.bytes();
        let size = shape.coordinates() / dims * texels.channels();
        let number = if domain.is_square() {
            format!(
                "if (k == 0) for (uint32_t d = 0; d < {dims}; d++)\n\
                if (a_tile_2_number(tile, x, y, t, s, n * {dims}u + d) != p[d]) return 1;"
            )
        } else {
            String::new()
        };
        let program = format!(
            "#include \"t.h\"\n#include \"t.h\"\n#include <stdio.h>\n\
             int main(void) {{\n\
             static uint{kind}_t tile[{size}];\n\
             FILE *file = fopen(\"t.raw\", \"rb\");\n\
             if (!file || fread(tile, sizeof tile[0], {size}, file) != {size}) return 2;\n\
             for (uint32_t t = 0; t < 2u * {}u; t++) for (uint32_t y = 0; y < 2u * {}u; y++)\n\
             for (uint32_t x = 0; x < 2u * {}u; x++) for (uint32_t s = 0; s < 2u * {spp}u; s++)\n\
             for (uint32_t n = 0; n < 3; n++) {{\n\
             float p[{dims}];\n\
             a_tile_2_point(tile, x, y, t, s, n, p);\n\
             for (int k = 0; k < {dims}; k++) {{ printf(\"%a\\n\", p[k]); {number} }}\n\
             }}\nreturn 0; }}\n",
            shape.frames(),
            shape.height(),
            shape.width()
        );
        fs::write(at("t.c"), program).unwrap();
        let mut compile = Command::new("cc");
        let flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-O1", "-o", "t", "t.c", "-lm"];
        let done = output(compile.args(flags).current_dir(folder.path()));
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let done = output(Command::new(at("t")).current_dir(folder.path()));
        assert_eq!(done.status.code(), Some(0), "{}", String::from_utf8_lossy(&done.stderr));
        let text = String::from_utf8(done.stdout).unwrap();
        let mut numbers = text.lines().map(hexadecimal);
        let rounded = quantized(&tile, depth.levels().into());
        let [width, height, frames] = [shape.width(), shape.height(), shape.frames()];
        for t in 0..2 * frames {
            for (y, x) in (0..2 * height).flat_map(|y| (0..2 * width).map(move |x| (y, x))) {
                for (s, n) in (0..2 * spp).flat_map(|s| (0..3).map(move |n| (s, n))) {
                    let [column, row, sample] = place(shape, [x, y, s, n]);
                    let point = rounded.point(column, row, t % frames, sample);
                    let mut expected: Vec<f64> = point.iter().map(|&x| x.into()).collect();
                    if !domain.is_square() {
                        expected.iter_mut().for_each(|x| *x = 2.0 * *x - 1.0);
                    }
                    if domain == Domain::Sphere {
                        let length = expected.iter().map(|x| x * x).sum::<f64>().sqrt();
                        expected.iter_mut().for_each(|x| *x /= length);
                    }
                    for x in expected {
                        let found = numbers.next().unwrap();
                        assert!((found - x).abs() < 3e-7, "{domain}: {found} {x}");
                    }
                }
            }
        }
        assert_eq!(numbers.next(), None);
    }
}

/// A number as C prints it with `%a`.
fn hexadecimal(text: &str) -> f64 {
    let (sign, text) = text.strip_prefix('-').map_or((1.0, text), |rest| (-1.0, rest));
    let (digits, exponent) = text.strip_prefix("0x").unwrap().split_once('p').unwrap();
    let (whole, part) = digits.split_once('.').unwrap_or((digits, ""));
    let all = u64::from_str_radix(&format!("{whole}{part}"), 16).unwrap() as f64;
    let exponent: i32 = exponent.parse::<i32>().unwrap() - 4 * part.len() as i32;
    sign * all * f64::from(exponent).exp2()
}

/// Headers of all kinds that a shading language reads.
fn shaders(language: Language) -> Vec<(String, Header<'static>)> {
    let mut all = Vec::new();
    for storage in [Storage::Array, Storage::Volume, Storage::Strip] {
        for depth in DEPTHS {
            for (dims, domain) in [
                (1, Domain::Square),
                (2, Domain::Square),
                (2, Domain::Disk),
                (3, Domain::Cosine),
                (4, Domain::Square),
            ] {
                let spp = if storage == Storage::Strip { 1 } else { 2 };
                let it = header(shape(8, 16, 4, spp, dims), domain, depth, storage);
                all.push((it.text(language).unwrap(), it));
            }
        }
    }
    all
}

#[test]
fn naga_accepts_the_wgsl_header() {
    use naga::valid::{Capabilities, ValidationFlags, Validator};
    for (text, it) in shaders(Language::Wgsl) {
        let texture = match it.storage {
            Storage::Array => "texture_2d_array<f32>",
            Storage::Volume => "texture_3d<f32>",
            _ => "texture_2d<f32>",
        };
        let number =
            if it.domain.is_square() { "a_tile_2_number(noise, p, 1u, 0u, 5u)" } else { "0.0" };
        let point = if it.shape.dims() == 1 { "" } else { ".x" };
        let whole = format!(
            "{text}\n@group(0) @binding(0) var noise: {texture};\n\
             @fragment fn main(@builtin(position) at: vec4<f32>) -> @location(0) vec4<f32> {{\n\
             let p = vec2<u32>(at.xy);\n\
             let a = a_tile_2_point(noise, p, 1u, 2u, 3u){point};\n\
             return vec4<f32>(a, {number}, 0.0, 1.0);\n}}\n"
        );
        let module = naga::front::wgsl::parse_str(&whole)
            .unwrap_or_else(|error| panic!("{}\n{whole}", error.emit_to_string(&whole)));
        let mut validator = Validator::new(ValidationFlags::all(), Capabilities::empty());
        validator.validate(&module).unwrap_or_else(|error| panic!("{error:?}\n{whole}"));
    }
}

#[test]
fn glslang_accepts_the_glsl_and_hlsl_headers() {
    if Command::new("glslangValidator").arg("--version").output().is_err() {
        eprintln!("skipped: there is no glslangValidator");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    for language in [Language::Glsl, Language::Hlsl] {
        for (number, (text, it)) in shaders(language).into_iter().enumerate() {
            let dims = it.shape.dims();
            let point = if dims == 1 { "" } else { ".x" };
            let number_of = |arguments: &str| match it.domain.is_square() {
                true => format!("a_tile_2_number({arguments})"),
                false => "0.0".to_owned(),
            };
            let (name, whole, flags) = if language == Language::Glsl {
                let sampler = match it.storage {
                    Storage::Array => "sampler2DArray",
                    Storage::Volume => "sampler3D",
                    _ => "sampler2D",
                };
                let number = number_of("noise, uvec2(gl_FragCoord.xy), 1u, 0u, 5u");
                let whole = format!(
                    "#version 300 es\nprecision highp float;\n{text}\nuniform highp {sampler} noise;\n\
                     out vec4 color;\nvoid main() {{\n\
                     float a = a_tile_2_point(noise, uvec2(gl_FragCoord.xy), 1u, 2u, 3u){point};\n\
                     color = vec4(a, {number}, 0.0, 1.0);\n}}\n"
                );
                (
                    format!("{number}.frag")
                        .replace(|c: char| !c.is_ascii_alphanumeric() && c != '.', ""),
                    whole,
                    vec![],
                )
            } else {
                let channels = texture::texels_for(it.shape, None).unwrap().channels();
                let texture = match it.storage {
                    Storage::Array => "Texture2DArray",
                    Storage::Volume => "Texture3D",
                    _ => "Texture2D",
                };
                let float =
                    if channels == 1 { "float".to_owned() } else { format!("float{channels}") };
                let number = number_of("noise, uint2(at.xy), 1u, 0u, 5u");
                let whole = format!(
                    "{text}\n{texture}<{float}> noise;\n\
                     float4 main(float4 at : SV_Position) : SV_Target {{\n\
                     float a = a_tile_2_point(noise, uint2(at.xy), 1u, 2u, 3u){point};\n\
                     return float4(a, {number}, 0.0, 1.0);\n}}\n"
                );
                ("h.frag".to_owned(), whole, vec!["-D", "-V", "-e", "main"])
            };
            let path = folder.path().join(format!("{number}-{name}"));
            fs::write(&path, &whole).unwrap();
            let mut command = Command::new("glslangValidator");
            let done = output(command.args(flags).arg(&path).current_dir(folder.path()));
            let said = String::from_utf8_lossy(&done.stdout);
            assert!(done.status.success(), "{said}\n{whole}");
        }
    }
}

#[test]
fn headers_are_refused_where_they_could_not_read() {
    let of = |shape, storage, language| {
        header(shape, Domain::Square, Depth::Eight, storage).text(language).unwrap_err()
    };
    let plain = shape(4, 4, 4, 1, 2);
    assert!(matches!(of(plain, Storage::Memory, Language::Glsl), HeaderError::Storage { .. }));
    assert!(matches!(of(plain, Storage::Array, Language::C), HeaderError::Storage { .. }));
    let several = shape(4, 4, 4, 2, 2);
    let error = of(several, Storage::Strip, Language::Wgsl);
    assert_eq!(error, HeaderError::Samples { spp: 2 });
    let long = shape(1 << 16, 1, 1, 1, 1);
    assert!(matches!(of(long, Storage::Array, Language::Hlsl), HeaderError::Side { .. }));
    let many = shape(4, 4, 4, 1, 5);
    assert!(matches!(of(many, Storage::Array, Language::Glsl), HeaderError::Texture(_)));
}

#[test]
fn names_in_headers_are_names() {
    let of = |name| {
        let plain = header(shape(4, 4, 4, 1, 2), Domain::Square, Depth::Eight, Storage::Array);
        Header { name, ..plain }.text(Language::Glsl).unwrap()
    };
    for (name, expected) in [
        ("tile", "vec2 tile_point("),
        ("my tile--v2", "vec2 my_tile_v2_point("),
        ("64x64", "vec2 tile_64x64_point("),
        ("gl_tile", "vec2 tile_gl_tile_point("),
        ("__", "vec2 tile_point("),
        ("ä*/\n#error", "vec2 error_point("),
    ] {
        let text = of(name);
        assert!(text.contains(expected), "{name}: {text}");
        assert!(text.lines().all(|line| !line.starts_with('#')), "{text}");
    }
}

/// An exact tile has exact counts also in what is written.
#[test]
fn exact_levels_are_written_as_they_are() {
    let tile = exact(&scattered(shape(32, 16, 2, 1, 2)), Depth::Eight);
    let levels: Vec<u16> = texture::levels(&tile, Texels::Rg, Depth::Eight).collect();
    for (layer, channel) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let mut counts = [0; 256];
        for &level in levels[layer * 1024..][..1024].iter().skip(channel).step_by(2) {
            counts[usize::from(level)] += 1;
        }
        assert_eq!(counts, [2; 256]);
    }
}

/// The command as users type it.
#[cfg(target_os = "linux")]
mod command {
    use super::*;
    use crate::tool::{PROGRAM, PROGRESS, Room};

    /// A folder with some tiles.
    struct Folder(Room);

    impl Folder {
        fn new() -> Self {
            let room = Room::new();
            for (name, dims, spp) in [("a", 2, 1), ("b", 1, 1), ("many", 5, 1), ("more", 1, 2)] {
                let path = room.at(&format!("{name}.npy"));
                scattered(shape(8, 8, 4, spp, dims)).save(path).unwrap();
            }
            Self(room)
        }

        /// Runs a command as a shell splits it: its exit code, and what it printed and said.
        fn run(&self, line: &str) -> (Option<i32>, String, String) {
            let mut command = Command::new("sh");
            command.args(["-c", &format!("exec \"$0\" {line}"), PROGRAM]);
            let done = output(command.current_dir(self.0.at("")).env(PROGRESS.0, PROGRESS.1));
            let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
            (done.status.code(), text(&done.stdout), text(&done.stderr))
        }

        /// Runs what must succeed, and returns what it printed.
        fn succeed(&self, line: &str) -> String {
            let (code, printed, said) = self.run(line);
            assert_eq!((code, said.as_str()), (Some(0), ""), "{line}");
            printed
        }

        /// Runs what must fail with an exit code and these words.
        fn fail(&self, line: &str, code: i32, words: &str) {
            let (found, _, said) = self.run(line);
            assert_eq!(found, Some(code), "{line}: {said}");
            assert!(said.starts_with("error: ") && said.contains(words), "{line}: {said}");
        }
    }

    #[test]
    fn every_format_is_written_where_users_expect_it_and_read_back() {
        let room = Folder::new();
        let tile = scattered(shape(8, 8, 4, 1, 2));
        for (flags, path, levels) in [
            ("png8", "a-png8", Some(256.0)),
            ("png16 --strip --out strip", "strip/a.png", Some(65536.0)),
            ("png8 --plain-numbers --texels rgba --out plain", "plain", Some(256.0)),
            ("ktx2", "a.ktx2", Some(256.0)),
            ("ktx2 --bits 16 --out sixteen.ktx2", "sixteen.ktx2", Some(65536.0)),
            ("ktx2-3d --texels rgba --out volume.ktx2", "volume.ktx2", Some(256.0)),
            ("raw8", "a.raw", Some(256.0)),
            ("raw16 --out strip", "strip/a.raw", Some(65536.0)),
            ("npy", "a-u16.npy", Some(65536.0)),
            ("npy --bits 8", "a-u8.npy", Some(256.0)),
            ("exr", "a-exr", None),
            ("exr --layers --out layers", "layers/a.exr", None),
        ] {
            room.succeed(&format!("export a.npy --format {flags}"));
            let read = TileSource::new(room.0.at(path)).read().unwrap();
            let expected = levels.map_or_else(|| tile.clone(), |levels| quantized(&tile, levels));
            assert_eq!(bits(&read), bits(&expected), "{flags}");
        }
        assert!(room.0.names("plain").contains(&"a_f0.png".to_owned()));
        room.fail("export a.npy --format ktx2", 3, "a.ktx2 exists already");
        room.succeed("export a.npy --format ktx2 --force");
        room.fail("export a.npy --format npy --out ./a.npy --force", 2, "would replace the tile");
        for (language, file) in
            [("c", "a.h"), ("hlsl", "a.hlsl"), ("glsl", "a.glsl"), ("wgsl", "a.wgsl")]
        {
            room.succeed(&format!("export a.npy --format header --language {language}"));
            assert!(String::from_utf8(room.0.read(file)).unwrap().contains("a_point("), "{file}");
        }
    }

    #[test]
    fn tiles_share_a_texture() {
        let room = Folder::new();
        room.succeed("export a.npy b.npy --format ktx2 --out both.ktx2");
        let both = |channels: &str| TileSource {
            channels: Some(channels.parse().unwrap()),
            ..TileSource::new(room.0.at("both.ktx2"))
        };
        let [pair, single] =
            [2, 1].map(|dims| quantized(&scattered(shape(8, 8, 4, 1, dims)), 256.0));
        assert_eq!(both("rg").read().unwrap(), pair);
        assert_eq!(both("b").read().unwrap(), single);
        room.fail("export a.npy more.npy --format ktx2 --out x", 2, "do not go into one texture");
        room.fail("export a.npy many.npy --format ktx2 --out x", 2, "7 dimensions");
    }

    #[test]
    fn impossible_combinations_name_what_would_work() {
        let room = Folder::new();
        for (line, words) in [
            ("a.npy --format raw8 --bits 16", "raw16 has 16"),
            ("a.npy --format png16 --bits 8", "png8 has 8"),
            ("a.npy --format ktx2-3d --bits 16", "--format ktx2 has 16"),
            ("a.npy --format ktx2 --bits 12", "8 or 16"),
            ("a.npy --format exr --bits 8", "floats"),
            ("a.npy --format png8 --texels rg", "--format ktx2 has rg"),
            ("a.npy --format png8 --texels r", "`rg` or `rgb` or `rgba` would"),
            ("a.npy --format ktx2 --texels r", "`rg` or `rgb` or `rgba` would"),
            ("a.npy --format ktx2 --texels rgx", "r, rg, rgb or rgba"),
            ("many.npy --format ktx2", "--channels rg takes two of them"),
            ("a.npy --format npy --texels rg", "pictures and textures"),
            ("a.npy --format ktx2 --strip", "png8 or png16"),
            ("a.npy --format png8 --layers", "but with exr"),
            ("a.npy --format raw8 --plain-numbers", "png8, png16 or exr"),
            ("a.npy --format ktx2 --language c", "but with header"),
            ("a.npy --format header --language glsl --for raw8", "--for ktx2"),
            ("a.npy --format header --for exr", "ktx2"),
            ("a.npy --format exr --exact", "needs a format with levels"),
        ] {
            room.fail(&format!("export {line} --out out"), 2, words);
            assert!(!room.0.at("out").exists(), "{line}");
        }
    }

    #[test]
    fn exact_levels_are_said_to_cost_little() {
        let room = Folder::new();
        let said = room.succeed("export b.npy --exact --format raw8");
        assert!(said.contains("perceived error of b.npy") && said.contains("linear"), "{said}");
        let mut counts = [0; 256];
        for &level in &room.0.read("b.raw") {
            counts[usize::from(level)] += 1;
        }
        // 64 pixels in each of 4 frames have every fourth level, in the middle.
        let expected = |level: usize| if level % 4 == 2 { 4 } else { 0 };
        assert!((0..256).all(|level| counts[level] == expected(level)), "{counts:?}");
        let made = "optimize --domain sphere --preset quick --tile 8x8x8 --steps 2 --integrands 0";
        room.succeed(&format!("{made} --out s.npy"));
        room.fail("export s.npy --exact", 2, "tiles of the square");
    }

    #[test]
    fn a_density_is_not_needed_for_its_tile() {
        let room = Folder::new();
        let levels = perceptile::format::png::Raster {
            width: 2,
            height: 2,
            layout: perceptile::format::png::PixelFormat::Gray,
            depth: Depth::Eight,
            levels: vec![255, 0, 128, 64],
        };
        let mut bytes = Vec::new();
        perceptile::format::png::encode(&levels, &mut bytes).unwrap();
        fs::write(room.0.at("lamp.png"), bytes).unwrap();
        let made = "optimize --preset quick --tile 8x8x8 --steps 2 --integrands 0 --out t.npy";
        room.succeed(&format!("{made} --domain 'density(lamp.png)'"));
        fs::remove_file(room.0.at("lamp.png")).unwrap();
        room.succeed("export t.npy --format ktx2");
        room.succeed("export t.npy --format header --language wgsl");
        room.fail("export t.npy --exact", 2, "samples of a density, but --exact is for");
    }

    #[test]
    fn a_texture_keeps_the_kernel_of_its_tile() {
        let room = Folder::new();
        let made = "optimize --preset quick --tile 16x16x8 --steps 5 --integrands 0";
        room.succeed(&format!("{made} --kernel 'gaussian(1.5) @ 5x5x1' --out t.npy"));
        for format in ["ktx2", "raw8", "npy"] {
            room.succeed(&format!("export t.npy --format {format} --out {format}.{format}"));
            let said = room.succeed(&format!("evaluate {format}.{format} --integrands 4"));
            assert!(
                said.contains(&format!("gaussian(1.5) @ 5x5x1 (from {format}.json)")),
                "{said}"
            );
        }
    }
}
