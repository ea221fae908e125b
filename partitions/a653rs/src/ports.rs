//! Sampling and queuing ports.
#![allow(unsafe_code)] // the traits call functions unsafe that need a buffer which is large enough: these look

use a653rs::bindings as a653;
use a653rs::bindings::{
    ApexByte, ApexQueuingPortP1, ApexQueuingPortP4, ApexSamplingPortP1, ApexSamplingPortP4,
    ApexSamplingPortStatus, ApexSystemTime, MessageRange, MessageSize, PortDirection, QueueOverflow,
    QueuingDiscipline, QueuingPortName, SamplingPortName,
};
use bateleur_apex::ReturnCode;
use bateleur_apex::processes::current;
use bateleur_apex::processes::standard::{self, QueuingPortId, SamplingPortId, Validity};

use crate::convert::{Answer, call, code, id, receive, size, text, time, unsigned};
use crate::partition::ApexLinuxPartition;

fn direction(of: standard::PortDirection) -> PortDirection {
    match of {
        standard::PortDirection::Source => PortDirection::Source,
        standard::PortDirection::Destination => PortDirection::Destination,
    }
}

fn validity(of: Validity) -> a653::Validity {
    match of {
        Validity::Invalid => a653::Validity::Invalid,
        Validity::Valid => a653::Validity::Valid,
    }
}

impl ApexSamplingPortP4 for ApexLinuxPartition {
    fn create_sampling_port(
        sampling_port_name: SamplingPortName,
        max_message_size: MessageSize,
        port_direction: PortDirection,
        refresh_period: ApexSystemTime,
    ) -> Answer<a653::SamplingPortId> {
        let (name, most) = (text(&sampling_port_name)?, size(max_message_size));
        let port = current::create_sampling_port(name, most, port_direction as u32, refresh_period);
        Ok(port.map_err(code)?.0.into())
    }

    fn write_sampling_message(sampling_port_id: a653::SamplingPortId, message: &[ApexByte]) -> Answer<()> {
        let port = SamplingPortId(id(sampling_port_id));
        current::as_process(|process| process.write_sampling_message(port, message)).map_err(code)
    }

    unsafe fn read_sampling_message(
        sampling_port_id: a653::SamplingPortId,
        message: &mut [ApexByte],
    ) -> Answer<(a653::Validity, MessageSize)> {
        let port = SamplingPortId(id(sampling_port_id));
        let (read, length) = receive(message, |process, into| process.read_sampling_message(port, into));
        Ok((validity(read.map_err(code)?), length))
    }
}

impl ApexSamplingPortP1 for ApexLinuxPartition {
    fn get_sampling_port_id(sampling_port_name: SamplingPortName) -> Answer<a653::SamplingPortId> {
        let name = text(&sampling_port_name)?;
        Ok(call(|services| services.get_sampling_port_id(name))?.0.into())
    }

    fn get_sampling_port_status(sampling_port_id: a653::SamplingPortId) -> Answer<ApexSamplingPortStatus> {
        let port = SamplingPortId(id(sampling_port_id));
        let status = call(|services| services.get_sampling_port_status(port))?;
        Ok(ApexSamplingPortStatus {
            refresh_period: status.refresh_period,
            max_message_size: unsigned(status.max_message_size),
            port_direction: direction(status.port_direction),
            last_msg_validity: validity(status.last_msg_validity),
        })
    }
}

impl ApexQueuingPortP4 for ApexLinuxPartition {
    fn create_queuing_port(
        queuing_port_name: QueuingPortName,
        max_message_size: MessageSize,
        max_nb_message: MessageRange,
        port_direction: PortDirection,
        queuing_discipline: QueuingDiscipline,
    ) -> Answer<a653::QueuingPortId> {
        let (name, most) = (text(&queuing_port_name)?, size(max_message_size));
        let (messages, discipline) = (size(max_nb_message), queuing_discipline as u32);
        let port = current::create_queuing_port(name, most, messages, port_direction as u32, discipline);
        Ok(port.map_err(code)?.0.into())
    }

    fn send_queuing_message(
        queuing_port_id: a653::QueuingPortId,
        message: &[ApexByte],
        time_out: ApexSystemTime,
    ) -> Answer<()> {
        let (port, time_out) = (QueuingPortId(id(queuing_port_id)), time(time_out));
        current::as_process(|process| process.send_queuing_message(port, message, time_out)).map_err(code)
    }

    unsafe fn receive_queuing_message(
        queuing_port_id: a653::QueuingPortId,
        time_out: ApexSystemTime,
        message: &mut [ApexByte],
    ) -> Answer<(MessageSize, QueueOverflow)> {
        let (port, time_out) = (QueuingPortId(id(queuing_port_id)), time(time_out));
        let received =
            receive(message, |process, into| process.receive_queuing_message(port, time_out, into));
        match received {
            (Ok(()), length) => Ok((length, false)),
            (Err(ReturnCode::InvalidConfig), length) => Ok((length, true)),
            (Err(refused), _) => Err(code(refused)),
        }
    }

    fn get_queuing_port_status(queuing_port_id: a653::QueuingPortId) -> Answer<a653::QueuingPortStatus> {
        let port = QueuingPortId(id(queuing_port_id));
        let status = current::as_process(|process| {
            process.at_ports(|services, ports| services.get_queuing_port_status(ports, port))
        });
        let status = status.map_err(code)?;
        Ok(a653::QueuingPortStatus {
            nb_message: unsigned(status.nb_message),
            max_nb_message: unsigned(status.max_nb_message),
            max_message_size: unsigned(status.max_message_size),
            port_direction: direction(status.port_direction),
            waiting_processes: status.waiting_processes,
        })
    }

    fn clear_queuing_port(queuing_port_id: a653::QueuingPortId) -> Answer<()> {
        let port = QueuingPortId(id(queuing_port_id));
        let cleared = current::as_process(|process| {
            process.at_ports(|services, ports| services.clear_queuing_port(ports, port))
        });
        cleared.map_err(code)
    }
}

impl ApexQueuingPortP1 for ApexLinuxPartition {
    fn get_queuing_port_id(queuing_port_name: QueuingPortName) -> Answer<a653::QueuingPortId> {
        let name = text(&queuing_port_name)?;
        Ok(call(|services| services.get_queuing_port_id(name))?.0.into())
    }
}
