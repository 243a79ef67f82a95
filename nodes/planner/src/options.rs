//! The command line of `patchmill`: machinists' units (mm, mm/min, degrees, rpm), converted once, here.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use patchmill_machine_interface::dialect::Dialect;
use patchmill_machine_interface::linuxcnc::config::DEFAULT_PORT;
use patchmill_node_runtime::topics::nodes;
use patchmill_products::job::{Job, Strategy, Tool};

use crate::job_file::Effective;
use crate::job_options::{JobOptions, number, positive};
use crate::node_parameters::ParameterOptions;
use crate::select_option::{Condition, condition};
use crate::tool_option::{largest_first, tool};

/// Plans 3½½-axis finishing of free-form surfaces as ROS 2 nodes over DDS.
#[derive(Debug, Parser)]
#[command(name = "patchmill", version, about, arg_required_else_help = true)]
pub struct CommandLine {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Plan a surface: a checked program, the machine, a bag of the run and a summary.
    Plan(Box<PlanOptions>),
    /// Plan a surface by every method at the same conditions and put them side by side in one table.
    Compare(Box<CompareOptions>),
    /// Run all nodes in this process until interrupted.
    Up(UpOptions),
    /// Feed a recorded run into live nodes and report what differs (exit code 0: the same, 1: differs, 2: not done).
    Replay(Box<ReplayOptions>),
    /// Write a finished plan's program for other controls.
    Dialect(DialectOptions),
    /// Run a planned program on a controller and follow it to its end; Ctrl-C aborts it.
    Execute(ExecuteOptions),
    /// Write the configuration of a LinuxCNC simulation of a machine, made from its URDF.
    LinuxcncConfig(LinuxcncConfigOptions),
    /// Write report.html of a finished plan anew, from its bag.
    Report(ReportOptions),
    /// Draw a picture of a finished plan, without a browser.
    Plot(PlotOptions),
    /// Look after bags.
    #[command(subcommand)]
    Bag(BagCommand),
    /// Look at what the stack needs of this machine and say what to do about what is amiss (exit code 1: something is).
    Doctor(DoctorOptions),
    /// Print the completions of a shell.
    Completions(CompletionsOptions),
    /// Print the manual page of the command or of a subcommand.
    Man(ManOptions),
}

impl Command {
    /// Whether one JSON document is wanted on stdout.
    pub fn is_json(&self) -> bool {
        match self {
            Self::Plan(options) => options.run.json,
            Self::Compare(options) => options.run.json,
            Self::Replay(options) => options.json,
            Self::Doctor(options) => options.json,
            Self::Bag(BagCommand::Repair { json, .. }) => *json,
            _ => false,
        }
    }
}

