//! Analytic surfaces for the tests, with their meshes and samples: independent of surface_ingestion.

use nalgebra::{Matrix2, Point3, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::samples::SurfaceSamples;

/// Position and derivatives S, Su, Sv, Suu, Suv, Svv at (u, v) in the unit square; Su × Sv points to the tool.
type Jet = [Vector3<f64>; 6];

/// A parametric surface, metres.
pub(crate) struct Surface(Box<dyn Fn(f64, f64) -> Jet>);

impl Surface {
    /// z over [-half_x, half_x] × [-half_y, half_y]; `f` gives z, zx, zy, zxx, zxy, zyy.
    fn graph(half_x: f64, half_y: f64, f: impl Fn(f64, f64) -> [f64; 6] + 'static) -> Self {
        let (sx, sy) = (2.0 * half_x, 2.0 * half_y);
        Self(Box::new(move |u, v| {
            let (x, y) = (sx * (u - 0.5), sy * (v - 0.5));
            let [z, zx, zy, zxx, zxy, zyy] = f(x, y);
            [
                Vector3::new(x, y, z),
                Vector3::new(sx, 0.0, zx * sx),
                Vector3::new(0.0, sy, zy * sy),
                Vector3::new(0.0, 0.0, zxx * sx * sx),
                Vector3::new(0.0, 0.0, zxy * sx * sy),
                Vector3::new(0.0, 0.0, zyy * sy * sy),
            ]
        }))
    }

    /// A square in z = 0, centred on the origin.
    pub(crate) fn plane(side: f64) -> Self {
        Self::graph(side / 2.0, side / 2.0, |_, _| [0.0; 6])
    }

    /// A cap of a sphere over a square of half side `half`; concave for a positive radius.
    pub(crate) fn sphere(radius: f64, half: f64) -> Self {
        let (r, s) = (radius.abs(), radius.signum());
        Self::graph(half, half, move |x, y| {
            let h = (r * r - x * x - y * y).sqrt();
            let h3 = h * h * h;
            [
                s * (r - h),
                s * x / h,
                s * y / h,
                s * (h * h + x * x) / h3,
                s * x * y / h3,
                s * (h * h + y * y) / h3,
            ]
        })
    }

    /// Part of a cylinder along y; concave for a positive radius.
    pub(crate) fn cylinder(radius: f64, half_x: f64, half_y: f64) -> Self {
        let (r, s) = (radius.abs(), radius.signum());
        Self::graph(half_x, half_y, move |x, _| {
            let h = (r * r - x * x).sqrt();
            [s * (r - h), s * x / h, 0.0, s * r * r / (h * h * h), 0.0, 0.0]
        })
    }

    /// z = (x² + y²)/2p: the ball at the distance r from its axis has the radius p√(1 + r²/p²), centred on the axis.
    pub(crate) fn paraboloid(p: f64, half: f64) -> Self {
        Self::graph(half, half, move |x, y| [0.5 * (x * x + y * y) / p, x / p, y / p, 1.0 / p, 0.0, 1.0 / p])
    }

    /// The groove that a ball of radius `minor` cuts on its way round a circle of radius `major`.
    pub(crate) fn groove(major: f64, minor: f64, half_angle: f64) -> Self {
        let (du, dv) = (2.0 * half_angle, 2.0);
        Self(Box::new(move |u, v| {
            let ((sin, cos), (sw, cw)) = ((du * (u - 0.5)).sin_cos(), (dv * (v - 0.5)).sin_cos());
            let (out, round) = (Vector3::new(cos, sin, 0.0), Vector3::new(-sin, cos, 0.0));
            let rho = major - minor * sw;
            [
                out * rho - Vector3::z() * minor * cw,
                round * rho * du,
                (-out * cw + Vector3::z() * sw) * minor * dv,
                -out * rho * du * du,
                -round * minor * cw * du * dv,
                (out * sw + Vector3::z() * cw) * minor * dv * dv,
            ]
        }))
    }

    /// 3.6·sin(2πx/100) + cos(πy/40) mm over 100 × 40 mm: the algebraic fixture, moved to the origin.
    pub(crate) fn waves() -> Self {
        use std::f64::consts::PI;
        Self::graph(0.050, 0.020, |x, y| {
            let (a, b) = (2.0 * PI / 0.1, PI / 0.04);
            let ((sx, cx), (sy, cy)) = ((a * (x + 0.05)).sin_cos(), (b * (y + 0.02)).sin_cos());
            let (p, q) = (0.0036, 0.001);
            [p * sx + q * cy, p * a * cx, -q * b * sy, -p * a * a * sx, 0.0, -q * b * b * cy]
        })
    }

    /// A bicubic Bézier surface from a surface file of the fixtures.
    pub(crate) fn bezier_fixture(name: &str) -> Self {
        let path = format!("{}/../../tests/fixtures/{name}.json", env!("CARGO_MANIFEST_DIR"));
        let file: serde_json::Value = serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap();
        let net: [[Vector3<f64>; 4]; 4] = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                Vector3::from_fn(|k, _| file["control_points"][i][j][k].as_f64().unwrap() * 1e-3)
            })
        });
        Self(Box::new(move |u, v| {
            let (bu, bv) = (bernstein(u), bernstein(v));
            let sum = |a: usize, b: usize| {
                let mut s = Vector3::zeros();
                for (i, row) in net.iter().enumerate() {
                    for (j, p) in row.iter().enumerate() {
                        s += p * bu[a][i] * bv[b][j];
                    }
                }
                s
            };
            [sum(0, 0), sum(1, 0), sum(0, 1), sum(2, 0), sum(1, 1), sum(0, 2)]
        }))
    }
}

