use super::*;
use crate::cutter::Cutter;
use crate::drop_cutter::{DropCutter, tool_frame};
use crate::test_meshes::{Random, bumpy, height_field, random_soup};
use nalgebra::Unit;

fn frustum(low: f64, high: f64, radius_low: f64, radius_high: f64) -> Frustum {
    Frustum { low, high, radius_low, radius_high }
}

/// A shank, a steep and a shallow cone, a flange.
fn holder() -> Vec<Frustum> {
    vec![
        frustum(0.010, 0.020, 0.004, 0.004),
        frustum(0.020, 0.030, 0.006, 0.008),
        frustum(0.030, 0.032, 0.008, 0.020),
        frustum(0.032, 0.050, 0.022, 0.022),
    ]
}

#[test]
fn the_underside_is_the_least_height_of_all_sections() {
    let stack = ToolStack::new(&holder(), 0.0);
    for (rho, height) in
        [(0.0, 0.010), (0.004, 0.010), (0.005, 0.020), (0.007, 0.025), (0.014, 0.031), (0.021, 0.032)]
    {
        assert!((stack.height(rho).unwrap() - height).abs() < 1e-12, "{rho}");
    }
    assert_eq!(stack.height(0.0221), None);
    let grown = ToolStack::new(&holder(), 0.001);
    assert!((grown.height(0.0049).unwrap() - 0.009).abs() < 1e-12 && grown.height(0.0229).is_some());
    // One that narrows upward counts as a cylinder.
    let narrowing = ToolStack::new(&[frustum(0.01, 0.02, 0.009, 0.005)], 0.0);
    assert_eq!((narrowing.height(0.0089), narrowing.height(0.0091)), (Some(0.01), None));
    assert!(ToolStack::new(&[], 0.001).is_empty());
}

#[test]
fn only_what_is_wider_than_the_cutter_is_cut_out() {
    let cone = frustum(0.02, 0.04, 0.005, 0.015);
    assert_eq!(cone.wider_than(0.004), Some(cone));
    let clipped = cone.wider_than(0.010).unwrap();
    assert!((clipped.low - 0.03).abs() < 1e-15 && clipped.radius_low == 0.010 && clipped.high == 0.04);
    assert_eq!(cone.wider_than(0.015), None);
    assert_eq!(frustum(0.0, 1.0, 0.3, 0.1).wider_than(0.2).unwrap().radius_low, 0.3);
}

/// The same triangles, all facing the spindle: the drop-cutter does not look at facets from behind, a stack does.
fn facing(mesh: &TriangleMesh, axis: &Unit<Vector3<f64>>) -> TriangleMesh {
    let mut turned = mesh.clone();
    for t in 0..turned.triangles.len() {
        let [a, b, c] = turned.corners(t);
        if (b - a).cross(&(c - a)).dot(axis) < 0.0 {
            turned.triangles[t].swap(1, 2);
        }
    }
    turned
}

/// A disc is a flat-end cutter, for which the drop-cutter is exact.
#[test]
fn a_cylinder_drops_as_a_flat_end_does() {
    let mut random = Random::new(3);
    for mesh in [bumpy(60, 0.05, 0.006), random_soup(300, 5)] {
        for _ in 0..6 {
            let axis = Unit::new_normalize(Vector3::z() + 0.7 * random.unit_vector());
            let mesh = facing(&mesh, &axis);
            let bvh = Bvh::build(&mesh);
            let radius = random.in_range(0.001, 0.03);
            let flat = DropCutter::new(&mesh, &bvh, Cutter { r1: radius, r2: 0.0 }, &axis, &Vector3::x());
            let drops = StackDrop::new(&mesh, &bvh, *flat.frame());
            let stack = ToolStack::new(&[frustum(0.02, 0.03, radius, radius)], 0.0);
            for _ in 0..60 {
                let (x, y) = (random.in_range(-0.06, 0.06), random.in_range(-0.06, 0.06));
                let found = drops.lowest_tip(&stack, x, y, f64::NEG_INFINITY);
                let expected = flat.drop(x, y).map(|d| d.z - 0.02);
                assert_eq!(found.is_some(), expected.is_some());
                if let (Some(found), Some(expected)) = (found, expected) {
                    assert!((found - expected).abs() < 1e-11, "{found} {expected}");
                    assert_eq!(drops.lowest_tip(&stack, x, y, found), None);
                    assert!(drops.lowest_tip(&stack, x, y, found - 1e-9).is_some());
                }
            }
        }
    }
}

