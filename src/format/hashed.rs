//! Bytes that are hashed on their way, so that their digest takes no second pass.

use std::io::{self, Write};

use sha2::{Digest, Sha256};

/// Bytes of a SHA-256.
pub(crate) const DIGEST: usize = 32;

/// Passes bytes on, and hashes those that went.
pub(crate) struct Hashed<W> {
    out: W,
    hasher: Sha256,
}

impl<W: Write> Hashed<W> {
    /// Passes bytes on to `out`.
    pub fn new(out: W) -> Self {
        Self { out, hasher: Sha256::new() }
    }

    /// The SHA-256 of all bytes so far, and where they went.
    pub fn finish(self) -> (W, [u8; DIGEST]) {
        (self.out, self.hasher.finalize().into())
    }

    /// The SHA-256 of all bytes so far, as 64 hexadecimal digits.
    pub fn hexadecimal(self) -> String {
        self.finish().1.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

impl<W: Write> Write for Hashed<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let written = self.out.write(bytes)?;
        self.hasher.update(&bytes[..written]);
        Ok(written)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
