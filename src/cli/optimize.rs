//! `perceptile optimize`: from options to a tile on the disk.

use std::path::{self, Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use clap::Args;
use perceptile::format::source::TileSource;
use perceptile::format::write::Existing;
use perceptile::metric::ScoreOptions;
use perceptile::run::checkpointer::Checkpointer;
use perceptile::run::folder::RunFolder;
use perceptile::run::forecast::Forecast;
use perceptile::run::memory;
use perceptile::run::output::OutputFiles;
use perceptile::run::plan::Plan;
use perceptile::run::start::InitialState;
use perceptile::solver::HaloTraffic;
use perceptile::tile::Region;
use perceptile_cluster::communicator::Communicator;

use super::domain::check_density;
use super::exit::{Failure, Misuse};
use super::prepared::{self, Files, Invocation, PreparedRun};
use super::run::{RunArgs, check_folder};
use super::settings::SettingsArgs;
use super::stream::print;
use super::{execution, summary};

/// What users begin with.
const EXAMPLES: &str = "\
Examples:
  perceptile optimize                        the default tile, for 60 frames per second
  perceptile optimize --fps 120 --taa 0.1    for 120 Hz behind temporal anti-aliasing
  perceptile optimize --preset quick --out a.npy --seed 2
  perceptile optimize --tile 128x128x32 --time 10m
  perceptile optimize --print-config > my.toml; perceptile optimize --config my.toml";

/// Make a sample tile
///
/// Writes NAME.npy, the tile (float32, frames x height x width x spp x dims), NAME.json, its
/// provenance and scores, and NAME.png, a picture that shows how good it is. Without options it
/// makes a 64x64x16 tile for 60 frames per second in half a minute of two free cores.
///
/// The same settings and seed give the same bytes on every machine and with any number of threads
/// and workers. A run that takes longer than a minute keeps checkpoints in a folder, NAME.run, until
/// it has ended. Under mpirun or srun each rank makes a region of the tile; the first one reads and
/// writes the files.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct OptimizeArgs {
    #[command(flatten)]
    settings: SettingsArgs,

    /// Where the tile goes; NAME.json and NAME.png go beside it
    #[arg(long, value_name = "NPY", default_value = "tile.npy", help_heading = "Files")]
    out: PathBuf,

    /// Replace files that exist, and an unfinished run
    #[arg(long, help_heading = "Files")]
    force: bool,

    /// Where checkpoints go [default: NAME.run beside the tile]
    #[arg(long, value_name = "FOLDER", help_heading = "Files")]
    run_dir: Option<PathBuf>,

    #[command(flatten)]
    run: RunArgs,

    /// Integrands of each class that the tile is scored on at the end; 0 leaves scores out
    #[arg(help_heading = "Output", long, value_name = "N", default_value_t = ScoreOptions::default().integrands)]
    integrands: usize,

    /// Say what the run would do, need and take, and stop
    #[arg(long, help_heading = "Output")]
    dry_run: bool,

    /// Print all flags with their values as a file for --config, and stop
    #[arg(long, help_heading = "Output")]
    pub print_config: bool,
}

impl OptimizeArgs {
    /// All settings, by name.
    ///
    /// # Errors
    /// Settings that no run can have.
    pub fn effective(&self) -> Result<serde_json::Map<String, serde_json::Value>, Failure> {
        let settings = &self.settings.settings;
        Ok(settings.effective(&settings.options()?.0))
    }
}

/// Makes the tile.
///
/// # Errors
/// Wrong settings, outputs that exist or cannot be written, too little memory, lost workers.
pub fn run(args: &OptimizeArgs, communicator: &Arc<dyn Communicator>) -> Result<ExitCode, Failure> {
    args.run.run(communicator, || prepare(args, communicator.size()))
}

