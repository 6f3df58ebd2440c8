//! Checkpoints of a run: when they are due, what is in them, and how a run goes on from one.
//!
//! A folder is made when there is first something to keep in it, so that short runs leave no
//! trace; but whether it can be made is tried before the run begins. One that is there already is
//! taken then, or refused.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use crate::format::numbers::ArraySource;
use crate::format::write::Existing;
use crate::run::folder::{FolderError, Loaded, RunFolder};
use crate::run::plan::{Plan, Position};
use crate::run::start::InitialState;
use crate::solver::{Parallelism, Phase, Recorded};

/// How often a checkpoint is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Every {
    /// When this time has passed.
    Time(Duration),
    /// When so many steps are done.
    Steps(u32),
}

/// Arrays of a checkpoint: samples and two moments.
const ARRAYS: usize = 3;
/// The array of samples.
const SAMPLES: usize = 0;

/// How many numbers the arrays of a plan's checkpoints have.
fn lengths(plan: &Plan) -> [u64; ARRAYS] {
    [plan.options.shape.coordinates() as u64; ARRAYS]
}

/// The head of a checkpoint; samples and both moments, in line order, follow it.
#[derive(Debug, Serialize, Deserialize)]
struct Head {
    version: String,
    plan: Plan,
    record: Recorded,
    invocation: String,
}

/// Writes checkpoints.
#[derive(Debug)]
pub struct Checkpointer {
    path: PathBuf,
    every: Every,
    invocation: String,
    existing: Existing,
    folder: Option<RunFolder>,
    /// When a checkpoint was last written or tried, and at which step.
    tried: Instant,
    tried_at: u32,
    /// The step of the last one that was written.
    saved_at: Option<u32>,
}

/// A run that is to go on.
#[derive(Debug)]
pub struct Resumed {
    /// Its plan, from the checkpoint on.
    pub plan: Plan,
    /// What the checkpoint holds.
    pub start: InitialState,
    /// How it was started, as [`Checkpointer::new`] had it.
    pub invocation: String,
    /// Checkpoints that could not be used, and why not.
    pub damaged: Vec<String>,
}

impl Checkpointer {
    /// Writes the checkpoints of a run to a folder. `invocation` is for whoever lets it go on.
    ///
    /// # Errors
    /// A folder that cannot be made, or is there and cannot be taken.
    pub fn new(
        path: &Path,
        every: Every,
        existing: Existing,
        invocation: String,
    ) -> Result<Self, FolderError> {
        let mut checkpointer = Self {
            path: path.to_owned(),
            every,
            invocation,
            existing,
            folder: None,
            tried: Instant::now(),
            tried_at: 0,
            saved_at: None,
        };
        // Also a link that leads nowhere is something that is there.
        if path.symlink_metadata().is_ok() {
            checkpointer.folder()?;
        } else {
            RunFolder::probe(path, existing)?;
        }
        Ok(checkpointer)
    }

