//! `summary.json`: what was planned, in machinists' units. Keys end in their unit; documented in this package's README.

use nalgebra::{Point3, Vector3};
use patchmill_geometry::cutter::Cutter;
use patchmill_machine_interface::execution::sha256_hex;
use patchmill_machine_interface::travel::{AxisTravel, MachineUse};
use patchmill_msgs::msg::{Evaluation, PatchProgram, ProgramManifest, Proof, ProofSpot};
use patchmill_products::evaluation::RestRegion;
use patchmill_products::job::{HolderSection, Job, LookAhead, Pattern, Strategy, Tool};
use patchmill_products::wire::evaluation::rest_region;
use patchmill_rolling_ball_analysis::tool_fit::fitting_cutter;
use serde::Serialize;

use crate::plan_folder::LookAheadName;
use crate::rest_of::RestOf;
use crate::session::PlanFailure;

/// Rest regions that are printed.
const LINES_OF_REST: usize = 5;

/// The whole file.
#[derive(Debug, Serialize)]
pub struct Summary {
    /// patchmill's version.
    pub patchmill_version: &'static str,
    /// Version of this file's layout.
    pub summary_version: u32,
    /// Surface file as it was named.
    pub surface: String,
    /// The conditions on what is to be finished, as they were given; empty: everything.
    pub select: Vec<String>,
    /// The plan whose rest is finished; null: none.
    pub rest_of: Option<RestOf>,
    /// Content hash of the surface.
    pub surface_id: String,
    /// Content hash of the job.
    pub job_id: String,
    /// sha256 of program.ngc.
    pub program_sha256: String,
    /// sha256 of machine.urdf.
    pub machine_urdf_sha256: String,
    /// The program's files, one a control.
    pub programs: Vec<ProgramFile>,
    /// Planning strategy.
    pub strategy: &'static str,
    /// Pass pattern.
    pub pattern: &'static str,
    /// Machining time with the machine's limits, s.
    pub machining_time_s: f64,
    /// Length cut at feed, mm.
    pub cut_length_mm: f64,
    /// Number of patches chosen.
    pub chosen_patches: u32,
    /// Lines of program.ngc with a motion.
    pub blocks: u32,
    /// The tool.
    pub tool: ToolSummary,
    /// Job's scallop height, mm.
    pub scallop_height_mm: f64,
    /// Job's gouge tolerance, mm.
    pub gouge_tolerance_mm: f64,
    /// Feed of the tool tip, mm/min.
    pub feed_mm_per_min: f64,
    /// Spindle speed, rpm.
    pub spindle_rpm: f64,
    /// Where the part stands on the machine; null where no joint carries it.
    pub mount: Option<MountSummary>,
    /// What the program needs of every axis, and the machine's travel.
    pub travel: Vec<TravelSummary>,
    /// Acceleration of every linear axis that the time is reckoned with, m/s².
    pub acceleration_linear_m_per_s2: f64,
    /// Acceleration of every rotary axis that the time is reckoned with, rad/s².
    pub acceleration_rotary_rad_per_s2: f64,
    /// Jerk of every linear axis, m/s³; 0: not limited.
    pub jerk_linear_m_per_s3: f64,
    /// Jerk of every rotary axis, rad/s³; 0: not limited.
    pub jerk_rotary_rad_per_s3: f64,
    /// Least time of a block, s.
    pub block_time_s: f64,
    /// Over which moves the control plans speeds together.
    pub look_ahead: LookAheadName,
    /// How far the control may leave a corner of the path, mm.
    pub path_tolerance_mm: f64,
    /// Radius of the arcs on which passes are entered and left, mm.
    pub lead_radius_mm: f64,
    /// How far passes go on beyond open borders, mm.
    pub border_margin_mm: f64,
    /// Tools of the job that were larger and could not make the surface.
    pub refused_tools: Vec<RefusedTool>,
    /// The swept check of the written program.
    pub proof: ProofSummary,
    /// Largest lead with which the tool counts as fitting, degrees; null: nothing may be left standing.
    pub rest_lead_deg: Option<f64>,
    /// Area left standing where the tool does not fit, mm².
    pub rest_area_mm2: f64,
    /// The same by regions, the largest first, at most 64.
    pub rest: Vec<RestSummary>,
    /// All candidates, in order of their number of patches.
    pub candidates: Vec<CandidateSummary>,
    /// The chosen candidate's patches in cutting order.
    pub patches: Vec<PatchSummary>,
}

