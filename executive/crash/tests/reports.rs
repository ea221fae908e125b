//! Reports of a process that is this one: its own stack, as it would have been written down; and of memory that was damaged on purpose.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![allow(unsafe_code)] // looks at its own stack

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::fs::FileExt;

use bateleur_contract::CrashHead;
use bateleur_contract::crash::{
    AARCH64, BYTES, MAPS_AT, MAPS_BYTES, NAME_AT, REGISTERS, STACK_AT, STACK_BYTES, WHOLE, X86_64,
};
use bateleur_crash::{Binaries, Captured, CrashReport, Death, MOST_BYTES, minidump};
use minidump_common::format::{
    CONTEXT_AMD64, CONTEXT_ARM64, MINIDUMP_DIRECTORY, MINIDUMP_EXCEPTION_STREAM, MINIDUMP_HEADER,
    MINIDUMP_LOCATION_DESCRIPTOR, MINIDUMP_MODULE, MINIDUMP_SIGNATURE, MINIDUMP_STREAM_TYPE, MINIDUMP_THREAD,
    MINIDUMP_VERSION,
};
use scroll::ctx::SizeWith;
use scroll::{LE, Pread};

const STACK_POINTER: usize = if cfg!(target_arch = "x86_64") { 7 } else { 31 };

#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn own_registers() -> [u64; REGISTERS] {
    let mut registers = [0; REGISTERS];
    let (instruction, base, stack): (u64, u64, u64);
    // SAFETY: reads registers.
    unsafe {
        std::arch::asm!("lea {at}, [rip]", "mov {base}, rbp", "mov {stack}, rsp", at = out(reg) instruction, base = out(reg) base, stack = out(reg) stack);
    }
    (registers[16], registers[6], registers[7]) = (instruction, base, stack);
    registers
}

#[cfg(target_arch = "aarch64")]
#[inline(always)]
fn own_registers() -> [u64; REGISTERS] {
    let mut registers = [0; REGISTERS];
    let (instruction, base, link, stack): (u64, u64, u64, u64);
    // SAFETY: reads registers.
    unsafe {
        std::arch::asm!("adr {at}, .", "mov {base}, x29", "mov {link}, x30", "mov {stack}, sp", at = out(reg) instruction, base = out(reg) base, link = out(reg) link, stack = out(reg) stack);
    }
    (registers[32], registers[29], registers[30], registers[31]) = (instruction, base, link, stack);
    registers
}

/// The memory that this process would have written here.
#[inline(never)]
fn innermost() -> Vec<u8> {
    let registers = own_registers();
    let maps = std::fs::read("/proc/self/maps").unwrap();
    let from = registers[STACK_POINTER];
    let mut stack = vec![0; STACK_BYTES];
    let length = File::open("/proc/self/mem").unwrap().read_at(&mut stack, from).unwrap();
    let maps = &maps[..maps.len().min(MAPS_BYTES)];
    let head = CrashHead {
        state: WHOLE,
        architecture: if cfg!(target_arch = "x86_64") { X86_64 } else { AARCH64 },
        signal: 11,
        code: 1,
        address: 8,
        process: 1,
        thread: 5,
        stack_from: from,
        stack_bytes: length as u64,
        maps_bytes: maps.len() as u64,
        registers,
    };
    let mut memory = vec![0; BYTES as usize];
    let head = head.to_bytes();
    for (at, bytes) in [(0, &head[..]), (NAME_AT, b"fast"), (STACK_AT, &stack[..length]), (MAPS_AT, maps)] {
        memory[at as usize..][..bytes.len()].copy_from_slice(bytes);
    }
    memory
}

#[inline(never)]
fn in_between() -> Vec<u8> {
    let mut memory = innermost();
    memory.truncate(std::hint::black_box(memory.len())); // no call in the place of a return
    memory
}

#[inline(never)]
fn outermost() -> Vec<u8> {
    let mut memory = in_between();
    memory.truncate(std::hint::black_box(memory.len()));
    memory
}

fn report(captured: &Captured, binaries: &mut Binaries) -> CrashReport {
    let mut report = CrashReport::new(Death::default(), captured);
    report.trace(captured, binaries);
    report
}

