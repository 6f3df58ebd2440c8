//! The board: which job of which round is free, claimed or done.
//!
//! Work is done in *rounds* of jobs. All threads of all ranks take jobs from the board until none
//! is free; the round is over when all are done, whoever did them. So nobody ever waits for a
//! rank, only for jobs: one that comes late, or never, holds up nothing but the job it has claimed.
//! When a rank dies, its claims are released, and whoever is free takes them.
//!
//! A job's word says the round, the state and the holder, all that there is to know; a job is
//! claimed by exchanging a word that says *free*, or an earlier round, for one's own. A job that
//! changes memory does so unit by unit, and each unit is made in the journal of its thread before
//! it is put in place: what a dead rank left half done is ended before the job is released.

use std::cell::Cell;
use std::ops::Range;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering, fence};

use crate::shared::section::{Arena, Section, Words};
use crate::signal;

/// How much a board has to hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BoardPlan {
    /// Ranks.
    pub ranks: usize,
    /// Threads of a rank.
    pub threads: usize,
    /// Most jobs of a round.
    pub jobs: usize,
    /// Most bytes of a unit of a job; 0 if no rank can be lost.
    pub journal: usize,
}

/// Deals out the jobs of rounds.
#[derive(Debug)]
pub struct Board {
    words: Words,
    journals: Option<Section>,
    plan: BoardPlan,
}

/// What a job's word says besides the round.
const FREE: u64 = 0;
const CLAIMED: u64 = 1;
const DONE: u64 = 2;

/// Bits of a job's word: the round, the state and the thread.
const ROUND_SHIFT: u32 = 20;
const STATE_SHIFT: u32 = 18;
const THREAD: u64 = (1 << STATE_SHIFT) - 1;

/// Words of two cache lines.
const LINE: usize = 16;

/// Places of the words that everyone shares, each on lines of its own.
const COMPLETED: usize = 0;
const EVENT: usize = LINE;
const SLEEPERS: usize = 2 * LINE;
const HOLD_ASKED: usize = 3 * LINE;
const HELD: usize = HOLD_ASKED + 1;
const RELEASED: usize = HOLD_ASKED + 2;
const STOP_ASKED: usize = HOLD_ASKED + 3;
const STOPPED: usize = HOLD_ASKED + 4;
const SHARED: usize = 4 * LINE;

/// Words at the beginning of a journal, which say where in the map its unit belongs and how many
/// bytes of it there are: as many as keep what follows aligned to a cache line.
const JOURNAL_HEAD: usize = 8;

/// Counters of a rank; [`Board::counter`] reads them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Counter {
    /// Signs of life.
    Beats,
    /// Nanoseconds that its threads worked on jobs.
    Busy,
    /// Nanoseconds that it waited for others' jobs.
    Waiting,
    /// Jobs done.
    Jobs,
    /// Jobs done that are another rank's by place.
    Taken,
    /// Bytes read that another rank wrote.
    Traffic,
}

impl BoardPlan {
    /// Bytes of a board.
    pub fn room(&self) -> usize {
        Arena::room(self.words().saturating_mul(8))
            .saturating_add(Arena::room(self.journal_words().saturating_mul(8 * self.slots())))
    }

    fn slots(&self) -> usize {
        self.ranks.saturating_mul(self.threads)
    }

    fn words(&self) -> usize {
        (SHARED + 2 * LINE)
            .saturating_add(self.ranks.saturating_mul(LINE))
            .saturating_add(self.jobs.saturating_mul(2))
    }

    fn journal_words(&self) -> usize {
        if self.journal == 0 { 0 } else { JOURNAL_HEAD + self.journal.div_ceil(64) * 8 }
    }
}

impl Board {
    /// Most threads of all ranks together.
    pub const MOST_THREADS: usize = THREAD as usize;

    /// The board at the next place of an arena.
    ///
    /// # Panics
    /// If there are more threads than [`Self::MOST_THREADS`], or the arena has no room.
    pub fn new(arena: &mut Arena, plan: BoardPlan) -> Self {
        assert!(plan.slots() <= Self::MOST_THREADS);
        let words = arena.take(plan.words() * 8).words();
        let journals = arena.take(plan.slots() * plan.journal_words() * 8);
        Self { words, journals: (plan.journal > 0).then_some(journals), plan }
    }

    /// What it can hold.
    pub fn plan(&self) -> BoardPlan {
        self.plan
    }

    /// The last round that is over; 0 before the first.
    pub fn completed(&self) -> u64 {
        self.words[COMPLETED].load(Ordering::Acquire)
    }

