//! Known surfaces of about 20 000 triangles.

use nalgebra::Point3;

use super::*;

/// A grid over the unit square mapped by `f`, optionally with every other diagonal turned.
fn grid(n: usize, f: impl Fn(f64, f64) -> Point3<f64>) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for j in 0..=n {
        for i in 0..=n {
            mesh.vertices.push(f(i as f64 / n as f64, j as f64 / n as f64));
        }
    }
    let at = |i: usize, j: usize| (j * (n + 1) + i) as u32;
    for j in 0..n {
        for i in 0..n {
            let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    mesh
}

/// Largest angle between normals in degrees and largest relative curvature error, (inside, at the border).
fn errors(
    mesh: &TriangleMesh,
    fit: &[Curvature],
    normals: &[Vector3<f64>],
    truth: impl Fn(&Point3<f64>) -> (Vector3<f64>, f64, f64),
) -> [(f64, f64); 2] {
    let topology = MeshTopology::of(mesh);
    let mut worst = [(0f64, 0f64); 2];
    for (v, p) in mesh.vertices.iter().enumerate() {
        let (n, max, min) = truth(p);
        let size = max.abs().max(min.abs());
        let angle = n.cross(&normals[v]).norm().atan2(n.dot(&normals[v])).to_degrees();
        let bend = (fit[v].max - max).abs().max((fit[v].min - min).abs()) / size;
        let at = &mut worst[usize::from(topology.is_border(v))];
        *at = (at.0.max(angle), at.1.max(bend));
    }
    worst
}

fn judge(name: &str, mesh: &mut TriangleMesh, truth: impl Fn(&Point3<f64>) -> (Vector3<f64>, f64, f64)) {
    let fit = fit_smooth_surface(mesh);
    assert!(fit.sharp.iter().all(|s| !s), "{name}: no sharp vertices");
    let [inside, border] = errors(mesh, &fit.curvature, &fit.normals, &truth);
    println!("{name}: positions inside {inside:?} border {border:?}");
    assert!(inside.0 < 0.02 && border.0 < 0.02, "{name}: normals {inside:?} {border:?}");
    assert!(inside.1 < 0.01 && border.1 < 0.03, "{name}: curvature {inside:?} {border:?}");

    mesh.normals = mesh.vertices.iter().map(|p| truth(p).0).collect();
    let exact = mesh.normals.clone();
    let [inside, border] = errors(mesh, &vertex_curvature_from_normals(mesh), &exact, &truth);
    println!("{name}: normals inside {inside:?} border {border:?}");
    assert!(inside.1 < 0.01 && border.1 < 0.03, "{name}: curvature from normals {inside:?} {border:?}");
}

#[test]
fn bowl_of_a_sphere() {
    let r = 0.05;
    let mut mesh = grid(100, |u, v| {
        let (x, y) = (0.06 * (u - 0.5), 0.06 * (v - 0.5));
        Point3::new(x, y, r - (r * r - x * x - y * y).sqrt())
    });
    judge("sphere", &mut mesh, |p| ((Point3::new(0., 0., r) - p).normalize(), 1.0 / r, 1.0 / r));
}

#[test]
fn ridge_of_a_cylinder() {
    let r = 0.05;
    let mut mesh = grid(100, |u, v| {
        let a = 2.0 * (u - 0.5);
        Point3::new(r * a.sin(), 0.1 * v, r * a.cos())
    });
    judge("cylinder", &mut mesh, |p| (Vector3::new(p.x, 0., p.z).normalize(), 0.0, -1.0 / r));
}

#[test]
fn quarter_of_a_torus() {
    let (big, small) = (0.08, 0.03);
    let mut mesh = grid(100, |u, v| {
        let (a, b) = (u * 1.5, v * 2.6 + 0.2);
        let ring = big + small * b.cos();
        Point3::new(ring * a.cos(), ring * a.sin(), small * b.sin())
    });
    judge("torus", &mut mesh, |p| {
        let rho = p.x.hypot(p.y);
        let radial = Vector3::new(p.x / rho, p.y / rho, 0.0);
        let centre = Point3::from(radial * big);
        let n = (p - centre).normalize();
        let other = -n.dot(&radial) / rho;
        (n, other.max(-1.0 / small), other.min(-1.0 / small))
    });
}

#[test]
fn paraboloid() {
    let (a, b) = (8.0, -5.0);
    let mut mesh = grid(100, |u, v| {
        let (x, y) = (0.1 * (u - 0.5), 0.1 * (v - 0.5) + 0.02 * u);
        Point3::new(x, y, 0.5 * a * x * x + 0.5 * b * y * y)
    });
    judge("paraboloid", &mut mesh, |p| {
        let (gx, gy) = (a * p.x, b * p.y);
        let n = Vector3::new(-gx, -gy, 1.0).normalize();
        let s = (1.0 + gx * gx + gy * gy).sqrt();
        let (su, sv) = (Vector3::new(1.0, 0.0, gx), Vector3::new(0.0, 1.0, gy));
        let c = Curvature::of_fundamental_forms(&su, &sv, &n, [a / s, 0.0, b / s]);
        (n, c.max, c.min)
    });
}

#[test]
fn a_roof_keeps_its_ridge_sharp_and_its_slopes_flat() {
    let mesh = grid(20, |u, v| Point3::new(u - 0.5, v, -(u - 0.5).abs()));
    let fit = fit_smooth_surface(&mesh);
    for (v, p) in mesh.vertices.iter().enumerate() {
        assert_eq!(fit.sharp[v], p.x.abs() < 1e-9);
        if !fit.sharp[v] {
            let n = Vector3::new(p.x.signum(), 0.0, 1.0).normalize();
            assert!((fit.normals[v] - n).norm() < 1e-9);
            assert!(fit.curvature[v].max.abs() < 1e-6);
        } else {
            assert!(fit.normals[v].z > 0.99, "angle-weighted mean of both slopes");
        }
    }
}

#[test]
fn tensors_return_their_principal_curvatures() {
    let n = Vector3::new(0.3, -0.2, 0.9).normalize();
    let (t1, t2) = tangents(&n);
    assert!((t1.cross(&t2) - n).norm() < 1e-15);
    let c = Curvature::of_form(3.0, 1.0, -2.0, &t1, &t2);
    let back = Curvature::of_tensor(&c.tensor(&n), &n);
    assert!((back.max - c.max).abs() < 1e-12 && (back.min - c.min).abs() < 1e-12);
    assert!(back.direction.cross(&c.direction).norm() < 1e-12);
}
