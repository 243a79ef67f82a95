//! NURBS that equal exact shapes, and cubic ones that equal Bézier surfaces.

use super::*;
use crate::bezier::Bezier;
use crate::surface_file;

/// Control points (radius or x, height or y) and weights of a circular arc about the origin in pieces of at most 90°.
fn arc(radius: f64, from: f64, to: f64, pieces: usize) -> Vec<([f64; 2], f64)> {
    let half = (to - from) / (2 * pieces) as f64;
    (0..=2 * pieces)
        .map(|k| {
            let angle = from + half * k as f64;
            let (reach, weight) = if k % 2 == 0 { (radius, 1.0) } else { (radius / half.cos(), half.cos()) };
            ([reach * angle.cos(), reach * angle.sin()], weight)
        })
        .collect()
}

/// Knots of such an arc.
fn knots(pieces: usize) -> Vec<f64> {
    let inner = (1..pieces).flat_map(|k| [k as f64; 2]);
    [0.0; 3].into_iter().chain(inner).chain([pieces as f64; 3]).collect()
}

/// The profile of arc pieces about a circle `centre` from the Z axis, turned about that axis through `turn`.
fn revolved(centre: f64, radius: f64, profile: [f64; 2], turn: [f64; 2], pieces: [usize; 2]) -> RationalNet {
    let (section, circle) =
        (arc(radius, profile[0], profile[1], pieces[0]), arc(1.0, turn[0], turn[1], pieces[1]));
    let net: Vec<Vec<(Point3<f64>, f64)>> = section
        .iter()
        .map(|([r, z], w)| {
            let at =
                |([x, y], v): &([f64; 2], f64)| (Point3::new(x * (centre + r), y * (centre + r), *z), w * v);
            circle.iter().map(at).collect()
        })
        .collect();
    RationalNet::new([2, 2], [knots(pieces[0]), knots(pieces[1])], &net).unwrap()
}

/// Every 1/37 of both parameters.
fn places() -> impl Iterator<Item = (f64, f64)> {
    (0..=37).flat_map(|i| (0..=37).map(move |j| (f64::from(i) / 37.0, f64::from(j) / 37.0)))
}

#[test]
fn a_sphere_a_torus_and_a_cylinder_are_exact() {
    // Radii of the tube and of its centres' circle, the tube's angle on the tool side, in pieces: a sphere, a torus, its inside.
    for (centre, radius, profile, pieces) in
        [(0.0, 0.04, [0.2, 1.4], [1, 1]), (0.1, 0.03, [0.3, 2.8], [3, 4]), (0.1, 0.03, [1.0, 1.9], [2, 1])]
    {
        let surface =
            Nurbs::new(revolved(centre, radius, profile, [0.0, 1.5], pieces), "test".to_owned()).unwrap();
        for (u, v) in places() {
            let point = surface.at(u, v);
            let normal = point.normal(surface.scale()).unwrap();
            let p = point.position;
            let (axial, radial) = (p.z, p.x.hypot(p.y) - centre);
            assert!((axial.hypot(radial) - radius).abs() < 1e-12 * (centre + radius), "{u} {v}");
            let (sine, cosine) = (axial / radius, radial / radius);
            assert!((normal.z - sine).abs() < 1e-12, "{u} {v}: {normal}");
            // Convex from outside: negative, along the tube and about the axis.
            let expected = [-1.0 / radius, -cosine / (centre + radial)];
            let (low, high) = (expected[0].min(expected[1]), expected[0].max(expected[1]));
            let found = point.curvature(&normal);
            assert!(
                (found.max - high).abs() * radius < 1e-12 && (found.min - low).abs() * radius < 1e-12,
                "{u} {v}: {found:?}"
            );
        }
    }
    // A trough: the lower half of a cylinder along y, seen from inside.
    let section = arc(0.02, std::f64::consts::PI * 1.1, std::f64::consts::PI * 1.9, 3);
    let row =
        |([x, z], w): &([f64; 2], f64)| vec![(Point3::new(*x, 0.0, *z), *w), (Point3::new(*x, 0.05, *z), *w)];
    let net: Vec<_> = section.iter().map(row).collect();
    let net = RationalNet::new([2, 1], [knots(3), vec![0.0, 0.0, 1.0, 1.0]], &net).unwrap();
    let surface = Nurbs::new(net, "test".to_owned()).unwrap();
    assert_eq!(surface.breaks().map(|b| b.len()).iter().sum::<usize>(), 2);
    for (u, v) in places() {
        let point = surface.at(u, v);
        let curvature = point.curvature(&point.normal(surface.scale()).unwrap());
        assert!((point.position.x.hypot(point.position.z) - 0.02).abs() < 1e-13);
        assert!(
            (curvature.max * 0.02 - 1.0).abs() < 1e-12 && curvature.min.abs() * 0.02 < 1e-12,
            "{curvature:?}"
        );
    }
}

