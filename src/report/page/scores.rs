//! The scores as tables. Every number carries where it stands in the JSON of
//! `perceptile evaluate`: `data-tile` is the tile's name there, `data-score` a JSON pointer into
//! its entry, `data-value` the number in full.

use maud::{Markup, html};

use super::super::ReportOptions;
use super::super::card::Card;
use crate::metric::{
    Class, ClassScore, Coordinates, Ratio, ScoredTile, Scores, ShownScore, digits,
};

/// One figure of a whole tile.
type WholeFigure = fn(&Scores) -> f64;

/// The figures of a whole tile: heading, pointer within its scores, value.
const WHOLE: [(&str, &str, WholeFigure); 5] = [
    ("bias·√N", "bias", |scores| scores.bias),
    ("lowest cell", "histogram/smallest", |scores| scores.histogram.smallest),
    ("highest cell", "histogram/largest", |scores| scores.histogram.largest),
    ("histogram rms", "histogram/rms", |scores| scores.histogram.rms),
    ("residual", "residual", |scores| scores.residual),
];

/// One ratio of a class's scores, if the tile has it.
type Measure = fn(&ClassScore) -> Option<Ratio>;

/// The ratios of a class: heading, field, value.
const MEASURES: [(&str, &str, Measure); 4] = [
    ("perceived", "perceived", |class| Some(class.perceived)),
    ("half a period", "half_period", |class| class.half_period),
    ("whole period", "whole_period", |class| Some(class.whole_period)),
    ("whole period, perceived", "whole_period_perceived", |class| class.whole_period_perceived),
];

/// What comes of it all, in one line: the error on edges, which tells tiles apart best.
pub(super) fn verdict(cards: &[Card]) -> Markup {
    let edge = |card: &Card| {
        let scores = &card.entry.scores;
        let found = scores.class(Class::Edge, Coordinates::All)?.perceived;
        let pointer =
            format!("/scores/{}/perceived/mean", place(scores, Class::Edge, Coordinates::All));
        Some(number(&card.entry, &pointer, found.mean))
    };
    let read = cards.iter().filter(|card| card.entry.path.is_some());
    html! {
        p.verdict {
            @for (i, card) in read.enumerate() {
                @if let Some(edge) = edge(card) {
                    @if i > 0 { ", " }
                    strong { (card.title) } " has " (edge)
                }
            }
            " of white noise’s perceived error on edges."
        }
    }
}

/// The scores of all tiles.
pub(super) fn section(options: &ReportOptions, cards: &[Card]) -> Markup {
    let columns = cards
        .iter()
        .map(|card| Coordinates::of(card.entry.scores.options.domain, card.entry.shape.dims()));
    let columns = columns.max_by_key(|columns| columns.len()).unwrap_or(&[]);
    let [first, others @ ..] = ShownScore::ALL;
    html! {
        section aria-labelledby="scores" {
            h2 #scores { "Scores" }
            p {
                "Relative to white noise that is new in every frame, which has 1; lower is better. "
                @if cards.iter().any(|card| card.is_repeated_noise) {
                    "The kernel sees more frames than a tile has: samples that it meets again add \
                     error, so the tile of white noise has more than 1. "
                }
                (options.scores.integrands) " functions of each class, set " (options.scores.set)
                "; ± is the standard error over them. The best of each column is bold. "
                a href="#help" { "What they mean" } "."
            }
            (table(first, Coordinates::All, true, cards))
            @if columns.contains(&Coordinates::Pairs) {
                (table(first, Coordinates::Pairs, false, cards))
            }
            details {
                summary { "After rounding to 8 and 16 bits, and accumulated over time" }
                @for &coordinates in columns {
                    @for part in others { (table(part, coordinates, false, cards)) }
                }
            }
        }
    }
}

