//! Runs by worker processes: the tile is that of one thread, whatever happens to the workers.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::process::{Command, Stdio};

use perceptile::solver::faults;
use rustix::process::{Pid, Signal};

use crate::child::LONG;
use crate::densities::ring_in_a_file;
use crate::tool::{LEASH, PROGRAM, Random, Room, Run, has_ended, send, until};

/// What the tiles of tests have in common: nobody scores them, and rooms are used many times.
const PLAIN: &str = "optimize --integrands 0 --force --seed 7";

/// A run of all phases, long enough for something to happen to it.
const EVENTFUL: &str = "--tile 37x35x8 --start random --steps 150 --draws 500 --directions 2 \
                        --polish 20 --warp 60 \
                        --kernel 0.9:gaussian(2.1)*fovvideovdp(60)@7x7x8+0.1:column";

/// The same of samples that are more, in more dimensions.
const MANY: &str = "--tile 33x50x5 --spp 3 --dims 3 --start stratified --steps 50 --draws 500 \
                    --polish 4 --warp 20 --kernel gaussian(1.5)*ema(0.4)@5x5x4";

/// A run of many short steps.
const LASTING: &str = "--tile 27x24x8 --start random --steps 400 --draws 500 --polish 200 \
                       --warp 20 --kernel gaussian(1)*ema(0.5)@3x3x4";

/// A run whose descent goes on until it is told to stop.
fn endless_descent() -> String {
    format!("{} {LEASH}", LASTING.replace("--steps 400", "--steps 4000000000"))
}

/// A run whose polish does, after few steps of descent.
fn endless_polish() -> String {
    let line = LASTING.replace("--steps 400", "--steps 50");
    format!("{} {LEASH}", line.replace("--polish 200", "--polish 4000000000"))
}

/// Makes a tile by one thread, and checks that crews of all sizes make its bytes.
fn crews_make_one_tile(case: &str) {
    let room = Room::new();
    let line = format!("{PLAIN} {case}");
    let expected = room.make(&format!("{line} --threads 1"));
    assert_eq!(room.make(&format!("{line} --threads 8")), expected, "{case}, 8 threads");
    for workers in [1, 2, 3, 4, 8] {
        for threads in [1, 2] {
            let crew = format!("--workers {workers} --threads {threads}");
            // Whoever finds the old tile has not written one.
            fs::remove_file(room.at("tile.npy")).unwrap();
            assert_eq!(room.make(&format!("{line} {crew}")), expected, "{case} {crew}");
        }
    }
}

#[test]
fn workers_and_threads_leave_no_trace() {
    for case in [
        // Kernels with signs, over a whole column or frame, and mixtures; more samples and
        // dimensions; sizes that nothing divides.
        "--tile 37x35x8 --kernel 0.9:gaussian(2.1)*fovvideovdp(60)@7x7x8+0.1:column --polish 3",
        "--tile 33x50x5 --spp 3 --dims 3 --kernel gaussian(1.5)*ema(0.4)@5x5x4 --polish 2 \
         --start stratified",
        "--tile 41x19x3 --spp 2 --dims 1 --kernel gaussian(1)*gaussian_t(0.7)@5x5x3 --polish 2 \
         --start random",
        "--tile 70x18x2 --dims 6 --kernel 0.5:gaussian(2)@6x7x1+0.5:box(2) --polish 0",
        "--tile 32x33x2 --kernel 0.8:none+0.2:frame --start stratified --polish 0",
        "--tile 37x35x8 --domain sphere --spp 2 --kernel gaussian(1)*ema(0.5)@3x3x4 --polish 3",
        "--tile 33x36x4 --domain disk --kernel gaussian(1)@5x5x1 --polish 2 --start stratified",
        "--tile 20x21x15 --spp 2 --dims 3 --kernel gaussian(1)*fovvideovdp(60)@3x3x15 --polish 2 \
         --start random",
        // One frame; fewer jobs than workers, down to one.
        "--tile 29x31x1 --kernel gaussian(1)@5x5x1 --polish 4 --start random",
        "--tile 40x1x1 --kernel none --polish 2",
        "--tile 3x2x1 --kernel none --polish 2 --start stratified",
        "--tile 1x1x1 --kernel none --polish 2 --start random",
        "--tile 2x9x5 --spp 2 --kernel column --polish 2",
        // Sequences, whose start is made first.
        "--tile 21x19x8 --spp 3 --preset progressive --polish 2",
        // Phases that are left out.
        "--tile 19x17x4 --kernel gaussian(1)@3x3x1 --polish 0 --warp 0",
        "--tile 19x17x4 --kernel gaussian(1)@3x3x1 --polish 4 --steps 0",
        "--tile 19x17x4 --kernel gaussian(1)@3x3x1 --polish 0 --steps 0 --warp 7",
        "--tile 19x17x4 --kernel gaussian(1)@3x3x1 --polish 0 --steps 0 --warp 0",
        // Ends before the first step, between, at the end of the descent, in the polish.
        "--tile 27x18x4 --kernel gaussian(1)@3x3x1 --polish 3 --stop-after 0",
        "--tile 27x18x4 --kernel gaussian(1)@3x3x1 --polish 3 --stop-after 5",
        "--tile 27x18x4 --kernel gaussian(1)@3x3x1 --polish 3 --stop-after 8",
        "--tile 27x18x4 --kernel gaussian(1)@3x3x1 --polish 3 --stop-after 10",
        "--tile 27x18x4 --kernel gaussian(1)@3x3x1 --polish 3 --stop-after 11",
        "--tile 27x18x4 --kernel gaussian(1)@3x3x1 --polish 3 --stop-after 99",
    ] {
        // What is said last counts, so cases may say something else.
        let (tile, rest) = case.split_once(" --").unwrap();
        let steps = if rest.contains("--steps") { "" } else { "--steps 8" };
        let warp = if rest.contains("--warp") { "" } else { "--warp 9" };
        crews_make_one_tile(&format!("{case} {steps} {warp} --draws 500 --directions 2"));
        assert!(tile.starts_with("--tile"));
    }
    let ring = "--kernel gaussian(1)@5x5x1 --steps 8 --polish 2 --warp 9 --draws 500";
    crews_make_one_tile(&format!("--tile 33x36x4 --domain {} {ring}", ring_in_a_file()));
}

