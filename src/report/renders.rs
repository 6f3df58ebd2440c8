//! Renders that were made elsewhere, to be shown in a report: a folder with `renders.json` and
//! the pictures that it names.
//!
//! The folder is input like any other: what is too large, contradicts itself or points out of it
//! is refused with its place and the rule that it breaks.

use std::collections::{BTreeMap, HashSet};
use std::fs::{self, File};
use std::io::{self, Cursor, Read};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::format::png::{self, PngError};

/// The file that says what there is.
const NAME: &str = "renders.json";
/// The version of its format.
const FORMAT: u32 = 1;
/// Most bytes of it, and of a picture.
const MAX_BYTES: u64 = 16 << 20;
/// Most scenes, and most pictures in all.
const MAX_SCENES: usize = 64;
const MAX_PICTURES: usize = 2000;
/// Longest side of a scene's pictures.
const MAX_SIDE: usize = 8192;
/// Largest number in a plot, and its inverse the smallest on a logarithmic axis.
const MAX_NUMBER: f64 = 1e30;
/// Characters of a wrong value that an error shows.
const SHOWN: usize = 60;

/// Why renders cannot be used.
#[derive(Debug, Error)]
pub enum RendersError {
    /// Opening or reading failed.
    #[error("cannot read {}: {error}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// No regular file, or one too long.
    #[error("cannot read {}: it must be a file of at most {MAX_BYTES} bytes", path.display())]
    Size {
        /// The file.
        path: PathBuf,
    },
    /// A picture that leads out of the folder.
    #[error("cannot read {}: it leads out of {}", path.display(), folder.display())]
    Outside {
        /// The picture.
        path: PathBuf,
        /// The folder.
        folder: PathBuf,
    },
    /// A picture that is no PNG.
    #[error("cannot read {}: {error}", path.display())]
    Png {
        /// The picture.
        path: PathBuf,
        /// What is wrong.
        error: PngError,
    },
    /// The text is not JSON, or not that of renders.
    #[error("{} does not say what was rendered: {error}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// What is wrong, with line and column.
        error: serde_json::Error,
    },
    /// A value breaks its rule.
    #[error("{}: {problem}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Which, and the rule.
        problem: Problem,
    },
}

/// A value of `renders.json` that breaks its rule.
#[derive(Debug, Error, Clone, PartialEq, Eq)]
#[error("{place} is {value}, but {rule}")]
pub struct Problem {
    /// Where it stands, such as `scenes[0].pictures[2].file`.
    pub place: String,
    /// What it is.
    pub value: String,
    /// What it must be.
    pub rule: &'static str,
}

/// All that `renders.json` says.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Renders {
    pub format: u32,
    pub title: String,
    pub command: String,
    pub machine: String,
    #[serde(default)]
    pub note: String,
    #[serde(default)]
    pub scenes: Vec<Scene>,
    #[serde(default)]
    pub tables: Vec<TableData>,
    #[serde(default)]
    pub plots: Vec<Curves>,
    #[serde(default)]
    pub figures: Vec<Figure>,
    /// Width and height of each picture, by its path in the folder.
    #[serde(skip)]
    pub sizes: BTreeMap<String, [usize; 2]>,
}

/// One scene by all methods.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Scene {
    pub name: String,
    #[serde(default)]
    pub caption: String,
    pub width: usize,
    pub height: usize,
    #[serde(default)]
    pub reference: Option<String>,
    pub views: Vec<String>,
    pub pictures: Vec<Shot>,
    #[serde(default)]
    pub crops: Vec<Square>,
}

/// One method's picture of a scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Shot {
    pub name: String,
    pub view: String,
    pub file: String,
    pub value: f64,
    pub ratio: f64,
}

/// A part of a scene's pictures that is worth a closer look.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Square {
    pub x: usize,
    pub y: usize,
    pub size: usize,
}

/// A table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TableData {
    pub title: String,
    #[serde(default)]
    pub caption: String,
    pub columns: Vec<String>,
    pub rows: Vec<Vec<TableCell>>,
}

/// One cell of a table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub(super) enum TableCell {
    Text(String),
    Marked(Marked),
}

/// A cell that may stand out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Marked {
    pub text: String,
    #[serde(default)]
    pub strong: bool,
}

/// A plot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Curves {
    pub title: String,
    #[serde(default)]
    pub caption: String,
    pub x: String,
    pub y: String,
    #[serde(default)]
    pub log_y: bool,
    pub series: Vec<CurveData>,
}

