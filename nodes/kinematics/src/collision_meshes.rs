//! Collision meshes within URDF text: a machine travels as one text, and a file that it names is not there on another host.
//!
//! The facets stand in elements `<patchmill_collision_mesh filename="…" facets="…"/>` of `<robot>`, the corners of one after
//! another as little-endian 32-bit numbers in base64, in the file's own unit. Other readers of URDF pass over them, and the
//! `<mesh>` elements that name the files stay as they are.

use std::collections::BTreeMap;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use nalgebra::Point3;
use urdf_rs::Geometry;

use crate::error::KinematicsError;
use crate::urdf_text::{attribute, children_of_robot, robot_of};

const ELEMENT: &str = "patchmill_collision_mesh";
/// Bytes of a facet: three corners of three numbers.
const FACET: usize = 36;
/// Characters that an attribute cannot hold, and what stands for them.
const ESCAPES: [(char, &str); 5] =
    [('&', "&amp;"), ('<', "&lt;"), ('>', "&gt;"), ('"', "&quot;"), ('\'', "&apos;")];

/// Corners of the facets of a mesh, in its file's unit.
pub type Facets = Vec<[Point3<f64>; 3]>;

/// The files that the collision shapes of a machine name and whose facets are not in its text, each once.
///
/// # Errors
/// [`KinematicsError::Model`] when the text cannot be read.
pub fn missing_collision_meshes(urdf: &str) -> Result<Vec<String>, KinematicsError> {
    let robot = robot_of(urdf)?;
    let there = collision_meshes(urdf)?;
    let mut missing: Vec<String> = Vec::new();
    for shape in robot.links.iter().flat_map(|l| &l.collision) {
        if let Geometry::Mesh { filename, .. } = &shape.geometry
            && !there.contains_key(filename)
            && !missing.contains(filename)
        {
            missing.push(filename.clone());
        }
    }
    Ok(missing)
}

/// The URDF text with the facets of a file that its collision shapes name; they are rounded to 32 bits.
///
/// # Errors
/// [`KinematicsError::Model`] for text that has no `<robot>` element to add to.
pub fn with_collision_mesh(
    urdf: &str,
    filename: &str,
    facets: &[[Point3<f64>; 3]],
) -> Result<String, KinematicsError> {
    let broken = || KinematicsError::Model("the machine's URDF has no closed <robot> element".to_owned());
    let (_, robot_end) = children_of_robot(urdf).ok_or_else(broken)?;
    let numbers = facets.iter().flatten().flat_map(|corner| corner.iter());
    let bytes: Vec<u8> = numbers.flat_map(|v| (*v as f32).to_le_bytes()).collect();
    let name: String = filename.chars().map(escaped).collect();
    let before = urdf[..robot_end].trim_end_matches([' ', '\t']);
    let line_end = if before.ends_with('\n') { "" } else { "\n" };
    Ok(format!(
        "{before}{line_end}  <{ELEMENT} filename=\"{name}\" facets=\"{}\"/>\n{}",
        STANDARD.encode(bytes),
        &urdf[robot_end..]
    ))
}

/// The facets that stand in URDF text, by file name.
///
/// # Errors
/// [`KinematicsError::Model`] when an element of them has no name or its facets are not what [`with_collision_mesh`] writes.
pub fn collision_meshes(urdf: &str) -> Result<BTreeMap<String, Facets>, KinematicsError> {
    let (children, _) = children_of_robot(urdf).unwrap_or_default();
    let read = |tag: &str| {
        let name = attribute(tag, "filename").ok_or("it has no attribute filename".to_owned())?;
        let text = attribute(tag, "facets").ok_or("it has no attribute facets".to_owned())?;
        let bytes = STANDARD.decode(text).map_err(|e| format!("its facets are no base64: {e}"))?;
        Ok((unescaped(name), facets_of(&bytes)?))
    };
    let ours = children.iter().filter(|c| c.tag == ELEMENT);
    ours.map(|c| read(&urdf[c.head.clone()]))
        .collect::<Result<_, String>>()
        .map_err(|why| KinematicsError::Model(format!("<{ELEMENT}> of the machine's URDF: {why}")))
}

