//! Logbooks. What is stored, and what outlives a death, is tested with the executive.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use bateleur_processes::logbooks::{LogbookMemory, PlannedLogbook};
use bateleur_processes::standard::*;

use crate::bench::*;

/// Messages of 8 bytes, of which three are kept.
#[derive(Debug)]
struct Memory {
    in_progress: i32,
    /// The newest first, each with whether it is stored.
    messages: Mutex<VecDeque<(Vec<u8>, WriteStatus)>>,
}

impl Memory {
    fn under_way(&self) -> i32 {
        let messages = self.messages.lock().unwrap();
        messages.iter().filter(|(_, status)| *status == WriteStatus::InProgress).count() as i32
    }

    fn store(&self) {
        let mut messages = self.messages.lock().unwrap();
        messages.truncate(3);
        let under_way = messages.iter_mut().filter(|(_, status)| *status == WriteStatus::InProgress);
        under_way.for_each(|(_, status)| *status = WriteStatus::Complete);
    }
}

impl LogbookMemory for Memory {
    fn status(&self) -> LogbookStatus {
        let in_progress = self.under_way();
        LogbookStatus {
            max_message_size: 8,
            max_logged: 3,
            max_in_progress: self.in_progress,
            logged: self.messages.lock().unwrap().len() as i32 - in_progress,
            in_progress,
            aborted: 0,
        }
    }

    fn abort_unfinished(&self) {}

    fn write(&self, message: &[u8]) -> bool {
        let is_room = self.under_way() < self.in_progress;
        if is_room {
            self.messages.lock().unwrap().push_front((message.to_vec(), WriteStatus::InProgress));
        }
        is_room
    }

    fn overwrite(&self, message: &[u8]) -> bool {
        if !self.write(message) {
            self.messages.lock().unwrap()[0].0 = message.to_vec();
        }
        true
    }

    fn read(&self, entry: u32, into: &mut Vec<u8>) -> Option<WriteStatus> {
        let messages = self.messages.lock().unwrap();
        let (message, status) = messages.get(entry as usize)?;
        into.extend_from_slice(message);
        Some(*status)
    }

    fn clear(&self) -> bool {
        let is_free = self.under_way() == 0;
        if is_free {
            self.messages.lock().unwrap().clear();
        }
        is_free
    }
}

fn memory(in_progress: i32) -> Arc<Memory> {
    Arc::new(Memory { in_progress, messages: Mutex::default() })
}

/// The plan has the logbooks `events`, of two messages under way, and `single`, of one.
fn bench() -> (Bench, Arc<Memory>) {
    let events = memory(2);
    let planned = |name: &str, memory| PlannedLogbook { name: Name::new(name).unwrap(), memory };
    let bench = Bench::with(|settings| {
        settings.logbooks = vec![planned("events", events.clone()), planned("single", memory(1))];
    });
    (bench, events)
}

fn created() -> (Bench, LogbookId, Arc<Memory>) {
    let (mut bench, memory) = bench();
    let id = bench.create_logbook("events", 8, 3, 2).unwrap();
    (bench, id, memory)
}

const NOBODY: LogbookId = LogbookId(77);

#[test]
fn log_create_01_more_than_there_may_be_are_a_wrong_configuration() {
    let mut bench = Bench::with(|settings| {
        settings.logbooks = vec![PlannedLogbook { name: Name::new("events").unwrap(), memory: memory(2) }];
        settings.limits.objects = 0;
    });
    assert_eq!(code(bench.create_logbook("events", 8, 3, 2)), IC);
}

#[test]
fn log_create_02_one_that_the_plan_does_not_have_is_a_wrong_configuration() {
    let (mut bench, _) = bench();
    for name in ["another", "", "a name that is longer than the 32 characters of one"] {
        assert_eq!(code(bench.create_logbook(name, 8, 3, 2)), IC, "{name}");
    }
}

#[test]
fn log_create_03_one_that_is_created_is_no_action() {
    let (mut bench, ..) = created();
    assert_eq!(code(bench.create_logbook("events", 8, 3, 2)), NA);
    assert_eq!(code(bench.create_logbook("EVENTS", 8, 3, 2)), NA);
}

#[test]
fn log_create_04_other_sizes_than_the_plans_are_a_wrong_configuration() {
    let (mut bench, _) = bench();
    for (size, logged, in_progress) in
        [(7, 3, 2), (9, 3, 2), (8, 4, 2), (8, 3, 1), (-8, 3, 2), (8, -3, 2), (8, 3, -2)]
    {
        assert_eq!(code(bench.create_logbook("events", size, logged, in_progress)), IC);
    }
}

#[test]
fn log_create_05_none_is_created_in_normal() {
    let (mut bench, _) = bench();
    bench.started("a", 10);
    bench.normal();
    assert_eq!(code(bench.create_logbook("events", 8, 3, 2)), IM);
}

/// An unknown identifier is a wrong parameter.
fn unknown(service: impl Fn(&Bench, LogbookId) -> Code) {
    let (bench, id, _) = created();
    for unknown in [NOBODY, LogbookId(id.0 + 1), LogbookId(0)] {
        assert_eq!(service(&bench, unknown), IP);
    }
}

