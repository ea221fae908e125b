//! The Debian packages: one commit makes one package, and a Debian with nothing in it flies with it.
//!
//! They are made of the programs that the tests use, stripped; a release is made of smaller ones (profile `dist`), in the same way.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use bateleur_tests::{
    alone, among_others, bateleur, c_library, expect_success, flight_schedule, is_long, program, repository,
};

/// What a flight says of its digest, which no way of building and starting it may change.
fn digest(said: &str) -> &str {
    said.lines().find(|line| line.starts_with("digest ")).unwrap_or_else(|| panic!("no digest: {said}"))
}

/// Packs the programs that were built, into `folder`; gives the archives, sorted. `None`: this machine has no `dpkg-deb`.
fn pack(folder: &Path) -> Option<Vec<PathBuf>> {
    if Command::new("dpkg-deb").arg("--version").output().is_err() {
        eprintln!("skipped: no dpkg-deb here");
        return None;
    }
    c_library(); // it is built with the tests
    let programs = program("bateleur").parent().unwrap().to_owned();
    let mut tasks = Command::new(program("tasks"));
    tasks.arg("package").arg("--programs").arg(programs).arg("--output").arg(folder);
    // Quickly: nobody looks at its size.
    tasks.env("DPKG_DEB_COMPRESSOR_TYPE", "gzip").env("DPKG_DEB_COMPRESSOR_LEVEL", "1");
    expect_success(tasks.env("SOURCE_DATE_EPOCH", "1700000000"));
    let mut found: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    found.sort();
    assert_eq!(found.len(), 2, "{found:?}");
    Some(found)
}

/// What a project of one's own needs of the second package.
fn library_is_a_checkout(development: &Path, folder: &Path) {
    let root = folder.join("root");
    fs::create_dir_all(folder).unwrap();
    expect_success(Command::new("dpkg-deb").arg("-x").arg(development).arg(&root));
    let (library, project) = (root.join("usr/share/bateleur"), folder.join("tank"));
    let [library, made] = [&library, &project].map(|path| path.to_str().unwrap());
    bateleur(&["init", made, "--library", library]).end().expect_code(0);
    // Cargo reads every manifest on the way to the library, and finds all crates at the versions that were tested.
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".to_owned());
    // The first line of the project's `ci`.
    expect_success(Command::new(&cargo).current_dir(&project).args(["fmt", "--check"]));
    let mut metadata = Command::new(cargo);
    metadata.current_dir(&project).args(["metadata", "--offline", "--format-version", "1"]);
    // What other systems need was not fetched for a build for this one.
    metadata.args(["--filter-platform", &format!("{}-unknown-linux-gnu", std::env::consts::ARCH)]);
    let found = expect_success(&mut metadata);
    assert!(found.contains(&format!("{library}/partitions/apex/Cargo.toml")), "{found}");
}

#[test]
fn two_packings_are_equal_to_the_byte_and_lintian_finds_no_error() {
    let _turn = among_others();
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let Some(first) = pack(folders[0].path()) else { return };
    std::thread::sleep(std::time::Duration::from_millis(1100)); // files of another second
    let second = pack(folders[1].path()).unwrap();
    for (one, other) in first.iter().zip(&second) {
        assert_eq!(one.file_name(), other.file_name());
        assert!(fs::read(one).unwrap() == fs::read(other).unwrap(), "{} differs", one.display());
    }
    let development = first.iter().find(|path| path.to_string_lossy().contains("-dev_")).unwrap();
    library_is_a_checkout(development, &folders[0].path().join("library"));
    // Lintian takes most of its time for the 500 objects of the static library, of which it has nothing to say but that they are there.
    let judged: Vec<PathBuf> = first
        .iter()
        .map(|package| match package == development && !is_long() {
            true => repacked(package, &folders[1].path().join("short"), |tree| {
                let folders =
                    fs::read_dir(tree.join("usr/lib")).unwrap().map(|folder| folder.unwrap().path());
                let mut libraries = folders.map(|folder| folder.join("libbateleur_apex_c.a"));
                fs::remove_file(libraries.find(|library| library.exists()).unwrap()).unwrap();
                let sums = tree.join("DEBIAN/md5sums");
                let kept = fs::read_to_string(&sums).unwrap();
                let kept: String = kept.split_inclusive('\n').filter(|line| !line.contains(".a\n")).collect();
                fs::write(sums, kept).unwrap();
            }),
            false => package.clone(),
        })
        .collect();
    let Ok(lintian) = Command::new("lintian").args(["--fail-on", "error"]).args(&judged).output() else {
        eprintln!("skipped: no lintian here (tests/debian/prepare)");
        return;
    };
    let said = String::from_utf8_lossy(&lintian.stdout).into_owned();
    assert!(lintian.status.success(), "{said}{}", String::from_utf8_lossy(&lintian.stderr));
    println!("{said}");
}

