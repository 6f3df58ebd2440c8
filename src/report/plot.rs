//! Line plots as SVG inside the page, so that they follow its theme.
//!
//! Colours come from the page's style (`s0` to `s7`), and each series has dashes of its own as
//! well: no one has to know colours apart.

use maud::{Markup, html};

/// Size of a plot and of the room for labels, in units of the drawing.
const WIDTH: f64 = 560.0;
const HEIGHT: f64 = 320.0;
const LEFT: f64 = 76.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 46.0;
/// Colours that the style has.
const COLOURS: usize = 8;

/// A plot of numbers from −1e30 to 1e30.
#[derive(Debug, Clone)]
pub(super) struct Plot {
    pub title: String,
    pub x: PlotAxis,
    pub y: PlotAxis,
    pub series: Vec<PlotLine>,
}

/// One of its axes.
#[derive(Debug, Clone)]
pub(super) struct PlotAxis {
    pub label: String,
    pub log: bool,
    /// Values that it shows whatever the lines are.
    pub shows: Vec<f64>,
}

/// One of its lines.
#[derive(Debug, Clone, Default)]
pub(super) struct PlotLine {
    pub name: String,
    pub points: Vec<[f64; 2]>,
    /// Lowest and highest value at each point, drawn as a band.
    pub band: Vec<[f64; 2]>,
}

