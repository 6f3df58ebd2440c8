//! Messages of MPI that are sent again and again: requests that are set up once.

use std::ffi::c_int;
use std::mem;
use std::ptr::{self, NonNull};
use std::slice;
use std::sync::Arc;
use std::thread;

use ::mpi::ffi;

use crate::communicator::{Message, Transfer};
use crate::mpi::library::{Library, Turn, count, patient};

/// A transfer between ranks of MPI.
pub(super) struct Persistent {
    library: Arc<Library>,
    outgoing: Vec<Buffer>,
    incoming: Vec<Buffer>,
    requests: Requests,
    /// Whether the buffers are the library's.
    under_way: bool,
}

/// What moves the buffers, those that arrive first. There is one for each piece of a message;
/// between two ranks, pieces are in order.
struct Requests(Vec<ffi::MPI_Request>);

// SAFETY: they are names that only the library looks behind, and it does so for any thread whose
// turn it is.
unsafe impl Send for Requests {}

impl Persistent {
    /// Messages to and from ranks that there are, cut into pieces of at most so many words.
    pub fn new(
        library: Arc<Library>,
        outgoing: &[Message],
        incoming: &[Message],
        most: usize,
    ) -> Self {
        let tag = library.next_tag();
        let buffers = |messages: &[Message]| -> Vec<Buffer> {
            messages.iter().map(|message| Buffer::new(message.words)).collect()
        };
        let (from, to) = (buffers(incoming), buffers(outgoing));
        let mut requests = Vec::new();
        // SAFETY: it is set when the program starts, and never again.
        let none = unsafe { ffi::RSMPI_REQUEST_NULL };
        for (message, buffer) in incoming.iter().zip(&from) {
            for (start, words) in pieces(message.words, most) {
                let mut request = none;
                library.call("MPI_Recv_init", |comm| {
                    // SAFETY: the piece lies in the buffer, which stays where it is until the
                    // request is freed. Nothing is written before the request is started.
                    unsafe {
                        ffi::MPI_Recv_init(
                            buffer.base.add(start).as_ptr().cast(),
                            count(words),
                            ffi::RSMPI_UINT32_T,
                            message.rank as c_int,
                            tag,
                            comm,
                            &mut request,
                        )
                    }
                });
                requests.push(request);
            }
        }
        for (message, buffer) in outgoing.iter().zip(&to) {
            for (start, words) in pieces(message.words, most) {
                let mut request = none;
                library.call("MPI_Send_init", |comm| {
                    // SAFETY: as above; nothing is read before the request is started.
                    unsafe {
                        ffi::MPI_Send_init(
                            buffer.base.add(start).as_ptr().cast(),
                            count(words),
                            ffi::RSMPI_UINT32_T,
                            message.rank as c_int,
                            tag,
                            comm,
                            &mut request,
                        )
                    }
                });
                requests.push(request);
            }
        }
        let requests = Requests(requests);
        Self { library, outgoing: to, incoming: from, requests, under_way: false }
    }
}

impl Requests {
    /// Whether all are complete.
    fn test(&mut self, library: &Library, turn: Turn<'_>) -> bool {
        let Self(requests) = self;
        let mut done = 0;
        library.call_in(turn, "MPI_Testall", |_| {
            // SAFETY: the requests are persistent ones, of which those that are complete do no
            // harm, and nobody wants to know their statuses.
            unsafe {
                ffi::MPI_Testall(
                    count(requests.len()),
                    requests.as_mut_ptr(),
                    &mut done,
                    ffi::RSMPI_STATUSES_IGNORE,
                )
            }
        });
        done != 0
    }
}

impl Transfer for Persistent {
    fn outgoing(&mut self) -> Vec<&mut [u32]> {
        assert!(!self.under_way, "a transfer that is under way");
        // SAFETY: no request is active, so nobody else looks at the buffers, and none can become
        // so while the transfer is borrowed.
        self.outgoing.iter_mut().map(|buffer| unsafe { buffer.words_mut() }).collect()
    }

