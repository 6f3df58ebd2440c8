//! Ranks that are threads of one process: a cluster to try things on, without one.
//!
//! Nothing is shared but what is sent, so what works here works on machines apart. It is what
//! tests run on where there is no MPI.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Barrier, Mutex};

use crate::communicator::{Communicator, Message, Transfer};

/// The communicator of one of several ranks, each a thread.
#[derive(Debug)]
pub struct InProcess {
    rank: usize,
    shared: Arc<Shared>,
    /// Bytes sent by transfers that this rank started.
    sent: Arc<AtomicU64>,
    /// Transfers that were set up, which numbers them.
    transfers: AtomicU64,
}

#[derive(Debug)]
struct Shared {
    size: usize,
    barrier: Barrier,
    /// What ranks show each other, one after the other.
    values: Mutex<Vec<i64>>,
    bytes: Mutex<Vec<u8>>,
    /// Ends of channels that the other rank has not fetched yet: (transfer, from, to). The
    /// transfer of single messages is 0.
    ends: Mutex<Vec<(Key, End)>>,
}

type Key = (u64, usize, usize);

#[derive(Debug)]
enum End {
    Sender(Sender<Vec<u32>>),
    Receiver(Receiver<Vec<u32>>),
}

impl InProcess {
    /// So many ranks, each for a thread of its own.
    pub fn group(size: usize) -> Vec<Self> {
        let shared = Arc::new(Shared {
            size,
            barrier: Barrier::new(size),
            values: Mutex::default(),
            bytes: Mutex::default(),
            ends: Mutex::default(),
        });
        let rank = |rank| Self {
            rank,
            shared: Arc::clone(&shared),
            sent: Arc::default(),
            transfers: AtomicU64::new(0),
        };
        (0..size).map(rank).collect()
    }

    /// Bytes that transfers of this rank have sent.
    pub fn sent(&self) -> u64 {
        self.sent.load(Ordering::Relaxed)
    }

    /// Combines the values of all ranks.
    fn reduce(&self, values: &mut [i64], combine: impl Fn(i64, i64) -> i64) {
        const FIRST: &str = "no rank has panicked with it";
        self.shared.barrier.wait();
        {
            let mut all = self.shared.values.lock().expect(FIRST);
            if all.is_empty() {
                all.extend_from_slice(values);
            } else {
                all.iter_mut().zip(&*values).for_each(|(all, &value)| *all = combine(*all, value));
            }
        }
        self.shared.barrier.wait();
        values.copy_from_slice(&self.shared.values.lock().expect(FIRST)[..values.len()]);
        if self.shared.barrier.wait().is_leader() {
            self.shared.values.lock().expect(FIRST).clear();
        }
        self.shared.barrier.wait();
    }
}

impl Shared {
    /// One end of a channel; the other is left for who asks for it.
    fn end(&self, key: Key, sends: bool) -> End {
        let mut ends = self.ends.lock().expect("no rank has panicked with it");
        let waits =
            ends.iter().position(|(of, end)| *of == key && matches!(end, End::Sender(_)) == sends);
        if let Some(at) = waits {
            return ends.remove(at).1;
        }
        let (sender, receiver) = channel();
        let (mine, other) = if sends {
            (End::Sender(sender), End::Receiver(receiver))
        } else {
            (End::Receiver(receiver), End::Sender(sender))
        };
        ends.push((key, other));
        mine
    }

    fn sender(&self, key: Key) -> Sender<Vec<u32>> {
        match self.end(key, true) {
            End::Sender(sender) => sender,
            End::Receiver(_) => unreachable!("a sender was asked for"),
        }
    }

    fn receiver(&self, key: Key) -> Receiver<Vec<u32>> {
        match self.end(key, false) {
            End::Receiver(receiver) => receiver,
            End::Sender(_) => unreachable!("a receiver was asked for"),
        }
    }
}

impl Communicator for InProcess {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.shared.size
    }

    fn transfer(&self, outgoing: &[Message], incoming: &[Message]) -> Box<dyn Transfer> {
        assert!(outgoing.iter().chain(incoming).all(|message| message.rank < self.size()));
        let number = self.transfers.fetch_add(1, Ordering::Relaxed) + 1;
        let sender = |message: &Message| self.shared.sender((number, self.rank, message.rank));
        let receiver = |message: &Message| self.shared.receiver((number, message.rank, self.rank));
        let buffers = |messages: &[Message]| -> Vec<Vec<u32>> {
            messages.iter().map(|message| vec![0; message.words]).collect()
        };
        Box::new(ThreadTransfer {
            outgoing: buffers(outgoing),
            incoming: buffers(incoming),
            senders: outgoing.iter().map(sender).collect(),
            receivers: incoming.iter().map(receiver).collect(),
            under_way: false,
            sent: Arc::clone(&self.sent),
        })
    }

    fn sum(&self, values: &mut [i64]) {
        self.reduce(values, i64::wrapping_add);
    }

    fn max(&self, values: &mut [i64]) {
        self.reduce(values, i64::max);
    }

    fn broadcast(&self, bytes: &mut Vec<u8>) {
        const FIRST: &str = "no rank has panicked with it";
        if self.rank == 0 {
            self.shared.bytes.lock().expect(FIRST).clone_from(bytes);
        }
        self.shared.barrier.wait();
        bytes.clone_from(&self.shared.bytes.lock().expect(FIRST));
        self.shared.barrier.wait();
    }

    fn send(&self, to: usize, words: &[u32]) {
        // A message is a channel of its own, found by whoever comes second.
        self.shared
            .sender((0, self.rank, to))
            .send(words.to_vec())
            .expect("the other end is kept until it is fetched");
    }

    fn receive(&self, from: usize, words: &mut [u32]) {
        let receiver = self.shared.receiver((0, from, self.rank));
        words.copy_from_slice(&receiver.recv().expect("the sender sends before it is dropped"));
    }

    fn rest(&self) {
        self.shared.barrier.wait();
    }

    /// Ends the process, of which all ranks are threads.
    fn abort(&self, code: u8) {
        std::process::exit(code.into());
    }
}

