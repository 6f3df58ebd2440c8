//! One OpenEXR file: the colours of a picture in, and pictures like it out.
//!
//! Read are R, G and B of the first layer that is neither deep nor without them. A picture is as
//! large as the display window; what lies outside of the data window is black. Everything that a
//! file claims about its size is held against limits before memory is taken.

use std::fs::File;
use std::io::{BufReader, Cursor};
use std::path::Path;

use ::exr as codec;
use codec::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer, Layers};
use codec::math::Vec2;
use codec::meta::MetaData;
use codec::meta::attribute::{IntegerBounds, SampleType};
use codec::meta::header::{Header, ImageAttributes, LayerAttributes};
use codec::prelude::{ReadChannels, ReadLayers, WritableImage, f16};
use thiserror::Error;

/// Most pixels that are read.
pub const MAX_PIXELS: usize = 1 << 28;
/// Most numbers of all channels.
const MAX_VALUES: usize = 1 << 31;
/// The channels of a colour, in our order.
const COLOURS: [&str; 3] = ["R", "G", "B"];

/// Why an EXR file cannot be read or written.
#[derive(Debug, Error)]
pub enum ExrError {
    /// The file breaks the format or has what is not read, or reading it failed.
    #[error("not a readable EXR file: {0}")]
    Codec(codec::error::Error),
    /// No colours.
    #[error("no layer of the EXR file has channels R, G and B, each with a number for every pixel")]
    Colours,
    /// Larger than any that is read.
    #[error(
        "the EXR file has {width}x{height} pixels in {channels} channels, but at most {MAX_PIXELS} pixels are read"
    )]
    Size {
        /// Pixels across.
        width: usize,
        /// Pixels down.
        height: usize,
        /// Channels.
        channels: usize,
    },
    /// Files whose pixels are to be put together have other channels or windows.
    #[error("the channels or windows of {other} are not those of {first}")]
    Unlike {
        /// A file.
        first: String,
        /// Another one.
        other: String,
    },
}

impl From<codec::error::Error> for ExrError {
    fn from(error: codec::error::Error) -> Self {
        Self::Codec(error)
    }
}

/// A file with all its channels.
type Whole = Image<Layer<AnyChannels<FlatSamples>>>;

/// What a file says besides its pixels, so that others like it can be written.
#[derive(Debug, Clone)]
pub struct ExrTemplate {
    image: ImageAttributes,
    layer: LayerAttributes,
    encoding: Encoding,
    /// Whether colours are of 16 bits.
    half: bool,
    /// Whether there is more than colours.
    has_others: bool,
}

impl ExrTemplate {
    /// Whether the file has channels besides R, G and B.
    pub fn has_others(&self) -> bool {
        self.has_others
    }

    /// Whether its colours are half floats.
    pub fn is_half(&self) -> bool {
        self.half
    }

    /// Pixels across and down.
    pub fn size(&self) -> [usize; 2] {
        let Vec2(width, height) = self.image.display_window.size;
        [width, height]
    }
}

/// Reads what stands before the pixels.
///
/// # Errors
/// A file that is none, too large a picture, no colours.
pub fn read_template(path: &Path) -> Result<ExrTemplate, ExrError> {
    let file = File::open(path).map_err(codec::error::Error::from)?;
    let meta = MetaData::read_from_buffered(BufReader::new(file), false)?;
    let header = meta.headers.iter().find(|header| has_colours(header)).ok_or(ExrError::Colours)?;
    let channels = header.channels.list.len();
    let sizes = [header.shared_attributes.display_window.size, header.layer_size];
    for Vec2(width, height) in sizes {
        let pixels = width.saturating_mul(height);
        if pixels == 0 || pixels > MAX_PIXELS || pixels.saturating_mul(channels) > MAX_VALUES {
            return Err(ExrError::Size { width, height, channels });
        }
    }
    let half = |name: &str| {
        let found = header.channels.list.iter().find(|channel| channel.name == *name);
        found.is_some_and(|channel| channel.sample_type == SampleType::F16)
    };
    Ok(ExrTemplate {
        image: header.shared_attributes.clone(),
        layer: header.own_attributes.clone(),
        encoding: Encoding {
            compression: header.compression,
            blocks: codec::image::Blocks::ScanLines,
            line_order: codec::meta::attribute::LineOrder::Increasing,
        },
        half: COLOURS.into_iter().all(half),
        has_others: channels > COLOURS.len(),
    })
}

