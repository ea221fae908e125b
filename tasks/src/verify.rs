//! `cargo verify`: everything that must pass before a change lands, cheapest first; stops at the first failure.
//!
//! One profile throughout, so that everything is built once: the tests of the whole system run the release programs.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::{Duration, Instant};

use crate::step::{Step, in_ci, succeeds};
use crate::tally::Tally;
use crate::{CANNOT_RUN, apex, arrows, book, cargo, circles, commands, features, fly, links, trusted};

/// Some test, lint or page is not as it must be.
const FAILED: u8 = 1;
/// How long random system calls are made, s: all kinds together.
const FUZZ_S: &str = "60";
/// The same by `--long`: longer than anything else, for a machine that has the time.
const LONG_FUZZ_S: &str = "600";
/// Tests read it: `1`, they fly and draw as often as a release asks for.
const LONG: &str = "BATELEUR_LONG";
/// The tests that hold to be alone, as `.config/nextest.toml` knows them.
const ALONE: &str = "package(bateleur-tests) & test(/::alone::/)";
/// The server of Foxglove's protocol, a workspace of its own.
const FOXGLOVE: &str = "hil/foxglove/Cargo.toml";
/// How long asking a tool for its version may take.
const ASKING: Duration = Duration::from_secs(30);
/// How long a tool may still be installed when all else is done.
const INSTALLING: Duration = Duration::from_secs(900);
/// How long fetching the database of known vulnerabilities may take; without a network it is never there.
const FETCHING: Duration = Duration::from_secs(90);

pub(crate) fn run(arguments: &[OsString]) -> ExitCode {
    let is_long = match arguments {
        [] => false,
        [long] if long == "--long" => true,
        _ => {
            eprintln!(
                "usage: cargo verify [--long]: campaigns and random system calls as long as before a release"
            );
            return ExitCode::from(CANNOT_RUN);
        }
    };
    let root = root();
    if let Err(error) = std::env::set_current_dir(&root) {
        eprintln!("verify: cannot enter {}: {error}", root.display());
        return ExitCode::from(CANNOT_RUN);
    }
    let begun = Instant::now();
    let mut tally = Tally::default();
    let result = everything(&root, is_long, &mut tally);
    match &result {
        Ok(()) => println!("verify: everything passed in {:.0} s", begun.elapsed().as_secs_f64()),
        Err(reason) => println!("verify: {reason}"),
    }
    println!("{tally}");
    if result.is_ok() { ExitCode::SUCCESS } else { ExitCode::from(FAILED) }
}

/// The commands of the pages alone, with the programs as they were built last.
pub(crate) fn only_commands() -> ExitCode {
    said(shown_commands(&root()))
}

/// The links of the pages, the table of crates and that of what is trusted, alone.
pub(crate) fn only_pages() -> ExitCode {
    said(pages(&root()))
}

fn said(result: Result<(), String>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            println!("verify: {reason}");
            ExitCode::from(FAILED)
        }
    }
}

/// Writes the tables of a page, as its `check` does.
pub(crate) fn write_page(check: fn(&Path, bool) -> Vec<String>) -> ExitCode {
    let faults = check(&root(), true);
    faults.iter().for_each(|fault| println!("{fault}"));
    if faults.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(FAILED) }
}

/// Where the workspace lies: above this package.
pub(crate) fn root() -> PathBuf {
    let package = std::env::var_os("CARGO_MANIFEST_DIR").unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
    Path::new(&package).parent().map_or_else(|| ".".into(), Path::to_owned)
}

