//! What a run starts from.
//!
//! Every cell makes its own start from (seed, cell), so that no process needs another's.

use rand::seq::SliceRandom;

use crate::domain::Domain;
use crate::draw::{Stream, Use};
use crate::solver::Samples;
use crate::tile::{MAX_DIMS, Partition, Region};

/// Independent uniform samples of a region.
pub fn random(domain: Domain, partition: &Partition, region: Region, seed: u64) -> Samples {
    each_cell((partition, region), seed, |stream, words, dims| {
        let mut place = [0.0; MAX_DIMS];
        let place = &mut place[..domain.parameters(dims)];
        for point in words.chunks_exact_mut(dims) {
            place.iter_mut().for_each(|u| *u = stream.unit());
            domain.point(place, point);
        }
    })
}

/// Samples of a region, every coordinate stratified over the samples of each cell: of n samples, the
/// k-th in a random order (one for each dimension) is uniform in [k/n, (k+1)/n]. In other domains
/// than the square it is the coordinates of their places that are.
pub fn stratified(domain: Domain, partition: &Partition, region: Region, seed: u64) -> Samples {
    each_cell((partition, region), seed, |stream, words, dims| {
        let (samples, parameters) = (words.len() / dims, domain.parameters(dims));
        let mut order: Vec<usize> = (0..samples).collect();
        let mut places = vec![0.0; samples * parameters];
        for k in 0..parameters {
            order.shuffle(stream);
            for (place, stratum) in places.chunks_exact_mut(parameters).zip(&order) {
                place[k] = (*stratum as f64 + stream.unit()) / samples as f64;
            }
        }
        for (point, place) in words.chunks_exact_mut(dims).zip(places.chunks_exact(parameters)) {
            domain.point(place, point);
        }
    })
}

fn each_cell(
    (partition, region): (&Partition, Region),
    seed: u64,
    mut make: impl FnMut(&mut Stream, &mut [f32], usize),
) -> Samples {
    let (shape, place) = (region.shape(), region.place());
    let pixel = shape.spp() * shape.dims();
    let mut samples = Samples { words: vec![0.0; shape.coordinates()] };
    let mut words = Vec::new();
    for index in partition.cells_in(region) {
        let cell = partition.cell(index);
        words.clear();
        words.resize(cell.pixels(shape.frames()) * pixel, 0.0);
        let mut stream = Stream::new(seed, Use::Start, index as u32, 0);
        make(&mut stream, &mut words, shape.dims());
        for (row, from) in words.chunks_exact(cell.width * pixel).enumerate() {
            let (t, y) = (row / cell.height, cell.y - place.y + row % cell.height);
            let to = ((y * shape.frames() + t) * shape.width() + cell.x - place.x) * pixel;
            samples.words[to..to + from.len()].copy_from_slice(from);
        }
    }
    samples
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tile::{Reach, TileShape};

    #[test]
    fn a_stratified_start_has_one_coordinate_in_each_stratum() {
        let shape = TileShape::new(20, 40, 3, 2, 3).unwrap();
        let partition = Partition::new(shape, Reach::default());
        let tile = stratified(Domain::Square, &partition, Region::whole(shape), 5).to_tile(shape);
        for cell in (0..partition.cells()).map(|cell| partition.cell(cell)) {
            let samples = cell.pixels(3) * 2;
            let mut points = Vec::new();
            for t in 0..3 {
                for (y, x) in (cell.y..cell.y + cell.height)
                    .flat_map(|y| (cell.x..cell.x + cell.width).map(move |x| (y, x)))
                {
                    (0..2).for_each(|s| points.extend(tile.point(x, y, t, s)));
                }
            }
            for k in 0..3 {
                let mut column: Vec<f32> = points.chunks(3).map(|point| point[k]).collect();
                column.sort_by(f32::total_cmp);
                for (stratum, x) in column.into_iter().enumerate() {
                    let place = f64::from(x) * samples as f64 - stratum as f64;
                    assert!((-1e-3..1.001).contains(&place), "{stratum}: {x}");
                }
            }
        }
    }
}
