//! The communicator of a run with one rank.

use crate::communicator::{Communicator, Message, Transfer};

/// How the only rank reaches itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Single;

/// Messages to oneself.
struct Loop {
    outgoing: Vec<Vec<u32>>,
    incoming: Vec<Vec<u32>>,
}

impl Communicator for Single {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn transfer(&self, outgoing: &[Message], incoming: &[Message]) -> Box<dyn Transfer> {
        assert!(outgoing.iter().chain(incoming).all(|message| message.rank == 0));
        assert_eq!(outgoing, incoming, "the two ends of a message");
        let buffers = || outgoing.iter().map(|message| vec![0; message.words]).collect();
        Box::new(Loop { outgoing: buffers(), incoming: buffers() })
    }

    fn sum(&self, _: &mut [i64]) {}

    fn max(&self, _: &mut [i64]) {}

    fn broadcast(&self, _: &mut Vec<u8>) {}

    fn send(&self, to: usize, _: &[u32]) {
        unreachable!("there is no rank {to} to send to");
    }

    fn receive(&self, from: usize, _: &mut [u32]) {
        unreachable!("there is no rank {from} to receive from");
    }

    fn rest(&self) {}

    fn abort(&self, _: u8) {}
}

impl Transfer for Loop {
    fn outgoing(&mut self) -> Vec<&mut [u32]> {
        self.outgoing.iter_mut().map(Vec::as_mut_slice).collect()
    }

    fn incoming(&self) -> Vec<&[u32]> {
        self.incoming.iter().map(Vec::as_slice).collect()
    }

    fn start(&mut self) {
        for (to, from) in self.incoming.iter_mut().zip(&self.outgoing) {
            to.copy_from_slice(from);
        }
    }

    fn progress(&mut self) {}

    fn finish(&mut self) {}
}
