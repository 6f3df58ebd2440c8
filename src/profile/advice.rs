//! Sentences that say what the numbers of a profile mean, and what to try. Only what a flag can
//! change is advised: draws of a step, threads, the kernel's box, the tile's size, instructions.

use super::access::{Arrangement, Behaviour, DrawOrder};
use super::roofline::{Bound, Rates, Store};
use super::row::StageRow;
use super::subject::Sizes;
use crate::gradient::probe::Stage;
use crate::run::memory::size;

/// What a profile found.
#[derive(Debug, Clone, Copy)]
pub struct Evidence<'a> {
    /// The stages, in the order of [`Stage::ALL`].
    pub stages: &'a [StageRow],
    /// Layouts and orders.
    pub layouts: &'a [Behaviour],
    /// Bytes of what the descent keeps.
    pub sizes: &'a Sizes,
    /// What the machine can do.
    pub rates: &'a Rates,
    /// Bytes of L1, L2 and L3.
    pub caches: [u64; 3],
    /// Threads of the run.
    pub threads: usize,
    /// Blocks that they share.
    pub blocks: usize,
    /// Draws of a step.
    pub draws: usize,
    /// Whether the machine has better instructions than the run used.
    pub is_simd_left_out: bool,
}

/// Nanoseconds that a miss costs which the next level answers: usual ones of server cores, to
/// weigh levels against each other.
const LATENCIES: [f64; 3] = [4.0, 15.0, 90.0];
/// Share of the time from which waiting is worth a word.
const WAITING: f64 = 0.05;
/// Share of the time from which the work on all coordinates is worth a word.
const UPDATE: f64 = 0.3;
/// Share of a roof from which a stage is as fast as the machine lets it be.
const NEAR: f64 = 0.6;
/// What helps where the machine cannot be faster.
const LESS: &str = "only fewer draws a step (--draws) or a smaller kernel box help";
/// Misses of a draw from which they are worth a word.
const MISSES: f64 = 0.05;

impl Evidence<'_> {
    fn share(&self, stage: Stage) -> f64 {
        self.stages.iter().find(|row| row.stage == stage.name()).map_or(0.0, |row| row.share)
    }

    fn behaviour(&self, arrangement: Arrangement, order: DrawOrder) -> Option<&Behaviour> {
        self.layouts.iter().find(|row| (row.arrangement, row.order) == (arrangement, order))
    }
}

/// What to say, the most important first.
pub fn advice(evidence: &Evidence<'_>) -> Vec<String> {
    let mut sentences = Vec::new();
    let working = evidence.stages.iter().filter(|row| row.stage != Stage::Waiting.name());
    if let Some(row) = working.max_by(|a, b| a.share.total_cmp(&b.share)) {
        sentences.push(longest(row, evidence.rates));
    }
    sentences.extend(misses(evidence));
    sentences.extend(window(evidence));
    sentences.extend(update(evidence));
    sentences.extend(waiting(evidence));
    if evidence.is_simd_left_out {
        sentences.push(
            "the inner loops run without this machine's SIMD, and slower: --simd auto takes it."
                .to_owned(),
        );
    }
    sentences
}

/// The stage that takes most, and how near it is to what the machine can do.
fn longest(row: &StageRow, rates: &Rates) -> String {
    let begin = format!("{} takes most, {:.0} % of the time", row.stage, 100.0 * row.share);
    let Some(placement) = row.placement else { return begin + "." };
    let roof = match (placement.bound, row.store) {
        (Bound::Compute, _) => "the rate of operations",
        (Bound::Memory, Store::L1) => "the bandwidth of L1",
        (Bound::Memory, Store::L2) => "the bandwidth of L2",
        (Bound::Memory, Store::Memory) => "the bandwidth of memory",
    };
    let share = 100.0 * placement.share;
    if placement.share > 1.0 {
        format!(
            "{begin}, and is faster than {roof} allows for copying ({share:.0} % of it): it comes \
             from a cache, or in streams that suit the memory; {LESS}."
        )
    } else if placement.bound == Bound::Memory && !rates.bandwidth(row.store).measured {
        format!(
            "{begin}, at {share:.0} % of what {roof} allows at least: others used the machine, so \
             it could not be measured."
        )
    } else if placement.share >= NEAR {
        format!("{begin}, and is bound by {roof} ({share:.0} % of it): {LESS}.")
    } else {
        format!(
            "{begin}, at {share:.0} % of what {roof} allows: it is bound by latency, branches and \
             instructions rather than by a rate."
        )
    }
}

