//! Runs of the real command: started, followed while they work, and ended in every way.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus, Output, Stdio};
use std::thread::sleep;
use std::time::Duration;

use perceptile::format::sidecar::Sidecar;
use rustix::process::{Pid, Signal, kill_process, kill_process_group};
use tempfile::TempDir;

use crate::child::Child;
pub use crate::child::until;

pub const PROGRAM: &str = env!("CARGO_BIN_EXE_perceptile");

/// Says nothing of how runs go on: what is on the standard error is out of the ordinary.
pub const PROGRESS: (&str, &str) = ("PERCEPTILE_PROGRESS", "none");

/// The end of a run that goes on until it is told to stop, should nobody be left to tell it.
pub const LEASH: &str = "--time 10m";

/// A folder in which commands are run.
pub struct Room(TempDir);

impl Room {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.at(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    pub fn names(&self, folder: &str) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(self.at(folder))
            .into_iter()
            .flatten()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    /// The numbers of the checkpoints in a folder, the last one first. A number is one more than
    /// the steps that were done.
    pub fn checkpoints(&self, folder: &str) -> Vec<u32> {
        let number = |name: &String| name.strip_prefix("checkpoint-")?.parse().ok();
        let mut numbers: Vec<u32> = self.names(folder).iter().filter_map(number).collect();
        numbers.sort_unstable_by(|a, b| b.cmp(a));
        numbers
    }

    /// Whether there is a checkpoint after so many steps, or after more.
    pub fn has_checkpoint(&self, folder: &str, steps: u32) -> bool {
        self.checkpoints(folder).first().is_some_and(|&number| number > steps)
    }

    /// Starts this program with the words of a line.
    pub fn start(&self, line: &str) -> Run {
        let mut command = Command::new(PROGRAM);
        command.args(line.split_whitespace()).stdin(Stdio::null());
        self.start_as(command)
    }

    /// The same by a shell, which does something before it becomes this program.
    pub fn start_after(&self, before: &str, line: &str) -> Run {
        let mut command = Command::new("sh");
        command.args(["-c", &format!("{before}; exec \"$0\" \"$@\""), PROGRAM]);
        command.args(line.split_whitespace()).stdin(Stdio::null());
        self.start_as(command)
    }

    /// Starts a command that is ready but for its folder and the streams that it writes to.
    pub fn start_as(&self, mut command: Command) -> Run {
        let command = command.current_dir(self.0.path()).env("RUST_BACKTRACE", "0");
        Run(Child::start(command.env(PROGRESS.0, PROGRESS.1)))
    }

    pub fn run(&self, line: &str) -> Ended {
        self.start(line).end()
    }

    /// Runs what must succeed; `tile.npy` is then there, and its bytes are returned.
    pub fn make(&self, line: &str) -> Vec<u8> {
        self.run(line).succeeded();
        self.read("tile.npy")
    }

    pub fn sidecar(&self) -> Sidecar {
        Sidecar::read(&self.at("tile.json")).unwrap()
    }

    /// The tile that a run left which was told to stop, and the steps that it had done. Checks that
    /// the command on record makes the same tile by one thread.
    pub fn tile_so_far(&self) -> (Vec<u8>, u32) {
        let tile = self.read("tile.npy");
        let command = self.sidecar().command;
        let (_, steps) = command.split_once("--stop-after ").unwrap();
        let steps = steps.split(' ').next().unwrap().parse().unwrap();
        let words = command.strip_prefix("perceptile ").unwrap();
        let script =
            format!("exec \"$0\" {words} --integrands 0 --threads 1 --out again.npy --force");
        let mut again = Command::new("sh");
        again.args(["-c", &script, PROGRAM]).stdin(Stdio::null());
        self.start_as(again).end().succeeded();
        assert!(self.read("again.npy") == tile, "{command}");
        (tile, steps)
    }
}

/// A command that runs.
pub struct Run(Child);

impl Run {
    pub fn pid(&self) -> Pid {
        self.0.pid()
    }

    pub fn is_over(&mut self) -> bool {
        self.0.is_over()
    }

    /// Its worker processes.
    pub fn workers(&self) -> Vec<Pid> {
        let parent = self.pid().as_raw_nonzero().get();
        let alive = |process: &Process| process.parent == parent && process.state != 'Z';
        processes().into_iter().filter(alive).map(|process| process.pid).collect()
    }

    /// Those of them that take jobs: they have a thread that tells that they live.
    pub fn ready_workers(&self) -> Vec<Pid> {
        self.workers().into_iter().filter(|&worker| has_heartbeat(worker)).collect()
    }

    /// What it has said so far.
    pub fn error(&self) -> String {
        self.0.error()
    }

    /// Waits for what is to happen while the command runs.
    pub fn until(&mut self, what: &str, happens: impl FnMut(&mut Self) -> bool) {
        let has_happened = self.until_or_end(what, happens);
        assert!(has_happened, "{} is over before {what}: {}", self.0.line(), self.error());
    }

