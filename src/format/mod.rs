//! Tiles, pictures and provenance as files: everything that enters or leaves by the disk.
//!
//! Inwards, [`source`] recognises what a path holds and makes a [`Tile`](crate::tile::Tile) of
//! it: our own and foreign `.npy` files ([`npy`]), textures ([`ktx2`], [`raw`]), strips and folders of
//! slices ([`png`], `exr_slices`; [`series`] puts them in order). `tile` gives
//! [`Tile`](crate::tile::Tile) its own `load` and `save`. Outwards, [`slices`] exports a tile as
//! pictures, and [`texture`] as what engines load ([`export`](crate::export) chooses among them).
//! [`picture`] draws a tile's preview, [`sidecar`] records where it came from, and all of them
//! write through [`write`](mod@write), which never loses an existing file; `claim` keeps others
//! from the same output meanwhile, and `unfinished` knows what must go should the process end at
//! once. `checkpoint` is both ways: the state of a run that is to go on later.
//!
//! `animation` reads pictures, frame by frame, from `.npy` arrays and EXR files (`exr`).
//!
//! Tiles and checkpoints may be larger than memory. They are written from pieces ([`numbers`]), and
//! checkpoints are read in pieces, so that who writes or reads for others need not hold them.
//!
//! Every reader takes hostile input: it answers with a tile or an error that names the value and
//! the rule, and allocates no more than the size of the file can justify.

#[cfg(feature = "cli")]
#[cfg_attr(not(internals), doc(hidden))]
pub mod animation;
#[cfg_attr(not(internals), doc(hidden))]
pub mod checkpoint;
#[cfg_attr(not(internals), doc(hidden))]
pub mod claim;
pub mod exact;
#[cfg(feature = "exr")]
#[cfg_attr(not(internals), doc(hidden))]
pub mod exr;
#[cfg(feature = "exr")]
mod exr_slices;
pub(crate) mod hashed;
pub mod ktx2;
pub mod npy;
pub mod numbers;
pub mod picture;
pub mod png;
pub mod raw;
pub mod series;
pub mod sidecar;
pub mod slices;
pub mod source;
pub mod texture;
mod tile;
#[cfg_attr(not(internals), doc(hidden))]
pub mod unfinished;
pub mod write;
