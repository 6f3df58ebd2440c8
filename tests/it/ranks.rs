//! Runs by the ranks of a cluster: the tile is that of one process, however many there are and
//! whatever happens to them. Needs `mpirun`; ranks share the cores of this machine.

use std::process::{Command, Stdio};

use perceptile::kernel::KernelSpec;
use perceptile::run::plan::Plan;
use perceptile::solver::{HaloTraffic, Options, Parallelism, Preset};
use perceptile::tile::TileShape;
use rustix::process::Signal;

use crate::densities::ring_in_a_file;
use crate::tool::{Ended, LEASH, PROGRAM, Room, Run, send};

/// What the tiles of tests have in common.
const PLAIN: &str = "optimize --integrands 0 --force --seed 7";

/// A run that goes on until it is told to stop, after so many steps of its descent in its polish.
fn endless(steps: u64) -> String {
    format!(
        "{PLAIN} --tile 37x66x8 --start random --steps {steps} --draws 500 --polish 4000000000 \
         --warp 20 --kernel gaussian(1)*ema(0.5)@3x3x4 {LEASH}"
    )
}

/// A number of steps that nothing comes to the end of.
const MANY: u64 = 4_000_000_000;

/// Starts this program on so many ranks.
fn start(room: &Room, ranks: usize, line: &str) -> Run {
    let mut command = Command::new("mpirun");
    command.args(["--allow-run-as-root", "--oversubscribe", "--bind-to", "none"]);
    command.args(["--mca", "mpi_yield_when_idle", "1", "-n", &ranks.to_string(), PROGRAM]);
    command.args(line.split_whitespace()).stdin(Stdio::null());
    room.start_as(command)
}

fn run(room: &Room, ranks: usize, line: &str) -> Ended {
    start(room, ranks, line).end()
}

/// Makes a tile by one process, and checks that all numbers of ranks make its bytes.
fn ranks_make_one_tile(case: &str) {
    let room = Room::new();
    let line = format!("{PLAIN} {case}");
    let expected = room.make(&format!("{line} --threads 2"));
    for ranks in [1, 2, 3, 4, 7] {
        for threads in [1, 2] {
            std::fs::remove_file(room.at("tile.npy")).unwrap();
            run(&room, ranks, &format!("{line} --threads {threads}")).succeeded();
            assert!(room.read("tile.npy") == expected, "{case}: {ranks} ranks, {threads} threads");
        }
    }
}

#[test]
fn ranks_leave_no_trace() {
    for case in [
        // Kernels with signs, over columns, and mixtures; more samples and dimensions; sizes that
        // nothing divides; kernels wider than regions.
        "--tile 64x64x8 --kernel 0.9:gaussian(2.1)*fovvideovdp(60)@7x7x8+0.1:column --polish 3",
        "--tile 61x50x5 --spp 3 --dims 3 --kernel gaussian(1.5)*ema(0.4)@5x5x4 --polish 2 \
         --start stratified",
        "--tile 131x70x3 --spp 2 --dims 1 --kernel gaussian(1)*gaussian_t(0.7)@17x5x3 --polish 2",
        "--tile 96x48x4 --kernel gaussian(2)@9x9x1 --polish 0 --stop-after 10",
        "--tile 64x50x5 --domain hemisphere --kernel gaussian(1.5)*ema(0.4)@5x5x4 --polish 2",
    ] {
        ranks_make_one_tile(&format!("{case} --steps 40 --draws 300 --warp 10 --directions 2"));
    }
    let ring = "--kernel gaussian(1)@5x5x1 --polish 2 --steps 40 --draws 300 --warp 10";
    ranks_make_one_tile(&format!("--tile 64x50x4 --domain {} {ring}", ring_in_a_file()));
}

