//! Both sides together, with real processes.
//!
//! The workers are this test program once more, asked to run one of the ignored tests below, which
//! does nothing when it is run by hand.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileExt;
use std::os::unix::net::UnixStream;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitOptions, kill_process, waitpid};

use super::message::{Control, Socket, frame, greeting};
use super::*;
use crate::affinity::{self, Processors};

/// Where the shared file says that the run is over.
const OVER: u64 = 1000;
/// Where a worker writes its process.
const PROCESS: u64 = 2000;
/// Longer than anything takes, also on a busy machine: what hangs is to fail, and not to hang.
const LONG: Duration = Duration::from_secs(300);
const LOOK: Duration = Duration::from_millis(5);

/// A worker, which does what its payload says.
#[test]
#[ignore = "run by other tests"]
fn worker() {
    work("1.0");
}

#[test]
#[ignore = "run by other tests"]
fn worker_of_another_version() {
    work("2.0");
}

fn work(version: &str) {
    let Ok(mut worker) = attach(version) else {
        return;
    };
    if worker.payload == b"fail" {
        let text = format!("worker {} of {} has no disk", worker.index, worker.workers);
        worker.fail(&text).unwrap();
        return;
    }
    if worker.payload == b"wait" {
        sleep(LONG);
    }
    let (index, memory) = (worker.index as u64, worker.memory.try_clone().unwrap());
    if worker.payload == b"one by one" && index == 1 {
        // Its coordinator has seen the other end when nothing is left of that.
        until("the other has ended", || number(&memory, PROCESS).is_some_and(|pid| !exists(pid)));
    }
    memory.write_all_at(&[index as u8 + 1], index).unwrap();
    let beating = memory.try_clone().unwrap();
    let count = AtomicU64::new(1);
    let beat = move || {
        let count = count.fetch_add(1, Ordering::Relaxed);
        let _ = beating.write_all_at(&count.to_le_bytes(), 8 * (index + 1));
    };
    worker.ready(beat).unwrap();
    if worker.payload == b"exit" || (worker.payload == b"one by one" && worker.index == 0) {
        memory.write_all_at(&std::process::id().to_le_bytes(), PROCESS).unwrap();
        std::process::exit(7);
    }
    while byte(&memory, OVER) == 0 {
        sleep(LOOK);
    }
    let report = match worker.payload.as_slice() {
        b"long" => vec![index as u8; 30 << 20],
        b"bound" => format!("{:?}", affinity::Topology::detect().unwrap()).into_bytes(),
        _ => vec![index as u8; 3],
    };
    worker.report(report).unwrap();
}

fn byte(file: &File, at: u64) -> u8 {
    let mut byte = [0];
    file.read_exact_at(&mut byte, at).map_or(0, |()| byte[0])
}

fn number(file: &File, at: u64) -> Option<u32> {
    let mut bytes = [0; 4];
    file.read_exact_at(&mut bytes, at).ok()?;
    Some(u32::from_le_bytes(bytes)).filter(|&number| number > 0)
}

/// The heartbeats in the shared file.
fn beats(file: &File) -> impl Fn(usize) -> u64 {
    let file = file.try_clone().unwrap();
    move |index| {
        let mut bytes = [0; 8];
        file.read_exact_at(&mut bytes, 8 * (index as u64 + 1)).unwrap();
        u64::from_le_bytes(bytes)
    }
}

fn memory() -> File {
    let file = tempfile::tempfile().unwrap();
    file.set_len(4096).unwrap();
    file
}

fn launch(test: &str, workers: usize, payload: &str, memory: &File) -> Launch {
    let test = format!("process::tests::{test}");
    Launch {
        program: this_program().unwrap(),
        arguments: ["--exact", &test, "--ignored", "--nocapture"].map(Into::into).to_vec(),
        workers,
        version: "1.0".to_owned(),
        payload: payload.as_bytes().to_vec(),
        memory: memory.try_clone().unwrap(),
        affinity: None,
        patience: LONG,
        silence: LONG,
    }
}

fn start(workers: usize, payload: &str, memory: &File) -> Workers {
    Workers::start(launch("worker", workers, payload, memory)).unwrap()
}

fn signal(pid: u32, signal: Signal) {
    kill_process(Pid::from_raw(pid as i32).unwrap(), signal).unwrap();
}

