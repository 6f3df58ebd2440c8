//! Functions that read a tile in a program or shader, with sizes and decoding filled in.
//!
//! Each language has one function for all numbers of a sample, and one for a single number. Both go on
//! beyond what the tile has: further samples, and further numbers of a sample, are read from the same
//! tile at another place. Places are those of the R₂ sequence (Roberts 2018), which keeps any few of
//! them far from each other.

use std::fmt;

use thiserror::Error;

use crate::domain::{Domain, Surface};
use crate::format::png::Depth;
use crate::format::texture::{Texels, TextureError, texels_for};
use crate::tile::TileShape;

/// Most texels across or down: more does no GPU load.
pub const MAX_SIDE: usize = 1 << 15;

/// A language of headers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Language {
    /// C from C99 on, and C++: reads a raw volume.
    C,
    /// HLSL from shader model 5 on.
    Hlsl,
    /// GLSL from 3.30 or ES 3.00 on.
    Glsl,
    /// WGSL.
    Wgsl,
}

impl Language {
    /// All, with the names that users type.
    pub const ALL: [(Self, &str); 4] =
        [(Self::C, "c"), (Self::Hlsl, "hlsl"), (Self::Glsl, "glsl"), (Self::Wgsl, "wgsl")];

    /// The extension of its files.
    pub fn extension(self) -> &'static str {
        match self {
            Self::C => "h",
            Self::Hlsl => "hlsl",
            Self::Glsl => "glsl",
            Self::Wgsl => "wgsl",
        }
    }
}

/// What a tile is read from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Storage {
    /// Bytes in memory, as those of a raw volume.
    Memory,
    /// A two-dimensional array, with a layer for each frame and sample.
    Array,
    /// A volume, likewise.
    Volume,
    /// A two-dimensional texture with all frames below each other.
    Strip,
}

impl fmt::Display for Storage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Memory => "memory",
            Self::Array => "a two-dimensional texture array",
            Self::Volume => "a three-dimensional texture",
            Self::Strip => "a two-dimensional texture",
        })
    }
}

/// Why there is no header.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
pub enum HeaderError {
    /// A tile that no texture holds.
    #[error(transparent)]
    Texture(#[from] TextureError),
    /// A side that is too long.
    #[error("the tile has {shape}, but a header reads at most {MAX_SIDE} texels across and down")]
    Side {
        /// The tile's shape.
        shape: TileShape,
    },
    /// A language that does not read this.
    #[error("{} reads no tile from {storage}: {rule}", format!("{language:?}").to_uppercase())]
    Storage {
        /// The language.
        language: Language,
        /// What the tile would be read from.
        storage: Storage,
        /// What works.
        rule: &'static str,
    },
    /// A strip of one sample of several.
    #[error(
        "a strip has one sample of a pixel, but the tile has {spp}: a texture array has all of them"
    )]
    Samples {
        /// Samples of a pixel.
        spp: usize,
    },
}

/// What a header is about.
#[derive(Debug, Clone, PartialEq)]
pub struct Header<'a> {
    /// What the tile is called; names in the program begin with it, as far as it is letters and digits.
    pub name: &'a str,
    /// The tile's shape.
    pub shape: TileShape,
    /// Where its samples live: unit vectors are made unit vectors again, points of a disk are around 0
    /// with a radius of 1.
    pub domain: Domain,
    /// Channels of a texel; those that GPUs have, if none are said.
    pub texels: Option<Texels>,
    /// Bits of a channel.
    pub depth: Depth,
    /// Where the tile is.
    pub storage: Storage,
}

