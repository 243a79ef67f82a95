//! A surface as it comes in: bytes, kind and unit; and the only place of this stage that reads a file.

use std::fs::File;
use std::io::Read;
use std::path::{Component, Path, PathBuf};

use patchmill_products::stage::StageError;
use rustix::fs::{Mode, OFlags};

use crate::error_code::UNREADABLE_FILE;
use crate::step::part21;
use crate::units::metres_per_unit;
use crate::{pcd, ply, three_mf};

/// Largest file that is read, bytes: a binary STL of ten million triangles.
pub const FILE_BYTES_MAX: u64 = 512 << 20;

/// What the bytes of a source are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SourceKind {
    /// A Bézier or algebraic surface, see [`crate::surface_file`].
    Json,
    /// Binary or ASCII STL.
    Stl,
    /// PLY: a mesh or a point cloud.
    Ply,
    /// Wavefront OBJ.
    Obj,
    /// 3MF.
    ThreeMf,
    /// Points as text.
    Xyz,
    /// Points of the Point Cloud Library.
    Pcd,
    /// STEP: the faces of a part.
    Step,
}

impl SourceKind {
    /// By the name's extension, else by how the content begins, else STL.
    fn of(bytes: &[u8], name: &str) -> Self {
        let extension = Path::new(name).extension().map(|e| e.to_ascii_lowercase());
        let text = bytes.trim_ascii_start();
        match extension.as_ref().and_then(|e| e.to_str()) {
            Some("stl") => Self::Stl,
            Some("json") => Self::Json,
            Some("ply") => Self::Ply,
            Some("obj") => Self::Obj,
            Some("3mf") => Self::ThreeMf,
            Some("pcd") => Self::Pcd,
            Some("step" | "stp" | "p21") => Self::Step,
            _ if text.starts_with(b"{") => Self::Json,
            Some("xyz" | "txt" | "asc") => Self::Xyz,
            _ if ply::MAGIC.iter().any(|magic| bytes.starts_with(magic)) => Self::Ply,
            _ if bytes.starts_with(three_mf::MAGIC) => Self::ThreeMf,
            _ if bytes.starts_with(pcd::MAGIC) => Self::Pcd,
            _ if text.starts_with(part21::MAGIC) => Self::Step,
            _ => Self::Stl,
        }
    }
}

/// A surface that has not been looked into yet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SurfaceSource {
    /// The file's content.
    pub bytes: Vec<u8>,
    /// What the content is.
    pub kind: SourceKind,
    /// Length unit of what names none, that is, of all but 3MF, STEP and most JSON files: mm (also when empty), m or in.
    pub units: String,
    /// What errors call the source: the file's name.
    pub name: String,
}

impl SurfaceSource {
    /// A source from bytes, its kind told by the name's extension and by how the bytes begin (`{` after white space: JSON).
    pub fn new(bytes: Vec<u8>, name: &str, units: &str) -> Self {
        let kind = SourceKind::of(&bytes, name);
        Self { bytes, kind, units: units.to_owned(), name: name.to_owned() }
    }
}

/// Reads `path` (relative to `directory`, or absolute and within it). Only regular files inside `directory` are opened,
/// wherever symbolic links and `..` lead.
///
/// # Errors
/// When the file is missing, elsewhere, not a regular file, empty, too big or unreadable; for an unknown unit.
pub fn read_source(directory: &Path, path: &str, units: &str) -> Result<SurfaceSource, StageError> {
    metres_per_unit(units)?;
    let refuse = |text: String| StageError::new(UNREADABLE_FILE, format!("surface file {path}: {text}"));
    let root = directory.canonicalize().map_err(|e| {
        refuse(format!("the surface directory {} cannot be opened: {e}", directory.display()))
    })?;
    let outside = || refuse(format!("it lies outside the surface directory {}", root.display()));
    // Told before anything is looked at: whether files are there outside is nobody's business.
    let given = std::path::absolute(directory).unwrap_or_else(|_| root.clone());
    let plain = without_dots(&root.join(path));
    if !plain.starts_with(&root) && !plain.starts_with(without_dots(&given)) {
        return Err(outside());
    }
    let real = root.join(path).canonicalize().map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => refuse(format!("no such file in {}", root.display())),
        _ => refuse(format!("it cannot be opened: {e}")),
    })?;
    if !real.starts_with(&root) {
        return Err(outside());
    }
    let cannot = |e: std::io::Error| refuse(format!("it cannot be read: {e}"));
    let irregular = || refuse("it is not a regular file".to_owned());
    // Before opening: opening a device may do something.
    if !real.symlink_metadata().map_err(cannot)?.is_file() {
        return Err(irregular());
    }
    // Whoever may write into the directory can put another one there meanwhile: a FIFO would be waited for, a link followed.
    let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let opened = rustix::fs::open(&real, flags, Mode::empty());
    let file = File::from(opened.map_err(|e| cannot(e.into()))?);
    let found = file.metadata().map_err(cannot)?;
    if !found.is_file() {
        return Err(irregular());
    }
    let size = found.len();
    if size == 0 {
        return Err(refuse(
            "it is empty; a surface in JSON or STEP, a mesh (STL, PLY, OBJ, 3MF) or points (PLY, XYZ, PCD) were expected"
                .to_owned(),
        ));
    }
    let too_big = || refuse(format!("it is larger than {} MiB", FILE_BYTES_MAX >> 20));
    if size > FILE_BYTES_MAX {
        return Err(too_big());
    }
    let mut bytes = Vec::with_capacity(size as usize + 1);
    // A file that grows while it is read stays within the limit too.
    file.take(FILE_BYTES_MAX + 1).read_to_end(&mut bytes).map_err(cannot)?;
    if bytes.len() as u64 > FILE_BYTES_MAX {
        return Err(too_big());
    }
    let name = real.file_name().map_or_else(|| path.to_owned(), |n| n.to_string_lossy().into_owned());
    Ok(SurfaceSource::new(bytes, &name, units))
}

