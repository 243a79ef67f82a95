//! A ROS domain of this machine that nobody uses.

use std::fs::{File, OpenOptions};
use std::net::{Ipv4Addr, UdpSocket};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

use rustix::fs::OFlags;

use crate::RuntimeError;

/// Domains that are tried. Above 101 the DDS ports reach into the ephemeral range.
const DOMAINS: std::ops::RangeInclusive<u16> = 1..=100;
/// Participants whose ports are looked at; new ones take the lowest free number.
const PARTICIPANTS: u16 = 12;

/// A domain held by this process as long as the value lives.
#[derive(Debug)]
pub struct DomainLease {
    domain: u16,
    _lock: File,
}

impl DomainLease {
    /// The domain's number.
    pub fn domain(&self) -> u16 {
        self.domain
    }
}

/// Takes a domain in which no participant of this machine has a port and which no other process has taken by this
/// function (a locked file in the temporary directory, freed by the system when the process ends).
///
/// # Errors
/// [`RuntimeError::NoFreeDomain`].
pub fn free_domain() -> Result<DomainLease, RuntimeError> {
    let folder = std::env::temp_dir();
    DOMAINS.into_iter().find_map(|domain| lease(domain, &folder)).ok_or(RuntimeError::NoFreeDomain)
}

fn lease(domain: u16, folder: &Path) -> Option<DomainLease> {
    // Anybody may put something else of that name into the folder: what is no plain file is neither followed nor waited for.
    let flags = (OFlags::NOFOLLOW | OFlags::NONBLOCK).bits() as i32;
    let mut options = OpenOptions::new();
    options.create(true).truncate(false).write(true).custom_flags(flags);
    let file = options.open(folder.join(lock_name(domain))).ok()?;
    if !file.metadata().ok()?.is_file() {
        return None;
    }
    file.try_lock().ok()?;
    nobody_listens(domain).then_some(DomainLease { domain, _lock: file })
}

fn lock_name(domain: u16) -> String {
    format!("patchmill_domain_{domain}.lock")
}

/// Whether the discovery ports (RTPS 9.6.2.3: 7400 + 250·domain + 10 + 2·participant) can be had.
fn nobody_listens(domain: u16) -> bool {
    (0..PARTICIPANTS).all(|participant| {
        let port = 7400 + 250 * domain + 10 + 2 * participant;
        UdpSocket::bind((Ipv4Addr::UNSPECIFIED, port)).is_ok()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_leases_differ_and_ports_in_use_are_avoided() {
        let first = free_domain().unwrap();
        let second = free_domain().unwrap();
        assert_ne!(first.domain(), second.domain());
        let taken = second.domain();
        drop(second);
        let _peer = UdpSocket::bind((Ipv4Addr::LOCALHOST, 7400 + 250 * taken + 10)).unwrap();
        assert_ne!(free_domain().unwrap().domain(), taken);
    }

    #[test]
    fn what_lies_in_the_place_of_a_lock_is_neither_followed_nor_waited_for() {
        let ours = free_domain().unwrap();
        let folder = tempfile::tempdir().unwrap();
        let lock = folder.path().join(lock_name(ours.domain()));
        let taken = || lease(ours.domain(), folder.path()).is_some();
        let victim = folder.path().join("victim");
        std::os::unix::fs::symlink(&victim, &lock).unwrap();
        assert!(!taken() && !victim.exists());
        std::fs::remove_file(&lock).unwrap();
        assert!(std::process::Command::new("mkfifo").arg(&lock).status().unwrap().success());
        assert!(!taken());
        // A reader makes the FIFO one that can be opened.
        let flags = OFlags::NONBLOCK.bits() as i32;
        let _reader = OpenOptions::new().read(true).custom_flags(flags).open(&lock).unwrap();
        assert!(!taken());
        std::fs::remove_file(&lock).unwrap();
        let held = lease(ours.domain(), folder.path());
        assert!(held.is_some() && !taken());
        drop(held);
        assert!(taken());
    }
}
