//! The command as scripts and people meet it: exit codes, messages, files, signals.

use std::fs;
use std::io::{self, PipeWriter};
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

use perceptile::format::sidecar::{Sidecar, digest};
use perceptile::format::source::TileSource;
use perceptile::solver::Preset;
use perceptile::tile::Tile;
use proptest::prelude::*;
use rustix::process::Signal;
use serde_json::Value;

use crate::child::output;
use crate::npy::npy;
use crate::tool::{LEASH, PROGRAM, PROGRESS, Room, Run, caught};

/// A run that takes no time.
const SMALL: &[&str] = &[
    "optimize",
    "--tile",
    "8x9x4",
    "--kernel",
    "gaussian(1) * ema(0.5) @ 3x3x4",
    "--steps",
    "12",
    "--draws",
    "64",
    "--polish",
    "2",
    "--warp",
    "5",
    "--integrands",
    "2",
];

/// A run that goes on until it is told to stop.
const LONG: &[&str] = &[
    "optimize",
    "--preset",
    "quick",
    "--tile",
    "24x24x8",
    "--steps",
    "4000000000",
    "--draws",
    "256",
    "--polish",
    "0",
    "--seed",
    "3",
    "--kernel",
    "gaussian(1) * ema(0.5) @ 3x3x4",
];

/// What a command did, in a folder of its own.
struct Folder(Room);

impl Folder {
    fn new() -> Self {
        Self(Room::new())
    }

    fn path(&self) -> PathBuf {
        self.0.at("")
    }

    fn command(&self, args: &[&str]) -> Command {
        let mut command = Command::new(PROGRAM);
        command.args(args).current_dir(self.path()).env("RUST_BACKTRACE", "0");
        command.env(PROGRESS.0, PROGRESS.1);
        command
    }

    fn run(&self, args: &[&str]) -> Output {
        output(&mut self.command(args))
    }

    /// Runs what must succeed without a word on the standard error; returns what it printed.
    fn succeed(&self, args: &[&str]) -> String {
        let output = self.run(args);
        let error = text(&output.stderr);
        assert_eq!((output.status.code(), &*error), (Some(0), ""), "{args:?}");
        text(&output.stdout)
    }

    /// Runs what must fail with an exit code, and a message with all the words; it leaves no file.
    fn fail(&self, args: &[&str], code: i32, words: &[&str]) {
        let before = self.names();
        let output = self.run(args);
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {error}");
        for word in words {
            assert!(error.contains(word), "{args:?}: no {word:?} in {error}");
        }
        assert!(error.starts_with("error: "), "{args:?}: {error}");
        assert!(!error.contains("panicked"), "{args:?}: {error}");
        assert_eq!(self.names(), before, "{args:?}");
    }

    fn names(&self) -> Vec<String> {
        self.0.names("")
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path().join(name), content).unwrap();
    }

    fn read(&self, name: &str) -> Vec<u8> {
        self.0.read(name)
    }

    /// The tile of a run and its provenance, which must belong together.
    fn tile(&self, name: &str) -> (Tile, Sidecar) {
        let path = self.path().join(name);
        let tile = TileSource::new(path.clone()).read().unwrap();
        let sidecar = Sidecar::read(&Sidecar::path_of(&path)).unwrap();
        assert_eq!(sidecar.sha256, digest(&tile));
        assert_eq!(sidecar.shape, tile.shape());
        (tile, sidecar)
    }

    fn small(&self, more: &[&str]) -> String {
        self.succeed(&[SMALL, more].concat())
    }
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

#[test]
fn the_version_names_the_commit_and_tiles_do_not() {
    let folder = Folder::new();
    let version = env!("CARGO_PKG_VERSION");
    let printed = folder.succeed(&["--version"]);
    let commit = printed.strip_prefix(&format!("perceptile {version}")).unwrap().trim_end();
    // Without git there is none.
    let hash = commit.strip_prefix(" (").and_then(|rest| rest.strip_suffix(')'));
    let hexadecimal = |hash: &str| hash.len() >= 7 && hash.chars().all(|c| c.is_ascii_hexdigit());
    assert!(commit.is_empty() || hash.is_some_and(hexadecimal), "{printed}");
    folder.succeed(SMALL);
    let sidecar = Sidecar::read(&folder.path().join("tile.json")).unwrap();
    assert_eq!(sidecar.version, version);
}

#[test]
fn a_run_leaves_a_tile_its_provenance_and_its_picture() {
    let folder = Folder::new();
    let printed = folder.small(&[]);
    assert_eq!(folder.names(), ["tile.json", "tile.npy", "tile.png"]);
    for word in
        ["all steps done", "12 steps and 2 polish steps", "tile.npy", "scores", "phases", "sha256"]
    {
        assert!(printed.contains(word), "no {word} in {printed}");
    }
    let (tile, sidecar) = folder.tile("tile.npy");
    assert_eq!((tile.shape().width(), tile.shape().height(), tile.shape().frames()), (8, 9, 4));
    assert_eq!(sidecar.kernel, "gaussian(1) * ema(0.5) @ 3x3x4");
    assert!(sidecar.scores["classes"][0]["perceived"]["mean"].as_f64().unwrap() > 0.0);
    let picture = png_size(&folder.read("tile.png"));
    assert!(picture.0 > 0 && picture.1 > 0);
}

fn png_size(bytes: &[u8]) -> (u32, u32) {
    let reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info().unwrap();
    (reader.info().width, reader.info().height)
}

