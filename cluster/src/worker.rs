//! A worker's view of the run, and the rounds that the workers of a rank do together.
//!
//! All workers do the same sequence of rounds with rising numbers; in each they take jobs from the
//! board, those of their own share first, then others'. A worker that comes late to a round that is
//! over goes on to the next, so one that is started in the middle of a run catches up by itself.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Instant;

use rayon::prelude::*;

use crate::communicator::{Communicator, Single};
use crate::faults::{FaultSite, Faults};
use crate::shared::{Board, Claim, Counter, Job, Shards};

/// One of the workers of a rank, and what it has of the others.
#[derive(Debug)]
pub struct Worker {
    board: Board,
    index: usize,
    /// Whether there is a core for every thread: more threads than cores must not spin, as the one
    /// that they wait for may need the core.
    spins: AtomicBool,
    faults: Option<Faults>,
    communicator: Arc<dyn Communicator>,
}

/// What follows a round.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ends {
    /// Another round of the same step.
    Half,
    /// A step is over: here workers can be held and stopped.
    Step,
}

/// How often to look before one sleeps, while there is a core for every thread: about 100 µs. A
/// sleeper costs whoever wakes it some microseconds, and itself more.
const SPINS: u32 = 4000;

impl Worker {
    /// The worker of this index, with the others of a board; a run of one rank.
    ///
    /// # Panics
    /// If the board has no such worker.
    pub fn new(board: Board, index: usize, faults: Option<Faults>) -> Self {
        let plan = board.plan();
        assert!(index < plan.workers);
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let spins = AtomicBool::new(plan.workers * plan.threads <= cores);
        Self { board, index, spins, faults, communicator: Arc::new(Single) }
    }

    /// The same, as a worker of one of several ranks.
    pub fn with_communicator(self, communicator: Arc<dyn Communicator>) -> Self {
        Self { communicator, ..self }
    }

    /// How the rank of this worker reaches the others.
    pub fn communicator(&self) -> &Arc<dyn Communicator> {
        &self.communicator
    }

    /// Whether the worker spins before it sleeps: there is a core for every thread, as far as this
    /// process may use them.
    pub fn spins(&self) -> bool {
        self.spins.load(Ordering::Relaxed)
    }

    /// Sets that, for a process that may not use the cores of all workers and so does not see them.
    pub fn let_spin(&self, spins: bool) {
        self.spins.store(spins, Ordering::Relaxed);
    }

    /// Its number among the workers, from 0.
    pub fn index(&self) -> usize {
        self.index
    }

    /// Number of workers.
    pub fn workers(&self) -> usize {
        self.board.plan().workers
    }

    /// Threads of each worker.
    pub fn threads(&self) -> usize {
        self.board.plan().threads
    }

    /// The board that deals out the jobs.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// Counts bytes that a job of this worker read and another worker wrote.
    pub fn read_from_others(&self, bytes: u64) {
        if bytes > 0 {
            self.count(Counter::Traffic, bytes);
        }
    }

    /// Does what waits for others, and counts the time.
    pub fn waiting<T>(&self, wait: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = wait();
        self.count(Counter::Waiting, start.elapsed().as_nanos() as u64);
        result
    }

    /// Gives a sign of life.
    pub fn beat(&self) {
        self.count(Counter::Beats, 1);
    }

    /// Here faults made on purpose can happen.
    #[inline]
    pub fn fault(&self, site: FaultSite) {
        if let Some(faults) = &self.faults {
            faults.at(site, &self.board);
        }
    }

    fn count(&self, counter: Counter, by: u64) {
        self.board.counter(self.index, counter).fetch_add(by, Ordering::Relaxed);
    }

    /// Does the jobs of these numbers together with all workers, and returns when all are done; at
    /// once, if they were before.
    ///
    /// `work` is called once for each job that this worker does, with its parts of the shards, by
    /// as many threads at a time as a worker has (those of the current rayon pool, as far as there
    /// are so many). A job that was cut off by a fault is done again, from the unit that it was in.
    /// While a job is worked on, the round cannot end: what earlier rounds wrote stays as it is.
    ///
    /// Round numbers rise, and all workers do the same rounds with the same parts.
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
        self.board.wait_for_release(round, || self.fault(FaultSite::HOLD));
        let own = self.own(&jobs, self.index);
        let cursor = AtomicUsize::new(own.start);
        let shift =
            Shift { worker: self, round, ends, jobs: jobs.clone(), shards: &shards, work: &work };
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
                self.fault(FaultSite::COMMIT);
                self.board.complete(round);
                return;
            }
            let spins = if self.spins() { SPINS } else { 0 };
            self.waiting(|| self.board.wait(event, spins));
        }
    }

    /// A worker's own share of the jobs.
    fn own(&self, jobs: &Range<usize>, index: usize) -> Range<usize> {
        let share = |index: usize| jobs.start + jobs.len() * index / self.workers();
        share(index)..share(index + 1)
    }
}