/// Stops a child, and returns when it stands still: until then it may go on for a while.
fn stop(pid: u32) {
    signal(pid, Signal::STOP);
    let (_, status) = waitpid(Pid::from_raw(pid as i32), WaitOptions::UNTRACED).unwrap().unwrap();
    assert!(status.stopped());
}

fn pid(workers: &Workers, index: usize) -> u32 {
    workers.pids()[index].unwrap()
}

fn until(what: &str, mut found: impl FnMut() -> bool) {
    let start = Instant::now();
    while !found() {
        assert!(start.elapsed() < LONG, "waited too long: {what}");
        sleep(LOOK);
    }
}

/// A process that ends with its test.
struct Guarded(Child);

impl Guarded {
    fn wait(&mut self) -> ExitStatus {
        let mut status = None;
        until("a process to end", || {
            status = self.0.try_wait().unwrap();
            status.is_some()
        });
        status.unwrap()
    }
}

impl Drop for Guarded {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The next losses.
fn losses(workers: &mut Workers, memory: &File) -> Vec<Loss> {
    let mut found = Vec::new();
    until("a loss", || {
        found = workers.check(beats(memory));
        !found.is_empty()
    });
    found
}

fn exists(pid: u32) -> bool {
    fs::exists(format!("/proc/{pid}")).unwrap()
}

/// Gone, or reaped by nobody.
fn has_ended(pid: u32) -> bool {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    !status.lines().any(|line| line.starts_with("State:") && !line.contains('Z'))
}

#[test]
fn workers_find_their_payload_and_memory_and_report() {
    let memory = memory();
    let mut workers = start(3, "long", &memory);
    assert_eq!([0, 1, 2].map(|index| byte(&memory, index)), [1, 2, 3]);
    assert!(workers.check(beats(&memory)).is_empty());
    let pids = workers.pids();
    memory.write_all_at(&[1], OVER).unwrap();
    let reports = workers.finish(LONG);
    for (index, report) in reports.into_iter().enumerate() {
        assert!(report.unwrap() == vec![index as u8; 30 << 20]);
    }
    assert!(pids.into_iter().all(|pid| !exists(pid.unwrap())));
}

#[test]
fn an_orderly_end_is_no_loss() {
    let memory = memory();
    let mut workers = start(2, "", &memory);
    memory.write_all_at(&[1], OVER).unwrap();
    until("both to end", || {
        assert!(workers.check(beats(&memory)).is_empty());
        workers.pids() == [None, None]
    });
    assert!(matches!(workers.replace(0), Err(ProcessError::Present(0))));
    assert_eq!(workers.finish(LONG), [Some(vec![0; 3]), Some(vec![1; 3])]);
}

#[test]
fn a_killed_worker_is_named_and_replaced() {
    let memory = memory();
    let mut workers = start(3, "", &memory);
    let killed = pid(&workers, 1);
    signal(killed, Signal::KILL);
    let lost = losses(&mut workers, &memory);
    assert!(!exists(killed));
    let text = format!("worker 1 (process {killed}) was ended by SIGKILL");
    assert_eq!(lost.iter().map(Loss::to_string).collect::<Vec<_>>(), [text]);
    assert_eq!(workers.pids()[1], None);
    memory.write_all_at(&[0], 1).unwrap();
    workers.replace(1).unwrap();
    assert!(matches!(workers.replace(1), Err(ProcessError::Present(1))));
    assert!(matches!(workers.replace(3), Err(ProcessError::Worker { worker: 3, workers: 3 })));
    until("the replacement", || {
        assert!(workers.check(beats(&memory)).is_empty());
        byte(&memory, 1) == 2
    });
    assert_ne!(pid(&workers, 1), killed);
    memory.write_all_at(&[1], OVER).unwrap();
    assert_eq!(workers.finish(LONG), [0, 1, 2].map(|index| Some(vec![index; 3])));
}

#[test]
fn a_stopped_worker_is_silent() {
    let memory = memory();
    let silence = Duration::from_millis(700);
    let mut workers =
        Workers::start(Launch { silence, ..launch("worker", 2, "", &memory) }).unwrap();
    // On a busy machine the other may be late, so this test beats for it.
    let (heard, other) = (beats(&memory), AtomicU64::new(0));
    let beat = |index| match index {
        0 => heard(0),
        _ => other.fetch_add(1, Ordering::Relaxed),
    };
    assert!(workers.check(beat).is_empty());
    let stopped = pid(&workers, 0);
    stop(stopped);
    // A coordinator that did not look has no right to complain.
    sleep(2 * silence);
    let start = Instant::now();
    assert!(workers.check(beat).is_empty());
    let mut lost = Vec::new();
    until("a loss", || {
        lost = workers.check(beat);
        !lost.is_empty()
    });
    // The first of these looks counts for 0.1 s.
    assert!(start.elapsed() >= silence - Duration::from_millis(100));
    assert!(!exists(stopped));
    let text = format!("worker 0 (process {stopped}) gave no sign of life for 700ms");
    assert_eq!(lost.iter().map(Loss::to_string).collect::<Vec<_>>(), [text]);
    // The other is still heard.
    let start = Instant::now();
    while start.elapsed() < 2 * silence {
        assert!(workers.check(beat).is_empty());
        sleep(LOOK);
    }
}

#[test]
fn a_worker_beats_as_long_as_it_lives() {
    let memory = memory();
    let workers = start(1, "", &memory);
    let beats = beats(&memory);
    for _ in 0..3 {
        let before = beats(0);
        until("another beat", || beats(0) > before);
    }
    drop(workers);
}

#[test]
fn signals_to_the_group_leave_workers_alone() {
    let memory = memory();
    let workers = start(1, "", &memory);
    for each in [Signal::INT, Signal::TERM, Signal::HUP] {
        signal(pid(&workers, 0), each);
    }
    // It has to see this, and before that the signals.
    memory.write_all_at(&[1], OVER).unwrap();
    assert_eq!(workers.finish(LONG), [Some(vec![0; 3])]);
}

#[test]
fn nothing_is_left_of_dropped_workers() {
    let memory = memory();
    let workers = start(3, "", &memory);
    let pids = workers.pids();
    stop(pids[2].unwrap());
    drop(workers);
    assert!(pids.into_iter().all(|pid| !exists(pid.unwrap())));
}

#[test]
fn who_does_not_report_in_time_is_ended() {
    let memory = memory();
    let mut workers = start(2, "", &memory);
    let pids = workers.pids();
    stop(pids[0].unwrap());
    memory.write_all_at(&[1], OVER).unwrap();
    until("the other to report", || {
        assert!(workers.check(beats(&memory)).is_empty());
        workers.pids()[1].is_none()
    });
    assert_eq!(workers.finish(Duration::from_millis(500)), [None, Some(vec![1; 3])]);
    assert!(pids.into_iter().all(|pid| !exists(pid.unwrap())));
}

fn refused(launch: Launch) -> String {
    Workers::start(launch).unwrap_err().to_string()
}

#[test]
fn who_cannot_begin_says_why() {
    let memory = memory();
    let text = refused(launch("worker", 1, "fail", &memory));
    assert!(text.ends_with(" failed: worker 0 of 1 has no disk"), "{text}");

    let text = refused(launch("worker_of_another_version", 2, "", &memory));
    assert!(text.contains("the other end is version 2.0 (protocol 1)"), "{text}");
    assert!(text.ends_with("and this is version 1.0 (protocol 1)"), "{text}");

    let patience = Duration::from_millis(500);
    let text = refused(Launch { patience, ..launch("worker", 1, "wait", &memory) });
    assert!(text.ends_with(" was not ready within 500ms"), "{text}");
}

#[test]
fn a_worker_that_just_ends_is_lost() {
    // Also one that ends while others are not ready yet.
    for (count, payload) in [(1, "exit"), (2, "one by one")] {
        let memory = memory();
        let mut workers = start(count, payload, &memory);
        let lost = losses(&mut workers, &memory);
        let text = lost.iter().map(Loss::to_string).collect::<String>();
        assert!(text.starts_with("worker 0 ") && lost.len() == 1, "{text}");
        assert!(text.ends_with(" ended too early, with exit code 7"), "{text}");
        workers.replace(0).unwrap();
    }
}

#[test]
fn other_programs_are_refused() {
    let memory = memory();
    let program = |program: &str, arguments: &[&str]| Launch {
        program: program.into(),
        arguments: arguments.iter().map(Into::into).collect(),
        ..launch("worker", 2, "", &memory)
    };
    let text = refused(program("/bin/true", &[]));
    assert!(text.ends_with(" ended too early, with exit code 0"), "{text}");
    for (name, arguments) in [("/bin/cat", &[][..]), ("/bin/sleep", &["1000"])] {
        let patience = Duration::from_millis(500);
        let text = refused(Launch { patience, ..program(name, arguments) });
        assert!(text.ends_with(" was not ready within 500ms"), "{text}");
    }
    let text = refused(program("/bin/sh", &["-c", "echo hello >&0; exec sleep 1000"]));
    assert!(text.ends_with("none of this program: it begins with \"hello\\n\""), "{text}");
    let text = refused(program("/bin/sh", &["-c", "cat >&0 2>/dev/null"]));
    assert!(text.ends_with("sent the message Setup, which has no place there"), "{text}");
    let text = refused(program("/no/such/program", &[]));
    assert!(text.starts_with("cannot start a worker from /no/such/program: "), "{text}");
    let affinity = Some(Vec::new());
    let text = refused(Launch { affinity, ..launch("worker", 2, "", &memory) });
    assert_eq!(text, "processors are given for 0 workers, and there are 2 workers");
}

#[test]
fn a_worker_started_by_hand_says_so() {
    // A test's standard input is that of the caller, so this looks at a worker's exit.
    let output = Command::new(this_program().unwrap())
        .args(["--exact", "process::tests::by_hand", "--ignored", "--nocapture"])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("<this command is started by a coordinator, not by hand>"), "{text}");
}