    /// Says that rounds up to this one were over before the board was made.
    pub fn begin_after(&self, round: u64) {
        self.words[COMPLETED].store(round, Ordering::Release);
    }

    /// Asks that all ranks stop at the end of a step.
    pub fn ask_stop(&self) {
        self.words[STOP_ASKED].store(1, Ordering::Release);
    }

    /// Stops here, between two rounds; for a rank that is alone.
    pub fn stop_here(&self) {
        if self.stopped().is_none() {
            self.words[STOPPED].store(self.completed(), Ordering::Release);
        }
    }

    /// The round after which no step is to follow, once it is known.
    pub fn stopped(&self) -> Option<u64> {
        Some(self.words[STOPPED].load(Ordering::Acquire)).filter(|&round| round > 0)
    }

    /// Asks that all ranks wait at the end of a step; [`Self::held`] tells when they do.
    pub fn ask_hold(&self) {
        self.words[HOLD_ASKED].store(1, Ordering::Release);
    }

    /// The round after which all ranks wait: nobody reads or writes until [`Self::release`].
    pub fn held(&self) -> Option<u64> {
        let held = self.words[HELD].load(Ordering::Acquire);
        let waits = held > self.words[RELEASED].load(Ordering::Acquire);
        (waits && self.completed() == held).then_some(held)
    }

    /// Lets the ranks go on, once they are [`Self::held`] or dead; and asks at once that they wait
    /// `again` at the end of the next step. Nobody decides while they wait, so what was asked
    /// meanwhile and this are decided together.
    pub fn release(&self, again: bool) {
        self.words[HOLD_ASKED].store(again.into(), Ordering::Release);
        let held = self.words[HELD].load(Ordering::Acquire);
        self.words[RELEASED].store(held, Ordering::Release);
        self.wake();
    }

    /// Decides, as the holder of a step's last job, what is to happen after it.
    pub(crate) fn decide(&self, round: u64) {
        for (asked, decided) in [(STOP_ASKED, STOPPED), (HOLD_ASKED, HELD)] {
            if self.words[asked].load(Ordering::Acquire) != 0 {
                let unset = self.words[decided].load(Ordering::Acquire) == 0;
                if unset || decided == HELD {
                    self.words[decided].store(round, Ordering::Release);
                }
            }
        }
    }

    /// Waits until a round may begin; calls `is_held` if it has to.
    pub(crate) fn wait_for_release(&self, round: u64, is_held: impl Fn()) {
        loop {
            let event = self.event();
            let held = self.words[HELD].load(Ordering::Acquire);
            if held >= round || held <= self.words[RELEASED].load(Ordering::Acquire) {
                return;
            }
            is_held();
            self.wait(event, 0);
        }
    }

    /// A counter of a rank.
    pub fn counter(&self, rank: usize, counter: Counter) -> &AtomicU64 {
        &self.words[SHARED + rank * LINE + counter as usize]
    }

    /// How often a numbered thing has happened, over all ranks; for faults made on purpose.
    ///
    /// # Panics
    /// If the number is 32 or more.
    pub fn tally(&self, number: usize) -> &AtomicU64 {
        assert!(number < 2 * LINE);
        &self.words[SHARED + self.plan.ranks * LINE + number]
    }

    fn job_words(&self) -> Range<usize> {
        let start = SHARED + self.plan.ranks * LINE + 2 * LINE;
        start..start + self.plan.jobs
    }

    fn job(&self, job: usize) -> &AtomicU64 {
        &self.words[self.job_words()][job]
    }

    fn progress(&self, job: usize) -> &AtomicU64 {
        &self.words[self.job_words().end..][job]
    }

