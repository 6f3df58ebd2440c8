//! `perceptile evaluate`: how good tiles are, ours and others', in one table and in words.

mod table;
mod verdict;

use std::path::{Path, PathBuf};

use perceptile::format::write::{self, Existing};
use perceptile::metric::{Baseline, Class, Coordinates, ScoreOptions, ScoredTile, digits};
use perceptile::report::pictures::spectrum_picture;
use serde::Serialize;

use super::candidates::{self, Candidate, PartsArgs, progress};
use super::domain::DomainArgs;
use super::exit::{Exit, Failure, Misuse};
use super::integrands::IntegrandsArgs;
use super::perceived::PerceivedArgs;
use super::source::SourceArgs;
use super::stream::{say, show};

/// Score tiles: perceived error, uniformity, accumulation, quantization
///
/// All scores are relative to white noise that is new in every frame, which has 1, and lower is
/// better: the mean square error over random integrands of a class, divided by white noise's. A tile
/// repeats: a kernel longer than the tile is folded at its period. Scores are comparable only for
/// equal --kernel, --set and --integrands; judge tiles on sets that nothing was tuned on. The line
/// `÷ NAME` is the ratio to tile NAME: 2 means twice its error.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct EvaluateArgs {
    /// The tiles: .npy files, KTX2 textures, raw volumes, vertical strips of PNG slices, EXR layers, or
    /// folders of PNG or EXR slices
    #[arg(value_name = "TILE", required = true)]
    tiles: Vec<PathBuf>,

    /// The tile that the others are compared with [default: the first]
    #[arg(long, value_name = "TILE", help_heading = "Comparison")]
    against: Option<PathBuf>,

    /// Comparison tiles to add, in the shape of the first tile: white, sobol (scrambled after
    /// Owen, independently in each pixel), or both with a comma
    #[arg(long, value_name = "LIST", value_delimiter = ',', help_heading = "Comparison")]
    baselines: Vec<Baseline>,

    /// Most perceived error that each TILE may have, such as edge<=0.08,bump<=0.02 (classes: linear,
    /// edge, axis-edge, bump, disk); where one has more, the exit code is 6
    #[arg(long, value_name = "CLASS<=SCORE", value_delimiter = ',', value_parser = requirement, help_heading = "Comparison")]
    require: Vec<(Class, f64)>,

    #[command(flatten)]
    parts: PartsArgs,

    #[command(flatten)]
    domain: DomainArgs,

    #[command(flatten)]
    kernel: PerceivedArgs,

    #[command(flatten)]
    integrands: IntegrandsArgs,

    /// Print all tables: also after 8 and 16 bits, and means over a period
    #[arg(long, help_heading = "Output")]
    all: bool,

    /// Print JSON
    #[arg(long, help_heading = "Output")]
    json: bool,

    /// Folder for power spectra of the error, PNG files NAME-CLASS-xy.png and -xt.png: frequency 0
    /// is in the centre, time runs down, and brightness is amplitude, white noise's mid-gray. It
    /// is made if the folder around it exists
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    spectra: Option<PathBuf>,

    /// Replace pictures of spectra that exist
    #[arg(long, help_heading = "Output")]
    force: bool,

    #[command(flatten)]
    source: SourceArgs,
}

const EXAMPLES: &str = "\
Examples:
  perceptile evaluate tile.npy --baselines white
  perceptile evaluate mine.npy FAST.npy stbn-slices --fps 120 --taa 0.1
  perceptile evaluate sequence.npy --prefix 1,2,4,8,16 --baselines sobol";

/// All that the command found out, as `--json` prints it.
#[derive(Debug, Serialize)]
struct Evaluation {
    /// The kernel's text form.
    kernel: String,
    /// Where the kernel is from.
    kernel_origin: String,
    /// Frames from the oldest that the kernel sees to the newest.
    #[serde(skip)]
    kernel_frames: u64,
    options: ScoreOptions,
    /// Name of the tile that the others are compared with.
    against: String,
    /// Parts that every tile is scored in, which stand side by side: prefixes, phases.
    #[serde(skip)]
    parts: usize,
    tiles: Vec<ScoredTile>,
}

impl Evaluation {
    /// What a tile is compared with: the same part of the first tile, if it is not that itself.
    fn reference(&self, place: usize) -> Option<&ScoredTile> {
        (place >= self.parts).then(|| &self.tiles[place % self.parts])
    }

    /// Whether a tile is one of white noise that repeats within the kernel. Then it has more error than
    /// the white noise that scores are relative to.
    fn is_repeated_noise(&self, tile: &ScoredTile) -> bool {
        let is_noise = tile.path.is_none() && tile.name.starts_with(&Baseline::White.to_string());
        is_noise && self.kernel_frames > tile.shape.frames() as u64
    }
}