#[test]
fn functions_on_the_stack_are_named_from_the_innermost_on() {
    let captured = Captured::of(&outermost()).unwrap();
    let report = report(&captured, &mut Binaries::default());
    let frames = report.backtrace.as_ref().unwrap();
    let names: Vec<&str> = frames.iter().filter_map(|frame| frame.function.as_deref()).collect();
    let own: Vec<&str> = names.iter().filter_map(|name| name.strip_prefix("reports::")).take(3).collect();
    assert_eq!(own, ["innermost", "in_between", "outermost"], "{frames:#?}");
    assert!(report.place().unwrap().module.as_ref().unwrap().contains("reports-"));
    assert_eq!((report.process.as_deref(), report.main_thread), (Some("fast"), false));
    assert_eq!(
        (report.signal.as_str(), report.reason.as_deref()),
        ("SIGSEGV", Some("nothing is mapped there"))
    );
    assert_eq!(report.registers.len(), captured.architecture.registers().len());
}

#[test]
fn call_to_nowhere_shows_who_has_called() {
    let mut captured = Captured::of(&outermost()).unwrap();
    let instruction = captured.instruction();
    // As the processor leaves it: the address of the call's next instruction, on the stack or in the link register.
    if cfg!(target_arch = "x86_64") {
        captured.head.registers[16] = 0;
        captured.head.registers[7] -= 8;
        captured.head.stack_from -= 8;
        captured.stack.splice(0..0, (instruction + 1).to_le_bytes());
    } else {
        captured.head.registers[32] = 0;
        captured.head.registers[30] = instruction + 4;
    }
    let frames = report(&captured, &mut Binaries::default()).backtrace.unwrap();
    assert_eq!((frames[0].address, frames[0].function.as_deref()), (0, None));
    assert_eq!(frames[1].function.as_deref(), Some("reports::innermost"), "{frames:#?}");
}

/// The stream of this kind, by the file's own directory.
fn stream(dump: &[u8], kind: MINIDUMP_STREAM_TYPE) -> &[u8] {
    let header: MINIDUMP_HEADER = dump.pread_with(0, LE).unwrap();
    assert_eq!((header.signature, header.version & 0xffff), (MINIDUMP_SIGNATURE, MINIDUMP_VERSION));
    let size = MINIDUMP_DIRECTORY::size_with(&LE);
    let entries = (0..header.stream_count as usize).map(|number| {
        let at = header.stream_directory_rva as usize + number * size;
        dump.pread_with::<MINIDUMP_DIRECTORY>(at, LE).unwrap()
    });
    let entry = entries.into_iter().find(|entry| entry.stream_type == kind as u32).unwrap();
    bytes_at(dump, entry.location)
}

fn bytes_at(dump: &[u8], location: MINIDUMP_LOCATION_DESCRIPTOR) -> &[u8] {
    &dump[location.rva as usize..][..location.data_size as usize]
}

#[test]
fn minidump_holds_the_thread_its_stack_the_signal_and_the_files_of_memory() {
    let captured = Captured::of(&outermost()).unwrap();
    let dump = minidump::write(&captured, 1_700_000_000).unwrap();
    assert!(dump.len() as u64 <= MOST_BYTES, "{}", dump.len());
    let threads = stream(&dump, MINIDUMP_STREAM_TYPE::ThreadListStream);
    assert_eq!(threads.pread_with::<u32>(0, LE).unwrap(), 1);
    let thread: MINIDUMP_THREAD = threads.pread_with(4, LE).unwrap();
    assert_eq!((thread.thread_id, thread.stack.start_of_memory_range), (5, captured.head.stack_from));
    assert_eq!(bytes_at(&dump, thread.stack.memory), captured.stack);
    let context = bytes_at(&dump, thread.thread_context);
    let (instruction, stack) = if cfg!(target_arch = "x86_64") {
        let context: CONTEXT_AMD64 = context.pread_with(0, LE).unwrap();
        (context.rip, context.rsp)
    } else {
        let context: CONTEXT_ARM64 = context.pread_with(0, LE).unwrap();
        (context.pc, context.sp)
    };
    assert_eq!((instruction, stack), (captured.instruction(), captured.stack_pointer()));
    let exception = stream(&dump, MINIDUMP_STREAM_TYPE::ExceptionStream);
    let exception: MINIDUMP_EXCEPTION_STREAM = exception.pread_with(0, LE).unwrap();
    let record = exception.exception_record;
    assert_eq!((record.exception_code, record.exception_address), (11, 8));
    let modules = stream(&dump, MINIDUMP_STREAM_TYPE::ModuleListStream);
    let count = modules.pread_with::<u32>(0, LE).unwrap() as usize;
    let size = MINIDUMP_MODULE::size_with(&LE);
    let named = (0..count).map(|number| {
        let module: MINIDUMP_MODULE = modules.pread_with(4 + number * size, LE).unwrap();
        let at = module.module_name_rva as usize;
        let units = dump[at + 4..][..dump.pread_with::<u32>(at, LE).unwrap() as usize].chunks_exact(2);
        let name =
            String::from_utf16(&units.map(|unit| u16::from_le_bytes([unit[0], unit[1]])).collect::<Vec<_>>());
        (module.base_of_image..module.base_of_image + u64::from(module.size_of_image), name.unwrap())
    });
    let own = named.into_iter().find(|(range, _)| range.contains(&captured.instruction())).unwrap().1;
    assert!(own.contains("reports-"), "{own}");
    assert_eq!(stream(&dump, MINIDUMP_STREAM_TYPE::LinuxMaps), captured.maps);
}

