//! Runs by worker processes: the tile is that of one thread, whatever happens to the workers.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::net::{UnixDatagram, UnixStream};
use std::process::{Command, Stdio};
use std::time::Duration;

use perceptile_cluster::faults::Place;
use rustix::process::{Pid, Signal};

use crate::tool::{PROGRAM, Random, Room, Run, has_ended, send, until};

/// What the tiles of tests have in common: nobody scores them, and rooms are used many times.
const PLAIN: &str = "optimize --integrands 0 --force --seed 7";

/// A run of all phases, long enough for something to happen to it.
const EVENTFUL: &str = "--tile 37x35x8 --start random --steps 150 --draws 500 --directions 2 \
                        --polish 20 --warp 60 \
                        --kernel 0.9:gaussian(2.1)*fovvideovdp(60)@7x7x8+0.1:column";

/// The same of samples that are more, in more dimensions.
const MANY: &str = "--tile 33x50x5 --spp 3 --dims 3 --start stratified --steps 50 --draws 500 \
                    --polish 4 --warp 20 --kernel gaussian(1.5)*ema(0.4)@5x5x4";

/// A run with time to be stopped in its descent or in its polish.
const LASTING: &str = "--tile 27x24x8 --start random --steps 400 --draws 500 --polish 200 \
                       --warp 20 --kernel gaussian(1)*ema(0.5)@3x3x4";

/// A run that goes on until it is told to stop, with a leash should nobody tell it.
const ENDLESS: &str = "--tile 27x24x8 --steps 4000000000 --draws 500 --polish 0 --warp 5 \
                       --kernel gaussian(1)*ema(0.5)@3x3x4 --time 3m";

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
        "--tile 20x21x15 --spp 2 --dims 3 --kernel gaussian(1)*fovvideovdp(60)@3x3x15 --polish 2 \
         --start random",
        // One frame; fewer jobs than workers, down to one.
        "--tile 29x31x1 --kernel gaussian(1)@5x5x1 --polish 4 --start random",
        "--tile 40x1x1 --kernel none --polish 2",
        "--tile 3x2x1 --kernel none --polish 2 --start stratified",
        "--tile 1x1x1 --kernel none --polish 2 --start random",
        "--tile 2x9x5 --spp 2 --kernel column --polish 2",
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
        let (tile, rest) = case.split_once(" --kernel").unwrap();
        let steps = if rest.contains("--steps") { "" } else { "--steps 8" };
        let warp = if rest.contains("--warp") { "" } else { "--warp 9" };
        crews_make_one_tile(&format!("{case} {steps} {warp} --draws 500 --directions 2"));
        assert!(tile.starts_with("--tile"));
    }
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
        while !run.is_over() {
            let workers = run.workers();
            if let Some(&slow) = random.pick(&workers) {
                send(slow, Signal::STOP);
                random.sleep(20);
                send(slow, Signal::CONT);
            }
            random.sleep(20);
        }
        let ended = run.end().succeeded();
        assert_eq!(ended.error, "", "{crew}");
        assert_eq!(room.read("tile.npy"), expected, "{crew}");
    }
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
        let mut count = 0;
        for line in told.lines() {
            assert!(line.ends_with("; another takes its place"), "{told}");
            self.killed += usize::from(line.contains("was ended by SIGKILL"));
            self.silent += usize::from(line.contains("gave no sign of life"));
            count += 1;
        }
        let sidecar = room.sidecar();
        let summary = &sidecar.options["workers"];
        assert_eq!(summary["replaced"], count, "{told}");
        for fault in summary["faults"].as_array().unwrap() {
            let (place, count) = (fault[0].as_str().unwrap(), fault[1].as_u64().unwrap());
            *self.faults.entry(place.to_owned()).or_default() += count;
        }
    }

    fn all(&self) -> usize {
        self.killed + self.silent
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
        (1, "--workers 4 --threads 1 --faults 1ms,0.05 --checkpoint 10steps"),
        (0, "--workers 1 --threads 1 --faults 10ms,0.1 --checkpoint 1steps"),
    ];
    let mut losses = Losses::default();
    let enough = |losses: &Losses| {
        let often = |place: Place| losses.faults.get(place.name()).is_some_and(|&count| count >= 3);
        losses.all() >= 150 && losses.silent >= 10 && Place::ALL.into_iter().all(often)
    };
    // On a busy machine chance takes long to come to every place.
    for attempt in 0..200 {
        if enough(&losses) && attempt >= settings.len() {
            return;
        }
        let (case, setting) = settings[attempt % settings.len()];
        let line = format!("{} {setting} --silence 0.3s --replacements 100000", cases[case]);
        let ended = room.run(&line).succeeded();
        losses.add(&room, &ended.error);
        assert_eq!(room.read("tile.npy"), expected[case], "{line}: {}", ended.error);
    }
    panic!("too few losses: {losses:?}");
}

