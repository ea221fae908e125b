//! Functional status of the data in a sampling message (Part 2): four bytes before up to four sets of data say what each set is worth.

use crate::standard::Validity;

/// Bytes of status before the sets of data, one for each.
pub const STATUS_BYTES: usize = 4;

/// What a set of data is worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum FunctionalStatus {
    /// There is none.
    NoData = 0x00,
    /// It may be used.
    NormalOperation = 0x03,
    /// It is for a test.
    FunctionalTest = 0x0C,
    /// Its source can not compute it.
    NoComputedData = 0x30,
}

impl FunctionalStatus {
    /// What a byte says; one that says nothing stands for no data.
    #[must_use]
    pub fn of_byte(byte: u8) -> Self {
        let all = [Self::NormalOperation, Self::FunctionalTest, Self::NoComputedData];
        all.into_iter().find(|status| *status as u8 == byte).unwrap_or(Self::NoData)
    }

    /// Whether the data may be used, by somebody who tests or by anybody else.
    #[must_use]
    pub fn may_be_used(self, in_a_test: bool) -> bool {
        match self {
            Self::NormalOperation => true,
            Self::FunctionalTest => in_a_test,
            Self::NoData | Self::NoComputedData => false,
        }
    }
}

/// The status of each set of a message that was read with this validity: no data where the message is stale or too short.
#[must_use]
pub fn functional_status_of(message: &[u8], validity: Validity) -> [FunctionalStatus; STATUS_BYTES] {
    let bytes = match (validity, message.first_chunk::<STATUS_BYTES>()) {
        (Validity::Valid, Some(bytes)) => *bytes,
        _ => [0; STATUS_BYTES],
    };
    bytes.map(FunctionalStatus::of_byte)
}

/// The bytes of status before up to four sets: those that are not there have no data.
#[must_use]
pub fn status_bytes(sets: &[FunctionalStatus]) -> [u8; STATUS_BYTES] {
    let mut bytes = [FunctionalStatus::NoData as u8; STATUS_BYTES];
    bytes.iter_mut().zip(sets).for_each(|(byte, status)| *byte = *status as u8);
    bytes
}