impl Header<'_> {
    /// The program text.
    ///
    /// # Errors
    /// Any [`HeaderError`].
    pub fn text(&self, language: Language) -> Result<String, HeaderError> {
        let shape = self.shape;
        let texels = texels_for(shape, self.texels)?;
        if shape.width().max(shape.height()) > MAX_SIDE {
            return Err(HeaderError::Side { shape });
        }
        let is_memory = self.storage == Storage::Memory;
        if is_memory != (language == Language::C) {
            let rule = if is_memory { "--for ktx2 is a texture" } else { "--for raw8 is memory" };
            return Err(HeaderError::Storage { language, storage: self.storage, rule });
        }
        if self.storage == Storage::Strip && shape.spp() > 1 {
            return Err(HeaderError::Samples { spp: shape.spp() });
        }
        let identifier = self.identifier();
        let template = match language {
            Language::C => C,
            Language::Hlsl | Language::Glsl => SHADER,
            Language::Wgsl => WGSL,
        };
        let single = match language {
            Language::C => C_NUMBER,
            Language::Hlsl | Language::Glsl => SHADER_NUMBER,
            Language::Wgsl => WGSL_NUMBER,
        };
        let has_numbers = !self.domain.surface().is_round();
        let mut text = template.replace("@SINGLE@", if has_numbers { single } else { "" });
        let (texture, texel) = self.texture(language, texels);
        let levels = f64::from(self.depth.levels());
        for (mark, value) in [
            ("@WHAT@", self.what(texels)),
            ("@DECODE@", self.decode(language)),
            ("@TEXTURE@", texture),
            ("@TEXEL@", texel),
            ("@POINT@", point(language, shape.dims())),
            ("@PAIR@", if language == Language::Hlsl { "uint2" } else { "uvec2" }.to_owned()),
            ("@CHANNELS@", "rgba"[..shape.dims()].to_owned()),
            ("@PICK@", pick(shape.dims()).to_owned()),
            ("@UPPER@", identifier.to_uppercase()),
            ("@NAME@", identifier),
            ("@WIDTH@", shape.width().to_string()),
            ("@HEIGHT@", shape.height().to_string()),
            ("@FRAMES@", shape.frames().to_string()),
            ("@SPP@", shape.spp().to_string()),
            ("@DIMS@", shape.dims().to_string()),
            ("@TEXELS@", texels.channels().to_string()),
            ("@SCALE@", format!("{:.1} / {levels:.1}", levels - 1.0)),
            ("@LEVELS@", format!("{levels:.1}")),
            ("@HALF@", format!("0.5 / {levels:.1}")),
        ] {
            text = text.replace(mark, &value);
        }
        Ok(text)
    }

    /// What the tile is called in programs: letters, digits and single underscores.
    fn identifier(&self) -> String {
        let mut text = String::new();
        for c in self.name.chars() {
            let c = if c.is_ascii_alphanumeric() { c } else { '_' };
            if c != '_' || !text.ends_with('_') {
                text.push(c);
            }
        }
        let text = text.trim_matches('_');
        let is_free =
            text.starts_with(|c: char| c.is_ascii_alphabetic()) && !text.starts_with("gl_");
        if is_free { text.to_owned() } else { format!("tile_{text}").trim_matches('_').to_owned() }
    }

    fn what(&self, texels: Texels) -> String {
        let letters = texels.to_string().to_uppercase();
        let bits = 8 * self.depth.bytes();
        let unorm = if self.storage == Storage::Memory { "" } else { "_UNORM" };
        let format: String = letters.chars().map(|letter| format!("{letter}{bits}")).collect();
        format!("{}: {}, {format}{unorm}, in {}", self.name, self.shape, self.storage)
            // What would end a comment, or the line.
            .replace("*/", "* /")
            .replace(char::is_control, " ")
    }

    /// From coordinates in [0, 1), in the variable `at` (`point` in C), to samples of the domain.
    fn decode(&self, language: Language) -> String {
        let surface = self.domain.surface();
        let is_ball = surface == Surface::Ball;
        let text = match language {
            _ if !surface.is_round() => "",
            Language::C if is_ball => C_BALL,
            Language::C => C_SPHERE,
            _ if is_ball => "    at = 2.0 * at - 1.0;\n",
            _ => "    at = normalize(2.0 * at - 1.0);\n",
        };
        text.to_owned()
    }

    /// The type of the texture, and how one of its texels is fetched at `place` and `layer`.
    fn texture(&self, language: Language, texels: Texels) -> (String, String) {
        let components = texels.channels();
        let components = if components == 1 { String::new() } else { components.to_string() };
        let height = self.shape.height();
        let (texture, texel) = match (language, self.storage) {
            (Language::Hlsl, Storage::Array) => (
                format!("Texture2DArray<float{components}>"),
                "tile.Load(int4(place, layer, 0))".to_owned(),
            ),
            (Language::Hlsl, Storage::Volume) => (
                format!("Texture3D<float{components}>"),
                "tile.Load(int4(place, layer, 0))".to_owned(),
            ),
            (Language::Hlsl, _) => (
                format!("Texture2D<float{components}>"),
                format!("tile.Load(int3(place.x, layer * {height}u + place.y, 0))"),
            ),
            (Language::Glsl, Storage::Array) => (
                "highp sampler2DArray".to_owned(),
                "texelFetch(tile, ivec3(ivec2(place), int(layer)), 0)".to_owned(),
            ),
            (Language::Glsl, Storage::Volume) => (
                "highp sampler3D".to_owned(),
                "texelFetch(tile, ivec3(ivec2(place), int(layer)), 0)".to_owned(),
            ),
            (Language::Glsl, _) => (
                "highp sampler2D".to_owned(),
                format!("texelFetch(tile, ivec2(uvec2(place.x, layer * {height}u + place.y)), 0)"),
            ),
            (Language::Wgsl, Storage::Array) => (
                "texture_2d_array<f32>".to_owned(),
                "textureLoad(tile, place, layer, 0)".to_owned(),
            ),
            (Language::Wgsl, Storage::Volume) => (
                "texture_3d<f32>".to_owned(),
                "textureLoad(tile, vec3<u32>(place, layer), 0)".to_owned(),
            ),
            (Language::Wgsl, _) => (
                "texture_2d<f32>".to_owned(),
                format!("textureLoad(tile, vec2<u32>(place.x, layer * {height}u + place.y), 0)"),
            ),
            (Language::C, _) => (format!("uint{}_t", 8 * self.depth.bytes()), String::new()),
        };
        (texture, texel)
    }
}

