//! The cache model against a tool that is not ours.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use serde_json::Value;
use tempfile::TempDir;

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
    let run = Command::new("valgrind")
        .args(["--tool=cachegrind", "--cache-sim=yes", "--I1=32768,8,64"])
        .arg(format!("--D1={D1}"))
        .arg(format!("--LL={last}"))
        .arg(format!("--cachegrind-out-file={}", out.display()))
        .arg(example("replay"))
        .args([D1, L2, L3])
        .output()
        .unwrap();
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