    /// Waits for what may happen before the command is over; returns whether it has.
    pub fn until_or_end(&mut self, what: &str, mut happens: impl FnMut(&mut Self) -> bool) -> bool {
        let mut has_happened = false;
        let line = self.0.line().to_owned();
        until(&format!("{what} of {line}"), || {
            let is_over = self.is_over();
            has_happened = happens(self);
            has_happened || is_over
        });
        has_happened
    }

    /// Waits until it has written a checkpoint after so many steps, or after more.
    pub fn until_checkpoint(&mut self, room: &Room, folder: &str, steps: u32) {
        self.until("a checkpoint", |_| room.has_checkpoint(folder, steps));
    }

    /// Sends a signal, unless it is over: its number may then be another's.
    pub fn send(&mut self, signal: Signal) {
        if !self.is_over() {
            send(self.pid(), signal);
        }
    }

    /// Sends a signal to all of its processes.
    pub fn send_to_group(&mut self, signal: Signal) {
        assert!(!self.is_over(), "{} is over: {}", self.0.line(), self.error());
        kill_process_group(self.pid(), signal).unwrap();
    }

    /// Waits for its end, and that no process is left of it.
    pub fn end(mut self) -> Ended {
        let Output { status, stdout, stderr } = self.0.wait();
        let group = self.pid().as_raw_nonzero().get();
        let is_left = |it: &Process| it.group == group && it.state != 'Z';
        until(&format!("nothing is left of {}", self.0.line()), || {
            !processes().iter().any(is_left)
        });
        let [out, error] = [stdout, stderr].map(|bytes| String::from_utf8(bytes).unwrap());
        let line = self.0.line().to_owned();
        assert!(!error.contains("panicked"), "{line}: {error}");
        Ended { line, status, out, error }
    }
}

/// A command that has ended.
#[derive(Debug)]
#[allow(dead_code, reason = "the line is shown where a test fails")]
pub struct Ended {
    pub line: String,
    pub status: ExitStatus,
    pub out: String,
    pub error: String,
}

impl Ended {
    pub fn code(&self) -> Option<i32> {
        self.status.code()
    }

    pub fn succeeded(self) -> Self {
        assert!(self.status.success(), "{self:?}");
        self
    }

    /// It ended with an exit code, and an error in which all the words occur.
    pub fn failed(self, code: i32, words: &[&str]) -> Self {
        assert_eq!(self.code(), Some(code), "{self:?}");
        assert!(self.error.lines().any(|line| line.starts_with("error: ")), "{self:?}");
        for word in words {
            assert!(self.error.contains(word), "no {word:?}: {self:?}");
        }
        self
    }
}

/// Sends a signal to a process that may have gone.
pub fn send(process: Pid, signal: Signal) {
    let _ = kill_process(process, signal);
}

/// A process as the system lists it.
struct Process {
    pid: Pid,
    state: char,
    parent: i32,
    group: i32,
}

fn processes() -> Vec<Process> {
    let entries = fs::read_dir("/proc").unwrap().flatten();
    let process = |path: &Path| {
        let number = path.file_name()?.to_str()?.parse().ok()?;
        let stat = fs::read_to_string(path.join("stat")).ok()?;
        // The name before may hold anything.
        let mut words = stat[stat.rfind(')')? + 1..].split_whitespace();
        Some(Process {
            pid: Pid::from_raw(number)?,
            state: words.next()?.chars().next()?,
            parent: words.next()?.parse().ok()?,
            group: words.next()?.parse().ok()?,
        })
    };
    entries.filter_map(|entry| process(&entry.path())).collect()
}

fn has_heartbeat(worker: Pid) -> bool {
    let tasks = fs::read_dir(format!("/proc/{}/task", worker.as_raw_nonzero()));
    let name = |task: fs::DirEntry| fs::read_to_string(task.path().join("comm"));
    tasks.into_iter().flatten().flatten().any(|task| name(task).is_ok_and(|it| it == "heartbeat\n"))
}

/// Whether a process has ended; who should ask how may not have done so yet.
pub fn has_ended(process: Pid) -> bool {
    processes().iter().all(|it| it.pid != process || it.state == 'Z')
}

/// Whether a process has handlers for all of these signals.
pub fn caught(process: Pid, signals: &[Signal]) -> bool {
    let path = format!("/proc/{}/status", process.as_raw_nonzero());
    let status = fs::read_to_string(path).unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    let mask = mask.map_or(0, |mask| u64::from_str_radix(mask.trim(), 16).unwrap());
    signals.iter().all(|signal| mask >> (signal.as_raw() - 1) & 1 == 1)
}

/// Random numbers (SplitMix64; Steele et al. 2014), the same in every run.
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, end: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ z >> 31) % end as u64) as usize
    }

    pub fn pick<'a, T>(&mut self, of: &'a [T]) -> Option<&'a T> {
        if of.is_empty() { None } else { of.get(self.below(of.len())) }
    }

    /// Sleeps for less than so many milliseconds.
    pub fn sleep(&mut self, milliseconds: u64) {
        sleep(Duration::from_micros(self.below(1000 * milliseconds as usize) as u64));
    }
}
