//! Who has called whom, and in which function and line of the source each was.

use std::sync::Arc;

use addr2line::demangle_auto;
use framehop::aarch64::{CacheAarch64, PtrAuthMask, UnwindRegsAarch64, UnwinderAarch64};
use framehop::x86_64::{CacheX86_64, UnwindRegsX86_64, UnwinderX86_64};
use framehop::{FrameAddress, Module, Unwinder};

use crate::captured::{Architecture, Captured, plain};
use crate::frame::Frame;
use crate::maps::Mapping;

use crate::sections::{Binaries, Binary, Bytes};

/// Frames of the stack, most.
const MOST_FRAMES: usize = 64;
/// Frames with those that the compiler has made one of, most.
const MOST_SHOWN: usize = 96;
/// Letters of a function's or a file's name, most.
const MOST_LETTERS: usize = 200;
/// Bits of an address on aarch64; those above may sign it.
const AARCH64_ADDRESS: u64 = (1 << 48) - 1;

/// A mapping that code runs in, and its file.
struct Code<'a> {
    mapping: &'a Mapping,
    binary: Arc<Binary>,
    bias: u64,
}

/// The code of a dead process.
pub struct Process<'a> {
    captured: &'a Captured,
    code: Vec<Code<'a>>,
}

impl<'a> Process<'a> {
    /// Looks into the files that its memory was mapped from.
    pub fn new(captured: &'a Captured, binaries: &mut Binaries) -> Self {
        let running = captured.mappings.iter().filter(|mapping| mapping.runs);
        let code = running.filter_map(|mapping| {
            let binary = binaries.of(mapping)?;
            let bias = binary.bias(mapping)?;
            Some(Code { mapping, binary, bias })
        });
        Self { captured, code: code.collect() }
    }

    /// Addresses of instructions, the innermost first; each but the first is within the call.
    #[must_use]
    pub fn addresses(&self) -> Vec<u64> {
        let (instruction, stack) = (self.captured.instruction(), self.captured.stack_pointer());
        let registers = &self.captured.head.registers;
        let runs = |address: u64| self.captured.mappings.iter().any(|one| one.runs && one.contains(address));
        match self.captured.architecture {
            Architecture::X86_64 => {
                let mut unwinder = UnwinderX86_64::new();
                self.add_to(&mut unwinder);
                let walk = |begin: u64, stack: u64| {
                    let registers = UnwindRegsX86_64::new(begin, stack, registers[6]);
                    self.walk(&unwinder, begin, registers, &mut CacheX86_64::new())
                };
                match self.captured.word(stack).filter(|caller| !runs(instruction) && runs(*caller)) {
                    // A call to nowhere: the caller's address is what the call has left.
                    Some(caller) => beyond(instruction, walk(caller.wrapping_sub(1), stack.wrapping_add(8))),
                    None => walk(instruction, stack),
                }
            }
            Architecture::Aarch64 => {
                let mut unwinder = UnwinderAarch64::new();
                self.add_to(&mut unwinder);
                let link = registers[30] & AARCH64_ADDRESS;
                let walk = |begin: u64| {
                    let mask = PtrAuthMask::from_max_known_address(AARCH64_ADDRESS);
                    let registers =
                        UnwindRegsAarch64::new_with_ptr_auth_mask(mask, registers[30], stack, registers[29]);
                    self.walk(&unwinder, begin, registers, &mut CacheAarch64::new())
                };
                match !runs(instruction) && runs(link) {
                    true => beyond(instruction, walk(link.wrapping_sub(1))),
                    false => walk(instruction),
                }
            }
        }
    }

    fn add_to(&self, unwinder: &mut impl Unwinder<Module = Module<Bytes>>) {
        for Code { mapping, binary, bias } in &self.code {
            let range = mapping.from..mapping.to;
            unwinder.add_module(Module::new(mapping.path.clone(), range, *bias, binary.unwinding()));
        }
    }

    fn walk<U: Unwinder>(
        &self,
        unwinder: &U,
        begin: u64,
        registers: U::UnwindRegs,
        cache: &mut U::Cache,
    ) -> Vec<u64> {
        let mut read = |address| self.captured.word(address).ok_or(());
        let mut frames = unwinder.iter_frames(begin, registers, cache, &mut read);
        let mut found = Vec::new();
        while found.len() < MOST_FRAMES
            && let Ok(Some(frame)) = frames.next()
        {
            found.push(match frame {
                FrameAddress::InstructionPointer(address) => address,
                FrameAddress::ReturnAddress(address) => address.get().wrapping_sub(1),
            });
        }
        found
    }

    /// The functions and lines at these addresses.
    #[must_use]
    pub fn frames(&self, addresses: &[u64]) -> Vec<Frame> {
        let mut frames = Vec::new();
        for address in addresses {
            self.add_frames(*address, &mut frames);
        }
        frames.truncate(MOST_SHOWN);
        mark_runtime(&mut frames);
        frames
    }