    /// Looks at the newest checkpoint of a folder that can be used, for so many ranks, workers and threads to go on from. Its
    /// arrays are checked, but read only when the run begins.
    ///
    /// # Errors
    /// A folder that cannot be used, a run of another version, and what no run can go on from.
    pub fn resume(
        path: &Path,
        every: Every,
        parallelism: Parallelism,
    ) -> Result<(Self, Resumed), FolderError> {
        let mut folder = RunFolder::open(path)?;
        let mut stray = None;
        let loaded = folder.newest::<Head>(&mut |number, array, piece| {
            if array == SAMPLES && !piece.iter().all(|x| (0.0..1.0).contains(x)) {
                stray = Some(number);
            }
        })?;
        let Loaded { number, head, arrays, damaged } = loaded;
        let Head { version, plan, record, invocation } = head;
        if version != env!("CARGO_PKG_VERSION") {
            return Err(FolderError::Version { path: path.to_owned(), found: version });
        }
        let (from, held) = (plan.from, arrays.lengths());
        let content = |rule: String| FolderError::Content { path: path.to_owned(), rule };
        for (fits, rule) in [
            (matches!(from.phase, Phase::Descent | Phase::Polish), "its phase has no steps"),
            (from.step <= plan.steps_of(from.phase), "it has more steps than the run"),
            (held.len() == ARRAYS, "it does not hold samples and two moments"),
            (held == lengths(&plan), "it holds another number of coordinates than its tile has"),
            (stray != Some(number), "it holds samples outside [0, 1)"),
        ] {
            if !fits {
                return Err(content(rule.to_owned()));
            }
        }
        let plan =
            Plan { parallelism, ..plan }.checked().map_err(|error| content(error.to_string()))?;
        let done = plan.steps_done(from);
        let damaged = damaged.iter().map(|(path, error)| format!("{}: {error}", path.display()));
        let resumed = Resumed {
            plan,
            start: InitialState::checkpoint(arrays, record),
            invocation: invocation.clone(),
            damaged: damaged.collect(),
        };
        let checkpointer = Self {
            path: path.to_owned(),
            every,
            invocation,
            existing: Existing::Keep,
            folder: Some(folder),
            tried: Instant::now(),
            tried_at: done,
            saved_at: Some(done),
        };
        Ok((checkpointer, resumed))
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether there is something to go on from.
    pub fn has_saved(&self) -> bool {
        self.saved_at.is_some()
    }

    /// Whether a checkpoint is due after so many steps.
    pub fn is_due(&self, done: u32) -> bool {
        match self.every {
            Every::Time(time) => self.tried.elapsed() >= time,
            Every::Steps(steps) => done >= self.tried_at.saturating_add(steps),
        }
    }

    /// Steps until a checkpoint is due after so many; none where that depends on time.
    pub fn steps_until_due(&self, done: u32) -> Option<u32> {
        match self.every {
            Every::Time(_) => None,
            Every::Steps(steps) => Some(self.tried_at.saturating_add(steps).saturating_sub(done)),
        }
    }

    /// Writes a checkpoint of where a run is, unless there is one.
    ///
    /// # Errors
    /// What the system reports, and a folder that cannot be taken. Earlier ones stay; the next is
    /// due as if this one had been written.
    pub fn save(
        &mut self,
        plan: &Plan,
        at: Position,
        record: Recorded,
        state: &dyn ArraySource,
    ) -> Result<(), FolderError> {
        let done = plan.steps_done(at);
        (self.tried, self.tried_at) = (Instant::now(), done);
        if self.saved_at == Some(done) {
            return Ok(());
        }
        let head = Head {
            version: env!("CARGO_PKG_VERSION").into(),
            plan: Plan { from: at, ..plan.clone() },
            record,
            invocation: self.invocation.clone(),
        };
        self.folder()?.save(u64::from(done) + 1, &head, &lengths(plan), state)?;
        self.saved_at = Some(done);
        Ok(())
    }

    /// Removes all that was kept: the run has ended well.
    ///
    /// # Errors
    /// What the system reports.
    pub fn remove(self) -> Result<(), FolderError> {
        self.folder.map_or(Ok(()), RunFolder::remove)
    }

    fn folder(&mut self) -> Result<&mut RunFolder, FolderError> {
        if self.folder.is_none() {
            self.folder = Some(RunFolder::create(&self.path, self.existing)?);
        }
        Ok(self.folder.as_mut().expect("a folder, by now"))
    }
}

#[cfg(test)]
mod tests {
    use std::io;

    use proptest::prelude::*;

    use super::*;
    use crate::format::numbers::NumberSink;
    use crate::solver::{Options, Preset, Record, StoragePlan};
    use crate::tile::{Partition, Reach, Region, TileShape};

    /// A state that has these arrays and hands them over in pieces of this size.
    struct Pieces {
        arrays: Vec<Vec<f32>>,
        size: usize,
    }

    impl ArraySource for Pieces {
        fn array(&self, index: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
            self.arrays[index].chunks(self.size).try_for_each(|piece| sink.put(piece))
        }
    }

    /// A plan of few numbers, at a step of its descent.
    fn plan(step: u32) -> Plan {
        let shape = TileShape::new(5, 4, 3, 1, 2).unwrap();
        let kernel = "gaussian(1) @ 3x3x1".parse().unwrap();
        let options = Options { shape, kernel, ..Preset::Quick.options() };
        let plan = Plan::new(&options, Parallelism::threads()).unwrap();
        Plan { from: Position { phase: Phase::Descent, step }, ..plan }
    }

    /// Its arrays, all numbers different, and a record.
    fn state(plan: &Plan, size: usize) -> (Pieces, std::sync::Arc<Record>) {
        let count = plan.options.shape.coordinates();
        let array = |k: usize| (0..count).map(move |i| (i * 3 + k) as f32 / (3 * count) as f32);
        let arrays = (0..3).map(|k| array(k).collect()).collect();
        let shape = plan.options.shape;
        let partition = Partition::new(shape, Reach::default());
        let plan = StoragePlan::new(&partition, Region::whole(shape), Parallelism::threads());
        let (_, storage) = plan.private().unwrap();
        (Pieces { arrays, size }, storage.record)
    }

    fn save(path: &Path, plan: &Plan, state: &Pieces, record: &Record) {
        let mut checkpointer =
            Checkpointer::new(path, Every::Steps(1), Existing::Replace, "how".into()).unwrap();
        checkpointer.save(plan, plan.from, record.read(), state).unwrap();
    }

