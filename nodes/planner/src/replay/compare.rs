//! Compares what was recorded with what live nodes gave, field by field.

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::msg::MachineModel;
use patchmill_products::evaluation::{Evaluation, Proof, ProofSpot, ResidualMap, RestRegion};
use patchmill_products::field::RollingBallField;
use patchmill_products::partition::Partition;
use patchmill_products::program::{JointMotion, PatchPlan, Program};
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;

use super::RunProducts;
use super::report::{FieldReport, Report};
use super::tolerances::{
    EVALUATION, FIELD, MACHINE, MESH, MOTION, PARTITION, PROGRAM, RESIDUAL, ROBOT_DESCRIPTION, SAMPLES,
    STATUS, TOOLPATH,
};

/// Compares everything that both have, and says what only one has.
pub fn compare(recorded: &RunProducts, now: &RunProducts) -> Report {
    let mut report = Report::default();
    let (then_names, now_names) = (recorded.names(), now.names());
    report.missing = then_names.iter().filter(|name| !now_names.contains(name)).cloned().collect();
    report.unrecorded = now_names.into_iter().filter(|name| !then_names.contains(name)).collect();
    both(&recorded.surface_id, &now.surface_id, |then, now| {
        report.field(MESH, "surface_id").exact(String::new, then, now);
    });
    both(&recorded.mesh, &now.mesh, |then, now| mesh(&mut report, then, now));
    both(&recorded.samples, &now.samples, |then, now| samples(&mut report, then, now));
    both(&recorded.field, &now.field, |then, now| field(&mut report, then, now));
    for (index, then) in &recorded.partitions {
        both(&Some(then), &now.partitions.get(index), |then, now| partition(&mut report, then, now));
    }
    for (index, then) in &recorded.toolpaths {
        both(&Some(then), &now.toolpaths.get(index), |then, now| toolpath(&mut report, then, now));
    }
    both(&recorded.evaluation, &now.evaluation, |then, now| evaluation(&mut report, then, now));
    both(&recorded.program, &now.program, |then, now| program(&mut report, then, now));
    both(&recorded.motion, &now.motion, |then, now| motion(&mut report, then, now));
    both(&recorded.residual, &now.residual, |then, now| residual(&mut report, then, now));
    both(&recorded.machine, &now.machine, |then, now| machine(&mut report, then, now));
    both(&recorded.robot_description, &now.robot_description, |then, now| {
        lines(report.field(ROBOT_DESCRIPTION, "data"), then, now);
    });
    for (stage, then) in &recorded.ends {
        let Some(now) = now.ends.get(stage) else { continue };
        let at = || stage.clone();
        let state = |done| if done { "DONE" } else { "FAILED" };
        report.field(STATUS, "state").exact(at, &state(then.done), &state(now.done));
        report.field(STATUS, "code").exact(at, &then.code, &now.code);
        report.field(STATUS, "text of a failure").exact(at, &then.failure, &now.failure);
    }
    report
}

fn both<T>(recorded: &Option<T>, now: &Option<T>, compare: impl FnOnce(&T, &T)) {
    if let (Some(recorded), Some(now)) = (recorded, now) {
        compare(recorded, now);
    }
}

fn numbers(field: &mut FieldReport, at: &str, recorded: &[f64], now: &[f64]) {
    if field.same_length(|| at.to_owned(), recorded.len(), now.len()) {
        for (i, (then, now)) in recorded.iter().zip(now).enumerate() {
            field.number(|| indexed(at, i), *then, *now);
        }
    }
}

fn exacts<T: PartialEq + std::fmt::Debug>(field: &mut FieldReport, at: &str, recorded: &[T], now: &[T]) {
    if field.same_length(|| at.to_owned(), recorded.len(), now.len()) {
        for (i, (then, now)) in recorded.iter().zip(now).enumerate() {
            field.exact(|| indexed(at, i), then, now);
        }
    }
}

/// Points or vectors.
fn vectors<V: Copy + Into<[f64; 3]>>(field: &mut FieldReport, at: &str, recorded: &[V], now: &[V]) {
    if field.same_length(|| at.to_owned(), recorded.len(), now.len()) {
        for (i, (then, now)) in recorded.iter().zip(now).enumerate() {
            field.vector(|| indexed(at, i), (*then).into(), (*now).into());
        }
    }
}

/// Texts line by line.
fn lines(field: &mut FieldReport, recorded: &str, now: &str) {
    let (then, now): (Vec<&str>, Vec<&str>) = (recorded.lines().collect(), now.lines().collect());
    field.same_length(|| "lines".to_owned(), then.len(), now.len());
    for (i, (then, now)) in then.iter().zip(&now).enumerate() {
        field.exact(|| format!("line {}", i + 1), then, now);
    }
}

