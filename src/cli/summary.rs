//! What a run prints before its first step and after its last one.

use perceptile::format::sidecar::Sidecar;
use perceptile::kernel::{Dropped, KernelClass};
use perceptile::metric::Scores;
use perceptile::run::driver::Output;
use perceptile::run::forecast::Forecast;
use perceptile::run::output::OutputFiles;
use perceptile::run::plan::Plan;
use perceptile::run::summary::{
    ParallelSummary, RankSummary, RanksSummary, WorkerSummary, WorkersSummary,
};
use perceptile::solver::{Options, Parallelism, StopReason, Summary};

use super::duration::in_words;

/// The share of its weight that a kernel may lose to its truncation without a warning.
const MOST_DROPPED: f64 = 0.25;

/// What the imbalance is.
const IMBALANCE: &str = "(the longest work against the mean)";

/// What a run is about to do, and how long that will take, if it was foreseen.
pub fn intent(plan: &Plan, forecast: Option<&Forecast>) -> String {
    let Options { shape, seed, steps, polish, .. } = plan.options;
    let Parallelism { ranks, workers, threads } = plan.parallelism;
    let mut text = format!("{shape}, seed {seed}: {steps} steps");
    if polish.steps > 0 {
        text += &format!(", {} polish steps", polish.steps);
    }
    text += " on ";
    if ranks > 1 {
        text += &format!("{ranks} ranks of ");
    }
    if workers > 0 {
        text += &format!("{workers} workers of ");
    }
    text += &format!("{threads} thread{}", if threads == 1 { "" } else { "s" });
    if let Some(forecast) = forecast {
        text += &format!(", about {}", time(forecast));
    }
    for notice in notices(plan) {
        text += &format!("\n{notice}");
    }
    text
}

/// How long a run will take, in all and by phase.
pub fn time(forecast: &Forecast) -> String {
    let phases = forecast.seconds.iter();
    let phases = phases.map(|(phase, seconds)| format!("{} {}", phase.name(), in_words(*seconds)));
    let phases = phases.collect::<Vec<String>>().join(", ");
    format!("{} ({phases})", in_words(forecast.total()))
}

/// What people should know of the kernel before a run.
fn notices(plan: &Plan) -> Vec<String> {
    let classes = plan.kernel.classes();
    let mut notices = Vec::new();
    let frames = plan.options.shape.frames() as u64;
    for class in classes {
        // A box as long as the tile is as long as it should be.
        let whole = class.taps.size()[2] >= frames;
        let Dropped { total, space, .. } = class.dropped;
        if space.filter(|_| whole).unwrap_or(total) > MOST_DROPPED {
            notices.push(format!("warning: {}", dropped(class)));
        }
    }
    let still = |class: &KernelClass| class.taps.size() == [1, 1, frames];
    let in_time = classes[0].taps.size()[2] > 1;
    if in_time && frames > 1 && !classes.iter().any(still) {
        let half = frames.div_ceil(2);
        let share = format!("0.84: {} + 0.06: column + 0.1: box({half})", classes[0].text);
        notices.push(format!(
            "note: this kernel has no part for still pictures, which accumulate: `{share}` has"
        ));
    }
    notices
}

/// What the truncation of a class leaves out.
pub fn dropped(class: &KernelClass) -> String {
    let percent = |share: f64| format!("{:.0} %", 100.0 * share);
    let Dropped { total, space, time } = class.dropped;
    let mut text = format!("`{}` leaves out {} of its weight", class.text, percent(total));
    if let (Some(space), Some(time)) = (space, time) {
        text += &format!(" (space alone {}, time alone {})", percent(space), percent(time));
    }
    text
}

/// What was made, for programs: the provenance and the files.
///
/// # Errors
/// What cannot be written as JSON.
pub fn json(made: &Sidecar, files: &OutputFiles) -> Result<String, serde_json::Error> {
    let OutputFiles { tile, sidecar, picture } = files;
    let mut made = serde_json::to_value(made)?;
    made["files"] = serde_json::json!({ "tile": tile, "provenance": sidecar, "picture": picture });
    Ok(serde_json::to_string_pretty(&made)? + "\n")
}

