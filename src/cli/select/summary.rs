//! What a selection says before it begins, and its scores.

use perceptile::metric::figure;
use perceptile::select::{
    MethodScores, Norm, SelectParallelism, SelectPlan, SelectScores, Selection,
};
use serde::Serialize;

use super::SelectArgs;
use super::hands::Swept;
use super::inputs::Inputs;
use super::outputs::Outputs;
use crate::cli::duration::in_words;

/// Where the time went.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct Seconds {
    /// In all.
    pub all: f64,
    /// Of the thread that reads ahead.
    pub reading: f64,
    /// That the sweeps waited for it.
    pub waiting: f64,
    /// Sweeps, filters and scores.
    pub sweeps: f64,
    /// Writing frames.
    pub writing: f64,
}

/// All that is known of a selection.
#[derive(Debug, Serialize)]
pub struct Report {
    /// The program.
    version: &'static str,
    result: String,
    width: usize,
    height: usize,
    frames: usize,
    /// The text form of the eye's filter.
    kernel: String,
    taa: Option<f64>,
    norm: Norm,
    /// What scores are against: `reference` or `guide`.
    against: &'static str,
    /// What was read: the reference or guide first.
    inputs: Vec<String>,
    /// Channel by channel for levels, else of all together.
    scores: Vec<SelectScores>,
    /// The guide's own error as a part of the mean's, as far as the renders tell; none without two.
    guide_error: Option<f64>,
    /// How often each candidate was chosen, by the numbers of its renders.
    chosen: Vec<(String, u64)>,
    /// λ and changed pixels of each sweep.
    sweeps: Swept,
    parallelism: SelectParallelism,
    /// Workers that were lost and replaced.
    pub replaced: u32,
    seconds: Seconds,
    /// Pixels of all frames, times sweeps, in a second of sweeping.
    pixels_per_second: f64,
}

/// What is about to be done, in so many bytes of memory and frames of a window.
pub fn intent(
    inputs: &Inputs,
    plan: &SelectPlan,
    (bytes, window): (u64, usize),
    outputs: &Outputs,
) -> String {
    let [width, height] = inputs.guide.size();
    let frames = inputs.guide.frames();
    let what = match inputs.display {
        Some(display) => format!("{} levels", display.levels),
        None => {
            let candidates = plan.candidates();
            let means = match candidates.subsets {
                true => format!(", means of {} renders", candidates.renders),
                false => String::new(),
            };
            let candidates = candidates.count();
            format!("{candidates} candidate{}{means}", if candidates == 1 { "" } else { "s" })
        }
    };
    let options = plan.options();
    format!(
        "{width}x{height}, {frames} frame{}: {what}, {} sweeps in {}, on {}\n\
         window     {window} frames, about {} of memory\n\
         result     {}\n",
        if frames == 1 { "" } else { "s" },
        options.sweeps,
        match options.norm {
            Norm::L1 => "L1",
            Norm::L2 => "L2",
        },
        hands(plan.parallelism()),
        perceptile::run::memory::size(bytes),
        outputs.result.display(),
    )
}

/// Who works, in words.
fn hands(parallelism: SelectParallelism) -> String {
    let many = |count: usize, what: &str| match count {
        1 => format!("1 {what}"),
        _ => format!("{count} {what}s"),
    };
    let threads = many(parallelism.threads, "thread");
    match parallelism {
        SelectParallelism { ranks: 1, workers: 0, .. } => threads,
        SelectParallelism { ranks: 1, workers, .. } => {
            format!("{} of {threads}", many(workers, "worker"))
        }
        SelectParallelism { ranks, .. } => format!("{} of {threads}", many(ranks, "rank")),
    }
}

