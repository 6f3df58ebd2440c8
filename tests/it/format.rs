//! Tiles through files and back.

use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use perceptile::domain::Domain;
use perceptile::format::npy;
use perceptile::format::png::{self, Depth, PixelFormat, Raster};
use perceptile::format::sidecar;
use perceptile::format::slices::{Picture, SliceOptions, Stack, slice_paths, write_slices};
use perceptile::format::source::{SourceError, TileSource};
use perceptile::format::write::{self, Existing, WriteError};
use perceptile::kernel::KernelSpec;
use perceptile::preview::Preview;
use perceptile::tile::{BELOW_ONE, Tile, TileShape};
use proptest::prelude::*;

pub fn shape(width: usize, height: usize, frames: usize, spp: usize, dims: usize) -> TileShape {
    TileShape::new(width, height, frames, spp, dims).unwrap()
}

/// A tile whose coordinates all differ, spread over the interval without order.
pub fn scattered(shape: TileShape) -> Tile {
    let count = shape.coordinates();
    let golden = |i: usize| ((i as f64 + 0.5) * 0.618_033_988_749_895).fract() as f32;
    Tile::new(shape, (0..count).map(golden).collect()).unwrap()
}

pub fn npy_bytes(tile: &Tile) -> Vec<u8> {
    let mut bytes = Vec::new();
    npy::write_tile(tile, &mut bytes).unwrap();
    bytes
}

pub fn bits(tile: &Tile) -> Vec<u32> {
    tile.samples().iter().map(|x| x.to_bits()).collect()
}

fn shapes() -> impl Strategy<Value = TileShape> {
    (1_usize..6, 1_usize..6, 1_usize..5, 1_usize..4, 1_usize..8)
        .prop_map(|(width, height, frames, spp, dims)| shape(width, height, frames, spp, dims))
}

/// Tiles of any bits that are coordinates.
fn tiles() -> impl Strategy<Value = Tile> {
    shapes().prop_flat_map(|shape| {
        let coordinate = (0..=BELOW_ONE.to_bits()).prop_map(f32::from_bits);
        proptest::collection::vec(coordinate, shape.coordinates())
            .prop_map(move |samples| Tile::new(shape, samples).unwrap())
    })
}

/// The tile after every coordinate went to the middle of its bin.
pub fn quantized(tile: &Tile, levels: f64) -> Tile {
    let middle = |&x: &f32| (((f64::from(x) * levels).floor() + 0.5) / levels) as f32;
    Tile::new(tile.shape(), tile.samples().iter().map(middle).collect()).unwrap()
}

proptest! {
    #[test]
    fn a_tile_survives_npy_bit_for_bit(tile in tiles()) {
        let bytes = npy_bytes(&tile);
        let back = npy::read_tile(&bytes[..], bytes.len() as u64, None).unwrap();
        prop_assert_eq!(back.shape(), tile.shape());
        prop_assert_eq!(bits(&back), bits(&tile));
        // Another reader sees the same.
        let file = npyz::NpyFile::new(&bytes[..]).unwrap();
        let sizes = [
            tile.shape().frames(),
            tile.shape().height(),
            tile.shape().width(),
            tile.shape().spp(),
            tile.shape().dims(),
        ];
        prop_assert_eq!(file.shape(), sizes.map(|size| size as u64));
        prop_assert_eq!(file.order(), npyz::Order::C);
        prop_assert_eq!(file.into_vec::<f32>().unwrap(), tile.samples());
        prop_assert_eq!(bytes.len() % 64, tile.samples().len() * 4 % 64);
    }

    #[test]
    fn a_tile_survives_png_up_to_its_bins(
        tile in tiles(),
        sixteen in any::<bool>(),
        strip in any::<bool>(),
    ) {
        let shape = tile.shape();
        let folder = tempfile::tempdir().unwrap();
        let (depth, levels) = if sixteen { (Depth::Sixteen, 65536.0) } else { (Depth::Eight, 256.0) };
        let stack = if strip { Stack::Strip } else { Stack::Files };
        let options =
            SliceOptions { picture: Picture::Png(depth), stack, ..SliceOptions::default() };
        let paths = write_slices(&tile, options, folder.path(), "t_8x8", Existing::Keep).unwrap();
        prop_assert_eq!(&paths, &slice_paths(shape, options, folder.path(), "t_8x8"));
        let parts = if shape.dims() > 4 { shape.dims().div_ceil(2) } else { 1 } * shape.spp();
        prop_assert_eq!(paths.len(), if strip { parts } else { parts * shape.frames() });
        // Each sample and group of dimensions of a strip is a picture of its own.
        if strip && parts > 1 {
            return Ok(());
        }
        let mut source = TileSource::new(if strip { &paths[0] } else { folder.path() });
        source.frames = Some(shape.frames());
        source.spp = Some(shape.spp());
        if shape.dims() <= 4 {
            source.channels = Some("rgba"[..shape.dims()].parse().unwrap());
        }
        let back = source.read().unwrap();
        prop_assert_eq!(back.shape(), shape);
        prop_assert_eq!(bits(&back), bits(&quantized(&tile, levels)));
    }
}

