//! `perceptile report`: tiles and renders as a page that opens in a browser.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use perceptile::domain::Domain;
use perceptile::format::write::Existing;
use perceptile::kernel::KernelSpec;
use perceptile::metric::{Baseline, ScoreOptions};
use perceptile::report::{Report, ReportOptions};
use perceptile::run::signals::Signals;
use perceptile::settings::shell_line;

use super::candidates::{self, PartsArgs, progress};
use super::domain::DomainArgs;
use super::exit::{Failure, Misuse};
use super::integrands::IntegrandsArgs;
use super::perceived::PerceivedArgs;
use super::source::SourceArgs;
use super::stream::{print, say};

/// Most frames per second of the animations.
const MAX_FPS: f64 = 1000.0;
/// Weight of the newest frame in the views with temporal anti-aliasing, if the kernel has none.
const ALPHA: f64 = 0.2;

/// Show tiles beside white noise: a folder with a page that needs no network
///
/// Open OUT/index.html in a browser. It plays the error of every tile as it is, as perceived and
/// behind temporal anti-aliasing (TAA), and shows the scores of `perceptile evaluate`, slices,
/// spectra, histograms, and where each tile comes from.
///
/// The animations play at the kernel's frame rate, so at that of --fps. The views with TAA have the
/// kernel's weight of the newest frame, so that of --taa, or 0.2 if the kernel has no TAA.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct ReportArgs {
    /// The folder to make; the one around it must exist
    #[arg(value_name = "OUT")]
    out: PathBuf,

    /// The tiles: .npy files, KTX2 textures, raw volumes, vertical strips of PNG slices, EXR layers, or
    /// folders of PNG or EXR slices
    #[arg(value_name = "TILE", required = true)]
    tiles: Vec<PathBuf>,

    /// Folder of renders to show, with a renders.json
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    renders: Option<PathBuf>,

    /// Replace an existing report. Refuses if OUT is not a report or has other files in it
    #[arg(long, help_heading = "Output")]
    force: bool,

    #[command(flatten)]
    parts: PartsArgs,

    #[command(flatten)]
    kernel: PerceivedArgs,

    #[command(flatten)]
    integrands: IntegrandsArgs,

    #[command(flatten)]
    domain: DomainArgs,

    #[command(flatten)]
    source: SourceArgs,
}

/// Scores the tiles and makes the folder.
///
/// # Errors
/// A tile that cannot be read, a kernel that does not fit one, options out of range, renders that
/// cannot be used, a folder that exists or cannot be written.
pub fn run(args: ReportArgs) -> Result<ExitCode, Failure> {
    let signals =
        Signals::install(|_| ()).map_err(Failure::refused("cannot listen for signals"))?;
    args.integrands.options().validate()?;
    args.kernel.check()?;
    check_name(&args.out, args.force)?;
    let mut candidates = candidates::read(args.tiles.clone(), &args.source)?;
    let kernel = args.kernel.choose(&args.tiles[0], &candidates)?;
    let domain = args.domain.choose(&args.tiles[0], &mut candidates, &args.source)?;
    let scores = ScoreOptions { domain, ..args.integrands.options() };
    let mut candidates = args.parts.of(candidates, (domain, &[Baseline::White]))?;
    // White noise is white in all of its parts.
    let noise = candidates.iter().position(|candidate| candidate.path.is_none());
    candidates.truncate(noise.map_or(candidates.len(), |first| first + 1));
    let options = ReportOptions {
        kernel: kernel.spec.clone(),
        alpha: ALPHA,
        fps: frame_rate(&kernel.spec),
        scores,
        command: args.command(&kernel.spec, domain),
    };
    let ReportArgs { out, renders, force, .. } = args;
    let existing = Existing::from_force(force);
    let mut report = Report::begin(&out, existing, options, renders.as_deref())?;
    let progress = progress(candidates.len());
    for candidate in candidates {
        let (entry, taps) = candidate.score(&kernel.spec, scores, true, &progress)?;
        report.add(entry, &candidate.tile, &taps)?;
        if let Some(code) = signals.received() {
            progress.finish_and_clear();
            say("stopped by a signal; there is no report");
            return Ok(ExitCode::from(code as u8));
        }
    }
    report.finish()?;
    progress.finish_and_clear();
    let page = out.join("index.html");
    print(&format!("kernel  {} ({})\n{}\n", kernel.spec, kernel.origin, page.display()))?;
    Ok(ExitCode::SUCCESS)
}

