//! What a run starts from.
//!
//! Every cell makes its own start from (seed, cell), so that no process needs another's.

use perceptile_cluster::World;
use rand::seq::SliceRandom;

use crate::draw::{Stream, Use};
use crate::solver::state::CellSamples;
use crate::tile::{Partition, clamp_coordinate};

/// Independent uniform samples.
pub fn random(partition: &Partition, seed: u64, world: World) -> CellSamples {
    each_cell(partition, seed, world, |stream, words, _| {
        words.iter_mut().for_each(|x| *x = clamp_coordinate(stream.unit() as f32));
    })
}

/// Every coordinate stratified over the samples of each cell: of n samples, the k-th in a random
/// order (one for each dimension) is uniform in [k/n, (k+1)/n].
pub fn stratified(partition: &Partition, seed: u64, world: World) -> CellSamples {
    each_cell(partition, seed, world, |stream, words, dims| {
        let samples = words.len() / dims;
        let mut order: Vec<usize> = (0..samples).collect();
        for k in 0..dims {
            order.shuffle(stream);
            for (point, stratum) in words.chunks_exact_mut(dims).zip(&order) {
                let x = (*stratum as f64 + stream.unit()) / samples as f64;
                point[k] = clamp_coordinate(x as f32);
            }
        }
    })
}

fn each_cell(
    partition: &Partition,
    seed: u64,
    world: World,
    mut make: impl FnMut(&mut Stream, &mut [f32], usize),
) -> CellSamples {
    let shape = partition.shape();
    let mut words = Vec::new();
    for cell in partition.owned(world.rank()) {
        let start = words.len();
        let samples = partition.cell(cell).pixels(shape.frames()) * shape.spp();
        words.resize(start + samples * shape.dims(), 0.0);
        let mut stream = Stream::new(seed, Use::Start, cell as u32, 0);
        make(&mut stream, &mut words[start..], shape.dims());
    }
    CellSamples { words }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tile::{Reach, TileShape};

    #[test]
    fn a_stratified_start_has_one_coordinate_in_each_stratum() {
        let shape = TileShape::new(20, 40, 3, 2, 3).unwrap();
        let partition = Partition::new(shape, Reach::default(), 1);
        let mut words = &stratified(&partition, 5, World::Local).words[..];
        for cell in 0..partition.cells() {
            let samples = partition.cell(cell).pixels(3) * 2;
            let (points, rest) = words.split_at(samples * 3);
            words = rest;
            for k in 0..3 {
                let mut column: Vec<f32> = points.chunks(3).map(|point| point[k]).collect();
                column.sort_by(f32::total_cmp);
                for (stratum, x) in column.into_iter().enumerate() {
                    let place = f64::from(x) * samples as f64 - stratum as f64;
                    assert!((-1e-3..1.001).contains(&place), "{stratum}: {x}");
                }
            }
        }
        assert!(words.is_empty());
    }
}