/// Options of `patchmill plan`.
#[derive(Args, Debug)]
pub struct PlanOptions {
    /// Surface: JSON (Bézier, NURBS or algebraic), STEP, a mesh (STL, PLY, OBJ, 3MF) or scanned points (PLY, XYZ, PCD); its +Z side is
    /// machined
    #[arg(required_unless_present = "cloud")]
    pub surface: Option<PathBuf>,
    /// Instead of SURFACE the newest sensor_msgs/PointCloud2 that the running stack's topic surface_ingestion/points has had
    #[arg(long, conflicts_with_all = ["surface", "units"], requires = "domain")]
    pub cloud: bool,
    /// Longest wait for a cloud where none has come yet, s
    #[arg(long, value_name = "S", default_value = "30", value_parser = cloud_wait, requires = "cloud", allow_hyphen_values = true)]
    pub cloud_wait: f64,
    /// Folder for program.ngc, machine.urdf, summary.json, job.yaml, report.html and bag/
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Tool in mm: r1 = axis to corner centre (0: ball-end), r2 = corner radius (0: flat-end), length = stick-out, nose to
    /// tip; flute = tip to the top of the flutes (default: up to the holder), shank = diameter above them (default: the
    /// cutter's). Given several times, the largest one that can make the surface is taken
    #[arg(long, value_name = "r1=MM,r2=MM,length=MM,flute=MM,shank=MM", default_value = "r1=13.05,r2=6,length=100", value_parser = tool)]
    pub tool: Vec<Tool>,
    /// Finish only what the plan in this folder, made with --allow-rest of the same surface, has left standing
    #[arg(long, value_name = "DIR", conflicts_with = "cloud")]
    pub rest_of: Option<PathBuf>,
    /// How tool axes and passes are chosen
    #[arg(long, value_enum, default_value = "fastest")]
    pub strategy: StrategyOption,
    /// Numbers of patches tried: one number or an inclusive range; default: 1..8, with a strategy of one patch: 1
    #[arg(long, value_name = "N|N..M", value_parser = patch_range)]
    pub patches: Option<RangeInclusive<u8>>,
    /// Everything else of the job.
    #[command(flatten)]
    pub job: JobOptions,
    /// Parameters of the nodes.
    #[command(flatten)]
    pub parameters: ParameterOptions,
    /// Write the program for this control too, in tilted work planes; may be given several times
    #[arg(long, value_enum, value_name = "CONTROL")]
    pub dialect: Vec<DialectOption>,
    /// Join the stack that runs on this ROS domain instead of starting one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=232))]
    pub domain: Option<u16>,
    /// Namespace of that stack; default: /patchmill
    #[arg(long, value_name = "/NAME", requires = "domain")]
    pub namespace: Option<String>,
    /// The job file, and how the command tells.
    #[command(flatten)]
    pub run: RunOptions,
}

/// What `plan` and `compare` share besides the job.
#[derive(Args, Debug)]
pub struct RunOptions {
    /// Job file: the options of this command as YAML, as DIR/job.yaml has them; what is typed outweighs it
    #[arg(long = "job", value_name = "FILE")]
    pub job_file: Option<PathBuf>,
    /// Print the result as one JSON document
    #[arg(long)]
    pub json: bool,
    /// Print a line a stage instead of the bar, and the log of the nodes that are started
    #[arg(long, short)]
    pub verbose: bool,
    /// All options as they were read, for job.yaml.
    #[arg(skip)]
    pub effective: Effective,
}

/// Options of `patchmill compare`.
#[derive(Args, Debug)]
pub struct CompareOptions {
    /// Surface: JSON (Bézier, NURBS or algebraic), STEP, a mesh (STL, PLY, OBJ, 3MF) or scanned points (PLY, XYZ, PCD); its +Z side is
    /// machined
    pub surface: PathBuf,
    /// Folder for compare.md, compare.json, job.yaml and, a folder each, the programs
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Tool in mm, as for `plan`; Sturz milling may take a smaller one
    #[arg(long, value_name = "r1=MM,r2=MM,length=MM,flute=MM,shank=MM", default_value = "r1=13.05,r2=6,length=100", value_parser = tool)]
    pub tool: Tool,
    /// A tool in stock that Sturz milling may take; may be given several times; default: toroidal cutters of 32, 25, 20, 16, 12,
    /// 10, 8 and 6 mm with a corner radius of a quarter of that
    #[arg(long, value_name = "r1=MM,r2=MM,length=MM", value_parser = tool)]
    pub stock: Vec<Tool>,
    /// Numbers of patches of the paper's method, each planned on its own
    #[arg(long, value_name = "N|N..M", default_value = "1..8", value_parser = patch_range)]
    pub patches: RangeInclusive<u8>,
    /// Everything else of the job.
    #[command(flatten)]
    pub job: JobOptions,
    /// Parameters of the nodes.
    #[command(flatten)]
    pub parameters: ParameterOptions,
    /// The job file, and how the command tells.
    #[command(flatten)]
    pub run: RunOptions,
}

