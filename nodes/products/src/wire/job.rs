//! The job as a message, and its id.

use std::f64::consts::{FRAC_PI_2, TAU};

use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::cdr::to_cdr;
use patchmill_msgs::geometry_msgs::msg::Vector3;
use patchmill_msgs::{msg, std_msgs};

use super::check::{expect, in_unit, millimetres, within};
use super::hash::ContentHash;
use super::provenance::{FRAME, check_id};
use super::tool::{check_tool, tool_from_msg, tool_msg};
use super::{Provenance, WireError};
use crate::job::{Job, LookAhead, PATH_TOLERANCE, Pattern, Placement, Strategy};

/// Most patches that may be asked for.
pub const MAX_PATCHES: u8 = 16;

/// Longest URDF text that a message takes along, bytes: messages stay below 128 KiB.
pub const MAX_URDF_BYTES: usize = 100 * 1024;

/// Smallest length that is taken for positive, m.
const TINY: f64 = 1e-9;

/// The last digit of a coordinate in a program, m: nothing finer can be kept.
const PROGRAM_DIGIT: f64 = 1e-7;

/// Least path tolerance, m: ten times the last digit that `G64 P` is written with.
const LEAST_PATH_TOLERANCE: f64 = 1e-8;

/// Hex digits of a job's id.
const ID_DIGITS: usize = 16;

impl Job {
    /// The job's message; `stamp` identifies this run of the job.
    pub fn to_msg(&self, stamp: Time) -> msg::Job {
        let (placement, xyz, rpy) = match self.placement {
            Placement::AsDescribed => (msg::Job::PLACEMENT_AS_DESCRIBED, [0.0; 3], [0.0; 3]),
            Placement::At { xyz, rpy } => (msg::Job::PLACEMENT_GIVEN, xyz, rpy),
            Placement::Auto => (msg::Job::PLACEMENT_AUTO, [0.0; 3], [0.0; 3]),
        };
        let vector = |[x, y, z]: [f64; 3]| Vector3 { x, y, z };
        msg::Job {
            header: std_msgs::msg::Header { stamp, frame_id: FRAME.to_owned() },
            job_id: self.job_id.clone(),
            surface_id: self.surface_id.clone(),
            tool: tool_msg(&self.tool),
            scallop_height: self.scallop_height,
            gouge_tolerance: self.gouge_tolerance,
            lead_min: self.lead_min,
            inclination_max: self.inclination_max,
            pass_chord: self.pass_chord,
            stock_allowance: self.stock_allowance,
            clearance: self.clearance,
            feed: self.feed,
            spindle_speed: self.spindle_speed,
            patches_min: self.patches_min,
            patches_max: self.patches_max,
            pattern: match self.pattern {
                Pattern::Zigzag => msg::Job::PATTERN_ZIGZAG,
                Pattern::OneWay => msg::Job::PATTERN_ONE_WAY,
                Pattern::Climb => msg::Job::PATTERN_CLIMB,
            },
            strategy: match self.strategy {
                Strategy::RollingBall => msg::Job::STRATEGY_ROLLING_BALL,
                Strategy::FiveAxis => msg::Job::STRATEGY_FIVE_AXIS,
                Strategy::Fastest => msg::Job::STRATEGY_FASTEST,
                Strategy::Sturz => msg::Job::STRATEGY_STURZ,
                Strategy::ThreeAxis => msg::Job::STRATEGY_THREE_AXIS,
            },
            border_margin: self.border_margin,
            lead_radius: self.lead_radius,
            acceleration_linear: self.acceleration_linear,
            acceleration_rotary: self.acceleration_rotary,
            jerk_linear: self.jerk_linear,
            jerk_rotary: self.jerk_rotary,
            block_time: self.block_time,
            path_tolerance: self.path_tolerance,
            look_ahead: look_ahead_msg(self.look_ahead),
            rest_lead: self.rest_lead,
            placement,
            mount_position: vector(xyz),
            mount_rpy: vector(rpy),
            machine_urdf: self.machine_urdf.clone(),
        }
    }

