//! How the animation is watched, as flags: they stand for the kernel that follows from it.

use clap::Args;
use perceptile::kernel::{KernelSpec, SpecProblem, Viewing};
use perceptile::tile::TileShape;
use serde::{Deserialize, Serialize};

use super::exit::Misuse;

/// How the animation is watched. What is not given is the paper's: 60 frames per second, no temporal
/// anti-aliasing, sigma 2.1.
#[derive(Debug, Clone, Copy, Default, PartialEq, Args, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[command(next_help_heading = "Kernel")]
pub struct ViewingArgs {
    /// Frames per second of the display, above 4 [default: 60]
    #[arg(long, value_name = "N")]
    pub fps: Option<f64>,

    /// Weight of the newest frame in the renderer's temporal anti-aliasing (TAA), above 0 and at
    /// most 1, such as 0.1 [default: no TAA]
    #[arg(long, value_name = "ALPHA")]
    pub taa: Option<f64>,

    /// Standard deviation of the eye's spatial filter in pixels [default: 2.1]
    #[arg(long, value_name = "PIXELS")]
    pub sigma: Option<f64>,

    /// The same by display and distance: 45 pixels per degree (2560 pixels on 27 inches from 60 cm)
    /// make sigma 2.1
    #[arg(long, value_name = "N")]
    pub pixels_per_degree: Option<f64>,
}

impl ViewingArgs {
    /// Whether any of the flags is given.
    pub fn is_given(&self) -> bool {
        *self != Self::default()
    }

    /// Refuses these flags beside a kernel that is written out, in a flag or argument of this name.
    ///
    /// # Errors
    /// If there is one, and one of them is given.
    pub fn refuse_beside(&self, kernel: Option<&KernelSpec>, name: &str) -> Result<(), Misuse> {
        if kernel.is_none() || !self.is_given() {
            return Ok(());
        }
        let rule = "leave out --fps, --taa, --sigma and --pixels-per-degree";
        Err(Misuse(format!("{name} says all of the kernel: {rule}")))
    }

    /// The flags that are given, as they are typed.
    pub fn typed(&self) -> String {
        let Self { fps, taa, sigma, pixels_per_degree } = *self;
        [("fps", fps), ("taa", taa), ("sigma", sigma), ("pixels-per-degree", pixels_per_degree)]
            .into_iter()
            .filter_map(|(name, value)| Some(format!("--{name} {}", value?)))
            .collect::<Vec<String>>()
            .join(" ")
    }

    /// The kernel that a tile of this shape is made with.
    ///
    /// # Errors
    /// Numbers out of range, and two values for sigma.
    pub fn kernel(&self, shape: TileShape) -> Result<KernelSpec, Misuse> {
        self.viewing()?.kernel(shape).map_err(|problem| self.refused(problem))
    }

    /// The kernel behind which error is seen.
    ///
    /// # Errors
    /// Numbers out of range, and two values for sigma.
    pub fn perceived(&self, shape: TileShape) -> Result<KernelSpec, Misuse> {
        self.viewing()?.perceived(shape).map_err(|problem| self.refused(problem))
    }

    /// What the flags say, and the paper's where they do not.
    ///
    /// # Errors
    /// Two values for sigma.
    pub fn viewing(&self) -> Result<Viewing, Misuse> {
        let Self { fps, taa, sigma, pixels_per_degree } = *self;
        if sigma.is_some() && pixels_per_degree.is_some() {
            return Err(Misuse("--pixels-per-degree says sigma: leave out --sigma".into()));
        }
        let default = Viewing::default();
        let sigma = sigma.or(pixels_per_degree.map(Viewing::sigma_at)).unwrap_or(default.sigma);
        Ok(Viewing { fps: fps.unwrap_or(default.fps), taa, sigma })
    }

    /// What is wrong with a number, under the name of its flag: nobody typed an alpha.
    fn refused(&self, mut problem: SpecProblem) -> Misuse {
        if let SpecProblem::Value { name, .. } | SpecProblem::Reach { name, .. } = &mut problem {
            *name = match *name {
                "fps" => "--fps",
                "alpha" => "--taa",
                "sigma" if self.pixels_per_degree.is_some() => "sigma by --pixels-per-degree",
                "sigma" => "--sigma",
                other => other,
            };
        }
        Misuse(problem.to_string())
    }
}
