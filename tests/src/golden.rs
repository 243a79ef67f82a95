//! The golden bag: one small run, recorded by `launch_scripts/refresh_golden.sh`.

use std::path::{Path, PathBuf};

pub use patchmill_bag_recorder::RecordedRun;

/// Folder of the golden bag.
pub fn golden_bag() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden/small_bezier")
}
