//! The MPI library: who may call it, what a failed call means, and when it is finalised.
//!
//! Threads take turns: it is initialised for that, which costs nothing and is had everywhere. A
//! turn is one call that waits for no other rank; whatever takes longer is started in one turn and
//! asked after in others. So a thread that waits for a rank keeps none of its own process from
//! calling, least of all the one that has to end the run. Who waits asks a few times at once, and
//! then gives its core away in between: the rank that it waits for may share it.

use std::ffi::{c_char, c_int, c_void};
use std::hint;
use std::io::{self, Write};
use std::mem::{self, MaybeUninit};
use std::process;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, TryLockError};
use std::thread;

use ::mpi::environment::Universe;
use ::mpi::ffi;
use ::mpi::traits::Communicator;

/// MPI from its beginning to its end.
pub(super) struct Library {
    /// Whose turn it is to call, and what with: a communicator of this library's own.
    turn: Mutex<Comm>,
    pub rank: usize,
    pub size: usize,
    largest_tag: u32,
    /// Transfers that were set up.
    transfers: AtomicU32,
    /// Finalises when it is dropped.
    universe: Option<Universe>,
}

/// The library's name for a group of ranks.
pub(super) struct Comm(ffi::MPI_Comm);

/// The right to call.
pub(super) type Turn<'a> = MutexGuard<'a, Comm>;

// SAFETY: it is a name that only the library looks behind, and it does so for any thread whose
// turn it is.
unsafe impl Send for Comm {}

impl Library {
    /// The tag of single messages. Transfers have those above.
    pub const SINGLE: c_int = 0;

    /// The library, initialised for threads that take turns.
    pub fn new(universe: Universe) -> Self {
        let world = universe.world();
        let mut library = Self {
            // SAFETY: it is set when the program starts, and never again.
            turn: Mutex::new(Comm(unsafe { ffi::RSMPI_COMM_WORLD })),
            rank: world.rank() as usize,
            size: world.size() as usize,
            // What there is at least.
            largest_tag: 32_767,
            transfers: AtomicU32::new(0),
            universe: Some(universe),
        };
        let mut largest: *const c_int = std::ptr::null();
        let mut found = 0;
        library.call("MPI_Comm_get_attr", |comm| {
            let value: *mut *const c_int = &mut largest;
            // SAFETY: the value of an attribute is a pointer, and there is room for one.
            unsafe {
                let tag = ffi::MPI_TAG_UB as c_int;
                ffi::MPI_Comm_get_attr(comm, tag, value.cast::<c_void>(), &mut found)
            }
        });
        if found != 0 {
            // SAFETY: of this attribute it points to an integer, which is there until the end.
            library.largest_tag = unsafe { *largest } as u32;
        }
        // SAFETY: it is set when the program starts, and never again.
        let mut own = unsafe { ffi::RSMPI_COMM_NULL };
        library.call("MPI_Comm_dup", |comm| {
            // SAFETY: there is room for the name of a communicator. This waits for other ranks, and
            // nobody else has the library yet.
            unsafe { ffi::MPI_Comm_dup(comm, &mut own) }
        });
        library.turn = Mutex::new(Comm(own));
        library
    }

    /// A tag for a transfer: the same on all ranks, as they set them up in the same order. So many
    /// transfers later it is that of another; nobody has two of them under way by then.
    pub fn next_tag(&self) -> c_int {
        let number = self.transfers.fetch_add(1, Ordering::Relaxed);
        (Self::SINGLE as u32 + 1 + number % self.largest_tag) as c_int
    }

    /// Makes a call that waits for no other rank.
    pub fn call(&self, name: &str, call: impl FnOnce(ffi::MPI_Comm) -> c_int) {
        self.call_in(self.turn(), name, call);
    }

    /// Makes such a call in a turn that one has.
    pub fn call_in(&self, turn: Turn<'_>, name: &str, call: impl FnOnce(ffi::MPI_Comm) -> c_int) {
        let code = call(turn.0);
        drop(turn);
        self.check(name, code);
    }

