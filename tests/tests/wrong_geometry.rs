//! Surfaces and jobs that are wrong: each ends in an error that says what, where and what was expected, or in a program that a judge of its
//! own finds right.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

use nalgebra::{Point3, Vector3};
use patchmill_geometry::cutter::Cutter;
use patchmill_machine_interface::MachineParams;
use patchmill_machine_interface::evaluate::{NONE_FEASIBLE, evaluate};
use patchmill_products::job::{Job, Strategy, Tool};
use patchmill_products::selection::{NormalCone, Selection};
use patchmill_products::stage::{Progress, SUPERSEDED, StageError, unobserved};
use patchmill_surface_ingestion::{IngestionParams, SurfaceSource};
use patchmill_tests::bowl::{Facet, stl};
use patchmill_tests::brute_check::{self, POSE_SLACK};
use patchmill_tests::spoilt::{Spoil, good, spoil};
use patchmill_tests::{fixture, plan, plan_source};
use peak_alloc::PeakAlloc;
use proptest::prelude::*;
use proptest::strategy::Strategy as Draw;
use proptest::test_runner::{Config, RngAlgorithm, TestCaseError, TestRng, TestRunner};

#[global_allocator]
static PEAK: PeakAlloc = PeakAlloc;

/// A case that takes longer, on a busy machine too, is a failure and told to stop, which it has to soon.
const PATIENCE: Duration = Duration::from_secs(60);
const STOPS_WITHIN: Duration = Duration::from_secs(20);
/// Most memory of a case, MiB.
const MEMORY: f32 = 1024.0;
/// The welding of vertices, the digits of a program and what its poses hide, m.
const SLACK: f64 = 1e-6 + 0.2e-6 + POSE_SLACK;
/// Least share of the area within the scallop height at the judge's few points.
const COVERED: f64 = 0.99;

/// What a case ends with.
#[derive(Debug)]
enum End {
    Refused(StageError),
    Program(String),
}

fn small(strategy: Strategy) -> Job {
    let tool = Tool::bare(Cutter { r1: 1.0e-3, r2: 1.0e-3 }, 0.1);
    Job { strategy, patches_min: 1, patches_max: 1, tool, ..Job::default_for("") }
}

fn run(source: &SurfaceSource, selection: Selection, job: Job, progress: Progress<'_>) -> End {
    let params = IngestionParams { selection, samples_per_side: 24, ..IngestionParams::default() };
    let whole = || {
        job.check().map_err(|e| e.with_code(600))?;
        let planned = plan_source(source, &params, job.clone(), progress)?;
        evaluate(
            &planned.toolpaths,
            &planned.surface.mesh,
            &planned.job,
            &MachineParams::default(),
            &progress,
        )
    };
    match whole() {
        Ok(output) => End::Program(output.program.unwrap().passed.text().to_owned()),
        Err(e) => End::Refused(e),
    }
}

/// Plans in a thread of its own, and stops it when it takes too long.
fn bounded(bytes: Vec<u8>, selection: Selection, job: Job) -> Result<End, String> {
    static CANCELLED: AtomicBool = AtomicBool::new(false);
    let (sender, receiver) = mpsc::channel();
    let begin = Instant::now();
    CANCELLED.store(false, Ordering::Relaxed);
    PEAK.reset_peak_usage();
    let before = PEAK.current_usage_as_mb();
    let name = "wrong.stl".to_owned();
    let work = std::thread::spawn(move || {
        let source = SurfaceSource::new(bytes, &name, "");
        let progress = Progress { cancelled: &CANCELLED, report: &|_| {} };
        let _ = sender.send(run(&source, selection, job, progress));
    });
    let end = match receiver.recv_timeout(PATIENCE) {
        Ok(end) => Ok(end),
        Err(mpsc::RecvTimeoutError::Disconnected) => Err("it panicked".to_owned()),
        Err(mpsc::RecvTimeoutError::Timeout) => {
            CANCELLED.store(true, Ordering::Relaxed);
            let stopped = receiver.recv_timeout(STOPS_WITHIN).is_ok();
            Err(format!(
                "it took longer than {} s{}",
                PATIENCE.as_secs(),
                if stopped { "" } else { " and could not be stopped" }
            ))
        }
    };
    let memory = PEAK.peak_usage_as_mb() - before;
    if end.is_ok() {
        work.join().map_err(|_| "it panicked".to_owned())?;
    }
    if memory > MEMORY {
        return Err(format!("it took {memory:.0} MiB"));
    }
    if std::env::var_os("WRONG_GEOMETRY_TELLS").is_some() {
        eprintln!("{:.2} s, {memory:.0} MiB", begin.elapsed().as_secs_f64());
    }
    end
}