    /// The job of a message. Its header may be empty and so may its ids, as in an action's goal.
    ///
    /// # Errors
    /// When a value is out of its range, or the id is there and is not the content's.
    pub fn from_msg(msg: &msg::Job) -> Result<Self, WireError> {
        let frame = &msg.header.frame_id;
        expect(frame.is_empty() || frame == FRAME, "the job's frame", frame, &format!("'{FRAME}'"))?;
        let job = Self {
            job_id: msg.job_id.clone(),
            surface_id: msg.surface_id.clone(),
            tool: tool_from_msg(&msg.tool),
            scallop_height: msg.scallop_height,
            gouge_tolerance: msg.gouge_tolerance,
            lead_min: msg.lead_min,
            inclination_max: msg.inclination_max,
            pass_chord: msg.pass_chord,
            stock_allowance: msg.stock_allowance,
            clearance: msg.clearance,
            feed: msg.feed,
            spindle_speed: msg.spindle_speed,
            patches_min: msg.patches_min,
            patches_max: msg.patches_max,
            pattern: match msg.pattern {
                msg::Job::PATTERN_ZIGZAG => Pattern::Zigzag,
                msg::Job::PATTERN_ONE_WAY => Pattern::OneWay,
                msg::Job::PATTERN_CLIMB => Pattern::Climb,
                other => {
                    return Err(WireError::new(format!("pattern {other} is unknown, 0 to 2 was expected")));
                }
            },
            strategy: match msg.strategy {
                msg::Job::STRATEGY_ROLLING_BALL => Strategy::RollingBall,
                msg::Job::STRATEGY_FIVE_AXIS => Strategy::FiveAxis,
                msg::Job::STRATEGY_FASTEST => Strategy::Fastest,
                msg::Job::STRATEGY_STURZ => Strategy::Sturz,
                msg::Job::STRATEGY_THREE_AXIS => Strategy::ThreeAxis,
                other => {
                    return Err(WireError::new(format!("strategy {other} is unknown, 0 to 4 was expected")));
                }
            },
            border_margin: msg.border_margin,
            lead_radius: msg.lead_radius,
            acceleration_linear: msg.acceleration_linear,
            acceleration_rotary: msg.acceleration_rotary,
            jerk_linear: msg.jerk_linear,
            jerk_rotary: msg.jerk_rotary,
            block_time: msg.block_time,
            path_tolerance: msg.path_tolerance,
            look_ahead: look_ahead(msg.look_ahead)?,
            rest_lead: msg.rest_lead,
            placement: match msg.placement {
                msg::Job::PLACEMENT_AS_DESCRIBED => Placement::AsDescribed,
                msg::Job::PLACEMENT_GIVEN => {
                    let numbers = |v: &Vector3| [v.x, v.y, v.z];
                    Placement::At { xyz: numbers(&msg.mount_position), rpy: numbers(&msg.mount_rpy) }
                }
                msg::Job::PLACEMENT_AUTO => Placement::Auto,
                other => {
                    return Err(WireError::new(format!("placement {other} is unknown, 0 to 2 was expected")));
                }
            },
            machine_urdf: msg.machine_urdf.clone(),
        };
        job.check()?;
        if !job.job_id.is_empty() {
            let id = job.content_id();
            expect(
                job.job_id == id,
                "job_id",
                &job.job_id,
                &format!("'{id}', the hash of the job's content,"),
            )?;
        }
        Ok(job)
    }

    /// The same job with its id.
    pub fn with_id(self) -> Self {
        Self { job_id: self.content_id(), ..self }
    }

    /// Hash of the CDR of all fields but header and id, 16 hex digits.
    fn content_id(&self) -> String {
        let content = msg::Job {
            header: std_msgs::msg::Header::default(),
            job_id: String::new(),
            ..self.to_msg(Time::default())
        };
        let mut hash = ContentHash::default();
        hash.bytes(&to_cdr(&content));
        hash.hex()[..ID_DIGITS].to_owned()
    }