/// One line of a plot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CurveData {
    pub name: String,
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    #[serde(default)]
    pub low: Option<Vec<f64>>,
    #[serde(default)]
    pub high: Option<Vec<f64>>,
}

/// Pictures side by side.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Figure {
    pub title: String,
    #[serde(default)]
    pub caption: String,
    pub pictures: Vec<Named>,
}

/// One picture of a figure.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Named {
    pub name: String,
    pub file: String,
}

impl Renders {
    /// Reads a folder, and hands each of its pictures on: path inside the folder, and content.
    ///
    /// # Errors
    /// What cannot be read or breaks a rule, and what `take` answers.
    pub fn read<E: From<RendersError>>(
        folder: &Path,
        mut take: impl FnMut(&str, &[u8]) -> Result<(), E>,
    ) -> Result<Self, E> {
        let path = folder.join(NAME);
        let text = read(&path)?;
        let mut renders: Self = serde_json::from_slice(&text)
            .map_err(|error| RendersError::Json { path: path.clone(), error })?;
        let value = |problem| RendersError::Value { path: path.clone(), problem };
        renders.check().map_err(value)?;
        let io = |error| RendersError::Io { path: folder.to_owned(), error };
        let inside = folder.canonicalize().map_err(io)?;
        let files: Vec<String> = renders.files().map(|(_, file)| file.to_owned()).collect();
        for file in files {
            if renders.sizes.contains_key(&file) {
                continue;
            }
            let path = folder.join(&file);
            let whole = path
                .canonicalize()
                .map_err(|error| RendersError::Io { path: path.clone(), error })?;
            if !whole.starts_with(&inside) {
                let folder = folder.to_owned();
                return Err(RendersError::Outside { path, folder }.into());
            }
            let bytes = read(&path)?;
            let picture = png::decode(Cursor::new(&bytes), bytes.len() as u64)
                .map_err(|error| RendersError::Png { path, error })?;
            take(&file, &bytes)?;
            renders.sizes.insert(file, [picture.width, picture.height]);
        }
        renders.check_sizes().map_err(value)?;
        Ok(renders)
    }

    /// Every picture with its place.
    fn files(&self) -> impl Iterator<Item = (String, &str)> {
        let scenes = self.scenes.iter().enumerate().flat_map(|(i, scene)| {
            let reference = scene
                .reference
                .iter()
                .map(move |file| (format!("scenes[{i}].reference"), file.as_str()));
            let pictures = scene.pictures.iter().enumerate();
            reference.chain(pictures.map(move |(j, picture)| {
                (format!("scenes[{i}].pictures[{j}].file"), picture.file.as_str())
            }))
        });
        let figures = self.figures.iter().enumerate().flat_map(|(i, figure)| {
            figure.pictures.iter().enumerate().map(move |(j, picture)| {
                (format!("figures[{i}].pictures[{j}].file"), picture.file.as_str())
            })
        });
        scenes.chain(figures)
    }

    /// Everything that can be said without the pictures.
    fn check(&self) -> Result<(), Problem> {
        holds("format", self.format, self.format == FORMAT, "this version reads format 1")?;
        let scenes = self.scenes.len();
        holds("the number of scenes", scenes, scenes <= MAX_SCENES, "at most 64 are shown")?;
        let pictures = self.files().count();
        let few = pictures <= MAX_PICTURES;
        holds("the number of pictures", pictures, few, "at most 2000 are shown")?;
        for (place, file) in self.files() {
            holds(
                &place,
                file,
                is_plain(file),
                "it must be the path of a .png file inside the folder, of letters, digits, '.', '_', '-' and '/'",
            )?;
        }
        for (i, scene) in self.scenes.iter().enumerate() {
            scene.check(&format!("scenes[{i}]"))?;
        }
        for (i, table) in self.tables.iter().enumerate() {
            for (j, row) in table.rows.iter().enumerate() {
                let place = format!("the number of cells in tables[{i}].rows[{j}]");
                let same = row.len() == table.columns.len();
                holds(&place, row.len(), same, "it must be that of the columns")?;
            }
        }
        for (i, plot) in self.plots.iter().enumerate() {
            for (j, curve) in plot.series.iter().enumerate() {
                curve.check(&format!("plots[{i}].series[{j}]"), plot.log_y)?;
            }
        }
        Ok(())
    }

