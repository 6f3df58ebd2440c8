//! The ranks of a cluster, as the command sees them.
//!
//! All ranks are started with the same arguments. The root alone reads and writes files and speaks
//! to people: it prepares the run and sends the others its plan, or the exit code to end with.
//! A rank that fails by itself says so, and all end.

use std::process::ExitCode;
use std::sync::Arc;

use perceptile::run::plan::Plan;
use perceptile::run::start::InitialState;
use perceptile_cluster::codec;
use perceptile_cluster::communicator::{Communicator, Single};
use perceptile_cluster::launcher::Launcher;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::exit::{Failure, Misuse};
use super::prepared::PreparedRun;

/// Most memory that a brief may ask for: kernels of millions of taps are long.
const BRIEF_LIMIT: usize = 1 << 30;

/// The ranks that this process is one of; the only one, if no launcher started it as such.
///
/// # Errors
/// A launcher that started several, for a program without MPI or with another MPI than its own.
fn join(launcher: Option<Launcher>) -> Result<Arc<dyn Communicator>, Misuse> {
    #[cfg(feature = "mpi")]
    if launcher.is_some() {
        use perceptile_cluster::mpi::Mpi;

        let mpi = Mpi::init().map_err(|error| Misuse(error.to_string()))?;
        mpi.end_all_on_panic();
        return Ok(Arc::new(mpi));
    }
    #[cfg(not(feature = "mpi"))]
    check_alone(launcher, "this program was built without MPI: build it with `--features mpi`")?;
    Ok(Arc::new(Single))
}

/// Joins the ranks and ends together with them: what went wrong is said while all still wait for
/// each other, as launchers end all of them as soon as one has failed.
///
/// # Errors
/// Ranks that cannot be joined; what `work` reports is said already.
pub fn together(
    launcher: Option<Launcher>,
    work: impl FnOnce(&Arc<dyn Communicator>) -> Result<ExitCode, Failure>,
) -> Result<ExitCode, Failure> {
    let communicator = join(launcher)?;
    let code = work(&communicator).unwrap_or_else(Failure::report);
    // What the root still does needs the others' cores, not their company.
    communicator.rest();
    Ok(code)
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

/// Sends other ranks what the root has for them: something, nothing, or the exit code to end with.
///
/// # Errors
/// What cannot be sent.
pub fn tell<T: Serialize>(
    communicator: &dyn Communicator,
    brief: &Result<Option<T>, u8>,
) -> Result<(), Failure> {
    if communicator.size() > 1 {
        let mut bytes = codec::encode(brief)
            .map_err(Failure::refused("cannot send the plan to other ranks"))?;
        communicator.broadcast(&mut bytes);
    }
    Ok(())
}

/// What the root tells.
///
/// # Errors
/// The exit code to end with, which the root has reported.
pub fn hear<T: DeserializeOwned>(communicator: &dyn Communicator) -> Result<Option<T>, Failure> {
    let mut bytes = Vec::new();
    communicator.broadcast(&mut bytes);
    let brief = codec::decode::<Result<Option<T>, u8>, BRIEF_LIMIT>(&bytes)
        .map_err(Failure::refused("cannot read the plan of the first rank"))?;
    brief.map_err(Failure::reported)
}

/// Sends other ranks what the root prepares: a run, or nothing. `threads` says how many this rank
/// has.
///
/// # Errors
/// At the root, what `prepare` reports; elsewhere the same, reported already.
pub fn share(
    communicator: &dyn Communicator,
    threads: impl FnOnce() -> Result<usize, Misuse>,
    prepare: impl FnOnce() -> Result<Option<PreparedRun>, Failure>,
) -> Result<Option<PreparedRun>, Failure> {
    if communicator.rank() == 0 {
        let prepared = prepare();
        let told = |job: &PreparedRun| (job.plan.clone(), job.start.is_checkpoint());
        let brief = match &prepared {
            Ok(job) => Ok(job.as_ref().map(told)),
            Err(failure) => Err(failure.code()),
        };
        tell(communicator, &brief)?;
        return prepared;
    }
    // The plan, and whether it goes on from a checkpoint.
    let Some((mut plan, from_checkpoint)) = hear::<(Plan, bool)>(communicator)? else {
        return Ok(None);
    };
    plan.parallelism.threads = threads()?;
    let start = InitialState::beside_root(&plan, from_checkpoint);
    Ok(Some(PreparedRun { plan, start, files: None }))
}

/// Goes on if all ranks do. The first that cannot says why.
///
/// # Errors
/// On all ranks, if one of them fails.
pub fn agree<T>(communicator: &dyn Communicator, result: Result<T, Failure>) -> Result<T, Failure> {
    let (rank, size) = (communicator.rank(), communicator.size());
    // The largest is that of the first rank that fails.
    let key = |code: u8| (size - rank) as i64 * 256 + i64::from(code);
    let mine = result.as_ref().err().map_or(0, |failure| key(failure.code()));
    let mut all = [mine];
    communicator.max(&mut all);
    match result {
        Err(failure) if all == [mine] && rank > 0 => {
            Err(failure.explained(format_args!("rank {rank}")))
        }
        Err(failure) if all == [mine] => Err(failure),
        Ok(value) if all == [0] => Ok(value),
        _ => Err(Failure::reported((all[0] % 256) as u8)),
    }
}