/// Options of `patchmill up`.
#[derive(Args, Debug)]
pub struct UpOptions {
    /// ROS domain; default: ROS_DOMAIN_ID, else 0
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=232))]
    pub domain: Option<u16>,
    /// Folder that surfaces may be loaded from; default: the parameter surface_directory, else the present one
    #[arg(long, value_name = "DIR")]
    pub surfaces: Option<PathBuf>,
    /// The machine: a shipped one's name or an own URDF; default: xyzac
    #[arg(long, value_name = "NAME|FILE.urdf")]
    pub machine: Option<PathBuf>,
    /// Parameters of the nodes.
    #[command(flatten)]
    pub parameters: ParameterOptions,
    /// Record a bag of everything into this folder (it must not exist yet)
    #[arg(long, value_name = "DIR")]
    pub bag: Option<PathBuf>,
    /// Serve every topic to Foxglove on a WebSocket of this machine; default port: 8765; 0: any free one
    #[arg(long, value_name = "PORT", num_args = 0..=1, default_missing_value = "8765")]
    pub foxglove: Option<u16>,
}

/// Options of `patchmill replay`.
#[derive(Args, Debug)]
pub struct ReplayOptions {
    /// Folder of the bag; the last job in it is replayed
    pub bag: PathBuf,
    /// First stage that runs: what comes before it is fed from the bag, what it and later ones give is compared
    #[arg(long, value_enum, value_name = "STAGE")]
    pub from: StageOption,
    /// The surface's file, for --from surface_ingestion
    #[arg(long, value_name = "FILE")]
    pub surface: Option<PathBuf>,
    /// Unit of a mesh or of points that name none: mm, m or in; default mm
    #[arg(long, value_name = "UNIT", value_parser = ["mm", "m", "in"])]
    pub units: Option<String>,
    /// What of the surface is to be finished, as for `plan`, for --from surface_ingestion; may be given several times
    #[arg(long, value_name = "CONDITION", value_parser = condition, allow_hyphen_values = true)]
    pub select: Vec<Condition>,
    /// The plan whose rest was finished, as for `plan`, for --from surface_ingestion
    #[arg(long, value_name = "DIR")]
    pub rest_of: Option<PathBuf>,
    /// The machine (a shipped one's name or an own URDF) where the recorded job brings none; default: xyzac
    #[arg(long, value_name = "NAME|FILE.urdf")]
    pub machine: Option<PathBuf>,
    /// Use the nodes that run on this ROS domain (STAGE and all later ones, none before) instead of starting them
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=232))]
    pub domain: Option<u16>,
    /// Longest silence of all stages before the replay is given up, s
    #[arg(long, value_name = "S", default_value = "120", value_parser = clap::value_parser!(u64).range(1..=86_400))]
    pub silence: u64,
    /// Print the report as one JSON document
    #[arg(long)]
    pub json: bool,
    /// Print a line a stage instead of the bar, and the log of the nodes that are started
    #[arg(long, short)]
    pub verbose: bool,
}

/// Options of `patchmill dialect`.
#[derive(Args, Debug)]
pub struct DialectOptions {
    /// Folder of a plan: program.ngc, machine.urdf, summary.json
    pub plan: PathBuf,
    /// The control; may be given several times
    #[arg(long, value_enum, value_name = "CONTROL", required = true)]
    pub to: Vec<DialectOption>,
}

/// A control as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DialectOption {
    /// program.ngc, RS-274 in joint coordinates: always written
    Linuxcnc,
    /// program.mpf, planes by CYCLE800
    Siemens,
    /// program.h, planes by PLANE SPATIAL
    Heidenhain,
    /// program.nc, planes by G68.2
    Fanuc,
}

impl DialectOption {
    /// The dialects beside program.ngc that were asked for, each once, in their own order.
    pub fn wanted(options: &[Self]) -> Vec<Dialect> {
        let asked = |dialect: &Dialect| {
            options.contains(&match dialect {
                Dialect::Siemens => Self::Siemens,
                Dialect::Heidenhain => Self::Heidenhain,
                Dialect::Fanuc => Self::Fanuc,
            })
        };
        Dialect::ALL.into_iter().filter(asked).collect()
    }
}

