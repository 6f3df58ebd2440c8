//! How the cells of a tile are shared out over the ranks of a cluster.
//!
//! A *region* is the rectangle of cells that one rank owns: their samples live there and nowhere
//! else. What its draws see beyond its edge, its *halo*, belongs to other regions, in *pieces* that
//! gather: samples to where they are seen, gradients to where the samples are.
//!
//! Everything here is pure arithmetic, the same on all ranks.

use std::sync::Arc;

use crate::tile::{Cell, Reach, TileShape};

/// The rectangle of a tile, with all its frames, that one rank owns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Region {
    tile: TileShape,
    place: Cell,
}

impl Region {
    pub(super) fn new(tile: TileShape, place: Cell) -> Self {
        Self { tile, place }
    }

    /// All of a tile.
    pub fn whole(tile: TileShape) -> Self {
        Self::new(tile, Cell { x: 0, y: 0, width: tile.width(), height: tile.height() })
    }

    /// The shape of the tile.
    pub fn tile(&self) -> TileShape {
        self.tile
    }

    /// Where in the tile it lies.
    pub fn place(&self) -> Cell {
        self.place
    }

    /// Its shape, as if it were a tile.
    pub fn shape(&self) -> TileShape {
        let Self { tile, place } = self;
        TileShape::new(place.width, place.height, tile.frames(), tile.spp(), tile.dims())
            .expect("no larger than the tile")
    }

    /// Whether it goes around the torus in x.
    pub fn wraps_x(&self) -> bool {
        self.place.width == self.tile.width()
    }

    /// Whether it goes around the torus in y.
    pub fn wraps_y(&self) -> bool {
        self.place.height == self.tile.height()
    }

    /// The size of the tile along x and y where the region goes around it.
    pub(super) fn wraps(&self) -> [Option<usize>; 2] {
        [self.wraps_x().then_some(self.tile.width()), self.wraps_y().then_some(self.tile.height())]
    }

    /// With its halo.
    fn window(&self, reach: Reach) -> Window {
        Window::of(self.place, reach)
    }
}

/// The regions of a tile, one for each rank, and the rank that one sees them from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Regions {
    all: Arc<[Region]>,
    rank: usize,
}

impl Regions {
    pub(super) fn new(all: Vec<Region>, rank: usize) -> Self {
        assert!(rank < all.len(), "rank {rank} of {}", all.len());
        Self { all: all.into(), rank }
    }

    /// One for all of a tile.
    pub fn whole(tile: TileShape) -> Self {
        Self::new(vec![Region::whole(tile)], 0)
    }

    /// All of them, by rank.
    pub fn all(&self) -> &[Region] {
        &self.all
    }

    /// The rank that owns [`Self::own`].
    pub fn rank(&self) -> usize {
        self.rank
    }

    /// This rank's own.
    pub fn own(&self) -> Region {
        self.all[self.rank]
    }

    /// The pieces of this rank's halo that are another's, or its own around the torus, where that
    /// is not how its rows close by themselves ([`crate::tile::Rows`]). Sorted by owner.
    pub fn halo(&self, reach: Reach) -> Vec<Piece> {
        (0..self.all.len()).flat_map(|owner| self.pieces(self.rank, owner, reach)).collect()
    }

    /// The pieces of other ranks' halos that are this rank's. Sorted by rank; those of a rank come
    /// in the order in which [`Self::halo`] has them there.
    pub fn lent(&self, reach: Reach) -> Vec<Piece> {
        (0..self.all.len()).flat_map(|other| self.pieces(other, self.rank, reach)).collect()
    }

    /// The pieces of the halo of one rank that another owns.
    fn pieces(&self, seer: usize, owner: usize, reach: Reach) -> Vec<Piece> {
        let (region, owned) = (self.all[seer], self.all[owner]);
        let window = region.window(reach);
        let [width, height] = [region.tile.width(), region.tile.height()].map(|x| x as i64);
        let turns = |start: i64, end: i64, size: i64| start.div_euclid(size)..=end.div_euclid(size);
        let mut pieces = Vec::new();
        for turn_y in turns(window.y, window.y + window.height as i64 - 1, height) {
            for turn_x in turns(window.x, window.x + window.width as i64 - 1, width) {
                let closed = (turn_x == 0 || region.wraps_x()) && (turn_y == 0 || region.wraps_y());
                if seer == owner && closed {
                    continue;
                }
                let there = Window::of(owned.place, Reach::default());
                let [x, y] = [turn_x * width, turn_y * height];
                let turned = Window { x: there.x + x, y: there.y + y, ..there };
                if let Some(seen) = window.common(turned) {
                    pieces.push(Piece { seer, owner, seen, owned: seen.moved(-x, -y) });
                }
            }
        }
        pieces
    }
}

