//! Draws what the error of tiles looks like, one row for each tile, for one integrand.
//!
//! ```text
//! cargo run --release --example difference -- OUT.png KERNEL LABEL=TILE.npy...
//! ```
//!
//! Columns: the error of a pixel's estimate in one frame, and in an XT slice (time runs down);
//! then the same two as perceived, behind the kernel, magnified in contrast alike for all tiles.
//! Above a row stand its label and its perceived squared error, that of the first row being 1.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use glam::IVec3;
use perceptile::domain::Domain;
use perceptile::format::source::TileSource;
use perceptile::format::write::Existing;
use perceptile::kernel::{KernelSpec, KernelTaps};
use perceptile::metric::{Class, digits, integrand_sets};
use perceptile::preview::canvas::{Canvas, LINE};
use perceptile::tile::{Tile, TileShape};

/// Screen pixels of a sample, and of the gap between panels.
const SCALE: usize = 4;
const GAP: usize = 8;
/// Pixels across and down of a panel.
const SIDE: usize = 64;
/// Screen pixels from one panel to the next, across and down.
const STEP: [usize; 2] = [SIDE * SCALE + GAP, SIDE * SCALE + LINE + 2 * GAP];
/// What the panels of a row show.
const COLUMNS: [&str; 4] = ["one frame", "XT slice", "frame, perceived", "XT slice, perceived"];

/// A tile's panels, and its perceived squared error.
struct Row {
    label: String,
    panels: [Vec<f32>; 4],
    error: f64,
}

fn main() -> anyhow::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [out, kernel, tiles @ ..] = &args[..] else {
        bail!("usage: difference OUT.png KERNEL LABEL=TILE.npy...");
    };
    let kernel: KernelSpec = kernel.parse()?;
    let mut rows = Vec::new();
    for tile in tiles {
        let (label, path) = tile.split_once('=').context("a tile is LABEL=TILE.npy")?;
        let tile = TileSource::new(PathBuf::from(path)).read()?;
        let shape = tile.shape();
        let resolved = kernel.resolve(shape)?;
        let raw = errors(&tile);
        let perceived = filter(shape, &raw, &resolved.classes()[0].taps);
        let squares = perceived.iter().map(|&error| f64::from(error).powi(2));
        rows.push(Row {
            label: label.to_owned(),
            error: squares.sum::<f64>() / perceived.len() as f64,
            panels: [(&raw, false), (&raw, true), (&perceived, false), (&perceived, true)]
                .map(|(errors, slice)| panel(shape, errors, slice)),
        });
    }
    draw(&rows).into_image().save(Path::new(out), Existing::Replace)?;
    Ok(())
}

/// All rows below the names of the columns.
fn draw(rows: &[Row]) -> Canvas {
    // One contrast for all raw panels, one for all perceived ones.
    let spread = |columns: std::ops::Range<usize>| {
        let values = rows.iter().flat_map(|row| row.panels[columns.clone()].iter().flatten());
        let (n, sum) = values.fold((0, 0.0), |(n, sum), x| (n + 1, sum + x * x));
        (sum / n.max(1) as f32).sqrt()
    };
    // White noise would hide the others: what is perceived is magnified until it saturates.
    let contrast = [spread(0..2), 0.3 * spread(2..4)];
    let top = LINE + GAP;
    let mut canvas = Canvas::new(COLUMNS.len() * STEP[0] - GAP, top + rows.len() * STEP[1]);
    for (column, name) in COLUMNS.iter().enumerate() {
        canvas.text([column * STEP[0], 0], name);
    }
    for (place, row) in rows.iter().enumerate() {
        let top = top + place * STEP[1];
        canvas.text([0, top + GAP / 2], &row.label);
        let error = format!("perceived error {}", digits(row.error / rows[0].error, 2));
        canvas.text([2 * STEP[0], top + GAP / 2], &error);
        for (column, values) in row.panels.iter().enumerate() {
            for (at, value) in values.iter().enumerate() {
                let level = 127.5 + 50.0 * value / contrast[column / 2];
                let left = column * STEP[0] + at % SIDE * SCALE;
                let top = top + LINE + GAP + at / SIDE * SCALE;
                canvas.fill([left, top], [SCALE; 2], [level.clamp(0.0, 255.0) as u8; 3]);
            }
        }
    }
    canvas
}

/// The error of the first bump of the first set of integrands, at every pixel.
fn errors(tile: &Tile) -> Vec<f32> {
    let sets = integrand_sets(Domain::Square, 0, tile.shape().dims(), 1);
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
