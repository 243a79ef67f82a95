//! Normals and curvature of the smooth surface that a mesh stands for.
//!
//! Two local least-squares fits, both in the frame of a vertex's tangent plane with the height
//! h(x, y) = g·(x, y) + ½ (x, y) W (x, y)ᵀ + cubic terms over it:
//! * [`fit_smooth_surface`] knows positions only (STL) and fits h itself, and a second time over the plane of
//!   the first fit if that leans, so that the normal is accurate to third order in the edge length;
//! * [`vertex_curvature_from_normals`] trusts the vertex normals and fits ∇h = −(n·x̂, n·ŷ)/(n·ẑ).
//!
//! W is the second fundamental form where g = 0, its eigenvalues the principal curvatures.

use nalgebra::{SMatrix, SVector, Vector2, Vector3};
use rayon::prelude::*;

use crate::mesh::TriangleMesh;
use crate::mesh_topology::MeshTopology;

/// Principal curvatures at a point, positive where concave as seen from the tool side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curvature {
    /// Largest (most concave) principal curvature, 1/m.
    pub max: f64,
    /// Least principal curvature, 1/m.
    pub min: f64,
    /// Unit tangent along which `max` is taken; any tangent at an umbilic.
    pub direction: Vector3<f64>,
}

impl Curvature {
    /// Eigenvalues and first eigenvector of the symmetric form [[a, b], [b, c]] (1/m) in the orthonormal
    /// tangents `t1`, `t2`.
    pub fn of_form(a: f64, b: f64, c: f64, t1: &Vector3<f64>, t2: &Vector3<f64>) -> Self {
        let (mean, half) = (0.5 * (a + c), 0.5 * (a - c));
        let radius = half.hypot(b);
        // At an umbilic atan2(0, 0) = 0: the first tangent.
        let (sin, cos) = (0.5 * b.atan2(half)).sin_cos();
        Self { max: mean + radius, min: mean - radius, direction: t1 * cos + t2 * sin }
    }

    /// The curvature of the other side, whose unit normal is `n`.
    #[must_use]
    pub fn turned(&self, n: &Vector3<f64>) -> Self {
        Self { max: -self.min, min: -self.max, direction: self.direction.cross(n) }
    }

    /// The curvature as a symmetric 3 × 3 tensor whose null direction is the normal `n`: fit for interpolation.
    pub fn tensor(&self, n: &Vector3<f64>) -> SMatrix<f64, 3, 3> {
        let other = n.cross(&self.direction);
        self.max * self.direction * self.direction.transpose() + self.min * other * other.transpose()
    }

    /// Principal curvatures of the part of `tensor` (1/m) that lies in the plane normal to the unit vector `n`.
    pub fn of_tensor(tensor: &SMatrix<f64, 3, 3>, n: &Vector3<f64>) -> Self {
        let (t1, t2) = tangents(n);
        let form = |s: &Vector3<f64>, t: &Vector3<f64>| s.dot(&(tensor * t));
        Self::of_form(form(&t1, &t1), form(&t1, &t2), form(&t2, &t2), &t1, &t2)
    }
}

/// What [`fit_smooth_surface`] finds, one entry a vertex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SmoothFit {
    /// Unit normals on the side from which the triangles run counter-clockwise.
    pub normals: Vec<Vector3<f64>>,
    /// Principal curvatures; zero at sharp vertices and where there are too few neighbours for a fit.
    pub curvature: Vec<Curvature>,
    /// Vertices on an edge whose facets meet at more than [`SHARP_ANGLE`]: their normal is the angle-weighted
    /// mean of the facets'.
    pub sharp: Vec<bool>,
}

/// Facets that meet at more than this angle, rad, meet at a sharp edge and not at a facet edge of a smooth surface.
pub const SHARP_ANGLE: f64 = 30.0 * std::f64::consts::PI / 180.0;

/// Neighbours wanted for a cubic fit of positions (9 unknowns): two rings of a regular mesh.
const FIT_NEIGHBOURS: usize = 16;
/// The same for a vertex of the border, where the fit is one-sided.
const FIT_NEIGHBOURS_BORDER: usize = 20;
/// A fit never reaches further than this many rings.
const RINGS_MAX: usize = 4;

