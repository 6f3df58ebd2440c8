//! The report as people and scripts meet it: the folder, its numbers, and what is refused.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use base64::Engine;
use perceptile::format::npy;
use perceptile::format::picture::Image;
use perceptile::format::write::Existing;
use perceptile::metric::Baseline;
use perceptile::tile::{Tile, TileShape};
use serde_json::{Value, json};
use tempfile::TempDir;

use crate::child::{Child, output, until};
use crate::tool::PROGRESS;

const PROGRAM: &str = env!("CARGO_BIN_EXE_perceptile");
const KERNEL: &str = "gaussian(1) * ema(0.5) @ 3x3x4";
/// What takes no time.
const QUICK: &[&str] = &["--kernel", KERNEL, "--set", "3", "--integrands", "4"];

/// A folder in which commands are run.
struct Room(TempDir);

impl Room {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Saves white noise.
    fn save(&self, name: &str, shape: TileShape, seed: u64) -> Tile {
        let tile = Baseline::White.tile(shape, seed);
        npy::write_tile(&tile, &mut fs::File::create(self.at(name)).unwrap()).unwrap();
        tile
    }

    fn run(&self, words: &[&str]) -> Output {
        let mut command = Command::new(PROGRAM);
        output(command.args(words).current_dir(self.0.path()).env(PROGRESS.0, PROGRESS.1))
    }

    fn succeed(&self, words: &[&str]) -> String {
        let output = self.run(words);
        let error = String::from_utf8_lossy(&output.stderr);
        assert_eq!((output.status.code(), &*error), (Some(0), ""), "{words:?}");
        String::from_utf8(output.stdout).unwrap()
    }

    fn report(&self, words: &[&str]) -> String {
        self.succeed(&[&["report"], words, QUICK].concat());
        fs::read_to_string(self.at(words[0]).join("index.html")).unwrap()
    }

    /// Fails with an exit code and words, and changes no file.
    fn refuse(&self, words: &[&str], code: i32, about: &[&str]) {
        let before = files(self.0.path());
        let output = self.run(&[&["report"], words, QUICK].concat());
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{words:?}: {error}");
        for word in about {
            assert!(error.contains(word), "{words:?}: no {word:?} in {error}");
        }
        assert!(error.starts_with("error: ") && !error.contains("panicked"), "{error}");
        assert_eq!(files(self.0.path()), before, "{words:?}");
    }
}

/// All files below a folder with their content, by their path in it.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    fn walk(folder: &Path, from: &Path, into: &mut BTreeMap<String, Vec<u8>>) {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                walk(&path, from, into);
            } else {
                let name = path.strip_prefix(from).unwrap().to_str().unwrap().to_owned();
                into.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    let mut all = BTreeMap::new();
    walk(folder, folder, &mut all);
    all
}

fn shape(dims: usize) -> TileShape {
    TileShape::new(12, 10, 6, 1, dims).unwrap()
}

/// The text between two marks.
fn between<'a>(text: &'a str, start: &str, end: &str) -> &'a str {
    let from = text.find(start).unwrap_or_else(|| panic!("no {start}")) + start.len();
    &text[from..from + text[from..].find(end).unwrap()]
}

/// The JSON in a script element.
fn data(page: &str, id: &str) -> Value {
    let start = format!("<script type=\"application/json\" id=\"{id}\">");
    serde_json::from_str(between(page, &start, "</script>")).unwrap()
}

