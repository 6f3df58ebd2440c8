//! A selection from files to files: frames are read ahead by a thread, engines choose, frames are
//! written.

use std::process::ExitCode;
use std::sync::mpsc;
use std::thread;
use std::time::Instant;

use perceptile::format::animation::{Animation, AnimationError};
use perceptile::gradient::simd::Simd;
use perceptile::run::memory;
use perceptile::select::{Filters, Frame, SelectOptions, SelectState, Selection, foreseen};
use sha2::{Digest, Sha256};

use super::SelectArgs;
use super::inputs::Inputs;
use super::outputs::{Claimed, Outputs};
use super::progress::Progress;
use super::summary::{self, Seconds};
use crate::cli::execution;
use crate::cli::exit::{Failure, Misuse};
use crate::cli::stream::{say, show};

/// Frames that are read before they are asked for.
const AHEAD: usize = 1;
/// Bytes that reading, writing and the program itself take besides.
const FIXED: u64 = 64 << 20;

/// What is to be done.
pub struct Job<'a> {
    pub inputs: &'a Inputs,
    pub filters: &'a Filters,
    pub options: SelectOptions,
    pub threads: usize,
    pub simd: Simd,
}

/// A frame of all engines, and how long it took to read.
type Read = Result<(Vec<Frame>, f64), AnimationError>;

