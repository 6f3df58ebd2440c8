//! AVX2: the copy of every inner loop that is compiled for it, transpositions, a sort, and
//! prefetches.
//!
//! The sort is a bitonic one (Batcher 1968) without a branch on the keys. Blocks of 64 keys are
//! sorted in eight registers (and 32 at the end in four), as columns first, so that most comparisons are between registers;
//! then sorted runs are merged two by two. Every comparator puts the smaller key in front, so
//! registers behind the last one, which would hold the largest of all keys, need not exist.

use std::arch::x86_64::*;

use super::{Isa, LANES, PLACES, SORT_BLOCK, SPARE, Vectorized, check_places};

/// Proof that the processor has AVX2.
#[derive(Clone, Copy)]
struct Avx2(());

/// Runs an operation with AVX2, into which its `#[inline(always)]` body is compiled.
#[target_feature(enable = "avx2")]
pub(super) fn run<V: Vectorized>(operation: V) -> V::Output {
    // Whoever calls this function has made sure of the feature; this is the only place that
    // makes the proof.
    operation.run(Avx2(()))
}

impl Isa for Avx2 {
    #[inline(always)]
    fn sort(self, keys: &mut [u32]) {
        assert!(keys.len().is_multiple_of(SORT_BLOCK));
        let (vectors, _) = keys.as_chunks_mut::<LANES>();
        // SAFETY: an `Avx2` exists, so the processor has the one feature that `sort` needs.
        #[allow(unsafe_code)]
        unsafe {
            sort(vectors)
        }
    }

    #[inline(always)]
    fn split(self, points: &[f32], planes: &mut [f32], n: usize, dims: usize) {
        check(n, dims, points.len(), planes.len());
        // SAFETY: an `Avx2` exists, so the processor has the one feature that these need, and
        // `check` has seen to the sizes that they ask for.
        #[allow(unsafe_code)]
        unsafe {
            match dims {
                1 => planes[..n].copy_from_slice(&points[..n]),
                2 => split_pairs(points.as_ptr(), planes.as_mut_ptr(), n),
                _ => split_fours(points.as_ptr(), planes.as_mut_ptr(), n, dims),
            }
        }
    }

    #[inline(always)]
    fn join(self, planes: &[f32], points: &mut [f32], n: usize, dims: usize) {
        check(n, dims, points.len(), planes.len());
        // SAFETY: as in `split`.
        #[allow(unsafe_code)]
        unsafe {
            match dims {
                1 => points[..n].copy_from_slice(&planes[..n]),
                2 => join_pairs(planes.as_ptr(), points.as_mut_ptr(), n),
                _ => join_fours(planes.as_ptr(), points.as_mut_ptr(), n, dims),
            }
        }
    }

    #[inline(always)]
    fn interpolate(self, table: &[f64], step: f64, out: &mut [f64]) {
        check_places(table.len(), step, out.len());
        // SAFETY: an `Avx2` exists, so the processor has the one feature that this needs, and
        // the check has seen to the sizes that it asks for.
        #[allow(unsafe_code)]
        unsafe {
            interpolate(table, step, out)
        }
    }

    #[inline(always)]
    fn prefetch<T>(self, slice: &[T], index: usize) {
        let place = slice.as_ptr().wrapping_add(index).cast::<i8>();
        // SAFETY: a prefetch reads nothing that the program could see, faults at no address, and
        // needs SSE, which every x86-64 processor has.
        #[allow(unsafe_code)]
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(place)
        }
    }
}

/// Looks up places `i · step`.
///
/// # Safety
/// The table has two nodes or more and fewer than 2³¹, and all places are from 0 to 2³¹.
#[target_feature(enable = "avx2")]
#[inline]
#[allow(unsafe_code)]
unsafe fn interpolate(table: &[f64], step: f64, out: &mut [f64]) {
    let last = _mm_set1_epi32(table.len() as i32 - 2);
    let step = _mm256_set1_pd(step);
    let mut index = _mm256_setr_pd(0.0, 1.0, 2.0, 3.0);
    let (chunks, _) = out.as_chunks_mut::<PLACES>();
    for chunk in chunks {
        let place = _mm256_mul_pd(index, step);
        // Where the conversion overflows at 2³¹ it gives a negative number; as an unsigned one it
        // is past the last node, as it should be.
        let node = _mm_min_epu32(_mm256_cvttpd_epi32(place), last);
        // SAFETY: nodes are from 0 to len − 2, so they and the ones after them are in the table;
        // the chunk is four numbers that may be written.
        unsafe {
            let a = _mm256_i32gather_pd::<8>(table.as_ptr(), node);
            let b = _mm256_i32gather_pd::<8>(table.as_ptr().add(1), node);
            let part = _mm256_sub_pd(place, _mm256_cvtepi32_pd(node));
            let value = _mm256_add_pd(a, _mm256_mul_pd(_mm256_sub_pd(b, a), part));
            _mm256_storeu_pd(chunk.as_mut_ptr(), value);
        }
        index = _mm256_add_pd(index, _mm256_set1_pd(4.0));
    }
}

