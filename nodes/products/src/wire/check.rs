//! Checks that several products share.

use nalgebra::{Point3, Vector3};

use super::WireError;

/// Largest deviation of a unit vector's length from 1.
const UNIT: f64 = 1e-6;

/// An error that gives the value and says what was expected, unless the condition holds.
pub(super) fn expect(
    holds: bool,
    what: &str,
    value: impl std::fmt::Display,
    expected: &str,
) -> Result<(), WireError> {
    if holds { Ok(()) } else { Err(WireError::new(format!("{what} is {value}, {expected} was expected"))) }
}

/// A finite number within the closed range.
pub(super) fn within(what: &str, value: f64, low: f64, high: f64) -> Result<(), WireError> {
    let expected = format!("a number from {low} to {high}");
    expect(value.is_finite() && low <= value && value <= high, what, plain(value), &expected)
}

/// A length (m) within the closed range (m), reported in mm.
pub(super) fn millimetres(what: &str, value: f64, low: f64, high: f64) -> Result<(), WireError> {
    let [mm, low_mm, high_mm] = [value, low, high].map(|m| plain(m * 1e3));
    let expected = format!("{low_mm} mm to {high_mm} mm");
    expect(value.is_finite() && low <= value && value <= high, what, format!("{mm} mm"), &expected)
}

/// A number of a machinist's unit within the closed range.
pub(super) fn in_unit(what: &str, value: f64, unit: &str, low: f64, high: f64) -> Result<(), WireError> {
    // Conversions to and from SI must not refuse the ends of the range.
    let slack = 1e-9;
    let holds = value.is_finite() && low * (1.0 - slack) <= value && value <= high * (1.0 + slack);
    expect(holds, what, format!("{} {unit}", plain(value)), &format!("{low} to {high} {unit}"))
}

/// As people write it, without dozens of digits where it is absurd.
fn plain(value: f64) -> String {
    let size = value.abs();
    if value == 0.0 || (0.999e-4..1e9).contains(&size) {
        let text = format!("{value:.6}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        let short = format!("{value:.5e}").parse().unwrap_or(value);
        format!("{short:e}")
    }
}

/// A finite number that is at least 0.
pub(super) fn not_negative(what: &str, value: f64) -> Result<(), WireError> {
    expect(value.is_finite() && value >= 0.0, what, value, "a finite number of at least 0")
}

/// A finite number.
pub(super) fn finite(what: &str, value: f64) -> Result<(), WireError> {
    expect(value.is_finite(), what, value, "a finite number")
}

/// Finite numbers all.
pub(super) fn all_finite(what: &str, values: &[f64]) -> Result<(), WireError> {
    match values.iter().position(|v| !v.is_finite()) {
        None => Ok(()),
        Some(at) => finite(&format!("{what} {at}"), values[at]),
    }
}

/// Finite coordinates all.
pub(super) fn finite_points(what: &str, points: &[Point3<f64>]) -> Result<(), WireError> {
    match points.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
        None => Ok(()),
        Some(at) => Err(WireError::new(format!("{what} {at} has a coordinate that is no finite number"))),
    }
}

/// Unit vectors all.
pub(super) fn unit_vectors(what: &str, vectors: &[Vector3<f64>]) -> Result<(), WireError> {
    let is_unit = |v: &Vector3<f64>| (v.norm() - 1.0).abs() <= UNIT;
    match vectors.iter().position(|v| !is_unit(v)) {
        None => Ok(()),
        Some(at) => {
            let length = vectors[at].norm();
            Err(WireError::new(format!("{what} {at} has length {length}, a unit vector was expected")))
        }
    }
}

/// An array as long as the one it belongs to.
pub(super) fn same_length(what: &str, length: usize, expected: usize) -> Result<(), WireError> {
    expect(length == expected, &format!("the number of {what}"), length, &expected.to_string())
}

/// A count that the manifest announces against what came and against the limit, before anything is allocated.
pub(super) fn count(what: &str, announced: u32, came: usize, limit: u32) -> Result<(), WireError> {
    expect(
        announced <= limit,
        &format!("the announced number of {what}"),
        announced,
        &format!("at most {limit}"),
    )?;
    same_length(&format!("{what} in the chunks"), came, announced as usize)
}

/// A chunk's data start where those of the chunk before end.
pub(super) fn follows(what: &str, first: u32, expected: usize) -> Result<(), WireError> {
    expect(first as usize == expected, &format!("a chunk's first {what}"), first, &expected.to_string())
}