/// The program for one control.
#[derive(Debug, Serialize)]
pub struct ProgramFile {
    /// `linuxcnc`, `siemens`, `heidenhain` or `fanuc`.
    pub dialect: &'static str,
    /// File in the output folder.
    pub file: &'static str,
    /// sha256 of the file.
    pub sha256: String,
}

/// A tool that cannot make the surface.
#[derive(Clone, Debug, Serialize)]
pub struct RefusedTool {
    /// Axis to corner centre, mm.
    pub r1_mm: f64,
    /// Corner radius, mm.
    pub r2_mm: f64,
    /// Why not.
    pub reason: String,
}

/// The tool, mm.
#[derive(Debug, Serialize)]
pub struct ToolSummary {
    /// Axis to corner centre, mm.
    pub r1_mm: f64,
    /// Corner radius, mm.
    pub r2_mm: f64,
    /// Spindle nose to tip, mm.
    pub length_mm: f64,
    /// Tip to the top of the flutes, mm; null where the job does not say.
    pub flute_length_mm: Option<f64>,
    /// Between flutes and holder, mm; null where the job does not say.
    pub shank_diameter_mm: Option<f64>,
    /// The holder's sections from the lowest up to the spindle nose.
    pub holder: Vec<HolderSummary>,
}

/// One section of the holder, mm.
#[derive(Debug, Serialize)]
pub struct HolderSummary {
    /// Along the axis, mm.
    pub length_mm: f64,
    /// At its end towards the tip, mm.
    pub diameter_low_mm: f64,
    /// At its end towards the spindle, mm.
    pub diameter_high_mm: f64,
}

/// The `workpiece` frame in the link that carries it.
#[derive(Debug, Serialize)]
pub struct MountSummary {
    /// Position, mm.
    pub xyz_mm: [f64; 3],
    /// Roll, pitch, yaw about the link's fixed axes, degrees.
    pub rpy_deg: [f64; 3],
}

/// One axis: least and largest joint value of the program and of the machine, and the distance to the nearer end.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum TravelSummary {
    /// A linear axis.
    Linear {
        /// Joint name in the URDF.
        joint: String,
        /// mm.
        used_mm: [f64; 2],
        /// mm.
        limits_mm: Option<[f64; 2]>,
        /// mm; null without ends.
        margin_mm: Option<f64>,
    },
    /// A rotary axis.
    Rotary {
        /// Joint name in the URDF.
        joint: String,
        /// Degrees.
        used_deg: [f64; 2],
        /// Degrees; null for a joint that turns without end.
        limits_deg: Option<[f64; 2]>,
        /// Degrees; null without ends.
        margin_deg: Option<f64>,
    },
}

/// The proof, mm and shares of the area.
#[derive(Debug, Serialize)]
pub struct ProofSummary {
    /// Largest depth below the surface, mm.
    pub gouge_max_mm: f64,
    /// Largest leftover, mm.
    pub scallop_max_mm: f64,
    /// Leftover that half of the area keeps within, mm.
    pub scallop_p50_mm: f64,
    /// Leftover that 90 % of the area keeps within, mm.
    pub scallop_p90_mm: f64,
    /// Leftover that 99 % of the area keeps within, mm.
    pub scallop_p99_mm: f64,
    /// Leftover that 99.9 % of the area keeps within, mm.
    pub scallop_p999_mm: f64,
    /// Share of the area within the scallop height.
    pub area_within_scallop: f64,
    /// Share of the area that no cut reached.
    pub uncut_area: f64,
    /// Places below the surface, the deepest first.
    pub deepest: Vec<SpotSummary>,
    /// Places where most is left, the highest first.
    pub highest: Vec<SpotSummary>,
}

