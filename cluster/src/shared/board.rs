//! The board: which job of which round is free, claimed or done.
//!
//! Work is done in *rounds* of jobs. All threads of all workers take jobs from the board until none
//! is free; the round is over when all are done, whoever did them. So nobody ever waits for a
//! worker, only for jobs: one that comes late, or never, holds up nothing but the job it has
//! claimed. When a worker dies, its claims are released, and whoever is free takes them.
//!
//! Here the files beside this one come together: a board is the words of jobs and their journals,
//! the orders that are decided at the end of a round, the counters, and what wakes who waits.

use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering, fence};

use crate::shared::counters::{Counter, TALLIES, WorkerCounters};
use crate::shared::event_count::EventCount;
use crate::shared::job::{Claim, JobWords, THREAD, is_done};
use crate::shared::journal::Journals;
use crate::shared::orders::Orders;
use crate::shared::section::{Arena, Words};

/// How much a board has to hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoardPlan {
    /// Workers.
    pub workers: usize,
    /// Threads of a worker.
    pub threads: usize,
    /// Most jobs of a round.
    pub jobs: usize,
    /// Most bytes of a unit of a job; 0 if no worker can be lost.
    pub journal: usize,
}

/// Deals out the jobs of rounds.
#[derive(Debug)]
pub struct Board {
    /// The last round that is over.
    completed: Words,
    event: EventCount,
    orders: Orders,
    counters: WorkerCounters,
    /// A word for each job, and then a word for the progress of each.
    jobs: Words,
    journals: Option<Journals>,
    plan: BoardPlan,
}

/// Bytes of one word.
const WORD: usize = size_of::<u64>();

impl BoardPlan {
    /// Bytes of a board; saturating.
    pub fn room(&self) -> usize {
        [
            Arena::room(WORD),
            EventCount::room(),
            Orders::room(),
            WorkerCounters::room(self.workers),
            Arena::room(self.job_bytes()),
            Journals::room(self.all_threads(), self.journal),
        ]
        .into_iter()
        .fold(0, usize::saturating_add)
    }

    /// Bytes of a unit that is saved in so many ranges of so many bytes altogether; saturating.
    pub fn saved(ranges: usize, bytes: usize) -> usize {
        Journals::saved(ranges, bytes)
    }

    fn all_threads(&self) -> usize {
        self.workers.saturating_mul(self.threads)
    }

    fn job_bytes(&self) -> usize {
        self.jobs.saturating_mul(2 * WORD)
    }
}

impl Board {
    /// Most threads of all workers together.
    pub const MOST_THREADS: usize = THREAD as usize;
    /// Number of things that [`Self::tally`] counts.
    pub const TALLIES: usize = TALLIES;

    /// The board at the next place of an arena.
    ///
    /// # Panics
    /// If there are more threads than [`Self::MOST_THREADS`], or the arena has no room.
    pub fn new(arena: &mut Arena, plan: BoardPlan) -> Self {
        assert!(plan.all_threads() <= Self::MOST_THREADS);
        // In this order in all processes, each on lines of its own.
        Self {
            completed: arena.take(WORD).words(),
            event: EventCount::new(arena),
            orders: Orders::new(arena),
            counters: WorkerCounters::new(arena, plan.workers),
            jobs: arena.take(plan.job_bytes()).words(),
            journals: Journals::new(arena, plan.all_threads(), plan.journal),
            plan,
        }
    }

    /// What it can hold.
    pub fn plan(&self) -> BoardPlan {
        self.plan
    }

    /// The last round that is over; 0 before the first.
    pub fn completed(&self) -> u64 {
        self.completed[0].load(Ordering::Acquire)
    }

    /// Says that rounds up to this one were over before the board was made.
    pub fn start_after(&self, round: u64) {
        self.completed[0].store(round, Ordering::Release);
    }

    /// Says that a round is over.
    pub(crate) fn complete(&self, round: u64) {
        if self.completed[0].fetch_max(round, Ordering::AcqRel) < round {
            self.event.raise();
        }
    }