#[test]
fn wrong_arguments_are_refused() {
    let folder = Folder::new();
    for (args, words) in [
        (&["--tile", "0x8x8"][..], &["width is 0", "at least 1"][..]),
        (&["--tile", "8x8x0"], &["frames is 0"]),
        (&["--tile", "8x8"], &["8x8", "128x128x30"]),
        (&["--tile", "-8x8x8"], &["-8"]),
        (&["--tile", "8x8x8x8"], &["8x8x8x8"]),
        (&["--tile", "99999999999999999999x8x8"], &["99999999999999999999x8x8"]),
        (&["--tile", "1048577x8x8"], &["width is 1048577", "1048576"]),
        (&["--tile", "1048576x1048576x1048576"], &["more coordinates than memory can address"]),
        (&["--spp", "0"], &["spp is 0"]),
        (&["--spp", "65"], &["spp is 65", "64"]),
        (&["--dims", "0"], &["dims is 0"]),
        (&["--dims", "17"], &["dims is 17", "16"]),
        (&["--tile", "6x16x16"], &["7 pixels wide", "only 6"]),
        (&["--tile", "16x6x16"], &["7 pixels high", "only 6"]),
        (&["--kernel", "gausian(2.1)"], &["gausian", "gaussian", "column", "^"]),
        (&["--kernel", "gaussian(2.1) * "], &["^"]),
        (&["--kernel", "gaussian(-1)"], &["-1", "^"]),
        (&["--kernel", "gaussian(nan)"], &["^"]),
        (&["--kernel", ""], &["^"]),
        (&["--preset", "fast"], &["fast", "best", "quick", "paper", "paper-taa", "salaun"]),
        (&["--steps", "-1"], &["-1"]),
        (&["--steps", "4294967296"], &["4294967296"]),
        (&["--draws", "0"], &["draws is 0", "1..=2^30"]),
        (&["--draws", "2000000", "--tile", "8x8x8"], &["2000000 draws", "fewer draws"]),
        (&["--directions", "17"], &["directions is 17"]),
        (&["--rate", "nan"], &["rate is NaN"]),
        (&["--rate", "0"], &["rate is 0"]),
        (&["--beta1", "1"], &["beta1 is 1"]),
        (&["--beta2", "0.99999999"], &["beta2 is 0.99999999", "in [0, 0.999999]"]),
        (&["--axis-share", "0.8", "--pair-share", "0.3"], &["1.1", "at most 1"]),
        (&["--warp-rate", "inf"], &["warp-rate is inf"]),
        (&["--polish-axis-weight=-1"], &["polish-axis-weight is -1"]),
        (&["--seed", "-1"], &["-1"]),
        (&["--time", "10y"], &["10y", "s, m or h"]),
        (&["--time=-5s"], &["-5s"]),
        (&["--time", "1e300h"], &["1e300h"]),
        (&["--time", "nan"], &["nan"]),
        (&["--workers", "5000"], &["5000 workers are too many"]),
        (&["--workers", "1000", "--threads", "1000"], &["1000000 threads of all workers"]),
        (&["--pin"], &["--workers"]),
        (&["--checkpoint", "0"], &["more than 0"]),
        (&["--threads", "-1"], &["-1"]),
        (&["--threads", "1000000000"], &["1000000000", "1024"]),
        (&["--integrands", "65537"], &["65537", "65536"]),
        (&["--threads", "1e2"], &["whole number in digits"]),
        (&["--simd", "neon"], &["neon", "auto", "plain"]),
        (&["--stpes", "5"], &["--stpes", "--steps"]),
        (&["--kernel", "frame", "--tile", "256x256x2", "--polish", "3"], &["65536 taps", "polish"]),
    ] {
        folder.fail(&[&["optimize"], args].concat(), 2, words);
    }
    for args in [&["optimise"][..], &["kernel", "box(2)", "b"], &["export"]] {
        folder.fail(args, 2, &["Usage"]);
    }
}

#[test]
fn a_run_that_memory_cannot_hold_is_refused_at_once() {
    let folder = Folder::new();
    for tile in ["16384x16384x1024", "1048576x1048576x1", "1048576x1048576x1024"] {
        folder.fail(&["optimize", "--preset", "salaun", "--tile", tile], 4, &["B of memory"]);
    }
    // Its draws need more than its samples do.
    let draws =
        ["--tile", "512x512x16", "--kernel", "none", "--draws", "1000000000", "--directions"];
    folder.fail(&[&["optimize"], &draws[..], &["16"]].concat(), 4, &["memory"]);
    folder.fail(
        &["optimize", "--tile", "8192x8192x64", "--dry-run", "--spp", "64"],
        4,
        &["memory"],
    );
}

#[test]
fn what_exists_is_replaced_only_with_force() {
    let folder = Folder::new();
    for (name, other) in [("a.npy", "a"), ("b.json", "b"), ("c.d.png", "c.d")] {
        folder.write(name, b"precious");
        folder.fail(&[SMALL, &["--out", &format!("{other}.npy")]].concat(), 3, &[name, "--force"]);
        assert_eq!(folder.read(name), b"precious");
        folder.small(&["--force", "--out", &format!("{other}.npy")]);
        assert_ne!(folder.read(name), b"precious");
    }
    folder.fail(&["export", "a.npy", "--format", "png8", "--out", "nowhere/deep"], 1, &["nowhere"]);
    folder.succeed(&["export", "a.npy", "--format", "png8", "--out", "slices"]);
    let slice = folder.path().join("slices/a_f000.png");
    fs::write(&slice, b"precious").unwrap();
    folder.fail(&["export", "a.npy", "--format", "png8", "--out", "slices"], 3, &["--force"]);
    assert_eq!(fs::read(&slice).unwrap(), b"precious");
    folder.succeed(&["export", "a.npy", "--format", "png8", "--out", "slices", "--force"]);
    let other = ["export", "b.npy", "--format", "png8", "--out", "slices"];
    folder.fail(&other, 3, &["a_f000.png", "choose another folder", "--force"]);
    folder.write("slices/z.png", b"precious");
    folder.fail(&[&other[..], &["--force"]].concat(), 3, &["z.png", "choose another folder"]);
    fs::remove_file(folder.path().join("slices/z.png")).unwrap();
    folder.succeed(&[&other[..], &["--force"]].concat());
    // The sidecar of the slices that are gone is gone with them.
    assert_eq!(folder.0.names("slices").len(), 5);
    assert_eq!(folder.read("slices/b.json"), folder.read("b.json"));
    folder.write("kernel.png", b"precious");
    let kernel = ["kernel", "box(3)", "--out", "kernel.png"];
    folder.fail(&kernel, 3, &["kernel.png", "--force"]);
    assert_eq!(folder.read("kernel.png"), b"precious");
    folder.succeed(&[&kernel[..], &["--force"]].concat());
    assert_ne!(folder.read("kernel.png"), b"precious");
}

#[test]
fn outputs_that_cannot_be_written_are_noticed_before_the_run() {
    let folder = Folder::new();
    folder.fail(&[LONG, &["--out", "missing/tile.npy"]].concat(), 1, &["missing"]);
    fs::create_dir(folder.path().join("dir.npy")).unwrap();
    folder.fail(&[LONG, &["--out", "dir.npy"]].concat(), 1, &["dir.npy", "folder"]);
    folder.fail(
        &[LONG, &["--out", "tile.json"]].concat(),
        2,
        &["tile.json", "--out names the .npy file", "give tile.npy"],
    );
    folder.fail(&[LONG, &["--out", "/dev/null"]].concat(), 1, &["/dev/null"]);
    folder.fail(&[LONG, &["--out=.."]].concat(), 1, &["name"]);
    let locked = folder.path().join("locked");
    fs::create_dir(&locked).unwrap();
    fs::set_permissions(&locked, fs::Permissions::from_mode(0o555)).unwrap();
    // The superuser may write everywhere.
    if fs::write(locked.join("probe"), b"").is_err() {
        folder.fail(&[LONG, &["--out", "locked/tile.npy"]].concat(), 1, &["locked"]);
    } else {
        fs::remove_file(locked.join("probe")).unwrap();
    }
}