#[test]
fn workers_make_the_tile_of_every_preset() {
    for preset in ["best", "quick", "paper", "paper-taa", "salaun"] {
        crews_make_one_tile(&format!(
            "--preset {preset} --tile 25x22x31 --steps 4 --draws 300 --polish 2 --warp 5"
        ));
    }
}

#[test]
fn a_worker_that_is_slow_changes_nothing() {
    let room = Room::new();
    let expected = room.make(&format!("{PLAIN} {EVENTFUL} --threads 1"));
    let mut random = Random(1);
    for crew in ["--workers 2 --threads 1", "--workers 4 --threads 2"] {
        let mut run = room.start(&format!("{PLAIN} {EVENTFUL} {crew} --silence 60s"));
        run.until_or_end("the end", |run| {
            if let Some(&slow) = random.pick(&run.workers()) {
                send(slow, Signal::STOP);
                random.sleep(20);
                send(slow, Signal::CONT);
            }
            random.sleep(20);
            false
        });
        let ended = run.end().succeeded();
        assert_eq!(ended.error, "", "{crew}");
        assert_eq!(room.read("tile.npy"), expected, "{crew}");
    }
}

/// Workers that were killed and that were silent, as a run tells.
fn losses(told: &str) -> (usize, usize) {
    let count = |words| told.lines().filter(|line| line.contains(words)).count();
    (count("was ended by SIGKILL"), count("gave no sign of life"))
}

/// What happened to workers, as runs tell.
#[derive(Debug, Default)]
struct Losses {
    killed: usize,
    silent: usize,
    /// By place.
    faults: BTreeMap<String, u64>,
}

impl Losses {
    /// Adds those of a run that has ended well, and checks that it tells of each.
    fn add(&mut self, room: &Room, told: &str) {
        let (killed, silent) = losses(told);
        self.killed += killed;
        self.silent += silent;
        let lines = || told.lines().filter(|line| !line.starts_with("stopping: "));
        let count = lines().count();
        assert!(lines().all(|line| line.ends_with("; another takes its place")), "{told}");
        let sidecar = room.sidecar();
        let summary = &sidecar.options["workers"];
        assert_eq!(summary["replaced"], count, "{told}");
        for fault in summary["faults"].as_array().unwrap() {
            let (place, count) = (fault[0].as_str().unwrap(), fault[1].as_u64().unwrap());
            *self.faults.entry(place.to_owned()).or_default() += count;
        }
    }

    fn are_enough(&self) -> bool {
        let often = |site: &str| self.faults.get(site).is_some_and(|&count| count >= 3);
        self.killed >= 100 && self.silent >= 10 && faults::names().all(often)
    }
}