    /// Claims a job of a round for a thread, if it is free.
    ///
    /// # Panics
    /// If there is no such thread or job.
    pub fn claim(&self, round: u64, job: usize, thread: usize) -> Option<Claim<'_>> {
        assert!(thread < self.plan.slots() && job < self.plan.jobs);
        let word = self.job(job);
        let seen = word.load(Ordering::Acquire);
        let free =
            seen >> ROUND_SHIFT < round || (seen >> ROUND_SHIFT == round && state(seen) == FREE);
        if !free {
            return None;
        }
        let mine = round << ROUND_SHIFT | CLAIMED << STATE_SHIFT | thread as u64;
        // Exactly one exchange of a word that says free succeeds.
        word.compare_exchange(seen, mine, Ordering::AcqRel, Ordering::Relaxed).ok()?;
        let progress = self.progress(job).load(Ordering::Relaxed);
        let done = if progress >> PROGRESS_SHIFT == round { progress >> 1 & UNITS } else { 0 };
        let job = Job {
            board: self,
            round,
            job,
            thread,
            done: Cell::new(done as usize),
            busy: Cell::new(false),
        };
        Some(Claim { token: Token { job: job.job }, job })
    }

    /// Whether all of a round's jobs are done.
    pub(crate) fn all_done(&self, round: u64, jobs: Range<usize>) -> bool {
        // After one's own last word, so that of two who finish at once one sees both.
        fence(Ordering::SeqCst);
        self.words[self.job_words()][jobs].iter().all(|word| {
            let seen = word.load(Ordering::Acquire);
            seen >> ROUND_SHIFT > round || (seen >> ROUND_SHIFT == round && state(seen) == DONE)
        })
    }

    /// Says that a round is over.
    pub(crate) fn complete(&self, round: u64) {
        if self.words[COMPLETED].fetch_max(round, Ordering::AcqRel) < round {
            self.wake();
        }
    }

    /// Wakes all who wait, so that they look again.
    pub fn wake(&self) {
        self.signal().fetch_add(1, Ordering::SeqCst);
        if self.words[SLEEPERS].load(Ordering::SeqCst) > 0 {
            signal::wake(self.signal());
        }
    }

    /// A number that changes when there is something new to see.
    pub(crate) fn event(&self) -> u32 {
        self.signal().load(Ordering::SeqCst)
    }

    /// Waits until [`Self::event`] changes: spins so many times first, then sleeps.
    pub(crate) fn wait(&self, event: u32, spins: u32) {
        for _ in 0..spins {
            if self.event() != event {
                return;
            }
            std::hint::spin_loop();
        }
        // A sleeper that dies is counted for ever, which costs a call to the system and no more.
        self.words[SLEEPERS].fetch_add(1, Ordering::SeqCst);
        signal::wait(self.signal(), event);
        self.words[SLEEPERS].fetch_sub(1, Ordering::SeqCst);
    }

    fn signal(&self) -> &AtomicU32 {
        let word: *const AtomicU64 = &self.words[EVENT];
        // SAFETY: the first half of an aligned word, which is used as such a half only.
        unsafe { &*word.cast() }
    }

    /// Gives back what a rank had claimed, after ending the units that it left half done. Returns
    /// how many jobs that were.
    ///
    /// The rank must be dead: stopped is not enough, it could wake and write.
    pub fn release_rank(&self, rank: usize) -> usize {
        let threads = rank * self.plan.threads..(rank + 1) * self.plan.threads;
        let mut released = 0;
        for job in 0..self.plan.jobs {
            let seen = self.job(job).load(Ordering::Acquire);
            let (round, thread) = (seen >> ROUND_SHIFT, (seen & THREAD) as usize);
            if state(seen) != CLAIMED || !threads.contains(&thread) {
                continue;
            }
            let progress = self.progress(job).load(Ordering::Acquire);
            if progress >> PROGRESS_SHIFT == round && progress & OPEN != 0 {
                self.put_in_place(thread);
                // The next unit, and not open: one more in the bits above.
                self.progress(job).store(progress + 1, Ordering::Release);
            }
            self.job(job).store(round << ROUND_SHIFT | FREE << STATE_SHIFT, Ordering::Release);
            released += 1;
        }
        self.wake();
        released
    }

    /// Puts what is in a thread's journal in place.
    fn put_in_place(&self, thread: usize) {
        let Some(journals) = &self.journals else { return };
        let words = self.plan.journal_words();
        let journal = &journals.slice::<u64>()[thread * words..][..words];
        let (head, data) = journal.split_at(JOURNAL_HEAD);
        let bytes = &bytemuck::cast_slice(data)[..head[1] as usize];
        Section::put(self.words.map(), head[0] as usize, bytes);
    }
}

fn state(word: u64) -> u64 {
    word >> STATE_SHIFT & 3
}

/// Bits of a progress word: the round, how many units are done, and whether the next is open.
const PROGRESS_SHIFT: u32 = 24;
const OPEN: u64 = 1;
const UNITS: u64 = (1 << (PROGRESS_SHIFT - 1)) - 1;

/// The right to do a job of a round, which nobody else has.
#[derive(Debug)]
pub struct Claim<'a> {
    /// What its parts are given for.
    pub(crate) token: Token,
    /// How its progress is told.
    pub(crate) job: Job<'a>,
}

