//! What a coordinator and a worker say to each other, and how: frames over a socket.
//!
//! Both ends begin with a greeting, whose form is the same in every version: a mark, the number of
//! the protocol and the version of the program. So a worker of another version is known from
//! one that talks nonsense. All that follows are frames: a length, 4 bytes, little-endian, and as
//! many bytes of [`codec`].

use std::fs::File;
use std::io::{self, IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::time::{Duration, Instant};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer,
    SendAncillaryMessage, SendFlags, recvmsg, sendmsg,
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::affinity::Processors;
use crate::codec::{self, CodecError};

/// The first bytes of both ends.
const MARK: [u8; 8] = *b"PCPTRANK";
/// Goes up when a message gets another form.
const PROTOCOL: u32 = 1;
/// Of a version, in bytes: its length is one byte of the greeting.
const VERSION_LIMIT: usize = u8::MAX as usize;
/// Of the bytes of a message.
const MESSAGE_LIMIT: usize = 64 << 20;
/// Of the memory that a message asks for: a small number takes 1 byte in a frame and 8 in memory.
const MEMORY_LIMIT: usize = MESSAGE_LIMIT + (64 << 10);
/// Read from one end before another has its turn, in bytes.
const TURN: usize = 4 << 20;

/// The other end does not say what it should.
#[derive(Debug, Error)]
pub enum MessageError {
    /// It does not greet.
    #[error("the other end is none of this program: it begins with \"{}\"", .0.escape_ascii())]
    Stranger(Vec<u8>),
    /// It is another version.
    #[error(
        "the other end is version {theirs} (protocol {their_protocol}), and this is version \
         {ours} (protocol {PROTOCOL})"
    )]
    Version {
        /// Its version.
        theirs: String,
        /// Its protocol.
        their_protocol: u32,
        /// The version of this process.
        ours: String,
    },
    /// A version that no greeting can carry.
    #[error("the version {0:?} is not up to {VERSION_LIMIT} bytes of printable text")]
    BadVersion(String),
    /// A message over the limit.
    #[error("a message has {0} bytes, where {MESSAGE_LIMIT} are allowed")]
    TooLong(usize),
    /// Bytes that are no message.
    #[error("the other end sent bytes that are no message: {0}")]
    Codec(CodecError),
    /// A message at the wrong time.
    #[error("the other end sent the message {0}, which has no place there")]
    Unexpected(&'static str),
    /// A message that lacks the file it speaks of.
    #[error("the other end sent no file of shared memory")]
    NoMemory,
    /// Nothing came in time.
    #[error("the other end did not answer within {0:?}")]
    Late(Duration),
    /// The other end has gone.
    #[error("the other end has gone")]
    Gone,
    /// The system refused.
    #[error("cannot talk to the other end: {0}")]
    System(io::Error),
}

// By hand, as both show the error themselves: a source would be shown a second time.
impl From<CodecError> for MessageError {
    fn from(error: CodecError) -> Self {
        Self::Codec(error)
    }
}

impl From<io::Error> for MessageError {
    fn from(error: io::Error) -> Self {
        Self::System(error)
    }
}

/// What follows the greeting.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum Control {
    /// To a worker, first and once; the file of shared memory comes along.
    Setup {
        /// Its index, below `workers`.
        index: usize,
        /// Number of workers.
        workers: usize,
        /// What it is to be bound to; to nothing if none.
        processors: Option<Processors>,
        /// For its work.
        payload: Vec<u8>,
    },
    /// From a worker: it takes jobs from now on.
    Ready,
    /// From a worker: it cannot go on, and why, in words for users.
    Failed(String),
    /// From a worker, last: what is left to say.
    Report(Vec<u8>),
}

impl Control {
    fn name(&self) -> &'static str {
        match self {
            Self::Setup { .. } => "Setup",
            Self::Ready => "Ready",
            Self::Failed(_) => "Failed",
            Self::Report(_) => "Report",
        }
    }

    /// The error of an end that did not expect this message.
    pub fn unexpected(&self) -> MessageError {
        MessageError::Unexpected(self.name())
    }
}