    /// The pictures of a scene have its size.
    fn check_sizes(&self) -> Result<(), Problem> {
        for (i, scene) in self.scenes.iter().enumerate() {
            let files = scene.pictures.iter().map(|picture| &picture.file);
            for file in files.chain(&scene.reference) {
                let [width, height] = self.sizes.get(file).copied().unwrap_or_default();
                let place = format!("the size of {file} in scenes[{i}]");
                let same = [width, height] == [scene.width, scene.height];
                let size = format!("{width}x{height}");
                holds(&place, size, same, "it must be that of the scene")?;
            }
        }
        Ok(())
    }
}

impl Scene {
    fn check(&self, place: &str) -> Result<(), Problem> {
        for (name, side) in [("width", self.width), ("height", self.height)] {
            let fits = (1..=MAX_SIDE).contains(&side);
            holds(&format!("{place}.{name}"), side, fits, "it must be 1 to 8192")?;
        }
        let mut seen = HashSet::new();
        for (i, view) in self.views.iter().enumerate() {
            let place = format!("{place}.views[{i}]");
            holds(&place, view, seen.insert(view), "each view is named once")?;
        }
        let mut shots = HashSet::new();
        for (i, picture) in self.pictures.iter().enumerate() {
            let place = format!("{place}.pictures[{i}]");
            let known = seen.contains(&picture.view);
            holds(&format!("{place}.view"), &picture.view, known, "it must be one of the views")?;
            let new = shots.insert((&picture.name, &picture.view));
            let rule = "each name has one picture in a view";
            holds(&format!("{place}.name"), &picture.name, new, rule)?;
        }
        holds(&format!("{place}.views"), "empty", !seen.is_empty(), "a scene has a view")?;
        for (i, view) in self.views.iter().enumerate() {
            let shown = shots.iter().any(|(_, of)| *of == view);
            holds(&format!("{place}.views[{i}]"), view, shown, "a view has a picture")?;
        }
        for (i, crop) in self.crops.iter().enumerate() {
            let ends = [crop.x, crop.y].map(|start| start.checked_add(crop.size));
            let [right, bottom] = ends.map(|end| end.unwrap_or(usize::MAX));
            let inside = crop.size > 0 && right <= self.width && bottom <= self.height;
            let text = format!("{} pixels from ({}, {})", crop.size, crop.x, crop.y);
            let place = format!("{place}.crops[{i}]");
            holds(&place, text, inside, "it must have pixels and lie inside the scene")?;
        }
        Ok(())
    }
}

impl CurveData {
    fn check(&self, place: &str, log: bool) -> Result<(), Problem> {
        let columns = [
            ("x", Some(&self.x), false),
            ("y", Some(&self.y), log),
            ("low", self.low.as_ref(), log),
            ("high", self.high.as_ref(), log),
        ];
        for (name, values, log) in columns {
            let Some(values) = values else { continue };
            let same = values.len() == self.x.len();
            let rule = "it must be that of x";
            holds(&format!("the length of {place}.{name}"), values.len(), same, rule)?;
            let fits =
                |value: f64| value.abs() <= MAX_NUMBER && (!log || value >= 1.0 / MAX_NUMBER);
            let rule = if log {
                "on a logarithmic axis it must be 1e-30 to 1e30"
            } else {
                "it must be -1e30 to 1e30"
            };
            for (i, &value) in values.iter().enumerate() {
                holds(&format!("{place}.{name}[{i}]"), value, fits(value), rule)?;
            }
        }
        let both = self.low.is_some() == self.high.is_some();
        holds(&format!("{place}.low alone"), "given", both, "a band needs both low and high")
    }
}

/// Answers with a problem unless the rule holds.
fn holds(
    place: &str,
    value: impl ToString,
    rule_holds: bool,
    rule: &'static str,
) -> Result<(), Problem> {
    if rule_holds {
        return Ok(());
    }
    let text = value.to_string();
    let shown: String = text.chars().take(SHOWN).collect();
    let more = if shown.len() < text.len() { "…" } else { "" };
    // Quoted, so that no control character reaches a terminal.
    Err(Problem { place: place.to_owned(), value: format!("{:?}", shown + more), rule })
}

/// Where in a report a picture of the folder goes.
pub(super) fn place(file: &str) -> String {
    format!("renders/{file}")
}

/// Whether a path is one of a picture in the folder, and needs no quoting in a page.
fn is_plain(file: &str) -> bool {
    let letter = |c: char| c.is_ascii_alphanumeric() || "._-".contains(c);
    let name = |part: &str| !part.is_empty() && !part.starts_with('.') && part.chars().all(letter);
    file.len() <= 255 && file.ends_with(".png") && file.split('/').all(name)
}

