//! The surfaces and curves of faces and edges, m and rad.

use std::f64::consts::TAU;

use nalgebra::{Point3, Vector3, Vector4};

use crate::knots::Knots;
use crate::nurbs::RationalNet;
use crate::parametric::SurfacePoint;

/// A placement.
#[derive(Clone, Debug)]
pub struct Frame {
    /// Origin.
    pub origin: Point3<f64>,
    /// Unit axes, right-handed.
    pub axes: [Vector3<f64>; 3],
}

impl Frame {
    fn local(&self, p: &Point3<f64>) -> Vector3<f64> {
        let d = p - self.origin;
        Vector3::from(self.axes.map(|axis| axis.dot(&d)))
    }

    fn directed(&self, d: &Vector3<f64>) -> Vector3<f64> {
        self.axes[0] * d.x + self.axes[1] * d.y + self.axes[2] * d.z
    }
}

/// The outline that turns about the axis of an elementary surface; v is its parameter, u the angle.
#[derive(Clone, Copy, Debug)]
pub enum Profile {
    /// A line at `radius`, leaning outward by the tangent `slope`: cylinder or cone; v is the height.
    Straight {
        /// At height 0.
        radius: f64,
        /// Radius per height.
        slope: f64,
    },
    /// A circle of `radius` about a point `centre` off the axis: sphere (0) or torus; v is its angle.
    Round {
        /// Distance of the circle's centre from the axis.
        centre: f64,
        /// Radius of the circle.
        radius: f64,
    },
}

impl Profile {
    /// Distance from the axis and height, with their first and second derivatives by v.
    fn at(&self, v: f64) -> [[f64; 3]; 2] {
        match *self {
            Self::Straight { radius, slope } => [[radius + slope * v, slope, 0.0], [v, 1.0, 0.0]],
            Self::Round { centre, radius } => {
                let (s, c) = (radius * v.sin(), radius * v.cos());
                [[centre + c, -s, -c], [s, c, -s]]
            }
        }
    }
}

/// The surface of a face.
#[derive(Clone, Debug)]
pub enum Shape {
    /// u and v are lengths along the frame's x and y.
    Plane(Frame),
    /// Turned about the frame's z.
    Revolved(Frame, Profile),
    /// B-spline.
    Spline(Box<RationalNet>),
}

/// The parameters of a point.
#[derive(Clone, Copy, Debug)]
pub struct Parameters {
    /// u and v.
    pub uv: [f64; 2],
    /// Every u gives this point: a pole or an apex.
    pub pole: bool,
}

impl Shape {
    /// Position and derivatives.
    pub fn at(&self, [u, v]: [f64; 2]) -> SurfacePoint {
        match self {
            Self::Plane(frame) => {
                let zero = Vector3::zeros();
                let position = frame.origin + frame.axes[0] * u + frame.axes[1] * v;
                SurfacePoint {
                    position,
                    u: frame.axes[0],
                    v: frame.axes[1],
                    uu: zero,
                    uv: zero,
                    vv: zero,
                    branch: 0,
                }
            }
            Self::Revolved(frame, profile) => {
                let ([r, z], (s, c)) = (profile.at(v), u.sin_cos());
                let out = |r: f64, z: f64| frame.directed(&Vector3::new(r * c, r * s, z));
                let along = |r: f64| frame.directed(&Vector3::new(-r * s, r * c, 0.0));
                SurfacePoint {
                    position: frame.origin + out(r[0], z[0]),
                    u: along(r[0]),
                    v: out(r[1], z[1]),
                    uu: out(-r[0], 0.0),
                    uv: along(r[1]),
                    vv: out(r[2], z[2]),
                    branch: 0,
                }
            }
            Self::Spline(net) => net.at(u, v),
        }
    }

