//! `perceptile select` from files to files: forms, messages, going on after a stop.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use exr::prelude::*;
use perceptile::array::{self, ArrayHeader};
use serde_json::Value;

use crate::tool::{PROGRAM, PROGRESS};

fn perceptile() -> Command {
    let mut command = Command::new(PROGRAM);
    command.env(PROGRESS.0, PROGRESS.1);
    command
}

/// An animation of noise around a slope, as `.npy`: frames, height, width, 3.
fn values(seed: u32, [frames, height, width]: [usize; 3], noise: f32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(1);
    let mut uniform = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32
    };
    (0..frames * height * width * 3)
        .map(|i| {
            let (x, t) = (i / 3 % width, i / 3 / width / height);
            let value = 0.2 + 0.01 * (x + t) as f32;
            value * (1.0 + noise * (2.0 * uniform() - 1.0))
        })
        .collect()
}

fn write_npy(path: &Path, shape: &[usize], values: &[f32]) {
    let mut bytes = Vec::new();
    array::write_header(shape, &mut bytes).unwrap();
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    fs::write(path, bytes).unwrap();
}

fn read_npy(path: &Path) -> (Vec<usize>, Vec<f32>) {
    let mut file = fs::File::open(path).unwrap();
    let bytes = file.metadata().unwrap().len();
    let header = ArrayHeader::read(&mut file, bytes).unwrap();
    let mut values = vec![0.0; header.count()];
    let store = |place: usize, value: f64| {
        values[place] = value as f32;
        Ok::<(), array::ArrayError>(())
    };
    header.read_values(file, store).unwrap();
    (header.shape().to_vec(), values)
}

/// A frame as EXR with a channel more than colours, in a data window within the display window.
fn write_exr(path: &Path, [height, width]: [usize; 2], pixels: &[f32], depth: f32) {
    let plane = |c: usize| FlatSamples::F32(pixels.iter().skip(c).step_by(3).copied().collect());
    let colours = ["R", "G", "B"].into_iter().enumerate();
    let colours = colours.map(|(c, name)| AnyChannel::new(name, plane(c)));
    let z = AnyChannel::new("Z", FlatSamples::F32(vec![depth; height * width]));
    let layer = Layer::new(
        (width, height),
        LayerAttributes { layer_position: Vec2(3, 2), ..LayerAttributes::default() },
        Encoding::FAST_LOSSLESS,
        AnyChannels::sort(colours.chain([z]).collect()),
    );
    let display = IntegerBounds::new((1, 1), (width + 4, height + 3));
    Image { attributes: ImageAttributes::new(display), layer_data: layer }
        .write()
        .to_file(path)
        .unwrap();
}

const SHAPE: [usize; 3] = [6, 12, 16];

/// A folder with a reference and three renders.
fn folder(form: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (number, name) in ["reference", "a", "b", "c"].into_iter().enumerate() {
        let noise = if number == 0 { 0.0 } else { 0.5 };
        let values = values(number as u32, SHAPE, noise);
        let [frames, height, width] = SHAPE;
        if form == "npy" {
            let path = folder.path().join(format!("{name}.npy"));
            write_npy(&path, &[frames, height, width, 3], &values);
        } else {
            fs::create_dir(folder.path().join(name)).unwrap();
            for (t, pixels) in values.chunks_exact(height * width * 3).enumerate() {
                let path = folder.path().join(format!("{name}/x.{:04}.exr", t + 9));
                write_exr(&path, [height, width], pixels, number as f32);
            }
        }
    }
    folder
}

fn arguments(folder: &Path, names: [&str; 4], further: &[&str]) -> Vec<String> {
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let mut words: Vec<String> = ["select", "--reference"].map(str::to_owned).to_vec();
    words.push(path(names[0]));
    words.push("--candidates".into());
    words.extend(names[1..].iter().map(|name| path(name)));
    words.extend(further.iter().map(|&word| word.to_owned()));
    words
}

const NPY: [&str; 4] = ["reference.npy", "a.npy", "b.npy", "c.npy"];
const EXR: [&str; 4] = ["reference/x.####.exr", "a/x.####.exr", "b/x.####.exr", "c/x.####.exr"];

