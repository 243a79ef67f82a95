//! A smooth surface through the points around a place: a quadric by moving least squares (Alexa et al., "Point set surfaces", 2001),
//! with Tukey's biweight against points that do not belong.

use nalgebra::{Matrix3, Point3, SMatrix, SVector, Vector3};
use patchmill_geometry::curvature::{Curvature, tangents};

use patchmill_geometry::point_grid::Grid;

/// Fewest points of a fit: its six unknowns and some to spare.
const POINTS_MIN: usize = 10;
/// Where points are few (corners have a quarter of the circle) or lie along a line the radius is widened by √2, this often at most.
const WIDENINGS: i32 = 4;
/// Fits one after the other, each in the tangent plane and with the weights that the one before gives.
const PASSES: usize = 3;
/// Residuals beyond this many standard deviations have no weight.
const BIWEIGHT: f64 = 4.685;
/// Standard deviation of a normal distribution in units of its median absolute deviation.
const SIGMA_OF_MEDIAN: f64 = 1.4826;
/// Least pivot of the normalised equations: below it the points do not define a quadric.
const PIVOT_MIN: f64 = 1e-9;

/// The smooth surface at a place.
#[derive(Clone, Copy, Debug)]
pub struct LocalFit {
    /// The place moved onto the surface along the surface's normal, m.
    pub position: Point3<f64>,
    /// Unit normal, on either side.
    pub normal: Vector3<f64>,
    /// Principal curvatures as seen from the side of `normal`.
    pub curvature: Curvature,
    /// Distance of the place from a fit that it had no part in, m, signed along `normal`.
    pub residual: f64,
    /// Share of the place's own error that the fit follows, 0 to 1.
    pub leverage: f64,
    /// Variance of `residual` in units of the points' own.
    pub variance: f64,
}

impl LocalFit {
    /// The same surface seen from the other side.
    pub fn turned(&self) -> Self {
        let normal = -self.normal;
        Self { normal, curvature: self.curvature.turned(&normal), residual: -self.residual, ..*self }
    }
}

/// Points around a place, relative to it, each with its weight by distance and its residual of the last pass.
#[derive(Default)]
pub struct Neighbours(Vec<(Vector3<f64>, f64, f64)>, Vec<f64>);

/// The fit at `place` over the points within `radius` (m), more where they are fewer than `wanted`; `own`: whether the place is one of
/// the points. None where the points do not define a surface.
pub fn fit(
    grid: &Grid,
    place: &Point3<f64>,
    own: bool,
    (radius, wanted): (f64, usize),
    neighbours: &mut Neighbours,
) -> Option<LocalFit> {
    (0..=WIDENINGS).find_map(|k| {
        let radius = radius * std::f64::consts::SQRT_2.powi(k);
        let wanted = if k == WIDENINGS { POINTS_MIN } else { wanted.max(POINTS_MIN) };
        neighbours.0.clear();
        grid.near(place, radius, |p, _| {
            let d = p - place;
            let share = 1.0 - d.norm_squared() / (radius * radius);
            neighbours.0.push((d, share * share, 0.0));
        });
        if neighbours.0.len() < wanted { None } else { neighbours.fit(place, own, radius) }
    })
}

type Quadric = SVector<f64, 6>;

/// Weighted sums over points (u, v) of height h.
#[derive(Default)]
struct Moments {
    /// Of uⁱvʲ: 1, u, v, u², uv, v², u³, u²v, uv², v³, u⁴, u³v, u²v², uv³, v⁴.
    powers: [f64; 15],
    /// Of h times 1, u, v, ½u², uv, ½v².
    height: Quadric,
}

impl Moments {
    #[inline]
    fn add(&mut self, w: f64, u: f64, v: f64, h: f64) {
        let (wu, wv) = (w * u, w * v);
        let (wuu, wuv, wvv) = (wu * u, wu * v, wv * v);
        let (wuuu, wuuv, wuvv, wvvv) = (wuu * u, wuu * v, wvv * u, wvv * v);
        let all = [
            w,
            wu,
            wv,
            wuu,
            wuv,
            wvv,
            wuuu,
            wuuv,
            wuvv,
            wvvv,
            wuuu * u,
            wuuu * v,
            wuuv * v,
            wvvv * u,
            wvvv * v,
        ];
        for (sum, x) in self.powers.iter_mut().zip(all) {
            *sum += x;
        }
        self.height += Quadric::from([w, wu, wv, 0.5 * wuu, wuv, 0.5 * wvv]) * h;
    }