/// Scores the tiles and prints what came out.
///
/// # Errors
/// A tile that cannot be read, a kernel that does not fit one, options out of range, spectra that
/// exist without `--force` or cannot be written, more error than `--require` allows.
pub fn run(args: EvaluateArgs) -> Result<(), Failure> {
    args.integrands.options().validate()?;
    args.kernel.check()?;
    let mut candidates = candidates(&args)?;
    let kernel = args.kernel.choose(&args.tiles[0], &candidates)?;
    let domain = args.domain.choose(&args.tiles[0], &mut candidates, &args.source)?;
    let is_missing = |(class, _): &&(Class, f64)| !Class::of(domain).contains(class);
    if let Some((class, _)) = args.require.iter().find(is_missing) {
        let what = format!("--require says {class}, but there is no such score");
        return Err(Misuse(format!("{what} of the domain `{domain}`")).into());
    }
    let options = ScoreOptions { domain, ..args.integrands.options() };
    // The tile to compare with is always put first.
    let against = candidates[0].name.clone();
    let tiles = candidates.len() + args.baselines.len();
    let candidates = args.parts.of(candidates, (domain, &args.baselines))?;
    let parts = candidates.len() / tiles;
    let existing = Existing::from_force(args.force);
    if let Some(folder) = &args.spectra {
        write::make_folder(folder)?;
        let outputs = candidates.iter().flat_map(|candidate| {
            Coordinates::of(domain, candidate.tile.shape().dims())
                .iter()
                .flat_map(|&coordinates| {
                    Class::of(domain).iter().map(move |&class| (class, coordinates))
                })
                .flat_map(|(class, coordinates)| {
                    ["xy", "xt"]
                        .map(|plane| picture(folder, &candidate.name, class, coordinates, plane))
                })
        });
        write::probe(outputs, existing)?;
    }
    let progress = progress(candidates.len());
    let mut tiles = Vec::new();
    let mut kernel_frames = 0;
    for candidate in candidates {
        let (entry, taps) =
            candidate.score(&kernel.spec, options, args.spectra.is_some(), &progress)?;
        if let Some(folder) = &args.spectra {
            save_spectra(folder, &entry, existing)?;
        }
        kernel_frames = taps.size()[2];
        tiles.push(entry);
    }
    progress.finish_and_clear();
    let (kernel, kernel_origin) = (kernel.spec.to_string(), kernel.origin);
    let report =
        Evaluation { kernel, kernel_origin, kernel_frames, options, against, parts, tiles };
    show(args.json, &report, || table::table(&report, args.all))?;
    check(&args, &report.tiles)
}

/// Reads the most error that a tile may have for a class.
fn requirement(text: &str) -> Result<(Class, f64), &'static str> {
    let rule = "it must be CLASS<=SCORE, such as axis-edge<=0.08";
    let (name, most) = text.split_once("<=").ok_or(rule)?;
    let class = Class::ALL.into_iter().find(|it| it.to_string().replace(' ', "-") == name);
    class.zip(most.parse().ok().filter(|most: &f64| most.is_finite())).ok_or(rule)
}

/// Says which of the tiles that were named have more error than they may.
fn check(args: &EvaluateArgs, tiles: &[ScoredTile]) -> Result<(), Failure> {
    let is_named = |path: &PathBuf| args.tiles.iter().any(|tile| write::is_same(tile, path));
    let mut result = Ok(());
    for tile in tiles.iter().filter(|tile| tile.path.as_ref().is_some_and(is_named)) {
        for &(class, most) in &args.require {
            let score = tile.scores.class(class, Coordinates::All);
            if let Some(score) = score.filter(|score| score.perceived.mean > most) {
                let found = format!("{} has {}", tile.name, digits(score.perceived.mean, 6));
                say(format_args!("error: {found} for {class}, but --require says at most {most}"));
                result = Err(Failure::reported(Exit::Missed as u8));
            }
        }
    }
    result
}

/// The tiles to score; the one to compare with comes first.
fn candidates(args: &EvaluateArgs) -> Result<Vec<Candidate>, Failure> {
    let mut paths = args.tiles.clone();
    if let Some(against) = &args.against {
        // Given as one of the tiles as well, it is not scored twice.
        paths.retain(|path| !write::is_same(path, against));
        paths.insert(0, against.clone());
    }
    candidates::read(paths, &args.source)
}

/// Where a spectrum is saved.
fn picture(
    folder: &Path,
    name: &str,
    class: Class,
    coordinates: Coordinates,
    plane: &str,
) -> PathBuf {
    let class = class.to_string().replace(' ', "-");
    let pairs = if coordinates == Coordinates::Pairs { "-pairs" } else { "" };
    folder.join(format!("{name}-{class}{pairs}-{plane}.png"))
}

