//! Ranks of MPI, for which this is a plain program: it has to be started by a launcher.
//!
//! Started by nobody, it starts itself with several numbers of ranks and looks at how they end.
//! Started with `mpirun`, each rank runs what its argument names. Ranks know from the numbers of a
//! message what has to be in it, without having seen it sent.

use std::env;
use std::fs::File;
use std::io::{Read, Seek};
use std::process::{Command, ExitCode, ExitStatus};
use std::thread;
use std::time::{Duration, Instant, SystemTime};

use perceptile_cluster::communicator::{Communicator, Message, Transfer};
use perceptile_cluster::launcher::Launcher;
use perceptile_cluster::mpi::Mpi;

fn main() -> ExitCode {
    if Launcher::detect(|name| env::var(name).ok()).is_none() {
        start_all();
        return ExitCode::SUCCESS;
    }
    let communicator = match Mpi::init() {
        Ok(communicator) => communicator,
        Err(error) => {
            eprintln!("refused: {error}");
            return ExitCode::from(2);
        }
    };
    match env::args().nth(1).as_deref() {
        Some("panic") => panics(&communicator, Panic::Main),
        Some("panic-thread") => panics(&communicator, Panic::Thread),
        Some("panic-unhooked") => panics(&communicator, Panic::Unhooked),
        Some("panic-sending") => panics(&communicator, Panic::Sending),
        Some("disagree") => disagrees(&communicator),
        Some("abort") => aborts(&communicator),
        _ => works_together(communicator),
    }
    ExitCode::SUCCESS
}

// What starts the ranks.

/// Runs ranks of all kinds and looks at how they end.
fn start_all() {
    for ranks in [1, 2, 3, 7] {
        let ended = launch(ranks, &[], "all");
        assert_eq!(ended.status.code(), Some(0), "{ranks} ranks: {}", ended.text);
        let said = ended.text.matches("all is well").count();
        assert_eq!(said, ranks, "{ranks} ranks: {}", ended.text);
        println!("{ranks} ranks work together");
    }
    for (role, message) in [
        ("panic", "a panic of the last rank"),
        ("panic-thread", "a panic of a thread"),
        ("panic-unhooked", "a panic of the last rank"),
        ("panic-sending", "a panic in a transfer"),
        ("disagree", "and those that rank 1 expects"),
    ] {
        let ended = launch(3, &[], role);
        assert_eq!(ended.status.code(), Some(101), "{role}: {}", ended.text);
        assert_eq!(ended.text.matches(message).count(), 1, "{role}: {}", ended.text);
        println!("{role} ends all ranks");
    }
    let ended = launch(3, &[], "abort");
    assert_eq!(ended.status.code(), Some(7), "abort: {}", ended.text);
    println!("abort ends all ranks");
    let ended = launch(2, &["env", "OMPI_COMM_WORLD_SIZE=5"], "all");
    assert_eq!(ended.status.code(), Some(2), "another size: {}", ended.text);
    let message = "refused: the launcher started 5 processes, but MPI sees 2: this program was \
                   built with another MPI (";
    assert!(ended.text.contains(message), "another size: {}", ended.text);
    println!("another number of ranks than the launcher started is refused");
}

/// How the ranks ended.
struct Ended {
    status: ExitStatus,
    /// What they and their launcher wrote.
    text: String,
}

/// Starts ranks of this program, and waits until they have ended.
fn launch(ranks: usize, before: &[&str], role: &str) -> Ended {
    // Longer than anything takes, also on a busy machine.
    const LONGEST: Duration = Duration::from_secs(300);
    let mut output = tempfile::tempfile().unwrap();
    let same = |file: &File| file.try_clone().unwrap();
    let begin = Instant::now();
    let mut launcher = Command::new("mpirun")
        .args(["--allow-run-as-root", "--oversubscribe", "--mca", "mpi_yield_when_idle", "1"])
        .args(["-n", &ranks.to_string()])
        .args(before)
        .arg(env::current_exe().unwrap())
        .arg(role)
        .env("OMPI_MCA_rmaps_base_oversubscribe", "1")
        .stdout(same(&output))
        .stderr(same(&output))
        .spawn()
        .expect("mpirun is installed where there is MPI");
    let status = loop {
        if let Some(status) = launcher.try_wait().unwrap() {
            break status;
        }
        if begin.elapsed() > LONGEST {
            launcher.kill().unwrap();
            panic!("{ranks} ranks that should {role} do not end");
        }
        thread::sleep(Duration::from_millis(10));
    };
    let mut text = Vec::new();
    output.rewind().unwrap();
    output.read_to_end(&mut text).unwrap();
    Ended { status, text: String::from_utf8_lossy(&text).into_owned() }
}

