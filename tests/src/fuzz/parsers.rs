//! The table of parsers: everything that reads what somebody else has written.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use clap::Parser as _;
use patchmill_bag_recorder::BagMessage;
use patchmill_kinematics::{
    Accelerations, Machine, Mount, collision_meshes, missing_collision_meshes, mount_of, with_mount,
    with_tool_tip,
};
use patchmill_machine_interface::linuxcnc::protocol;
use patchmill_machine_interface::{DEFAULT_MACHINE_URDF, gcode};
use patchmill_node_runtime::Arguments;
use patchmill_planner::options::CommandLine;
use patchmill_planner::{job_file, replay, select_option, tool_option};
use patchmill_products::stage::unobserved;
use patchmill_surface_ingestion::expression::Expression;
use patchmill_surface_ingestion::{
    IngestionParams, SurfaceSource, grid_samples, ingest, read_raw, step, surface_file,
};
use tempfile::TempDir;

use super::messages::{checked_messages, every_message};
use super::{Parser, seeds};

/// Chord tolerance of STEP faces, m: coarse, the text is what counts.
const STEP_CHORD: f64 = 1e-4;
/// Limits of what is made of a small input.
const STEP_TRIANGLES: usize = 100_000;
const ACCELERATIONS: Accelerations = Accelerations { linear: 5.0, rotary: 20.0 };
const TOOL_LENGTH: f64 = 0.1;

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// A folder for files that are read again and again: in memory where there is such a place.
///
/// # Errors
/// When it cannot be made.
pub fn scratch() -> std::io::Result<TempDir> {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { TempDir::new_in(memory) } else { TempDir::new() }
}

/// All parsers. Those that read files get a folder of their own in `scratch`.
///
/// # Errors
/// When the golden bag or the default machine cannot be read or no folder can be made.
pub fn parsers(recorded: &[BagMessage], scratch: &Path) -> Outcome<Vec<Parser>> {
    let mut all = surfaces();
    all.extend(texts(recorded)?);
    all.push(parameters(TempDir::new_in(scratch)?));
    all.push(job_files(TempDir::new_in(scratch)?));
    all.push(bag("bag", recorded, TempDir::new_in(scratch)?, |folder| {
        replay::recorded::load(folder).is_ok()
    }));
    all.push(bag("bag_repair", recorded, TempDir::new_in(scratch)?, |folder| {
        patchmill_bag_recorder::repair(folder).is_ok()
    }));
    all.extend(checked_messages(recorded));
    all.extend(every_message(recorded));
    Ok(all)
}

fn surfaces() -> Vec<Parser> {
    let file = |name: &str| {
        let name = format!("a.{name}");
        move |bytes: &[u8]| {
            read_raw(&SurfaceSource::new(bytes.to_vec(), &name, "mm"), &IngestionParams::default()).is_ok()
        }
    };
    vec![
        Parser::new("stl", seeds::stl(), file("stl")),
        Parser::new("obj", seeds::obj(), file("obj")),
        Parser::new("ply", seeds::ply(), file("ply")),
        Parser::new("pcd", seeds::pcd(), file("pcd")),
        Parser::new("xyz", seeds::xyz(), file("xyz")),
        Parser::new("3mf", seeds::three_mf(), file("3mf")),
        // With the sums of a ZIP right whatever the model.
        Parser::new("3mf_model", seeds::models(), {
            let package_is_read = file("3mf");
            move |bytes| package_is_read(&seeds::package(bytes, false))
        }),
        Parser::new("json", seeds::json(), surface_is_evaluated),
        Parser::new("step", seeds::step(), |bytes| {
            step::part21::parse(bytes).and_then(|instances| step::model::read(&instances)).is_ok()
        }),
        Parser::new("step_mesh", seeds::step(), |bytes| {
            step::read(bytes, "a.step", STEP_CHORD, STEP_TRIANGLES, true, unobserved()).is_ok()
        }),
        Parser::new("ingest", [seeds::stl(), seeds::ply(), seeds::pcd()].concat(), whole_surface_is_made),
    ]
}

fn surface_is_evaluated(bytes: &[u8]) -> bool {
    let Ok(surface) = surface_file::parse(bytes, "a.json", "mm") else { return false };
    for (u, v) in [(0.0, 0.0), (0.3, 0.7), (1.0, 1.0)] {
        let _ = (surface.at(u, v), surface.place(u, v));
    }
    grid_samples::grid_samples(surface.as_ref(), 5).is_ok()
}

