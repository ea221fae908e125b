//! The two ends of a channel, whatever its memory is.

use iceoryx2::port::ReceiveError;
use iceoryx2::port::SendError;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::port::update_connections::{ConnectionFailure, UpdateConnections};
use iceoryx2::sample::Sample;

use crate::{Shared, Stamp, sealed};

/// Why a message was not sent.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    /// As many wait as the queue holds.
    #[error("the queue is full")]
    Full,
    /// Anything else.
    #[error("{0}")]
    Other(String),
}

impl From<SendError> for Refusal {
    fn from(error: SendError) -> Self {
        match error {
            SendError::UnableToDeliver => Self::Full,
            other => Self::Other(format!("{other:?}")),
        }
    }
}

/// Why a message could not be received.
#[derive(Debug, thiserror::Error)]
pub enum Unreceived {
    /// What the library said.
    #[error("{0:?}")]
    Library(#[from] ReceiveError),
    /// What stands in the source's memory is no message of this channel.
    #[error("its source's memory holds no message where one belongs")]
    Damaged,
}

/// A source port's writing end.
pub struct Writer(pub(crate) Writing);

pub(crate) enum Writing {
    Shared(Publisher<Shared, [u8], Stamp>),
    Sealed(sealed::Writer),
}

impl Writer {
    /// Sends a message; gives the number of those who receive it. On a sealed sampling channel that is 1, whoever reads.
    ///
    /// # Errors
    /// It was not sent.
    pub fn put(&self, bytes: &[u8], stamp: Stamp) -> Result<usize, Refusal> {
        match &self.0 {
            Writing::Shared(publisher) => {
                let lent = publisher.loan_slice_uninit(bytes.len());
                let mut sample = lent.map_err(|error| Refusal::Other(format!("{error:?}")))?;
                *sample.user_header_mut() = stamp;
                Ok(sample.write_from_slice(bytes).send()?)
            }
            Writing::Sealed(writer) => writer.put(bytes, stamp),
        }
    }

    /// As [`Writer::put`], of what `fill` makes of `bytes` bytes in the channel's memory, which hold what an earlier message left there. They
    /// are aligned to [`crate::ALIGNMENT`].
    ///
    /// # Errors
    /// As there.
    #[allow(unsafe_code)] // memory that the compiler takes for unwritten
    pub fn put_in_place(
        &self,
        bytes: usize,
        stamp: Stamp,
        fill: impl FnOnce(&mut [u8]),
    ) -> Result<usize, Refusal> {
        match &self.0 {
            Writing::Shared(publisher) => {
                let lent = publisher.loan_slice_uninit(bytes);
                let mut sample = lent.map_err(|error| Refusal::Other(format!("{error:?}")))?;
                *sample.user_header_mut() = stamp;
                // SAFETY: the bytes lie in a shared mapping that the kernel handed out as zeros and that only messages were
                // written to; every one of them has a value.
                let mut sample = unsafe { sample.assume_init() };
                fill(sample.payload_mut());
                Ok(sample.send()?)
            }
            Writing::Sealed(writer) => writer.put_in_place(bytes, stamp, fill),
        }
    }

    /// Meets the readers that came since.
    ///
    /// # Errors
    /// One of them can not be met; it is tried again at the next message.
    pub fn connect(&self) -> Result<(), ConnectionFailure> {
        match &self.0 {
            Writing::Shared(publisher) => publisher.update_connections(),
            Writing::Sealed(_) => Ok(()),
        }
    }
}

/// A destination port's reading end.
pub struct Reader(pub(crate) Reading);

pub(crate) enum Reading {
    Shared(Subscriber<Shared, [u8], Stamp>),
    Sealed(sealed::Reader),
}

impl Reader {
    /// The next message; of a sealed sampling channel the latest, once.
    ///
    /// # Errors
    /// There was one that could not be received.
    #[inline]
    pub fn receive(&self) -> Result<Option<Received>, Unreceived> {
        match &self.0 {
            Reading::Shared(subscriber) => {
                Ok(subscriber.receive()?.map(|sample| Received(Message::Shared(sample))))
            }
            Reading::Sealed(reader) => Ok(reader.receive()?.map(|copied| Received(Message::Copied(copied)))),
        }
    }

    /// Whether a message waits. What can not be asked can not be received either.
    #[inline]
    #[must_use]
    pub fn has_messages(&self) -> bool {
        match &self.0 {
            Reading::Shared(subscriber) => subscriber.has_samples().unwrap_or(false),
            Reading::Sealed(reader) => reader.has_messages(),
        }
    }

    /// How many messages of a queue wait; `None`: they have to be received to know, as on every channel that is not sealed.
    #[must_use]
    pub fn waiting(&self) -> Option<usize> {
        match &self.0 {
            Reading::Shared(_) => None,
            Reading::Sealed(reader) => reader.waiting(),
        }
    }

    /// Meets the writers that came since.
    ///
    /// # Errors
    /// As with [`Writer::connect`].
    pub fn connect(&self) -> Result<(), ConnectionFailure> {
        match &self.0 {
            Reading::Shared(subscriber) => subscriber.update_connections(),
            Reading::Sealed(_) => Ok(()),
        }
    }
}

/// One received message: in shared memory, or a copy of its own out of a sealed channel.
pub struct Received(Message);

enum Message {
    Shared(Sample<Shared, [u8], Stamp>),
    Copied(sealed::Copied),
}

impl Received {
    /// The message, aligned to [`crate::ALIGNMENT`].
    #[inline]
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        match &self.0 {
            Message::Shared(sample) => sample.payload(),
            Message::Copied(copied) => copied.bytes(),
        }
    }

    /// What its source said of it.
    #[inline]
    #[must_use]
    pub fn stamp(&self) -> Stamp {
        match &self.0 {
            Message::Shared(sample) => *sample.user_header(),
            Message::Copied(copied) => copied.stamp(),
        }
    }

    /// Whether nothing newer of another process of its source can wait behind it, where `before` was received before it.
    #[inline]
    #[must_use]
    pub fn is_last_after(&self, before: Option<&Self>) -> bool {
        match (&self.0, before.map(|before| &before.0)) {
            (Message::Shared(sample), Some(Message::Shared(before))) => {
                before.header().publisher_id() == sample.header().publisher_id()
            }
            (Message::Shared(_), _) => false,
            (Message::Copied(_), _) => true,
        }
    }
}

impl std::fmt::Debug for Received {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Received")
            .field("stamp", &self.stamp())
            .field("bytes", &self.payload().len())
            .finish()
    }
}