/// A package of the tree of another one after a change, in a folder of its own.
fn repacked(package: &Path, folder: &Path, change: impl FnOnce(&Path)) -> PathBuf {
    let (tree, file) = (folder.join("tree"), folder.join(package.file_name().unwrap()));
    fs::create_dir_all(folder).unwrap();
    expect_success(Command::new("dpkg-deb").arg("-R").arg(package).arg(&tree));
    change(&tree);
    expect_success(
        Command::new("dpkg-deb")
            .args(["-Zgzip", "-z1", "--root-owner-group", "--build"])
            .arg(&tree)
            .arg(&file),
    );
    fs::remove_dir_all(tree).unwrap();
    file
}

/// As a newer version has it: two files of settings have another line.
fn make_newer(tree: &Path) {
    for name in ["schedule.toml", "schedules/can.toml"] {
        let path = tree.join("etc/bateleur").join(name);
        fs::write(&path, fs::read_to_string(&path).unwrap() + "# newer\n").unwrap();
    }
    let control = tree.join("DEBIAN/control");
    let text = fs::read_to_string(&control).unwrap();
    fs::write(&control, text.replace("\nVersion: ", "\nVersion: 1:")).unwrap();
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn a_debian_without_compiler_and_network_flies_upgrades_and_is_clean_after_a_purge() {
        let prepared = repository().join("target/debian/root");
        if !repository().join("target/debian/prepared").exists() || !rustix::process::geteuid().is_root() {
            eprintln!("skipped: no Debian root here, or not run as root (tests/debian/prepare, as root)");
            return;
        }
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let (packages, root) = (folder.path().join("packages"), folder.path().join("root"));
        let Some(archives) = pack(&packages) else { return };
        let programs = archives.iter().find(|path| path.to_string_lossy().contains("bateleur_")).unwrap();
        repacked(programs, &packages.join("newer"), make_newer);
        expect_success(Command::new("cp").args(["-a", "--reflink=auto"]).arg(prepared).arg(&root));
        expect_success(Command::new("cp").arg("-r").arg(&packages).arg(root.join("packages")));
        expect_success(Command::new("cp").arg(repository().join("tests/debian/fly")).arg(root.join("fly")));
        // Mounts go away with their namespace. The root is a mount itself, as that of a machine is.
        let script = "set -e; ip link set lo up; mount --make-rprivate /; mount --bind \"$0\" \"$0\"; cd \"$0\"; \
                  mount -t proc proc proc; mount -t sysfs -o ro sysfs sys; mount -t tmpfs -o mode=1777 shm dev/shm; \
                  mount -t devpts -o newinstance,ptmxmode=0666 pts dev/pts; mount --bind dev/pts/ptmx dev/ptmx; \
                  exec chroot . /fly";
        let namespaces = ["--net", "--mount", "--pid", "--ipc", "--fork", "--kill-child", "--"];
        let mut command = Command::new("unshare");
        let said = expect_success(command.args(namespaces).args(["sh", "-c", script]).arg(&root));
        println!("{said}");
        let schedule = flight_schedule();
        let here =
            bateleur(&["fly", "--fast", "--schedule", schedule.to_str().unwrap()]).end().expect_code(0);
        assert_eq!(digest(&said), digest(&here.stdout), "the flight is another one");
        let held = said.lines().filter(|line| line.starts_with("holds: ")).count();
        assert_eq!(held, 6, "{said}");
    }
}
