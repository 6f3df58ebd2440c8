//! Who works on a selection, as its owner sees them: this process, its workers, or all ranks.

use std::path::Path;
use std::sync::Arc;

use perceptile::gradient::simd::Simd;
#[cfg(unix)]
use perceptile::select::workers::Crew;
use perceptile::select::{Frame, SelectPlan, SelectState, Selection};
use perceptile_cluster::communicator::Communicator;
use serde::{Deserialize, Serialize};

use super::SelectArgs;
use super::progress::Progress;
use crate::cli::exit::Failure;
use crate::cli::ranks;

/// What all ranks do next.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
enum Order {
    /// Put what is chosen together.
    State,
    /// Take in a frame.
    Load,
    /// Do a wave.
    Advance,
    /// Put what was counted together.
    Count,
}

/// λ of each sweep, and how many pixels changed in it.
pub type Swept = Vec<(f32, u64)>;

/// The selections, and who works on them.
pub struct Hands {
    selections: Vec<Selection>,
    communicator: Arc<dyn Communicator>,
    #[cfg(unix)]
    crew: Option<Crew>,
}

impl Hands {
    /// Prepares so many selections of a plan, with all ranks.
    ///
    /// # Errors
    /// Too little memory.
    pub fn new(
        args: &SelectArgs,
        (plan, count): (&SelectPlan, usize),
        simd: Simd,
        folder: &Path,
        communicator: &Arc<dyn Communicator>,
    ) -> Result<Self, Failure> {
        #[cfg(unix)]
        if args.execution.workers > 0 {
            let options = args.workers.options(crate::cli::SELECT_WORKER, folder);
            let (crew, selections) = Crew::new(plan, count, simd, options)?;
            let communicator = Arc::clone(communicator);
            return Ok(Self { selections, communicator, crew: Some(crew) });
        }
        #[cfg(not(unix))]
        let _ = (args, folder);
        let one = || Selection::of_ranks(plan, simd, Arc::clone(communicator));
        Ok(Self {
            selections: (0..count).map(|_| one()).collect::<Result<_, _>>()?,
            communicator: Arc::clone(communicator),
            #[cfg(unix)]
            crew: None,
        })
    }

    /// The selections.
    pub fn selections(&self) -> &[Selection] {
        &self.selections
    }

    /// Goes on from states, of which there is one for each selection, or none.
    ///
    /// # Errors
    /// States of other selections.
    pub fn restore(&mut self, states: Vec<SelectState>) -> Result<(), Failure> {
        for (selection, state) in self.selections.iter_mut().zip(states) {
            selection.restore(state)?;
        }
        self.tell(&self.selections[0].wave())
    }

    /// The states, if the next wave is one that can be gone on from.
    ///
    /// # Errors
    /// Ranks that cannot be told.
    pub fn states(&self) -> Result<Option<Vec<SelectState>>, Failure> {
        self.tell(&Order::State)?;
        Ok(self.selections.iter().map(Selection::state).collect())
    }

    /// Takes in a frame of every selection.
    ///
    /// # Errors
    /// Ranks that cannot be told.
    pub fn load(&mut self, frames: &[Frame]) -> Result<(), Failure> {
        self.tell(&Order::Load)?;
        self.selections.iter_mut().zip(frames).for_each(|(selection, frame)| selection.load(frame));
        Ok(())
    }

    /// Does a wave. `done` gets the number, the picture and the choices of the frame that is done, of
    /// each selection. Returns whether there is more to do.
    ///
    /// # Errors
    /// Ranks that cannot be told, or too many workers that are lost.
    pub fn advance(
        &mut self,
        progress: &Progress,
        mut done: impl FnMut(usize, &[f32], &[u8]),
    ) -> Result<bool, Failure> {
        self.tell(&Order::Advance)?;
        let mut more = false;
        for index in 0..self.selections.len() {
            #[cfg(unix)]
            if let Some(crew) = &mut self.crew {
                let report = &mut |text: &str| progress.report(text);
                more = crew.advance(&mut self.selections, index, report, &mut done)?;
                continue;
            }
            more = self.selections[index].advance(&mut done);
        }
        #[cfg(not(unix))]
        let _ = progress;
        Ok(more)
    }

    /// What the sweeps of each selection changed.
    ///
    /// # Errors
    /// Ranks that cannot be told.
    pub fn sweeps(&self) -> Result<Vec<Swept>, Failure> {
        self.tell(&Order::Count)?;
        Ok(self.selections.iter().map(|selection| selection.sweeps().collect()).collect())
    }

    /// Ends: other ranks with an exit code if something went wrong, and workers. Returns how many of
    /// these were replaced.
    ///
    /// # Errors
    /// Ranks that cannot be told.
    pub fn end(self, code: Option<u8>) -> Result<u32, Failure> {
        ranks::tell::<Order>(&*self.communicator, &code.map_or(Ok(None), Err))?;
        #[cfg(unix)]
        if let Some(crew) = self.crew {
            return Ok(crew.finish());
        }
        Ok(0)
    }

    fn tell<T: Serialize>(&self, order: &T) -> Result<(), Failure> {
        ranks::tell(&*self.communicator, &Ok(Some(order)))
    }

    /// Does, on another rank than the root, what the root's calls above do.
    ///
    /// # Errors
    /// The exit code to end with, which the root has reported.
    pub fn follow(&mut self) -> Result<(), Failure> {
        let communicator = Arc::clone(&self.communicator);
        let Some(wave) = ranks::hear::<usize>(&*communicator)? else { return Ok(()) };
        self.selections.iter_mut().for_each(|selection| selection.go_on_from(wave));
        while let Some(order) = ranks::hear::<Order>(&*communicator)? {
            for selection in &mut self.selections {
                match order {
                    Order::State => drop(selection.state()),
                    Order::Load => selection.receive(),
                    Order::Advance => {
                        selection.advance(|_, _, _| ());
                    }
                    Order::Count => drop(selection.sweeps()),
                }
            }
        }
        Ok(())
    }
}
