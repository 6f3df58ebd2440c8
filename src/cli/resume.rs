//! `perceptile resume`: goes on with a run that was stopped or killed.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use clap::Args;
use perceptile::format::sidecar::{self, Sidecar};
use perceptile::format::write::Existing;
use perceptile::run::checkpointer::{Checkpointer, Resumed};
use perceptile::run::output::OutputFiles;
use perceptile::run::plan::Plan;
use perceptile_cluster::communicator::Communicator;

use super::domain::check_density;
use super::exit::{Failure, Misuse};
use super::prepared::{self, Files, Invocation, PreparedRun};
use super::run::{RunArgs, check_folder};
use super::stream::say;

/// Go on with a run that was stopped or killed
///
/// Reads the newest good checkpoint of the run's folder and does the rest, with any number of
/// threads, workers and ranks, to the same bytes that the run would have made. A damaged checkpoint is
/// named, and the one before it used. The tile so far that the run wrote when it was stopped is
/// replaced.
#[derive(Debug, Args)]
pub struct ResumeArgs {
    /// The run's folder
    #[arg(value_name = "RUN")]
    folder: PathBuf,

    /// Where the tile goes [default: where the run was to write it]
    #[arg(long, value_name = "NPY")]
    out: Option<PathBuf>,

    /// Replace files that exist, other than the tile so far of the run itself
    #[arg(long)]
    force: bool,

    #[command(flatten)]
    run: RunArgs,
}

/// Goes on with the run.
///
/// # Errors
/// No run that could go on, outputs that exist or cannot be written, too little memory, lost
/// workers.
pub fn run(args: &ResumeArgs, communicator: &Arc<dyn Communicator>) -> Result<ExitCode, Failure> {
    args.run.run(communicator, || prepare(args, communicator.size()))
}

/// Gets the rest of the run ready.
fn prepare(args: &ResumeArgs, ranks: usize) -> Result<Option<PreparedRun>, Failure> {
    let parallelism = args.run.parallelism(ranks)?;
    check_name(&args.folder)?;
    let (checkpointer, resumed) =
        Checkpointer::resume(&args.folder, args.run.checkpoint, parallelism)?;
    let Resumed { plan, start, invocation, damaged } = resumed;
    for checkpoint in damaged {
        say(format_args!("a checkpoint is damaged, and an earlier one is used: {checkpoint}"));
    }
    let mut invocation: Invocation = serde_json::from_str(&invocation)
        .map_err(Failure::refused("the run does not say how it was started"))?;
    if let Some(out) = &args.out {
        invocation.out.clone_from(out);
    }
    prepared::check(&plan)?;
    let existing = Existing::from_force(args.force || is_so_far(&invocation.out, &plan));
    let outputs = OutputFiles::of(&invocation.out);
    check_folder(&outputs, &args.folder)?;
    check_density(&outputs, plan.options.domain)?;
    let claims = outputs.claim(existing)?;
    let files = Files { invocation, outputs, existing, checkpointer, claims };
    Ok(Some(PreparedRun { plan, start, files: Some(files) }))
}

/// Checks that the path is not that of the tile which the run was to make.
fn check_name(folder: &Path) -> Result<(), Misuse> {
    let run = folder.with_extension("run");
    if folder.is_file() && run != folder {
        let (file, run) = (folder.display(), run.display());
        return Err(Misuse(format!("{file} is a file: give the run's folder, such as {run}")));
    }
    Ok(())
}

/// Whether the tile at a path is what this run wrote when it was stopped: its provenance has the
/// run's options and stops early, and nobody has changed the tile since.
fn is_so_far(tile: &Path, plan: &Plan) -> bool {
    let Ok(sidecar) = Sidecar::read(&Sidecar::path_of(tile)) else { return false };
    sidecar.options["options"] == serde_json::json!(plan.options)
        && sidecar.options["summary"]["reason"] != "completed"
        && sidecar::file_digest(tile).is_ok_and(|digest| digest == sidecar.sha256)
}
