//! The page: everything that was found out, as one HTML file.
//!
//! All text goes through `maud`, which escapes it; data for scripts goes through [`data`].

mod scores;
mod shots;
mod spectra;
mod tile;

use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde::Serialize;

use super::ReportOptions;
use super::card::Card;
use super::folder::GENERATOR;
use super::names::without_folders;
use super::renders::Renders;
use super::views::{View, Views};

/// What the page may load: its own folder, and what its scripts make.
const POLICY: &str = "default-src 'none'; img-src 'self' file: data:; style-src 'unsafe-inline'; \
                      script-src 'self' file: 'unsafe-inline'; worker-src blob:; base-uri 'none'; \
                      form-action 'none'";
const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");
const VIEWER_STYLE: &str = include_str!("viewer/viewer.css");
/// The parts of the viewer, in the order in which they run. They share one element, because its
/// worker is started from that element's text.
const VIEWER_SCRIPTS: [&str; 10] = [
    include_str!("viewer/integrands.js"),
    include_str!("viewer/filter.js"),
    include_str!("viewer/work.js"),
    include_str!("viewer/player.js"),
    include_str!("viewer/controls.js"),
    include_str!("viewer/compare.js"),
    include_str!("viewer/panes.js"),
    include_str!("viewer/tiles.js"),
    include_str!("viewer/scenes.js"),
    include_str!("viewer/viewer.js"),
];

/// What the viewer shows.
#[derive(Serialize)]
struct ViewerData<'a> {
    fps: f64,
    views: &'a [View],
    /// Which of them it begins with.
    first: usize,
    tiles: Vec<ViewerTile<'a>>,
}

/// One of its tiles.
#[derive(Serialize)]
struct ViewerTile<'a> {
    name: &'a str,
    file: String,
    width: usize,
    height: usize,
    frames: usize,
    spp: usize,
    dims: usize,
    whole: bool,
}

/// The whole page.
pub(super) fn page(
    options: &ReportOptions,
    views: &Views,
    cards: &[Card],
    renders: Option<&Renders>,
) -> String {
    let read = cards.iter().filter(|card| card.entry.path.is_some());
    let title = read.map(|card| card.title.as_str()).collect::<Vec<_>>().join(", ");
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="generator" content={ (GENERATOR) " " (env!("CARGO_PKG_VERSION")) };
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { "Perceptile report: " (title) }
                style { (PreEscaped(STYLE)) (PreEscaped(VIEWER_STYLE)) }
            }
            body {
                (header(cards, renders))
                main {
                    (viewer(options, views, cards))
                    (scores::section(options, cards))
                    (spectra::section(cards))
                    section aria-labelledby="tiles" {
                        h2 #tiles { "Tiles" }
                        @for (number, card) in cards.iter().enumerate() {
                            (tile::article(number, card))
                        }
                    }
                    @if let Some(renders) = renders {
                        (shots::section(renders))
                    }
                    (making(options, cards))
                    (help())
                }
                footer {
                    p { "Made by Perceptile " (env!("CARGO_PKG_VERSION")) "." }
                    p.unseen #said role="status" {}
                }
                script { (PreEscaped(SCRIPT)) }
                script {
                    @for part in VIEWER_SCRIPTS { (PreEscaped(part)) }
                }
            }
        }
    };
    markup.into_string()
}

fn header(cards: &[Card], renders: Option<&Renders>) -> Markup {
    html! {
        header {
            div.top {
                h1 { "Perceptile report" }
                button #theme type="button" hidden { "Dark theme" }
            }
            (scores::verdict(cards))
            nav aria-label="Contents" {
                ul {
                    li { a href="#viewer" { "Viewer" } }
                    li { a href="#scores" { "Scores" } }
                    li { a href="#spectra" { "Spectra" } }
                    li { a href="#tiles" { "Tiles" } }
                    @if renders.is_some() {
                        li { a href="#renders" { "Renders" } }
                    }
                    li { a href="#making" { "How it was made" } }
                    li { a href="#help" { "How to read this" } }
                }
            }
        }
    }
}

/// What the report was made of and with.
fn making(options: &ReportOptions, cards: &[Card]) -> Markup {
    let scores = options.scores;
    html! {
        section aria-labelledby="making" {
            h2 #making { "How this report was made" }
            dl.facts {
                dt { "Tiles" }
                dd {
                    @for (number, card) in cards.iter().enumerate() {
                        @if number > 0 { "; " }
                        (card.title) " (" (card.entry.shape.to_string()) ")"
                    }
                }
                dt { "Kernel" }
                dd {
                    code { (without_folders(&options.kernel.to_string())) }
                    @if options.kernel.classes().len() > 1 { " (its first class)" }
                }
                dt { "Frame rate" }
                dd { (options.fps) " frames per second" }
                dt { "Integrands" }
                dd { (scores.integrands) " of each class, set " (scores.set) }
            }
            p.muted {
                "The command that makes it again, where the files are, as the folder OUT:"
            }
            (command("report-command", &without_folders(&options.command)))
        }
    }
}

