//! The report: tiles and renders as a folder that opens in a browser, without a network.
//!
//! ```text
//!  tile, scores ──► card ──────► pictures/*.png, contours, plots ─┐
//!               └─► samples ───► tiles/N.js ─────────────────────┤
//!  kernel ─────────► views ────► planes × slices ────────────────┼─► page ──► index.html
//!  renders.json ───► renders ──► renders/*.png ──────────────────┘
//! ```
//!
//! `folder` makes it appear whole or not at all. The numbers are those of [`ScoredTile`], which
//! `perceptile evaluate` prints; `page` only sets them. `viewer/` holds the script that animates
//! errors in the page. The same tiles make the same bytes: nothing here depends on the time, the
//! machine or the name of the folder.

mod card;
mod contour;
mod error;
mod folder;
mod names;
mod page;
pub mod pictures;
mod plot;
mod provenance;
mod renders;
mod samples;
mod views;

pub use error::ReportError;
pub use renders::{Problem, RendersError};

use std::path::Path;

use crate::format::write::Existing;
use crate::kernel::{KernelSpec, KernelTaps};
use crate::metric::{ScoreOptions, ScoredTile};
use crate::tile::Tile;

use card::Card;
use folder::{Folder, PAGE};
use renders::Renders;
use views::Views;

/// What a report is made with.
#[derive(Debug, Clone)]
pub struct ReportOptions {
    /// The kernel through which error is seen; of a mixture, its first class.
    pub kernel: KernelSpec,
    /// Weight of the newest frame in temporal anti-aliasing, in (0, 1], if the kernel has none.
    pub alpha: f64,
    /// Frames per second that the viewer plays.
    pub fps: f64,
    /// The integrands of the scores.
    pub scores: ScoreOptions,
    /// The command that makes the report again, as the page shows it.
    pub command: String,
}

/// A report that is being made: tiles are added one by one, so that not all need be in memory.
pub struct Report {
    folder: Folder,
    options: ReportOptions,
    renders: Option<Renders>,
    cards: Vec<Card>,
}

impl Report {
    /// Begins a report that will be the folder `out`, with the renders of a folder if there are
    /// any.
    ///
    /// # Errors
    /// `out` exists and is to be kept or is no report, or renders that cannot be used.
    pub fn begin(
        out: &Path,
        existing: Existing,
        options: ReportOptions,
        renders: Option<&Path>,
    ) -> Result<Self, ReportError> {
        let folder = Folder::new(out, existing)?;
        let take = |name: &str, bytes: &[u8]| -> Result<(), ReportError> {
            Ok(folder.write(&renders::place(name), bytes)?)
        };
        let renders = renders.map(|path| Renders::read(path, take)).transpose()?;
        Ok(Self { folder, options, renders, cards: Vec::new() })
    }

    /// Adds a tile with its scores and spectra, and the kernel behind which they were measured.
    /// The tile that was read nowhere is white noise.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn add(
        &mut self,
        entry: ScoredTile,
        tile: &Tile,
        kernel: &KernelTaps,
    ) -> Result<(), ReportError> {
        let card = Card::new(self.cards.len(), entry, tile, kernel, &self.folder)?;
        self.cards.push(card);
        Ok(())
    }

    /// Writes the page and gives the folder its name.
    ///
    /// # Errors
    /// A kernel that does not fit the first tile, and what cannot be written.
    pub fn finish(self) -> Result<(), ReportError> {
        let Self { folder, options, renders, cards } = self;
        let views = match cards.first() {
            Some(first) => {
                let parts: Vec<_> = cards.iter().map(|card| card.part).collect();
                Views::new(&options.kernel, options.alpha, first.entry.shape, &parts)?
            }
            None => Views { shown: Vec::new(), left_out: Vec::new() },
        };
        let page = page::page(&options, &views, &cards, renders.as_ref());
        folder.write(PAGE, page.as_bytes())?;
        folder.finish()
    }
}
