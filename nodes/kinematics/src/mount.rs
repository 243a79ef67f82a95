//! Where the part stands: the fixed transform from the link that carries it to the link `workpiece`, read from and
//! written into URDF text. Only the joint of `workpiece` is touched.

use crate::error::KinematicsError;
use crate::urdf_text::{Child, attribute, child_link, children_of_robot, element, robot_of};
use urdf_rs::JointType;

/// The link that is added where a moving joint carries `workpiece` itself.
const CARRIER: &str = "workpiece_carrier";

/// Pose of the `workpiece` frame in the link that carries it (the table), as URDF's `<origin>` has it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Mount {
    /// Position, m.
    pub xyz: [f64; 3],
    /// Roll, pitch, yaw about the fixed axes of the carrying link, rad.
    pub rpy: [f64; 3],
}

/// The mount that the URDF describes; that of a `workpiece` carried by a moving joint is the identity.
///
/// # Errors
/// [`KinematicsError::Model`] when the text cannot be read or no joint carries `workpiece`.
pub fn mount_of(urdf: &str) -> Result<Mount, KinematicsError> {
    let robot = robot_of(urdf)?;
    let joint = robot.joints.iter().find(|j| j.child.link == "workpiece").ok_or_else(not_carried)?;
    Ok(match joint.joint_type {
        JointType::Fixed => Mount { xyz: *joint.origin.xyz, rpy: *joint.origin.rpy },
        _ => Mount::default(),
    })
}

/// The URDF text with the part mounted there.
///
/// # Errors
/// [`KinematicsError::Model`] for a mount that is not finite, text without a closed `<robot>`, or a machine on which no
/// joint carries `workpiece`.
pub fn with_mount(urdf: &str, mount: &Mount) -> Result<String, KinematicsError> {
    if !mount.xyz.iter().chain(&mount.rpy).all(|v| v.is_finite()) {
        return Err(KinematicsError::Model("the mount of the part must be finite numbers".to_owned()));
    }
    let broken = || KinematicsError::Model("the machine's URDF has no closed <robot> element".to_owned());
    let (children, robot_end) = children_of_robot(urdf).ok_or_else(broken)?;
    let joint = children
        .iter()
        .find(|c| c.tag == "joint" && child_link(&urdf[c.whole.clone()]) == Some("workpiece"))
        .ok_or_else(not_carried)?;
    let text = &urdf[joint.whole.clone()];
    let has_type = |kind: &str| attribute(&urdf[joint.head.clone()], "type") == Some(kind);
    if !has_type("fixed") {
        return Ok(carried(urdf, joint, &children, robot_end, mount));
    }
    let parent = element(text, "parent").and_then(|tag| attribute(&text[tag], "link")).ok_or_else(broken)?;
    let name = attribute(&urdf[joint.head.clone()], "name").unwrap_or("workpiece_mount");
    let fresh = fixed_joint(name, parent, "workpiece", mount);
    Ok(format!("{}{}{}", &urdf[..joint.whole.start], fresh, &urdf[joint.whole.end..]))
}

/// A moving joint carries `workpiece`: it carries a link of its own instead, and that link the part.
fn carried(urdf: &str, joint: &Child, children: &[Child], robot_end: usize, mount: &Mount) -> String {
    let taken = |tag: &str, name: &str| {
        children.iter().any(|c| c.tag == tag && attribute(&urdf[c.head.clone()], "name") == Some(name))
    };
    let free = |tag: &str, name: &str| {
        (0..)
            .map(|i| if i == 0 { name.to_owned() } else { format!("{name}_{i}") })
            .find(|name| !taken(tag, name))
            .unwrap_or_default()
    };
    let (link, name) = (free("link", CARRIER), free("joint", "workpiece_mount"));
    let text = &urdf[joint.whole.clone()];
    let renamed = match element(text, "child") {
        Some(tag) => format!("{}<child link=\"{link}\"/>{}", &text[..tag.start], after_child(text, tag.end)),
        None => text.to_owned(),
    };
    let fresh = fixed_joint(&name, &link, "workpiece", mount);
    format!(
        "{}{renamed}{}  <link name=\"{link}\"/>\n  {fresh}\n{}",
        &urdf[..joint.whole.start],
        &urdf[joint.whole.end..robot_end],
        &urdf[robot_end..]
    )
}

/// What follows the child element whose opening tag ends at `end`.
fn after_child(text: &str, end: usize) -> &str {
    let rest = &text[end..];
    if text[..end].ends_with("/>") {
        rest
    } else {
        rest.split_once("</child>").map_or(rest, |(_, rest)| rest)
    }
}

