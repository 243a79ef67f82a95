//! The limit of open files. rustdds holds some descriptors for every reader and writer: a whole stack in one process has 1200, where
//! most systems allow 1024 unless a process asks for more.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// So many are asked for: a dozen stacks.
const WANTED: u64 = 16_384;

/// Raises this process's limit as far as it may itself, where it is lower.
pub(crate) fn allow_many() {
    let limit = getrlimit(Resource::Nofile);
    let allowed = limit.maximum.map_or(WANTED, |maximum| maximum.min(WANTED));
    if limit.current.is_some_and(|current| current < allowed) {
        // Where it is refused, the topic that finds no descriptor says so.
        let _ = setrlimit(Resource::Nofile, Rlimit { current: Some(allowed), ..limit });
    }
}
