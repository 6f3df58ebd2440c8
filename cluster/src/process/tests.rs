//! Both sides together, with real processes.
//!
//! The workers are this test program once more, told to run one of the ignored tests below, which
//! does nothing when it is run by hand.

use std::fs::{self, File};
use std::io::{BufRead, BufReader};
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileExt;
use std::os::unix::net::UnixStream;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

use rustix::process::{Pid, Signal, WaitOptions, kill_process, waitpid};

use super::message::{Channel, Message, frame, greeting};
use super::*;
use crate::place::{self, Place};

/// Where the shared file says that the run is over.
const OVER: u64 = 1000;
/// Longer than anything takes, also on a busy machine.
const LONG: Duration = Duration::from_secs(30);
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
        let text = format!("worker {} of {} has no disk", worker.rank, worker.size);
        worker.fail(&text).unwrap();
        return;
    }
    if worker.payload == b"wait" {
        sleep(LONG);
    }
    if worker.payload == b"one by one" {
        sleep(Duration::from_millis(300) * worker.rank as u32);
    }
    let (rank, region) = (worker.rank as u64, worker.region.try_clone().unwrap());
    region.write_all_at(&[rank as u8 + 1], rank).unwrap();
    let beating = region.try_clone().unwrap();
    let count = std::sync::atomic::AtomicU64::new(1);
    let beat = move || {
        let count = count.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        let _ = beating.write_all_at(&count.to_le_bytes(), 8 * (rank + 1));
    };
    worker.ready(beat).unwrap();
    if worker.payload == b"exit" || (worker.payload == b"one by one" && worker.rank == 0) {
        std::process::exit(7);
    }
    while byte(&region, OVER) == 0 {
        sleep(LOOK);
    }
    let report = match worker.payload.as_slice() {
        b"long" => vec![rank as u8; 30 << 20],
        b"bound" => format!("{:?}", place::Machine::detect().unwrap()).into_bytes(),
        _ => vec![rank as u8; 3],
    };
    worker.report(report).unwrap();
}

fn byte(file: &File, at: u64) -> u8 {
    let mut byte = [0];
    file.read_exact_at(&mut byte, at).map_or(0, |()| byte[0])
}

/// The heartbeats in the shared file.
fn beats(file: &File) -> impl Fn(usize) -> u64 {
    let file = file.try_clone().unwrap();
    move |rank| {
        let mut bytes = [0; 8];
        file.read_exact_at(&mut bytes, 8 * (rank as u64 + 1)).unwrap();
        u64::from_le_bytes(bytes)
    }
}

fn region() -> File {
    let file = tempfile::tempfile().unwrap();
    file.set_len(4096).unwrap();
    file
}

fn launch(test: &str, workers: usize, payload: &str, region: &File) -> Launch {
    let test = format!("process::tests::{test}");
    Launch {
        program: this_program().unwrap(),
        arguments: ["--exact", &test, "--ignored", "--nocapture"].map(Into::into).to_vec(),
        workers,
        version: "1.0".to_owned(),
        payload: payload.as_bytes().to_vec(),
        region: region.try_clone().unwrap(),
        places: None,
        patience: LONG,
        silence: LONG,
    }
}