/// Gets the run ready, or says what it would do.
fn prepare(args: &OptimizeArgs, ranks: usize) -> Result<Option<PreparedRun>, Failure> {
    let settings = args.settings.settings.clone();
    let (options, start) = settings.options()?;
    let plan = Plan::new(&options, args.run.parallelism(ranks)?)?;
    if args.integrands > 0 {
        let score_options = ScoreOptions { integrands: args.integrands, ..Default::default() };
        score_options.validate()?;
    }
    prepared::check(&plan)?;
    let start = start.map(|path| TileSource::new(path).read()).transpose()?;
    let start = InitialState::new(&plan, start.as_ref())?;
    let existing = Existing::from_force(args.force);
    let folder = args.run_dir.clone().unwrap_or_else(|| args.out.with_extension("run"));
    check_name(&args.out)?;
    let outputs = OutputFiles::of(&args.out);
    check_density(&outputs, options.domain)?;
    check_folder(&outputs, &folder)?;
    if args.dry_run {
        let foresee = || Forecast::of(&plan, args.run.execution.simd());
        let alone = plan.parallelism.ranks == 1;
        let pool = alone.then(|| execution::pool(plan.parallelism.threads)).transpose()?;
        let forecast = pool.map(|pool| pool.install(foresee)).transpose()?;
        print(&describe(&plan, forecast.as_ref()))?;
        // What is in a run's way does not keep the plan from being known.
        let stopped = |failure: Failure| failure.explained("the run would stop");
        outputs.probe(existing).map_err(|error| stopped(error.into()))?;
        RunFolder::probe(&folder, existing).map_err(|error| stopped(error.into()))?;
        return Ok(None);
    }
    let claims = outputs.claim(existing)?;
    let out =
        path::absolute(&args.out).map_err(Failure::refused("cannot find where the tile goes"))?;
    let invocation = Invocation { settings, out, integrands: args.integrands };
    let kept = serde_json::to_string(&invocation)
        .map_err(Failure::refused("cannot write down the settings"))?;
    let checkpointer = Checkpointer::new(&folder, args.run.checkpoint, existing, kept)?;
    let files = Files { invocation, outputs, existing, checkpointer, claims };
    Ok(Some(PreparedRun { plan, start, files: Some(files) }))
}

/// Checks that the tile's path is not that of its picture or its provenance.
fn check_name(out: &Path) -> Result<(), Misuse> {
    let extension = out.extension().unwrap_or_default().to_string_lossy().to_lowercase();
    match &*extension {
        "png" | "json" => Err(Misuse(format!(
            "--out names the .npy file, and another of its files would be {}: give {}",
            out.display(),
            out.with_extension("npy").display()
        ))),
        _ => Ok(()),
    }
}

/// What `--dry-run` prints.
fn describe(plan: &Plan, forecast: Option<&Forecast>) -> String {
    let options = &plan.options;
    let mut text = summary::intent(plan, None) + "\n";
    let mut line = |words: String| text += &(words + "\n");
    line(format!("kernel      {}", options.kernel));
    for class in plan.kernel.classes().iter().filter(|class| class.dropped.total > 0.0) {
        line(format!("  box       {}", summary::dropped(class)));
    }
    line(format!(
        "work        {} steps of {} draws, {} polish steps, {} warp frames",
        options.steps, options.draw.draws, options.polish.steps, options.warp.frames
    ));
    if let Some(forecast) = forecast {
        line(format!("time        about {}", summary::time(forecast)));
    }
    line(format!("memory      {} MB", memory::foreseen(plan) >> 20));
    if plan.parallelism.has_workers() {
        let shared = plan.storage(Region::whole(options.shape)).bytes();
        line(format!("  shared    {} MB", shared >> 20));
    }
    if plan.parallelism.ranks > 1 {
        let regions = plan.regions(0);
        let (ranks, place) = (plan.parallelism.ranks, regions.own().place());
        let region = format!("{}x{}", place.width, place.height);
        line(format!("ranks       {ranks} with regions such as {region}"));
        let HaloTraffic { bytes, messages } = HaloTraffic::of(&regions, plan.partition().reach());
        let sent = format!("{:.1} KB in {messages} messages", bytes as f64 * 1e-3);
        line(format!("halo        {sent} from the first rank in each step"));
    }
    line(format!("tile file   {:.1} MB", (options.shape.coordinates() * 4) as f64 / 1e6));
    text
}
