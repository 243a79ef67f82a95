//! Room in the folder that plans are written into.

use std::path::Path;

use rustix::fs::{Access, access, statvfs};

use super::Finding;

const CHECK: &str = "disk";
/// The largest of the plans in README's tables takes 16 MB; a bag of a million triangles a few hundred.
const LITTLE: u64 = 1 << 30;
const TOO_LITTLE: u64 = 64 << 20;

/// Free bytes where a folder is or will be.
pub fn disk(folder: &Path) -> Finding {
    let whole = std::path::absolute(folder).unwrap_or_else(|_| folder.to_path_buf());
    let Some(there) = whole.ancestors().find(|place| place.is_dir()) else {
        return Finding::bad(
            CHECK,
            format!("{}: no part of it is there", folder.display()),
            "name another --out",
        );
    };
    if let Err(e) = access(there, Access::WRITE_OK) {
        return Finding::bad(CHECK, format!("{}: {e}", there.display()), "name an --out that can be written");
    }
    match statvfs(there) {
        Ok(all) => judged(folder, all.f_bavail.saturating_mul(all.f_frsize)),
        Err(e) => Finding::bad(CHECK, format!("{}: {e}", there.display()), "name another --out"),
    }
}

fn judged(folder: &Path, free: u64) -> Finding {
    let found = format!("{:.1} GB free in {}", free as f64 / 1e9, folder.display());
    match free {
        free if free < TOO_LITTLE => {
            Finding::bad(CHECK, found, "make room or name another --out: plans take tens of MB")
        }
        free if free < LITTLE => {
            Finding::doubtful(CHECK, found, "make room: bags of large meshes take hundreds of MB")
        }
        _ => Finding::good(CHECK, found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terminal::Mood;

    #[test]
    fn room_is_found_where_the_folder_will_be() {
        let folder = tempfile::tempdir().unwrap();
        let finding = disk(&folder.path().join("not/yet"));
        assert!(finding.found.contains("GB free") && finding.found.contains("not/yet"), "{finding:?}");
        let state = |free| judged(Path::new("d"), free).state;
        assert_eq!([state(1 << 40), state(1 << 29), state(1 << 20)], [Mood::Good, Mood::Doubtful, Mood::Bad]);
    }
}
