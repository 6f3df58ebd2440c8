//! Chooses the instruction set that the inner loops are compiled for.
//!
//! A loop is written once, in safe code, as a [`Vectorized`] operation, and compiled twice: for
//! the plain target and for AVX2. Both do the same IEEE operations in the same order (no fused
//! multiply-add, no approximate reciprocals), so they give the same bytes; which one runs is
//! found out at run time. What the compiler does not find by itself is asked of the [`Isa`],
//! whose plain twin has the same answer.

#[cfg(target_arch = "x86_64")]
mod avx2;
mod plain;

pub use plain::Plain;

/// [`Isa::sort`] sorts multiples of so many keys.
pub const SORT_BLOCK: usize = 32;

/// Points that are taken apart or put together at a time.
pub const LANES: usize = 8;

/// Numbers behind the last point that may be touched.
pub const SPARE: usize = 4;

/// Places that are looked up at a time.
pub const PLACES: usize = 4;

/// Whether a table and places have the sizes that [`Isa::interpolate`] asks for.
#[inline(always)]
fn check_places(nodes: usize, step: f64, places: usize) {
    let limit = f64::from(i32::MAX);
    assert!(places.is_multiple_of(PLACES) && (2..i32::MAX as usize).contains(&nodes));
    assert!(step >= 0.0 && step * places as f64 <= limit, "{places} places {step} apart");
}

/// What instruction sets do differently.
pub trait Isa: Copy {
    /// Sorts keys in rising order.
    ///
    /// # Panics
    /// If their number is no multiple of [`SORT_BLOCK`].
    fn sort(self, keys: &mut [u32]);

    /// Takes points apart: writes number k of point i to `planes[k · n + i]`.
    ///
    /// # Panics
    /// If `n`, the number of points, is no multiple of [`LANES`], if `planes` has no room for
    /// `n · dims` numbers, or `points` does not have as many and [`SPARE`] behind them.
    fn split(self, points: &[f32], planes: &mut [f32], n: usize, dims: usize);

    /// Puts planes together to points, the inverse of [`Self::split`], under the same conditions.
    /// What is behind the last point may change.
    fn join(self, planes: &[f32], points: &mut [f32], n: usize, dims: usize);

    /// Linear interpolation in a table: `out[i]` is the value at place `i · step`, where node j of
    /// the table is at place j. Places past the last node go on along the last line.
    ///
    /// # Panics
    /// If the number of places is no multiple of [`PLACES`], the table has fewer than two or
    /// 2³¹ nodes or more, or a place is negative or past 2³¹.
    fn interpolate(self, table: &[f64], step: f64, out: &mut [f64]);

    /// Asks for the cache line of an element that will be needed soon; of no effect where there
    /// is none.
    fn prefetch<T>(self, slice: &[T], index: usize);
}

/// An operation on slices that gains from wide registers.
///
/// Implementations must mark [`Self::run`] `#[inline(always)]`, as well as what it calls, or they
/// are compiled for the plain target only.
pub trait Vectorized {
    /// What it returns.
    type Output;

    /// Does the work with an instruction set.
    fn run<I: Isa>(self, isa: I) -> Self::Output;
}

/// An instruction set that this machine has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Simd(Level);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Level {
    Plain,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Simd {
    /// The best one for this machine.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return Self(Level::Avx2);
        }
        Self::plain()
    }

    /// The one that every machine has.
    pub fn plain() -> Self {
        Self(Level::Plain)
    }

    /// Its name: `plain` or `avx2`.
    pub fn name(self) -> &'static str {
        match self.0 {
            Level::Plain => "plain",
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => "avx2",
        }
    }

    /// Runs an operation with it.
    #[inline]
    pub fn run<V: Vectorized>(self, operation: V) -> V::Output {
        match self.0 {
            Level::Plain => operation.run(Plain),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2 => {
                // SAFETY: `Level::Avx2` is private to this file and made only in `detect`, after
                // the processor was found to have AVX2, the one feature that `avx2::run` needs.
                #[allow(unsafe_code)]
                unsafe {
                    avx2::run(operation)
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    struct Sort<'a>(&'a mut [u32]);

    impl Vectorized for Sort<'_> {
        type Output = ();

        #[inline(always)]
        fn run<I: Isa>(self, isa: I) {
            isa.sort(self.0);
        }
    }

    struct Interpolate<'a>(&'a [f64], f64, &'a mut [f64]);

    impl Vectorized for Interpolate<'_> {
        type Output = ();

        #[inline(always)]
        fn run<I: Isa>(self, isa: I) {
            isa.interpolate(self.0, self.1, self.2);
        }
    }

    struct Split<'a>(&'a [f32], &'a mut [f32], usize, usize);

    impl Vectorized for Split<'_> {
        type Output = ();

        #[inline(always)]
        fn run<I: Isa>(self, isa: I) {
            isa.split(self.0, self.1, self.2, self.3);
        }
    }

    struct Join<'a>(&'a [f32], &'a mut [f32], usize, usize);

    impl Vectorized for Join<'_> {
        type Output = ();

        #[inline(always)]
        fn run<I: Isa>(self, isa: I) {
            isa.join(self.0, self.1, self.2, self.3);
        }
    }

    proptest! {
        #[test]
        fn tables_are_looked_up_alike(
            nodes in prop::collection::vec(-2.0..2.0_f64, 2..50), step in 0.0..3.0_f64,
            places in 0_usize..9,
        ) {
            let mut found = [vec![0.0; places * PLACES], vec![0.0; places * PLACES]];
            Simd::detect().run(Interpolate(&nodes, step, &mut found[0]));
            Simd::plain().run(Interpolate(&nodes, step, &mut found[1]));
            let bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            prop_assert_eq!(bits(&found[0]), bits(&found[1]));
            for (i, value) in found[0].iter().enumerate() {
                let place = i as f64 * step;
                let node = (place.floor() as usize).min(nodes.len() - 2);
                let slope = nodes[node + 1] - nodes[node];
                prop_assert!((value - nodes[node] - slope * (place - node as f64)).abs() < 1e-9);
            }
        }

        #[test]
        fn planes_hold_what_points_hold(blocks in 0_usize..9, dims in 1_usize..17) {
            let n = blocks * LANES;
            let points: Vec<f32> = (0..n * dims + SPARE).map(|i| i as f32).collect();
            for simd in [Simd::detect(), Simd::plain()] {
                let mut planes = vec![-1.0; n * dims];
                simd.run(Split(&points, &mut planes, n, dims));
                for (place, &x) in planes.iter().enumerate() {
                    prop_assert_eq!(x, (place % n * dims + place / n) as f32);
                }
                let mut back = vec![-1.0; n * dims + SPARE];
                simd.run(Join(&planes, &mut back, n, dims));
                prop_assert_eq!(&back[..n * dims], &points[..n * dims]);
            }
        }

        #[test]
        fn keys_are_sorted_by_every_instruction_set(
            blocks in 0_usize..40, few: bool, seed: u64,
        ) {
            let mut stream = crate::draw::Stream::new(seed, crate::draw::Use::Baseline, 0, 0);
            let keys: Vec<u32> = (0..blocks * SORT_BLOCK)
                .map(|_| if few { stream.below(5) } else { stream.word() })
                .collect();
            let mut expected = keys.clone();
            expected.sort();
            for simd in [Simd::detect(), Simd::plain()] {
                let mut found = keys.clone();
                simd.run(Sort(&mut found));
                prop_assert_eq!(&found, &expected, "{}", simd.name());
            }
        }
    }
}
