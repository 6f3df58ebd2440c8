//! `perceptile select`: chooses among candidate renders of an animation, pixel by pixel.

mod hands;
mod inputs;
mod job;
mod outputs;
mod progress;
mod summary;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use clap::{Args, ValueEnum};
use perceptile::format::write::Existing;
use perceptile::kernel::{Factor, KernelSpec, Viewing};
use perceptile::select::{
    Candidates, Continuation, Filters, Norm, SelectOptions, SelectParallelism, SelectPlan,
};
use perceptile::settings::whole;
use perceptile_cluster::communicator::Communicator;

use super::display::Shown;
use super::execution::ExecutionArgs;
use super::exit::{Failure, Misuse};
use super::workers::WorkersArgs;
use inputs::Inputs;
use outputs::Outputs;

const EXAMPLES: &str = "\
Examples:
  perceptile select --subsets --reference reference.npy --candidates a.npy b.npy c.npy d.npy
  perceptile select --subsets --guide denoised/x.####.exr --taa 0.1 --out best/x.####.exr \\
      --candidates a/x.####.exr b/x.####.exr c/x.####.exr d/x.####.exr
  perceptile select --levels 64 --reference x.####.exr --out dithered/x.####.png";

/// Choose among candidate renders of an animation, for every pixel and frame
///
/// The result has, in every pixel and frame, one of the candidates (or the mean of some of them), so
/// chosen that the error that is left is where the eye and the renderer's temporal anti-aliasing do
/// not see it. It needs the true picture (--reference) or a stand-in such as a denoised one (--guide),
/// and is as good as that. With --levels it dithers: candidates are the two nearest levels of a display.
///
/// Animations are .npy files (float, frames x height x width, or with 1 or 3 channels behind it) or
/// sequences of EXR files, named like x.####.exr. The result has the form of the candidates, and its
/// scores go beside it as JSON. A selection that was stopped keeps the frames that are done; the same
/// command goes on from there.
#[derive(Debug, Args)]
#[command(after_help = EXAMPLES)]
pub struct SelectArgs {
    /// The renders to choose among: 1 to 64 animations of one size
    #[arg(
        long,
        value_name = "ANIMATION",
        num_args = 1..,
        required_unless_present = "levels",
        conflicts_with = "levels"
    )]
    candidates: Vec<PathBuf>,

    /// Choose among the means of all non-empty subsets of the renders, of which there may be 6: four
    /// have 15
    #[arg(long, conflicts_with = "levels")]
    subsets: bool,

    /// The true animation
    #[arg(
        long,
        value_name = "ANIMATION",
        conflicts_with = "guide",
        required_unless_present = "guide"
    )]
    reference: Option<PathBuf>,

    /// A stand-in for the true animation, such as the denoised mean of the renders
    #[arg(long, value_name = "ANIMATION")]
    guide: Option<PathBuf>,

    /// Dither the animation to so many levels of a display, 2 to 65536
    #[arg(long, value_name = "N", value_parser = whole::<u32>, help_heading = "Display")]
    levels: Option<u32>,

    /// How the display makes light of its levels
    #[arg(long, value_enum, default_value_t = Transfer::Srgb, requires = "levels", help_heading = "Display")]
    transfer: Transfer,

    /// The filter of the eye; of a mixture, only its first term is used [default: from the flags below]
    #[arg(long, value_name = "SPEC", help_heading = "Kernel")]
    kernel: Option<KernelSpec>,

    /// Frames per second of the display, above 4 [default: 60]
    #[arg(long, value_name = "N", help_heading = "Kernel", conflicts_with = "kernel")]
    fps: Option<f64>,

    /// Standard deviation of the eye's spatial filter in pixels [default: 2.1]
    #[arg(long, value_name = "PIXELS", help_heading = "Kernel", conflicts_with = "kernel")]
    sigma: Option<f64>,

    /// The same by display and distance: 45 pixels per degree (2560 pixels on 27 inches from 60 cm)
    /// make sigma 2.1
    #[arg(long, value_name = "N", help_heading = "Kernel", conflicts_with_all = ["kernel", "sigma"])]
    pixels_per_degree: Option<f64>,

    /// Weight of the newest frame in the temporal anti-aliasing (TAA) that the result goes through,
    /// above 0 and at most 1; also as ema(WEIGHT) [default: no TAA]
    #[arg(long, value_name = "ALPHA", value_parser = alpha, help_heading = "Kernel")]
    taa: Option<f64>,

    /// How errors are summed: squares (L2), or magnitudes (L1, the paper's, slower)
    #[arg(long, value_enum, ignore_case = true, default_value_t = NormChoice::L2, help_heading = "Selection")]
    norm: NormChoice,

    /// How often every pixel is visited, 1 to 256
    #[arg(long, value_name = "N", default_value_t = SelectOptions::default().sweeps, value_parser = whole::<u32>, help_heading = "Selection")]
    sweeps: u32,

    /// Weight of the unfiltered error in the first and in the last sweep, or in the last one alone
    /// [default: 0; with --subsets 0.01..0, with a guide 0.2..0.01]
    #[arg(long, value_name = "FROM..TO", help_heading = "Selection")]
    continuation: Option<Continuation>,

    /// Where the result goes; its scores go beside it [default: selected.npy, selected.####.exr, or
    /// with --levels dithered.####.png]
    #[arg(long, value_name = "ANIMATION", help_heading = "Files")]
    out: Option<PathBuf>,

    /// Replace files that exist, and give up a selection that was stopped
    #[arg(long, help_heading = "Files")]
    force: bool,

    #[command(flatten)]
    execution: ExecutionArgs,

    #[command(flatten)]
    workers: WorkersArgs,

    /// How progress is shown on the standard error
    #[arg(long, value_enum, default_value_t = Shown::Auto, env = "PERCEPTILE_PROGRESS", help_heading = "Output")]
    progress: Shown,

    /// Print the scores as JSON
    #[arg(long, help_heading = "Output")]
    json: bool,

    /// Say what would be done and how much memory that needs, and stop
    #[arg(long, help_heading = "Output")]
    dry_run: bool,
}

