//! The profile's models: the caches against a tool that is not ours, accesses and traffic against
//! loops over pixels.

use std::collections::{HashMap, HashSet};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use perceptile::draw::LevelSets;
use perceptile::gradient::probe::Stage;
use perceptile::profile::access::{self, Arrangement, DrawOrder};
use perceptile::profile::machine::Machine;
use perceptile::profile::subject::Subject;
use perceptile::profile::traffic;
use perceptile::solver::Preset;
use perceptile::tile::TileShape;
use serde_json::Value;
use tempfile::TempDir;

use crate::child::output;

/// The caches, smaller than real ones, so that a short stream fills them.
const D1: &str = "32768,8,64";
const L2: &str = "262144,8,64";
const L3: &str = "786432,12,64";

/// The example beside this test's binary.
fn example(name: &str) -> PathBuf {
    let mut path = std::env::current_exe().unwrap();
    path.pop();
    path.pop();
    path.join("examples").join(name)
}

/// Misses of the function `replay::replay` in a file of cachegrind: those of D1 and of LL.
fn misses(file: &str) -> [u64; 2] {
    let header = file.lines().find_map(|line| line.strip_prefix("events:")).unwrap();
    let events: Vec<&str> = header.split_whitespace().collect();
    let mut inside = false;
    let mut sums = vec![0_u64; events.len()];
    for line in file.lines() {
        if let Some(function) = line.strip_prefix("fn=") {
            // Versions of valgrind that do not know Rust's names leave a hash at the end.
            inside = function == "replay::replay" || function.starts_with("replay::replay::h");
        } else if inside && line.starts_with(|c: char| c.is_ascii_digit()) {
            // The number of the source line, then the events; those that are left out are zero.
            for (sum, count) in sums.iter_mut().zip(line.split_whitespace().skip(1)) {
                *sum += count.parse::<u64>().unwrap();
            }
        }
    }
    let sum = |names: [&str; 2]| {
        names.iter().map(|name| sums[events.iter().position(|event| event == name).unwrap()]).sum()
    };
    [sum(["D1mr", "D1mw"]), sum(["DLmr", "DLmw"])]
}

/// Runs the example under cachegrind with a last level; returns the model's misses of all levels
/// and cachegrind's of its two.
fn run(last: &str) -> (Vec<u64>, [u64; 2]) {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("cachegrind.out");
    let mut command = Command::new("valgrind");
    command
        .args(["--tool=cachegrind", "--cache-sim=yes", "--I1=32768,8,64"])
        .arg(format!("--D1={D1}"))
        .arg(format!("--LL={last}"))
        .arg(format!("--cachegrind-out-file={}", out.display()))
        .arg(example("replay"))
        .args([D1, L2, L3]);
    let run = output(&mut command);
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    let model: Value = serde_json::from_slice(&run.stdout).unwrap();
    let levels = model["levels"].as_array().unwrap();
    let model = levels.iter().map(|level| level["misses"].as_u64().unwrap()).collect();
    (model, misses(&std::fs::read_to_string(out).unwrap()))
}

#[test]
fn the_cache_model_agrees_with_cachegrind() {
    let version = Command::new("valgrind").arg("--version").stdout(Stdio::null()).status();
    if !version.is_ok_and(|status| status.success()) {
        return println!("skipped: valgrind is not installed");
    }
    // Tests of this file alone do not build examples; those of the package do.
    let replay = example("replay");
    assert!(replay.exists(), "{} is missing: cargo build --examples makes it", replay.display());
    let ((model, [d1, l3]), (again, [d1_again, l2])) = std::thread::scope(|scope| {
        let other = scope.spawn(|| run(L2));
        (run(L3), other.join().unwrap())
    });
    println!("model {model:?}, {again:?}; cachegrind D1 {d1}, {d1_again}, L2 {l2}, L3 {l3}");
    // Each level has to have hits and misses of its own, or agreeing on it says nothing.
    let [first, second, third] = model[..] else { panic!("{model:?}") };
    assert!(first * 9 > second * 10 && second * 9 > third * 10 && third > 100_000, "{model:?}");
    for (model, found) in [(first, d1), (again[0], d1_again), (again[1], l2), (third, l3)] {
        assert!(model.abs_diff(found) * 5 <= found, "the model has {model}, cachegrind {found}");
    }
}

