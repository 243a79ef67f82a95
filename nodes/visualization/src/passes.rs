//! The passes: where the cutter touches the surface.

use nalgebra::Point3;
use patchmill_products::toolpath::CandidateToolpath;

use crate::colours;
use crate::shape::{Drawing, Form, MOST_POINTS, Shape};
use crate::simplify::simplified;

/// Passes with more points together are drawn with fewer.
pub const DISPLAY_POINTS: usize = 40_000;
/// Width of the stroke, m.
const WIDTH: f64 = 0.2e-3;

/// The cutter contact points of every pass as a line, in the namespaces `passes_0`, `passes_1` … by patch; links and retracts
/// are not drawn. Where there are more than [`DISPLAY_POINTS`], points within a tolerance are left out, as the note says.
pub fn drawing(toolpath: &CandidateToolpath) -> Drawing {
    let owners = toolpath.patches.iter().flat_map(|p| p.passes.iter().map(|pass| (p.patch as usize, pass)));
    let owners: Vec<_> = owners.filter(|(_, pass)| pass.cc.len() > 1).collect();
    let lines: Vec<&[Point3<f64>]> = owners.iter().map(|(_, pass)| pass.cc.as_slice()).collect();
    let (lines, tolerance) = simplified(&lines, DISPLAY_POINTS);
    let mut note = String::new();
    if tolerance > 0.0 {
        note = format!("the passes are drawn within {:.0} µm, without some of their points", tolerance * 1e6);
    }
    let mut next = std::collections::BTreeMap::new();
    let mut shapes = Vec::new();
    for ((patch, _), line) in owners.iter().zip(&lines) {
        for points in pieces(line) {
            let id: &mut usize = next.entry(*patch).or_insert(0);
            let form = Form::Line { points: points.to_vec(), width: WIDTH };
            let ns = format!("passes_{patch}");
            shapes.push(Shape::on_workpiece(&ns, *id, colours::passes(*patch), form));
            *id += 1;
        }
    }
    Drawing { shapes, note }
}

/// Pieces of a line of at most [`MOST_POINTS`] points; each begins where the one before it ended.
fn pieces(line: &[Point3<f64>]) -> impl Iterator<Item = &[Point3<f64>]> {
    let step = MOST_POINTS - 1;
    (0..line.len().saturating_sub(1)).step_by(step).map(move |i| &line[i..line.len().min(i + step + 1)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use patchmill_products::toolpath::{Pass, PatchToolpath};
    use std::collections::BTreeSet;

    fn toolpath(passes: &[(u32, usize)]) -> CandidateToolpath {
        let patch = |&(patch, points): &(u32, usize)| PatchToolpath {
            patch,
            tool_axis: Vector3::z(),
            feed_direction: Vector3::x(),
            pseudo_curvature_max: 0.0,
            sample_count: 1,
            step_over: [0.0; 2],
            area: 0.0,
            passes: vec![
                Pass { cc: wave(points), ..Pass::default() },
                Pass { cc: wave(points / 2), ..Pass::default() },
            ],
        };
        CandidateToolpath {
            index: 0,
            count: 1,
            patch_count: 2,
            infeasible_reason: String::new(),
            patches: passes.iter().map(patch).collect(),
            area_within_scallop: 1.0,
            gouge_max: 0.0,
        }
    }

    fn wave(points: usize) -> Vec<Point3<f64>> {
        let t = |i: usize| i as f64 / points as f64;
        (0..points).map(|i| Point3::new(0.1 * t(i), 1e-3 * (200.0 * t(i)).sin(), 0.0)).collect()
    }

    fn points(shape: &Shape) -> &[Point3<f64>] {
        match &shape.form {
            Form::Line { points, .. } => points,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn every_pass_is_drawn_whole_with_ids_of_its_own() {
        let toolpath = toolpath(&[(3, 6000), (0, 500)]);
        let Drawing { shapes, note } = drawing(&toolpath);
        assert_eq!(note, "");
        let ids: BTreeSet<_> = shapes.iter().map(|s| (s.ns.clone(), s.id)).collect();
        assert_eq!(ids.len(), shapes.len());
        let names: BTreeSet<_> = shapes.iter().map(|s| s.ns.as_str()).collect();
        assert_eq!(names, BTreeSet::from(["passes_0", "passes_3"]));
        let segments: usize = shapes.iter().map(|s| points(s).len() - 1).sum();
        assert_eq!(segments, 5999 + 2999 + 499 + 249);
        // 6000 points are three pieces that meet.
        assert_eq!(points(&shapes[0]).last(), points(&shapes[1]).first());
        assert!(shapes.iter().all(|s| points(s).len() <= MOST_POINTS));
    }

    #[test]
    fn too_many_points_are_thinned_and_the_note_says_so() {
        let Drawing { shapes, note } = drawing(&toolpath(&[(0, 60_000)]));
        let total: usize = shapes.iter().map(|s| points(s).len()).sum();
        assert!(total <= DISPLAY_POINTS + shapes.len());
        assert!(note.contains("within 10 µm"), "{note}");
    }

    #[test]
    fn passes_of_one_point_are_no_lines() {
        assert!(drawing(&toolpath(&[(0, 1)])).shapes.is_empty());
    }
}