/// Elements of a foreign file, each with the coordinates that it stands for.
fn foreign(descr: &str, count: usize) -> (Vec<u8>, Vec<f32>) {
    let big = descr.starts_with('>');
    let order = |mut bytes: Vec<u8>| {
        if big {
            bytes.reverse();
        }
        bytes
    };
    let mut data = Vec::new();
    let mut coordinates = Vec::new();
    for i in 0..count {
        let x = ((i * 7919 + 13) % 65521) as f64 / 65521.0;
        let (bytes, coordinate) = match &descr[1..] {
            "f8" => (x.to_le_bytes().to_vec(), x as f32),
            "f4" => ((x as f32).to_le_bytes().to_vec(), x as f32),
            "u2" => {
                let level = (x * 65536.0) as u16;
                (level.to_le_bytes().to_vec(), ((f64::from(level) + 0.5) / 65536.0) as f32)
            }
            _ => {
                let level = (x * 256.0) as u8;
                (vec![level], ((f64::from(level) + 0.5) / 256.0) as f32)
            }
        };
        data.extend(order(bytes));
        coordinates.push(coordinate);
    }
    (data, coordinates)
}

#[test]
fn foreign_arrays_mean_the_same_in_every_order_and_type() {
    for descr in ["<f8", ">f8", "<f4", ">f4", "<u2", ">u2", "|u1"] {
        for (axes, expected) in [
            (&[3_usize, 4, 5][..], shape(5, 4, 3, 1, 1)),
            (&[3, 4, 5, 2], shape(5, 4, 3, 1, 2)),
            (&[3, 4, 5, 2, 3], shape(5, 4, 3, 2, 3)),
        ] {
            let count = axes.iter().product();
            let (data, coordinates) = foreign(descr, count);
            let file = |fortran: &str, data: &[u8]| {
                let shape = axes.iter().map(|n| format!("{n}, ")).collect::<String>();
                let header = format!(
                    "{{'shape': ({shape}), 'fortran_order': {fortran}, \"descr\": '{descr}'}}"
                );
                let mut bytes = b"\x93NUMPY\x03\x00".to_vec();
                bytes.extend((header.len() as u32).to_le_bytes());
                bytes.extend(header.as_bytes());
                bytes.extend(data);
                npy::read_tile(&bytes[..], bytes.len() as u64, None).unwrap()
            };
            let tile = file("False", &data);
            assert_eq!(tile.shape(), expected, "{descr}");
            assert_eq!(tile.samples(), coordinates, "{descr}");

            // The same array, its elements moved to where Fortran order has them.
            let size = data.len() / count;
            let mut moved = vec![0; data.len()];
            for (place, element) in data.chunks_exact(size).enumerate() {
                let mut left = place;
                let index: Vec<usize> = axes
                    .iter()
                    .rev()
                    .map(|n| {
                        let i = left % n;
                        left /= n;
                        i
                    })
                    .collect();
                let position = index
                    .iter()
                    .zip(axes.iter().rev())
                    .fold(0, |position, (i, n)| position * n + i);
                moved[position * size..][..size].copy_from_slice(element);
            }
            assert_eq!(file("True", &moved).samples(), coordinates, "{descr}");
        }
    }
}

