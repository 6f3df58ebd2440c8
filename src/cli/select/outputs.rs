//! Where the result of a selection goes: the frames, the scores, and until it is done a file that it
//! can go on from.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use perceptile::array;
use perceptile::format::animation::{Animation, numbered, path_of};
use perceptile::format::claim::Claim;
use perceptile::format::exr::{self, ExrError, ExrTemplate};
use perceptile::format::png::{self, Depth, PixelFormat, Raster};
use perceptile::format::write::{self, Existing};
use perceptile::select::SelectState;
use perceptile_cluster::codec;
use serde::{Deserialize, Serialize};

use super::SelectArgs;
use super::inputs::{Display, Inputs};
use crate::cli::exit::{Failure, Misuse};

/// Most bytes of a state.
const MOST: usize = 1 << 33;

/// The files of a result.
#[derive(Debug)]
pub struct Outputs {
    /// The result as named.
    pub result: PathBuf,
    /// The scores.
    pub scores: PathBuf,
    state: PathBuf,
    form: Form,
    existing: Existing,
    shape: [usize; 4],
    first: u64,
}

#[derive(Debug)]
enum Form {
    /// One array; as long as it is not whole, under this name.
    Npy {
        partial: PathBuf,
    },
    Exr {
        template: Box<ExrTemplate>,
        carried: bool,
    },
    Png {
        display: Display,
    },
}

/// What is kept to go on from.
#[derive(Debug, Serialize, Deserialize)]
struct Kept {
    /// Of everything that decides the result.
    digest: String,
    states: Vec<SelectState>,
}

/// Outputs that nobody else writes.
pub struct Claimed {
    outputs: Outputs,
    digest: String,
    array: Option<File>,
    /// What frames may replace: their like, if the selection goes on.
    frames: Existing,
    /// Whether there is anything to go on from.
    has_frames: bool,
    _claim: Claim,
}

impl Outputs {
    /// The outputs that the arguments mean.
    ///
    /// # Errors
    /// A name that does not go with the form of the result.
    pub fn new(args: &SelectArgs, inputs: &Inputs) -> Result<Self, Failure> {
        let template = inputs.candidates.first().and_then(|animation| animation.template());
        let (default, extension) = match (inputs.display, template) {
            (Some(_), _) => ("dithered.####.png", "png"),
            (None, Some(_)) => ("selected.####.exr", "exr"),
            (None, None) => ("selected.npy", "npy"),
        };
        let result = args.out.clone().unwrap_or_else(|| default.into());
        let found = result.extension().and_then(|extension| extension.to_str());
        if !found.is_some_and(|found| found.eq_ignore_ascii_case(extension)) {
            let rule = format!("--out is {}, but the result is {extension}", result.display());
            return Err(Misuse(rule).into());
        }
        let frames = inputs.guide.frames();
        if extension != "npy" && frames > 1 && numbered(&result).is_none() {
            let rule = "but a name of many files must have a #, such as x.####";
            return Err(Misuse(format!("--out is {}, {rule}.{extension}", result.display())).into());
        }
        // The result's name without its number.
        let plain = match numbered(&result) {
            Some((before, _, after)) => {
                let stem = before.trim_end_matches(['.', '_', '-']);
                let stem = if stem.is_empty() { "selected" } else { stem };
                result.with_file_name(format!("{stem}{after}"))
            }
            None => result.clone(),
        };
        let has_others = |animation: &Animation| {
            animation.template().is_some_and(|(template, _)| template.has_others())
        };
        let form = match (inputs.display, template) {
            (Some(display), _) => Form::Png { display },
            (None, Some((template, _))) => Form::Exr {
                template: Box::new(template.clone()),
                carried: !inputs.subsets && inputs.candidates.iter().all(has_others),
            },
            (None, None) => Form::Npy { partial: plain.with_extension("npy.part") },
        };
        let [width, height] = inputs.guide.size();
        let shape = [frames, height, width, inputs.guide.channels()];
        let first = inputs.candidates.first().unwrap_or(&inputs.guide).template();
        Ok(Self {
            scores: plain.with_extension("json"),
            state: plain.with_extension("state"),
            result,
            form,
            existing: args.existing(),
            shape,
            first: first.map_or(0, |(_, first)| first),
        })
    }

