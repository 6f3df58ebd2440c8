//! The coordinator's side: starts workers, looks at them, ends and replaces them.
//!
//! A worker goes through *greeting* (is it this program?), *setting up* (it has its rank and the
//! shared memory) and *working*, until it has *reported*. It is lost when it ends before that, is
//! not ready in time, is silent, or says that it cannot go on. What is lost is first killed and
//! reaped: a process that the system has reaped writes to shared memory no more, so that its jobs
//! can be given to another.

use std::ffi::OsString;
use std::fmt;
use std::fs::File;
use std::io;
use std::marker::PhantomData;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use signal_hook::low_level::signal_name;
use thiserror::Error;

use super::message::{Channel, Message, MessageError, frame, greeting, wait_for_any};
use super::{ProcessError, system};
use crate::place::Place;

/// Names the file that this process runs, also after another was put in its place.
const SELF: &str = "/proc/self/exe";
/// The most that one look adds to the time for which a worker counts as silent.
const LONGEST_LOOK: Duration = Duration::from_millis(100);
/// Between two looks of calls that wait.
const PAUSE: Duration = Duration::from_millis(10);
/// How long a killed worker may take to end, which the system can hold up.
const LAST_WAIT: Duration = Duration::from_secs(10);

/// What workers are started with.
#[derive(Debug)]
pub struct Launch {
    /// The program that calls [`attach`](super::attach); see [`this_program`].
    pub program: PathBuf,
    /// Its arguments.
    pub arguments: Vec<OsString>,
    /// Number of workers.
    pub workers: usize,
    /// Of this program: a worker of another version is refused. At most 255 bytes, printable.
    pub version: String,
    /// For every worker, as it is.
    pub payload: Vec<u8>,
    /// The shared memory. It needs no name in the file system.
    pub region: File,
    /// Where each worker runs, by rank; anywhere if none.
    pub places: Option<Vec<Place>>,
    /// How long a worker may take until it is ready.
    pub patience: Duration,
    /// How long the heartbeat of a worker may stand still.
    pub silence: Duration,
}

/// The program that this process runs, for [`Launch::program`].
///
/// # Errors
/// What the system reports.
pub fn this_program() -> io::Result<PathBuf> {
    if Path::new(SELF).exists() { Ok(SELF.into()) } else { std::env::current_exe() }
}

/// A worker that is no more.
#[derive(Debug, Error)]
#[error("worker {rank} (process {pid}) {cause}")]
pub struct Loss {
    /// Its rank.
    pub rank: usize,
    /// Its process, which has been reaped.
    pub pid: u32,
    /// Why.
    pub cause: Cause,
}

/// Why a worker is no more.
#[derive(Debug)]
pub enum Cause {
    /// It ended by itself, with this exit code.
    Exited(i32),
    /// This signal ended it.
    Signal(i32),
    /// The system does not say how it ended.
    Vanished(io::Error),
    /// It was not ready in this time.
    Unready(Duration),
    /// Its heartbeat stood still for this time.
    Silent(Duration),
    /// It said that it cannot go on, and why.
    Failed(String),
    /// It said what no worker of this program says.
    Message(MessageError),
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exited(code) => write!(f, "ended too early, with exit code {code}"),
            Self::Signal(number) => match signal_name(*number) {
                Some(name) => write!(f, "was ended by {name}"),
                None => write!(f, "was ended by signal {number}"),
            },
            Self::Vanished(error) => write!(f, "has vanished: {error}"),
            Self::Unready(time) => write!(f, "was not ready within {time:?}"),
            Self::Silent(time) => write!(f, "gave no sign of life for {time:?}"),
            Self::Failed(text) => write!(f, "failed: {text}"),
            Self::Message(error) => write!(f, "cannot be used: {error}"),
        }
    }
}

impl From<MessageError> for Cause {
    fn from(error: MessageError) -> Self {
        Self::Message(error)
    }
}

impl From<ExitStatus> for Cause {
    fn from(status: ExitStatus) -> Self {
        match (status.code(), status.signal()) {
            (Some(code), _) => Self::Exited(code),
            (None, Some(signal)) => Self::Signal(signal),
            (None, None) => Self::Vanished(io::Error::other(status.to_string())),
        }
    }
}

