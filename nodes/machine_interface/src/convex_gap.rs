//! Whether two convex bodies are apart: the algorithm of Gilbert, Johnson and Keerthi on their supports.
//!
//! The bodies are apart by at least d·s where s is the point of the Minkowski difference that is least along the unit direction
//! d. The iteration keeps up to four points of the difference and turns d towards the point of their hull that is nearest to the
//! origin; it ends as soon as a direction proves the gap. Finding none counts as not apart, which errs on the safe side.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

/// Directions tried before the gap counts as too small.
const MOST_DIRECTIONS: usize = 100;
/// Distances closer than this are the same, m.
const ROUNDING: f64 = 1e-13;

/// A convex set of points.
pub trait Convex {
    /// A point of it.
    fn inside(&self) -> Point3<f64>;
    /// Its point farthest along `direction`.
    fn farthest(&self, direction: &Vector3<f64>) -> Point3<f64>;
}

/// A solid about its own origin, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Solid {
    /// Half of its edges.
    Cuboid(Vector3<f64>),
    /// About z.
    Cylinder {
        /// Radius, m.
        radius: f64,
        /// Half of its length, m.
        half_length: f64,
    },
    /// Its radius.
    Sphere(f64),
}

/// A solid at a place.
#[derive(Clone, Copy, Debug)]
pub struct Placed {
    /// The solid.
    pub solid: Solid,
    /// world_from_solid.
    pub pose: Isometry3<f64>,
}

impl Convex for Placed {
    fn inside(&self) -> Point3<f64> {
        self.pose.translation.vector.into()
    }

    fn farthest(&self, direction: &Vector3<f64>) -> Point3<f64> {
        let d = self.pose.rotation.inverse() * direction;
        let own = match self.solid {
            Solid::Cuboid(half) => half.zip_map(&d, f64::copysign),
            Solid::Cylinder { radius, half_length } => {
                let across = d.xy().try_normalize(0.0).unwrap_or_default() * radius;
                Vector3::new(across.x, across.y, half_length.copysign(d.z))
            }
            Solid::Sphere(radius) => d.try_normalize(0.0).unwrap_or_default() * radius,
        };
        self.pose * Point3::from(own)
    }
}

/// The corners of a convex body.
impl<const N: usize> Convex for [Point3<f64>; N] {
    fn inside(&self) -> Point3<f64> {
        self[0]
    }

    fn farthest(&self, direction: &Vector3<f64>) -> Point3<f64> {
        let along = |p: &Point3<f64>| p.coords.dot(direction);
        self.iter().copied().reduce(|a, b| if along(&b) > along(&a) { b } else { a }).unwrap_or_default()
    }
}

/// Whether the bodies are proven to be at least `margin` (m, above 0) apart.
pub fn apart(a: &impl Convex, b: &impl Convex, margin: f64) -> bool {
    let mut hull = Hull::of(a.inside() - b.inside());
    for _ in 0..MOST_DIRECTIONS {
        let nearest = hull.keep_nearest();
        let distance = nearest.norm();
        // The difference holds this point, so the bodies are no farther apart.
        if distance < margin {
            return false;
        }
        let direction = nearest / distance;
        let least = a.farthest(&-direction) - b.farthest(&direction);
        let gap = direction.dot(&least);
        if gap >= margin {
            return true;
        }
        // The distance is known to rounding, and below the margin.
        if distance - gap <= ROUNDING || hull.is_full() || hull.points().contains(&least) {
            return false;
        }
        hull.push(least);
    }
    false
}

/// Up to four points of the Minkowski difference, m.
#[derive(Clone, Copy)]
struct Hull {
    corners: [Vector3<f64>; 4],
    count: usize,
}

impl Hull {
    fn of(point: Vector3<f64>) -> Self {
        Self { corners: [point; 4], count: 1 }
    }

    fn points(&self) -> &[Vector3<f64>] {
        &self.corners[..self.count]
    }

    fn is_full(&self) -> bool {
        self.count == self.corners.len()
    }

    fn push(&mut self, point: Vector3<f64>) {
        self.corners[self.count] = point;
        self.count += 1;
    }

    /// The points whose bits are set in `subset`, at least one.
    fn only(&self, subset: usize) -> Self {
        let mut kept = Self { count: 0, ..*self };
        for (i, point) in self.points().iter().enumerate() {
            if subset >> i & 1 == 1 {
                kept.push(*point);
            }
        }
        kept
    }

    /// The point of the hull that is nearest to the origin; keeps only the points that span its place.
    fn keep_nearest(&mut self) -> Vector3<f64> {
        let mut best = (f64::INFINITY, *self, Vector3::zeros());
        for subset in 1..1usize << self.count {
            let part = self.only(subset);
            if let Some(foot) = part.foot()
                && foot.norm_squared() < best.0
            {
                best = (foot.norm_squared(), part, foot);
            }
        }
        *self = best.1;
        best.2
    }

