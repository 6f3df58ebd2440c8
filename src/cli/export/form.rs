//! What an export makes, as its flags say: only combinations that some reader takes.

use clap::ValueEnum;
use perceptile::format::header::{Language, Storage};
use perceptile::format::ktx2::Layout;
use perceptile::format::png::Depth;
use perceptile::format::slices::{Picture, SliceOptions, Stack};
use perceptile::format::texture::{MAX_CHANNELS, Texels, TextureError};
use perceptile::tile::TileShape;

use super::ExportArgs;
use crate::cli::exit::Misuse;

/// What `--format` offers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ExportFormat {
    /// PNG with 8 bits per channel, a file for each frame
    Png8,
    /// PNG with 16 bits per channel, a file for each frame
    Png16,
    /// KTX2 texture array: Bevy, Vulkan, D3D12, Godot
    Ktx2,
    /// KTX2 volume, 8 bits: three.js and WebGL, which read no arrays from KTX2
    #[value(name = "ktx2-3d")]
    Ktx2Volume,
    /// 8-bit texels and nothing else, with a description in .raw.json
    Raw8,
    /// 16-bit texels, little-endian, likewise
    Raw16,
    /// EXR with floats, a file for each frame
    Exr,
    /// Integers in a .npy array (frames, height, width, samples, dimensions)
    Npy,
    /// The function that reads the texture in a program or shader
    Header,
}

impl ExportFormat {
    /// Its name on the command line.
    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// The bits that its name says.
    fn bits(self) -> Option<u32> {
        match self {
            Self::Png8 | Self::Raw8 | Self::Ktx2Volume => Some(8),
            Self::Png16 | Self::Raw16 => Some(16),
            Self::Ktx2 | Self::Exr | Self::Npy | Self::Header => None,
        }
    }
}

/// What `--language` offers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LanguageName {
    /// C and C++, for raw volumes
    C,
    /// HLSL
    Hlsl,
    /// GLSL
    Glsl,
    /// WGSL
    Wgsl,
}

impl From<LanguageName> for Language {
    fn from(name: LanguageName) -> Self {
        match name {
            LanguageName::C => Self::C,
            LanguageName::Hlsl => Self::Hlsl,
            LanguageName::Glsl => Self::Glsl,
            LanguageName::Wgsl => Self::Wgsl,
        }
    }
}

/// Reads the channels of a texel.
pub fn texels(text: &str) -> Result<Texels, &'static str> {
    let rule = "it must be r, rg, rgb or rgba";
    Texels::ALL.into_iter().find(|texels| texels.to_string() == text).ok_or(rule)
}

/// What is to be written.
#[derive(Debug, Clone, Copy)]
pub enum Form {
    /// Pictures, and what their folder's name ends with.
    Pictures { options: SliceOptions, folder: &'static str },
    /// A single file.
    File(FileForm),
}

/// What is to be written into a single file.
#[derive(Debug, Clone, Copy)]
pub enum FileForm {
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
    pub fn new(args: &ExportArgs) -> Result<Self, Misuse> {
        let is_header = args.format == ExportFormat::Header;
        for (flag, given, rule, holds) in [
            ("--strip", args.strip, "png8 or png16", is_png(args.format)),
            ("--layers", args.layers, "exr", args.format == ExportFormat::Exr),
            ("--plain-numbers", args.plain_numbers, "png8, png16 or exr", is_picture(args.format)),
            ("--language", args.language.is_some(), "header", is_header),
            ("--for", args.reads.is_some(), "header", is_header),
        ] {
            if given && !holds {
                return Err(misfit(flag, args.format, rule));
            }
        }
        let language = args.language.map_or(Language::C, Language::from);
        let read = match args.reads {
            None if language == Language::C && args.bits == Some(16) => ExportFormat::Raw16,
            None if language == Language::C => ExportFormat::Raw8,
            None => ExportFormat::Ktx2,
            Some(read) => read,
        };
        let format = if is_header { read } else { args.format };
        let depth = depth(format, args.bits)?;
        let texels = args.texels;
        if is_png(format) && texels == Some(Texels::Rg) {
            let what = "--texels rg does not go with PNG, which has no pixels of two channels";
            return Err(Misuse(format!("{what}: rgb and rgba do, and --format ktx2 has rg")));
        }
        if texels.is_some() && format == ExportFormat::Npy {
            return Err(misfit("--texels", format, "pictures and textures"));
        }
        let stack = if args.strip { Stack::Strip } else { Stack::Files };
        let slices = SliceOptions {
            picture: Picture::Png(depth),
            stack,
            padded: !args.plain_numbers,
            texels,
        };
        Ok(match args.format {
            ExportFormat::Png8 => Self::Pictures { options: slices, folder: "png8" },
            ExportFormat::Png16 => Self::Pictures { options: slices, folder: "png16" },
            ExportFormat::Exr => {
                let stack = if args.layers { Stack::Layers } else { Stack::Files };
                let options = SliceOptions { picture: Picture::Exr, stack, ..slices };
                Self::Pictures { options, folder: "exr" }
            }
            ExportFormat::Ktx2 => {
                Self::File(FileForm::Ktx2 { texels, depth, layout: Layout::Array })
            }
            ExportFormat::Ktx2Volume => {
                Self::File(FileForm::Ktx2 { texels, depth, layout: Layout::Volume })
            }
            ExportFormat::Raw8 | ExportFormat::Raw16 => Self::File(FileForm::Raw { texels, depth }),
            ExportFormat::Npy => Self::File(FileForm::Npy { depth }),
            ExportFormat::Header => {
                let storage = storage(read)?;
                Self::File(FileForm::Header { language, storage, texels, depth })
            }
        })
    }

