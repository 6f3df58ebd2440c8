//! Runs: where the solver meets files, processes, signals and people.
//!
//! ```text
//!  plan + start ──► driver: one loop ──► backend ─┬─ threads ─┬─► steps ──► solver, round by round
//!                     │                           ├─ ranks ───┤
//!                     └─► watch ─┬─► observer     └─ workers ─┘ (in processes of their own)
//!                                └─► checkpointer ──► folder
//! ```
//!
//! [`plan`] says what to do and [`start`] what from; [`driver`] follows it by one of the
//! [`backend`]s, which differ in who does the [`steps`]. Between two steps [`watch`] reports to the
//! [`observer`], stops the run for it, and has the [`checkpointer`] write to the [`folder`].
//! [`gather`] takes tiles to the regions of ranks and back, [`signals`] turns signals into a stop,
//! [`memory`] and [`forecast`] foresee what a run needs, and [`output`] writes its files.

pub mod backend;
pub mod checkpointer;
pub mod driver;
pub mod error;
pub mod folder;
pub mod forecast;
pub mod gather;
pub mod memory;
pub mod nested;
pub mod observer;
pub mod output;
pub mod plan;
pub mod signals;
pub mod start;
pub mod steps;
pub mod summary;
pub mod watch;