#[test]
fn workers_that_fail_everywhere_leave_no_trace() {
    let room = Room::new();
    let warped = EVENTFUL.replace("--warp 60", "--warp 400");
    let cases = [EVENTFUL, MANY, &warped].map(|case| format!("{PLAIN} {case}"));
    let expected = cases.each_ref().map(|line| room.make(&format!("{line} --threads 1")));
    // Short lives for the places that a worker passes once, long ones for what takes time to
    // come to; holds wherever a step ends.
    let settings = [
        (0, "--workers 3 --threads 1 --faults 20ms,0.25 --checkpoint 2steps"),
        (1, "--workers 2 --threads 2 --faults 5ms,0.1 --checkpoint 1steps"),
        (0, "--workers 4 --threads 1 --faults 1ms,0.05 --checkpoint 10steps"),
        (2, "--workers 8 --threads 2 --faults 50ms,0.1 --checkpoint 1steps"),
        (1, "--workers 8 --threads 1 --faults 1ms,0.05 --checkpoint 10steps"),
        (0, "--workers 1 --threads 1 --faults 10ms,0.1 --checkpoint 1steps"),
    ];
    // Chance comes to each place in 7 of 8 rounds of all settings, busy or not. If it were in one
    // of 2, a place would be met less than 3 times in 44 with a probability of
    // (1 + 44 + 44 * 43 / 2) / 2^44 < 6e-11, and one of the 8 with less than 5e-10.
    let mut losses = Losses::default();
    for _ in 0..44 {
        for (case, setting) in settings {
            let line = format!("{} {setting} --silence 0.3s --replacements 100000", cases[case]);
            let ended = room.run(&line).succeeded();
            losses.add(&room, &ended.error);
            assert_eq!(room.read("tile.npy"), expected[case], "{line}: {}", ended.error);
        }
        if losses.are_enough() {
            return;
        }
    }
    panic!("too few losses: {losses:?}");
}

/// Kills or stops a worker, whom chance picks. One that is stopped is let be until it is missed:
/// killed before, it would not be.
fn harm(run: &mut Run, random: &mut Random) {
    if let Some(&worker) = random.pick(&run.ready_workers()) {
        if random.below(8) == 0 {
            send(worker, Signal::STOP);
            let lost = format!("(process {})", worker.as_raw_nonzero());
            run.until_or_end("a stopped worker is missed", |run| run.error().contains(&lost));
        } else {
            send(worker, Signal::KILL);
        }
    }
    random.sleep(25);
}

#[test]
fn workers_that_others_kill_or_stop_leave_no_trace() {
    const KEPT: &str = "--checkpoint 7steps --silence 0.3s --replacements 100000";
    let mut random = Random(3);
    for case in [EVENTFUL, MANY, LASTING] {
        let room = Room::new();
        let line = format!("{PLAIN} {case}");
        let expected = room.make(&format!("{line} --threads 1"));
        for crew in ["--workers 4 --threads 1", "--workers 3 --threads 2"] {
            let mut run = room.start(&format!("{line} {crew} {KEPT}"));
            // Before that they may not be ready yet: who ends then counts as not to be had.
            run.until_or_end("a checkpoint", |_| room.has_checkpoint("tile.run", 0));
            run.until_or_end("the end", |run| {
                harm(run, &mut random);
                false
            });
            let ended = run.end().succeeded();
            Losses::default().add(&room, &ended.error);
            assert_eq!(room.read("tile.npy"), expected, "{case} {crew}: {}", ended.error);
        }
    }
    // How many are lost in those is not for the test to say; in these it is.
    for (case, after, crew) in [
        (endless_descent(), 7, "--workers 3 --threads 2"),
        (endless_polish(), 57, "--workers 4 --threads 1"),
    ] {
        let room = Room::new();
        let mut run = room.start(&format!("{PLAIN} {case} {crew} {KEPT}"));
        run.until_checkpoint(&room, "tile.run", after);
        run.until("losses of all kinds", |run| {
            harm(run, &mut random);
            let (killed, silent) = losses(&run.error());
            killed >= 10 && silent >= 2
        });
        run.send(Signal::TERM);
        let ended = run.end();
        assert_eq!(ended.code(), Some(143), "{ended:?}");
        Losses::default().add(&room, &ended.error);
        room.tile_so_far();
    }
}

