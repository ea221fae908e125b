//! Health monitoring.

use super::{configured, valid};
use crate::health::{Handler, Notice, Occurrence};
use crate::partition::{Partition, Runner};
use crate::return_code::ReturnCode;
use crate::standard::{
    ErrorCode, ErrorHandlerConcurrency, ErrorStatus, MAIN_PROCESS_ID, NULL_PROCESS_ID, Text,
};

impl Partition {
    /// REPORT_APPLICATION_MESSAGE: recorded, no error.
    ///
    /// # Errors
    /// INVALID_PARAM: the message has more than 128 bytes.
    pub fn report_application_message(&mut self, message: &[u8]) -> Result<(), ReturnCode> {
        let text = Text::new(message).ok_or(ReturnCode::InvalidParam)?;
        let process = match self.running() {
            Some(Runner::Main) => MAIN_PROCESS_ID,
            Some(Runner::Process(id)) => id,
            Some(Runner::Handler) | None => NULL_PROCESS_ID,
        };
        self.notices.add(Notice::Report { time: self.now, process, text });
        Ok(())
    }

    /// CREATE_ERROR_HANDLER. It runs from its entry point whenever an error comes, above all processes.
    ///
    /// # Errors
    /// NO_ACTION: it exists. INVALID_CONFIG: the stack's size, or no memory is left. INVALID_MODE: NORMAL.
    pub fn create_error_handler(&mut self, stack_size: u32) -> Result<(), ReturnCode> {
        if self.handler.is_some() {
            return Err(ReturnCode::NoAction);
        }
        let limits = &self.settings.limits;
        let stacks = self.stack_memory + u64::from(stack_size);
        configured(limits.stack.contains(&stack_size) && stacks <= limits.stack_memory)?;
        self.initialising()?;
        self.stack_memory = stacks;
        let concurrency = ErrorHandlerConcurrency::ProcessesPause;
        let (active, lent, serves_start) = (false, false, false);
        self.handler = Some(Handler { active, lent, life: 0, serves_start, concurrency, core: 0 });
        Ok(())
    }

    /// ENABLE_ERROR_HANDLER: before NORMAL too, the error handler runs at once when an error comes. A fault of the main process, which
    /// could not go on, is still the partition's.
    ///
    /// # Errors
    /// NO_ACTION: there is no error handler.
    pub fn enable_error_handler(&mut self) -> Result<(), ReturnCode> {
        self.handler.as_mut().ok_or(ReturnCode::NoAction)?.serves_start = true;
        Ok(())
    }

    /// GET_ERROR_STATUS: the oldest error, which leaves the list.
    ///
    /// # Errors
    /// INVALID_CONFIG: the caller is not the error handler. NO_ACTION: there is none.
    pub fn get_error_status(&mut self) -> Result<ErrorStatus, ReturnCode> {
        configured(self.running() == Some(Runner::Handler))?;
        self.errors.take().ok_or(ReturnCode::NoAction)
    }

    /// RAISE_APPLICATION_ERROR. The error handler runs at once, and the caller goes on after it.
    ///
    /// # Errors
    /// INVALID_PARAM: the message has more than 128 bytes, or the code is not APPLICATION_ERROR.
    pub fn raise_application_error(
        &mut self,
        code: impl Into<u32>,
        message: &[u8],
    ) -> Result<(), ReturnCode> {
        let text = Text::new(message).ok_or(ReturnCode::InvalidParam)?;
        valid(code.into() == u32::from(ErrorCode::ApplicationError))?;
        let who = self.running();
        self.error(Occurrence { code: ErrorCode::ApplicationError, who, address: 0, text });
        Ok(())
    }

    /// CONFIGURE_ERROR_HANDLER.
    ///
    /// # Errors
    /// INVALID_CONFIG: there is no error handler, or the partition has no such core. INVALID_MODE: NORMAL. INVALID_PARAM: the
    /// concurrency.
    pub fn configure_error_handler(
        &mut self,
        concurrency: impl Into<u32>,
        core: i32,
    ) -> Result<(), ReturnCode> {
        configured(self.handler.is_some())?;
        self.initialising()?;
        configured((0..self.settings.cores).contains(&core))?;
        let concurrency = ErrorHandlerConcurrency::try_from(concurrency.into())?;
        if let Some(handler) = &mut self.handler {
            (handler.concurrency, handler.core) = (concurrency, core);
        }
        Ok(())
    }
}