/// A range of values and where they are drawn.
struct Scale {
    log: bool,
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Scale {
    /// Holds all values that the axis can show.
    fn new(log: bool, values: impl Iterator<Item = f64>, [from, to]: [f64; 2]) -> Self {
        let shown = values.filter(|value| !log || *value > 0.0);
        let (mut low, mut high) = shown
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        if low > high {
            (low, high) = (if log { 0.1 } else { 0.0 }, 1.0);
        }
        if log && high / low < 1.0 + 1e-9 {
            (low, high) = (low / 2.0, high * 2.0);
        } else if !log && high - low <= 1e-12 * high.abs().max(low.abs()) {
            let room = if high == 0.0 { 1.0 } else { high.abs() / 2.0 };
            (low, high) = (low - room, high + room);
        }
        Self { log, low, high, from, to }
    }

    fn at(&self, value: f64) -> f64 {
        let part = if self.log {
            let low = libm::log(self.low);
            (libm::log(value.max(self.low * 1e-3)) - low) / (libm::log(self.high) - low)
        } else {
            (value - self.low) / (self.high - self.low)
        };
        self.from + part.clamp(-0.5, 1.5) * (self.to - self.from)
    }

    /// Values to mark, about `count` of them.
    fn ticks(&self, count: usize) -> Vec<f64> {
        if self.log {
            log_ticks(self.low, self.high, count)
        } else {
            linear_ticks(self.low, self.high, count)
        }
    }
}

/// Multiples of 1, 2 or 5 times a power of ten within a range.
fn linear_ticks(low: f64, high: f64, count: usize) -> Vec<f64> {
    let rough = (high - low) / count.max(1) as f64;
    let power = libm::pow(10.0, libm::floor(libm::log10(rough)));
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().find(|step| step * power >= rough * (1.0 - 1e-9));
    let step = step.unwrap_or(10.0) * power;
    let (first, last) = ((low / step - 1e-9).ceil(), (high / step + 1e-9).floor());
    // A range far from 0 can be too narrow for its digits.
    let steps = (last - first).clamp(0.0, 2.0 * count as f64 + 2.0) as usize;
    (0..=steps).map(|i| (first + i as f64) * step).collect()
}

/// Powers of ten within a range, thinned out if there are many; with their double and fivefold if
/// there are few. A range that is too narrow for that is marked as a linear one.
fn log_ticks(low: f64, high: f64, count: usize) -> Vec<f64> {
    let inside = |tick: &f64| *tick >= low * (1.0 - 1e-9) && *tick <= high * (1.0 + 1e-9);
    let (first, last) =
        (libm::floor(libm::log10(low)) as i32, libm::ceil(libm::log10(high)) as i32);
    // The nearest number to 10^n, which a product of tenths would miss.
    let power = |n: i32| format!("1e{n}").parse::<f64>().unwrap_or(f64::NAN);
    let with = |factors: &[f64]| -> Vec<f64> {
        let powers = (first..=last).flat_map(|n| factors.iter().map(move |f| f * power(n)));
        powers.filter(inside).collect()
    };
    let decades = with(&[1.0]);
    if decades.len() > count {
        return decades.iter().copied().step_by(decades.len().div_ceil(count)).collect();
    }
    let finer = with(&[1.0, 2.0, 5.0]);
    match finer.len() {
        _ if decades.len() > 3 => decades,
        0..3 => linear_ticks(low, high, count).into_iter().filter(|tick| *tick > 0.0).collect(),
        _ => finer,
    }
}

/// A number as an axis shows it: no digits of rounding, and powers of ten where it is far from 1.
fn label(value: f64) -> String {
    let rounded: f64 = format!("{value:.6e}").parse().unwrap_or(value);
    if rounded != 0.0 && !(1e-4..1e6).contains(&rounded.abs()) {
        format!("{rounded:e}").replace('-', "−")
    } else {
        format!("{rounded}").replace('-', "−")
    }
}

/// A place in the drawing, to a tenth of its unit.
fn place(x: f64) -> String {
    format!("{:.1}", x + 0.0)
}

/// A line through places.
fn path(points: impl Iterator<Item = [f64; 2]>) -> String {
    let mut text = String::new();
    for (i, [x, y]) in points.enumerate() {
        text += if i == 0 { "M" } else { "L" };
        text += &format!("{} {}", place(x), place(y));
    }
    text
}

impl Plot {
    /// The drawing with its legend. `id` is used for no other plot of the page.
    pub fn markup(&self, id: &str) -> Markup {
        let points = || self.series.iter().flat_map(|series| &series.points);
        let bands = || self.series.iter().flat_map(|series| series.band.iter().flatten().copied());
        let shows = |axis: &PlotAxis| axis.shows.clone().into_iter();
        let values = points().map(|p| p[0]).chain(shows(&self.x));
        let x = Scale::new(self.x.log, values, [LEFT, WIDTH - RIGHT]);
        let values = points().map(|p| p[1]).chain(bands()).chain(shows(&self.y));
        let y = Scale::new(self.y.log, values, [HEIGHT - BOTTOM, TOP]);
        let names: Vec<&str> = self.series.iter().map(|series| series.name.as_str()).collect();
        let clip = format!("{id}-clip");
        html! {
            figure.plot {
                figcaption { (self.title) }
                div.scroll tabindex="0" role="region" aria-label={ "Plot: " (self.title) } {
                    svg viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } role="img"
                        aria-labelledby={ (id) "-title " (id) "-desc" } {
                        title id={ (id) "-title" } { (self.title) }
                        desc id={ (id) "-desc" } {
                            (self.y.label) " against " (self.x.label) ": " (names.join(", ")) ". "
                            (self.summary())
                        }
                        clipPath id=(clip) {
                            rect x=(LEFT) y=(TOP) width=(WIDTH - LEFT - RIGHT)
                                height=(HEIGHT - TOP - BOTTOM) {}
                        }
                        @for tick in x.ticks(7) {
                            @let at = place(x.at(tick));
                            path.grid d={ "M" (at) " " (TOP) "V" (HEIGHT - BOTTOM) } {}
                            text x=(at) y=(HEIGHT - BOTTOM + 18.0) text-anchor="middle" {
                                (label(tick))
                            }
                        }
                        @for tick in y.ticks(6) {
                            @let at = y.at(tick);
                            path.grid d={ "M" (LEFT) " " (place(at)) "H" (WIDTH - RIGHT) } {}
                            text x=(LEFT - 8.0) y=(place(at + 4.0)) text-anchor="end" {
                                (label(tick))
                            }
                        }
                        text x=(place((LEFT + WIDTH - RIGHT) / 2.0)) y=(HEIGHT - 8.0)
                            text-anchor="middle" { (self.x.label) }
                        text transform={ "translate(14 " (place((TOP + HEIGHT - BOTTOM) / 2.0)) ") rotate(-90)" }
                            text-anchor="middle" { (self.y.label) }
                        g clip-path={ "url(#" (clip) ")" } {
                            @for (i, series) in self.series.iter().enumerate() {
                                @if !series.band.is_empty() {
                                    path class={ "band s" (i % COLOURS) }
                                        d={ (band(series, &x, &y)) "Z" } {}
                                }
                            }
                            @for (i, series) in self.series.iter().enumerate() {
                                path class={ "line s" (i % COLOURS) } d=(path(
                                    series.points.iter().map(|&[a, b]| [x.at(a), y.at(b)])
                                )) {}
                            }
                        }
                    }
                }
                ul.legend {
                    @for (i, series) in self.series.iter().enumerate() {
                        li {
                            svg viewBox="0 0 34 8" width="34" height="8" aria-hidden="true" {
                                path class={ "line s" (i % COLOURS) } d="M1 4H33" {}
                            }
                            (series.name)
                        }
                    }
                }
            }
        }
    }