/// Whether a layer has colours that can be read.
fn has_colours(header: &Header) -> bool {
    let is_whole = |name: &str| {
        let found = header.channels.list.iter().find(|channel| channel.name == *name);
        found.is_some_and(|channel| {
            channel.sampling == Vec2(1, 1) && channel.sample_type != SampleType::U32
        })
    };
    !header.deep && COLOURS.into_iter().all(is_whole)
}

/// Reads all layers with all channels, of a file that was held against limits.
///
/// # Errors
/// What the codec reports.
pub(super) fn read_layers(
    path: &Path,
) -> Result<Image<Layers<AnyChannels<FlatSamples>>>, codec::error::Error> {
    codec::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .all_layers()
        .all_attributes()
        .from_file(path)
}

fn read_whole(path: &Path) -> Result<Whole, ExrError> {
    // Held against the limits first.
    read_template(path)?;
    let layers = read_layers(path)?;
    let layer = layers
        .layer_data
        .into_iter()
        .find(|layer| COLOURS.into_iter().all(|name| colour(layer, name).is_some()));
    let layer_data = layer.ok_or(ExrError::Colours)?;
    Ok(Image { attributes: layers.attributes, layer_data })
}

/// A channel with a number for every pixel.
fn colour<'a>(layer: &'a Layer<AnyChannels<FlatSamples>>, name: &str) -> Option<&'a FlatSamples> {
    let channel = layer.channel_data.list.iter().find(|channel| channel.name == *name)?;
    let whole = channel.sampling == Vec2(1, 1)
        && !matches!(channel.sample_data, FlatSamples::U32(_))
        && channel.sample_data.len() == layer.size.area();
    whole.then_some(&channel.sample_data)
}

/// Reads the colours: three planes of the display window, row by row, R, G, B.
///
/// # Errors
/// A file that is none, too large a picture, no colours.
pub fn read(path: &Path) -> Result<(ExrTemplate, Vec<f32>), ExrError> {
    let template = read_template(path)?;
    let [width, height] = template.size();
    let whole = read_whole(path)?;
    let layer = &whole.layer_data;
    let window = whole.attributes.display_window;
    let mut planes = vec![0.0; COLOURS.len() * width * height];
    for (name, plane) in COLOURS.into_iter().zip(planes.chunks_exact_mut(width * height)) {
        let samples = colour(layer, name).ok_or(ExrError::Colours)?;
        for (y, row) in plane.chunks_exact_mut(width).enumerate() {
            let Some((from, to, start)) = overlap(layer, window, y, width) else { continue };
            let row = &mut row[from..to];
            match samples {
                FlatSamples::F16(values) => {
                    for (out, value) in row.iter_mut().zip(&values[start..]) {
                        *out = value.to_f32();
                    }
                }
                FlatSamples::F32(values) => row.copy_from_slice(&values[start..][..row.len()]),
                FlatSamples::U32(_) => return Err(ExrError::Colours),
            }
        }
    }
    Ok((template, planes))
}

/// The columns of a row of the display window that the layer has, and where they begin in it.
fn overlap(
    layer: &Layer<AnyChannels<FlatSamples>>,
    window: IntegerBounds,
    y: usize,
    width: usize,
) -> Option<(usize, usize, usize)> {
    let offset = |axis: fn(Vec2<i32>) -> i32| {
        i64::from(axis(window.position)) - i64::from(axis(layer.attributes.layer_position))
    };
    let (dx, dy) = (offset(|Vec2(x, _)| x), offset(|Vec2(_, y)| y));
    let Vec2(columns, rows) = layer.size;
    let row = usize::try_from(y as i64 + dy).ok().filter(|&row| row < rows)?;
    let from = (-dx).max(0) as usize;
    let to = (columns as i64 - dx).clamp(0, width as i64) as usize;
    let start = row * columns + usize::try_from(from as i64 + dx).ok()?;
    (from < to).then_some((from, to, start))
}