impl Job<'_> {
    /// Bytes of memory that it takes, and frames of the window.
    ///
    /// # Errors
    /// Options out of range.
    pub fn foreseen(&self) -> Result<(u64, usize), Failure> {
        let shape = self.inputs.shape()?;
        let (renders, subsets) = self.inputs.renders();
        let candidates = (renders, subsets);
        let (bytes, frames) =
            foreseen(shape, self.filters, candidates, &self.options, self.threads)?;
        let engines = self.inputs.engines() as u64;
        // Frames on their way: as they are read, decoded and waiting; and the one that is written.
        let frame = (4 * shape.values() * (renders + 1)) as u64;
        let on_the_way = frame.saturating_mul(AHEAD as u64 + 3);
        Ok(((bytes as u64 + on_the_way).saturating_mul(engines).saturating_add(FIXED), frames))
    }

    /// Checks that there is so much memory.
    ///
    /// # Errors
    /// If there is not.
    pub fn check_memory(&self) -> Result<(), Failure> {
        Ok(memory::check_bytes(self.foreseen()?.0)?)
    }

    /// What is about to be done.
    ///
    /// # Errors
    /// Options out of range.
    pub fn intent(&self, outputs: &Outputs) -> Result<String, Failure> {
        let needed = self.foreseen()?;
        Ok(summary::intent(self.inputs, &self.options, self.threads, needed, outputs))
    }

    /// Does it, and says what came out.
    ///
    /// # Errors
    /// Whatever keeps it from being done.
    pub fn run(&self, args: &SelectArgs, outputs: Outputs) -> Result<ExitCode, Failure> {
        self.check_memory()?;
        let intent = self.intent(&outputs)?;
        let pool = execution::pool(self.threads)?;
        pool.install(|| {
            let (renders, shape) = (self.inputs.renders(), self.inputs.shape()?);
            let engine = || Selection::new(shape, self.filters, renders, &self.options, self.simd);
            let mut engines: Vec<Selection> =
                (0..self.inputs.engines()).map(|_| engine()).collect::<Result<_, _>>()?;
            // From here on there are files that a signal must not leave behind.
            let mut progress = Progress::open(args.progress, shape.frames())
                .map_err(Failure::refused("cannot listen for signals"))?;
            let (mut claimed, kept) = outputs.claim(self.digest(args)?)?;
            let done = kept.first().map_or(0, SelectState::done);
            for (engine, state) in engines.iter_mut().zip(kept) {
                engine.restore(state)?;
            }
            progress.begin(intent.trim_end(), done);
            match self.go_on(args, engines, &mut claimed, &mut progress) {
                Ok(Some(report)) => self.finish(args, claimed, &report),
                Ok(None) => Ok(ExitCode::from(progress.received().unwrap_or(1) as u8)),
                Err(failure) => {
                    claimed.abandon();
                    Err(failure)
                }
            }
        })
    }

    /// Goes on until all frames are done, or nothing if a signal comes before.
    fn go_on(
        &self,
        args: &SelectArgs,
        mut engines: Vec<Selection>,
        claimed: &mut Claimed,
        progress: &mut Progress,
    ) -> Result<Option<summary::Report>, Failure> {
        let start = Instant::now();
        let mut seconds = Seconds::default();
        let first = engines[0].needed().start;
        thread::scope(|scope| {
            let (sender, frames) = mpsc::sync_channel::<Read>(AHEAD);
            scope.spawn(move || {
                for frame in first..self.inputs.guide.frames() {
                    let start = Instant::now();
                    let read = self.inputs.read(frame);
                    let read = read.map(|frames| (frames, start.elapsed().as_secs_f64()));
                    // Nobody listens any more once something went wrong.
                    if sender.send(read).is_err() {
                        return;
                    }
                }
            });
            let mut more = true;
            while more {
                if progress.received().is_some() {
                    progress.clear();
                    return Ok(None);
                }
                let states: Option<Vec<_>> = engines.iter().map(Selection::state).collect();
                if let Some(states) = states {
                    claimed.keep(states)?;
                }
                while !engines[0].needed().is_empty() {
                    let waiting = Instant::now();
                    let read = frames.recv().expect("as many frames as there are");
                    seconds.waiting += waiting.elapsed().as_secs_f64();
                    let (frame, reading) = read?;
                    seconds.reading += reading;
                    for (engine, frame) in engines.iter_mut().zip(&frame) {
                        engine.load(frame);
                    }
                }
                let sweeping = Instant::now();
                let mut result = None;
                let (mut pictures, mut choices) = (Vec::new(), Vec::new());
                for engine in &mut engines {
                    more = engine.advance(|frame, picture, chosen| {
                        result = Some(frame);
                        pictures.push(picture.to_vec());
                        choices.push(chosen.to_vec());
                    });
                }
                seconds.sweeps += sweeping.elapsed().as_secs_f64();
                if let Some(frame) = result {
                    let writing = Instant::now();
                    claimed.frame(frame, &pictures, &choices, self.inputs)?;
                    seconds.writing += writing.elapsed().as_secs_f64();
                    progress.done(frame + 1);
                }
            }
            progress.clear();
            seconds.all = start.elapsed().as_secs_f64();
            Ok(Some(summary::Report::new(
                (self.inputs, &self.options),
                args,
                &engines,
                seconds,
                claimed.outputs(),
            )))
        })
    }

    /// Gives the result its name and says what came out.
    fn finish(
        &self,
        args: &SelectArgs,
        claimed: Claimed,
        report: &summary::Report,
    ) -> Result<ExitCode, Failure> {
        claimed.finish(report)?;
        for warning in report.warnings() {
            say(warning);
        }
        show(args.json, report, || report.text())?;
        Ok(ExitCode::SUCCESS)
    }

    /// A number of all that decides the result: settings and the files as they are now.
    fn digest(&self, args: &SelectArgs) -> Result<String, Failure> {
        let mut hash = Sha256::new();
        let settings = (
            (env!("CARGO_PKG_VERSION"), &self.options, args.eye()?.to_string(), args.taa),
            (self.inputs.subsets, args.levels, args.transfer, self.inputs.is_true),
            (&self.inputs.names, self.inputs.guide.frames(), self.inputs.guide.size()),
        );
        hash.update(serde_json::to_vec(&settings)?);
        let animations = [&self.inputs.guide].into_iter().chain(&self.inputs.candidates);
        for animation in animations {
            for frame in 0..animation.frames() {
                hash.update(stamp(animation, frame)?);
            }
        }
        Ok(hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

/// The length of a frame's file and when it was changed last.
fn stamp(animation: &Animation, frame: usize) -> Result<String, Failure> {
    let path = animation.path(frame);
    let metadata = std::fs::metadata(path)
        .map_err(|error| Misuse(format!("cannot read {}: {error}", path.display())))?;
    Ok(format!("{} {:?}\n", metadata.len(), metadata.modified().ok()))
}