/// The type of a sample of so many dimensions; C has arrays.
fn point(language: Language, dims: usize) -> String {
    match (language, dims) {
        (Language::C, _) => String::new(),
        (Language::Wgsl, 1) => "f32".to_owned(),
        (Language::Wgsl, _) => format!("vec{dims}<f32>"),
        (_, 1) => "float".to_owned(),
        (Language::Hlsl, _) => format!("float{dims}"),
        (Language::Glsl, _) => format!("vec{dims}"),
    }
}

/// How one number of a sample is taken from it.
fn pick(dims: usize) -> &'static str {
    if dims == 1 { "" } else { "[dimension % @DIMS@u]" }
}

const C: &str = "\
/* @WHAT@.
   x fastest, then y, sample and frame; numbers of a sample side by side.
   Written by Perceptile; use it as you like. */
#ifndef @UPPER@_H
#define @UPPER@_H

#include <math.h>
#include <stdint.h>

/* The numbers of sample `index` of a pixel in a frame, for decision `number` of its path, both from 0
   and as far as you like: what the tile has not is read from another place of it. */
static inline void @NAME@_point(const @TEXTURE@ *tile, uint32_t x, uint32_t y, uint32_t frame,
                                uint32_t index, uint32_t number, float point[@DIMS@]) {
    const uint32_t other = number + 1009u * (index / @SPP@u);
    const uint32_t column = (x % @WIDTH@u + (((other * 3242174889u) >> 16) * @WIDTH@u >> 16)) % @WIDTH@u;
    const uint32_t row = (y % @HEIGHT@u + (((other * 2447445414u) >> 16) * @HEIGHT@u >> 16)) % @HEIGHT@u;
    const uint64_t layer = (uint64_t)(frame % @FRAMES@u) * @SPP@u + index % @SPP@u;
    const @TEXTURE@ *texel = tile + ((layer * @HEIGHT@u + row) * @WIDTH@u + column) * @TEXELS@u;
    for (int k = 0; k < @DIMS@; k++) {
        point[k] = (float)((texel[k] + 0.5) / @LEVELS@);
    }
@DECODE@}
@SINGLE@
#endif
";