/// Whether slices have the sizes that transpositions ask for.
#[inline(always)]
fn check(n: usize, dims: usize, points: usize, planes: usize) {
    assert!(n.is_multiple_of(LANES) && dims > 0, "{n} points of {dims} numbers");
    let words = n.checked_mul(dims).expect("numbers that fit into memory");
    assert!(words <= planes && words + SPARE <= points, "{words} numbers");
}

/// Takes points of two numbers apart.
///
/// # Safety
/// `n` is a multiple of 8, and there are 2·n numbers to be read and to be written.
#[target_feature(enable = "avx2")]
#[inline]
#[allow(unsafe_code)]
unsafe fn split_pairs(points: *const f32, planes: *mut f32, n: usize) {
    for i in (0..n).step_by(LANES) {
        // SAFETY: i + 8 ≤ n, so points 2i to 2i + 16 and places i + 8 of both planes exist.
        unsafe {
            let a = _mm256_loadu_ps(points.add(2 * i));
            let b = _mm256_loadu_ps(points.add(2 * i + LANES));
            // Points 0 1 4 5 | 2 3 6 7, then in order.
            let x = _mm256_castps_pd(_mm256_shuffle_ps::<0b10_00_10_00>(a, b));
            let y = _mm256_castps_pd(_mm256_shuffle_ps::<0b11_01_11_01>(a, b));
            let x = _mm256_castpd_ps(_mm256_permute4x64_pd::<0b11_01_10_00>(x));
            let y = _mm256_castpd_ps(_mm256_permute4x64_pd::<0b11_01_10_00>(y));
            _mm256_storeu_ps(planes.add(i), x);
            _mm256_storeu_ps(planes.add(n + i), y);
        }
    }
}

/// Puts two planes together to points.
///
/// # Safety
/// `n` is a multiple of 8, and there are 2·n numbers to be read and to be written.
#[target_feature(enable = "avx2")]
#[inline]
#[allow(unsafe_code)]
unsafe fn join_pairs(planes: *const f32, points: *mut f32, n: usize) {
    for i in (0..n).step_by(LANES) {
        // SAFETY: i + 8 ≤ n, so points 2i to 2i + 16 and places i + 8 of both planes exist.
        unsafe {
            let (x, y) = (_mm256_loadu_ps(planes.add(i)), _mm256_loadu_ps(planes.add(n + i)));
            let (a, b) = (_mm256_unpacklo_ps(x, y), _mm256_unpackhi_ps(x, y));
            _mm256_storeu_ps(points.add(2 * i), _mm256_permute2f128_ps::<0x20>(a, b));
            _mm256_storeu_ps(points.add(2 * i + LANES), _mm256_permute2f128_ps::<0x31>(a, b));
        }
    }
}

/// The first of each four numbers of a point that are moved together. The last four overlap the
/// ones before, unless there are three numbers only and one of the next point is moved with them.
fn fours(dims: usize) -> impl Iterator<Item = usize> {
    (0..dims).step_by(4).map(move |k| k.min(dims.saturating_sub(4)))
}

/// Makes rows of four lanes columns, in both halves of registers.
#[target_feature(enable = "avx2")]
#[inline]
fn turn(r: [__m256; 4]) -> [__m256; 4] {
    let (a, b) = (_mm256_unpacklo_ps(r[0], r[1]), _mm256_unpackhi_ps(r[0], r[1]));
    let (c, d) = (_mm256_unpacklo_ps(r[2], r[3]), _mm256_unpackhi_ps(r[2], r[3]));
    [
        _mm256_shuffle_ps::<0b01_00_01_00>(a, c),
        _mm256_shuffle_ps::<0b11_10_11_10>(a, c),
        _mm256_shuffle_ps::<0b01_00_01_00>(b, d),
        _mm256_shuffle_ps::<0b11_10_11_10>(b, d),
    ]
}