    fn resume(path: &Path) -> Result<Resumed, FolderError> {
        Checkpointer::resume(path, Every::Steps(1), Parallelism::threads())
            .map(|(_, resumed)| resumed)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20))]

        #[test]
        fn a_run_goes_on_from_the_arrays_that_were_kept(size in 1_usize..200, step in 0_u32..3) {
            let around = tempfile::tempdir().unwrap();
            let path = around.path().join("run");
            let plan = plan(step);
            let (state, record) = state(&plan, size);
            save(&path, &plan, &state, &record);
            let mut resumed = resume(&path).unwrap();
            prop_assert_eq!(&resumed.plan, &plan);
            prop_assert_eq!(resumed.invocation, "how");
            prop_assert_eq!(&resumed.start.record, &record.read());
            let mut arrays = vec![Vec::new(); 3];
            resumed.start.read(&plan, &mut |array, piece| arrays[array].extend(piece)).unwrap();
            // A phase that starts has no moments.
            let kept = if step > 0 { 3 } else { 1 };
            prop_assert_eq!(&arrays[..kept], &state.arrays[..kept]);
            prop_assert!(arrays[kept..].iter().all(Vec::is_empty));

            let (worker, mut storage) = plan.storage(Region::whole(plan.options.shape)).private().unwrap();
            resumed.start.put(&plan, &worker, &mut storage).unwrap();
            let tile = storage.tile_mut(plan.options.shape);
            prop_assert_eq!(&*tile, state.arrays[0].as_slice());
            let count = arrays[0].len();
            for (section, moments) in [(&storage.first, &arrays[1]), (&storage.second, &arrays[2])] {
                let expected = if step > 0 { moments.clone() } else { vec![0.0; count] };
                prop_assert_eq!(&section.slice::<f32>()[..count], expected);
            }
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_found_out_before_the_first_step() {
        let around = tempfile::tempdir().unwrap();
        let at = |name: &str| around.path().join(name);
        let new = |path: &Path| {
            Checkpointer::new(path, Every::Steps(1), Existing::Keep, "how".into()).map(drop)
        };
        std::fs::write(at("file"), "").unwrap();
        for (name, part) in
            [("no/run", "there is no folder"), ("file/run", "no folder"), ("file", "not a folder")]
        {
            for result in [new(&at(name)), RunFolder::probe(&at(name), Existing::Keep)] {
                let error = result.unwrap_err().to_string();
                assert!(error.contains(part), "{error}");
            }
        }
        // Where it can, it comes with the first checkpoint.
        new(&at("run")).unwrap();
        assert!(!at("run").exists());
        std::fs::create_dir(at("run")).unwrap();
        RunFolder::probe(&at("run"), Existing::Keep).unwrap();
        assert_eq!(std::fs::read_dir(at("run")).unwrap().count(), 0);
    }

    #[test]
    fn what_no_run_can_go_on_from_is_named() {
        let around = tempfile::tempdir().unwrap();
        let path = around.path().join("run");
        let plan = plan(2);
        for (bad, stray) in [(1.0, true), (-0.5, true), (f32::NAN, true), (0.999, false)] {
            let (mut state, record) = state(&plan, 7);
            state.arrays[0][33] = bad;
            // Moments may be anything.
            state.arrays[1][33] = -7.0;
            save(&path, &plan, &state, &record);
            match resume(&path) {
                Err(error) => {
                    assert!(stray && error.to_string().contains("outside [0, 1)"), "{error}")
                }
                Ok(_) => assert!(!stray),
            }
        }
        let kept = |lengths: &[u64]| {
            let mut folder = RunFolder::create(&path, Existing::Replace).unwrap();
            let head = Head {
                version: env!("CARGO_PKG_VERSION").into(),
                plan: plan.clone(),
                record: Recorded::default(),
                invocation: String::new(),
            };
            let array =
                &|i: usize, sink: &mut dyn NumberSink| sink.put(&vec![0.5; lengths[i] as usize]);
            folder.save(1, &head, lengths, array).unwrap();
            drop(folder);
            resume(&path).map(|_| ()).map_err(|error| error.to_string())
        };
        let count = plan.options.shape.coordinates() as u64;
        assert_eq!(kept(&[count; 3]), Ok(()));
        for (lengths, part) in [
            (&[count; 2][..], "samples and two moments"),
            (&[count; 4], "samples and two moments"),
            (&[count, count, count - 1], "another number of coordinates"),
            (&[count + 1, count, count], "another number of coordinates"),
        ] {
            let error = kept(lengths).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
    }

    #[test]
    fn samples_of_a_damaged_checkpoint_say_nothing_of_the_one_that_is_used() {
        let around = tempfile::tempdir().unwrap();
        let path = around.path().join("run");
        let (state, record) = state(&plan(1), 7);
        save(&path, &plan(1), &state, &record);
        // The newer one has samples that are none, but is damaged as well.
        let good = path.join("checkpoint-2");
        let mut bytes = std::fs::read(&good).unwrap();
        let samples = bytes.len() - 32 - 3 * 4 * state.arrays[0].len();
        bytes[samples..samples + 4].copy_from_slice(&7.0_f32.to_le_bytes());
        std::fs::write(path.join("checkpoint-3"), bytes).unwrap();
        let resumed = resume(&path).unwrap();
        assert_eq!(resumed.plan, plan(1));
        assert!(resumed.damaged.len() == 1 && resumed.damaged[0].contains("checkpoint-3"));
    }
}
