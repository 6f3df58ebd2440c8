//! Runs that were killed, stopped or damaged go on to the same bytes, and what is no run of ours
//! is refused.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::PathBuf;
use std::process::Command;

use rustix::process::{Signal, geteuid};

use crate::child::output;
use crate::densities::ring_file;
use crate::tool::{LEASH, Random, Room, has_ended, until};

/// A run with time to be killed in its descent and in its polish; of little work, so that what is
/// left of it is done soon.
const RUN: &str = "optimize --integrands 0 --seed 5 --tile 27x24x8 --start random --steps 300 \
                   --draws 500 --polish 600 --warp 20 --kernel gaussian(1)*ema(0.5)@3x3x4";

/// The same without an end of its descent.
fn endless() -> String {
    format!("{} {LEASH}", RUN.replace("--steps 300", "--steps 4000000000"))
}

/// The tile of the run, made without interruption.
fn expected(room: &Room) -> Vec<u8> {
    room.run(&format!("{RUN} --threads 1 --out whole.npy --force")).succeeded();
    room.read("whole.npy")
}

/// Leaves a run behind that was killed after so many steps.
fn killed(room: &Room, after: u32) {
    killed_with(room, "", after);
}

/// The same with more flags.
fn killed_with(room: &Room, flags: &str, after: u32) {
    // On a busy machine a run may be over before it is killed. What is left of it takes longer than
    // that most times, so not once in so many attempts is less likely than 2^-40.
    for _ in 0..40 {
        let mut run = room.start(&format!("{RUN} {flags} --threads 1 --checkpoint 2steps --force"));
        run.until_or_end("a checkpoint", |_| room.has_checkpoint("tile.run", after));
        run.send(Signal::KILL);
        let ended = run.end();
        if ended.code().is_none() {
            assert!(!room.at("tile.npy").exists(), "{ended:?}");
            return;
        }
        ended.succeeded();
        for name in ["tile.npy", "tile.json", "tile.png"] {
            fs::remove_file(room.at(name)).unwrap();
        }
    }
    panic!("no run is killed before it is over");
}

#[test]
fn a_run_goes_on_without_the_file_of_its_density() {
    let room = Room::new();
    fs::copy(ring_file(), room.at("ring.npy")).unwrap();
    let flags = "--domain density(ring.npy)";
    room.run(&format!("{RUN} {flags} --out whole.npy")).succeeded();
    killed_with(&room, flags, 20);
    let replaced = "the density would be replaced by";
    room.run("resume tile.run --out ring.npy --force").failed(2, &[replaced]);
    fs::remove_file(room.at("ring.npy")).unwrap();
    room.run("resume tile.run").succeeded();
    assert!(room.read("tile.npy") == room.read("whole.npy"));
}

#[test]
fn a_run_whose_coordinator_is_killed_twenty_times_makes_the_same_tile() {
    let room = Room::new();
    let expected = expected(&room);
    let mut random = Random(1);
    let crews =
        ["--threads 2", "--workers 3 --threads 1", "--threads 1", "--workers 2 --threads 2"];
    let (mut kills, mut runs) = (0, 0);
    while kills < 20 {
        runs += 1;
        assert!(runs < 40, "whole runs without a kill, but for {kills}");
        let _ = fs::remove_file(room.at("tile.npy"));
        let mut line = format!("{RUN} --force");
        let mut at = 0;
        loop {
            let crew = crews[kills % crews.len()];
            let mut run = room.start(&format!("{line} {crew} --checkpoint 3steps"));
            let ahead = at + 10 + random.below(60) as u32;
            run.until_or_end("a checkpoint", |_| room.has_checkpoint("tile.run", ahead));
            random.sleep(20);
            let workers = run.workers();
            run.send(Signal::KILL);
            let ended = run.end();
            if ended.code().is_some() {
                // It was over before.
                ended.succeeded();
                break;
            }
            until("workers end with their coordinator", || workers.iter().all(|&it| has_ended(it)));
            kills += 1;
            if let Some(&number) = room.checkpoints("tile.run").first() {
                at = number;
                line = "resume tile.run --force".into();
            }
        }
        assert_eq!(room.read("tile.npy"), expected, "after {kills} kills");
        assert!(!room.at("tile.run").exists());
    }
}

