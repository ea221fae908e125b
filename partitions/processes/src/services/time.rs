//! Time management.

use super::valid;
use crate::partition::{Partition, Progress};
use crate::return_code::ReturnCode;
use crate::scheduling::TimeOut;
use crate::standard::{INFINITE_TIME_VALUE, SystemTime};

impl Partition {
    /// TIMED_WAIT. A delay of 0 lets the caller's equals run first.
    ///
    /// # Errors
    /// INVALID_MODE: the caller owns a mutex or the preemption lock, or is no process. INVALID_PARAM: the delay is infinite or
    /// none.
    pub fn timed_wait(&mut self, delay: SystemTime) -> Result<Progress, ReturnCode> {
        let place = self.may_wait()?;
        match self.time_out(delay)? {
            TimeOut::Never => Err(ReturnCode::InvalidParam),
            TimeOut::Poll => {
                self.yield_to_equals(place);
                Ok(Progress::Done(()))
            }
            TimeOut::At(at) => {
                self.wait_until(place, at);
                Ok(Progress::Waits)
            }
        }
    }

    /// PERIODIC_WAIT: the next release point is one period after the last, whenever this is called. If it has passed, the caller is
    /// ready at once, and no release is left out.
    ///
    /// # Errors
    /// INVALID_MODE: the caller owns a mutex or the preemption lock, is aperiodic, or no process. INVALID_CONFIG: the next deadline
    /// is beyond all times.
    pub fn periodic_wait(&mut self) -> Result<Progress, ReturnCode> {
        let place = self.may_wait()?;
        let process = &self.processes[place];
        if !process.is_periodic() {
            return Err(ReturnCode::InvalidMode);
        }
        let release = process.release.checked_add(process.attributes.period);
        let next = release.and_then(|release| Some((release, process.deadline_of(release)?)));
        let (release, deadline) = next.ok_or(ReturnCode::InvalidConfig)?;
        self.processes[place].release = release;
        self.set_deadline(place, deadline);
        self.wait_until(place, release);
        self.settle(); // the release may have passed, and even the deadline
        Ok(Progress::Waits)
    }

    /// GET_TIME: module time, ns.
    #[must_use]
    pub fn get_time(&self) -> SystemTime {
        self.now
    }

    /// REPLENISH: the caller's deadline is `budget` from now.
    ///
    /// # Errors
    /// NO_ACTION: the caller is the error handler, or the mode is not NORMAL. INVALID_MODE: the deadline of a periodic process would
    /// be after its next release. INVALID_PARAM: the budget.
    pub fn replenish(&mut self, budget: SystemTime) -> Result<(), ReturnCode> {
        let place = self.caller().ok_or(ReturnCode::NoAction)?;
        valid(budget >= INFINITE_TIME_VALUE)?;
        let process = &self.processes[place];
        let next_release = process.release.saturating_add(process.attributes.period);
        let (periodic, unlimited) =
            (process.is_periodic(), process.attributes.time_capacity == INFINITE_TIME_VALUE);
        if budget == INFINITE_TIME_VALUE {
            if periodic {
                return Err(ReturnCode::InvalidMode);
            }
            self.set_deadline(place, INFINITE_TIME_VALUE);
            return Ok(());
        }
        let deadline = self.now.checked_add(budget).ok_or(ReturnCode::InvalidParam)?;
        if periodic && deadline > next_release {
            return Err(ReturnCode::InvalidMode);
        }
        if !unlimited {
            self.set_deadline(place, deadline);
            self.settle();
        }
        Ok(())
    }
}