/// An orthonormal pair (t1, t2) with t1 × t2 = `n`, continuous except at n = −Z (Duff et al., "Building an
/// orthonormal basis, revisited", 2017).
pub fn tangents(n: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let sign = 1f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    let t1 = Vector3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x);
    let t2 = Vector3::new(b, sign + n.y * n.y * a, -n.y);
    (t1, t2)
}

/// Normals and curvature from the vertex positions alone; `mesh.normals` is not read.
pub fn fit_smooth_surface(mesh: &TriangleMesh) -> SmoothFit {
    let topology = MeshTopology::of(mesh);
    let facet_normals: Vec<Vector3<f64>> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::z)
        })
        .collect();
    let sharp = topology.sharp_vertices(&facet_normals, SHARP_ANGLE.cos());
    let fits: Vec<(Vector3<f64>, Curvature)> = (0..mesh.vertices.len())
        .into_par_iter()
        .map_init(Vec::new, |ring, v| {
            let facets = angle_weighted_normal(mesh, &topology, &facet_normals, v);
            if sharp[v] {
                return (facets, flat(&facets));
            }
            let wanted = if topology.is_border(v) { FIT_NEIGHBOURS_BORDER } else { FIT_NEIGHBOURS };
            let least = if topology.is_border(v) { 3 } else { 2 };
            collect_rings(&topology, &sharp, v, least, wanted, ring);
            fit_positions(mesh, v, &ring[1..], &facets)
        })
        .collect();
    let (normals, curvature) = fits.into_iter().unzip();
    SmoothFit { normals, curvature, sharp }
}

/// Principal curvatures at every vertex from the mesh's vertex normals, exact to second order in the edge length.
pub fn vertex_curvature_from_normals(mesh: &TriangleMesh) -> Vec<Curvature> {
    let topology = MeshTopology::of(mesh);
    let none_sharp = vec![false; mesh.vertices.len()];
    (0..mesh.vertices.len())
        .into_par_iter()
        .map_init(Vec::new, |ring, v| {
            let rings = if topology.is_border(v) { 2 } else { 1 };
            collect_rings(&topology, &none_sharp, v, rings, 5, ring);
            fit_normals(mesh, v, &ring[1..])
        })
        .collect()
}

fn flat(n: &Vector3<f64>) -> Curvature {
    Curvature { max: 0.0, min: 0.0, direction: tangents(n).0 }
}

fn angle_weighted_normal(
    mesh: &TriangleMesh,
    topology: &MeshTopology,
    facet_normals: &[Vector3<f64>],
    v: usize,
) -> Vector3<f64> {
    let mut sum = Vector3::zeros();
    for &t in topology.triangles_at(v) {
        let corners = mesh.triangles[t as usize];
        let Some(k) = corners.iter().position(|&c| c as usize == v) else { continue };
        let p = mesh.corners(t as usize);
        let (a, b) = (p[(k + 1) % 3] - p[k], p[(k + 2) % 3] - p[k]);
        sum += facet_normals[t as usize] * a.cross(&b).norm().atan2(a.dot(&b));
    }
    sum.try_normalize(1e-12).unwrap_or_else(|| {
        topology.triangles_at(v).first().map_or_else(Vector3::z, |&t| facet_normals[t as usize])
    })
}

/// Breadth-first neighbours of `v` into `ring` (itself first): at least `least` rings, then further ones until
/// `wanted` vertices are found. The walk does not go on across sharp vertices.
fn collect_rings(
    topology: &MeshTopology,
    sharp: &[bool],
    v: usize,
    least: usize,
    wanted: usize,
    ring: &mut Vec<u32>,
) {
    ring.clear();
    ring.push(v as u32);
    let mut start = 0;
    for level in 0..RINGS_MAX {
        if level >= least && ring.len() > wanted {
            return;
        }
        let end = ring.len();
        for i in start..end {
            let at = ring[i] as usize;
            if sharp[at] {
                continue;
            }
            for &next in topology.neighbours(at) {
                // Rings hold a few dozen vertices: a scan beats any set.
                if !ring.contains(&next) {
                    ring.push(next);
                }
            }
        }
        start = end;
    }
}