fn start(workers: usize, payload: &str, region: &File) -> Workers {
    Workers::start(launch("worker", workers, payload, region)).unwrap()
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

fn pid(workers: &Workers, rank: usize) -> u32 {
    workers.pids()[rank].unwrap()
}

fn until(what: &str, within: Duration, mut found: impl FnMut() -> bool) {
    let start = Instant::now();
    while !found() {
        assert!(start.elapsed() < within, "waited too long: {what}");
        sleep(LOOK);
    }
}

/// The next losses.
fn losses(workers: &mut Workers, region: &File) -> Vec<Loss> {
    let mut found = Vec::new();
    until("a loss", LONG, || {
        found = workers.check(beats(region));
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
    let region = region();
    let mut workers = start(3, "long", &region);
    assert_eq!([0, 1, 2].map(|rank| byte(&region, rank)), [1, 2, 3]);
    assert!(workers.check(beats(&region)).is_empty());
    let pids = workers.pids();
    region.write_all_at(&[1], OVER).unwrap();
    let reports = workers.finish(LONG);
    for (rank, report) in reports.into_iter().enumerate() {
        assert!(report.unwrap() == vec![rank as u8; 30 << 20]);
    }
    assert!(pids.into_iter().all(|pid| !exists(pid.unwrap())));
}

#[test]
fn an_orderly_end_is_no_loss() {
    let region = region();
    let mut workers = start(2, "", &region);
    region.write_all_at(&[1], OVER).unwrap();
    until("both to end", LONG, || {
        assert!(workers.check(beats(&region)).is_empty());
        workers.pids() == [None, None]
    });
    assert!(matches!(workers.replace(0), Err(ProcessError::Present(0))));
    assert_eq!(workers.finish(LONG), [Some(vec![0; 3]), Some(vec![1; 3])]);
}

#[test]
fn a_killed_worker_is_named_and_replaced() {
    let region = region();
    let mut workers = start(3, "", &region);
    let killed = pid(&workers, 1);
    signal(killed, Signal::KILL);
    let lost = losses(&mut workers, &region);
    assert!(!exists(killed));
    let text = format!("worker 1 (process {killed}) was ended by SIGKILL");
    assert_eq!(lost.iter().map(Loss::to_string).collect::<Vec<_>>(), [text]);
    assert_eq!(workers.pids()[1], None);
    region.write_all_at(&[0], 1).unwrap();
    workers.replace(1).unwrap();
    assert!(matches!(workers.replace(1), Err(ProcessError::Present(1))));
    assert!(matches!(workers.replace(3), Err(ProcessError::Rank { rank: 3, workers: 3 })));
    until("the replacement", LONG, || {
        assert!(workers.check(beats(&region)).is_empty());
        byte(&region, 1) == 2
    });
    assert_ne!(pid(&workers, 1), killed);
    region.write_all_at(&[1], OVER).unwrap();
    assert_eq!(workers.finish(LONG), [0, 1, 2].map(|rank| Some(vec![rank; 3])));
}

#[test]
fn a_stopped_worker_is_silent() {
    let region = region();
    let silence = Duration::from_millis(700);
    let mut workers =
        Workers::start(Launch { silence, ..launch("worker", 2, "", &region) }).unwrap();
    assert!(workers.check(beats(&region)).is_empty());
    let stopped = pid(&workers, 0);
    stop(stopped);
    // A coordinator that did not look has no right to complain.
    sleep(2 * silence);
    assert!(workers.check(beats(&region)).is_empty());
    let start = Instant::now();
    let lost = losses(&mut workers, &region);
    assert!(start.elapsed() < 5 * silence);
    assert!(!exists(stopped));
    let text = format!("worker 0 (process {stopped}) gave no sign of life for 700ms");
    assert_eq!(lost.iter().map(Loss::to_string).collect::<Vec<_>>(), [text]);
    // The other is still heard.
    let start = Instant::now();
    while start.elapsed() < 2 * silence {
        assert!(workers.check(beats(&region)).is_empty());
        sleep(LOOK);
    }
}

#[test]
fn signals_to_the_group_leave_workers_alone() {
    let region = region();
    let workers = start(1, "", &region);
    for each in [Signal::INT, Signal::TERM, Signal::HUP] {
        signal(pid(&workers, 0), each);
    }
    sleep(Duration::from_millis(100));
    region.write_all_at(&[1], OVER).unwrap();
    assert_eq!(workers.finish(LONG), [Some(vec![0; 3])]);
}

#[test]
fn nothing_is_left_of_dropped_workers() {
    let region = region();
    let workers = start(3, "", &region);
    let pids = workers.pids();
    stop(pids[2].unwrap());
    drop(workers);
    assert!(pids.into_iter().all(|pid| !exists(pid.unwrap())));
}

#[test]
fn who_does_not_report_in_time_is_ended() {
    let region = region();
    let workers = start(2, "", &region);
    let pids = workers.pids();
    stop(pids[0].unwrap());
    region.write_all_at(&[1], OVER).unwrap();
    assert_eq!(workers.finish(Duration::from_secs(5)), [None, Some(vec![1; 3])]);
    assert!(pids.into_iter().all(|pid| !exists(pid.unwrap())));
}

fn refused(launch: Launch) -> String {
    Workers::start(launch).unwrap_err().to_string()
}

#[test]
fn who_cannot_begin_says_why() {
    let region = region();
    let text = refused(launch("worker", 1, "fail", &region));
    assert!(text.ends_with(" failed: worker 0 of 1 has no disk"), "{text}");

    let text = refused(launch("worker_of_another_version", 2, "", &region));
    assert!(text.contains("the other end is version 2.0 (protocol 1)"), "{text}");
    assert!(text.ends_with("and this is version 1.0 (protocol 1)"), "{text}");

    let patience = Duration::from_millis(500);
    let text = refused(Launch { patience, ..launch("worker", 1, "wait", &region) });
    assert!(text.ends_with(" was not ready within 500ms"), "{text}");
}

#[test]
fn a_worker_that_just_ends_is_lost() {
    let region = region();
    // Also one that ends while others are not ready yet.
    for (count, payload) in [(1, "exit"), (2, "one by one")] {
        let mut workers = start(count, payload, &region);
        let lost = losses(&mut workers, &region);
        let text = lost.iter().map(Loss::to_string).collect::<String>();
        assert!(text.starts_with("worker 0 ") && lost.len() == 1, "{text}");
        assert!(text.ends_with(" ended too early, with exit code 7"), "{text}");
        workers.replace(0).unwrap();
    }
}

#[test]
fn other_programs_are_refused() {
    let region = region();
    let program = |program: &str, arguments: &[&str]| Launch {
        program: program.into(),
        arguments: arguments.iter().map(Into::into).collect(),
        patience: Duration::from_millis(500),
        ..launch("worker", 2, "", &region)
    };
    let text = refused(program("/bin/true", &[]));
    assert!(text.ends_with(" ended too early, with exit code 0"), "{text}");
    for (name, arguments) in [("/bin/cat", &[][..]), ("/bin/sleep", &["100"])] {
        let text = refused(program(name, arguments));
        assert!(text.ends_with(" was not ready within 500ms"), "{text}");
    }
    let text = refused(program("/bin/sh", &["-c", "echo hello >&0; exec sleep 100"]));
    assert!(text.ends_with("none of this program: it begins with \"hello\\n\""), "{text}");
    let text = refused(program("/bin/sh", &["-c", "cat >&0 2>/dev/null"]));
    assert!(text.ends_with("sent the message Setup, which has no place there"), "{text}");
    let text = refused(program("/no/such/program", &[]));
    assert!(text.starts_with("cannot start a worker from /no/such/program: "), "{text}");
    let places = Some(Vec::new());
    let text = refused(Launch { places, ..launch("worker", 2, "", &region) });
    assert_eq!(text, "there are places for 0 workers, and 2 workers");
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
fn workers_run_where_they_are_placed() {
    let region = region();
    let places = place::assign(1, 1).unwrap();
    let alone = place::with_bound(&places[0], place::Machine::detect).unwrap().unwrap();
    let launch_bound = Launch { places: Some(places), ..launch("worker", 1, "bound", &region) };
    let workers = Workers::start(launch_bound).unwrap();
    region.write_all_at(&[1], OVER).unwrap();
    let report = workers.finish(LONG).remove(0).unwrap();
    assert_eq!(String::from_utf8(report).unwrap(), format!("{alone:?}"));

    let places = Some(vec![Place { node: 0, cpus: vec![1023] }]);
    let text = refused(Launch { places, ..launch("worker", 1, "", &region) });
    assert!(text.contains(" failed: cannot bind a thread to node 0, cpus 1023: "), "{text}");
}

/// A run of two workers, one of them stopped.
#[test]
#[ignore = "run by other tests"]
fn coordinator() {
    let workers = start(2, "", &region());
    stop(pid(&workers, 1));
    println!("<{} {}>", pid(&workers, 0), pid(&workers, 1));
    sleep(Duration::from_secs(10));
}

#[cfg(target_os = "linux")]
#[test]
fn workers_end_with_their_coordinator() {
    let mut middle = Command::new(this_program().unwrap())
        .args(["--exact", "process::tests::coordinator", "--ignored", "--nocapture"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let lines = BufReader::new(middle.stdout.take().unwrap()).lines();
    let line = lines.map(Result::unwrap).find(|line| line.contains('<')).unwrap();
    let (_, pids) = line.split_once('<').unwrap();
    let pids: Vec<u32> =
        pids.trim_end_matches('>').split(' ').map(|pid| pid.parse().unwrap()).collect();
    assert!(!pids.iter().any(|&pid| has_ended(pid)));
    middle.kill().unwrap();
    middle.wait().unwrap();
    until("workers to end", Duration::from_secs(1), || pids.iter().all(|&pid| has_ended(pid)));
}

#[test]
fn a_worker_ends_when_its_socket_is_closed() {
    let (own, other) = UnixStream::pair().unwrap();
    let Launch { program, arguments, region, .. } = launch("worker", 1, "", &region());
    let mut child = Command::new(program)
        .args(arguments)
        .stdin(OwnedFd::from(other))
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut channel = Channel::new(own).unwrap();
    channel.queue(&greeting("1.0").unwrap());
    let setup = Message::Setup { rank: 0, size: 1, place: None, payload: Vec::new() };
    channel.queue_with(&frame(&setup).unwrap(), region);
    channel.wait(Some(LONG), |channel| Ok(channel.greeted("1.0")?.then_some(()))).unwrap();
    assert_eq!(channel.wait(Some(LONG), Channel::message).unwrap(), Message::Ready);
    drop(channel);
    let start = Instant::now();
    let status = child.wait().unwrap();
    assert!(start.elapsed() < Duration::from_secs(1));
    assert_eq!(status.signal(), Some(9));
}