#[test]
fn a_damaged_checkpoint_is_named_and_the_one_before_it_used() {
    let room = Room::new();
    let expected = expected(&room);
    for (after, crew) in [(20, "--threads 2"), (350, "--workers 2 --threads 1")] {
        killed(&room, after);
        // Three, if it was killed before it removed the oldest.
        assert!((2..=3).contains(&room.checkpoints("tile.run").len()));
        let newest = format!("tile.run/checkpoint-{}", room.checkpoints("tile.run")[0]);
        let mut bytes = room.read(&newest);
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(room.at(&newest), bytes).unwrap();
        let ended = room.run(&format!("resume tile.run {crew}")).succeeded();
        assert!(ended.error.contains(&newest) && ended.error.contains("damaged"), "{ended:?}");
        assert_eq!(room.read("tile.npy"), expected);
        fs::remove_file(room.at("tile.npy")).unwrap();
        for name in ["tile.json", "tile.png"] {
            fs::remove_file(room.at(name)).unwrap();
        }
    }

    killed(&room, 20);
    let names = room.checkpoints("tile.run").into_iter().map(|it| format!("checkpoint-{it}"));
    let names: Vec<String> = names.collect();
    assert!(names.len() >= 2);
    for name in &names {
        let path = format!("tile.run/{name}");
        let bytes = room.read(&path);
        fs::write(room.at(&path), &bytes[..bytes.len() - 5]).unwrap();
    }
    room.run("resume tile.run").failed(1, &[&names[0], &names[1]]);
    assert!(!room.at("tile.npy").exists());
}

#[test]
fn whatever_is_in_a_checkpoint_does_no_harm() {
    let room = Room::new();
    let expected = expected(&room);
    killed(&room, 200);
    // Of one checkpoint only, so that none takes its place.
    let numbers = room.checkpoints("tile.run");
    let good = room.read(&format!("tile.run/checkpoint-{}", numbers[0]));
    let mut random = Random(9);
    for turn in 0..40 {
        let mut bytes = good.clone();
        match turn % 4 {
            // The head is where damage could do most.
            0 => bytes[random.below(3000)] ^= 1 << random.below(8),
            1 => bytes[random.below(good.len())] ^= 1 << random.below(8),
            2 => bytes.truncate(random.below(good.len())),
            _ => {
                let (from, to) = (random.below(good.len() - 99), random.below(good.len() - 99));
                bytes.copy_within(from..from + 99, to);
            }
        }
        fs::create_dir_all(room.at("other.run")).unwrap();
        fs::write(room.at("other.run/lock"), []).unwrap();
        fs::write(room.at("other.run/checkpoint-7"), &bytes).unwrap();
        let mut permissions = fs::metadata(room.at("other.run")).unwrap().permissions();
        std::os::unix::fs::PermissionsExt::set_mode(&mut permissions, 0o700);
        fs::set_permissions(room.at("other.run"), permissions).unwrap();
        let ended = room.run("resume other.run --threads 2 --out other.npy --force");
        if ended.code() == Some(0) {
            assert_eq!(room.read("other.npy"), expected, "turn {turn}");
        } else {
            ended.failed(1, &["checkpoint-7"]);
        }
    }
}

#[test]
fn a_folder_that_is_in_use_or_holds_an_unfinished_run_is_left_alone() {
    let room = Room::new();
    let mut run = room.start(&format!("{} --checkpoint 5steps --run-dir kept", endless()));
    run.until_checkpoint(&room, "kept", 0);
    for line in [
        format!("{RUN} --out other.npy --run-dir kept"),
        format!("{RUN} --out other.npy --run-dir kept --force"),
        "resume kept --out other.npy".into(),
    ] {
        room.run(&line).failed(3, &["kept", "in use"]);
    }
    run.send(Signal::KILL);
    run.end();
    let before = room.checkpoints("kept");
    room.run(&format!("{RUN} --out other.npy --run-dir kept")).failed(3, &["kept", "--force"]);
    assert_eq!(room.checkpoints("kept"), before);
    room.run(&format!("{RUN} --out other.npy --run-dir kept --force")).succeeded();
    assert!(!room.at("kept").exists());
}