fn save(path: &Path, raster: &Raster) {
    write::write(path, Existing::Keep, |out| png::encode(raster, out)).unwrap();
}

fn gray(width: usize, height: usize, first: u16) -> Raster {
    let levels = (0..(width * height) as u16).map(|i| first + i).collect();
    Raster { width, height, layout: PixelFormat::Gray, depth: Depth::Eight, levels }
}

#[test]
fn slices_of_a_folder_come_in_the_order_of_their_numbers() {
    let folder = tempfile::tempdir().unwrap();
    for frame in 0..12 {
        save(&folder.path().join(format!("noise_{frame}.PNG")), &gray(2, 3, frame * 20));
    }
    fs::write(folder.path().join("licence.txt"), "free").unwrap();
    let tile = TileSource::new(folder.path()).read().unwrap();
    assert_eq!(tile.shape(), shape(2, 3, 12, 1, 1));
    for frame in 0..12 {
        assert_eq!(tile.point(1, 2, frame, 0), [(frame as f32 * 20.0 + 5.5) / 256.0]);
    }
    // The same slices as three samples of four frames.
    let mut source = TileSource::new(folder.path());
    source.spp = Some(3);
    let tile = source.read().unwrap();
    assert_eq!(tile.shape(), shape(2, 3, 4, 3, 1));
    assert_eq!(tile.point(0, 0, 2, 1), [(7.0 * 20.0 + 0.5) / 256.0]);
    source.spp = Some(5);
    assert!(matches!(source.read(), Err(SourceError::Spp { slices: 12, spp: 5, .. })));
    source.spp = Some(0);
    assert!(matches!(source.read(), Err(SourceError::Spp { spp: 0, .. })));
    source.spp = None;
    source.frames = Some(11);
    assert!(matches!(source.read(), Err(SourceError::Frames { found: 12, asked: 11, .. })));
}

#[test]
fn a_strip_is_cut_into_squares_or_as_told() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("strip");
    save(&path, &gray(4, 24, 0));
    let read = |frames, spp| TileSource { frames, spp, ..TileSource::new(&path) }.read();
    assert_eq!(read(None, None).unwrap().shape(), shape(4, 4, 6, 1, 1));
    assert_eq!(read(Some(3), None).unwrap().shape(), shape(4, 8, 3, 1, 1));
    assert_eq!(read(Some(3), Some(2)).unwrap().shape(), shape(4, 4, 3, 2, 1));
    let tile = read(None, Some(3)).unwrap();
    assert_eq!(tile.shape(), shape(4, 4, 2, 3, 1));
    // Slice 4 is sample 1 of frame 1.
    assert_eq!(tile.point(2, 1, 1, 1), [(4.0 * 16.0 + 6.0 + 0.5) / 256.0]);
    for (frames, spp) in
        [(Some(5), None), (Some(0), None), (Some(48), None), (Some(usize::MAX), Some(2))]
    {
        assert!(matches!(read(frames, spp), Err(SourceError::Strip { .. })), "{frames:?} {spp:?}");
    }
    assert!(matches!(read(Some(6), Some(0)), Err(SourceError::Strip { .. })));
    assert!(matches!(read(None, Some(0)), Err(SourceError::Spp { .. })));
    save(&folder.path().join("odd"), &gray(4, 7, 0));
    let odd = TileSource::new(folder.path().join("odd")).read();
    assert!(matches!(odd, Err(SourceError::Strip { .. })));
    // Also where it lies alone in a folder, as it is exported; a slice says its frame.
    let alone = folder.path().join("alone");
    fs::create_dir(&alone).unwrap();
    save(&alone.join("noise.png"), &gray(4, 24, 0));
    assert_eq!(TileSource::new(&alone).read().unwrap().shape(), shape(4, 4, 6, 1, 1));
    fs::rename(alone.join("noise.png"), alone.join("noise_f000.png")).unwrap();
    assert_eq!(TileSource::new(&alone).read().unwrap().shape(), shape(4, 24, 1, 1, 1));
}

