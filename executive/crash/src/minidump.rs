//! The same as a minidump, the format that debuggers and services for crash reports read: one thread with its registers and its stack, the
//! signal, the files that memory was mapped from, and the map of memory.

use std::collections::BTreeMap;

use minidump_common::format::{
    CONTEXT_AMD64, CONTEXT_ARM64, CPU_INFORMATION, ContextFlagsAmd64, ContextFlagsArm64, MINIDUMP_DIRECTORY,
    MINIDUMP_EXCEPTION, MINIDUMP_EXCEPTION_STREAM, MINIDUMP_HEADER, MINIDUMP_LOCATION_DESCRIPTOR,
    MINIDUMP_MEMORY_DESCRIPTOR, MINIDUMP_MODULE, MINIDUMP_SIGNATURE, MINIDUMP_STREAM_TYPE,
    MINIDUMP_SYSTEM_INFO, MINIDUMP_THREAD, MINIDUMP_VERSION, PlatformId, ProcessorArchitecture,
    VS_FIXEDFILEINFO,
};
use scroll::ctx::{SizeWith, TryIntoCtx};
use scroll::{Endian, LE, Pwrite};

use crate::captured::{Architecture, Captured};

/// Files that are named, most.
const MOST_MODULES: usize = 128;
/// Letters of a file's path, most: with all of them the file stays within its bound.
const MOST_LETTERS: usize = 200;
/// An exception code for what is no signal, as other writers of minidumps have it ("simulated").
const NO_SIGNAL: u32 = 0x0517_a7ed;

/// The file's bytes. `unix_s`: when it happened, seconds since 1970.
///
/// # Errors
/// A structure can not be written, which is an error of this module.
pub fn write(captured: &Captured, unix_s: u32) -> Result<Vec<u8>, scroll::Error> {
    let mut file = Writer::default();
    file.add(&[0; 32]); // the header, at the end
    let context = context(captured)?;
    let context = file.bytes(&context);
    let stack = MINIDUMP_MEMORY_DESCRIPTOR {
        start_of_memory_range: captured.head.stack_from,
        memory: file.bytes(&captured.stack),
    };
    let maps = file.bytes(&captured.maps);
    let system = file.one(system_info(captured.architecture))?;
    let thread_id = captured.head.thread as u32;
    let thread = MINIDUMP_THREAD {
        thread_id,
        suspend_count: 0,
        priority_class: 0,
        priority: 0,
        teb: 0,
        stack,
        thread_context: context,
    };
    let threads = file.list(vec![thread])?;
    let exception = MINIDUMP_EXCEPTION {
        exception_code: match captured.head.signal {
            0 => NO_SIGNAL,
            signal => signal as u32,
        },
        exception_flags: captured.head.code as u32,
        exception_address: captured.head.address,
        ..MINIDUMP_EXCEPTION::default()
    };
    let exception = file.one(MINIDUMP_EXCEPTION_STREAM {
        thread_id,
        __align: 0,
        exception_record: exception,
        thread_context: context,
    })?;
    let modules = modules(captured, &mut file)?;
    let memory = file.list(vec![stack])?;
    let streams = [
        (MINIDUMP_STREAM_TYPE::SystemInfoStream, system),
        (MINIDUMP_STREAM_TYPE::ThreadListStream, threads),
        (MINIDUMP_STREAM_TYPE::ExceptionStream, exception),
        (MINIDUMP_STREAM_TYPE::ModuleListStream, modules),
        (MINIDUMP_STREAM_TYPE::MemoryListStream, memory),
        (MINIDUMP_STREAM_TYPE::LinuxMaps, maps),
    ];
    file.align();
    let stream_directory_rva = file.0.len() as u32;
    for (stream, location) in streams {
        file.add_one(MINIDUMP_DIRECTORY { stream_type: stream as u32, location })?;
    }
    let header = MINIDUMP_HEADER {
        signature: MINIDUMP_SIGNATURE,
        version: MINIDUMP_VERSION,
        stream_count: streams.len() as u32,
        stream_directory_rva,
        checksum: 0,
        time_date_stamp: unix_s,
        flags: 0,
    };
    file.0.pwrite_with(header, 0, LE)?;
    Ok(file.0)
}

#[derive(Default)]
struct Writer(Vec<u8>);

impl Writer {
    fn align(&mut self) {
        self.0.resize(self.0.len().next_multiple_of(8), 0);
    }

    fn add(&mut self, bytes: &[u8]) {
        self.0.extend_from_slice(bytes);
    }

    fn bytes(&mut self, bytes: &[u8]) -> MINIDUMP_LOCATION_DESCRIPTOR {
        self.align();
        let rva = self.0.len() as u32;
        self.0.extend_from_slice(bytes);
        MINIDUMP_LOCATION_DESCRIPTOR { data_size: bytes.len() as u32, rva }
    }

    fn add_one<T>(&mut self, value: T) -> Result<(), scroll::Error>
    where
        T: SizeWith<Endian> + TryIntoCtx<Endian, Error = scroll::Error>,
    {
        let at = self.0.len();
        self.0.resize(at + T::size_with(&LE), 0);
        self.0.pwrite_with(value, at, LE)?;
        Ok(())
    }