/// A connected part of the surface that the tool does not fit, mm.
#[derive(Debug, Serialize)]
pub struct RestSummary {
    /// Its tightest place, workpiece frame.
    pub position_mm: [f64; 3],
    /// Corners of its bounding box.
    pub bounds_mm: [[f64; 3]; 2],
    /// mm².
    pub area_mm2: f64,
    /// Smallest rolling ball in it; the radius r1 + r2 of a tool that fits all of it is below that.
    pub smallest_ball_radius_mm: f64,
    /// The largest ball-end that fits all of it, its r2.
    pub largest_ball_end_r2_mm: f64,
    /// The largest tool of the same shape that fits all of it with leads up to `rest_lead_deg`: r1 and r2.
    pub largest_same_shape_mm: [f64; 2],
    /// Most that is left, along the normal; 1 where no cut came.
    pub leftover_max_mm: f64,
}

/// A place of the surface and what the program leaves there.
#[derive(Debug, Serialize)]
pub struct SpotSummary {
    /// In the workpiece frame, mm.
    pub position_mm: [f64; 3],
    /// Along the normal, mm; negative below the surface.
    pub leftover_mm: f64,
}

/// One candidate.
#[derive(Debug, Serialize)]
pub struct CandidateSummary {
    /// Number of patches.
    pub patches: u32,
    /// Whether it meets the job's tolerances on this machine.
    pub feasible: bool,
    /// Why not; empty when feasible.
    pub reason: String,
    /// s; 0 when infeasible.
    pub machining_time_s: f64,
    /// mm; 0 when infeasible.
    pub cut_length_mm: f64,
    /// Moves to another tool orientation.
    pub index_moves: u32,
}

/// One patch of the chosen candidate.
#[derive(Debug, Serialize)]
pub struct PatchSummary {
    /// Number of the patch in the partition.
    pub patch: u32,
    /// Unit tool axis, workpiece frame.
    pub axis: [f64; 3],
    /// Rotary joints and their angles while the patch is cut, degrees, base of the chain first.
    pub rotary_deg: Vec<RotarySummary>,
    /// Unit feed direction of the first pass, workpiece frame.
    pub feed_direction: [f64; 3],
    /// Smallest concave rolling-ball radius, mm; null where the patch is convex or flat.
    pub smallest_concave_radius_mm: Option<f64>,
    /// Radius R1+R2 that the largest usable tool stays below, mm; null where nothing limits it.
    pub largest_usable_tool_radius_mm: Option<f64>,
    /// Samples in the patch.
    pub sample_count: u32,
    /// Area, mm².
    pub area_mm2: f64,
    /// Feed polylines.
    pub passes: u32,
    /// Least and largest step-over, mm.
    pub step_over_mm: [f64; 2],
    /// s, the index move before the patch included.
    pub machining_time_s: f64,
    /// mm.
    pub cut_length_mm: f64,
}

/// One rotary joint.
#[derive(Debug, Serialize)]
pub struct RotarySummary {
    /// Joint name in the URDF.
    pub joint: String,
    /// Degrees.
    pub angle_deg: f64,
}

fn tool_summary(tool: &Tool) -> ToolSummary {
    let given = |length: f64| (length > 0.0).then(|| rounded(length * 1e3, 6));
    let section = |s: &HolderSection| HolderSummary {
        length_mm: rounded(s.length * 1e3, 6),
        diameter_low_mm: rounded(s.radius_low * 2e3, 6),
        diameter_high_mm: rounded(s.radius_high * 2e3, 6),
    };
    ToolSummary {
        r1_mm: rounded(tool.cutter.r1 * 1e3, 6),
        r2_mm: rounded(tool.cutter.r2 * 1e3, 6),
        length_mm: rounded(tool.length * 1e3, 6),
        flute_length_mm: given(tool.flute_length),
        shank_diameter_mm: given(tool.shank_radius * 2.0),
        holder: tool.holder.iter().map(section).collect(),
    }
}

