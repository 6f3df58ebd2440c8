//! What an export makes, as its options say: only combinations that some reader takes.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use super::header::{Language, Storage};
use crate::format::ktx2::Layout;
use crate::format::png::Depth;
use crate::format::slices::{Picture, SliceOptions, Stack};
use crate::format::texture::{MAX_CHANNELS, Texels, TextureError};
use crate::tile::TileShape;

/// What there is to export to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ExportFormat {
    /// PNG with 8 bits per channel, a file for each frame.
    #[default]
    Png8,
    /// PNG with 16 bits per channel, a file for each frame.
    Png16,
    /// A KTX2 texture array.
    Ktx2,
    /// A KTX2 volume of 8 bits.
    Ktx2Volume,
    /// Texels of 8 bits and nothing else, with a description beside them.
    Raw8,
    /// The same of 16 bits.
    Raw16,
    /// EXR with floats, a file for each frame.
    #[cfg(feature = "exr")]
    Exr,
    /// Integers in a `.npy` array.
    Npy,
    /// The function that reads a texture.
    Header,
}

impl ExportFormat {
    /// All, with the names that users type and what they are for.
    pub const ALL: &[(Self, &str, &str)] = &[
        (Self::Png8, "png8", "PNG with 8 bits per channel, a file for each frame"),
        (Self::Png16, "png16", "PNG with 16 bits per channel, a file for each frame"),
        (Self::Ktx2, "ktx2", "KTX2 texture array: Bevy, Vulkan, D3D12, Godot"),
        (Self::Ktx2Volume, "ktx2-3d", "KTX2 volume of 8 bits: three.js, WebGL"),
        (Self::Raw8, "raw8", "Texels of 8 bits and nothing else, with a description in .raw.json"),
        (Self::Raw16, "raw16", "The same of 16 bits, little-endian"),
        #[cfg(feature = "exr")]
        (Self::Exr, "exr", "EXR with floats, a file for each frame"),
        (Self::Npy, "npy", "Integers in a .npy array (frames, height, width, samples, dimensions)"),
        (Self::Header, "header", "The function that reads the texture in a program or shader"),
    ];

    /// The bits that its name says.
    fn bits(self) -> Option<u32> {
        match self {
            Self::Png8 | Self::Raw8 | Self::Ktx2Volume => Some(8),
            Self::Png16 | Self::Raw16 => Some(16),
            _ => None,
        }
    }

    fn is_png(self) -> bool {
        matches!(self, Self::Png8 | Self::Png16)
    }

    fn is_exr(self) -> bool {
        #[cfg(feature = "exr")]
        let is_exr = self == Self::Exr;
        #[cfg(not(feature = "exr"))]
        let is_exr = false;
        is_exr
    }
}

impl fmt::Display for ExportFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let named = Self::ALL.iter().find(|(format, ..)| format == self);
        f.write_str(named.map_or("", |(_, name, _)| name))
    }
}

impl FromStr for ExportFormat {
    type Err = FormError;

    fn from_str(text: &str) -> Result<Self, FormError> {
        let named = Self::ALL.iter().find(|(_, name, _)| *name == text);
        let names = || Self::ALL.iter().map(|(_, name, _)| *name).collect::<Vec<_>>().join(", ");
        named.map(|(format, ..)| *format).ok_or_else(|| {
            FormError(format!("invalid value '{text}' for --format: there are: {}", names()))
        })
    }
}

/// How a tile is exported. Everything but the format may be left as it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ExportOptions {
    /// What to write.
    pub format: ExportFormat,
    /// Bits of a channel, 8 or 16, where the format does not say them; 8 by default, of `npy` 16.
    pub bits: Option<u32>,
    /// Channels of a texel; by default as many as dimensions, as far as there are such.
    pub texels: Option<Texels>,
    /// Whether every level stands equally often in each slice ([`exact`](crate::format::exact)).
    pub exact: bool,
    /// PNG: one picture with all frames below each other.
    pub strip: bool,
    /// EXR: one file with a layer for each frame.
    pub layers: bool,
    /// Pictures: numbers in names without leading zeros.
    pub plain_numbers: bool,
    /// Header: its language; C by default.
    pub language: Option<Language>,
    /// Header: the format that it reads; `raw8` in C and else `ktx2` by default.
    pub reads: Option<ExportFormat>,
}

