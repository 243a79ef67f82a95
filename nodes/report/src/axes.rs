//! The machine's axes and what the program asks of them.

use patchmill_kinematics::{Axis, AxisKind, Joints, Machine};
use patchmill_products::program::JointMotion;

/// An axis and how the program uses it, m or rad.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisUse {
    /// The axis with its limits.
    pub axis: Axis,
    /// Least and largest position.
    pub used: [f64; 2],
    /// Position at the program's start.
    pub start: f64,
    /// Largest speed.
    pub fastest: f64,
}

impl AxisUse {
    /// Whether it moves along a line rather than turns.
    pub fn is_linear(&self) -> bool {
        self.axis.kind == AxisKind::Linear
    }

    /// Distance of the program from the nearer end of the travel; `None` without ends.
    pub fn margin(&self) -> Option<f64> {
        self.axis.limits.map(|[low, high]| (self.used[0] - low).min(high - self.used[1]))
    }

    /// What a position is multiplied by for people: to mm or degrees.
    pub fn scale(&self) -> f64 {
        if self.is_linear() { 1e3 } else { 1f64.to_degrees() }
    }

    /// What a speed is multiplied by for people: to mm/min or °/s.
    pub fn speed_scale(&self) -> f64 {
        if self.is_linear() { 60e3 } else { 1f64.to_degrees() }
    }

    /// Unit of a position, with the space before it.
    pub fn unit(&self) -> &'static str {
        if self.is_linear() { " mm" } else { "°" }
    }

    /// Unit of a speed, with the space before it.
    pub fn speed_unit(&self) -> &'static str {
        if self.is_linear() { " mm/min" } else { "°/s" }
    }
}

/// A motion in the order of the machine's axes.
#[derive(Clone, Debug, Default)]
pub struct Moves {
    /// From the program's start, s; never decreasing.
    pub times: Vec<f64>,
    /// Positions, m and rad.
    pub positions: Vec<Joints>,
    /// Velocities, m/s and rad/s.
    pub velocities: Vec<Joints>,
}

impl Moves {
    /// The motion of a machine's joints.
    ///
    /// # Errors
    /// When it is not of this machine, moves nothing, or its arrays do not fit each other.
    pub fn of(motion: &JointMotion, machine: &Machine) -> Result<Self, String> {
        let n = motion.joint_names.len();
        let place = |axis: &Axis| {
            let found = motion.joint_names.iter().position(|name| *name == axis.joint_name);
            found.ok_or_else(|| format!("the joint motion has no joint {}", axis.joint_name))
        };
        let places: Vec<usize> = machine.axes().iter().map(place).collect::<Result<_, _>>()?;
        let places: [usize; 5] = places.try_into().map_err(|_| "the machine has not five axes".to_owned())?;
        let points = motion.times.len();
        if points == 0 || motion.positions.len() != points * n || motion.velocities.len() != points * n {
            return Err(format!(
                "the joint motion has {points} times of {n} joints, {} positions and {} velocities; expected {n} of each a time",
                motion.positions.len(),
                motion.velocities.len()
            ));
        }
        let rows = |values: &[f64]| values.chunks(n).map(|row| places.map(|p| row[p])).collect();
        Ok(Self {
            times: motion.times.clone(),
            positions: rows(&motion.positions),
            velocities: rows(&motion.velocities),
        })
    }

    /// Time of the last point, s.
    pub fn duration(&self) -> f64 {
        self.times.last().copied().unwrap_or(0.0)
    }

    /// What the motion asks of every axis.
    pub fn uses(&self, machine: &Machine) -> Vec<AxisUse> {
        let one = |(i, axis): (usize, &Axis)| {
            let used = self
                .positions
                .iter()
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], q| [low.min(q[i]), high.max(q[i])]);
            let fastest = self.velocities.iter().map(|v| v[i].abs()).fold(0.0, f64::max);
            AxisUse { axis: axis.clone(), used, start: self.positions[0][i], fastest }
        };
        machine.axes().iter().enumerate().map(one).collect()
    }
}