/// A transfer between threads.
struct ThreadTransfer {
    outgoing: Vec<Vec<u32>>,
    incoming: Vec<Vec<u32>>,
    senders: Vec<Sender<Vec<u32>>>,
    receivers: Vec<Receiver<Vec<u32>>>,
    under_way: bool,
    sent: Arc<AtomicU64>,
}

impl Transfer for ThreadTransfer {
    fn outgoing(&mut self) -> Vec<&mut [u32]> {
        assert!(!self.under_way, "a transfer that is under way");
        self.outgoing.iter_mut().map(Vec::as_mut_slice).collect()
    }

    fn incoming(&self) -> Vec<&[u32]> {
        assert!(!self.under_way, "a transfer that is under way");
        self.incoming.iter().map(Vec::as_slice).collect()
    }

    fn start(&mut self) {
        assert!(!self.under_way, "a transfer that is under way");
        for (words, sender) in self.outgoing.iter().zip(&self.senders) {
            self.sent.fetch_add(4 * words.len() as u64, Ordering::Relaxed);
            // A rank that is gone receives nothing more, and nobody asks it.
            let _ = sender.send(words.clone());
        }
        self.under_way = true;
    }

    fn progress(&mut self) {}

    fn finish(&mut self) {
        if std::mem::take(&mut self.under_way) {
            for (words, receiver) in self.incoming.iter_mut().zip(&self.receivers) {
                let found = receiver.recv().expect("a rank that is still there");
                words.copy_from_slice(&found);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs one function on all ranks at once.
    fn on_all<T: Send>(size: usize, run: impl Fn(&InProcess) -> T + Sync) -> Vec<T> {
        std::thread::scope(|scope| {
            let ranks: Vec<_> = InProcess::group(size)
                .into_iter()
                .map(|rank| {
                    let run = &run;
                    scope.spawn(move || run(&rank))
                })
                .collect();
            ranks.into_iter().map(|rank| rank.join().unwrap()).collect()
        })
    }

    #[test]
    fn sums_and_largest_values_are_those_of_all_ranks() {
        for size in [1, 2, 5] {
            let found = on_all(size, |communicator| {
                (0..50)
                    .map(|i| {
                        let mut values = [i + communicator.rank() as i64, -1, i64::MAX];
                        communicator.sum(&mut values);
                        let mut most = [communicator.rank() as i64, -i];
                        communicator.max(&mut most);
                        (values, most)
                    })
                    .collect::<Vec<_>>()
            });
            let n = size as i64;
            for rank in found {
                for (i, (sums, most)) in rank.into_iter().enumerate() {
                    let i = i as i64;
                    let wrapped = (1..n).fold(i64::MAX, |sum, _| sum.wrapping_add(i64::MAX));
                    assert_eq!(sums, [n * i + n * (n - 1) / 2, -n, wrapped]);
                    assert_eq!(most, [n - 1, -i]);
                }
            }
        }
    }

    #[test]
    fn messages_arrive_in_order_and_transfers_keep_apart() {
        on_all(3, |communicator| {
            let (me, size) = (communicator.rank(), communicator.size());
            let words = |from: usize, to: usize| 1 + from * 2 + to;
            let to = |other| Message { rank: other, words: words(me, other) };
            let from = |other| Message { rank: other, words: words(other, me) };
            let messages = |message: &dyn Fn(usize) -> Message| (0..size).map(message).collect();
            let (outgoing, incoming): (Vec<_>, Vec<_>) = (messages(&to), messages(&from));
            let mut transfers = [(); 2].map(|()| communicator.transfer(&outgoing, &incoming));
            for round in 0..20_u32 {
                for (which, transfer) in transfers.iter_mut().enumerate() {
                    for (other, words) in transfer.outgoing().into_iter().enumerate() {
                        words.fill(round * 1000 + which as u32 * 100 + (me * 10 + other) as u32);
                    }
                    transfer.start();
                }
                for (which, transfer) in transfers.iter_mut().enumerate().rev() {
                    transfer.progress();
                    transfer.finish();
                    for (other, found) in transfer.incoming().into_iter().enumerate() {
                        let word = round * 1000 + which as u32 * 100 + (other * 10 + me) as u32;
                        assert_eq!(found, vec![word; words(other, me)]);
                    }
                }
            }
            if me == 0 {
                for i in 0..9 {
                    let mut words = [0; 2];
                    communicator.receive(1 + i % 2, &mut words);
                    assert_eq!(words, [i as u32 / 2, 1 + i as u32 % 2]);
                }
            } else {
                (0..6 - me as u32).for_each(|i| communicator.send(0, &[i, me as u32]));
            }
            let mut bytes = if me == 0 { vec![1, 2, 3] } else { Vec::new() };
            communicator.broadcast(&mut bytes);
            assert_eq!(bytes, [1, 2, 3]);
            communicator.rest();
        });
    }
}