#[test]
fn halos_are_what_the_formula_says() {
    const STEPS: u32 = 5;
    let shape = TileShape::new(128, 128, 30, 1, 2).unwrap();
    let text = "gaussian(2.1) * fovvideovdp(60) @ 7x7x8";
    let kernel: KernelSpec = text.parse().unwrap();
    let options = Options { shape, kernel, ..Preset::Paper.options() };
    let room = Room::new();
    for ranks in [2, 4, 8] {
        let parallelism = Parallelism { ranks, ..Parallelism::threads() };
        let plan = Plan::new(&options, parallelism).unwrap();
        let reach = plan.partition().reach();
        // By hand for two ranks: 3 lines above and below of 64 and more, and the copies at the sides.
        if ranks == 2 {
            let lines = 2 * 3 * (128 + 2 * 3) * 30 * 2 * 4;
            let bytes = HaloTraffic::of(&plan.regions(0), reach).bytes;
            assert_eq!(bytes, 2 * lines);
        }
        let words: String = text.split(' ').collect();
        let line = format!(
            "{PLAIN} --preset paper --kernel {words} --steps {STEPS} --polish 0 --warp 0 --threads 1"
        );
        run(&room, ranks, &line).succeeded();
        let told = room.sidecar().options;
        let all = told["ranks"]["ranks"].as_array().unwrap();
        assert_eq!(all.len(), ranks);
        let all_reduce = 2 * (ranks as u64 - 1) * 4 * shape.coordinates() as u64 / ranks as u64;
        let mut sent = 0;
        let mut received = 0;
        for (rank, told) in all.iter().enumerate() {
            let traffic = HaloTraffic::of(&plan.regions(rank), reach).bytes;
            assert!(5 * traffic < all_reduce, "{ranks} ranks: {traffic} of {all_reduce}");
            sent += u64::from(STEPS) * traffic;
            received += told["traffic"].as_u64().unwrap();
        }
        assert_eq!(sent, received, "{ranks} ranks");
    }
}

/// Ends a job without an end by a signal to its ranks, once it has a checkpoint after so many
/// steps, and checks its tile so far. Returns the steps that it has done.
fn stop(room: &Room, mut job: Run, after: u32) -> u32 {
    job.until_checkpoint(room, "tile.run", after);
    job.workers().into_iter().for_each(|rank| send(rank, Signal::TERM));
    let ended = job.end();
    assert_eq!(ended.code(), Some(143), "{ended:?}");
    assert!(ended.out.contains("interrupted: this is the tile so far"), "{ended:?}");
    room.tile_so_far().1
}

#[test]
fn a_killed_rank_ends_the_job_and_others_go_on() {
    for (ranks, steps, after, next) in [(3, MANY, 200, 2), (2, 50, 200, 4)] {
        let room = Room::new();
        let line = endless(steps);
        let mut job = start(&room, ranks, &format!("{line} --threads 1 --checkpoint 100steps"));
        job.until_checkpoint(&room, "tile.run", after);
        send(*job.workers().last().unwrap(), Signal::KILL);
        let ended = job.end();
        assert!(!ended.status.success(), "{ended:?}");
        assert!(!room.at("tile.npy").exists());
        let last = room.checkpoints("tile.run")[0];
        let resume = format!("resume tile.run --force --threads 1 --checkpoint 9steps {LEASH}");
        let steps = stop(&room, start(&room, next, &resume), last);
        assert!(steps >= last, "{steps} steps, before {last}");
    }
}

#[test]
fn stopped_ranks_leave_a_tile_and_a_checkpoint_that_anyone_goes_on_from() {
    let resume = format!("resume tile.run --force --threads 1 --checkpoint 9steps {LEASH}");
    for steps in [MANY, 50] {
        let room = Room::new();
        let line = format!("{} --threads 1 --checkpoint 9steps", endless(steps));
        let done = stop(&room, start(&room, 3, &line), 60);
        let alone = start(&room, 1, &format!("{resume} --workers 2"));
        let done = stop(&room, alone, done + 1);
        // And the other way round.
        stop(&room, start(&room, 4, &resume), done + 1);
        let ours = |name: &String| ["tile.", "again."].iter().any(|stem| name.starts_with(stem));
        assert!(room.names("").iter().all(ours), "{:?}", room.names(""));
    }
}

#[test]
fn ranks_stop_when_their_time_is_up() {
    let room = Room::new();
    let line = endless(MANY).replace(LEASH, "--time 0.3s");
    let stopped = run(&room, 3, &format!("{line} --threads 1")).succeeded();
    assert!(stopped.out.contains("time is up"), "{stopped:?}");
    room.tile_so_far();
}

