//! Ranks of MPI, as Slurm or `mpirun` starts them on the machines of a cluster.
//!
//! A room with `unsafe`: what is sent again and again goes through persistent requests, which no
//! safe interface has. [`Mpi`] is the communicator, `library` lets one thread at a time call the
//! library, and `transfer` has the memory that messages leave from and arrive in. What makes it
//! safe is one rule: **memory that a request works on is neither touched nor freed until the
//! library says that the request is complete.**

mod library;
mod transfer;

use std::ffi::c_int;
use std::fmt;
use std::panic;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use ::mpi::environment::{self, Threading};
use ::mpi::ffi;
use ::mpi::traits::Communicator as _;
use thiserror::Error;

use crate::communicator::{Communicator, Message, Transfer};
use crate::launcher::Launcher;
use library::{Library, count, patient};
use transfer::Persistent;

/// Why there is no communicator of MPI.
#[derive(Debug, Error)]
pub enum MpiError {
    /// MPI begins and ends once in a process.
    #[error("MPI has been initialised in this process before")]
    Again,
    /// The library is for programs of one thread.
    #[error("this MPI does not let the threads of a program take turns: {library}")]
    Threads {
        /// What the library says it is.
        library: String,
    },
    /// The launcher and the library do not know each other.
    #[error(
        "the launcher started {launched} processes, but MPI sees {size}: this program was built \
         with another MPI ({library}) than the launcher's"
    )]
    World {
        /// Processes that the launcher started.
        launched: usize,
        /// Processes that the library knows.
        size: usize,
        /// What the library says it is.
        library: String,
    },
}

/// The communicator of a rank that an MPI launcher started; of the only one, if none did.
///
/// MPI is finalised when this and its transfers are gone, which waits until all ranks do the same:
/// a rank that alone cannot go on calls [`Communicator::abort`]. It is for the thread that began. A
/// rank that panics does not finalise, and its launcher ends the others.
pub struct Mpi {
    library: Arc<Library>,
    /// Elements that one call is asked to move.
    most: usize,
}

impl Mpi {
    /// Elements of a message that is not cut. The count is a C integer, and libraries have been
    /// known to put bytes into one.
    const MOST: usize = 1 << 28;
    /// Values that are added up at once, which bounds the memory it takes.
    const MOST_VALUES: usize = 1 << 20;

    /// Initialises MPI, together with all ranks.
    ///
    /// # Errors
    /// A second time in one process, a library that cannot be used by threads in turn, and one
    /// that knows another number of ranks than the launcher started.
    pub fn init() -> Result<Self, MpiError> {
        let (universe, threading) =
            environment::initialize_with_threading(Threading::Serialized).ok_or(MpiError::Again)?;
        if threading < Threading::Serialized {
            return Err(MpiError::Threads { library: name() });
        }
        let size = universe.world().size() as usize;
        let launcher = Launcher::detect(|name| std::env::var(name).ok());
        match launcher.and_then(|launcher| launcher.size) {
            Some(launched) if launched != size => {
                Err(MpiError::World { launched, size, library: name() })
            }
            _ => Ok(Self { library: Arc::new(Library::new(universe)), most: Self::MOST }),
        }
    }

    /// Cuts messages of more elements. It has to be the same on all ranks.
    #[must_use]
    pub fn cut_at(mut self, elements: usize) -> Self {
        self.most = elements.clamp(1, Self::MOST);
        self
    }

    /// From now on, a panic of any thread of this rank ends all ranks, once its message is out.
    /// Without that, they wait for the rank for ever.
    pub fn end_all_on_panic(&self) {
        /// The exit code of a Rust program that panics.
        const PANICKED: u8 = 101;
        let library = Arc::downgrade(&self.library);
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |panic| {
            before(panic);
            if let Some(library) = library.upgrade() {
                library.abort(PANICKED);
            }
        }));
    }

    /// Replaces each value by what an operation makes of those of all ranks.
    fn reduce(&self, values: &mut [i64], datatype: ffi::MPI_Datatype, operation: ffi::MPI_Op) {
        for values in values.chunks_mut(self.most.min(Self::MOST_VALUES)) {
            let own = values.to_vec();
            self.library.run("MPI_Iallreduce", patient(), |comm, request| {
                // SAFETY: `own` and `values` are two pieces of memory of as many elements, of
                // eight bytes as those of both datatypes are. They are borrowed until `run`
                // returns, which is after the request is complete.
                unsafe {
                    ffi::MPI_Iallreduce(
                        own.as_ptr().cast(),
                        values.as_mut_ptr().cast(),
                        count(values.len()),
                        datatype,
                        operation,
                        comm,
                        request,
                    )
                }
            });
        }
    }

    /// Replaces bytes by as many of the root's.
    fn broadcast_slice(&self, bytes: &mut [u8]) {
        for piece in bytes.chunks_mut(self.most) {
            self.library.run("MPI_Ibcast", patient(), |comm, request| {
                // SAFETY: `piece` has as many bytes, and is borrowed until `run` returns, which is
                // after the request is complete.
                unsafe {
                    ffi::MPI_Ibcast(
                        piece.as_mut_ptr().cast(),
                        count(piece.len()),
                        ffi::RSMPI_UINT8_T,
                        0,
                        comm,
                        request,
                    )
                }
            });
        }
    }

    /// The length of the message of each rank, or all bits if it has none.
    fn words(&self, messages: &[Message]) -> Vec<u64> {
        let mut words = vec![u64::MAX; self.size()];
        for message in messages {
            words[message.rank] = message.words as u64;
        }
        words
    }

    /// Sends each rank a number, and receives what it sends to this one.
    ///
    /// Ranks that do not agree on their messages would wait for ever, or for what does not fit.
    fn ahead(&self, numbers: &[u64]) -> Vec<u64> {
        assert_eq!(numbers.len(), self.size());
        let mut heard = vec![0_u64; self.size()];
        self.library.run("MPI_Ialltoall", patient(), |comm, request| {
            // SAFETY: both have a number for each rank. They are borrowed until `run` returns,
            // which is after the request is complete.
            unsafe {
                ffi::MPI_Ialltoall(
                    numbers.as_ptr().cast(),
                    1,
                    ffi::RSMPI_UINT64_T,
                    heard.as_mut_ptr().cast(),
                    1,
                    ffi::RSMPI_UINT64_T,
                    comm,
                    request,
                )
            }
        });
        heard
    }

    /// A rank as MPI knows it.
    fn other(&self, rank: usize) -> c_int {
        assert!(rank < self.size(), "there is no rank {rank}");
        rank as c_int
    }
}

