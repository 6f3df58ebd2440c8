//! A domain as users type it: a name, or the file of a density, which is read when it is needed.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::{Domain, DomainError, read};

/// A domain, or the file of one.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum DomainSpec {
    /// One that is known already.
    Known(Domain),
    /// `density(FILE)`: gray levels of a PNG, or a `.npy` array of rows and columns.
    File(String),
}

impl DomainSpec {
    /// Dimensions of its points; `None` if they may have any number.
    pub fn dims(&self) -> Option<usize> {
        match self {
            Self::Known(domain) => domain.dims(),
            Self::File(_) => Some(2),
        }
    }

    /// The domain.
    ///
    /// # Errors
    /// A file that cannot be read, or that holds no density.
    pub fn resolve(&self) -> Result<Domain, DomainError> {
        match self {
            Self::Known(domain) => Ok(*domain),
            Self::File(file) => read::read(file)
                .map(Domain::Density)
                .map_err(|why| DomainError::File { file: file.clone(), why }),
        }
    }
}

impl From<Domain> for DomainSpec {
    fn from(domain: Domain) -> Self {
        Self::Known(domain)
    }
}

impl fmt::Display for DomainSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let file = match self {
            Self::Known(Domain::Density(density)) => density.name(),
            Self::Known(domain) => {
                let number = Domain::ALL.iter().position(|it| it == domain);
                return f.pad(number.map_or("", |i| Domain::NAMES[i]));
            }
            Self::File(file) => file,
        };
        f.pad(&format!("density({file})"))
    }
}

impl FromStr for DomainSpec {
    type Err = DomainError;

    fn from_str(text: &str) -> Result<Self, DomainError> {
        let file = text.strip_prefix("density(").and_then(|rest| rest.strip_suffix(')'));
        if let Some(file) = file.filter(|file| !file.is_empty()) {
            return Ok(Self::File(file.to_owned()));
        }
        let number = Domain::NAMES.iter().position(|&it| it == text);
        let number = number.ok_or_else(|| DomainError::Name { found: text.to_owned() })?;
        Ok(Self::Known(Domain::ALL[number]))
    }
}

impl TryFrom<String> for DomainSpec {
    type Error = DomainError;

    fn try_from(text: String) -> Result<Self, DomainError> {
        text.parse()
    }
}

impl From<DomainSpec> for String {
    fn from(spec: DomainSpec) -> Self {
        spec.to_string()
    }
}
