//! The ranks of a cluster, as the command sees them.
//!
//! All ranks are started with the same arguments. The root alone reads and writes files and speaks
//! to people: it prepares the run and tells the others what to do, or with which exit code to end.
//! A rank that fails by itself says so, and all end.

use std::sync::Arc;
use std::time::Duration;

use perceptile::run::begin::Begin;
use perceptile::run::program::Program;
use perceptile_cluster::codec;
use perceptile_cluster::launcher::Launcher;
use perceptile_cluster::peers::Peers;
use serde::{Deserialize, Serialize};

use super::carry::Ready;
use super::{Misuse, say};

/// A failure that was told already, and the exit code for it.
#[derive(Debug, thiserror::Error)]
#[error("the run has failed")]
pub struct Told(pub u8);

/// What the root tells other ranks.
#[derive(Debug, Serialize, Deserialize)]
struct Brief {
    program: Program,
    /// Whether it begins with a checkpoint.
    is_kept: bool,
}

/// Most memory that a brief may ask for: kernels of millions of taps are long.
const BRIEF_LIMIT: usize = 1 << 30;

/// The launcher of this process, if it has one.
pub fn launcher() -> Option<Launcher> {
    Launcher::detect(|name| std::env::var(name).ok())
}

/// The ranks that this process is one of, if a launcher started it as such.
///
/// # Errors
/// A program that was built without MPI, or with another one than its launcher's.
#[cfg(feature = "mpi")]
pub fn join(launcher: Option<Launcher>) -> anyhow::Result<Option<Arc<dyn Peers>>> {
    use perceptile_cluster::mpi::Mpi;

    if launcher.is_none() {
        return Ok(None);
    }
    let mpi = Mpi::init().map_err(|error| Misuse(error.to_string()))?;
    mpi.end_all_on_panic();
    Ok(Some(Arc::new(mpi)))
}

/// The ranks that this process is one of: none, as it was built without MPI.
///
/// # Errors
/// A launcher that started several.
#[cfg(not(feature = "mpi"))]
pub fn join(launcher: Option<Launcher>) -> anyhow::Result<Option<Arc<dyn Peers>>> {
    check_alone(launcher, "this program was built without MPI: build it with `--features mpi`")?;
    Ok(None)
}

/// Refuses to be one of several.
///
/// # Errors
/// A launcher that started several; `why` they cannot work together.
pub fn check_alone(launcher: Option<Launcher>, why: &str) -> Result<(), Misuse> {
    match launcher {
        Some(Launcher { name, size, .. }) if size != Some(1) => {
            let several = size.map_or("several".into(), |size| size.to_string());
            Err(Misuse(format!("{name} started {several} ranks, but {why}")))
        }
        _ => Ok(()),
    }
}

/// What the root has prepared, on all ranks: a run, or what it ends with instead.
pub enum Prepared {
    /// The root's.
    Root(Box<Ready>),
    /// Another rank's.
    Other(Box<Program>, Begin),
    /// There is nothing to carry out; the exit code.
    Ended(u8),
}

/// Tells other ranks what the root has prepared; `prepare` is called by the root alone. `threads`
/// are this rank's.
///
/// # Errors
/// At the root, what `prepare` reports.
pub fn share(
    peers: &dyn Peers,
    threads: usize,
    prepare: impl FnOnce() -> anyhow::Result<Option<Ready>>,
) -> anyhow::Result<Prepared> {
    let mut bytes = Vec::new();
    if peers.rank() == 0 {
        let prepared = prepare();
        let brief: Result<Brief, u8> = match &prepared {
            Ok(Some(Ready { program, begin, .. })) => {
                let is_kept = begin.as_ref().is_some_and(Begin::is_kept);
                Ok(Brief { program: program.clone(), is_kept })
            }
            Ok(None) => Err(0),
            Err(error) => Err(super::exit_code(error)),
        };
        bytes = codec::encode(&brief)?;
        peers.broadcast(&mut bytes);
        return Ok(prepared?.map_or(Prepared::Ended(0), |ready| Prepared::Root(Box::new(ready))));
    }
    peers.broadcast(&mut bytes);
    Ok(match codec::decode::<Result<Brief, u8>, BRIEF_LIMIT>(&bytes)? {
        Ok(Brief { mut program, is_kept }) => {
            program.team.threads = threads;
            let begin = Begin::beside_root(&program, is_kept);
            Prepared::Other(Box::new(program), begin)
        }
        Err(code) => Prepared::Ended(code),
    })
}

/// Has a rank that would only say what the first one says wait until that has spoken: launchers end
/// all ranks as soon as one has failed.
pub fn let_first_speak() {
    std::thread::sleep(Duration::from_millis(500));
}

/// Says what went wrong, once.
pub fn tell(error: anyhow::Error) -> Told {
    if let Some(&Told(code)) = error.downcast_ref() {
        return Told(code);
    }
    say(format_args!("error: {error:#}"));
    Told(super::exit_code(&error))
}

/// Goes on if all ranks do. The first that cannot says why.
///
/// # Errors
/// [`Told`] on all ranks, if one of them fails.
pub fn agree<T>(peers: &dyn Peers, result: anyhow::Result<T>) -> anyhow::Result<T> {
    // The largest is that of the first rank that fails.
    let key = |code: u8| (peers.size() - peers.rank()) as i64 * 256 + i64::from(code);
    let mine = result.as_ref().err().map_or(0, |error| key(super::exit_code(error)));
    let mut all = [mine];
    peers.max(&mut all);
    if all == [0] {
        return result;
    }
    if let Err(error) = result
        && all == [mine]
    {
        let rank = peers.rank();
        eprintln!(
            "error: {}{error:#}",
            if rank > 0 { format!("rank {rank}: ") } else { "".into() }
        );
    }
    Err(Told((all[0] % 256) as u8).into())
}
