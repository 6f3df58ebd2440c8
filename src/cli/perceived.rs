//! The kernel through which error is seen: written out, or as it follows from how the animation is
//! watched, or the one that the first tile was made for. Nobody is to score a tile for another
//! display than its own without noticing, so the kernel always comes with its origin.

use std::path::Path;

use clap::Args;
use perceptile::format::sidecar::Sidecar;
use perceptile::kernel::KernelSpec;
use perceptile::settings::{SettingsError, ViewingSettings};
use perceptile::tile::TileShape;

use super::candidates::Candidate;
use super::exit::{Failure, Misuse};

/// The kernel through which error is seen if nothing says another.
const DEFAULT: &str = "gaussian(2.1) * fovvideovdp(60) @ 7x7x8";

/// The flags that say the kernel.
#[derive(Debug, Clone, Args)]
#[command(next_help_heading = "Kernel")]
pub struct PerceivedArgs {
    /// The kernel through which error is seen; of a mixture, only its first term is used [default: from
    /// the flags below if one is given, else what the first tile was made for as its sidecar says, else
    /// "gaussian(2.1) * fovvideovdp(60) @ 7x7x8"]
    #[arg(long, value_name = "SPEC")]
    kernel: Option<KernelSpec>,

    #[command(flatten)]
    viewing: ViewingSettings,
}

/// A kernel through which error is seen.
#[derive(Debug, Clone, PartialEq)]
pub struct PerceivedKernel {
    /// The kernel.
    pub spec: KernelSpec,
    /// Where it is from, for people.
    pub origin: String,
}

impl PerceivedArgs {
    /// Checks what can be checked before any tile is read.
    ///
    /// # Errors
    /// Flags that say the kernel twice.
    pub fn check(&self) -> Result<(), SettingsError> {
        self.viewing.refuse_beside(self.kernel.as_ref(), "--kernel")
    }

    /// The kernel for these tiles, of which the user named `first` first.
    ///
    /// # Errors
    /// Flags that say it twice, or numbers out of range.
    pub fn choose(
        &self,
        first: &Path,
        candidates: &[Candidate],
    ) -> Result<PerceivedKernel, Failure> {
        self.check()?;
        if let Some(kernel) = &self.kernel {
            return Ok(PerceivedKernel { spec: kernel.clone(), origin: "from --kernel".into() });
        }
        let is_first = |candidate: &&Candidate| candidate.path.as_deref() == Some(first);
        let candidate = candidates.iter().find(is_first).or(candidates.first());
        let shape = candidate.map(|candidate| candidate.tile.shape());
        let shape = shape.ok_or_else(|| Misuse("there is no tile".into()))?;
        if self.viewing.is_given() {
            let spec = self.viewing.perceived(shape)?;
            return Ok(PerceivedKernel { spec, origin: format!("from {}", self.viewing.typed()) });
        }
        Ok(of_tile(first, shape))
    }
}

/// The kernel that a tile was made for, or the default.
pub fn of_tile(tile: &Path, shape: TileShape) -> PerceivedKernel {
    of_sidecar(tile, shape).unwrap_or_else(|origin| PerceivedKernel {
        spec: DEFAULT.parse().expect("a valid kernel"),
        origin,
    })
}

/// The kernel that a tile was made for, whole; otherwise what people read of the default's origin.
fn of_sidecar(tile: &Path, shape: TileShape) -> Result<PerceivedKernel, String> {
    let path = Sidecar::find(tile).ok_or("the default")?;
    let not = |why: &str| format!("the default, as {} {why}", path.display());
    let sidecar = Sidecar::read(&path).map_err(|_| not("cannot be read"))?;
    if !sidecar.describes(tile, shape) {
        return Err(not("is that of another tile"));
    }
    let kernel: KernelSpec =
        sidecar.kernel.parse().map_err(|_| not("has a kernel that cannot be read"))?;
    let spec = kernel.perceived(shape);
    Ok(PerceivedKernel { spec, origin: format!("from {}", path.display()) })
}