/// One worker's share in a round.
struct Shift<'a, S, W> {
    worker: &'a Worker,
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
    /// Does jobs until none is free: the worker's own from `cursor` to `end` first, then what
    /// others have left, from their ends.
    fn work(&self, thread: usize, cursor: &AtomicUsize, end: usize) {
        loop {
            let job = cursor.fetch_add(1, Ordering::Relaxed);
            if job >= end {
                break;
            }
            self.attempt(job, thread);
        }
        let workers = self.worker.workers();
        for other in (0..workers).map(|next| (self.worker.index + next) % workers) {
            for job in self.worker.own(&self.jobs, other).rev() {
                if self.attempt(job, thread) && other != self.worker.index {
                    self.worker.count(Counter::Taken, 1);
                }
            }
        }
    }

    /// Does a job, if it is free.
    fn attempt(&self, job: usize, thread: usize) -> bool {
        let Self { worker, round, .. } = *self;
        let thread = worker.index * worker.threads() + thread;
        let Some(Claim { token, job }) = worker.board.claim(round, job, thread) else {
            return false;
        };
        let start = Instant::now();
        (self.work)(&job, self.shards.part(token));
        if job.index() == self.jobs.start && self.ends == Ends::Step {
            worker.board.decide(round);
        }
        worker.fault(FaultSite::COMMIT);
        job.finish();
        worker.count(Counter::Busy, start.elapsed().as_nanos() as u64);
        worker.count(Counter::Jobs, 1);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shared::{Arena, BoardPlan, Map, MapHeader};

    /// All workers of a rank, in one process, over one file.
    fn all_workers(workers: usize, threads: usize, jobs: usize) -> Vec<(Worker, Arena)> {
        let plan = BoardPlan { workers, threads, jobs, journal: 64 };
        let folder = std::env::temp_dir();
        let file = tempfile::tempfile_in(&folder).unwrap();
        let header = MapHeader { len: plan.room() as u64 + (1 << 16), run: 1 };
        Map::create(&file, &folder, header).unwrap();
        (0..workers)
            .map(|index| {
                let mut arena = Arena::new(Map::open(&file, header).unwrap());
                (Worker::new(Board::new(&mut arena, plan), index, None), arena)
            })
            .collect()
    }

    #[test]
    fn every_job_of_every_round_is_done_once_by_someone() {
        const JOBS: usize = 37;
        const ROUNDS: u64 = 300;
        for (workers, threads) in [(1, 1), (1, 4), (2, 1), (3, 2), (8, 1)] {
            let sums: Vec<u64> = std::thread::scope(|scope| {
                let run = |(worker, mut arena): (Worker, Arena)| {
                    let parts = |job| vec![job * 3..job * 3 + 1, job * 3 + 1..job * 3 + 3];
                    let mut odd =
                        arena.take(JOBS * 3 * 8).parts::<u64>((0..JOBS).map(parts).collect());
                    let mut even =
                        arena.take(JOBS * 3 * 8).parts::<u64>((0..JOBS).map(parts).collect());
                    // A worker that is late finds some rounds over.
                    std::thread::sleep(std::time::Duration::from_millis(worker.index() as u64));
                    for round in 1..=ROUNDS {
                        let (from, to) =
                            if round % 2 == 1 { (&even, &mut odd) } else { (&odd, &mut even) };
                        worker.round(round, Ends::Step, 0..JOBS, (to,), |job, (mut part,)| {
                            let i = job.index();
                            let before = from.whole()[i * 3] + from.whole()[(i + 1) % JOBS * 3 + 2];
                            part.piece(0)[0] = before + 1;
                            part.piece(1)[1] += round;
                        });
                    }
                    let jobs = worker.board().counter(worker.index(), Counter::Jobs);
                    (even.whole().to_vec(), jobs.load(Ordering::Relaxed))
                };
                let handles: Vec<_> = all_workers(workers, threads, JOBS)
                    .into_iter()
                    .map(|it| scope.spawn(move || run(it)))
                    .collect();
                let results: Vec<_> = handles.into_iter().map(|it| it.join().unwrap()).collect();
                let jobs: u64 = results.iter().map(|(_, jobs)| jobs).sum();
                assert_eq!(jobs, JOBS as u64 * ROUNDS, "{workers} workers of {threads} threads");
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
            assert_eq!(sums, even, "{workers} workers of {threads} threads");
        }
    }

    #[test]
    fn a_job_whose_holder_died_is_done_by_who_waits_for_it() {
        let mut workers = all_workers(2, 1, 4).into_iter();
        let ((alive, _arena), (dead, _)) = (workers.next().unwrap(), workers.next().unwrap());
        // Worker 1 claims a job and is not heard of again.
        let _claim = dead.board().claim(1, 3, 1).unwrap();
        let done = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            let waits = scope.spawn(|| {
                alive.round(1, Ends::Step, 0..4, (), |_, ()| {
                    done.fetch_add(1, Ordering::Relaxed);
                });
            });
            // It has done the others, and has looked for this one in vain.
            let waited = alive.board().counter(0, Counter::Waiting);
            while waited.load(Ordering::Relaxed) == 0 && !waits.is_finished() {
                std::thread::yield_now();
            }
            assert!(!waits.is_finished());
            assert_eq!(done.load(Ordering::Relaxed), 3);
            assert_eq!(dead.board().release_worker(1), 1);
            waits.join().unwrap();
        });
        assert_eq!(done.load(Ordering::Relaxed), 4);
        assert_eq!(alive.board().completed(), 1);
    }
}
