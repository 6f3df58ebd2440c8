//! What a run prints when it is over.

use perceptile::metric::{Domain, Scores};
use perceptile::run::driver::Output;
use perceptile::run::output::OutputFiles;
use perceptile::run::summary::{ParallelSummary, RanksSummary, WorkersSummary};
use perceptile::solver::StopReason;

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
    let phases: Vec<String> = summary
        .seconds
        .iter()
        .map(|(phase, seconds)| format!("{} {seconds:.1} s", phase.name()))
        .collect();
    line(format!("phases      {}", phases.join(", ")));
    if let Some(scores) = scores {
        line("scores      (white noise is 1, lower is better)".into());
        for class in &scores.classes {
            let pairs = if class.domain == Domain::Pairs { ", pairs" } else { "" };
            let name = format!("{}{pairs}", class.class);
            let perceived = class.perceived;
            line(format!("  {name:22} {:.4} +- {:.4}", perceived.mean, perceived.standard_error));
        }
        let histogram = scores.histogram;
        line(format!("  {:22} {:.2}", "bias * sqrt(N)", scores.bias));
        line(format!(
            "  {:22} {:.2}-{:.2} (rms {:.3})",
            "histogram", histogram.smallest, histogram.largest, histogram.rms
        ));
        line(format!("  {:22} {:.3}", "residual", scores.residual));
    }
    line(format!("tile        {}", files.tile.display()));
    line(format!("picture     {}", files.picture.display()));
    line(format!("provenance  {}", files.sidecar.display()));
    match &output.parallel {
        ParallelSummary::Threads => (),
        ParallelSummary::Workers(workers) => text += &describe_workers(workers),
        ParallelSummary::Ranks(ranks) => text += &describe_ranks(ranks),
    }
    text
}

/// What a run by worker processes prints besides.
fn describe_workers(workers: &WorkersSummary) -> String {
    let mut text = format!(
        "workers     {}, {} replaced, imbalance {:.2} (the longest work against the mean)\n",
        workers.workers.len(),
        workers.replaced,
        workers.imbalance
    );
    text += "            work s  waiting s      jobs  of others  MB of others\n";
    for (rank, worker) in workers.workers.iter().enumerate() {
        text += &format!(
            "  {rank:<8} {:>7.1} {:>10.1} {:>9} {:>10} {:>13.1}\n",
            worker.busy,
            worker.waiting,
            worker.jobs,
            worker.taken,
            worker.traffic as f64 / 1e6
        );
    }
    if !workers.faults.is_empty() {
        let faults = workers.faults.iter().map(|(place, count)| format!("{place} {count}"));
        text += &format!("faults      {}\n", faults.collect::<Vec<String>>().join(", "));
    }
    text
}

/// What a run by several ranks prints besides.
fn describe_ranks(ranks: &RanksSummary) -> String {
    let mut text = format!(
        "ranks       {}, imbalance {:.2} (the longest work against the mean)\n",
        ranks.ranks.len(),
        ranks.imbalance
    );
    text += "                region   work s  waiting s  MB of halos  peak MB\n";
    for (rank, it) in ranks.ranks.iter().enumerate() {
        let [width, height] = it.size;
        text += &format!(
            "  {rank:<8} {:>11} {:>8.1} {:>10.1} {:>12.1} {:>8.0}\n",
            format!("{width}x{height}"),
            it.busy,
            it.waiting,
            it.traffic as f64 * 1e-6,
            it.peak as f64 * 1e-6
        );
    }
    text
}