fn names_in(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn arrays_become_an_array_with_scores_beside_it() {
    let folder = folder("npy");
    let out = folder.path().join("best.npy");
    let further = ["--subsets", "--taa", "ema(0.5)", "--json", "--out", out.to_str().unwrap()];
    let done = perceptile().args(arguments(folder.path(), NPY, &further)).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let (shape, picture) = read_npy(&out);
    assert_eq!(shape, [6, 12, 16, 3]);
    let renders =
        ["a", "b", "c"].map(|name| read_npy(&folder.path().join(format!("{name}.npy"))).1);
    for (i, &value) in picture.iter().enumerate() {
        let of = |subset: u32| {
            let members = (0..3).filter(|k| subset >> k & 1 == 1);
            members.map(|k| renders[k][i]).sum::<f32>() / subset.count_ones() as f32
        };
        assert!((1..8).any(|subset| (of(subset) - value).abs() < 1e-6), "{i}");
    }
    let report: Value = serde_json::from_slice(&done.stdout).unwrap();
    assert_eq!(
        report,
        serde_json::from_slice::<Value>(&fs::read(out.with_extension("json")).unwrap()).unwrap()
    );
    let score = |what: &str| report["scores"][0][what]["taa"].as_f64().unwrap();
    assert!(score("selection") < 0.3 * score("mean"), "{report}");
    assert_eq!(report["chosen"].as_array().unwrap().len(), 7);
    assert_eq!(
        names_in(folder.path()),
        ["a.npy", "b.npy", "best.json", "best.npy", "c.npy", "reference.npy"]
    );
    // What is there stays, unless it is to be replaced; also what lies where the array grows.
    let part = folder.path().join("other.npy.part");
    fs::write(&part, "mine").unwrap();
    let other = part.with_extension("");
    let line = arguments(folder.path(), NPY, &["--out", other.to_str().unwrap()]);
    assert_eq!(perceptile().args(line).output().unwrap().status.code(), Some(3));
    assert_eq!(fs::read(&part).unwrap(), b"mine");
    let again = perceptile().args(arguments(folder.path(), NPY, &further)).output().unwrap();
    assert_eq!(again.status.code(), Some(3));
    let further = [&further[..], &["--force", "--threads", "1", "--simd", "plain"]].concat();
    let again = perceptile().args(arguments(folder.path(), NPY, &further)).output().unwrap();
    assert!(again.status.success());
    assert_eq!(read_npy(&out).1, picture);
}

#[test]
fn sequences_become_a_sequence_with_all_channels_of_what_was_chosen() {
    let folder = folder("exr");
    let out = folder.path().join("y.##.exr");
    let further = ["--out", out.to_str().unwrap()];
    let done = perceptile().args(arguments(folder.path(), EXR, &further)).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let channel = |path: PathBuf, name: &str| -> Vec<f32> {
        let image = read_first_flat_layer_from_file(path).unwrap();
        assert_eq!(image.layer_data.attributes.layer_position, Vec2(3, 2));
        assert_eq!(image.attributes.display_window, IntegerBounds::new((1, 1), (20, 15)));
        let list = &image.layer_data.channel_data.list;
        let channel = list.iter().find(|channel| channel.name == *name).unwrap();
        channel.sample_data.values_as_f32().collect()
    };
    let mut seen = [0; 4];
    for frame in 9..15 {
        let of = |name: &str| channel(folder.path().join(format!("y.{frame:02}.exr")), name);
        let depth = of("Z");
        for name in ["R", "G", "B"] {
            let render = |k: usize| {
                let from = ["reference", "a", "b", "c"][k];
                channel(folder.path().join(format!("{from}/x.{frame:04}.exr")), name)
            };
            let renders = [0, 1, 2, 3].map(render);
            for (i, value) in of(name).into_iter().enumerate() {
                assert_eq!(value, renders[depth[i] as usize][i]);
                seen[depth[i] as usize] += 1;
            }
        }
    }
    assert!(seen[0] == 0 && seen[1..].iter().all(|&count| count > 300), "{seen:?}");
    let report: Value =
        serde_json::from_slice(&fs::read(folder.path().join("y.json")).unwrap()).unwrap();
    assert_eq!((&report["width"], &report["height"]), (&20.into(), &15.into()));
}

#[test]
fn half_floats_stay_half_floats_and_subsets_have_colours_only() {
    let folder = tempfile::tempdir().unwrap();
    for (number, name) in ["reference", "a", "b", "c"].into_iter().enumerate() {
        fs::create_dir(folder.path().join(name)).unwrap();
        let pixels = values(number as u32, [1, 5, 7], if number == 0 { 0.0 } else { 0.5 });
        let pixel = |Vec2(x, y): Vec2<usize>| {
            let at = 3 * (y * 7 + x);
            let [r, g, b] = [0, 1, 2].map(|c| f16::from_f32(pixels[at + c]));
            (r, g, b)
        };
        write_rgb_file(folder.path().join(name).join("x.0001.exr"), 7, 5, |x, y| pixel(Vec2(x, y)))
            .unwrap();
    }
    let out = folder.path().join("best.exr");
    let further = ["--subsets", "--out", out.to_str().unwrap()];
    let done = perceptile().args(arguments(folder.path(), EXR, &further)).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let image = read_first_flat_layer_from_file(&out).unwrap();
    let list = &image.layer_data.channel_data.list;
    assert_eq!(list.len(), 3);
    assert!(list.iter().all(|channel| matches!(channel.sample_data, FlatSamples::F16(_))));
    // They are kept as such: a later frame that has more digits would lose them.
    for name in ["reference", "a", "b", "c"] {
        let path = folder.path().join(name).join("x.0002.exr");
        write_rgb_file(path, 7, 5, |x, y| (0.1_f32, x as f32, y as f32)).unwrap();
    }
    let out = folder.path().join("other.####.exr");
    let further = ["--out", out.to_str().unwrap()];
    let refused = perceptile().args(arguments(folder.path(), EXR, &further)).output().unwrap();
    assert_eq!(refused.status.code(), Some(1));
    let message = String::from_utf8(refused.stderr).unwrap();
    assert!(message.contains("x.0002.exr has 32-bit colours"), "{message}");
}

#[test]
fn a_stopped_selection_goes_on_with_the_same_command() {
    let folder = tempfile::tempdir().unwrap();
    let shape = [90, 24, 24];
    for (number, name) in NPY.into_iter().enumerate() {
        let noise = if number == 0 { 0.0 } else { 0.5 };
        let values = values(number as u32, shape, noise);
        write_npy(&folder.path().join(name), &[90, 24, 24, 3], &values);
    }
    let [whole, part] = ["whole.npy", "part.npy"].map(|name| folder.path().join(name));
    let line = |out: &Path, further: &[&str]| {
        let all = ["--sweeps", "4", "--out", out.to_str().unwrap()];
        arguments(folder.path(), NPY, &[&all[..], further].concat())
    };
    assert!(perceptile().args(line(&whole, &[])).output().unwrap().status.success());
    // One of the renders ends early: what is there before the selection meets that is kept.
    let render = folder.path().join("b.npy");
    let bytes = fs::read(&render).unwrap();
    let modified = fs::metadata(&render).unwrap().modified().unwrap();
    let put = |bytes: &[u8]| {
        fs::write(&render, bytes).unwrap();
        fs::File::options().append(true).open(&render).unwrap().set_modified(modified).unwrap();
    };
    let mut broken = bytes.clone();
    let at = broken.len() - 20 * 24 * 24 * 3 * 4;
    broken[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
    put(&broken);
    let failed = perceptile().args(line(&part, &[])).output().unwrap();
    assert_eq!(failed.status.code(), Some(1));
    let message = String::from_utf8(failed.stderr).unwrap();
    assert!(
        message.contains("frame 70 of")
            && message.contains("b.npy has the value NaN at pixel (0, 0), channel 0"),
        "{message}"
    );
    assert!(part.with_extension("state").exists() && !part.exists());
    put(&bytes);
    // With other settings it is something else.
    let other = perceptile().args(line(&part, &["--norm", "l1"])).output().unwrap();
    assert_eq!(other.status.code(), Some(3));
    assert!(String::from_utf8(other.stderr).unwrap().contains("--force gives it up"));
    // Whoever does it.
    let workers = ["--progress", "lines", "--workers", "2"];
    let done = perceptile().args(line(&part, &workers)).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert!(String::from_utf8(done.stderr).unwrap().contains("going on behind frame 29"));
    assert_eq!(fs::read(&whole).unwrap(), fs::read(&part).unwrap());
    let scores = |path: &Path| {
        let text = fs::read(path.with_extension("json")).unwrap();
        serde_json::from_slice::<Value>(&text).unwrap()["scores"].clone()
    };
    assert_eq!(scores(&whole), scores(&part));
    let left = names_in(folder.path());
    assert!(
        left.iter().all(|name| !name.ends_with(".state") && !name.ends_with(".part")),
        "{left:?}"
    );
}

#[test]
fn an_interrupted_selection_goes_on_from_wherever_it_was() {
    let folder = folder("exr");
    let of = |out: &Path| {
        let out = out.to_str().unwrap().to_owned();
        arguments(folder.path(), EXR, &["--norm", "l1", "--sweeps", "200", "--out", &out])
    };
    let whole = folder.path().join("whole.####.exr");
    assert!(perceptile().args(of(&whole)).output().unwrap().status.success());
    // Before it has done a frame, and after.
    let part = folder.path().join("part.####.exr");
    let state = folder.path().join("part.state");
    let mut child = perceptile().args(of(&part)).spawn().unwrap();
    crate::tool::until("there is a state", || state.exists());
    let id = rustix::process::Pid::from_raw(child.id() as i32).unwrap();
    let _ = rustix::process::kill_process(id, rustix::process::Signal::INT);
    let code = child.wait().unwrap().code();
    assert!(matches!(code, Some(0 | 130)), "{code:?}");
    if code == Some(130) {
        assert!(state.exists());
        let done = perceptile().args(of(&part)).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    }
    for frame in 9..15 {
        let read =
            |name: &str| fs::read(folder.path().join(format!("{name}.{frame:04}.exr"))).unwrap();
        assert_eq!(read("whole"), read("part"));
    }
    assert!(!state.exists());
}

/// A folder with an animation of many strips, long enough for a state, and the arguments to choose from
/// it.
fn tall() -> (tempfile::TempDir, impl Fn(&str, &str) -> Vec<String>) {
    const TALL: [usize; 3] = [40, 61, 20];
    let folder = tempfile::tempdir().unwrap();
    for (number, name) in NPY.into_iter().enumerate() {
        let noise = if number == 0 { 0.0 } else { 0.5 };
        let [frames, height, width] = TALL;
        let shape = [frames, height, width, 3];
        write_npy(&folder.path().join(name), &shape, &values(number as u32, TALL, noise));
    }
    let path = folder.path().to_owned();
    let line = move |out: &str, further: &str| {
        let out = path.join(out).to_str().unwrap().to_owned();
        let kernel = "gaussian(1) * fovvideovdp(60) @ 3x3x3";
        let own = ["--kernel", kernel, "--sweeps", "5", "--subsets", "--out", &out];
        let further: Vec<&str> = further.split_whitespace().collect();
        arguments(&path, NPY, &[&own[..], &further].concat())
    };
    (folder, line)
}

#[test]
fn workers_choose_the_same_whatever_becomes_of_them() {
    let (folder, line) = tall();
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    let run = |line: Vec<String>| {
        let done = perceptile().args(line).output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    };
    let counts = |name: &str| {
        let report: Value = serde_json::from_slice(&read(name)).unwrap();
        let replaced = report["replaced"].as_u64().unwrap();
        (["scores", "chosen", "sweeps"].map(|field| report[field].clone()), replaced)
    };
    for norm in ["l2", "l1"] {
        run(line("one.npy", &format!("--norm {norm} --threads 1 --force")));
        let expected = (read("one.npy"), counts("one.json").0);
        let calm =
            ["--workers 1 --threads 1", "--workers 3 --threads 1", "--workers 2 --threads 2"];
        for workers in calm {
            run(line("more.npy", &format!("--norm {norm} {workers} --force")));
            let (found, replaced) = counts("more.json");
            assert!((read("more.npy"), found) == expected, "{norm} {workers}");
            assert_eq!(replaced, 0);
        }
        // Workers die and hang wherever chance has them.
        let mut lost = 0;
        let wild = [
            "--workers 3 --threads 1 --faults 10ms,0.1",
            "--workers 4 --threads 2 --faults 5ms,0.05",
            "--workers 1 --threads 1 --faults 20ms,0.1",
        ];
        let mut runs = wild.into_iter().cycle().take(90);
        while lost < 60 {
            let workers = runs.next().expect("workers that fail");
            let rest = "--silence 0.3s --replacements 100000 --force";
            run(line("more.npy", &format!("--norm {norm} {workers} {rest}")));
            let (found, replaced) = counts("more.json");
            assert!((read("more.npy"), found) == expected, "{norm} {workers}");
            lost += replaced;
        }
    }
}

#[test]
fn too_many_lost_workers_leave_what_goes_on() {
    let (folder, line) = tall();
    let run = |more: &str| perceptile().args(line("more.npy", more)).output().unwrap();
    // Each lives for two milliseconds at most, and has more to do.
    let lost = run("--workers 2 --threads 1 --faults 1ms,0 --replacements 3");
    let message = String::from_utf8(lost.stderr).unwrap();
    assert_eq!(lost.status.code(), Some(5), "{message}");
    assert!(message.contains("4 workers were lost, the last because it was ended by SIGKILL"));
    assert!(!folder.path().join("more.npy").exists());
    assert!(run("--workers 2").status.success());
    assert!(perceptile().args(line("one.npy", "")).output().unwrap().status.success());
    let read = |name: &str| fs::read(folder.path().join(name)).unwrap();
    assert_eq!(read("more.npy"), read("one.npy"));
}

#[test]
fn levels_are_the_two_nearest_and_less_error_is_seen_than_of_noise() {
    let folder = tempfile::tempdir().unwrap();
    let [frames, height, width] = [10, 20, 32];
    let input: Vec<f32> = (0..frames * height * width)
        .map(|i| {
            0.1 + 0.02 * (i % width) as f32 / width as f32 + 0.001 * (i / width / height) as f32
        })
        .collect();
    let path = folder.path().join("slope.npy");
    write_npy(&path, &[frames, height, width], &input);
    let out = folder.path().join("d.##.png");
    let line = ["select", "--levels", "64", "--transfer", "linear", "--reference"];
    let done = perceptile().args(line).args([&path, Path::new("--out"), &out]).output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    // Workers take the channels of a colour picture in turns.
    let colours = folder.path().join("colours.npy");
    write_npy(&colours, &[frames, height, width, 3], &values(3, [frames, height, width], 0.0));
    let both = [("e", "--workers"), ("f", "--threads")].map(|(name, who)| {
        let out = folder.path().join(format!("{name}.##.png"));
        let mut command = perceptile();
        command.args(line).args([&colours, Path::new("--out"), &out]).args([who, "3"]);
        let done = command.output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let file = |frame| fs::read(folder.path().join(format!("{name}.{frame:02}.png"))).unwrap();
        (0..frames).map(file).collect::<Vec<_>>()
    });
    assert_eq!(both[0], both[1]);
    for frame in 0..frames {
        let file = fs::File::open(folder.path().join(format!("d.{frame:02}.png"))).unwrap();
        let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        for (i, &byte) in bytes.iter().enumerate() {
            let level = f32::from(byte) * 63.0 / 255.0;
            assert!((level - level.round()).abs() < 0.13, "{byte}");
            let light = input[frame * height * width + i] * 63.0;
            assert!((level.round() - light).abs() <= 1.0, "{level} for {light}");
        }
    }
    let report: Value =
        serde_json::from_slice(&fs::read(folder.path().join("d.json")).unwrap()).unwrap();
    // One of the levels alone is off by half a level on average.
    let score = |what: &str| report["scores"][0][what]["plain"].as_f64().unwrap();
    assert!(score("selection") < 0.05 * score("mean"), "{report}");
}

#[test]
fn what_is_wrong_is_named_and_nothing_is_written() {
    let folder = folder("exr");
    let inside = |name: &str| folder.path().join(name);
    write_npy(&inside("short.npy"), &[5, 15, 20, 3], &values(1, [5, 15, 20], 0.1));
    write_npy(&inside("gray.npy"), &[6, 15, 20], &values(1, [2, 15, 20], 0.1));
    write_npy(&inside("flat.npy"), &[6, 900], &values(1, [6, 15, 20], 0.1)[..5400]);
    let before = names_in(folder.path());
    let check = |names: [&str; 4], further: &[&str], code: i32, words: &str| {
        let out = inside("out.####.exr");
        let further = [further, &["--out", out.to_str().unwrap()]].concat();
        let done = perceptile().args(arguments(folder.path(), names, &further)).output().unwrap();
        let message = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(code), "{message}");
        assert!(message.contains(words), "{message}");
        assert_eq!(names_in(folder.path()), before, "{words}");
    };
    let with = |name| [EXR[0], EXR[1], name, EXR[3]];
    check(with("short.npy"), &[], 2, "short.npy has 20x15 pixels, 3 channels and 5 frames, but");
    check(with("gray.npy"), &[], 2, "1 channels and 6 frames");
    check(with("flat.npy"), &[], 1, "has the shape [6, 900]");
    check(with("no.npy"), &[], 1, "no.npy");
    check(with("no/x.####.exr"), &[], 1, "cannot read");
    check(with("a/z.####.exr"), &[], 1, "there is no file");
    check(with("a.png"), &[], 2, "is neither a .npy file nor");
    check(EXR, &["--sweeps", "0"], 2, "there are 0 sweeps, but there must be 1 to 256");
    check(
        EXR,
        &["--continuation", "0.1..0.2"],
        2,
        "the continuation is 0.1..0.2, but it must fall",
    );
    check(EXR, &["--taa", "2"], 2, "is 2, but it must be above 0");
    check(EXR, &["--kernel", "gaussian(2) * ema(0.2)"], 2, "leave ema out of --kernel");
    check(EXR, &["--pin"], 2, "--pin is for worker processes");
    check(EXR, &["--levels", "64"], 2, "cannot be used with");
    let done = perceptile()
        .args(arguments(folder.path(), EXR, &["--out", inside("out.exr").to_str().unwrap()]))
        .output()
        .unwrap();
    assert_eq!(done.status.code(), Some(2));
    assert!(String::from_utf8(done.stderr).unwrap().contains("must have a #"));
    // A frame that is missing, cut short, or of another size.
    fs::remove_file(inside("b/x.0011.exr")).unwrap();
    check(EXR, &[], 1, "x.0011.exr is missing: there are frames 9 to 14");
    let whole = fs::read(inside("b/x.0010.exr")).unwrap();
    fs::write(inside("b/x.0011.exr"), &whole[..whole.len() / 2]).unwrap();
    check(EXR, &[], 1, "x.0011.exr: not a readable EXR file");
    write_exr(&inside("b/x.0011.exr"), [12, 17], &values(3, [1, 12, 17], 0.5), 0.0);
    check(EXR, &[], 1, "x.0011.exr has 21x15 pixels, but");
    // Dry runs write nothing, either.
    fs::write(inside("b/x.0011.exr"), whole).unwrap();
    let done = perceptile().args(arguments(folder.path(), EXR, &["--dry-run"])).output().unwrap();
    assert!(done.status.success());
    assert!(String::from_utf8(done.stdout).unwrap().contains("20x15, 6 frames: 3 candidates"));
    assert_eq!(names_in(folder.path()), before);
}

#[test]
fn damaged_pictures_are_errors_and_nothing_worse() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.exr");
    write_exr(&path, [6, 8], &values(1, [1, 6, 8], 0.5), 2.0);
    let whole = fs::read(&path).unwrap();
    let mut state = 7_u32;
    let mut random = |below: usize| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as usize % below
    };
    let mut read = 0;
    for round in 0..3000 {
        let mut bytes = whole.clone();
        for _ in 0..1 + random(4) {
            let at = random(bytes.len());
            match random(3) {
                0 => bytes[at] = random(256) as u8,
                1 => bytes[at] ^= 1 << random(8),
                // Numbers that are large or negative.
                _ => bytes[at] = [0, 255, 127, 128][random(4)],
            }
        }
        if round % 7 == 0 {
            bytes.truncate(random(whole.len()));
        }
        fs::write(&path, &bytes).unwrap();
        read += usize::from(perceptile::format::exr::read(&path).is_ok());
    }
    assert!((10..2990).contains(&read), "{read}");
}