/// The path with `.` and `..` taken out as written, whatever links there are.
fn without_dots(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => {
                plain.pop();
            }
            Component::CurDir => {}
            other => plain.push(other),
        }
    }
    plain
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_inside_the_directory_are_read() {
        let base = tempfile::tempdir().unwrap();
        let inside = base.path().join("surfaces");
        std::fs::create_dir_all(inside.join("sub")).unwrap();
        std::fs::write(base.path().join("secret.json"), b"{}").unwrap();
        std::fs::write(inside.join("a.json"), b"{}").unwrap();
        std::fs::write(inside.join("sub/b.stl"), b"solid").unwrap();
        std::fs::write(inside.join("empty.stl"), b"").unwrap();
        std::os::unix::fs::symlink(base.path().join("secret.json"), inside.join("link.json")).unwrap();
        std::os::unix::fs::symlink(inside.join("a.json"), inside.join("good_link.json")).unwrap();
        std::os::unix::fs::symlink(base.path(), inside.join("up")).unwrap();
        std::os::unix::fs::symlink("loop", inside.join("loop")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", inside.join("device")).unwrap();
        std::os::unix::fs::symlink(&inside, base.path().join("alias")).unwrap();
        // Takes no room on the disk.
        File::create(inside.join("huge.stl")).unwrap().set_len(1 << 40).unwrap();
        std::os::unix::net::UnixListener::bind(inside.join("socket")).unwrap();
        let fifo = inside.join("fifo");
        assert!(std::process::Command::new("mkfifo").arg(&fifo).status().unwrap().success());

        for good in ["a.json", "./a.json", "sub/../a.json", "sub/b.stl", "good_link.json"] {
            read_source(&inside, good, "mm").unwrap();
        }
        read_source(&inside, inside.join("a.json").to_str().unwrap(), "").unwrap();
        let alias = base.path().join("alias");
        read_source(&alias, alias.join("a.json").to_str().unwrap(), "").unwrap();
        let outside = base.path().join("secret.json");
        for (bad, part) in [
            ("../secret.json", "outside"),
            ("link.json", "outside"),
            (outside.to_str().unwrap(), "outside"),
            ("/dev/zero", "outside"),
            ("device", "outside"),
            ("up/secret.json", "outside"),
            ("sub/../../secret.json", "outside"),
            // Whether it is there is not told.
            ("../none.json", "outside"),
            ("/none/at/all", "outside"),
            ("/proc/self/environ", "outside"),
            ("loop", "cannot be opened"),
            ("socket", "regular file"),
            ("huge.stl", "larger than 512 MiB"),
            ("missing.json", "no such file"),
            ("fifo", "regular file"),
            ("sub", "regular file"),
            ("", "regular file"),
            ("empty.stl", "empty"),
            ("a\0b", "cannot be opened"),
        ] {
            let error = read_source(&inside, bad, "mm").unwrap_err();
            assert_eq!(error.code, UNREADABLE_FILE);
            assert!(error.text.contains(part), "{bad}: {error}");
        }
        // Files of /proc have no size, whatever can be read of them.
        assert!(read_source(Path::new("/proc/self"), "environ", "").unwrap_err().text.contains("empty"));
        assert!(read_source(&inside, "a.json", "furlong").is_err());
        assert!(read_source(&base.path().join("none"), "a.json", "mm").is_err());
    }

    #[test]
    fn the_kind_is_told_by_extension_then_content() {
        let kind = |bytes: &[u8], name: &str| SurfaceSource::new(bytes.to_vec(), name, "").kind;
        assert_eq!(kind(b"x", "a.JSON"), SourceKind::Json);
        assert_eq!(kind(b"{", "a.stl"), SourceKind::Stl);
        assert_eq!(kind(b"  {", "a"), SourceKind::Json);
        assert_eq!(kind(b"solid", "a"), SourceKind::Stl);
        assert_eq!(kind(b"ply\n", "a"), SourceKind::Ply);
        assert_eq!(kind(b"ply\n", "a.stl"), SourceKind::Stl);
        assert_eq!(kind(b"PK\x03\x04", "a.zip"), SourceKind::ThreeMf);
        assert_eq!(kind(b"# .PCD v0.7", ""), SourceKind::Pcd);
        assert_eq!(kind(b"# .PCD v0.7", "a.xyz"), SourceKind::Xyz);
        assert_eq!(kind(b"{", "a.txt"), SourceKind::Json);
        for (name, expected) in [
            ("a.PLY", SourceKind::Ply),
            ("a.obj", SourceKind::Obj),
            ("a.3mf", SourceKind::ThreeMf),
            ("a.asc", SourceKind::Xyz),
            ("a.txt", SourceKind::Xyz),
            ("a.pcd", SourceKind::Pcd),
            ("a.STP", SourceKind::Step),
            ("a.step", SourceKind::Step),
        ] {
            assert_eq!(kind(b"x", name), expected);
        }
    }
}
