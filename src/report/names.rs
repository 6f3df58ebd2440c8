//! Names of files without their folders.
//!
//! A report is sent to others, and where files lie on the machine that made it is not theirs to
//! know. The commands that it shows work in the folder of the files all the same.

use std::path::{Path, is_separator};

/// The last part of a path.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// A command or a kernel whose files have lost their folders.
///
/// Between quotes, a path may have spaces; elsewhere it ends at one.
pub(super) fn without_folders(text: &str) -> String {
    let mut short = String::with_capacity(text.len());
    let mut quotes: Vec<char> = Vec::new();
    let mut word = String::new();
    for c in text.chars() {
        let is_quote = c == '\'' || c == '"';
        if is_quote || (quotes.is_empty() && (c.is_whitespace() || "=(),".contains(c))) {
            short += last_part(&word);
            short.push(c);
            word.clear();
        } else {
            word.push(c);
        }
        if is_quote {
            match quotes.last() {
                Some(&open) if open == c => _ = quotes.pop(),
                _ => quotes.push(c),
            }
        }
    }
    short + last_part(&word)
}

/// What stands behind the last separator; a name like a flag's keeps the `./` that tells it apart.
fn last_part(word: &str) -> &str {
    let end = word.trim_end_matches(is_separator).len();
    let Some(at) = word[..end].rfind(is_separator) else { return word };
    let name = &word[at + 1..];
    if name.starts_with('-') && word[..at].ends_with('.') { &word[at - 1..] } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_folders_go() {
        for (text, short) in [
            ("perceptile report OUT a.npy", "perceptile report OUT a.npy"),
            ("report OUT /home/me/a.npy ../b.npy ./-x", "report OUT a.npy b.npy ./-x"),
            ("--renders shots/ --taa 0.2", "--renders shots/ --taa 0.2"),
            ("--renders my/shots/ --taa 0.2", "--renders shots/ --taa 0.2"),
            ("'/home/my self/a b.npy' --start=x/y.npy", "'a b.npy' --start=y.npy"),
            (
                "--kernel 'table(\"/k 1/g.npy\", origin=(0, 1, 1)) * ema(0.2) @ 7x7x8'",
                "--kernel 'table(\"g.npy\", origin=(0, 1, 1)) * ema(0.2) @ 7x7x8'",
            ),
            ("table(\"k/g.npy\", origin=(0, 1, 1))", "table(\"g.npy\", origin=(0, 1, 1))"),
            ("", ""),
        ] {
            assert_eq!(without_folders(text), short);
        }
        assert_eq!(file_name(Path::new("a/b.npy")), "b.npy");
        assert_eq!(file_name(Path::new("/")), "/");
    }
}
