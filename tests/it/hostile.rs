//! Files that were made to do harm: every reader answers, and takes no more memory than the size of the
//! file justifies.

use std::fs;
use std::io::Cursor;

use perceptile::format::ktx2::{self, Layout};
use perceptile::format::png::{self, Depth, PixelFormat, Raster};
use perceptile::format::sidecar::{self, Sidecar};
use perceptile::format::slices::{Picture, SliceOptions, Stack, write_slices};
use perceptile::format::source::TileSource;
use perceptile::format::texture::Texels;
use perceptile::format::write::Existing;
use perceptile::format::{npy, raw};
use proptest::prelude::*;

use crate::format::{npy_bytes, scattered, shape};

/// What an attacker does to a file.
#[derive(Debug, Clone)]
enum Damage {
    Flip(prop::sample::Index, u8),
    Cut(prop::sample::Index),
    Insert(prop::sample::Index, Vec<u8>),
    /// Replaces one of the texts that readers trust.
    Word(prop::sample::Index, &'static str),
}

fn damages(words: &'static [&'static str]) -> impl Strategy<Value = Vec<Damage>> {
    let damage = prop_oneof![
        4 => (any::<prop::sample::Index>(), 1_u8..).prop_map(|(i, x)| Damage::Flip(i, x)),
        1 => any::<prop::sample::Index>().prop_map(Damage::Cut),
        1 => (any::<prop::sample::Index>(), prop::collection::vec(any::<u8>(), 1..9))
            .prop_map(|(i, bytes)| Damage::Insert(i, bytes)),
        3 => (any::<prop::sample::Index>(), prop::sample::select(words))
            .prop_map(|(i, word)| Damage::Word(i, word)),
    ];
    prop::collection::vec(damage, 1..4)
}

/// Applies `damages`; words replace a run of letters or digits in the first 200 bytes.
fn damaged(mut bytes: Vec<u8>, damages: &[Damage]) -> Vec<u8> {
    for damage in damages {
        if bytes.is_empty() {
            break;
        }
        match damage {
            Damage::Flip(at, mask) => {
                let at = at.index(bytes.len());
                bytes[at] ^= mask;
            }
            Damage::Cut(at) => bytes.truncate(at.index(bytes.len())),
            Damage::Insert(at, new) => {
                let at = at.index(bytes.len());
                bytes.splice(at..at, new.iter().copied());
            }
            Damage::Word(at, word) => {
                let start = at.index(bytes.len().min(200));
                let run = |c: &&u8| c.is_ascii_alphanumeric();
                let before = bytes[..start].iter().rev().take_while(run).count();
                let after = bytes[start..].iter().take_while(run).count();
                bytes.splice(start - before..start + after, word.bytes());
            }
        }
    }
    bytes
}

const NPY_WORDS: &[&str] = &[
    "0",
    "-1",
    "7",
    "4294967296",
    "9223372036854775807",
    "18446744073709551615",
    "99999999999999999999999",
    "1e9",
    "f2",
    "f8",
    "u2",
    "i4",
    "O",
    "True",
    "None",
    "shape",
    "descr",
    "((((((((",
    "NUMPY",
    "",
];

const JSON_WORDS: &[&str] = &[
    "0",
    "-1",
    "1e999",
    "18446744073709551616",
    "null",
    "true",
    "NaN",
    "{}",
    "[[[[",
    "format",
    "shape",
    "\\u0000",
    "\\ud800",
    "\"",
    "",
];

