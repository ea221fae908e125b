//! Name services (Part 2): the addresses of service access points by their names, and the names by the addresses. All that one knows stands
//! in the plan, so an answer is there at once or does not come.

use super::{configured, copy, discipline, valid};
use crate::partition::{Partition, Progress};
use crate::queues::ListId;
use crate::return_code::ReturnCode;
use crate::scheduling::TimeOut;
use crate::standard::{NameServiceId, QueuingDiscipline, SapAddress, SystemTime};

/// A name service that was created.
#[derive(Debug)]
pub(crate) struct NameService {
    /// By name.
    addresses: Vec<(String, SapAddress)>,
    discipline: QueuingDiscipline,
    waiting: ListId,
}

impl Partition {
    /// CREATE_NAME_SERVICE.
    ///
    /// # Errors
    /// INVALID_CONFIG: there are as many as there may be, the plan has no such name service, or the discipline. NO_ACTION: it is created.
    /// INVALID_MODE: NORMAL.
    pub fn create_name_service(
        &mut self,
        name: &str,
        queuing_discipline: impl Into<u32>,
    ) -> Result<NameServiceId, ReturnCode> {
        let name = self.name_services.new_planned_name(name, &mut self.notices)?;
        let planned = self.settings.name_services.iter().find(|(planned, _)| *planned == name);
        let addresses = planned.ok_or(ReturnCode::InvalidConfig)?.1.clone();
        let discipline = discipline(queuing_discipline).map_err(|_| ReturnCode::InvalidConfig)?;
        self.initialising()?;
        let waiting = self.queues.add_list();
        Ok(NameServiceId::of(self.name_services.add(name, NameService { addresses, discipline, waiting })))
    }

    /// GET_NAME: the first name, in the order of their letters, that has the address.
    ///
    /// # Errors
    /// INVALID_PARAM: there is no such name service, the time-out, or no byte may be written. INVALID_CONFIG: the name is longer than
    /// `max_length`. NOT_AVAILABLE: nobody knows the address. INVALID_MODE: the caller would have to wait and must not. TIMED_OUT, as the
    /// result.
    pub fn get_name(
        &mut self,
        id: NameServiceId,
        address: SapAddress,
        time_out: SystemTime,
        max_length: i32,
        into: &mut Vec<u8>,
    ) -> Result<Progress, ReturnCode> {
        into.clear();
        let service = self.name_services.get(id.index())?;
        let time_out = self.time_out(time_out)?;
        valid(max_length > 0)?;
        match service.addresses.iter().find(|(_, known)| *known == address) {
            None => self.wait_for_answer(id, time_out),
            Some((name, _)) => {
                configured(name.len() <= max_length as usize)?;
                copy(name.as_bytes(), into);
                Ok(Progress::Done(()))
            }
        }
    }

    /// GET_ADDRESS.
    ///
    /// # Errors
    /// As [`Partition::get_name`]; INVALID_PARAM: the name has no byte.
    pub fn get_address(
        &mut self,
        id: NameServiceId,
        name: &[u8],
        time_out: SystemTime,
        into: &mut Option<SapAddress>,
    ) -> Result<Progress, ReturnCode> {
        *into = None;
        let service = self.name_services.get(id.index())?;
        let time_out = self.time_out(time_out)?;
        valid(!name.is_empty())?;
        match service.addresses.iter().find(|(known, _)| known.as_bytes() == name) {
            None => self.wait_for_answer(id, time_out),
            Some((_, address)) => {
                *into = Some(*address);
                Ok(Progress::Done(()))
            }
        }
    }

    /// Nobody will answer: the time-out ends it.
    fn wait_for_answer(&mut self, id: NameServiceId, time_out: TimeOut) -> Result<Progress, ReturnCode> {
        let service = self.name_services.get(id.index())?;
        let (waiting, discipline) = (service.waiting, service.discipline);
        self.wait_plainly(waiting, discipline, time_out)
    }
}
