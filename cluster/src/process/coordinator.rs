//! The coordinator's side: starts workers, looks at them, ends and replaces them.
//!
//! A worker goes through *greeting* (is it this program?), *setting up* (it has its index and the
//! shared memory) and *working*, until it has *reported*. It is lost when it ends before that, is
//! not ready in time, is silent, or says that it cannot go on. What is lost is first killed and
//! reaped: a process that the system has reaped writes to shared memory no more, so that its jobs
//! can be given to another.

use std::ffi::OsString;
use std::fs::File;
use std::marker::PhantomData;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use super::error::{ProcessError, system};
use super::loss::{Cause, Loss};
use super::message::{Control, MessageError, Socket, frame, greeting, wait_for_any};
use super::program;
use crate::affinity::Processors;
use crate::shared::{Board, Counter};

/// The most that one look adds to the time for which a worker counts as silent.
const LONGEST_LOOK: Duration = Duration::from_millis(100);
/// Between two looks of calls that wait.
const PAUSE: Duration = Duration::from_millis(10);
/// How long a killed worker may take to end, which the system can hold up.
const LAST_WAIT: Duration = Duration::from_secs(10);

/// What workers are started with.
#[derive(Debug)]
pub struct Launch {
    /// The program that calls [`attach`](super::attach); see [`this_program`](super::this_program).
    pub program: PathBuf,
    /// Its arguments.
    pub arguments: Vec<OsString>,
    /// Number of workers.
    pub workers: usize,
    /// Of this program: a worker of another version is refused. At most 255 bytes, printable.
    pub version: String,
    /// For every worker, as it is.
    pub payload: Vec<u8>,
    /// The file of the shared memory. It needs no name in the file system.
    pub memory: File,
    /// What each worker is bound to, by index; to nothing if none.
    pub affinity: Option<Vec<Processors>>,
    /// How long a worker may take until it is ready.
    pub patience: Duration,
    /// How long the heartbeat of a worker may stand still.
    pub silence: Duration,
}

/// The workers of a run. Dropping it kills and reaps them all.
///
/// It stays on the thread that made it: a worker ends with the *thread* that started it, as the
/// system has it, so that thread has to live as long as the workers.
#[derive(Debug)]
pub struct Workers {
    launch: Launch,
    states: Vec<WorkerState>,
    /// Workers that were ready and then lost before all others were ready.
    early: Vec<Loss>,
    stopwatch: Stopwatch,
    /// Not to be sent to another thread.
    stays: PhantomData<*const ()>,
}

/// What there is of a worker.
#[derive(Debug)]
enum WorkerState {
    /// Nothing yet, or nothing any more.
    Empty,
    Running(Box<Process>),
    /// A worker that reported and then ended.
    Done(Vec<u8>),
}

impl Launch {
    /// How long a worker should be given until it is ready: what it prepares may be large, machines
    /// slow.
    pub const PATIENCE: Duration = Duration::from_secs(60);
}