/// What the library says it is; it may go on for lines.
fn name() -> String {
    let version = environment::library_version().unwrap_or_default();
    version.lines().next().unwrap_or_default().trim_end_matches('\0').trim().to_owned()
}

impl fmt::Debug for Mpi {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Mpi").field("rank", &self.rank()).field("size", &self.size()).finish()
    }
}

impl Communicator for Mpi {
    fn rank(&self) -> usize {
        self.library.rank
    }

    fn size(&self) -> usize {
        self.library.size
    }

    fn transfer(&self, outgoing: &[Message], incoming: &[Message]) -> Box<dyn Transfer> {
        assert_eq!(
            self.ahead(&self.words(outgoing)),
            self.words(incoming),
            "words that ranks send, and those that rank {} expects",
            self.rank()
        );
        Box::new(Persistent::new(Arc::clone(&self.library), outgoing, incoming, self.most))
    }

    fn sum(&self, values: &mut [i64]) {
        // Without a sign they are the same bits, and wrap around in every language.
        // SAFETY: the two are set when the program starts, and never again.
        let (datatype, operation) = unsafe { (ffi::RSMPI_UINT64_T, ffi::RSMPI_SUM) };
        self.reduce(values, datatype, operation);
    }

    fn max(&self, values: &mut [i64]) {
        // SAFETY: the two are set when the program starts, and never again.
        let (datatype, operation) = unsafe { (ffi::RSMPI_INT64_T, ffi::RSMPI_MAX) };
        self.reduce(values, datatype, operation);
    }

    fn broadcast(&self, bytes: &mut Vec<u8>) {
        let mut len = (bytes.len() as u64).to_ne_bytes();
        self.broadcast_slice(&mut len);
        bytes.resize(u64::from_ne_bytes(len) as usize, 0);
        self.broadcast_slice(bytes);
    }

    fn send(&self, to: usize, words: &[u32]) {
        let to = self.other(to);
        for piece in words.chunks(self.most) {
            self.library.run("MPI_Isend", patient(), |comm, request| {
                // SAFETY: `piece` has as many words, and is borrowed until `run` returns, which is
                // after the request is complete.
                unsafe {
                    ffi::MPI_Isend(
                        piece.as_ptr().cast(),
                        count(piece.len()),
                        ffi::RSMPI_UINT32_T,
                        to,
                        Library::SINGLE,
                        comm,
                        request,
                    )
                }
            });
        }
    }

    fn receive(&self, from: usize, words: &mut [u32]) {
        let from = self.other(from);
        for piece in words.chunks_mut(self.most) {
            let status = self.library.run("MPI_Irecv", patient(), |comm, request| {
                // SAFETY: `piece` has as many words, and is borrowed until `run` returns, which is
                // after the request is complete. All bits make a word.
                unsafe {
                    ffi::MPI_Irecv(
                        piece.as_mut_ptr().cast(),
                        count(piece.len()),
                        ffi::RSMPI_UINT32_T,
                        from,
                        Library::SINGLE,
                        comm,
                        request,
                    )
                }
            });
            let mut found = 0;
            self.library.call("MPI_Get_count", |_| {
                // SAFETY: the status is that of a message of such words.
                unsafe { ffi::MPI_Get_count(&status, ffi::RSMPI_UINT32_T, &mut found) }
            });
            assert_eq!(found, count(piece.len()), "words from rank {from}");
        }
    }

    fn rest(&self) {
        /// Between two looks. Whoever waits this way waits for long.
        const NAP: Duration = Duration::from_millis(5);
        self.library.run(
            "MPI_Ibarrier",
            || thread::sleep(NAP),
            |comm, request| {
                // SAFETY: a barrier works on no memory.
                unsafe { ffi::MPI_Ibarrier(comm, request) }
            },
        );
    }

    fn abort(&self, code: u8) {
        self.library.abort(code);
    }
}
