//! What a run prints when it is over.

use perceptile::metric::{Domain, Histogram, Scores};
use perceptile::run::driver::Output;
use perceptile::run::output::OutputFiles;
use perceptile::run::summary::{
    ParallelSummary, RankSummary, RanksSummary, WorkerSummary, WorkersSummary,
};
use perceptile::solver::StopReason;

/// What the imbalance is.
const IMBALANCE: &str = "(the longest work against the mean)";

/// How a run ended, what its tile is worth, and where the files are.
pub fn describe(
    output: &Output,
    scores: Option<&Scores>,
    files: &OutputFiles,
    seconds: f64,
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
    line(format!("{}: {reason}, {} steps in {seconds:.1} s", shape, summary.steps));
    if let (Some(before), Some(after)) = (summary.objective_before, summary.objective_after) {
        line(format!("objective   {before:.6} -> {after:.6} (mean W2^2 of a draw)"));
    }
    let phases =
        summary.seconds.iter().map(|(phase, time)| format!("{} {time:.1} s", phase.name()));
    line(format!("phases      {}", phases.collect::<Vec<String>>().join(", ")));
    if let Some(scores) = scores {
        line("scores      (white noise is 1, lower is better)".into());
        for class in &scores.classes {
            let pairs = if class.domain == Domain::Pairs { ", pairs" } else { "" };
            let name = format!("{}{pairs}", class.class);
            let perceived = class.perceived;
            line(format!("  {name:22} {:.4} +- {:.4}", perceived.mean, perceived.standard_error));
        }
        let Histogram { smallest, largest, rms } = scores.histogram;
        line(format!("  bias * sqrt(N)         {:.2}", scores.bias));
        line(format!("  histogram              {smallest:.2}-{largest:.2} (rms {rms:.3})"));
        line(format!("  residual               {:.3}", scores.residual));
    }
    line(format!("tile        {}", files.tile.display()));
    line(format!("picture     {}", files.picture.display()));
    line(format!("provenance  {}", files.sidecar.display()));
    match &output.parallel {
        ParallelSummary::Threads => (),
        ParallelSummary::Workers(workers) => describe_workers(workers, line),
        ParallelSummary::Ranks(ranks) => describe_ranks(ranks, line),
    }
    text
}

/// What a run by worker processes prints besides.
fn describe_workers(summary: &WorkersSummary, mut line: impl FnMut(String)) {
    let WorkersSummary { workers, imbalance, replaced, faults } = summary;
    let parts = format!("{}, {replaced} replaced", workers.len());
    line(format!("workers     {parts}, imbalance {imbalance:.2} {IMBALANCE}"));
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
fn describe_ranks(summary: &RanksSummary, mut line: impl FnMut(String)) {
    let RanksSummary { ranks, imbalance } = summary;
    line(format!("ranks       {}, imbalance {imbalance:.2} {IMBALANCE}", ranks.len()));
    line("                region   work s  waiting s  MB of halos  peak MB".into());
    for (rank, it) in ranks.iter().enumerate() {
        let RankSummary { size: [width, height], busy, waiting, traffic, peak } = it;
        let region = format!("{width}x{height}");
        let (traffic, peak) = (*traffic as f64 * 1e-6, *peak as f64 * 1e-6);
        let times = format!("{busy:>8.1} {waiting:>10.1}");
        line(format!("  {rank:<8} {region:>11} {times} {traffic:>12.1} {peak:>8.0}"));
    }
}