/// Local coordinates of a neighbour and its weight, lengths in units of `scale`.
fn weight(d: &Vector2<f64>) -> f64 {
    // Gentle: a neighbour at the scale's distance counts half.
    1.0 / (1.0 + d.norm_squared())
}

fn fit_positions(
    mesh: &TriangleMesh,
    v: usize,
    ring: &[u32],
    facets: &Vector3<f64>,
) -> (Vector3<f64>, Curvature) {
    let mut n = *facets;
    let mut curvature = flat(facets);
    for _ in 0..2 {
        let (t1, t2) = tangents(&n);
        let origin = mesh.vertices[v];
        let scale = ring_scale(mesh, v, ring);
        let rows = ring.iter().map(|&q| {
            let d = (mesh.vertices[q as usize] - origin) / scale;
            (Vector2::new(d.dot(&t1), d.dot(&t2)), d.dot(&n))
        });
        let Some(h) = cubic_heights(rows.clone(), ring.len()).or_else(|| quadratic_heights(rows, ring.len()))
        else {
            return (n, curvature);
        };
        let (gx, gy) = (h[0], h[1]);
        if gx.hypot(gy) > 1.0 {
            // More than 45° from the facets: not a surface that a height function describes.
            return (*facets, flat(facets));
        }
        curvature = curvature_of_graph(&h, scale, &t1, &t2, &n);
        n = (n - t1 * gx - t2 * gy).normalize();
        // The curvature takes the gradient into account; only a plane that leans more is worth a second fit.
        if gx.hypot(gy) < 0.01 {
            break;
        }
    }
    (n, curvature)
}

/// Curvature at the origin of the height h = [gx, gy, a, b, c] (½a x² + b xy + ½c y²), lengths in units of `scale`.
fn curvature_of_graph(
    h: &[f64; 5],
    scale: f64,
    t1: &Vector3<f64>,
    t2: &Vector3<f64>,
    n: &Vector3<f64>,
) -> Curvature {
    let [gx, gy, a, b, c] = *h;
    let stretch = (1.0 + gx * gx + gy * gy).sqrt();
    let (su, sv) = (t1 + n * gx, t2 + n * gy);
    let normal = (n - t1 * gx - t2 * gy) / stretch;
    Curvature::of_fundamental_forms(
        &su,
        &sv,
        &normal,
        [a / (stretch * scale), b / (stretch * scale), c / (stretch * scale)],
    )
}

impl Curvature {
    /// Principal curvatures from the first derivatives `su`, `sv` (not parallel), the unit normal `n` and the second
    /// fundamental form [Suu·n, Suv·n, Svv·n].
    pub fn of_fundamental_forms(
        su: &Vector3<f64>,
        sv: &Vector3<f64>,
        n: &Vector3<f64>,
        second: [f64; 3],
    ) -> Self {
        let [l, m, nn] = second;
        let e1 = su.normalize();
        let e2 = n.cross(&e1);
        // su = p·e1, sv = q·e1 + r·e2; the form in (e1, e2) is J⁻ᵀ II J⁻¹.
        let (p, q, r) = (su.norm(), sv.dot(&e1), sv.dot(&e2));
        let a = l / (p * p);
        let b = (m - a * p * q) / (p * r);
        let c = (nn - a * q * q - 2.0 * b * q * r) / (r * r);
        Self::of_form(a, b, c, &e1, &e2)
    }
}

fn ring_scale(mesh: &TriangleMesh, v: usize, ring: &[u32]) -> f64 {
    let origin = mesh.vertices[v];
    let sum: f64 = ring.iter().map(|&q| (mesh.vertices[q as usize] - origin).norm()).sum();
    (sum / ring.len().max(1) as f64).max(f64::MIN_POSITIVE)
}

type Row = (Vector2<f64>, f64);

fn cubic_heights(rows: impl Iterator<Item = Row>, count: usize) -> Option<[f64; 5]> {
    if count < 12 {
        return None;
    }
    let x = solve::<9>(rows.map(|(d, h)| {
        let (x, y) = (d.x, d.y);
        let f = [x, y, 0.5 * x * x, x * y, 0.5 * y * y, x * x * x, x * x * y, x * y * y, y * y * y];
        (f, h, weight(&d))
    }))?;
    Some([x[0], x[1], x[2], x[3], x[4]])
}

