//! The machine's description from its file, with the collision meshes that it names.

use std::path::{Path, PathBuf};

use nalgebra::Point3;
use patchmill_kinematics::{missing_collision_meshes, with_collision_mesh};
use patchmill_machine_interface::MACHINES;
use patchmill_node_runtime::regular_file;
use patchmill_products::wire::job::MAX_URDF_BYTES;
use patchmill_surface_ingestion::stl;

/// Bytes of URDF text that a facet takes: 36 in base64.
const FACET: usize = 48;
/// Room that is left for what is written into the text later, the mount and the tool's tip, bytes.
const SPARE: usize = 4096;
/// Largest mesh file that is looked at, bytes.
const LARGEST_MESH: u64 = 32 << 20;

/// The URDF text of a machine: a shipped one by its name, else of a file; empty without either. The facets of its collision meshes
/// are put into the text, which travels in one message, as long as there is room. `warn` is told of every mesh that cannot be had:
/// its link is planned without.
///
/// # Errors
/// When the file cannot be read, is too big to travel or no URDF.
pub fn machine_text(file: Option<&Path>, mut warn: impl FnMut(String)) -> Result<String, String> {
    let Some(file) = file else { return Ok(String::new()) };
    if let Some((_, text)) = MACHINES.iter().find(|(name, _)| file.as_os_str() == *name) {
        return Ok((*text).to_owned());
    }
    let say = |what: String| format!("machine file {}: {what}", file.display());
    let expected = |e: String| {
        let names: Vec<&str> = MACHINES.iter().map(|(name, _)| *name).collect();
        format!("{e}; expected a URDF file or one of {}", names.join(", "))
    };
    let mut urdf = regular_file::read_text(file, MAX_URDF_BYTES as u64).map_err(|e| say(expected(e)))?;
    let folder = file.parent().unwrap_or(Path::new(""));
    for name in missing_collision_meshes(&urdf).map_err(|e| say(e.to_string()))? {
        let room = MAX_URDF_BYTES.saturating_sub(urdf.len() + name.len() + SPARE) / FACET;
        match facets(&name, folder, room) {
            Ok(facets) => {
                urdf = with_collision_mesh(&urdf, &name, &facets).map_err(|e| say(e.to_string()))?;
            }
            Err(why) => warn(say(format!("collisions with mesh {name} are not looked for: {why}"))),
        }
    }
    Ok(urdf)
}

fn facets(name: &str, folder: &Path, most: usize) -> Result<Vec<[Point3<f64>; 3]>, String> {
    let places = places(name, folder);
    let file = places.iter().find(|p| p.is_file()).ok_or_else(|| match places.as_slice() {
        [] => "only files and package:// can be read".to_owned(),
        tried => format!("there is no file {}", tried[tried.len() - 1].display()),
    })?;
    if !file.extension().is_some_and(|e| e.eq_ignore_ascii_case("stl")) {
        return Err("only STL can be read".to_owned());
    }
    let bytes = regular_file::read(file, LARGEST_MESH)?;
    stl::parse(&bytes, &file.to_string_lossy(), most).map_err(|e| e.text)
}

