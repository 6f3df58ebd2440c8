//! The machine at hand: its processor and its caches, as Linux reports them.
//!
//! What the system does not report, or reports in a way that cannot be, is replaced by the caches of
//! a common server core and marked as assumed. Virtual machines often report nothing, or not the
//! whole truth; so nothing here is trusted, and nothing that it says makes a run fail.

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::thread::available_parallelism;

use serde::{Deserialize, Serialize};

use super::cache::CacheLevel;

/// Where Linux describes the first core's caches, one folder for each.
const CACHES: &str = "sys/devices/system/cpu/cpu0/cache";
/// Most folders that are looked at there; real cores have four or five.
const MOST_CACHES: usize = 16;
/// Most bytes that are read of one file.
const MOST_BYTES: u64 = 1 << 16;
/// Longest line in bytes that is believed; with it the assumed caches are still whole sets.
const LONGEST_LINE: u32 = 512;
/// Most characters of a processor's name.
const MOST_CHARACTERS: usize = 100;

/// The caches that are assumed where nothing is reported: those of a Zen core.
const FALLBACK: [CacheLevel; 3] = [
    CacheLevel { level: 1, bytes: 32 << 10, ways: 8, line: 64 },
    CacheLevel { level: 2, bytes: 1 << 20, ways: 16, line: 64 },
    CacheLevel { level: 3, bytes: 32 << 20, ways: 16, line: 64 },
];

/// One level of data cache.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DataCache {
    /// Its geometry, which [`super::cache::Hierarchy`] accepts.
    pub geometry: CacheLevel,
    /// Whether the geometry is a guess: the system reports none, or one that cannot be.
    pub assumed: bool,
}

/// A machine as its system describes it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Machine {
    /// The processor's name; its architecture where it has none.
    pub processor: String,
    /// Logical cores that this process may use, at least 1.
    pub cores: usize,
    /// L1 (data), L2 and L3 of the first core, with lines that do not become smaller from one to
    /// the next.
    pub caches: [DataCache; 3],
}

impl Machine {
    /// This machine.
    pub fn detect() -> Self {
        Self::read(Path::new("/"))
    }

    /// The machine whose `proc` and `sys` are in the folder `root`; the number of cores is always
    /// that of this one.
    pub fn read(root: &Path) -> Self {
        let processor = text(&root.join("proc/cpuinfo")).and_then(|text| name(&text));
        Self {
            processor: processor.unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            cores: available_parallelism().map_or(1, usize::from),
            caches: caches(&root.join(CACHES)),
        }
    }

    /// The geometries of L1, L2 and L3.
    pub fn levels(&self) -> [CacheLevel; 3] {
        self.caches.map(|cache| cache.geometry)
    }
}

/// The first processor's name in `cpuinfo`.
fn name(cpuinfo: &str) -> Option<String> {
    let field = |line: &str| {
        let (key, value) = line.split_once(':')?;
        (key.trim() == "model name").then(|| value.trim().to_owned())
    };
    let name = cpuinfo.lines().find_map(field)?;
    let name: String = name.chars().filter(|c| !c.is_control()).take(MOST_CHARACTERS).collect();
    (!name.is_empty()).then_some(name)
}

/// The caches described in a folder; for each level the first one that can be.
fn caches(folder: &Path) -> [DataCache; 3] {
    let reported: Vec<CacheLevel> =
        (0..MOST_CACHES).filter_map(|i| reported(&folder.join(format!("index{i}")))).collect();
    let mut line = 0;
    FALLBACK.map(|fallback| {
        let fits = |cache: &&CacheLevel| cache.level == fallback.level && cache.line >= line;
        let cache = match reported.iter().find(fits) {
            Some(&geometry) => DataCache { geometry, assumed: false },
            None => {
                let geometry = CacheLevel { line: fallback.line.max(line), ..fallback };
                DataCache { geometry, assumed: true }
            }
        };
        line = cache.geometry.line;
        cache
    })
}