#[test]
fn nothing_is_made_of_a_memory_that_was_not_finished() {
    assert!(Captured::of(&[]).is_err() && Captured::of(&vec![0; BYTES as usize]).is_err());
    let mut memory = outermost();
    memory[0] = 1;
    assert!(Captured::of(&memory).unwrap_err().to_string().contains("before it had written"));
    memory[0] = WHOLE as u8;
    memory[8] = 77;
    assert!(Captured::of(&memory).unwrap_err().to_string().contains("77"));
}

/// SplitMix64.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ (mixed >> 31)
    }

    fn below(&mut self, limit: usize) -> usize {
        (self.next() % limit as u64) as usize
    }
}

/// Damages that a hostile partition may make: words of the head, of the stack and of the map, and lengths that lie.
fn damage(memory: &mut [u8], random: &mut Random) {
    const ODD: [u64; 6] = [0, 1, u64::MAX, 1 << 63, 4096, 0x7fff_ffff_ffff];
    let word = |random: &mut Random| match random.below(2) {
        0 => ODD[random.below(ODD.len())],
        _ => random.next(),
    };
    for _ in 0..=random.below(24) {
        let value = word(random);
        // The state and the architecture stay: what is refused at once shows nothing.
        let at = match random.below(4) {
            0 => 16 + 8 * random.below(42),
            1 => STACK_AT as usize + 8 * random.below(256),
            2 => MAPS_AT as usize + random.below(MAPS_BYTES - 8),
            _ => STACK_AT as usize + random.below(STACK_BYTES - 8),
        };
        memory[at..at + 8].copy_from_slice(&value.to_ne_bytes());
    }
    if random.below(8) == 0 {
        memory[8] = if random.below(2) == 0 { 1 } else { 2 };
    }
}

#[test]
fn hundred_thousand_damages_end_in_a_bounded_report_or_in_a_refusal() {
    let whole = outermost();
    let mut random = Random(19);
    // Files are opened once; what the map says of others leads nowhere.
    let mut binaries = Binaries::default();
    let _ = report(&Captured::of(&whole).unwrap(), &mut binaries);
    let mut outcomes: BTreeMap<bool, u32> = BTreeMap::new();
    let mut memory = whole.clone();
    for round in 0..100_000 {
        // A part of them only, as copying all of it would take most of the time.
        if round % 16 == 0 {
            memory.copy_from_slice(&whole);
        }
        damage(&mut memory, &mut random);
        let Ok(captured) = Captured::of(&memory) else {
            *outcomes.entry(false).or_default() += 1;
            continue;
        };
        *outcomes.entry(true).or_default() += 1;
        assert!(captured.stack.len() <= STACK_BYTES && captured.maps.len() <= MAPS_BYTES);
        if round % 8 == 0 {
            assert!(minidump::write(&captured, 0).unwrap().len() as u64 <= MOST_BYTES);
        }
        if round % 64 == 0 {
            let report = report(&captured, &mut binaries);
            assert!(report.backtrace.as_ref().unwrap().len() <= 96);
            assert!(serde_json::to_vec_pretty(&report).unwrap().len() as u64 <= MOST_BYTES);
        }
    }
    assert!(outcomes.get(&true).is_some_and(|count| *count > 90_000), "{outcomes:?}");
}

#[test]
fn file_of_rubbish_is_no_report() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("memory");
    let mut random = Random(7);
    for length in [0, 1, 351, 4096, BYTES as usize] {
        let bytes: Vec<u8> = (0..length).map(|_| random.next() as u8).collect();
        std::fs::write(&path, bytes).unwrap();
        assert!(Captured::read(&File::open(&path).unwrap()).is_err());
    }
}
