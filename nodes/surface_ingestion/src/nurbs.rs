//! The rational B-spline surface of a control net.

use nalgebra::{Point3, Vector3, Vector4};
use patchmill_products::stage::StageError;

use crate::error_code::{BAD_CONTENT, SINGULAR_SURFACE};
use crate::knots::{Basis, Knots};
use crate::parametric::{ParametricSurface, SurfacePoint, looks_up};

/// Normals on both sides of a knot that differ by more than this, rad (0.1°), are a crease.
const CREASE: f64 = 1.75e-3;
/// Places along a knot at which creases are looked for.
const CREASE_PLACES: usize = 64;

/// S(u, v) = Σᵢⱼ Nᵢ(u) Nⱼ(v) wᵢⱼ Pᵢⱼ / Σᵢⱼ Nᵢ(u) Nⱼ(v) wᵢⱼ.
#[derive(Clone, Debug)]
pub struct RationalNet {
    knots: [Knots; 2],
    /// Rows along u of (w·P, w), m.
    net: Vec<Vec<Vector4<f64>>>,
}

impl RationalNet {
    /// The surface of a net whose row i holds the points over all v at u's i-th function, with their positive weights.
    ///
    /// # Errors
    /// When rows differ in length or a weight is not positive; for knots that do not fit.
    pub fn new(
        degrees: [usize; 2],
        knots: [Vec<f64>; 2],
        net: &[Vec<(Point3<f64>, f64)>],
    ) -> Result<Self, String> {
        let columns = net.first().map_or(0, Vec::len);
        if let Some(i) = net.iter().position(|row| row.len() != columns) {
            return Err(format!("row {} has {} control points, the first {columns}", i + 1, net[i].len()));
        }
        // Beyond that ratio a weight would be lost in rounding.
        let most = net.iter().flatten().map(|(_, w)| *w).fold(0.0, f64::max);
        if let Some((_, w)) =
            net.iter().flatten().find(|(_, w)| !w.is_finite() || *w < 1e-9 * most || *w <= 0.0)
        {
            return Err(format!("a weight is {w}; positive ones within a ratio of 1e9 were expected"));
        }
        let [u, v] = knots;
        let along = |name: &str, degree: usize, knots: Vec<f64>, count: usize| {
            Knots::new(degree, knots, count).map_err(|text| format!("along {name} {text}"))
        };
        let knots = [along("u", degrees[0], u, net.len())?, along("v", degrees[1], v, columns)?];
        let homogeneous = |(p, w): &(Point3<f64>, f64)| (p.coords * *w).push(*w);
        Ok(Self { knots, net: net.iter().map(|row| row.iter().map(homogeneous).collect()).collect() })
    }

    /// Ranges of u and v.
    pub fn domain(&self) -> [[f64; 2]; 2] {
        [self.knots[0].domain(), self.knots[1].domain()]
    }

    /// The knots of u and v.
    pub fn knots(&self) -> &[Knots; 2] {
        &self.knots
    }

    /// Position and derivatives by the knots' own parameters.
    pub fn at(&self, u: f64, v: f64) -> SurfacePoint {
        self.of_bases(&self.knots[0].at(u), &self.knots[1].at(v))
    }

    fn of_bases(&self, u: &Basis, v: &Basis) -> SurfacePoint {
        let rows = &self.net[u.first..][..u.of_order(0).len()];
        let sum = |du: usize, dv: usize| {
            rows.iter().zip(u.of_order(du)).fold(Vector4::zeros(), |sum, (row, nu)| {
                let points = row[v.first..].iter().zip(v.of_order(dv));
                sum + points.fold(Vector4::zeros(), |sum: Vector4<f64>, (p, nv)| sum + p * *nv) * *nu
            })
        };
        // S = A/w, so A′ = w′S + wS′ and so on.
        let parts = |a: Vector4<f64>| (a.xyz(), a.w);
        let ((a, w), (au, wu), (av, wv)) = (parts(sum(0, 0)), parts(sum(1, 0)), parts(sum(0, 1)));
        let ((auu, wuu), (auv, wuv), (avv, wvv)) = (parts(sum(2, 0)), parts(sum(1, 1)), parts(sum(0, 2)));
        let s = a / w;
        let (su, sv) = ((au - s * wu) / w, (av - s * wv) / w);
        SurfacePoint {
            position: Point3::from(s),
            u: su,
            v: sv,
            uu: (auu - su * (2.0 * wu) - s * wuu) / w,
            uv: (auv - su * wv - sv * wu - s * wuv) / w,
            vv: (avv - sv * (2.0 * wv) - s * wvv) / w,
            branch: 0,
        }
    }

    /// The same surface with u and v exchanged, which turns its normal.
    fn swapped(self) -> Self {
        let [u, v] = self.knots;
        let columns = self.net.first().map_or(0, Vec::len);
        let net = (0..columns).map(|j| self.net.iter().map(|row| row[j]).collect()).collect();
        Self { knots: [v, u], net }
    }