#[test]
fn files_that_are_no_tiles_are_refused() {
    let folder = Folder::new();
    let good: Vec<f32> = (0..32).map(|i| i as f32 / 32.0).collect();
    let with = |value: f32| {
        let mut values = good.clone();
        values[5] = value;
        npy("(2, 2, 2, 2, 2)", &values)
    };
    folder.write("nan.npy", with(f32::NAN));
    folder.write("inf.npy", with(f32::INFINITY));
    folder.write("one.npy", with(1.5));
    folder.write("short.npy", &npy("(2, 2, 2, 2, 2)", &good)[..200]);
    folder.write("header.npy", &npy("(2, 2, 2, 2, 2)", &good)[..50]);
    folder.write("lying.npy", npy("(1000000, 1000000, 1000, 1, 2)", &good));
    folder.write("overflow.npy", npy("(99999999999, 99999999999, 99999999999)", &good));
    folder.write("less.npy", npy("(2, 2, 2, 1, 2)", &good));
    folder.write("empty.npy", b"");
    folder.write("text.npy", b"no tile at all");
    for (name, words) in [
        ("nan.npy", "NaN"),
        ("inf.npy", "inf"),
        ("one.npy", "1.5"),
        ("short.npy", "bytes of data"),
        ("header.npy", "header"),
        ("lying.npy", "bytes of data"),
        ("overflow.npy", "memory can address"),
        ("less.npy", "bytes of data"),
        ("empty.npy", "empty.npy"),
        ("text.npy", "text.npy"),
        ("absent.npy", "absent.npy"),
        (".", "."),
        ("/dev/zero", "/dev/zero"),
    ] {
        folder.fail(&["evaluate", name, "--kernel", "none"], 1, &[name, words]);
        folder.fail(&["export", name, "--format", "png8", "--out", "out"], 1, &[name, words]);
        folder.fail(&[LONG, &["--start", name]].concat(), 1, &[name, words]);
    }
    // A whole tile, but of another shape than the run's.
    folder.write("other.npy", npy("(2, 2, 2, 2, 2)", &good));
    folder.fail(&[LONG, &["--start", "other.npy"]].concat(), 2, &["2x2x2", "24x24x8"]);
    folder.fail(&["evaluate", "other.npy"], 2, &["7 pixels wide", "other"]);
    folder.fail(&["evaluate", "other.npy", "--kernel", "none", "--integrands", "0"], 2, &["0 int"]);
    let mut table = good[..8].to_vec();
    table[3] = f32::NAN;
    folder.write("table.npy", npy("(2, 2, 2)", &table));
    folder.write("long.npy", npy("(1000000, 1000000, 1000)", &table));
    for (name, words) in [
        ("table.npy", "NaN"),
        ("long.npy", "1000000"),
        ("other.npy", "3 axes"),
        ("absent.npy", ""),
        ("/dev/zero", ""),
    ] {
        let kernel = format!("table(\"{name}\", origin=(0, 0, 0))");
        folder.fail(&["kernel", &kernel], 1, &[name, words]);
    }
}

#[test]
fn a_file_of_settings_says_what_flags_say_and_flags_win() {
    let folder = Folder::new();
    folder.small(&["--out", "flags.npy", "--seed", "5"]);
    folder.write(
        "run.toml",
        "tile = \"8x9x4\"\nkernel = \"gaussian(1) * ema(0.5) @ 3x3x4\"\nsteps = 12\ndraws = 64\n\
         polish = 2\nwarp = 5\nseed = 4\n",
    );
    let config = ["optimize", "--config", "run.toml", "--integrands", "0", "--out"];
    folder.succeed(&[&config[..], &["file.npy"]].concat());
    folder.succeed(&[&config[..], &["both.npy", "--seed", "5"]].concat());
    assert_eq!(folder.read("flags.npy"), folder.read("both.npy"));
    assert_ne!(folder.read("flags.npy"), folder.read("file.npy"));

    for (content, words) in [
        ("seed = 5\nstpes = 5", &["run.toml, line 2", "stpes", "'--steps'"][..]),
        ("steps = \"many\"", &["run.toml", "many"]),
        ("config = \"other.toml\"", &["run.toml, line 1", "another"]),
        ("force = \"yes\"", &["run.toml, line 1", "yes"]),
        ("steps = [5]", &["run.toml, line 1", "a number"]),
        ("sigma = 1\npixels-per-degree = 60", &["leave out --sigma"]),
        ("steps = -1", &["run.toml", "-1"]),
        ("tile = \"8x8\"", &["run.toml", "8x8"]),
        ("kernel = \"gausian(1)\"", &["run.toml", "gausian"]),
        ("preset = \"fast\"", &["run.toml", "fast", "quick"]),
        ("steps = 5\nsteps = 6", &["run.toml", "steps"]),
        ("steps = ", &["run.toml"]),
        ("[table]\nsteps = 5", &["run.toml", "table"]),
        ("tile = \"0x8x8\"", &["width is 0"]),
        ("rate = nan", &["rate is NaN"]),
    ] {
        folder.write("run.toml", content);
        folder.fail(&["optimize", "--config", "run.toml"], 2, words);
    }
    folder.write("run.toml", b"\xff\xfe");
    folder.fail(&["optimize", "--config", "run.toml"], 1, &["run.toml"]);
    folder.write("run.toml", vec![b'#'; (1 << 20) + 1]);
    folder.fail(&["optimize", "--config", "run.toml"], 2, &["run.toml", "1048577"]);
    folder.fail(&["optimize", "--config", "absent.toml"], 1, &["absent.toml"]);
    for special in [".", "/dev/zero"] {
        folder.fail(&["optimize", "--config", special], 1, &[special]);
    }

    // It has the name of every flag, and what is printed reads as the same.
    folder.write(
        "all.toml",
        "tile = \"8x9x4\"\nsteps = 12\ndraws = 64\nwarp = 5\nseed = \"18446744073709551615\"\nforce = true\n\
         integrands = 0\nthreads = 1\nout = \"all.npy\"\npin = false\ntime = \"1m\"\nfps = 48\n",
    );
    folder.succeed(&["optimize", "--config", "all.toml"]);
    let printed = folder.succeed(&["optimize", "--config", "all.toml", "--print-config"]);
    for line in ["fps = 48", "threads = 1", "polish = 0", "rate = 0.02", "preset = \"best\""] {
        assert!(printed.lines().any(|printed| printed == line), "no {line}: {printed}");
    }
    folder.write("printed.toml", printed.replace("all.npy", "printed.npy"));
    folder.succeed(&["optimize", "--config", "printed.toml"]);
    assert_eq!(folder.read("all.npy"), folder.read("printed.npy"));
    // What is typed takes the place of what says the same in another way.
    let kernel = ["--kernel", "gaussian(1) @ 3x3x1", "--out", "kernel.npy"];
    folder.succeed(&[&["optimize", "--config", "all.toml"], &kernel[..]].concat());
    assert_eq!(folder.tile("kernel.npy").1.kernel, "gaussian(1) @ 3x3x1");
}

#[test]
fn a_frame_rate_and_taa_make_the_kernel() {
    let folder = Folder::new();
    let line = ["optimize", "--steps", "2", "--integrands", "0", "--warp", "2", "--force"];
    let kernel = |more: &[&str]| {
        folder.succeed(&[&line[..], more].concat());
        folder.tile("tile.npy").1.kernel
    };
    let tile = ["--tile", "16x16x8"];
    let default = kernel(&tile);
    assert_eq!(
        kernel(&[&tile[..], &["--fps", "60"]].concat()),
        default.replace("box(8)", "box(4)")
    );
    let taa = kernel(&[&tile[..], &["--fps", "120", "--taa", "0.1", "--sigma", "1"]].concat());
    let expected =
        "0.84: gaussian(1) * fovvideovdp(120) * ema(0.1) @ 5x5x8 + 0.06: column + 0.1: box(4)";
    assert_eq!(taa, expected);
    let far = kernel(&[&tile[..], &["--pixels-per-degree", "22.5"]].concat());
    assert!(far.starts_with("0.84: gaussian(1.05) "), "{far}");
    for (more, words) in [
        (&["--taa", "0"][..], &["--taa is 0", "at most 1"][..]),
        (&["--fps", "4"], &["fps is 4"]),
        (&["--sigma", "1", "--pixels-per-degree", "45"], &["leave out --sigma"]),
        (&["--fps", "60", "--kernel", "none"], &["--kernel says all of the kernel"]),
    ] {
        folder.fail(&[&["optimize"], more].concat(), 2, words);
    }
}

