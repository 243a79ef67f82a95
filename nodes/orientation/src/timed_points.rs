//! The sums over a patch's points that a search asks for thousands of times, four points side by side.
//!
//! A point costs area times passes per distance (one over
//! [`TangentShape::allowed_distance`](crate::step_over::TangentShape::allowed_distance) as measured on the surface), a place where passes end the
//! border's length across them times the same. What depends on the tool axis alone is reckoned once for
//! all feed directions that are asked for with it. Plain arrays without branches: the compiler puts two or more points into one instruction.

use nalgebra::Vector3;
use patchmill_geometry::cutter::Cutter;
use patchmill_products::job::Job;

use crate::cloud_point::CloudPoint;
use crate::step_over::{LEAST_CORNER, STEEP, STEP_SHARE, TangentShape, relative, scallop_budget};

/// Points side by side.
const LANES: usize = 4;
type Lane = [f64; LANES];

/// Points to be summed over; `ENDS`: places where passes end.
pub(crate) struct TimedPoints<const ENDS: bool> {
    blocks: Vec<Block>,
}

/// Some points, component by component.
#[derive(Clone, Copy, Default)]
struct Block {
    /// The tangents.
    u: [Lane; 3],
    v: [Lane; 3],
    /// Curvature of the surface along u, between them and along v, 1/m.
    curvature: [Lane; 3],
    /// 1/(8h), h the scallop height left to the spacing, 1/m.
    inverse_budget: Lane,
    /// The point's area in m², 0; of an end the border's length times its outward direction along u and v, m.
    weight: [Lane; 2],
}

impl TimedPoints<false> {
    /// Points that stand for their areas.
    pub(crate) fn of<'a>(points: impl Iterator<Item = &'a CloudPoint>, job: &Job) -> Self {
        Self::weighted(points.map(|p| (p, |_: &TangentShape| [p.area, 0.0])), job)
    }
}

impl TimedPoints<true> {
    /// Places at the border with its length there times its outward direction, m.
    pub(crate) fn of<'a>(ends: impl Iterator<Item = (&'a CloudPoint, Vector3<f64>)>, job: &Job) -> Self {
        Self::weighted(ends.map(|(p, outward)| (p, move |s: &TangentShape| s.components(&outward))), job)
    }
}

impl<const ENDS: bool> TimedPoints<ENDS> {
    fn weighted<'a, W: Fn(&TangentShape) -> [f64; 2]>(
        points: impl Iterator<Item = (&'a CloudPoint, W)>,
        job: &Job,
    ) -> Self {
        let mut blocks: Vec<Block> = Vec::new();
        for (i, (point, weight)) in points.enumerate() {
            let shape = TangentShape::new(&point.normal, &point.curvature);
            let budget = 8.0 * scallop_budget(point, job.scallop_height, job.pass_chord);
            let weight = weight(&shape);
            // A block begins with one point in all lanes, which counts in its own alone.
            let lanes = if i % LANES == 0 { 0..LANES } else { i % LANES..i % LANES + 1 };
            if i % LANES == 0 {
                blocks.push(Block::default());
            }
            let Some(block) = blocks.last_mut() else { continue };
            for lane in lanes {
                for k in 0..3 {
                    block.u[k][lane] = shape.u[k];
                    block.v[k][lane] = shape.v[k];
                    block.curvature[k][lane] = shape.curvature[k];
                }
                block.inverse_budget[lane] = 1.0 / budget;
            }
            for (own, weight) in block.weight.iter_mut().zip(weight) {
                own[i % LANES] = weight;
            }
        }
        Self { blocks }
    }

    /// Length of the passes (m) or number of their ends, for a tool `axis` and each of the directions that passes lie `across`.
    pub(crate) fn sums<const N: usize>(
        &self,
        cutter: Cutter,
        axis: &Vector3<f64>,
        across: &[Vector3<f64>; N],
    ) -> [f64; N] {
        let mut sums = [[0.0; LANES]; N];
        for block in &self.blocks {
            block.add(cutter, axis, across, ENDS, &mut sums);
        }
        sums.map(|lanes| lanes.iter().sum())
    }
}

impl Block {
    #[inline(always)]
    fn components(&self, direction: &Vector3<f64>, lane: usize) -> [f64; 2] {
        [&self.u, &self.v]
            .map(|t| t[0][lane] * direction.x + t[1][lane] * direction.y + t[2][lane] * direction.z)
    }