    /// Claims a job of a round for a thread, if it is free.
    ///
    /// # Panics
    /// If there is no such thread or job.
    pub fn claim(&self, round: u64, job: usize, thread: usize) -> Option<Claim<'_>> {
        assert!(thread < self.plan.all_threads() && job < self.plan.jobs);
        self.job(job).claim(round, job, thread)
    }

    /// Whether all of a round's jobs are done.
    pub(crate) fn all_done(&self, round: u64, jobs: Range<usize>) -> bool {
        // After one's own last word, so that of two who finish at once one sees both.
        fence(Ordering::SeqCst);
        self.jobs[..self.plan.jobs][jobs].iter().all(|word| is_done(word, round))
    }

    /// Gives back what a worker had claimed, after ending the units that it left half done. Returns
    /// how many jobs that were.
    ///
    /// The worker must be dead: stopped is not enough, it could wake and write.
    pub fn release_worker(&self, worker: usize) -> usize {
        let threads = worker * self.plan.threads..(worker + 1) * self.plan.threads;
        // SAFETY: the worker is dead, as the caller says, and it is the caller who looks after it.
        let release = |job: &usize| unsafe { self.job(*job).release(&threads) };
        let released = (0..self.plan.jobs).filter(release).count();
        self.event.raise();
        released
    }

    fn job(&self, job: usize) -> JobWords<'_> {
        let (words, progress) = self.jobs.split_at(self.plan.jobs);
        let journals = self.journals.as_ref();
        JobWords { word: &words[job], progress: &progress[job], journals }
    }

    /// Asks that all workers stop at the end of a step.
    pub fn ask_stop(&self) {
        self.orders.ask_stop();
    }

    /// Stops here, between two rounds; for a worker that is alone.
    pub fn stop_here(&self) {
        self.orders.stop_after(self.completed());
    }

    /// The round after which no step is to follow, once it is known.
    pub fn stopped(&self) -> Option<u64> {
        self.orders.stopped()
    }

    /// Asks that all workers wait at the end of a step; [`Self::held`] says when they do.
    pub fn ask_hold(&self) {
        self.orders.ask_hold();
    }

    /// Waits until something happens that all should see, such as the end of a round, but not long.
    pub fn watch(&self, event: u32) {
        self.event.wait(event, 0);
    }

    /// The round after which all workers wait: nobody reads or writes until [`Self::release`].
    pub fn held(&self) -> Option<u64> {
        self.orders.held().filter(|&round| round == self.completed())
    }

    /// Lets the workers go on, once they are [`Self::held`] or dead; and asks at once that they
    /// wait `again` at the end of the next step.
    pub fn release(&self, again: bool) {
        self.orders.release(again);
        self.event.raise();
    }

    /// Decides, as the holder of a step's first job, what is to happen after the step.
    pub(crate) fn decide(&self, round: u64) {
        self.orders.decide(round);
    }

    /// Waits until a round may begin; calls `is_held` if it has to.
    pub(crate) fn wait_for_release(&self, round: u64, is_held: impl Fn()) {
        loop {
            let seen = self.event.seen();
            if self.orders.held().is_none_or(|held| held >= round) {
                return;
            }
            is_held();
            self.event.wait(seen, 0);
        }
    }

    /// A number that changes when there is something new to see.
    pub fn event(&self) -> u32 {
        self.event.seen()
    }

    /// Waits until [`Self::event`] changes: spins so many times first, then sleeps.
    pub(crate) fn wait(&self, event: u32, spins: u32) {
        self.event.wait(event, spins);
    }

    /// A counter of a worker.
    ///
    /// # Panics
    /// If there is no such worker.
    pub fn counter(&self, worker: usize, counter: Counter) -> &AtomicU64 {
        self.counters.of_worker(worker, counter)
    }

    /// How often a numbered thing has happened, over all workers; for faults made on purpose.
    ///
    /// # Panics
    /// If the number is not below [`Self::TALLIES`].
    pub fn tally(&self, number: usize) -> &AtomicU64 {
        self.counters.tally(number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shared::{Map, Parts, Shards};

    const PLAN: BoardPlan = BoardPlan { workers: 3, threads: 2, jobs: 5, journal: 64 };

    fn board() -> (Board, Arena) {
        let mut arena = Arena::new(Map::private(PLAN.room() + 4096).unwrap());
        (Board::new(&mut arena, PLAN), arena)
    }

    fn eight_numbers_each(arena: &mut Arena) -> Parts<f32> {
        let of_job = |job: usize| std::iter::once(job * 8..job * 8 + 8).collect();
        arena.take(400).parts((0..5).map(of_job).collect())
    }

    #[test]
    fn a_board_takes_the_room_that_it_says() {
        for (workers, threads, jobs, journal) in [(1, 1, 1, 0), (3, 2, 5, 64), (7, 3, 100, 1000)] {
            let plan = BoardPlan { workers, threads, jobs, journal };
            let mut arena = Arena::new(Map::private(plan.room() + 128).unwrap());
            let board = Board::new(&mut arena, plan);
            assert_eq!(arena.take(128).len(), 128);
            assert!(std::panic::catch_unwind(move || arena.take(1)).is_err());
            assert_eq!((board.completed(), board.stopped(), board.held()), (0, None, None));
        }
        let plan = BoardPlan { workers: usize::MAX, threads: 2, jobs: usize::MAX, journal: 1 };
        assert_eq!(plan.room(), usize::MAX);
    }

    #[test]
    fn a_job_is_claimed_once_a_round() {
        let (board, _arena) = board();
        let claim = board.claim(1, 2, 0).unwrap();
        assert!(board.claim(1, 2, 1).is_none());
        claim.job.finish();
        assert!(board.claim(1, 2, 1).is_none());
        assert!(!board.all_done(1, 0..5));
        for job in [0, 1, 3, 4] {
            board.claim(1, job, 3).unwrap().job.finish();
        }
        assert!(board.all_done(1, 0..5));
        board.complete(1);
        assert_eq!(board.completed(), 1);
        // One that comes late finds nothing to do in the old round once there is a new one.
        let _claim = board.claim(2, 2, 4).unwrap();
        assert!(board.claim(1, 2, 1).is_none() && board.all_done(1, 0..5));
    }

    #[test]
    fn what_a_dead_worker_had_is_released_and_what_it_had_open_is_ended() {
        let (board, mut arena) = board();
        let mut parts = eight_numbers_each(&mut arena);
        parts.whole_mut().fill(1.0);
        // Thread 3 is worker 1's second. It dies in the second unit of its job.
        {
            let Claim { token, job } = board.claim(7, 4, 3).unwrap();
            let shards = (&mut parts,);
            let (mut part,) = shards.part(token);
            let (first, second) = part.piece(0).split_at_mut(4);
            job.unit(first, |_, to| to.fill(2.0), || ());
            let died = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                job.unit(second, |_, to| to.fill(3.0), || panic!("dies"));
            }));
            assert!(died.is_err());
        }
        let other = board.claim(7, 3, 1).unwrap();
        assert_eq!(parts.whole()[32..40], [2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 1.0, 1.0]);
        assert_eq!(board.release_worker(2), 0);
        assert_eq!(board.release_worker(1), 1);
        assert_eq!(parts.whole()[32..40], [2.0, 2.0, 2.0, 2.0, 3.0, 3.0, 3.0, 3.0]);
        assert!(board.claim(7, 3, 5).is_none());
        let again = board.claim(7, 4, 5).unwrap();
        assert_eq!(again.job.units_done(), 2);
        again.job.finish();
        other.job.finish();
        // In the next round nothing of it is left.
        assert_eq!(board.claim(8, 4, 0).unwrap().job.units_done(), 0);
    }

    #[test]
    fn a_change_in_place_that_a_dead_worker_left_half_done_is_taken_back() {
        let (board, mut arena) = board();
        let mut parts = eight_numbers_each(&mut arena);
        let claim = board.claim(7, 4, 3).unwrap();
        {
            let shards = (&mut parts,);
            let (mut part,) = shards.part(claim.token);
            let (first, second) = part.piece(0).split_at_mut(4);
            let unit = claim.job.reversible(|saver| saver.save(first));
            first.fill(2.0);
            unit.done();
            let _unit = claim.job.reversible(|saver| saver.save(second));
            second[..2].fill(3.0);
        }
        assert_eq!(board.release_worker(1), 1);
        assert_eq!(parts.whole()[32..40], [2.0, 2.0, 2.0, 2.0, 0.0, 0.0, 0.0, 0.0]);
        let again = board.claim(7, 4, 5).unwrap();
        assert_eq!(again.job.units_done(), 1);
    }

    #[test]
    fn holds_and_stops_are_decided_once_for_all() {
        let (board, _arena) = board();
        board.decide(3);
        assert_eq!((board.held(), board.stopped()), (None, None));
        board.ask_hold();
        assert_eq!(board.held(), None);
        board.decide(5);
        assert_eq!(board.held(), None);
        board.complete(5);
        assert_eq!(board.held(), Some(5));
        // Those who are still in the round may end it.
        board.wait_for_release(5, || ());
        board.release(false);
        assert_eq!(board.held(), None);
        board.wait_for_release(6, || ());
        board.decide(7);
        assert_eq!(board.stopped(), None);
        board.ask_stop();
        board.decide(9);
        board.decide(11);
        assert_eq!(board.stopped(), Some(9));
    }

    #[test]
    fn who_is_to_stop_while_held_waits_where_it_stops() {
        let (board, _arena) = board();
        board.ask_hold();
        board.decide(5);
        board.complete(5);
        board.ask_stop();
        board.release(true);
        board.wait_for_release(6, || ());
        board.decide(7);
        board.complete(7);
        assert_eq!((board.stopped(), board.held()), (Some(7), Some(7)));
    }
}
