//! How the animation is watched, as settings: they stand for the kernel that follows from it.

use serde::{Deserialize, Serialize};

use super::error::SettingsError;
use super::value::read;
use crate::kernel::{KernelSpec, SpecProblem, Viewing};
use crate::tile::TileShape;

/// How the animation is watched. What is not given is the paper's: 60 frames per second, no temporal
/// anti-aliasing, sigma 2.1.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::Args))]
#[cfg_attr(feature = "cli", command(next_help_heading = "Kernel"))]
#[serde(rename_all = "kebab-case")]
pub struct ViewingSettings {
    /// Frames per second of the display, above 4 [default: 60]
    #[cfg_attr(feature = "cli", arg(long, value_name = "N"))]
    pub fps: Option<f64>,

    /// Weight of the newest frame in the renderer's temporal anti-aliasing (TAA), above 0 and at
    /// most 1, such as 0.1 [default: no TAA]
    #[cfg_attr(feature = "cli", arg(long, value_name = "ALPHA"))]
    pub taa: Option<f64>,

    /// Standard deviation of the eye's spatial filter in pixels [default: 2.1]
    #[cfg_attr(feature = "cli", arg(long, value_name = "PIXELS"))]
    pub sigma: Option<f64>,

    /// The same by display and distance: 45 pixels per degree (2560 pixels on 27 inches from 60 cm)
    /// make sigma 2.1
    #[cfg_attr(feature = "cli", arg(long, value_name = "N"))]
    pub pixels_per_degree: Option<f64>,
}

impl ViewingSettings {
    /// Their names.
    pub(super) const NAMES: [&str; 4] = ["fps", "taa", "sigma", "pixels_per_degree"];

    /// Sets one of [`Self::NAMES`] from text; nothing, if it has another name.
    pub(super) fn set_text(&mut self, name: &str, text: &str) -> Result<bool, SettingsError> {
        let value = match name {
            "fps" => &mut self.fps,
            "taa" => &mut self.taa,
            "sigma" => &mut self.sigma,
            "pixels_per_degree" => &mut self.pixels_per_degree,
            _ => return Ok(false),
        };
        *value = Some(read(name, text)?);
        Ok(true)
    }

    /// Whether any of them is given.
    pub fn is_given(&self) -> bool {
        *self != Self::default()
    }

    /// Refuses these settings beside a kernel that is written out, in a flag or argument of this name.
    ///
    /// # Errors
    /// If there is one, and one of them is given.
    pub fn refuse_beside(
        &self,
        kernel: Option<&KernelSpec>,
        name: &'static str,
    ) -> Result<(), SettingsError> {
        if kernel.is_none() || !self.is_given() {
            return Ok(());
        }
        Err(SettingsError::TwoKernels { name })
    }

    /// Those that are given, as flags of the command.
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
    pub fn kernel(&self, shape: TileShape) -> Result<KernelSpec, SettingsError> {
        self.viewing()?.kernel(shape).map_err(|problem| self.refused(problem))
    }

    /// The kernel behind which error is seen.
    ///
    /// # Errors
    /// Numbers out of range, and two values for sigma.
    pub fn perceived(&self, shape: TileShape) -> Result<KernelSpec, SettingsError> {
        self.viewing()?.perceived(shape).map_err(|problem| self.refused(problem))
    }

    /// What they say, and the paper's where they do not.
    ///
    /// # Errors
    /// Two values for sigma.
    pub fn viewing(&self) -> Result<Viewing, SettingsError> {
        let Self { fps, taa, sigma, pixels_per_degree } = *self;
        if sigma.is_some() && pixels_per_degree.is_some() {
            return Err(SettingsError::TwoSigmas);
        }
        let default = Viewing::default();
        let sigma = sigma.or(pixels_per_degree.map(Viewing::sigma_at)).unwrap_or(default.sigma);
        Ok(Viewing { fps: fps.unwrap_or(default.fps), taa, sigma })
    }

    /// What is wrong with a number, under the name of its flag: nobody typed an alpha.
    fn refused(&self, mut problem: SpecProblem) -> SettingsError {
        if let SpecProblem::Value { name, .. } | SpecProblem::Reach { name, .. } = &mut problem {
            *name = match *name {
                "fps" => "--fps",
                "alpha" => "--taa",
                "sigma" if self.pixels_per_degree.is_some() => "sigma by --pixels-per-degree",
                "sigma" => "--sigma",
                other => other,
            };
        }
        SettingsError::Viewing(problem)
    }
}