    /// Waits for a turn. Nothing that is done in one can panic, let alone break something.
    pub fn turn(&self) -> Turn<'_> {
        self.turn.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A turn, unless it is somebody else's.
    pub fn try_turn(&self) -> Option<Turn<'_>> {
        match self.turn.try_lock() {
            Ok(turn) => Some(turn),
            Err(TryLockError::Poisoned(turn)) => Some(turn.into_inner()),
            Err(TryLockError::WouldBlock) => None,
        }
    }

    /// Starts a request and waits until it is complete, with a pause between two looks.
    ///
    /// It does not unwind before that: memory that is borrowed for as long as this runs is safe to
    /// leave to the request.
    pub fn run(
        &self,
        name: &str,
        mut pause: impl FnMut(),
        start: impl FnOnce(ffi::MPI_Comm, *mut ffi::MPI_Request) -> c_int,
    ) -> ffi::MPI_Status {
        // SAFETY: it is set when the program starts, and never again.
        let mut request = unsafe { ffi::RSMPI_REQUEST_NULL };
        let mut status = MaybeUninit::<ffi::MPI_Status>::zeroed();
        self.call(name, |comm| start(comm, &mut request));
        loop {
            let mut done = 0;
            self.call("MPI_Test", |_| {
                // SAFETY: the request is one that was started, or none, and there is room for the
                // answers.
                unsafe { ffi::MPI_Test(&mut request, &mut done, status.as_mut_ptr()) }
            });
            if done != 0 {
                // SAFETY: a status is made of integers, which the library has set, or which are
                // the zeros they were.
                return unsafe { status.assume_init() };
            }
            pause();
        }
    }

    /// Ends all ranks.
    pub fn abort(&self, code: u8) -> ! {
        let _turn = self.turn();
        // SAFETY: MPI has been initialised and not finalised, since `universe` is still there, and
        // it is this thread's turn.
        unsafe { ffi::MPI_Abort(ffi::RSMPI_COMM_WORLD, code.into()) };
        // A library that could not end the others: their launcher sees this rank go.
        process::exit(code.into())
    }

    /// Ends all ranks if a call failed. Most libraries do so themselves: nobody knows what became
    /// of messages, and memory that requests work on cannot be given back.
    fn check(&self, name: &str, code: c_int) {
        if code == ffi::MPI_SUCCESS as c_int {
            return;
        }
        let mut text = [0_u8; ffi::MPI_MAX_ERROR_STRING as usize];
        let mut len = 0;
        {
            let _turn = self.turn();
            // SAFETY: there is room for the longest text.
            unsafe {
                ffi::MPI_Error_string(code, text.as_mut_ptr().cast::<c_char>(), &mut len);
            }
        }
        let text = text.get(..len as usize).unwrap_or_default();
        // Not by `eprintln!`: nobody may be there to read it, and that is no reason to panic.
        let _ = writeln!(io::stderr(), "{name} failed: {}", String::from_utf8_lossy(text));
        self.abort(1);
    }
}

impl Drop for Library {
    fn drop(&mut self) {
        if thread::panicking() {
            // Others may never come to finalise. The launcher sees a rank go that has not.
            mem::forget(self.universe.take());
            return;
        }
        let mut comm = self.turn().0;
        // SAFETY: the communicator is a duplicate, so it may be freed. No request is left on it:
        // who has one has this library. MPI is finalised after this, with `universe`.
        let code = unsafe { ffi::MPI_Comm_free(&mut comm) };
        self.check("MPI_Comm_free", code);
    }
}

/// A number of elements as MPI has it.
pub(super) fn count(elements: usize) -> c_int {
    c_int::try_from(elements).expect("messages are cut")
}

/// A pause for those who wait for something that is probably there soon.
pub(super) fn patient() -> impl FnMut() {
    /// Looks before the core is given away.
    const HASTY: u32 = 64;
    let mut looks = 0;
    move || {
        if looks < HASTY {
            looks += 1;
            hint::spin_loop();
        } else {
            thread::yield_now();
        }
    }
}