#[test]
fn fewer_steps_than_the_presets_shorten_the_polish() {
    let folder = Folder::new();
    let polish = |more: &[&str]| {
        let line = [&["optimize", "--tile", "8x8x4", "--dry-run"], more].concat();
        let printed = folder.succeed(&line);
        let (before, _) = printed.split_once(" polish steps, ").unwrap();
        before.rsplit(' ').next().unwrap().parse::<u32>().unwrap()
    };
    assert_eq!(polish(&[]), 150);
    assert_eq!(polish(&["--steps", "20000"]), 150);
    assert_eq!(polish(&["--steps", "1600"]), 15);
    assert_eq!(polish(&["--steps", "40"]), 0);
    assert_eq!(polish(&["--steps", "40", "--polish", "7"]), 7);
    assert_eq!(polish(&["--steps", "0"]), 0);
}

#[test]
fn a_run_says_what_it_does_how_long_it_takes_and_what_it_made() {
    let folder = Folder::new();
    let run = |more: &[&str]| {
        let mut command = folder.command(&[SMALL, &["--force"], more].concat());
        let output = output(command.env_remove("PERCEPTILE_PROGRESS"));
        assert_eq!(output.status.code(), Some(0), "{more:?}");
        (text(&output.stdout), text(&output.stderr))
    };
    let (printed, told) = run(&[]);
    assert!(printed.starts_with("8x9x4, 1 spp, 2 dims: all steps done"), "{printed}");
    assert!(
        told.starts_with("8x9x4, 1 spp, 2 dims, seed 1: 12 steps, 2 polish steps on "),
        "{told}"
    );
    assert!(told.contains("\nnote: this kernel has no part for still pictures"), "{told}");
    assert!(!told.contains("warning"), "{told}");
    // The box is shorter than the tile.
    let line = ["optimize", "--tile", "8x9x4", "--kernel", "gaussian(1) * ema(0.5) @ 3x3x2"];
    let line = [&line[..], &["--steps", "1", "--integrands", "0", "--force"]].concat();
    let short = output(folder.command(&line).env_remove("PERCEPTILE_PROGRESS"));
    let told = text(&short.stderr);
    assert!(told.contains("\nwarning: `gaussian(1) * ema(0.5) @ 3x3x2` leaves out 42 %"), "{told}");
    assert_eq!(run(&["--quiet"]), (String::new(), String::new()));
    let (printed, told) = run(&["--json", "--progress", "none"]);
    let made: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(made["sha256"], folder.tile("tile.npy").1.sha256);
    assert_eq!((made["files"]["tile"].as_str(), &*told), (Some("tile.npy"), ""));

    // A second or two of steps: at least one line for programs.
    let line = [LONG, &["--progress", "json", "--time", "3s", "--integrands", "0", "--force"]];
    let output = output(&mut folder.command(&line.concat()));
    assert_eq!(output.status.code(), Some(0));
    let told = text(&output.stderr);
    let lines: Vec<Value> = told.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert!(!lines.is_empty());
    for line in lines {
        assert_eq!(line["phase"], "descent");
        assert!(line["rate"].as_f64().unwrap() > 0.0 && line["eta"].as_f64().unwrap() > 0.0);
        assert_eq!(line["of"], 4_000_000_000_u32);
    }
}

#[test]
fn a_dry_run_says_what_there_is_to_do_and_does_nothing() {
    let folder = Folder::new();
    let printed = folder.succeed(&["optimize", "--preset", "paper", "--dry-run"]);
    for word in ["128x128x30", "10000 steps", "4096 draws", "memory", "MB"] {
        assert!(printed.contains(word), "no {word} in {printed}");
    }
    assert!(folder.names().is_empty());
    // It also says so where something is in the run's way.
    folder.write("tile.npy", "");
    let stopped = folder.run(&["optimize", "--preset", "quick", "--dry-run"]);
    assert_eq!(stopped.status.code(), Some(3));
    assert!(text(&stopped.stdout).contains("500 steps"), "{}", text(&stopped.stdout));
    let error = text(&stopped.stderr);
    assert!(error.starts_with("error: the run would stop: tile.npy exists already"), "{error}");
}

/// Starts the long run.
fn start(folder: &Folder, more: &[&str]) -> Run {
    let leash: Vec<&str> = LEASH.split(' ').collect();
    folder.0.start_as(folder.command(&[LONG, more, &leash].concat()))
}

#[test]
fn signals_end_a_run_and_leave_its_tile() {
    for (signal, code) in [(Signal::INT, 130), (Signal::TERM, 143)] {
        let folder = Folder::new();
        let mut run = start(&folder, &["--threads", "2", "--checkpoint", "5steps"]);
        run.until_checkpoint(&folder.0, "tile.run", 0);
        run.send(signal);
        let ended = run.end();
        assert_eq!(ended.code(), Some(code), "{ended:?}");
        assert!(ended.error.starts_with("stopping: "), "{ended:?}");
        assert!(ended.out.contains("interrupted"), "{}", ended.out);
        // The run can go on, as it says.
        assert_eq!(folder.names(), ["tile.json", "tile.npy", "tile.png", "tile.run"]);
        assert!(ended.out.contains("perceptile resume tile.run"));
        let (_, sidecar) = folder.tile("tile.npy");
        assert!(sidecar.command.contains("--stop-after"), "{}", sidecar.command);
        // The command on record is for a shell, and makes the same bytes.
        folder.0.tile_so_far();
    }
}

#[test]
fn a_sequence_that_is_stopped_at_its_start_leaves_nothing() {
    let folder = Folder::new();
    // The tile of one sample that it starts from takes a minute and more.
    let line = "optimize --preset progressive --tile 64x64x256 --integrands 0 --threads 2";
    let words: Vec<&str> = line.split(' ').chain(LEASH.split(' ')).collect();
    let mut run = folder.0.start_as(folder.command(&words));
    run.until("it listens", |run| caught(run.pid(), &[Signal::INT, Signal::TERM]));
    run.send(Signal::INT);
    run.end().failed(130, &["stopped while its start was made"]);
    assert_eq!(folder.0.names("."), [""; 0]);
}

#[test]
fn a_second_signal_ends_a_run_at_once() {
    let folder = Folder::new();
    // The uniformity step that the first signal leads to would take for ever.
    let mut run = start(&folder, &["--warp", "4000000000", "--checkpoint", "1h"]);
    run.until("it listens", |run| caught(run.pid(), &[Signal::INT, Signal::TERM]));
    run.send(Signal::INT);
    // Nothing else has it write one so soon.
    run.until_checkpoint(&folder.0, "tile.run", 0);
    run.send(Signal::INT);
    assert_eq!(run.end().code(), Some(130));
    assert_eq!(folder.names(), ["tile.run"]);
}

#[test]
fn time_ends_a_run() {
    let folder = Folder::new();
    let printed = folder.succeed(&[LONG, &["--time", "1s", "--integrands", "2"]].concat());
    assert!(printed.contains("time is up"), "{printed}");
    let (_, sidecar) = folder.tile("tile.npy");
    assert!(sidecar.command.contains("--stop-after"));
    assert!(sidecar.seconds >= 1.0);
}

