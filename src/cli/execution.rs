//! How a run is carried out: flags of every command that does one, of no influence on the tile.

use clap::{Args, ValueEnum};
use perceptile::gradient::simd::Simd;
use rayon::{ThreadPool, ThreadPoolBuilder};

use super::Misuse;

/// Most threads; systems refuse far more of them, some only after having made thousands.
const MAX_THREADS: usize = 1024;

/// Threads, workers and instructions.
#[derive(Debug, Args)]
pub struct ExecutionArgs {
    /// Threads, at most 1024; 0 takes one for each core
    #[arg(long, default_value_t = 0)]
    threads: usize,

    /// Worker processes; 0 means threads in this process
    #[arg(long, default_value_t = 0, value_parser = parse_workers)]
    workers: u32,

    /// Instruction set of the inner loops; of no influence on the tile
    #[arg(long, value_enum, default_value_t = SimdChoice::Auto)]
    simd: SimdChoice,
}

/// What `--simd` offers.
#[derive(Debug, Clone, Copy, ValueEnum)]
enum SimdChoice {
    /// The best that the machine has
    Auto,
    /// None
    Plain,
}

impl ExecutionArgs {
    /// The number of threads.
    ///
    /// # Errors
    /// If it is too large.
    pub fn threads(&self) -> Result<usize, Misuse> {
        match self.threads {
            0 => Ok(std::thread::available_parallelism().map_or(1, usize::from)),
            1..=MAX_THREADS => Ok(self.threads),
            asked => Err(Misuse(format!("{asked} threads are too many: at most {MAX_THREADS}"))),
        }
    }

    /// The instruction set on this machine.
    pub fn simd(&self) -> Simd {
        match self.simd {
            SimdChoice::Auto => Simd::detect(),
            SimdChoice::Plain => Simd::plain(),
        }
    }
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

/// Reads the number of worker processes.
fn parse_workers(text: &str) -> Result<u32, String> {
    match text.parse() {
        Ok(0) => Ok(0),
        _ => {
            Err("there are no worker processes in this version; 0 means threads in this process"
                .into())
        }
    }
}
