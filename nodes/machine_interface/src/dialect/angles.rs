//! A tilted plane as three angles: the rotation of the workpiece frame that makes the tool axis +Z, in the ways in which
//! controls take it. R_x, R_y, R_z turn about one axis by the right-hand rule; the columns of the product are the plane's
//! axes in the workpiece frame.
//!
//! ```text
//! axis by axis   R = R_x(a) R_y(b) R_z(c)   about X, then about the turned Y, then about the turned Z
//! spatial        R = R_z(c) R_y(b) R_x(a)   about X, then Y, then Z of the workpiece frame
//! Euler          R = R_z(i) R_x(j) R_z(k)   about Z, then about the turned X, then about the turned Z
//! ```
//!
//! Where two angles turn about the same line (axis by axis and spatial: b = ±90°; Euler: j = 0 or 180°) one of them is 0.

use nalgebra::{Matrix3, Rotation3, Vector3};
use std::f64::consts::PI;

/// Decimals of an angle in degrees: 1e-5° is 0.17 µrad, the resolution of rotary words in the proven program.
pub const DECIMALS: usize = 5;
/// Below this cosine (sine for Euler angles) of the middle angle the other two turn about the same line.
const GIMBAL: f64 = 1e-7;

/// How three angles make a rotation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Convention {
    /// R_x(a) R_y(b) R_z(c).
    AxisByAxis,
    /// R_z(c) R_y(b) R_x(a), the angles given as a, b, c.
    Spatial,
    /// R_z(i) R_x(j) R_z(k).
    Euler,
}

impl Convention {
    /// The three angles of a rotation, rad, each within ±π.
    pub fn angles(self, rotation: &Rotation3<f64>) -> [f64; 3] {
        let m = rotation.matrix();
        match self {
            Self::AxisByAxis => axis_by_axis(m),
            Self::Spatial => spatial(m),
            Self::Euler => euler(m),
        }
    }

    /// The rotation of three angles, rad.
    pub fn rotation(self, [first, second, third]: [f64; 3]) -> Rotation3<f64> {
        let about = |axis: Vector3<f64>, angle: f64| Rotation3::new(axis * angle);
        let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
        match self {
            Self::AxisByAxis => about(x, first) * about(y, second) * about(z, third),
            Self::Spatial => about(z, third) * about(y, second) * about(x, first),
            Self::Euler => about(z, first) * about(x, second) * about(z, third),
        }
    }

    /// The angles in degrees as a program has them, [`DECIMALS`] decimals, and the rotation that these make.
    pub fn written(self, rotation: &Rotation3<f64>) -> ([f64; 3], Rotation3<f64>) {
        let scale = 10f64.powi(DECIMALS as i32);
        let degrees = self.angles(rotation).map(|a| (a.to_degrees() * scale).round() / scale);
        (degrees, self.rotation(degrees.map(f64::to_radians)))
    }
}

fn axis_by_axis(m: &Matrix3<f64>) -> [f64; 3] {
    let cosine = m.m11.hypot(m.m12);
    let b = m.m13.atan2(cosine);
    if cosine < GIMBAL {
        return [m.m32.atan2(m.m22), b, 0.0];
    }
    [(-m.m23).atan2(m.m33), b, (-m.m12).atan2(m.m11)]
}

fn spatial(m: &Matrix3<f64>) -> [f64; 3] {
    let cosine = m.m11.hypot(m.m21);
    let b = (-m.m31).atan2(cosine);
    if cosine < GIMBAL {
        return [0.0, b, (-m.m12).atan2(m.m22)];
    }
    [m.m32.atan2(m.m33), b, m.m21.atan2(m.m11)]
}