// What each rank does.

/// All that works, one after the other.
fn works_together(mut communicator: Mpi) {
    communicator.end_all_on_panic();
    for most in [usize::MAX, 999, 7, 1] {
        communicator = communicator.cut_at(most);
        transfers_bring_what_was_sent(&communicator, most);
        values_are_those_of_all_ranks(&communicator);
        bytes_are_those_of_the_root(&communicator);
        single_messages_arrive_in_order(&communicator);
    }
    communicator = communicator.cut_at(usize::MAX);
    threads_wait_for_different_things(&communicator);
    a_dropped_transfer_is_still_sent(&communicator);
    who_rests_leaves_the_processor(&communicator);
    the_last_one_finalises(communicator);
    println!("all is well");
}

/// A number of many bits that is a function of some others.
fn mix(numbers: &[u64]) -> u64 {
    numbers.iter().fold(0x9e37_79b9_7f4a_7c15, |mixed, &number| {
        let mixed = (mixed ^ number).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (mixed ^ (mixed >> 29)).wrapping_mul(0x94d0_49bb_1331_11eb).rotate_left(31)
    })
}

/// Words that are more than libraries send at once.
const LONG: usize = 20_000;

/// The word at some place of a message.
fn word(transfer: u64, round: u64, from: usize, to: usize, index: usize) -> u32 {
    mix(&[transfer, round, from as u64, to as u64, index as u64]) as u32
}

/// A set of messages among all ranks, some of which are empty, not there at all, or `long`.
struct Plan {
    number: u64,
    rank: usize,
    outgoing: Vec<Message>,
    incoming: Vec<Message>,
}

impl Plan {
    fn new(communicator: &Mpi, number: u64, long: usize) -> Self {
        let words = |from: usize, to: usize| {
            let mixed = mix(&[number, from as u64, to as u64]);
            match mixed % 8 {
                0 => None,
                1 => Some(0),
                2 => Some(long + mixed as usize / 8 % (1 + long / 20)),
                _ => Some(mixed as usize / 8 % 50),
            }
        };
        let rank = communicator.rank();
        let ends = |words: &dyn Fn(usize) -> Option<usize>| {
            let end = |other| words(other).map(|words| Message { rank: other, words });
            let mut ends: Vec<_> = (0..communicator.size()).filter_map(end).collect();
            // The two ends of a transfer need not name it in one order.
            let turn = number as usize % ends.len().max(1);
            ends.rotate_left(turn);
            ends
        };
        let outgoing = ends(&|to| words(rank, to));
        let incoming = ends(&|from| words(from, rank));
        Self { number, rank, outgoing, incoming }
    }

    fn start(&self, transfer: &mut dyn Transfer, round: u64) {
        let buffers = transfer.outgoing();
        assert_eq!(buffers.len(), self.outgoing.len());
        for (message, words) in self.outgoing.iter().zip(buffers) {
            assert_eq!(words.len(), message.words);
            for (index, found) in words.iter_mut().enumerate() {
                *found = word(self.number, round, self.rank, message.rank, index);
            }
        }
        transfer.start();
    }

    fn check(&self, transfer: &dyn Transfer, round: u64) {
        let buffers = transfer.incoming();
        assert_eq!(buffers.len(), self.incoming.len());
        for (message, words) in self.incoming.iter().zip(buffers) {
            assert_eq!(words.len(), message.words);
            for (index, &found) in words.iter().enumerate() {
                let expected = word(self.number, round, message.rank, self.rank, index);
                assert_eq!(found, expected, "transfer {}, round {round}", self.number);
            }
        }
    }
}

fn transfers_bring_what_was_sent(communicator: &Mpi, most: usize) {
    // Messages of many pieces, but not of thousands.
    let long = most.saturating_mul(25).min(LONG);
    for number in 0..4 {
        let plans =
            [2 * number, 2 * number + 1].map(|number| Plan::new(communicator, number, long));
        let mut transfers = [0, 1].map(|which: usize| {
            communicator.transfer(&plans[which].outgoing, &plans[which].incoming)
        });
        transfers.iter_mut().for_each(|transfer| transfer.finish());
        for round in 0..25 {
            // Ranks start the two in orders of their own.
            let first = (mix(&[round, communicator.rank() as u64]) % 2) as usize;
            for which in [first, 1 - first] {
                plans[which].start(&mut *transfers[which], round);
            }
            for _ in 0..round {
                transfers.iter_mut().for_each(|transfer| transfer.progress());
            }
            for which in [round as usize % 2, 1 - round as usize % 2] {
                transfers[which].finish();
                plans[which].check(&*transfers[which], round);
            }
        }
    }
}