    /// Box of the control points, low and high corner, m: the surface is within it.
    pub fn bounds(&self) -> [Vector3<f64>; 2] {
        let points = || self.net.iter().flatten().map(|p| p.xyz() / p.w);
        let start = Vector3::repeat(f64::INFINITY);
        [points().fold(start, |a, b| a.inf(&b)), points().fold(-start, |a, b| a.sup(&b))]
    }

    /// Whether a side of the net is one point, so that the surface has no parameters of its own there.
    pub fn collapses(&self) -> bool {
        let [low, high] = self.bounds();
        let near = 1e-9 * (high - low).norm();
        let point = |p: &Vector4<f64>| p.xyz() / p.w;
        let is_point = |side: Vec<&Vector4<f64>>| {
            side.windows(2).all(|pair| (point(pair[0]) - point(pair[1])).norm() <= near)
        };
        let rows = [self.net.first(), self.net.last()];
        rows.into_iter().flatten().any(|row| is_point(row.iter().collect()))
            || is_point(self.net.iter().filter_map(|row| row.first()).collect())
            || is_point(self.net.iter().filter_map(|row| row.last()).collect())
    }

    /// The largest angle, rad, between the normals on both sides of a knot, and the place.
    fn sharpest_crease(&self) -> (f64, [f64; 2]) {
        let mut worst = (0.0, [0.0; 2]);
        for axis in 0..2 {
            let (knots, [low, high]) = (&self.knots[axis], self.knots[1 - axis].domain());
            for (knot, _) in knots.inner().filter(|(_, times)| *times >= knots.degree()) {
                let sides = [knots.before(knot), knots.at(knot)];
                for k in 0..=CREASE_PLACES {
                    let t = low + (high - low) * k as f64 / CREASE_PLACES as f64;
                    let along = self.knots[1 - axis].at(t);
                    let [a, b] = sides.each_ref().map(|side| {
                        let (u, v) = if axis == 0 { (side, &along) } else { (&along, side) };
                        self.of_bases(u, v).area_vector()
                    });
                    let angle = a.cross(&b).norm().atan2(a.dot(&b));
                    if angle > worst.0 {
                        worst = (angle, if axis == 0 { [knot, t] } else { [t, knot] });
                    }
                }
            }
        }
        worst
    }
}

/// A rational B-spline surface as one to be machined: over the unit square, its mean normal to +Z, without creases.
#[derive(Clone, Debug)]
pub struct Nurbs {
    net: RationalNet,
    /// Whether u and v of the file were exchanged to turn the normal to +Z.
    swapped: bool,
    title: String,
    scale: f64,
}

impl Nurbs {
    /// The surface of a file's net.
    ///
    /// # Errors
    /// If neither side looks to +Z on the whole, or it has a crease.
    pub fn new(net: RationalNet, title: String) -> Result<Self, StageError> {
        let [low, high] = net.bounds();
        let scale = (high - low).norm();
        let (angle, [u, v]) = net.sharpest_crease();
        if angle > CREASE {
            return Err(StageError::new(
                SINGULAR_SURFACE,
                format!(
                    "{title} has a crease of {:.2}° at u = {u:.4}, v = {v:.4}; a smooth surface was expected: cut it there",
                    angle.to_degrees()
                ),
            ));
        }
        if !scale.is_finite() {
            return Err(StageError::new(BAD_CONTENT, format!("{title} is not finite")));
        }
        let mut surface = Self { net, swapped: false, title, scale };
        if !looks_up(&surface)? {
            surface.swapped = true;
            surface.net = surface.net.swapped();
        }
        Ok(surface)
    }

    fn parameters(&self, u: f64, v: f64) -> [f64; 2] {
        let [[u0, u1], [v0, v1]] = self.net.domain();
        [u0 + (u1 - u0) * u, v0 + (v1 - v0) * v]
    }
}

impl ParametricSurface for Nurbs {
    fn at(&self, u: f64, v: f64) -> SurfacePoint {
        let ([u, v], [[u0, u1], [v0, v1]]) = (self.parameters(u, v), self.net.domain());
        let (du, dv) = (u1 - u0, v1 - v0);
        let p = self.net.at(u, v);
        SurfacePoint {
            u: p.u * du,
            v: p.v * dv,
            uu: p.uu * (du * du),
            uv: p.uv * (du * dv),
            vv: p.vv * (dv * dv),
            ..p
        }
    }

    fn place(&self, u: f64, v: f64) -> String {
        let ([s, t], p) = (self.parameters(u, v), self.at(u, v).position * 1e3);
        let (s, t) = if self.swapped { (t, s) } else { (s, t) };
        format!("u = {s:.4}, v = {t:.4} (x = {:.4} mm, y = {:.4} mm, z = {:.4} mm)", p.x, p.y, p.z)
    }

    fn title(&self) -> &str {
        &self.title
    }

    fn scale(&self) -> f64 {
        self.scale
    }

    fn breaks(&self) -> [Vec<f64>; 2] {
        // Second derivatives are continuous over a knot that occurs at most degree − 2 times.
        self.net.knots.each_ref().map(|knots| {
            let [low, high] = knots.domain();
            let rough = knots.inner().filter(|(_, times)| times + 1 >= knots.degree());
            rough.map(|(knot, _)| (knot - low) / (high - low)).collect()
        })
    }
}

#[cfg(test)]
mod tests;