/// What is wrong with an end, if anything is; `whole`: all of the surface has to be cut.
fn wrong(end: &End, facets: &[Facet], whole: bool, job: &Job) -> Option<String> {
    match end {
        End::Refused(e) => (!is_clear(e)).then(|| format!("the error is not clear: {e}")),
        End::Program(text) => {
            let Cutter { r1, r2 } = job.tool.cutter;
            let tool = brute_check::Tool { r1, r2, length: job.tool.length };
            let height = job.stock_allowance + job.scallop_height + SLACK;
            match brute_check::judge(text, facets, tool, height) {
                Err(e) => Some(format!("the program does not read: {e}")),
                Ok(v) if v.gouge > job.gouge_tolerance + SLACK || v.gouge.is_nan() => {
                    Some(format!("it gouges: {v:?}"))
                }
                Ok(v) if whole && (v.within < COVERED || v.within.is_nan()) => {
                    Some(format!("it leaves material: {v:?}"))
                }
                Ok(_) => None,
            }
        }
    }
}

/// One sentence with a number of its stage, without what a program prints when it does not know better.
fn is_clear(e: &StageError) -> bool {
    let text = &e.text;
    let odd = ["NaN mm at", "Error {", "unwrap", "  ", "\n", "panicked", "Some(", "None"];
    e.code != SUPERSEDED
        && text.len() > 20
        && text.len() < 1500
        && odd.iter().all(|word| !text.contains(word))
}

fn case(name: &str, facets: &[Facet], selection: Selection, job: Job) -> (End, Option<String>) {
    let whole = selection.is_all() && !job.leaves_rest();
    match bounded(stl(facets), selection, job.clone()) {
        Ok(end) => {
            let wrong = wrong(&end, facets, whole, &job);
            if std::env::var_os("WRONG_GEOMETRY_TELLS").is_some() {
                match &end {
                    End::Refused(e) => eprintln!("{name}: {e}"),
                    End::Program(text) => eprintln!("{name}: a program of {} lines", text.lines().count()),
                }
            }
            (end, wrong.map(|wrong| format!("{name}: {wrong}")))
        }
        Err(e) => (End::Program(String::new()), Some(format!("{name}: {e}"))),
    }
}

fn spoilt(ways: &[Spoil]) -> Vec<Facet> {
    let mut facets = good(12);
    ways.iter().for_each(|way| spoil(&mut facets, *way));
    facets
}

