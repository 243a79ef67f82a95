//! Mounts the tool in URDF text: the fixed link `tool_tip` under `spindle`. Only those elements of the text are
//! touched, so comments, layout and everything else stay as the machine's author wrote them.

use crate::error::KinematicsError;
use crate::urdf_text::{Child, attribute, child_link, children_of_robot};

/// The URDF text with a link `tool_tip`, a fixed child of `spindle` at −`tool_length` (m) along z; one that exists is
/// moved there. Its visual is a cylinder of `tool_radius` (m). Text without a `spindle` is returned as it is: such a
/// machine brings its own `tool_tip`.
///
/// # Errors
/// [`KinematicsError::Model`] for text that has no `<robot>` element to add to.
pub fn with_tool_tip(urdf: &str, tool_length: f64, tool_radius: f64) -> Result<String, KinematicsError> {
    let broken = || KinematicsError::Model("the machine's URDF has no closed <robot> element".to_owned());
    let (children, robot_end) = children_of_robot(urdf).ok_or_else(broken)?;
    let named = |name: &str| {
        children.iter().any(|c| c.tag == "link" && attribute(&urdf[c.head.clone()], "name") == Some(name))
    };
    if !named("spindle") {
        return Ok(urdf.to_owned());
    }
    let mounts_tip = |c: &&Child| c.tag == "joint" && child_link(&urdf[c.whole.clone()]) == Some("tool_tip");
    let old: Vec<&Child> = children.iter().filter(mounts_tip).collect();
    let joint_name = (0..)
        .map(|i| if i == 0 { "tool_mount".to_owned() } else { format!("tool_mount_{i}") })
        .find(|name| !children.iter().any(|c| is_other_joint(urdf, c, &old, name)))
        .unwrap_or_default();
    let mut added = String::new();
    if !named("tool_tip") {
        added.push_str(&format!(
            "  <link name=\"tool_tip\">\n    <visual>\n      <origin xyz=\"0 0 {}\" rpy=\"0 0 0\"/>\n      <geometry><cylinder radius=\"{}\" length=\"{}\"/></geometry>\n    </visual>\n  </link>\n",
            tool_length / 2.0,
            tool_radius,
            tool_length
        ));
    }
    added.push_str(&format!(
        "  <joint name=\"{joint_name}\" type=\"fixed\">\n    <origin xyz=\"0 0 {}\" rpy=\"0 0 0\"/>\n    <parent link=\"spindle\"/>\n    <child link=\"tool_tip\"/>\n  </joint>\n",
        -tool_length
    ));
    let mut out = String::with_capacity(urdf.len() + added.len());
    let mut at = 0;
    for child in old {
        out.push_str(urdf[at..child.whole.start].trim_end_matches([' ', '\t']));
        at = child.whole.end;
        at += urdf[at..].strip_prefix("\r\n").map_or(usize::from(urdf[at..].starts_with('\n')), |_| 2);
    }
    out.push_str(urdf[at..robot_end].trim_end_matches([' ', '\t']));
    if !out.ends_with('\n') {
        out.push('\n');
    }
    out.push_str(&added);
    out.push_str(&urdf[robot_end..]);
    Ok(out)
}

fn is_other_joint(urdf: &str, child: &Child, replaced: &[&Child], name: &str) -> bool {
    child.tag == "joint"
        && !replaced.iter().any(|r| r.whole == child.whole)
        && attribute(&urdf[child.head.clone()], "name") == Some(name)
}

#[cfg(test)]
mod tests {
    use super::with_tool_tip;

    const BARE: &str = "<?xml version='1.0'?>\n<!-- <robot> a > b -->\n<robot name=\"m\">\n  <link name=\"spindle\"/>\n  <!-- <joint><child link=\"tool_tip\"/></joint> -->\n</robot>\n";

    #[test]
    fn adds_the_tip_and_keeps_the_rest() {
        let out = with_tool_tip(BARE, 0.1, 0.02).unwrap();
        assert!(out.starts_with(BARE.trim_end_matches("</robot>\n")));
        let robot = urdf_rs::read_from_string(&out).unwrap();
        assert_eq!(robot.links.len(), 2);
        assert_eq!(robot.joints[0].child.link, "tool_tip");
        assert_eq!(robot.joints[0].origin.xyz[2], -0.1);
    }

    #[test]
    fn replaces_and_is_idempotent() {
        let once = with_tool_tip(BARE, 0.1, 0.02).unwrap();
        let twice = with_tool_tip(&once, 0.15, 0.02).unwrap();
        let robot = urdf_rs::read_from_string(&twice).unwrap();
        assert_eq!((robot.links.len(), robot.joints.len()), (2, 1));
        assert_eq!(robot.joints[0].origin.xyz[2], -0.15);
        assert_eq!(with_tool_tip(&twice, 0.1, 0.02).unwrap(), once);
    }

    #[test]
    fn a_machine_without_spindle_is_left_alone_and_broken_text_refused() {
        let own = "<robot name=\"m\"><link name=\"tool_tip\"/></robot>";
        assert_eq!(with_tool_tip(own, 0.1, 0.02).unwrap(), own);
        for text in ["", "<robot name=\"m\"><link name=\"spindle\"/>", "<robot", "no markup"] {
            assert!(with_tool_tip(text, 0.1, 0.02).is_err(), "{text}");
        }
    }
}
