//! What `plan` and `compare` share of the command line: the job in machinists' units.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use patchmill_products::job::{Job, LookAhead, Pattern, Placement, Tool};

use crate::select_option::{Condition, condition};
use crate::tool_option::{HolderSections, holder};

/// The largest lead where `--allow-rest` names none, degrees: more of it makes the passes beside a tight place slow.
const REST_LEAD: &str = "45";

/// A job but for its tool, strategy and numbers of patches.
#[derive(Args, Debug)]
pub struct JobOptions {
    /// Holder in mm, sections from the lowest up to the spindle nose: d = diameter (or low..high for a cone), l = length
    #[arg(long, value_name = "d=MM[..MM],l=MM;...", value_parser = holder)]
    pub holder: Option<HolderSections>,
    /// Largest height left between passes, mm
    #[arg(long, value_name = "MM", default_value = "0.0254", value_parser = positive, allow_negative_numbers = true)]
    pub scallop: f64,
    /// Largest depth of a cut below the surface, mm
    #[arg(long, value_name = "MM", default_value = "0.005", value_parser = positive, allow_negative_numbers = true)]
    pub gouge_tolerance: f64,
    /// How neighbouring passes are connected
    #[arg(long, value_enum, default_value = "zigzag")]
    pub pattern: PatternOption,
    /// The machine: xyzac (table-table), xyzbc (head-table), xyzbc_nutating (45° head), or an own URDF; default: xyzac
    #[arg(long, value_name = "NAME|FILE.urdf")]
    pub machine: Option<PathBuf>,
    /// Where the part stands in the link that carries it, mm and degrees, or auto: where the travel suffices; default: as the URDF has it
    #[arg(long, value_name = "X,Y,Z,ROLL,PITCH,YAW|auto", value_parser = placement, allow_hyphen_values = true)]
    pub mount: Option<Placement>,
    /// Unit of a mesh or of points (JSON, 3MF and STEP name their own): mm, m or in; default mm
    #[arg(long, value_name = "UNIT", value_parser = ["mm", "m", "in"])]
    pub units: Option<String>,
    /// What of the surface is to be finished; the rest may not be gouged and need not be cut. normal=DEG: facets that lean up to
    /// DEG from +Z; normal=X,Y,Z,DEG: from that direction; z=MIN..MAX: facets between these heights, mm; facets=FILE: those
    /// whose numbers (or FIRST..LAST) FILE lists, counted from 0 as in the surface's file; facet=N,crease=DEG: facet N and what is
    /// reached from it over edges that bend by DEG at most. Given several times, all have to hold; default: everything
    #[arg(long, value_name = "CONDITION", value_parser = condition, allow_hyphen_values = true)]
    pub select: Vec<Condition>,
    /// Where the tool does not fit, or only by leaning from the normal by more than DEG, leave what is there standing and list it; default:
    /// refuse such a surface
    #[arg(long, value_name = "DEG", num_args = 0..=1, require_equals = true, default_missing_value = REST_LEAD, value_parser = lead)]
    pub allow_rest: Option<f64>,
    /// Feed of the tool tip, mm/min
    #[arg(long, value_name = "MM/MIN", default_value = "2000", value_parser = positive, allow_negative_numbers = true)]
    pub feed: f64,
    /// Spindle speed, rpm
    #[arg(long, value_name = "RPM", default_value = "6000", value_parser = positive, allow_negative_numbers = true)]
    pub spindle: f64,
    /// Material deliberately left on the surface, mm
    #[arg(long, value_name = "MM", default_value = "0", value_parser = not_negative, allow_negative_numbers = true)]
    pub stock_allowance: f64,
    /// Least angle between tool axis and surface normal, degrees
    #[arg(long, value_name = "DEG", default_value = "5", value_parser = lead, allow_negative_numbers = true)]
    pub lead_min: f64,
    /// Largest angle between tool axis and surface normal, degrees
    #[arg(long, value_name = "DEG", default_value = "75", value_parser = lead, allow_negative_numbers = true)]
    pub inclination_max: f64,
    /// Acceleration of every linear axis, m/s²
    #[arg(long, value_name = "M/S2", default_value = "5", value_parser = positive, allow_negative_numbers = true)]
    pub acceleration_linear: f64,
    /// Acceleration of every rotary axis, rad/s²
    #[arg(long, value_name = "RAD/S2", default_value = "20", value_parser = positive, allow_negative_numbers = true)]
    pub acceleration_rotary: f64,
    /// Jerk of every linear axis, m/s³; 0: not limited
    #[arg(long, value_name = "M/S3", default_value = "0", value_parser = not_negative, allow_negative_numbers = true)]
    pub jerk_linear: f64,
    /// Jerk of every rotary axis, rad/s³; 0: not limited
    #[arg(long, value_name = "RAD/S3", default_value = "0", value_parser = not_negative, allow_negative_numbers = true)]
    pub jerk_rotary: f64,
    /// Least time that the control takes for a block, ms
    #[arg(long, value_name = "MS", default_value = "0", value_parser = not_negative, allow_negative_numbers = true)]
    pub block_time: f64,
    /// Over which moves the control plans speeds together: all, or those of linear axes alone, as LinuxCNC
    #[arg(long, value_enum, default_value = "all-axes")]
    pub look_ahead: LookAheadOption,
    /// How far the control may leave a corner of the path (P of G64), mm
    #[arg(long, value_name = "MM", default_value = "0.002", value_parser = positive, allow_negative_numbers = true)]
    pub path_tolerance: f64,
    /// Radius of the arcs on which passes are entered and left, mm; 0: straight down
    #[arg(long, value_name = "MM", default_value = "2", value_parser = not_negative, allow_negative_numbers = true)]
    pub lead_radius: f64,
    /// Passes go on so far beyond open borders of the surface, mm
    #[arg(long, value_name = "MM", default_value = "0", value_parser = not_negative, allow_negative_numbers = true)]
    pub border_margin: f64,
}