fn everything(root: &Path, is_long: bool, tally: &mut Tally) -> Result<(), String> {
    Step::cargo("format", &["fmt", "--all", "--check"]).run(tally)?;
    locks(tally)?;
    pages(root)?;
    let mut late = Vec::new();
    for (has_tool, check) in WITH_TOOLS {
        if has_tool() {
            check(root, tally)?;
        } else {
            late.push((has_tool, check));
        }
    }
    Step::cargo("programs and tests", &["build", "--release", "--workspace", "--all-targets"]).run(tally)?;
    schedule(tally)?;
    let other = other_processor(tally)?;
    let mut own = Tally::default();
    let counted = &mut own;
    let (tested, beside) = std::thread::scope(|scope| {
        // The tests go on: whoever waits shall read it at once.
        let beside = scope.spawn(move || {
            let foxglove = beside_tests(counted);
            foxglove.inspect_err(|reason| println!("== FAILED: {reason}"))
        });
        let tested = shown_commands(root).and_then(|()| tests(is_long, tally));
        (tested, beside.join().unwrap_or_else(|_| Err("the steps beside the tests panicked".into())))
    });
    tally.add(own);
    tested?;
    let foxglove = beside?;
    guest(root, other, is_long, tally)?;
    foxglove_clients(foxglove, tally)?;
    for (has_tool, check) in late {
        let begun = Instant::now();
        while in_ci() && !has_tool() && begun.elapsed() < INSTALLING {
            std::thread::sleep(Duration::from_secs(1));
        }
        check(root, tally)?;
    }
    Ok(())
}

/// Whether a tool is there, and what is checked with it: first of all, or, where `.ci/run` still installs it, last.
const WITH_TOOLS: [(fn() -> bool, Check); 2] = [(has_mdbook, book), (has_deny, dependencies)];

type Check = fn(&Path, &mut Tally) -> Result<(), String>;

fn has_mdbook() -> bool {
    succeeds("mdbook", &["--version"], ASKING)
}

fn has_deny() -> bool {
    succeeds(cargo(), &["deny", "--version"], ASKING)
}

/// What the tests are told; without the option what the environment says.
fn long(is_long: bool) -> String {
    if is_long { "1".to_owned() } else { std::env::var(LONG).unwrap_or_default() }
}

/// The workspaces beside this one lock what this one's crates need by now: their own builds come late, or not at all.
fn locks(tally: &mut Tally) -> Result<(), String> {
    for manifest in [FOXGLOVE, "gateway/zenoh/Cargo.toml"] {
        let update = ["update", "--quiet", "--workspace", "--locked", "--manifest-path", manifest];
        let repeat = format!("to mend it: cargo update --workspace --manifest-path {manifest}");
        Step::cargo("locks", &update).run(tally).map_err(|error| format!("{error}; {repeat}"))?;
    }
    Ok(())
}

fn pages(root: &Path) -> Result<(), String> {
    let mut faults = links::check(root);
    faults.extend(arrows::check(root));
    faults.extend(trusted::check(root, false));
    faults.extend(apex::check(root, false));
    faults.extend(features::check(root));
    faults.extend(circles::check(root));
    said_faults(&faults, "places in the pages and manifests are wrong")?;
    println!("== pages, the table of crates, and features: fine");
    Ok(())
}

fn book(root: &Path, tally: &mut Tally) -> Result<(), String> {
    if !has_mdbook() {
        return left_out("book", "mdbook is not installed: cargo install mdbook --locked");
    }
    let place = fly::beside_self("book").map_err(|error| error.to_string())?;
    let (shown, source) = (place.to_string_lossy(), root.join("docs"));
    Step::new("book", "mdbook", &["build", "--dest-dir", &shown, &source.to_string_lossy()]).run(tally)?;
    said_faults(&book::check(&place), "links and pictures of the book lead nowhere")
}

/// Without a tool a person's run leaves something out and says so; CI fails.
fn left_out(what: &str, why: &str) -> Result<(), String> {
    if in_ci() {
        return Err(format!("{what}: {why}; CI needs it"));
    }
    println!("== {what}: NOT CHECKED, {why}");
    Ok(())
}

/// Shows what is wrong, if something is.
fn said_faults(faults: &[String], what: &str) -> Result<(), String> {
    faults.iter().for_each(|fault| println!("{fault}"));
    if faults.is_empty() { Ok(()) } else { Err(format!("{} {what} (see above)", faults.len())) }
}

