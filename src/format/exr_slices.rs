//! Tiles as EXR files: a file for each slice, or one with a layer for each, as floats without rounding.
//!
//! One dimension is Y, two are R and G (B is 0), three RGB, four RGBA, as in PNG files. Everything
//! that a file claims about its size is held against limits before memory is taken.

use std::fs::File;
use std::io::{BufReader, Cursor, Write};
use std::path::Path;

use ::exr as codec;
use codec::image::{AnyChannel, AnyChannels, Encoding, FlatSamples, Image, Layer};
use codec::math::Vec2;
use codec::meta::MetaData;
use codec::meta::attribute::IntegerBounds;
use codec::meta::header::{ImageAttributes, LayerAttributes};
use codec::prelude::{Text, WritableImage};

use super::exr::{self, ExrError};
use super::png::PixelFormat;
use super::slices::SOFTWARE;
use super::source::Slice;

/// Most numbers of all layers of a file: 1 GiB.
const MAX_VALUES: usize = 1 << 28;

/// The names of the channels of a pixel, in our order.
fn names(layout: PixelFormat) -> &'static [&'static str] {
    match layout {
        PixelFormat::Gray => &["Y"],
        PixelFormat::GrayAlpha => &["Y", "A"],
        PixelFormat::Rgb => &["R", "G", "B"],
        PixelFormat::Rgba => &["R", "G", "B", "A"],
    }
}

/// Writes slices of equal size as the layers of one file, under their names if they have some.
///
/// # Errors
/// What the codec or `out` reports.
pub(super) fn write(
    slices: &[(String, Slice)],
    out: &mut (impl Write + ?Sized),
) -> std::io::Result<()> {
    let layers: Vec<Layer<AnyChannels<FlatSamples>>> = slices
        .iter()
        .map(|(name, slice)| {
            let names = names(slice.layout);
            let channel = |(at, &name): (usize, &&str)| {
                let plane = slice.coordinates.iter().skip(at).step_by(names.len());
                AnyChannel::new(name, FlatSamples::F32(plane.copied().collect()))
            };
            let channels = AnyChannels::sort(names.iter().enumerate().map(channel).collect());
            let attributes = LayerAttributes {
                layer_name: Text::new_or_none(name).filter(|_| !name.is_empty()),
                software_name: Text::new_or_none(SOFTWARE),
                ..LayerAttributes::default()
            };
            Layer::new((slice.width, slice.height), attributes, Encoding::UNCOMPRESSED, channels)
        })
        .collect();
    let window = IntegerBounds::from_dimensions(layers[0].size);
    let image = Image::from_layers(ImageAttributes::new(window), layers);
    let mut file = Cursor::new(Vec::new());
    image.write().to_buffered(&mut file).map_err(std::io::Error::other)?;
    out.write_all(&file.into_inner())
}

/// Reads all layers, with their names, in the order of the file.
///
/// # Errors
/// A file that is none, too large, or with a layer that has neither Y nor R, G and B.
pub(super) fn read(path: &Path) -> Result<Vec<(String, Slice)>, ExrError> {
    let file = File::open(path).map_err(codec::error::Error::from)?;
    let meta = MetaData::read_from_buffered(BufReader::new(file), false)?;
    let mut values = 0_usize;
    for header in &meta.headers {
        let Vec2(width, height) = header.layer_size;
        let channels = header.channels.list.len();
        let of_layer = width.saturating_mul(height).saturating_mul(channels);
        values = values.saturating_add(of_layer);
        if of_layer == 0 || values > MAX_VALUES {
            return Err(ExrError::Size { width, height, channels });
        }
    }
    exr::read_layers(path)?.layer_data.into_iter().map(slice).collect()
}

/// The software that a file says it was made by.
pub(super) fn software(path: &Path) -> Option<String> {
    let file = File::open(path).ok()?;
    let meta = MetaData::read_from_buffered(BufReader::new(file), false).ok()?;
    let software = meta.headers.first()?.own_attributes.software_name.as_ref()?;
    Some(software.to_string())
}

/// What a layer has of a slice.
fn slice(layer: Layer<AnyChannels<FlatSamples>>) -> Result<(String, Slice), ExrError> {
    let Vec2(width, height) = layer.size;
    let find = |name: &str| {
        let channel = layer.channel_data.list.iter().find(|channel| channel.name == *name);
        channel.filter(|it| it.sampling == Vec2(1, 1) && it.sample_data.len() == width * height)
    };
    let layouts = [PixelFormat::Rgba, PixelFormat::Rgb, PixelFormat::GrayAlpha, PixelFormat::Gray];
    let planes = |layout| names(layout).iter().map(|name| find(name)).collect::<Option<Vec<_>>>();
    let (layout, planes) = layouts
        .into_iter()
        .find_map(|layout| Some((layout, planes(layout)?)))
        .ok_or(ExrError::Colours)?;
    let mut coordinates = vec![0.0; width * height * planes.len()];
    for (at, plane) in planes.iter().enumerate() {
        let pixels = coordinates.iter_mut().skip(at).step_by(planes.len());
        for (coordinate, value) in pixels.zip(plane.sample_data.values_as_f32()) {
            *coordinate = value;
        }
    }
    let name = layer.attributes.layer_name.map_or_else(String::new, |name| name.to_string());
    Ok((name, Slice { width, height, layout, depth: None, coordinates }))
}