    /// Foot of the origin on the flat through all points, where it lies within their hull.
    fn foot(&self) -> Option<Vector3<f64>> {
        let (first, others) = self.points().split_first()?;
        let edge = |i: usize| others.get(i).map_or_else(Vector3::zeros, |point| point - first);
        // Edges that are not there get the share 0.
        let gram = Matrix3::from_fn(|i, j| {
            if i.max(j) < others.len() { edge(i).dot(&edge(j)) } else { f64::from(u8::from(i == j)) }
        });
        let shares = gram.cholesky()?.solve(&Vector3::from_fn(|i, _| -edge(i).dot(first)));
        let within = shares.min() >= 0.0 && shares.sum() <= 1.0;
        within.then(|| first + edge(0) * shares.x + edge(1) * shares.y + edge(2) * shares.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    fn placed(solid: Solid, at: [f64; 3], turn: [f64; 3]) -> Placed {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
        Placed { solid, pose: Isometry3::from_parts(Translation3::from(at), rotation) }
    }

    fn at(solid: Solid, at: [f64; 3]) -> Placed {
        placed(solid, at, [0.0; 3])
    }

    #[test]
    fn gaps_that_are_known() {
        let cuboid = Solid::Cuboid(Vector3::new(0.1, 0.2, 0.3));
        let cylinder = Solid::Cylinder { radius: 0.05, half_length: 0.4 };
        let ball = Solid::Sphere(0.02);
        let origin = at(cuboid, [0.0; 3]);
        // A face, an edge, a corner, the flat end and the rim of a cylinder.
        let corner = 0.02 / 3f64.sqrt();
        let cases = [
            (at(ball, [0.13, 0.1, -0.2]), 0.01),
            (at(ball, [0.13, 0.24, 0.0]), 0.05 - 0.02),
            (at(ball, [0.1 + 3.0 * corner, 0.2 + 3.0 * corner, 0.3 + 3.0 * corner]), 0.04),
            (at(cylinder, [0.0, 0.0, 0.705]), 0.005),
            (at(cylinder, [0.16, 0.0, 0.0]), 0.01),
            (placed(cylinder, [0.0, 0.0, 0.36], [std::f64::consts::FRAC_PI_2, 0.0, 0.0]), 0.01),
        ];
        for (i, (body, gap)) in cases.into_iter().enumerate() {
            assert!(apart(&origin, &body, gap * 0.999) && apart(&body, &origin, gap * 0.999), "case {i}");
            assert!(!apart(&origin, &body, gap * 1.001), "case {i}");
        }
        assert!(!apart(&origin, &at(ball, [0.0; 3]), 1e-3));
        let triangle = [[0.2, 0.0, 0.0], [0.3, -1.0, 0.5], [0.3, 1.0, 0.4]].map(Point3::from);
        assert!(apart(&origin, &triangle, 0.0999) && !apart(&origin, &triangle, 0.1001));
    }

    proptest! {
        /// A proof of being apart holds for points of the bodies; balls, whose gap is known, are always proven.
        #[test]
        fn apart_is_never_claimed_wrongly(
            place in [-0.4f64..0.4, -0.4..0.4, -0.4..0.4], turn in [-3.0f64..3.0, -3.0..3.0, -3.0..3.0],
            u in prop::collection::vec([-1.0f64..1.0, -1.0..1.0, -1.0..1.0], 40)
        ) {
            let cuboid = at(Solid::Cuboid(Vector3::new(0.1, 0.15, 0.05)), [0.0; 3]);
            let cylinder = placed(Solid::Cylinder { radius: 0.08, half_length: 0.12 }, place, turn);
            let margin = 2e-3;
            let claimed = apart(&cuboid, &cylinder, margin);
            let mut least = f64::INFINITY;
            for w in &u {
                let p = cuboid.farthest(&Vector3::from(*w));
                for d in &u {
                    least = least.min((cylinder.farthest(&Vector3::from(*d)) - p).norm());
                }
                let inner = cylinder.pose * Point3::from(Vector3::new(0.08 * w[0], 0.0, 0.12 * w[2]));
                let (low, high) = (Vector3::new(-0.1, -0.15, -0.05), Vector3::new(0.1, 0.15, 0.05));
                least = least.min((inner.coords - inner.coords.sup(&low).inf(&high)).norm());
            }
            prop_assert!(!claimed || least >= margin);
            let balls = [at(Solid::Sphere(0.1), [0.0; 3]), at(Solid::Sphere(0.05), place)];
            let gap = Vector3::from(place).norm() - 0.15;
            prop_assert_eq!(apart(&balls[0], &balls[1], margin), gap >= margin);
        }
    }
}