/// Licences, sources and known vulnerabilities of other people's crates.
fn dependencies(_: &Path, tally: &mut Tally) -> Result<(), String> {
    if !has_deny() {
        return left_out("dependencies", "cargo-deny is not installed: cargo install cargo-deny --locked");
    }
    Step::cargo("dependencies", &["deny", "--log-level", "error", "check", "bans", "licenses", "sources"])
        .run(tally)?;
    if succeeds(cargo(), &["deny", "fetch", "db"], FETCHING) {
        let offline = ["deny", "--offline", "--log-level", "error", "check", "advisories"];
        return Step::cargo("vulnerabilities", &offline).run(tally);
    }
    println!("== vulnerabilities: NOT CHECKED, their database can not be reached from here");
    Ok(())
}

/// What two threads share without a lock, in every order in which they can meet. One crate after the other: each is built with the
/// model checker's atomics, which its dependents do not know.
fn models(tally: &mut Tally) -> Result<(), String> {
    for crate_name in ["bateleur-contract", "bateleur-ports", "bateleur-time"] {
        let test = ["test", "--release", "--lib", "--features", "model", "-p", crate_name, "model_"];
        Step::cargo("models of what threads share", &test).idle().run(tally)?;
    }
    Ok(())
}

/// What only another kernel or processor can show, in a virtual machine: see tests/guest. Beside nothing else: limits of real time hold within
/// a guest, and beside tests of real-time priority it starves. `other`: programs for the other processor were built.
fn guest(root: &Path, other: bool, is_long: bool, tally: &mut Tally) -> Result<(), String> {
    let mut arguments =
        vec!["test", "--release", "--workspace", "--test", "system", "--", "--ignored", "guest::"];
    if !other {
        println!("== tests on aarch64: NOT RUN, there are no programs for it (see above)");
        arguments.extend(["--skip", "on_aarch64"]);
    }
    let has_kernel = std::fs::read_dir(root.join("target/guest/boot")).is_ok_and(|files| files.count() > 0);
    let prepared = has_kernel && succeeds("qemu-system-x86_64", &["--version"], ASKING);
    if !prepared {
        return left_out("tests in a guest", "no guest is prepared (on Debian: tests/guest/prepare)");
    }
    Step::cargo("tests in a guest", &arguments).with(LONG, &long(is_long)).run(tally)
}

/// What compiles, on processors that no test wants: those on the wall clock sleep for most of their time. Whether there is a server of
/// Foxglove's protocol.
fn beside_tests(tally: &mut Tally) -> Result<Result<(), String>, String> {
    // First what is built in a folder of its own: in the common one the tests would wait for it before they begin.
    let foxglove = foxglove(tally);
    let lints = ["clippy", "--release", "--workspace", "--all-targets", "--", "-D", "warnings"];
    Step::cargo("lints", &lints).idle().run(tally)?;
    models(tally)?;
    Step::cargo("examples in comments", &["test", "--release", "--workspace", "--doc"]).idle().run(tally)?;
    let documentation = Step::cargo("reference", &["doc", "--release", "--workspace", "--no-deps", "--lib"]);
    documentation.with("RUSTDOCFLAGS", "-D warnings").idle().run(tally)?;
    Ok(foxglove)
}

fn foxglove(tally: &mut Tally) -> Result<(), String> {
    let build = ["build", "--release", "--locked", "--manifest-path", FOXGLOVE];
    // A flight's messages are few: it need not be quick, and tests run meanwhile.
    Step::cargo("foxglove", &build).with("CARGO_PROFILE_RELEASE_OPT_LEVEL", "0").idle().run(tally)
}

/// Other people's clients read from the server, if it could be built.
fn foxglove_clients(built: Result<(), String>, tally: &mut Tally) -> Result<(), String> {
    match built {
        Ok(()) => {
            let test =
                ["test", "--release", "--workspace", "--test", "system", "--", "--ignored", "foxglove::"];
            Step::cargo("foxglove's clients", &test).run(tally)
        }
        Err(reason) => left_out("foxglove's clients", &reason),
    }
}