/// How a run ended, what its tile is worth, and where the files are; `everything` with what
/// threads, workers or ranks did.
pub fn describe(
    output: &Output,
    plan: &Plan,
    scores: Option<&Scores>,
    made: &Sidecar,
    files: &OutputFiles,
    everything: bool,
) -> String {
    let (shape, summary) = (output.shape(), &output.summary);
    let mut text = String::new();
    let mut line = |words: String| text += &(words + "\n");
    let reason = match summary.reason {
        StopReason::Completed => "all steps done",
        StopReason::StopAfter => "stopped where asked",
        StopReason::Interrupted => "interrupted: this is the tile so far",
        StopReason::Time => "time is up: this is the tile so far",
    };
    let descended = summary.steps.min(plan.options.steps);
    let polished = match summary.steps - descended {
        0 => String::new(),
        steps => format!(" and {steps} polish steps"),
    };
    let steps = format!("{descended} steps{polished} in {}", in_words(made.seconds));
    line(format!("{shape}: {reason}, {steps}"));
    // Of few steps the first are the last.
    let enough = descended as usize >= 2 * Summary::WINDOW;
    if let (true, Some(before), Some(after)) =
        (enough, summary.objective_before, summary.objective_after)
    {
        line(format!("loss        {before:.6} -> {after:.6} (sliced W2^2, mean of a step)"));
    }
    let phases =
        summary.seconds.iter().map(|(phase, time)| format!("{} {time:.1} s", phase.name()));
    line(format!("phases      {}", phases.collect::<Vec<String>>().join(", ")));
    if let Some(scores) = scores {
        line("scores      (white noise is 1, lower is better)".into());
        scores.to_string().lines().for_each(|score| line(format!("  {score}")));
    }
    line(format!("tile        {}", files.tile.display()));
    line(format!("picture     {}", files.picture.display()));
    line(format!("provenance  {}", files.sidecar.display()));
    line(format!("sha256      {}", made.sha256));
    match &output.parallel {
        ParallelSummary::Threads => (),
        ParallelSummary::Workers(workers) => describe_workers(workers, everything, line),
        ParallelSummary::Ranks(ranks) => describe_ranks(ranks, everything, line),
    }
    text
}

/// What a run by worker processes prints besides.
fn describe_workers(summary: &WorkersSummary, everything: bool, mut line: impl FnMut(String)) {
    let WorkersSummary { workers, imbalance, replaced, faults } = summary;
    line(format!("workers     {}, {replaced} replaced", workers.len()));
    if !everything {
        return;
    }
    line(format!("imbalance   {imbalance:.2} {IMBALANCE}"));
    line("            work s  waiting s      jobs  of others  MB of others".into());
    for (rank, worker) in workers.iter().enumerate() {
        let WorkerSummary { busy, waiting, jobs, taken, traffic } = worker;
        let times = format!("{busy:>7.1} {waiting:>10.1}");
        let traffic = *traffic as f64 / 1e6;
        line(format!("  {rank:<8} {times} {jobs:>9} {taken:>10} {traffic:>13.1}"));
    }
    if !faults.is_empty() {
        let faults = faults.iter().map(|(place, count)| format!("{place} {count}"));
        line(format!("faults      {}", faults.collect::<Vec<String>>().join(", ")));
    }
}

/// What a run by several ranks prints besides.
fn describe_ranks(summary: &RanksSummary, everything: bool, mut line: impl FnMut(String)) {
    let RanksSummary { ranks, imbalance } = summary;
    line(format!("ranks       {}", ranks.len()));
    if !everything {
        return;
    }
    line(format!("imbalance   {imbalance:.2} {IMBALANCE}"));
    line("                region   work s  waiting s  MB of halos  peak MB".into());
    for (rank, it) in ranks.iter().enumerate() {
        let RankSummary { size: [width, height], busy, waiting, traffic, peak } = it;
        let region = format!("{width}x{height}");
        let (traffic, peak) = (*traffic as f64 * 1e-6, *peak as f64 * 1e-6);
        let times = format!("{busy:>8.1} {waiting:>10.1}");
        line(format!("  {rank:<8} {region:>11} {times} {traffic:>12.1} {peak:>8.0}"));
    }
}
