//! README and the manual: links lead somewhere, and the command understands what they tell to type.
//!
//! Of the commands in `sh` blocks only those of a block that starts with `sh run` do their work. The
//! others are tried without the files that they name, or as a dry run: that shows whether their
//! options exist and fit together.

use std::collections::HashMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::tool::{PROGRAM, Room};

/// Most lines of README, which is for the first five minutes.
const MOST_LINES: usize = 250;

/// Where the repository is.
fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// What people read, by its path in the repository.
fn pages() -> Vec<(PathBuf, Page)> {
    let names = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md"];
    let manual = fs::read_dir(root().join("docs")).unwrap().map(|entry| entry.unwrap().path());
    let manual = manual.filter(|path| path.extension().is_some_and(|it| it == "md"));
    let mut paths: Vec<PathBuf> =
        names.iter().map(|name| root().join(name)).chain(manual).collect();
    paths.sort();
    let page = |path: PathBuf| {
        let text = fs::read_to_string(&path).unwrap();
        let name = path.strip_prefix(root()).unwrap().to_owned();
        (name, Page::parse(&text))
    };
    paths.into_iter().map(page).collect()
}

/// A page of Markdown.
#[derive(Debug, Default)]
struct Page {
    /// What links to a part of it end in, after `#`.
    anchors: Vec<String>,
    /// Where its links lead.
    links: Vec<String>,
    /// Its blocks of code: what stands behind the fence, and what is inside.
    blocks: Vec<(String, String)>,
}

impl Page {
    fn parse(text: &str) -> Self {
        let mut page = Self::default();
        let mut headings = Vec::new();
        let mut prose = String::new();
        let mut lines = text.lines();
        while let Some(line) = lines.next() {
            if let Some(info) = line.trim_start().strip_prefix("```") {
                let is_inside = |line: &&str| line.trim() != "```";
                let block: Vec<&str> = lines.by_ref().take_while(is_inside).collect();
                page.blocks.push((info.trim().to_owned(), block.join("\n")));
                continue;
            }
            if line.starts_with('#') {
                headings.push(line.trim_start_matches('#').trim());
            }
            prose.push_str(line);
            prose.push('\n');
        }
        page.anchors = anchors(&headings);
        page.links = links(&prose);
        page
    }
}

/// GitHub's anchors of headings: letters, digits, `-` and `_` in small letters, with `-` for each
/// space, and a number behind those that were there before.
fn anchors(headings: &[&str]) -> Vec<String> {
    let mut seen: HashMap<String, usize> = HashMap::new();
    let anchor = |heading: &&str| {
        let name: String = without_targets(heading)
            .chars()
            .filter(|it| it.is_alphanumeric() || matches!(it, '-' | '_' | ' '))
            .flat_map(char::to_lowercase)
            .map(|it| if it == ' ' { '-' } else { it })
            .collect();
        let count = seen.entry(name.clone()).or_default();
        *count += 1;
        if *count == 1 { name } else { format!("{name}-{}", *count - 1) }
    };
    headings.iter().map(anchor).collect()
}

/// A heading in which of each link only the words are left.
fn without_targets(heading: &str) -> String {
    let mut parts = heading.split("](");
    let mut words = parts.next().unwrap_or_default().to_owned();
    words.extend(parts.map(|part| part.split_once(')').map_or(part, |(_, rest)| rest)));
    words
}

/// Where the links and pictures of a text lead. What stands in code leads nowhere.
fn links(prose: &str) -> Vec<String> {
    let text = without_code(prose);
    let targets = text.split("](").skip(1).filter_map(|rest| rest.split_once(')'));
    targets.map(|(target, _)| target.trim().to_owned()).collect()
}

/// A text without what stands between equally many backticks.
fn without_code(text: &str) -> String {
    let mut left = String::new();
    let mut rest = text;
    while let Some(start) = rest.find('`') {
        let length = rest[start..].len() - rest[start..].trim_start_matches('`').len();
        let (before, inside) = (&rest[..start], &rest[start + length..]);
        left.push_str(before);
        rest = match end_of_code(inside, length) {
            Some(end) => &inside[end..],
            None => inside,
        };
    }
    left + rest
}

/// Where code ends that so many backticks have begun.
fn end_of_code(text: &str, length: usize) -> Option<usize> {
    let mut at = 0;
    while let Some(start) = text[at..].find('`') {
        let start = at + start;
        let found = text[start..].len() - text[start..].trim_start_matches('`').len();
        at = start + found;
        if found == length {
            return Some(at);
        }
    }
    None
}