#[test]
fn workers_that_others_kill_or_stop_leave_no_trace() {
    let room = Room::new();
    let mut random = Random(3);
    let mut losses = Losses::default();
    // Whom chance picks, and whether it is missed before the run ends, is not for the test to say.
    for (done, case) in [EVENTFUL, MANY, LASTING].into_iter().cycle().take(30).enumerate() {
        if done >= 3 && losses.killed >= 10 && losses.silent > 0 {
            break;
        }
        let line = format!("{PLAIN} {case}");
        let expected = room.make(&format!("{line} --threads 1"));
        for crew in ["--workers 4 --threads 1", "--workers 3 --threads 2"] {
            let kept = "--checkpoint 7steps --silence 0.3s --replacements 100000";
            let mut run = room.start(&format!("{line} {crew} {kept}"));
            // Before that they may not be ready yet: who ends then counts as not to be had.
            run.until_checkpoint(&room, "tile.run", 0);
            while !run.is_over() {
                if let Some(&worker) = random.pick(&run.ready_workers()) {
                    let stop = random.below(8) == 0;
                    send(worker, if stop { Signal::STOP } else { Signal::KILL });
                    if stop {
                        // Until it is missed; killed before, it would not be.
                        std::thread::sleep(Duration::from_millis(500));
                    }
                }
                random.sleep(25);
            }
            let ended = run.end().succeeded();
            losses.add(&room, &ended.error);
            assert_eq!(room.read("tile.npy"), expected, "{case} {crew}: {}", ended.error);
        }
    }
    assert!(losses.killed >= 10 && losses.silent > 0, "{losses:?}");
}

#[test]
fn too_many_losses_end_a_run_and_it_can_go_on() {
    let room = Room::new();
    let mut random = Random(4);
    let line = format!("{PLAIN} {LASTING}");
    let expected = room.make(&format!("{line} --threads 1"));
    for (after, crew, replacements, signal, cause, resumed) in [
        (20, "--workers 3 --threads 1", 2, Signal::KILL, "was ended by SIGKILL", "--threads 2"),
        (200, "--workers 1 --threads 2", 0, Signal::KILL, "was ended by SIGKILL", "--workers 4"),
        (20, "--workers 2 --threads 1", 1, Signal::STOP, "no sign of life", "--workers 2"),
        (420, "--workers 4 --threads 1", 3, Signal::KILL, "was ended by SIGKILL", "--threads 1"),
        (420, "--workers 2 --threads 2", 0, Signal::STOP, "no sign of life", "--workers 3"),
    ] {
        fs::remove_file(room.at("tile.npy")).unwrap();
        let kept = "--checkpoint 9steps --silence 0.3s";
        let mut run = room.start(&format!("{line} {crew} {kept} --replacements {replacements}"));
        run.until_checkpoint(&room, "tile.run", after);
        while !run.is_over() {
            if let Some(&worker) = random.pick(&run.ready_workers()) {
                send(worker, signal);
            }
            random.sleep(10);
        }
        let lost = format!("{} workers were lost", replacements + 1);
        run.end().failed(5, &[&lost, cause, "perceptile resume tile.run"]);
        assert!(!room.at("tile.npy").exists(), "{crew}");
        assert!(room.checkpoints("tile.run")[0] > after, "{crew}");
        assert_eq!(room.make(&format!("resume tile.run --force {resumed}")), expected, "{crew}");
        assert!(!room.at("tile.run").exists(), "{crew}");
    }
}

