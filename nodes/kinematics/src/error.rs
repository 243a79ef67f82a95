//! What can be wrong with a machine description or a pose.

use crate::axis::AxisKind;
use std::fmt;

/// A joint value outside its axis's travel.
#[derive(Clone, Debug, PartialEq)]
pub struct LimitViolation {
    /// Place of the axis in [`crate::Machine::axes`].
    pub axis: usize,
    /// Its letter.
    pub letter: char,
    /// Its kind.
    pub kind: AxisKind,
    /// The value asked for, m or rad.
    pub value: f64,
    /// Least and largest value allowed, m or rad.
    pub limits: [f64; 2],
}

impl LimitViolation {
    /// How far the value lies outside, m or rad, > 0.
    pub fn excess(&self) -> f64 {
        (self.limits[0] - self.value).max(self.value - self.limits[1])
    }
}

impl fmt::Display for LimitViolation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (scale, unit) = match self.kind {
            AxisKind::Linear => (1e3, "mm"),
            AxisKind::Rotary => (1f64.to_degrees(), "°"),
        };
        write!(
            f,
            "axis {} at {:.3} {unit} is {:.3} {unit} outside its travel {:.3}..{:.3} {unit}",
            self.letter,
            self.value * scale,
            self.excess() * scale,
            self.limits[0] * scale,
            self.limits[1] * scale
        )
    }
}

/// Why a machine cannot be built from its URDF, or a pose not be reached.
#[derive(Clone, Debug, PartialEq)]
pub enum KinematicsError {
    /// The URDF cannot be read or does not describe a five-axis machine; the text says what is missing.
    Model(String),
    /// No rotary position, however far it turned, points the tool that way; short by this angle, rad.
    Orientation {
        /// Angle between the wanted tool axis and the nearest one the mechanism can point to, rad.
        short_by: f64,
    },
    /// The pose needs an axis outside its travel; the solution that needs least.
    Limit(LimitViolation),
    /// The linear axes do not span space at this rotary position.
    Singular,
}

impl fmt::Display for KinematicsError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Model(text) => f.write_str(text),
            Self::Orientation { short_by } => write!(
                f,
                "no position of the rotary axes points the tool along the wanted axis (short by {:.3}°)",
                short_by.to_degrees()
            ),
            Self::Limit(violation) => violation.fmt(f),
            Self::Singular => f.write_str("the linear axes do not span space at this rotary position"),
        }
    }
}

impl std::error::Error for KinematicsError {}