/// All programs are built for the other kind of processor that aircraft carry: system calls, atomics and constants have twins.
/// False: they can not be built here.
fn other_processor(tally: &mut Tally) -> Result<bool, String> {
    let target =
        if cfg!(target_arch = "aarch64") { "x86_64-unknown-linux-gnu" } else { "aarch64-unknown-linux-gnu" };
    let compiler = target.replace("-unknown", "") + "-gcc";
    let library = Command::new("rustc").args(["--print", "target-libdir", "--target", target]).output();
    let there = library.is_ok_and(|said| Path::new(String::from_utf8_lossy(&said.stdout).trim()).is_dir());
    if there && succeeds(&compiler, &["--version"], ASKING) {
        // In the common folder, before the tests want it: macros and build scripts have been built there.
        let build = ["build", "--release", "--workspace", "--bins", "--target", target];
        let linker = format!("CARGO_TARGET_{}_LINKER", target.to_uppercase().replace('-', "_"));
        // They are emulated; what they compute is the same at every level.
        let build = Step::cargo("other processor", &build).with("CARGO_PROFILE_RELEASE_OPT_LEVEL", "1");
        build.with(&linker, &compiler).run(tally)?;
        return Ok(true);
    }
    let lack = format!(
        "rustup target add {target}, and {compiler} (on Debian: gcc-{})",
        compiler.trim_end_matches("-gcc").replace('_', "-")
    );
    println!("== other processor: NOT CHECKED ({lack})");
    Ok(false)
}

/// The schedule that is delivered has not even a warning.
fn schedule(tally: &mut Tally) -> Result<(), String> {
    let program = fly::beside_self("bateleur").map_err(|error| error.to_string())?;
    Step::new("schedule", program, &["check", "--deny", "warnings"]).run(tally)
}

/// What README and the book tell people to type does what they say.
fn shown_commands(root: &Path) -> Result<(), String> {
    let begun = Instant::now();
    let programs = fly::beside_self("").map_err(|error| error.to_string())?;
    let cargo = commands::own_cargo(std::env::var_os("CARGO"))?;
    match commands::check(root, &programs, &cargo) {
        Ok((run, left)) => {
            let seconds = begun.elapsed().as_secs_f64();
            println!(
                "== commands of the pages: {run} blocks fine, {left} are marked as not to be run, {seconds:.1} s"
            );
            Ok(())
        }
        Err(faults) => {
            faults.iter().for_each(|fault| println!("{fault}"));
            Err(format!(
                "{} blocks of commands in the pages are wrong (see above); to repeat it: \
                 cargo run --release -p tasks -- commands",
                faults.len()
            ))
        }
    }
}

/// All of them, also after the first that fails: the count at the end shall be the whole truth. Those that are alone, then a partition that makes
/// random system calls, follow when the others are through.
fn tests(is_long: bool, tally: &mut Tally) -> Result<(), String> {
    let fuzz = ["test", "--release", "--workspace", "--test", "system", "--", "--ignored", "sandbox_fuzz::"];
    let fuzz = Step::cargo("random system calls", &[&fuzz[..], &["--nocapture"]].concat())
        .with("BATELEUR_FUZZ_SECONDS", if is_long { LONG_FUZZ_S } else { FUZZ_S });
    if !succeeds(cargo(), &["nextest", "--version"], ASKING) {
        let all = ["test", "--release", "--workspace", "--lib", "--bins", "--tests", "--no-fail-fast"];
        Step::cargo("tests", &all).with(LONG, &long(is_long)).run(tally)?;
        return fuzz.run(tally);
    }
    // One waits for a process of its own while the others compute.
    let processors = std::thread::available_parallelism().map_or(2, usize::from);
    let threads = (processors + processors / 2).to_string();
    let mut some = |name, filter: &str| {
        let run = ["nextest", "run", "--release", "--workspace", "--no-fail-fast", "-E", filter];
        Step::cargo(name, &run).with("NEXTEST_TEST_THREADS", &threads).with(LONG, &long(is_long)).run(tally)
    };
    let others = some("tests", &format!("not ({ALONE})"));
    let alone = some("tests that are alone", ALONE);
    others.and(alone)?;
    fuzz.run(tally)
}