/// One score of all tiles that have it.
fn table(part: ShownScore, coordinates: Coordinates, whole: bool, cards: &[Card]) -> Markup {
    let ratio =
        |card: &Card, class| (part.ratio)((part.scores)(&card.entry).class(class, coordinates)?);
    let rows: Vec<&Card> =
        cards.iter().filter(|card| ratio(card, Class::ALL[0]).is_some()).collect();
    let compared = rows.len() > 1;
    let best_of = |value: &dyn Fn(&Card) -> f64| {
        rows.iter().map(|card| value(card)).fold(f64::INFINITY, f64::min)
    };
    let mean = |card: &Card, class| ratio(card, class).map_or(f64::INFINITY, |ratio| ratio.mean);
    let domain = rows.first().map(|card| card.entry.scores.options.domain);
    let classes = Class::of(domain.unwrap_or_default());
    let bests = classes.iter().map(|&class| best_of(&|card| mean(card, class)));
    let name = if coordinates == Coordinates::Pairs {
        format!("{}, random pairs of dimensions", part.title)
    } else {
        part.title.to_owned()
    };
    html! {
        @if !rows.is_empty() {
            div.scroll tabindex="0" role="region" aria-label={ "Table: " (name) } {
                table {
                    caption { (capitalized(&name)) }
                    thead {
                        tr {
                            th scope="col" { "Tile" }
                            @for class in classes { th scope="col" { (class.to_string()) } }
                            @if whole {
                                @for (heading, _, _) in WHOLE { th scope="col" { (heading) } }
                            }
                        }
                    }
                    tbody {
                        @for &card in &rows {
                            @let scores = (part.scores)(&card.entry);
                            tr {
                                th scope="row" {
                                    (card.title)
                                    @if card.is_repeated_noise {
                                        ", " (card.entry.shape.frames()) " frames repeated"
                                    }
                                }
                                @for (&class, best) in classes.iter().zip(bests.clone()) {
                                    @if let Some(found) = ratio(card, class) {
                                        @let place = place(scores, class, coordinates);
                                        @let pointer =
                                            format!("/{}/{place}/{}", part.field, part.measure);
                                        td.best[compared && found.mean == best] {
                                            (ratio_cell(&card.entry, &pointer, found))
                                        }
                                    }
                                }
                                @if whole {
                                    @for (_, pointer, value) in WHOLE {
                                        td {
                                            (number(
                                                &card.entry,
                                                &format!("/{}/{pointer}", part.field),
                                                value(scores),
                                            ))
                                        }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// All scores of one tile.
pub(super) fn of_tile(entry: &ScoredTile) -> Markup {
    let fields = [
        ("As it is", "scores", &entry.scores),
        ("After rounding to 8 bits", "after_8_bits", &entry.after_8_bits),
        ("After rounding to 16 bits", "after_16_bits", &entry.after_16_bits),
    ];
    html! {
        @for (title, field, scores) in fields {
            div.scroll tabindex="0" role="region" aria-label={ "Table: " (title) ", " (entry.name) } {
                table {
                    caption { (title) }
                    thead {
                        tr {
                            th scope="col" { "Functions" }
                            @for (heading, _, _) in MEASURES { th scope="col" { (heading) } }
                            th scope="col" { "bias·√N" }
                        }
                    }
                    tbody {
                        @for (i, class) in scores.classes.iter().enumerate() {
                            @let pairs = class.coordinates == Coordinates::Pairs;
                            tr {
                                th scope="row" {
                                    (class.class.to_string()) @if pairs { ", random pairs" }
                                }
                                @for (_, measure, ratio) in MEASURES {
                                    td {
                                        @if let Some(found) = ratio(class) {
                                            @let pointer = format!("/{field}/classes/{i}/{measure}");
                                            (ratio_cell(entry, &pointer, found))
                                        } @else { "–" }
                                    }
                                }
                                td {
                                    (number(entry, &format!("/{field}/classes/{i}/bias"), class.bias))
                                }
                            }
                        }
                    }
                }
            }
            dl.facts {
                @for (heading, pointer, value) in WHOLE {
                    dt { (heading) }
                    dd { (number(entry, &format!("/{field}/{pointer}"), value(scores))) }
                }
            }
        }
    }
}

/// Where a class's scores stand.
fn place(scores: &Scores, class: Class, coordinates: Coordinates) -> String {
    let same = |score: &ClassScore| score.class == class && score.coordinates == coordinates;
    format!("classes/{}", scores.classes.iter().position(same).unwrap_or(0))
}

fn ratio_cell(entry: &ScoredTile, pointer: &str, ratio: Ratio) -> Markup {
    html! {
        (number(entry, &format!("{pointer}/mean"), ratio.mean)) " "
        small {
            "±" (shown(entry, &format!("{pointer}/standard_error"), ratio.standard_error, 1))
        }
    }
}

fn number(entry: &ScoredTile, pointer: &str, value: f64) -> Markup {
    shown(entry, pointer, value, 3)
}

/// A number with so many significant digits.
fn shown(entry: &ScoredTile, pointer: &str, value: f64, significant: i32) -> Markup {
    html! {
        span data-tile=(entry.name) data-score=(pointer) data-value=(value.to_string()) {
            (digits(value, significant))
        }
    }
}

fn capitalized(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