/// Takes points of three or more numbers apart.
///
/// # Safety
/// `n` is a multiple of 8, `dims` is at least 3, there are `n·dims + 4` numbers to be read and
/// `n·dims` to be written.
#[target_feature(enable = "avx2")]
#[inline]
#[allow(unsafe_code)]
unsafe fn split_fours(points: *const f32, planes: *mut f32, n: usize, dims: usize) {
    for i in (0..n).step_by(LANES) {
        for k in fours(dims) {
            // SAFETY: point i + 7 < n exists; four numbers from k on are its own, or with three
            // dimensions one of the next point, or behind the last one.
            let row = |j: usize| unsafe { _mm_loadu_ps(points.add((i + j) * dims + k)) };
            let rows = [0, 1, 2, 3].map(|j| _mm256_set_m128(row(j + 4), row(j)));
            for (j, column) in turn(rows).into_iter().enumerate().take(dims - k) {
                // SAFETY: k + j < dims and i + 8 ≤ n, so the place is in one of the planes.
                unsafe { _mm256_storeu_ps(planes.add((k + j) * n + i), column) }
            }
        }
    }
}

/// Puts three or more planes together to points.
///
/// # Safety
/// `n` is a multiple of 8, `dims` is at least 3, there are `n·dims` numbers to be read and
/// `n·dims + 4` to be written.
#[target_feature(enable = "avx2")]
#[inline]
#[allow(unsafe_code)]
unsafe fn join_fours(planes: *const f32, points: *mut f32, n: usize, dims: usize) {
    for i in (0..n).step_by(LANES) {
        for k in fours(dims) {
            let mut columns = [_mm256_setzero_ps(); 4];
            for (j, column) in columns.iter_mut().enumerate().take(dims - k) {
                // SAFETY: k + j < dims and i + 8 ≤ n, so the place is in one of the planes.
                *column = unsafe { _mm256_loadu_ps(planes.add((k + j) * n + i)) };
            }
            // In rising order: with three dimensions a fourth number falls on the next point,
            // which is written later.
            let rows = turn(columns);
            let lows = rows.map(|row| _mm256_castps256_ps128(row));
            let highs = rows.map(|row| _mm256_extractf128_ps::<1>(row));
            for (j, row) in lows.into_iter().chain(highs).enumerate() {
                // SAFETY: point i + j < n exists; four numbers from k on as in `split_fours`.
                unsafe { _mm_storeu_ps(points.add((i + j) * dims + k), row) }
            }
        }
    }
}

#[target_feature(enable = "avx2")]
#[inline]
fn load(keys: &[u32; LANES]) -> __m256i {
    // SAFETY: the eight keys are 32 bytes that may be read, of any alignment.
    #[allow(unsafe_code)]
    unsafe {
        _mm256_loadu_si256(keys.as_ptr().cast())
    }
}

#[target_feature(enable = "avx2")]
#[inline]
fn store(keys: &mut [u32; LANES], vector: __m256i) {
    // SAFETY: the eight keys are 32 bytes that may be written, of any alignment.
    #[allow(unsafe_code)]
    unsafe {
        _mm256_storeu_si256(keys.as_mut_ptr().cast(), vector)
    }
}

#[target_feature(enable = "avx2")]
fn sort(vectors: &mut [[u32; LANES]]) {
    let (blocks, rest) = vectors.as_chunks_mut::<LANES>();
    for block in blocks {
        sort_block(block);
    }
    if let Some(half) = rest.first_chunk_mut::<HALF>() {
        sort_half(half);
    }
    let mut run = LANES;
    while run < vectors.len() {
        for pair in vectors.chunks_mut(2 * run) {
            if pair.len() > run {
                merge(pair, run);
            }
        }
        run *= 2;
    }
}

/// Registers of half a block, the least that is sorted.
const HALF: usize = SORT_BLOCK / LANES;

/// Puts the smaller keys of each lane into the first register.
#[target_feature(enable = "avx2")]
#[inline]
fn compare(low: &mut __m256i, high: &mut __m256i) {
    (*low, *high) = (_mm256_min_epu32(*low, *high), _mm256_max_epu32(*low, *high));
}