const EXAMPLES: &str = "\
Examples:
  perceptile report out tile.npy
  perceptile report out mine.npy FAST.npy stbn-slices --fps 120 --taa 0.1";

/// Checks that the first argument is not a tile, as it is where OUT was forgotten.
fn check_name(out: &Path, force: bool) -> Result<(), Misuse> {
    // With --force the folder itself says that it is no report.
    if !force && out.is_file() && out.extension().is_some_and(|extension| extension == "npy") {
        let tile = out.display();
        return Err(Misuse(format!(
            "OUT, the folder to make, is {tile}, a file: give OUT before the tiles, \
             as in perceptile report out {tile}"
        )));
    }
    Ok(())
}

/// Frames per second of the animations.
fn frame_rate(kernel: &KernelSpec) -> f64 {
    kernel.frame_rate().unwrap_or(60.0).min(MAX_FPS)
}

impl ReportArgs {
    /// The command that makes the same report, as any folder. The kernel says all that follows from
    /// flags and sidecars.
    fn command(&self, kernel: &KernelSpec, domain: Domain) -> String {
        let mut words: Vec<String> = ["perceptile", "report", "OUT"].map(str::to_owned).into();
        words.extend(self.tiles.iter().map(|path| {
            let name = path.display().to_string();
            // A name like that of a flag.
            if name.starts_with('-') { format!("./{name}") } else { name }
        }));
        let mut flag = |name: &str, value: String| words.extend([format!("--{name}"), value]);
        flag("kernel", kernel.to_string());
        if let Some(renders) = &self.renders {
            flag("renders", renders.display().to_string());
        }
        let scores = self.integrands.options();
        flag("integrands", scores.integrands.to_string());
        flag("set", scores.set.to_string());
        words.extend(self.domain.command_line(domain));
        words.extend(self.parts.command_line());
        words.extend(self.source.command_line());
        shell_line(words.into_iter())
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        args: ReportArgs,
    }

    fn parse(line: &[&str]) -> Result<ReportArgs, clap::Error> {
        Command::try_parse_from([&["report"], line].concat()).map(|command| command.args)
    }

    #[test]
    fn the_command_says_all_but_the_folder() {
        let args = [
            "here",
            "a b.npy",
            "--spp=2",
            "--prefix=1,2",
            "--stride=8",
            "--taa=0.1",
            "--renders=r",
            "--force",
            "--",
            "-x",
        ];
        let kernel: KernelSpec = "gaussian(2.1) * ema(0.1) @ 7x7x8".parse().unwrap();
        assert_eq!(
            parse(&args).unwrap().command(&kernel, Domain::Square),
            "perceptile report OUT 'a b.npy' ./-x --kernel 'gaussian(2.1) * ema(0.1) @ 7x7x8' \
             --renders r --integrands 256 --set 0 --prefix '1,2' --stride 8 --spp 2"
        );
    }

    #[test]
    fn animations_have_the_frame_rate_of_the_kernel() {
        for (kernel, fps) in [
            ("gaussian(2.1) * fovvideovdp(120) @ 7x7x8", 120.0),
            ("0.9: fovvideovdp(24) @ 90% + 0.1: fovvideovdp(90) @ 90%", 24.0),
            ("fovvideovdp(5000) @ 90%", 1000.0),
            ("gaussian(2.1) @ 7x7x1", 60.0),
            ("0.5: column + 0.5: fovvideovdp(24) @ 90%", 60.0),
        ] {
            assert_eq!(frame_rate(&kernel.parse().unwrap()), fps, "{kernel}");
        }
    }

    #[test]
    fn nonsense_is_refused() {
        for (flag, value) in [("--taa", "x"), ("--kernel", "gaussian(-1)")] {
            let error = parse(&["out", "a.npy", flag, value]).unwrap_err().to_string();
            assert!(error.contains(value), "{error}");
        }
        assert!(parse(&["out"]).is_err());
    }
}
