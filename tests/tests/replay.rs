//! Every stage replayed from the golden bag: the recorded inputs must give the recorded products.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::sync::Arc;

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_machine_interface::MachineParams;
use patchmill_machine_interface::evaluate::evaluate;
use patchmill_msgs::msg;
use patchmill_path_generation::{PathParams, PreparedSurface, plan_candidate};
use patchmill_products::evaluation::Evaluation;
use patchmill_products::field::RollingBallField;
use patchmill_products::program::{JointMotion, Program};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::unobserved;
use patchmill_products::toolpath::CandidateToolpath;
use patchmill_rolling_ball_analysis::{AnalysisParams, analyse};
use patchmill_surface_ingestion::{IngestionParams, ingest, read_source};
use patchmill_surface_partitioning::{PartitionParams, partition};
use patchmill_tests::fixture;
use patchmill_tests::golden::{RecordedRun, golden_bag};

/// Positions may differ by rounding of another processor's mathematics, m.
const POSITION: f64 = 1e-9;

fn recorded() -> RecordedRun {
    RecordedRun::open(&golden_bag()).unwrap()
}

#[test]
fn surface_ingestion() {
    let source = read_source(&fixture(""), "small_bezier.json", "").unwrap();
    let surface = ingest(&source, &IngestionParams::default(), unobserved()).unwrap();
    let (mesh, samples): (TriangleMesh, SurfaceSamples) =
        (recorded().product().unwrap(), recorded().product().unwrap());
    assert_eq!(surface.surface_id, recorded().job().unwrap().surface_id);
    assert_eq!(surface.mesh.triangles, mesh.triangles);
    for (now, then) in surface.mesh.vertices.iter().zip(&mesh.vertices) {
        assert!((now - then).norm() < POSITION);
    }
    assert_eq!(surface.samples.grid, samples.grid);
    for i in 0..samples.len() {
        assert!((surface.samples.points[i] - samples.points[i]).norm() < POSITION);
        assert!((surface.samples.normals[i] - samples.normals[i]).norm() < 1e-9);
        assert!((surface.samples.curvature_max[i] - samples.curvature_max[i]).abs() < 1e-6);
    }
}

#[test]
fn rolling_ball_analysis() {
    let run = recorded();
    let (mesh, samples) = (run.product().unwrap(), run.product().unwrap());
    let field =
        analyse(&mesh, &samples, &run.job().unwrap(), &AnalysisParams::default(), unobserved()).unwrap();
    let then: RollingBallField = run.product().unwrap();
    assert_eq!(field.pseudo_curvature.len(), then.pseudo_curvature.len());
    for (now, then) in field.pseudo_curvature.iter().zip(&then.pseudo_curvature) {
        assert!((now - then).abs() < 1e-6, "{now} {then}");
    }
}

#[test]
fn surface_partitioning() {
    let run = recorded();
    let (samples, field) = (run.product().unwrap(), run.product().unwrap());
    let now =
        partition(&samples, &field, &run.job().unwrap(), &PartitionParams::default(), unobserved()).unwrap();
    let then = run.partitions().unwrap();
    assert_eq!(now.len(), then.len());
    for (now, then) in now.iter().zip(&then) {
        assert_eq!(now.labels, then.labels);
        assert!((now.inertia - then.inertia).abs() < 1e-9 * then.inertia);
    }
}

#[test]
fn path_generation() {
    let run = recorded();
    let mesh: TriangleMesh = run.product().unwrap();
    let (samples, field, job) = (run.product().unwrap(), run.product().unwrap(), run.job().unwrap());
    let params = PathParams::default();
    let surface =
        PreparedSurface::new(Arc::new(mesh), &samples, &field, &job, &params, unobserved()).unwrap();
    let mut then: Vec<CandidateToolpath> = run.products().unwrap();
    then.sort_by_key(|t| t.index);
    let partitions = run.partitions().unwrap();
    assert_eq!(then.len(), partitions.len());
    for (partition, then) in partitions.iter().zip(&then) {
        let now = plan_candidate(&surface, partition, &job, &params, unobserved()).unwrap();
        assert_eq!(now.infeasible_reason, then.infeasible_reason);
        assert_eq!(now.patches.len(), then.patches.len());
        for (now, then) in now.patches.iter().zip(&then.patches) {
            assert!((now.tool_axis - then.tool_axis).norm() < 1e-9);
            let tips = |p: &patchmill_products::toolpath::PatchToolpath| {
                p.passes.iter().flat_map(|pass| pass.cl.clone()).collect::<Vec<_>>()
            };
            let (now, then) = (tips(now), tips(then));
            assert_eq!(now.len(), then.len());
            assert!(now.iter().zip(&then).all(|(a, b)| (a - b).norm() < POSITION));
        }
    }
}

#[test]
fn machine_interface() {
    let run = recorded();
    let mesh: TriangleMesh = run.product().unwrap();
    let mut toolpaths: Vec<CandidateToolpath> = run.products().unwrap();
    toolpaths.sort_by_key(|t| t.index);
    let job = run.job().unwrap();
    let now = evaluate(&toolpaths, &mesh, &job, &MachineParams::default(), &unobserved()).unwrap();
    let then = run.messages::<msg::Evaluation>("machine/evaluation").unwrap();
    let (_, then) = Evaluation::from_msg(&then[0]).unwrap();
    assert_eq!(now.evaluation.chosen, then.chosen);
    for (now, then) in now.evaluation.candidates.iter().zip(&then.candidates) {
        assert_eq!((now.feasible, &now.reason), (then.feasible, &then.reason));
        assert!((now.machining_time - then.machining_time).abs() < 1e-6);
    }
    let program = now.program.unwrap();
    assert_eq!(program.passed.text(), run.product::<Program>().unwrap().text);
    let motion: JointMotion = run.product().unwrap();
    assert_eq!(program.trajectory.len(), motion.times.len());
}