/// Goes on with a run that has no end, and ends it after a later step.
fn go_on_for_a_while(room: &Room, crew: &str) {
    let first = room.checkpoints("tile.run")[0];
    let words = format!("resume tile.run --force {crew} --checkpoint 9steps {LEASH}");
    let mut run = room.start(&words);
    run.until_checkpoint(room, "tile.run", first);
    run.send(Signal::TERM);
    assert_eq!(run.end().code(), Some(143));
    let (_, steps) = room.tile_so_far();
    assert!(steps >= first, "{steps} steps, before {first}");
}

#[test]
fn too_many_losses_end_a_run_and_it_can_go_on() {
    let mut random = Random(4);
    let (descent, polish) = (endless_descent(), endless_polish());
    for (line, after, crew, replacements, signal, cause, resumed) in [
        (&descent, 20, "--workers 3 --threads 1", 2, Signal::KILL, "by SIGKILL", "--threads 2"),
        (&descent, 200, "--workers 1 --threads 2", 0, Signal::KILL, "by SIGKILL", "--workers 4"),
        (&descent, 20, "--workers 2 --threads 1", 1, Signal::STOP, "no sign", "--workers 2"),
        (&polish, 70, "--workers 4 --threads 1", 3, Signal::KILL, "by SIGKILL", "--threads 1"),
        (&polish, 70, "--workers 2 --threads 2", 0, Signal::STOP, "no sign", "--workers 3"),
    ] {
        let room = Room::new();
        let kept = format!("--checkpoint 9steps --replacements {replacements}");
        let mut run = room.start(&format!("{PLAIN} {line} {crew} {kept}"));
        run.until_checkpoint(&room, "tile.run", after);
        run.until_or_end("the end", |run| {
            if let Some(&worker) = random.pick(&run.ready_workers()) {
                send(worker, signal);
            }
            false
        });
        let lost = format!("{} workers were lost", replacements + 1);
        run.end().failed(5, &[&lost, cause, "perceptile resume tile.run"]);
        assert!(!room.at("tile.npy").exists(), "{crew}");
        assert!(room.checkpoints("tile.run")[0] > after, "{crew}");
        go_on_for_a_while(&room, resumed);
    }
}

#[test]
fn what_is_left_without_workers_when_all_steps_are_done_is_done_at_once() {
    let room = Room::new();
    // Few steps, and much to do after them.
    let line = LASTING.replace("--steps 400", "--steps 2").replace("--polish 200", "--polish 0");
    let line = format!("{PLAIN} {}", line.replace("--warp 20", "--warp 12000"));
    let expected = room.make(&format!("{line} --threads 1"));
    let mut run = room.start(&format!("{line} --workers 2 --threads 1 --replacements 0"));
    // Of work, not of time: a hundred times that of the steps.
    run.until("a fifth of a second of work", |run| {
        let workers = run.workers();
        workers.len() == 2 && workers.iter().all(|&worker| worked(worker) >= 20)
    });
    send(run.workers()[0], Signal::KILL);
    run.until("no workers", |run| run.workers().is_empty());
    run.end().succeeded();
    assert_eq!(room.read("tile.npy"), expected);
}

/// Hundredths of a second for which a process has had a processor.
fn worked(process: Pid) -> u64 {
    let stat = fs::read_to_string(format!("/proc/{}/stat", process.as_raw_nonzero()));
    let stat = stat.unwrap_or_default();
    let words = stat.split(')').next_back().unwrap_or_default().split_whitespace();
    words.skip(11).take(2).filter_map(|ticks| ticks.parse::<u64>().ok()).sum()
}

/// The memory of a process, of what it shares only its part.
fn own_bytes(process: Pid) -> Option<u64> {
    let path = format!("/proc/{}/smaps_rollup", process.as_raw_nonzero());
    let text = fs::read_to_string(path).ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("Pss:"))?;
    Some(1024 * line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?)
}

