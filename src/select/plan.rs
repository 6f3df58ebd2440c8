//! What is to be selected, and how: the same for all processes that take part.

use serde::{Deserialize, Serialize};

use super::filter::Filter;
use super::footprint::Footprint;
use super::mixture::{MAX_CANDIDATES, MAX_SUBSET_RENDERS, Mixture};
use super::options::SelectOptions;
use super::schedule::Schedule;
use super::sources::FilterSet;
use super::window::WindowPlan;
use super::{AnimationShape, Filters, SelectError, scale};

/// What a pixel can be.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Candidates {
    /// Number of renders.
    pub renders: usize,
    /// Whether the means of all their non-empty subsets are candidates, rather than each by itself.
    pub subsets: bool,
    /// Whether their values are those of half floats, which take half of the memory.
    pub half: bool,
}

impl Candidates {
    /// Number of candidates of a pixel.
    pub fn count(&self) -> usize {
        if self.subsets { (1 << self.renders) - 1 } else { self.renders }
    }

    /// Checks the number of renders.
    fn validate(&self) -> Result<(), SelectError> {
        let Self { renders, subsets, .. } = *self;
        let most = if subsets { MAX_SUBSET_RENDERS } else { MAX_CANDIDATES };
        match (1..=most).contains(&renders) {
            true => Ok(()),
            false => Err(SelectError::Renders { renders, most, subsets }),
        }
    }
}

/// Who works on a selection.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SelectParallelism {
    /// Processes that share no memory, each with rows of its own.
    pub ranks: usize,
    /// Processes that share the memory of a rank; 0 if its own process works alone.
    pub workers: usize,
    /// Threads of each.
    pub threads: usize,
}

/// A selection before it begins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SelectPlan {
    pub(super) shape: AnimationShape,
    pub(super) filters: Filters,
    pub(super) candidates: Candidates,
    pub(super) options: SelectOptions,
    pub(super) parallelism: SelectParallelism,
}

/// What is made of a plan before the first frame.
pub(super) struct Ready {
    pub mixture: Mixture,
    pub footprint: Footprint,
    pub filters: FilterSet,
    pub lambdas: Vec<f32>,
    pub schedule: Schedule,
}

impl SelectPlan {
    /// A selection among the renders of an animation.
    ///
    /// # Errors
    /// Numbers out of range, a kernel that is too large, or more ranks than a picture has strips.
    pub fn new(
        shape: AnimationShape,
        filters: Filters,
        candidates: Candidates,
        options: SelectOptions,
        parallelism: SelectParallelism,
    ) -> Result<Self, SelectError> {
        options.validate()?;
        candidates.validate()?;
        let plan = Self { shape, filters, candidates, options, parallelism };
        let ranks = parallelism.ranks;
        let strips = plan.ready()?.window(&plan, 0).strips.len();
        if ranks > strips {
            return Err(SelectError::Ranks { ranks, strips, height: shape.height() });
        }
        Ok(plan)
    }

    /// The size of the animation.
    pub fn shape(&self) -> AnimationShape {
        self.shape
    }

    /// What a pixel can be.
    pub fn candidates(&self) -> Candidates {
        self.candidates
    }

    /// How it is selected.
    pub fn options(&self) -> &SelectOptions {
        &self.options
    }

    /// Who works on it.
    pub fn parallelism(&self) -> SelectParallelism {
        self.parallelism
    }

    /// The same, with this process's own number of threads.
    pub fn with_threads(mut self, threads: usize) -> Self {
        self.parallelism.threads = threads;
        self
    }

    /// Bytes of memory and frames of the window that a rank takes; saturating.
    ///
    /// # Errors
    /// A kernel that is too large.
    pub fn foreseen(&self) -> Result<(usize, usize), SelectError> {
        let ready = self.ready()?;
        let bytes = (0..self.parallelism.ranks).map(|rank| ready.window(self, rank).bytes());
        Ok((bytes.max().unwrap_or(0), ready.window(self, 0).pictures))
    }

    pub(super) fn ready(&self) -> Result<Ready, SelectError> {
        let Self { shape, filters, candidates, options, .. } = self;
        let seen = filters.render();
        let ready = |kernel| Filter::new(kernel, scale(kernel));
        let footprint = Footprint::new(seen, scale(seen));
        let lambdas = options.lambdas();
        Ok(Ready {
            mixture: match candidates.subsets {
                true => Mixture::subsets(candidates.renders),
                false => Mixture::single(candidates.renders),
            },
            filters: FilterSet {
                eye: ready(&filters.eye)?,
                render: filters.taa.as_ref().map(ready).transpose()?,
                squares: Filter::of_squares(seen, scale(seen))?,
            },
            schedule: Schedule::new(shape.frames(), &footprint, lambdas.len()),
            footprint,
            lambdas,
        })
    }
}

impl Ready {
    /// The window of a rank of the plan that this is made of.
    pub fn window(&self, plan: &SelectPlan, rank: usize) -> WindowPlan {
        WindowPlan::new(plan, &self.footprint, self.schedule, rank)
    }
}