    /// First and last value of each series, for those who do not see the lines.
    fn summary(&self) -> String {
        let ends = |series: &PlotLine| {
            let (first, last) = (series.points.first()?, series.points.last()?);
            Some(format!("{} from {} to {}", series.name, label(first[1]), label(last[1])))
        };
        let ends: Vec<String> = self.series.iter().filter_map(ends).collect();
        if ends.is_empty() { "No values.".to_owned() } else { ends.join("; ") + "." }
    }
}

/// The outline of a band: along its lower side and back along the upper one.
fn band(series: &PlotLine, x: &Scale, y: &Scale) -> String {
    let side = |which: usize| {
        let at = |(point, band): (&[f64; 2], &[f64; 2])| [x.at(point[0]), y.at(band[which])];
        series.points.iter().zip(&series.band).map(at).collect::<Vec<_>>()
    };
    path(side(0).into_iter().chain(side(1).into_iter().rev()))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        assert_eq!(linear_ticks(0.0, 1.0, 5), [0.0, 0.2, 0.4, 0.6000000000000001, 0.8, 1.0]);
        assert_eq!(linear_ticks(-3.0, 12.0, 6), [0.0, 5.0, 10.0]);
        assert_eq!(log_ticks(1e-4, 2.0, 6), [1e-4, 1e-3, 1e-2, 0.1, 1.0]);
        assert_eq!(log_ticks(0.3, 4.0, 6), [0.5, 1.0, 2.0]);
        assert_eq!(log_ticks(1e-9, 1e3, 6), [1e-9, 1e-6, 1e-3, 1.0, 1e3]);
        assert_eq!(log_ticks(0.52, 0.64, 4), [0.55, 0.6000000000000001]);
    }

    #[test]
    fn labels_are_short() {
        for (value, text) in [
            (0.0, "0"),
            (0.6000000000000001, "0.6"),
            (-2.5, "−2.5"),
            (1e-7, "1e−7"),
            (5e6, "5e6"),
            (250.0, "250"),
        ] {
            assert_eq!(label(value), text);
        }
    }

    fn plot(log: bool, series: Vec<PlotLine>) -> String {
        let axis = |log| PlotAxis { label: "<x>".into(), log, shows: vec![] };
        Plot { title: "A & B".into(), x: axis(false), y: axis(log), series }
            .markup("p")
            .into_string()
    }

    #[test]
    fn lines_go_through_their_points() {
        let points = vec![[0.0, 0.01], [1.0, 0.1], [2.0, 1.0]];
        let band = vec![[0.005, 0.02], [0.05, 0.2], [0.5, 2.0]];
        let text =
            plot(true, vec![PlotLine { name: "one".into(), points: points.clone(), band: vec![] }]);
        // Equal steps of the logarithm are equal steps of the drawing.
        assert!(text.contains("d=\"M76.0 274.0L310.0 143.0L544.0 12.0\""), "{text}");
        assert!(text.contains("&lt;x&gt;") && text.contains("A &amp; B") && !text.contains("<x>"));
        assert!(!text.contains("class=\"band"));
        let text = plot(true, vec![PlotLine { name: "one".into(), points, band }]);
        assert!(text.contains("class=\"band s0\""));
    }

    /// Numbers of all sizes that plots may have.
    fn number() -> impl Strategy<Value = f64> {
        prop_oneof![
            (-1.0..1.0_f64, -30..=30_i32).prop_map(|(x, n)| x * 10.0_f64.powi(n)),
            Just(0.0),
            Just(1.0),
        ]
    }

    proptest! {
        #[test]
        fn any_numbers_make_a_plot(
            points in prop::collection::vec([number(), number()], 0..20), log: bool,
        ) {
            let series = PlotLine { name: "s".into(), band: points.clone(), points };
            let text = plot(log, vec![series]);
            prop_assert!(!text.contains("NaN") && !text.contains("inf"), "{}", text);
            prop_assert!(text.matches("<text").count() < 60);
        }

        #[test]
        fn ticks_are_few_and_in_range(low in -1e6..1e6_f64, width in 1e-3..1e6_f64) {
            for (low, high, ticks) in [
                (low, low + width, linear_ticks(low, low + width, 6)),
                (width, width * (1.5 + low.abs()), log_ticks(width, width * (1.5 + low.abs()), 6)),
            ] {
                prop_assert!((2..=12).contains(&ticks.len()), "{:?}", ticks);
                let room = 1e-6 * (high - low);
                prop_assert!(ticks.iter().all(|t| (low - room..=high + room).contains(t)));
                prop_assert!(ticks.is_sorted());
            }
        }
    }
}