#[test]
fn workers_share_their_memory() {
    const WORKERS: u64 = 4;
    const EACH: u64 = 16 << 20;
    let room = Room::new();
    // A polish that goes on until it is told to stop, since it needs most.
    let line = format!(
        "{PLAIN} --tile 256x256x8 --spp 2 --start random --steps 2 --polish 4000000000 --warp 5 \
         --kernel gaussian(1)*ema(0.5)@3x3x4 --workers {WORKERS} --threads 1 --checkpoint 1steps"
    );
    let planned = room.run(&format!("{line} --dry-run")).succeeded().out;
    let shared = planned.lines().find_map(|line| line.trim().strip_prefix("shared")).unwrap();
    let shared: u64 = shared.trim().strip_suffix(" MB").unwrap().parse().unwrap();
    // What they share is told in whole MB; the coordinator keeps the samples that it starts from.
    let samples = 256 * 256 * 8 * 2 * 2 * 4;
    let base = ((shared + 1) << 20) + samples;
    let mut run = room.start(&format!("{line} {LEASH}"));
    let mut most = 0;
    let mut look = |run: &mut Run| {
        let workers = run.workers();
        let all = workers.iter().copied().chain([run.pid()]).filter_map(own_bytes).sum::<u64>();
        most = most.max(all);
        assert!(workers.len() as u64 <= WORKERS);
    };
    run.until("some steps of the polish", |run| {
        look(run);
        room.has_checkpoint("tile.run", 5)
    });
    (0..5).for_each(|_| look(&mut run));
    run.send(Signal::TERM);
    run.until_or_end("the end", |run| {
        look(run);
        false
    });
    assert_eq!(run.end().code(), Some(143));
    assert!(most > base / 2, "{most} bytes");
    assert!(most <= base + WORKERS * EACH, "{most} bytes of {base} + {WORKERS} x {EACH}");
}

/// A worker without a coordinator, with something else as its standard input.
fn worker(room: &Room, input: impl Into<Stdio>) -> Run {
    let mut command = Command::new(PROGRAM);
    command.arg("worker").stdin(input);
    room.start_as(command)
}

/// A worker and the other end of its socket.
fn worker_with_socket(room: &Room) -> (Run, UnixStream) {
    let (own, other) = UnixStream::pair().unwrap();
    (worker(room, OwnedFd::from(other)), own)
}

#[test]
fn a_worker_without_a_coordinator_says_so() {
    let room = Room::new();
    // The one that takes longest: it waits for a greeting.
    let (silent, _open) = worker_with_socket(&room);

    const BY_HAND: &str = "started by a coordinator, not by hand";
    worker(&room, Stdio::null()).end().failed(1, &[BY_HAND]);
    fs::write(room.at("file"), "perceptile 1.0").unwrap();
    worker(&room, File::open(room.at("file")).unwrap()).end().failed(1, &[BY_HAND]);
    let (pipe, mut other) = std::io::pipe().unwrap();
    other.write_all(b"perceptile 1.0").unwrap();
    worker(&room, pipe).end().failed(1, &[BY_HAND]);
    let (datagrams, _other) = UnixDatagram::pair().unwrap();
    worker(&room, OwnedFd::from(datagrams)).end().failed(1, &[BY_HAND]);
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let stream = std::net::TcpStream::connect(listener.local_addr().unwrap()).unwrap();
    worker(&room, OwnedFd::from(stream)).end().failed(1, &[BY_HAND]);

    let (closed, end) = worker_with_socket(&room);
    drop(end);
    closed.end().failed(1, &["the other end has gone"]);
    let (stranger, mut end) = worker_with_socket(&room);
    end.write_all(b"GET / HTTP/1.1\r\n\r\n").unwrap();
    stranger.end().failed(1, &["GET / HTTP"]);

    let mut random = Random(5);
    for attempt in 0..24 {
        let (confused, mut end) = worker_with_socket(&room);
        // Its own greeting is that of a coordinator, too.
        let mut bytes = [0; 512];
        end.set_read_timeout(Some(LONG)).unwrap();
        let length = end.read(&mut bytes).unwrap();
        let mut bytes = bytes[..length].to_vec();
        match attempt % 3 {
            // Nonsense, first with a length that lies and then with one that does not.
            0 => bytes.extend((0..1 + random.below(300)).map(|_| random.below(256) as u8)),
            1 => {
                let length = 1 + random.below(60) as u32;
                bytes.extend(length.to_le_bytes());
                bytes.extend((0..length).map(|_| random.below(256) as u8));
            }
            // A greeting that is not quite one.
            _ => bytes[random.below(length)] ^= 1 << random.below(8),
        }
        // It may end before it has read all.
        let _ = end.write_all(&bytes);
        drop(end);
        confused.end().failed(1, &[]);
    }
    silent.end().failed(1, &["the other end did not answer within"]);
}

/// CPUs that this process may run on. It may have less time than that many give.
fn cpus() -> u32 {
    let status = fs::read_to_string("/proc/thread-self/status").unwrap();
    let mask = status.lines().find_map(|line| line.strip_prefix("Cpus_allowed:")).unwrap();
    mask.chars().filter_map(|digit| digit.to_digit(16)).map(u32::count_ones).sum()
}