/// The summary of a finished plan; `machine_urdf` is the text of its machine.urdf.
pub fn summary(
    surface: &str,
    job: &Job,
    evaluation: &Evaluation,
    program: &ProgramManifest,
    machine_urdf: &str,
    machine: &MachineUse,
) -> Summary {
    let chosen = usize::try_from(evaluation.chosen).ok().and_then(|i| evaluation.candidates.get(i));
    Summary {
        patchmill_version: env!("CARGO_PKG_VERSION"),
        summary_version: 1,
        surface: surface.to_owned(),
        select: Vec::new(),
        rest_of: None,
        surface_id: program.surface_id.clone(),
        job_id: program.job_id.clone(),
        program_sha256: program.content_hash.clone(),
        machine_urdf_sha256: sha256_hex(machine_urdf),
        programs: vec![ProgramFile {
            dialect: "linuxcnc",
            file: "program.ngc",
            sha256: program.content_hash.clone(),
        }],
        strategy: match job.strategy {
            Strategy::RollingBall => "rolling-ball",
            Strategy::Fastest => "fastest",
            Strategy::FiveAxis => "five-axis",
            Strategy::Sturz => "sturz",
            Strategy::ThreeAxis => "three-axis",
        },
        pattern: match job.pattern {
            Pattern::Zigzag => "zigzag",
            Pattern::OneWay => "one-way",
            Pattern::Climb => "climb",
        },
        machining_time_s: rounded(program.machining_time, 3),
        cut_length_mm: rounded(program.cut_length * 1e3, 3),
        chosen_patches: chosen.map_or(0, |c| c.patch_count),
        blocks: program.block_count,
        tool: tool_summary(&job.tool),
        scallop_height_mm: rounded(job.scallop_height * 1e3, 6),
        gouge_tolerance_mm: rounded(job.gouge_tolerance * 1e3, 6),
        feed_mm_per_min: rounded(job.feed * 60e3, 6),
        spindle_rpm: rounded(job.spindle_speed * 60.0 / std::f64::consts::TAU, 6),
        mount: machine.mount.map(|mount| MountSummary {
            xyz_mm: mount.xyz.map(|v| rounded(v * 1e3, 6)),
            rpy_deg: mount.rpy.map(|v| rounded(v.to_degrees(), 6)),
        }),
        travel: machine.axes.iter().map(travel_summary).collect(),
        acceleration_linear_m_per_s2: job.acceleration_linear,
        acceleration_rotary_rad_per_s2: job.acceleration_rotary,
        jerk_linear_m_per_s3: job.jerk_linear,
        jerk_rotary_rad_per_s3: job.jerk_rotary,
        block_time_s: job.block_time,
        look_ahead: match job.look_ahead {
            LookAhead::AllAxes => LookAheadName::AllAxes,
            LookAhead::LinearAxes => LookAheadName::LinearAxes,
        },
        path_tolerance_mm: rounded(job.corner_tolerance() * 1e3, 6),
        lead_radius_mm: rounded(job.lead_radius * 1e3, 6),
        border_margin_mm: rounded(job.border_margin * 1e3, 6),
        refused_tools: Vec::new(),
        proof: proof_summary(&program.proof),
        rest_lead_deg: job.leaves_rest().then(|| rounded(job.rest_lead.to_degrees(), 6)),
        rest_area_mm2: rounded(program.proof.rest_area * 1e6, 3),
        rest: program.proof.rest.iter().map(|region| rest_summary(&rest_region(region), job)).collect(),
        candidates: evaluation
            .candidates
            .iter()
            .map(|c| CandidateSummary {
                patches: c.patch_count,
                feasible: c.feasible,
                reason: c.reason.clone(),
                machining_time_s: rounded(c.machining_time, 3),
                cut_length_mm: rounded(c.cut_length * 1e3, 3),
                index_moves: c.index_moves,
            })
            .collect(),
        patches: program.patches.iter().map(patch_summary).collect(),
    }
}

/// The tools of an order's first jobs, which were refused, and why.
pub fn refused_tools(jobs: &[Job], refused: &[PlanFailure]) -> Vec<RefusedTool> {
    let one = |(job, failure): (&Job, &PlanFailure)| RefusedTool {
        r1_mm: rounded(job.tool.cutter.r1 * 1e3, 6),
        r2_mm: rounded(job.tool.cutter.r2 * 1e3, 6),
        reason: failure.text.clone(),
    };
    jobs.iter().zip(refused).map(one).collect()
}

