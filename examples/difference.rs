//! Draws what the error of tiles looks like, one row for each tile, for one integrand.
//!
//! ```text
//! cargo run --release --example difference -- OUT.png KERNEL TILE.npy...
//! ```
//!
//! Columns: the error of a pixel's estimate in one frame, and in an XT slice (time runs down);
//! then the same two as perceived, behind the kernel, magnified in contrast alike for all tiles.

use std::path::{Path, PathBuf};

use anyhow::bail;
use glam::IVec3;
use perceptile::format::picture::Image;
use perceptile::format::source::TileSource;
use perceptile::format::write::Existing;
use perceptile::kernel::{KernelSpec, KernelTaps};
use perceptile::metric::{Class, integrand_sets};
use perceptile::tile::{Tile, TileShape};

/// Screen pixels of a sample, and of the gap between panels.
const SCALE: usize = 4;
const GAP: usize = 8;
/// Pixels across and down of a panel.
const SIDE: usize = 64;

fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [out, kernel, tiles @ ..] = &args[..] else {
        bail!("usage: difference OUT.png KERNEL TILE.npy...");
    };
    let kernel: KernelSpec = kernel.parse()?;
    let mut rows = Vec::new();
    for path in tiles {
        let tile = TileSource::new(PathBuf::from(path)).read()?;
        let shape = tile.shape();
        let resolved = kernel.resolve(shape)?;
        let taps = &resolved.classes()[0].taps;
        let raw = errors(&tile);
        let perceived = filter(shape, &raw, taps);
        rows.push([
            panel(shape, &raw, false),
            panel(shape, &raw, true),
            panel(shape, &perceived, false),
            panel(shape, &perceived, true),
        ]);
    }
    // One contrast for all raw panels, one for all perceived ones.
    let spread = |columns: std::ops::Range<usize>| {
        let values = rows.iter().flat_map(|row| row[columns.clone()].iter().flatten());
        let (n, sum) = values.fold((0, 0.0), |(n, sum), x| (n + 1, sum + x * x));
        (sum / n.max(1) as f32).sqrt()
    };
    // White noise would hide the others: what is perceived is magnified until it saturates.
    let contrast = [spread(0..2), 0.3 * spread(2..4)];
    let step = SIDE * SCALE + GAP;
    let (width, height) = (4 * step - GAP, (rows.len() * step).max(step) - GAP);
    let image = Image::gray(width, height, |x, y| {
        let (column, row) = (x / step, y / step);
        let (i, j) = (x % step / SCALE, y % step / SCALE);
        if i >= SIDE || j >= SIDE {
            return 255;
        }
        let value = rows[row][column][j * SIDE + i] / contrast[column / 2];
        (127.5 + 50.0 * value).clamp(0.0, 255.0) as u8
    })?;
    image.save(Path::new(out), Existing::Replace)?;
    Ok(())
}

/// The error of the first bump of the first set of integrands, at every pixel.
fn errors(tile: &Tile) -> Vec<f32> {
    let sets = integrand_sets(0, tile.shape().dims(), 1);
    let bump = sets.iter().find(|set| set.class == Class::Bump);
    let mut errors = vec![0.0; tile.shape().pixels()];
    if let Some(bump) = bump.and_then(|set| set.integrands.first()) {
        bump.errors(tile, &mut errors);
    }
    errors
}

/// The error behind the kernel, around the torus.
fn filter(shape: TileShape, errors: &[f32], kernel: &KernelTaps) -> Vec<f32> {
    let size = IVec3::new(shape.width() as i32, shape.height() as i32, shape.frames() as i32);
    let mut filtered = Vec::with_capacity(errors.len());
    for t in 0..size.z {
        for y in 0..size.y {
            for x in 0..size.x {
                let sum: f64 = kernel
                    .taps()
                    .iter()
                    .map(|tap| {
                        let p = (IVec3::new(x, y, t) + tap.offset).rem_euclid(size).as_usizevec3();
                        tap.weight * f64::from(errors[shape.pixel(p.x, p.y, p.z)])
                    })
                    .sum();
                filtered.push(sum as f32);
            }
        }
    }
    filtered
}

/// Frame 0, or the slice y = 0 with time running down; both repeat to fill the panel.
fn panel(shape: TileShape, errors: &[f32], slice: bool) -> Vec<f32> {
    let at = |x: usize, y: usize| {
        let x = x % shape.width();
        let (y, t) = if slice { (0, y % shape.frames()) } else { (y % shape.height(), 0) };
        errors[shape.pixel(x, y, t)]
    };
    (0..SIDE * SIDE).map(|place| at(place % SIDE, place / SIDE)).collect()
}