#[test]
fn a_run_goes_on_from_a_tile() {
    let folder = Folder::new();
    folder.small(&["--out", "first.npy"]);
    folder.small(&["--start", "first.npy", "--out", "second.npy"]);
    let (_, sidecar) = folder.tile("second.npy");
    assert!(sidecar.command.contains("--start first.npy"), "{}", sidecar.command);
    folder.small(&["--start", "stratified", "--out", "third.npy"]);
    assert_ne!(folder.read("second.npy"), folder.read("third.npy"));
}

/// Commands that end in every way, with their exit codes.
const ENDS: [(&[&str], i32); 8] = [
    (&["kernel", "box(2)", "--json"], 0),
    (&["optimize", "--dry-run"], 0),
    (&["--help"], 0),
    (&["kernel"], 0),
    (&["kernel", "column"], 2),
    (&["optimize", "--tile", "0x8x8"], 2),
    (&["evaluate", "nowhere.npy"], 1),
    (&["export", "nowhere.npy", "--format", "png8", "--out", "slices"], 1),
];

#[test]
fn a_command_ends_as_ever_when_nobody_reads_what_it_writes() {
    /// A pipe that nobody reads.
    fn unread() -> PipeWriter {
        io::pipe().unwrap().1
    }
    let folder = Folder::new();
    for (args, code) in ENDS {
        let mut command = folder.command(args);
        let output = command.stderr(unread()).output().unwrap();
        assert_eq!(output.status.code(), Some(code), "{args:?}, no reader of the errors");
        let output = command.stderr(Stdio::piped()).stdout(unread()).output().unwrap();
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{args:?}, no reader of the output: {error}");
        assert_eq!(error.is_empty(), code == 0, "{args:?}, no reader of the output: {error}");
    }
}

#[test]
fn a_command_ends_as_ever_when_its_streams_are_closed() {
    let folder = Folder::new();
    for (args, code) in ENDS {
        for closed in ["2>&-", ">&-", ">&- 2>&-"] {
            let mut command = Command::new("sh");
            command.args(["-c", &format!("exec \"$0\" \"$@\" {closed}"), PROGRAM]).args(args);
            let status = command.current_dir(folder.path()).output().unwrap().status;
            assert_eq!(status.code(), Some(code), "{args:?} {closed}");
        }
    }
}

#[test]
fn kernels_are_shown() {
    let folder = Folder::new();
    let spec = "0.75: gaussian(1) * ema(0.5) @ 3x3x4 + 0.25: column";
    // No file is left behind that nobody asked for, and what can be shown can be shown again.
    for _ in 0..2 {
        let printed = folder.succeed(&["kernel", spec, "--tile", "8x8x6"]);
        assert!(printed.contains("75.0 % of draws") && printed.contains("3x3x4"), "{printed}");
        assert!(folder.names().is_empty());
    }
    let printed = folder.succeed(&["kernel", spec, "--tile", "8x8x6", "--out", "taps.png"]);
    assert!(printed.ends_with("\npicture: taps.png\n"), "{printed}");
    assert!(png_size(&folder.read("taps.png")).0 > 0);
    let printed = folder.succeed(&["kernel", spec, "--tile", "8x8x6", "--json"]);
    let report: Value = serde_json::from_str(&printed).unwrap();
    assert_eq!(report["kernel"], spec);
    let taps = report["classes"][0]["taps"].as_array().unwrap();
    assert_eq!(taps.len(), 36);
    let mass: f64 = taps.iter().map(|tap| tap[3].as_f64().unwrap().abs()).sum();
    assert!((mass - 1.0).abs() < 1e-12);
    let printed = folder.succeed(&["kernel", "--fps", "120", "--taa", "0.1", "--json"]);
    let report: Value = serde_json::from_str(&printed).unwrap();
    let mixture =
        "0.84: gaussian(2.1) * fovvideovdp(120) * ema(0.1) @ 7x7x16 + 0.06: column + 0.1: box(8)";
    assert_eq!(report["kernel"], mixture);
    let smaller = folder.succeed(&["kernel", "--fps", "120", "--tile", "8x8x6"]);
    assert!(smaller.contains("box(3)"), "{smaller}");
    folder.fail(&["kernel", spec, "--fps", "120"], 2, &["SPEC says all", "leave out --fps"]);
    // Alone it shows the default tile's.
    let report: Value = serde_json::from_str(&folder.succeed(&["kernel", "--json"])).unwrap();
    let best = "0.84: gaussian(2.1) * fovvideovdp(60) @ 7x7x8 + 0.06: column + 0.1: box(8)";
    assert_eq!(report["kernel"], best);
    // Numbers go by the names of their flags.
    folder.fail(&["kernel", "--fps", "3"], 2, &["error: --fps is 3, but must be above 4"]);
    folder.fail(&["optimize", "--taa", "10"], 2, &["error: --taa is 10, but must be above 0"]);
    folder.fail(&["kernel", "--sigma", "0"], 2, &["error: --sigma is 0"]);
    folder.fail(&["kernel", "--pixels-per-degree=-1"], 2, &["sigma by --pixels-per-degree is"]);
    folder.fail(&["kernel", spec, "--json"], 2, &["--tile"]);
    folder.fail(&["kernel", spec, "--tile", "8x2x8", "--json"], 2, &["3 pixels high", "only 2"]);
}

#[test]
fn a_tile_is_scored_behind_the_kernel_that_it_was_made_for() {
    let folder = Folder::new();
    folder.small(&["--out", "a.npy"]);
    let quick = ["--integrands", "2"];
    let line = |more: &[&str]| {
        let printed = folder.succeed(&[&["evaluate"], more, &quick[..]].concat());
        printed.lines().next().unwrap().to_owned()
    };
    let own = "kernel      gaussian(1) * ema(0.5) @ 3x3x4 (from a.json)";
    assert_eq!(line(&["a.npy"]), own);
    let given = "kernel      gaussian(1) @ 3x3x1 (from --kernel)";
    assert_eq!(line(&["a.npy", "--kernel", "gaussian(1) @ 3x3x1"]), given);
    let watched = "kernel      gaussian(1) * fovvideovdp(24) * ema(0.5) @ 5x5x6 (from --fps 24 --taa 0.5 \
                   --sigma 1)";
    assert_eq!(line(&["a.npy", "--fps", "24", "--taa", "0.5", "--sigma", "1"]), watched);
    let both = ["evaluate", "a.npy", "--kernel", "none", "--taa", "0.1"];
    folder.fail(&both, 2, &["--kernel says all of the kernel: leave out --fps"]);
    folder.fail(&["report", "out", "a.npy", "--kernel", "none", "--fps", "90"], 2, &["leave out"]);
    let printed = folder.succeed(&[&["report", "out", "a.npy"], &quick[..]].concat());
    assert_eq!(printed, "kernel  gaussian(1) * ema(0.5) @ 3x3x4 (from a.json)\nout/index.html\n");

    // A sidecar that is damaged or another tile's is no error.
    let default = "kernel      gaussian(2.1) * fovvideovdp(60) @ 7x7x8 (the default";
    fs::copy(folder.path().join("a.json"), folder.path().join("b.json")).unwrap();
    folder.write("b.npy", npy("(4, 9, 8, 1, 2)", &[0.5; 576]));
    assert_eq!(line(&["b.npy"]), format!("{default}, as b.json is that of another tile)"));
    folder.write("b.json", "{");
    assert_eq!(line(&["b.npy"]), format!("{default}, as b.json cannot be read)"));
    fs::remove_file(folder.path().join("b.json")).unwrap();
    assert_eq!(line(&["b.npy"]), format!("{default})"));
    // The first tile that is named decides, and not the one that others are compared with.
    assert_eq!(line(&["a.npy", "--against", "b.npy"]), own);
}