/// The workers of a run. Dropping it kills and reaps them all.
///
/// It stays on the thread that made it: a worker ends with the *thread* that started it, as the
/// system has it, so that thread has to live as long as the workers.
#[derive(Debug)]
pub struct Workers {
    launch: Launch,
    slots: Vec<Slot>,
    /// Workers that were ready and then lost before all others were ready.
    early: Vec<Loss>,
    clock: Clock,
    /// Not to be sent to another thread.
    stays: PhantomData<*const ()>,
}

/// What holds a rank.
#[derive(Debug)]
enum Slot {
    /// Nothing yet, or nothing any more.
    Empty,
    Running(Box<Worker>),
    /// A worker that reported and then ended.
    Done(Vec<u8>),
}

impl Workers {
    /// Starts all workers side by side, and waits until every one is ready, or was: one that is
    /// lost after that is a loss as any, for [`check`](Self::check) to give.
    ///
    /// Until a worker has called [`attach`](super::attach), Ctrl-C ends it as any process; the
    /// error is then the loss of that worker.
    ///
    /// # Errors
    /// A program that does not start, or a worker that is lost before it is ready. The others are
    /// ended.
    pub fn start(launch: Launch) -> Result<Self, ProcessError> {
        if let Some(places) = &launch.places
            && places.len() != launch.workers
        {
            return Err(ProcessError::Places { places: places.len(), workers: launch.workers });
        }
        let slots = (0..launch.workers).map(|_| Slot::Empty).collect();
        let (early, clock) = (Vec::new(), Clock::new());
        let mut workers = Self { launch, slots, early, clock, stays: PhantomData };
        for rank in 0..workers.launch.workers {
            workers.replace(rank)?;
        }
        loop {
            for (phase, loss) in workers.look(|_| None).1 {
                if phase < Phase::Working {
                    return Err(loss.into());
                }
                workers.early.push(loss);
            }
            if workers.running().all(|worker| worker.phase >= Phase::Working) {
                return Ok(workers);
            }
            workers.pause(PAUSE)?;
        }
    }

    /// Looks at every worker once, without waiting; to be called about every 10 ms.
    ///
    /// `beat` gives the heartbeat of a rank, which changes as long as its worker lives. A worker
    /// is silent when that stood still for [`Launch::silence`], of which every call counts 0.1 s
    /// at most: while this process is stopped, or the machine sleeps, nobody becomes silent.
    ///
    /// Gives the workers that are no more: dead, reaped, and their ranks free for
    /// [`replace`](Self::replace). A worker that has to be killed may appear only some calls
    /// later, when the system is done with it. One that ends after its report is no loss.
    pub fn check(&mut self, beat: impl Fn(usize) -> u64) -> Vec<Loss> {
        let (_, losses) = self.look(|rank| Some(beat(rank)));
        self.early.drain(..).chain(losses.into_iter().map(|(_, loss)| loss)).collect()
    }

    /// Starts a worker in the place of a lost one, and does not wait for it: that it is ready, or
    /// lost in its turn, is found by later calls of [`check`](Self::check).
    ///
    /// # Errors
    /// A program that does not start, or a rank whose worker is not lost.
    pub fn replace(&mut self, rank: usize) -> Result<(), ProcessError> {
        let workers = self.slots.len();
        let slot = self.slots.get_mut(rank).ok_or(ProcessError::Rank { rank, workers })?;
        if !matches!(slot, Slot::Empty) {
            return Err(ProcessError::Present(rank));
        }
        *slot = Slot::Running(Box::new(Worker::start(&self.launch)?));
        Ok(())
    }

    /// The processes by rank; none for a rank whose worker was lost, or ended after its report.
    pub fn pids(&self) -> Vec<Option<u32>> {
        let pid = |slot: &Slot| match slot {
            Slot::Running(worker) => Some(worker.child.id()),
            Slot::Empty | Slot::Done(_) => None,
        };
        self.slots.iter().map(pid).collect()
    }

