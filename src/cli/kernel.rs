//! `perceptile kernel`: what a kernel description means, in numbers and as a picture.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use perceptile::format::picture::Image;
use perceptile::format::write::Existing;
use perceptile::kernel::{Kernel, KernelClass, KernelSpec, ResolveProblem, Tap, picture};
use serde::Serialize;

use super::exit::Failure;
use super::settings::TileSize;
use super::stream::print;

/// Taps listed per class without `--all`.
const LISTED: usize = 20;

/// Show the taps of a kernel and what truncation drops, and draw them on request
///
/// Prints, for each class of the kernel, its size, its sums, what truncation dropped and its
/// largest taps. With --out it draws a picture as well: the taps frame by frame (newest first), the
/// space-time slice, and the frequency response over (x, y) and over (x, t).
#[derive(Debug, clap::Args)]
pub struct KernelArgs {
    /// The kernel, such as "gaussian(2.1) * fovvideovdp(60) @ 7x7x8"
    ///
    /// A product of none, gaussian(SIGMA), gaussian(SIGMA, radius=PIXELS), fovvideovdp(FPS),
    /// ema(ALPHA), box(FRAMES), gaussian_t(SIGMA), gaussian_t(SIGMA, radius=FRAMES) and
    /// table("FILE.npy", origin=(T, Y, X)); then, if wanted, "@" and the box WIDTHxHEIGHTxFRAMES
    /// or the share PERCENT% to keep (infinite kernels keep 97% by default). Or a mixture of such
    /// products, column and frame, each with its weight: "0.9: gaussian(2.1) * ema(0.2) + 0.1:
    /// column".
    #[arg(value_name = "SPEC")]
    pub spec: KernelSpec,

    /// Size of the tile that the kernel is for; column and frame need it
    #[arg(long, value_name = "WxHxF")]
    pub tile: Option<TileSize>,

    /// List every tap instead of the 20 largest
    #[arg(long)]
    pub all: bool,

    /// Print JSON, with every tap
    #[arg(long)]
    pub json: bool,

    /// Draw the kernel and its frequency response into this PNG file
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,

    /// Overwrite the picture if it exists
    #[arg(long)]
    pub force: bool,
}

/// Prints the kernel, and writes its picture if one is asked for.
///
/// # Errors
/// A kernel that cannot be made or does not fit the tile, and a picture that cannot be written.
pub fn run(args: KernelArgs) -> Result<(), Failure> {
    let kernel = match args.tile {
        // Samples per pixel and dimensions do not matter to a kernel.
        Some(size) => args.spec.resolve(size.shape(1, 1)?)?,
        None => args.spec.resolve_without_tile().map_err(|error| {
            let needs_tile = error.problem == ResolveProblem::NeedsTile;
            let failure = Failure::from(error);
            if needs_tile { failure.explained("give --tile WxHxF") } else { failure }
        })?,
    };
    let text = if args.json {
        let report = KernelReport { kernel: args.spec.to_string(), classes: describe(&kernel) };
        serde_json::to_string_pretty(&report)? + "\n"
    } else {
        table(&kernel, if args.all { usize::MAX } else { LISTED })
    };
    print(&text)?;
    if let Some(path) = args.out {
        write_picture(&kernel, &path, Existing::from_force(args.force))?;
        if !args.json {
            print(&format!("\npicture: {}\n", path.display()))?;
        }
    }
    Ok(())
}

fn write_picture(kernel: &Kernel, path: &Path, existing: Existing) -> Result<(), Failure> {
    let picture = picture(kernel);
    let (width, height) = (picture.width(), picture.height());
    Image::new(width, height, 3, picture.into_rgb())?.save(path, existing)?;
    Ok(())
}

/// The JSON form.
#[derive(Serialize)]
struct KernelReport {
    kernel: String,
    classes: Vec<ClassReport>,
}

#[derive(Serialize)]
struct ClassReport {
    kernel: String,
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
    dropped: DroppedReport,
    /// (dx, dy, dt, weight), largest magnitude first.
    taps: Vec<(i32, i32, i32, f64)>,
}

#[derive(Serialize)]
struct DroppedReport {
    total: f64,
    space: Option<f64>,
    time: Option<f64>,
}

fn describe(kernel: &Kernel) -> Vec<ClassReport> {
    let class = |class: &KernelClass| {
        let KernelClass { weight, taps, dropped, text } = class;
        let (low, high) = taps.bounds();
        ClassReport {
            kernel: text.clone(),
            weight: *weight,
            low: low.to_array(),
            high: high.to_array(),
            size: taps.size(),
            sum: taps.sum(),
            sum_abs: taps.magnitude(),
            sum_squares: taps.power(),
            effective_taps: taps.effective_taps(),
            mean_subset: taps.mean_subset(),
            dropped: DroppedReport {
                total: dropped.total,
                space: dropped.space,
                time: dropped.time,
            },
            taps: taps
                .taps()
                .iter()
                .map(|&Tap { offset, weight }| (offset.x, offset.y, offset.z, weight))
                .collect(),
        }
    };
    kernel.classes().iter().map(class).collect()
}

/// The form for people, with at most `listed` taps per class.
fn table(kernel: &Kernel, listed: usize) -> String {
    let mut text = String::new();
    for (i, class) in describe(kernel).iter().enumerate() {
        if i > 0 {
            text.push('\n');
        }
        // Writing into a String cannot fail.
        let _ = write_class(&mut text, class, listed, kernel.classes().len() > 1);
    }
    text
}

fn write_class(
    out: &mut String,
    class: &ClassReport,
    listed: usize,
    mixture: bool,
) -> std::fmt::Result {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let [width, height, frames] = class.size;
    let ([left, top, past], [right, bottom, newest]) = (class.low, class.high);
    let share =
        if mixture { format!(", {} of draws", percent(class.weight)) } else { String::new() };
    writeln!(out, "{}{share}", class.kernel)?;
    writeln!(
        out,
        "  box              {width}x{height}x{frames}: dx {left}..{right}, dy {top}..{bottom}, dt {past}..{newest}"
    )?;
    writeln!(out, "  taps             {}", class.taps.len())?;
    writeln!(out, "  effective taps   {:.1}  (1/Σg²)", class.effective_taps)?;
    writeln!(out, "  mean subset      {:.1}  (taps above a random threshold)", class.mean_subset)?;
    writeln!(out, "  Σg               {:.6}", class.sum)?;
    writeln!(out, "  Σ|g|             {:.6}", class.sum_abs)?;
    writeln!(out, "  Σg²              {:.6e}", class.sum_squares)?;
    let dropped = match (class.dropped.space, class.dropped.time) {
        (Some(space), Some(time)) => {
            format!("  (space {}, time {})", percent(space), percent(time))
        }
        _ => String::new(),
    };
    writeln!(out, "  dropped of Σ|g|  {}{dropped}", percent(class.dropped.total))?;
    writeln!(out, "     dx   dy   dt        weight   Σ|g| so far")?;
    let mut mass = 0.0;
    for &(dx, dy, dt, weight) in class.taps.iter().take(listed) {
        mass += weight.abs();
        writeln!(out, "  {dx:>5}{dy:>5}{dt:>5}  {weight:>12.9}   {:>11}", percent(mass))?;
    }
    match class.taps.len().saturating_sub(listed) {
        0 => Ok(()),
        more => writeln!(out, "  and {more} more (--all)"),
    }
}
