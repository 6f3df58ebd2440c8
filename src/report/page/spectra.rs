//! The spectra of all tiles side by side: where each has its error, and what the kernel lets pass.

use maud::{Markup, html};

use super::super::card::{Card, KernelWindow, Shown};
use super::super::plot::{Plot, PlotAxis};
use super::zoom;

/// What the two spectra of a tile are.
const PLANES: [&str; 2] = ["XY", "XT"];

/// Pictures and plots of all tiles.
pub(super) fn section(cards: &[Card]) -> Markup {
    html! {
        section aria-labelledby="spectra" {
            h2 #spectra { "Error spectra" }
            p {
                "Mean over the classes of functions that read all dimensions. Brightness is \
                 amplitude, white noise’s is mid-gray, frequency 0 is in the middle. Lines: where \
                 the kernel lets pass half (solid) and a tenth (dashed) of its largest amplitude. \
                 Above, XY: frequencies across and down, the mean over all frames; the lines are \
                 for error that stands still. Below, XT: frequencies across, and those of time \
                 down, the mean over all rows of pixels; the lines are for error that is equal in \
                 all rows."
            }
            div.pictures.spectra {
                @for card in cards {
                    figure {
                        figcaption { (card.title) }
                        @for (window, plane) in card.spectra.iter().zip(PLANES) {
                            (spectrum(window, plane, &card.title))
                        }
                    }
                }
            }
            div.plots {
                @for (i, plane) in PLANES.into_iter().enumerate() { (radial(i, plane, cards)) }
            }
        }
    }
}

fn spectrum(window: &KernelWindow, plane: &str, title: &str) -> Markup {
    let Shown { file, width, height } = &window.picture;
    let factor = zoom(*width, *height);
    let [half, far] = &window.contours;
    html! {
        div.scroll tabindex="0" role="region" aria-label={ (plane) " spectrum, " (title) } {
            div.window style={ "width:" (width * factor) "px" } {
                img.pixels src=(file) width=(width) height=(height) loading="lazy"
                    alt={ (plane) " spectrum of the error of " (title) }
                    style={ "width:" (width * factor) "px" };
                svg viewBox={ "0 0 " (width) " " (height) } preserveAspectRatio="none"
                    role="img" aria-label="The kernel’s window" {
                    path.case d={ (half) (far) } {}
                    path.half d=(half) {}
                    path.far d=(far) {}
                }
            }
        }
    }
}

/// Power by distance from frequency 0: a line for each tile, and one for the kernel.
fn radial(which: usize, plane: &str, cards: &[Card]) -> Markup {
    let tiles = cards.iter().map(|card| card.rings[which].clone());
    let kernel = cards.first().map(|card| card.kernel_power.clone());
    Plot {
        title: format!("Error spectrum, {plane}"),
        x: PlotAxis {
            label: "distance from frequency 0, cycles per pixel or frame".into(),
            log: false,
            shows: vec![0.0],
        },
        y: PlotAxis { label: "power, white noise is 1".into(), log: true, shows: vec![1.0] },
        series: tiles.chain(kernel).collect(),
    }
    .markup(&format!("radial-{which}"))
}