/// Compares the keys of a register with those of another order of them; lanes whose bit is set
/// in `MAX` take the larger one.
#[target_feature(enable = "avx2")]
#[inline]
fn exchange<const MAX: i32>(vector: __m256i, partner: __m256i) -> __m256i {
    _mm256_blend_epi32::<MAX>(_mm256_min_epu32(vector, partner), _mm256_max_epu32(vector, partner))
}

/// Swaps the halves of a register.
#[target_feature(enable = "avx2")]
#[inline]
fn swap_halves(vector: __m256i) -> __m256i {
    _mm256_permute4x64_epi64::<0b01_00_11_10>(vector)
}

/// Lanes from last to first.
#[target_feature(enable = "avx2")]
#[inline]
fn reverse(vector: __m256i) -> __m256i {
    _mm256_permutevar8x32_epi32(vector, _mm256_setr_epi32(7, 6, 5, 4, 3, 2, 1, 0))
}

/// The comparisons between registers that make a bitonic sequence of each lane a rising one.
#[target_feature(enable = "avx2")]
#[inline]
fn finish_columns<const ROWS: usize>(v: &mut [__m256i; ROWS]) {
    for distance in [4, 2, 1] {
        for i in (0..ROWS).filter(|i| i & distance == 0 && distance < ROWS) {
            let (low, high) = v.split_at_mut(i + distance);
            compare(&mut low[i], &mut high[0]);
        }
    }
}

/// Compares each column with the reverse of the one that `order` names; lanes with a bit set in
/// `MAX` take the larger keys.
#[target_feature(enable = "avx2")]
#[inline]
fn mirror_columns<const MAX: i32, const ROWS: usize>(v: &mut [__m256i; ROWS], order: __m256i) {
    for i in 0..ROWS / 2 {
        let (a, b) = (v[i], v[ROWS - 1 - i]);
        v[i] = exchange::<MAX>(a, _mm256_permutevar8x32_epi32(b, order));
        v[ROWS - 1 - i] = exchange::<MAX>(b, _mm256_permutevar8x32_epi32(a, order));
    }
}

/// Merges eight sorted columns to one sequence, column after column in the order 0 4 1 5 2 6 3 7:
/// 0 with 4, then 04 with 15 (and 26 with 37), then 0415 with 2637.
#[target_feature(enable = "avx2")]
#[inline]
fn merge_columns<const ROWS: usize>(v: &mut [__m256i; ROWS]) {
    mirror_columns::<0b1111_0000, ROWS>(v, _mm256_setr_epi32(4, 5, 6, 7, 0, 1, 2, 3));
    finish_columns(v);
    mirror_columns::<0b1010_1010, ROWS>(v, _mm256_setr_epi32(5, 4, 7, 6, 1, 0, 3, 2));
    for vector in v.iter_mut() {
        *vector = exchange::<0b1111_0000>(*vector, swap_halves(*vector));
    }
    finish_columns(v);
    mirror_columns::<0b1100_1100, ROWS>(v, _mm256_setr_epi32(7, 6, 5, 4, 3, 2, 1, 0));
    for vector in v.iter_mut() {
        let pairs = _mm256_shuffle_epi32::<0b10_11_00_01>(*vector);
        *vector = exchange::<0b1010_1010>(*vector, pairs);
        *vector = exchange::<0b1111_0000>(*vector, swap_halves(*vector));
    }
    finish_columns(v);
}

/// Sorts 64 keys.
///
/// Each lane is a column of eight keys. Columns are sorted, then merged; a transposition puts
/// them in order.
#[target_feature(enable = "avx2")]
fn sort_block(keys: &mut [[u32; LANES]; LANES]) {
    let mut v = [_mm256_setzero_si256(); LANES];
    for (vector, keys) in v.iter_mut().zip(&*keys) {
        *vector = load(keys);
    }
    // The optimal network of 19 comparators for eight keys (Knuth, volume 3, section 5.3.4).
    const NETWORK: [(usize, usize); 19] = [
        (0, 2),
        (1, 3),
        (4, 6),
        (5, 7),
        (0, 4),
        (1, 5),
        (2, 6),
        (3, 7),
        (0, 1),
        (2, 3),
        (4, 5),
        (6, 7),
        (2, 4),
        (3, 5),
        (1, 4),
        (3, 6),
        (1, 2),
        (3, 4),
        (5, 6),
    ];
    for (i, j) in NETWORK {
        let (low, high) = v.split_at_mut(j);
        compare(&mut low[i], &mut high[0]);
    }
    merge_columns(&mut v);
    transpose(&mut v);
    for (keys, column) in keys.iter_mut().zip([0, 4, 1, 5, 2, 6, 3, 7]) {
        store(keys, v[column]);
    }
}