/// Options of `patchmill report`.
#[derive(Args, Debug)]
pub struct ReportOptions {
    /// Folder of a plan: summary.json, bag/
    pub plan: PathBuf,
}

/// Options of `patchmill plot`.
#[derive(Args, Debug)]
pub struct PlotOptions {
    /// Folder of a plan: summary.json, bag/
    pub plan: PathBuf,
    /// What the picture shows
    #[arg(long, value_enum, value_name = "WHAT")]
    pub what: PlotOption,
    /// The picture's file: .png or .svg
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
}

/// A picture as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PlotOption {
    /// The patches from above
    Patches,
    /// The rolling ball's radius, within 500 mm
    Radius,
    /// What the program leaves
    Residual,
    /// The passes over the patches
    Passes,
    /// The candidates' machining times
    Time,
}

/// Options of `patchmill execute`.
#[derive(Args, Debug)]
pub struct ExecuteOptions {
    /// Folder that `patchmill plan` has written; the lines `hold`, `resume` and `abort` on the standard input act on the run
    pub plan: PathBuf,
    /// Who runs it: sim (a simulated machine) or linuxcnc://HOST:PORT (linuxcncrsh)
    #[arg(long, value_name = "NAME", default_value = "sim")]
    pub controller: String,
    /// How many times as fast as in reality the simulated machine runs
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = positive, allow_negative_numbers = true)]
    pub speed: f64,
    /// Use the machine_interface that runs on this ROS domain instead of starting one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=232))]
    pub domain: Option<u16>,
    /// Print a line a state instead of the bar, and the log of the node that is started
    #[arg(long, short)]
    pub verbose: bool,
}

/// Options of `patchmill linuxcnc-config`.
#[derive(Args, Debug)]
pub struct LinuxcncConfigOptions {
    /// Folder for the INI, HAL, tool table and parameter files and start.sh; must not exist or be empty
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// The machine: a shipped one's name or an own URDF, such as a plan's machine.urdf; default: xyzac
    #[arg(long, value_name = "NAME|FILE.urdf")]
    pub machine: Option<PathBuf>,
    /// Tool 1 in mm, as for `plan`
    #[arg(long, value_name = "r1=MM,r2=MM,length=MM", default_value = "r1=13.05,r2=6,length=100", value_parser = tool)]
    pub tool: Tool,
    /// Acceleration of every linear axis, m/s²
    #[arg(long, value_name = "M/S2", default_value = "5", value_parser = positive, allow_negative_numbers = true)]
    pub acceleration_linear: f64,
    /// Acceleration of every rotary axis, rad/s²
    #[arg(long, value_name = "RAD/S2", default_value = "20", value_parser = positive, allow_negative_numbers = true)]
    pub acceleration_rotary: f64,
    /// Port on which linuxcncrsh listens
    #[arg(long, value_name = "PORT", default_value_t = DEFAULT_PORT, value_parser = clap::value_parser!(u16).range(1..))]
    pub port: u16,
}

/// The subcommands of `patchmill bag`.
#[derive(Debug, Subcommand)]
pub enum BagCommand {
    /// Give a bag whose recorder was killed its summaries and metadata, so that every reader opens it.
    Repair {
        /// Folder of the bag
        directory: PathBuf,
        /// Print the result as one JSON document
        #[arg(long)]
        json: bool,
    },
}