#[test]
fn a_tile_to_start_from_is_shared_out() {
    let room = Room::new();
    let make =
        "--tile 64x40x4 --kernel gaussian(1)@3x3x2 --steps 20 --draws 200 --polish 0 --warp 3";
    room.make(&format!("{PLAIN} {make}"));
    std::fs::rename(room.at("tile.npy"), room.at("start.npy")).unwrap();
    let line = format!("{PLAIN} {make} --start start.npy");
    let expected = room.make(&format!("{line} --threads 2"));
    std::fs::remove_file(room.at("tile.npy")).unwrap();
    run(&room, 3, &line).succeeded();
    assert!(room.read("tile.npy") == expected);
}

#[test]
fn what_is_wrong_is_said_once_by_the_first_rank() {
    let room = Room::new();
    let once = |ended: &Ended, words: &str| {
        assert_eq!(ended.error.matches("error:").count(), 1, "{ended:?}");
        assert!(ended.error.contains(words), "{ended:?}");
    };
    let small = "--tile 32x32x2 --kernel gaussian(1)@3x3x1 --steps 5 --polish 0 --warp 0";
    for (line, code, words) in [
        (format!("{PLAIN} --tile 64x64x0"), 2, "frames"),
        (format!("{PLAIN} {small}"), 2, "5 ranks are too many"),
        (format!("{PLAIN} --no-such-flag"), 2, "--no-such-flag"),
        (format!("{PLAIN} --workers 2"), 2, "--workers"),
        ("resume nowhere.run".into(), 1, "nowhere.run"),
        (format!("{PLAIN} --out no/such/folder.npy"), 1, "no/such"),
        (
            "evaluate tile.npy --kernel gaussian(1)@3x3x1".into(),
            2,
            "only `optimize`, `resume` and `select`",
        ),
    ] {
        let ended = run(&room, 5, &line);
        assert_eq!(ended.code(), Some(code), "{ended:?}");
        once(&ended, words);
    }
    room.make(&format!("{PLAIN} {small}"));
    let ended = run(&room, 2, &format!("optimize {small}"));
    assert_eq!(ended.code(), Some(3), "{ended:?}");
    once(&ended, "--force");
}

#[test]
fn ranks_choose_what_one_process_chooses() {
    let room = Room::new();
    let [frames, height, width] = [50, 61, 20];
    for (name, factor) in [("reference", 0_u32), ("a", 7), ("b", 11), ("c", 13)] {
        let value = |i: u32| 0.3 + 0.02 * (i * factor * factor % 31) as f32;
        let mut bytes = Vec::new();
        perceptile::array::write_header(&[frames, height, width], &mut bytes).unwrap();
        let values = (0..(frames * height * width) as u32).map(value);
        bytes.extend(values.flat_map(f32::to_le_bytes));
        std::fs::write(room.at(&format!("{name}.npy")), bytes).unwrap();
    }
    let line = "select --reference reference.npy --candidates a.npy b.npy c.npy --subsets --sweeps 5 \
                --kernel gaussian(1)*fovvideovdp(60)@3x3x3 --taa 0.5 --threads 1";
    run(&room, 1, &format!("{line} --out one.npy")).succeeded();
    for ranks in 2..=4 {
        run(&room, ranks, &format!("{line} --out more.npy --force")).succeeded();
        assert!(room.read("more.npy") == room.read("one.npy"), "{ranks} ranks");
        let scores = |name| {
            let report: serde_json::Value = serde_json::from_slice(&room.read(name)).unwrap();
            ["scores", "chosen", "sweeps"].map(|field| report[field].clone())
        };
        assert_eq!(scores("more.json"), scores("one.json"));
    }
    // What keeps the root from going on ends all: a frame that is none, after a state is kept.
    let broken = room.at("b.npy");
    let whole = std::fs::read(&broken).unwrap();
    let modified = std::fs::metadata(&broken).unwrap().modified().unwrap();
    let put = |bytes: &[u8]| {
        std::fs::write(&broken, bytes).unwrap();
        std::fs::File::options()
            .append(true)
            .open(&broken)
            .unwrap()
            .set_modified(modified)
            .unwrap();
    };
    let mut bytes = whole.clone();
    let last = bytes.len() - 4;
    bytes[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    put(&bytes);
    let failed = run(&room, 3, &format!("{line} --out more.npy --force"));
    assert!(failed.error.contains("b.npy has the value NaN at pixel (19, 60)"), "{failed:?}");
    assert_eq!((failed.code(), failed.error.matches("error:").count()), (Some(1), 1));
    put(&whole);
    std::fs::remove_file(room.at("more.npy")).unwrap();
    let done = run(&room, 2, &format!("{line} --out more.npy --progress lines")).succeeded();
    assert!(done.error.contains("going on behind frame"), "{done:?}");
    assert!(room.read("more.npy") == room.read("one.npy"));
    // Too many, and ranks with workers.
    for (more, words) in [("", "9 ranks are too many"), ("--workers 2", "--workers")] {
        let ended = run(&room, 9, &format!("{line} --out other.npy {more}"));
        assert_eq!(ended.code(), Some(2), "{ended:?}");
        assert!(
            ended.error.matches("error:").count() == 1 && ended.error.contains(words),
            "{ended:?}"
        );
    }
}

#[test]
fn an_output_that_cannot_be_written_in_the_end_hangs_nobody() {
    let room = Room::new();
    std::fs::create_dir(room.at("sub")).unwrap();
    let line = "optimize --out sub/tile.npy --integrands 0 --tile 64x64x8 --steps 4000000000 \
                --threads 1 --kernel gaussian(1)@3x3x1 --run-dir kept --checkpoint 5steps";
    let mut job = start(&room, 3, &format!("{line} {LEASH}"));
    job.until_checkpoint(&room, "kept", 0);
    std::fs::remove_dir_all(room.at("sub")).unwrap();
    job.workers().into_iter().for_each(|rank| send(rank, Signal::TERM));
    let failed = job.end();
    assert_eq!(failed.code(), Some(1), "{failed:?}");
    assert!(failed.error.contains("sub"), "{failed:?}");
}

/// Runs this program by so many ranks on two hosts; none where there cannot be two.
fn on_two_hosts(room: &Room, ranks: usize, line: &str) -> Option<()> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/two_hosts.sh");
    let mut command = Command::new(script);
    command.args(["--count", "bytes.txt", &ranks.to_string(), PROGRAM]);
    command.args(line.split_whitespace());
    let ended = room.start_as(command).end();
    if ended.code() == Some(77) {
        println!("skipped: {}", ended.error.trim());
        return None;
    }
    assert!(ended.status.success(), "{ended:?}");
    Some(())
}