#[test]
fn channels_are_chosen_or_the_colours_that_say_something() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("slice.png");
    let mut raster = Raster {
        width: 1,
        height: 2,
        layout: PixelFormat::Rgba,
        depth: Depth::Eight,
        levels: vec![10, 20, 0, 40, 11, 21, 0, 41],
    };
    raster.width = 2;
    raster.height = 1;
    save(&path, &raster);
    let read = |channels: &str| {
        let channels = (!channels.is_empty()).then(|| channels.parse().unwrap());
        TileSource { channels, frames: Some(1), ..TileSource::new(&path) }.read().map(|tile| {
            tile.samples().iter().map(|x| (x * 256.0).floor() as i32).collect::<Vec<_>>()
        })
    };
    // Alpha that says something counts, and all before it.
    assert_eq!(read("").unwrap(), [10, 20, 0, 40, 11, 21, 0, 41]);
    raster.levels = vec![10, 20, 0, 255, 11, 21, 0, 255];
    write::write(&path, Existing::Replace, |out| png::encode(&raster, out)).unwrap();
    assert_eq!(read("").unwrap(), [10, 20, 11, 21]);
    raster.levels = vec![10, 20, 0, 40, 11, 21, 0, 41];
    write::write(&path, Existing::Replace, |out| png::encode(&raster, out)).unwrap();
    assert_eq!(read("rgb").unwrap(), [10, 20, 0, 11, 21, 0]);
    assert_eq!(read("ag").unwrap(), [40, 20, 41, 21]);
    raster.layout = PixelFormat::Gray;
    raster.width = 8;
    write::write(&path, Existing::Replace, |out| png::encode(&raster, out)).unwrap();
    assert_eq!(read("r").unwrap(), [10, 20, 0, 40, 11, 21, 0, 41]);
    let error = read("rg").unwrap_err();
    assert!(matches!(error, SourceError::Channel { .. }));
    assert!(error.to_string().contains("channel g") && error.to_string().contains("gray"));

    let tile = scattered(shape(2, 2, 1, 2, 3));
    let npy = folder.path().join("tile.npy");
    fs::write(&npy, npy_bytes(&tile)).unwrap();
    let select = |channels: &str| {
        TileSource { channels: Some(channels.parse().unwrap()), ..TileSource::new(&npy) }.read()
    };
    let chosen = select("bg").unwrap();
    assert_eq!(chosen.shape(), shape(2, 2, 1, 2, 2));
    let (all, some) = (tile.point(1, 0, 0, 1), chosen.point(1, 0, 0, 1));
    assert_eq!(some, [all[2], all[1]]);
    assert!(matches!(select("a"), Err(SourceError::Channel { .. })));
}

#[test]
fn an_export_of_many_samples_and_dimensions_is_read_without_being_told() {
    for (spp, dims) in [(1, 1), (1, 2), (1, 3), (4, 1), (3, 2), (1, 5), (2, 6), (2, 16)] {
        let tile = scattered(shape(5, 4, 3, spp, dims));
        let folder = tempfile::tempdir().unwrap();
        let options =
            SliceOptions { picture: Picture::Png(Depth::Sixteen), ..SliceOptions::default() };
        let paths = write_slices(&tile, options, folder.path(), "t", Existing::Keep).unwrap();
        let name = paths[0].file_name().unwrap().to_str().unwrap();
        let plain = spp == 1 && dims <= 4;
        assert_eq!(name, if plain { "t_f000.png" } else { "t_f000_s00_d00.png" });
        let back = TileSource::new(folder.path()).read().unwrap();
        assert_eq!(bits(&back), bits(&quantized(&tile, 65536.0)), "{spp} spp, {dims} dims");

        let again = write_slices(&tile, options, folder.path(), "t", Existing::Keep);
        assert!(matches!(again, Err(WriteError::Exists { .. })));
        fs::remove_file(paths.last().unwrap()).unwrap();
        let read = TileSource::new(folder.path()).read();
        if plain {
            // One frame fewer is a whole series, too.
            assert_eq!(read.unwrap().shape().frames(), 2);
        } else {
            assert!(matches!(read, Err(SourceError::Series { .. })));
        }
    }
}