#[test]
fn tiles_are_evaluated_and_exported() {
    let folder = Folder::new();
    folder.small(&["--out", "a.npy"]);
    folder.small(&["--out", "b.npy", "--seed", "9"]);
    let kernel = ["--kernel", "gaussian(1) * ema(0.5) @ 3x3x4", "--integrands", "16"];
    let table = folder.succeed(&[&["evaluate", "a.npy", "b.npy"], &kernel[..]].concat());
    assert!(table.contains("linear") && table.contains("residual"), "{table}");
    assert!(table.contains("of b's perceived error") && !table.contains("±0.0000"), "{table}");
    assert_eq!(table.matches("axis edge ").count(), 1, "{table}");
    let all = folder.succeed(&[&["evaluate", "a.npy", "b.npy", "--all"], &kernel[..]].concat());
    assert!(all.matches("axis edge ").count() > 3, "{all}");
    folder.fail(&["evaluate", "a.npy", "--integrands", "1e4"], 2, &["whole number in digits"]);
    folder.fail(
        &["evaluate", "a.png"],
        1,
        &["a.png is the picture of a tile, not a tile: give a.npy"],
    );
    folder.fail(&["evaluate", "a.json"], 1, &["raw volume with its .json: give a.npy"]);
    let json = folder.succeed(
        &[&["evaluate", "a.npy", "b.npy", "--json", "--baselines", "white"], &kernel[..]].concat(),
    );
    let report: Value = serde_json::from_str(&json).unwrap();
    let names: Vec<&str> =
        report["tiles"].as_array().unwrap().iter().map(|t| t["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["a", "b", "white"]);
    let linear = |tile: usize| {
        report["tiles"][tile]["scores"]["classes"][0]["perceived"]["mean"].as_f64().unwrap()
    };
    assert!((0..3).all(|tile| linear(tile) > 0.0));

    folder.succeed(&["export", "a.npy", "--format", "png16", "--out", "strip", "--strip"]);
    assert_eq!(folder.0.names("strip"), ["a.json", "a.png"]);
    let strip = folder.path().join("strip/a.png");
    assert_eq!(png_size(&fs::read(&strip).unwrap()), (8, 36));
    let source = TileSource { frames: Some(4), ..TileSource::new(strip) };
    let (read, written) = (source.read().unwrap(), folder.tile("a.npy").0);
    for (a, b) in read.samples().iter().zip(written.samples()) {
        assert!((a - b).abs() <= 0.5 / 65536.0);
    }
}

#[test]
fn a_tile_with_more_error_than_it_may_have_ends_the_command() {
    let folder = Folder::new();
    folder.small(&["--out", "a.npy"]);
    let noise = ["--kernel", "none", "--steps", "0", "--warp", "0", "--integrands", "0"];
    folder.succeed(&[&["optimize", "--tile", "8x9x4", "--out", "worse.npy"], &noise[..]].concat());
    let line = ["evaluate", "a.npy", "--integrands", "4", "--json", "--against", "worse.npy"];
    let json = folder.succeed(&line);
    let found: Value = serde_json::from_str(&json).unwrap();
    let found = &found["tiles"][1]["scores"]["classes"][0]["perceived"]["mean"];
    // The tile to compare with is not required to be as good.
    let most = format!("--require=linear<={found},axis-edge<=9");
    assert_eq!(folder.succeed(&[&line[..], &[&most]].concat()), json);
    let words = ["worse has ", " for linear, but --require says at most "];
    folder.fail(&[&line[..], &["worse.npy", &most]].concat(), 6, &words);
    for wrong in ["edge<0.1", "edges<=0.1", "edge<=nan", "edge"] {
        folder.fail(&[&line[..], &["--require", wrong]].concat(), 2, &[wrong, "CLASS<=SCORE"]);
    }
}

#[test]
fn presets_are_shown_as_they_are() {
    let folder = Folder::new();
    let shown: Value = serde_json::from_str(&folder.succeed(&["presets", "--json"])).unwrap();
    let table = folder.succeed(&["presets"]);
    assert_eq!(shown.as_array().unwrap().len(), Preset::ALL.len());
    for ((preset, name), shown) in Preset::ALL.into_iter().zip(shown.as_array().unwrap()) {
        let options = preset.options();
        let shape = options.shape;
        let size = format!("{}x{}x{}", shape.width(), shape.height(), shape.frames());
        let kernel = options.kernel.to_string();
        for (field, text) in [("preset", name), ("tile", &size), ("kernel", &kernel)] {
            assert_eq!(shown[field].as_str(), Some(text), "{name}");
        }
        let numbers = [
            ("spp", shape.spp()),
            ("dims", shape.dims()),
            ("steps", options.steps as usize),
            ("draws", options.draw.draws),
            ("directions", options.draw.directions),
            ("polish", options.polish.steps as usize),
        ];
        let mut row = format!("{name} {size}");
        for (field, number) in numbers {
            assert_eq!(shown[field].as_u64(), Some(number as u64), "{field} of {name}");
            row += &format!(" {number}");
        }
        row += &format!(" {}", shown["purpose"].as_str().unwrap());
        let words = |line: &str| line.split_whitespace().collect::<Vec<_>>().join(" ");
        for expected in [row, format!("{name} {kernel}")] {
            assert!(table.lines().any(|line| words(line) == expected), "no {expected}: {table}");
        }
    }
}

#[test]
fn an_export_needs_no_flags_and_keeps_the_provenance() {
    let folder = Folder::new();
    folder.small(&["--out", "a.npy"]);
    let printed = folder.succeed(&["export", "a.npy"]);
    assert_eq!(printed, "a-png8/a_f000.png … a-png8/a_f003.png (4 files)\n");
    assert_eq!(folder.0.names("a-png8").len(), 5);
    assert_eq!(folder.read("a-png8/a.json"), folder.read("a.json"));
    folder.succeed(&["export", "a.npy", "--format", "png16"]);
    assert_eq!(folder.0.names("a-png16").len(), 5);
    let printed = folder.succeed(&["evaluate", "a-png8", "--integrands", "2"]);
    let kernel = "kernel      gaussian(1) * ema(0.5) @ 3x3x4 (from a-png8/a.json)\n";
    assert!(printed.starts_with(kernel), "{printed}");

    // What stands there stays.
    folder.fail(&["export", "a.npy"], 3, &["a-png8/a.json exists already", "--force"]);
    folder.succeed(&["export", "a.npy", "--force"]);
    folder.write("a-png8/mine.png", "precious");
    folder.fail(&["export", "a.npy", "--force"], 3, &["mine.png", "choose another folder"]);

    // Where the tile is, its sidecar is already.
    let own = folder.read("a.json");
    folder.succeed(&["export", "a.npy", "--out", ".", "--strip", "--force"]);
    assert_eq!(folder.read("a.json"), own);

    // The sidecar of another tile does not go along.
    folder.write("b.npy", npy("(4, 9, 8, 1, 2)", &[0.5; 576]));
    fs::copy(folder.path().join("a.json"), folder.path().join("b.json")).unwrap();
    folder.succeed(&["export", "b.npy"]);
    assert_eq!(folder.0.names("b-png8").len(), 4);
}

#[test]
fn shells_and_manuals_are_told_all_commands() {
    let folder = Folder::new();
    for shell in ["bash", "zsh", "fish"] {
        let text = folder.succeed(&["completions", shell]);
        assert!(
            ["evaluate", "integrands", "presets"].iter().all(|it| text.contains(it)),
            "{shell}"
        );
    }
    folder.fail(&["completions", "tcsh"], 2, &["tcsh", "bash"]);
    assert!(folder.succeed(&["man"]).starts_with(".ie"));
    assert!(folder.names().is_empty());
    folder.succeed(&["man", "pages"]);
    let pages = folder.0.names("pages");
    for page in ["perceptile.1", "perceptile-optimize.1", "perceptile-presets.1"] {
        assert!(pages.iter().any(|name| name == page), "no {page} in {pages:?}");
    }
    assert!(!pages.iter().any(|name| name.contains("worker")), "{pages:?}");
    folder.write("pages/perceptile.1", "precious");
    folder.fail(&["man", "pages"], 3, &["perceptile", "exists already", "--force"]);
    folder.succeed(&["man", "pages", "--force"]);
    assert_ne!(folder.read("pages/perceptile.1"), b"precious");
}

/// Pieces of which arguments are made, sensible and not.
fn nonsense() -> impl Strategy<Value = String> {
    let piece = prop_oneof![
        prop::sample::select(
            &[
                "gaussian(",
                "fovvideovdp(",
                "ema(",
                "box(",
                "none",
                "column",
                "frame",
                "table(\"",
                "1e308",
                "1e-308",
                "0",
                "1",
                "60",
                "16384",
                "999999999999",
                "-",
                "x",
                "*",
                "+",
                "@",
                ":",
                "%",
                ")",
                ",",
                "radius=",
                "8x8x8",
                "0.5",
                "nan",
                "inf",
                " ",
                "s",
                "m",
                "h",
            ][..]
        )
        .prop_map(str::to_owned),
        "[^\\x00]",
    ];
    prop::collection::vec(piece, 0..12).prop_map(|pieces| pieces.concat())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(150))]

    #[test]
    fn nothing_that_is_typed_makes_the_command_panic(word in nonsense(), which in 0..5) {
        let folder = Folder::new();
        let equals = |flag: &str| format!("--{flag}={word}");
        let args = match which {
            0 => vec!["kernel".to_owned(), "--json".to_owned(), "--".to_owned(), word],
            1 => vec!["optimize".to_owned(), "--dry-run".to_owned(), equals("kernel")],
            2 => vec!["optimize".to_owned(), "--dry-run".to_owned(), equals("tile")],
            3 => vec!["optimize".to_owned(), "--dry-run".to_owned(), equals("time")],
            _ => vec!["kernel".to_owned(), "--json".to_owned(), "box(2)".to_owned(), equals("tile")],
        };
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let output = folder.run(&args);
        let error = text(&output.stderr);
        prop_assert!(matches!(output.status.code(), Some(0 | 1 | 2 | 4)), "{args:?}: {error}");
        prop_assert!(!error.contains("panicked"), "{args:?}: {error}");
    }
}

