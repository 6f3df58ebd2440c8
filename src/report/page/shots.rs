//! What was rendered with the tiles: scenes, tables, plots and figures of `renders.json`.

use maud::{Markup, html};

use super::super::plot::{Plot, PlotAxis, PlotLine};
use super::super::renders::{
    CurveData, Curves, Figure, Renders, Scene, TableCell, TableData, place,
};
use super::{command, data};
use crate::metric::figure;

/// Everything about the renders.
pub(super) fn section(renders: &Renders) -> Markup {
    html! {
        section aria-labelledby="renders" {
            h2 #renders { (renders.title) }
            @if !renders.note.is_empty() { p { (renders.note) } }
            dl.facts {
                dt { "Machine" }
                dd { (renders.machine) }
            }
            p.muted { "The command that makes them again:" }
            (command("renders-command", &renders.command))
            @for table in &renders.tables { (table_markup(table)) }
            @for (i, plot) in renders.plots.iter().enumerate() { (plot_markup(i, plot)) }
            @if !renders.scenes.is_empty() {
                h3 { "Scenes" }
                section #scenes aria-label="Scenes" {
                    @for scene in &renders.scenes { (scene_markup(scene)) }
                }
                (data("scenes-data", &renders.scenes.iter().map(placed).collect::<Vec<_>>()))
            }
            @for figure in &renders.figures { (figure_markup(figure, renders)) }
        }
    }
}

/// The scene with its pictures where the report has them.
fn placed(scene: &Scene) -> Scene {
    let mut scene = scene.clone();
    let files = scene.pictures.iter_mut().map(|picture| &mut picture.file);
    files.chain(&mut scene.reference).for_each(|file| *file = place(file));
    scene
}

fn scene_markup(scene: &Scene) -> Markup {
    let shot = |name: &str, file: &str, note: Markup| {
        html! {
            div.shot {
                img src=(place(file)) width=(scene.width) height=(scene.height) loading="lazy"
                    alt={ (scene.name) ", " (name) };
                p { (name) (note) }
            }
        }
    };
    html! {
        figure.scene {
            figcaption {
                strong { (scene.name) }
                @if !scene.caption.is_empty() { ": " (scene.caption) }
            }
            div.scroll tabindex="0" role="region" aria-label={ "Pictures of " (scene.name) } {
                div.shots {
                    @for picture in &scene.pictures {
                        (shot(&format!("{}, {}", picture.name, picture.view), &picture.file, html! {
                            br; small {
                                (figure(picture.value)) " (" (figure(picture.ratio)) " of white noise)"
                            }
                        }))
                    }
                    @if let Some(reference) = &scene.reference {
                        (shot("Reference", reference, html! {}))
                    }
                }
            }
        }
    }
}

fn table_markup(table: &TableData) -> Markup {
    let cell = |cell: &TableCell| match cell {
        TableCell::Text(text) => html! { (text) },
        TableCell::Marked(marked) if marked.strong => html! { strong { (marked.text) } },
        TableCell::Marked(marked) => html! { (marked.text) },
    };
    html! {
        div.scroll tabindex="0" role="region" aria-label={ "Table: " (table.title) } {
            table {
                caption { (table.title) }
                thead { tr { @for column in &table.columns { th scope="col" { (column) } } } }
                tbody {
                    @for row in &table.rows {
                        tr {
                            @for (i, content) in row.iter().enumerate() {
                                @if i == 0 {
                                    th scope="row" { (cell(content)) }
                                } @else {
                                    td { (cell(content)) }
                                }
                            }
                        }
                    }
                }
            }
        }
        @if !table.caption.is_empty() { p.muted { (table.caption) } }
    }
}

fn plot_markup(number: usize, plot: &Curves) -> Markup {
    let axis = |label: &String, log| PlotAxis { label: label.clone(), log, shows: Vec::new() };
    let pair = |(&a, &b): (&f64, &f64)| [a, b];
    let series = |curve: &CurveData| PlotLine {
        name: curve.name.clone(),
        points: curve.x.iter().zip(&curve.y).map(pair).collect(),
        band: match (&curve.low, &curve.high) {
            (Some(low), Some(high)) => low.iter().zip(high).map(pair).collect(),
            _ => Vec::new(),
        },
    };
    html! {
        (Plot {
            title: plot.title.clone(),
            x: axis(&plot.x, false),
            y: axis(&plot.y, plot.log_y),
            series: plot.series.iter().map(series).collect(),
        }
        .markup(&format!("plot-{number}")))
        @if !plot.caption.is_empty() { p.muted { (plot.caption) } }
    }
}

fn figure_markup(figure: &Figure, renders: &Renders) -> Markup {
    html! {
        h3 { (figure.title) }
        @if !figure.caption.is_empty() { p.muted { (figure.caption) } }
        div.scroll tabindex="0" role="region" aria-label={ "Pictures: " (figure.title) } {
            div.shots {
                @for picture in &figure.pictures {
                    @let [width, height] =
                        renders.sizes.get(&picture.file).copied().unwrap_or_default();
                    div.shot {
                        img src=(place(&picture.file)) width=(width) height=(height) loading="lazy"
                            alt=(picture.name);
                        p { (picture.name) }
                    }
                }
            }
        }
    }
}
