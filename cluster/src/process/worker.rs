//! A worker's side: it finds its coordinator, says when it is ready, and never outlives it.

use std::fs::File;
use std::io;
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::thread;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use rustix::net::{AddressFamily, RecvFlags, SocketType, getsockname, recv, sockopt};
use rustix::process::{Signal, getpid, kill_process};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use super::error::{ProcessError, system};
use super::message::{Control, MessageError, Socket, frame, greeting, timespec};

/// Between two heartbeats.
const BEAT: Duration = Duration::from_millis(50);
/// For the greeting of the coordinator, which was sent before this process existed.
const GREETING_WAIT: Duration = Duration::from_secs(10);
/// Of the text of a failure, in bytes.
const TEXT_LIMIT: usize = 64 << 10;

/// A worker that has found its coordinator.
#[derive(Debug)]
pub struct Attached {
    /// The index of this worker, below `workers`.
    pub index: usize,
    /// Number of workers.
    pub workers: usize,
    /// What the coordinator has for all workers.
    pub payload: Vec<u8>,
    /// The file of the shared memory.
    pub memory: File,
    socket: Socket,
}

/// Finds the coordinator, which is at the other end of standard input.
///
/// To be called once, first of all and by the main thread. From then on the process ends with its
/// coordinator, on Linux even while it is stopped; SIGINT, SIGTERM and SIGHUP do nothing, as they
/// are sent to all processes of a run and the coordinator decides; and if the coordinator has
/// chosen processors, this thread and those that it starts run there.
///
/// # Errors
/// Standard input that is no socket, or at whose other end is no coordinator of the same
/// `version`, and processors that cannot be used. The coordinator hears of it if it can.
pub fn attach(version: &str) -> Result<Attached, ProcessError> {
    let stream = standard_input()?;
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, Arc::new(AtomicBool::new(false)))
            .map_err(system("listen for signals"))?;
    }
    end_with_parent()?;
    name_process();
    let mut socket = Socket::new(stream).map_err(system("use the coordinator's socket"))?;
    socket.queue(&greeting(version)?);
    socket.wait(Some(GREETING_WAIT), |socket| Ok(socket.greeted(version)?.then_some(())))?;
    // No limit from here on. The coordinator may be stopped; and if it ended before this process
    // asked to end with it, this finds the socket closed.
    let setup = socket.wait(None, Socket::message)?;
    let Control::Setup { index, workers, processors, payload } = setup else {
        return Err(setup.unexpected().into());
    };
    let memory = socket.take_file().ok_or(MessageError::NoMemory)?;
    let attached = Attached { index, workers, payload, memory, socket };
    match processors.map_or(Ok(()), |processors| processors.bind()) {
        Ok(()) => Ok(attached),
        Err(error) => {
            attached.fail(&error.to_string())?;
            Err(error.into())
        }
    }
}

impl Attached {
    /// Says that this worker takes jobs, and calls `beat` every 50 ms from a thread of its own, as
    /// long as the process lives. The thread ends the process as soon as the coordinator has gone.
    /// To be called once.
    ///
    /// # Errors
    /// A thread that cannot be started, or a coordinator that has gone.
    pub fn ready(&mut self, beat: impl Fn() + Send + 'static) -> Result<(), ProcessError> {
        let stream = self.socket.stream().map_err(system("use the coordinator's socket"))?;
        thread::Builder::new()
            .name("heartbeat".to_owned())
            .spawn(move || keep_up(&stream, beat))
            .map_err(system("start a thread for the heartbeat"))?;
        self.say(&Control::Ready)
    }

    /// Says that this worker cannot go on, and why, in words for users. The process is to end then.
    ///
    /// # Errors
    /// A coordinator that has gone.
    pub fn fail(mut self, text: &str) -> Result<(), ProcessError> {
        let text = text[..text.floor_char_boundary(TEXT_LIMIT)].to_owned();
        self.say(&Control::Failed(text))
    }

    /// Says that this worker is done, and what is left to say, which may be nothing. The process
    /// is to end then.
    ///
    /// # Errors
    /// A report of more than 64 MiB, about, or a coordinator that has gone.
    pub fn report(mut self, bytes: Vec<u8>) -> Result<(), ProcessError> {
        self.say(&Control::Report(bytes))
    }

    /// Waits until the message is sent.
    fn say(&mut self, message: &Control) -> Result<(), ProcessError> {
        self.socket.queue(&frame(message)?);
        let said = |socket: &mut Socket| socket.is_sent() && !socket.is_gone();
        Ok(self.socket.wait(None, |socket| Ok(said(socket).then_some(())))?)
    }
}

/// Standard input, if it is a socket such as a coordinator makes.
fn standard_input() -> Result<UnixStream, ProcessError> {
    let input = io::stdin();
    let is_unix = || Ok(getsockname(&input)?.address_family() == AddressFamily::UNIX);
    let is_stream = || Ok(sockopt::socket_type(&input)? == SocketType::STREAM);
    let is_socket = |asked: Result<bool, Errno>| asked.unwrap_or(false);
    if !(is_socket(is_unix()) && is_socket(is_stream())) {
        return Err(ProcessError::ByHand);
    }
    let own = input.as_fd().try_clone_to_owned();
    Ok(own.map_err(system("use the coordinator's socket"))?.into())
}

/// A stopped process does not see that a socket is closed. This ends it all the same.
fn end_with_parent() -> Result<(), ProcessError> {
    #[cfg(target_os = "linux")]
    rustix::process::set_parent_process_death_signal(Some(Signal::KILL))
        .map_err(system("ask to end with the coordinator"))?;
    Ok(())
}

/// A process started through `/proc/self/exe` is listed as `exe`. Lists are to show its program.
fn name_process() {
    #[cfg(target_os = "linux")]
    if let Some(program) = std::env::args_os().next()
        && let Some(name) = std::path::Path::new(&program).file_name()
        && let Ok(name) = std::ffi::CString::new(name.as_encoded_bytes())
    {
        // The name is for people; nothing depends on it.
        let _ = rustix::thread::set_name(&name);
    }
}

/// Calls `beat` until the coordinator has gone, and then ends the process.
fn keep_up(stream: &UnixStream, beat: impl Fn()) {
    let pause = timespec(BEAT);
    loop {
        beat();
        if matches!(poll(&mut [PollFd::new(stream, PollFlags::IN)], Some(&pause)), Ok(0)) {
            continue;
        }
        match recv(stream, &mut [0_u8; 64], RecvFlags::empty()) {
            // A coordinator says nothing more. If it does, nobody listens.
            Ok((count, _)) if count > 0 => (),
            Err(Errno::AGAIN | Errno::INTR) => (),
            Ok(_) | Err(_) => end_at_once(),
        }
    }
}

/// Ends the process without running anything more, which could wait for threads that work.
fn end_at_once() -> ! {
    let _ = kill_process(getpid(), Signal::KILL);
    std::process::exit(1)
}