impl Workers {
    /// How long workers should be given to end by themselves when all is done; one that hangs is ended
    /// then.
    pub const FAREWELL: Duration = Duration::from_millis(300);

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
        if let Some(affinity) = &launch.affinity
            && affinity.len() != launch.workers
        {
            let (bound, workers) = (affinity.len(), launch.workers);
            return Err(ProcessError::Affinities { bound, workers });
        }
        let states = (0..launch.workers).map(|_| WorkerState::Empty).collect();
        let (early, stopwatch) = (Vec::new(), Stopwatch::new());
        let mut workers = Self { launch, states, early, stopwatch, stays: PhantomData };
        for index in 0..workers.launch.workers {
            workers.replace(index)?;
        }
        loop {
            for (readiness, loss) in workers.look(|_| None).1 {
                if readiness < Readiness::Working {
                    return Err(loss.into());
                }
                workers.early.push(loss);
            }
            if workers.running().all(|worker| worker.readiness >= Readiness::Working) {
                return Ok(workers);
            }
            workers.pause(PAUSE)?;
        }
    }

    /// Looks at every worker once, without waiting; to be called about every 10 ms.
    ///
    /// `beat` gives the heartbeat of a worker, which changes as long as that lives. A worker is
    /// silent when it stood still for [`Launch::silence`], of which every call counts 0.1 s
    /// at most: while this process is stopped, or the machine sleeps, nobody becomes silent.
    ///
    /// Gives the workers that are no more: dead, reaped, and free for [`replace`](Self::replace). A
    /// worker that has to be killed may appear only some calls later, when the system is done with
    /// it. One that ends after its report is no loss.
    pub fn check(&mut self, beat: impl Fn(usize) -> u64) -> Vec<Loss> {
        let (_, losses) = self.look(|index| Some(beat(index)));
        self.early.drain(..).chain(losses.into_iter().map(|(_, loss)| loss)).collect()
    }

    /// [`check`](Self::check), where workers beat on a board.
    pub fn losses(&mut self, board: &Board) -> Vec<Loss> {
        self.check(|index| board.counter(index, Counter::Beats).load(Ordering::Relaxed))
    }

    /// Starts a worker in the place of a lost one, and does not wait for it: that it is ready, or
    /// lost in its turn, is found by later calls of [`check`](Self::check).
    ///
    /// # Errors
    /// A program that does not start, an index that no worker has, or a worker that is not lost.
    pub fn replace(&mut self, index: usize) -> Result<(), ProcessError> {
        let workers = self.states.len();
        let state =
            self.states.get_mut(index).ok_or(ProcessError::Worker { worker: index, workers })?;
        if !matches!(state, WorkerState::Empty) {
            return Err(ProcessError::Present(index));
        }
        *state = WorkerState::Running(Box::new(Process::start(&self.launch)?));
        Ok(())
    }

    /// The processes by index; none for a worker that was lost, or ended after its report.
    pub fn pids(&self) -> Vec<Option<u32>> {
        let pid = |state: &WorkerState| match state {
            WorkerState::Running(worker) => Some(worker.child.id()),
            WorkerState::Empty | WorkerState::Done(_) => None,
        };
        self.states.iter().map(pid).collect()
    }

    /// Waits until every worker has reported and ended, or is lost, and ends those that are not
    /// done `within` this time. Gives the reports by index.
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
        let report = |state: &mut WorkerState| match state {
            WorkerState::Empty => None,
            WorkerState::Running(worker) => worker.report.take(),
            WorkerState::Done(report) => Some(std::mem::take(report)),
        };
        self.states.iter_mut().map(report).collect()
    }

    fn running(&self) -> impl Iterator<Item = &Process> {
        self.states.iter().filter_map(|state| match state {
            WorkerState::Running(worker) => Some(&**worker),
            WorkerState::Empty | WorkerState::Done(_) => None,
        })
    }

    /// Looks at every worker once. Gives the time that passed since the last look, and the losses
    /// with how far each had come.
    fn look(&mut self, beat: impl Fn(usize) -> Option<u64>) -> (Duration, Vec<(Readiness, Loss)>) {
        let passed = self.stopwatch.tick();
        let mut losses = Vec::new();
        for (index, state) in self.states.iter_mut().enumerate() {
            let WorkerState::Running(worker) = state else {
                continue;
            };
            let pid = worker.child.id();
            match worker.look(&self.launch, index, passed, beat(index)) {
                Health::Alive => (),
                Health::Done(report) => *state = WorkerState::Done(report),
                Health::Lost(cause) => {
                    losses.push((worker.readiness, Loss { worker: index, pid, cause }));
                    *state = WorkerState::Empty;
                }
            }
        }
        (passed, losses)
    }

    /// Waits until a worker says something, but not long: that one ended has to be looked for.
    fn pause(&self, time: Duration) -> Result<(), ProcessError> {
        wait_for_any(self.running().map(|worker| &worker.socket), Some(time))
            .map_err(system("wait for workers"))
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        // First all are killed, so that they end side by side.
        for state in &mut self.states {
            if let WorkerState::Running(worker) = state {
                worker.kill();
            }
        }
        let start = Instant::now();
        for state in &mut self.states {
            if let WorkerState::Running(worker) = state {
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
enum Readiness {
    Greeting,
    SettingUp,
    Working,
    Reported,
}

/// What a look at a worker shows.
enum Health {
    Alive,
    /// It reported, ended and was reaped.
    Done(Vec<u8>),
    /// It ended otherwise and was reaped.
    Lost(Cause),
}

/// A process that may be alive.
#[derive(Debug)]
struct Process {
    child: Child,
    socket: Socket,
    readiness: Readiness,
    /// Since it was started, until it is ready.
    age: Duration,
    /// The heartbeat at the last look, and for how long it has stood still.
    beat: Option<u64>,
    quiet: Duration,
    report: Option<Vec<u8>>,
    /// Why it was killed.
    killed: Option<Cause>,
}

impl Process {
    fn start(launch: &Launch) -> Result<Self, ProcessError> {
        let (own, other) =
            UnixStream::pair().map_err(system("make a pair of sockets for a worker"))?;
        let mut socket = Socket::new(own).map_err(system("use a worker's socket"))?;
        // Sent before there is a worker, so that a worker never has to wait for it.
        socket.queue(&greeting(&launch.version)?);
        socket.exchange()?;
        let mut command = Command::new(&launch.program);
        if let Some(name) = program::own_name(&launch.program) {
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
            socket,
            readiness: Readiness::Greeting,
            age: Duration::ZERO,
            beat: None,
            quiet: Duration::ZERO,
            report: None,
            killed: None,
        })
    }

    /// Looks once, `passed` after the last time.
    fn look(
        &mut self,
        launch: &Launch,
        index: usize,
        passed: Duration,
        beat: Option<u64>,
    ) -> Health {
        self.judge(|worker| worker.talk(launch, index));
        let by_itself = match self.child.try_wait() {
            Ok(None) => {
                self.judge(|worker| worker.wait_on(launch, passed, beat));
                return Health::Alive;
            }
            Ok(Some(status)) => Cause::from(status),
            Err(error) => Cause::Vanished(error),
        };
        // Its last words say more than its exit code.
        self.judge(|worker| worker.talk(launch, index));
        match (self.report.take(), self.killed.take()) {
            (Some(report), _) => Health::Done(report),
            (None, Some(cause)) => Health::Lost(cause),
            (None, None) => Health::Lost(by_itself),
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
    fn talk(&mut self, launch: &Launch, index: usize) -> Result<(), Cause> {
        self.socket.exchange()?;
        if self.readiness == Readiness::Greeting && self.socket.greeted(&launch.version)? {
            let affinity = launch.affinity.as_ref();
            let setup = Control::Setup {
                index,
                workers: launch.workers,
                processors: affinity.and_then(|affinity| affinity.get(index)).cloned(),
                payload: launch.payload.clone(),
            };
            let memory = launch.memory.try_clone().map_err(MessageError::System)?;
            self.socket.queue_with(&frame(&setup)?, memory);
            self.socket.exchange()?;
            self.readiness = Readiness::SettingUp;
        }
        while self.readiness > Readiness::Greeting
            && let Some(message) = self.socket.message()?
        {
            self.readiness = match (self.readiness, message) {
                (Readiness::SettingUp, Control::Ready) => Readiness::Working,
                (Readiness::SettingUp | Readiness::Working, Control::Failed(text)) => {
                    return Err(Cause::Failed(text));
                }
                (Readiness::Working, Control::Report(report)) => {
                    self.report = Some(report);
                    Readiness::Reported
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
        match self.readiness {
            Readiness::Greeting | Readiness::SettingUp => {
                self.age += passed;
                if self.age > launch.patience {
                    return Err(Cause::Unready(launch.patience));
                }
            }
            Readiness::Working if beat.is_some() && beat == self.beat => {
                self.quiet += passed;
                if self.quiet > launch.silence {
                    return Err(Cause::Silent(launch.silence));
                }
            }
            Readiness::Working => (self.beat, self.quiet) = (beat, Duration::ZERO),
            Readiness::Reported => (),
        }
        Ok(())
    }
}

/// Counts time in which this process was running.
#[derive(Debug)]
struct Stopwatch(Instant);

impl Stopwatch {
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
