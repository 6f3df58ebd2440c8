//! The profile: everything that was measured, modelled and counted, and its table.

use std::fmt::{self, Write};
use std::time::Duration;

use perceptile_cluster::shared::MapError;
use serde::Serialize;
use thiserror::Error;

use super::access::{self, Arrangement, Behaviour, DrawOrder};
use super::advice::{self, Evidence};
use super::cache::CacheError;
use super::counters::{Counters, Event, Reading};
use super::machine::Machine;
use super::measure::{self, StageTiming, Timing};
use super::roofline::{Rates, Work};
use super::row::{self, StageRow};
use super::subject::{Sizes, Subject};
use super::traffic::{self, Subsets};
#[cfg(unix)]
use super::workers::WorkersProfile;
use crate::gradient::probe::Stage;
use crate::gradient::simd::Simd;
use crate::run::memory::size;
use crate::tile::TileShape;

/// Version of the form of [`Profile`] as JSON.
pub const FORMAT: u32 = 2;

/// Why there is no profile.
#[derive(Debug, Error)]
pub enum ProfileError {
    /// The caches of the machine cannot be modelled.
    #[error("the caches of this machine cannot be modelled: {0}")]
    Cache(#[from] CacheError),
    /// There is no memory for the descent.
    #[error(transparent)]
    Memory(#[from] MapError),
}

/// What a counter of the processor has seen.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CounterRow {
    /// What is counted.
    pub event: Event,
    /// The number for each draw, where there is one.
    pub per_draw: Option<f64>,
    /// The number of all measured steps, or why there is none.
    pub reading: Reading,
}

/// A profile of a run's descent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Profile {
    /// [`FORMAT`].
    pub format: u32,
    /// Version of this program.
    pub version: &'static str,
    /// The machine.
    pub machine: Machine,
    /// Threads of the run.
    pub threads: usize,
    /// Its instruction set.
    pub simd: &'static str,
    /// The tile.
    pub shape: TileShape,
    /// The kernel.
    pub kernel: String,
    /// Steps of the whole descent.
    pub steps: u32,
    /// Draws of a step.
    pub draws: usize,
    /// Directions of a draw.
    pub directions: usize,
    /// Bytes of what the descent keeps.
    pub sizes: Sizes,
    /// The draws' subsets.
    pub subsets: Subsets,
    /// Steps without probes.
    pub whole: Timing,
    /// Steps with probes.
    pub probed: StageTiming,
    /// The stages.
    pub stages: Vec<StageRow>,
    /// Layouts and orders of draws, on a model of the machine's caches.
    pub layouts: Vec<Behaviour>,
    /// What the processor counted in the steps without probes.
    pub counters: Vec<CounterRow>,
    /// What the machine can do at best.
    pub rates: Rates,
    /// What to do about it.
    pub advice: Vec<String>,
    /// What worker processes make of it, if they were asked for.
    #[cfg(unix)]
    pub workers: Option<WorkersProfile>,
}

impl Profile {
    /// Takes the profile of a descent; it takes about four times `time`, a second or two for the
    /// models, and what making the descents takes. To be called by a thread of the pool that does
    /// the run's work, with counters that were opened before that pool was built.
    ///
    /// # Errors
    /// If the machine's caches cannot be modelled.
    pub fn take(
        subject: &Subject,
        machine: Machine,
        rates: Rates,
        simd: Simd,
        time: Duration,
        counters: &mut Counters,
    ) -> Result<Self, ProfileError> {
        let samples = subject.start();
        let draws = subject.options().draw.draws;
        let mut before = counters.snapshot();
        let warm = || before = counters.snapshot();
        let whole = measure::whole(subject, crate::tile::Layout::Rows, simd, &samples, time, warm)?;
        let readings = counters.snapshot().since(&before);
        let counted = draws as f64 * f64::from(whole.steps);
        let counters = readings
            .into_iter()
            .map(|(event, reading)| {
                let per_draw = match &reading {
                    Reading::Count { events, .. } => Some(*events as f64 / counted),
                    Reading::Unavailable { .. } => None,
                };
                CounterRow { event, per_draw, reading }
            })
            .collect();
        let probed = measure::stages(subject, simd, &samples, time)?;
        let levels = machine.levels();
        let mut layouts = access::compare(subject, &levels)?;
        let per_draw =
            |timing: Timing| timing.seconds * 1e9 * subject.threads() as f64 / draws as f64;
        for behaviour in layouts.iter_mut().filter(|layout| layout.order == DrawOrder::Sorted) {
            behaviour.measured = match (behaviour.arrangement, behaviour.arrangement.layout()) {
                (_, None) => None,
                (Arrangement::Rows, _) => Some(per_draw(whole)),
                (_, Some(layout)) => {
                    Some(per_draw(measure::whole(subject, layout, simd, &samples, time, || ())?))
                }
            };
        }
        let sizes = subject.sizes();
        let (traffic, subsets) = traffic::count(subject, 1);
        let sum = probed.sum();
        let stages = Stage::ALL.map(|stage| {
            let nanoseconds = probed.of(stage);
            let traffic = traffic[stage as usize];
            let store =
                row::store(stage, &sizes, levels.map(|level| level.bytes), subject.threads());
            let work = Work {
                operations: traffic.operations,
                bytes: traffic.bytes(),
                // The rates are those of all threads together.
                seconds: nanoseconds / 1e9 / subject.threads() as f64,
            };
            StageRow {
                stage: stage.name(),
                nanoseconds,
                per_draw: nanoseconds / draws as f64,
                share: nanoseconds / sum,
                traffic,
                store,
                placement: rates.ceiling(store).place(work).ok(),
            }
        });
        let advice = advice::advice(&Evidence {
            stages: &stages,
            layouts: &layouts,
            sizes: &sizes,
            rates: &rates,
            caches: levels.map(|level| level.bytes),
            threads: subject.threads(),
            blocks: subject.blocks().len(),
            draws,
            is_simd_left_out: simd.name() != Simd::detect().name(),
        });
        Ok(Self {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION"),
            machine,
            threads: subject.threads(),
            simd: simd.name(),
            shape: subject.shape(),
            kernel: subject.options().kernel.to_string(),
            steps: subject.options().steps,
            draws,
            directions: subject.options().draw.directions,
            sizes,
            subsets,
            whole,
            probed,
            stages: stages.into(),
            layouts,
            counters,
            rates,
            advice,
            #[cfg(unix)]
            workers: None,
        })
    }
}

