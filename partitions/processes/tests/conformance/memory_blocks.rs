//! Memory blocks. That a block for reading can not be written, and what outlives a restart, is tested with the executive.

use bateleur_processes::standard::*;

use crate::bench::*;

fn status(address: usize, mode: MemoryBlockMode, size: i32) -> MemoryBlockStatus {
    MemoryBlockStatus { address, mode, size }
}

fn bench() -> Bench {
    Bench::with(|settings| {
        settings.memory_blocks = vec![
            (Name::new("terrain").unwrap(), status(0x7000, MemoryBlockMode::Read, 65_536)),
            (Name::new("Scratch").unwrap(), status(0x9000, MemoryBlockMode::ReadWrite, 100)),
        ];
    })
}

#[test]
fn mem_01_block_that_is_not_given_to_the_partition_is_a_wrong_configuration() {
    let too_long = "a name that is longer than the 32 characters of one";
    for name in ["scratch2", "", too_long] {
        assert_eq!(code(bench().get_memory_block_status(name)), IC, "{name}");
    }
}

#[test]
fn mem_02_status_has_the_address_the_mode_and_the_size() {
    let bench = bench();
    let terrain = status(0x7000, MemoryBlockMode::Read, 65_536);
    assert_eq!(bench.get_memory_block_status("terrain"), Ok(terrain));
    let scratch = status(0x9000, MemoryBlockMode::ReadWrite, 100);
    assert_eq!(bench.get_memory_block_status("scratch"), Ok(scratch), "in any spelling of its letters");
    assert_eq!([MemoryBlockMode::Read as u32, MemoryBlockMode::ReadWrite as u32], [0, 1]);
}

#[test]
fn mem_04_answer_is_the_same_in_every_mode_and_after_a_restart() {
    let mut bench = bench();
    let found = bench.get_memory_block_status("terrain");
    bench.started("a", 10);
    bench.normal();
    assert_eq!(bench.get_memory_block_status("terrain"), found);
    bench.set_partition_mode(OperatingMode::WarmStart).unwrap();
    let Bench { partition, .. } = bench;
    assert_eq!(partition.restarted().get_memory_block_status("terrain"), found);
}