    /// Waits until every worker has reported and ended, or is lost, and ends those that are not
    /// done `within` this time. Gives the reports by rank.
    pub fn finish(mut self, within: Duration) -> Vec<Option<Vec<u8>>> {
        let mut left = within;
        loop {
            let (passed, _) = self.look(|_| None);
            left = left.saturating_sub(passed);
            if left.is_zero() || self.running().next().is_none() {
                break;
            }
            if self.pause(PAUSE.min(left)).is_err() {
                break;
            }
        }
        let report = |slot: &mut Slot| match slot {
            Slot::Empty => None,
            Slot::Running(worker) => worker.report.take(),
            Slot::Done(report) => Some(std::mem::take(report)),
        };
        self.slots.iter_mut().map(report).collect()
    }

    fn running(&self) -> impl Iterator<Item = &Worker> {
        self.slots.iter().filter_map(|slot| match slot {
            Slot::Running(worker) => Some(&**worker),
            Slot::Empty | Slot::Done(_) => None,
        })
    }

    /// Looks at every worker once. Gives the time that passed since the last look, and the losses
    /// with how far each had come.
    fn look(&mut self, beat: impl Fn(usize) -> Option<u64>) -> (Duration, Vec<(Phase, Loss)>) {
        let passed = self.clock.tick();
        let mut losses = Vec::new();
        for (rank, slot) in self.slots.iter_mut().enumerate() {
            let Slot::Running(worker) = slot else {
                continue;
            };
            let pid = worker.child.id();
            match worker.look(&self.launch, rank, passed, beat(rank)) {
                State::Alive => (),
                State::Done(report) => *slot = Slot::Done(report),
                State::Lost(cause) => {
                    losses.push((worker.phase, Loss { rank, pid, cause }));
                    *slot = Slot::Empty;
                }
            }
        }
        (passed, losses)
    }

    /// Waits until a worker says something, but not long: that one ended has to be looked for.
    fn pause(&self, time: Duration) -> Result<(), ProcessError> {
        wait_for_any(self.running().map(|worker| &worker.channel), Some(time))
            .map_err(system("wait for workers"))
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        // First all are killed, so that they end side by side.
        for slot in &mut self.slots {
            if let Slot::Running(worker) = slot {
                worker.kill();
            }
        }
        let start = Instant::now();
        for slot in &mut self.slots {
            if let Slot::Running(worker) = slot {
                // In the end the system reaps what is left, when this process ends.
                while matches!(worker.child.try_wait(), Ok(None)) && start.elapsed() < LAST_WAIT {
                    thread::sleep(Duration::from_millis(1));
                }
            }
        }
    }
}

/// How far a worker has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Phase {
    Greeting,
    SettingUp,
    Working,
    Reported,
}

/// What a look at a worker shows.
enum State {
    Alive,
    /// It reported, ended and was reaped.
    Done(Vec<u8>),
    /// It ended otherwise and was reaped.
    Lost(Cause),
}

/// A process that may be alive.
#[derive(Debug)]
struct Worker {
    child: Child,
    channel: Channel,
    phase: Phase,
    /// Since it was started, until it is ready.
    age: Duration,
    /// The heartbeat at the last look, and for how long it has stood still.
    beat: Option<u64>,
    quiet: Duration,
    report: Option<Vec<u8>>,
    /// Why it was killed.
    killed: Option<Cause>,
}

impl Worker {
    fn start(launch: &Launch) -> Result<Self, ProcessError> {
        let (own, other) =
            UnixStream::pair().map_err(system("make a pair of sockets for a worker"))?;
        let mut channel = Channel::new(own).map_err(system("use a worker's socket"))?;
        // Sent before there is a worker, so that a worker never has to wait for it.
        channel.queue(&greeting(&launch.version)?);
        channel.exchange()?;
        let mut command = Command::new(&launch.program);
        if launch.program == Path::new(SELF)
            && let Some(name) = std::env::args_os().next()
        {
            command.arg0(name);
        }
        let child = command
            .args(&launch.arguments)
            .stdin(Stdio::from(OwnedFd::from(other)))
            // Standard output belongs to the coordinator: scripts read it.
            .stdout(Stdio::null())
            .spawn()
            .map_err(|error| ProcessError::Start { program: launch.program.clone(), error })?;
        Ok(Self {
            child,
            channel,
            phase: Phase::Greeting,
            age: Duration::ZERO,
            beat: None,
            quiet: Duration::ZERO,
            report: None,
            killed: None,
        })
    }