/// What the parts of a job are given for.
#[derive(Debug)]
pub struct Token {
    job: usize,
}

impl Token {
    pub(super) fn job(&self) -> usize {
        self.job
    }
}

/// A job as the one sees it who does it.
#[derive(Debug)]
pub struct Job<'a> {
    board: &'a Board,
    round: u64,
    job: usize,
    thread: usize,
    /// Units that are done. Cells keep other threads out: the journal is this one's.
    done: Cell<usize>,
    /// Whether a unit is under way.
    busy: Cell<bool>,
}

impl Job<'_> {
    /// Says that it is done.
    pub(crate) fn finish(self) {
        let Self { board, round, job, thread, .. } = self;
        let done = round << ROUND_SHIFT | DONE << STATE_SHIFT | thread as u64;
        board.job(job).store(done, Ordering::Release);
    }

    /// Its number in the round.
    pub fn index(&self) -> usize {
        self.job
    }

    /// The thread that does it, counted over all ranks.
    pub fn thread(&self) -> usize {
        self.thread
    }

    /// Units that are done already: by someone who did not live to do the rest.
    pub fn units_done(&self) -> usize {
        self.done.get()
    }

    /// Changes one unit of the job, such that it is changed whole or not at all, whatever happens
    /// to this rank: `make` reads what the unit was and writes what it is to be to the journal,
    /// from where it is put in place. `midway` is called while that is half done.
    ///
    /// What else `make` writes is written when the unit is changed, and may be written again if
    /// it is not.
    ///
    /// # Panics
    /// If the board has no journal or no room in it, the unit is not in shared memory or within
    /// another, or the job has more than 2²³ − 1 units.
    pub fn unit(
        &self,
        unit: &mut [f32],
        make: impl FnOnce(&[f32], &mut [f32]),
        midway: impl FnOnce(),
    ) {
        let journals = self.board.journals.as_ref().expect("a board with a journal");
        let map = self.board.words.map();
        let offset = unit.as_ptr().addr().wrapping_sub(map.base().addr());
        assert!(offset <= map.len(), "a unit of shared memory");
        let words = self.board.plan.journal_words();
        let start: *mut u64 = journals.pointer();
        assert!(!self.busy.replace(true), "a unit within a unit");
        // SAFETY: the journal of a thread lies in the section, and it is this thread's alone:
        // `Job` is not `Sync`, nobody else has its number, and there is no unit within a unit.
        // Others read it when the thread is dead.
        let journal =
            unsafe { std::slice::from_raw_parts_mut(start.add(self.thread * words), words) };
        let (head, data) = journal.split_at_mut(JOURNAL_HEAD);
        let data: &mut [f32] = bytemuck::cast_slice_mut(data);
        let made = &mut data[..unit.len()];
        make(unit, made);
        (head[0], head[1]) = (offset as u64, size_of_val(unit) as u64);
        // The journal is whole before it is said to be open, and that is said before anything
        // changes; what a process has written when it dies was written in this order.
        let progress = self.board.progress(self.job);
        let units = self.done.get() as u64;
        assert!(units < UNITS, "{units} units of a job");
        progress.store(self.round << PROGRESS_SHIFT | units << 1 | OPEN, Ordering::Release);
        fence(Ordering::Release);
        let (one, other) = unit.split_at_mut(made.len() / 2);
        one.copy_from_slice(&made[..one.len()]);
        midway();
        other.copy_from_slice(&made[one.len()..]);
        progress.store(self.round << PROGRESS_SHIFT | (units + 1) << 1, Ordering::Release);
        self.done.set(units as usize + 1);
        self.busy.set(false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shared::{Map, Shards};

    const PLAN: BoardPlan = BoardPlan { ranks: 3, threads: 2, jobs: 5, journal: 64 };

    fn board() -> (Board, Arena) {
        let mut arena = Arena::new(Map::private(PLAN.room() + 4096).unwrap());
        (Board::new(&mut arena, PLAN), arena)
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
    fn what_a_dead_rank_had_is_released_and_what_it_had_open_is_ended() {
        let (board, mut arena) = board();
        let mut parts = arena
            .take(400)
            .parts::<f32>((0..5).map(|i| std::iter::once(i * 8..i * 8 + 8).collect()).collect());
        parts.whole_mut().fill(1.0);
        // Thread 3 is rank 1's second. It dies in the second unit of its job.
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
        assert_eq!(board.release_rank(2), 0);
        assert_eq!(board.release_rank(1), 1);
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
    fn who_is_told_to_stop_while_held_waits_where_it_stops() {
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