/// The content of a file that is not too long.
fn read(path: &Path) -> Result<Vec<u8>, RendersError> {
    let io = |error| RendersError::Io { path: path.to_owned(), error };
    // Asked before opening, which would wait for ever on a pipe.
    let metadata = fs::metadata(path).map_err(io)?;
    if !metadata.is_file() || metadata.len() > MAX_BYTES {
        return Err(RendersError::Size { path: path.to_owned() });
    }
    let mut bytes = Vec::new();
    File::open(path).and_then(|file| file.take(MAX_BYTES).read_to_end(&mut bytes)).map_err(io)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde_json::{Value, json};

    use super::*;
    use crate::format::picture::Image;
    use crate::format::write::Existing;

    fn example() -> Value {
        json!({
            "format": 1, "title": "Renders", "command": "render all", "machine": "two cores",
            "scenes": [{
                "name": "Box", "width": 4, "height": 3, "reference": "box/reference.png",
                "views": ["raw"],
                "pictures": [
                    {"name": "a", "view": "raw", "file": "box/a.png", "value": 0.5, "ratio": 1},
                    {"name": "b", "view": "raw", "file": "box/b.png", "value": 0.1, "ratio": 0.2},
                ],
                "crops": [{"x": 1, "y": 0, "size": 3}],
            }],
            "tables": [{
                "title": "t", "columns": ["x", "y"],
                "rows": [["1", {"text": "2", "strong": true}]],
            }],
            "plots": [{
                "title": "p", "x": "x", "y": "y", "log_y": true,
                "series": [{"name": "s", "x": [1, 2], "y": [3, 4], "low": [1, 1], "high": [9, 9]}],
            }],
            "figures": [{"title": "f", "pictures": [{"name": "n", "file": "f.png"}]}],
        })
    }

    fn folder(value: &Value) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("box")).unwrap();
        let picture = Image::gray(4, 3, |x, y| (x + y) as u8).unwrap();
        for name in ["box/reference.png", "box/a.png", "box/b.png", "f.png"] {
            picture.save(&folder.path().join(name), Existing::Keep).unwrap();
        }
        fs::write(folder.path().join(NAME), value.to_string()).unwrap();
        folder
    }

    fn load(folder: &Path) -> Result<(Renders, Vec<String>), RendersError> {
        let mut taken = Vec::new();
        let renders = Renders::read::<RendersError>(folder, |name, bytes| {
            assert_eq!(bytes, fs::read(folder.join(name)).unwrap());
            taken.push(name.to_owned());
            Ok(())
        })?;
        Ok((renders, taken))
    }

    #[test]
    fn a_folder_is_read_with_its_pictures() {
        let folder = folder(&example());
        let (renders, taken) = load(folder.path()).unwrap();
        assert_eq!(taken, ["box/reference.png", "box/a.png", "box/b.png", "f.png"]);
        assert_eq!(renders.sizes["f.png"], [4, 3]);
        assert_eq!(renders.scenes[0].pictures[1].ratio, 0.2);
    }

    #[test]
    fn what_breaks_a_rule_is_named_with_its_place() {
        for (pointer, bad, words) in [
            ("/format", json!(2), &["format is \"2\"", "format 1"][..]),
            ("/title", json!(7), &["integer `7`, expected a string", "line 1"]),
            ("/scenes/0/width", json!(0), &["scenes[0].width is \"0\"", "1 to 8192"]),
            ("/scenes/0/width", json!(5), &["box/a.png", "4x3", "that of the scene"]),
            ("/scenes/0/pictures/1/name", json!("a"), &["pictures[1].name", "one picture"]),
            ("/scenes/0/pictures/1/view", json!("b\u{7}"), &[r"b\u{7}", "one of the views"]),
            ("/scenes/0/pictures/0/file", json!("../a.png"), &["../a.png", "inside the folder"]),
            ("/scenes/0/pictures/0/file", json!("/a.png"), &["inside the folder"]),
            ("/scenes/0/pictures/0/file", json!("a?<b>.png"), &["a?<b>.png", "letters"]),
            ("/scenes/0/pictures/0/file", json!("box/a.svg"), &[".png file"]),
            ("/scenes/0/reference", json!("box/.png"), &["scenes[0].reference"]),
            ("/scenes/0/crops/0/size", json!(4), &["crops[0]", "inside the scene"]),
            ("/scenes/0/crops/0/x", json!(u64::MAX), &["crops[0]", "inside the scene"]),
            ("/tables/0/rows/0", json!(["1"]), &["tables[0].rows[0]", "columns"]),
            ("/tables/0/rows/0/0", json!(1), &["Cell"]),
            ("/plots/0/series/0/y", json!([1]), &["series[0].y is \"1\"", "that of x"]),
            ("/plots/0/series/0/y/0", json!(0), &["series[0].y[0] is \"0\"", "logarithmic"]),
            ("/plots/0/series/0/x/0", json!(1e31), &["series[0].x[0]", "1e30"]),
            ("/plots/0/series/0/high", Value::Null, &["both low and high"]),
            ("/figures/0/pictures/0/file", json!("no.png"), &["no.png"]),
        ] {
            let mut value = example();
            *value.pointer_mut(pointer).unwrap() = bad;
            let error = load(folder(&value).path()).unwrap_err().to_string();
            for word in words {
                assert!(error.contains(word), "{pointer}: {error}");
            }
        }
        let mut many = example();
        many["scenes"] = vec![many["scenes"][0].clone(); 65].into();
        assert!(load(folder(&many).path()).unwrap_err().to_string().contains("at most 64"));
        let mut many = example();
        many["figures"][0]["pictures"] = vec![json!({"name": "n", "file": "f.png"}); 2001].into();
        assert!(load(folder(&many).path()).unwrap_err().to_string().contains("at most 2000"));
    }

    #[test]
    fn files_that_are_no_pictures_are_not_taken() {
        let room = folder(&example());
        let picture = room.path().join("f.png");
        fs::write(&picture, "<svg>").unwrap();
        assert!(matches!(load(room.path()), Err(RendersError::Png { .. })));
        File::create(&picture).unwrap().set_len(MAX_BYTES + 1).unwrap();
        assert!(matches!(load(room.path()), Err(RendersError::Size { .. })));
        fs::remove_file(&picture).unwrap();
        fs::create_dir(&picture).unwrap();
        assert!(matches!(load(room.path()), Err(RendersError::Size { .. })));
        #[cfg(unix)]
        {
            let other = folder(&example());
            fs::remove_dir(&picture).unwrap();
            std::os::unix::fs::symlink(other.path().join("f.png"), &picture).unwrap();
            assert!(matches!(load(room.path()), Err(RendersError::Outside { .. })));
        }
        File::create(room.path().join(NAME)).unwrap().set_len(MAX_BYTES + 1).unwrap();
        assert!(matches!(load(room.path()), Err(RendersError::Size { .. })));
        fs::remove_file(room.path().join(NAME)).unwrap();
        assert!(matches!(load(room.path()), Err(RendersError::Io { .. })));
    }

    proptest! {
        #[test]
        fn plain_paths_stay_inside(file in "[a-z./\\\\%: ]{0,12}(\\.png)?") {
            if is_plain(&file) {
                let parts = Path::new(&file).components();
                let normal = |part| matches!(part, std::path::Component::Normal(_));
                prop_assert!(parts.into_iter().all(normal));
                prop_assert!(!file.contains(['\\', '%', ':', ' ']));
            }
        }

        /// Any value anywhere: an answer, and no panic.
        #[test]
        fn no_text_is_too_strange(
            place in 0_usize..40,
            bad in prop_oneof![
                Just(Value::Null), Just(json!([])), Just(json!({})), any::<i64>().prop_map(Value::from),
                any::<f64>().prop_map(Value::from), any::<String>().prop_map(Value::from),
                Just(json!([[], {}, 1])),
            ],
        ) {
            let mut value = example();
            let mut pointers = Vec::new();
            walk(&value, String::new(), &mut pointers);
            let pointer = &pointers[place * pointers.len() / 40];
            *value.pointer_mut(pointer).unwrap() = bad;
            let parsed: Result<Renders, _> = serde_json::from_str(&value.to_string());
            if let Ok(renders) = parsed && let Err(problem) = renders.check() {
                prop_assert!(!problem.to_string().contains(|c: char| c.is_control()));
            }
        }

        #[test]
        fn no_bytes_are_renders_by_chance(bytes: Vec<u8>) {
            prop_assert!(serde_json::from_slice::<Renders>(&bytes).is_err());
        }
    }

    fn walk(value: &Value, pointer: String, into: &mut Vec<String>) {
        match value {
            Value::Array(items) => {
                items.iter().enumerate().for_each(|(i, v)| walk(v, format!("{pointer}/{i}"), into));
            }
            Value::Object(fields) => {
                fields.iter().for_each(|(key, v)| walk(v, format!("{pointer}/{key}"), into));
            }
            _ => {}
        }
        if !pointer.is_empty() {
            into.push(pointer);
        }
    }
}