impl fmt::Display for Profile {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { machine, rates, sizes, subsets, whole, probed, .. } = self;
        let draws = self.draws as f64;
        let caches: Vec<String> = machine
            .caches
            .iter()
            .map(|cache| {
                let assumed = if cache.assumed { " (assumed)" } else { "" };
                format!("L{} {}{assumed}", cache.geometry.level, size(cache.geometry.bytes))
            })
            .collect();
        let step = whole.seconds * 1e3;
        let decimals = if step < 10.0 { 2 } else { 1 };
        let all = duration(whole.seconds * f64::from(self.steps));
        writeln!(f, "{step:.decimals$} ms a step: {} steps take {all}\n", self.steps)?;
        writeln!(f, "tile      {}", self.shape)?;
        writeln!(f, "kernel    {}", self.kernel)?;
        writeln!(
            f,
            "machine   {}, {} cores; {}",
            machine.processor,
            machine.cores,
            caches.join(", ")
        )?;
        writeln!(
            f,
            "rates     copying {}{:.0} GB/s in L1, {}{:.0} in L2, {:.1} in memory; {:.0} Gop/s \
             (threads: {}, {})",
            rates.l1.hedge(),
            rates.l1.rate / 1e9,
            rates.l2.hedge(),
            rates.l2.rate / 1e9,
            rates.memory.rate / 1e9,
            rates.compute / 1e9,
            rates.threads,
            self.simd
        )?;
        if !(rates.l1.measured && rates.l2.measured) {
            let what = "others use the machine, so a cache seemed slower than what lies beyond it, \
                        however often it was measured";
            writeln!(f, "          disturbed: do not trust the roof; {what}")?;
        }
        writeln!(
            f,
            "memory    samples {}, moments {}, patches {} (the largest {}); a cell sees {}",
            size(sizes.samples),
            size(sizes.moments),
            size(sizes.patches),
            size(sizes.patch),
            size(sizes.window)
        )?;
        writeln!(
            f,
            "step      {:.3} ms for {} draws (mean of {} steps); {:.1} samples in {:.1} runs a draw",
            whole.seconds * 1e3,
            self.draws,
            whole.steps,
            subsets.samples,
            subsets.runs
        )?;
        writeln!(
            f,
            "probes    {:.3} ms a step; {:.1} ns for each look at the clock are taken off",
            probed.timing.seconds * 1e3,
            probed.look
        )?;

        writeln!(
            f,
            "\n{:10} {:>8} {:>6} {:>9} {:>9} {:>7} {:>7} {:>8} {:>8}  under",
            "stage", "ns/draw", "share", "samples", "bytes", "GB/s", "Gop/s", "op/byte", "of roof"
        )?;
        for row in &self.stages {
            write!(f, "{:10} {:8.1} {:5.1}%", row.stage, row.per_draw, 100.0 * row.share)?;
            let Some(placement) = row.placement else {
                writeln!(f)?;
                continue;
            };
            let seconds = row.nanoseconds / 1e9 / self.threads as f64;
            let intensity = placement.intensity.unwrap_or(f64::INFINITY);
            writeln!(
                f,
                " {:9.1} {:9.0} {:7.1} {:7.2} {:8.2} {:7.0}%  {}",
                row.traffic.samples / draws,
                row.traffic.bytes() / draws,
                row.traffic.bytes() / seconds / 1e9,
                placement.attained / 1e9,
                intensity,
                100.0 * placement.share,
                row.bound()
            )?;
        }
        writeln!(
            f,
            "(time of all threads for each draw; samples and bytes for each draw; the roof is the \
             machine's rates)"
        )?;

