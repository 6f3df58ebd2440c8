//! `perceptile kernel`: what a kernel description means, in numbers and as a picture.

use std::path::PathBuf;

use perceptile::format::picture::Image;
use perceptile::format::write::Existing;
use perceptile::kernel::{Dropped, KernelClass, KernelSpec, ResolveProblem, Tap, picture};
use perceptile::settings::{TileSize, ViewingSettings};
use perceptile::solver::Preset;
use serde::Serialize;

use super::exit::Failure;
use super::stream::{print, show};

/// Taps listed per class without `--all`.
const LISTED: usize = 20;

/// Show the taps of a kernel and what truncation drops, and draw them on request
///
/// The kernel is written out as SPEC, or follows from --fps, --taa, --sigma and --pixels-per-degree,
/// as in `optimize`: then it is the mixture that a tile is made with, of 64x64x16 unless --tile says
/// another size. Without any of them it is the default tile's.
///
/// Prints, for each class of the kernel, its size, its sums, what truncation dropped and its
/// largest taps. With --out it draws a picture as well: the taps frame by frame (newest first), the
/// space-time slice, and the frequency response over (x, y) and over (x, t).
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct KernelArgs {
    /// The kernel, such as "gaussian(2.1) * fovvideovdp(60) @ 7x7x8"
    ///
    /// A product of none, gaussian(SIGMA), gaussian(SIGMA, radius=PIXELS), box_xy(PIXELS), binomial(N),
    /// fovvideovdp(FPS), ema(ALPHA) or exponential(ALPHA) (ALPHA is the weight of the newest frame),
    /// box(FRAMES), gaussian_t(SIGMA), gaussian_t(SIGMA, radius=FRAMES), binomial_t(N),
    /// table("FILE.npy", origin=(T, Y, X)) and every(FRAMES) (of which the filter sees one frame);
    /// then, if wanted, "@" and the box WIDTHxHEIGHTxFRAMES or the share PERCENT% to keep (infinite
    /// kernels keep 97% by default), and "of" and the samples of each pixel that are seen, the first
    /// 4 ("of 4"), 1 to 16 ("of 1..16") or 1 to all ("of 1.."). Or a mixture of such products,
    /// column and frame, each with its weight: "0.9: gaussian(2.1) * ema(0.2) + 0.1: column".
    #[arg(value_name = "SPEC")]
    pub spec: Option<KernelSpec>,

    #[command(flatten)]
    pub viewing: ViewingSettings,

    /// Size of the tile that the kernel is for; column and frame need it, and in it a longer kernel
    /// wraps in time
    #[arg(long, help_heading = "Kernel", value_name = "WxHxF")]
    pub tile: Option<TileSize>,

    /// List every tap instead of the 20 largest
    #[arg(long, help_heading = "Output")]
    pub all: bool,

    /// Print JSON, with every tap
    #[arg(long, help_heading = "Output")]
    pub json: bool,

    /// Draw the kernel and its frequency response into this PNG file
    #[arg(long, help_heading = "Output", value_name = "FILE")]
    pub out: Option<PathBuf>,

    /// Overwrite the picture if it exists
    #[arg(long, help_heading = "Output")]
    pub force: bool,
}

const EXAMPLES: &str = "\
Examples:
  perceptile kernel --fps 120 --taa 0.1
  perceptile kernel 'gaussian(2.1) * ema(0.2) @ 7x7x15' --out kernel.png";

/// Prints the kernel, and writes its picture if one is asked for.
///
/// # Errors
/// A kernel that cannot be made or does not fit the tile, and a picture that cannot be written.
pub fn run(args: KernelArgs) -> Result<(), Failure> {
    // Samples per pixel and dimensions do not matter to a kernel.
    let shape = args.tile.map(|size| size.shape(1, 1)).transpose()?;
    let default = Preset::Best.options().shape;
    args.viewing.refuse_beside(args.spec.as_ref(), "SPEC")?;
    let (spec, shape) = match args.spec {
        Some(spec) => (spec, shape),
        None => (args.viewing.kernel(shape.unwrap_or(default))?, shape.or(Some(default))),
    };
    let kernel = match shape {
        Some(shape) => spec.resolve(shape)?,
        None => spec.resolve_without_tile().map_err(|error| {
            let needs_tile = error.problem == ResolveProblem::NeedsTile;
            let failure = Failure::from(error);
            if needs_tile { failure.explained("give --tile WxHxF") } else { failure }
        })?,
    };
    let classes: Vec<ClassReport> = kernel.classes().iter().map(describe).collect();
    let report = KernelReport { kernel: spec.to_string(), classes };
    let listed = if args.all { usize::MAX } else { LISTED };
    show(args.json, &report, || table(&report.classes, listed))?;
    if let Some(path) = args.out {
        let picture = picture(&kernel);
        let (width, height) = (picture.width(), picture.height());
        let image = Image::new(width, height, 3, picture.into_rgb())?;
        image.save(&path, Existing::from_force(args.force))?;
        if !args.json {
            print(&format!("\npicture: {}\n", path.display()))?;
        }
    }
    Ok(())
}