fn fixed_joint(name: &str, parent: &str, child: &str, mount: &Mount) -> String {
    let numbers = |v: &[f64; 3]| v.map(|x| x.to_string()).join(" ");
    format!(
        "<joint name=\"{name}\" type=\"fixed\">\n    <origin xyz=\"{}\" rpy=\"{}\"/>\n    <parent link=\"{parent}\"/>\n    <child link=\"{child}\"/>\n  </joint>",
        numbers(&mount.xyz),
        numbers(&mount.rpy)
    )
}

fn not_carried() -> KinematicsError {
    KinematicsError::Model(
        "the part cannot be mounted: no joint of the machine's URDF has the child link `workpiece`"
            .to_owned(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Accelerations, Machine};

    const MOUNT: Mount = Mount { xyz: [0.01, -0.2, 0.5], rpy: [0.1, 0.0, -1.5] };

    fn machine(joints: &str) -> String {
        let axis = |letter: char, kind: &str, parent: &str, child: &str, xyz: &str| {
            format!(
                "<joint name=\"{letter}\" type=\"{kind}\"><parent link=\"{parent}\"/><child link=\"{child}\"/><axis xyz=\"{xyz}\"/><limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"1\"/></joint>"
            )
        };
        let links: String = ["base", "p", "q", "r", "s", "spindle", "table", "workpiece"]
            .iter()
            .map(|l| format!("<link name=\"{l}\"/>"))
            .collect();
        format!(
            "<robot name=\"m\">{links}\n<!-- <child link=\"workpiece\"/> -->{}{}{}{}{joints}</robot>",
            axis('x', "prismatic", "base", "p", "1 0 0"),
            axis('y', "prismatic", "p", "q", "0 1 0"),
            axis('z', "prismatic", "q", "r", "0 0 1"),
            axis('a', "revolute", "r", "spindle", "1 0 0"),
        )
    }

    fn fixed() -> String {
        machine(
            "<joint name=\"c\" type=\"continuous\"><parent link=\"base\"/><child link=\"table\"/><axis xyz=\"0 0 1\"/><limit effort=\"1\" velocity=\"1\"/></joint><joint type=\"fixed\" name=\"hold\"><child link=\"workpiece\"/><origin xyz=\"9 9 9\"/><parent link=\"table\"/></joint>",
        )
    }

    fn moving() -> String {
        machine(
            "<joint name=\"c\" type=\"continuous\"><parent link=\"base\"/><child link=\"workpiece\"></child><axis xyz=\"0 0 1\"/><limit effort=\"1\" velocity=\"1\"/></joint>",
        )
    }

    #[test]
    fn a_mounted_part_is_where_it_was_put() {
        assert_eq!(mount_of(&fixed()).unwrap().xyz, [9.0, 9.0, 9.0]);
        assert_eq!(mount_of(&moving()).unwrap(), Mount::default());
        for urdf in [fixed(), moving()] {
            let mounted = with_mount(&urdf, &MOUNT).unwrap();
            assert_eq!(mount_of(&mounted).unwrap(), MOUNT, "{mounted}");
            assert_eq!(with_mount(&mounted, &MOUNT).unwrap(), mounted);
            let acceleration = Accelerations { linear: 1.0, rotary: 1.0 };
            let at_origin = with_mount(&urdf, &Mount::default()).unwrap();
            let [there, origin] =
                [&mounted, &at_origin].map(|text| Machine::from_urdf(text, 0.1, acceleration).unwrap());
            let q = [0.1, 0.2, 0.3, 0.4, 0.5];
            // The same place in the table's frame.
            let table_from_workpiece = nalgebra::Isometry3::from_parts(
                nalgebra::Translation3::new(0.01, -0.2, 0.5),
                nalgebra::UnitQuaternion::from_euler_angles(0.1, 0.0, -1.5),
            );
            let tool = table_from_workpiece * there.workpiece_from_tool(&q);
            assert!(
                (tool.translation.vector - origin.workpiece_from_tool(&q).translation.vector).norm() < 1e-12
            );
        }
    }

    #[test]
    fn what_cannot_be_mounted_is_refused() {
        let nothing = machine("");
        let infinite = Mount { xyz: [f64::INFINITY, 0.0, 0.0], ..Mount::default() };
        for (text, mount, expected) in [
            (nothing.as_str(), MOUNT, "no joint"),
            ("<robot name=\"m\">", MOUNT, "closed"),
            (fixed().as_str(), infinite, "finite"),
        ] {
            let error = with_mount(text, &mount).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
        assert!(mount_of(&nothing).is_err());
    }
}
