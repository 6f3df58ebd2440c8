//! What the page says of one tile.

use maud::{Markup, html};

use super::super::card::{Card, Shown};
use super::super::names::{file_name, without_folders};
use super::super::pictures::{FULL, MOST};
use super::super::plot::{Plot, PlotAxis, PlotLine};
use super::super::provenance::{Match, Provenance};
use super::{command, scores, zoom};
use crate::format::sidecar::Sidecar;
use crate::metric::figure;

/// Histograms of pairs that are shown without asking for more.
const PAIRS: usize = 6;

/// Everything about one tile.
pub(super) fn article(number: usize, card: &Card) -> Markup {
    let shape = card.entry.shape;
    let factor = zoom(shape.width().max(shape.frames()), shape.height().max(shape.frames()));
    let large = shape.width().max(shape.height()).max(shape.frames()) > MOST;
    html! {
        article.tile #{ "tile-" (number) } aria-labelledby={ "tile-" (number) "-name" } {
            h3 #{ "tile-" (number) "-name" } { (card.title) }
            p.muted {
                (shape.to_string())
                @if let Some(path) = &card.entry.path { ", " code { (file_name(path)) } }
            }
            h4 { "Samples" }
            @if large {
                p.muted { "Only the upper left " (MOST) " pixels or frames are shown." }
            }
            div.pictures {
                @for (slice, caption) in card.slices.iter().zip([
                    "A frame (time 0)",
                    "An XT slice: the first row of every frame, time down",
                    "A YT slice: the first column of every frame, time across",
                ]) {
                    figure { (pixels(slice, factor, caption, &card.title)) figcaption { (caption) } }
                }
            }
            div.columns {
                div { (histograms(number, card)) }
                div {
                    @if let Some(plot) = convergence(card) {
                        h4 { "Convergence" }
                        p.muted {
                            "How far the samples of a draw were from even when a step began; lower \
                             is better. The polish and the uniformity step come after it."
                        }
                        (plot.markup(&format!("convergence-{number}")))
                    }
                    h4 { "Where it comes from" }
                    (provenance(number, card))
                }
            }
            details {
                summary { "All scores of " (card.title) }
                (scores::of_tile(&card.entry))
            }
        }
    }
}

/// A picture whose pixels stay squares.
fn pixels(shown: &Shown, factor: usize, caption: &str, title: &str) -> Markup {
    html! {
        div.scroll tabindex="0" role="region" aria-label={ (caption) ", " (title) } {
            img.pixels src=(shown.file) width=(shown.width) height=(shown.height) loading="lazy"
                alt={ (caption) " of " (title) }
                style={ "width:" (shown.width * factor) "px" };
        }
    }
}

/// How the descent went, if the tile's provenance says so.
fn convergence(card: &Card) -> Option<Plot> {
    let Provenance::Known(sidecar, _) = &card.provenance else { return None };
    let curve = &sidecar.convergence;
    (curve.len() > 1).then(|| Plot {
        title: format!("{}: mean transport cost of a draw", card.title),
        x: PlotAxis { label: "step".into(), log: true, shows: vec![1.0] },
        y: PlotAxis { label: "mean W₂² of a draw".into(), log: true, shows: Vec::new() },
        series: vec![PlotLine {
            name: "single steps".into(),
            points: curve.iter().map(|&(step, objective)| [step.into(), objective]).collect(),
            band: Vec::new(),
        }],
    })
}

fn histograms(number: usize, card: &Card) -> Markup {
    let (first, more) = card.pairs.split_at(card.pairs.len().min(PAIRS));
    let domain = card.entry.scores.options.domain;
    let percent = format!("{:.0}", 100.0 * FULL);
    html! {
        h4 { "Histograms" }
        p.muted {
            "Share of the samples in each cell, relative to an even share. Gray is even, blue is \
             less, orange is more; full colour is " (percent) " % off."
            @if !domain.is_square() {
                " Samples of the " (domain.to_string()) " stand where an equal-area map from the \
                 square has them; the viewer shows functions of these places."
            }
        }
        div.pictures.heat { @for pair in first { (heat(pair, &card.title)) } }
        @if !more.is_empty() {
            details {
                summary { "The other " (more.len()) " pairs of dimensions" }
                div.pictures.heat { @for pair in more { (heat(pair, &card.title)) } }
            }
        }
        (Plot {
            title: format!("{}: histogram of each coordinate", card.title),
            x: PlotAxis { label: "coordinate".into(), log: false, shows: vec![0.0, 1.0] },
            y: PlotAxis {
                label: "share, even is 1".into(),
                log: false,
                shows: vec![1.0 - FULL, 1.0 + FULL],
            },
            series: card.marginals.clone(),
        }
        .markup(&format!("marginals-{number}")))
    }
}

fn heat((histogram, shown): &(crate::metric::PairHistogram, Shown), title: &str) -> Markup {
    let (i, j) = histogram.dims;
    let name =
        if i == j { format!("dimension {i}") } else { format!("dimensions {i} (across) and {j}") };
    let figures = histogram.figures();
    html! {
        figure {
            img.pixels src=(shown.file) width=(shown.width) height=(shown.height) loading="lazy"
                alt={ "Histogram of " (name) " of " (title) }
                style={ "width:" (shown.width * 8) "px" };
            figcaption {
                (name) br; "least " (figure(figures.smallest)) ", most " (figure(figures.largest))
                ", rms " (figure(figures.rms))
            }
        }
    }
}

fn provenance(number: usize, card: &Card) -> Markup {
    match &card.provenance {
        Provenance::Comparison => html! {
            p { "Made for this comparison, in the shape of the first tile." }
        },
        Provenance::Unknown => html! {
            p { "There is no sidecar beside this tile: where it comes from is not known." }
        },
        Provenance::Unreadable(error) => html! {
            p { "The sidecar beside this tile cannot be used: " (error) "." }
        },
        Provenance::Known(sidecar, same) => known(number, sidecar, *same),
    }
}

fn known(number: usize, sidecar: &Sidecar, same: Match) -> Markup {
    let verdict = match same {
        Match::Same => "the file still matches",
        Match::Other => "the file does not match: it is not the tile that this describes",
        Match::Unread => "the file could not be read again",
    };
    html! {
        dl.facts {
            dt { "Made by" }
            dd { (sidecar.program) " " (sidecar.version) }
            dt { "Finished" }
            dd { (sidecar.created) ", after " (figure(sidecar.seconds)) " s" }
            dt { "Kernel" }
            dd { code { (without_folders(&sidecar.kernel)) } }
            dt { "Seed" }
            dd { (sidecar.seed) }
            dt { "SHA-256" }
            dd { code { (sidecar.sha256) } br; strong { (verdict) } }
        }
        p.muted { "The command that makes it again:" }
        (command(&format!("tile-{number}-command"), &without_folders(&sidecar.command)))
    }
}