#[test]
fn workers_that_cannot_be_had_are_told_of() {
    let room = Room::new();
    let line = format!("{PLAIN} {}", endless_descent());
    let cpus = cpus();
    let (workers, needed) = (cpus + 1, format!("{} workers", cpus + 1));
    room.run(&format!("{line} --pin --workers {workers} --threads 1"))
        .failed(2, &[&needed, &format!("{cpus} CPU")]);
    room.run(&format!("{line} --workers 5000")).failed(2, &["5000 workers", "1024"]);
    room.run(&format!("{line} --workers 1024 --threads 1024"))
        .failed(2, &["1048576 threads", "16384"]);
    room.run(&format!("{line} --pin")).failed(2, &["--workers"]);
    // Limits of the system: sockets for the workers, and the size of what they share.
    let crew = format!("{line} --workers 8 --threads 1");
    room.start_after("ulimit -n 10", &crew).end().failed(1, &["Too many open files"]);
    room.start_after("ulimit -f 100", &crew).end().failed(1, &["shared memory", "too large"]);
    assert!(room.names(".").is_empty(), "{:?}", room.names("."));
}

#[test]
fn workers_can_be_bound_to_processors() {
    let room = Room::new();
    let line = format!("{PLAIN} {MANY}");
    let expected = room.make(&format!("{line} --threads 1"));
    let ended = room.run(&format!("{line} --pin --workers 1 --threads 1")).succeeded();
    assert!(ended.error.starts_with("worker 0 runs on node "), "{}", ended.error);
    assert_eq!(room.read("tile.npy"), expected);
}

#[test]
fn signals_end_a_run_of_workers_which_can_go_on() {
    let (descent, polish) = (endless_descent(), endless_polish());
    for (line, after, signal, group, code) in [
        (&descent, 20, Signal::INT, true, 130),
        (&descent, 250, Signal::TERM, false, 143),
        (&polish, 70, Signal::INT, true, 130),
        (&polish, 70, Signal::TERM, true, 143),
    ] {
        let room = Room::new();
        let mut run = room.start(&format!("{PLAIN} {line} --workers 3 --checkpoint 10steps"));
        run.until_checkpoint(&room, "tile.run", after);
        // Ctrl-C goes to all processes of the group; a manager of jobs may know only one of them.
        if group {
            run.send_to_group(signal)
        } else {
            run.send(signal)
        }
        let ended = run.end();
        assert_eq!(ended.code(), Some(code), "{ended:?}");
        assert!(ended.error.starts_with("stopping: "), "{ended:?}");
        assert_eq!(ended.error.lines().count(), 1, "{ended:?}");
        for words in ["interrupted: this is the tile so far", "perceptile resume tile.run"] {
            assert!(ended.out.contains(words), "{}", ended.out);
        }
        let (_, steps) = room.tile_so_far();
        assert!(steps > after && room.checkpoints("tile.run")[0] == steps + 1, "{steps} steps");
        go_on_for_a_while(&room, "--workers 2");
    }
}

#[test]
fn workers_end_with_their_coordinator() {
    for stopped in [false, true] {
        let room = Room::new();
        let kept = "--workers 3 --checkpoint 5steps";
        let mut run = room.start(&format!("{PLAIN} {} {kept}", endless_descent()));
        run.until_checkpoint(&room, "tile.run", 5);
        let workers = run.workers();
        assert_eq!(workers.len(), 3);
        if stopped {
            // It cannot even see that its coordinator has gone.
            send(workers[1], Signal::STOP);
        }
        // What they share has no name, so that it goes when they go.
        let path = format!("/proc/{}/maps", workers[0].as_raw_nonzero());
        let maps = fs::read_to_string(path).unwrap();
        let mut shared = maps.lines().filter(|line| line.contains(" rw-s ")).peekable();
        assert!(shared.peek().is_some(), "{maps}");
        assert!(shared.all(|line| line.ends_with(" (deleted)")), "{maps}");
        run.send(Signal::KILL);
        let ended = run.end();
        assert_eq!(ended.code(), None);
        until("all workers have ended", || workers.iter().all(|&worker| has_ended(worker)));
        // Nobody holds the locks of the outputs any more: the next run takes them over.
        let locks = [".tile.json.lock", ".tile.npy.lock", ".tile.png.lock"];
        assert_eq!(room.names("."), [&locks[..], &["tile.run"]].concat());
    }
}
