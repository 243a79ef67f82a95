//! Property tests over random chains: any order of axes, any split between table and head, any origins.

use crate::{Accelerations, AxisKind, Joints, KinematicsError, Machine};
use nalgebra::{Unit, Vector3};
use proptest::prelude::*;

const ACCELERATIONS: Accelerations = Accelerations { linear: 5.0, rotary: 20.0 };

#[derive(Clone, Debug)]
struct RandomJoint {
    letter: char,
    on_table: bool,
    axis: [f64; 3],
    xyz: [f64; 3],
    rpy: [f64; 3],
}

fn urdf(joints: &[RandomJoint], limits: bool) -> String {
    let mut text = String::from(
        "<robot name=\"random\"><link name=\"base_link\"/><link name=\"workpiece\"/><link name=\"spindle\"/>",
    );
    let join = |v: &[f64; 3]| v.map(|x| x.to_string()).join(" ");
    for (on_table, end) in [(true, "workpiece"), (false, "spindle")] {
        let mut parent = "base_link".to_owned();
        for j in joints.iter().filter(|j| j.on_table == on_table) {
            let kind = match (j.letter, limits) {
                ('X'..='Z', _) => "prismatic",
                (_, true) => "revolute",
                (_, false) => "continuous",
            };
            let child = format!("after_{}", j.letter);
            text.push_str(&format!(
                "<link name=\"{child}\"/><joint name=\"axis_{}\" type=\"{kind}\"><origin xyz=\"{}\" rpy=\"{}\"/><parent link=\"{parent}\"/><child link=\"{child}\"/><axis xyz=\"{}\"/><limit lower=\"-7\" upper=\"7\" effort=\"1\" velocity=\"1\"/></joint>",
                j.letter.to_ascii_lowercase(),
                join(&j.xyz),
                join(&j.rpy),
                join(&j.axis)
            ));
            parent = child;
        }
        text.push_str(&format!(
            "<joint name=\"mount_{end}\" type=\"fixed\"><origin xyz=\"0.1 -0.2 0.05\" rpy=\"0.3 -0.2 0.1\"/><parent link=\"{parent}\"/><child link=\"{end}\"/></joint>"
        ));
    }
    text + "</robot>"
}

fn random_joints() -> impl Strategy<Value = Vec<RandomJoint>> {
    let triple = || prop::array::uniform3(-1.0..1.0f64);
    let angles = || prop::array::uniform3(-3.0..3.0f64);
    let one = move || (any::<bool>(), triple(), triple(), angles());
    (prop::collection::vec(one(), 5), Just(vec!['X', 'Y', 'Z', 'A', 'C']).prop_shuffle()).prop_map(
        |(parts, letters)| {
            let joint =
                |((on_table, axis, xyz, rpy), letter)| RandomJoint { letter, on_table, axis, xyz, rpy };
            parts.into_iter().zip(letters).map(joint).collect()
        },
    )
}

/// Chains whose axes stay well away from each other at rotary zero.
fn well_conditioned(joints: &[RandomJoint]) -> Option<Machine> {
    let machine = Machine::from_urdf(&urdf(joints, false), 0.1, ACCELERATIONS).ok()?;
    let [a, b] = machine.rotary_geometry();
    let apart = a.direction.cross(&b.direction).norm() > 0.1
        && b.direction.cross(&machine.tool_axis_at_zero()).norm() > 0.1;
    apart.then_some(machine)
}