/// What `--norm` offers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum NormChoice {
    /// Σ w·|r|
    L1,
    /// Σ w²·r²
    L2,
}

/// What `--transfer` offers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Transfer {
    /// The curve of sRGB
    Srgb,
    /// Levels are proportional to light
    Linear,
}

/// Runs the command, as one of the ranks.
///
/// # Errors
/// Arguments that contradict each other or the files, files that cannot be read or written, too little
/// memory, workers that are lost.
pub fn run(args: &SelectArgs, communicator: &Arc<dyn Communicator>) -> Result<ExitCode, Failure> {
    if communicator.rank() > 0 {
        return job::follow(args, communicator);
    }
    let prepared = prepare(args, communicator.size());
    job::run(args, prepared, communicator)
}

/// What the root does: the job and its outputs, or nothing if it was to be told only.
fn prepare(args: &SelectArgs, ranks: usize) -> Result<Option<(job::Job, Outputs)>, Failure> {
    let inputs = Inputs::open(args)?;
    let outputs = Outputs::new(args, &inputs)?;
    args.workers.check(args.execution.workers, ranks)?;
    let (workers, threads) = (args.execution.workers, args.execution.threads()?);
    let parallelism = SelectParallelism { ranks, workers, threads };
    let (renders, subsets) = inputs.renders();
    let candidates = Candidates { renders, subsets, half: inputs.are_half() };
    let plan =
        SelectPlan::new(inputs.shape()?, filters(args)?, candidates, args.options(), parallelism)?;
    let job = job::Job { inputs, plan, simd: args.execution.simd() };
    if args.dry_run {
        super::stream::print(&job.intent(args, &outputs)?)?;
        job.check_memory(args)?;
        return Ok(None);
    }
    job.check_memory(args)?;
    Ok(Some((job, outputs)))
}

impl SelectArgs {
    fn options(&self) -> SelectOptions {
        let norm = match self.norm {
            NormChoice::L1 => Norm::L1,
            NormChoice::L2 => Norm::L2,
        };
        let suited = Continuation::suited(self.guide.is_some(), self.subsets);
        let continuation = self.continuation.unwrap_or(suited);
        SelectOptions { norm, sweeps: self.sweeps, continuation }
    }

    fn existing(&self) -> Existing {
        Existing::from_force(self.force)
    }

    /// The text form of the eye's filter.
    fn eye(&self) -> Result<KernelSpec, Misuse> {
        if let Some(kernel) = &self.kernel {
            if kernel.taa().is_some() {
                let rule = "leave ema out of --kernel: --taa says the renderer's filter";
                return Err(Misuse(rule.into()));
            }
            return Ok(kernel.first());
        }
        let default = Viewing::default();
        let sigma = self.sigma.or(self.pixels_per_degree.map(Viewing::sigma_at));
        let viewing = Viewing {
            fps: self.fps.unwrap_or(default.fps),
            taa: None,
            sigma: sigma.unwrap_or(default.sigma),
        };
        viewing.of_pictures().map_err(|problem| Misuse(problem.to_string()))
    }
}

fn filters(args: &SelectArgs) -> Result<Filters, Failure> {
    let spec = args.eye()?;
    let kernel = spec.resolve_without_tile()?;
    Ok(Filters::new(kernel.classes()[0].taps.clone(), args.taa)?)
}

/// Reads the weight of the newest frame, as a number or as a factor of a kernel.
fn alpha(text: &str) -> Result<f64, String> {
    if let Ok(alpha) = text.parse() {
        return Ok(alpha);
    }
    let rule = "it must be a number above 0 and at most 1, such as 0.2, or ema(0.2)";
    let spec: KernelSpec = text.parse().map_err(|_| rule.to_owned())?;
    let lone = KernelSpec::new(spec.classes().to_vec()).ok().and_then(|spec| spec.taa());
    match lone {
        Some(alpha) if spec.to_string() == format!("{}", Factor::Ema { alpha }) => Ok(alpha),
        _ => Err(rule.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_renderers_filter_is_a_number_or_a_factor() {
        assert_eq!(alpha("0.2"), Ok(0.2));
        assert_eq!(alpha("ema(0.2)"), Ok(0.2));
        assert!(alpha("gaussian(2)").is_err() && alpha("x").is_err());
    }
}