    /// Looks once, `passed` after the last time.
    fn look(&mut self, launch: &Launch, rank: usize, passed: Duration, beat: Option<u64>) -> State {
        self.judge(|worker| worker.talk(launch, rank));
        let by_itself = match self.child.try_wait() {
            Ok(None) => {
                self.judge(|worker| worker.wait_on(launch, passed, beat));
                return State::Alive;
            }
            Ok(Some(status)) => Cause::from(status),
            Err(error) => Cause::Vanished(error),
        };
        // Its last words tell more than its exit code.
        self.judge(|worker| worker.talk(launch, rank));
        match (self.report.take(), self.killed.take()) {
            (Some(report), _) => State::Done(report),
            (None, Some(cause)) => State::Lost(cause),
            (None, None) => State::Lost(by_itself),
        }
    }

    /// Kills the worker if `rule` finds a reason, and it was not killed before.
    fn judge(&mut self, rule: impl FnOnce(&mut Self) -> Result<(), Cause>) {
        if self.killed.is_none()
            && let Err(cause) = rule(self)
        {
            self.kill();
            self.killed = Some(cause);
        }
    }

    fn kill(&mut self) {
        // It fails only for a worker that has ended.
        let _ = self.child.kill();
    }

    /// Sends and receives what can be without waiting.
    fn talk(&mut self, launch: &Launch, rank: usize) -> Result<(), Cause> {
        self.channel.exchange()?;
        if self.phase == Phase::Greeting && self.channel.greeted(&launch.version)? {
            let size = launch.workers;
            let place = launch.places.as_ref().and_then(|places| places.get(rank)).cloned();
            let setup = Message::Setup { rank, size, place, payload: launch.payload.clone() };
            let region = launch.region.try_clone().map_err(MessageError::System)?;
            self.channel.queue_with(&frame(&setup)?, region);
            self.channel.exchange()?;
            self.phase = Phase::SettingUp;
        }
        while self.phase > Phase::Greeting
            && let Some(message) = self.channel.message()?
        {
            self.phase = match (self.phase, message) {
                (Phase::SettingUp, Message::Ready) => Phase::Working,
                (Phase::SettingUp | Phase::Working, Message::Failed(text)) => {
                    return Err(Cause::Failed(text));
                }
                (Phase::Working, Message::Report(report)) => {
                    self.report = Some(report);
                    Phase::Reported
                }
                (_, message) => return Err(message.unexpected().into()),
            };
        }
        Ok(())
    }

    /// Another look at a worker that is alive: is it ready in time, does its heart beat?
    fn wait_on(
        &mut self,
        launch: &Launch,
        passed: Duration,
        beat: Option<u64>,
    ) -> Result<(), Cause> {
        match self.phase {
            Phase::Greeting | Phase::SettingUp => {
                self.age += passed;
                if self.age > launch.patience {
                    return Err(Cause::Unready(launch.patience));
                }
            }
            Phase::Working if beat.is_some() && beat == self.beat => {
                self.quiet += passed;
                if self.quiet > launch.silence {
                    return Err(Cause::Silent(launch.silence));
                }
            }
            Phase::Working => (self.beat, self.quiet) = (beat, Duration::ZERO),
            Phase::Reported => (),
        }
        Ok(())
    }
}

/// Counts time in which this process was running.
#[derive(Debug)]
struct Clock(Instant);

impl Clock {
    fn new() -> Self {
        Self(Instant::now())
    }

    /// Since the last tick; of a longer time [`LONGEST_LOOK`].
    fn tick(&mut self) -> Duration {
        let now = Instant::now();
        let passed = now.saturating_duration_since(self.0);
        self.0 = now;
        passed.min(LONGEST_LOOK)
    }
}
