//! `perceptile report`: tiles and renders as a page that opens in a browser.

use std::path::PathBuf;
use std::process::ExitCode;

use perceptile::format::write::Existing;
use perceptile::kernel::KernelSpec;
use perceptile::metric::{Baseline, ScoreOptions};
use perceptile::report::{Report, ReportOptions};
use perceptile::run::signals::Signals;

use super::candidates::{self, DEFAULT_KERNEL, progress};
use super::exit::Failure;
use super::source::SourceArgs;
use super::stream::{print, say};

/// Most frames per second of the animations.
const MAX_FPS: f64 = 1000.0;

/// Show tiles beside white noise: a folder with a page that needs no network
///
/// Open OUT/index.html in a browser. It plays the error of every tile as it is, as perceived and
/// behind temporal anti-aliasing, and shows the scores of `perceptile evaluate`, slices, spectra,
/// histograms, and where each tile comes from.
#[derive(Debug, clap::Args)]
pub struct ReportArgs {
    /// The folder to make; the one around it must exist
    #[arg(value_name = "OUT")]
    out: PathBuf,

    /// The tiles: .npy files, vertical strips of PNG slices, or folders of PNG slices
    #[arg(value_name = "TILE", required = true)]
    tiles: Vec<PathBuf>,

    /// The kernel through which error is seen; of a mixture, its first class
    #[arg(long, value_name = "SPEC", default_value = DEFAULT_KERNEL)]
    kernel: KernelSpec,

    /// Weight of the newest frame in temporal anti-aliasing, above 0 and at most 1
    #[arg(long, value_name = "ALPHA", default_value_t = 0.2, value_parser = alpha)]
    taa: f64,

    /// Frames per second of the animations, 1 to 1000 [default: that of the kernel's perception, or
    /// 60]
    #[arg(long, value_name = "N", value_parser = fps)]
    fps: Option<f64>,

    /// Folder of renders to show, with a renders.json
    #[arg(long, value_name = "DIR")]
    renders: Option<PathBuf>,

    /// Integrands of each class, 1 to 65536
    #[arg(long, value_name = "N", default_value_t = ScoreOptions::default().integrands)]
    integrands: usize,

    /// Number of the set of integrands
    #[arg(long, value_name = "N", default_value_t = ScoreOptions::default().set)]
    set: u64,

    #[command(flatten)]
    source: SourceArgs,

    /// Replace a report that exists; anything else that has its name stays, and so does a report
    /// with files of somebody else in it
    #[arg(long)]
    force: bool,
}

/// Reads the weight of the newest frame.
fn alpha(text: &str) -> Result<f64, String> {
    // The same rule as in a kernel.
    let spec: Result<KernelSpec, _> = format!("ema({text})").parse();
    spec.map_err(|error| error.to_string())?;
    text.parse().map_err(|_| "it must be a number".to_owned())
}

/// Reads a frame rate.
fn fps(text: &str) -> Result<f64, String> {
    let rate = text.parse().ok().filter(|rate| (1.0..=MAX_FPS).contains(rate));
    rate.ok_or_else(|| "it must be a number from 1 to 1000".to_owned())
}

/// Scores the tiles and makes the folder.
///
/// # Errors
/// A tile that cannot be read, a kernel that does not fit one, options out of range, renders that
/// cannot be used, a folder that exists or cannot be written.
pub fn run(args: ReportArgs) -> Result<ExitCode, Failure> {
    let signals =
        Signals::install(|_| ()).map_err(Failure::refused("cannot listen for signals"))?;
    let scores = ScoreOptions { set: args.set, integrands: args.integrands };
    scores.validate()?;
    let command = args.command();
    let fps = args.frame_rate();
    let ReportArgs { out, tiles, kernel, taa, renders, source, force, .. } = args;
    let options = ReportOptions { kernel: kernel.clone(), alpha: taa, fps, scores, command };
    let existing = Existing::from_force(force);
    let mut report = Report::begin(&out, existing, options, renders.as_deref())?;
    let candidates = candidates::read(tiles, &source, &[Baseline::White])?;
    let progress = progress(candidates.len());
    for candidate in candidates {
        let (entry, taps) = candidate.score(&kernel, scores, true, &progress)?;
        report.add(entry, &candidate.tile, &taps)?;
        if let Some(code) = signals.received() {
            progress.finish_and_clear();
            say("stopped by a signal; there is no report");
            return Ok(ExitCode::from(code as u8));
        }
    }
    report.finish()?;
    progress.finish_and_clear();
    print(&format!("{}\n", out.join("index.html").display()))?;
    Ok(ExitCode::SUCCESS)
}

impl ReportArgs {
    /// Frames per second of the animations.
    fn frame_rate(&self) -> f64 {
        let of_kernel = || self.kernel.frame_rate().unwrap_or(60.0).min(MAX_FPS);
        self.fps.unwrap_or_else(of_kernel)
    }

    /// The command that makes the same report, as any folder.
    fn command(&self) -> String {
        let mut words: Vec<String> = ["perceptile", "report", "OUT"].map(str::to_owned).into();
        words.extend(self.tiles.iter().map(|path| {
            let name = path.display().to_string();
            // A name like that of a flag.
            if name.starts_with('-') { format!("./{name}") } else { name }
        }));
        let mut flag = |name: &str, value: String| words.extend([format!("--{name}"), value]);
        flag("kernel", self.kernel.to_string());
        flag("taa", self.taa.to_string());
        flag("fps", self.frame_rate().to_string());
        if let Some(renders) = &self.renders {
            flag("renders", renders.display().to_string());
        }
        flag("integrands", self.integrands.to_string());
        flag("set", self.set.to_string());
        words.extend(self.source.command_line());
        super::line(words.into_iter())
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
        let args =
            ["here", "a b.npy", "--spp=2", "--taa=0.1", "--renders=r", "--force", "--", "-x"];
        assert_eq!(
            parse(&args).unwrap().command(),
            "perceptile report OUT 'a b.npy' ./-x \
             --kernel 'gaussian(2.1) * fovvideovdp(60) @ 7x7x8' --taa 0.1 --fps 60 \
             --renders r --integrands 256 --set 0 --spp 2"
        );
    }

    #[test]
    fn animations_have_the_frame_rate_of_the_kernel() {
        for (kernel, flags, fps) in [
            ("gaussian(2.1) * fovvideovdp(120) @ 7x7x8", &[][..], 120.0),
            ("0.9: fovvideovdp(24) @ 90% + 0.1: fovvideovdp(90) @ 90%", &[], 24.0),
            ("fovvideovdp(5000) @ 90%", &[], 1000.0),
            ("gaussian(2.1) @ 7x7x1", &[], 60.0),
            ("0.5: column + 0.5: fovvideovdp(24) @ 90%", &[], 60.0),
            ("fovvideovdp(120) @ 90%", &["--fps", "30"], 30.0),
        ] {
            let args = parse(&[&["out", "a.npy", "--kernel", kernel], flags].concat()).unwrap();
            assert_eq!(args.frame_rate(), fps, "{kernel}");
        }
    }

    #[test]
    fn nonsense_is_refused_with_its_rule() {
        for (flag, value, words) in [
            ("--taa", "0", "above 0"),
            ("--taa", "x", "ema"),
            ("--taa", "NaN", "ema"),
            ("--taa", "0.2) * box(2", "number"),
            ("--fps", "0", "1 to 1000"),
            ("--fps", "inf", "1 to 1000"),
        ] {
            let error = parse(&["out", "a.npy", flag, value]).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
        assert!(parse(&["out"]).is_err());
    }
}