/// A descent on a tile that is small and no multiple of anything.
fn subject() -> Subject {
    let mut options = Preset::Quick.options();
    options.shape = TileShape::new(21, 19, 5, 2, 2).unwrap();
    options.kernel = "gaussian(1) * fovvideovdp(24) @ 5x3x5".parse().unwrap();
    options.draw.draws = 60;
    let kernel = options.kernel.resolve(options.shape).unwrap();
    Subject::new(&options, &kernel, 1).unwrap()
}

/// Calls `visit(x, y, t, draw)` for every pixel of every draw of a step, before it is wrapped in x
/// and y.
fn pixels(subject: &Subject, step: u32, mut visit: impl FnMut(i64, i64, i64, usize)) {
    let kernel = subject.options().kernel.resolve(subject.shape()).unwrap();
    let levels = LevelSets::of(&kernel, subject.shape().spp());
    let mut number = 0;
    for cell in 0..subject.partition().cells() {
        let place = subject.partition().cell(cell);
        for draw in subject.cell_draws(step, cell).draws {
            for offset in &levels.sets()[draw.set as usize].offsets[..draw.taps as usize] {
                visit(
                    (place.x + draw.x as usize) as i64 + i64::from(offset.x),
                    (place.y + draw.y as usize) as i64 + i64::from(offset.y),
                    (i64::from(draw.t) + i64::from(offset.z)).rem_euclid(5),
                    number,
                );
            }
            number += 1;
        }
    }
}

#[test]
fn lines_and_pages_of_a_draw_are_those_of_its_pixels() {
    let subject = subject();
    let levels = Machine::detect().levels();
    let line = i64::from(levels[0].line);
    let found = access::compare(&subject, &levels).unwrap();
    let shape = subject.shape();
    let (width, height) = (shape.width() as i64, shape.height() as i64);
    let (rows, reach) = (subject.rows(), subject.rows().reach());
    let bytes = (rows.pixel() * 4) as i64;
    let linear = |x: i64, y: i64, t: i64| {
        (((t * height) + y.rem_euclid(height)) * width + x.rem_euclid(width)) * bytes
    };
    let in_rows = |x: i64, y: i64, t: i64| {
        let row = (reach.up as i64 + y) * 5 + t;
        row * rows.stride() as i64 * 4 + (reach.left as i64 + x) * bytes
    };
    let check = |arrangement, address: &dyn Fn(i64, i64, i64) -> i64| {
        let (mut lines, mut pages) = (HashSet::new(), HashSet::new());
        let mut draws = HashSet::new();
        let mut fewest = HashMap::<_, i64>::new();
        // Enough steps for a comparison never come together here, so it takes all of them.
        for step in 1..=16 {
            pixels(&subject, step, |x, y, t, draw| {
                let first = address(x, y, t);
                for byte in first..first + bytes {
                    lines.insert((step, draw, byte / line));
                    pages.insert((step, draw, byte / 4096));
                }
                draws.insert((step, draw));
                *fewest.entry((step, draw)).or_default() += bytes;
            });
        }
        let all = draws.len() as f64;
        let fewest: i64 = fewest.into_values().map(|bytes| (bytes + line - 1) / line).sum();
        for order in DrawOrder::ALL {
            let of =
                |row: &&access::Behaviour| (row.arrangement, row.order) == (arrangement, order);
            let row = found.iter().find(of).unwrap();
            let expected = [
                all,
                lines.len() as f64 / all,
                pages.len() as f64 / all,
                lines.len() as f64 / fewest as f64,
            ];
            let label = format!("{arrangement:?} {order:?}");
            let found = [row.draws as f64, row.lines, row.pages, row.ratio];
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-9, "{label}: {found}, not {expected}");
            }
        }
    };
    check(Arrangement::Linear, &linear);
    check(Arrangement::Rows, &in_rows);
    // A line is used for the first time in a draw before it is used again.
    for row in &found {
        let uses = row.reuse.cold + row.reuse.bins.iter().sum::<u64>();
        assert!(uses as f64 >= 3.0 * row.lines * row.draws as f64 - 0.5, "{row:?}");
        assert!(row.misses()[0] >= row.misses()[1] && row.misses()[1] >= row.misses()[2]);
        let copies = matches!(row.arrangement, Arrangement::Bricks | Arrangement::Curve);
        assert!(copies || row.copy == [0.0; 3]);
    }
}

