//! A selection from files to files: frames are read ahead by a thread, hands choose, frames are
//! written.

use std::path::Path;
use std::process::ExitCode;
use std::sync::{Arc, mpsc};
use std::thread;
use std::time::Instant;

use perceptile::format::animation::{Animation, AnimationError};
use perceptile::gradient::simd::Simd;
use perceptile::run::memory;
use perceptile::run::signals::Signals;
use perceptile::select::{Frame, SelectPlan, SelectState};
use perceptile_cluster::communicator::Communicator;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use super::SelectArgs;
use super::hands::Hands;
use super::inputs::Inputs;
use super::outputs::{Claimed, Outputs};
use super::progress::Progress;
use super::summary::{self, Seconds};
use crate::cli::exit::{Failure, Misuse};
use crate::cli::stream::{say, show};
use crate::cli::{execution, ranks};

/// Bytes that reading, writing and the program itself take besides, and what a worker takes for itself.
const FIXED: u64 = 64 << 20;
const OF_WORKER: u64 = 16 << 20;

/// What is to be done.
pub struct Job {
    pub inputs: Inputs,
    pub plan: SelectPlan,
    pub simd: Simd,
}

/// What other ranks have to know of it.
#[derive(Debug, Serialize, Deserialize)]
struct Brief {
    plan: SelectPlan,
    selections: usize,
}

/// A frame of all selections, and how long it took to read.
type Read = Result<(Vec<Frame>, f64), AnimationError>;

/// Does what the root has prepared, if there is something, with all ranks, and says what came out.
///
/// # Errors
/// What `prepared` says, and whatever keeps it from being done.
pub fn run(
    args: &SelectArgs,
    prepared: Result<Option<(Job, Outputs)>, Failure>,
    communicator: &Arc<dyn Communicator>,
) -> Result<ExitCode, Failure> {
    let brief = match &prepared {
        Ok(job) => Ok(job.as_ref().map(|(job, _)| job.brief())),
        Err(failure) => Err(failure.code()),
    };
    ranks::tell(&**communicator, &brief)?;
    let Some((job, outputs)) = prepared? else { return Ok(ExitCode::SUCCESS) };
    let pool = || Ok(execution::pool(args.execution.threads()?)?);
    let pool = ranks::agree(&**communicator, pool())?;
    // Workers end with the thread that starts them, which is one of the pool's.
    pool.install(|| job.run(args, outputs, communicator))
}

/// Does the part of another rank than the root.
///
/// # Errors
/// What keeps this rank from it, or what the root has reported.
pub fn follow(
    args: &SelectArgs,
    communicator: &Arc<dyn Communicator>,
) -> Result<ExitCode, Failure> {
    // The root decides when to stop; a launcher sends signals to all.
    let _signals = Signals::install(|_| ()).map_err(Failure::refused("cannot listen for signals"));
    let Some(Brief { plan, selections }) = ranks::hear(&**communicator)? else {
        return Ok(ExitCode::SUCCESS);
    };
    let ready = || -> Result<_, Failure> {
        let threads = args.execution.threads()?;
        memory::check_bytes((plan.foreseen()?.0 as u64).saturating_mul(selections as u64))?;
        // The root decides when to stop; a launcher sends signals to all.
        let signals = Signals::install(|_| ());
        let signals = signals.map_err(Failure::refused("cannot listen for signals"))?;
        Ok((execution::pool(threads)?, plan.with_threads(threads), signals))
    };
    let (pool, plan, _signals) = ranks::agree(&**communicator, ready())?;
    pool.install(|| {
        let what = (&plan, selections);
        let mut hands =
            Hands::new(args, what, args.execution.simd(), Path::new("."), communicator)?;
        hands.follow()?;
        Ok(ExitCode::SUCCESS)
    })
}

impl Job {
    fn brief(&self) -> Brief {
        Brief { plan: self.plan.clone(), selections: self.inputs.selections() }
    }

    /// Bytes of memory that it takes, and frames of the window.
    ///
    /// # Errors
    /// A kernel that is too large.
    pub fn foreseen(&self, args: &SelectArgs) -> Result<(u64, usize), Failure> {
        let (bytes, frames) = self.plan.foreseen()?;
        let selections = self.inputs.selections() as u64;
        // Frames on their way: one that is read, with a file of it as it is decoded, one that is taken
        // in, and one that is written.
        let (renders, _) = self.inputs.renders();
        let frame = (4 * self.inputs.shape()?.values()) as u64;
        let on_the_way = frame.saturating_mul(2 * (renders as u64 + 1) + 5);
        let all = (bytes as u64).saturating_add(on_the_way).saturating_mul(selections);
        let workers = OF_WORKER * args.execution.workers as u64;
        Ok((all.saturating_add(FIXED + workers), frames))
    }

