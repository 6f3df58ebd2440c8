//! Says which commit the command is built from, for `perceptile --version` and nothing else: tiles and
//! what is written beside them know the version alone.
//!
//! Without git, or where the package is not a checkout of its own, as when it comes from a registry,
//! the commit is left out.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let version = env!("CARGO_PKG_VERSION");
    // Only the command prints it.
    let commit = std::env::var_os("CARGO_FEATURE_CLI").and_then(|_| commit());
    let commit = commit.map(|commit| format!(" ({commit})")).unwrap_or_default();
    println!("cargo::rustc-env=PERCEPTILE_VERSION={version}{commit}");
}

/// The commit that is checked out, if the package is the root of a checkout. Asks cargo to come back
/// when another one is.
fn commit() -> Option<String> {
    let root = git(&["rev-parse", "--show-toplevel"])?;
    let package = Path::new(env!("CARGO_MANIFEST_DIR")).canonicalize().ok()?;
    if Path::new(&root).canonicalize().ok()? != package {
        return None;
    }
    // `HEAD` itself changes with the branch only; its log has a line for each commit as well.
    for file in ["HEAD", "logs/HEAD"] {
        let path = git(&["rev-parse", "--git-path", file])?;
        if package.join(&path).exists() {
            println!("cargo::rerun-if-changed={path}");
        }
    }
    git(&["rev-parse", "--short=7", "HEAD"])
}

/// What git answers, if it does.
fn git(words: &[&str]) -> Option<String> {
    let output = Command::new("git").args(words).output().ok()?;
    let answer = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| answer.trim().to_owned())
}
