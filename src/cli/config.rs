//! Flags from a file: a TOML file has a name for every flag of its command, and the flags that are
//! typed win.
//!
//! The names and values of a file become arguments in front of the typed ones, so they are read by
//! the same rules, with the same messages.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs;
use std::path::Path;

use clap::parser::ValueSource;
use clap::{ArgMatches, Command};
use toml::{Spanned, Value};

use super::exit::{Failure, Misuse};

/// The flag that names the file.
pub const CONFIG: &str = "config";
/// Most bytes of a file.
const MAX_BYTES: u64 = 1 << 20;
/// Flags that say the same in different ways: one that is typed takes the place of the others of its
/// line in a file.
const ALTERNATIVES: [&[&str]; 3] =
    [&["kernel", "fps"], &["kernel", "taa"], &["kernel", "sigma", "pixels-per-degree"]];
/// Flags that show something and make nothing: not for `--print-config`.
const SHOWING: [&str; 5] = [CONFIG, "print-config", "dry-run", "help", "json"];

/// The arguments of the process with those of the file that they name, if they do, read by a command.
///
/// # Errors
/// Arguments that the command refuses.
pub fn matches(command: &Command, typed: &[OsString]) -> Result<ArgMatches, MatchError> {
    let matches = command.clone().try_get_matches_from(typed)?;
    let Some((name, of_command)) = matches.subcommand() else { return Ok(matches) };
    let file = of_command.try_get_one::<std::path::PathBuf>(CONFIG).ok().flatten();
    let Some(file) = file else { return Ok(matches) };
    let given = |flag: &str| {
        let id = flag.replace('-', "_");
        of_command.try_contains_id(&id).unwrap_or(false)
            && of_command.value_source(&id) == Some(ValueSource::CommandLine)
    };
    let replaced = |flag: &str| {
        ALTERNATIVES.iter().any(|line| line.contains(&flag) && line.iter().any(|&it| given(it)))
    };
    let mut line = typed[..1].to_vec();
    line.push(name.into());
    line.extend(
        read(command, name, file)?
            .into_iter()
            .filter_map(|(flag, argument)| (!replaced(&flag)).then_some(argument)),
    );
    // The name of the command is the first argument that is no flag of the program's own.
    let after = typed.iter().position(|word| word == name).map_or(typed.len(), |at| at + 1);
    line.extend(typed[after..].iter().cloned());
    let command = command.clone().mut_subcommand(name, |it| it.args_override_self(true));
    Ok(command.try_get_matches_from(line)?)
}

/// Why there are no arguments.
pub enum MatchError {
    /// The command's own words, or its help.
    Clap(clap::Error),
    /// The file's fault.
    File(Failure),
}

impl From<clap::Error> for MatchError {
    fn from(error: clap::Error) -> Self {
        Self::Clap(error)
    }
}

impl From<Failure> for MatchError {
    fn from(failure: Failure) -> Self {
        Self::File(failure)
    }
}

/// The flags of a file, each with its argument, in the order of their names.
fn read(command: &Command, name: &str, path: &Path) -> Result<Vec<(String, OsString)>, Failure> {
    let shown = path.display();
    let unreadable = format!("cannot read {shown}");
    let metadata = fs::metadata(path).map_err(Failure::refused(&unreadable))?;
    if !metadata.is_file() {
        // A pipe or a device may never end.
        return Err(Failure::refused(&unreadable)("it is not a file"));
    }
    let size = metadata.len();
    if size > MAX_BYTES {
        let rule = format!("settings have at most {MAX_BYTES}");
        return Err(Misuse(format!("{shown} has {size} bytes, but {rule}")).into());
    }
    let text = fs::read_to_string(path).map_err(Failure::refused(&unreadable))?;
    let entries: BTreeMap<Spanned<String>, Value> = toml::from_str(&text)
        .map_err(|error| Misuse(format!("{shown}: {error}").trim_end().into()))?;
    let mut arguments = Vec::new();
    for (key, value) in entries {
        let row = text[..key.span().start].matches('\n').count() + 1;
        let refused = |message: String| Misuse(format!("{shown}, line {row}: {message}"));
        let flag = key.into_inner();
        let argument = match value {
            Value::Boolean(true) => format!("--{flag}"),
            Value::Boolean(false) => continue,
            Value::String(text) => format!("--{flag}={text}"),
            Value::Integer(_) | Value::Float(_) => format!("--{flag}={value}"),
            _ => {
                let kinds = "a text, a number, true or false";
                return Err(refused(format!("{flag} must be {kinds}")).into());
            }
        };
        if flag == CONFIG {
            return Err(refused("a file cannot name another one".into()).into());
        }
        // Alone, so that whoever is wrong has its line.
        let alone = command.clone().try_get_matches_from(["perceptile", name, &argument]);
        alone.map_err(|error| refused(in_short(&error)))?;
        arguments.push((flag, argument.into()));
    }
    Ok(arguments)
}

/// What is wrong, without the usage of the command.
fn in_short(error: &clap::Error) -> String {
    let text = error.render().to_string();
    let text = text.strip_prefix("error: ").unwrap_or(&text);
    let end =
        ["\n\nUsage:", "\n\nFor more information"].iter().filter_map(|it| text.find(it)).min();
    text[..end.unwrap_or(text.len())].trim_end().to_owned()
}

/// The arguments of a command as a file: those that are given, those that have a default, and
/// `settings`, which know the defaults of the others.
pub fn file(
    command: &Command,
    matches: &ArgMatches,
    settings: serde_json::Map<String, serde_json::Value>,
) -> String {
    let mut table = toml::Table::new();
    for argument in command.get_arguments() {
        let (id, flag) = (argument.get_id().as_str(), argument.get_long().unwrap_or_default());
        if SHOWING.contains(&flag) || argument.is_hide_set() {
            continue;
        }
        let Some(raw) = matches.get_raw(id).and_then(|mut raw| raw.next()) else { continue };
        table.insert(flag.into(), value(&raw.to_string_lossy()));
    }
    for (name, of_settings) in settings {
        let text = of_settings.as_str().map_or_else(|| of_settings.to_string(), str::to_owned);
        table.insert(name, value(&text));
    }
    table.to_string()
}

/// The value that an argument is in a file.
fn value(text: &str) -> Value {
    let integer = text.parse().map(Value::Integer).ok();
    // A seed may be larger than the integers of a file.
    let is_integer = text.bytes().all(|byte| byte.is_ascii_digit());
    let float = || text.parse().map(Value::Float).ok().filter(|_| !is_integer);
    let boolean = || text.parse().map(Value::Boolean).ok();
    integer.or_else(float).or_else(boolean).unwrap_or_else(|| Value::String(text.into()))
}