#[test]
fn log_write_01_unknown_logbook() {
    unknown(|bench, id| bench.write_logbook(id, b"x"));
}

#[test]
fn log_over_01_unknown_logbook() {
    unknown(|bench, id| bench.overwrite_logbook(id, b"x"));
}

#[test]
fn log_read_01_unknown_logbook() {
    unknown(|bench, id| code(bench.read_logbook(id, 0, &mut Vec::new())));
}

#[test]
fn log_clear_01_unknown_logbook() {
    unknown(|bench, id| bench.clear_logbook(id));
}

#[test]
fn log_stat_01_unknown_logbook() {
    unknown(|bench, id| code(bench.get_logbook_status(id)));
}

#[test]
fn log_write_02_message_without_bytes_or_with_too_many() {
    let (bench, id, _) = created();
    for message in [&[][..], &[1; 9]] {
        assert_eq!(bench.write_logbook(id, message), IP);
    }
    assert_eq!(bench.write_logbook(id, &[1; 8]), NE);
}

#[test]
fn log_over_03_message_without_bytes_or_with_too_many() {
    let (bench, id, _) = created();
    for message in [&[][..], &[1; 9]] {
        assert_eq!(bench.overwrite_logbook(id, message), IP);
    }
}

#[test]
fn log_write_03_nothing_more_can_be_under_way() {
    let (bench, id, memory) = created();
    assert_eq!([bench.write_logbook(id, b"a"), bench.write_logbook(id, b"b")], [NE, NE]);
    assert_eq!(bench.write_logbook(id, b"c"), NV);
    memory.store();
    assert_eq!(bench.write_logbook(id, b"c"), NE);
}

#[test]
fn log_over_02_where_fewer_than_two_can_be_under_way() {
    let (mut bench, _) = bench();
    let single = bench.create_logbook("single", 8, 3, 1).unwrap();
    assert_eq!(bench.overwrite_logbook(single, b"x"), IC);
}

#[test]
fn log_over_05_is_a_write_where_there_is_room() {
    let (bench, id, _) = created();
    assert_eq!([bench.overwrite_logbook(id, b"a"), bench.overwrite_logbook(id, b"b")], [NE, NE]);
    assert_eq!(bench.get_logbook_status(id).unwrap().in_progress, 2);
}

#[test]
fn log_over_04_replaces_the_newest_one_where_there_is_no_room() {
    let (bench, id, _) = created();
    for message in [b"a", b"b", b"c"] {
        assert_eq!(bench.overwrite_logbook(id, message), NE);
    }
    let mut message = Vec::new();
    assert_eq!(bench.read_logbook(id, 0, &mut message), Ok(WriteStatus::InProgress));
    assert_eq!(message, b"c");
    assert_eq!(code(bench.read_logbook(id, 1, &mut message)), NE);
    assert_eq!(message, b"a");
    assert_eq!(code(bench.read_logbook(id, 2, &mut message)), NA);
}

#[test]
fn log_read_02_entry_out_of_range() {
    let (bench, id, _) = created();
    for entry in [-1, 3, i32::MAX, i32::MIN] {
        assert_eq!(code(bench.read_logbook(id, entry, &mut Vec::new())), IP, "{entry}");
    }
}

#[test]
fn log_read_03_no_such_entry() {
    let (bench, id, _) = created();
    let mut message = vec![9];
    assert_eq!(code(bench.read_logbook(id, 0, &mut message)), NA);
    assert!(message.is_empty());
}

#[test]
fn log_clear_02_not_while_a_message_is_under_way() {
    let (bench, id, _) = created();
    bench.write_logbook(id, b"a").unwrap();
    assert_eq!(bench.clear_logbook(id), NV);
    assert_eq!(code(bench.read_logbook(id, 0, &mut Vec::new())), NE);
}

#[test]
fn log_clear_03_is_empty_afterwards() {
    let (bench, id, memory) = created();
    bench.write_logbook(id, b"a").unwrap();
    memory.store();
    assert_eq!(bench.clear_logbook(id), NE);
    assert_eq!(code(bench.read_logbook(id, 0, &mut Vec::new())), NA);
}

#[test]
fn log_id_01_unknown_name_is_a_wrong_configuration() {
    let (bench, id, _) = created();
    assert_eq!(bench.get_logbook_id("Events"), Ok(id));
    for name in ["single", "another", ""] {
        assert_eq!(code(bench.get_logbook_id(name)), IC, "{name}");
    }
}

#[test]
fn log_stat_02_sizes_and_counts() {
    let (bench, id, memory) = created();
    bench.write_logbook(id, b"a").unwrap();
    memory.store();
    bench.write_logbook(id, b"b").unwrap();
    let status = bench.get_logbook_status(id).unwrap();
    let sizes = [status.max_message_size, status.max_logged, status.max_in_progress];
    assert_eq!((sizes, [status.logged, status.in_progress, status.aborted]), ([8, 3, 2], [1, 1, 0]));
}