    /// The bits of its levels, if it has levels.
    pub fn depth(&self) -> Option<Depth> {
        match *self {
            Self::Pictures {
                options: SliceOptions { picture: Picture::Png(depth), .. }, ..
            } => Some(depth),
            Self::Pictures { .. } => None,
            Self::File(
                FileForm::Ktx2 { depth, .. }
                | FileForm::Raw { depth, .. }
                | FileForm::Npy { depth }
                | FileForm::Header { depth, .. },
            ) => Some(depth),
        }
    }
}

impl FileForm {
    /// The file for a tile of this name.
    pub fn name(&self, tile: &str) -> String {
        match self {
            Self::Ktx2 { .. } => format!("{tile}.ktx2"),
            Self::Raw { .. } => format!("{tile}.raw"),
            // Never the tile itself.
            Self::Npy { depth } => format!("{tile}-u{}.npy", 8 * depth.bytes()),
            Self::Header { language, .. } => format!("{tile}.{}", language.extension()),
        }
    }

    /// Whether it has the samples of a tile.
    pub fn has_samples(&self) -> bool {
        !matches!(self, Self::Header { .. })
    }
}

/// What a header reads that is for a format.
///
/// # Errors
/// A format without headers.
fn storage(read: ExportFormat) -> Result<Storage, Misuse> {
    match read {
        ExportFormat::Ktx2 => Ok(Storage::Array),
        ExportFormat::Ktx2Volume => Ok(Storage::Volume),
        ExportFormat::Png8 | ExportFormat::Png16 => Ok(Storage::Strip),
        ExportFormat::Raw8 | ExportFormat::Raw16 => Ok(Storage::Memory),
        ExportFormat::Exr | ExportFormat::Npy | ExportFormat::Header => {
            let rule = "ktx2, ktx2-3d, png8 and png16 (their strips), raw8 and raw16 do";
            Err(Misuse(format!("--for {} has no header: {rule}", read.name())))
        }
    }
}

/// Checks that pictures have the channels for what they hold.
///
/// # Errors
/// Fewer channels than dimensions.
pub fn check_pictures(shape: TileShape, options: &SliceOptions) -> Result<(), TextureError> {
    let dims = if shape.dims() > MAX_CHANNELS { 2 } else { shape.dims() };
    match options.texels {
        Some(texels) if texels.channels() < dims => Err(TextureError::Dims { dims, texels }),
        _ => Ok(()),
    }
}

fn is_png(format: ExportFormat) -> bool {
    matches!(format, ExportFormat::Png8 | ExportFormat::Png16)
}

fn is_picture(format: ExportFormat) -> bool {
    is_png(format) || format == ExportFormat::Exr
}

fn misfit(flag: &str, format: ExportFormat, rule: &str) -> Misuse {
    Misuse(format!("{flag} does not go with --format {}, but with {rule}", format.name()))
}

/// The bits of a channel.
fn depth(format: ExportFormat, bits: Option<u32>) -> Result<Depth, Misuse> {
    let named = format.bits();
    let wrong = |bits: u32| {
        let name = format.name();
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
        Misuse(format!("--bits {bits} does not go with {name}: {instead}"))
    };
    match (named, bits) {
        (Some(named), Some(bits)) if named != bits => Err(wrong(bits)),
        (_, Some(_)) if format == ExportFormat::Exr => {
            let rule = "its numbers are floats; ktx2, raw16 and png16 have levels";
            Err(Misuse(format!("--bits does not go with exr: {rule}")))
        }
        (Some(8), _) | (None, Some(8)) => Ok(Depth::Eight),
        (Some(_), _) | (None, Some(16)) => Ok(Depth::Sixteen),
        (None, Some(bits)) => Err(wrong(bits)),
        (None, None) if format == ExportFormat::Npy => Ok(Depth::Sixteen),
        (None, None) => Ok(Depth::Eight),
    }
}