    fn incoming(&self) -> Vec<&[u32]> {
        assert!(!self.under_way, "a transfer that is under way");
        // SAFETY: no request is active, so nobody writes to the buffers, and none can become so
        // while the transfer is borrowed.
        self.incoming.iter().map(|buffer| unsafe { buffer.words() }).collect()
    }

    fn start(&mut self) {
        assert!(!self.under_way, "a transfer that is under way");
        self.under_way = true;
        // One by one: started all at once they have no order, and pieces of a message need one.
        for request in &mut self.requests.0 {
            self.library.call("MPI_Start", |_| {
                // SAFETY: the request is not active, and its buffer is there and left alone until
                // it is complete: `under_way` says so to all that look at buffers.
                unsafe { ffi::MPI_Start(request) }
            });
        }
    }

    fn progress(&mut self) {
        // The library moves all messages while it looks after these. If it is another's turn, that
        // one's call does as well.
        if self.under_way
            && let Some(turn) = self.library.try_turn()
        {
            self.requests.test(&self.library, turn);
        }
    }

    fn finish(&mut self) {
        let mut pause = patient();
        while self.under_way {
            if self.requests.test(&self.library, self.library.turn()) {
                self.under_way = false;
            } else {
                pause();
            }
        }
    }
}

impl Drop for Persistent {
    fn drop(&mut self) {
        if self.under_way && thread::panicking() {
            // The other ends may never come, so this does not wait. The library goes on writing to
            // the buffers: they are left to it, and it is not finalised.
            mem::forget(mem::take(&mut self.outgoing));
            mem::forget(mem::take(&mut self.incoming));
            mem::forget(Arc::clone(&self.library));
            return;
        }
        self.finish();
        for request in &mut self.requests.0 {
            self.library.call("MPI_Request_free", |_| {
                // SAFETY: the request is not active, and MPI is not finalised: the transfer has
                // the library.
                unsafe { ffi::MPI_Request_free(request) }
            });
        }
    }
}

/// Words that the library may work on while this moves; a `Vec` or a `Box` would claim them.
struct Buffer {
    base: NonNull<u32>,
    len: usize,
}

// SAFETY: it owns its words, as a `Box` does.
unsafe impl Send for Buffer {}

impl Buffer {
    /// So many zeros.
    fn new(len: usize) -> Self {
        let words = Box::leak(vec![0_u32; len].into_boxed_slice());
        Self { base: NonNull::from(words).cast(), len }
    }

    /// # Safety
    /// Nobody writes to the words while they are borrowed.
    unsafe fn words(&self) -> &[u32] {
        // SAFETY: they are from `new`; the rest the caller promises.
        unsafe { slice::from_raw_parts(self.base.as_ptr(), self.len) }
    }

    /// # Safety
    /// Nobody else looks at the words while they are borrowed.
    unsafe fn words_mut(&mut self) -> &mut [u32] {
        // SAFETY: they are from `new`; the rest the caller promises.
        unsafe { slice::from_raw_parts_mut(self.base.as_ptr(), self.len) }
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        let words = ptr::slice_from_raw_parts_mut(self.base.as_ptr(), self.len);
        // SAFETY: it is what `new` leaked. No request works on it: the transfer is done with them
        // before it drops its buffers.
        drop(unsafe { Box::from_raw(words) });
    }
}

/// Where the pieces of a message begin and how long they are, in words.
fn pieces(words: usize, most: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..words).step_by(most).map(move |start| (start, most.min(words - start)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_cover_a_message_once_and_in_order() {
        for (words, most) in
            [(0, 3), (1, 3), (3, 3), (7, 3), (9, 3), (5, 1), ((1 << 32) + 5, 1 << 28)]
        {
            let mut end = 0;
            for (start, len) in pieces(words, most) {
                assert_eq!(start, end);
                assert!((1..=most).contains(&len));
                end += len;
            }
            assert_eq!(end, words);
        }
    }
}