#[test]
fn slices_of_two_tiles_never_lie_in_one_folder() {
    let tile = |frames, spp| scattered(shape(4, 3, frames, spp, 2));
    let slices = SliceOptions::default();
    let strips = SliceOptions { stack: Stack::Strip, ..slices };
    // What an export finds of an earlier one: other frames, other samples, another name, another
    // form. And the strips that may stay beside other strips.
    for (old, new, apart) in [
        ((tile(5, 1), "t", slices), (tile(3, 1), "t", slices), false),
        ((tile(3, 1), "t", slices), (tile(5, 2), "t", slices), false),
        ((tile(3, 4), "t", slices), (tile(3, 2), "t", slices), false),
        ((tile(3, 1), "u", slices), (tile(3, 1), "t", slices), false),
        ((tile(3, 1), "t", strips), (tile(3, 1), "t", slices), false),
        ((tile(3, 1), "u", slices), (tile(3, 1), "t", strips), false),
        ((tile(3, 3), "t", strips), (tile(3, 2), "t", strips), false),
        ((tile(3, 1), "t", strips), (tile(3, 2), "t", strips), false),
        ((tile(3, 2), "u", strips), (tile(3, 2), "t", strips), true),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let write = |(tile, stem, options): &(Tile, &str, SliceOptions), existing| {
            write_slices(tile, *options, folder.path(), stem, existing)
        };
        // Whoever imports pictures keeps notes beside them.
        fs::write(folder.path().join("t_f000.png.meta"), "theirs").unwrap();
        let before = write(&old, Existing::Keep).unwrap();
        let content = || -> Vec<(PathBuf, Vec<u8>)> {
            let entries = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path());
            let mut files: Vec<_> = entries.map(|it| (it.clone(), fs::read(it).unwrap())).collect();
            files.sort();
            files
        };
        let first = content();
        let result = write(&new, Existing::Keep);
        if !apart {
            let error = result.unwrap_err();
            let named = matches!(&error, WriteError::Beside { path } | WriteError::Exists { path }
                    if before.contains(path));
            assert!(named && error.to_string().contains("--force"), "{error}");
            assert_eq!(content(), first);
        }
        let after = write(&new, Existing::Replace).unwrap();
        let notes = vec![folder.path().join("t_f000.png.meta")];
        let mut expected = [notes, after, if apart { before } else { Vec::new() }].concat();
        expected.sort();
        assert!(content().iter().map(|(path, _)| path).eq(&expected), "{expected:?}");
        if new.2.stack == Stack::Files {
            let back = TileSource::new(folder.path()).read().unwrap();
            assert_eq!(bits(&back), bits(&quantized(&new.0, 256.0)));
        }
    }
}

#[test]
fn an_export_removes_no_picture_of_somebody_else() {
    let tile = scattered(shape(4, 3, 2, 1, 2));
    for name in ["photo.png", "t_f002.png", "t_f2.PNG", "link.png"] {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        if name == "link.png" {
            fs::create_dir(at("away")).unwrap();
            let options = SliceOptions { stack: Stack::Strip, ..SliceOptions::default() };
            write_slices(&tile, options, &at("away"), "ours", Existing::Keep).unwrap();
            #[cfg(unix)]
            std::os::unix::fs::symlink("away/ours.png", at(name)).unwrap();
            #[cfg(not(unix))]
            continue;
        } else {
            save(&at(name), &gray(4, 3, 0));
        }
        let options = SliceOptions::default();
        for existing in [Existing::Keep, Existing::Replace] {
            let error = write_slices(&tile, options, folder.path(), "t", existing).unwrap_err();
            assert!(error.to_string().contains(name), "{error}");
            assert_eq!(matches!(error, WriteError::Foreign { .. }), existing == Existing::Replace);
            assert!(at(name).exists() && !at("t_f000.png").exists());
        }
    }
}