#[test]
fn only_halos_and_the_tile_cross_the_link_between_two_hosts() {
    const STEPS: u32 = 60;
    let room = Room::new();
    let line = format!(
        "{PLAIN} --tile 128x128x16 --kernel gaussian(2.1)*fovvideovdp(60)@7x7x8 --steps {STEPS} \
         --draws 1000 --polish 0 --warp 0 --threads 1"
    );
    let expected = room.make(&line);
    std::fs::remove_file(room.at("tile.npy")).unwrap();
    let Some(()) = on_two_hosts(&room, 2, &line) else { return };
    assert!(room.read("tile.npy") == expected);
    let told = room.sidecar().options;
    let ranks = told["ranks"]["ranks"].as_array().unwrap();
    let halos: u64 = ranks.iter().map(|rank| rank["traffic"].as_u64().unwrap()).sum();
    let half = (expected.len() / 2) as u64;
    let crossed = String::from_utf8(room.read("bytes.txt")).unwrap();
    let crossed: u64 = crossed.trim().parse().unwrap();
    let payload = halos + half;
    // The headers of TCP and Ethernet, of Open MPI, and its own talk at the start.
    let most = payload + payload / 30 + 200_000;
    assert!((payload..most).contains(&crossed), "{crossed} bytes of {payload}");
}

#[test]
fn two_hosts_leave_no_trace() {
    let room = Room::new();
    let line = format!(
        "{PLAIN} --tile 61x50x5 --spp 3 --dims 3 --kernel gaussian(1.5)*ema(0.4)@5x5x4 --steps 40 \
         --draws 300 --polish 2 --warp 10 --start stratified"
    );
    let expected = room.make(&format!("{line} --threads 1"));
    for (ranks, threads) in [(2, 2), (3, 1), (4, 2), (7, 1)] {
        std::fs::remove_file(room.at("tile.npy")).unwrap();
        let line = format!("{line} --threads {threads}");
        let Some(()) = on_two_hosts(&room, ranks, &line) else { return };
        assert!(room.read("tile.npy") == expected, "{ranks} ranks of {threads} threads");
    }
}