/// What is wrong with a link of a page, if anything.
fn problem(page: &Path, own: &Page, link: &str) -> Option<String> {
    if link.contains("://") {
        return None;
    }
    let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
    if file.is_empty() {
        let is_there = own.anchors.iter().any(|it| it == anchor);
        return (!is_there).then(|| format!("there is no heading for #{anchor}"));
    }
    let Ok(path) = root().join(page).parent()?.join(file).canonicalize() else {
        return Some(format!("there is no {file}"));
    };
    if !path.starts_with(root().canonicalize().unwrap()) {
        return Some(format!("{file} is outside of the repository"));
    }
    if anchor.is_empty() {
        return None;
    }
    let text = fs::read_to_string(&path).unwrap_or_default();
    let is_there = Page::parse(&text).anchors.iter().any(|it| it == anchor);
    (!is_there).then(|| format!("{file} has no heading for #{anchor}"))
}

/// The words of the commands in a block for a shell. Understands what the manual needs: comments,
/// quotes, lines that go on, and variables that are set in a line of their own.
fn commands(block: &str) -> Vec<Vec<String>> {
    let mut variables: HashMap<String, String> = HashMap::new();
    let mut commands = Vec::new();
    for line in block.replace("\\\n", " ").lines() {
        let words = words(line, &variables);
        match words.as_slice() {
            [] => {}
            [word] if word.contains('=') => {
                let (name, value) = word.split_once('=').unwrap();
                variables.insert(name.to_owned(), value.to_owned());
            }
            _ => commands.push(words),
        }
    }
    commands
}

fn words(line: &str, variables: &HashMap<String, String>) -> Vec<String> {
    let mut words = Vec::new();
    let mut word: Option<String> = None;
    let mut quote = None;
    let mut chars = line.chars().peekable();
    while let Some(it) = chars.next() {
        match (quote, it) {
            (None, '#') if word.is_none() => break,
            (None, ' ') => words.extend(word.take()),
            (None, '\'' | '"') => {
                quote = Some(it);
                word.get_or_insert_default();
            }
            (Some(end), it) if it == end => quote = None,
            (None | Some('"'), '$') => {
                let mut name = String::new();
                while let Some(it) = chars.next_if(|it| it.is_ascii_alphanumeric() || *it == '_') {
                    name.push(it);
                }
                let value =
                    variables.get(&name).unwrap_or_else(|| panic!("${name} is not set: {line}"));
                word.get_or_insert_default().push_str(value);
            }
            _ => word.get_or_insert_default().push(it),
        }
    }
    assert_eq!(quote, None, "a quote is open: {line}");
    words.extend(word);
    words
}

/// The arguments of this program in a command that runs it, also by a launcher or by cargo.
fn arguments(command: &[String]) -> Option<&[String]> {
    let is_program = |word: &String| word == "perceptile" || word.ends_with("/perceptile");
    let is_cargo = command.starts_with(&["cargo".to_owned(), "run".to_owned()])
        && !command.contains(&"--example".to_owned());
    let at = match command.iter().position(is_program) {
        Some(at) => at,
        None if is_cargo => command.iter().position(|word| word == "--")?,
        None => return None,
    };
    let arguments = &command[at + 1..];
    (!arguments.is_empty()).then_some(arguments)
}

/// What the program says against these arguments, if anything. It gets an empty folder, so that what
/// reads files ends at once.
fn refusal(arguments: &[String]) -> Option<String> {
    let has = |flag: &str| arguments.iter().any(|word| word == flag);
    let mut command = Command::new(PROGRAM);
    command.args(arguments).stdin(Stdio::null());
    let has_density = arguments.iter().any(|word| word.starts_with("density("));
    let mut reads_files = has("--config") || has("--start") || has_density;
    match arguments[0].as_str() {
        "optimize" if !has("--dry-run") => {
            command.arg("--dry-run");
        }
        // Has no dry run. A file of settings that is missing ends it as early.
        "profile" if !has("--config") => {
            command.args(["--config", "missing.toml"]);
            reads_files = true;
        }
        "optimize" | "profile" | "kernel" => {}
        _ => reads_files = true,
    }
    let room = Room::new();
    let ended = room.start_as(command).end();
    let is_fine = match ended.code() {
        Some(0) => true,
        // Its files are not there.
        Some(1) => reads_files,
        // A machine too small for what the manual speaks of.
        Some(4) => true,
        _ => false,
    };
    (!is_fine).then_some(ended.error)
}