impl Report {
    pub fn new(
        (inputs, plan): (&Inputs, &SelectPlan),
        args: &SelectArgs,
        (selections, swept): (&[Selection], Vec<Swept>),
        seconds: Seconds,
        outputs: &Outputs,
    ) -> Self {
        let [width, height] = inputs.guide.size();
        let frames = inputs.guide.frames();
        let options = plan.options();
        let visits =
            (width * height * frames * selections.len()) as f64 * f64::from(options.sweeps);
        let scores: Vec<SelectScores> = selections.iter().map(Selection::scores).collect();
        let sum = |counts: Vec<Vec<u64>>| -> Vec<u64> {
            (0..counts[0].len()).map(|i| counts.iter().map(|of| of[i]).sum()).collect()
        };
        let chosen =
            sum(selections.iter().map(|of| of.chosen().map(|(_, n)| n).collect()).collect());
        let changed = sum(swept.iter().map(|of| of.iter().map(|&(_, n)| n).collect()).collect());
        let guide_error = if inputs.display.is_none() { guide_error(&scores[0]) } else { None };
        Self {
            version: env!("CARGO_PKG_VERSION"),
            result: outputs.result.display().to_string(),
            width,
            height,
            frames,
            kernel: args.eye().map(|spec| spec.to_string()).unwrap_or_default(),
            taa: args.taa,
            norm: options.norm,
            against: if inputs.is_true { "reference" } else { "guide" },
            inputs: inputs.names.iter().map(|name| name.display().to_string()).collect(),
            guide_error: guide_error.filter(|_| !inputs.is_true),
            chosen: selections[0].chosen().map(|(name, _)| name).zip(chosen).collect(),
            sweeps: swept[0].iter().map(|&(lambda, _)| lambda).zip(changed).collect(),
            scores,
            parallelism: plan.parallelism(),
            replaced: 0,
            seconds,
            pixels_per_second: visits / seconds.sweeps.max(1e-9),
        }
    }

    /// What people should know before they use the result.
    pub fn warnings(&self) -> impl Iterator<Item = String> {
        let bad = self.guide_error.filter(|&error| error > 1.0);
        bad.into_iter().map(|error| {
            format!(
                "warning: the guide's error is about {} times that of the mean of the renders: it is no \
                 stand-in for the true picture, and the mean may be better than the result",
                figure(error)
            )
        })
    }

    /// The scores as people read them.
    pub fn text(&self) -> String {
        let mut text = format!("pRelMSE against the {}", self.against);
        let has_taa = self.taa.is_some();
        text += if has_taa { "         as seen   behind TAA\n" } else { "         as seen\n" };
        let mean = |pick: &dyn Fn(&SelectScores) -> MethodScores| {
            let all = self.scores.iter().map(pick);
            let n = self.scores.len() as f64;
            let (plain, taa) = all.fold((0.0, 0.0), |(plain, taa), scores| {
                (plain + scores.plain / n, taa + scores.taa.unwrap_or(0.0) / n)
            });
            MethodScores { plain, taa: has_taa.then_some(taa) }
        };
        let width = 34;
        let mut line = |name: &str, scores: MethodScores| {
            text += &format!("{name:width$}{:>9}", figure(scores.plain));
            if let Some(taa) = scores.taa {
                text += &format!("{:>13}", figure(taa));
            }
            text.push('\n');
        };
        line("the result", mean(&|scores| scores.selection));
        if self.inputs.len() > 1 {
            line("the mean of all renders", mean(&|scores| scores.mean));
            for (i, name) in self.inputs[1..].iter().enumerate() {
                let short: String = name.chars().rev().take(width - 2).collect();
                let short: String = short.chars().rev().collect();
                line(&short, mean(&|scores| scores.renders[i]));
            }
        }
        if let Some(error) = self.guide_error {
            text += &format!(
                "the guide's own error, as far as the renders tell, is {} of the mean's\n",
                figure(error)
            );
        }
        let frames = self.frames as f64 / self.seconds.all.max(1e-9);
        text += &format!(
            "{} in {} ({frames:.1} frames a second; {:.2} million pixels a second and sweep)\n",
            self.result,
            in_words(self.seconds.all),
            self.pixels_per_second / 1e6,
        );
        text
    }
}

/// The error of the guide as a part of that of the mean of n renders, both as seen. A render's error
/// against the guide is B + σ², the mean's B + σ²/n, where σ² is a render's own error and B the
/// guide's, if renders and guide are independent. A guide that is made of the same renders looks
/// better than it is.
fn guide_error(scores: &SelectScores) -> Option<f64> {
    let n = scores.renders.len() as f64;
    if n < 2.0 {
        return None;
    }
    let render = scores.renders.iter().map(|scores| scores.plain).sum::<f64>() / n;
    let mean = scores.mean.plain;
    let noise = (render - mean) / (n - 1.0);
    let guide = (mean - noise).max(0.0);
    (noise > 0.0).then_some(guide / noise)
}
