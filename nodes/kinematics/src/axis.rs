//! One axis of the machine and its letter in a program.

/// Joint values of the five axes in the order of [`crate::Machine::axes`]: X, Y, Z (m), two rotary axes (rad).
pub type Joints = [f64; 5];

/// How an axis moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisKind {
    /// A prismatic joint, metres.
    Linear,
    /// A revolute or continuous joint, radians.
    Rotary,
}

/// One axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Name of the joint in the URDF.
    pub joint_name: String,
    /// Its word in a program: X Y Z for linear axes, A B C for rotary ones.
    pub letter: char,
    /// Linear or rotary.
    pub kind: AxisKind,
    /// Least and largest joint value, m or rad; `None` for a continuous joint.
    pub limits: Option<[f64; 2]>,
    /// Largest speed, m/s or rad/s, > 0.
    pub velocity: f64,
    /// Largest acceleration, m/s² or rad/s², > 0.
    pub acceleration: f64,
}

/// Accelerations of the axes, which URDF does not carry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Accelerations {
    /// Of every linear axis, m/s².
    pub linear: f64,
    /// Of every rotary axis, rad/s².
    pub rotary: f64,
}

/// The axis letter in a joint name: alone, or after (or before) `_`, `axis` or `joint`, in any case
/// (`x`, `joint_x`, `axis_x`, `x_axis`, `AxisX`, `x_joint`). `None` when there is none.
pub(crate) fn letter_of(joint_name: &str) -> Option<char> {
    let lower = joint_name.to_ascii_lowercase();
    let last = lower
        .split(|c: char| !c.is_ascii_alphanumeric())
        .rfind(|token| !matches!(*token, "" | "axis" | "joint"))?;
    let bare = ["axis", "joint"].iter().fold(last, |token, word| {
        token.strip_prefix(word).unwrap_or(token.strip_suffix(word).unwrap_or(token))
    });
    let mut letters = bare.chars();
    match (letters.next(), letters.next()) {
        (Some(c @ ('x'..='z' | 'a'..='c')), None) => Some(c.to_ascii_uppercase()),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::letter_of;

    #[test]
    fn letters_in_usual_joint_names() {
        for name in
            ["x", "X", "joint_x", "axis_x", "x_axis", "AxisX", "xaxis", "machine_x_joint", "joint_x_axis"]
        {
            assert_eq!(letter_of(name), Some('X'), "{name}");
        }
        for name in ["spindle", "xy", "slide_1", "", "_", "axis", "u"] {
            assert_eq!(letter_of(name), None, "{name}");
        }
    }
}