fn indexed(at: &str, index: usize) -> String {
    if at.is_empty() { format!("[{index}]") } else { format!("{at}, [{index}]") }
}

fn mesh(report: &mut Report, then: &TriangleMesh, now: &TriangleMesh) {
    vectors(report.field(MESH, "vertices"), "", &then.vertices, &now.vertices);
    vectors(report.field(MESH, "normals"), "", &then.normals, &now.normals);
    exacts(report.field(MESH, "triangles"), "", &then.triangles, &now.triangles);
    // Facet by facet, so that it counts as compared where no facet is marked as well.
    let marks = |mesh: &TriangleMesh| -> Vec<bool> {
        (0..mesh.triangles.len()).map(|t| !mesh.is_finished(t)).collect()
    };
    exacts(report.field(MESH, "check_only"), "", &marks(then), &marks(now));
    report.field(MESH, "chord_error").number(String::new, then.chord_error, now.chord_error);
}

fn samples(report: &mut Report, then: &SurfaceSamples, now: &SurfaceSamples) {
    report.field(SAMPLES, "grid").exact(String::new, &then.grid, &now.grid);
    vectors(report.field(SAMPLES, "points"), "", &then.points, &now.points);
    vectors(report.field(SAMPLES, "normals"), "", &then.normals, &now.normals);
    numbers(report.field(SAMPLES, "curvature_max"), "", &then.curvature_max, &now.curvature_max);
    numbers(report.field(SAMPLES, "curvature_min"), "", &then.curvature_min, &now.curvature_min);
    vectors(report.field(SAMPLES, "direction_max"), "", &then.direction_max, &now.direction_max);
    numbers(report.field(SAMPLES, "area"), "", &then.area, &now.area);
}

fn field(report: &mut Report, then: &RollingBallField, now: &RollingBallField) {
    numbers(report.field(FIELD, "pseudo_curvature"), "", &then.pseudo_curvature, &now.pseudo_curvature);
    vectors(report.field(FIELD, "contact"), "", &then.contact, &now.contact);
    report.field(FIELD, "shadow_radius").number(String::new, then.shadow_radius, now.shadow_radius);
}

fn partition(report: &mut Report, then: &Partition, now: &Partition) {
    let at = format!("candidate {}", then.index);
    report.field(PARTITION, "count").exact(|| at.clone(), &then.count, &now.count);
    let (mean, scale) = (&then.feature_mean, &then.feature_scale);
    numbers(report.field(PARTITION, "feature_mean"), &at, mean.as_slice(), now.feature_mean.as_slice());
    numbers(report.field(PARTITION, "feature_scale"), &at, scale.as_slice(), now.feature_scale.as_slice());
    exacts(report.field(PARTITION, "labels"), &at, &then.labels, &now.labels);
    report.field(PARTITION, "inertia").number(|| at.clone(), then.inertia, now.inertia);
    let patches = report.field(PARTITION, "patches.mean");
    if !patches.same_length(|| format!("{at}, patches"), then.patches.len(), now.patches.len()) {
        return;
    }
    for (i, (then, now)) in then.patches.iter().zip(&now.patches).enumerate() {
        let at = format!("{at}, patch {i}");
        numbers(report.field(PARTITION, "patches.mean"), &at, then.mean.as_slice(), now.mean.as_slice());
        let covariances = (then.covariance.as_slice(), now.covariance.as_slice());
        numbers(report.field(PARTITION, "patches.covariance"), &at, covariances.0, covariances.1);
        let counts = report.field(PARTITION, "patches.sample_count");
        counts.exact(|| at.clone(), &then.sample_count, &now.sample_count);
        exacts(report.field(PARTITION, "patches.parts"), &at, &then.parts, &now.parts);
    }
}

fn toolpath(report: &mut Report, then: &CandidateToolpath, now: &CandidateToolpath) {
    let at = format!("candidate {}", then.index);
    report.field(TOOLPATH, "count").exact(|| at.clone(), &then.count, &now.count);
    report.field(TOOLPATH, "patch_count").exact(|| at.clone(), &then.patch_count, &now.patch_count);
    let reasons = report.field(TOOLPATH, "infeasible_reason");
    reasons.exact(|| at.clone(), &then.infeasible_reason, &now.infeasible_reason);
    let areas = report.field(TOOLPATH, "area_within_scallop");
    areas.number(|| at.clone(), then.area_within_scallop, now.area_within_scallop);
    report.field(TOOLPATH, "gouge_max").number(|| at.clone(), then.gouge_max, now.gouge_max);
    let patches = report.field(TOOLPATH, "patches.patch");
    if !patches.same_length(|| format!("{at}, patches"), then.patches.len(), now.patches.len()) {
        return;
    }
    for (i, (then, now)) in then.patches.iter().zip(&now.patches).enumerate() {
        let at = format!("{at}, patch {i}");
        plan(report, TOOLPATH, &at, &PatchPlan::from(then), &PatchPlan::from(now));
        for (p, (then, now)) in then.passes.iter().zip(&now.passes).enumerate() {
            let at = format!("{at}, pass {p}");
            vectors(report.field(TOOLPATH, "passes.cl"), &at, &then.cl, &now.cl);
            vectors(report.field(TOOLPATH, "passes.cc"), &at, &then.cc, &now.cc);
            let heights = report.field(TOOLPATH, "passes.retract_height");
            heights.number(|| at.clone(), then.retract_height, now.retract_height);
        }
    }
}

