//! A partition that has been taken over and spoils the directories of its channels, in window number `after` of each of its first
//! `lives` incarnations. `how` says what it does there, `seed` and the incarnation's number what chance makes of it, and `end` whether
//! it exits then (`exit`) or goes on (`stay`).
//!
//! `closed`: their modes are 0. `nested`: folders within each other, of mode 0. `full`: empty files, until it can make no more. `random`:
//! a tree of folders, files, links, pipes and sockets, with any modes and names; the library's own files may be among them.

use std::ffi::CString;
use std::fs;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use bateleur_apex::{
    Context, Direction, Partition, PortKind, SamplingDestination, SamplingSource, StartError, Window,
};
use bateleur_messages::FunctionStatus;
use rustix::fs::{AtFlags, CWD, Mode, OFlags};

struct Litterer {
    how: String,
    seed: u64,
    exits: bool,
    count: u64,
    windows_left: Option<u64>,
    source: Option<SamplingSource<FunctionStatus>>,
    heard: Option<SamplingDestination<FunctionStatus>>,
}

impl Partition for Litterer {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let has = |name: &str, direction| {
            context.port_names(PortKind::Sampling, direction).iter().any(|port| port == name)
        };
        let (counts, hears) = (has("count", Direction::Source), has("heard", Direction::Destination));
        let life = u64::from(context.generation());
        let attacks = life < context.attribute("lives", u64::MAX)?;
        Ok(Self {
            how: context.attribute("how", "closed".to_owned())?,
            seed: context.attribute("seed", 1_u64)?.wrapping_mul(1000) + life,
            exits: context.attribute("end", "exit".to_owned())? == "exit",
            count: context.attribute("count", 1500_u64)?,
            windows_left: attacks.then_some(context.attribute("after", 5_u64)?),
            source: if counts { Some(context.sampling_source("count")?) } else { None },
            heard: if hears { Some(context.sampling_destination("heard")?) } else { None },
        })
    }

    fn window(&mut self, window: &Window) {
        let _ = self.heard.as_mut().map(SamplingDestination::read_valid);
        if let Some(source) = &mut self.source {
            source.write(&FunctionStatus::default());
        }
        match &mut self.windows_left {
            Some(0) => {
                for channel in channels() {
                    match self.how.as_str() {
                        "closed" => drop(fs::set_permissions(&channel, fs::Permissions::from_mode(0o0))),
                        "nested" => nest(&channel, self.count),
                        "full" => fill(&channel, self.count),
                        _ => litter(&channel, self.seed),
                    }
                }
                window.report("it has littered");
                self.windows_left = None;
                if self.exits {
                    std::process::exit(3);
                }
            }
            Some(left) => *left -= 1,
            None => {}
        }
    }
}

/// The directories of its channels, which stand among what it maps.
fn channels() -> Vec<PathBuf> {
    let maps = fs::read_to_string("/proc/self/maps").unwrap_or_default();
    let mapped = maps.lines().filter_map(|line| Some(Path::new(line.get(line.find("/dev/shm/")?..)?)));
    let mut found: Vec<PathBuf> = mapped.filter_map(channel_of).map(Path::to_owned).collect();
    found.sort();
    found.dedup();
    found
}

/// The directory of the channel that `file` lies in.
fn channel_of(file: &Path) -> Option<&Path> {
    file.ancestors().find(|path| path.parent().is_some_and(|above| above.ends_with("ports")))
}

/// Folders within each other, as many as there can be or `count`; all but the outermost are closed.
fn nest(top: &Path, count: u64) {
    const FOLDER: OFlags = OFlags::RDONLY.union(OFlags::DIRECTORY);
    let Ok(mut inner) = rustix::fs::open(top, FOLDER, Mode::empty()) else { return };
    let mut before: Option<OwnedFd> = None;
    for _ in 0..count {
        if rustix::fs::mkdirat(&inner, "nested", Mode::from_raw_mode(0o700)).is_err() {
            return;
        }
        let Ok(next) = rustix::fs::openat(&inner, "nested", FOLDER, Mode::empty()) else { return };
        if let Some(closed) = before.replace(inner) {
            let _ = rustix::fs::fchmod(closed.as_fd(), Mode::empty()); // refused for the channel's own directory
        }
        inner = next;
    }
    let _ = fs::set_permissions(top, fs::Permissions::from_mode(0o777)); // it was closed first of all
}

/// Empty files, half of them named as the library's are.
fn fill(top: &Path, count: u64) {
    for number in 0..count {
        let name = if number % 2 == 0 { format!("{number}") } else { format!("bateleur_{number}.data") };
        if fs::write(top.join(name), "").is_err() {
            return;
        }
    }
}

/// A random tree.
fn litter(top: &Path, seed: u64) {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut random = move |below: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    let mut folders = vec![top.to_owned(), top.join("nodes"), top.join("services")];
    let mut closed = Vec::new();
    for number in 0..10 + random(400) {
        let above = folders[random(folders.len())].clone();
        let name = match random(6) {
            0 => format!("bateleur_{number}.data"),
            1 => format!("{}", (std::process::id() as u128) << 64 | number as u128),
            2 => "n".repeat(1 + random(255)),
            3 => format!("{number}\u{1f4a5}\n"),
            _ => number.to_string(),
        };
        let path = above.join(name);
        match random(10) {
            0..=3 => {
                if fs::create_dir(&path).is_ok() {
                    folders.push(path.clone());
                    closed.push(path);
                }
            }
            4 => drop(std::os::unix::fs::symlink(["/", "..", "/dev/shm"][random(3)], &path)),
            5 => drop(rustix::fs::mkfifoat(CWD, &path, Mode::from_raw_mode(0o600))),
            6 => drop(std::os::unix::net::UnixListener::bind(&path)),
            7 => {
                // Something of the library's own, in its place or in a wrong one.
                let Some(Ok(known)) = fs::read_dir(&above).ok().and_then(|mut all| all.nth(random(4))) else {
                    continue;
                };
                match random(4) {
                    0 => drop(fs::hard_link(known.path(), &path)),
                    1 => drop(fs::rename(known.path(), &path)),
                    2 => drop(fs::remove_file(known.path())),
                    _ => closed.push(known.path()),
                }
            }
            _ => drop(fs::write(&path, vec![7; random(200)])),
        }
    }
    if random(3) == 0 {
        closed.push(top.to_owned());
    }
    for path in closed.into_iter().rev() {
        let Ok(text) = CString::new(path.as_os_str().as_bytes()) else { continue };
        let mode = [0, 0o500, 0o300, 0o777][random(4)];
        let _ = rustix::fs::chmodat(CWD, text.as_c_str(), Mode::from_raw_mode(mode), AtFlags::empty());
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Litterer>()
}