/// A profile that takes as little time as one can.
const PROFILE: &[&str] = &[
    "profile",
    "--tile",
    "24x20x4",
    "--kernel",
    "gaussian(1) * ema(0.5) @ 3x3x4",
    "--draws",
    "64",
    "--threads",
    "2",
    "--measure",
    "0.05",
];

const STAGES: [&str; 9] =
    ["draws", "gather", "project", "rank", "transport", "scatter", "reduce", "adam", "waiting"];

#[test]
fn a_profile_shows_all_stages_layouts_and_counters() {
    let folder = Folder::new();
    let table = folder.succeed(PROFILE);
    for stage in STAGES {
        let shown = |line: &&str| line.starts_with(&format!("{stage} "));
        assert!(table.lines().any(|line| shown(&line)), "no {stage} in {table}");
    }
    for layout in ["linear", "rows", "bricks", "curve"] {
        for order in ["sorted", "unsorted"] {
            let shown = |line: &str| line.split_whitespace().take(2).eq([layout, order]);
            assert!(table.lines().any(shown), "no {layout}, {order} in {table}");
        }
    }
    for words in ["hardware counters", "advice\n- ", "reuse of lines", "takes most"] {
        assert!(table.contains(words), "no {words:?} in {table}");
    }
    // Each counter, or once why there is none.
    let counters = ["cycles", "TLB read misses"].iter().all(|name| table.contains(name));
    assert!(counters || table.contains("none on this machine ("), "{table}");
    assert_eq!(table.matches("os error").count(), usize::from(!counters), "{table}");
    let first = table.lines().next().unwrap();
    assert!(first.contains(" ms a step: 16000 steps take "), "{first}");
    // It makes no tile.
    assert!(folder.names().is_empty());
}

#[test]
fn a_profile_takes_how_the_animation_is_watched_and_its_own_flags_come_first() {
    let folder = Folder::new();
    let watched = ["profile", "--tile", "24x20x4", "--draws", "64", "--measure", "0.05", "--json"];
    let json = folder.succeed(&[&watched[..], &["--fps", "24", "--sigma", "1"]].concat());
    let profile: Value = serde_json::from_str(&json).unwrap();
    let kernel = profile["kernel"].as_str().unwrap();
    assert!(kernel.contains("gaussian(1) * fovvideovdp(24)"), "{kernel}");
    let help = folder.succeed(&["profile", "--help"]);
    assert!(help.find("--trace").unwrap() < help.find("--preset").unwrap(), "{help}");
}

#[test]
fn a_profile_as_json_adds_up() {
    let folder = Folder::new();
    let text = folder.succeed(&[PROFILE, &["--json"]].concat());
    let profile: Value = serde_json::from_str(&text).unwrap();
    let number = |value: &Value| value.as_f64().unwrap_or_else(|| panic!("{value}"));
    let sum = |value: &Value| value.as_array().unwrap().iter().map(number).sum::<f64>();
    assert_eq!(profile["format"], 2);
    let stages = profile["stages"].as_array().unwrap();
    assert!(stages.iter().map(|row| row["stage"].as_str().unwrap()).eq(STAGES));

    // Stages, waiting and the clock are all the time of both threads.
    let probed = &profile["probed"];
    let wall = 2.0 * 1e9 * number(&probed["timing"]["seconds"]);
    let all = stages.iter().map(|row| number(&row["nanoseconds"])).sum::<f64>();
    let clock = sum(&probed["clock"]);
    assert!((all + clock - wall).abs() < 0.01 * wall, "{all} + {clock}, not {wall}");
    let threads = probed["threads"].as_array().unwrap();
    assert_eq!(threads.len(), 2);
    assert!((threads.iter().map(sum).sum::<f64>() - all).abs() < 1e-6 * all);
    let shares = stages.iter().map(|row| number(&row["share"])).sum::<f64>();
    assert!((shares - 1.0).abs() < 1e-9);

    let subsets = &profile["subsets"];
    let samples = number(&subsets["samples"]) * 64.0;
    assert!((number(&stages[1]["samples"]) - samples).abs() < 1e-6 * samples);
    assert!((number(&stages[1]["read"]) - 8.0 * samples).abs() < 1e-6 * samples);
    let layouts = profile["layouts"].as_array().unwrap();
    assert_eq!(layouts.len(), 8);
    assert!(layouts.iter().all(|row| number(&row["ratio"]) >= 1.0));
    assert_eq!(layouts.iter().filter(|row| row["measured"].is_number()).count(), 3);
    for counter in profile["counters"].as_array().unwrap() {
        let reading = &counter["reading"];
        let told = reading["count"]["events"].is_u64();
        assert!(told || !reading["unavailable"]["reason"].as_str().unwrap().is_empty());
        assert_eq!(told, counter["per_draw"].is_number());
    }
}