/// Where the file of a `<mesh>` may be, most likely first: as a path from the URDF's folder, as `file://` or in a ROS package.
fn places(name: &str, folder: &Path) -> Vec<PathBuf> {
    if let Some(path) = name.strip_prefix("file://") {
        return vec![PathBuf::from(path)];
    }
    let Some(path) = name.strip_prefix("package://") else {
        let plain = !name.contains("://");
        return plain.then(|| folder.join(name)).into_iter().collect();
    };
    let variable = |name: &str| std::env::var_os(name).unwrap_or_default();
    let (ament, ros) = (variable("AMENT_PREFIX_PATH"), variable("ROS_PACKAGE_PATH"));
    let package = path.split('/').next().unwrap_or_default();
    let folder = std::path::absolute(folder).unwrap_or_default();
    // A package that is not installed: the URDF lies in it.
    let around = folder.ancestors().filter(|f| f.file_name().is_some_and(|n| n == package));
    let around = around.filter_map(|f| Some(f.parent()?.join(path)));
    let installed = std::env::split_paths(&ament).map(|prefix| prefix.join("share").join(path));
    installed.chain(std::env::split_paths(&ros).map(|f| f.join(path))).chain(around).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_kinematics::collision_meshes;
    use patchmill_products::job::Job;

    const FACET_TEXT: &str = "solid s\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid s\n";

    fn written(folder: &Path, name: &str, text: &str) -> PathBuf {
        let file = folder.join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(&file, text).unwrap();
        file
    }

    fn urdf(meshes: &[&str]) -> String {
        let shape =
            |m: &&str| format!("<collision><geometry><mesh filename=\"{m}\"/></geometry></collision>");
        let shapes: String = meshes.iter().map(shape).collect();
        format!("<robot name=\"m\"><link name=\"a\">{shapes}</link></robot>")
    }

    #[test]
    fn meshes_are_found_beside_the_file_and_in_its_package() {
        let folder = tempfile::tempdir().unwrap();
        written(folder.path(), "cell/meshes/a.stl", FACET_TEXT);
        let names = ["../meshes/a.stl", "package://cell/meshes/a.stl"];
        let file = written(folder.path(), "cell/urdf/m.urdf", &urdf(&names));
        let text = machine_text(Some(&file), |w| panic!("{w}")).unwrap();
        let found = collision_meshes(&text).unwrap();
        assert!(names.iter().all(|name| found[*name].len() == 1));
    }

    #[test]
    fn meshes_are_taken_as_long_as_the_job_can_carry_them() {
        let folder = tempfile::tempdir().unwrap();
        for (name, facets) in [("small.stl", 500), ("large.stl", 3000), ("other.stl", 900)] {
            let facet =
                FACET_TEXT.lines().skip(1).take(7).map(|line| format!("{line}\n")).collect::<String>();
            written(folder.path(), name, &format!("solid s\n{}endsolid s\n", facet.repeat(facets)));
        }
        let names = ["small.stl", "large.stl", "other.stl"];
        let file = written(folder.path(), "m.urdf", &urdf(&names));
        let mut told = Vec::new();
        let text = machine_text(Some(&file), |w| told.push(w)).unwrap();
        assert_eq!(collision_meshes(&text).unwrap().keys().collect::<Vec<_>>(), ["other.stl", "small.stl"]);
        assert!(
            told.len() == 1 && told[0].contains("large.stl") && told[0].contains("more than the"),
            "{told:?}"
        );
        let job = Job { machine_urdf: text, ..Job::default_for(&"0".repeat(16)) };
        job.check().unwrap();
    }

    #[test]
    fn a_mesh_that_cannot_be_had_is_told_and_the_rest_is_taken() {
        let folder = tempfile::tempdir().unwrap();
        written(folder.path(), "a.stl", FACET_TEXT);
        written(folder.path(), "bad.stl", "solid");
        written(folder.path(), "b.dae", "");
        let names = ["no.stl", "b.dae", "bad.stl", "http://there/c.stl", "package://none/d.stl", "a.stl"];
        let file = written(folder.path(), "m.urdf", &urdf(&names));
        let mut told = Vec::new();
        let text = machine_text(Some(&file), |w| told.push(w)).unwrap();
        assert_eq!(collision_meshes(&text).unwrap().keys().collect::<Vec<_>>(), ["a.stl"]);
        let expected = ["no file", "only STL", "bad.stl", "only files and package", "d.stl"];
        assert_eq!(told.len(), expected.len(), "{told:?}");
        for (told, expected) in told.iter().zip(expected) {
            assert!(told.contains("m.urdf") && told.contains(expected), "{told}");
        }
    }
}
