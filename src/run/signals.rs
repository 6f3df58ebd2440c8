//! Signals: the first one asks the run to stop, the second one ends the process. A file that may
//! not become so large is an error, and no signal that ends the process.
//!
//! A thread listens, so that signals are heard whatever the other threads do.

use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

/// Which signal has arrived.
#[derive(Debug, Clone, Default)]
pub struct Signals {
    number: Arc<AtomicUsize>,
}

impl Signals {
    /// Listens from now on for SIGINT (Ctrl-C), SIGTERM and SIGHUP (the terminal was closed), and
    /// lets writes fail that pass a limit of file sizes.
    ///
    /// The first signal is remembered, and `first` is called at once with its number, on a thread
    /// of its own. The second SIGINT or SIGTERM removes all that is
    /// [unfinished](crate::format::unfinished) and ends the process with 128 + its number,
    /// whatever the other threads do. A SIGHUP is never the second signal: the system and the
    /// shell both send one when a terminal is closed. If the process was started without it, as
    /// by `nohup`, it stays ignored.
    ///
    /// # Errors
    /// What the system reports.
    pub fn install(first: impl FnOnce(i32) + Send + 'static) -> io::Result<Self> {
        let signals = Self::default();
        signals.listen(first)?;
        // Unless somebody listens, the signal ends the process instead.
        #[cfg(unix)]
        flag::register(signal_hook::consts::SIGXFSZ, Arc::default())?;
        Ok(signals)
    }

    /// The exit code for the signal that has arrived, if one has.
    pub fn received(&self) -> Option<i32> {
        let number = self.number.load(Ordering::Relaxed) as i32;
        (number > 0).then(|| exit_code(number))
    }

    /// Starts the thread that listens.
    #[cfg(unix)]
    fn listen(&self, first: impl FnOnce(i32) + Send + 'static) -> io::Result<()> {
        use signal_hook::consts::SIGHUP;
        let hang_up = Some(SIGHUP).filter(|&signal| !is_ignored(signal));
        let numbers = [SIGINT, SIGTERM].into_iter().chain(hang_up);
        let mut arriving = signal_hook::iterator::Signals::new(numbers)?;
        let number = Arc::clone(&self.number);
        let mut first = Some(first);
        let listener = move || {
            for signal in arriving.forever() {
                if let Some(first) = first.take() {
                    number.store(signal as usize, Ordering::Relaxed);
                    // It may wait for a terminal that does not answer. If it cannot be called,
                    // the run stops without a word.
                    let _ = start("first signal", move || first(signal));
                } else if signal != SIGHUP {
                    end(signal);
                }
            }
        };
        start("signals", listener)
    }

    /// Lets the system end the process on the second signal, and starts a thread that looks for
    /// the first.
    #[cfg(not(unix))]
    fn listen(&self, first: impl FnOnce(i32) + Send + 'static) -> io::Result<()> {
        use std::sync::atomic::AtomicBool;
        const LOOK: Duration = Duration::from_millis(50);
        let seen = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM] {
            // Handlers run in the order in which they are registered, so the first signal finds
            // the flag down and the second finds it up.
            flag::register_conditional_shutdown(signal, exit_code(signal), Arc::clone(&seen))?;
            flag::register(signal, Arc::clone(&seen))?;
            flag::register_usize(signal, Arc::clone(&self.number), signal as usize)?;
        }
        let number = Arc::clone(&self.number);
        start("signals", move || {
            loop {
                match number.load(Ordering::Relaxed) {
                    0 => thread::sleep(LOOK),
                    signal => return first(signal as i32),
                }
            }
        })
    }
}

/// Starts a thread that nobody waits for.
fn start(name: &str, work: impl FnOnce() + Send + 'static) -> io::Result<()> {
    thread::Builder::new().name(name.to_owned()).spawn(work).map(drop)
}

/// Removes what must not outlive the process, and ends it.
#[cfg(unix)]
fn end(signal: i32) -> ! {
    /// How long the removal may take: the disk may not answer any more.
    const REMOVAL: Duration = Duration::from_secs(2);
    let (done, removed) = std::sync::mpsc::channel();
    let _ = start("removal", move || {
        crate::format::unfinished::remove_all();
        let _ = done.send(());
    });
    let _ = removed.recv_timeout(REMOVAL);
    signal_hook::low_level::exit(exit_code(signal))
}

/// Whether this process ignores a signal, where the system reports it (Linux).
#[cfg(unix)]
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status");
    status.is_ok_and(|status| ignores(&status, signal))
}

/// Whether the status of a process says that it ignores a signal.
#[cfg(unix)]
fn ignores(status: &str, signal: i32) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    // The first bit is signal 1.
    mask.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}

/// 128 + the signal's number, as shells have it: 129 for SIGHUP, 130 for Ctrl-C, 143 for SIGTERM.
fn exit_code(signal: i32) -> i32 {
    128 + signal
}

#[cfg(all(test, unix))]
mod tests {
    use std::fs::File;
    use std::io::{BufRead, BufReader, Lines, Write};
    use std::path::{Path, PathBuf};
    use std::process::{Child, ChildStdout, Command, Stdio};

    use rustix::process::{Pid, Signal, kill_process};

    use super::*;
    use crate::format::unfinished::Unfinished;