fn facets_of(bytes: &[u8]) -> Result<Facets, String> {
    if bytes.is_empty() || !bytes.len().is_multiple_of(FACET) {
        return Err(format!("its facets have {} bytes; {FACET} a facet were expected", bytes.len()));
    }
    let number = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let corner = |b: &[u8]| Point3::new(number(b), number(&b[4..]), number(&b[8..]));
    let facets: Facets =
        bytes.chunks_exact(FACET).map(|b| [corner(b), corner(&b[12..]), corner(&b[24..])]).collect();
    let finite = facets.iter().flatten().all(|p| p.iter().all(|v| v.is_finite()));
    if finite { Ok(facets) } else { Err("a corner of its facets is no finite number".to_owned()) }
}

fn escaped(c: char) -> String {
    ESCAPES
        .iter()
        .find(|(plain, _)| *plain == c)
        .map_or_else(|| c.to_string(), |(_, name)| (*name).to_owned())
}

fn unescaped(text: &str) -> String {
    // The ampersand last: what it gives is not read again.
    ESCAPES.iter().rev().fold(text.to_owned(), |text, (plain, name)| text.replace(name, &plain.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn machine(filename: &str) -> String {
        let name: String = filename.chars().map(escaped).collect();
        let shape = format!("<collision><geometry><mesh filename=\"{name}\"/></geometry></collision>");
        format!("<robot name=\"m\">\n  <link name=\"a\">{shape}{shape}</link>\n</robot>\n")
    }

    fn facet(x: f64) -> [Point3<f64>; 3] {
        [Point3::new(x, 0.5, -1.0), Point3::new(0.25, x, 2.0), Point3::new(0.0, 0.0, x)]
    }

    #[test]
    fn a_mesh_is_missing_until_it_is_added_and_the_rest_stays() {
        let urdf = machine("package://m/meshes/frame.stl");
        assert_eq!(missing_collision_meshes(&urdf).unwrap(), ["package://m/meshes/frame.stl"]);
        let whole =
            with_collision_mesh(&urdf, "package://m/meshes/frame.stl", &[facet(0.5), facet(8.0)]).unwrap();
        assert!(missing_collision_meshes(&whole).unwrap().is_empty());
        assert!(whole.starts_with(urdf.trim_end_matches("</robot>\n")));
        let found = collision_meshes(&whole).unwrap();
        assert_eq!(found["package://m/meshes/frame.stl"], [facet(0.5), facet(8.0)]);
        assert_eq!(urdf_rs::read_from_string(&whole).unwrap().links.len(), 1);
    }

    #[test]
    fn bad_facets_are_refused_by_what_is_wrong() {
        let not_a_number: String = STANDARD.encode([0xff; FACET]);
        for (attributes, expected) in [
            ("facets=\"AAAA\"".to_owned(), "no attribute filename"),
            ("filename=\"a\"".to_owned(), "no attribute facets"),
            ("filename=\"a\" facets=\"?\"".to_owned(), "no base64"),
            ("filename=\"a\" facets=\"\"".to_owned(), "0 bytes"),
            ("filename=\"a\" facets=\"AAAA\"".to_owned(), "3 bytes"),
            (format!("filename=\"a\" facets=\"{not_a_number}\""), "no finite number"),
        ] {
            let urdf = format!("<robot name=\"m\"><{ELEMENT} {attributes}/></robot>");
            let error = collision_meshes(&urdf).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert!(with_collision_mesh("<robot", "a", &[facet(1.0)]).is_err());
    }

    proptest! {
        #[test]
        fn any_file_name_comes_back(name in "[a-z&;<>\"' ä/:.]{1,20}") {
            let whole = with_collision_mesh(&machine("x"), &name, &[facet(1.0)]).unwrap();
            prop_assert!(collision_meshes(&whole).unwrap().contains_key(&name));
        }
    }
}
