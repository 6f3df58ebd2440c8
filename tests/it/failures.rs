//! What goes wrong around a run, and what users must not lose by it: outputs that two runs want,
//! folders that take no files, terminals that close, and words that say what to do.

use std::fs;
use std::process::{Command, Stdio};

use rustix::process::Signal;

use crate::tool::{LEASH, PROGRAM, Room, Run};

/// A run that goes on until it is stopped.
const ENDLESS: &str = "optimize --integrands 0 --tile 27x24x8 --steps 4000000000 --draws 500 \
                       --polish 0 --warp 5 --kernel gaussian(1)*ema(0.5)@3x3x4 \
                       --checkpoint 5steps";

/// A run of no time.
const SHORT: &str = "optimize --integrands 0 --tile 9x8x4 --steps 20 --draws 64 --polish 0 \
                     --warp 5 --kernel gaussian(1)*ema(0.5)@3x3x4";

/// Starts an endless run, and waits until it does steps.
fn start_endless(room: &Room, flags: &str) -> Run {
    let mut run = room.start(&format!("{ENDLESS} {LEASH} {flags}"));
    let folder = if flags.contains("--run-dir other.run") { "other.run" } else { "tile.run" };
    run.until_checkpoint(room, folder, 5);
    run
}

/// Runs a line of a shell in which `$0` is this program.
fn shell(room: &Room, script: &str) -> Run {
    let mut command = Command::new("sh");
    command.args(["-c", script, PROGRAM]).stdin(Stdio::null());
    room.start_as(command)
}

#[test]
fn an_output_that_another_run_makes_is_refused_before_the_first_step() {
    let room = Room::new();
    let mut run = start_endless(&room, "--force");
    // Whatever folder the second one keeps itself in, and however it spells the path.
    for flags in ["--run-dir b.run", "--run-dir b.run --force", "--run-dir b.run --out ./tile.npy"]
    {
        let words = ["another run", "tile.npy"];
        room.run(&format!("{ENDLESS} {LEASH} {flags}")).failed(3, &words);
    }
    // With the same folder as well.
    room.run(&format!("{ENDLESS} {LEASH} --force")).failed(3, &["another run"]);
    run.send(Signal::INT);
    assert_eq!(run.end().code(), Some(130));
    assert_eq!(room.names("."), ["tile.json", "tile.npy", "tile.png", "tile.run"]);
}

#[test]
fn an_output_is_free_again_after_a_run_that_failed_or_was_killed() {
    let room = Room::new();
    room.run(&format!("{SHORT} --run-dir /proc/tile.run")).failed(1, &["/proc/tile.run"]);
    assert!(room.names(".").is_empty(), "{:?}", room.names("."));
    let mut run = start_endless(&room, "");
    run.send(Signal::KILL);
    run.end();
    room.run(&format!("{SHORT} --force")).succeeded();
    assert_eq!(room.names("."), ["tile.json", "tile.npy", "tile.png"]);
}

#[test]
fn a_run_is_resumed_from_anywhere_to_where_it_was_to_write() {
    let room = Room::new();
    fs::create_dir_all(room.at("a")).unwrap();
    fs::create_dir_all(room.at("b")).unwrap();
    let mut run = shell(&room, &format!("cd a && exec \"$0\" {} {LEASH}", quoted(ENDLESS)));
    run.until_checkpoint(&room, "a/tile.run", 5);
    run.send(Signal::KILL);
    run.end();
    shell(&room, "cd b && exec \"$0\" resume ../a/tile.run --time 0s").end().succeeded();
    assert!(room.at("a/tile.npy").exists());
    assert!(room.names("b").is_empty(), "{:?}", room.names("b"));
}

#[test]
fn a_folder_that_takes_no_checkpoints_is_found_before_the_first_step() {
    let room = Room::new();
    let endless = format!("{ENDLESS} {LEASH}");
    room.run(&format!("{endless} --run-dir /proc/tile.run")).failed(1, &["/proc/tile.run"]);
    room.run(&format!("{endless} --run-dir no/tile.run")).failed(1, &["there is no folder no"]);
    // What would be both a file and a folder.
    for flags in ["--out x.run", "--run-dir tile.npy", "--run-dir ./tile.json"] {
        room.run(&format!("{endless} {flags}")).failed(2, &["both an output and the run's folder"]);
    }
    assert!(room.names(".").is_empty(), "{:?}", room.names("."));
}

#[test]
fn a_dry_run_finds_what_the_run_would() {
    let room = Room::new();
    fs::write(room.at("there.npy"), "").unwrap();
    for (flags, code, words) in [
        ("--out no/tile.npy", 1, "there is no folder no"),
        ("--out there.npy", 3, "there.npy exists already"),
        ("--start missing.npy", 1, "missing.npy"),
        ("--out x.run", 2, "both an output and the run's folder"),
        ("--run-dir no/tile.run", 1, "there is no folder no"),
    ] {
        let line = format!("{SHORT} {flags}");
        room.run(&line).failed(code, &[words]);
        room.run(&format!("{line} --dry-run")).failed(code, &[words]);
    }
    room.run(&format!("{SHORT} --dry-run")).succeeded();
    assert_eq!(room.names("."), ["there.npy"]);
}

