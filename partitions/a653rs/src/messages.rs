//! Buffers and blackboards.
#![allow(unsafe_code)] // the traits call functions unsafe that need a buffer which is large enough: these look

use a653rs::bindings as a653;
use a653rs::bindings::{
    ApexBlackboardP1, ApexBufferP1, ApexByte, ApexSystemTime, BlackboardName, BufferName, MessageRange,
    MessageSize, QueuingDiscipline,
};
use bateleur_apex::processes::standard::{BlackboardId, BufferId, EmptyIndicator};

use crate::convert::{Answer, call, code, id, receive, size, text, time, unsigned, wait};
use crate::partition::ApexLinuxPartition;

impl ApexBufferP1 for ApexLinuxPartition {
    fn create_buffer(
        buffer_name: BufferName,
        max_message_size: MessageSize,
        max_nb_message: MessageRange,
        queuing_discipline: QueuingDiscipline,
    ) -> Answer<a653::BufferId> {
        let (name, most, messages) = (text(&buffer_name)?, size(max_message_size), size(max_nb_message));
        let discipline = queuing_discipline as u32;
        Ok(call(|services| services.create_buffer(name, most, messages, discipline))?.0.into())
    }

    fn send_buffer(buffer_id: a653::BufferId, message: &[ApexByte], time_out: ApexSystemTime) -> Answer<()> {
        wait(|services| services.send_buffer(BufferId(id(buffer_id)), message, time(time_out)))
    }

    unsafe fn receive_buffer(
        buffer_id: a653::BufferId,
        time_out: ApexSystemTime,
        message: &mut [ApexByte],
    ) -> Answer<MessageSize> {
        let (buffer, time_out) = (BufferId(id(buffer_id)), time(time_out));
        let (received, length) = receive(message, |process, into| {
            process.receive(into, |services, into| services.receive_buffer(buffer, time_out, into))
        });
        received.map_err(code)?;
        Ok(length)
    }

    fn get_buffer_id(buffer_name: BufferName) -> Answer<a653::BufferId> {
        let name = text(&buffer_name)?;
        Ok(call(|services| services.get_buffer_id(name))?.0.into())
    }

    fn get_buffer_status(buffer_id: a653::BufferId) -> Answer<a653::BufferStatus> {
        let status = call(|services| services.get_buffer_status(BufferId(id(buffer_id))))?;
        Ok(a653::BufferStatus {
            nb_message: unsigned(status.nb_message),
            max_nb_message: unsigned(status.max_nb_message),
            max_message_size: unsigned(status.max_message_size),
            waiting_processes: status.waiting_processes,
        })
    }
}

impl ApexBlackboardP1 for ApexLinuxPartition {
    fn create_blackboard(
        blackboard_name: BlackboardName,
        max_message_size: MessageSize,
    ) -> Answer<a653::BlackboardId> {
        let (name, most) = (text(&blackboard_name)?, size(max_message_size));
        Ok(call(|services| services.create_blackboard(name, most))?.0.into())
    }

    fn display_blackboard(blackboard_id: a653::BlackboardId, message: &[ApexByte]) -> Answer<()> {
        call(|services| services.display_blackboard(BlackboardId(id(blackboard_id)), message))
    }

    unsafe fn read_blackboard(
        blackboard_id: a653::BlackboardId,
        time_out: ApexSystemTime,
        message: &mut [ApexByte],
    ) -> Answer<MessageSize> {
        let (blackboard, time_out) = (BlackboardId(id(blackboard_id)), time(time_out));
        let (read, length) = receive(message, |process, into| {
            process.receive(into, |services, into| services.read_blackboard(blackboard, time_out, into))
        });
        read.map_err(code)?;
        Ok(length)
    }

    fn clear_blackboard(blackboard_id: a653::BlackboardId) -> Answer<()> {
        call(|services| services.clear_blackboard(BlackboardId(id(blackboard_id))))
    }

    fn get_blackboard_id(blackboard_name: BlackboardName) -> Answer<a653::BlackboardId> {
        let name = text(&blackboard_name)?;
        Ok(call(|services| services.get_blackboard_id(name))?.0.into())
    }

    fn get_blackboard_status(blackboard_id: a653::BlackboardId) -> Answer<a653::BlackboardStatus> {
        let status = call(|services| services.get_blackboard_status(BlackboardId(id(blackboard_id))))?;
        Ok(a653::BlackboardStatus {
            empty_indicator: match status.empty_indicator {
                EmptyIndicator::Empty => a653::EmptyIndicator::Empty,
                EmptyIndicator::Occupied => a653::EmptyIndicator::Occupied,
            },
            max_message_size: unsigned(status.max_message_size),
            waiting_processes: status.waiting_processes,
        })
    }
}
