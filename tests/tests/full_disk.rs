//! Folders that cannot be written, fill up or vanish while a plan is made: one clear error, and files that are whole or not there.
//! The disks are small ones of this test's own, mounted in a namespace of its own (`unshare`), so that no rights are needed.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use patchmill_tests::children::{Children, stderr_of, wait};
use patchmill_tests::executables::executable;
use patchmill_tests::fixture;

const PATIENCE: Duration = Duration::from_secs(120);

fn plan(out: &Path) -> Command {
    let mut command = Command::new(executable("patchmill"));
    command.arg("plan").arg(fixture("small_bezier.json")).args(["--patches", "1", "--out"]).arg(out);
    command
}

/// Runs a script with a disk (tmpfs with these options) mounted on `$disk`; `$patchmill` and `$surface` are set too.
fn on_disk(options: &str, script: &str) -> Output {
    let disk = tempfile::tempdir().unwrap();
    let whole = format!("set -e; mount -t tmpfs -o {options} none \"$disk\"; set +e; {script}");
    let output = Command::new("unshare")
        .args(["--map-root-user", "--mount", "sh", "-c", &whole])
        .env("disk", disk.path())
        .env("patchmill", executable("patchmill"))
        .env("surface", fixture("small_bezier.json"))
        .output()
        .expect("unshare of util-linux is there");
    assert!(
        !String::from_utf8_lossy(&output.stderr).contains("unshare:"),
        "namespaces cannot be made here: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    output
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The one error of a command's stderr.
fn error(stderr: &str) -> String {
    let errors: Vec<&str> = stderr.lines().filter(|line| line.contains("error:")).collect();
    assert_eq!(errors.len(), 1, "{stderr}");
    errors[0].to_owned()
}

#[test]
fn a_disk_that_is_full_before_the_plan_is_whole_leaves_nothing_and_is_named() {
    // Enough to begin the bag, not to end it.
    let script =
        r#""$patchmill" plan "$surface" --patches 1 --out "$disk/plan"; echo "code $?"; ls -A "$disk""#;
    let output = on_disk("size=300k", script);
    let (said, told) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(said, "code 1\n", "{told}");
    assert!(error(&told).contains("No space left on device"), "{told}");
}

#[test]
fn what_finds_no_room_beside_a_plan_leaves_the_plan_as_it_is() {
    let script = r#"
        "$patchmill" plan "$surface" --patches 1 --out "$disk/plan" >&2 || exit 9
        rm "$disk/plan/report.html"
        cd "$disk/plan"; sha256sum program.ngc summary.json > "$disk/sums"; ls -A > "$disk/names"
        cat /dev/zero > "$disk/rest" 2> /dev/null
        for words in "report $disk/plan" "dialect $disk/plan --to siemens" "plot $disk/plan --what passes --out $disk/plan/p.svg" \
            "plan $surface --patches 1 --out $disk/plan"; do
            "$patchmill" $words; echo "code $?"
            sha256sum --quiet --check "$disk/sums" && ls -A | diff "$disk/names" -
        done
        rm "$disk/rest"
        "$patchmill" plan "$surface" --patches 1 --out "$disk/plan" > /dev/null; echo "code $?"; ls report.html
        ls -A "$disk""#;
    let output = on_disk("size=8m", script);
    let (said, told) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(said, "code 1\ncode 1\ncode 1\ncode 1\ncode 0\nreport.html\nnames\nplan\nsums\n", "{told}");
    let full =
        told.lines().filter(|line| line.contains("error:") && line.contains("No space left on device"));
    assert_eq!(full.count(), 4, "{told}");
}

#[test]
fn a_folder_that_cannot_be_written_is_refused_before_planning() {
    let script = r#"
        mkdir "$disk/plan"; mount -o remount,ro "$disk"
        for out in "$disk/plan" "$disk/new"; do
            "$patchmill" plan "$surface" --patches 1 --out "$out" --verbose; echo "code $?"
        done
        ls -A "$disk" "$disk/plan""#;
    let output = on_disk("size=1m", script);
    let (said, told) = (text(&output.stdout), text(&output.stderr));
    assert!(said.starts_with("code 1\ncode 1\n") && !said.contains("patchmill-"), "{said}");
    assert_eq!(told.matches("Read-only file system").count(), 2, "{told}");
    // No stage has said anything.
    assert!(!told.contains("surface_ingestion"), "{told}");
}

#[test]
fn a_mount_point_and_a_link_to_one_get_their_plan() {
    // A bind mount, as a container's volume often is, has the device of its parent.
    let script = r#"
        cd "$disk"; mkdir volume behind bound; mount -t tmpfs none volume; mount --bind behind bound; ln -s volume link
        for out in volume bound link; do
            "$patchmill" plan "$surface" --patches 1 --out "$out" > /dev/null; echo "code $?"; echo $(ls -A "$out")
        done
        "$patchmill" linuxcnc-config --out "$disk/bound/lc" > /dev/null; echo "code $?"
        echo $(ls -A)"#;
    let output = on_disk("size=64m", script);
    let (said, told) = (text(&output.stdout), text(&output.stderr));
    let one = "code 0\nbag job.yaml machine.urdf program.ngc report.html summary.json\n";
    assert_eq!(said, format!("{}code 0\nbehind bound link volume\n", one.repeat(3)), "{told}");
}

#[test]
fn a_folder_that_vanishes_while_planning_is_an_error_and_stays_away() {
    let root = tempfile::tempdir().unwrap();
    let parent = root.path().join("parent");
    let mut command = plan(&parent.join("plan"));
    let mut processes = Children(vec![command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()]);
    let end = Instant::now() + PATIENCE;
    // The bag has been begun.
    let recording = || {
        fs::read_dir(&parent)
            .is_ok_and(|mut all| all.any(|e| e.unwrap().path().join("bag/metadata.yaml").exists()))
    };
    while !recording() {
        assert!(Instant::now() < end, "no bag is begun");
        std::thread::sleep(Duration::from_millis(5));
    }
    // What is made in it meanwhile keeps it from going.
    while parent.exists() {
        assert!(Instant::now() < end, "the folder does not go");
        let _ = fs::remove_dir_all(&parent);
    }
    let status = wait(&mut processes.0[0], PATIENCE);
    let told = stderr_of(&mut processes.0[0]);
    assert_eq!(status.code(), Some(1), "{told}");
    assert!(error(&told).contains("parent/"), "{told}");
    assert!(!parent.exists());
}

/// A log file on a disk that is full, or a `tee` that has gone.
#[test]
fn a_stderr_that_takes_nothing_ends_nobody() {
    let folder = tempfile::tempdir().unwrap();
    let full = || Stdio::from(fs::OpenOptions::new().write(true).open("/dev/full").unwrap());
    let out = folder.path().join("plan");
    let planned = plan(&out).arg("--verbose").stdout(Stdio::null()).stderr(full()).status().unwrap();
    assert!(planned.success(), "{planned}");
    assert!(out.join("summary.json").is_file());
    let mut none = Command::new(executable("patchmill"));
    let refused = none.arg("report").arg(folder.path().join("none")).stderr(full()).status().unwrap();
    assert_eq!(refused.code(), Some(1));
}