fn values_are_those_of_all_ranks(communicator: &Mpi) {
    let value = |rank: usize, index: usize| mix(&[rank as u64, index as u64]) as i64;
    for len in [0, 1, 3, 1000] {
        let own: Vec<i64> = (0..len).map(|index| value(communicator.rank(), index)).collect();
        let (mut sums, mut most) = (own.clone(), own);
        communicator.sum(&mut sums);
        communicator.max(&mut most);
        for index in 0..len {
            let all = (0..communicator.size()).map(|rank| value(rank, index));
            assert_eq!(sums[index], all.clone().fold(0, i64::wrapping_add));
            assert_eq!(Some(most[index]), all.max());
        }
    }
    let mut least = [i64::MIN, -1 - communicator.rank() as i64];
    communicator.max(&mut least);
    assert_eq!(least, [i64::MIN, -1]);
}

fn bytes_are_those_of_the_root(communicator: &Mpi) {
    for len in [0, 1, 8, 3000] {
        let byte = |rank: usize, index: usize| mix(&[rank as u64, len, index as u64]) as u8;
        let before =
            if communicator.rank() == 0 { len } else { mix(&[communicator.rank() as u64]) % 5000 };
        let mut bytes: Vec<u8> =
            (0..before as usize).map(|at| byte(communicator.rank(), at)).collect();
        communicator.broadcast(&mut bytes);
        assert_eq!(bytes.len() as u64, len);
        assert!(bytes.iter().enumerate().all(|(at, &found)| found == byte(0, at)));
    }
}

/// Everybody sends to the root, which takes what comes rank by rank.
fn single_messages_arrive_in_order(communicator: &Mpi) {
    let words = |from: usize, number: u64| {
        let len = mix(&[from as u64, number]) as usize % 40;
        (0..len).map(|index| word(1000, number, from, 0, index)).collect::<Vec<_>>()
    };
    if communicator.rank() > 0 {
        (0..20).for_each(|number| communicator.send(0, &words(communicator.rank(), number)));
        return;
    }
    for from in (1..communicator.size()).rev() {
        for number in 0..20 {
            let expected = words(from, number);
            let mut found = vec![0; expected.len()];
            communicator.receive(from, &mut found);
            assert_eq!(found, expected);
        }
    }
}

/// One thread of a rank waits for others, which wait for another thread of that rank.
fn threads_wait_for_different_things(communicator: &Mpi) {
    const LATE: Duration = Duration::from_millis(50);
    let (rank, size) = (communicator.rank(), communicator.size());
    let to_all: Vec<_> = (0..size).map(|other| Message { rank: other, words: 100 }).collect();
    let from_root = [Message { rank: 0, words: 100 }];
    let outgoing = if rank == 0 { &to_all[..] } else { &[] };
    for wait in [
        &(|| communicator.sum(&mut [1])) as &(dyn Fn() + Sync),
        &|| communicator.rest(),
        &|| communicator.broadcast(&mut Vec::new()),
        &|| match rank {
            0 => (1..size).for_each(|from| communicator.receive(from, &mut [0])),
            _ => communicator.send(0, &[1]),
        },
    ] {
        let mut transfer = communicator.transfer(outgoing, &from_root);
        if rank == 0 {
            thread::scope(|scope| {
                scope.spawn(|| {
                    thread::sleep(LATE);
                    transfer.start();
                    transfer.finish();
                });
                wait();
            });
        } else {
            transfer.start();
            transfer.finish();
            wait();
        }
    }
    // Two threads of each rank, each busy with messages of its own.
    let plans = [50, 51].map(|number| Plan::new(communicator, number, LONG));
    let mut transfers =
        plans.each_ref().map(|plan| communicator.transfer(&plan.outgoing, &plan.incoming));
    thread::scope(|scope| {
        for (plan, transfer) in plans.iter().zip(&mut transfers) {
            scope.spawn(move || {
                for round in 0..25 {
                    plan.start(&mut **transfer, round);
                    transfer.progress();
                    transfer.finish();
                    plan.check(&**transfer, round);
                }
            });
        }
    });
}