    /// The normal equations' symmetric matrix.
    fn matrix(&self) -> SMatrix<f64, 6, 6> {
        let m = &self.powers;
        SMatrix::from([
            [m[0], m[1], m[2], 0.5 * m[3], m[4], 0.5 * m[5]],
            [m[1], m[3], m[4], 0.5 * m[6], m[7], 0.5 * m[8]],
            [m[2], m[4], m[5], 0.5 * m[7], m[8], 0.5 * m[9]],
            [0.5 * m[3], 0.5 * m[6], 0.5 * m[7], 0.25 * m[10], 0.5 * m[11], 0.25 * m[12]],
            [m[4], m[7], m[8], 0.5 * m[11], m[12], 0.5 * m[13]],
            [0.5 * m[5], 0.5 * m[8], 0.5 * m[9], 0.25 * m[12], 0.5 * m[13], 0.25 * m[14]],
        ])
    }
}

/// How far the height at the place follows the points.
struct Shares {
    /// Share of a point at the place with unit weight.
    own: f64,
    /// Sum of the squares of all points' shares.
    squares: f64,
}

impl Neighbours {
    fn fit(&mut self, place: &Point3<f64>, own: bool, radius: f64) -> Option<LocalFit> {
        let mut normal = self.plane_normal()?;
        let mut scale = f64::INFINITY;
        for pass in 0..PASSES {
            let (t1, t2) = tangents(&normal);
            let (quadric, shares) = self.quadric(radius, scale, [&t1, &t2, &normal])?;
            let [height, slope_1, slope_2] = [quadric[0], quadric[1] / radius, quadric[2] / radius];
            let steep = (normal - t1 * slope_1 - t2 * slope_2).normalize();
            if pass + 1 < PASSES {
                normal = steep;
                scale = self.scale(radius);
                continue;
            }
            let form = [quadric[3], quadric[4], quadric[5]].map(|c| c / (radius * radius));
            let own_share = if own { robust_weight(height, scale) * shares.own } else { 0.0 };
            let leverage = own_share.clamp(0.0, 0.99);
            return Some(LocalFit {
                position: place + normal * height,
                normal: steep,
                curvature: Curvature::of_form(form[0], form[1], form[2], &t1, &t2),
                residual: -height / (1.0 - leverage),
                leverage,
                variance: (1.0 - 2.0 * leverage + shares.squares) / (1.0 - leverage).powi(2),
            });
        }
        None
    }

    /// Normal of the weighted plane through the points.
    fn plane_normal(&self) -> Option<Vector3<f64>> {
        let (mut sum, mut weights) = (Vector3::zeros(), 0.0);
        for (d, w, _) in &self.0 {
            sum += d * *w;
            weights += w;
        }
        let centre = sum / weights;
        let spread: Matrix3<f64> =
            self.0.iter().map(|(d, w, _)| (d - centre) * (d - centre).transpose() * *w).sum();
        let eigen = spread.symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        let normal: Vector3<f64> = eigen.eigenvectors.column(least).into();
        normal.try_normalize(0.0).filter(|n| n.iter().all(|x| x.is_finite()))
    }

    /// Height over the plane of the frame's first two axes, c₀ + c₁u + c₂v + ½c₃u² + c₄uv + ½c₅v² (u, v in radii), and the
    /// variance of c₀ for points of unit variance and weight. Leaves every point's residual.
    fn quadric(
        &mut self,
        radius: f64,
        scale: f64,
        [t1, t2, n]: [&Vector3<f64>; 3],
    ) -> Option<(Quadric, Shares)> {
        let flat = |d: &Vector3<f64>| (d.dot(t1) / radius, d.dot(t2) / radius);
        let mut moments = Moments::default();
        for (d, weight, residual) in &self.0 {
            let (u, v) = flat(d);
            moments.add(weight * robust_weight(*residual, scale), u, v, d.dot(n));
        }
        let weights = moments.powers[0];
        let cholesky = (moments.matrix() / weights).cholesky()?;
        if !(0..6).all(|i| cholesky.l_dirty()[(i, i)] > PIVOT_MIN.sqrt()) {
            return None;
        }
        let quadric = cholesky.solve(&(moments.height / weights));
        let influence = cholesky.solve(&Quadric::ith(0, 1.0)) / weights;
        let mut squares = 0.0;
        for (d, weight, residual) in &mut self.0 {
            let (u, v) = flat(d);
            let row = Quadric::from([1.0, u, v, 0.5 * u * u, u * v, 0.5 * v * v]);
            squares += (*weight * robust_weight(*residual, scale) * row.dot(&influence)).powi(2);
            *residual = d.dot(n) - row.dot(&quadric);
        }
        Some((quadric, Shares { own: influence[0], squares }))
    }