/// The JSON form.
#[derive(Serialize)]
struct KernelReport<'a> {
    kernel: String,
    classes: Vec<ClassReport<'a>>,
}

#[derive(Serialize)]
struct ClassReport<'a> {
    kernel: &'a str,
    weight: f64,
    /// Lowest and highest (dx, dy, dt), both included.
    low: [i32; 3],
    high: [i32; 3],
    /// Pixels across, pixels down, frames.
    size: [u64; 3],
    sum: f64,
    sum_abs: f64,
    sum_squares: f64,
    effective_taps: f64,
    mean_subset: f64,
    dropped: Dropped,
    /// (dx, dy, dt, weight), largest magnitude first.
    taps: Vec<(i32, i32, i32, f64)>,
}

fn describe(class: &KernelClass) -> ClassReport<'_> {
    let KernelClass { weight, taps, dropped, text, .. } = class;
    let (low, high) = taps.bounds();
    let flat = |&Tap { offset, weight }: &Tap| (offset.x, offset.y, offset.z, weight);
    ClassReport {
        kernel: text,
        weight: *weight,
        low: low.to_array(),
        high: high.to_array(),
        size: taps.size(),
        sum: taps.sum(),
        sum_abs: taps.magnitude(),
        sum_squares: taps.power(),
        effective_taps: taps.effective_taps(),
        mean_subset: taps.mean_subset(),
        dropped: *dropped,
        taps: taps.taps().iter().map(flat).collect(),
    }
}

/// The form for people, with at most `listed` taps per class.
fn table(classes: &[ClassReport<'_>], listed: usize) -> String {
    let is_mixture = classes.len() > 1;
    let tables = classes.iter().map(|class| class_table(class, listed, is_mixture));
    tables.collect::<Vec<String>>().join("\n")
}

fn class_table(class: &ClassReport<'_>, listed: usize, is_mixture: bool) -> String {
    let mut text = String::new();
    let mut line = |words: String| text += &(words + "\n");
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let [width, height, frames] = class.size;
    let ([left, top, past], [right, bottom, newest]) = (class.low, class.high);
    let share = format!(", {} of draws", percent(class.weight));
    line(format!("{}{}", class.kernel, if is_mixture { &share } else { "" }));
    let reach = format!("dx {left}..{right}, dy {top}..{bottom}, dt {past}..{newest}");
    line(format!("  box              {width}x{height}x{frames}: {reach}"));
    line(format!("  taps             {}", class.taps.len()));
    line(format!("  effective taps   {:.1}  (1/Σg²)", class.effective_taps));
    line(format!("  mean subset      {:.1}  (taps above a random threshold)", class.mean_subset));
    line(format!("  Σg               {:.6}", class.sum));
    line(format!("  Σ|g|             {:.6}", class.sum_abs));
    line(format!("  Σg²              {:.6e}", class.sum_squares));
    let Dropped { total, space, time } = class.dropped;
    let of_box = space.zip(time).map(|(space, time)| {
        format!("  (space alone {}, time alone {})", percent(space), percent(time))
    });
    line(format!("  dropped of Σ|g|  {}{}", percent(total), of_box.unwrap_or_default()));
    line("     dx   dy   dt        weight   Σ|g| so far".into());
    let mut mass = 0.0;
    for &(dx, dy, dt, weight) in class.taps.iter().take(listed) {
        mass += weight.abs();
        line(format!("  {dx:>5}{dy:>5}{dt:>5}  {weight:>12.9}   {:>11}", percent(mass)));
    }
    if class.taps.len() > listed {
        line(format!("  and {} more (--all)", class.taps.len() - listed));
    }
    text
}
