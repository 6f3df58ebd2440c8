//! How tiles scale as a picture (SVG): speed-up against ranks.

use plotters::prelude::*;

use super::report::{Scaling, ScalingTable};
use crate::profile::picture::{COLOURS, PictureError, erase};

/// Pixels of the picture.
const SIZE: (u32, u32) = (860, 620);

/// Draws the speed-up of each tile, as it is, with the ideal.
///
/// Pictures go to memory, so nothing can fail but what is drawn.
pub fn svg(scaling: &Scaling) -> String {
    let mut text = String::new();
    let drawn = draw(scaling, &mut text);
    debug_assert!(drawn.is_ok(), "{drawn:?}");
    text
}

/// Ranks and speed-up.
fn points(table: &ScalingTable) -> Vec<(f64, f64)> {
    let steps = table.rows.iter().filter_map(|row| Some((row.ranks, row.step?.speedup)));
    steps.map(|(ranks, speedup)| (ranks as f64, speedup)).collect()
}

fn draw(scaling: &Scaling, text: &mut String) -> Result<(), PictureError> {
    let root = SVGBackend::with_string(text, SIZE).into_drawing_area();
    root.fill(&WHITE).map_err(erase)?;
    let most = (scaling.cluster.ranks as f64).max(2.0);
    let lines: Vec<_> = scaling.tiles.iter().map(|tile| (tile, points(&tile.strong))).collect();
    let all = lines.iter().flat_map(|(_, points)| points);
    let lowest = all.map(|&(_, speedup)| speedup).fold(1.0, f64::min);
    let caption =
        format!("speed-up of a step, ranks of {} threads (predicted)", scaling.cluster.threads);
    let mut chart = ChartBuilder::on(&root)
        .caption(caption, ("sans-serif", 18))
        .margin(14)
        .x_label_area_size(42)
        .y_label_area_size(60)
        .build_cartesian_2d(
            (1.0..most).log_scale().base(2.0),
            (lowest * 0.8..most * 1.2).log_scale().base(2.0),
        )
        .map_err(erase)?;
    chart
        .configure_mesh()
        .x_desc("ranks")
        .y_desc("speed-up over one rank")
        .x_label_formatter(&f64::to_string)
        .y_label_formatter(&f64::to_string)
        .max_light_lines(1)
        .light_line_style(RGBColor(240, 240, 240))
        .label_style(("sans-serif", 13))
        .draw()
        .map_err(erase)?;
    let ideal = BLACK.mix(0.5).stroke_width(1);
    chart
        .draw_series(LineSeries::new([(1.0, 1.0), (most, most)], ideal))
        .map_err(erase)?
        .label("ideal")
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], ideal));
    for ((tile, points), colour) in lines.into_iter().zip(COLOURS.into_iter().skip(1).cycle()) {
        let style = colour.stroke_width(2);
        let marks = points.iter().map(|&point| Circle::new(point, 3, colour.filled()));
        chart.draw_series(marks).map_err(erase)?;
        chart
            .draw_series(LineSeries::new(points, style))
            .map_err(erase)?
            .label(tile.shape.to_string())
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 14, y)], style));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.8))
        .label_font(("sans-serif", 13))
        .draw()
        .map_err(erase)?;
    root.present().map_err(erase)
}