/// A piece of a rank's halo that a rank owns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Piece {
    /// The rank whose draws see it.
    pub seer: usize,
    /// The rank that has its samples.
    pub owner: usize,
    /// Where its seer sees it.
    pub seen: Window,
    /// Where in the tile it lies.
    pub owned: Window,
}

impl Piece {
    /// Pixels in so many frames.
    pub fn pixels(&self, frames: usize) -> usize {
        self.seen.width * self.seen.height * frames
    }
}

/// A rectangle of pixels that may lie outside the tile, on another turn around the torus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub x: i64,
    /// First row.
    pub y: i64,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Window {
    /// A rectangle of the tile and what lies around it.
    pub fn of(place: Cell, reach: Reach) -> Self {
        let Reach { left, right, up, down } = reach;
        Self {
            x: place.x as i64 - left as i64,
            y: place.y as i64 - up as i64,
            width: left + place.width + right,
            height: up + place.height + down,
        }
    }

    /// What both have in common, if there is something.
    pub fn common(self, other: Self) -> Option<Self> {
        let [x, y] = [self.x.max(other.x), self.y.max(other.y)];
        let end = |a: i64, size: usize| a + size as i64;
        let right = end(self.x, self.width).min(end(other.x, other.width));
        let below = end(self.y, self.height).min(end(other.y, other.height));
        (x < right && y < below).then(|| Self {
            x,
            y,
            width: (right - x) as usize,
            height: (below - y) as usize,
        })
    }

    /// The same elsewhere.
    pub fn moved(self, x: i64, y: i64) -> Self {
        Self { x: self.x + x, y: self.y + y, ..self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tile::Partition;
    use proptest::prelude::*;

    proptest! {
        /// Every pixel around a region is in one piece, of the rank that owns it, or closes by
        /// itself.
        #[test]
        fn pieces_cover_halos_once(
            width in 1_usize..60, height in 1_usize..60, ranks in 1_usize..9,
            left in 0_usize..70, right in 0_usize..9, up in 0_usize..9, down in 0_usize..70,
        ) {
            let shape = TileShape::new(width, height, 2, 1, 1).unwrap();
            // Cells of a small reach, to have several.
            let partition = Partition::new(shape, Reach::default());
            let reach = Reach { left, right, up, down };
            let ranks = ranks.min(partition.cells());
            let mut owners = vec![usize::MAX; width * height];
            let all = partition.regions(ranks, 0).unwrap();
            for (rank, region) in all.all().iter().enumerate() {
                let Cell { x, y, width: columns, height: rows } = region.place();
                for row in y..y + rows {
                    for owner in &mut owners[row * width + x..][..columns] {
                        prop_assert_eq!(*owner, usize::MAX);
                        *owner = rank;
                    }
                }
            }
            prop_assert!(owners.iter().all(|&owner| owner < ranks));
            let mut lent = Vec::new();
            let mut seen_by_all = Vec::new();
            for rank in 0..ranks {
                let regions = partition.regions(ranks, rank).unwrap();
                let own = regions.own();
                let window = own.window(reach);
                let mut covered = vec![0; window.width * window.height];
                for piece in regions.halo(reach) {
                    prop_assert_eq!(piece.seer, rank);
                    for j in 0..piece.seen.height {
                        for i in 0..piece.seen.width {
                            let (x, y) = (piece.seen.x + i as i64, piece.seen.y + j as i64);
                            let column = (x - window.x) as usize;
                            covered[(y - window.y) as usize * window.width + column] += 1;
                            let (at_x, at_y) =
                                (piece.owned.x + i as i64, piece.owned.y + j as i64);
                            prop_assert_eq!(x.rem_euclid(width as i64), at_x);
                            prop_assert_eq!(y.rem_euclid(height as i64), at_y);
                            let at = at_y as usize * width + at_x as usize;
                            prop_assert_eq!(owners[at], piece.owner);
                        }
                    }
                    seen_by_all.push(piece);
                }
                for (i, &count) in covered.iter().enumerate() {
                    let x = window.x + (i % window.width) as i64 - own.place().x as i64;
                    let y = window.y + (i / window.width) as i64 - own.place().y as i64;
                    let within = |at: i64, size: usize| (0..size as i64).contains(&at);
                    let closed = (own.wraps_x() || within(x, own.place().width))
                        && (own.wraps_y() || within(y, own.place().height));
                    prop_assert_eq!(count, usize::from(!closed), "{} {}", x, y);
                }
                let mine = regions.lent(reach);
                prop_assert!(mine.windows(2).all(|pair| pair[0].seer <= pair[1].seer));
                lent.extend(mine);
            }
            // What one rank sees is what another lends, in the same order.
            lent.sort_by_key(|piece| (piece.seer, piece.owner));
            prop_assert_eq!(lent, seen_by_all);
        }
    }
}
