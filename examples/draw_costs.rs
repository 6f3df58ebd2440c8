//! Prints what a draw costs for each sample of its subset, by the size of the subset and the
//! number of dimensions, as a table in Markdown.
//!
//! ```text
//! cargo run --release --example draw_costs
//! ```
//!
//! One thread makes, gathers, projects, ranks, gradients and scatters all draws of a step; the
//! figures are the shortest of several such steps, in nanoseconds.

#[path = "../benches/common/mod.rs"]
mod common;

use std::hint::black_box;
use std::time::Duration;

use perceptile::gradient::simd::Simd;
use perceptile::metric::Baseline;
use perceptile::profile::machine::Machine;

use common::subsets::{self, DIMS, SUBSETS};
use common::{
    Gradients, PAPER_DRAWS, PAPER_KERNEL, PAPER_SIZE, Shortest, gradient, paper_options,
    paper_taps, shape,
};

/// Fewest repetitions, and the time that they should take together.
const LEAST: u32 = 5;
const ENOUGH: Duration = Duration::from_millis(150);

/// The shortest of several steps, in nanoseconds for each of `parts`.
fn cost(gradients: &mut Gradients, parts: usize) -> f64 {
    let shortest = Shortest::default();
    let (mut spent, mut step) = (Duration::ZERO, 0);
    while spent < ENOUGH || step < LEAST {
        step += 1;
        spent += shortest.measure(1, || {
            black_box(gradients.run(black_box(step)));
        });
    }
    shortest.nanoseconds(parts).expect("a measurement")
}

fn main() {
    println!("{}, one thread, {}\n", Machine::detect().processor, Simd::detect().name());
    let headings: String = DIMS.iter().map(|dims| format!(" d = {dims} |")).collect();
    println!("| samples | taps × spp |{headings}");
    println!("|---:|---:|{}", "---:|".repeat(DIMS.len()));
    for (taps, spp) in SUBSETS {
        let samples = taps * spp;
        print!("| {samples} | {taps} × {spp} |");
        for dims in DIMS {
            let nanoseconds =
                cost(&mut subsets::gradients((taps, spp), dims), subsets::DRAWS * samples);
            print!(" {nanoseconds:.1} |");
        }
        println!();
    }

    let shape = shape(PAPER_SIZE, 1, 2);
    let taps = paper_taps(shape);
    let tile = Baseline::White.tile(shape, 1);
    let mut gradients = Gradients::new(gradient(shape, &taps, paper_options(PAPER_DRAWS)), &tile);
    gradients.check_some(&tile, &taps, 16);
    gradients.check_sum(&tile);
    let nanoseconds = cost(&mut gradients, PAPER_DRAWS);
    println!(
        "\n{PAPER_KERNEL} on {shape}: {nanoseconds:.0} ns per draw of {:.0} samples on average",
        taps.mean_subset()
    );
}