#[test]
fn what_is_left_without_workers_when_all_steps_are_done_is_done_at_once() {
    let room = Room::new();
    let line = LASTING.replace("--warp 20", "--warp 30000").replace("--polish 200", "--polish 0");
    let line = format!("{PLAIN} {line}");
    let expected = room.make(&format!("{line} --threads 1"));
    let mut run = room.start(&format!("{line} --workers 2 --replacements 0 --checkpoint 20steps"));
    run.until_checkpoint(&room, "tile.run", 300);
    // The steps that may be left take less than the pause, or else this would be a run given up.
    std::thread::sleep(Duration::from_millis(300));
    let workers = run.workers();
    send(workers[0], Signal::KILL);
    run.until("without workers", |run| run.workers().is_empty());
    run.end().succeeded();
    assert_eq!(room.read("tile.npy"), expected);
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
    let line = format!(
        "{PLAIN} --tile 256x256x8 --spp 2 --start random --steps 12 --polish 2 --warp 5 \
         --kernel gaussian(1)*ema(0.5)@3x3x4 --workers {WORKERS} --threads 1"
    );
    let planned = room.run(&format!("{line} --dry-run")).succeeded().out;
    let shared = planned.lines().find_map(|line| line.trim().strip_prefix("shared")).unwrap();
    let shared: u64 = shared.trim().strip_suffix(" MB").unwrap().parse().unwrap();
    // What they share is told in whole MB; the coordinator keeps the samples that it starts from.
    let samples = 256 * 256 * 8 * 2 * 2 * 4;
    let base = ((shared + 1) << 20) + samples;
    let mut run = room.start(&line);
    let (mut most, mut looks) = (0, 0);
    while !run.is_over() {
        let workers = run.workers();
        let all = workers.iter().copied().chain([run.pid()]).filter_map(own_bytes).sum::<u64>();
        most = most.max(all);
        looks += usize::from(workers.len() as u64 == WORKERS);
    }
    run.end().succeeded();
    assert!(looks >= 5 && most > base / 2, "{most} bytes in {looks} looks");
    assert!(most <= base + WORKERS * EACH, "{most} bytes of {base} + {WORKERS} x {EACH}");
}

/// A worker without a coordinator, with something else as its standard input.
fn worker(room: &Room, input: impl Into<Stdio>) -> Run {
    let mut command = Command::new(PROGRAM);
    command.arg("worker").stdin(input);
    room.start_as(command, "worker")
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

#[test]
fn workers_that_cannot_be_had_are_told_of() {
    let room = Room::new();
    let line = format!("{PLAIN} {ENDLESS}");
    let cpus = std::thread::available_parallelism().unwrap().get();
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
    room.start_after("ulimit -f 100", &crew).end().failed(4, &["shared memory", "too large"]);
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
    let room = Room::new();
    let line = format!("{PLAIN} {LASTING}");
    let expected = room.make(&format!("{line} --threads 1"));
    for (after, signal, group, code) in [
        (20, Signal::INT, true, 130),
        (250, Signal::TERM, false, 143),
        (420, Signal::INT, true, 130),
        (420, Signal::TERM, true, 143),
    ] {
        let mut run = room.start(&format!("{line} --workers 3 --checkpoint 10steps"));
        run.until_checkpoint(&room, "tile.run", after);
        // Ctrl-C goes to all processes of the group; a manager of jobs may know only one of them.
        if group {
            run.send_to_group(signal)
        } else {
            run.send(signal)
        }
        let ended = run.end();
        assert_eq!((ended.code(), &*ended.error), (Some(code), ""));
        for words in ["interrupted: this is the tile so far", "perceptile resume tile.run"] {
            assert!(ended.out.contains(words), "{}", ended.out);
        }
        let so_far = room.read("tile.npy");
        assert_ne!(so_far, expected);
        let command = room.sidecar().command;
        let (_, steps) = command.split_once("--stop-after ").unwrap();
        let steps: u32 = steps.split(' ').next().unwrap().parse().unwrap();
        assert!(steps > after && room.checkpoints("tile.run")[0] == steps + 1, "{command}");
        let words = command.strip_prefix("perceptile ").unwrap();
        let mut again = Command::new("sh");
        let script = format!("\"$0\" {words} --integrands 0 --threads 1 --out again.npy --force");
        again.args(["-c", &script, PROGRAM]).stdin(Stdio::null());
        room.start_as(again, &script).end().succeeded();
        assert_eq!(room.read("again.npy"), so_far, "{command}");

        assert_eq!(room.make("resume tile.run --force --workers 2"), expected, "{command}");
    }
}

#[test]
fn workers_end_with_their_coordinator() {
    for stopped in [false, true] {
        let room = Room::new();
        let kept = "--workers 3 --checkpoint 5steps";
        let mut run = room.start(&format!("{PLAIN} {ENDLESS} {kept}"));
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
        assert_eq!(room.names("."), ["tile.run"]);
    }
}
