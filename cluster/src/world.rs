//! The world of a run: its ranks, and the rounds that they do together.
//!
//! A rank is a process with its threads. All ranks run the same program, a sequence of rounds
//! with rising numbers; in each they take jobs from the board, their own by place first, then
//! others'. A rank that comes late to a round that is over goes on to the next, so one that is
//! started in the middle of a run catches up by itself.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use crate::faults::{Faults, Place};
use crate::peers::{Alone, Peers};
use crate::shared::{Board, Claim, Counter, Job, Shards};

/// The ranks of a run, seen from one of them.
#[derive(Debug)]
pub struct World {
    board: Board,
    rank: usize,
    /// Whether there is a core for every thread: more threads than cores must not spin, as the one
    /// they wait for may need the core.
    spins: AtomicBool,
    faults: Option<Faults>,
    peers: Arc<dyn Peers>,
}

/// What follows a round.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ends {
    /// Another round of the same step.
    Half,
    /// A step is over: here ranks can be held and stopped.
    Step,
}

/// How often to look before one sleeps, while there is a core for every thread: about 100 µs. A
/// sleeper costs whoever wakes it some microseconds, and itself more.
const SPINS: u32 = 4000;

impl World {
    /// The world of a board, as a rank of it.
    ///
    /// # Panics
    /// If there is no such rank.
    pub fn new(board: Board, rank: usize, faults: Option<Faults>) -> Self {
        let plan = board.plan();
        assert!(rank < plan.ranks);
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let spins = AtomicBool::new(plan.ranks * plan.threads <= cores);
        Self { board, rank, spins, faults, peers: Arc::new(Alone) }
    }

    /// The same, with other worlds beside it that share no memory with it.
    pub fn with_peers(self, peers: Arc<dyn Peers>) -> Self {
        Self { peers, ..self }
    }

    /// The worlds that share no memory with this one, which is one of them.
    pub fn peers(&self) -> &Arc<dyn Peers> {
        &self.peers
    }

    /// Whether ranks spin before they sleep: there is a core for every thread, as far as the
    /// process that says so may use them.
    pub fn spins(&self) -> bool {
        self.spins.load(Ordering::Relaxed)
    }

    /// Says so for a process that may not use all cores of the ranks.
    pub fn let_spin(&self, spins: bool) {
        self.spins.store(spins, Ordering::Relaxed);
    }

    /// This rank's number, from 0.
    pub fn rank(&self) -> usize {
        self.rank
    }

    /// Number of ranks.
    pub fn size(&self) -> usize {
        self.board.plan().ranks
    }

    /// Threads of each rank.
    pub fn threads(&self) -> usize {
        self.board.plan().threads
    }

    /// The board that deals out the jobs.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// Tells that a job of this rank read bytes that another rank wrote.
    pub fn read_from_others(&self, bytes: u64) {
        if bytes > 0 {
            self.count(Counter::Traffic, bytes);
        }
    }

    /// Does what waits for others.
    pub fn waiting<T>(&self, wait: impl FnOnce() -> T) -> T {
        let begin = Instant::now();
        let result = wait();
        self.count(Counter::Waiting, begin.elapsed().as_nanos() as u64);
        result
    }

    /// Gives a sign of life.
    pub fn beat(&self) {
        self.count(Counter::Beats, 1);
    }

    /// A place where faults made on purpose can happen.
    #[inline]
    pub fn fault(&self, place: Place) {
        if let Some(faults) = &self.faults {
            faults.at(place, &self.board);
        }
    }

    fn count(&self, counter: Counter, by: u64) {
        self.board.counter(self.rank, counter).fetch_add(by, Ordering::Relaxed);
    }