    /// Whether every value is in its range.
    ///
    /// # Errors
    /// With the first value that is not; lengths in mm and angles in degrees.
    pub fn check(&self) -> Result<(), WireError> {
        check_tool(&self.tool)?;
        millimetres("scallop_height", self.scallop_height, PROGRAM_DIGIT, 0.01)?;
        millimetres("gouge_tolerance", self.gouge_tolerance, PROGRAM_DIGIT, 0.01)?;
        millimetres("pass_chord", self.pass_chord, TINY, 0.001)?;
        millimetres("stock_allowance", self.stock_allowance, 0.0, 0.1)?;
        millimetres("clearance", self.clearance, TINY, 1.0)?;
        degrees("inclination_max", self.inclination_max, 0.0, FRAC_PI_2)?;
        degrees("lead_min", self.lead_min, 0.0, self.inclination_max)?;
        if self.rest_lead != 0.0 {
            degrees("rest_lead", self.rest_lead, self.lead_min, self.inclination_max)?;
        }
        // Less is `F0.00..` in a program.
        in_unit("feed", self.feed * 60e3, "mm/min", 0.01, 600e3)?;
        // Less is `S0`: a tool that stands still.
        in_unit("spindle_speed", self.spindle_speed * 60.0 / TAU, "rpm", 1.0, 950e3)?;
        within("acceleration_linear [m/s^2]", self.acceleration_linear, 1e-3, 1e4)?;
        within("acceleration_rotary [rad/s^2]", self.acceleration_rotary, 1e-3, 1e5)?;
        within("jerk_linear [m/s^3]", self.jerk_linear, 0.0, 1e9)?;
        within("jerk_rotary [rad/s^3]", self.jerk_rotary, 0.0, 1e9)?;
        within("block_time [s]", self.block_time, 0.0, 1.0)?;
        if self.path_tolerance != 0.0 {
            // Less is `P0` in a program, with which a control may leave the path as far as it likes.
            millimetres("path_tolerance", self.path_tolerance, LEAST_PATH_TOLERANCE, 0.001)?;
        }
        millimetres("lead_radius", self.lead_radius, 0.0, 0.1)?;
        millimetres("border_margin", self.border_margin, 0.0, 0.1)?;
        if let Placement::At { xyz, rpy } = self.placement {
            for (what, value) in ["x", "y", "z"].iter().zip(xyz) {
                millimetres(&format!("the mount's {what}"), value, -10.0, 10.0)?;
            }
            for (what, value) in ["roll", "pitch", "yaw"].iter().zip(rpy) {
                degrees(&format!("the mount's {what}"), value, -TAU, TAU)?;
            }
        }
        let (min, max) = (self.patches_min, self.patches_max);
        let expected = format!("a range within 1..{MAX_PATCHES}");
        let in_range = 1 <= min && min <= max && max <= MAX_PATCHES;
        expect(in_range, "the range of patches", format!("{min}..{max}"), &expected)?;
        if self.strategy.one_patch() {
            let one = "1..1 with a strategy of one patch";
            expect((min, max) == (1, 1), "the range of patches", format!("{min}..{max}"), one)?;
        }
        check_id("surface_id", &self.surface_id)?;
        check_id("job_id", &self.job_id)?;
        let urdf = self.machine_urdf.len();
        expect(
            urdf <= MAX_URDF_BYTES,
            "the machine's URDF in bytes",
            urdf,
            &format!("at most {MAX_URDF_BYTES}"),
        )
    }

    /// The path tolerance that programs ask of the control, m.
    pub fn corner_tolerance(&self) -> f64 {
        if self.path_tolerance > 0.0 { self.path_tolerance } else { PATH_TOLERANCE }
    }

    /// What products of this job's run say of their origin; `stamp` is that of the job's message.
    pub fn provenance(&self, stamp: Time) -> Provenance {
        Provenance::of_job(stamp, self)
    }
}

/// Number of a look-ahead in messages.
pub fn look_ahead_msg(look_ahead: LookAhead) -> u8 {
    match look_ahead {
        LookAhead::AllAxes => msg::Job::LOOK_AHEAD_ALL_AXES,
        LookAhead::LinearAxes => msg::Job::LOOK_AHEAD_LINEAR_AXES,
    }
}

/// The look-ahead of a number in messages.
///
/// # Errors
/// When the number is unknown.
pub fn look_ahead(number: u8) -> Result<LookAhead, WireError> {
    match number {
        msg::Job::LOOK_AHEAD_ALL_AXES => Ok(LookAhead::AllAxes),
        msg::Job::LOOK_AHEAD_LINEAR_AXES => Ok(LookAhead::LinearAxes),
        other => Err(WireError::new(format!("look_ahead {other} is unknown, 0 or 1 was expected"))),
    }
}

fn degrees(what: &str, value: f64, low: f64, high: f64) -> Result<(), WireError> {
    let expected = format!("{:.3} to {:.3} degrees", low.to_degrees(), high.to_degrees());
    let shown = format!("{:.3} degrees", value.to_degrees());
    expect(value.is_finite() && low <= value && value <= high, what, shown, &expected)
}