/// Options of `patchmill doctor`.
#[derive(Args, Debug)]
pub struct DoctorOptions {
    /// ROS domain; default: ROS_DOMAIN_ID, else 0
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=232))]
    pub domain: Option<u16>,
    /// The machine that is checked: a shipped one's name or an own URDF; default: xyzac
    #[arg(long, value_name = "NAME|FILE.urdf")]
    pub machine: Option<PathBuf>,
    /// A controller that is asked whether it answers: linuxcnc://HOST:PORT (linuxcncrsh)
    #[arg(long, value_name = "NAME")]
    pub controller: Option<String>,
    /// Folder in which plans are to be written
    #[arg(long, value_name = "DIR", default_value = ".")]
    pub out: PathBuf,
    /// How long peers are listened for, s
    #[arg(long, value_name = "S", default_value = "3", value_parser = listening, allow_negative_numbers = true)]
    pub wait: f64,
    /// Print the findings as one JSON document
    #[arg(long)]
    pub json: bool,
}

/// Options of `patchmill completions`.
#[derive(Args, Debug)]
pub struct CompletionsOptions {
    /// The shell
    pub shell: ShellOption,
}

/// A shell as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ShellOption {
    /// eval "$(patchmill completions bash)"
    Bash,
    /// patchmill completions zsh > a folder of $fpath/_patchmill
    Zsh,
    /// patchmill completions fish > ~/.config/fish/completions/patchmill.fish
    Fish,
}

/// Options of `patchmill man`.
#[derive(Args, Debug)]
pub struct ManOptions {
    /// The subcommand, such as plan or bag repair; default: the command itself
    #[arg(conflicts_with = "out")]
    pub subcommand: Vec<String>,
    /// Write the pages of the command and all its subcommands into this folder instead
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// A stage as typed.
#[derive(Clone, Copy, Debug, ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum StageOption {
    /// Loads the surface
    SurfaceIngestion,
    /// Computes the rolling-ball field
    RollingBallAnalysis,
    /// Computes the candidate partitions
    SurfacePartitioning,
    /// Cuts the passes
    PathGeneration,
    /// Times, proves and chooses
    MachineInterface,
}

impl StageOption {
    /// Name of the stage's node.
    pub fn stage(self) -> &'static str {
        match self {
            Self::SurfaceIngestion => nodes::SURFACE_INGESTION,
            Self::RollingBallAnalysis => nodes::ROLLING_BALL_ANALYSIS,
            Self::SurfacePartitioning => nodes::SURFACE_PARTITIONING,
            Self::PathGeneration => nodes::PATH_GENERATION,
            Self::MachineInterface => nodes::MACHINE_INTERFACE,
        }
    }
}

/// Strategy as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum StrategyOption {
    /// The paper's method: patches with a fixed tool axis each
    RollingBall,
    /// Any tool axis and feed direction a patch, passes that follow the surface
    Fastest,
    /// One patch, all axes move at once, the rolling ball's own tool axis everywhere
    FiveAxis,
    /// One patch, all axes move at once, the tool leans by the least lead everywhere; refused where it gouges
    Sturz,
    /// One patch, tool axis along Z
    ThreeAxis,
}

impl StrategyOption {
    /// The job's strategy.
    pub fn strategy(self) -> Strategy {
        match self {
            Self::RollingBall => Strategy::RollingBall,
            Self::Fastest => Strategy::Fastest,
            Self::FiveAxis => Strategy::FiveAxis,
            Self::Sturz => Strategy::Sturz,
            Self::ThreeAxis => Strategy::ThreeAxis,
        }
    }
}

impl PlanOptions {
    /// The job in SI units with a tool, without ids and machine text.
    fn job_with(&self, tool: &Tool) -> Job {
        let strategy = self.strategy.strategy();
        let patches = self.patches.clone().unwrap_or(if strategy.one_patch() { 1..=1 } else { 1..=8 });
        Job { strategy, patches_min: *patches.start(), patches_max: *patches.end(), ..self.job.job(tool) }
    }

    /// The jobs that are tried, that of the largest tool first.
    pub fn jobs(&self) -> Vec<Job> {
        largest_first(self.tool.clone()).iter().map(|tool| self.job_with(tool)).collect()
    }
}

