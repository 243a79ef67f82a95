//! The URDF's joints as transforms, for `/tf_static` and `/tf`.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use patchmill_kinematics::Machine;
use patchmill_products::stage::StageError;

use crate::evaluate::BAD_MACHINE;

/// Where a link is in its parent.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkTransform {
    /// Parent link.
    pub parent: String,
    /// Child link.
    pub child: String,
    /// parent_from_child, m.
    pub transform: Isometry3<f64>,
}

/// Transforms of a machine's links: of fixed joints, and of the others at `positions` (joint name to m or rad, absent: 0).
///
/// # Errors
/// [`BAD_MACHINE`] when the text is no URDF.
pub fn transforms(
    urdf: &str,
    positions: &BTreeMap<String, f64>,
) -> Result<(Vec<LinkTransform>, Vec<LinkTransform>), StageError> {
    let robot =
        patchmill_kinematics::robot_of(urdf).map_err(|e| StageError::new(BAD_MACHINE, e.to_string()))?;
    let (mut fixed, mut moving) = (Vec::new(), Vec::new());
    for joint in &robot.joints {
        let ([x, y, z], [roll, pitch, yaw]) = (joint.origin.xyz.0, joint.origin.rpy.0);
        let origin = Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        );
        let axis = Vector3::from(joint.axis.xyz.0).try_normalize(1e-12).unwrap_or(Vector3::x());
        let q = positions.get(&joint.name).copied().unwrap_or(0.0);
        let motion = match joint.joint_type {
            urdf_rs::JointType::Prismatic => {
                Isometry3::from_parts((axis * q).into(), UnitQuaternion::identity())
            }
            urdf_rs::JointType::Revolute | urdf_rs::JointType::Continuous => {
                Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_scaled_axis(axis * q))
            }
            _ => Isometry3::identity(),
        };
        let link = LinkTransform {
            parent: joint.parent.link.clone(),
            child: joint.child.link.clone(),
            transform: origin * motion,
        };
        if joint.joint_type == urdf_rs::JointType::Fixed { fixed.push(link) } else { moving.push(link) }
    }
    Ok((fixed, moving))
}

/// Joint name to position in the order of the machine's axes.
pub fn named_positions(machine: &Machine, joints: &[f64]) -> BTreeMap<String, f64> {
    machine.axes().iter().zip(joints).map(|(axis, q)| (axis.joint_name.clone(), *q)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DEFAULT_MACHINE_URDF;
    use patchmill_kinematics::{Accelerations, with_tool_tip};

    /// The product of the published transforms is the machine's forward kinematics.
    #[test]
    fn transforms_agree_with_the_kinematics() {
        let urdf = with_tool_tip(DEFAULT_MACHINE_URDF, 0.1, 0.02).unwrap();
        let machine = Machine::from_urdf(&urdf, 0.1, Accelerations { linear: 5.0, rotary: 20.0 }).unwrap();
        let q = [0.1, -0.05, -0.2, -0.7, 1.9];
        let (fixed, moving) = transforms(&urdf, &named_positions(&machine, &q)).unwrap();
        let all: Vec<&LinkTransform> = fixed.iter().chain(&moving).collect();
        let base_from = |link: &str| {
            let (mut link, mut total) = (link.to_owned(), Isometry3::identity());
            while let Some(step) = all.iter().find(|t| t.child == link) {
                total = step.transform * total;
                link.clone_from(&step.parent);
            }
            total
        };
        let tool = base_from("workpiece").inverse() * base_from("tool_tip");
        let expected = machine.workpiece_from_tool(&q);
        assert!((tool.translation.vector - expected.translation.vector).norm() < 1e-12);
        assert!(tool.rotation.angle_to(&expected.rotation) < 1e-12);
    }
}