/// A command with a button that copies it.
fn command(id: &str, text: &str) -> Markup {
    html! {
        div.command {
            pre #(id) { (text) }
            button type="button" data-copies=(id) aria-label="Copy the command" hidden { "Copy" }
        }
    }
}

fn viewer(options: &ReportOptions, views: &Views, cards: &[Card]) -> Markup {
    let tiles = cards.iter().enumerate().map(|(number, card)| {
        let part = card.part;
        ViewerTile {
            name: &card.title,
            file: format!("tiles/{number}.js"),
            width: part.width,
            height: part.height,
            frames: part.frames,
            spp: card.entry.shape.spp(),
            dims: card.entry.shape.dims().min(2),
            whole: part.whole,
        }
    });
    let content = ViewerData {
        fps: options.fps,
        views: &views.shown,
        first: views.first(&options.kernel),
        tiles: tiles.collect(),
    };
    html! {
        h2 { "Error in motion" }
        p {
            "Each pixel integrates one function with the tile’s samples; shown is how far it is \
             off."
        }
        section #viewer aria-label="Viewer" {
            noscript { p { "The animations need JavaScript." } }
        }
        dl.facts {
            @for view in &views.shown {
                @if let Some(text) = &view.text {
                    dt { (view.name) }
                    dd { code { (without_folders(text)) } }
                }
            }
        }
        @for (name, reason) in &views.left_out {
            p.muted { "The view “" (name) "” is left out: " (reason) "." }
        }
        (data("viewer-data", &content))
    }
}

/// Data for a script. Without `<` in it, no text can end the element.
fn data(id: &str, content: &impl Serialize) -> Markup {
    let json = serde_json::to_string(content).unwrap_or_else(|_| "null".to_owned());
    html! {
        script type="application/json" id=(id) { (PreEscaped(json.replace('<', "\\u003c"))) }
    }
}

/// How large a picture is shown: by the largest whole factor up to 8 with which it is at most 256
/// pixels across and down.
fn zoom(width: usize, height: usize) -> usize {
    (256 / width.max(height).max(1)).clamp(1, 8)
}

fn help() -> Markup {
    html! {
        section aria-labelledby="help" {
            h2 #help { "How to read this" }
            h3 { "Perceived-error ratio" }
            p {
                "A renderer takes its random numbers from a tile, and every pixel of every frame is \
                 a little off. The eye does not see single pixels of single frames: it blends \
                 neighbours in space and in time. The kernel is a model of that. We integrate many \
                 simple functions with the tile's samples, filter the error with the kernel, and \
                 divide its mean square over all functions of a class by white noise's. 1 is white \
                 noise, 0.1 is a tenth of its error energy: lower is better. Functions that hardly \
                 vary hardly count. The number behind ± is the standard error over the functions. \
                 Compare tiles only on the same set of functions."
            }
            h3 { "Bias, histogram, residual" }
            p {
                "Bias is the error that stays when the whole tile is averaged, relative to as many \
                 independent samples, over all functions in the same way. After rounding to 8 bits \
                 it is largest for axis edges: rounding moves such an edge by up to half a level in \
                 all pixels alike, which no average removes. The histogram says how evenly the samples fill the square: 1 \
                 is an even share in every cell. The residual is what is left in each pixel when all \
                 its frames are averaged. The means of half a period and of a whole period say the \
                 same for the functions."
            }
            h3 { "Slices" }
            p {
                "A tile is a stack of frames. A frame is what one image uses. An XT slice follows \
                 one row of pixels through time, with time down; a YT slice follows one column, with \
                 time across. Good tiles look restless everywhere: patches and stripes are error \
                 that is seen."
            }
            h3 { "Spectra and the kernel’s window" }
            p {
                "A spectrum shows how much of the error is coarse (near the middle) or fine (far \
                 from it); bright is much, mid-gray is white noise. The lines are the kernel’s \
                 window: error inside the lines is seen; error outside is averaged away. A good tile \
                 is dark inside the window and pays for it outside."
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_text_ends_the_data_or_a_script() {
        let hostile = "</script><script>alert(1)</script><!--";
        let text = data("x", &[hostile]).into_string();
        assert_eq!(text.matches("</script").count(), 1);
        assert!(!text.contains("<!--"));
        let start = text.find('>').unwrap() + 1;
        let json = &text[start..text.rfind('<').unwrap()];
        assert_eq!(serde_json::from_str::<Vec<String>>(json).unwrap(), [hostile]);
        for script in VIEWER_SCRIPTS.into_iter().chain([SCRIPT]) {
            assert!(!script.contains("</script") && !script.contains("<!--"));
        }
        for style in [STYLE, VIEWER_STYLE] {
            assert!(!style.contains("</style"));
        }
    }

    #[test]
    fn pictures_are_magnified_by_whole_factors() {
        let zooms = [(64, 16, 4), (16, 100, 2), (256, 1, 1), (512, 4, 1), (1, 1, 8)];
        for (width, height, factor) in zooms {
            assert_eq!(zoom(width, height), factor);
        }
    }
}