    /// The file of a frame.
    fn frame(&self, frame: usize) -> PathBuf {
        path_of(&self.result, self.first + frame as u64)
    }

    /// Claims the outputs, and finds what a selection of this digest can go on from: the states of all
    /// engines, or nothing at its beginning.
    ///
    /// # Errors
    /// Outputs that exist, or that others are making; folders that are missing.
    pub fn claim(self, digest: String) -> Result<(Claimed, Vec<SelectState>), Failure> {
        let claim = Claim::new(&self.scores, Existing::Replace)?;
        let kept = self.kept(&digest)?;
        if kept.is_none() {
            let mut outputs = vec![self.scores.clone()];
            match &self.form {
                Form::Npy { partial } => outputs.extend([self.result.clone(), partial.clone()]),
                _ => outputs.extend((0..self.shape[0]).map(|frame| self.frame(frame))),
            }
            write::probe(outputs, self.existing)?;
        }
        let frames = if kept.is_some() { Existing::Replace } else { self.existing };
        let mut claimed = Claimed {
            outputs: self,
            digest,
            array: None,
            frames,
            has_frames: kept.is_some(),
            _claim: claim,
        };
        let states = kept.unwrap_or_default();
        claimed.open(states.first().map_or(0, SelectState::done))?;
        if !claimed.has_frames {
            claimed.keep(Vec::new())?;
        }
        Ok((claimed, states))
    }

    /// The states that are kept, if they are of this digest.
    fn kept(&self, digest: &str) -> Result<Option<Vec<SelectState>>, Failure> {
        if self.existing == Existing::Replace || !self.state.exists() {
            return Ok(None);
        }
        let bytes = fs::read(&self.state)
            .map_err(Failure::refused(&format!("cannot read {}", self.state.display())))?;
        let kept = codec::decode::<Kept, MOST>(&bytes).ok();
        let kept = kept.filter(|kept| kept.digest == digest);
        match kept {
            Some(kept) => Ok(Some(kept.states)),
            None => Err(Failure::exists(format!(
                "{} is that of a selection with other settings or inputs: --force gives it up",
                self.state.display()
            ))),
        }
    }
}

impl Claimed {
    /// The result as named.
    pub fn outputs(&self) -> &Outputs {
        &self.outputs
    }

    /// Opens the array that is not whole, behind the frames that are done.
    fn open(&mut self, done: usize) -> Result<(), Failure> {
        let Form::Npy { partial } = &self.outputs.form else { return Ok(()) };
        let what = format!("cannot write {}", partial.display());
        let shape = self.outputs.shape;
        let open = || -> io::Result<File> {
            let mut file = OpenOptions::new()
                .write(true)
                .read(true)
                .create(true)
                .truncate(false)
                .open(partial)?;
            let mut header = Vec::new();
            array::write_header(&shape, &mut header)?;
            let frame = shape[1..].iter().product::<usize>() * size_of::<f32>();
            let end = header.len() as u64 + (done * frame) as u64;
            if file.metadata()?.len() < end && done > 0 {
                return Err(io::Error::new(io::ErrorKind::InvalidData, "frames are missing in it"));
            }
            file.write_all(&header)?;
            file.set_len(end)?;
            file.seek(SeekFrom::Start(end))?;
            Ok(file)
        };
        self.array = Some(open().map_err(Failure::refused(&what))?);
        Ok(())
    }

