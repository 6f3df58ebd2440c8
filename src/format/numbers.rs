//! Numbers that come in pieces, written as bytes: no more than a block of them is held here, so
//! that whoever writes an array need not have it whole.

use std::io::{self, ErrorKind, Write};

/// Takes the numbers of an array: a file that is written, or whoever gathers them.
pub trait NumberSink {
    /// Takes the next piece.
    ///
    /// # Errors
    /// If it can take no more.
    fn put(&mut self, piece: &[f32]) -> io::Result<()>;
}

/// Has arrays of numbers, and hands them over one at a time.
pub trait ArraySource {
    /// Puts an array into a sink, in order and piece by piece.
    ///
    /// # Errors
    /// What the sink reports, and numbers that cannot be had.
    ///
    /// # Panics
    /// If there is no array of that index.
    fn array(&self, index: usize, sink: &mut dyn NumberSink) -> io::Result<()>;
}

/// Takes the pieces of several arrays, each with the number of its array.
pub type ArraySink<'a> = dyn FnMut(usize, &[f32]) + 'a;

impl<F: FnMut(&[f32]) -> io::Result<()>> NumberSink for F {
    fn put(&mut self, piece: &[f32]) -> io::Result<()> {
        self(piece)
    }
}

impl<F: Fn(usize, &mut dyn NumberSink) -> io::Result<()>> ArraySource for F {
    fn array(&self, index: usize, sink: &mut dyn NumberSink) -> io::Result<()> {
        self(index, sink)
    }
}

/// Numbers that are converted and passed on at a time: they stay in the caches.
pub(super) const BLOCK: usize = 1 << 14;

/// Writes so many numbers as little-endian `f32`, and refuses more and fewer.
///
/// After an error every other piece is refused, and [`Self::finish`] fails, even if whoever put the
/// piece did not pass the error on.
pub(super) struct NumberWriter<'a, W: ?Sized> {
    out: &'a mut W,
    /// Those that do not fill a block yet.
    buffer: Vec<u32>,
    /// How many there must be.
    count: u64,
    /// How many are to come.
    left: u64,
    /// Why no more are taken.
    failed: Option<ErrorKind>,
}

impl<W: Write + ?Sized> NumberSink for NumberWriter<'_, W> {
    fn put(&mut self, piece: &[f32]) -> io::Result<()> {
        if let Some(kind) = self.failed {
            return Err(kind.into());
        }
        let result = self.pass_on(piece);
        self.failed = result.as_ref().err().map(io::Error::kind);
        result
    }
}

impl<'a, W: Write + ?Sized> NumberWriter<'a, W> {
    /// Writes `count` numbers to `out`.
    pub fn new(out: &'a mut W, count: u64) -> Self {
        Self { out, buffer: Vec::new(), count, left: count, failed: None }
    }

    fn pass_on(&mut self, mut piece: &[f32]) -> io::Result<()> {
        let left = self.left.checked_sub(piece.len() as u64);
        self.left = left.ok_or_else(|| {
            let message = format!("more than {} numbers are to be written", self.count);
            io::Error::new(ErrorKind::InvalidData, message)
        })?;
        while !piece.is_empty() {
            let (block, rest) = piece.split_at(piece.len().min(BLOCK - self.buffer.len()));
            self.buffer.extend(block.iter().map(|number| number.to_bits().to_le()));
            piece = rest;
            if self.buffer.len() == BLOCK {
                self.flush()?;
            }
        }
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.write_all(bytemuck::cast_slice(&self.buffer))?;
        self.buffer.clear();
        Ok(())
    }

    /// Writes what is left.
    ///
    /// # Errors
    /// What the output reports, also of pieces before; [`ErrorKind::InvalidData`] if there were more
    /// numbers or fewer.
    pub fn finish(mut self) -> io::Result<()> {
        if let Some(kind) = self.failed {
            return Err(kind.into());
        }
        if self.left > 0 {
            let Self { count, left, .. } = self;
            let message = format!("{} numbers instead of {count} are to be written", count - left);
            return Err(io::Error::new(ErrorKind::InvalidData, message));
        }
        self.flush()
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn pieces_of_any_size_are_the_whole(
            bits in prop::collection::vec(any::<u32>(), 0..60),
            cuts in prop::collection::vec(any::<prop::sample::Index>(), 0..9),
            repeat in prop_oneof![Just(1_usize), Just(1000)],
        ) {
            let bits = bits.repeat(repeat);
            let numbers: Vec<f32> = bits.iter().map(|bits| f32::from_bits(*bits)).collect();
            let whole: Vec<u8> = bits.iter().flat_map(|bits| bits.to_le_bytes()).collect();
            let mut cuts: Vec<usize> = cuts.iter().map(|cut| cut.index(bits.len() + 1)).collect();
            cuts.extend([0, bits.len()]);
            cuts.sort_unstable();
            let give = |count: usize| {
                let mut bytes = Vec::new();
                let mut writer = NumberWriter::new(&mut bytes, count as u64);
                let put = cuts.windows(2).try_for_each(|cut| writer.put(&numbers[cut[0]..cut[1]]));
                let given = put.and(writer.finish());
                (given.map_err(|error| error.kind()), bytes)
            };
            prop_assert_eq!(give(bits.len()), (Ok(()), whole));
            prop_assert_eq!(give(bits.len() + 1).0, Err(ErrorKind::InvalidData));
            if !bits.is_empty() {
                prop_assert_eq!(give(bits.len() - 1).0, Err(ErrorKind::InvalidData));
            }
        }
    }

    #[test]
    fn an_error_that_is_not_passed_on_is_an_error_all_the_same() {
        // Room for one block, and then for no more.
        let mut room = vec![0; 4 * BLOCK];
        let mut room = room.as_mut_slice();
        let mut writer = NumberWriter::new(&mut room, 3 * BLOCK as u64);
        let refused = (0..3).filter(|_| writer.put(&[0.5; BLOCK]).is_err()).count();
        assert_eq!((writer.finish().unwrap_err().kind(), refused), (ErrorKind::WriteZero, 2));
        // One piece too many, and then the right number.
        let mut bytes = Vec::new();
        let mut writer = NumberWriter::new(&mut bytes, 2);
        assert!(writer.put(&[0.5; 3]).is_err() && writer.put(&[0.5; 2]).is_err());
        assert_eq!(writer.finish().unwrap_err().kind(), ErrorKind::InvalidData);
    }
}
