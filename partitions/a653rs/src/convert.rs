//! Numbers and names of `a653rs`, as the services have them, and back.

use a653rs::bindings::{ApexName, ApexSystemTime, ErrorReturnCode, MessageSize};
use bateleur_apex::ReturnCode;
use bateleur_apex::processes::standard::INFINITE_TIME_VALUE;
use bateleur_apex::processes::{Process, Progress, Services, current};

/// What a service of `a653rs` gives.
pub(crate) type Answer<T> = Result<T, ErrorReturnCode>;

pub(crate) fn code(code: ReturnCode) -> ErrorReturnCode {
    match code {
        ReturnCode::NoAction => ErrorReturnCode::NoAction,
        ReturnCode::NotAvailable => ErrorReturnCode::NotAvailable,
        ReturnCode::InvalidParam => ErrorReturnCode::InvalidParam,
        ReturnCode::InvalidConfig => ErrorReturnCode::InvalidConfig,
        ReturnCode::InvalidMode => ErrorReturnCode::InvalidMode,
        ReturnCode::TimedOut => ErrorReturnCode::TimedOut,
    }
}

/// Calls a service that does not wait.
pub(crate) fn call<R>(service: impl FnOnce(&mut Services) -> Result<R, ReturnCode>) -> Answer<R> {
    current::as_process(|process| process.call(service)).map_err(code)
}

/// Calls one that may wait.
pub(crate) fn wait(service: impl FnOnce(&mut Services) -> Result<Progress, ReturnCode>) -> Answer<()> {
    current::as_process(|process| process.wait(service)).map_err(code)
}

/// Calls one that gives a message, which is copied into `into`. With what it gave, and the message's length.
pub(crate) fn receive<R>(
    into: &mut [u8],
    service: impl FnOnce(&Process, &mut Vec<u8>) -> Result<R, ReturnCode>,
) -> (Result<R, ReturnCode>, MessageSize) {
    current::receive(service, |result, message| match into.get_mut(..message.len()) {
        Some(place) => {
            place.copy_from_slice(message);
            (result, message.len() as MessageSize) // at most a port's size
        }
        None => (Err(ReturnCode::InvalidParam), 0),
    })
}

/// An identifier; one that nobody has if it is beyond the range of the services.
pub(crate) fn id(number: i64) -> i32 {
    i32::try_from(number).unwrap_or(i32::MIN)
}

/// A size or a count; too large is too large there too.
pub(crate) fn size(number: u32) -> i32 {
    i32::try_from(number).unwrap_or(i32::MAX)
}

/// Every negative time is infinite.
pub(crate) fn time(span: ApexSystemTime) -> ApexSystemTime {
    span.max(INFINITE_TIME_VALUE)
}

/// A name, up to its first NUL.
///
/// # Errors
/// INVALID_CONFIG: it is no text, so that nothing has that name.
pub(crate) fn text(name: &ApexName) -> Answer<&str> {
    let length = name.iter().position(|byte| *byte == 0).unwrap_or(name.len());
    std::str::from_utf8(&name[..length]).map_err(|_| ErrorReturnCode::InvalidConfig)
}

/// A number of the services, which is never negative.
pub(crate) fn unsigned(number: i32) -> u32 {
    number.unsigned_abs()
}