/// A patch without its passes, of a toolpath or a program.
fn plan(report: &mut Report, product: &str, at: &str, then: &PatchPlan, now: &PatchPlan) {
    let at = || at.to_owned();
    report.field(product, "patches.patch").exact(at, &then.patch, &now.patch);
    report.field(product, "patches.tool_axis").vector(at, then.tool_axis.into(), now.tool_axis.into());
    let directions = report.field(product, "patches.feed_direction");
    directions.vector(at, then.feed_direction.into(), now.feed_direction.into());
    let curvatures = report.field(product, "patches.pseudo_curvature_max");
    curvatures.number(at, then.pseudo_curvature_max, now.pseudo_curvature_max);
    report.field(product, "patches.sample_count").exact(at, &then.sample_count, &now.sample_count);
    numbers(report.field(product, "patches.step_over"), &at(), &then.step_over, &now.step_over);
    report.field(product, "patches.area").number(at, then.area, now.area);
    report.field(product, "patches.pass_count").exact(at, &then.pass_count, &now.pass_count);
}

fn evaluation(report: &mut Report, then: &Evaluation, now: &Evaluation) {
    let chosen = report.field(EVALUATION, "chosen");
    chosen.exact(String::new, &then.chosen, &now.chosen);
    let counts = report.field(EVALUATION, "candidates.patch_count");
    if !counts.same_length(|| "candidates".to_owned(), then.candidates.len(), now.candidates.len()) {
        return;
    }
    for (then, now) in then.candidates.iter().zip(&now.candidates) {
        let at = || format!("candidate {}", then.index);
        report.field(EVALUATION, "candidates.patch_count").exact(at, &then.patch_count, &now.patch_count);
        report.field(EVALUATION, "candidates.feasible").exact(at, &then.feasible, &now.feasible);
        report.field(EVALUATION, "candidates.reason").exact(at, &then.reason, &now.reason);
        let times = report.field(EVALUATION, "candidates.machining_time");
        times.number(at, then.machining_time, now.machining_time);
        report.field(EVALUATION, "candidates.cut_length").number(at, then.cut_length, now.cut_length);
        report.field(EVALUATION, "candidates.rapid_length").number(at, then.rapid_length, now.rapid_length);
        report.field(EVALUATION, "candidates.index_moves").exact(at, &then.index_moves, &now.index_moves);
    }
}

