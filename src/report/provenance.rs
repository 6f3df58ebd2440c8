//! Where a tile of the report comes from.

use std::path::Path;

use super::names::file_name;
use crate::format::sidecar::{Sidecar, file_digest};

/// Where a tile comes from.
#[derive(Debug)]
pub(super) enum Provenance {
    /// Made for the comparison.
    Comparison,
    /// No sidecar is beside the tile.
    Unknown,
    /// There is one that cannot be used, for this reason.
    Unreadable(String),
    /// The sidecar, and whether the tile's file is the one that it describes.
    Known(Box<Sidecar>, Match),
}

/// Whether a file has the digest of its sidecar.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Match {
    /// It has.
    Same,
    /// It has another.
    Other,
    /// It could not be read again.
    Unread,
}

impl Provenance {
    /// What the sidecar beside a tile says.
    pub fn of(tile: Option<&Path>) -> Self {
        let Some(tile) = tile else { return Self::Comparison };
        let path = Sidecar::path_of(tile);
        // A folder of slices has none, and one that is the tile itself is none.
        if !tile.is_file() || path == tile || path.symlink_metadata().is_err() {
            return Self::Unknown;
        }
        match Sidecar::read(&path) {
            Err(error) => {
                let whole = path.display().to_string();
                Self::Unreadable(error.to_string().replace(&whole, &file_name(&path)))
            }
            Ok(sidecar) => {
                let same = match file_digest(tile) {
                    Ok(digest) if digest == sidecar.sha256 => Match::Same,
                    Ok(_) => Match::Other,
                    Err(_) => Match::Unread,
                };
                Self::Known(Box::new(sidecar), same)
            }
        }
    }
}