/// Cubic Bernstein polynomials, their first and second derivatives.
fn bernstein(t: f64) -> [[f64; 4]; 3] {
    let s = 1.0 - t;
    [
        [s * s * s, 3.0 * t * s * s, 3.0 * t * t * s, t * t * t],
        [-3.0 * s * s, 3.0 * s * s - 6.0 * t * s, 6.0 * t * s - 3.0 * t * t, 3.0 * t * t],
        [6.0 * s, 6.0 * t - 12.0 * s, 6.0 * s - 12.0 * t, 6.0 * t],
    ]
}

/// A mesh of `cells` × `cells` × 2 triangles with the surface's own normals.
pub(crate) fn grid_mesh(surface: &Surface, cells: usize) -> TriangleMesh {
    let samples = grid_samples(surface, cells + 1);
    let n = cells as u32 + 1;
    let mut triangles = Vec::new();
    for i in 0..n - 1 {
        for j in 0..n - 1 {
            let a = i * n + j;
            triangles.push([a, a + n, a + n + 1]);
            triangles.push([a, a + n + 1, a + 1]);
        }
    }
    TriangleMesh {
        vertices: samples.points,
        normals: samples.normals,
        triangles,
        chord_error: 0.0,
        check_only: Vec::new(),
    }
}

/// `n` × `n` samples with exact normals and principal curvatures.
pub(crate) fn grid_samples(surface: &Surface, n: usize) -> SurfaceSamples {
    let mut samples = SurfaceSamples { grid: Some([n as u32; 2]), ..SurfaceSamples::default() };
    for i in 0..n {
        for j in 0..n {
            let [s, su, sv, suu, suv, svv] = surface.0(i as f64 / (n - 1) as f64, j as f64 / (n - 1) as f64);
            let normal = su.cross(&sv).normalize();
            assert!(normal.z > 0.0);
            let first = su.normalize();
            let second = normal.cross(&first);
            let jacobian = Matrix2::new(su.dot(&first), sv.dot(&first), su.dot(&second), sv.dot(&second));
            let inverse = jacobian.try_inverse().unwrap();
            let form = Matrix2::new(suu.dot(&normal), suv.dot(&normal), suv.dot(&normal), svv.dot(&normal));
            let eigen = (inverse.transpose() * form * inverse).symmetric_eigen();
            let (max, min) = if eigen.eigenvalues[0] >= eigen.eigenvalues[1] { (0, 1) } else { (1, 0) };
            let direction = eigen.eigenvectors.column(max);
            samples.points.push(Point3::from(s));
            samples.normals.push(normal);
            samples.curvature_max.push(eigen.eigenvalues[max]);
            samples.curvature_min.push(eigen.eigenvalues[min]);
            samples.direction_max.push(first * direction[0] + second * direction[1]);
            samples.area.push(su.cross(&sv).norm() / (n * n) as f64);
        }
    }
    samples
}
