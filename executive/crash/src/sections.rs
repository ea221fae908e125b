//! The files of the program and its libraries: what is needed of each to find callers, functions and lines.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::fs::File;
use std::ops::Range;
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::sync::Arc;

use addr2line::Loader;
use framehop::ExplicitModuleSectionInfo;
use object::elf::PF_X;
use object::{Object, ObjectSection, ObjectSegment, ReadCache, SegmentFlags};

use crate::maps::Mapping;

/// Bytes of a file that is looked into, most.
const MOST_FILE: u64 = 1 << 30;
/// Bytes of a section that is read, most.
const MOST_SECTION: u64 = 256 << 20;
/// Files that are looked into for one report, most.
const MOST_FILES: usize = 64;
/// So that a path that leads to a pipe holds up nobody (fcntl.h).
const O_NONBLOCK: i32 = 0o4000;

/// Bytes of a section, of which copies cost nothing.
pub(crate) type Bytes = Arc<[u8]>;

/// Files by their paths, each opened once.
#[derive(Default)]
pub struct Binaries {
    program: Option<(String, File)>,
    known: BTreeMap<String, Option<Arc<Binary>>>,
}

impl Binaries {
    /// `program`: the partition's program, and the file behind its path, which whoever reads may not be able to open.
    #[must_use]
    pub fn new(program: Option<(String, File)>) -> Self {
        Self { program, known: BTreeMap::new() }
    }

    /// The file of a mapping, if it is a program or a library that can be read.
    pub(crate) fn of(&mut self, mapping: &Mapping) -> Option<Arc<Binary>> {
        if let Some(known) = self.known.get(&mapping.path) {
            return known.clone();
        }
        if mapping.path.is_empty() || self.known.len() >= MOST_FILES {
            return None;
        }
        let binary = self.open(&mapping.path).and_then(|(path, file)| Binary::read(path, file)).map(Arc::new);
        self.known.insert(mapping.path.clone(), binary.clone());
        binary
    }

    /// A file, and a path that leads to it.
    fn open(&self, path: &str) -> Option<(String, File)> {
        if let Some((_, program)) = self.program.as_ref().filter(|(program, _)| program == path) {
            return Some((format!("/proc/self/fd/{}", program.as_raw_fd()), program.try_clone().ok()?));
        }
        let file = File::options().read(true).custom_flags(O_NONBLOCK).open(Path::new(path)).ok()?;
        Some((path.to_owned(), file))
    }
}

/// One program or library.
pub(crate) struct Binary {
    path: String,
    /// Of the segments that run, from the place in the file to the address that the file itself gives it: place, bytes, address.
    segments: Vec<(u64, u64, u64)>,
    sections: BTreeMap<&'static str, (Range<u64>, Bytes)>,
    loader: OnceCell<Option<Loader>>,
}

/// Sections that callers are found by.
const UNWIND: [&str; 3] = [".eh_frame", ".eh_frame_hdr", ".debug_frame"];

impl Binary {
    fn read(path: String, file: File) -> Option<Self> {
        let about = file.metadata().ok()?;
        if !about.is_file() || about.len() > MOST_FILE {
            return None;
        }
        let cache = ReadCache::new(file);
        let object = object::File::parse(&cache).ok()?;
        // Two segments may share a page of the file, but only one of them runs.
        let runs = |flags| matches!(flags, SegmentFlags::Elf { p_flags } if p_flags & PF_X != 0);
        let segments = object.segments().filter(|segment| runs(segment.flags())).map(|segment| {
            let (place, bytes) = segment.file_range();
            (place, bytes, segment.address())
        });
        let sections = UNWIND.iter().filter_map(|name| {
            let section = object.section_by_name(name)?;
            let bytes = section.uncompressed_data().ok().filter(|_| section.size() <= MOST_SECTION)?;
            Some((
                *name,
                (section.address()..section.address().saturating_add(section.size()), Bytes::from(&*bytes)),
            ))
        });
        Some(Self {
            segments: segments.collect(),
            sections: sections.collect(),
            loader: OnceCell::new(),
            path,
        })
    }

    /// What is added to the file's own addresses to have those of the process.
    pub(crate) fn bias(&self, mapping: &Mapping) -> Option<u64> {
        let within = |&&(place, bytes, _): &&(u64, u64, u64)| {
            // A segment begins in the midst of a page, its mapping at the page.
            (place & !0xfff..place.saturating_add(bytes)).contains(&mapping.offset)
        };
        let (place, _, address) = self.segments.iter().find(within)?;
        Some(mapping.from.wrapping_sub(address.wrapping_sub(*place).wrapping_add(mapping.offset)))
    }

    /// What callers are found by.
    pub(crate) fn unwinding(&self) -> ExplicitModuleSectionInfo<Bytes> {
        let part = |name| self.sections.get(name).cloned();
        let (eh_frame, header, debug_frame) =
            (part(".eh_frame"), part(".eh_frame_hdr"), part(".debug_frame"));
        ExplicitModuleSectionInfo {
            eh_frame_svma: eh_frame.as_ref().map(|(range, _)| range.clone()),
            eh_frame: eh_frame.map(|(_, bytes)| bytes),
            eh_frame_hdr_svma: header.as_ref().map(|(range, _)| range.clone()),
            eh_frame_hdr: header.map(|(_, bytes)| bytes),
            debug_frame: debug_frame.map(|(_, bytes)| bytes),
            ..ExplicitModuleSectionInfo::default()
        }
    }

    /// Its symbols and line tables, which are read when somebody first asks.
    pub(crate) fn loader(&self) -> Option<&Loader> {
        self.loader.get_or_init(|| Loader::new(&self.path).ok()).as_ref()
    }
}
