//! Borders: what ranks with neighbouring rows send each other after a round.
//!
//! A visit changes the residual of rows up to the kernel's reach beyond its strip. Rows that two ranks
//! see belong to the two strips beside their border, which have different colours: after a round, the
//! rank whose strip had its turn sends what the other will go on with. What is chosen goes along, as
//! far as filters read beyond a rank's own rows.

use std::ops::Range;

use bytemuck::{cast_slice, cast_slice_mut};
use perceptile_cluster::communicator::{Communicator, Message, Transfer};

use super::footprint::Footprint;
use super::strips::COLOURS;
use super::window::{Window, WindowPlan};

/// The borders of a rank.
pub(super) struct Borders {
    borders: Vec<Border>,
    prepares: Exchange,
    visits: [Exchange; COLOURS],
}

/// A border with another rank.
#[derive(Debug, Clone)]
struct Border {
    rank: usize,
    /// The colour of this rank's strip beside it.
    colour: usize,
    /// Rows of pictures beside it: this rank's that the other reads, and the other's.
    own: Range<usize>,
    other: Range<usize>,
    /// Padded rows that both see, and those of them that belong to this rank and to the other.
    shared: Range<usize>,
    own_shared: Range<usize>,
    other_shared: Range<usize>,
}

/// What is sent and received again and again.
struct Exchange {
    transfer: Box<dyn Transfer>,
    /// The borders that messages go over.
    outgoing: Vec<usize>,
    incoming: Vec<usize>,
}

impl Exchange {
    /// Sets up messages of so many numbers over each border, none where that is 0.
    fn new(
        communicator: &dyn Communicator,
        borders: &[Border],
        outgoing: impl Fn(&Border) -> usize,
        incoming: impl Fn(&Border) -> usize,
    ) -> Self {
        let messages = |words: &dyn Fn(&Border) -> usize| -> (Vec<usize>, Vec<Message>) {
            let all = borders.iter().enumerate();
            let all = all.map(|(i, border)| (i, border.rank, words(border)));
            let some = all.filter(|&(.., words)| words > 0);
            some.map(|(i, rank, words)| (i, Message { rank, words })).unzip()
        };
        let (outgoing, sent) = messages(&outgoing);
        let (incoming, received) = messages(&incoming);
        Self { transfer: communicator.transfer(&sent, &received), outgoing, incoming }
    }

    /// Sends what `pack` finds and hands on what came.
    fn exchange(
        &mut self,
        borders: &[Border],
        window: &mut Window,
        pack: impl Fn(&Border, &Window, &mut [f32]),
        unpack: impl Fn(&Border, &mut Window, &[f32]),
    ) {
        for (message, &border) in self.transfer.outgoing().into_iter().zip(&self.outgoing) {
            pack(&borders[border], window, cast_slice_mut(message));
        }
        self.transfer.start();
        self.transfer.finish();
        for (message, &border) in self.transfer.incoming().into_iter().zip(&self.incoming) {
            unpack(&borders[border], window, cast_slice(message));
        }
    }
}

/// Copies ranges of memory to a message, one after the other; it may have room left.
fn collect<'a>(message: &mut [f32], pieces: impl Iterator<Item = &'a [f32]>) {
    let mut at = 0;
    for piece in pieces {
        message[at..at + piece.len()].copy_from_slice(piece);
        at += piece.len();
    }
}

/// Copies a message to ranges of memory, as far as they go. Returns what is left of it.
fn spread<'m>(
    mut message: &'m [f32],
    memory: &mut [f32],
    places: impl Iterator<Item = Range<usize>>,
) -> &'m [f32] {
    for place in places {
        let (piece, rest) = message.split_at(place.len());
        memory[place].copy_from_slice(piece);
        message = rest;
    }
    message
}

impl Borders {
    /// Those of a rank, together with all ranks.
    pub fn new(plan: &WindowPlan, footprint: &Footprint, communicator: &dyn Communicator) -> Self {
        let borders = borders(plan, footprint, communicator);
        let (channels, width) = (plan.shape.channels(), plan.shape.width());
        let picture = |rows: &Range<usize>| channels * rows.len() * width;
        let padded = |rows: &Range<usize>| channels * rows.len() * plan.stride;
        let seen = |border: &Border| footprint.frames() * padded(&border.shared);
        let visits = std::array::from_fn(|colour| {
            let sent = |border: &Border| match border.colour == colour {
                true => seen(border) + picture(&border.own),
                false => 0,
            };
            let received = |border: &Border| match border.colour == colour {
                true => 0,
                false => seen(border) + picture(&border.other),
            };
            Exchange::new(communicator, &borders, sent, received)
        });
        Self {
            prepares: Exchange::new(
                communicator,
                &borders,
                |border| 2 * padded(&border.own_shared),
                |border| 2 * padded(&border.other_shared),
            ),
            visits,
            borders,
        }
    }

