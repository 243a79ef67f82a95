//! What a person has to know before the program runs, in plain words.

use crate::axes::AxisUse;
use crate::plan::Plan;
use crate::sections::{mm, tool_name};

/// Nearer than this to the end of its travel an axis is worth a warning, m and rad.
const NEAR_END_LINEAR: f64 = 5e-3;
const NEAR_END_ROTARY: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// A gouge of more than this share of its tolerance is worth a warning.
const NEAR_TOLERANCE: f64 = 0.8;
/// Less of the area than this within the scallop height is worth a warning.
const AREA: f64 = 0.999;
/// A tool of more than this share of a patch's smallest concave radius is worth a warning.
const TIGHT: f64 = 0.9;
/// An axis above this share of its largest speed is said to be at it.
const AT_LIMIT: f64 = 0.99;

/// The warnings, the graver ones first.
pub fn warnings(plan: &Plan, axes: &[AxisUse]) -> Vec<String> {
    let mut said = Vec::new();
    of_proof(plan, &mut said);
    of_travel(axes, &mut said);
    of_tool(plan, &mut said);
    for tool in &plan.refused {
        said.push(format!(
            "A larger tool, {}, cannot make this surface: {}.",
            tool_name(tool.r1, tool.r2),
            tool.reason.trim_end_matches('.')
        ));
    }
    let infeasible = plan.evaluation.candidates.iter().filter(|c| !c.feasible).count();
    if infeasible > 0 {
        let of = plan.evaluation.candidates.len();
        said.push(format!(
            "{infeasible} of {of} numbers of patches could not be made; the table of candidates says why."
        ));
    }
    let fast = axes.iter().filter(|a| a.fastest > AT_LIMIT * a.axis.velocity);
    let fast: Vec<String> = fast.map(|a| a.axis.letter.to_string()).collect();
    if !fast.is_empty() {
        said.push(format!(
            "At their largest speed at times: {}. A faster machine would need less time.",
            fast.join(", ")
        ));
    }
    said.extend(plan.notes.iter().cloned());
    said
}

fn of_proof(plan: &Plan, said: &mut Vec<String>) {
    let (proof, job) = (&plan.program.proof, &plan.job);
    if proof.gouge_max > NEAR_TOLERANCE * job.gouge_tolerance {
        said.push(format!(
            "The deepest cut below the surface, {} mm, is close to the {} mm allowed.",
            mm(proof.gouge_max, 4),
            mm(job.gouge_tolerance, 4)
        ));
    }
    if proof.area_within_scallop < AREA {
        said.push(format!(
            "{:.2} % of the area keeps more than the scallop height of {} mm.",
            (1.0 - proof.area_within_scallop) * 100.0,
            mm(job.scallop_height, 4)
        ));
    }
    if proof.rest_area > 0.0 {
        let place = proof.rest.first().map_or_else(String::new, |region| {
            let p = region.position;
            format!(
                ", the largest of {} mm² at ({}, {}, {}) mm with a smallest ball of {} mm",
                mm(region.area * 1e3, 1),
                mm(p.x, 1),
                mm(p.y, 1),
                mm(p.z, 1),
                mm(region.ball_radius, 3)
            )
        });
        let (area, regions) = (mm(proof.rest_area * 1e3, 1), proof.rest.len());
        said.push(format!(
            "{area} mm² in {regions} regions are left standing: the tool does not fit there{place}. A plan with a smaller tool and \
             --rest-of this folder finishes them."
        ));
    }
    if proof.uncut_area > 0.0 {
        said.push(format!("{:.3} % of the area is reached by no cut.", proof.uncut_area * 100.0));
    }
}

fn of_travel(axes: &[AxisUse], said: &mut Vec<String>) {
    for axis in axes {
        let near = if axis.is_linear() { NEAR_END_LINEAR } else { NEAR_END_ROTARY };
        // Where the program begins the planner has put the axis out of the way itself: Z at the top of its travel.
        let others = AxisUse {
            used: axis
                .used
                .map(|end| if end == axis.start { 0.5 * (axis.used[0] + axis.used[1]) } else { end }),
            ..axis.clone()
        };
        if let Some(margin) = others.margin().filter(|margin| *margin < near) {
            said.push(format!(
                "Axis {} comes within {:.1}{} of the end of its travel; --mount moves the part.",
                axis.axis.letter,
                margin * axis.scale(),
                axis.unit()
            ));
        }
    }
}

fn of_tool(plan: &Plan, said: &mut Vec<String>) {
    let tool = &plan.job.tool;
    if tool.holder.is_empty() {
        said.push(
            "No holder was given: only the tool itself was checked against the part, not what holds it."
                .to_owned(),
        );
    }
    for (place, patch) in plan.program.patches.iter().enumerate() {
        let curvature = patch.plan.pseudo_curvature_max;
        if curvature > 0.0 && tool.cutter.radius() * curvature > TIGHT {
            said.push(format!(
                "Patch {} is tight: its smallest concave radius is {} mm, the tool's {} mm.",
                place + 1,
                mm(1.0 / curvature, 2),
                mm(tool.cutter.radius(), 2)
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_kinematics::{Axis, AxisKind};

    fn axis(limits: Option<[f64; 2]>, used: [f64; 2], fastest: f64) -> AxisUse {
        let kind = AxisKind::Linear;
        let axis =
            Axis { joint_name: "z".to_owned(), letter: 'Z', kind, limits, velocity: 0.5, acceleration: 5.0 };
        AxisUse { axis, used, start: used[0], fastest }
    }

    #[test]
    fn an_axis_near_its_end_is_named_with_what_is_left() {
        let mut said = Vec::new();
        of_travel(&[axis(Some([-0.6, 0.0]), [-0.4, -0.001], 0.1)], &mut said);
        assert_eq!(said, ["Axis Z comes within 1.0 mm of the end of its travel; --mount moves the part."]);
        said.clear();
        of_travel(&[axis(Some([-0.6, 0.0]), [-0.4, -0.006], 0.1), axis(None, [-9.0, 9.0], 0.1)], &mut said);
        assert!(said.is_empty());
        // Put there by the planner itself before the first cut.
        of_travel(&[axis(Some([-0.6, 0.0]), [-0.599, -0.3], 0.1)], &mut said);
        assert!(said.is_empty());
    }
}
