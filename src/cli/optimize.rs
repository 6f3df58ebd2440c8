//! `perceptile optimize`: from options to a tile on the disk.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use clap::Args;
use perceptile::format::source::TileSource;
use perceptile::format::write::Existing;
use perceptile::metric::ScoreOptions;
use perceptile::run::begin::Begin;
use perceptile::run::keeper::Keeper;
use perceptile::run::memory;
use perceptile::run::outputs::Outputs;
use perceptile::run::program::Program;
use perceptile::solver::HaloTraffic;
use perceptile::tile::Region;
use perceptile_cluster::peers::Peers;

use super::carry::{CarryArgs, Invocation, Ready};
use super::execution::ExecutionArgs;
use super::print;
use super::settings::Settings;

/// Make a sample tile
///
/// Writes NAME.npy, the tile (float32, frames x height x width x spp x dims), NAME.json, its
/// provenance and scores, and NAME.png, its first frame beside its XT slice. Without options it
/// makes the best 64x64x16 tile that a minute of two cores allows. The same settings and seed
/// give the same bytes on every machine and with any number of threads and workers. A run that
/// takes longer than a minute keeps checkpoints in a folder, NAME.run, until it has ended. Under
/// mpirun or srun each rank makes a region of the tile; the first one reads and writes the files.
#[derive(Debug, Args)]
pub struct OptimizeArgs {
    #[command(flatten)]
    settings: Settings,

    /// Settings from a TOML file with the names of the flags; flags win
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,

    /// Where the tile goes
    #[arg(long, value_name = "NPY", default_value = "tile.npy")]
    out: PathBuf,

    /// Replace files that exist, and an unfinished run
    #[arg(long)]
    force: bool,

    /// Where checkpoints go [default: NAME.run beside the tile]
    #[arg(long, value_name = "FOLDER")]
    run_dir: Option<PathBuf>,

    #[command(flatten)]
    execution: ExecutionArgs,

    #[command(flatten)]
    carry: CarryArgs,

    /// Integrands of each class that the tile is scored on at the end; 0 leaves scores out
    #[arg(long, value_name = "N", default_value_t = ScoreOptions::default().integrands)]
    integrands: usize,

    /// Say what the run would do and need, and stop
    #[arg(long)]
    dry_run: bool,
}

/// Makes the tile.
///
/// # Errors
/// Wrong settings, outputs that exist or cannot be written, too little memory, lost workers.
pub fn run(args: OptimizeArgs, peers: Option<Arc<dyn Peers>>) -> anyhow::Result<ExitCode> {
    let ranks = peers.as_ref().map_or(1, |peers| peers.size());
    args.carry.check(&args.execution, ranks)?;
    args.carry.run(&args.execution, peers, || prepare(&args, ranks))
}

/// Gets the run ready, or says what it would do.
fn prepare(args: &OptimizeArgs, ranks: usize) -> anyhow::Result<Option<Ready>> {
    let settings = match &args.config {
        Some(path) => args.settings.clone().or(Settings::read(path)?),
        None => args.settings.clone(),
    };
    let (options, start) = settings.clone().options()?;
    let program = Program::new(&options, args.execution.team(ranks)?)?;
    if args.integrands > 0 {
        let score_options = ScoreOptions { integrands: args.integrands, ..Default::default() };
        score_options.validate()?;
    }
    if ranks == 1 {
        memory::check(&program)?;
    }
    program.check_batch()?;
    if args.dry_run {
        print(&plan(&program))?;
        return Ok(None);
    }
    let existing = Existing::from_force(args.force);
    Outputs::of(&args.out).probe(existing)?;
    let start = start.map(|path| TileSource::new(path).read()).transpose()?;
    let begin = Begin::new(&program, start.as_ref())?;
    drop(start);
    let folder = args.run_dir.clone().unwrap_or_else(|| args.out.with_extension("run"));
    let invocation = Invocation { settings, out: args.out.clone(), integrands: args.integrands };
    let kept = serde_json::to_string(&invocation)?;
    let keeper = Keeper::new(&folder, args.carry.checkpoint(), existing, kept)?;
    Ok(Some(Ready { invocation, program, begin: Some(begin), existing, keeper }))
}

/// What `--dry-run` prints.
fn plan(program: &Program) -> String {
    let options = &program.options;
    let mut text = String::new();
    let mut line = |words: String| text += &(words + "\n");
    line(format!("tile        {}", options.shape));
    line(format!("kernel      {}", options.kernel));
    line(format!(
        "work        {} steps of {} draws, {} full-batch steps, {} warp frames",
        options.steps, options.draw.draws, options.polish.steps, options.warp.frames
    ));
    line(format!("memory      {} MB", memory::foreseen(program) >> 20));
    if program.team.can_fail {
        line(format!(
            "  shared    {} MB",
            program.storage(Region::whole(options.shape)).bytes() >> 20
        ));
    }
    if program.team.regions > 1 {
        let reach = program.partition().reach();
        let regions = program.regions(0);
        let traffic = HaloTraffic::of(&regions, reach);
        let place = regions.own().place();
        line(format!(
            "ranks       {} with regions such as {}x{}",
            program.team.regions, place.width, place.height
        ));
        line(format!(
            "halo        {:.1} KB in {} messages from the first rank in each step",
            traffic.bytes as f64 * 1e-3,
            traffic.messages
        ));
    }
    line(format!("tile file   {:.1} MB", (options.shape.coordinates() * 4) as f64 / 1e6));
    text
}