/// The data cache described in a folder, if there is one and it can be.
fn reported(folder: &Path) -> Option<CacheLevel> {
    let file = |name: &str| text(&folder.join(name)).map(|text| text.trim().to_owned());
    if !matches!(file("type")?.as_str(), "Data" | "Unified") {
        return None;
    }
    let geometry = CacheLevel {
        level: file("level")?.parse().ok()?,
        bytes: bytes(&file("size")?)?,
        ways: file("ways_of_associativity")?.parse().ok()?,
        line: file("coherency_line_size")?.parse().ok()?,
    };
    (geometry.line <= LONGEST_LINE && geometry.sets().is_ok()).then_some(geometry)
}

/// A size as Linux writes it: `48K`.
fn bytes(text: &str) -> Option<u64> {
    let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
    let shift = match &text[digits.len()..] {
        "" => 0,
        "K" => 10,
        "M" => 20,
        "G" => 30,
        _ => return None,
    };
    digits.parse::<u64>().ok()?.checked_mul(1 << shift)
}

/// The beginning of a regular file; others could wait for ever.
fn text(path: &Path) -> Option<String> {
    if !path.metadata().ok()?.is_file() {
        return None;
    }
    let mut bytes = Vec::new();
    File::open(path).ok()?.take(MOST_BYTES).read_to_end(&mut bytes).ok()?;
    Some(String::from_utf8_lossy(&bytes).into_owned())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use proptest::prelude::*;
    use tempfile::TempDir;

    use super::*;
    use crate::profile::cache::Hierarchy;

    const FILES: [&str; 5] =
        ["level", "type", "size", "ways_of_associativity", "coherency_line_size"];

    /// A tree with caches of these files; `None` leaves a file out.
    fn tree(caches: &[[Option<&[u8]>; 5]]) -> TempDir {
        let root = TempDir::new().unwrap();
        for (i, files) in caches.iter().enumerate() {
            let folder = root.path().join(CACHES).join(format!("index{i}"));
            fs::create_dir_all(&folder).unwrap();
            for (name, content) in FILES.iter().zip(files) {
                if let Some(content) = content {
                    fs::write(folder.join(name), content).unwrap();
                }
            }
        }
        root
    }

    fn cache(texts: [&'static str; 5]) -> [Option<&'static [u8]>; 5] {
        texts.map(|text| Some(text.as_bytes()))
    }

    const L1: [&str; 5] = ["1\n", "Data\n", "48K\n", "12\n", "64\n"];
    const L1I: [&str; 5] = ["1\n", "Instruction\n", "32K\n", "8\n", "64\n"];
    const L2: [&str; 5] = ["2\n", "Unified\n", "1280K\n", "20\n", "64\n"];
    const L3: [&str; 5] = ["3\n", "Unified\n", "55M\n", "11\n", "64\n"];

    fn assumed(machine: &Machine) -> [bool; 3] {
        machine.caches.map(|cache| cache.assumed)
    }

    #[test]
    fn what_is_told_is_taken() {
        let root = tree(&[cache(L1I), cache(L1), cache(L2), cache(L3)]);
        fs::create_dir_all(root.path().join("proc")).unwrap();
        let info = "processor\t: 0\nmodel name\t: Fast \u{7}9000\nmodel name\t: Other\n";
        fs::write(root.path().join("proc/cpuinfo"), info).unwrap();
        let machine = Machine::read(root.path());
        assert_eq!(machine.processor, "Fast 9000");
        assert!(machine.cores > 0);
        assert_eq!(
            machine.levels(),
            [
                CacheLevel { level: 1, bytes: 48 << 10, ways: 12, line: 64 },
                CacheLevel { level: 2, bytes: 1280 << 10, ways: 20, line: 64 },
                CacheLevel { level: 3, bytes: 55 << 20, ways: 11, line: 64 },
            ]
        );
        assert_eq!(assumed(&machine), [false; 3]);
    }

    #[test]
    fn nothing_told_is_all_assumed() {
        let root = TempDir::new().unwrap();
        let machine = Machine::read(root.path());
        assert_eq!(machine.levels(), FALLBACK);
        assert_eq!(assumed(&machine), [true; 3]);
        assert_eq!(machine.processor, std::env::consts::ARCH);
    }

    #[test]
    fn a_level_that_cannot_be_is_assumed_alone() {
        let with = |place: usize, text: &'static str| {
            let mut files = L2;
            files[place] = text;
            let root = tree(&[cache(L1), cache(files), cache(L3)]);
            Machine::read(root.path())
        };
        for (place, text) in [
            (0, ""),
            (0, "9"),
            (1, "Quantum"),
            (2, "0K"),
            (2, "-1K"),
            (2, "1281K"),
            (2, "99999999999999999999G"),
            (2, "18446744073709551615G"),
            (2, "1152921504606846976K"),
            (2, "K"),
            (2, "1280KK"),
            (2, "１２８０K"),
            (3, "0"),
            (3, "4294967296"),
            (4, "0"),
            (4, "48"),
            (4, "2147483648"),
            // Smaller lines than L1's.
            (4, "32"),
        ] {
            let machine = with(place, text);
            assert_eq!(assumed(&machine), [false, true, false], "{text:?} in {}", FILES[place]);
            assert_eq!(machine.levels()[1], FALLBACK[1]);
        }
        for place in 0..FILES.len() {
            let mut files = cache(L2);
            files[place] = None;
            let machine = Machine::read(tree(&[cache(L1), files, cache(L3)]).path());
            assert_eq!(assumed(&machine), [false, true, false], "without {}", FILES[place]);
        }
    }

    #[test]
    fn assumed_levels_have_lines_as_long_as_those_above() {
        let l1: [&str; 5] = ["1", "Data", "128K", "8", "128"];
        let machine = Machine::read(tree(&[cache(l1)]).path());
        assert_eq!(machine.levels().map(|level| level.line), [128; 3]);
        assert!(Hierarchy::new(&machine.levels()).is_ok());
    }

    #[test]
    fn this_machine_can_be_modelled() {
        assert!(Hierarchy::new(&Machine::detect().levels()).is_ok());
    }

    fn content() -> impl Strategy<Value = Option<Vec<u8>>> {
        prop_oneof![
            Just(None),
            prop::collection::vec(any::<u8>(), 0..20).prop_map(Some),
            "[0-9]{0,25}[KMG]?\n?".prop_map(|text| Some(text.into_bytes())),
            prop::sample::select(vec!["1", "2", "3", "4", "8", "16", "64", "256", "512", "48K"])
                .prop_map(|text| Some(text.as_bytes().to_vec())),
            prop::sample::select(vec!["Data", "Unified", "Instruction"])
                .prop_map(|text| Some(text.as_bytes().to_vec())),
        ]
    }

    proptest! {
        #[test]
        fn whatever_is_told_can_be_modelled(
            files in prop::collection::vec(prop::array::uniform5(content()), 0..5),
            info in prop::collection::vec(any::<u8>(), 0..100),
        ) {
            let files: Vec<[Option<&[u8]>; 5]> =
                files.iter().map(|cache| cache.each_ref().map(Option::as_deref)).collect();
            let root = tree(&files);
            fs::create_dir_all(root.path().join("proc")).unwrap();
            fs::write(root.path().join("proc/cpuinfo"), info).unwrap();
            let machine = Machine::read(root.path());
            for (cache, level) in machine.caches.iter().zip(1..) {
                prop_assert_eq!(cache.geometry.level, level);
                prop_assert!(cache.geometry.sets().is_ok());
            }
            prop_assert!(machine.levels().is_sorted_by_key(|level| level.line));
            prop_assert!(!machine.processor.is_empty());
        }
    }
}