        writeln!(
            f,
            "\n{:41}  {:<23}  {:<23} {:>9}",
            "", "misses of the draws in", "misses of copying in", "measured"
        )?;
        writeln!(
            f,
            "{:7} {:9} {:>7} {:>7} {:>7}  {:>7} {:>7} {:>7}  {:>7} {:>7} {:>7} {:>9}",
            "layout",
            "draws",
            "lines",
            "pages",
            "x least",
            "L1",
            "L2",
            "L3",
            "L1",
            "L2",
            "L3",
            "ns/draw"
        )?;
        for row in &self.layouts {
            let own: Vec<f64> =
                (0..3).map(|level| row.gather[level] + row.scatter[level]).collect();
            let measured = row.measured.map_or("-".into(), |ns| format!("{ns:.0}"));
            writeln!(
                f,
                "{:7} {:9} {:7.1} {:7.1} {:7.2}  {:7.2} {:7.2} {:7.2}  {:7.2} {:7.2} {:7.2} {measured:>9}",
                row.arrangement.name(),
                row.order.name(),
                row.lines,
                row.pages,
                row.ratio,
                own[0],
                own[1],
                own[2],
                row.copy[0],
                row.copy[1],
                row.copy[2]
            )?;
        }
        writeln!(
            f,
            "(lines and pages of a draw's samples; misses for each draw of reading samples and \
             adding to their gradient, then of copying; modelled for one core without prefetching; \
             measured time of a whole step and all threads)"
        )?;

        if let Some(rows) = self.behaviour(Arrangement::Rows, DrawOrder::Sorted) {
            let all = rows.reuse.cold + rows.reuse.bins.iter().sum::<u64>();
            let share = |uses: u64| 100.0 * uses as f64 / all.max(1) as f64;
            writeln!(f, "\nreuse of lines by draws (rows, sorted), by lines used in between")?;
            let mut line = |name: String, uses: u64| {
                let bar = "#".repeat((share(uses) / 2.0).round() as usize);
                writeln!(f, "{name:>16} {:5.1}% {bar}", share(uses))
            };
            for (bin, &uses) in rows.reuse.bins.iter().enumerate() {
                let name = if bin == 0 { "0".into() } else { format!("below {}", 1_u64 << bin) };
                line(name, uses)?;
            }
            line("first use".into(), rows.reuse.cold)?;
        }

        if let Some(reason) = self.no_counters() {
            writeln!(f, "\nhardware counters: none on this machine ({reason})")?;
        } else {
            writeln!(f, "\nhardware counters, for each draw")?;
            for row in &self.counters {
                let text = match row.per_draw {
                    Some(per_draw) => format!("{per_draw:.2}"),
                    None => row.reading.to_string(),
                };
                writeln!(f, "  {:18} {text}", row.event.name())?;
            }
        }

        #[cfg(unix)]
        if let Some(workers) = &self.workers {
            write!(f, "\n{workers}")?;
        }
        let mut advice = String::new();
        for sentence in &self.advice {
            writeln!(advice, "- {sentence}")?;
        }
        write!(f, "\nadvice\n{advice}")
    }
}

/// A time as people read it.
fn duration(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..60 => format!("{seconds:.1} s"),
        60..3600 => format!("{} min {} s", whole / 60, whole % 60),
        _ => format!("{} h {} min", whole / 3600, whole % 3600 / 60),
    }
}

impl Profile {
    /// Why nothing at all was counted, if so.
    fn no_counters(&self) -> Option<&str> {
        let is_none = |row: &CounterRow| matches!(row.reading, Reading::Unavailable { .. });
        match &self.counters.first()?.reading {
            Reading::Unavailable { reason } if self.counters.iter().all(is_none) => Some(reason),
            _ => None,
        }
    }

    /// What an arrangement and an order cost.
    pub fn behaviour(&self, arrangement: Arrangement, order: DrawOrder) -> Option<&Behaviour> {
        self.layouts.iter().find(|row| (row.arrangement, row.order) == (arrangement, order))
    }
}

#[cfg(test)]
mod tests {
    use super::duration;

    #[test]
    fn times_have_the_units_that_people_use() {
        for (seconds, text) in [
            (0.04, "0.0 s"),
            (12.34, "12.3 s"),
            (59.7, "1 min 0 s"),
            (563.2, "9 min 23 s"),
            (3600.0, "1 h 0 min"),
            (100_000.0, "27 h 46 min"),
        ] {
            assert_eq!(duration(seconds), text);
        }
    }
}