    /// Writes a frame: its picture and the choices of each engine.
    ///
    /// # Errors
    /// A file that exists or cannot be written, or candidates that cannot be put together.
    pub fn frame(
        &mut self,
        frame: usize,
        pictures: &[Vec<f32>],
        choices: &[Vec<u8>],
        inputs: &Inputs,
    ) -> Result<(), Failure> {
        let [_, height, width, channels] = self.outputs.shape;
        let (path, pixels) = (self.outputs.frame(frame), width * height);
        let what = format!("cannot write {}", path.display());
        let refused = Failure::refused::<ExrError>(&what);
        let bytes = match &self.outputs.form {
            Form::Npy { partial } => {
                let file = self.array.as_mut().expect("open");
                let picture = &pictures[0];
                let mut out = BufWriter::with_capacity(1 << 16, file);
                let mut write = || -> io::Result<()> {
                    for pixel in 0..pixels {
                        for channel in 0..channels {
                            out.write_all(&picture[channel * pixels + pixel].to_le_bytes())?;
                        }
                    }
                    out.flush()
                };
                write()
                    .map_err(Failure::refused(&format!("cannot write {}", partial.display())))?;
                self.has_frames = true;
                return Ok(());
            }
            Form::Exr { carried: true, .. } => {
                let files: Vec<&Path> =
                    inputs.candidates.iter().map(|animation| animation.path(frame)).collect();
                exr::encode_choices(&files, &choices[0]).map_err(refused)?
            }
            Form::Exr { template, .. } => exr::encode(template, &pictures[0]).map_err(refused)?,
            Form::Png { display } => encode_levels(*display, self.outputs.shape, pictures)
                .map_err(Failure::refused(&what))?,
        };
        write::write(&path, self.frames, |out| out.write_all(&bytes))?;
        self.has_frames = true;
        Ok(())
    }

    /// Leaves nothing behind, if there is no frame yet.
    pub fn abandon(self) {
        if !self.has_frames {
            let _ = fs::remove_file(&self.outputs.state);
            if let Form::Npy { partial } = &self.outputs.form {
                let _ = fs::remove_file(partial);
            }
        }
    }

    /// Keeps what the selection can go on from.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub fn keep(&mut self, states: Vec<SelectState>) -> Result<(), Failure> {
        if let Some(file) = &self.array {
            let what = format!("cannot write {}", self.outputs.result.display());
            file.sync_data().map_err(Failure::refused(&what))?;
        }
        let kept = Kept { digest: self.digest.clone(), states };
        let bytes = codec::encode(&kept).map_err(Failure::refused("cannot keep the selection"))?;
        write::write(&self.outputs.state, Existing::Replace, |out| out.write_all(&bytes))?;
        Ok(())
    }

    /// Gives the array its name, writes the scores, and removes what was kept.
    ///
    /// # Errors
    /// Files that cannot be written, or that appeared meanwhile.
    pub fn finish(mut self, scores: &impl Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string_pretty(scores)? + "\n";
        if let (Some(file), Form::Npy { partial }) = (self.array.take(), &self.outputs.form) {
            let what = format!("cannot write {}", self.outputs.result.display());
            file.sync_all().map_err(Failure::refused(&what))?;
            drop(file);
            write::probe([&self.outputs.result], self.outputs.existing)?;
            fs::rename(partial, &self.outputs.result).map_err(Failure::refused(&what))?;
        }
        write::write(&self.outputs.scores, Existing::Replace, |out| {
            out.write_all(text.as_bytes())
        })?;
        let _ = fs::remove_file(&self.outputs.state);
        Ok(())
    }
}

/// The bytes of a PNG of light that a display has, a picture for each channel: levels fill the range of
/// its depth.
fn encode_levels(
    display: Display,
    [_, height, width, channels]: [usize; 4],
    pictures: &[Vec<f32>],
) -> io::Result<Vec<u8>> {
    let depth = if display.levels <= 256 { Depth::Eight } else { Depth::Sixteen };
    let (most, steps) = (u64::from(depth.levels() - 1), u64::from(display.levels - 1));
    let value =
        |light: f32| ((u64::from(display.level(light)) * most * 2 + steps) / (2 * steps)) as u16;
    let levels = (0..width * height)
        .flat_map(|pixel| pictures.iter().map(move |picture| value(picture[pixel])))
        .collect();
    let layout = if channels == 1 { PixelFormat::Gray } else { PixelFormat::Rgb };
    let mut bytes = Vec::new();
    png::encode(&Raster { width, height, layout, depth, levels }, &mut bytes)?;
    Ok(bytes)
}