/// The greeting of a program of this version.
///
/// # Errors
/// A version that is too long or has bytes that a terminal would obey.
pub fn greeting(version: &str) -> Result<Vec<u8>, MessageError> {
    let length = u8::try_from(version.len()).ok().filter(|_| is_printable(version));
    let length = length.ok_or_else(|| MessageError::BadVersion(version.to_owned()))?;
    let mut bytes = MARK.to_vec();
    bytes.extend(PROTOCOL.to_le_bytes());
    bytes.push(length);
    bytes.extend(version.as_bytes());
    Ok(bytes)
}

/// Takes a greeting from the front of `bytes`, once it is there, and compares it with the version
/// of this process.
///
/// # Errors
/// Bytes that are none, as soon as that is clear, or another version.
fn take_greeting(bytes: &mut Vec<u8>, ours: &str) -> Result<bool, MessageError> {
    const HEAD: usize = MARK.len() + 5;
    let stranger = |bytes: &[u8]| MessageError::Stranger(bytes[..bytes.len().min(32)].to_vec());
    if !bytes.iter().zip(MARK).all(|(byte, mark)| *byte == mark) {
        return Err(stranger(bytes));
    }
    let Some(&[a, b, c, d, length]) = bytes.get(MARK.len()..HEAD) else {
        return Ok(false);
    };
    let Some(version) = bytes.get(HEAD..HEAD + usize::from(length)) else {
        return Ok(false);
    };
    let version = str::from_utf8(version).ok().filter(|version| is_printable(version));
    let theirs = version.ok_or_else(|| stranger(bytes))?.to_owned();
    let their_protocol = u32::from_le_bytes([a, b, c, d]);
    if (their_protocol, theirs.as_str()) != (PROTOCOL, ours) {
        return Err(MessageError::Version { theirs, their_protocol, ours: ours.to_owned() });
    }
    bytes.drain(..HEAD + usize::from(length));
    Ok(true)
}

fn is_printable(text: &str) -> bool {
    !text.contains(char::is_control)
}

/// A message as a frame.
///
/// # Errors
/// A message over the limit.
pub fn frame(message: &Control) -> Result<Vec<u8>, MessageError> {
    let body = codec::encode(message)?;
    let length = u32::try_from(body.len()).ok().filter(|_| body.len() <= MESSAGE_LIMIT);
    let mut bytes = length.ok_or(MessageError::TooLong(body.len()))?.to_le_bytes().to_vec();
    bytes.extend(body);
    Ok(bytes)
}

/// Takes a message from the front of `bytes`, once all of it is there.
///
/// # Errors
/// A length over the limit, as soon as it is known, or bytes that are no message.
fn take_message(bytes: &mut Vec<u8>) -> Result<Option<Control>, MessageError> {
    let Some((&head, rest)) = bytes.split_first_chunk::<4>() else {
        return Ok(None);
    };
    let length = u32::from_le_bytes(head) as usize;
    if length > MESSAGE_LIMIT {
        return Err(MessageError::TooLong(length));
    }
    let Some(body) = rest.get(..length) else {
        return Ok(None);
    };
    let message = codec::decode::<Control, MEMORY_LIMIT>(body)?;
    bytes.drain(..4 + length);
    Ok(Some(message))
}

/// One end of the socket between a coordinator and a worker. No call waits unless it says so.
#[derive(Debug)]
pub struct Socket {
    stream: UnixStream,
    /// Arrived, and not yet taken.
    arrived: Vec<u8>,
    /// The file that came along.
    file: Option<File>,
    /// To be sent from `sent` on.
    outgoing: Vec<u8>,
    sent: usize,
    /// Goes along with the next byte.
    file_to_send: Option<File>,
    gone: bool,
}