/// Sorts 32 keys, as four rows of columns.
#[target_feature(enable = "avx2")]
fn sort_half(keys: &mut [[u32; LANES]; HALF]) {
    let mut v = [_mm256_setzero_si256(); HALF];
    for (vector, keys) in v.iter_mut().zip(&*keys) {
        *vector = load(keys);
    }
    for (i, j) in [(0, 1), (2, 3), (0, 2), (1, 3), (1, 2)] {
        let (low, high) = v.split_at_mut(j);
        compare(&mut low[i], &mut high[0]);
    }
    merge_columns(&mut v);
    // Columns 0 and 4, 1 and 5 and so on become registers, in the order of the sequence.
    let columns = turn(v.map(|row| _mm256_castsi256_ps(row)));
    for (keys, column) in keys.iter_mut().zip(columns) {
        store(keys, _mm256_castps_si256(column));
    }
}

/// Makes lanes registers, and registers lanes.
#[target_feature(enable = "avx2")]
#[inline]
fn transpose(v: &mut [__m256i; LANES]) {
    let t = [0, 2, 4, 6]
        .map(|i| [_mm256_unpacklo_epi32(v[i], v[i + 1]), _mm256_unpackhi_epi32(v[i], v[i + 1])]);
    for half in 0..2 {
        // Rows 4·half to 4·half + 3 of columns 0–3 (low halves) and 4–7 (high halves).
        let (a, b) = (t[2 * half], t[2 * half + 1]);
        v[4 * half] = _mm256_unpacklo_epi64(a[0], b[0]);
        v[4 * half + 1] = _mm256_unpackhi_epi64(a[0], b[0]);
        v[4 * half + 2] = _mm256_unpacklo_epi64(a[1], b[1]);
        v[4 * half + 3] = _mm256_unpackhi_epi64(a[1], b[1]);
    }
    for i in 0..4 {
        let (a, b) = (v[i], v[i + 4]);
        v[i] = _mm256_permute2x128_si256::<0x20>(a, b);
        v[i + 4] = _mm256_permute2x128_si256::<0x31>(a, b);
    }
}

/// Merges the sorted first `run` registers with the sorted rest, which are at most as many.
#[target_feature(enable = "avx2")]
fn merge(pair: &mut [[u32; LANES]], run: usize) {
    for i in (2 * run - pair.len())..run {
        let j = 2 * run - 1 - i;
        let (mut low, mut high) = (load(&pair[i]), reverse(load(&pair[j])));
        compare(&mut low, &mut high);
        store(&mut pair[i], low);
        store(&mut pair[j], reverse(high));
    }
    let mut distance = run / 2;
    while distance >= LANES {
        for group in pair.chunks_mut(2 * distance) {
            if group.len() > distance {
                let (lows, highs) = group.split_at_mut(distance);
                for (low, high) in lows.iter_mut().zip(highs) {
                    let (mut a, mut b) = (load(low), load(high));
                    compare(&mut a, &mut b);
                    store(low, a);
                    store(high, b);
                }
            }
        }
        distance /= 2;
    }
    let (blocks, rest) = pair.as_chunks_mut::<LANES>();
    for block in blocks {
        finish(block);
    }
    if let Some(half) = rest.first_chunk_mut::<HALF>() {
        finish(half);
    }
}

/// Sorts registers that hold a bitonic sequence.
#[target_feature(enable = "avx2")]
#[inline]
fn finish<const ROWS: usize>(block: &mut [[u32; LANES]; ROWS]) {
    let mut v = [_mm256_setzero_si256(); ROWS];
    for (vector, keys) in v.iter_mut().zip(&*block) {
        *vector = load(keys);
    }
    finish_columns(&mut v);
    for (keys, mut vector) in block.iter_mut().zip(v) {
        vector = exchange::<0b1111_0000>(vector, swap_halves(vector));
        let twos = _mm256_shuffle_epi32::<0b01_00_11_10>(vector);
        vector = exchange::<0b1100_1100>(vector, twos);
        let ones = _mm256_shuffle_epi32::<0b10_11_00_01>(vector);
        vector = exchange::<0b1010_1010>(vector, ones);
        store(keys, vector);
    }
}