#[test]
fn folders_that_are_no_tile_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let read = || TileSource::new(folder.path()).read().unwrap_err();
    assert!(matches!(read(), SourceError::Empty { .. }));
    save(&at("a_0.png"), &gray(2, 2, 0));
    save(&at("a_1.png"), &gray(2, 3, 0));
    let error = read();
    assert!(matches!(error, SourceError::Unequal { .. }));
    assert!(error.to_string().contains("2x3 pixels") && error.to_string().contains("2x2 pixels"));
    fs::write(at("a_1.png"), "not a picture").unwrap();
    assert!(matches!(read(), SourceError::Png { .. }));
    fs::remove_file(at("a_1.png")).unwrap();
    fs::create_dir(at("a_1.png")).unwrap();
    assert!(matches!(read(), SourceError::Special { .. }));
    save(&at("b_0.png"), &gray(2, 2, 0));
    assert!(matches!(read(), SourceError::Series { .. }));
}

#[test]
fn what_is_no_tile_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let read = |name: &str| TileSource::new(at(name)).read().unwrap_err();
    assert!(matches!(read("missing.npy"), SourceError::Io { .. }));
    for (name, content) in
        [("empty.npy", ""), ("text.npy", "hello, I am a text"), ("short", "\u{89}P")]
    {
        fs::write(at(name), content).unwrap();
        let error = read(name);
        assert!(matches!(error, SourceError::Unknown { .. }), "{error}");
        assert!(error.to_string().contains(name));
    }
    fs::write(at("cut.npy"), &npy_bytes(&scattered(shape(4, 4, 4, 1, 2)))[..200]).unwrap();
    assert!(matches!(read("cut.npy"), SourceError::Npy { .. }));
    if cfg!(unix) {
        let error = TileSource::new("/dev/zero").read().unwrap_err();
        assert!(matches!(error, SourceError::Special { .. }));
    }
    // A frame count that the file does not have.
    fs::write(at("tile.npy"), npy_bytes(&scattered(shape(4, 4, 4, 1, 2)))).unwrap();
    let source = TileSource { frames: Some(8), ..TileSource::new(at("tile.npy")) };
    assert!(matches!(source.read(), Err(SourceError::Frames { found: 4, asked: 8, .. })));
}

#[test]
fn the_picture_of_a_tile_is_saved_as_it_was_drawn_and_is_no_tile() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("preview.png");
    let tile = scattered(shape(16, 8, 12, 1, 2));
    let spec: KernelSpec = "gaussian(1) @ 3x3x1".parse().unwrap();
    let kernel = spec.resolve(tile.shape()).unwrap();
    let mut preview = Preview::new((Domain::Square, tile.shape()), &kernel.classes()[0].taps);
    preview.take(tile.samples());
    let picture = preview.image(None);
    picture.save(&path, Existing::Keep).unwrap();
    let bytes = fs::read(&path).unwrap();
    let raster = png::decode(Cursor::new(&bytes), bytes.len() as u64).unwrap();
    assert_eq!((raster.width, raster.height), (picture.width(), picture.height()));
    assert_eq!(raster.layout, PixelFormat::Rgb);
    assert!(raster.levels.iter().zip(picture.data()).all(|(&a, &b)| a == u16::from(b)));
    // However it is to be cut.
    let refuse = |frames| {
        let error = TileSource { frames, ..TileSource::new(&path) }.read().unwrap_err();
        assert!(matches!(error, SourceError::Preview { .. }), "{error}");
        error.to_string()
    };
    for frames in [None, Some(1)] {
        assert!(refuse(frames).ends_with("preview.png is the picture of a tile, not a tile"));
    }
    fs::write(folder.path().join("preview.npy"), npy_bytes(&tile)).unwrap();
    let words = refuse(None);
    assert!(words.contains("not a tile: give ") && words.ends_with("preview.npy"), "{words}");
}

#[test]
fn the_digest_is_that_of_the_file() {
    // From `sha256sum` on the file that NumPy wrote for the same array.
    let tile = Tile::new(
        shape(3, 2, 1, 1, 2),
        vec![0.0, 0.25, 0.5, 0.75, 0.125, 0.375, 0.625, 0.875, 0.0625, 0.1875, 0.3125, 0.4375],
    )
    .unwrap();
    assert_eq!(
        sidecar::digest(&tile),
        "7365d50216eb5b4671c5378376f9c8bb9937ab755b825f0da66d051d688e2029"
    );
}