#[test]
fn traffic_is_what_loops_over_pixels_and_patches_move() {
    let subject = subject();
    let (traffic, subsets) = traffic::count(&subject, 1);
    let mut samples = 0;
    pixels(&subject, 0, |_, _, _, _| samples += 2);
    assert_eq!(subsets.draws, 60);
    assert!((subsets.samples * 60.0 - f64::from(samples)).abs() < 1e-6);
    let words = f64::from(samples) * 2.0;
    let reach = subject.partition().reach();
    let patches: usize = subject
        .blocks()
        .iter()
        .map(|block| {
            let place = block.place();
            let width = reach.left + place.width + reach.right;
            width * (reach.up + place.height + reach.down) * 5 * 4
        })
        .sum();
    let (patches, all) = (patches as f64, subject.shape().coordinates() as f64);
    let bytes = |stage: Stage| traffic[stage as usize].bytes();
    assert_eq!(bytes(Stage::Gather), 4.0 * 2.0 * words);
    assert_eq!(bytes(Stage::Scatter), 4.0 * (3.0 * words + patches));
    assert_eq!(bytes(Stage::Reduce), 4.0 * (3.0 * patches + all));
    assert_eq!(bytes(Stage::Adam), 4.0 * 7.0 * all);
    assert_eq!(traffic[Stage::Adam as usize].operations, 16.0 * all);
    assert_eq!(bytes(Stage::Waiting), 0.0);
}

#[test]
fn scaling_shows_tables_up_to_the_last_cell_and_a_picture() {
    let folder = TempDir::new().unwrap();
    let picture = folder.path().join("scaling.svg");
    let run = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_perceptile"));
        command.args(["profile", "--scaling", "--measure", "0.01", "--threads", "1"]);
        command.args(["--tile", "64x32x8", "--kernel", "gaussian(1) @ 5x5x4", "--draws", "100"]);
        output(command.args(["--most-ranks", "16"]).args(arguments))
    };
    let out = run(&["--json", "--rank-threads", "1", "--picture", picture.to_str().unwrap()]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let found: Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(found["tiles"].as_array().unwrap().len(), 1);
    let tile = &found["tiles"][0];
    for cost in ["sample", "coordinate", "patch_word", "packed_byte", "unpacked_byte", "round"] {
        let cost = tile["measured"]["costs"][cost].as_f64().unwrap();
        // Of seconds, as on a busy machine even a round takes less; nanoseconds would be more.
        assert!(cost > 0.0 && cost < 0.1, "{cost}");
    }
    let rows = |table: &str| tile[table]["rows"].as_array().unwrap().clone();
    let ranks: Vec<u64> = rows("strong").iter().map(|row| row["ranks"].as_u64().unwrap()).collect();
    assert_eq!(ranks, [1, 2, 4, 8, 16]);
    // Eight cells.
    assert!(rows("strong")[..4].iter().all(|row| row["step"]["seconds"].as_f64().unwrap() > 0.0));
    assert_eq!(
        (&rows("strong")[4]["step"], &rows("strong")[4]["cells"]),
        (&Value::Null, &8.into())
    );
    let cores = std::thread::available_parallelism().unwrap().get() as u64;
    for row in rows("strong") {
        assert_eq!(row["extrapolated"], row["ranks"].as_u64().unwrap() > cores);
    }
    let last = &rows("weak")[4];
    assert_eq!((&last["shape"]["width"], &last["shape"]["height"]), (&256.into(), &128.into()));
    assert_eq!(last["step"]["region"], serde_json::json!([64, 32]));
    let picture = std::fs::read_to_string(picture).unwrap();
    assert!(picture.contains("64x32x8") && picture.contains("ideal"));

    let text = String::from_utf8(run(&["--latency", "5us"]).stdout).unwrap();
    for part in ["messages of 5.00 us", "16 threads", "no more cells", "Stops at its 8 cells"] {
        assert!(text.contains(part), "{part} in {text}");
    }
    for wrong in [["--bandwidth", "12"], ["--workers", "2"], ["--trace", "trace.json"]] {
        assert_eq!(run(&wrong).status.code(), Some(2), "{wrong:?}");
    }
}