/// Look-ahead as typed.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum LookAheadOption {
    /// Over all moves
    AllAxes,
    /// Moves in which a rotary axis turns one by one
    LinearAxes,
}

/// Pass pattern as typed.
#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum PatternOption {
    /// Alternate senses, linked on the surface
    Zigzag,
    /// One sense, a lift between passes
    OneWay,
    /// One way, every pass on the right of the last one: the cutter climbs with M3
    Climb,
}

impl JobOptions {
    /// The job in SI units with the paper's strategy, without ids and machine text.
    pub fn job(&self, tool: &Tool) -> Job {
        Job {
            tool: Tool { holder: self.holder.clone().unwrap_or_default().0, ..tool.clone() },
            scallop_height: self.scallop / 1e3,
            gouge_tolerance: self.gouge_tolerance / 1e3,
            lead_min: self.lead_min.to_radians(),
            inclination_max: self.inclination_max.to_radians(),
            stock_allowance: self.stock_allowance / 1e3,
            feed: self.feed / 60e3,
            spindle_speed: self.spindle * std::f64::consts::TAU / 60.0,
            pattern: match self.pattern {
                PatternOption::Zigzag => Pattern::Zigzag,
                PatternOption::OneWay => Pattern::OneWay,
                PatternOption::Climb => Pattern::Climb,
            },
            rest_lead: self
                .allow_rest
                .map_or(0.0, |lead| lead.min(self.inclination_max).max(self.lead_min).to_radians()),
            lead_radius: self.lead_radius / 1e3,
            border_margin: self.border_margin / 1e3,
            jerk_linear: self.jerk_linear,
            jerk_rotary: self.jerk_rotary,
            block_time: self.block_time / 1e3,
            path_tolerance: self.path_tolerance / 1e3,
            look_ahead: match self.look_ahead {
                LookAheadOption::AllAxes => LookAhead::AllAxes,
                LookAheadOption::LinearAxes => LookAhead::LinearAxes,
            },
            placement: self.mount.unwrap_or(Placement::AsDescribed),
            acceleration_linear: self.acceleration_linear,
            acceleration_rotary: self.acceleration_rotary,
            ..Job::default_for("")
        }
    }
}

pub(crate) fn number(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("`{text}` is not a finite number")),
    }
}

pub(crate) fn positive(text: &str) -> Result<f64, String> {
    number(text).and_then(|v| if v > 0.0 { Ok(v) } else { Err(format!("{v} is not above 0")) })
}

fn not_negative(text: &str) -> Result<f64, String> {
    number(text).and_then(|v| if v >= 0.0 { Ok(v) } else { Err(format!("{v} is below 0")) })
}

fn lead(text: &str) -> Result<f64, String> {
    number(text).and_then(|v| {
        if v > 0.0 && v < 90.0 { Ok(v) } else { Err(format!("{v} is not between 0 and 90 degrees")) }
    })
}

fn placement(text: &str) -> Result<Placement, String> {
    if text == "auto" {
        return Ok(Placement::Auto);
    }
    let expected = "expected X,Y,Z,ROLL,PITCH,YAW in mm and degrees, for example -90,-60,70,0,0,0, or auto";
    let numbers: Vec<f64> = text
        .split(',')
        .map(|part| number(part).map_err(|e| format!("{e}; {expected}")))
        .collect::<Result<_, _>>()?;
    let [x, y, z, roll, pitch, yaw] = numbers[..] else {
        return Err(format!("`{text}` has {} numbers; {expected}", numbers.len()));
    };
    Ok(Placement::At { xyz: [x, y, z].map(|v| v / 1e3), rpy: [roll, pitch, yaw].map(f64::to_radians) })
}