fn joint_values() -> impl Strategy<Value = Joints> {
    prop::array::uniform5(-3.0..3.0f64)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn forward_of_inverse_is_the_pose(joints in random_joints(), q in joint_values(), near in joint_values()) {
        let Some(machine) = well_conditioned(&joints) else { return Ok(()) };
        let Ok(held) = machine.at_rotary([q[3], q[4]]) else { return Ok(()) };
        prop_assume!(machine.linear_directions([q[3], q[4]]).determinant().abs() > 0.05);
        let pose = machine.pose(&q);
        prop_assert!((held.tip(&q) - pose.tip).norm() < 1e-9);
        let orientations = machine.orientations(&pose.axis, [near[3], near[4]]).unwrap();
        prop_assert!(!orientations.is_empty() && orientations.len() <= 2);
        for o in &orientations {
            let axis = machine.pose(&[0.0, 0.0, 0.0, o.rotary[0], o.rotary[1]]).axis;
            prop_assert!((axis.into_inner() - pose.axis.into_inner()).norm() < 1e-9);
            prop_assert!((0..2).all(|i| (o.rotary[i] - near[3 + i]).abs() <= std::f64::consts::PI + 1e-9));
        }
        let back = machine.inverse(&pose.tip, &pose.axis, &q).unwrap();
        let again = machine.pose(&back.joints);
        prop_assert!((again.tip - pose.tip).norm() < 1e-9);
        prop_assert!((again.axis.into_inner() - pose.axis.into_inner()).norm() < 1e-9);
    }

    #[test]
    fn axes_close_to_singular_and_to_the_rim_are_met(
        joints in random_joints(), exponent in 1.0..14.0f64, azimuth in -3.0..3.0f64, near in joint_values(),
    ) {
        let Some(machine) = well_conditioned(&joints) else { return Ok(()) };
        let [inner, outer] = machine.rotary_geometry();
        let u1 = inner.direction.into_inner();
        let side = u1.cross(&outer.direction).normalize();
        let lean = side * azimuth.cos() + u1.cross(&side) * azimuth.sin();
        let wanted = Unit::new_normalize(u1 + lean * 10f64.powf(-exponent));
        match machine.orientations(&wanted, [near[3], near[4]]) {
            Ok(found) => for o in found {
                let axis = machine.pose(&[0.0, 0.0, 0.0, o.rotary[0], o.rotary[1]]).axis;
                prop_assert!((axis.into_inner() - wanted.into_inner()).norm() < 3e-9);
                prop_assert!(!o.singular || o.rotary[inner.axis - 3] == near[inner.axis]);
            },
            Err(e) => prop_assert!(matches!(e, KinematicsError::Orientation { .. }), "{e}"),
        }
    }

    #[test]
    fn solutions_keep_revolute_limits(joints in random_joints(), q in joint_values(), near in joint_values()) {
        prop_assume!(well_conditioned(&joints).is_some());
        let machine = Machine::from_urdf(&urdf(&joints, true), 0.1, ACCELERATIONS).unwrap();
        let pose = machine.pose(&q);
        for o in machine.orientations(&pose.axis, [near[3] * 4.0, near[4] * 4.0]).unwrap() {
            prop_assert!(o.singular || o.rotary.iter().all(|r| r.abs() <= 7.0));
        }
    }

    #[test]
    fn zero_offset_puts_the_tip_at_the_origin(joints in random_joints()) {
        let Some(machine) = well_conditioned(&joints) else { return Ok(()) };
        prop_assume!(machine.linear_directions([0.0, 0.0]).determinant().abs() > 0.01);
        prop_assert!(machine.pose(&machine.zero_offset().unwrap()).tip.coords.norm() < 1e-9);
    }
}

/// A 45° nutating head over a rotary table, as built.
fn nutating() -> Machine {
    let joint = |letter, on_table, axis| RandomJoint { letter, on_table, axis, xyz: [0.0; 3], rpy: [0.0; 3] };
    let joints = [
        joint('C', true, [0.0, 0.0, 1.0]),
        joint('X', false, [1.0, 0.0, 0.0]),
        joint('Y', false, [0.0, 1.0, 0.0]),
        joint('Z', false, [0.0, 0.0, 1.0]),
        joint('B', false, [0.0, 1.0, 1.0]),
    ];
    // The fixed mounts of `urdf` would tilt the tool; this machine is square.
    let text = urdf(&joints, false).replace("rpy=\"0.3 -0.2 0.1\"", "rpy=\"0 0 0\"");
    Machine::from_urdf(&text, 0.1, ACCELERATIONS).unwrap()
}

