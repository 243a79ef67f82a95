//! Meshes and random numbers for the kernels' tests.

use nalgebra::{Point3, Vector3};

use crate::mesh::TriangleMesh;

/// A small deterministic generator (SplitMix64).
pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn in_range(&mut self, low: f64, high: f64) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        low + (high - low) * ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(crate) fn unit_vector(&mut self) -> Vector3<f64> {
        loop {
            let v = Vector3::from_fn(|_, _| self.in_range(-1.0, 1.0));
            if v.norm() > 0.1 && v.norm() < 1.0 {
                return v.normalize();
            }
        }
    }
}

/// A height field of n × n cells over [−half, half]², z = height·sin·cos waves.
pub(crate) fn bumpy(n: usize, half: f64, height: f64) -> TriangleMesh {
    height_field(n, half, |x, y| {
        height * ((x / half * 5.0).sin() * (y / half * 4.0).cos() + 0.3 * (x + y) / half)
    })
}

/// A height field of n × n cells over [−half, half]²; normals left as +z.
pub(crate) fn height_field(n: usize, half: f64, z: impl Fn(f64, f64) -> f64) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for i in 0..=n {
        for j in 0..=n {
            let (x, y) = (-half + 2.0 * half * i as f64 / n as f64, -half + 2.0 * half * j as f64 / n as f64);
            mesh.vertices.push(Point3::new(x, y, z(x, y)));
            mesh.normals.push(Vector3::z());
        }
    }
    let id = |i: usize, j: usize| (i * (n + 1) + j) as u32;
    for i in 0..n {
        for j in 0..n {
            mesh.triangles.push([id(i, j), id(i + 1, j), id(i + 1, j + 1)]);
            mesh.triangles.push([id(i, j), id(i + 1, j + 1), id(i, j + 1)]);
        }
    }
    mesh
}

/// Unconnected random triangles within about ±0.05 m, of all orientations.
pub(crate) fn random_soup(n: usize, seed: u64) -> TriangleMesh {
    let mut random = Random::new(seed);
    let mut mesh = TriangleMesh::default();
    for t in 0..n as u32 {
        let centre = Vector3::from_fn(|_, _| random.in_range(-0.05, 0.05));
        let size = random.in_range(0.001, 0.02);
        for _ in 0..3 {
            mesh.vertices.push(Point3::from(centre + random.unit_vector() * size));
            mesh.normals.push(Vector3::z());
        }
        mesh.triangles.push([3 * t, 3 * t + 1, 3 * t + 2]);
    }
    mesh
}