    /// Checks that there is so much memory.
    ///
    /// # Errors
    /// If there is not.
    pub fn check_memory(&self, args: &SelectArgs) -> Result<(), Failure> {
        Ok(memory::check_bytes(self.foreseen(args)?.0)?)
    }

    /// What is about to be done.
    ///
    /// # Errors
    /// A kernel that is too large.
    pub fn intent(&self, args: &SelectArgs, outputs: &Outputs) -> Result<String, Failure> {
        let needed = self.foreseen(args)?;
        Ok(summary::intent(&self.inputs, &self.plan, needed, outputs))
    }

    fn run(
        &self,
        args: &SelectArgs,
        outputs: Outputs,
        communicator: &Arc<dyn Communicator>,
    ) -> Result<ExitCode, Failure> {
        let intent = self.intent(args, &outputs)?;
        let folder = outputs.scores.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new("."));
        let what = (&self.plan, self.inputs.selections());
        let mut hands = Hands::new(args, what, self.simd, folder, communicator)?;
        let mut claimed = None;
        let work = || -> Result<Result<summary::Report, u8>, Failure> {
            // From here on there are files that a signal must not leave behind.
            let mut progress = Progress::open(args.progress, self.inputs.guide.frames())
                .map_err(Failure::refused("cannot listen for signals"))?;
            let (now, kept) = outputs.claim(self.digest(args)?)?;
            let claimed = claimed.insert(now);
            let done = kept.first().map_or(0, SelectState::done);
            hands.restore(kept)?;
            progress.begin(intent.trim_end(), done);
            self.go_on(args, &mut hands, claimed, &mut progress)
        };
        match work() {
            Ok(Ok(mut report)) => {
                report.replaced = hands.end(None)?;
                self.finish(args, claimed.expect("outputs"), &report)
            }
            Ok(Err(code)) => {
                hands.end(Some(code))?;
                Ok(ExitCode::from(code))
            }
            Err(failure) => {
                if let Some(claimed) = claimed {
                    claimed.abandon();
                }
                hands.end(Some(failure.code()))?;
                Err(failure)
            }
        }
    }

    /// Goes on until all frames are done, or a signal comes, whose exit code it gives.
    fn go_on(
        &self,
        args: &SelectArgs,
        hands: &mut Hands,
        claimed: &mut Claimed,
        progress: &mut Progress,
    ) -> Result<Result<summary::Report, u8>, Failure> {
        let start = Instant::now();
        let mut seconds = Seconds::default();
        let first = hands.selections()[0].needed().start;
        thread::scope(|scope| {
            // One frame waits while another is read: what waits takes memory.
            let (sender, frames) = mpsc::sync_channel::<Read>(0);
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
                if let Some(code) = progress.received() {
                    progress.clear();
                    return Ok(Err(code as u8));
                }
                if let Some(states) = hands.states()? {
                    claimed.keep(states)?;
                }
                while !hands.selections()[0].needed().is_empty() {
                    let waiting = Instant::now();
                    let read = frames.recv().expect("as many frames as there are");
                    seconds.waiting += waiting.elapsed().as_secs_f64();
                    let (frame, reading) = read?;
                    seconds.reading += reading;
                    hands.load(&frame)?;
                }
                let sweeping = Instant::now();
                let mut result = None;
                let (mut pictures, mut choices) = (Vec::new(), Vec::new());
                more = hands.advance(progress, |frame, picture, chosen| {
                    result = Some(frame);
                    pictures.push(picture.to_vec());
                    choices.push(chosen.to_vec());
                })?;
                seconds.sweeps += sweeping.elapsed().as_secs_f64();
                if let Some(frame) = result {
                    let writing = Instant::now();
                    claimed.frame(frame, &pictures, &choices, &self.inputs)?;
                    seconds.writing += writing.elapsed().as_secs_f64();
                    progress.done(frame + 1);
                }
            }
            progress.clear();
            seconds.all = start.elapsed().as_secs_f64();
            Ok(Ok(summary::Report::new(
                (&self.inputs, &self.plan),
                args,
                (hands.selections(), hands.sweeps()?),
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
            (env!("CARGO_PKG_VERSION"), args.options(), args.eye()?.to_string(), args.taa),
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