/// The bytes of a file like the template, with these colours: three planes of the display window.
///
/// # Errors
/// What the codec reports.
///
/// # Panics
/// If the planes are not of the template's size.
pub fn encode(template: &ExrTemplate, planes: &[f32]) -> Result<Vec<u8>, ExrError> {
    let [width, height] = template.size();
    assert_eq!(planes.len(), COLOURS.len() * width * height);
    let channels = COLOURS.into_iter().zip(planes.chunks_exact(width * height));
    let channels = channels.map(|(name, plane)| {
        let samples = match template.half {
            true => FlatSamples::F16(plane.iter().map(|&value| f16::from_f32(value)).collect()),
            false => FlatSamples::F32(plane.to_vec()),
        };
        AnyChannel::new(name, samples)
    });
    let layer = Layer::new(
        (width, height),
        LayerAttributes {
            layer_position: template.image.display_window.position,
            ..template.layer.clone()
        },
        template.encoding,
        AnyChannels::sort(channels.collect()),
    );
    bytes(&Image { attributes: template.image.clone(), layer_data: layer })
}

/// The bytes of a file whose every pixel, with all its channels, is that of one of the files:
/// `choices` names it, for every pixel of the display window.
///
/// # Errors
/// Files that cannot be read, or whose channels and windows differ.
///
/// # Panics
/// If choices are not as many as pixels, or name a file that is not there.
pub fn encode_choices(files: &[&Path], choices: &[u8]) -> Result<Vec<u8>, ExrError> {
    let wholes: Vec<Whole> = files.iter().map(|path| read_whole(path)).collect::<Result<_, _>>()?;
    let mut result = wholes[0].clone();
    let kind = |whole: &Whole| {
        let channels = whole.layer_data.channel_data.list.iter();
        let channels: Vec<_> = channels
            .map(|channel| {
                let kind = std::mem::discriminant(&channel.sample_data);
                (channel.name.clone(), kind, channel.sampling, channel.sample_data.len())
            })
            .collect();
        (whole.layer_data.absolute_bounds(), whole.attributes.display_window, channels)
    };
    if let Some(at) = wholes.iter().position(|whole| kind(whole) != kind(&wholes[0])) {
        let name = |path: &Path| path.display().to_string();
        return Err(ExrError::Unlike { first: name(files[0]), other: name(files[at]) });
    }
    let window = result.attributes.display_window;
    let Vec2(width, height) = window.size;
    assert_eq!(choices.len(), width * height);
    for y in 0..height {
        let Some((from, to, start)) = overlap(&result.layer_data, window, y, width) else {
            continue;
        };
        let choices = &choices[y * width..][from..to];
        for (index, channel) in result.layer_data.channel_data.list.iter_mut().enumerate() {
            if channel.sampling != Vec2(1, 1) {
                continue;
            }
            for (x, &choice) in choices.iter().enumerate() {
                let source = &wholes[usize::from(choice)].layer_data.channel_data.list[index];
                let at = start + x;
                match (&mut channel.sample_data, &source.sample_data) {
                    (FlatSamples::F16(to), FlatSamples::F16(from)) => to[at] = from[at],
                    (FlatSamples::F32(to), FlatSamples::F32(from)) => to[at] = from[at],
                    (FlatSamples::U32(to), FlatSamples::U32(from)) => to[at] = from[at],
                    _ => unreachable!("channels are of one kind"),
                }
            }
        }
    }
    bytes(&result)
}

fn bytes(image: &Whole) -> Result<Vec<u8>, ExrError> {
    let mut file = Cursor::new(Vec::new());
    image.write().to_buffered(&mut file)?;
    Ok(file.into_inner())
}