/// The level whose misses cost the draws most.
fn misses(evidence: &Evidence<'_>) -> Option<String> {
    let rows = evidence.behaviour(Arrangement::Rows, DrawOrder::Sorted)?;
    let moving = evidence.share(Stage::Gather) + evidence.share(Stage::Scatter);
    let stage = if rows.scatter.iter().sum::<f64>() >= rows.gather.iter().sum::<f64>() {
        Stage::Scatter
    } else {
        Stage::Gather
    };
    let of = rows.misses();
    // What is missed here and found in the next level.
    let cost = |level: usize| (of[level] - of.get(level + 1).unwrap_or(&0.0)) * LATENCIES[level];
    let level = (0..3).max_by(|&a, &b| cost(a).total_cmp(&cost(b)))?;
    let taken = format!("gather and scatter take {:.0} % of the time", 100.0 * moving);
    if of[level] < MISSES {
        return Some(format!("{taken}; what they need is in the caches near the core."));
    }
    Some(format!(
        "{taken}; they cost L{} misses most, {:.1} a draw, {} the larger part of them: a smaller \
         kernel box or a smaller tile has fewer.",
        level + 1,
        of[level],
        stage.name()
    ))
}

/// Whether what a cell sees outgrows the second cache.
fn window(evidence: &Evidence<'_>) -> Option<String> {
    let (seen, l2) = (2 * evidence.sizes.window, evidence.caches[1]);
    (seen > l2).then(|| {
        format!(
            "what the draws of a cell see, {} with its gradient, outgrows L2 ({}): a tile of {:.1} \
             times fewer frames, or a smaller kernel box, would fit.",
            size(seen),
            size(l2),
            seen as f64 / l2 as f64
        )
    })
}

/// Whether the work on all coordinates is what a step consists of.
fn update(evidence: &Evidence<'_>) -> Option<String> {
    let share = evidence.share(Stage::Reduce) + evidence.share(Stage::Adam);
    let (all, l3) = (evidence.sizes.all(), evidence.caches[2]);
    let place = if all > l3 {
        format!("samples, moments and patches, {}, outgrow L3 ({})", size(all), size(l3))
    } else {
        format!("samples, moments and patches, {}, stay in L3 ({})", size(all), size(l3))
    };
    if share > UPDATE {
        Some(format!(
            "reduce and adam take {:.0} % of the time, whatever the number of draws; {place}: with \
             {} draws a step instead of {} they would take {:.0} %.",
            100.0 * share,
            2 * evidence.draws,
            evidence.draws,
            100.0 * share / (2.0 - share)
        ))
    } else {
        (all > l3).then(|| {
            format!(
                "{place}: each step brings all of them from memory, but reduce and adam take only \
                 {:.0} % of the time.",
                100.0 * share
            )
        })
    }
}