/// Options that do not go together, with what would.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
#[error("{0}")]
pub struct FormError(String);

/// What is to be written.
#[derive(Debug, Clone, Copy)]
pub struct Form(pub(super) Kind);

/// What is to be written, by where it goes.
#[derive(Debug, Clone, Copy)]
pub(super) enum Kind {
    /// Pictures, and what their folder's name ends with.
    Pictures { options: SliceOptions, folder: &'static str },
    /// A single file.
    File(FileKind),
}

/// What is to be written into a single file.
#[derive(Debug, Clone, Copy)]
pub(super) enum FileKind {
    /// A KTX2 texture.
    Ktx2 { texels: Option<Texels>, depth: Depth, layout: Layout },
    /// A raw volume with its description.
    Raw { texels: Option<Texels>, depth: Depth },
    /// An array of integers.
    Npy { depth: Depth },
    /// A header.
    Header { language: Language, storage: Storage, texels: Option<Texels>, depth: Depth },
}

impl Form {
    /// What the flags ask for.
    ///
    /// # Errors
    /// Flags that do not go together, with what would.
    pub fn new(options: &ExportOptions) -> Result<Self, FormError> {
        let is_header = options.format == ExportFormat::Header;
        for (flag, given, rule, holds) in [
            ("--strip", options.strip, "png8 or png16", options.format.is_png()),
            ("--layers", options.layers, "exr", options.format.is_exr()),
            (
                "--plain-numbers",
                options.plain_numbers,
                "png8, png16 or exr",
                options.format.is_png() || options.format.is_exr(),
            ),
            ("--language", options.language.is_some(), "header", is_header),
            ("--for", options.reads.is_some(), "header", is_header),
        ] {
            if given && !holds {
                return Err(misfit(flag, options.format, rule));
            }
        }
        let language = options.language.unwrap_or(Language::C);
        let read = match options.reads {
            None if language == Language::C && options.bits == Some(16) => ExportFormat::Raw16,
            None if language == Language::C => ExportFormat::Raw8,
            None => ExportFormat::Ktx2,
            Some(read) => read,
        };
        let format = if is_header { read } else { options.format };
        let depth = depth(format, options.bits)?;
        let texels = options.texels;
        if format.is_png() && texels == Some(Texels::Rg) {
            let what = "--texels rg does not go with PNG, which has no pixels of two channels";
            return Err(FormError(format!("{what}: rgb and rgba do, and --format ktx2 has rg")));
        }
        if texels.is_some() && format == ExportFormat::Npy {
            return Err(misfit("--texels", format, "pictures and textures"));
        }
        let stack = if options.strip { Stack::Strip } else { Stack::Files };
        let slices = SliceOptions {
            picture: Picture::Png(depth),
            stack,
            padded: !options.plain_numbers,
            texels,
        };
        let kind = match options.format {
            ExportFormat::Png8 => Kind::Pictures { options: slices, folder: "png8" },
            ExportFormat::Png16 => Kind::Pictures { options: slices, folder: "png16" },
            #[cfg(feature = "exr")]
            ExportFormat::Exr => {
                let stack = if options.layers { Stack::Layers } else { Stack::Files };
                let options = SliceOptions { picture: Picture::Exr, stack, ..slices };
                Kind::Pictures { options, folder: "exr" }
            }
            ExportFormat::Ktx2 => {
                Kind::File(FileKind::Ktx2 { texels, depth, layout: Layout::Array })
            }
            ExportFormat::Ktx2Volume => {
                Kind::File(FileKind::Ktx2 { texels, depth, layout: Layout::Volume })
            }
            ExportFormat::Raw8 | ExportFormat::Raw16 => Kind::File(FileKind::Raw { texels, depth }),
            ExportFormat::Npy => Kind::File(FileKind::Npy { depth }),
            ExportFormat::Header => {
                let storage = storage(read)?;
                Kind::File(FileKind::Header { language, storage, texels, depth })
            }
        };
        Ok(Self(kind))
    }