#[test]
fn nutating_head_reaches_the_horizontal_and_no_farther() {
    let machine = nutating();
    let towards = |tilt: f64, turn: f64| {
        Unit::new_normalize(Vector3::new(tilt.sin() * turn.cos(), tilt.sin() * turn.sin(), tilt.cos()))
    };
    for tilt in [0.0, 1e-7, 0.3, 1.0, 1.5, std::f64::consts::FRAC_PI_2] {
        let wanted = towards(tilt, 0.7);
        for o in machine.orientations(&wanted, [0.2, 0.1]).unwrap() {
            let axis = machine.pose(&[0.0, 0.0, 0.0, o.rotary[0], o.rotary[1]]).axis;
            assert!((axis.into_inner() - wanted.into_inner()).norm() < 1e-9, "{tilt}");
            assert_eq!(o.singular, tilt == 0.0);
        }
    }
    match machine.orientations(&towards(1.7, 0.7), [0.0, 0.0]) {
        Err(KinematicsError::Orientation { short_by }) => {
            assert!((short_by - (1.7 - std::f64::consts::FRAC_PI_2)).abs() < 1e-9);
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn singular_pose_keeps_the_inner_axis() {
    let machine = nutating();
    let found = machine.orientations(&Vector3::z_axis(), [1.234, 0.4]).unwrap();
    assert_eq!(found.len(), 1);
    assert!(found[0].singular);
    assert_eq!(found[0].rotary[0], 1.234);
    assert!(found[0].rotary[1].abs() < 1e-12);
}

#[test]
fn machine_descriptions_that_cannot_be_used_say_why() {
    let good = {
        let joint =
            |letter, on_table, axis| RandomJoint { letter, on_table, axis, xyz: [0.0; 3], rpy: [0.0; 3] };
        urdf(
            &[
                joint('C', true, [0.0, 0.0, 1.0]),
                joint('A', true, [1.0, 0.0, 0.0]),
                joint('X', false, [1.0, 0.0, 0.0]),
                joint('Y', false, [0.0, 1.0, 0.0]),
                joint('Z', false, [0.0, 0.0, 1.0]),
            ],
            false,
        )
    };
    let machine = Machine::from_urdf(&good, 0.1, ACCELERATIONS).unwrap();
    assert_eq!(machine.axes().iter().map(|a| a.letter).collect::<String>(), "XYZCA");
    assert!(machine.axes()[..3].iter().all(|a| a.kind == AxisKind::Linear && a.limits == Some([-7.0, 7.0])));
    let cases = [
        ("name=\"workpiece\"", "name=\"part\"", "no link named `workpiece`"),
        ("name=\"spindle\"", "name=\"nose\"", "no link named `spindle` or `tool_tip`"),
        ("name=\"axis_x\"", "name=\"slide\"", "no axis letter"),
        ("name=\"axis_x\" type=\"prismatic\"", "name=\"axis_x\" type=\"fixed\"", "2 linear"),
        ("name=\"axis_x\" type=\"prismatic\"", "name=\"axis_x\" type=\"floating\"", "Floating"),
        ("<axis xyz=\"0 1 0\"/>", "<axis xyz=\"0 0 0\"/>", "axis is zero"),
        ("<axis xyz=\"0 1 0\"/>", "<axis xyz=\"1 0 0\"/>", "do not span space"),
        ("<axis xyz=\"0 1 0\"/><limit", "<axis xyz=\"0 1 0\"/><nolimit", "no speed"),
        ("<axis xyz=\"0 1 0\"/>", "<axis xyz=\"0 1 0\"/><mimic joint=\"axis_x\"/>", "mimics"),
        ("<robot", "<notrobot", "cannot be read"),
    ];
    for (from, to, expected) in cases {
        assert!(good.contains(from), "{from}");
        let error = Machine::from_urdf(&good.replace(from, to), 0.1, ACCELERATIONS).unwrap_err().to_string();
        assert!(error.contains(expected), "{from} → {to}: {error}");
    }
}