    /// What the listening process below is given: the path of an unfinished file.
    const PATH: &str = "PERCEPTILE_TEST_PATH";
    /// And that its answer to the first signal never ends.
    const STUCK: &str = "PERCEPTILE_TEST_STUCK";

    /// What starts it so that it hears SIGHUP, also if these tests do not, as under `nohup`.
    #[cfg(target_os = "linux")]
    const HEARS: [&str; 2] = ["env", "--default-signal=HUP"];
    #[cfg(not(target_os = "linux"))]
    const HEARS: [&str; 1] = ["env"];

    /// How long that process lives at most; all that it is to do takes far less.
    const LEASH: Duration = Duration::from_secs(100);

    /// A process that listens: this test program once more, asked to run the ignored test below.
    struct Listener {
        child: Child,
        said: Lines<BufReader<ChildStdout>>,
    }

    impl Listener {
        /// Starts one by these words, and waits until it listens.
        fn start(words: &[&str], path: &Path, stuck: bool) -> Self {
            let program = std::env::current_exe().unwrap();
            let test = "run::signals::tests::listener";
            let mut command = Command::new(words[0]);
            command.args(&words[1..]).arg(program);
            command.args(["--exact", test, "--ignored", "--nocapture"]).env(PATH, path);
            if stuck {
                command.env(STUCK, "1");
            }
            let mut child = command.stdout(Stdio::piped()).spawn().unwrap();
            let said = BufReader::new(child.stdout.take().unwrap()).lines();
            let mut listener = Self { child, said };
            listener.hear("listens");
            listener
        }

        fn send(&self, signal: Signal) {
            kill_process(Pid::from_child(&self.child), signal).unwrap();
        }

        /// Waits until it says something that begins so, and returns what follows.
        fn hear(&mut self, begin: &str) -> String {
            let mut lines = self.said.by_ref().map(Result::unwrap);
            lines.find_map(|line| line.strip_prefix(begin).map(str::to_owned)).expect(begin)
        }

        fn code(&mut self) -> Option<i32> {
            self.child.wait().unwrap().code()
        }
    }

    impl Drop for Listener {
        fn drop(&mut self) {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }

    #[test]
    #[ignore = "run by other tests"]
    fn listener() {
        let Some(path) = std::env::var_os(PATH).map(PathBuf::from) else { return };
        let make = || File::create_new(&path).map(|file| (file, path.clone()));
        let _unfinished = Unfinished::make(make).unwrap();
        let say = |text: String| {
            let mut out = io::stdout().lock();
            out.write_all(text.as_bytes()).unwrap();
            out.flush().unwrap();
        };
        let signals = Signals::install(move |signal| {
            say(format!("first {signal}\n"));
            while std::env::var_os(STUCK).is_some() {
                thread::park();
            }
        })
        .unwrap();
        say("\nlistens\n".to_owned());
        let start = std::time::Instant::now();
        while signals.received().is_none() && start.elapsed() < LEASH {
            thread::sleep(Duration::from_millis(1));
        }
        say(format!("received {}\n", signals.received().unwrap()));
        // Whatever fails, nobody waits for ever.
        thread::sleep(LEASH);
    }

    #[test]
    fn the_first_signal_is_heard_and_the_second_ends_the_process() {
        let room = tempfile::tempdir().unwrap();
        let path = room.path().join("unfinished");
        for (first, code) in [(Signal::INT, 130), (Signal::TERM, 143), (Signal::HUP, 129)] {
            for (second, last) in [(Signal::INT, 130), (Signal::TERM, 143)] {
                let stuck = second == Signal::INT;
                let mut listener = Listener::start(&HEARS, &path, stuck);
                listener.send(first);
                let mut heard = [listener.hear(""), listener.hear("")];
                heard.sort();
                assert_eq!(heard, [format!("first {}", code - 128), format!("received {code}")]);
                assert!(path.exists());
                listener.send(second);
                assert_eq!(listener.code(), Some(last));
                assert!(!path.exists());
            }
        }
    }

    #[test]
    fn a_terminal_that_closes_is_one_signal_however_many_it_sends() {
        let room = tempfile::tempdir().unwrap();
        let mut listener = Listener::start(&HEARS, &room.path().join("unfinished"), false);
        listener.send(Signal::HUP);
        listener.hear("received 129");
        listener.send(Signal::HUP);
        // Of signals that are pending, the lowest number is heard first.
        listener.send(Signal::TERM);
        assert_eq!(listener.code(), Some(143));
    }

    #[test]
    fn who_was_started_without_hang_ups_does_not_hear_them() {
        let room = tempfile::tempdir().unwrap();
        let words = ["sh", "-c", "trap '' HUP; exec \"$@\"", "sh"];
        let mut listener = Listener::start(&words, &room.path().join("unfinished"), false);
        listener.send(Signal::HUP);
        listener.send(Signal::INT);
        assert_eq!(listener.hear("received "), "130");
    }

    #[test]
    fn signals_that_are_ignored_are_read_from_the_status() {
        let status = "SigQ:\t0/95\nSigIgn:\t0000000000001001\nSigCgt:\t0000000180000002\n";
        assert!(ignores(status, 1) && ignores(status, 13));
        assert!(!ignores(status, 2) && !ignores(status, 15));
        assert!(!ignores("", 1) && !ignores("SigIgn:\tx", 1));
    }
}
