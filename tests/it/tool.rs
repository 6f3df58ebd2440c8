//! Runs of the real command: started, followed while they work, and ended in every way.

use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use perceptile::format::sidecar::Sidecar;
use rustix::process::{Pid, Signal, kill_process, kill_process_group};
use tempfile::TempDir;

pub const PROGRAM: &str = env!("CARGO_BIN_EXE_perceptile");

/// Longer than anything takes, also on a busy machine: what hangs is to fail, and not to hang.
const LONG: Duration = Duration::from_secs(120);

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

    /// Starts this program with the words of a line, in a process group of its own.
    pub fn start(&self, line: &str) -> Run {
        let mut command = Command::new(PROGRAM);
        command.args(line.split_whitespace()).stdin(Stdio::null());
        self.start_as(command, line)
    }

    /// The same by a shell, which does something before it becomes this program.
    pub fn start_after(&self, before: &str, line: &str) -> Run {
        let mut command = Command::new("sh");
        command.args(["-c", &format!("{before}; exec \"$0\" \"$@\""), PROGRAM]);
        command.args(line.split_whitespace()).stdin(Stdio::null());
        self.start_as(command, line)
    }

    /// Starts a command that is ready but for its folder and the streams that it writes to.
    pub fn start_as(&self, mut command: Command, line: &str) -> Run {
        let streams = [(); 2].map(|()| tempfile::tempfile().unwrap());
        let [out, error] = streams.each_ref().map(|stream| stream.try_clone().unwrap());
        command.current_dir(self.0.path()).env("RUST_BACKTRACE", "0").process_group(0);
        let child = command.stdout(out).stderr(error).spawn().unwrap();
        Run { child, line: line.to_owned(), streams }
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
}

/// A command that runs. If nobody waits for it, it is killed.
pub struct Run {
    child: Child,
    line: String,
    streams: [File; 2],
}

impl Run {
    pub fn pid(&self) -> Pid {
        Pid::from_child(&self.child)
    }

    pub fn is_over(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
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

    /// Waits for what is to happen while the command runs.
    pub fn until(&mut self, what: &str, mut happens: impl FnMut(&Self) -> bool) {
        let start = Instant::now();
        while !happens(self) {
            let over = self.is_over();
            if over || start.elapsed() > LONG {
                let line = &self.line;
                panic!("{line}: over {over}, but not yet {what}: {}", self.said(1));
            }
            sleep(Duration::from_millis(1));
        }
    }

    /// Waits until it has written a checkpoint after so many steps, or is over.
    pub fn until_checkpoint(&mut self, room: &Room, folder: &str, steps: u32) {
        let start = Instant::now();
        while !self.is_over() && room.checkpoints(folder).first().is_none_or(|&it| it <= steps) {
            assert!(start.elapsed() < LONG, "{}: no checkpoint: {}", self.line, self.said(1));
            sleep(Duration::from_millis(1));
        }
    }

    pub fn send(&self, signal: Signal) {
        send(self.pid(), signal);
    }

    pub fn send_to_group(&self, signal: Signal) {
        kill_process_group(self.pid(), signal).unwrap();
    }

    /// What it has said so far.
    fn said(&self, stream: usize) -> String {
        let stream = &self.streams[stream];
        let mut text = vec![0; stream.metadata().unwrap().len() as usize];
        // Not by a seek: the command writes where this one reads.
        stream.read_exact_at(&mut text, 0).unwrap();
        String::from_utf8(text).unwrap()
    }

    /// Waits for its end, and that no process is left of it.
    pub fn end(mut self) -> Ended {
        let start = Instant::now();
        let status = loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                break status;
            }
            if start.elapsed() > LONG {
                panic!("{} hangs: {}", self.line, self.said(1));
            }
            sleep(Duration::from_millis(1));
        };
        let group = self.pid().as_raw_nonzero().get();
        let left = || processes().into_iter().filter(|it| it.group == group && it.state != 'Z');
        while let Some(process) = left().next() {
            let line = &self.line;
            assert!(start.elapsed() < LONG, "{line} leaves process {:?} behind", process.pid);
            sleep(Duration::from_millis(1));
        }
        let [out, error] = [0, 1].map(|stream| self.said(stream));
        let line = std::mem::take(&mut self.line);
        assert!(!error.contains("panicked"), "{line}: {error}");
        Ended { line, status, out, error }
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
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

/// Waits for what must happen.
pub fn until(what: &str, mut happens: impl FnMut() -> bool) {
    let start = Instant::now();
    while !happens() {
        assert!(start.elapsed() < LONG, "waited too long: {what}");
        sleep(Duration::from_millis(1));
    }
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
