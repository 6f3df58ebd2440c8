//! Threads, workers and instructions: flags of every command that uses them, of no influence on the
//! tile.

use clap::{Args, ValueEnum};
use perceptile::gradient::simd::Simd;
use perceptile::settings::whole;
use perceptile::solver::Parallelism;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::exit::Misuse;

/// Most worker processes.
const MAX_WORKERS: usize = 1024;
/// Most threads of all workers: each needs blocks and a journal.
const MAX_ALL_THREADS: usize = 1 << 14;

/// Threads, workers and instructions.
#[derive(Debug, Args)]
#[command(next_help_heading = "Running")]
pub struct ExecutionArgs {
    /// Threads of each worker or, without workers, of this process or rank, at most 1024; 0 shares out
    /// the cores
    #[arg(help_heading = "Running", long, value_name = "N", default_value_t = 0, value_parser = whole::<usize>)]
    threads: usize,

    /// Worker processes, at most 1024; 0 means threads in this process. They are of use on NUMA
    /// machines, and for runs that must survive
    #[arg(help_heading = "Running", long, value_name = "N", default_value_t = 0, value_parser = whole::<usize>)]
    pub workers: usize,

    /// Instruction set of the inner loops; of no influence on the tile
    #[arg(help_heading = "Running", long, value_enum, default_value_t = SimdChoice::Auto)]
    simd: SimdChoice,
}

/// What `--simd` offers.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum SimdChoice {
    /// The best that the machine has
    Auto,
    /// Portable code: the same bytes, slower
    Plain,
}

impl ExecutionArgs {
    /// Threads of this process or of each worker.
    ///
    /// # Errors
    /// If there are too many of them, or of all workers together.
    pub fn threads(&self) -> Result<usize, Misuse> {
        check(self.workers, "workers", MAX_WORKERS)?;
        check(self.threads, "threads", Parallelism::MAX_THREADS)?;
        let workers = self.workers.max(1);
        let threads = match self.threads {
            0 => (std::thread::available_parallelism().map_or(1, usize::from) / workers).max(1),
            asked => asked,
        };
        check(threads * workers, "threads of all workers", MAX_ALL_THREADS)?;
        Ok(threads)
    }

    /// So many workers and threads, in one process or beside it.
    ///
    /// # Errors
    /// If there are too many of them.
    pub fn parallelism(&self) -> Result<Parallelism, Misuse> {
        Ok(Parallelism { ranks: 1, workers: self.workers, threads: self.threads()? })
    }

    /// The instruction set on this machine.
    pub fn simd(&self) -> Simd {
        match self.simd {
            SimdChoice::Auto => Simd::detect(),
            SimdChoice::Plain => Simd::plain(),
        }
    }
}

/// Whether there are not too many of something.
fn check(asked: usize, what: &str, most: usize) -> Result<(), Misuse> {
    if asked <= most {
        return Ok(());
    }
    Err(Misuse(format!("{asked} {what} are too many: at most {most}")))
}

/// Why there are no workers on some systems.
#[cfg(not(unix))]
pub fn no_workers() -> Misuse {
    Misuse("there are no worker processes on this system".into())
}

/// Starts threads.
///
/// # Errors
/// If the system does not give them.
pub fn pool(threads: usize) -> Result<ThreadPool, Misuse> {
    ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|error| Misuse(format!("{threads} threads cannot be had: {error}")))
}