#[test]
fn a_report_is_a_folder_that_needs_nothing_else() {
    let room = Room::new();
    let tile = room.save("a.npy", shape(2), 1);
    room.save("one.npy", shape(1), 2);
    let page = room.report(&["out", "a.npy", "one.npy"]);
    let found = files(&room.at("out"));
    assert_eq!(fs::read_dir(room.0.path()).unwrap().count(), 3, "nothing else is left");
    let references: Vec<&str> =
        page.split("src=\"").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    assert!(references.len() >= 18);
    for reference in &references {
        assert!(found.contains_key(*reference), "{reference}");
    }
    // Nothing is loaded from elsewhere, and no file is there for nothing.
    assert!(!page.contains("http://") && !page.contains("https://"));
    assert!(page.contains("Content-Security-Policy") && page.contains("default-src 'none'"));
    let viewer = data(&page, "viewer-data");
    let tiles = viewer["tiles"].as_array().unwrap();
    for name in found.keys().filter(|name| *name != "index.html") {
        let is_tile = tiles.iter().any(|tile| tile["file"] == name.as_str());
        assert!(is_tile || references.contains(&name.as_str()), "{name}");
    }
    let names: Vec<&str> = tiles.iter().map(|tile| tile["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["a", "one", "White noise"]);
    assert_eq!(tiles[0]["whole"], true);
    assert_eq!(viewer["fps"], 60.0);
    // The samples of the viewer are those of the tile.
    let script = String::from_utf8(found["tiles/0.js"].clone()).unwrap();
    let bytes = base64::engine::general_purpose::STANDARD
        .decode(between(&script, "perceptileTile(0, \"", "\")"))
        .unwrap();
    assert_eq!(bytes.len(), 2 * tile.samples().len());
    for (pair, x) in bytes.chunks_exact(2).zip(tile.samples()) {
        let found = (f32::from(u16::from_le_bytes([pair[0], pair[1]])) + 0.5) / 65536.0;
        assert!((found - x).abs() <= 0.5 / 65536.0);
    }
    // Every element that refers to another by its id refers to one that is there, once.
    let markup = page.split("<script>").next().unwrap();
    for attribute in ["aria-labelledby=\"", "data-copies=\"", "href=\"#"] {
        for list in markup.split(attribute).skip(1).map(|rest| rest.split('"').next().unwrap()) {
            for id in list.split(' ') {
                assert_eq!(markup.matches(&format!(" id=\"{id}\"")).count(), 1, "{id}");
            }
        }
    }
}

#[test]
fn the_kernel_of_the_viewer_is_the_kernel_of_the_scores() {
    let room = Room::new();
    room.save("a.npy", shape(2), 1);
    let viewer = data(&room.report(&["out", "a.npy"]), "viewer-data");
    let kernel: Value = serde_json::from_str(&room.succeed(&["kernel", KERNEL, "--json"])).unwrap();
    let class = &kernel["classes"][0];
    // It has temporal anti-aliasing of its own.
    assert_eq!(viewer["views"][3]["name"], "TAA, as perceived");
    let shown = &viewer["views"][3]["kernel"];
    assert_eq!(shown["power"], class["sum_squares"]);
    let taps = class["taps"].as_array().unwrap();
    for tap in taps {
        let number = |i: usize| tap[i].as_i64().unwrap();
        let slices = shown["slices"].as_array().unwrap();
        let slice = slices.iter().find(|slice| slice["dt"] == tap[2]).unwrap();
        let plane = &shown["planes"][slice["plane"].as_u64().unwrap() as usize];
        let at = |name: &str| plane[name].as_i64().unwrap();
        let place = (number(1) - at("y")) * at("width") + number(0) - at("x");
        let weight =
            slice["scale"].as_f64().unwrap() * plane["weights"][place as usize].as_f64().unwrap();
        assert!((weight - tap[3].as_f64().unwrap()).abs() < 1e-7);
    }
}

#[test]
fn every_number_is_that_of_evaluate() {
    let room = Room::new();
    room.save("flat.npy", shape(2), 1);
    room.save("deep.npy", shape(3), 2);
    let page = room.report(&["out", "flat.npy", "deep.npy"]);
    let line = [&["evaluate", "flat.npy", "deep.npy", "--json", "--baselines", "white"], QUICK];
    let scores: Value = serde_json::from_str(&room.succeed(&line.concat())).unwrap();
    let mut shown: BTreeMap<(String, String), f64> = BTreeMap::new();
    for element in page.split("<span data-tile=\"").skip(1) {
        let tile = element.split('"').next().unwrap();
        let pointer = between(element, "data-score=\"", "\"");
        let value: f64 = between(element, "data-value=\"", "\"").parse().unwrap();
        let text: f64 = between(element, ">", "<").parse().unwrap();
        // An error of a figure has one digit.
        let rounding = if pointer.ends_with("/standard_error") { 0.5 } else { 0.005 };
        assert!((text - value).abs() <= rounding * value.abs() + 1e-300, "{text} {value}");
        let before = shown.insert((tile.to_owned(), pointer.to_owned()), value);
        assert!(before.is_none_or(|before| before == value), "{tile} {pointer}");
    }
    let mut left = shown.len();
    for tile in scores["tiles"].as_array().unwrap() {
        let name = tile["name"].as_str().unwrap().to_owned();
        let mut numbers = Vec::new();
        for field in ["scores", "after_8_bits", "after_16_bits"] {
            walk(&tile[field], format!("/{field}"), &mut numbers);
        }
        // What the functions are is said once for all.
        for (pointer, value) in numbers.iter().filter(|(it, _)| !it.contains("/options/")) {
            let found = shown.get(&(name.clone(), pointer.clone()));
            assert_eq!(found, Some(value), "{name} {pointer}");
            left -= 1;
        }
    }
    assert_eq!(left, 0, "the page shows scores that evaluate does not know");
}

/// Each part is a tile of its own, beside white noise in the shape of the first.
#[test]
fn parts_of_a_tile_are_tiles_of_a_report() {
    let room = Room::new();
    room.save("a.npy", TileShape::new(8, 8, 8, 3, 2).unwrap(), 1);
    for (flag, parts, spp, frames) in [
        (["--prefix", "1,3"], ["a-first-1", "a-first-3"], [1, 3, 1], [8, 8, 8]),
        (["--stride", "2"], ["a-phase-0-of-2", "a-phase-1-of-2"], [3, 3, 3], [4, 4, 4]),
    ] {
        let page = room.report(&[&["out", "a.npy", "--force"][..], &flag].concat());
        let tiles = data(&page, "viewer-data")["tiles"].as_array().unwrap().clone();
        let of = |field: &str| tiles.iter().map(|tile| tile[field].clone()).collect::<Vec<_>>();
        assert_eq!(of("name"), [parts[0], parts[1], "White noise"]);
        assert_eq!(
            (of("spp"), of("frames")),
            (spp.map(Value::from).into(), frames.map(Value::from).into())
        );
        assert!(
            page.contains(&flag.join(" ")) || page.contains(&format!("{} '{}'", flag[0], flag[1]))
        );
    }
}

/// Every number below a value, with its JSON pointer.
fn walk(value: &Value, pointer: String, into: &mut Vec<(String, f64)>) {
    match value {
        Value::Array(items) => {
            items
                .iter()
                .enumerate()
                .for_each(|(i, item)| walk(item, format!("{pointer}/{i}"), into));
        }
        Value::Object(fields) => {
            fields.iter().for_each(|(key, item)| walk(item, format!("{pointer}/{key}"), into));
        }
        _ => into.extend(value.as_f64().map(|number| (pointer, number))),
    }
}

#[test]
fn the_same_tiles_make_the_same_bytes() {
    let room = Room::new();
    room.save("a.npy", shape(2), 1);
    renders(&room, &hostile());
    room.report(&["one", "a.npy", "--renders", "renders"]);
    room.report(&["two", "a.npy", "--renders", "renders"]);
    assert!(files(&room.at("one")) == files(&room.at("two")));
}

#[test]
fn provenance_is_that_of_the_sidecar() {
    let room = Room::new();
    let make = ["optimize", "--tile", "12x10x6", "--kernel", KERNEL, "--steps", "2", "--draws"];
    room.succeed(&[&make[..], &["8", "--integrands", "0", "--seed", "77"]].concat());
    room.save("bare.npy", shape(2), 1);
    room.save("odd.npy", shape(2), 2);
    fs::write(room.at("odd.json"), "{\"format\": 9}").unwrap();
    let page = room.report(&["out", "tile.npy", "bare.npy", "odd.npy"]);
    let article = |number: usize| between(&page, &format!("id=\"tile-{number}\""), "</article>");
    let sidecar: Value = serde_json::from_slice(&fs::read(room.at("tile.json")).unwrap()).unwrap();
    for field in ["version", "created", "sha256"] {
        assert!(article(0).contains(sidecar[field].as_str().unwrap()), "{field}");
    }
    assert!(article(0).contains("the file still matches") && article(0).contains("<dd>77</dd>"));
    let command = between(article(0), "id=\"tile-0-command\">", "</pre>");
    assert!(command.starts_with("perceptile optimize") && command.contains("--seed 77"));
    let descent = |number| article(number).contains("mean transport cost of a draw");
    assert!(descent(0) && !descent(1));
    assert!(article(1).contains("There is no sidecar"));
    assert!(article(2).contains("cannot be used: the provenance has format 9"));
    assert!(article(3).contains("Made for this comparison"));
    // Another tile under the name of the sidecar.
    room.save("tile.npy", shape(2), 3);
    let page = room.report(&["again", "tile.npy"]);
    assert!(page.contains("the file does not match") && !page.contains("still matches"));
}

#[test]
fn the_viewer_comes_first_and_one_line_says_what_came_of_it() {
    let room = Room::new();
    room.save("a.npy", shape(2), 1);
    room.save("b.npy", shape(2), 2);
    let page = room.report(&["out", "a.npy", "b.npy"]);
    let places =
        ["p class=\"verdict\"", "id=\"viewer\"", "id=\"scores\"", "id=\"spectra\"", "id=\"tiles\""];
    let places = places.map(|mark| page.find(mark).unwrap_or_else(|| panic!("no {mark}")));
    assert!(places.is_sorted(), "{places:?}");
    let verdict = between(&page, "<p class=\"verdict\">", "</p>");
    assert!(verdict.contains("<strong>a</strong>") && verdict.contains("<strong>b</strong>"));
    assert_eq!(verdict.matches("data-value").count(), 2, "white noise has 1");
    // All spectra stand in one row, and all lines in one plot for each plane.
    let row = between(&page, "class=\"pictures spectra\"", "class=\"plots\"");
    assert_eq!(row.matches("<figure>").count(), 3);
    let plots = between(&page, "class=\"plots\"", "</section>");
    assert_eq!(plots.matches("kernel’s power |ĝ|² (along x)</li>").count(), 2);
    for old in ["fineness", "emptiest", "window |"] {
        assert!(!page.contains(old), "{old}");
    }
}

#[test]
fn white_noise_that_repeats_within_the_kernel_is_called_so() {
    let room = Room::new();
    room.save("a.npy", shape(2), 1);
    let row = ">White noise, 6 frames repeated</th>";
    let longer = "gaussian(1) * ema(0.5) @ 3x3x8";
    room.succeed(&["report", "long", "a.npy", "--kernel", longer, "--integrands", "2"]);
    let page = fs::read_to_string(room.at("long/index.html")).unwrap();
    assert!(page.contains(row) && page.contains("sees more frames than a tile has"));
    let page = room.report(&["out", "a.npy"]);
    assert!(!page.contains("frames repeated") && !page.contains("sees more frames"));
}

#[test]
fn no_folder_of_this_machine_is_in_a_report() {
    let room = Room::new();
    fs::create_dir(room.at("my tiles")).unwrap();
    let tile = room.at("my tiles/a.npy");
    let make = ["--tile", "12x10x6", "--kernel", KERNEL, "--steps", "1", "--draws", "8"];
    room.save("my tiles/start.npy", shape(2), 1);
    let start = room.at("my tiles/start.npy");
    let [tile, start] = [&tile, &start].map(|path| path.to_str().unwrap());
    let line = ["optimize", "--out", tile, "--start", start, "--integrands", "0"];
    room.succeed(&[&line[..], &make].concat());
    room.save("my tiles/b.npy", shape(2), 2);
    let bad = room.at("my tiles/b.npy");
    fs::create_dir(room.at("my tiles/b.json")).unwrap();
    let page = room.report(&["out", tile, bad.to_str().unwrap()]);
    for part in ["my tiles", room.0.path().to_str().unwrap()] {
        assert!(!page.contains(part), "{part}");
    }
    let command = between(&page, "id=\"report-command\">", "</pre>");
    assert!(command.starts_with("perceptile report OUT 'a.npy' 'b.npy' --kernel"), "{command}");
    assert!(between(&page, "id=\"tile-0-command\">", "</pre>").contains("start.npy"));
    assert!(page.contains("cannot read b.json"));
}

/// Renders whose every text tries to be markup.
fn hostile() -> Value {
    let evil = |name: &str| format!("{name}</script><script>alert('&\"')</script><!--");
    json!({
        "format": 1, "title": evil("title"), "command": evil("command"),
        "machine": evil("machine"), "note": evil("note"),
        "scenes": [{
            "name": evil("scene"), "caption": evil("caption"), "width": 5, "height": 4,
            "reference": "a/reference.png", "views": [evil("view")],
            "pictures": [{
                "name": evil("method"), "view": evil("view"), "file": "a/white.png",
                "value": 0.0123, "ratio": 1.0,
            }],
            "crops": [{"x": 1, "y": 1, "size": 3}],
        }],
        "tables": [{
            "title": evil("table"), "caption": evil("c"), "columns": [evil("column"), "x"],
            "rows": [[evil("cell"), {"text": evil("strong"), "strong": true}]],
        }],
        "plots": [{
            "title": evil("plot"), "caption": evil("c"), "x": evil("x"), "y": evil("y"),
            "log_y": true,
            "series": [{
                "name": evil("series"), "x": [1, 2, 3], "y": [0.1, 0.2, 0.1],
                "low": [0.05, 0.1, 0.05], "high": [0.2, 0.4, 0.2],
            }],
        }],
        "figures": [{
            "title": evil("figure"), "pictures": [{"name": evil("picture"), "file": "f.png"}],
        }],
    })
}

fn renders(room: &Room, content: &Value) {
    fs::create_dir_all(room.at("renders/a")).unwrap();
    let picture = Image::gray(5, 4, |x, y| (40 * x + y) as u8).unwrap();
    for name in ["a/reference.png", "a/white.png", "f.png"] {
        picture.save(&room.at("renders").join(name), Existing::Replace).unwrap();
    }
    fs::write(room.at("renders/renders.json"), content.to_string()).unwrap();
}

#[test]
fn no_text_becomes_markup() {
    let room = Room::new();
    let name = "<script>alert(1)<&\"'.npy";
    room.save(name, shape(2), 1);
    renders(&room, &hostile());
    let page = room.report(&["out", name, "--renders", "renders"]);
    assert!(!page.contains("<script>alert"));
    // The page's two scripts, and the data for them.
    assert_eq!(page.matches("<script").count(), 4);
    assert_eq!(page.matches("</script>").count(), 4);
    assert!(!page.contains("<!--"));
    let words = ["title", "command", "machine", "note", "scene", "caption", "method", "table"];
    let more = ["column", "cell", "strong", "plot", "series", "figure", "picture"];
    for word in words.iter().chain(&more) {
        assert!(page.contains(&format!("{word}&lt;/script&gt;&lt;script&gt;alert")), "{word}");
    }
    // As data it is what it was.
    let scenes = data(&page, "scenes-data");
    assert_eq!(scenes[0]["name"], hostile()["scenes"][0]["name"]);
    assert_eq!(scenes[0]["pictures"][0]["file"], "renders/a/white.png");
    assert_eq!(scenes[0]["reference"], "renders/a/reference.png");
    assert_eq!(scenes[0]["crops"][0], json!({"x": 1, "y": 1, "size": 3}));
    let viewer = data(&page, "viewer-data");
    assert_eq!(viewer["tiles"][0]["name"], name.strip_suffix(".npy").unwrap());
    let copied = files(&room.at("out/renders"));
    assert_eq!(Vec::from_iter(copied.keys()), ["a/reference.png", "a/white.png", "f.png"]);
    assert_eq!(copied["f.png"], fs::read(room.at("renders/f.png")).unwrap());
    // Series are drawn, with their band.
    assert!(page.contains("class=\"band s0\"") && page.contains("class=\"line s0\""));
}

#[test]
fn renders_that_break_a_rule_leave_nothing_behind() {
    let room = Room::new();
    room.save("a.npy", shape(2), 1);
    let mut content = hostile();
    let line = ["out", "a.npy", "--renders", "renders"];
    content["scenes"][0]["views"] = json!([content["scenes"][0]["views"][0], "bare"]);
    renders(&room, &content);
    room.refuse(&line, 1, &["scenes[0].views[1]", "bare", "a view has a picture"]);
    content["scenes"][0]["views"] = json!([]);
    content["scenes"][0]["pictures"] = json!([]);
    renders(&room, &content);
    room.refuse(&line, 1, &["scenes[0].views", "a scene has a view"]);
    content = hostile();
    content["scenes"][0]["pictures"][0]["file"] = json!("../a.npy.png");
    renders(&room, &content);
    room.refuse(&line, 1, &["renders.json", "scenes[0].pictures[0].file", "../a.npy.png"]);
    renders(&room, &hostile());
    fs::write(room.at("renders/f.png"), "no picture").unwrap();
    room.refuse(&line, 1, &["f.png", "PNG"]);
    fs::write(room.at("renders/renders.json"), "{").unwrap();
    room.refuse(&line, 1, &["renders.json", "line 1"]);
    room.refuse(&["out", "a.npy", "--renders", "nowhere"], 1, &["nowhere"]);
}

#[test]
fn what_exists_stays_unless_it_is_a_report() {
    let room = Room::new();
    room.save("a.npy", shape(2), 1);
    room.report(&["out", "a.npy"]);
    room.refuse(&["out", "a.npy"], 3, &["out exists already", "--force"]);
    room.refuse(&["a.npy", "a.npy"], 2, &["a.npy, a file", "perceptile report out a.npy"]);
    room.save("b.npy", shape(2), 2);
    room.report(&["out", "b.npy", "--force"]);
    assert_eq!(data(&room.report(&["new", "b.npy"]), "viewer-data")["tiles"][0]["name"], "b");
    assert!(files(&room.at("out")) == files(&room.at("new")), "nothing is left of the old one");
    // Even the tile that is shown may lie there.
    fs::copy(room.at("a.npy"), room.at("out/tiles/mine.npy")).unwrap();
    let line = ["out", "out/tiles/mine.npy", "--force"];
    room.refuse(&line, 3, &["tiles/mine.npy", "no part of the report"]);
    fs::create_dir(room.at("photos")).unwrap();
    fs::write(room.at("photos/index.html"), "<title>Holidays</title>").unwrap();
    for name in ["photos", "a.npy"] {
        room.refuse(&[name, "a.npy", "--force"], 3, &[name, "not a folder with a report"]);
    }
    room.refuse(&["no/where", "a.npy"], 1, &["no/where"]);
}

#[test]
fn a_kernel_that_does_not_fit_is_the_same_error_as_in_evaluate() {
    let room = Room::new();
    room.save("a.npy", TileShape::new(8, 2, 8, 1, 2).unwrap(), 1);
    room.refuse(&["out", "a.npy"], 2, &["3 pixels high, but the tile has only 2"]);
    // In time a kernel may be longer than the tile.
    room.save("a.npy", TileShape::new(8, 8, 2, 1, 2).unwrap(), 1);
    let page = {
        let line =
            ["report", "out", "a.npy", "--kernel", "gaussian(1) @ 3x3x1", "--integrands", "2"];
        room.succeed(&line);
        fs::read_to_string(room.at("out/index.html")).unwrap()
    };
    let views = data(&page, "viewer-data")["views"].clone();
    let names: Vec<&str> =
        views.as_array().unwrap().iter().flat_map(|v| v["name"].as_str()).collect();
    assert_eq!(names, ["Raw", "As perceived", "With TAA", "TAA, as perceived"]);
    assert_eq!(page.matches("is left out").count(), 0);
}

#[cfg(unix)]
#[test]
fn a_signal_leaves_nothing_behind() {
    use rustix::process::{Signal, kill_process};

    let room = Room::new();
    room.save("a.npy", TileShape::new(32, 32, 16, 1, 2).unwrap(), 1);
    // It looks for signals between two tiles, of which there are many left.
    let line = [&["report", "out"][..], &["a.npy"; 300], &["--integrands", "64"]].concat();
    let mut run = Child::start(Command::new(PROGRAM).args(line).current_dir(room.0.path()));
    let count = || fs::read_dir(room.0.path()).unwrap().count();
    // From its first folder on it listens.
    until("a report begins", || count() == 2);
    assert!(!run.is_over(), "{}", run.error());
    kill_process(run.pid(), Signal::TERM).unwrap();
    assert_eq!(run.wait().status.code(), Some(143));
    assert_eq!(count(), 1);
}