#[test]
fn an_output_that_cannot_be_written_in_the_end_is_not_lost() {
    let room = Room::new();
    fs::create_dir(room.at("sub")).unwrap();
    let mut run = start_endless(&room, "--out sub/tile.npy --run-dir tile.run");
    fs::remove_dir_all(room.at("sub")).unwrap();
    run.send(Signal::INT);
    run.end().failed(1, &["there is no folder sub", "`perceptile resume tile.run` goes on"]);
    room.run("resume tile.run --out tile.npy --time 0s").succeeded();
}

#[test]
fn a_terminal_that_closes_leaves_the_tile() {
    for workers in ["", "--workers 2"] {
        let room = Room::new();
        // These tests may have been started so that nothing of them hears a terminal close.
        let mut command = Command::new("env");
        command.args(["--default-signal=HUP", PROGRAM]).stdin(Stdio::null());
        command.args(format!("{ENDLESS} {LEASH} {workers}").split_whitespace());
        let mut run = room.start_as(command);
        run.until_checkpoint(&room, "tile.run", 5);
        run.send_to_group(Signal::HUP);
        assert_eq!(run.end().code(), Some(129));
        assert_eq!(room.names("."), ["tile.json", "tile.npy", "tile.png", "tile.run"]);
    }
}

#[test]
fn a_terminal_that_was_left_on_purpose_closes_without_effect() {
    let room = Room::new();
    let script = format!("trap '' HUP; exec \"$0\" {} {LEASH}", quoted(ENDLESS));
    let mut run = shell(&room, &script);
    run.until_checkpoint(&room, "tile.run", 5);
    run.send(Signal::HUP);
    let steps = room.checkpoints("tile.run")[0];
    run.until_checkpoint(&room, "tile.run", steps + 50);
    run.send(Signal::INT);
    assert_eq!(run.end().code(), Some(130));
}

#[test]
fn a_stop_is_answered_at_once_and_what_it_says_to_do_works() {
    let room = Room::new();
    // The uniformity step that follows would take for ever.
    let flags = format!("{} {LEASH}", ENDLESS.replace("--warp 5", "--warp 4000000000"));
    let mut run = room.start(&flags);
    run.until_checkpoint(&room, "tile.run", 5);
    run.send(Signal::INT);
    run.until("an answer", |run| run.error().contains("stopping"));
    assert!(!run.is_over());
    run.send(Signal::INT);
    assert_eq!(run.end().code(), Some(130));
    // Nothing is left but what the run can go on from.
    assert_eq!(room.names("."), ["tile.run"]);

    let room = Room::new();
    let mut run = start_endless(&room, "");
    run.send(Signal::TERM);
    let ended = run.end();
    assert_eq!(ended.code(), Some(143));
    let (_, command) = ended.out.split_once("perceptile resume ").unwrap();
    let line = format!("resume {} --time 0s", command.lines().next().unwrap());
    room.run(&line).succeeded();
    // A tile that somebody has put there is not the run's.
    fs::write(room.at("tile.npy"), "mine").unwrap();
    room.run(&line).failed(3, &["tile.npy exists already"]);
    assert_eq!(room.read("tile.npy"), b"mine");
}

#[test]
fn messages_survive_a_reader_that_has_gone() {
    let room = Room::new();
    // Each lost worker is a line, of which the reader wants none.
    let line = ENDLESS.replace("--steps 4000000000", "--steps 300");
    let workers = "--workers 2 --faults 50ms,0 --replacements 100000";
    let script =
        format!("{{ \"$0\" {} {workers}; echo $? >code; }} 2>&1 | true; cat code", quoted(&line));
    let ended = shell(&room, &script).end().succeeded();
    assert_eq!(ended.out, "0\n");
    assert!(room.at("tile.npy").exists());
}

#[cfg(target_os = "linux")]
#[test]
fn a_run_that_a_limit_would_end_is_refused() {
    let room = Room::new();
    let large = "optimize --tile 512x512x64 --kernel none --polish 0 --integrands 0";
    let ended = room.start_after("ulimit -v 400000", large).end();
    ended.failed(4, &["MB of memory", "ulimit -v"]);
    assert!(room.names(".").is_empty(), "{:?}", room.names("."));
}

/// A line for a shell: kernels have parentheses.
fn quoted(line: &str) -> String {
    let words: Vec<String> = line.split_whitespace().map(|word| format!("'{word}'")).collect();
    words.join(" ")
}