fn program(report: &mut Report, then: &Program, now: &Program) {
    let here = String::new;
    lines(report.field(PROGRAM, "text"), &then.text, &now.text);
    report.field(PROGRAM, "block_count").exact(here, &then.block_count, &now.block_count);
    report.field(PROGRAM, "candidate_index").exact(here, &then.candidate_index, &now.candidate_index);
    report.field(PROGRAM, "machining_time").number(here, then.machining_time, now.machining_time);
    report.field(PROGRAM, "cut_length").number(here, then.cut_length, now.cut_length);
    let (t, n) = (&then.proof, &now.proof);
    report.field(PROGRAM, "proof.gouge_max").number(here, t.gouge_max, n.gouge_max);
    report.field(PROGRAM, "proof.scallop_max").number(here, t.scallop_max, n.scallop_max);
    let percentiles = report.field(PROGRAM, "proof.scallop_percentiles");
    percentiles.number(|| "p50".to_owned(), t.scallop_p50, n.scallop_p50);
    percentiles.number(|| "p90".to_owned(), t.scallop_p90, n.scallop_p90);
    percentiles.number(|| "p99".to_owned(), t.scallop_p99, n.scallop_p99);
    percentiles.number(|| "p999".to_owned(), t.scallop_p999, n.scallop_p999);
    for (name, then, now) in
        [("proof.deepest", &t.deepest, &n.deepest), ("proof.highest", &t.highest, &n.highest)]
    {
        let spots = report.field(PROGRAM, name);
        if spots.same_length(String::new, then.len(), now.len()) {
            let numbers = |spot: &ProofSpot| <[f64; 3]>::from(spot.position);
            for (i, (then, now)) in then.iter().zip(now).enumerate() {
                spots.vector(|| indexed("", i), numbers(then), numbers(now));
                spots.number(|| indexed("leftover", i), then.leftover, now.leftover);
            }
        }
    }
    let within = report.field(PROGRAM, "proof.area_within_scallop");
    within.number(here, t.area_within_scallop, n.area_within_scallop);
    report.field(PROGRAM, "proof.uncut_area").number(here, t.uncut_area, n.uncut_area);
    rest(report, t, n);
    lines(report.field(PROGRAM, "machine_urdf"), &then.machine_urdf, &now.machine_urdf);
    let patches = report.field(PROGRAM, "patches.patch");
    if !patches.same_length(|| "patches".to_owned(), then.patches.len(), now.patches.len()) {
        return;
    }
    for (i, (then, now)) in then.patches.iter().zip(&now.patches).enumerate() {
        let at = format!("patch {i}");
        plan(report, PROGRAM, &at, &then.plan, &now.plan);
        exacts(report.field(PROGRAM, "patches.rotary_names"), &at, &then.rotary_names, &now.rotary_names);
        let rotary = (&then.rotary_positions, &now.rotary_positions);
        numbers(report.field(PROGRAM, "patches.rotary_positions"), &at, rotary.0, rotary.1);
        let times = report.field(PROGRAM, "patches.machining_time");
        times.number(|| at.clone(), then.machining_time, now.machining_time);
        report.field(PROGRAM, "patches.cut_length").number(|| at.clone(), then.cut_length, now.cut_length);
    }
}

fn rest(report: &mut Report, then: &Proof, now: &Proof) {
    report.field(PROGRAM, "proof.rest_area").number(String::new, then.rest_area, now.rest_area);
    // Region by region; that there are as many counts as compared where there is none as well.
    let numbers_of = |region: &RestRegion| {
        let [low, high] = region.bounds;
        [region.position, low, high].map(<[f64; 3]>::from).concat()
    };
    for field in ["proof.rest", "proof.rest.area"] {
        report.field(PROGRAM, field).exact(|| "regions".to_owned(), &then.rest.len(), &now.rest.len());
    }
    for (i, (then, now)) in then.rest.iter().zip(&now.rest).enumerate() {
        let places = report.field(PROGRAM, "proof.rest");
        numbers(places, &format!("region {i}"), &numbers_of(then), &numbers_of(now));
        places.number(|| format!("region {i}, ball"), then.ball_radius, now.ball_radius);
        places.number(|| format!("region {i}, leftover"), then.leftover_max, now.leftover_max);
        report.field(PROGRAM, "proof.rest.area").number(|| format!("region {i}"), then.area, now.area);
    }
}

fn motion(report: &mut Report, then: &JointMotion, now: &JointMotion) {
    exacts(report.field(MOTION, "joint_names"), "", &then.joint_names, &now.joint_names);
    numbers(report.field(MOTION, "times"), "", &then.times, &now.times);
    numbers(report.field(MOTION, "positions"), "", &then.positions, &now.positions);
    numbers(report.field(MOTION, "velocities"), "", &then.velocities, &now.velocities);
}

fn residual(report: &mut Report, then: &ResidualMap, now: &ResidualMap) {
    vectors(report.field(RESIDUAL, "points"), "", &then.points, &now.points);
    numbers(report.field(RESIDUAL, "leftover"), "", &then.leftover, &now.leftover);
}

fn machine(report: &mut Report, then: &MachineModel, now: &MachineModel) {
    report.field(MACHINE, "name").exact(String::new, &then.name, &now.name);
    lines(report.field(MACHINE, "urdf"), &then.urdf, &now.urdf);
    let names = report.field(MACHINE, "axes.joint_name");
    if !names.same_length(|| "axes".to_owned(), then.axes.len(), now.axes.len()) {
        return;
    }
    for (i, (then, now)) in then.axes.iter().zip(&now.axes).enumerate() {
        let at = || format!("axis {i}");
        report.field(MACHINE, "axes.joint_name").exact(at, &then.joint_name, &now.joint_name);
        report.field(MACHINE, "axes.letter").exact(at, &then.letter, &now.letter);
        report.field(MACHINE, "axes.kind").exact(at, &then.kind, &now.kind);
        let limits = |a: &patchmill_msgs::msg::AxisModel| (a.limited, a.lower, a.upper);
        report.field(MACHINE, "axes.limits").exact(at, &limits(then), &limits(now));
        report.field(MACHINE, "axes.velocity").number(at, then.velocity, now.velocity);
        report.field(MACHINE, "axes.acceleration").number(at, then.acceleration, now.acceleration);
    }
}