/// Arrays of random numbers for the header, short data behind it.
fn npy_headers() -> impl Strategy<Value = Vec<u8>> {
    let size = prop_oneof![0_u64..5, any::<u64>(), Just(1 << 20), Just(1 << 32)];
    let descr = prop::sample::select(&["<f4", ">f8", "|u1", "<u2", "<f2", "|O", "<f99"][..]);
    (
        prop::collection::vec(size, 0..7),
        descr,
        any::<bool>(),
        prop::collection::vec(any::<u8>(), 0..99),
    )
        .prop_map(|(shape, descr, fortran, data)| {
            let order = if fortran { "True" } else { "False" };
            let header =
                format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape:?}, }}\n")
                    .replace('[', "(")
                    .replace(']', ")");
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend((header.len() as u16).to_le_bytes());
            bytes.extend(header.as_bytes());
            bytes.extend(data);
            bytes
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn no_npy_bytes_do_harm(
        damage in damages(NPY_WORDS),
        header in npy_headers(),
        noise in prop::collection::vec(any::<u8>(), 0..80),
        spp in prop::option::of(prop_oneof![0_usize..5, any::<usize>()]),
    ) {
        let valid = npy_bytes(&scattered(shape(3, 4, 2, 1, 2)));
        let lead = [b"\x93NUMPY\x01\x00", &noise[..]].concat();
        for bytes in [damaged(valid, &damage), damaged(header.clone(), &damage), header, noise, lead] {
            if let Ok(tile) = npy::read_tile(&bytes[..], bytes.len() as u64, spp) {
                prop_assert!(tile.samples().len() <= bytes.len());
                prop_assert!(tile.samples().iter().all(|x| (0.0..1.0).contains(x)));
            }
        }
    }

    #[test]
    fn no_json_bytes_do_harm(damage in damages(JSON_WORDS), noise in ".{0,60}") {
        let tile = scattered(shape(3, 4, 2, 1, 2));
        let valid = serde_json::json!({
            "format": 1, "program": "perceptile", "version": "0.1.0", "command": "perceptile",
            "kernel": "none", "seed": 1, "shape": tile.shape(), "options": {"steps": [1, 2.5]},
            "created": "1970-01-01T00:00:00Z", "seconds": 0.5, "sha256": sidecar::digest(&tile),
            "scores": null,
        });
        let valid = valid.to_string().into_bytes();
        prop_assert!(Sidecar::parse(&valid).is_ok());
        let _ = Sidecar::parse(&damaged(valid, &damage));
        let _ = Sidecar::parse(noise.as_bytes());
    }

    #[test]
    fn no_png_bytes_do_harm(
        damage in damages(&["IDAT", "IEND", "PLTE", "tRNS", "acTL", "fcTL", "fdAT", "zTXt", "IHDR"]),
        header in prop::collection::vec(any::<u8>(), 13),
        noise in prop::collection::vec(any::<u8>(), 0..80),
    ) {
        let raster = Raster {
            width: 4,
            height: 4,
            layout: PixelFormat::Rgb,
            depth: Depth::Sixteen,
            levels: (0..48).map(|i| i * 1365).collect(),
        };
        let mut valid = Vec::new();
        png::encode(&raster, &mut valid).unwrap();
        // The header's numbers: size, depth, colour, compression, filter, interlace.
        let mut lying = valid.clone();
        for (byte, new) in lying[16..29].iter_mut().zip(&header) {
            *byte = if new % 3 == 0 { new / 3 } else { *byte };
        }
        let lead = [&png::SIGNATURE[..], &noise[..]].concat();
        for mut bytes in [damaged(valid.clone(), &damage), lying, lead, noise] {
            for checked in [false, true] {
                if checked {
                    correct_checksums(&mut bytes);
                }
                if let Ok(raster) = png::decode(Cursor::new(&bytes), bytes.len() as u64) {
                    prop_assert!(raster.levels.len() <= 8 * 1100 * (bytes.len() + 1));
                }
            }
        }
    }

    #[test]
    fn no_ktx2_bytes_do_harm(
        damage in damages(&["KTXwriter", "PerceptileSample", "1 2", "0 0", "999999999999 1", "-1", ""]),
        words in prop::collection::vec((0_usize..26, any::<u32>()), 0..4),
        noise in prop::collection::vec(any::<u8>(), 0..80),
    ) {
        let tile = scattered(shape(3, 4, 2, 2, 2));
        let mut valid = Vec::new();
        ktx2::write(&tile, (Texels::Rg, Depth::Sixteen), Layout::Array, &mut valid).unwrap();
        // Numbers of the header: format, sizes, and where things are.
        let mut lying = valid.clone();
        for (word, value) in words {
            let value = if value % 2 == 0 { value % 300 } else { value };
            lying[12 + 4 * word % 92..][..4].copy_from_slice(&value.to_le_bytes());
        }
        let lead = [&ktx2::SIGNATURE[..], &noise[..]].concat();
        for bytes in [damaged(valid, &damage), lying, lead, noise] {
            if let Ok(texture) = ktx2::read(&bytes[..], bytes.len() as u64) {
                prop_assert!(texture.levels.len() <= bytes.len());
            }
        }
    }
}

/// Makes the checksum of every chunk right, so that the decoder looks at what is inside.
fn correct_checksums(bytes: &mut [u8]) {
    let mut at = 8;
    while let Some(head) = bytes.get(at..at + 4) {
        let length = u32::from_be_bytes(head.try_into().unwrap()) as usize;
        let Some(end) = at.checked_add(8 + length).filter(|end| end + 4 <= bytes.len()) else {
            break;
        };
        let crc = !bytes[at + 4..end].iter().fold(u32::MAX, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |crc, _| {
                (crc >> 1) ^ (0xedb8_8320 & (crc & 1).wrapping_neg())
            })
        });
        bytes[end..end + 4].copy_from_slice(&crc.to_be_bytes());
        at = end + 4;
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn no_raw_volume_does_harm(
        damage in damages(&["width", "0", "-1", "4294967295", "1e9", "channels", "bits", "null", "{"]),
        short in any::<prop::sample::Index>(),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.raw");
        let tile = scattered(shape(3, 4, 2, 2, 2));
        let mut bytes = Vec::new();
        let description = raw::write(&tile, (Texels::Rg, Depth::Sixteen), &mut bytes).unwrap();
        let text = serde_json::to_vec(&description).unwrap();
        fs::write(&path, &bytes).unwrap();
        fs::write(raw::description_of(&path), damaged(text.clone(), &damage)).unwrap();
        if let Ok(read) = TileSource::new(&path).read() {
            prop_assert_eq!(read.samples().len(), tile.samples().len());
        }
        fs::write(raw::description_of(&path), text).unwrap();
        let cut = short.index(bytes.len());
        fs::write(&path, &bytes[..cut]).unwrap();
        prop_assert!(raw::read(&path).is_err());
        bytes[cut] ^= 1;
        fs::write(&path, &bytes).unwrap();
        let is_refused = matches!(raw::read(&path), Err(raw::RawError::Digest { .. }));
        prop_assert!(is_refused);
    }

    #[test]
    fn no_exr_slices_do_harm(
        damage in damages(&["channels", "chlist", "R", "Y", "dataWindow", "box2i", "name", "string", ""]),
        layered: bool,
    ) {
        let folder = tempfile::tempdir().unwrap();
        let stack = if layered { Stack::Layers } else { Stack::Files };
        let options = SliceOptions { picture: Picture::Exr, stack, ..SliceOptions::default() };
        let tile = scattered(shape(3, 4, 2, 1, 2));
        let paths = write_slices(&tile, options, folder.path(), "t", Existing::Keep).unwrap();
        let bytes = fs::read(&paths[0]).unwrap();
        fs::write(&paths[0], damaged(bytes, &damage)).unwrap();
        if let Ok(read) = TileSource::new(folder.path()).read() {
            prop_assert!(read.samples().iter().all(|x| (0.0..1.0).contains(x)));
        }
    }
}
