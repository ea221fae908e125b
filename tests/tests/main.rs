//! The tests of the whole system, as one program: linked once, not once for each file. A file is a subject; a test that shares the machine
//! with no other lies in a module `alone` of its file.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod a653rs;
mod air_faults;
mod airframe;
mod alignment;
mod attacks;
mod bad_input;
mod c_partitions;
mod campaign;
mod can_flight;
mod can_gateway;
mod control;
mod crash_reports;
mod daemon;
mod damaged_channels;
mod error_handler;
mod executive_deaths;
mod fault_campaign;
mod flights;
mod foreign_messages;
mod foxglove;
mod ground_stations;
#[cfg(target_arch = "x86_64")] // the guest's kernel is
mod guest;
mod health_log;
mod hostile_channels;
mod hosts;
mod hosts_campaign;
mod injected_signals;
mod isolation;
mod jsbsim;
mod killed_at_random;
mod landings;
mod leftovers;
mod logbooks;
mod mavlink_flight;
mod measures;
mod memory_blocks;
mod missions;
mod module_errors;
mod module_schedules;
mod neighbours;
mod new_partition;
mod one_process;
mod operator_acts;
mod ordinary_user;
mod output;
mod outside_world;
mod own_project;
mod packages;
mod play;
mod processes;
mod processes_seen;
mod publishers;
mod receiver;
mod replay;
mod replicas;
mod report_page;
mod restarts;
mod run_hosts;
mod sandbox_fuzz;
mod schedule_edits;
mod sealed_channels;
mod service_manager;
mod simulators;
mod sketches;
mod space;
mod spare;
mod standby;
mod together;
mod top;
mod two_cores;
mod view;
mod wall;
mod why;
mod window;

#[test]
fn every_file_of_this_folder_is_part_of_this_program() {
    let folder = bateleur_tests::repository().join("tests/tests");
    for file in std::fs::read_dir(folder).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap();
        let named = name == "main.rs"
            || include_str!("main.rs").contains(&format!("mod {};", name.replace(".rs", "")));
        assert!(named, "tests/main.rs does not name {name}");
    }
}
