//! Which facets of a mesh are finished and which are check surface only.

use nalgebra::{Point3, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::mesh_topology::MeshTopology;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::selection::{Seed, Selection};
use patchmill_products::stage::StageError;

use crate::error_code::BAD_SELECTION;

/// Heights are compared with this tolerance, m: files have them in single precision.
const HEIGHT_SLACK: f64 = 1e-6;
/// Angles are compared with this tolerance, rad.
const ANGLE_SLACK: f64 = 1e-6;

/// The marks of [`TriangleMesh::check_only`] by a selection; empty where all facets are selected. `numbers` holds the place in the
/// file of every facet, where the file has facets; vertex normals are not read.
///
/// # Errors
/// When no facet is selected, or one is named by number that is not there.
pub fn check_only(
    mesh: &TriangleMesh,
    numbers: Option<&[u32]>,
    selection: &Selection,
    name: &str,
) -> Result<Vec<bool>, StageError> {
    let bad = |text: String| StageError::new(BAD_SELECTION, format!("{name}: {text}"));
    if selection.is_all() {
        return Ok(Vec::new());
    }
    let normals: Vec<Vector3<f64>> = (0..mesh.triangles.len()).map(|t| facet_normal(mesh, t)).collect();
    let mut selected: Vec<bool> =
        (0..mesh.triangles.len()).map(|t| holds(selection, &normals[t], &mesh.corners(t))).collect();
    if !selection.facets.is_empty() || selection.seed.is_some() {
        let numbers =
            numbers.ok_or_else(|| bad("facets cannot be picked by number: the file has none".to_owned()))?;
        if !selection.facets.is_empty() {
            let picked = picked(numbers, &selection.facets).map_err(bad)?;
            selected.iter_mut().zip(picked).for_each(|(selected, picked)| *selected &= picked);
        }
        if let Some(seed) = &selection.seed {
            let grown = grown(mesh, &normals, numbers, seed).map_err(bad)?;
            selected.iter_mut().zip(grown).for_each(|(selected, grown)| *selected &= grown);
        }
    }
    match selected.iter().filter(|selected| **selected).count() {
        0 => Err(bad(format!(
            "none of the {} facets fulfils the selection; at least one facet to be finished was expected",
            selected.len()
        ))),
        all if all == selected.len() => Ok(Vec::new()),
        _ => Ok(selected.into_iter().map(|selected| !selected).collect()),
    }
}

/// The samples of an analytic surface that a selection keeps; a grid only where it keeps all.
///
/// # Errors
/// When none is left.
pub fn selected_samples(
    samples: SurfaceSamples,
    selection: &Selection,
    name: &str,
) -> Result<SurfaceSamples, StageError> {
    let keep = |i: &usize| holds(selection, &samples.normals[*i], &[samples.points[*i]]);
    let kept: Vec<usize> = (0..samples.len()).filter(keep).collect();
    if kept.len() == samples.len() {
        return Ok(samples);
    }
    if kept.is_empty() {
        return Err(StageError::new(
            BAD_SELECTION,
            format!("{name}: none of the {} samples fulfils the selection", samples.len()),
        ));
    }
    Ok(samples.only(&kept))
}

fn facet_normal(mesh: &TriangleMesh, t: usize) -> Vector3<f64> {
    let [a, b, c] = mesh.corners(t);
    (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_default()
}

/// Whether the conditions on normal and height hold.
fn holds(selection: &Selection, normal: &Vector3<f64>, points: &[Point3<f64>]) -> bool {
    let in_cone = selection.cone.is_none_or(|cone| normal.angle(&cone.axis) <= cone.angle + ANGLE_SLACK);
    let in_band = |[low, high]: [f64; 2]| {
        points.iter().all(|p| low - HEIGHT_SLACK <= p.z && p.z <= high + HEIGHT_SLACK)
    };
    in_cone && selection.band.is_none_or(in_band)
}

/// Facets whose number is in one of the runs.
fn picked(numbers: &[u32], runs: &[[u32; 2]]) -> Result<Vec<bool>, String> {
    let most = numbers.iter().copied().max().unwrap_or(0);
    if let Some([first, last]) = runs.iter().find(|[_, last]| *last > most) {
        return Err(format!("facets {first} to {last} are selected, the last one of the file is {most}"));
    }
    let mut runs = runs.to_vec();
    runs.sort_unstable();
    let within = |number: &u32| {
        let after = runs.partition_point(|[first, _]| first <= number);
        runs[..after].iter().any(|[_, last]| number <= last)
    };
    Ok(numbers.iter().map(within).collect())
}

/// Facets that are reached from the seed over edges of no more than the crease angle.
fn grown(
    mesh: &TriangleMesh,
    normals: &[Vector3<f64>],
    numbers: &[u32],
    seed: &Seed,
) -> Result<Vec<bool>, String> {
    let start = numbers.iter().position(|number| *number == seed.facet).ok_or_else(|| {
        let most = numbers.iter().copied().max().unwrap_or(0);
        format!(
            "facet {} is not there: a facet with an area among the numbers 0 to {most} was expected",
            seed.facet
        )
    })?;
    let topology = MeshTopology::of(mesh);
    let mut reached = vec![false; mesh.triangles.len()];
    let mut open = vec![start];
    reached[start] = true;
    while let Some(t) = open.pop() {
        let corners = mesh.triangles[t];
        for k in 0..3 {
            for s in topology.across(t, corners[k], corners[(k + 1) % 3]) {
                if !reached[s] && normals[t].angle(&normals[s]) <= seed.crease + ANGLE_SLACK {
                    reached[s] = true;
                    open.push(s);
                }
            }
        }
    }
    Ok(reached)
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_products::selection::NormalCone;

    /// A unit cube, two facets a side: -z, +z, -y, +y, -x, +x.
    fn cube() -> TriangleMesh {
        let vertices = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(f64::from)).map(Point3::from).collect();
        let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = sides.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        TriangleMesh { vertices, triangles, ..TriangleMesh::default() }
    }

    fn finished(selection: &Selection) -> Result<Vec<usize>, StageError> {
        let numbers: Vec<u32> = (0..12).map(|t| 10 + t).collect();
        let marks = check_only(&cube(), Some(&numbers), selection, "cube")?;
        Ok((0..12).filter(|t| marks.get(*t).is_none_or(|check_only| !check_only)).collect())
    }

    #[test]
    fn every_condition_alone_and_all_together() {
        let up = Selection {
            cone: Some(NormalCone { axis: Vector3::z_axis(), angle: 0.1 }),
            ..Selection::default()
        };
        assert_eq!(finished(&up).unwrap(), [2, 3]);
        let bottom = Selection { band: Some([-0.5, 0.0]), ..Selection::default() };
        assert_eq!(finished(&bottom).unwrap(), [0, 1]);
        let some = Selection { facets: vec![[12, 14], [20, 20]], ..Selection::default() };
        assert_eq!(finished(&some).unwrap(), [2, 3, 4, 10]);
        let flat = |facet| Selection { seed: Some(Seed { facet, crease: 0.2 }), ..Selection::default() };
        assert_eq!(finished(&flat(17)).unwrap(), [6, 7]);
        let around = Selection { seed: Some(Seed { facet: 10, crease: 1.6 }), ..Selection::default() };
        assert_eq!(finished(&around).unwrap().len(), 12);
        assert_eq!(finished(&Selection { facets: vec![[13, 13]], ..up.clone() }).unwrap(), [3]);
        assert!(check_only(&cube(), None, &Selection::default(), "cube").unwrap().is_empty());
        for (bad, text) in [
            (Selection { band: Some([2.0, 3.0]), ..Selection::default() }, "none of the 12 facets"),
            (Selection { facets: vec![[0, 22]], ..Selection::default() }, "the last one of the file is 21"),
            (flat(9), "facet 9 is not there"),
            (Selection { facets: vec![[14, 14]], ..up }, "none of the 12 facets"),
        ] {
            let error = finished(&bad).unwrap_err();
            assert!(error.code == BAD_SELECTION && error.text.contains(text), "{error}");
        }
        assert!(check_only(&cube(), None, &some, "cube").unwrap_err().text.contains("the file has none"));
    }
}