    /// Standard deviation of the residuals, m, by their median.
    fn scale(&mut self, radius: f64) -> f64 {
        self.1.clear();
        self.1.extend(self.0.iter().map(|(_, _, r)| r.abs()));
        let half = self.1.len() / 2;
        let median = *self.1.select_nth_unstable_by(half, f64::total_cmp).1;
        // Exact points have rounding only: none of them is to be left out.
        (median * SIGMA_OF_MEDIAN).max(1e-6 * radius)
    }
}

fn robust_weight(residual: f64, scale: f64) -> f64 {
    let share = residual / (BIWEIGHT * scale);
    let rest = (1.0 - share * share).max(0.0);
    rest * rest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// z = 3 + 0.2x − 0.1y + x² + 0.5xy − 2y², about the origin.
    fn surface(x: f64, y: f64) -> Point3<f64> {
        Point3::new(x, y, 3.0 + 0.2 * x - 0.1 * y + x * x + 0.5 * x * y - 2.0 * y * y)
    }

    fn points() -> Vec<Point3<f64>> {
        (-10..=10)
            .flat_map(|i| (-10..=10).map(move |j| surface(f64::from(i) * 0.004, f64::from(j) * 0.004)))
            .collect()
    }

    #[test]
    fn a_quadric_is_met_to_third_order_with_its_normal_and_curvature() {
        let points = points();
        let at = surface(0.0, 0.0);
        let [wide, narrow] = [0.03, 0.015].map(|radius| {
            let grid = Grid::new(&points, radius);
            let fit = fit(&grid, &at, true, (radius, 10), &mut Neighbours::default()).unwrap();
            if fit.normal.z < 0.0 { fit.turned() } else { fit }
        });
        let normal = Vector3::new(-0.2, 0.1, 1.0).normalize();
        let error = |fit: &LocalFit| fit.normal.cross(&normal).norm();
        assert!(
            error(&wide) < 3e-4 && error(&narrow) < 0.3 * error(&wide),
            "{} {}",
            error(&wide),
            error(&narrow)
        );
        assert!((narrow.position - at).norm() < 1e-7 && narrow.residual.abs() < 1e-7);
        // Gaussian and mean curvature of a graph.
        let (p, q, r, s, t) = (0.2, -0.1, 2.0, 0.5, -4.0);
        let w: f64 = 1.0 + p * p + q * q;
        let gauss = (r * t - s * s) / (w * w);
        let mean = ((1.0 + q * q) * r - 2.0 * p * q * s + (1.0 + p * p) * t) / (2.0 * w * w.sqrt());
        let curvature = narrow.curvature;
        assert!((curvature.max * curvature.min / gauss - 1.0).abs() < 1e-2);
        assert!((0.5 * (curvature.max + curvature.min) / mean - 1.0).abs() < 1e-2);
    }

    #[test]
    fn a_spike_moves_neither_its_neighbours_nor_itself_up() {
        let mut points = points();
        let spike = points.len() / 2;
        points[spike].z += 0.01;
        let grid = Grid::new(&points, 0.03);
        let fit_at = |i: usize| fit(&grid, &points[i], true, (0.03, 10), &mut Neighbours::default()).unwrap();
        assert!(fit_at(spike + 1).residual.abs() < 1e-5);
        assert!((fit_at(spike).residual.abs() - 0.01).abs() < 1e-3);
        assert!((fit_at(spike).position - surface(0.0, 0.0)).norm() < 2.5e-3);
    }

    #[test]
    fn a_line_of_points_and_too_few_are_no_surface() {
        let line: Vec<_> = (0..100).map(|i| Point3::new(f64::from(i) * 0.01, 0.0, 0.0)).collect();
        for points in [&line[..], &line[..5]] {
            assert!(
                fit(&Grid::new(points, 0.1), &line[2], true, (0.1, 10), &mut Neighbours::default()).is_none()
            );
        }
    }
}