/// One rank drops what it has started, the others get it nevertheless.
fn a_dropped_transfer_is_still_sent(communicator: &Mpi) {
    let plan = Plan::new(communicator, 60, LONG);
    let mut transfer = communicator.transfer(&plan.outgoing, &plan.incoming);
    plan.start(&mut *transfer, 5);
    if communicator.rank() + 1 < communicator.size() {
        transfer.finish();
        plan.check(&*transfer, 5);
    }
    drop(transfer);
    let next = Plan::new(communicator, 61, LONG);
    let mut transfer = communicator.transfer(&next.outgoing, &next.incoming);
    next.start(&mut *transfer, 6);
    transfer.finish();
    next.check(&*transfer, 6);
}

fn who_rests_leaves_the_processor(communicator: &Mpi) {
    const LATE: Duration = Duration::from_millis(400);
    let now = || SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap();
    communicator.sum(&mut [0]);
    if communicator.rank() == 0 {
        thread::sleep(LATE);
    }
    let (came, busy) = (now(), processor_time());
    communicator.rest();
    let (left, busy) = (now(), processor_time().saturating_sub(busy));
    assert!(busy < LATE / 4, "{busy:?} of processor time at rest");
    // The ranks are on one machine, with one clock: nobody leaves before the last has come.
    let mut last = [came.as_nanos() as i64];
    communicator.max(&mut last);
    assert!(left.as_nanos() as i64 >= last[0]);
}

/// Time that a processor has worked for this thread, where the system tells.
fn processor_time() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanos = text.split(' ').next().and_then(|nanos| nanos.parse().ok());
    Duration::from_nanos(nanos.unwrap_or_default())
}

/// A transfer lives longer than what it is from, and MPI as long as the transfer.
fn the_last_one_finalises(communicator: Mpi) {
    let plan = Plan::new(&communicator, 70, LONG);
    let mut transfer = communicator.transfer(&plan.outgoing, &plan.incoming);
    drop(communicator);
    plan.start(&mut *transfer, 0);
    transfer.finish();
    plan.check(&*transfer, 0);
    assert!(!mpi::environment::is_finalized());
    drop(transfer);
    assert!(mpi::environment::is_finalized());
    let again = Mpi::init().unwrap_err().to_string();
    assert!(again.contains("before"), "{again}");
}

/// Where a rank panics.
enum Panic {
    /// Its main thread, with the others waiting.
    Main,
    /// Another thread, with the main thread waiting.
    Thread,
    /// Its main thread, and nothing is there that would end the others.
    Unhooked,
    /// The same, with a message under way that never comes.
    Sending,
}

/// The last rank panics while the others wait for it.
fn panics(communicator: &Mpi, which: Panic) {
    let (rank, last) = (communicator.rank(), communicator.size() - 1);
    let of = |other| [Message { rank: other, words: 10 }];
    // Between the root and the last, there and back.
    let mut transfer = match rank {
        0 => communicator.transfer(&of(last), &of(last)),
        _ if rank == last => communicator.transfer(&of(0), &of(0)),
        _ => communicator.transfer(&[], &[]),
    };
    if matches!(which, Panic::Main | Panic::Thread) {
        communicator.end_all_on_panic();
    }
    communicator.sum(&mut [0]);
    match which {
        Panic::Main | Panic::Unhooked if rank == last => {
            panic!("a panic of the last rank");
        }
        Panic::Thread if rank == last => {
            thread::scope(|scope| {
                scope.spawn(|| panic!("a panic of a thread"));
                communicator.sum(&mut [0]);
            });
        }
        Panic::Sending if rank == last => {
            transfer.start();
            panic!("a panic in a transfer");
        }
        _ if rank == 0 => communicator.sum(&mut [0]),
        _ => communicator.receive(last, &mut [0]),
    }
    unreachable!("the last rank sends nothing");
}

/// One rank expects more than another has for it.
fn disagrees(communicator: &Mpi) {
    communicator.end_all_on_panic();
    match communicator.rank() {
        0 => communicator.transfer(&[Message { rank: 1, words: 4 }], &[]),
        1 => communicator.transfer(&[], &[Message { rank: 0, words: 5 }]),
        _ => communicator.transfer(&[], &[]),
    };
    communicator.sum(&mut [0]);
}

/// One rank ends all.
fn aborts(communicator: &Mpi) {
    communicator.sum(&mut [0]);
    if communicator.rank() == 1 {
        communicator.abort(7);
    }
    communicator.sum(&mut [0]);
    unreachable!("a rank is missing");
}
