//! Tool axis, feed direction and number of every patch.

use nalgebra::Point3;
use patchmill_products::partition::Partition;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::{CandidateToolpath, PatchToolpath};

use crate::colours;
use crate::shape::{Form, Shape};

/// Lengths as shares of the surface's diagonal.
const AXIS_LENGTH: f64 = 0.2;
const FEED_LENGTH: f64 = 0.12;
const SHAFT: f64 = 0.008;
const NUMBER_HEIGHT: f64 = 0.04;

/// For every patch an arrow along its tool axis, one along its feed direction, and its number above the first, in the
/// namespaces `tool_axis`, `feed_direction` and `patch_number`; the id is the patch's number. The arrows stand on the sample of the
/// patch that is nearest to the patch's centroid.
pub fn shapes(toolpath: &CandidateToolpath, partition: &Partition, samples: &SurfaceSamples) -> Vec<Shape> {
    let size = diagonal(&samples.points);
    toolpath
        .patches
        .iter()
        .flat_map(|patch| of_patch(patch, &foot(patch, partition, samples), size))
        .collect()
}

fn of_patch(patch: &PatchToolpath, foot: &Point3<f64>, size: f64) -> [Shape; 3] {
    let arrow = |direction, length: f64| Form::Arrow {
        from: *foot,
        to: foot + length * size * direction,
        diameter: SHAFT * size,
    };
    let text = Form::Text {
        at: foot + (AXIS_LENGTH + NUMBER_HEIGHT) * size * patch.tool_axis,
        height: NUMBER_HEIGHT * size,
        text: format!("patch {}", patch.patch),
    };
    let id = patch.patch as usize;
    [
        Shape::on_workpiece("tool_axis", id, colours::TOOL_AXIS, arrow(patch.tool_axis, AXIS_LENGTH)),
        Shape::on_workpiece(
            "feed_direction",
            id,
            colours::FEED_DIRECTION,
            arrow(patch.feed_direction, FEED_LENGTH),
        ),
        Shape::on_workpiece("patch_number", id, colours::NUMBER, text),
    ]
}

/// The patch's sample nearest to the patch's centroid; without samples its first contact point.
fn foot(patch: &PatchToolpath, partition: &Partition, samples: &SurfaceSamples) -> Point3<f64> {
    let labels = partition.labels.iter().zip(samples.points.iter().zip(&samples.area));
    let own: Vec<_> = labels.filter(|(l, _)| u32::from(**l) == patch.patch).map(|(_, s)| s).collect();
    let area: f64 = own.iter().map(|(_, a)| **a).sum();
    let moment = own.iter().fold(Point3::origin(), |sum, (p, a)| sum + p.coords * **a);
    let centroid = moment / if area > 0.0 { area } else { 1.0 };
    let away = |p: &Point3<f64>| (p - centroid).norm_squared();
    let nearest = own.iter().map(|(p, _)| **p).min_by(|a, b| away(a).total_cmp(&away(b)));
    let first = || patch.passes.iter().find_map(|pass| pass.cc.first().copied());
    nearest.or_else(first).unwrap_or_else(Point3::origin)
}

fn diagonal(points: &[Point3<f64>]) -> f64 {
    let first = points.first().copied().unwrap_or_default();
    let (low, high) = points.iter().fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    (high - low).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4, Vector3, Vector4};
    use patchmill_products::partition::PatchStatistics;

    #[test]
    fn arrows_stand_on_the_middle_sample_of_their_patch() {
        let points: Vec<Point3<f64>> =
            (0..25).map(|i| Point3::new(f64::from(i % 5) * 0.01, f64::from(i / 5) * 0.01, 0.0)).collect();
        let samples = SurfaceSamples { area: vec![1e-4; 25], points, ..SurfaceSamples::default() };
        let statistics = PatchStatistics {
            mean: Vector4::zeros(),
            covariance: Matrix4::identity(),
            sample_count: 1,
            parts: vec![1],
        };
        // Three columns are patch 1, two patch 0.
        let partition = Partition {
            index: 0,
            count: 1,
            feature_mean: Vector4::zeros(),
            feature_scale: Vector4::repeat(1.0),
            labels: (0..25).map(|i| u8::from(i % 5 < 3)).collect(),
            patches: vec![statistics; 2],
            inertia: 0.0,
        };
        let patch = PatchToolpath {
            patch: 1,
            tool_axis: Vector3::z(),
            feed_direction: Vector3::y(),
            pseudo_curvature_max: 0.0,
            sample_count: 15,
            step_over: [0.0; 2],
            area: 0.0,
            passes: Vec::new(),
        };
        let toolpath = CandidateToolpath {
            index: 0,
            count: 1,
            patch_count: 2,
            infeasible_reason: String::new(),
            patches: vec![patch],
            area_within_scallop: 1.0,
            gouge_max: 0.0,
        };
        let shapes = shapes(&toolpath, &partition, &samples);
        assert_eq!(
            shapes.iter().map(|s| s.ns.as_str()).collect::<Vec<_>>(),
            ["tool_axis", "feed_direction", "patch_number"]
        );
        assert!(shapes.iter().all(|s| s.id == 1));
        let size = 0.04 * 2f64.sqrt();
        let Form::Arrow { from, to, .. } = &shapes[0].form else { panic!() };
        assert!((from - Point3::new(0.01, 0.02, 0.0)).norm() < 1e-12);
        assert!((to - from - Vector3::z() * AXIS_LENGTH * size).norm() < 1e-12);
        let Form::Arrow { from, to, .. } = &shapes[1].form else { panic!() };
        assert!((to - from - Vector3::y() * FEED_LENGTH * size).norm() < 1e-12);
        let Form::Text { text, .. } = &shapes[2].form else { panic!() };
        assert_eq!(text, "patch 1");
    }
}