    /// Periods of u and v; 0 where there is none.
    pub fn periods(&self) -> [f64; 2] {
        match self {
            Self::Revolved(_, Profile::Straight { .. }) => [TAU, 0.0],
            Self::Revolved(_, Profile::Round { centre, .. }) => [TAU, if *centre > 0.0 { TAU } else { 0.0 }],
            Self::Plane(_) | Self::Spline(_) => [0.0; 2],
        }
    }

    /// The parameters of the surface's point nearest `p`, of several those nearest `near`.
    pub fn parameters(&self, p: &Point3<f64>, near: Option<[f64; 2]>) -> Parameters {
        let mut pole = false;
        let mut uv = match self {
            Self::Plane(frame) => {
                let q = frame.local(p);
                [q.x, q.y]
            }
            Self::Revolved(frame, profile) => {
                let q = frame.local(p);
                let out = q.x.hypot(q.y);
                let v = match *profile {
                    Profile::Straight { slope, radius } => {
                        // The foot of the perpendicular on the outline.
                        ((out - radius) * slope + q.z) / (1.0 + slope * slope)
                    }
                    Profile::Round { centre, .. } => q.z.atan2(out - centre),
                };
                pole = out < 1e-9;
                // A cone's other half is reached by a negative radius; nobody trims there.
                [q.y.atan2(q.x), v]
            }
            Self::Spline(net) => spline_parameters(net, p, near),
        };
        if let Some(near) = near {
            let periods = self.periods();
            for k in 0..2 {
                if periods[k] > 0.0 {
                    uv[k] += ((near[k] - uv[k]) / periods[k]).round() * periods[k];
                }
            }
            if pole {
                uv[0] = near[0];
            }
        }
        Parameters { uv, pole }
    }
}

/// Intervals a side among which a first guess is sought.
const GUESSES: usize = 24;

fn spline_parameters(net: &RationalNet, p: &Point3<f64>, near: Option<[f64; 2]>) -> [f64; 2] {
    let domain = net.domain();
    let guess = || {
        let at =
            |k: usize, i: usize| domain[k][0] + (domain[k][1] - domain[k][0]) * i as f64 / GUESSES as f64;
        let places = (0..=GUESSES).flat_map(|i| (0..=GUESSES).map(move |j| [at(0, i), at(1, j)]));
        let distance = |uv: &[f64; 2]| (net.at(uv[0], uv[1]).position - p).norm_squared();
        places.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or([domain[0][0], domain[1][0]])
    };
    let found = newton(net, p, near.unwrap_or_else(guess));
    let off = |uv: [f64; 2]| (net.at(uv[0], uv[1]).position - p).norm();
    if near.is_some() && off(found) > 1e-6 {
        // The start led elsewhere.
        let again = newton(net, p, guess());
        return if off(again) < off(found) { again } else { found };
    }
    found
}

/// Gauss–Newton on the distance, held within the domain.
fn newton(net: &RationalNet, p: &Point3<f64>, mut uv: [f64; 2]) -> [f64; 2] {
    let domain = net.domain();
    for _ in 0..30 {
        let s = net.at(uv[0], uv[1]);
        let d = p - s.position;
        let (a, b, c) = (s.u.norm_squared(), s.u.dot(&s.v), s.v.norm_squared());
        let (f, g) = (s.u.dot(&d), s.v.dot(&d));
        let det = a * c - b * b;
        if det <= 1e-24 * a * c {
            break;
        }
        let step = [(f * c - g * b) / det, (g * a - f * b) / det];
        let before = uv;
        for k in 0..2 {
            uv[k] = (uv[k] + step[k]).clamp(domain[k][0], domain[k][1]);
        }
        let moved =
            (0..2).map(|k| (uv[k] - before[k]).abs() / (domain[k][1] - domain[k][0])).fold(0.0, f64::max);
        if moved < 1e-13 {
            break;
        }
    }
    uv
}

