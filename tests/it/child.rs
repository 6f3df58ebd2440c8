//! Child processes of tests: none outlives its test, however that ends, and none is waited for
//! without end.

use std::fs;
use std::process::{self, Command, Output, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use tempfile::NamedTempFile;

/// Longer than anything takes, also on a busy machine: what hangs is to fail, and not to hang.
pub const LONG: Duration = Duration::from_secs(300);

/// Waits for what must happen.
pub fn until(what: &str, mut happens: impl FnMut() -> bool) {
    let start = Instant::now();
    while !happens() {
        assert!(start.elapsed() < LONG, "waited too long: {what}");
        sleep(Duration::from_millis(1));
    }
}

/// Runs a command to its end.
pub fn output(command: &mut Command) -> Output {
    Child::start(command.stdin(Stdio::null())).wait()
}

/// A process with a process group of its own, which is killed when this is dropped.
pub struct Child {
    process: process::Child,
    line: String,
    /// Its output and its errors. Files, as pipes fill up while nobody reads.
    streams: [NamedTempFile; 2],
}

impl Child {
    /// Starts a command that is ready but for the streams that it writes to.
    pub fn start(command: &mut Command) -> Self {
        let line = format!("{command:?}");
        let streams = [(); 2].map(|()| NamedTempFile::new().unwrap());
        let [out, error] = streams.each_ref().map(|stream| stream.reopen().unwrap());
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(command, 0);
        let process = command.stdout(out).stderr(error).spawn();
        Self { process: process.unwrap_or_else(|error| panic!("{line}: {error}")), line, streams }
    }

    /// What the system lists it by.
    #[cfg(unix)]
    pub fn pid(&self) -> rustix::process::Pid {
        rustix::process::Pid::from_child(&self.process)
    }

    /// The command, for who reads of a failure.
    pub fn line(&self) -> &str {
        &self.line
    }

    pub fn is_over(&mut self) -> bool {
        self.process.try_wait().unwrap().is_some()
    }

    /// What it has said on the standard error so far.
    pub fn error(&self) -> String {
        String::from_utf8_lossy(&fs::read(self.streams[1].path()).unwrap()).into_owned()
    }

    /// Waits for its end.
    pub fn wait(&mut self) -> Output {
        let start = Instant::now();
        loop {
            if let Some(status) = self.process.try_wait().unwrap() {
                let [stdout, stderr] =
                    self.streams.each_ref().map(|stream| fs::read(stream.path()).unwrap());
                return Output { status, stdout, stderr };
            }
            assert!(start.elapsed() < LONG, "{} hangs: {}", self.line, self.error());
            sleep(Duration::from_millis(1));
        }
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        // Also what its group has left, should it have ended.
        #[cfg(unix)]
        let _ = rustix::process::kill_process_group(self.pid(), rustix::process::Signal::KILL);
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}
