//! Makes the pictures that the manual has densities from, as PNG files of gray levels:
//!
//!     cargo run --release --example densities -- DIR
//!
//! `star.png` is an aperture, `gradient.png` rises from left to right, and `landscape.png` is what a photograph may have: soft and hard edges, levels over three decades, and
//! parts that are black.

use std::path::PathBuf;

use anyhow::Context;
use perceptile::format::png::{Depth, PixelFormat, Raster, encode};

/// The level at a point of the square [−1, 1]², whose y runs down.
type Level = fn(f64, f64) -> f64;

/// Pixels along each side.
const SIZE: usize = 128;
/// Samples of a pixel along each side, for soft edges.
const FINE: usize = 4;

fn main() -> anyhow::Result<()> {
    let folder: PathBuf = std::env::args_os().nth(1).context("say DIR")?.into();
    std::fs::create_dir_all(&folder)?;
    let pictures: [(&str, Level); 3] =
        [("star", star), ("gradient", |x, _| 0.5 + 0.5 * x), ("landscape", landscape)];
    for (name, level) in pictures {
        let path = folder.join(name).with_extension("png");
        let raster = Raster {
            width: SIZE,
            height: SIZE,
            layout: PixelFormat::Gray,
            depth: Depth::Sixteen,
            levels: (0..SIZE * SIZE).map(|i| pixel(i % SIZE, i / SIZE, level)).collect(),
        };
        let mut file = std::fs::File::create(&path)?;
        encode(&raster, &mut file).with_context(|| path.display().to_string())?;
        println!("{}", path.display());
    }
    Ok(())
}

/// Mean level of a pixel, in 16 bits.
fn pixel(column: usize, row: usize, level: Level) -> u16 {
    let at = |pixel: usize, i: usize| {
        (pixel as f64 + (i as f64 + 0.5) / FINE as f64) / SIZE as f64 * 2.0 - 1.0
    };
    let fine = (0..FINE * FINE).map(|i| level(at(column, i % FINE), at(row, i / FINE)));
    let mean = fine.sum::<f64>() / (FINE * FINE) as f64;
    (mean.clamp(0.0, 1.0) * 65535.0).round() as u16
}

/// 1 within a star of five points.
fn star(x: f64, y: f64) -> f64 {
    // Inside at least four of the five half-planes whose borders are its lines.
    let inside = (0..5).filter(|&k| {
        let angle = std::f64::consts::TAU * f64::from(k) / 5.0;
        x * angle.sin() - y * angle.cos() < 0.36
    });
    f64::from(u8::from(inside.count() >= 4 && x * x + y * y < 0.98))
}

/// A sky with a lamp, and hills in front, some of which are black.
fn landscape(x: f64, y: f64) -> f64 {
    let hill = |height: f64, width: f64, phase: f64| {
        height + 0.22 * (width * x + phase).sin() + 0.08 * (2.7 * width * x + 2.0 * phase).cos()
    };
    let lamp = (-60.0 * ((x - 0.4) * (x - 0.4) + (y + 0.5) * (y + 0.5))).exp();
    if y > hill(0.55, 3.1, 0.3) {
        // A dark foreground with lights in a row.
        let light = ((9.0 * x).sin() * (7.0 * y).sin()).powi(6);
        if light > 0.4 { 0.3 * light } else { 0.0 }
    } else if y > hill(0.1, 2.2, 1.9) {
        0.02 + 0.015 * (40.0 * x * y).sin()
    } else {
        0.002 + 0.06 * (1.0 - y) * (1.0 - y) + 0.9 * lamp
    }
}