#[test]
#[ignore = "run by other tests"]
fn by_hand() {
    if let Err(error) = attach("1.0") {
        println!("<{error}>");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn workers_run_on_the_processors_that_they_are_bound_to() {
    let memory = memory();
    let one = affinity::assign(1, 1).unwrap();
    let alone = affinity::with_bound(&one[0], affinity::Topology::detect).unwrap().unwrap();
    let launch_bound = Launch { affinity: Some(one), ..launch("worker", 1, "bound", &memory) };
    let workers = Workers::start(launch_bound).unwrap();
    memory.write_all_at(&[1], OVER).unwrap();
    let report = workers.finish(LONG).remove(0).unwrap();
    assert_eq!(String::from_utf8(report).unwrap(), format!("{alone:?}"));

    let affinity = Some(vec![Processors { node: 0, cpus: vec![1023] }]);
    let text = refused(Launch { affinity, ..launch("worker", 1, "", &memory) });
    assert!(text.contains(" failed: cannot bind a thread to node 0, cpus 1023: "), "{text}");
}

/// A run of two workers, one of them stopped.
#[test]
#[ignore = "run by other tests"]
fn coordinator() {
    let workers = start(2, "", &memory());
    stop(pid(&workers, 1));
    println!("<{} {}>", pid(&workers, 0), pid(&workers, 1));
    // Until it is killed, or who should do that has gone.
    let _ = std::io::stdin().read_line(&mut String::new());
}

#[cfg(target_os = "linux")]
#[test]
fn workers_end_with_their_coordinator() {
    let middle = Command::new(this_program().unwrap())
        .args(["--exact", "process::tests::coordinator", "--ignored", "--nocapture"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn();
    let mut middle = Guarded(middle.unwrap());
    let lines = BufReader::new(middle.0.stdout.take().unwrap()).lines();
    let line = lines.map(Result::unwrap).find(|line| line.contains('<')).unwrap();
    let (_, pids) = line.split_once('<').unwrap();
    let pids: Vec<u32> =
        pids.trim_end_matches('>').split(' ').map(|pid| pid.parse().unwrap()).collect();
    assert!(!pids.iter().any(|&pid| has_ended(pid)));
    drop(middle);
    until("workers to end", || pids.iter().all(|&pid| has_ended(pid)));
}

#[test]
fn a_worker_ends_when_its_socket_is_closed() {
    let (own, other) = UnixStream::pair().unwrap();
    let Launch { program, arguments, memory, .. } = launch("worker", 1, "", &memory());
    let child = Command::new(program)
        .args(arguments)
        .stdin(OwnedFd::from(other))
        .stdout(Stdio::null())
        .spawn();
    let mut child = Guarded(child.unwrap());
    let mut socket = Socket::new(own).unwrap();
    socket.queue(&greeting("1.0").unwrap());
    let setup = Control::Setup { index: 0, workers: 1, processors: None, payload: Vec::new() };
    socket.queue_with(&frame(&setup).unwrap(), memory);
    socket.wait(Some(LONG), |socket| Ok(socket.greeted("1.0")?.then_some(()))).unwrap();
    assert_eq!(socket.wait(Some(LONG), Socket::message).unwrap(), Control::Ready);
    drop(socket);
    assert_eq!(child.wait().signal(), Some(9));
}