/// The whole stage, the kind told by the content.
fn whole_surface_is_made(bytes: &[u8]) -> bool {
    let params = IngestionParams { samples_per_side: 3, ..IngestionParams::default() };
    ingest(&SurfaceSource::new(bytes.to_vec(), "a", "mm"), &params, unobserved()).is_ok()
}

fn texts(recorded: &[BagMessage]) -> Outcome<Vec<Parser>> {
    let machine = Machine::from_urdf(DEFAULT_MACHINE_URDF, TOOL_LENGTH, ACCELERATIONS)?;
    let zero = machine.zero_offset()?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    Ok(vec![
        Parser::new("expression", seeds::expressions(), move |bytes| {
            Expression::parse(&text(bytes)).is_ok_and(|formula| {
                let _ = (formula.at(0.5, -0.5), formula.at(0.0, 0.0));
                true
            })
        }),
        Parser::new("urdf", seeds::urdf(), move |bytes| machine_is_read(&text(bytes))),
        Parser::new("gcode", seeds::programs(recorded), move |bytes| {
            let text = text(bytes);
            let _ = gcode::path_tolerance(&text);
            gcode::read(&text, &machine, &zero, gcode::MOST_MOVES).is_ok()
        }),
        Parser::new("linuxcnc", seeds::linuxcnc(), answers_are_read),
        Parser::new("options", seeds::options(), move |bytes| options_are_read(&text(bytes))),
    ])
}

fn machine_is_read(text: &str) -> bool {
    let _ = (missing_collision_meshes(text), collision_meshes(text), mount_of(text));
    let mounted = with_mount(text, &Mount { xyz: [0.1, 0.2, 0.3], rpy: [0.0, 0.1, 0.0] });
    let _ = mounted.and_then(|text| with_tool_tip(&text, TOOL_LENGTH, 0.01));
    Machine::from_urdf(text, TOOL_LENGTH, ACCELERATIONS).is_ok_and(|machine| machine.zero_offset().is_ok())
}

/// Lines off the connection, each as the answer to every question.
fn answers_are_read(bytes: &[u8]) -> bool {
    let mut stream = bytes;
    let mut understood = false;
    while let Ok(Some(line)) = protocol::read_line(&mut stream) {
        for word in
            ["HELLO", "SET VERBOSE", "PROGRAM_STATUS", "ERROR", "JOINT_HOMED", "JOINT_POS", "PROGRAM_LINE"]
        {
            let Some(rest) = protocol::rest_of(&line, word) else { continue };
            understood |=
                protocol::program_status(rest).is_some() | protocol::joint_positions(rest).is_some();
            let _ = (protocol::all_homed(rest), protocol::program_line(rest), protocol::error(rest));
        }
    }
    understood
}

fn options_are_read(text: &str) -> bool {
    let line = CommandLine::try_parse_from(std::iter::once("patchmill").chain(text.split_whitespace()));
    let condition = select_option::condition(text);
    tool_option::tool(text).is_ok() | tool_option::holder(text).is_ok() | condition.is_ok() | line.is_ok()
}

/// A parameter file and, as long as it has one line, a parameter as typed.
fn parameters(folder: TempDir) -> Parser {
    Parser::new("parameters", seeds::parameters(), move |bytes| {
        let file = folder.path().join("a.yaml");
        if std::fs::write(&file, bytes).is_err() {
            return false;
        }
        let parse = |option: &str, value: String| {
            let line = ["--ros-args".to_owned(), option.to_owned(), value];
            Arguments::parse(line, "patchmill", |_| None).is_ok()
        };
        let typed = String::from_utf8_lossy(bytes).into_owned();
        parse("--params-file", file.to_string_lossy().into_owned())
            | parse("-p", format!("name:={typed}"))
            | parse("-p", typed.clone())
            | parse("-r", typed)
    })
}

/// The file of `--job`, up to the options' own parsers.
fn job_files(folder: TempDir) -> Parser {
    let file = folder.path().join("job.yaml");
    let line = ["patchmill", "plan", "--job", &file.to_string_lossy()].map(OsString::from).to_vec();
    Parser::new("job_file", seeds::job_files(), move |bytes| {
        let _held = &folder;
        std::fs::write(&file, bytes).is_ok()
            && job_file::merged(line.clone())
                .is_ok_and(|merged| CommandLine::try_parse_from(merged.arguments).is_ok())
    })
}

fn bag(name: &str, recorded: &[BagMessage], folder: TempDir, read: fn(&Path) -> bool) -> Parser {
    let file: PathBuf = folder.path().join("bag_0.mcap");
    Parser::new(name, seeds::bags(recorded), move |bytes| {
        std::fs::write(&file, bytes).is_ok() && read(folder.path())
    })
}
