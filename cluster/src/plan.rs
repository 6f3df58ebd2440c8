//! What goes where: the messages of one exchange.

use std::ops::Range;

use thiserror::Error;

/// What happens to a word that arrives.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Combine {
    /// It is added to the one that is there.
    Add,
    /// It replaces the one that is there.
    Copy,
}

/// One end of a message: a block of a rank.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Endpoint {
    /// The rank that owns the block.
    pub rank: usize,
    /// Position of the block in that rank's slice.
    pub block: usize,
}

/// A run of words of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Segment {
    /// First word in the source block, counted from the block's start.
    pub source: usize,
    /// First word in the target block, counted from the block's start.
    pub target: usize,
    /// Number of words.
    pub len: usize,
}

/// What one block sends to one other (or to itself).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Where the words come from.
    pub source: Endpoint,
    /// Where they go.
    pub target: Endpoint,
    /// Which words.
    pub segments: Vec<Segment>,
}

impl Message {
    /// Words in all segments together.
    pub fn words(&self) -> usize {
        self.segments.iter().map(|segment| segment.len).sum()
    }
}

/// Why messages do not make a plan.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum PlanError {
    /// A message names a block that its rank does not have.
    #[error("a message names block {} of rank {}, which has {blocks} blocks", endpoint.block, endpoint.rank)]
    Block {
        /// What the message names.
        endpoint: Endpoint,
        /// How many blocks there are.
        blocks: usize,
    },
    /// A segment reaches past the end of its block.
    #[error("a segment ends at word {end} of a block of {words} words")]
    Segment {
        /// One past the segment's last word.
        end: usize,
        /// The block's size.
        words: usize,
    },
}

/// The messages of one exchange as one rank sees them, checked against its blocks.
#[derive(Debug, Clone)]
pub struct Plan {
    /// Sizes in words of this rank's blocks, which lie one after the other in its slice.
    blocks: Vec<usize>,
    /// Messages sorted by target, each with its place in the mailbox.
    messages: Vec<(Message, Range<usize>)>,
    mailbox: usize,
}

impl Plan {
    /// A plan for `rank`, whose slice is cut into `blocks` (sizes in words).
    ///
    /// Messages in which the rank has no part are left out.
    ///
    /// # Errors
    /// A block that does not exist, or a segment that does not fit into its block.
    pub fn new(rank: usize, blocks: Vec<usize>, messages: Vec<Message>) -> Result<Self, PlanError> {
        let mut messages: Vec<Message> = messages
            .into_iter()
            .filter(|message| message.source.rank == rank || message.target.rank == rank)
            .collect();
        messages.sort_by_key(|message| (message.target, message.source));
        let check = |endpoint: Endpoint, end: usize| {
            if endpoint.rank != rank {
                return Ok(());
            }
            match blocks.get(endpoint.block) {
                None => Err(PlanError::Block { endpoint, blocks: blocks.len() }),
                Some(&words) if end > words => Err(PlanError::Segment { end, words }),
                Some(_) => Ok(()),
            }
        };
        let mut mailbox = 0;
        let mut placed = Vec::with_capacity(messages.len());
        for message in messages {
            let last = |end: fn(&Segment) -> usize| message.segments.iter().map(end).max();
            check(message.source, last(|s| s.source.saturating_add(s.len)).unwrap_or(0))?;
            check(message.target, last(|s| s.target.saturating_add(s.len)).unwrap_or(0))?;
            let place = mailbox..mailbox + message.words();
            mailbox = place.end;
            placed.push((message, place));
        }
        Ok(Self { blocks, messages: placed, mailbox })
    }

    /// Sizes in words of this rank's blocks.
    pub fn blocks(&self) -> &[usize] {
        &self.blocks
    }

    /// Words that the exchange moves.
    pub fn words(&self) -> usize {
        self.mailbox
    }

    /// The messages by target, each with its range of the mailbox.
    pub(crate) fn messages(&self) -> &[(Message, Range<usize>)] {
        &self.messages
    }
}
