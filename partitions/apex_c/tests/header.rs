//! The header against the library and the compilers of this machine.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::mem::offset_of;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use bateleur_apex_c::types::{
    BlackboardStatus, BufferStatus, ErrorStatus, EventStatus, LogbookStatus, MemoryBlockStatus, MutexStatus,
    PartitionStatus, ProcessAttribute, ProcessStatus, QueuingPortStatus, SamplingPortCurrentStatus,
    SamplingPortStatus, SapAddress, ScheduleStatus, SemaphoreStatus,
};

const STRICT: [&str; 4] = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"];

fn own(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// Runs a compiler with the header's folder; `None`: this machine has none.
fn compiler(name: &str, arguments: &[&str]) -> Option<Output> {
    match Command::new(name).args(STRICT).arg("-I").arg(own("include")).args(arguments).output() {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => None,
        output => Some(output.unwrap()),
    }
}

#[track_caller]
fn expect_success(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Name in C and size of a record, and the place of each field.
type Layout = (&'static str, usize, Vec<(&'static str, usize)>);

macro_rules! layout {
    ($of:ty as $name:literal { $($field:ident $in_c:literal),+ $(,)? }) => {
        ($name, size_of::<$of>(), vec![$(($in_c, offset_of!($of, $field))),+])
    };
}

/// As the library has them, for identifiers of a width.
macro_rules! layouts {
    ($id:ty) => {
        [
            layout!(ProcessAttribute as "PROCESS_ATTRIBUTE_TYPE" {
                period "PERIOD", time_capacity "TIME_CAPACITY", entry_point "ENTRY_POINT", stack_size "STACK_SIZE",
                base_priority "BASE_PRIORITY", deadline "DEADLINE", name "NAME",
            }),
            layout!(ProcessStatus as "PROCESS_STATUS_TYPE" {
                deadline_time "DEADLINE_TIME", current_priority "CURRENT_PRIORITY", process_state "PROCESS_STATE",
                attributes "ATTRIBUTES",
            }),
            layout!(PartitionStatus<$id> as "PARTITION_STATUS_TYPE" {
                period "PERIOD", duration "DURATION", identifier "IDENTIFIER", lock_level "LOCK_LEVEL",
                operating_mode "OPERATING_MODE", start_condition "START_CONDITION",
                num_assigned_cores "NUM_ASSIGNED_CORES",
            }),
            layout!(SamplingPortStatus as "SAMPLING_PORT_STATUS_TYPE" {
                refresh_period "REFRESH_PERIOD", max_message_size "MAX_MESSAGE_SIZE",
                port_direction "PORT_DIRECTION", last_msg_validity "LAST_MSG_VALIDITY",
            }),
            layout!(SamplingPortCurrentStatus as "SAMPLING_PORT_CURRENT_STATUS_TYPE" {
                refresh_period "REFRESH_PERIOD", time_stamp "TIME_STAMP", max_message_size "MAX_MESSAGE_SIZE",
                port_direction "PORT_DIRECTION", message_age "MESSAGE_AGE", updated "UPDATED",
            }),
            layout!(QueuingPortStatus as "QUEUING_PORT_STATUS_TYPE" {
                nb_message "NB_MESSAGE", max_nb_message "MAX_NB_MESSAGE", max_message_size "MAX_MESSAGE_SIZE",
                port_direction "PORT_DIRECTION", waiting_processes "WAITING_PROCESSES",
            }),
            layout!(BufferStatus as "BUFFER_STATUS_TYPE" {
                nb_message "NB_MESSAGE", max_nb_message "MAX_NB_MESSAGE", max_message_size "MAX_MESSAGE_SIZE",
                waiting_processes "WAITING_PROCESSES",
            }),
            layout!(BlackboardStatus as "BLACKBOARD_STATUS_TYPE" {
                empty_indicator "EMPTY_INDICATOR", max_message_size "MAX_MESSAGE_SIZE",
                waiting_processes "WAITING_PROCESSES",
            }),
            layout!(SemaphoreStatus as "SEMAPHORE_STATUS_TYPE" {
                current_value "CURRENT_VALUE", maximum_value "MAXIMUM_VALUE", waiting_processes "WAITING_PROCESSES",
            }),
            layout!(EventStatus as "EVENT_STATUS_TYPE" {
                event_state "EVENT_STATE", waiting_processes "WAITING_PROCESSES",
            }),
            layout!(MutexStatus<$id> as "MUTEX_STATUS_TYPE" {
                mutex_owner "MUTEX_OWNER", mutex_state "MUTEX_STATE", mutex_priority "MUTEX_PRIORITY",
                lock_count "LOCK_COUNT", waiting_processes "WAITING_PROCESSES",
            }),
            layout!(ErrorStatus<$id> as "ERROR_STATUS_TYPE" {
                failed_address "FAILED_ADDRESS", failed_process_id "FAILED_PROCESS_ID", error_code "ERROR_CODE",
                length "LENGTH", message "MESSAGE",
            }),
            layout!(ScheduleStatus<$id> as "SCHEDULE_STATUS_TYPE" {
                time_of_last_schedule_switch "TIME_OF_LAST_SCHEDULE_SWITCH", current_schedule "CURRENT_SCHEDULE",
                next_schedule "NEXT_SCHEDULE",
            }),
            layout!(MemoryBlockStatus as "MEMORY_BLOCK_STATUS_TYPE" {
                memory_block_addr "MEMORY_BLOCK_ADDR", memory_block_mode "MEMORY_BLOCK_MODE",
                memory_block_size "MEMORY_BLOCK_SIZE",
            }),
            layout!(SapAddress as "SAP_ADDRESS_TYPE" { ip_address "IP_ADDRESS", udp_port "UDP_PORT" }),
            layout!(LogbookStatus as "LOGBOOK_STATUS_TYPE" {
                max_message_size "MAX_MESSAGE_SIZE", max_nb_logged_messages "MAX_NB_LOGGED_MESSAGES",
                max_nb_in_progress_messages "MAX_NB_IN_PROGRESS_MESSAGES", nb_logged_messages "NB_LOGGED_MESSAGES",
                nb_in_progress_messages "NB_IN_PROGRESS_MESSAGES", nb_aborted_messages "NB_ABORTED_MESSAGES",
            }),
        ]
    };
}

/// C that does not compile where a layout differs. The places are the same on every machine of 64 bits.
fn assertions(bits: u32, layouts: &[Layout]) -> String {
    let mut text = format!("#define APEX_IDENTIFIER_BITS {bits}\n#include <stddef.h>\n#include <apex.h>\n");
    for (name, size, fields) in layouts {
        text += &format!("typedef char {name}_has_{size}[sizeof({name}) == {size} ? 1 : -1];\n");
        for (field, at) in fields {
            text +=
                &format!("typedef char {name}_{field}_{at}[offsetof({name}, {field}) == {at} ? 1 : -1];\n");
        }
    }
    text + "int main(void) { return 0; }\n"
}

#[test]
fn typ_01_records_lie_in_c_as_they_do_in_the_library_on_both_processors() {
    let narrow: [Layout; 16] = layouts!(i32);
    let wide: [Layout; 16] = layouts!(i64);
    assert_eq!((narrow[0].1, narrow[2].1, narrow[11].1), (72, 40, 152), "as other implementations have them");
    assert_eq!((wide[10].1, narrow[12].1, wide[12].1, narrow[13].1), (24, 16, 24, 16));
    for (bits, layouts) in [(32, &narrow), (64, &wide)] {
        let folder = tempfile::tempdir().unwrap();
        let source = folder.path().join("layouts.c");
        std::fs::write(&source, assertions(bits, layouts)).unwrap();
        let object = folder.path().join("layouts.o");
        for name in ["cc", "aarch64-linux-gnu-gcc"] {
            let arguments = ["-std=c99", "-c", source.to_str().unwrap(), "-o", object.to_str().unwrap()];
            compiler(name, &arguments).iter().for_each(expect_success);
        }
        let wrong = assertions(bits, layouts)
            .replace("sizeof(EVENT_STATUS_TYPE) == 8", "sizeof(EVENT_STATUS_TYPE) == 9");
        std::fs::write(&source, wrong).unwrap();
        let arguments = ["-std=c99", "-c", source.to_str().unwrap(), "-o", object.to_str().unwrap()];
        assert!(!compiler("cc", &arguments).expect("a C compiler").status.success(), "it compares nothing");
    }
}

#[test]
fn header_and_partitions_are_c99_and_cpp17_without_a_warning_on_both_processors() {
    let tests = own("../../tests/c");
    let folder = tempfile::tempdir().unwrap();
    let messages =
        "#include <stdint.h>\ntypedef struct bateleur_Number { int32_t number; } bateleur_Number;\n";
    std::fs::write(folder.path().join("messages.h"), messages).unwrap();
    let sources = std::fs::read_dir(tests).unwrap().map(|entry| entry.unwrap().path());
    let sources = sources.filter(|path| path.extension().is_some_and(|of| of == "c"));
    let sources: Vec<_> = sources.chain([own("examples/greeting/greeting.c")]).collect();
    assert!(sources.len() > 12);
    let object = folder.path().join("compiled.o");
    for source in &sources {
        for (name, language, standard) in [
            ("cc", "c", "-std=c99"),
            ("c++", "c++", "-std=c++17"),
            ("aarch64-linux-gnu-gcc", "c", "-std=c99"),
        ] {
            let include = format!("-I{}", folder.path().display());
            let more = ["-DFAULT=aborted", "-O2", &include, "-c", "-o", object.to_str().unwrap()];
            let arguments = [&["-x", language, standard, source.to_str().unwrap()], &more[..]].concat();
            compiler(name, &arguments).iter().for_each(expect_success);
        }
    }
}

/// The folder of the libraries, built with this test.
fn libraries() -> PathBuf {
    std::env::current_exe().unwrap().parent().unwrap().to_owned()
}

/// The names that a header declares as functions, with their wide forms.
fn declared() -> Vec<String> {
    let header = std::fs::read_to_string(own("include/apex.h")).unwrap();
    let functions = header.lines().filter_map(|line| line.strip_prefix("void ")?.split('(').next());
    let wide = header.lines().filter_map(|line| line.strip_prefix("#define ")?.split(' ').nth(1));
    let wide = wide.filter(|name| name.ends_with("_64"));
    functions.chain(wide).map(str::to_owned).collect()
}

#[test]
fn every_declared_function_is_in_the_shared_library_which_installs_with_pkg_config() {
    let names = declared();
    assert!(names.len() > 110, "{}", names.len());
    let prefix = tempfile::tempdir().unwrap();
    let place = |from: PathBuf, to: &str| {
        let to = prefix.path().join(to);
        std::fs::create_dir_all(to.parent().unwrap()).unwrap();
        std::fs::copy(from, to).unwrap();
    };
    place(own("include/apex.h"), "include/apex.h");
    place(own("bateleur_apex_c.pc"), "lib/pkgconfig/bateleur_apex_c.pc");
    place(libraries().join("libbateleur_apex_c.so"), "lib/libbateleur_apex_c.so");
    let flags = Command::new("pkg-config")
        .args(["--cflags", "--libs", "bateleur_apex_c"])
        .env("PKG_CONFIG_PATH", prefix.path().join("lib/pkgconfig"))
        .output();
    let flags = match flags {
        Ok(output) => String::from_utf8(output.stdout).unwrap(),
        Err(_) => format!("-I{0}/include -L{0}/lib -lbateleur_apex_c", prefix.path().display()),
    };
    let uses: String = names.iter().map(|name| format!("extern void {name}(void);\n")).collect();
    let calls: String = names.iter().map(|name| format!("  {name},\n")).collect();
    let source = prefix.path().join("all.c");
    let text = format!("{uses}void (*const all[])(void) = {{\n{calls}}};\nint main(void) {{ return 0; }}\n");
    std::fs::write(&source, text).unwrap();
    for source in [source, own("examples/greeting/greeting.c")] {
        let program = prefix.path().join("program");
        let output =
            Command::new("cc").arg(source).args(flags.split_whitespace()).arg("-o").arg(program).output();
        expect_success(&output.unwrap());
    }
}