/// By hand: what broken exports look like, and what has to come of each. A number is that of the error, 0 a program, −1 either.
#[test]
fn surfaces_that_are_wrong_end_in_an_error_or_a_right_program() {
    let up = [Spoil::Solid(3.0)];
    let cases: Vec<(&str, Vec<Spoil>, i32)> = vec![
        ("as it should be", vec![], 0),
        ("every facet twice", vec![Spoil::Duplicate(0)], 0),
        ("inside out", vec![Spoil::Flip(0)], 0),
        ("every third facet inside out", vec![Spoil::Flip(2)], 0),
        ("collapsed facets", vec![Spoil::Collapse(5), Spoil::Collapse(77), Spoil::Collapse(210)], -1),
        ("needles", vec![Spoil::Needle(5, 1e-3), Spoil::Needle(150, 1e-6)], -1),
        ("a missing facet", vec![Spoil::Delete(130)], 0),
        ("upside down", vec![Spoil::Mirror], 0),
        ("metres read as millimetres", vec![Spoil::Scale(1e-3)], 203),
        ("a nanometre large", vec![Spoil::Scale(1e-7)], 111),
        ("a millionth of a millimetre large", vec![Spoil::Scale(1e-8)], 111),
        ("of no size", vec![Spoil::Scale(0.0)], 111),
        ("nearly of no size", vec![Spoil::Scale(1e-30)], 111),
        ("as large as a town", vec![Spoil::Scale(4e4)], 403),
        ("larger than allowed", vec![Spoil::Scale(1e6)], 111),
        ("a million millimetres away", vec![Spoil::Shift([9.9e5, 0.0, 0.0])], -1),
        ("beyond the limit", vec![Spoil::Shift([0.0, 2e6, 0.0])], 111),
        ("folded to a wall", vec![Spoil::Fold(6.0, 90.0)], -1),
        ("folded beyond the vertical", vec![Spoil::Fold(6.0, 120.0)], -1),
        ("folded back on itself", vec![Spoil::Fold(6.0, 180.0)], -1),
        ("T-junctions", vec![Spoil::TJunction(40, 0.0), Spoil::TJunction(201, 0.002)], -1),
        ("a fin", vec![Spoil::Fin(120, 3.0)], -1),
        ("a low fin", vec![Spoil::Fin(120, 0.1)], -1),
        ("a fin lower than the tolerance", vec![Spoil::Fin(120, 0.003)], -1),
        ("two shells", vec![Spoil::Shell(0.5)], -1),
        ("two shells closer than the tolerance", vec![Spoil::Shell(0.001)], -1),
        ("two shells as near as the welding", vec![Spoil::Shell(1e-6)], 0),
        ("a shell far above", vec![Spoil::Shell(300.0)], -1),
        ("not a number", vec![Spoil::NotFinite(9, f32::NAN)], 111),
        ("infinite", vec![Spoil::NotFinite(10, f32::INFINITY)], 111),
        ("nearly infinite", vec![Spoil::NotFinite(10, f32::MAX)], 111),
        ("one facet", vec![Spoil::Only(33)], 0),
        ("one small facet", vec![Spoil::Only(33), Spoil::Scale(0.01)], -1),
        ("one large facet", vec![Spoil::Only(33), Spoil::Scale(15.0)], -1),
        ("cracks", vec![Spoil::Cracks(1e-4)], -1),
        ("wide cracks", vec![Spoil::Cracks(0.2)], -1),
        ("a spike", vec![Spoil::Spike(150, 4.0)], -1),
        ("a pit", vec![Spoil::Spike(150, -4.0)], 203),
        ("a closed solid", up.to_vec(), 120),
        ("a closed solid inside out", vec![Spoil::Solid(3.0), Spoil::Flip(0)], 120),
        ("a plate of no thickness", vec![Spoil::Solid(0.0)], -1),
        ("facets in any order", vec![Spoil::Shuffle], 0),
    ];
    let mut found = Vec::new();
    for (name, ways, code) in cases {
        let (end, wrong) = case(name, &spoilt(&ways), Selection::default(), small(Strategy::RollingBall));
        found.extend(wrong);
        let came = match &end {
            End::Refused(e) => e.code,
            End::Program(_) => 0,
        };
        if code >= 0 && came != code {
            found.push(format!("{name}: {code} was expected, {end:?} came"));
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Jobs that make no sense on a good surface: each value in turn.
#[test]
fn jobs_that_are_absurd_end_in_an_error_or_a_right_program() {
    const VALUES: [f64; 10] =
        [0.0, -1.0, f64::MIN_POSITIVE, 1e-9, 1e-7, 0.5, 1e3, 1e300, f64::INFINITY, f64::NAN];
    type Field = fn(&mut Job) -> &mut f64;
    let fields: [(&str, Field); 18] = [
        ("r1", |j| &mut j.tool.cutter.r1),
        ("r2", |j| &mut j.tool.cutter.r2),
        ("length", |j| &mut j.tool.length),
        ("flute_length", |j| &mut j.tool.flute_length),
        ("scallop_height", |j| &mut j.scallop_height),
        ("gouge_tolerance", |j| &mut j.gouge_tolerance),
        ("lead_min", |j| &mut j.lead_min),
        ("inclination_max", |j| &mut j.inclination_max),
        ("pass_chord", |j| &mut j.pass_chord),
        ("stock_allowance", |j| &mut j.stock_allowance),
        ("clearance", |j| &mut j.clearance),
        ("feed", |j| &mut j.feed),
        ("spindle_speed", |j| &mut j.spindle_speed),
        ("border_margin", |j| &mut j.border_margin),
        ("lead_radius", |j| &mut j.lead_radius),
        ("acceleration_linear", |j| &mut j.acceleration_linear),
        ("path_tolerance", |j| &mut j.path_tolerance),
        ("rest_lead", |j| &mut j.rest_lead),
    ];
    let facets = spoilt(&[Spoil::Scale(0.5)]);
    let mut found = Vec::new();
    for (name, field) in fields {
        for value in VALUES {
            let mut job = small(Strategy::RollingBall);
            *field(&mut job) = value;
            let (end, wrong) = case(&format!("{name} {value:e}"), &facets, Selection::default(), job);
            found.extend(wrong);
            let meaningless = value.is_nan() || value.is_infinite() || value < 0.0;
            if meaningless && matches!(end, End::Program(_)) {
                found.push(format!("{name} {value:e}: a program came"));
            }
        }
    }
    for [r1, r2] in [[0.0, 1e-6], [1e-6, 0.0], [0.0, 0.5e-6], [0.999, 0.001], [0.0, 1.0]] {
        let tool = Tool::bare(Cutter { r1, r2 }, 0.1);
        let name = format!("r1 {r1:e} r2 {r2:e}");
        let job = Job { tool, ..small(Strategy::RollingBall) };
        found.extend(case(&name, &facets, Selection::default(), job).1);
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

fn ways() -> impl Draw<Value = Spoil> {
    let place = 0usize..100_000;
    let far = prop::sample::select(vec![-9.9e5f32, -1e3, 0.0, 1e3, 9.9e5, 3e6]);
    prop_oneof![
        place.clone().prop_map(Spoil::Duplicate),
        place.clone().prop_map(Spoil::Flip),
        place.clone().prop_map(Spoil::Collapse),
        (place.clone(), prop::sample::select(vec![1e-7f32, 1e-5, 1e-3, 0.05]))
            .prop_map(|(i, w)| Spoil::Needle(i, w)),
        place.clone().prop_map(Spoil::Delete),
        prop::sample::select(vec![1e-9f32, 1e-6, 1e-3, 0.1, 0.5, 1.5, 25.4, 1e3, 1e6]).prop_map(Spoil::Scale),
        (far.clone(), far).prop_map(|(x, z)| Spoil::Shift([x, 0.0, z])),
        (-10f32..10.0, 0f32..200.0).prop_map(|(x, angle)| Spoil::Fold(x, angle)),
        (place.clone(), -0.1f32..0.1).prop_map(|(i, h)| Spoil::TJunction(i, h)),
        (place.clone(), -2f32..2.0).prop_map(|(i, h)| Spoil::Fin(i, h)),
        prop::sample::select(vec![-5.0f32, -0.01, 1e-4, 0.003, 0.05, 8.0]).prop_map(Spoil::Shell),
        place.clone().prop_map(Spoil::Only),
        prop::sample::select(vec![1e-6f32, 1e-4, 0.003, 0.1]).prop_map(Spoil::Cracks),
        (place, -0.5f32..0.5).prop_map(|(i, h)| Spoil::Spike(i, h)),
        Just(Spoil::Mirror),
        prop::sample::select(vec![0.0f32, 0.001, 2.0]).prop_map(Spoil::Solid),
        Just(Spoil::Shuffle),
    ]
}

fn jobs() -> impl Draw<Value = Job> {
    let strategy = prop_oneof![
        6 => Just(Strategy::RollingBall),
        2 => Just(Strategy::Fastest),
        1 => Just(Strategy::FiveAxis),
        1 => Just(Strategy::Sturz),
        1 => Just(Strategy::ThreeAxis),
    ];
    let tools = vec![
        [0.0, 1.0e-3],
        [1.0e-3, 1.0e-3],
        [0.5e-3, 0.3e-3],
        [2e-3, 0.0],
        [0.0, 4e-3],
        [13.05e-3, 6e-3],
        [0.4, 0.3],
    ];
    let tool = prop::sample::select(tools);
    let scallop = prop_oneof![8 => Just(25.4e-6), 1 => Just(5e-6), 1 => Just(1e-3), 1 => Just(1e-7)];
    let gouge = prop_oneof![8 => Just(5e-6), 1 => Just(1e-7), 1 => Just(1e-4)];
    let rest = prop_oneof![7 => Just(0.0), 1 => Just(45f64.to_radians())];
    (strategy, tool, scallop, gouge, rest).prop_map(
        |(strategy, [r1, r2], scallop_height, gouge_tolerance, rest_lead)| Job {
            tool: Tool::bare(Cutter { r1, r2 }, 0.1),
            scallop_height,
            gouge_tolerance,
            rest_lead,
            ..small(strategy)
        },
    )
}

fn selections() -> impl Draw<Value = Selection> {
    let cone = |degrees: f64| {
        let cone = NormalCone { axis: Vector3::z_axis(), angle: degrees.to_radians() };
        Selection { cone: Some(cone), ..Selection::default() }
    };
    prop_oneof![2 => Just(Selection::default()), 1 => Just(cone(50.0)), 1 => Just(cone(89.0))]
}

/// Drawn, the same ones every time; `WRONG_GEOMETRY_CASES` takes more, `WRONG_GEOMETRY_SEED` others.
#[test]
fn spoilt_surfaces_with_any_job_end_in_an_error_or_a_right_program() {
    let number =
        |name: &str, usual: u32| std::env::var(name).ok().and_then(|text| text.parse().ok()).unwrap_or(usual);
    let config = Config {
        cases: number("WRONG_GEOMETRY_CASES", 30),
        max_shrink_iters: 40,
        failure_persistence: None,
        ..Config::default()
    };
    let mut seed = [7u8; 32];
    seed[..4].copy_from_slice(&number("WRONG_GEOMETRY_SEED", 1).to_le_bytes());
    let mut runner = TestRunner::new_with_rng(config, TestRng::from_seed(RngAlgorithm::ChaCha, &seed));
    let drawn = (prop::collection::vec(ways(), 0..4), jobs(), selections());
    let done = runner.run(&drawn, |(ways, job, selection)| {
        let facets = spoilt(&ways);
        let name =
            format!("{ways:?} {:?} {:?} {:?}", job.strategy, job.tool.cutter, selection.cone.is_some());
        match case(&name, &facets, selection, job).1 {
            None => Ok(()),
            Some(wrong) => Err(TestCaseError::fail(wrong)),
        }
    });
    if let Err(e) = done {
        panic!("{e}");
    }
}

/// No program leaves machine_interface without a passed proof: passes that go 0.05 mm too deep, as a whole, in one pass or in one place of
/// the size of the cutter's bottom, are refused with the place.
#[test]
fn a_pass_that_was_shifted_into_the_surface_is_refused() {
    let job = Job { patches_min: 1, patches_max: 1, ..Job::default_for("") };
    let planned = plan(&fixture("small_bezier.json"), job).unwrap();
    let proven = |change: &dyn Fn(usize, usize, &Point3<f64>) -> f64| {
        let mut toolpaths = planned.toolpaths.clone();
        let patch = &mut toolpaths[0].patches[0];
        let axis = patch.tool_axis;
        for (i, pass) in patch.passes.iter_mut().enumerate() {
            for (j, tip) in pass.cl.iter_mut().enumerate() {
                *tip -= axis * change(i, j, tip);
            }
        }
        evaluate(&toolpaths, &planned.surface.mesh, &planned.job, &MachineParams::default(), &unobserved())
    };
    proven(&|_, _, _| 0.0).unwrap();
    let passes = &planned.toolpaths[0].patches[0].passes;
    let (pass, place) = (passes.len() / 2, passes[passes.len() / 2].cl.len() / 2);
    let middle = passes[pass].cl[place];
    type Change = Box<dyn Fn(usize, usize, &Point3<f64>) -> f64>;
    let changes: [(&str, Change); 4] = [
        ("all", Box::new(|_, _, _| 50e-6)),
        ("one pass", Box::new(move |i, _, _| if i == pass { 50e-6 } else { 0.0 })),
        ("one place", Box::new(move |_, _, tip| if (tip - middle).norm() < 1.5e-3 { 50e-6 } else { 0.0 })),
        ("one tip", Box::new(move |i, j, _| if (i, j) == (pass, place) { 50e-6 } else { 0.0 })),
    ];
    for (what, change) in changes {
        let refused = proven(&change).expect_err(what);
        assert_eq!(refused.code, NONE_FEASIBLE, "{what}: {refused}");
        assert!(
            refused.text.contains("the swept check of the program finds a gouge of 0.0"),
            "{what}: {refused}"
        );
    }
}