/// Of the two solutions (i, j, k) and (i ± π, −j, k ± π) the one with the smaller third angle: 0 for a table whose plane
/// has its X along the machine's.
fn euler(m: &Matrix3<f64>) -> [f64; 3] {
    let sine = m.m13.hypot(m.m23);
    let j = sine.atan2(m.m33);
    if sine < GIMBAL {
        return [m.m21.atan2(m.m11), j, 0.0];
    }
    let (i, k) = (m.m13.atan2(-m.m23), m.m31.atan2(m.m32));
    let half_turned = |a: f64| if a > 0.0 { a - PI } else { a + PI };
    if k.abs() > 0.5 * PI { [half_turned(i), -j, half_turned(k)] } else { [i, j, k] }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Unit;
    use proptest::prelude::*;

    const ALL: [Convention; 3] = [Convention::AxisByAxis, Convention::Spatial, Convention::Euler];

    /// Largest angle between two rotations, rad.
    fn apart(a: &Rotation3<f64>, b: &Rotation3<f64>) -> f64 {
        (0..3).map(|i| (a.matrix().column(i) - b.matrix().column(i)).norm()).fold(0.0, f64::max)
    }

    fn check(rotation: &Rotation3<f64>) -> Result<(), TestCaseError> {
        for convention in ALL {
            let angles = convention.angles(rotation);
            prop_assert!(angles.iter().all(|a| a.abs() <= PI + 1e-12), "{convention:?} {angles:?}");
            prop_assert!(apart(&convention.rotation(angles), rotation) < 3e-7, "{convention:?} {angles:?}");
            let (_, written) = convention.written(rotation);
            let axis = (written.matrix().column(2) - rotation.matrix().column(2)).norm();
            prop_assert!(axis < 4e-7, "{convention:?} {axis:e}");
        }
        Ok(())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn angles_make_the_rotation_again(
            axis in prop::array::uniform3(-1.0..1.0f64), angle in -PI..PI
        ) {
            prop_assume!(Vector3::from(axis).norm() > 0.1);
            check(&Rotation3::from_axis_angle(&Unit::new_normalize(axis.into()), angle))?;
        }

        #[test]
        fn near_and_at_the_gimbal_positions_too(
            tilt in prop::sample::select(vec![0.0, 0.5 * PI, -0.5 * PI, PI]),
            off in prop_oneof![Just(0.0), (1.0..16.0f64).prop_map(|e| 10f64.powf(-e))],
            (first, third) in (-PI..PI, -PI..PI),
            convention in prop::sample::select(ALL.to_vec()),
        ) {
            check(&convention.rotation([first, tilt + off, third]))?;
        }
    }

    #[test]
    fn angles_mean_what_the_manuals_examples_say() {
        let normal = |convention: Convention, degrees: [f64; 3]| {
            convention.rotation(degrees.map(f64::to_radians)) * Vector3::z()
        };
        // CYCLE800 axis by axis, -90 about X: the tool looks at the face towards +Y.
        let face = normal(Convention::AxisByAxis, [-90.0, 0.0, 0.0]);
        assert!((face - Vector3::y()).norm() < 1e-15);
        // G68.2 I J: normal (sin I sin J, -cos I sin J, cos J).
        let (i, j) = (60f64.to_radians(), 30f64.to_radians());
        let expected = Vector3::new(i.sin() * j.sin(), -i.cos() * j.sin(), j.cos());
        assert!((normal(Convention::Euler, [60.0, 30.0, 0.0]) - expected).norm() < 1e-15);
        // SPA+45 SPB+0 SPC+90: about the fixed X by 45, then the fixed Z by 90; as C 90 first, then the turned A 45.
        let expected = Rotation3::new(Vector3::z() * 0.5 * PI)
            * Vector3::new(0.0, -(0.25 * PI).sin(), (0.25 * PI).cos());
        assert!((normal(Convention::Spatial, [45.0, 0.0, 90.0]) - expected).norm() < 1e-15);
    }

    #[test]
    fn a_vertical_tool_only_turns_about_z() {
        let turned = Rotation3::new(Vector3::z() * 0.7);
        for (convention, expected) in ALL.into_iter().zip([[0.0, 0.0, 0.7], [0.0, 0.0, 0.7], [0.7, 0.0, 0.0]])
        {
            let angles = convention.angles(&turned);
            assert!((0..3).all(|i| (angles[i] - expected[i]).abs() < 1e-15), "{convention:?} {angles:?}");
        }
    }

    #[test]
    fn a_table_that_tilts_and_turns_needs_two_euler_angles() {
        // Table C on trunnion A: workpiece from machine is R_z(-C) R_x(-A).
        for (a, c) in [(-0.3, 1.1), (0.3, 1.1), (-1.2, -3.0), (0.4, 2.9)] {
            let plane = Convention::Euler.rotation([-c, -a, 0.0]);
            let angles = Convention::Euler.angles(&plane);
            assert!((angles[0] + c).abs() < 1e-12 && (angles[1] + a).abs() < 1e-12, "{angles:?}");
            assert!(angles[2].abs() < 1e-12);
        }
    }
}