fn proof_summary(proof: &Proof) -> ProofSummary {
    let mm = |v: f64| rounded(v * 1e3, 6);
    let spot = |s: &ProofSpot| SpotSummary {
        position_mm: [s.position.x, s.position.y, s.position.z].map(|v| rounded(v * 1e3, 3)),
        leftover_mm: mm(s.leftover),
    };
    ProofSummary {
        gouge_max_mm: mm(proof.gouge_max),
        scallop_max_mm: mm(proof.scallop_max),
        scallop_p50_mm: mm(proof.scallop_p50),
        scallop_p90_mm: mm(proof.scallop_p90),
        scallop_p99_mm: mm(proof.scallop_p99),
        scallop_p999_mm: mm(proof.scallop_p999),
        area_within_scallop: proof.area_within_scallop,
        uncut_area: proof.uncut_area,
        deepest: proof.deepest.iter().map(spot).collect(),
        highest: proof.highest.iter().map(spot).collect(),
    }
}

fn rest_summary(region: &RestRegion, job: &Job) -> RestSummary {
    let place = |p: &Point3<f64>| [p.x, p.y, p.z].map(|v| rounded(v * 1e3, 3));
    let [ball, shape] = [Cutter { r1: 0.0, r2: 1.0 }, job.tool.cutter]
        .map(|shape| fitting_cutter(shape, region.ball_radius - job.stock_allowance, job.rest_lead));
    RestSummary {
        position_mm: place(&region.position),
        bounds_mm: region.bounds.map(|corner| place(&corner)),
        area_mm2: rounded(region.area * 1e6, 3),
        smallest_ball_radius_mm: rounded(region.ball_radius * 1e3, 3),
        largest_ball_end_r2_mm: ball.r2 * 1e3,
        largest_same_shape_mm: [shape.r1 * 1e3, shape.r2 * 1e3],
        leftover_max_mm: rounded(region.leftover_max * 1e3, 4),
    }
}

fn travel_summary(axis: &AxisTravel) -> TravelSummary {
    let joint = axis.joint.clone();
    if axis.is_linear() {
        let mm = |v: f64| rounded(v * 1e3, 4);
        TravelSummary::Linear {
            joint,
            used_mm: axis.used.map(mm),
            limits_mm: axis.limits.map(|ends| ends.map(mm)),
            margin_mm: axis.margin().map(mm),
        }
    } else {
        let deg = |v: f64| rounded(v.to_degrees(), 5);
        TravelSummary::Rotary {
            joint,
            used_deg: axis.used.map(deg),
            limits_deg: axis.limits.map(|ends| ends.map(deg)),
            margin_deg: axis.margin().map(deg),
        }
    }
}

fn patch_summary(patch: &PatchProgram) -> PatchSummary {
    let plan = &patch.plan;
    let radius = (plan.pseudo_curvature_max > 0.0).then(|| rounded(1e3 / plan.pseudo_curvature_max, 3));
    PatchSummary {
        patch: plan.patch,
        axis: [plan.tool_axis.x, plan.tool_axis.y, plan.tool_axis.z],
        rotary_deg: patch
            .rotary_names
            .iter()
            .zip(&patch.rotary_positions)
            .map(|(joint, angle)| RotarySummary {
                joint: joint.clone(),
                angle_deg: rounded(angle.to_degrees(), 5),
            })
            .collect(),
        feed_direction: [plan.feed_direction.x, plan.feed_direction.y, plan.feed_direction.z],
        smallest_concave_radius_mm: radius,
        largest_usable_tool_radius_mm: radius,
        sample_count: plan.sample_count,
        area_mm2: rounded(plan.area * 1e6, 3),
        passes: plan.pass_count,
        step_over_mm: [plan.step_over_min, plan.step_over_max].map(|s| rounded(s * 1e3, 4)),
        machining_time_s: rounded(patch.machining_time, 3),
        cut_length_mm: rounded(patch.cut_length * 1e3, 3),
    }
}

