//! A job: the word that says who has it, and how the one who has it changes memory, unit by unit.
//!
//! A job's word says the round, the state and the holder, all that there is to know; a job is
//! claimed by exchanging a word that says *free*, or an earlier round, for one's own. A job that
//! changes memory does so unit by unit, and each unit is made in the journal of its thread before
//! it is put in place: what a dead worker left half done is ended before the job is released.

use std::cell::Cell;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering, fence};

use crate::shared::journal::{Journals, Saver};

/// What a job's word says besides the round.
const FREE: u64 = 0;
const CLAIMED: u64 = 1;
const DONE: u64 = 2;

/// Bits of a job's word: the round, the state and the thread.
const ROUND_SHIFT: u32 = 20;
const STATE_SHIFT: u32 = 18;
pub(super) const THREAD: u64 = (1 << STATE_SHIFT) - 1;

/// Bits of a progress word: the round, how many units are done, and whether the next is open.
const PROGRESS_SHIFT: u32 = 24;
const OPEN: u64 = 1;
const UNITS: u64 = (1 << (PROGRESS_SHIFT - 1)) - 1;

/// What a board has of a job.
#[derive(Debug, Clone, Copy)]
pub(super) struct JobWords<'a> {
    pub word: &'a AtomicU64,
    pub progress: &'a AtomicU64,
    pub journals: Option<&'a Journals>,
}

/// Whether a job with this word is done in a round; one of a later round is.
pub(super) fn is_done(word: &AtomicU64, round: u64) -> bool {
    let seen = word.load(Ordering::Acquire);
    seen >> ROUND_SHIFT > round || (seen >> ROUND_SHIFT == round && state(seen) == DONE)
}

fn state(word: u64) -> u64 {
    word >> STATE_SHIFT & 3
}

impl<'a> JobWords<'a> {
    /// Claims the job of this number in a round for a thread, if it is free.
    pub fn claim(self, round: u64, index: usize, thread: usize) -> Option<Claim<'a>> {
        let seen = self.word.load(Ordering::Acquire);
        let free =
            seen >> ROUND_SHIFT < round || (seen >> ROUND_SHIFT == round && state(seen) == FREE);
        if !free {
            return None;
        }
        let mine = round << ROUND_SHIFT | CLAIMED << STATE_SHIFT | thread as u64;
        // Exactly one exchange of a word that says free succeeds.
        self.word.compare_exchange(seen, mine, Ordering::AcqRel, Ordering::Relaxed).ok()?;
        let progress = self.progress.load(Ordering::Relaxed);
        let done = if progress >> PROGRESS_SHIFT == round { progress >> 1 & UNITS } else { 0 };
        let (done, busy) = (Cell::new(done as usize), Cell::new(false));
        let job = Job { words: self, round, index, thread, done, busy };
        Some(Claim { token: Token { job: index }, job })
    }

    /// Gives the job back if one of these threads has claimed it, after ending or taking back the
    /// unit that it left half done. Returns whether that was so.
    ///
    /// # Safety
    /// The threads are dead, and nobody else gives back what they had.
    pub unsafe fn release(self, threads: &Range<usize>) -> bool {
        let seen = self.word.load(Ordering::Acquire);
        let (round, thread) = (seen >> ROUND_SHIFT, (seen & THREAD) as usize);
        if state(seen) != CLAIMED || !threads.contains(&thread) {
            return false;
        }
        let progress = self.progress.load(Ordering::Acquire);
        if progress >> PROGRESS_SHIFT == round && progress & OPEN != 0 {
            // SAFETY: the thread is dead, and only this call looks after what it had. Nobody
            // can claim its job before the word below says that it is free.
            let put = |journals: &Journals| unsafe { journals.put_in_place(thread) };
            let reverted = self.journals.is_some_and(put);
            // This unit again, or the next (one more in the bits above); and not open.
            let after = if reverted { progress - OPEN } else { progress + 1 };
            self.progress.store(after, Ordering::Release);
        }
        self.word.store(round << ROUND_SHIFT | FREE << STATE_SHIFT, Ordering::Release);
        true
    }
}

/// The right to do a job of a round, which nobody else has.
#[derive(Debug)]
pub struct Claim<'a> {
    /// What its parts are given for.
    pub(crate) token: Token,
    /// The job, for who does it.
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
    words: JobWords<'a>,
    round: u64,
    index: usize,
    thread: usize,
    /// Units that are done. Cells keep other threads out: the journal is this one's.
    done: Cell<usize>,
    /// Whether a unit is under way.
    busy: Cell<bool>,
}

impl Job<'_> {
    /// Says that it is done.
    pub(crate) fn finish(self) {
        let done = self.round << ROUND_SHIFT | DONE << STATE_SHIFT | self.thread as u64;
        self.words.word.store(done, Ordering::Release);
    }

    /// Its number in the round.
    pub fn index(&self) -> usize {
        self.index
    }

    /// The thread that does it, counted over all workers.
    pub fn thread(&self) -> usize {
        self.thread
    }

    /// Units that are done already: by someone who did not live to do the rest.
    pub fn units_done(&self) -> usize {
        self.done.get()
    }

    /// Changes one unit of the job, such that it is changed whole or not at all, whatever happens
    /// to this worker: `make` reads what the unit was and writes what it is to be to the journal,
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
        let journals = self.words.journals.expect("a board with a journal");
        self.enter();
        // SAFETY: the journal is this thread's alone: `Job` is not `Sync`, nobody else has its
        // number, and there is no unit within a unit, so what is returned here before is given
        // up. Others read it when the thread is dead.
        let made = unsafe { journals.write(self.thread, unit, make) };
        self.open();
        let (one, other) = unit.split_at_mut(made.len() / 2);
        one.copy_from_slice(&made[..one.len()]);
        midway();
        other.copy_from_slice(&made[one.len()..]);
        self.close();
    }

    /// Begins a unit that is changed in place: `save` names all of it, and if this worker dies
    /// before [`Reversible::done`], it will be as it was. On a board without a journal, where
    /// nobody can be lost, nothing is saved.
    ///
    /// # Panics
    /// If the unit is not in shared memory, larger than the journal, or within another, or the job
    /// has more than 2²³ − 1 units.
    pub fn reversible(&self, save: impl FnOnce(&mut Saver<'_>)) -> Reversible<'_> {
        self.enter();
        if let Some(journals) = self.words.journals {
            // SAFETY: as in `unit`.
            save(&mut unsafe { journals.save(self.thread) });
        }
        self.open();
        Reversible(self)
    }

    fn enter(&self) {
        assert!(!self.busy.replace(true), "a unit within a unit");
    }

    /// Says that the next unit is about to be changed.
    fn open(&self) {
        // The journal is whole before it is said to be open, and that is said before anything
        // changes; what a process has written when it dies was written in this order.
        let units = self.done.get() as u64;
        assert!(units < UNITS, "{units} units of a job");
        let open = self.round << PROGRESS_SHIFT | units << 1 | OPEN;
        self.words.progress.store(open, Ordering::Release);
        fence(Ordering::Release);
    }

    /// Says that it is changed.
    fn close(&self) {
        let units = self.done.get() + 1;
        let closed = self.round << PROGRESS_SHIFT | (units as u64) << 1;
        self.words.progress.store(closed, Ordering::Release);
        self.done.set(units);
        self.busy.set(false);
    }
}

/// A unit that is being changed in place.
#[derive(Debug)]
#[must_use = "a unit that is not said to be done is taken back"]
pub struct Reversible<'a>(&'a Job<'a>);

impl Reversible<'_> {
    /// Says that it is changed.
    pub fn done(self) {
        self.0.close();
    }
}