/// Whether threads have nothing to do.
fn waiting(evidence: &Evidence<'_>) -> Option<String> {
    let share = evidence.share(Stage::Waiting);
    let Evidence { threads, blocks, .. } = *evidence;
    let begin = format!("threads wait {:.0} % of the time", 100.0 * share);
    if share <= WAITING {
        None
    } else if blocks < threads {
        Some(format!("{begin}: the tile has blocks for {blocks} of them, but there are {threads}."))
    } else {
        Some(format!(
            "{begin}: for each other, for a processor that others use, or for what one of them \
             does alone; more draws a step or fewer threads leave less of that."
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::cache::ReuseHistogram;
    use crate::profile::roofline::{Bandwidth, RooflinePoint};
    use crate::profile::traffic::Traffic;

    const SIZES: Sizes = Sizes {
        samples: 4 << 20,
        moments: 8 << 20,
        patches: 5 << 20,
        patch: 1 << 20,
        window: 1 << 17,
    };

    const RATES: Rates = {
        let bandwidth = Bandwidth { bytes: 1 << 20, rate: 1e10, measured: true };
        Rates { threads: 2, l1: bandwidth, l2: bandwidth, memory: bandwidth, compute: 1e10 }
    };

    fn stages(shares: [f64; Stage::ALL.len()], of_roof: f64) -> Vec<StageRow> {
        let row = |(stage, share): (Stage, f64)| StageRow {
            stage: stage.name(),
            nanoseconds: share * 1e6,
            per_draw: share * 1e3,
            share,
            traffic: Traffic::default(),
            store: Store::L1,
            placement: Some(RooflinePoint {
                intensity: Some(1.0),
                attainable: 1.0,
                attained: of_roof,
                bound: Bound::Compute,
                share: of_roof,
            }),
        };
        Stage::ALL.into_iter().zip(shares).map(row).collect()
    }

    fn behaviour(arrangement: Arrangement, order: DrawOrder, misses: [f64; 3]) -> Behaviour {
        Behaviour {
            arrangement,
            order,
            draws: 1,
            lines: 1.0,
            pages: 1.0,
            ratio: 1.0,
            gather: [0.0; 3],
            scatter: misses,
            copy: [0.0; 3],
            reuse: ReuseHistogram::default(),
            measured: match arrangement {
                Arrangement::Rows => Some(400.0),
                Arrangement::Bricks => Some(500.0),
                Arrangement::Curve => Some(300.0),
                Arrangement::Linear => None,
            },
        }
    }

    fn say(stages: &[StageRow], layouts: &[Behaviour], sizes: &Sizes) -> String {
        let caches = [32 << 10, 1 << 20, 32 << 20];
        let evidence = Evidence {
            stages,
            layouts,
            sizes,
            rates: &RATES,
            caches,
            threads: 2,
            blocks: 8,
            draws: 100,
            is_simd_left_out: false,
        };
        advice(&evidence).join("\n")
    }

    #[test]
    fn the_longest_stage_is_named_with_its_roof() {
        let shares = [0.1, 0.1, 0.1, 0.4, 0.1, 0.1, 0.05, 0.05, 0.0];
        let far = say(&stages(shares, 0.2), &[], &SIZES);
        assert!(far.contains("rank takes most, 40 % of the time, at 20 %"), "{far}");
        let near = say(&stages(shares, 0.9), &[], &SIZES);
        assert!(near.contains("bound by the rate of operations (90 % of it)"), "{near}");
        assert!(!near.contains("wait") && !near.contains("outgrow"), "{near}");
        let above = say(&stages(shares, 2.0), &[], &SIZES);
        assert!(above.contains("allows for copying (200 % of it)"), "{above}");
    }

    #[test]
    fn nothing_is_bound_by_what_was_not_measured() {
        let shares = [0.1, 0.1, 0.1, 0.4, 0.1, 0.1, 0.05, 0.05, 0.0];
        let mut row = stages(shares, 0.7)[3].clone();
        let mut rates = RATES;
        rates.l1.measured = false;
        let compute = longest(&row, &rates);
        assert!(compute.contains("bound by the rate of operations (70 % of it)"), "{compute}");
        row.placement = row.placement.map(|it| RooflinePoint { bound: Bound::Memory, ..it });
        let measured = longest(&row, &RATES);
        assert!(measured.contains("bound by the bandwidth of L1 (70 % of it)"), "{measured}");
        let unknown = longest(&row, &rates);
        assert!(
            unknown.contains("at 70 % of what the bandwidth of L1 allows at least"),
            "{unknown}"
        );
    }

    #[test]
    fn waiting_is_not_work() {
        let text = say(&stages([0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.9], 0.2), &[], &SIZES);
        assert!(text.contains("draws takes most") && text.contains("wait 90 %"), "{text}");
        assert!(!text.contains("blocks"), "{text}");
        let rows = stages([0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5], 0.2);
        let caches = [1; 3];
        let (stages, layouts, sizes, rates) = (&rows[..], &[][..], &SIZES, &RATES);
        let evidence = Evidence {
            stages,
            layouts,
            sizes,
            rates,
            caches,
            threads: 8,
            blocks: 3,
            draws: 100,
            is_simd_left_out: false,
        };
        let text = advice(&evidence).join("\n");
        assert!(text.contains("blocks for 3 of them, but there are 8"), "{text}");
    }

    #[test]
    fn misses_are_told_by_the_level_that_costs_and_with_what_has_fewer() {
        let shares = [0.0, 0.3, 0.1, 0.1, 0.1, 0.3, 0.05, 0.05, 0.0];
        let rows = behaviour(Arrangement::Rows, DrawOrder::Sorted, [10.0, 8.0, 0.0]);
        // Nobody can choose a layout or an order.
        let curve = behaviour(Arrangement::Curve, DrawOrder::Sorted, [9.0, 2.0, 0.0]);
        let unsorted = behaviour(Arrangement::Rows, DrawOrder::Unsorted, [90.0, 90.0, 0.0]);
        let text = say(&stages(shares, 0.2), &[rows, curve, unsorted], &SIZES);
        assert!(text.contains("L2 misses most, 8.0 a draw, scatter the larger part"), "{text}");
        assert!(text.contains("a smaller kernel box or a smaller tile has fewer"), "{text}");
        assert!(!text.contains("curve") && !text.contains("order"), "{text}");
    }

    #[test]
    fn instructions_that_were_left_out_are_told() {
        let rows = stages([0.1; 9], 0.2);
        let evidence = |is_simd_left_out| Evidence {
            stages: &rows,
            layouts: &[],
            sizes: &SIZES,
            rates: &RATES,
            caches: [1 << 30; 3],
            threads: 2,
            blocks: 8,
            draws: 100,
            is_simd_left_out,
        };
        assert!(advice(&evidence(true)).join("\n").contains("--simd auto"));
        assert!(!advice(&evidence(false)).join("\n").contains("--simd"));
    }

    #[test]
    fn what_is_not_missed_needs_no_advice() {
        let rows = behaviour(Arrangement::Rows, DrawOrder::Sorted, [0.0; 3]);
        let unsorted = behaviour(Arrangement::Rows, DrawOrder::Unsorted, [0.0; 3]);
        let text = say(&stages([0.1; 9], 0.2), &[rows, unsorted], &SIZES);
        assert!(
            text.contains("is in the caches near the core") && !text.contains("order"),
            "{text}"
        );
    }

    #[test]
    fn what_outgrows_a_cache_is_said() {
        let large = Sizes { window: 1 << 20, moments: 64 << 20, ..SIZES };
        let text = say(&stages([0.1; 9], 0.2), &[], &large);
        assert!(text.contains("2.0 MB with its gradient, outgrows L2 (1.0 MB)"), "{text}");
        assert!(text.contains("outgrow L3 (32.0 MB): each step"), "{text}");
        let mut shares = [0.05; 9];
        (shares[6], shares[7]) = (0.3, 0.3);
        let text = say(&stages(shares, 0.2), &[], &SIZES);
        assert!(text.contains("stay in L3") && text.contains("200 draws"), "{text}");
    }
}
