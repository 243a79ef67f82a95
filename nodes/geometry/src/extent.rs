//! How large a surface is.

use nalgebra::Point3;

/// Diagonal of a surface that no usual machine takes, m.
const LARGE: f64 = 20.0;

/// A box around points, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Least coordinates.
    pub low: Point3<f64>,
    /// Largest coordinates.
    pub high: Point3<f64>,
}

impl Extent {
    /// The box; `None` without points.
    pub fn of<'p>(points: impl IntoIterator<Item = &'p Point3<f64>>) -> Option<Self> {
        let mut points = points.into_iter();
        let first = *points.next()?;
        let grown = |e: Self, p: &Point3<f64>| Self { low: e.low.inf(p), high: e.high.sup(p) };
        Some(points.fold(Self { low: first, high: first }, grown))
    }

    /// Its diagonal, m.
    pub fn diagonal(&self) -> f64 {
        (self.high - self.low).norm()
    }

    /// The end of an error that may come of a wrong unit of length: asks for it where the box is smaller than `small` (m) or larger than
    /// what usual machines take; else empty.
    pub fn doubt_of_unit(&self, small: f64) -> String {
        if (small..LARGE).contains(&self.diagonal()) {
            return String::new();
        }
        let [x, y, z] = [0, 1, 2].map(|k| format!("{:.3}", (self.high[k] - self.low[k]) * 1e3));
        format!("; the surface measures {x} x {y} x {z} mm: is its unit right (--units)?")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_odd_sizes_are_asked_about() {
        let of = |mm: f64| Extent::of(&[Point3::origin(), Point3::new(mm / 1e3, 0.0, 0.0)]).unwrap();
        assert_eq!(of(100.0).doubt_of_unit(0.02), "");
        assert!(of(0.1).doubt_of_unit(0.02).contains("measures 0.100 x 0.000 x 0.000 mm"));
        assert!(of(100e3).doubt_of_unit(0.02).contains("measures 100000.000 x"));
        assert_eq!(Extent::of(&[]), None);
    }
}