/// No sampled point of the mesh is inside the dropped stack, and some point nearly touches it.
#[test]
fn a_drop_is_that_of_a_search_over_points() {
    let mut random = Random::new(11);
    let stack = ToolStack::new(&holder(), 0.0);
    for round in 0..40u32 {
        let mesh = random_soup(6, u64::from(round) + 100);
        let bvh = Bvh::build(&mesh);
        let axis = Unit::new_normalize(random.unit_vector());
        let drops = StackDrop::new(&mesh, &bvh, tool_frame(&axis, &Vector3::x()));
        let (x, y) = (random.in_range(-0.02, 0.02), random.in_range(-0.02, 0.02));
        let n = 400;
        let mut sampled = f64::NEG_INFINITY;
        for t in 0..mesh.triangles.len() {
            let [a, b, c] = mesh.corners(t).map(|p| drops.frame * p);
            for i in 0..=n {
                for j in 0..=n - i {
                    let (s, r) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                    let p = a + (b - a) * s + (c - a) * r;
                    if let Some(height) = stack.height((p.x - x).hypot(p.y - y)) {
                        sampled = sampled.max(p.z - height);
                    }
                }
            }
        }
        match drops.lowest_tip(&stack, x, y, f64::NEG_INFINITY) {
            // The shallowest flank rises by 1/6, the steepest by 5; samples are 0.1 mm apart at most.
            Some(found) => {
                assert!(found >= sampled - 1e-12, "round {round}: {found} {sampled}");
                assert!(found - sampled < 1.5e-3, "round {round}: {found} {sampled}");
            }
            None => assert_eq!(sampled, f64::NEG_INFINITY),
        }
    }
}

/// Cones on single tilted facets and edges, where the highest place is known.
#[test]
fn a_cone_touches_a_slope_where_it_is_known_to() {
    let cone = [frustum(0.03, 0.04, 0.01, 0.02)];
    let stack = ToolStack::new(&cone, 0.0);
    // Slopes 0.5 and 2 against the flank's 1: at the disc's rim and at the cone's.
    for (gradient, expected) in [(0.5, 0.005 - 0.03), (2.0, 0.04 - 0.04)] {
        let mesh = height_field(3, 0.1, |x, _| gradient * x);
        let bvh = Bvh::build(&mesh);
        let drops = StackDrop::new(&mesh, &bvh, Rotation3::identity());
        let found = drops.lowest_tip(&stack, 0.0, 0.0, -1.0).unwrap();
        assert!((found - expected).abs() < 1e-12, "{gradient}: {found}");
    }
    // A wire at plan distance e = 15 mm rising by m = 0.6: u = e·m/√(1 − m²) = 11.25 mm, ρ = 18.75 mm.
    let mesh = TriangleMesh {
        vertices: vec![
            Point3::new(-0.1, 0.015, -0.06),
            Point3::new(0.1, 0.015, 0.06),
            Point3::new(0.0, 0.015, -0.2),
        ],
        normals: vec![Vector3::z(); 3],
        triangles: vec![[0, 1, 2]],
        chord_error: 0.0,
        check_only: Vec::new(),
    };
    let bvh = Bvh::build(&mesh);
    let drops = StackDrop::new(&mesh, &bvh, Rotation3::identity());
    let found = drops.lowest_tip(&stack, 0.0, 0.0, -1.0).unwrap();
    assert!((found - (0.6 * 0.01125 - 0.03 - 0.00875)).abs() < 1e-12, "{found}");
}

#[test]
fn a_touch_tells_the_raise_that_clears() {
    let mesh = bumpy(60, 0.05, 0.012);
    let bvh = Bvh::build(&mesh);
    let axis = Unit::new_normalize(Vector3::new(0.3, 0.1, 1.0));
    let drops = StackDrop::new(&mesh, &bvh, tool_frame(&axis, &Vector3::x()));
    let stack = ToolStack::new(&holder(), 0.0005);
    let (from, to) = (Point3::new(-0.04, -0.03, -0.01), Point3::new(0.04, 0.02, -0.012));
    let worst = drops.touch_along(&stack, &from, &to, 0.5e-3).unwrap();
    let up = axis.into_inner() * (worst.raise + 1e-9);
    assert_eq!(drops.touch_along(&stack, &(from + up), &(to + up), 0.5e-3), None);
    let up = axis.into_inner() * (worst.raise - 1e-9);
    let again = drops.touch_along(&stack, &(from + up), &(to + up), 0.5e-3).unwrap();
    assert!((again.raise - 1e-9).abs() < 1e-11 && (again.tip - up - worst.tip).norm() < 1e-9);
    assert_eq!(Touch::worse(Some(worst), None), Some(worst));
    assert_eq!(Touch::worse(Some(again), Some(worst)), Some(worst));
}

#[test]
fn nothing_is_touched_outside_the_reach_or_without_a_mesh() {
    let empty = TriangleMesh::default();
    let bvh = Bvh::build(&empty);
    let stack = ToolStack::new(&holder(), 0.0);
    let drops = StackDrop::new(&empty, &bvh, Rotation3::identity());
    assert_eq!(drops.lowest_tip(&stack, 0.0, 0.0, -1.0), None);
    let mesh = bumpy(4, 0.01, 0.001);
    let bvh = Bvh::build(&mesh);
    let drops = StackDrop::new(&mesh, &bvh, Rotation3::identity());
    assert_eq!(drops.lowest_tip(&stack, 0.04, 0.0, -1.0), None);
    assert!(drops.lowest_tip(&stack, 0.0315, 0.0, -1.0).is_some());
}