#[test]
fn a_bezier_net_gives_the_bezier_surface() {
    let at = |i: usize, j: usize| {
        let (x, y) = (i as f64 * 0.01, j as f64 * 0.012);
        Vector3::new(x + 0.001 * (j * j) as f64, y, 0.003 * ((3 * i + 5 * j) % 7) as f64)
    };
    let net: [[Vector3<f64>; 4]; 4] = std::array::from_fn(|i| std::array::from_fn(|j| at(i, j)));
    let bezier = Bezier::new(net, "bezier".to_owned()).unwrap();
    let knots = || vec![2.0, 2.0, 2.0, 2.0, 6.0, 6.0, 6.0, 6.0];
    let points: Vec<Vec<_>> =
        net.iter().map(|row| row.iter().map(|p| (Point3::from(*p), 0.5)).collect()).collect();
    let nurbs =
        Nurbs::new(RationalNet::new([3, 3], [knots(), knots()], &points).unwrap(), "nurbs".to_owned())
            .unwrap();
    for (u, v) in places() {
        let (a, b) = (bezier.at(u, v), nurbs.at(u, v));
        for (a, b) in [
            (a.position.coords, b.position.coords),
            (a.u, b.u),
            (a.v, b.v),
            (a.uu, b.uu),
            (a.uv, b.uv),
            (a.vv, b.vv),
        ] {
            assert!((a - b).norm() < 1e-14, "{u} {v}");
        }
    }
}

#[test]
fn creases_and_bad_nets_are_refused() {
    let row =
        |z: f64| (0..2).map(|j| (Point3::new(z, f64::from(j), (z - 1.0).abs()), 1.0)).collect::<Vec<_>>();
    let net = RationalNet::new(
        [1, 1],
        [vec![0.0, 0.0, 1.0, 2.0, 2.0], vec![0.0, 0.0, 1.0, 1.0]],
        &[row(0.0), row(1.0), row(2.0)],
    );
    let text = Nurbs::new(net.unwrap(), "roof".to_owned()).unwrap_err().text;
    assert!(text.contains("roof has a crease of 90.00° at u = 1.0000"), "{text}");
    let file = |net: &str| surface_file::parse(net.as_bytes(), "a.json", "").map(|_| ()).unwrap_err().text;
    let whole = r#"{"kind":"nurbs","degrees":[1,1],"knots":[[0,0,1,1],[0,0,1,1]],"control_points":[[[0,0,0],[0,9,1]],[[9,0,0],[9,9,0]]],"weights":[[1,1],[1,2]]}"#;
    surface_file::parse(whole.as_bytes(), "a.json", "").unwrap();
    for (from, to, words) in [
        ("[1,2]]}", "[1,0]]}", "a weight is 0"),
        ("[1,2]]}", "[1]]}", "row 2 of 'weights'"),
        ("[1,2]]}", "[1,2],[1,1]]}", "3 rows of weights and 2"),
        (r#""degrees":[1,1]"#, r#""degrees":[1,-1]"#, "whole number"),
        (r#""degrees":[1,1]"#, r#""degrees":[1,2]"#, "along v there are 2 control points"),
        ("[0,0,1,1]]", "[0,0,1]]", "along v there are 3 knots"),
        ("[0,9,1]]", "[0,9]]", "control point 2 of row 1"),
        ("[0,9,1]],", "[0,9,1],[1,1,1]],", "row 1 of 'weights'"),
        (r#""knots":[[0,0,1,1],[0,0,1,1]],"#, "", "'knots' is missing"),
        (r#""weights""#, r#""weight""#, "'weight' is unknown"),
    ] {
        let text = file(&whole.replace(from, to));
        assert!(text.contains(words), "{words}: {text}");
    }
}