#[test]
fn links_lead_somewhere() {
    let mut problems = Vec::new();
    for (name, page) in pages() {
        for link in &page.links {
            if let Some(problem) = problem(&name, &page, link) {
                problems.push(format!("{}: ({link}) {problem}", name.display()));
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn the_index_has_every_page_of_the_manual() {
    let pages = pages();
    let index = Path::new("docs/README.md");
    let (_, contents) = pages.iter().find(|(name, _)| name == index).unwrap();
    for (name, _) in &pages {
        if let Ok(page) = name.strip_prefix("docs")
            && name != index
        {
            let link = page.to_str().unwrap();
            assert!(
                contents.links.iter().any(|it| it == link),
                "{} has no {link}",
                index.display()
            );
        }
    }
}

#[test]
fn readme_is_short() {
    let lines = fs::read_to_string(root().join("README.md")).unwrap().lines().count();
    assert!(lines <= MOST_LINES, "README.md has {lines} lines; the rest belongs into docs/");
}

#[test]
fn commands_are_understood() {
    let mut count = 0;
    let mut problems = Vec::new();
    for (name, page) in pages() {
        for (_, block) in page.blocks.iter().filter(|(info, _)| info == "sh") {
            for command in commands(block) {
                if let Some(arguments) = arguments(&command) {
                    count += 1;
                    if let Some(refusal) = refusal(arguments) {
                        problems.push(format!(
                            "{}: {}\n{refusal}",
                            name.display(),
                            command.join(" ")
                        ));
                    }
                }
            }
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
    assert!(count >= 20, "only {count} commands were found");
}

#[test]
fn commands_to_run_succeed() {
    let mut count = 0;
    for (name, page) in pages() {
        for (_, block) in page.blocks.iter().filter(|(info, _)| info == "sh run") {
            let room = Room::new();
            fs::create_dir(room.at("bin")).unwrap();
            symlink(PROGRAM, room.at("bin/perceptile")).unwrap();
            let mut command = Command::new("sh");
            let path = std::env::var("PATH").unwrap_or_default();
            command.args(["-e", "-c", block]).stdin(Stdio::null());
            command.env("PATH", format!("{}:{path}", room.at("bin").display()));
            let ended = room.start_as(command).end();
            assert_eq!(ended.code(), Some(0), "{}: {block}\n{}", name.display(), ended.error);
            count += 1;
        }
    }
    assert!(count > 0, "nothing was run");
}

/// A checker that finds nothing has to be able to find something.
#[test]
fn what_is_wrong_is_found() {
    let text = "# A `b` & [c](x.md), σ = 1.9\n## Same\n## Same\n\
        ```sh\n# [no](link)\nK='a b'\nperceptile kernel \"$K @\" \\\n  x#y # z\n```\n\
        [one](#same-1) `[two](nowhere)` [`three`](other.md)\n![four\nfive](six.png)\n";
    let page = Page::parse(text);
    assert_eq!(page.anchors, ["a-b--c-σ--19", "same", "same-1"]);
    assert_eq!(page.links, ["x.md", "#same-1", "other.md", "six.png"]);
    let [(info, block)] = page.blocks.as_slice() else { panic!("{page:?}") };
    assert_eq!(info, "sh");
    assert_eq!(commands(block), [["perceptile", "kernel", "a b @", "x#y"]]);

    let readme = Path::new("README.md");
    let wrong = |link| problem(readme, &page, link).is_some();
    assert!(!wrong("#same-1") && !wrong("LICENSE-MIT") && !wrong("https://example.org/none"));
    assert!(wrong("#same-2") && wrong("nowhere.md") && wrong("docs/README.md#nowhere"));
    assert!(wrong("../") && wrong("/"));

    let refused = |line: &str| refusal(arguments(&words(line, &HashMap::new())).unwrap());
    for line in [
        "mpirun -n 2 target/release/perceptile optimize --preset quick",
        "cargo run --release -- optimize --config run.toml",
        "perceptile evaluate tile.npy other.npy --set 7",
        "perceptile profile --preset paper --trace trace.json",
    ] {
        assert_eq!(refused(line), None, "{line}");
    }
    for line in [
        "perceptile optimise",
        "perceptile optimize --stepps 3",
        "perceptile optimize --kernel 'gaussian(0)'",
        "perceptile optimize --out nowhere/tile.npy",
        "perceptile evaluate",
        "perceptile evaluate tile.npy --set seven",
        "perceptile profile --roof",
        "cargo run --release -- optimize --tile 3x4",
    ] {
        assert!(refused(line).is_some(), "{line}");
    }
}