const C_NUMBER: &str = "
/* One number alone, of as many dimensions as you like. */
static inline float @NAME@_number(const @TEXTURE@ *tile, uint32_t x, uint32_t y, uint32_t frame,
                                  uint32_t index, uint32_t dimension) {
    float point[@DIMS@];
    @NAME@_point(tile, x, y, frame, index, dimension / @DIMS@u, point);
    return point[dimension % @DIMS@u];
}
";

const C_BALL: &str = "    for (int k = 0; k < @DIMS@; k++) {
        point[k] = 2.0f * point[k] - 1.0f;
    }
";

const C_SPHERE: &str = "    float square = 0.0f;
    for (int k = 0; k < @DIMS@; k++) {
        point[k] = 2.0f * point[k] - 1.0f;
        square += point[k] * point[k];
    }
    for (int k = 0; k < @DIMS@; k++) {
        point[k] /= sqrtf(square);
    }
";

/// GLSL and HLSL, which differ in the names of types.
const SHADER: &str = "\
// @WHAT@, linear, without mipmaps.
// Written by Perceptile; use it as you like.

// The numbers of sample `index` of a pixel in a frame, for decision `number` of its path, both from 0
// and as far as you like: what the tile has not is read from another place of it.
@POINT@ @NAME@_point(@TEXTURE@ tile, @PAIR@ pixel, uint frame, uint index, uint number) {
    uint other = number + 1009u * (index / @SPP@u);
    @PAIR@ size = @PAIR@(@WIDTH@u, @HEIGHT@u);
    @PAIR@ shift = (((@PAIR@(3242174889u, 2447445414u) * other) >> 16u) * size) >> 16u;
    @PAIR@ place = (pixel % size + shift) % size;
    uint layer = (frame % @FRAMES@u) * @SPP@u + index % @SPP@u;
    @POINT@ at = @TEXEL@.@CHANNELS@ * (@SCALE@) + @HALF@;
@DECODE@    return at;
}
@SINGLE@";

const SHADER_NUMBER: &str = "
// One number alone, of as many dimensions as you like.
float @NAME@_number(@TEXTURE@ tile, @PAIR@ pixel, uint frame, uint index, uint dimension) {
    return @NAME@_point(tile, pixel, frame, index, dimension / @DIMS@u)@PICK@;
}
";

const WGSL: &str = "\
// @WHAT@, linear, without mipmaps.
// Written by Perceptile; use it as you like.

// The numbers of sample `index` of a pixel in a frame, for decision `number` of its path, both from 0
// and as far as you like: what the tile has not is read from another place of it.
fn @NAME@_point(tile: @TEXTURE@, pixel: vec2<u32>, frame: u32, index: u32, number: u32) -> @POINT@ {
    let other = number + 1009u * (index / @SPP@u);
    let size = vec2<u32>(@WIDTH@u, @HEIGHT@u);
    let high = vec2<u32>(16u, 16u);
    let shift = (((vec2<u32>(3242174889u, 2447445414u) * other) >> high) * size) >> high;
    let place = (pixel % size + shift) % size;
    let layer = (frame % @FRAMES@u) * @SPP@u + index % @SPP@u;
    var at = @TEXEL@.@CHANNELS@ * (@SCALE@) + @HALF@;
@DECODE@    return at;
}
@SINGLE@";

const WGSL_NUMBER: &str = "
// One number alone, of as many dimensions as you like.
fn @NAME@_number(tile: @TEXTURE@, pixel: vec2<u32>, frame: u32, index: u32, dimension: u32) -> f32 {
    let point = @NAME@_point(tile, pixel, frame, index, dimension / @DIMS@u);
    return point@PICK@;
}
";