    /// The residual and the weights of a frame.
    pub fn after_prepare(&mut self, plan: &WindowPlan, window: &mut Window, frame: usize) {
        let seen = |rows: &Range<usize>| seen(plan, frame, rows);
        self.prepares.exchange(
            &self.borders,
            window,
            |border, window, message| {
                let (residual, weights) = (window.residual.whole(), window.weights.whole());
                let residual = seen(&border.own_shared).map(|place| &residual[place]);
                let weights = seen(&border.own_shared).map(|place| &weights[place]);
                collect(message, residual.chain(weights));
            },
            |border, window, message| {
                let places = || seen(&border.other_shared);
                let rest = spread(message, window.residual.whole_mut(), places());
                spread(rest, window.weights.whole_mut(), places());
            },
        );
    }

    /// What the visit of a frame's strips of one colour has changed, in the frames that see it.
    pub fn after_visit(
        &mut self,
        plan: &WindowPlan,
        window: &mut Window,
        (colour, frame): (usize, usize),
        frames: impl Iterator<Item = usize> + Clone,
    ) {
        let seen = |border: &Border| {
            let rows = border.shared.clone();
            frames.clone().flat_map(move |frame| seen(plan, frame, &rows))
        };
        let pictures = |rows: &Range<usize>| pictures(plan, frame, rows);
        self.visits[colour].exchange(
            &self.borders,
            window,
            |border, window, message| {
                let (residual, current) = (window.residual.whole(), window.current.whole());
                let residual = seen(border).map(|place| &residual[place]);
                let current = pictures(&border.own).map(|place| &current[place]);
                collect(message, residual.chain(current));
            },
            |border, window, message| {
                let rest = spread(message, window.residual.whole_mut(), seen(border));
                spread(rest, window.current.whole_mut(), pictures(&border.other));
            },
        );
    }
}

/// Where rows of a frame's picture are, channel by channel.
fn pictures(
    plan: &WindowPlan,
    frame: usize,
    rows: &Range<usize>,
) -> impl Iterator<Item = Range<usize>> + use<> {
    let of = |c| plan.picture_rows(frame, c, rows.clone());
    (0..plan.shape.channels()).map(of).collect::<Vec<_>>().into_iter()
}

/// Where padded rows of a frame are, channel by channel.
fn seen(
    plan: &WindowPlan,
    frame: usize,
    rows: &Range<usize>,
) -> impl Iterator<Item = Range<usize>> + use<> {
    let of = |c| plan.seen_rows(frame, c, rows.clone());
    (0..plan.shape.channels()).map(of).collect::<Vec<_>>().into_iter()
}

/// The borders of a rank with those before and behind it.
fn borders(
    plan: &WindowPlan,
    footprint: &Footprint,
    communicator: &dyn Communicator,
) -> Vec<Border> {
    let (rank, ranks) = (communicator.rank(), communicator.size());
    let [_, top, _, bottom] = footprint.margins();
    let rows = plan.own_rows();
    let height = plan.shape.height();
    // Above a border its upper rank reads below it as far as the kernel, turned around, reaches up.
    let border = |rank: usize, row: usize, strip: usize, is_lower: bool| {
        let (above, below) = (row - bottom..row, row..(row + top).min(height));
        let shared = row..row + plan.reach;
        let (upper, lower) = (row..row + top, row + top..row + plan.reach);
        let (own, other, own_shared, other_shared) = match is_lower {
            true => (below, above, lower, upper),
            false => (above, below, upper, lower),
        };
        let colour = strip % COLOURS;
        Border { rank, colour, own, other, shared, own_shared, other_shared }
    };
    let before = (rank > 0).then(|| border(rank - 1, rows.start, plan.own.start, true));
    let behind = (rank + 1 < ranks).then(|| border(rank + 1, rows.end, plan.own.end - 1, false));
    before.into_iter().chain(behind).collect()
}