    /// Does the jobs of these numbers together with all ranks, and returns when all are done; at
    /// once, if they were before.
    ///
    /// `work` is called once for each job that this rank does, with its parts of the shards, by as
    /// many threads at a time as a rank has (those of the current rayon pool, as far as there are
    /// so many). A job that was cut off by a fault is done again, from the unit that it was in.
    /// While a job is worked on, the round cannot end: what its rounds before wrote stays.
    ///
    /// Round numbers rise, and all ranks do the same rounds with the same parts.
    ///
    /// # Panics
    /// If there are more jobs than the board has room for, or fewer parts than jobs.
    pub fn round<S, W>(&self, round: u64, ends: Ends, jobs: Range<usize>, shards: S, work: W)
    where
        S: Shards,
        W: Fn(&Job<'_>, S::Part) + Sync,
    {
        assert!(jobs.end <= self.board.plan().jobs, "jobs {jobs:?} on a board");
        if self.board.completed() >= round {
            return;
        }
        self.board.wait_for_release(round, || self.fault(Place::Hold));
        let own = self.own(&jobs, self.rank);
        let cursor = AtomicUsize::new(own.start);
        let shift =
            Shift { world: self, round, ends, jobs: jobs.clone(), shards: &shards, work: &work };
        loop {
            let event = self.board.event();
            match self.threads() {
                1 => shift.work(0, &cursor, own.end),
                threads => (0..threads)
                    .into_par_iter()
                    .with_max_len(1)
                    .for_each(|thread| shift.work(thread, &cursor, own.end)),
            }
            if self.board.completed() >= round {
                return;
            }
            if self.board.all_done(round, jobs.clone()) {
                self.fault(Place::Commit);
                self.board.complete(round);
                return;
            }
            let spins = if self.spins() { SPINS } else { 0 };
            self.waiting(|| self.board.wait(event, spins));
        }
    }

    /// The jobs that are a rank's by place.
    fn own(&self, jobs: &Range<usize>, rank: usize) -> Range<usize> {
        let share = |rank: usize| jobs.start + jobs.len() * rank / self.size();
        share(rank)..share(rank + 1)
    }
}

/// One rank's share in a round.
struct Shift<'a, S, W> {
    world: &'a World,
    round: u64,
    ends: Ends,
    jobs: Range<usize>,
    shards: &'a S,
    work: &'a W,
}

