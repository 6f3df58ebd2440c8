//! The world of one process: messages pass through a mailbox in its own memory, on its threads.

use rayon::prelude::*;

use crate::plan::{Combine, Plan};
use crate::word::Word;

/// Carries out `plan`: first every message is packed into the mailbox, then every block unpacks
/// what it gets, in the order of the plan. Both halves run in parallel without sharing a word.
pub(crate) fn exchange<T: Word>(
    plan: &Plan,
    slice: &mut [T],
    combine: Combine,
    mailbox: &mut Vec<T>,
) {
    mailbox.resize(plan.words(), T::default());
    let blocks = split(slice, plan.blocks().iter().copied());
    let starts: Vec<&[T]> = blocks.iter().map(|block| &**block).collect();
    let parts = split(mailbox, plan.messages().iter().map(|(_, place)| place.len()));
    plan.messages().par_iter().zip(parts).for_each(|((message, _), mut part)| {
        let block = starts[message.source.block];
        for segment in &message.segments {
            let (head, tail) = part.split_at_mut(segment.len);
            head.copy_from_slice(&block[segment.source..segment.source + segment.len]);
            part = tail;
        }
    });
    let mailbox = &*mailbox;
    blocks.into_par_iter().enumerate().for_each(|(index, block)| {
        let messages = plan.messages();
        let first = messages.partition_point(|(message, _)| message.target.block < index);
        let mine = messages[first..].iter().take_while(|(m, _)| m.target.block == index);
        for (message, place) in mine {
            let mut words = &mailbox[place.clone()];
            for segment in &message.segments {
                let (head, tail) = words.split_at(segment.len);
                let target = &mut block[segment.target..segment.target + segment.len];
                match combine {
                    Combine::Copy => target.copy_from_slice(head),
                    Combine::Add => {
                        target.iter_mut().zip(head).for_each(|(a, &b)| *a = a.add(b));
                    }
                }
                words = tail;
            }
        }
    });
}

/// Cuts a slice into pieces of the given sizes, which must add up to at most its length.
fn split<T>(mut slice: &mut [T], sizes: impl Iterator<Item = usize>) -> Vec<&mut [T]> {
    sizes
        .map(|size| {
            let (head, tail) = std::mem::take(&mut slice).split_at_mut(size);
            slice = tail;
            head
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{Endpoint, Message, PlanError, Segment};
    use crate::world::World;

    fn message(source: usize, target: usize, segments: &[(usize, usize, usize)]) -> Message {
        Message {
            source: Endpoint { rank: 0, block: source },
            target: Endpoint { rank: 0, block: target },
            segments: segments
                .iter()
                .map(|&(source, target, len)| Segment { source, target, len })
                .collect(),
        }
    }

    #[test]
    fn words_are_read_before_any_is_written() {
        let messages = vec![message(0, 1, &[(0, 1, 2)]), message(1, 0, &[(1, 0, 2)])];
        let plan = Plan::new(0, vec![2, 3], messages).unwrap();
        let mut slice = [1, 2, 10, 20, 30];
        World::Local.exchange(&plan, &mut slice, Combine::Copy, &mut Vec::new());
        assert_eq!(slice, [20, 30, 10, 1, 2]);
    }

    #[test]
    fn sums_come_from_every_sender_and_from_a_block_itself() {
        let messages = vec![message(0, 0, &[(0, 1, 1)]), message(1, 0, &[(0, 1, 1), (2, 0, 1)])];
        let plan = Plan::new(0, vec![2, 3], messages).unwrap();
        let mut slice = [1, 2, 10, 20, 30];
        World::Local.exchange(&plan, &mut slice, Combine::Add, &mut Vec::new());
        assert_eq!(slice, [31, 13, 10, 20, 30]);
    }

    #[test]
    fn a_plan_that_leaves_its_blocks_is_refused() {
        let bad = Plan::new(0, vec![2, 3], vec![message(0, 2, &[])]);
        assert!(matches!(bad, Err(PlanError::Block { blocks: 2, .. })));
        let bad = Plan::new(0, vec![2, 3], vec![message(0, 1, &[(1, 0, 2)])]);
        assert!(matches!(bad, Err(PlanError::Segment { end: 3, words: 2 })));
        let bad = Plan::new(0, vec![2, 3], vec![message(0, 1, &[(0, usize::MAX, 1)])]);
        assert!(matches!(bad, Err(PlanError::Segment { .. })));
    }
}