    #[inline(always)]
    fn add<const N: usize>(
        &self,
        cutter: Cutter,
        axis: &Vector3<f64>,
        across: &[Vector3<f64>; N],
        ends: bool,
        sums: &mut [Lane; N],
    ) {
        let mut tensor = [[0.0; LANES]; 4];
        for l in 0..LANES {
            let surface = [self.curvature[0][l], self.curvature[1][l], self.curvature[2][l]];
            let held = relative(cutter, self.components(axis, l), surface);
            for (own, value) in tensor.iter_mut().zip(held) {
                own[l] = value;
            }
        }
        let [uu, uv, vv, determinant] = tensor;
        let widest = 1.0 / (cutter.radius() * cutter.radius());
        let corner = 1.0 / cutter.r2.max(LEAST_CORNER);
        for (sums, across) in sums.iter_mut().zip(across) {
            for l in 0..LANES {
                let [cu, cv] = self.components(across, l);
                let slope2 = cu * cu + cv * cv;
                let cc = cv * (uu[l] * cv - uv[l] * cu) - cu * (uv[l] * cv - vv[l] * cu);
                // Squares of densities: of the valley, of the widest step, and where the bottom does not clear.
                let valley = determinant[l] * slope2 * self.inverse_budget[l] / cc;
                let valley = if valley > widest { valley } else { widest };
                let steep = if slope2 < STEEP * STEEP { STEEP * STEEP / slope2 } else { 1.0 };
                let clears = (determinant[l] > 0.0) & (cc > 0.0) & (slope2 >= 1e-18);
                let density2 = if clears { valley * steep } else { self.inverse_budget[l] * corner };
                let weight = if ends {
                    // Along the pass: cross-feed × normal.
                    let along = (self.weight[0][l] * cv - self.weight[1][l] * cu).abs();
                    let length = slope2.sqrt();
                    along / if length > 1e-9 { length } else { 1e-9 }
                } else {
                    self.weight[0][l]
                };
                sums[l] += weight * density2.sqrt() * (1.0 / STEP_SHARE);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::orientation::Orientation;
    use nalgebra::{Matrix3, Point3, Unit};

    #[test]
    fn sums_are_those_of_the_points_one_by_one() {
        let job = Job::default_for("s");
        let at = |i: usize, k: usize| ((i * 7 + k * 13) as f64 * 0.618).fract() * 2.0 - 1.0;
        let unit = |i: usize, k: usize| Vector3::new(at(i, k), at(i, k + 1), at(i, k + 2)).normalize();
        let point = |i: usize| {
            let normal = (Vector3::z() * 1.5 + unit(i, 0)).normalize();
            let flat = Matrix3::identity() - normal * normal.transpose();
            let (p, q) = (unit(i, 3), unit(i, 6));
            CloudPoint {
                position: Point3::origin(),
                normal,
                pseudo_curvature: 0.0,
                curvature: flat * (p * p.transpose() * (40.0 * at(i, 9)) - q * q.transpose() * 9.0) * flat,
                facet_error: 1e-6,
                area: 1e-6 * (1.5 + at(i, 10)),
            }
        };
        let points: Vec<CloudPoint> = (0..43).map(point).collect();
        let outward = |i: usize| unit(i, 11) * 1e-3;
        for cutter in [Cutter { r1: 0.01305, r2: 0.006 }, Cutter { r1: 0.0, r2: 0.006 }] {
            for i in 0..50 {
                let axis = Unit::new_normalize(Vector3::z() + unit(i, 14) * 0.8);
                let across = [unit(i, 17), unit(i, 20), axis.into_inner(), points[i % 43].normal];
                let found = TimedPoints::<false>::of(points.iter(), &job).sums(cutter, &axis, &across);
                let ends = points.iter().enumerate().map(|(i, p)| (p, outward(i)));
                let found_ends = TimedPoints::<true>::of(ends, &job).sums(cutter, &axis, &across);
                for (k, cross_feed) in across.into_iter().enumerate() {
                    let o = Orientation { axis, feed: Vector3::x(), cross_feed, inclination: 0.0 };
                    let (mut expected, mut expected_ends) = (0.0, 0.0);
                    for (i, p) in points.iter().enumerate() {
                        let height = scallop_budget(p, job.scallop_height, job.pass_chord);
                        let shape = TangentShape::new(&p.normal, &p.curvature);
                        let (distance, slope) = shape.allowed_distance(&o, cutter, height);
                        let density = slope.max(STEEP) / distance;
                        let ([u, v], [cu, cv]) =
                            (shape.components(&outward(i)), shape.components(&cross_feed));
                        expected += p.area * density;
                        expected_ends += (u * cv - v * cu).abs() / cu.hypot(cv).max(1e-9) * density;
                    }
                    assert!((found[k] / expected - 1.0).abs() < 1e-9, "{i} {k}: {} {expected}", found[k]);
                    assert!((found_ends[k] / expected_ends - 1.0).abs() < 1e-6, "{i} {k}: {found_ends:?}");
                }
            }
        }
    }

    #[test]
    fn no_points_give_nothing() {
        let none = TimedPoints::<false>::of(std::iter::empty(), &Job::default_for("s"));
        let cutter = Cutter { r1: 0.01, r2: 0.005 };
        assert!(none.sums(cutter, &Vector3::z(), &[Vector3::x()]) == [0.0]);
    }
}