/// The curve of an edge.
#[derive(Clone, Debug)]
pub enum Curve {
    /// Straight.
    Line,
    /// Half axes along the frame's x and y; the parameter is the angle.
    Ellipse(Frame, [f64; 2]),
    /// B-spline: knots and (w·P, w).
    Spline(Knots, Vec<Vector4<f64>>),
}

impl Curve {
    /// The point at a parameter; of a line from `ends[0]` (0) to `ends[1]` (1).
    pub fn at(&self, t: f64, ends: &[Point3<f64>; 2]) -> Point3<f64> {
        match self {
            Self::Line => ends[0] + (ends[1] - ends[0]) * t,
            Self::Ellipse(frame, [a, b]) => {
                frame.origin + frame.axes[0] * (a * t.cos()) + frame.axes[1] * (b * t.sin())
            }
            Self::Spline(knots, net) => {
                let basis = knots.at(t);
                let sum = net[basis.first..]
                    .iter()
                    .zip(basis.of_order(0))
                    .fold(Vector4::zeros(), |s, (p, n)| s + p * *n);
                Point3::from(sum.xyz() / sum.w)
            }
        }
    }

    /// The parameters of the part from one end to the other along the curve's sense; of a closed curve all of it.
    pub fn range(&self, ends: &[Point3<f64>; 2]) -> [f64; 2] {
        match self {
            Self::Line => [0.0, 1.0],
            Self::Ellipse(frame, [a, b]) => {
                let [from, to] = ends.each_ref().map(|p| {
                    let q = frame.local(p);
                    (q.y / b).atan2(q.x / a)
                });
                let turn = (to - from).rem_euclid(TAU);
                [from, from + if turn < 1e-9 { TAU } else { turn }]
            }
            Self::Spline(knots, _) => {
                let domain = knots.domain();
                if (ends[1] - ends[0]).norm() < 1e-9 {
                    return domain;
                }
                [self.nearest(&ends[0], ends, domain), self.nearest(&ends[1], ends, domain)]
            }
        }
    }

    /// Where a B-spline comes nearest to `p`; its ends go first.
    fn nearest(&self, p: &Point3<f64>, ends: &[Point3<f64>; 2], [low, high]: [f64; 2]) -> f64 {
        let off = |t: f64| (self.at(t, ends) - p).norm();
        if let Some(end) = [low, high].into_iter().find(|t| off(*t) < 1e-9) {
            return end;
        }
        const PLACES: usize = 400;
        let at = |i: usize| low + (high - low) * i as f64 / PLACES as f64;
        let best = (0..=PLACES).min_by(|i, j| off(at(*i)).total_cmp(&off(at(*j)))).unwrap_or(0);
        let (mut from, mut to) = (at(best.saturating_sub(1)), at((best + 1).min(PLACES)));
        for _ in 0..80 {
            let (a, b) = (from + (to - from) / 3.0, to - (to - from) / 3.0);
            if off(a) < off(b) {
                to = b;
            } else {
                from = a;
            }
        }
        0.5 * (from + to)
    }

    /// Parts of a range between which the curve is smooth and turns little.
    pub fn pieces(&self, [from, to]: [f64; 2]) -> Vec<f64> {
        let even = |n: usize| (0..=n).map(|i| from + (to - from) * i as f64 / n as f64).collect();
        match self {
            Self::Line => vec![from, to],
            Self::Ellipse(..) => even(((to - from) / 0.3).ceil().max(1.0) as usize),
            Self::Spline(knots, _) => {
                let (inner, parts) = (knots.inner().map(|(t, _)| t), 2 * knots.degree());
                let mut ends = vec![from];
                ends.extend(inner.filter(|t| from < *t && *t < to));
                ends.push(to);
                let split = |pair: &[f64]| {
                    let (a, b) = (pair[0], pair[1]);
                    (0..parts).map(move |i| a + (b - a) * i as f64 / parts as f64).collect::<Vec<_>>()
                };
                let mut all: Vec<f64> = ends.windows(2).flat_map(split).collect();
                all.push(to);
                all
            }
        }
    }
}