    /// The bits of its levels, if it has levels.
    pub fn depth(&self) -> Option<Depth> {
        match self.0 {
            Kind::Pictures { options, .. } => match options.picture {
                Picture::Png(depth) => Some(depth),
                #[cfg(feature = "exr")]
                Picture::Exr => None,
            },
            Kind::File(
                FileKind::Ktx2 { depth, .. }
                | FileKind::Raw { depth, .. }
                | FileKind::Npy { depth }
                | FileKind::Header { depth, .. },
            ) => Some(depth),
        }
    }

    /// Whether it has the samples of a tile, and is not the function that reads them.
    pub fn has_samples(&self) -> bool {
        !matches!(self.0, Kind::File(FileKind::Header { .. }))
    }

    /// Whether it is a texture for engines, which have rules for its sides.
    pub fn is_texture(&self) -> bool {
        matches!(self.0, Kind::File(FileKind::Ktx2 { .. }))
    }
}

impl FileKind {
    /// The file for a tile of this name.
    pub(super) fn name(&self, tile: &str) -> String {
        match self {
            Self::Ktx2 { .. } => format!("{tile}.ktx2"),
            Self::Raw { .. } => format!("{tile}.raw"),
            // Never the tile itself.
            Self::Npy { depth } => format!("{tile}-u{}.npy", 8 * depth.bytes()),
            Self::Header { language, .. } => format!("{tile}.{}", language.extension()),
        }
    }
}

/// What a header reads that is for a format.
///
/// # Errors
/// A format without headers.
fn storage(read: ExportFormat) -> Result<Storage, FormError> {
    match read {
        ExportFormat::Ktx2 => Ok(Storage::Array),
        ExportFormat::Ktx2Volume => Ok(Storage::Volume),
        ExportFormat::Png8 | ExportFormat::Png16 => Ok(Storage::Strip),
        ExportFormat::Raw8 | ExportFormat::Raw16 => Ok(Storage::Memory),
        _ => {
            let rule = "ktx2, ktx2-3d, png8 and png16 (their strips), raw8 and raw16 do";
            Err(FormError(format!("--for {} has no header: {rule}", read)))
        }
    }
}

/// Checks that pictures have the channels for what they hold.
///
/// # Errors
/// Fewer channels than dimensions.
pub(super) fn check_pictures(shape: TileShape, options: &SliceOptions) -> Result<(), TextureError> {
    let dims = if shape.dims() > MAX_CHANNELS { 2 } else { shape.dims() };
    match options.texels {
        Some(texels) if texels.channels() < dims => Err(TextureError::Dims { dims, texels }),
        _ => Ok(()),
    }
}

fn misfit(flag: &str, format: ExportFormat, rule: &str) -> FormError {
    FormError(format!("{flag} does not go with --format {}, but with {rule}", format))
}

/// The bits of a channel.
fn depth(format: ExportFormat, bits: Option<u32>) -> Result<Depth, FormError> {
    let named = format.bits();
    let wrong = |bits: u32| {
        let name = format;
        let instead = match format {
            ExportFormat::Png8 => "--format png16 has 16",
            ExportFormat::Png16 => "--format png8 has 8",
            ExportFormat::Raw8 => "--format raw16 has 16",
            ExportFormat::Raw16 => "--format raw8 has 8",
            ExportFormat::Ktx2Volume => {
                "WebGL, which it is for, has no normalized textures of 16 bits; --format ktx2 has 16"
            }
            _ => "it must be 8 or 16",
        };
        FormError(format!("--bits {bits} does not go with {name}: {instead}"))
    };
    match (named, bits) {
        (Some(named), Some(bits)) if named != bits => Err(wrong(bits)),
        (_, Some(_)) if format.is_exr() => {
            let rule = "its numbers are floats; ktx2, raw16 and png16 have levels";
            Err(FormError(format!("--bits does not go with exr: {rule}")))
        }
        (Some(8), _) | (None, Some(8)) => Ok(Depth::Eight),
        (Some(_), _) | (None, Some(16)) => Ok(Depth::Sixteen),
        (None, Some(bits)) => Err(wrong(bits)),
        (None, None) if format == ExportFormat::Npy => Ok(Depth::Sixteen),
        (None, None) => Ok(Depth::Eight),
    }
}