#[test]
fn what_is_no_run_folder_of_ours_is_refused() {
    let room = Room::new();
    killed(&room, 20);
    let newest = format!("tile.run/checkpoint-{}", room.checkpoints("tile.run")[0]);

    symlink(room.at("tile.run"), room.at("link")).unwrap();
    room.run("resume link").failed(1, &["link"]);
    fs::write(room.at("made.npy"), "").unwrap();
    room.run("resume made.npy").failed(2, &["made.npy is a file", "such as made.run"]);
    room.run(&format!("{RUN} --out other.npy --run-dir link")).failed(1, &["link"]);

    fs::write(room.at("file"), b"precious").unwrap();
    room.run(&format!("{RUN} --out other.npy --run-dir file --force")).failed(1, &["file"]);
    assert_eq!(room.read("file"), b"precious");
    fs::create_dir(room.at("full")).unwrap();
    fs::write(room.at("full/thesis.txt"), b"precious").unwrap();
    room.run(&format!("{RUN} --out other.npy --run-dir full --force")).failed(1, &["thesis.txt"]);
    assert_eq!(room.names("full"), ["thesis.txt"]);

    // A checkpoint that is a link to another file.
    fs::rename(room.at(&newest), room.at("elsewhere")).unwrap();
    symlink(room.at("elsewhere"), room.at(&newest)).unwrap();
    room.run("resume tile.run").failed(1, &["checkpoint-"]);
    fs::remove_file(room.at(&newest)).unwrap();
    fs::rename(room.at("elsewhere"), room.at(&newest)).unwrap();

    for missing in ["nowhere", "nowhere/at/all"] {
        room.run(&format!("resume {missing}")).failed(1, &["nowhere"]);
    }
    fs::create_dir(room.at("empty")).unwrap();
    room.run("resume empty").failed(1, &["empty"]);

    if geteuid().is_root() {
        std::os::unix::fs::chown(room.at("tile.run"), Some(12345), None).unwrap();
        room.run("resume tile.run").failed(1, &["tile.run", "12345"]);
    }
    assert!(!room.at("tile.npy").exists() && !room.at("other.npy").exists());
}

#[test]
fn a_run_goes_on_when_its_folder_vanishes() {
    for crew in ["--threads 1", "--workers 2 --threads 1"] {
        let room = Room::new();
        let mut run = room.start(&format!("{} {crew} --checkpoint 5steps", endless()));
        run.until_checkpoint(&room, "tile.run", 0);
        // Again, if a checkpoint is written meanwhile.
        run.until("its folder is gone", |_| fs::remove_dir_all(room.at("tile.run")).is_ok());
        let told = |text: &str| text.contains("no checkpoint was written");
        run.until("that is told", |run| told(&run.error()));
        run.send(Signal::TERM);
        assert_eq!(run.end().code(), Some(143));
        room.tile_so_far();
    }
}

/// A file system in memory, which goes with this.
struct Mounted(PathBuf);

impl Mounted {
    /// Of so many bytes; none where none can be had.
    fn new(path: PathBuf, bytes: usize) -> Option<Self> {
        fs::create_dir(&path).unwrap();
        let mut mount = Command::new("sh");
        mount.args(["-c", &format!("exec mount -t tmpfs -o size={bytes} tmpfs \"$0\"")]).arg(&path);
        output(&mut mount).status.success().then_some(Self(path))
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        let unmounted = output(Command::new("umount").arg(&self.0)).status.success();
        assert!(unmounted || std::thread::panicking(), "{} stays", self.0.display());
    }
}

#[test]
fn a_full_disk_keeps_the_last_good_checkpoint() {
    let room = Room::new();
    let expected = expected(&room);
    // Room for two checkpoints and a half.
    let size = 27 * 24 * 8 * 2 * 3 * 4;
    let Some(_mounted) = Mounted::new(room.at("small"), size * 5 / 2) else {
        eprintln!("skipped: no file system can be mounted here");
        return;
    };
    let ended = room.run(&format!("{RUN} --threads 1 --checkpoint 5steps --run-dir small/run"));
    let ended = ended.succeeded();
    let told = ended.error.contains("no checkpoint was written") && ended.error.contains("space");
    assert!(told, "{ended:?}");
    assert!(room.read("tile.npy") == expected);
}

#[test]
fn a_stopped_run_goes_on_and_replaces_its_own_tile_only() {
    let room = Room::new();
    let mut run = room.start(&format!("{} --workers 2 --threads 1 --checkpoint 1h", endless()));
    run.until("at work", |run| !run.ready_workers().is_empty());
    run.send(Signal::TERM);
    let ended = run.end();
    assert_eq!(ended.code(), Some(143), "{ended:?}");
    let (so_far, steps) = room.tile_so_far();
    // A tile that is not what the run left.
    std::fs::write(room.at("tile.npy"), &so_far[1..]).unwrap();
    room.run("resume tile.run").failed(3, &["tile.npy", "--force"]);
    assert!(room.read("tile.npy") == so_far[1..]);
    std::fs::write(room.at("tile.npy"), &so_far).unwrap();
    let again = format!("resume tile.run --threads 2 --checkpoint 5steps {LEASH}");
    let mut run = room.start(&again);
    run.until_checkpoint(&room, "tile.run", steps + 1);
    run.send(Signal::TERM);
    assert_eq!(run.end().code(), Some(143));
    assert!(room.tile_so_far().1 > steps);
}
