//! What to make: the job, its tool, and its content hash.

use patchmill_geometry::cutter::Cutter;

pub use crate::tool::{HolderSection, Tool};

/// How neighbouring passes are connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pattern {
    /// Alternate passes run in opposite senses and are linked on the surface.
    Zigzag,
    /// All passes run in the same sense with a lift between them.
    OneWay,
    /// One way, each pass beside the last one on its right as seen along the feed: with the spindle turning clockwise (M3) the
    /// cutter climbs.
    Climb,
}

/// How tool axes and feed directions are chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Strategy {
    /// The paper's rolling-ball rule: normals' ellipse and most inclined tool axis.
    RollingBall,
    /// Any tool axis and feed direction within the limits, and passes that follow the surface, for the least machining time.
    Fastest,
    /// Simultaneous 5-axis: one patch, at every cutter location the rolling ball's own tool axis.
    FiveAxis,
    /// Simultaneous 5-axis: one patch, the tool axis leans by the least inclination θ_min in the feed direction everywhere, whether
    /// the cutter fits or not.
    Sturz,
    /// One patch, tool axis along +z.
    ThreeAxis,
}

impl Strategy {
    /// Whether the whole surface is one patch.
    pub fn one_patch(self) -> bool {
        matches!(self, Self::FiveAxis | Self::Sturz | Self::ThreeAxis)
    }

    /// Whether the tool axis turns while the cutter cuts.
    pub fn simultaneous(self) -> bool {
        matches!(self, Self::FiveAxis | Self::Sturz)
    }
}

/// Over which moves the control plans speeds together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LookAhead {
    /// Over all.
    AllAxes,
    /// Over those of linear axes; moves in which a rotary axis turns one by one, as LinuxCNC does.
    LinearAxes,
}

/// Where the part stands on the machine: the `workpiece` frame in the link that carries it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Placement {
    /// Where the machine's URDF has it.
    AsDescribed,
    /// There.
    At {
        /// Position, m.
        xyz: [f64; 3],
        /// Roll, pitch, yaw about the fixed axes of the carrying link, rad.
        rpy: [f64; 3],
    },
    /// Where the machine's travel suffices: machine_interface looks for it.
    Auto,
}

/// The path tolerance of a job that names none, m.
pub const PATH_TOLERANCE: f64 = 2e-6;

/// One job: everything that decides what the program does. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// Content hash of everything below.
    pub job_id: String,
    /// Content hash of the surface to be machined.
    pub surface_id: String,
    /// The tool.
    pub tool: Tool,
    /// Largest height of material left between passes, m.
    pub scallop_height: f64,
    /// Largest depth of a cut below the surface, m.
    pub gouge_tolerance: f64,
    /// Least inclination θ_min between tool axis and surface normal, rad.
    pub lead_min: f64,
    /// Largest inclination α_max between tool axis and surface normal, rad.
    pub inclination_max: f64,
    /// Largest distance between a pass's straight moves and the exact cutter location curve, m.
    pub pass_chord: f64,
    /// Material deliberately left on the surface, m.
    pub stock_allowance: f64,
    /// Rapid moves keep this distance above the part along the tool axis, m.
    pub clearance: f64,
    /// Feed of the tool tip, m/s.
    pub feed: f64,
    /// Spindle speed, rad/s.
    pub spindle_speed: f64,
    /// Least number of patches tried.
    pub patches_min: u8,
    /// Largest number of patches tried, inclusive.
    pub patches_max: u8,
    /// Pass pattern.
    pub pattern: Pattern,
    /// Planning strategy.
    pub strategy: Strategy,
    /// Passes go on so far beyond open borders of the surface, m.
    pub border_margin: f64,
    /// Radius of the arcs on which passes are entered and left, m; 0: straight down.
    pub lead_radius: f64,
    /// Acceleration of every linear axis, m/s².
    pub acceleration_linear: f64,
    /// Acceleration of every rotary axis, rad/s².
    pub acceleration_rotary: f64,
    /// Jerk of every linear axis, m/s³; 0: not limited.
    pub jerk_linear: f64,
    /// Jerk of every rotary axis, rad/s³; 0: not limited.
    pub jerk_rotary: f64,
    /// Least time of a block on the control, s.
    pub block_time: f64,
    /// How far the control may leave a corner of the path, m (`P` of `G64`); 0: [`PATH_TOLERANCE`].
    pub path_tolerance: f64,
    /// Over which moves the control plans speeds together.
    pub look_ahead: LookAhead,
    /// What the tool fits only by leaning from the normal by more than this (rad), or not at all, is left standing and listed; 0: such a
    /// surface is refused.
    pub rest_lead: f64,
    /// Where the part stands on the machine.
    pub placement: Placement,
    /// The machine as URDF text; empty: the one machine_interface was started with.
    pub machine_urdf: String,
}

impl Job {
    /// Whether places that the tool does not fit are left standing.
    pub fn leaves_rest(&self) -> bool {
        self.rest_lead > 0.0
    }

    /// The defaults of the paper's experiment: 1.5 in toroidal mill (13.05 + 6 mm, length 100 mm), scallop height
    /// 0.0254 mm, 2000 mm/min, 6000 rpm, 1 to 8 patches, lead arcs of 2 mm, jerk not limited; no holder, no ids yet.
    pub fn default_for(surface_id: &str) -> Self {
        Self {
            job_id: String::new(),
            surface_id: surface_id.to_owned(),
            tool: Tool::bare(Cutter { r1: 0.01305, r2: 0.006 }, 0.1),
            scallop_height: 25.4e-6,
            gouge_tolerance: 5e-6,
            lead_min: 5f64.to_radians(),
            inclination_max: 75f64.to_radians(),
            pass_chord: 1e-6,
            stock_allowance: 0.0,
            clearance: 0.010,
            feed: 2.0 / 60.0,
            spindle_speed: 6000.0 * std::f64::consts::TAU / 60.0,
            patches_min: 1,
            patches_max: 8,
            pattern: Pattern::Zigzag,
            strategy: Strategy::RollingBall,
            border_margin: 0.0,
            lead_radius: 2e-3,
            acceleration_linear: 5.0,
            acceleration_rotary: 20.0,
            jerk_linear: 0.0,
            jerk_rotary: 0.0,
            block_time: 0.0,
            path_tolerance: PATH_TOLERANCE,
            look_ahead: LookAhead::AllAxes,
            rest_lead: 0.0,
            placement: Placement::AsDescribed,
            machine_urdf: String::new(),
        }
    }
}
