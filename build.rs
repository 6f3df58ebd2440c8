//! Says which commit the command is built from, for `perceptile --version` and nothing else: tiles and
//! what is written beside them know the version alone.
//!
//! Without git, or where the package is not a checkout of its own, as when it comes from a registry,
//! the commit is left out. It is asked for when the program itself has changed: a commit that changes
//! tests or pages alone builds nothing anew, and the version goes on naming the one before it.

use std::path::Path;
use std::process::Command;

fn main() {
    for program in ["build.rs", "Cargo.toml", "src"] {
        println!("cargo::rerun-if-changed={program}");
    }
    let version = env!("CARGO_PKG_VERSION");
    // Only the command prints it.
    let commit = std::env::var_os("CARGO_FEATURE_CLI").and_then(|_| commit());
    let commit = commit.map(|commit| format!(" ({commit})")).unwrap_or_default();
    println!("cargo::rustc-env=PERCEPTILE_VERSION={version}{commit}");
}

/// The commit that is checked out, if the package is the root of a checkout.
fn commit() -> Option<String> {
    let root = git(&["rev-parse", "--show-toplevel"])?;
    let package = Path::new(env!("CARGO_MANIFEST_DIR")).canonicalize().ok()?;
    if Path::new(&root).canonicalize().ok()? != package {
        return None;
    }
    git(&["rev-parse", "--short=7", "HEAD"])
}

/// What git answers, if it does.
fn git(words: &[&str]) -> Option<String> {
    let output = Command::new("git").args(words).output().ok()?;
    let answer = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| answer.trim().to_owned())
}