#[test]
fn a_profile_leaves_a_trace_and_a_picture_and_replaces_nothing() {
    let folder = Folder::new();
    let args = [PROFILE, &["--trace", "trace.json", "--svg", "picture.svg"]].concat();
    folder.succeed(&args);
    assert_eq!(folder.names(), ["picture.svg", "trace.json"]);
    let picture = text(&folder.read("picture.svg"));
    assert!(picture.starts_with("<svg") && picture.trim_end().ends_with("</svg>"));
    assert!(picture.contains("rank") && picture.contains("unsorted draws"));

    let trace: Value = serde_json::from_slice(&folder.read("trace.json")).unwrap();
    assert_eq!(trace["otherData"]["dropped"], 0);
    let events = trace["traceEvents"].as_array().unwrap();
    let named = |name: &str| -> std::vec::IntoIter<&Value> {
        let named: Vec<&Value> = events.iter().filter(|event| event["name"] == name).collect();
        named.into_iter()
    };
    let tracks: Vec<&str> =
        named("thread_name").map(|event| event["args"]["name"].as_str().unwrap()).collect();
    assert_eq!(tracks, ["steps", "thread 0", "thread 1"]);
    let ends = |event: &Value| {
        let start = event["ts"].as_f64().unwrap();
        (start, start + event["dur"].as_f64().unwrap())
    };
    let steps: Vec<(f64, f64)> =
        (0..12).map(|step| ends(named(&format!("step {step}")).next().unwrap())).collect();
    assert!(steps.windows(2).all(|pair| pair[0].1 <= pair[1].0));
    // Each piece of work lies within its step, and stages within a piece of their thread.
    let mut pieces = Vec::new();
    for event in named("gradient").chain(named("update")) {
        let (begin, end) = steps[event["args"]["step"].as_u64().unwrap() as usize];
        let (from, to) = ends(event);
        assert!(begin <= from && to <= end + 1e-3, "{event}");
        pieces.push((&event["tid"], from, to));
    }
    // Four cells (at most as many blocks), 20 lines, in each of the steps.
    assert!(named("gradient").count() <= 48 && named("update").count() == 12 * 20);
    for stage in &STAGES[..8] {
        assert!(named(stage).count() > 0, "no {stage}");
        for event in named(stage) {
            let (from, to) = ends(event);
            let within = |&(tid, begin, end): &(&Value, f64, f64)| {
                *tid == event["tid"] && begin <= from && to <= end + 1e-3
            };
            assert!(pieces.iter().any(within), "{event}");
        }
    }

    folder.write("picture.svg", "kept");
    folder.fail(&args, 3, &["trace.json exists already", "--force"]);
    folder.fail(&[PROFILE, &["--svg", "picture.svg"]].concat(), 3, &["picture.svg exists"]);
    assert_eq!(folder.read("picture.svg"), b"kept");
    folder.succeed(&[PROFILE, &["--svg", "picture.svg", "--force"]].concat());
    assert!(text(&folder.read("picture.svg")).starts_with("<svg"));
}

#[test]
fn a_profile_of_workers_tells_of_each() {
    let folder = Folder::new();
    // Long enough for a coordinator on a busy machine to see the descent, whose time it takes.
    let args = ["--measure", "1", "--workers", "2", "--json", "--trace", "trace.json"];
    let args = [&PROFILE[..PROFILE.len() - 2], &args].concat();
    let profile: Value = serde_json::from_str(&folder.succeed(&args)).unwrap();
    let crew = &profile["workers"];
    assert_eq!(crew["threads"], 2);
    let number = |value: &Value| value.as_f64().unwrap();
    assert!(number(&crew["synchronisation"]) > 0.0 && number(&crew["step"]) > 0.0, "{crew}");
    assert!(number(&crew["workers"]["imbalance"]) >= 1.0, "{crew}");
    let workers = crew["workers"]["workers"].as_array().unwrap();
    assert_eq!(workers.len(), 2);
    // Each job of each step is somebody's: blocks of cells, and lines.
    let jobs: u64 = workers.iter().map(|worker| worker["jobs"].as_u64().unwrap()).sum();
    let steps = crew["steps"].as_u64().unwrap();
    assert!(jobs >= steps * (1 + 20), "{jobs} jobs of {steps} steps");
    assert!(workers.iter().map(|worker| number(&worker["busy"])).sum::<f64>() > 0.0);

    let trace: Value = serde_json::from_slice(&folder.read("trace.json")).unwrap();
    let events = trace["traceEvents"].as_array().unwrap();
    let named = events.iter().filter(|event| event["name"] == "thread_name");
    let names: Vec<&str> = named.map(|event| event["args"]["name"].as_str().unwrap()).collect();
    let expected = [(0, 0), (0, 1), (1, 0), (1, 1)];
    assert_eq!(names, expected.map(|(worker, thread)| format!("worker {worker}, thread {thread}")));
    let updates = events.iter().filter(|event| event["name"] == "update").count();
    assert!(updates > 0);

    let text = folder.succeed(&[PROFILE, &["--workers", "2"]].concat());
    assert!(text.contains("2 workers of 2 threads") && text.contains("worker 1"), "{text}");
}

#[test]
fn a_profile_of_what_cannot_be_run_says_so() {
    let folder = Folder::new();
    let with = |more: &[&'static str]| [PROFILE, more].concat();
    folder.fail(&with(&["--measure", "0.2", "--measure", "0"]), 2, &["--measure"]);
    for wrong in ["0", "-1", "nan", "1e9", "soon"] {
        let flag = format!("--measure={wrong}");
        let args: Vec<&str> =
            PROFILE[..PROFILE.len() - 2].iter().copied().chain([&*flag]).collect();
        folder.fail(&args, 2, &["--measure", wrong]);
    }
    let plain = |more: &[&'static str]| [&["profile"], more].concat();
    folder.fail(&plain(&["--threads", "100000"]), 2, &["100000 threads are too many"]);
    folder.fail(&plain(&["--axis-share", "2"]), 2, &["axis"]);
    folder.fail(&plain(&["--tile", "2x2x2"]), 2, &["kernel"]);
    folder.fail(&plain(&["--workers", "5000"]), 2, &["5000 workers are too many"]);
    folder.fail(&plain(&["--tile", "60000x60000x60"]), 4, &["memory"]);
    folder.fail(&plain(&["--svg", "nowhere/picture.svg"]), 1, &["no folder"]);
    folder.fail(&plain(&["--svg", "a.json", "--trace", "./a.json"]), 1, &["two outputs"]);
}
