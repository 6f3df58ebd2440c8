//! `perceptile resume`: goes on with a run that was stopped or killed.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Context;
use clap::Args;
use perceptile::format::write::Existing;
use perceptile::run::keeper::{Keeper, Resumed};
use perceptile::run::memory;
use perceptile::run::outputs::Outputs;
use perceptile_cluster::peers::Peers;

use super::carry::{CarryArgs, Invocation, Ready};
use super::execution::ExecutionArgs;

/// Go on with a run that was stopped or killed
///
/// Reads the newest good checkpoint of the run's folder and does the rest, with any number of
/// threads, workers and ranks, to the same bytes that the run would have made. A damaged checkpoint is
/// named, and the one before it used.
#[derive(Debug, Args)]
pub struct ResumeArgs {
    /// The run's folder
    #[arg(value_name = "RUN")]
    folder: PathBuf,

    /// Where the tile goes [default: where the run was to write it]
    #[arg(long, value_name = "NPY")]
    out: Option<PathBuf>,

    /// Replace files that exist, such as the tile so far of a run that was stopped
    #[arg(long)]
    force: bool,

    #[command(flatten)]
    execution: ExecutionArgs,

    #[command(flatten)]
    carry: CarryArgs,
}

/// Goes on with the run.
///
/// # Errors
/// No run that could go on, outputs that exist or cannot be written, too little memory, lost
/// workers.
pub fn run(args: ResumeArgs, peers: Option<Arc<dyn Peers>>) -> anyhow::Result<ExitCode> {
    let ranks = peers.as_ref().map_or(1, |peers| peers.size());
    args.carry.check(&args.execution, ranks)?;
    args.carry.run(&args.execution, peers, || prepare(&args, ranks))
}

/// Gets the rest of the run ready.
fn prepare(args: &ResumeArgs, ranks: usize) -> anyhow::Result<Option<Ready>> {
    let team = args.execution.team(ranks)?;
    let (keeper, resumed) = Keeper::resume(&args.folder, args.carry.checkpoint(), team)?;
    let Resumed { program, begin, invocation, damaged } = resumed;
    for checkpoint in damaged {
        eprintln!("a checkpoint is damaged, and an earlier one is used: {checkpoint}");
    }
    let mut invocation: Invocation =
        serde_json::from_str(&invocation).context("the run does not say how it was started")?;
    if let Some(out) = &args.out {
        invocation.out.clone_from(out);
    }
    if ranks == 1 {
        memory::check(&program)?;
    }
    program.check_batch()?;
    let existing = Existing::from_force(args.force);
    Outputs::of(&invocation.out).probe(existing)?;
    Ok(Some(Ready { invocation, program, begin: Some(begin), existing, keeper }))
}