fn cloud_wait(text: &str) -> Result<f64, String> {
    number(text).and_then(|s| {
        if (0.0..=3600.0).contains(&s) { Ok(s) } else { Err(format!("{s} is not within 0..3600 s")) }
    })
}

fn listening(text: &str) -> Result<f64, String> {
    number(text).and_then(|s| {
        if (0.5..=60.0).contains(&s) { Ok(s) } else { Err(format!("{s} is not within 0.5..60 s")) }
    })
}

fn patch_range(text: &str) -> Result<RangeInclusive<u8>, String> {
    let expected = "expected one number or a range such as 2..8, within 1..16";
    let one =
        |s: &str| s.trim().parse::<u8>().map_err(|_| format!("`{s}` is no number of patches; {expected}"));
    let (least, most) = match text.split_once("..") {
        Some((a, b)) => (one(a)?, one(b.trim_start_matches('='))?),
        None => (one(text)?, one(text)?),
    };
    if least < 1 || most > 16 || least > most {
        return Err(format!("`{text}` is no range of patches; {expected}"));
    }
    Ok(least..=most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_products::job::Placement;

    fn plan(arguments: &[&str]) -> Result<PlanOptions, String> {
        let line = ["patchmill", "plan", "s.json", "--out", "d"].iter().chain(arguments);
        match CommandLine::try_parse_from(line).map_err(|e| e.to_string())?.command {
            Command::Plan(options) => Ok(*options),
            other => Err(format!("{other:?}")),
        }
    }

    #[test]
    fn defaults_are_the_jobs_defaults() {
        let (job, default) = (plan(&[]).unwrap().jobs().remove(0), Job::default_for(""));
        assert!((job.scallop_height - default.scallop_height).abs() < 1e-15);
        assert!((job.feed - default.feed).abs() < 1e-15);
        assert_eq!(
            Job { scallop_height: 0.0, feed: 0.0, gouge_tolerance: 0.0, ..job },
            Job {
                scallop_height: 0.0,
                feed: 0.0,
                gouge_tolerance: 0.0,
                strategy: Strategy::Fastest,
                ..default
            }
        );
    }

    #[test]
    fn a_cloud_stands_in_for_a_file_where_a_stack_runs() {
        let read = |arguments: &[&str]| {
            let line = ["patchmill", "plan", "--out", "d"].iter().chain(arguments);
            match CommandLine::try_parse_from(line).map_err(|e| e.to_string())?.command {
                Command::Plan(options) => Ok(*options),
                other => Err(format!("{other:?}")),
            }
        };
        let options = read(&["--cloud", "--domain", "3", "--cloud-wait", "2.5"]).unwrap();
        assert!(options.cloud && options.surface.is_none());
        assert_eq!(options.cloud_wait, 2.5);
        for (bad, word) in [
            (&["--cloud"][..], "--domain"),
            (&["--cloud", "s.json", "--domain", "3"], "cannot be used with"),
            (&["--cloud", "--units", "mm", "--domain", "3"], "cannot be used with"),
            (&["--cloud", "--domain", "3", "--cloud-wait", "-1"], "0..3600"),
            (&["s.json", "--cloud-wait", "3"], "--cloud"),
            (&[], "SURFACE"),
        ] {
            let text = read(bad).unwrap_err();
            assert!(text.contains(word), "{bad:?}: {text}");
        }
    }

    #[test]
    fn dialects_are_asked_for_by_name_each_once() {
        let wanted = DialectOption::wanted;
        assert!(wanted(&plan(&[]).unwrap().dialect).is_empty());
        let all =
            ["--dialect", "fanuc", "--dialect", "siemens", "--dialect", "linuxcnc", "--dialect", "fanuc"];
        assert_eq!(wanted(&plan(&all).unwrap().dialect), [Dialect::Siemens, Dialect::Fanuc]);
        assert!(plan(&["--dialect", "okuma"]).unwrap_err().contains("heidenhain"));
        for dialect in Dialect::ALL {
            let line = ["patchmill", "dialect", "DIR", "--to", dialect.name()];
            match CommandLine::try_parse_from(line).unwrap().command {
                Command::Dialect(options) => assert_eq!(wanted(&options.to), [dialect]),
                other => panic!("{other:?}"),
            }
        }
        assert!(CommandLine::try_parse_from(["patchmill", "dialect", "DIR"]).is_err());
    }

    #[test]
    fn stages_are_called_as_their_nodes() {
        for stage in nodes::STAGES {
            let line = ["patchmill", "replay", "bag", "--from", stage];
            match CommandLine::try_parse_from(line).unwrap().command {
                Command::Replay(options) => assert_eq!(options.from.stage(), stage),
                other => panic!("{other:?}"),
            }
        }
        assert!(CommandLine::try_parse_from(["patchmill", "replay", "bag"]).is_err());
    }

    #[test]
    fn tools_are_tried_from_the_largest_down() {
        let tools =
            ["--tool", "r1=0,r2=6", "--tool", "r1=4,r2=4", "--tool", "r1=0,r2=8", "--tool", "r1=13.05,r2=6"];
        let options = plan(&tools).unwrap();
        let sizes: Vec<[f64; 2]> = options
            .jobs()
            .iter()
            .map(|job| [job.tool.cutter.r1, job.tool.cutter.r2].map(|r| r * 1e3))
            .collect();
        assert_eq!(sizes, [[13.05, 6.0], [4.0, 4.0], [0.0, 8.0], [0.0, 6.0]]);
    }

    #[test]
    fn ranges_and_tools_are_read_and_refused() {
        assert_eq!(plan(&["--patches", "2..8"]).unwrap().patches, Some(2..=8));
        assert_eq!(plan(&["--patches", "4"]).unwrap().patches, Some(4..=4));
        for bad in ["0", "8..2", "1..17", "x", "1..", "-1"] {
            assert!(plan(&["--patches", bad]).is_err(), "{bad}");
        }
        let ball = plan(&["--tool", "r1=0,r2=6"]).unwrap().tool[0].clone();
        assert_eq!((ball.cutter.r1, ball.cutter.r2, ball.length), (0.0, 0.006, 0.1));
        for bad in ["r1=1", "r1=-1,r2=2", "r1=0,r2=0", "r1=a,r2=1", "d=3", "r1=1,r2=inf"] {
            assert!(plan(&["--tool", bad]).unwrap_err().contains("r1"), "{bad}");
        }
        assert_eq!(plan(&["--mount", "auto"]).unwrap().jobs().remove(0).placement, Placement::Auto);
        let there = Placement::At { xyz: [-0.09, 0.0, 0.07], rpy: [0.0, 0.0, std::f64::consts::FRAC_PI_2] };
        assert_eq!(plan(&["--mount", "-90,0,70,0,0,90"]).unwrap().jobs().remove(0).placement, there);
        for bad in ["1,2,3", "a,0,0,0,0,0", "1,2,3,4,5,6,7", "", "automatic"] {
            assert!(plan(&["--mount", bad]).unwrap_err().contains("X,Y,Z"), "{bad}");
        }
        // A negative value is one, and no unknown option.
        assert!(plan(&["--feed", "-5"]).unwrap_err().contains("-5 is not above 0"));
        assert!(plan(&["--stock-allowance", "-0.001"]).unwrap_err().contains("-0.001 is below 0"));
        assert!(plan(&["--scallop", "0"]).is_err() && plan(&["--feed", "nan"]).is_err());
        let held = ["--tool", "r1=0,r2=6,flute=25,shank=10", "--holder", "d=20..32,l=30;d=63,l=25"];
        let tool = plan(&held).unwrap().jobs().remove(0).tool;
        assert_eq!((tool.flute_length, tool.shank_radius, tool.holder.len()), (0.025, 0.005, 2));
    }
}