/// One line: where the part stands and how near the program comes to the ends of the travel.
fn mounted(machine: &MachineUse) -> String {
    let numbers = |v: [f64; 3], scale: f64| v.map(|x| rounded(x * scale, 3).to_string()).join(" ");
    let place = machine.mount.map_or_else(String::new, |m| {
        let (xyz, rpy) = (numbers(m.xyz, 1e3), numbers(m.rpy, 1f64.to_degrees()));
        format!("part mounted at {xyz} mm, turned {rpy}°; ")
    });
    let margin = |axis: &AxisTravel| {
        let (scale, unit) = if axis.is_linear() { (1e3, " mm") } else { (1f64.to_degrees(), "°") };
        let name = axis.joint.to_uppercase();
        axis.margin().map_or(format!("{name} endless"), |m| format!("{name} {:.1}{unit}", m * scale))
    };
    let margins: Vec<String> = machine.axes.iter().map(margin).collect();
    format!("{place}margins to the ends of the travel: {}\n", margins.join(", "))
}

/// What is left standing: its area, and a line for each of the largest regions.
fn left_standing(proof: &Proof, job: &Job) -> String {
    if !job.leaves_rest() {
        return String::new();
    }
    if proof.rest.is_empty() {
        return "rest: the tool fits everywhere, nothing is left standing\n".to_owned();
    }
    let mut text = format!(
        "rest: {:.1} mm² in {} regions left standing where the tool fits with no lead up to {:.0}°\n",
        proof.rest_area * 1e6,
        proof.rest.len(),
        job.rest_lead.to_degrees()
    );
    for region in proof.rest.iter().take(LINES_OF_REST) {
        let region = rest_summary(&rest_region(region), job);
        let [x, y, z] = region.position_mm;
        let [r1, r2] = region.largest_same_shape_mm;
        text += &format!(
            "  {:.1} mm² at ({x:.1}, {y:.1}, {z:.1}) mm: smallest ball {:.3} mm; a ball-end up to r2={:.3} or a tool of this shape up to \
             r1={r1:.3} r2={r2:.3} mm fits\n",
            region.area_mm2, region.smallest_ball_radius_mm, region.largest_ball_end_r2_mm
        );
    }
    text
}

/// The table that `patchmill plan` prints: a line a candidate, the choice, and how it stands on the machine.
pub fn table(evaluation: &Evaluation, program: &ProgramManifest, job: &Job, machine: &MachineUse) -> String {
    let mut text = String::from("patches      time s   cut length mm   indexings\n");
    for candidate in &evaluation.candidates {
        let mark =
            if i64::from(evaluation.chosen) == i64::from(candidate.index) { "  <- chosen" } else { "" };
        text += &if candidate.feasible {
            format!(
                "{:>7}  {:>10.1}  {:>14.1}  {:>10}{mark}\n",
                candidate.patch_count,
                candidate.machining_time,
                candidate.cut_length * 1e3,
                candidate.index_moves
            )
        } else {
            format!("{:>7}  infeasible: {}\n", candidate.patch_count, candidate.reason)
        };
    }
    let proof = &program.proof;
    text += &format!(
        "proof: largest gouge {:.4} mm, {:.3} % of the area within the scallop height, 99.9 % of it within {:.4} mm\n",
        proof.gouge_max * 1e3,
        proof.area_within_scallop * 100.0,
        proof.scallop_p999 * 1e3
    );
    text += &left_standing(proof, job);
    text += &mounted(machine);
    for (i, patch) in program.patches.iter().enumerate() {
        let axis = &patch.plan.tool_axis;
        let tilt = Vector3::new(axis.x, axis.y, axis.z).angle(&Vector3::z()).to_degrees();
        let rotary: Vec<String> = patch
            .rotary_names
            .iter()
            .zip(&patch.rotary_positions)
            .map(|(name, angle)| format!("{} {:.3}°", name.to_uppercase(), angle.to_degrees()))
            .collect();
        // Passes joined by links at feed are one.
        let cuts = match patch.plan.pass_count {
            1 => "one continuous cut".to_owned(),
            count => format!("{count} continuous cuts"),
        };
        text += &format!(
            "patch {}: {}, axis {tilt:.1}° off vertical, {cuts}, step-over {:.2} to {:.2} mm, {:.1} s\n",
            i + 1,
            rotary.join(" "),
            patch.plan.step_over_min * 1e3,
            patch.plan.step_over_max * 1e3,
            patch.machining_time
        );
    }
    text
}

/// Rounded to so many decimals: figures for people, free of binary noise.
fn rounded(value: f64, decimals: i32) -> f64 {
    let scale = 10f64.powi(decimals);
    (value * scale).round() / scale
}
