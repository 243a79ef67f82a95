//! The wall clock is set while the stack runs (libfaketime in every process): plans under way and new ones are the same as ever, by
//! clients that were there before and by new ones.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use patchmill_node_runtime::free_domain;
use patchmill_tests::children::program_of;
use patchmill_tests::executables::patchmill;
use patchmill_tests::fixture;
use patchmill_tests::processes::Stack;

/// After so long without a sign of life DDS gives a participant up: who is still there then was heard.
const LEASE: Duration = Duration::from_secs(10);

/// What makes a process take its wall clock's error from a file; its monotonic clock stays.
fn environment(offset: &Path) -> Vec<(&'static str, String)> {
    let output = Command::new("faketime").args(["-m", "-f", "+0", "printenv", "LD_PRELOAD"]).output();
    let library =
        String::from_utf8(output.expect("faketime: launch_scripts/test.sh --install").stdout).unwrap();
    let offset = offset.to_string_lossy();
    [
        ("LD_PRELOAD", library.trim()),
        ("FAKETIME_TIMESTAMP_FILE", &*offset),
        ("FAKETIME_NO_CACHE", "1"),
        ("FAKETIME_DONT_FAKE_MONOTONIC", "1"),
    ]
    .map(|(name, value)| (name, value.to_owned()))
    .to_vec()
}

#[test]
fn a_clock_that_is_set_back_or_forth_changes_nothing() {
    let (lease, folder) = (free_domain().unwrap(), tempfile::tempdir().unwrap());
    let offset = folder.path().join("offset");
    fs::write(&offset, "+0").unwrap();
    let _stack = Stack::start_in(lease.domain(), &[], &environment(&offset));
    let (domain, surface) = (lease.domain().to_string(), fixture("small_bezier.json"));
    let plan = |name: &str| {
        let out = folder.path().join(name);
        let words = ["plan", &surface.to_string_lossy(), "--patches", "1", "--domain", &domain, "--out"];
        let output = patchmill(&[&words[..], &[&out.to_string_lossy()]].concat());
        assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
        program_of(&out)
    };
    let undisturbed = plan("undisturbed");
    for (jump, wait) in [("-3600", LEASE + Duration::from_secs(1)), ("+86400", Duration::ZERO)] {
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(800));
                fs::write(&offset, jump).unwrap();
            });
            assert!(plan(&format!("during {jump}")) == undisturbed, "during {jump}");
        });
        std::thread::sleep(wait);
        assert!(plan(&format!("after {jump}")) == undisturbed, "after {jump}");
    }
}