    fn add_frames(&self, address: u64, frames: &mut Vec<Frame>) {
        let code = self.code.iter().find(|code| code.mapping.contains(address));
        let mapping = self.captured.mappings.iter().find(|mapping| mapping.contains(address));
        let own = code.map(|code| address.wrapping_sub(code.bias));
        let bare = Frame {
            address,
            module: mapping.map(|mapping| plain(&short(&mapping.path))).filter(|path| !path.is_empty()),
            offset: own,
            ..Frame::default()
        };
        let before = frames.len();
        if let Some((loader, own)) = code.and_then(|code| code.binary.loader()).zip(own) {
            if let Ok(mut found) = loader.find_frames(own) {
                while frames.len() < MOST_SHOWN
                    && let Ok(Some(frame)) = found.next()
                {
                    let location = frame.location.as_ref();
                    frames.push(Frame {
                        function: frame.function.and_then(|name| Some(plain(&short(&name.demangle().ok()?)))),
                        file: location.and_then(|place| place.file).map(|file| plain(&short(file))),
                        line: location.and_then(|place| place.line),
                        column: location.and_then(|place| place.column),
                        ..bare.clone()
                    });
                }
            }
            // Without line tables the symbols have the outermost function's name.
            if let Some(last) = frames[before..].last_mut().filter(|last| last.function.is_none()) {
                last.function = symbol(loader, own);
            } else if frames.len() == before
                && let Some(function) = symbol(loader, own)
            {
                frames.push(Frame { function: Some(function), ..bare.clone() });
            }
        }
        if frames.len() == before {
            frames.push(bare);
        }
        // The last of them is the function that the stack's frame belongs to.
        let count = frames.len() - before;
        frames[before..].iter_mut().take(count - 1).for_each(|frame| frame.inlined = true);
    }
}

fn beyond(instruction: u64, callers: Vec<u64>) -> Vec<u64> {
    std::iter::once(instruction).chain(callers).take(MOST_FRAMES).collect()
}

fn symbol(loader: &addr2line::Loader, address: u64) -> Option<String> {
    let name = loader.find_symbol(address)?;
    Some(plain(&short(&demangle_auto(name.into(), None))))
}

fn short(text: &str) -> String {
    text.chars().take(MOST_LETTERS).collect()
}

/// Functions with which a runtime ends a program, or tells of its end.
const RUNTIME: [&str; 20] = [
    "core::panicking::",
    "std::panicking::",
    "std::panic::",
    "__rustc::rust_begin_unwind",
    "rust_begin_unwind",
    "std::sys::backtrace::__rust_end_short_backtrace",
    "core::result::unwrap_failed",
    "core::option::unwrap_failed",
    "core::option::expect_failed",
    "core::slice::index::",
    "core::str::slice_error_fail",
    "alloc::alloc::handle_alloc_error",
    "alloc::raw_vec::handle_error",
    "std::alloc::",
    "std::process::abort",
    "bateleur_apex::crash::",
    "__pthread_kill_implementation",
    "__GI_raise",
    "__GI_abort",
    "__libc_message",
];
/// As above, whole names.
const RUNTIME_NAMES: [&str; 8] = [
    "abort",
    "raise",
    "gsignal",
    "pthread_kill",
    "__assert_fail",
    "__assert_fail_base",
    "__GI___assert_fail",
    "__pthread_kill_internal",
];

fn is_runtimes(function: &str) -> bool {
    let function = function.trim_start_matches('<');
    RUNTIME.iter().any(|begin| function.starts_with(begin)) || RUNTIME_NAMES.contains(&function)
}

/// The innermost frames, up to the last of a runtime that stands among the first, say how the program was ended, and not where.
fn mark_runtime(frames: &mut [Frame]) {
    const AMONG: usize = 24;
    let is = |frame: &Frame, what: fn(&str) -> bool| frame.function.as_deref().is_some_and(what);
    // Whoever catches panics has such functions too, at the outer end.
    let caught = frames.iter().position(|frame| is(frame, catches)).unwrap_or(frames.len());
    if let Some(last) = frames[..caught.min(AMONG)].iter().rposition(|frame| is(frame, is_runtimes)) {
        frames[..=last].iter_mut().for_each(|frame| frame.runtime = true);
    }
}

/// Functions below which nothing is the program's own, or from which on its panics are caught.
fn catches(function: &str) -> bool {
    const BEGIN: [&str; 3] =
        ["std::rt::lang_start", "std::sys::backtrace::__rust_begin_short_backtrace", "__libc_start_"];
    BEGIN.iter().any(|begin| function.starts_with(begin))
        || ["catch_unwind", "panicking::try", "::do_call"].iter().any(|part| function.contains(part))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(names: &[&str]) -> Vec<Frame> {
        let mut frames: Vec<Frame> =
            names.iter().map(|name| Frame { function: Some((*name).into()), ..Frame::default() }).collect();
        mark_runtime(&mut frames);
        frames
    }

    #[test]
    fn frames_of_a_panic_are_told_from_those_that_led_to_it() {
        let panic = frames(&[
            "bateleur_apex::crash::panicked",
            "<alloc::boxed::Box<F,A> as core::ops::function::Fn<Args>>::call",
            "std::panicking::panic_with_hook",
            "core::panicking::panic_fmt",
            "gps::divide",
            "gps::main",
            "std::panicking::catch_unwind",
            "std::rt::lang_start_internal",
        ]);
        // Behind what is the program's own there may be such functions again.
        let innermost = panic.iter().find(|frame| !frame.runtime).and_then(|frame| frame.function.as_deref());
        assert_eq!(innermost, Some("gps::divide"));
        let fault = frames(&[
            "gps::write",
            "gps::main",
            "std::rt::lang_start_internal",
            "std::panicking::catch_unwind",
        ]);
        assert!(fault.iter().all(|frame| !frame.runtime));
    }
}