fn quadratic_heights(rows: impl Iterator<Item = Row>, count: usize) -> Option<[f64; 5]> {
    if count < 5 {
        return None;
    }
    let x = solve::<5>(rows.map(|(d, h)| {
        let (x, y) = (d.x, d.y);
        ([x, y, 0.5 * x * x, x * y, 0.5 * y * y], h, weight(&d))
    }))?;
    Some([x[0], x[1], x[2], x[3], x[4]])
}

fn fit_normals(mesh: &TriangleMesh, v: usize, ring: &[u32]) -> Curvature {
    let n = mesh.normals[v];
    let (t1, t2) = tangents(&n);
    let origin = mesh.vertices[v];
    let scale = ring_scale(mesh, v, ring);
    // Each neighbour gives both components of ∇h in units where lengths are divided by `scale`.
    let gradients = ring.iter().filter_map(|&q| {
        let (d, m) = ((mesh.vertices[q as usize] - origin) / scale, mesh.normals[q as usize]);
        let rise = m.dot(&n);
        (rise > 0.5).then(|| {
            (Vector2::new(d.dot(&t1), d.dot(&t2)), Vector2::new(-m.dot(&t1) / rise, -m.dot(&t2) / rise))
        })
    });
    // h = ½a x² + b xy + ½c y² + cubic (x³/6, x²y/2, xy²/2, y³/6).
    let full = solve::<7>(gradients.clone().flat_map(|(d, g)| {
        let (x, y, w) = (d.x, d.y, weight(&d));
        [
            ([x, y, 0.0, 0.5 * x * x, x * y, 0.5 * y * y, 0.0], g.x, w),
            ([0.0, x, y, 0.0, 0.5 * x * x, x * y, 0.5 * y * y], g.y, w),
        ]
    }));
    let form = full.map(|x| [x[0], x[1], x[2]]).or_else(|| {
        solve::<3>(gradients.flat_map(|(d, g)| {
            let (x, y, w) = (d.x, d.y, weight(&d));
            [([x, y, 0.0], g.x, w), ([0.0, x, y], g.y, w)]
        }))
        .map(|x| [x[0], x[1], x[2]])
    });
    form.map_or_else(|| flat(&n), |[a, b, c]| Curvature::of_form(a / scale, b / scale, c / scale, &t1, &t2))
}

/// Weighted least squares by normal equations with a Jacobi scaling; `None` when they do not determine the unknowns.
fn solve<const N: usize>(rows: impl Iterator<Item = ([f64; N], f64, f64)>) -> Option<SVector<f64, N>> {
    let mut a = SMatrix::<f64, N, N>::zeros();
    let mut b = SVector::<f64, N>::zeros();
    for (f, h, w) in rows {
        for i in 0..N {
            let wf = w * f[i];
            b[i] += wf * h;
            for j in 0..=i {
                a[(i, j)] += wf * f[j];
            }
        }
    }
    let s = SVector::<f64, N>::from_fn(|i, _| a[(i, i)].sqrt().recip());
    if !s.iter().all(|x| x.is_finite()) {
        return None;
    }
    // Cholesky in place on the lower triangle; a pivot below 1e-7 of its unit diagonal is a rank defect.
    let mut l = SMatrix::<f64, N, N>::zeros();
    for i in 0..N {
        for j in 0..=i {
            let mut x = a[(i, j)] * s[i] * s[j];
            for k in 0..j {
                x -= l[(i, k)] * l[(j, k)];
            }
            if i == j {
                if x < 1e-7 {
                    return None;
                }
                l[(i, i)] = x.sqrt();
            } else {
                l[(i, j)] = x / l[(j, j)];
            }
        }
    }
    let mut y = b.component_mul(&s);
    for i in 0..N {
        for k in 0..i {
            y[i] -= l[(i, k)] * y[k];
        }
        y[i] /= l[(i, i)];
    }
    for i in (0..N).rev() {
        for k in i + 1..N {
            y[i] -= l[(k, i)] * y[k];
        }
        y[i] /= l[(i, i)];
    }
    Some(y.component_mul(&s))
}

#[cfg(test)]
mod tests;