    fn one<T>(&mut self, value: T) -> Result<MINIDUMP_LOCATION_DESCRIPTOR, scroll::Error>
    where
        T: SizeWith<Endian> + TryIntoCtx<Endian, Error = scroll::Error>,
    {
        self.align();
        let rva = self.0.len() as u32;
        self.add_one(value)?;
        Ok(MINIDUMP_LOCATION_DESCRIPTOR { data_size: self.0.len() as u32 - rva, rva })
    }

    /// How many there are, and each.
    fn list<T>(&mut self, values: Vec<T>) -> Result<MINIDUMP_LOCATION_DESCRIPTOR, scroll::Error>
    where
        T: SizeWith<Endian> + TryIntoCtx<Endian, Error = scroll::Error>,
    {
        self.align();
        let rva = self.0.len() as u32;
        self.add_one(values.len() as u32)?;
        for value in values {
            self.add_one(value)?;
        }
        Ok(MINIDUMP_LOCATION_DESCRIPTOR { data_size: self.0.len() as u32 - rva, rva })
    }
}

fn context(captured: &Captured) -> Result<Vec<u8>, scroll::Error> {
    let registers = &captured.head.registers;
    let mut bytes;
    match captured.architecture {
        Architecture::X86_64 => {
            let [
                rax,
                rdx,
                rcx,
                rbx,
                rsi,
                rdi,
                rbp,
                rsp,
                r8,
                r9,
                r10,
                r11,
                r12,
                r13,
                r14,
                r15,
                rip,
                flags,
                ..,
            ] = *registers;
            let context = CONTEXT_AMD64 {
                context_flags: ContextFlagsAmd64::CONTEXT_AMD64_FULL.bits(),
                eflags: flags as u32,
                rax,
                rcx,
                rdx,
                rbx,
                rsp,
                rbp,
                rsi,
                rdi,
                r8,
                r9,
                r10,
                r11,
                r12,
                r13,
                r14,
                r15,
                rip,
                ..CONTEXT_AMD64::default()
            };
            bytes = vec![0; CONTEXT_AMD64::size_with(&LE)];
            bytes.pwrite_with(context, 0, LE)?;
        }
        Architecture::Aarch64 => {
            let mut iregs = [0; 31];
            iregs.copy_from_slice(&registers[..31]);
            let context = CONTEXT_ARM64 {
                context_flags: ContextFlagsArm64::CONTEXT_ARM64_FULL.bits(),
                cpsr: registers[33] as u32,
                iregs,
                sp: registers[31],
                pc: registers[32],
                ..CONTEXT_ARM64::default()
            };
            bytes = vec![0; CONTEXT_ARM64::size_with(&LE)];
            bytes.pwrite_with(context, 0, LE)?;
        }
    }
    Ok(bytes)
}

fn system_info(architecture: Architecture) -> MINIDUMP_SYSTEM_INFO {
    let processor = match architecture {
        Architecture::X86_64 => ProcessorArchitecture::PROCESSOR_ARCHITECTURE_AMD64,
        Architecture::Aarch64 => ProcessorArchitecture::PROCESSOR_ARCHITECTURE_ARM64,
    };
    MINIDUMP_SYSTEM_INFO {
        processor_architecture: processor as u16,
        processor_level: 0,
        processor_revision: 0,
        number_of_processors: 0,
        product_type: 0,
        major_version: 0,
        minor_version: 0,
        build_number: 0,
        platform_id: PlatformId::Linux as u32,
        csd_version_rva: 0,
        suite_mask: 0,
        reserved2: 0,
        cpu: CPU_INFORMATION { data: [0; 24] },
    }
}

fn modules(captured: &Captured, file: &mut Writer) -> Result<MINIDUMP_LOCATION_DESCRIPTOR, scroll::Error> {
    // Of each file, from its first byte that is mapped to its last.
    let mut ranges: BTreeMap<&str, (u64, u64, bool)> = BTreeMap::new();
    for mapping in captured.mappings.iter().filter(|mapping| !mapping.path.is_empty()) {
        let range = ranges.entry(&mapping.path).or_insert((mapping.from, mapping.to, false));
        *range = (range.0.min(mapping.from), range.1.max(mapping.to), range.2 || mapping.runs);
    }
    let mut modules = Vec::new();
    for (path, (from, to, _)) in ranges.into_iter().filter(|(_, range)| range.2).take(MOST_MODULES) {
        let name: Vec<u16> = path.chars().take(MOST_LETTERS).collect::<String>().encode_utf16().collect();
        file.align();
        let module_name_rva = file.0.len() as u32;
        file.add_one(name.len() as u32 * 2)?;
        for unit in name.iter().chain(&[0]) {
            file.add(&unit.to_le_bytes());
        }
        modules.push(MINIDUMP_MODULE {
            base_of_image: from,
            size_of_image: u32::try_from(to - from).unwrap_or(u32::MAX),
            checksum: 0,
            time_date_stamp: 0,
            module_name_rva,
            version_info: VS_FIXEDFILEINFO::default(),
            cv_record: MINIDUMP_LOCATION_DESCRIPTOR::default(),
            misc_record: MINIDUMP_LOCATION_DESCRIPTOR::default(),
            reserved0: [0; 2],
            reserved1: [0; 2],
        });
    }
    file.list(modules)
}
