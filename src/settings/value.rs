//! How a text becomes the value of a setting.

use super::error::SettingsError;
use super::number::whole;
use super::preset;
use super::size::TileSize;
use crate::domain::DomainSpec;
use crate::kernel::KernelSpec;
use crate::solver::Preset;

/// What a setting may hold.
pub(super) trait Value: Sized {
    /// Reads it as the command does; else says what is wrong.
    fn parse(text: &str) -> Result<Self, String>;
}

/// Values and how they are read.
macro_rules! values {
    ($($value:ty: $parse:expr,)*) => {
        $(impl Value for $value {
            fn parse(text: &str) -> Result<Self, String> {
                let parse: fn(&str) -> Result<Self, _> = $parse;
                parse(text).map_err(|error| error.to_string())
            }
        })*
    };
}

values! {
    usize: whole,
    u32: whole,
    u64: whole,
    f64: str::parse,
    String: str::parse,
    Preset: preset::parse,
    TileSize: str::parse,
    DomainSpec: str::parse,
    KernelSpec: str::parse,
}

/// Reads the value of the setting of a name.
pub(super) fn read<T: Value>(name: &str, text: &str) -> Result<T, SettingsError> {
    T::parse(text).map_err(|problem| SettingsError::Value {
        flag: format!("--{}", name.replace('_', "-")),
        text: text.to_owned(),
        problem,
    })
}