impl<S, W> Shift<'_, S, W>
where
    S: Shards,
    W: Fn(&Job<'_>, S::Part) + Sync,
{
    /// Does jobs until none is free: the rank's own from `cursor` to `end` first, then what others
    /// have left, from their ends.
    fn work(&self, thread: usize, cursor: &AtomicUsize, end: usize) {
        loop {
            let job = cursor.fetch_add(1, Ordering::Relaxed);
            if job >= end {
                break;
            }
            self.attempt(job, thread);
        }
        let size = self.world.size();
        for other in (0..size).map(|next| (self.world.rank + next) % size) {
            for job in self.world.own(&self.jobs, other).rev() {
                if self.attempt(job, thread) && other != self.world.rank {
                    self.world.count(Counter::Taken, 1);
                }
            }
        }
    }

    /// Does a job, if it is free.
    fn attempt(&self, job: usize, thread: usize) -> bool {
        let Self { world, round, .. } = *self;
        let thread = world.rank * world.threads() + thread;
        let Some(Claim { token, job }) = world.board.claim(round, job, thread) else {
            return false;
        };
        let begin = Instant::now();
        (self.work)(&job, self.shards.part(token));
        if job.index() == self.jobs.start && self.ends == Ends::Step {
            world.board.decide(round);
        }
        world.fault(Place::Commit);
        job.finish();
        world.count(Counter::Busy, begin.elapsed().as_nanos() as u64);
        world.count(Counter::Jobs, 1);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shared::{Arena, BoardPlan, Header, Map};

    /// The worlds of all ranks, in one process, over one file.
    fn worlds(ranks: usize, threads: usize, jobs: usize) -> Vec<(World, Arena)> {
        let plan = BoardPlan { ranks, threads, jobs, journal: 64 };
        let file = tempfile::tempfile().unwrap();
        let header = Header { len: plan.room() as u64 + (1 << 16), run: 1 };
        Map::create(&file, header).unwrap();
        (0..ranks)
            .map(|rank| {
                let mut arena = Arena::new(Map::open(&file, header).unwrap());
                (World::new(Board::new(&mut arena, plan), rank, None), arena)
            })
            .collect()
    }

    #[test]
    fn every_job_of_every_round_is_done_once_by_someone() {
        const JOBS: usize = 37;
        const ROUNDS: u64 = 300;
        for (ranks, threads) in [(1, 1), (1, 4), (2, 1), (3, 2), (8, 1)] {
            let sums: Vec<u64> = std::thread::scope(|scope| {
                let run = |(world, mut arena): (World, Arena)| {
                    let parts = |job| vec![job * 3..job * 3 + 1, job * 3 + 1..job * 3 + 3];
                    let mut odd =
                        arena.take(JOBS * 3 * 8).parts::<u64>((0..JOBS).map(parts).collect());
                    let mut even =
                        arena.take(JOBS * 3 * 8).parts::<u64>((0..JOBS).map(parts).collect());
                    // A rank that is late finds some rounds over.
                    std::thread::sleep(std::time::Duration::from_millis(world.rank() as u64));
                    for round in 1..=ROUNDS {
                        let (from, to) =
                            if round % 2 == 1 { (&even, &mut odd) } else { (&odd, &mut even) };
                        world.round(round, Ends::Step, 0..JOBS, (to,), |job, (mut part,)| {
                            let i = job.index();
                            let before = from.whole()[i * 3] + from.whole()[(i + 1) % JOBS * 3 + 2];
                            part.piece(0)[0] = before + 1;
                            part.piece(1)[1] += round;
                        });
                    }
                    let jobs = world.board().counter(world.rank(), Counter::Jobs);
                    (even.whole().to_vec(), jobs.load(Ordering::Relaxed))
                };
                let handles: Vec<_> = worlds(ranks, threads, JOBS)
                    .into_iter()
                    .map(|it| scope.spawn(move || run(it)))
                    .collect();
                let results: Vec<_> = handles.into_iter().map(|it| it.join().unwrap()).collect();
                let jobs: u64 = results.iter().map(|(_, jobs)| jobs).sum();
                assert_eq!(jobs, JOBS as u64 * ROUNDS, "{ranks} ranks of {threads} threads");
                assert!(results.iter().all(|(words, _)| *words == results[0].0));
                results[0].0.clone()
            });
            // The same without jobs.
            let (mut odd, mut even) = (vec![0_u64; JOBS * 3], vec![0_u64; JOBS * 3]);
            for round in 1..=ROUNDS {
                let (from, to) = if round % 2 == 1 { (&even, &mut odd) } else { (&odd, &mut even) };
                for i in 0..JOBS {
                    to[i * 3] = from[i * 3] + from[(i + 1) % JOBS * 3 + 2] + 1;
                    to[i * 3 + 2] += round;
                }
            }
            assert_eq!(sums, even, "{ranks} ranks of {threads} threads");
        }
    }

    #[test]
    fn a_job_whose_holder_died_is_done_by_who_waits_for_it() {
        let mut worlds = worlds(2, 1, 4).into_iter();
        let ((alive, _arena), (dead, _)) = (worlds.next().unwrap(), worlds.next().unwrap());
        // Rank 1 claims a job and is not heard of again.
        let _claim = dead.board().claim(1, 3, 1).unwrap();
        let done = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            let waits = scope.spawn(|| {
                alive.round(1, Ends::Step, 0..4, (), |_, ()| {
                    done.fetch_add(1, Ordering::Relaxed);
                });
            });
            std::thread::sleep(std::time::Duration::from_millis(50));
            assert!(!waits.is_finished());
            assert_eq!(done.load(Ordering::Relaxed), 3);
            assert_eq!(dead.board().release_rank(1), 1);
            waits.join().unwrap();
        });
        assert_eq!(done.load(Ordering::Relaxed), 4);
        assert_eq!(alive.board().completed(), 1);
    }
}
