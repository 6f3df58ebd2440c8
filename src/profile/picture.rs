//! The profile as a picture (SVG): the stages' shares of the time, where they stand under the
//! roofline, and how far apart the uses of a cache line are.

use std::convert::Infallible;

use plotters::coord::Shift;
use plotters::prelude::*;

use super::access::{Arrangement, Behaviour, DrawOrder};
use super::report::Profile;
use super::roofline::Store;

/// Pixels of the picture and of its panels.
const WIDTH: u32 = 960;
const BAR: u32 = 170;
const ROOFLINE: u32 = 460;
const REUSE: u32 = 380;
/// Room around the bar.
const MARGIN: i32 = 30;

/// One colour for each stage (Okabe and Ito, for all eyes), and grey for waiting.
pub(super) const COLOURS: [RGBColor; 9] = [
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 158, 115),
    RGBColor(213, 94, 0),
    RGBColor(204, 121, 167),
    RGBColor(0, 114, 178),
    RGBColor(140, 100, 60),
    RGBColor(60, 60, 60),
    RGBColor(190, 190, 190),
];

/// Why nothing is drawn.
pub(super) type PictureError = DrawingAreaErrorKind<Infallible>;

/// Draws the profile.
///
/// Pictures go to memory, so nothing can fail but what is drawn; a panel without numbers stays
/// empty.
pub fn svg(profile: &Profile) -> String {
    let mut text = String::new();
    {
        let size = (WIDTH, BAR + ROOFLINE + REUSE);
        let root = SVGBackend::with_string(&mut text, size).into_drawing_area();
        let (bar, rest) = root.split_vertically(BAR);
        let (roofline, reuse) = rest.split_vertically(ROOFLINE);
        let drawn = root
            .fill(&WHITE)
            .map_err(erase)
            .and_then(|()| stages(profile, &bar))
            .and_then(|()| roofs(profile, &roofline))
            .and_then(|()| distances(profile, &reuse))
            .and_then(|()| root.present().map_err(erase));
        debug_assert!(drawn.is_ok(), "{drawn:?}");
    }
    text
}

/// The errors of a picture in memory carry no more than their kind.
pub(super) fn erase<E: std::error::Error + Send + Sync>(
    error: DrawingAreaErrorKind<E>,
) -> PictureError {
    match error {
        DrawingAreaErrorKind::LayoutError => DrawingAreaErrorKind::LayoutError,
        _ => DrawingAreaErrorKind::SharingError,
    }
}

/// The shares of the stages as one bar, with a legend.
fn stages(profile: &Profile, area: &DrawingArea<SVGBackend, Shift>) -> Result<(), PictureError> {
    let title = format!(
        "{}, {} draws a step: {:.3} ms, threads: {}",
        profile.shape,
        profile.draws,
        profile.whole.seconds * 1e3,
        profile.threads
    );
    let font = ("sans-serif", 18).into_font();
    area.draw(&Text::new(title, (MARGIN, 14), font)).map_err(erase)?;
    let full = f64::from(WIDTH as i32 - 2 * MARGIN);
    let mut left = f64::from(MARGIN);
    for (i, (row, colour)) in profile.stages.iter().zip(COLOURS).enumerate() {
        let right = left + full * row.share;
        let corners = [(left as i32, 48), (right as i32, 92)];
        area.draw(&Rectangle::new(corners, colour.filled())).map_err(erase)?;
        left = right;
        let (x, y) = (MARGIN + (i as i32 % 5) * 180, 108 + (i as i32 / 5) * 26);
        let patch = Rectangle::new([(x, y), (x + 14, y + 14)], colour.filled());
        area.draw(&patch).map_err(erase)?;
        let label = format!("{} {:.1} %, {:.0} ns", row.stage, 100.0 * row.share, row.per_draw);
        let font = ("sans-serif", 14).into_font();
        area.draw(&Text::new(label, (x + 20, y), font)).map_err(erase)?;
    }
    Ok(())
}