impl Socket {
    /// A socket over this end.
    ///
    /// # Errors
    /// What the system reports.
    pub fn new(stream: UnixStream) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        Ok(Self {
            stream,
            arrived: Vec::new(),
            file: None,
            outgoing: Vec::new(),
            sent: 0,
            file_to_send: None,
            gone: false,
        })
    }

    /// Another handle of the same end.
    ///
    /// # Errors
    /// What the system reports.
    pub fn stream(&self) -> io::Result<UnixStream> {
        self.stream.try_clone()
    }

    /// Whether the other end has gone. What it said before may still wait to be taken.
    pub fn is_gone(&self) -> bool {
        self.gone
    }

    /// Whether all that was queued is sent.
    pub fn is_sent(&self) -> bool {
        self.outgoing.is_empty()
    }

    /// Puts bytes behind those that wait to be sent.
    pub fn queue(&mut self, bytes: &[u8]) {
        self.outgoing.extend(bytes);
    }

    /// The same with a file, which arrives before the last of the bytes. One file can be on its
    /// way at a time.
    pub fn queue_with(&mut self, bytes: &[u8], file: File) {
        self.file_to_send = Some(file);
        self.queue(bytes);
    }

    /// The file that has arrived, once.
    pub fn take_file(&mut self) -> Option<File> {
        self.file.take()
    }

    /// Sends and receives what can be without waiting. That the other end has gone is no error.
    ///
    /// # Errors
    /// What the system reports.
    pub fn exchange(&mut self) -> Result<(), MessageError> {
        self.send()?;
        Ok(self.receive()?)
    }

    fn send(&mut self) -> io::Result<()> {
        while !self.gone && !self.is_sent() {
            let file = self.file_to_send.as_ref().map(|file| file.as_fd());
            match send_some(&self.stream, &self.outgoing[self.sent..], file) {
                Ok(0) | Err(Errno::AGAIN) => return Ok(()),
                Ok(count) => {
                    self.file_to_send = None;
                    self.sent += count;
                }
                Err(Errno::INTR) => (),
                // What it said before it went is still to be read, so this is not the end.
                Err(Errno::PIPE | Errno::CONNRESET) => self.sent = self.outgoing.len(),
                Err(error) => return Err(error.into()),
            }
            if self.sent == self.outgoing.len() {
                (self.outgoing, self.sent) = (Vec::new(), 0);
            }
        }
        Ok(())
    }

    fn receive(&mut self) -> io::Result<()> {
        // The memory that a message needs grows with the bytes that really come.
        let mut buffer = [0; 1 << 16];
        let mut read = 0;
        while !self.gone && read < TURN {
            match receive_some(&self.stream, &mut buffer) {
                Ok((0, _)) | Err(Errno::CONNRESET) => self.gone = true,
                Ok((count, file)) => {
                    self.arrived.extend(&buffer[..count]);
                    self.file = file.or(self.file.take());
                    read += count;
                }
                Err(Errno::AGAIN) => return Ok(()),
                Err(Errno::INTR) => (),
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// Whether the other end has greeted as the same version.
    ///
    /// # Errors
    /// Bytes that are no greeting, or another version.
    pub fn greeted(&mut self, ours: &str) -> Result<bool, MessageError> {
        take_greeting(&mut self.arrived, ours)
    }

    /// The next message, if all of it has arrived.
    ///
    /// # Errors
    /// A message over the limit, or bytes that are none.
    pub fn message(&mut self) -> Result<Option<Control>, MessageError> {
        take_message(&mut self.arrived)
    }

    /// Waits until `take` finds what it looks for.
    ///
    /// # Errors
    /// Those of `take`, [`MessageError::Gone`], and [`MessageError::Late`] after `within`.
    pub fn wait<T>(
        &mut self,
        within: Option<Duration>,
        mut take: impl FnMut(&mut Self) -> Result<Option<T>, MessageError>,
    ) -> Result<T, MessageError> {
        let start = Instant::now();
        loop {
            self.exchange()?;
            if let Some(found) = take(self)? {
                return Ok(found);
            }
            if self.gone {
                return Err(MessageError::Gone);
            }
            let left = within.map(|within| within.saturating_sub(start.elapsed()));
            if left.is_some_and(|left| left.is_zero()) {
                return Err(MessageError::Late(within.unwrap_or_default()));
            }
            wait_for_any([&*self], left)?;
        }
    }
}

/// Waits until one of the sockets can go on, but no longer than `within`.
///
/// # Errors
/// What the system reports.
pub fn wait_for_any<'a>(
    sockets: impl IntoIterator<Item = &'a Socket>,
    within: Option<Duration>,
) -> io::Result<()> {
    let mut ends: Vec<PollFd> = sockets
        .into_iter()
        // Those that have gone would end the waiting at once, for ever.
        .filter(|socket| !socket.gone)
        .map(|socket| {
            let sending = if socket.is_sent() { PollFlags::empty() } else { PollFlags::OUT };
            PollFd::new(&socket.stream, PollFlags::IN | sending)
        })
        .collect();
    let within = within.map(timespec);
    match poll(&mut ends, within.as_ref()) {
        Ok(_) | Err(Errno::INTR) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// A time to wait as the system takes it. One that is too long for it is as good as the longest.
pub fn timespec(time: Duration) -> Timespec {
    const LONGEST: Timespec = Timespec { tv_sec: 1 << 30, tv_nsec: 0 };
    Timespec::try_from(time).map_or(LONGEST, |time| time.min(LONGEST))
}

fn send_some(
    stream: &UnixStream,
    bytes: &[u8],
    file: Option<BorrowedFd<'_>>,
) -> rustix::io::Result<usize> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut control = SendAncillaryBuffer::new(&mut space);
    let files = file.map(|file| [file]);
    if let Some(files) = &files
        && !control.push(SendAncillaryMessage::ScmRights(files))
    {
        return Err(Errno::NOBUFS);
    }
    // A worker that died is no reason for this process to die of SIGPIPE.
    #[cfg(target_os = "linux")]
    let flags = SendFlags::NOSIGNAL;
    #[cfg(not(target_os = "linux"))]
    let flags = SendFlags::empty();
    sendmsg(stream, &[IoSlice::new(bytes)], &mut control, flags)
}

fn receive_some(
    stream: &UnixStream,
    buffer: &mut [u8],
) -> rustix::io::Result<(usize, Option<File>)> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(1))];
    let mut control = RecvAncillaryBuffer::new(&mut space);
    #[cfg(target_os = "linux")]
    let flags = RecvFlags::CMSG_CLOEXEC;
    #[cfg(not(target_os = "linux"))]
    let flags = RecvFlags::empty();
    let count = recvmsg(stream, &mut [IoSliceMut::new(buffer)], &mut control, flags)?.bytes;
    let mut file: Option<OwnedFd> = None;
    for message in control.drain() {
        if let RecvAncillaryMessage::ScmRights(files) = message {
            file = files.last().or(file);
        }
    }
    #[cfg(not(target_os = "linux"))]
    if let Some(file) = &file {
        rustix::io::fcntl_setfd(file, rustix::io::FdFlags::CLOEXEC)?;
    }
    Ok((count, file.map(File::from)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::io::{Read, Seek, Write};

    fn messages() -> [Control; 5] {
        let processors = Processors { node: 1, cpus: vec![2, 300] };
        [
            Control::Setup {
                index: 2,
                workers: 3,
                processors: Some(processors),
                payload: vec![1, 2, 255],
            },
            Control::Setup { index: 0, workers: 1, processors: None, payload: vec![] },
            Control::Ready,
            Control::Failed("no memory".to_owned()),
            Control::Report(vec![7; 300]),
        ]
    }

    fn pair() -> (Socket, Socket) {
        let (a, b) = UnixStream::pair().unwrap();
        (Socket::new(a).unwrap(), Socket::new(b).unwrap())
    }

    const SOON: Option<Duration> = Some(Duration::from_secs(300));

    #[test]
    fn greetings_and_messages_arrive_in_order() {
        let mut bytes = greeting("1.2.3").unwrap();
        messages().iter().for_each(|message| bytes.extend(frame(message).unwrap()));
        // However the bytes are cut.
        for cut in 0..bytes.len() {
            let mut arrived = bytes[..cut].to_vec();
            let mut greeted = take_greeting(&mut arrived, "1.2.3").unwrap();
            let mut found = Vec::new();
            while greeted && let Some(message) = take_message(&mut arrived).unwrap() {
                found.push(message);
            }
            arrived.extend(&bytes[cut..]);
            greeted = greeted || take_greeting(&mut arrived, "1.2.3").unwrap();
            assert!(greeted);
            while let Some(message) = take_message(&mut arrived).unwrap() {
                found.push(message);
            }
            assert_eq!((found.as_slice(), arrived.as_slice()), (&messages()[..], &[][..]));
        }
    }

    #[test]
    fn another_version_is_named() {
        let mut bytes = greeting("2.0").unwrap();
        let text = take_greeting(&mut bytes.clone(), "1.9").unwrap_err().to_string();
        assert_eq!(
            text,
            "the other end is version 2.0 (protocol 1), and this is version 1.9 (protocol 1)"
        );
        bytes[MARK.len()] = 9;
        let text = take_greeting(&mut bytes, "2.0").unwrap_err().to_string();
        assert!(text.contains("version 2.0 (protocol 9)"), "{text}");
        for bad in ["v".repeat(256), "1.0\x1b[2J".to_owned()] {
            assert!(matches!(greeting(&bad), Err(MessageError::BadVersion(_))));
        }
        assert!(greeting(&"v".repeat(255)).is_ok());
    }

    #[test]
    fn what_does_not_greet_is_a_stranger() {
        let text = take_greeting(&mut b"hello\n".to_vec(), "1").unwrap_err().to_string();
        assert_eq!(text, "the other end is none of this program: it begins with \"hello\\n\"");
        assert!(!take_greeting(&mut MARK[..5].to_vec(), "1").unwrap());
    }

    #[test]
    fn a_length_that_lies_is_refused() {
        let huge = (MESSAGE_LIMIT as u32 + 1).to_le_bytes();
        assert!(matches!(take_message(&mut huge.to_vec()), Err(MessageError::TooLong(_))));
        let mut waits = (MESSAGE_LIMIT as u32).to_le_bytes().to_vec();
        assert!(take_message(&mut waits).unwrap().is_none());
        assert!(waits.capacity() < 100);
        let long = Control::Report(vec![0; MESSAGE_LIMIT]);
        assert!(matches!(frame(&long), Err(MessageError::TooLong(_))));
    }

    #[test]
    fn the_longest_message_passes() {
        let (mut a, mut b) = pair();
        let report = Control::Report((0..MESSAGE_LIMIT - 6).map(|i| i as u8).collect());
        let bytes = frame(&report).unwrap();
        assert_eq!(bytes.len(), 4 + MESSAGE_LIMIT);
        std::thread::scope(|scope| {
            scope.spawn(move || {
                a.queue(&bytes);
                a.wait(SOON, |a| Ok(a.is_sent().then_some(()))).unwrap();
            });
            assert!(b.wait(SOON, Socket::message).unwrap() == report);
        });
        assert!(matches!(b.wait(SOON, Socket::message), Err(MessageError::Gone)));
    }

    #[test]
    fn a_file_comes_along() {
        let (mut a, mut b) = pair();
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(b"shared").unwrap();
        a.queue(&greeting("1").unwrap());
        a.queue_with(&frame(&Control::Ready).unwrap(), file);
        a.exchange().unwrap();
        b.wait(SOON, |b| Ok(b.greeted("1")?.then_some(()))).unwrap();
        assert_eq!(b.wait(SOON, Socket::message).unwrap(), Control::Ready);
        let mut file = b.take_file().unwrap();
        let mut text = String::new();
        file.rewind().unwrap();
        file.read_to_string(&mut text).unwrap();
        assert_eq!(text, "shared");
        assert!(b.take_file().is_none());
    }

    #[test]
    fn an_end_that_is_silent_or_gone_is_an_error() {
        let (mut a, b) = pair();
        let late = a.wait(Some(Duration::from_millis(20)), Socket::message).unwrap_err();
        assert_eq!(late.to_string(), "the other end did not answer within 20ms");
        drop(b);
        a.queue(&[0; 9]);
        assert!(matches!(a.wait(SOON, Socket::message), Err(MessageError::Gone)));
        assert!(a.is_gone());
    }

    proptest! {
        #[test]
        fn no_bytes_do_harm(
            which in 0_usize..5, cut in any::<prop::sample::Index>(),
            changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4),
            garbage in proptest::collection::vec(any::<u8>(), 0..40),
        ) {
            let mut bytes = greeting("1.2.3").unwrap();
            bytes.extend(frame(&messages()[which]).unwrap());
            for (place, byte) in changes {
                let place = place.index(bytes.len());
                bytes[place] = byte;
            }
            bytes.truncate(cut.index(bytes.len() + 1));
            for mut bytes in [[bytes.clone(), garbage.clone()].concat(), garbage] {
                let (mut a, mut b) = pair();
                a.queue(&bytes);
                a.exchange().unwrap();
                drop(a);
                if b.wait(SOON, |b| Ok(b.greeted("1.2.3")?.then_some(()))).is_ok() {
                    while b.wait(SOON, Socket::message).is_ok() {}
                }
                while let Ok(Some(_)) = take_message(&mut bytes) {}
            }
        }
    }
}