fn save_spectra(folder: &Path, entry: &ScoredTile, existing: Existing) -> Result<(), Failure> {
    for spectra in entry.spectra.iter().flatten() {
        for (plane, spectrum) in [("xy", &spectra.xy), ("xt", &spectra.xt)] {
            let path = picture(folder, &entry.name, spectra.class, spectra.coordinates, plane);
            spectrum_picture(spectrum).save(&path, existing)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use clap::Parser;
    use perceptile::domain::Domain;
    use perceptile::tile::TileShape;

    use super::*;

    #[derive(Debug, Parser)]
    struct Command {
        #[command(flatten)]
        args: EvaluateArgs,
    }

    fn parse(line: &[&str]) -> EvaluateArgs {
        Command::try_parse_from([&["evaluate"], line].concat()).unwrap().args
    }

    /// A tile of white noise saved under `name`.
    fn save(folder: &Path, name: &str, seed: u64) -> String {
        let path = folder.join(name);
        let tile = Baseline::White.tile(TileShape::new(8, 8, 8, 1, 2).unwrap(), seed);
        let mut file = fs::File::create(&path).unwrap();
        perceptile::format::npy::write_tile(&tile, &mut file).unwrap();
        path.to_str().unwrap().to_owned()
    }

    #[test]
    fn the_tile_to_compare_with_comes_first_and_names_are_unique() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("old")).unwrap();
        let [a, b, old, white] = ["a.npy", "b.npy", "old/a.npy", "white.npy"]
            .map(|name| save(folder.path(), name, name.len() as u64));
        let names = |line: &[&str]| -> Vec<String> {
            let args = parse(line);
            let parts =
                args.parts.of(candidates(&args).unwrap(), (Domain::Square, &args.baselines));
            parts.unwrap().into_iter().map(|c| c.name).collect()
        };
        assert_eq!(names(&[&a, &b, &old]), ["a", "b", "a-2"]);
        assert_eq!(names(&[&a, &b, "--against", &b]), ["b", "a"]);
        assert_eq!(names(&[&a, "--against", &old]), ["a", "a-2"]);
        assert_eq!(
            names(&[&a, &white, "--baselines", "white,sobol"]),
            ["a", "white", "white-2", "sobol"]
        );
    }

    #[test]
    fn tiles_are_looked_at_in_parts() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        let tile = Baseline::White.tile(TileShape::new(8, 8, 4, 3, 2).unwrap(), 1);
        let mut file = fs::File::create(&path).unwrap();
        perceptile::format::npy::write_tile(&tile, &mut file).unwrap();
        let path = path.to_str().unwrap();
        let parts = |flags: &[&str]| {
            let args = parse(&[&[path, "--baselines", "white"], flags].concat());
            let parts =
                args.parts.of(candidates(&args).unwrap(), (Domain::Square, &args.baselines));
            parts.map(|parts| parts.into_iter().map(|part| part.name).collect::<Vec<_>>())
        };
        assert_eq!(parts(&[]).unwrap(), ["a", "white"]);
        let prefixes = ["a-first-1", "a-first-3", "white-first-1", "white-first-3"];
        assert_eq!(parts(&["--prefix", "1,3"]).unwrap(), prefixes);
        let phases = parts(&["--prefix", "2", "--stride", "2"]).unwrap();
        assert_eq!(phases[..2], ["a-first-2-phase-0-of-2", "a-first-2-phase-1-of-2"]);
        let error = |flags: &[&str]| parts(flags).unwrap_err().to_string();
        assert!(
            error(&["--prefix", "1,4"]).contains("--prefix is 4, but it must be from 1 to the 3")
        );
        assert!(error(&["--prefix", "0"]).contains("--prefix is 0"));
        assert!(
            error(&["--stride", "3"]).contains("--stride is 3, but it must divide the 4 frames")
        );
        assert!(error(&["--stride", "0"]).contains("--stride is 0"));
    }

    #[test]
    fn nonsense_is_refused() {
        for (line, words) in [
            (&["a.npy", "--baselines", "halton"][..], "there are: white, sobol"),
            (&["a.npy", "--kernel", "gaussian(-1)"], "gaussian"),
            (&[], "TILE"),
        ] {
            let error = Command::try_parse_from([&["evaluate"], line].concat()).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
        assert!(run(parse(&["a.npy", "--integrands", "0"])).is_err());
        assert!(run(parse(&["/nowhere/a.npy"])).is_err());
    }

    #[test]
    fn spectra_are_saved_and_never_overwritten_without_force() {
        let folder = tempfile::tempdir().unwrap();
        let tile = save(folder.path(), "a.npy", 1);
        let pictures = folder.path().join("spectra");
        let line = [&tile, "--integrands", "2", "--json", "--spectra", pictures.to_str().unwrap()];
        run(parse(&line)).unwrap();
        let count = fs::read_dir(&pictures).unwrap().count();
        assert_eq!(count, 10);
        assert!(pictures.join("a-axis-edge-xt.png").is_file());
        let error = run(parse(&line)).unwrap_err();
        assert_eq!(error.code(), Exit::Exists as u8, "{error:?}");
        run(parse(&[&line[..], &["--force"]].concat())).unwrap();
    }
}