/// Operations per second over operations per byte, both logarithmic.
fn roofs(profile: &Profile, area: &DrawingArea<SVGBackend, Shift>) -> Result<(), PictureError> {
    const INTENSITY: (f64, f64) = (0.02, 20.0);
    let compute = profile.rates.compute / 1e9;
    let points = profile.stages.iter().zip(COLOURS).filter_map(|(row, colour)| {
        let placement = row.placement?;
        let point = (placement.intensity?, placement.attained / 1e9);
        (point.0 > 0.0 && point.1 > 0.0).then_some((row.stage, point, colour))
    });
    let points: Vec<_> = points.collect();
    let lowest = points.iter().map(|(_, point, _)| point.1).fold(compute, f64::min);
    let floor = (lowest / 3.0).max(compute * 1e-6);
    let mut chart = ChartBuilder::on(area)
        .caption("operations under the machine's roofs", ("sans-serif", 16))
        .margin(14)
        .x_label_area_size(42)
        .y_label_area_size(60)
        .build_cartesian_2d(
            (INTENSITY.0..INTENSITY.1).log_scale(),
            (floor..compute * 2.0).log_scale(),
        )
        .map_err(erase)?;
    chart
        .configure_mesh()
        .x_desc("operations per byte moved")
        .y_desc("Gop/s of all threads")
        .y_labels(5)
        .max_light_lines(1)
        .light_line_style(RGBColor(240, 240, 240))
        .label_style(("sans-serif", 13))
        .draw()
        .map_err(erase)?;
    let stores = [("L1", Store::L1, 0), ("L2", Store::L2, 90), ("memory", Store::Memory, 170)];
    for (name, store, grey) in stores {
        let rate = profile.rates.bandwidth(store);
        let bandwidth = rate.rate / 1e9;
        let ridge = (compute / bandwidth).clamp(INTENSITY.0, INTENSITY.1);
        let roof = [INTENSITY.0, ridge, INTENSITY.1]
            .map(|intensity| (intensity, compute.min(intensity * bandwidth)));
        let style = RGBColor(grey, grey, grey).stroke_width(2);
        chart
            .draw_series(LineSeries::new(roof, style))
            .map_err(erase)?
            .label(format!("{name}: {}{bandwidth:.0} GB/s", rate.hedge()))
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], style));
    }
    let font = ("sans-serif", 14).into_font();
    for (name, point, colour) in points {
        let label = EmptyElement::at(point)
            + Circle::new((0, 0), 5, colour.filled())
            + Text::new(name, (8, -7), font.color(&colour));
        chart.draw_series([label]).map_err(erase)?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerRight)
        .background_style(WHITE.mix(0.8))
        .label_font(("sans-serif", 13))
        .draw()
        .map_err(erase)
}

/// Shares of uses of lines by their distance, with the caches' sizes.
fn distances(profile: &Profile, area: &DrawingArea<SVGBackend, Shift>) -> Result<(), PictureError> {
    let of = |order| profile.behaviour(Arrangement::Rows, order);
    let (Some(sorted), Some(unsorted)) = (of(DrawOrder::Sorted), of(DrawOrder::Unsorted)) else {
        return Ok(());
    };
    let shares = |behaviour: &Behaviour| -> Vec<f64> {
        let bins = &behaviour.reuse.bins;
        let all = behaviour.reuse.cold + bins.iter().sum::<u64>();
        bins.iter().map(|&uses| 100.0 * uses as f64 / all.max(1) as f64).collect()
    };
    let (sorted, unsorted) = (shares(sorted), shares(unsorted));
    // A cache of 2ᵏ lines has hit all bins up to and with k.
    let caches = profile.machine.caches.map(|cache| cache.geometry);
    let marks = caches.map(|level| {
        let lines = level.bytes as f64 / f64::from(level.line);
        (format!("L{}", level.level), lines.log2() + 1.0)
    });
    let last = marks.iter().map(|(_, at)| *at).fold(sorted.len() as f64, f64::max) + 1.0;
    let most = sorted.iter().chain(&unsorted).copied().fold(1.0, f64::max) * 1.15;
    let mut chart = ChartBuilder::on(area)
        .caption("uses of a cache line by lines used in between, rows", ("sans-serif", 16))
        .margin(14)
        .x_label_area_size(42)
        .y_label_area_size(60)
        .build_cartesian_2d(0.0..last, 0.0..most)
        .map_err(erase)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .x_desc("lines used in between")
        .y_desc("% of uses")
        .x_labels(12)
        .x_label_formatter(&|bin| match bin {
            1.0.. => format!("2^{:.0}", bin - 1.0),
            _ => "0".into(),
        })
        .max_light_lines(1)
        .light_line_style(RGBColor(240, 240, 240))
        .label_style(("sans-serif", 13))
        .draw()
        .map_err(erase)?;
    let bars = sorted.iter().enumerate().map(|(bin, &share)| {
        let left = bin as f64;
        Rectangle::new([(left + 0.08, 0.0), (left + 0.92, share)], COLOURS[1].filled())
    });
    chart
        .draw_series(bars)
        .map_err(erase)?
        .label("sorted draws")
        .legend(|(x, y)| Rectangle::new([(x, y - 5), (x + 14, y + 5)], COLOURS[1].filled()));
    let steps = unsorted.iter().enumerate().map(|(bin, &share)| (bin as f64 + 0.5, share));
    chart
        .draw_series(LineSeries::new(steps, COLOURS[3].stroke_width(2)))
        .map_err(erase)?
        .label("unsorted draws")
        .legend(|(x, y)| PathElement::new([(x, y), (x + 14, y)], COLOURS[3].stroke_width(2)));
    for (name, at) in marks {
        let line = [(at, 0.0), (at, most)];
        chart.draw_series(LineSeries::new(line, BLACK.mix(0.6))).map_err(erase)?;
        let font = ("sans-serif", 14).into_font();
        chart.draw_series([Text::new(name, (at + 0.1, most * 0.97), font)]).map_err(erase)?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::Coordinate(130, 6))
        .background_style(WHITE.mix(0.8))
        .label_font(("sans-serif", 13))
        .draw()
        .map_err(erase)
}
