//! The report's tables and figures as HTML. Every text is escaped by the macro; nothing here is written past it.

use maud::{Markup, html};
use nalgebra::Vector3;
use patchmill_products::evaluation::{CandidateEvaluation, ProofSpot};
use patchmill_products::program::PatchProgram;
use patchmill_visualization::colours;

use crate::axes::AxisUse;
use crate::plan::Plan;

/// A length (m) in mm with so many decimals.
pub fn mm(length: f64, decimals: usize) -> String {
    format!("{:.*}", decimals, length * 1e3)
}

/// A time (s) as minutes and seconds.
pub fn clock(seconds: f64) -> String {
    let tenths = (seconds * 10.0).round() as u64;
    format!("{}:{:02}.{}", tenths / 600, tenths / 10 % 60, tenths % 10)
}

/// A share in percent, never rounded up: only what is whole is called 100 %.
fn share(part: f64) -> String {
    // As precise as a proof's figures are; 0.9998 is a little less in binary.
    format!("{:.2} %", (part * 1e4 + 1e-6).floor() / 100.0)
}

/// A cutter by its sizes (m).
pub fn tool_name(r1: f64, r2: f64) -> String {
    let diameter = trimmed(2e3 * (r1 + r2));
    match (r1 > 0.0, r2 > 0.0) {
        (true, true) => format!("{diameter} mm bull-nose, corner {} mm", trimmed(r2 * 1e3)),
        (false, _) => format!("{diameter} mm ball-end"),
        (true, false) => format!("{diameter} mm flat-end"),
    }
}

fn trimmed(number: f64) -> String {
    let text = format!("{number:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// `#rrggbb` of a patch by its number in the partition.
pub fn patch_colour(number: usize) -> String {
    let [r, g, b] = colours::patch(number).map(|c| (c * 255.0).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Title and the figures that come first.
pub fn heading(plan: &Plan) -> Markup {
    let (program, job) = (&plan.program, &plan.job);
    let file = plan.surface.rsplit(['/', '\\']).next().unwrap_or_default();
    let tile = |name: &str, value: String, note: String| {
        html! { div.tile { dt { (name) } dd { span.value { (value) } span.note { (note) } } } }
    };
    let proof = &program.proof;
    html! {
        header {
            p.kind { "Machining report" }
            h1 { (file) }
            dl.tiles {
                (tile("Machining time", clock(program.machining_time), "min, with the machine's limits".to_owned()))
                (tile("Patches", program.patches.len().to_string(), format!("{} mm cut", mm(program.cut_length, 0))))
                (tile("Deepest gouge", format!("{} mm", mm(proof.gouge_max, 4)), format!("{} mm allowed", mm(job.gouge_tolerance, 4))))
                (tile("Within scallop height", share(proof.area_within_scallop), format!("of the area, {} mm", mm(job.scallop_height, 4))))
                (tile("Tool", format!("{} mm", trimmed(2e3 * job.tool.cutter.radius())), tool_name(job.tool.cutter.r1, job.tool.cutter.r2)))
            }
        }
    }
}

/// The warnings, or that there are none.
pub fn warnings(said: &[String]) -> Markup {
    html! {
        section #warnings aria-labelledby="h-warnings" {
            h2 #h-warnings { "What to look at" }
            @if said.is_empty() {
                p { "Nothing stands out." }
            } @else {
                ul { @for sentence in said { li { (sentence) } } }
            }
        }
    }
}

fn vector(v: &Vector3<f64>) -> String {
    format!("{:.3} {:.3} {:.3}", v.x, v.y, v.z)
}

fn angle(radians: f64) -> String {
    // No minus before a zero.
    let degrees = (radians.to_degrees() * 1e3).round() / 1e3 + 0.0;
    format!("{degrees:.3}°")
}

fn patch_row(place: usize, patch: &PatchProgram, letters: &[(String, char)]) -> Markup {
    let plan = &patch.plan;
    let named = |name: &String| {
        letters.iter().find(|(joint, _)| joint == name).map_or(name.clone(), |(_, l)| l.to_string())
    };
    let concave = (plan.pseudo_curvature_max > 0.0).then(|| mm(1.0 / plan.pseudo_curvature_max, 1));
    let tilt = plan.tool_axis.angle(&Vector3::z());
    let heading = plan.feed_direction.y.atan2(plan.feed_direction.x);
    html! {
        tr data-patch=(place) {
            th scope="row" {
                span.swatch style={ "background:" (patch_colour(plan.patch as usize)) } {}
                (place + 1)
            }
            td {
                @for (name, value) in patch.rotary_names.iter().zip(&patch.rotary_positions) {
                    span.angle { (named(name)) " " (angle(*value)) }
                }
            }
            td { (format!("{:.1}°", tilt.to_degrees())) }
            td title={ "unit vector " (vector(&plan.feed_direction)) } { (format!("{:.1}°", heading.to_degrees())) }
            td { (concave.clone().unwrap_or_else(|| "none".to_owned())) }
            td { @match concave { Some(radius) => { "< " (radius) } None => { "any" } } }
            td { (mm(plan.step_over[0], 2)) " – " (mm(plan.step_over[1], 2)) }
            td { (format!("{:.0}", plan.area * 1e6)) }
            td { (mm(patch.cut_length, 0)) }
            td { (clock(patch.machining_time)) }
        }
    }
}

/// The patches in cutting order.
pub fn patches(plan: &Plan, axes: &[AxisUse]) -> Markup {
    let letters: Vec<(String, char)> =
        axes.iter().map(|a| (a.axis.joint_name.clone(), a.axis.letter)).collect();
    html! {
        section aria-labelledby="h-patches" {
            h2 #h-patches { "Patches" }
            p.lead { "In cutting order; a colour is that of the patch in the view." }
            div.wide tabindex="0" role="region" aria-labelledby="h-patches" {
                table #patches {
                    thead { tr {
                        th scope="col" { "Patch" }
                        th scope="col" { "Tool axis" }
                        th scope="col" { "Off vertical" }
                        th scope="col" { "First feed, from X" }
                        th scope="col" { "Smallest concave radius, mm" }
                        th scope="col" { "Largest usable tool, radius mm" }
                        th scope="col" { "Step-over, mm" }
                        th scope="col" { "Area, mm²" }
                        th scope="col" { "Cut, mm" }
                        th scope="col" { "Time, min" }
                    } }
                    tbody { @for (place, patch) in plan.program.patches.iter().enumerate() { (patch_row(place, patch, &letters)) } }
                }
            }
        }
    }
}

fn candidate_row(candidate: &CandidateEvaluation, chosen: bool, longest: f64) -> Markup {
    let share = if longest > 0.0 { candidate.machining_time / longest * 100.0 } else { 0.0 };
    html! {
        tr.chosen[chosen] {
            th scope="row" { (candidate.patch_count) }
            @if candidate.feasible {
                td.chart { span.bar style=(format!("width:{share:.2}%")) {} }
                td { (clock(candidate.machining_time)) @if chosen { " " b.mark { "chosen" } } }
                td { (mm(candidate.cut_length, 0)) }
                td { (mm(candidate.rapid_length, 0)) }
                td { (candidate.index_moves) }
            } @else {
                td.reason colspan="5" { "not possible: " (candidate.reason) }
            }
        }
    }
}

/// The candidates' times as bars.
pub fn candidates(plan: &Plan) -> Markup {
    let all = &plan.evaluation.candidates;
    let longest = all.iter().filter(|c| c.feasible).map(|c| c.machining_time).fold(0.0, f64::max);
    html! {
        section aria-labelledby="h-candidates" {
            h2 #h-candidates { "Numbers of patches tried" }
            p.lead { "Machining time of the quickest program found with so many patches; candidates that cannot win are not worked on to the end." }
            div.wide tabindex="0" role="region" aria-labelledby="h-candidates" {
                table #candidates {
                    thead { tr {
                        th scope="col" { "Patches" } th.chart scope="col" { "Time" } th scope="col" { "min" }
                        th scope="col" { "Cut, mm" } th scope="col" { "Rapid, mm" } th scope="col" { "Index moves" }
                    } }
                    tbody { @for c in all { (candidate_row(c, plan.evaluation.chosen == Some(c.index), longest)) } }
                }
            }
        }
    }
}

/// The charts of the axes, drawn by the page's script, with what it draws as a table.
pub fn joints(axes: &[AxisUse]) -> Markup {
    let pair = |axis: &AxisUse, ends: [f64; 2]| {
        let [low, high] = ends.map(|v| v * axis.scale());
        format!("{low:.1} – {high:.1}{}", axis.unit())
    };
    html! {
        section aria-labelledby="h-joints" {
            h2 #h-joints { "Axes over time" }
            p.lead {
                "Joint positions and speeds. Dashed lines are the machine's limits, the colours below those of the patches; a click moves the tool there."
            }
            label.option { input #limits type="checkbox"; "Scale positions to the whole travel" }
            div #charts {}
            div.wide tabindex="0" role="region" aria-label="Use of the axes" {
                table #axes {
                    thead { tr {
                        th scope="col" { "Axis" } th scope="col" { "Used" } th scope="col" { "Travel" } th scope="col" { "To the nearer end" }
                        th scope="col" { "Fastest" } th scope="col" { "Largest speed" } th scope="col" { "Acceleration" }
                    } }
                    tbody { @for axis in axes { tr {
                        th scope="row" { (axis.axis.letter) }
                        td { (pair(axis, axis.used)) }
                        td { @match axis.axis.limits { Some(ends) => { (pair(axis, ends)) } None => { "endless" } } }
                        td { @match axis.margin() { Some(m) => { (format!("{:.1}{}", m * axis.scale(), axis.unit())) } None => { "–" } } }
                        td { (format!("{:.0}{}", axis.fastest * axis.speed_scale(), axis.speed_unit())) }
                        td { (format!("{:.0}{}", axis.axis.velocity * axis.speed_scale(), axis.speed_unit())) }
                        td { (if axis.is_linear() { format!("{} m/s²", axis.axis.acceleration) } else { format!("{} rad/s²", axis.axis.acceleration) }) }
                    } } }
                }
            }
        }
    }
}

fn spots(title: &str, spots: &[ProofSpot]) -> Markup {
    html! {
        table {
            caption { (title) }
            thead { tr { th scope="col" { "x, mm" } th scope="col" { "y, mm" } th scope="col" { "z, mm" } th scope="col" { "Left, mm" } } }
            tbody {
                @for spot in spots { tr {
                    @for v in spot.position.iter() { td { (mm(*v, 2)) } }
                    td { (mm(spot.leftover, 4)) }
                } }
                @if spots.is_empty() { tr { td colspan="4" { "none" } } }
            }
        }
    }
}

/// What the swept check of the program's text found.
pub fn proof(plan: &Plan) -> Markup {
    let (proof, job) = (&plan.program.proof, &plan.job);
    let left =
        |name: &str, value: f64| html! { tr { th scope="row" { (name) } td { (mm(value, 4)) " mm" } } };
    html! {
        section aria-labelledby="h-proof" {
            h2 #h-proof { "Proof" }
            p.lead {
                "The cutter was swept along the program's own text over " (plan.residual.points.len())
                " points of the surface. Negative is below the surface."
            }
            div.columns {
                table #proof {
                    caption { "What is left" }
                    tbody {
                        tr { th scope="row" { "Deepest below the surface" } td { (mm(proof.gouge_max, 4)) " mm of " (mm(job.gouge_tolerance, 4)) " allowed" } }
                        tr { th scope="row" { "Highest above it" } td { (mm(proof.scallop_max, 4)) " mm" } }
                        (left("Half of the area within", proof.scallop_p50))
                        (left("90 % within", proof.scallop_p90))
                        (left("99 % within", proof.scallop_p99))
                        (left("99.9 % within", proof.scallop_p999))
                        tr { th scope="row" { "Area within the scallop height" } td { (format!("{:.3} %", proof.area_within_scallop * 100.0)) " at " (mm(job.scallop_height, 4)) " mm" } }
                        tr { th scope="row" { "Area reached by no cut" } td { (format!("{:.3} %", proof.uncut_area * 100.0)) } }
                    }
                }
                (spots("Deepest places", &proof.deepest))
                (spots("Highest places", &proof.highest))
            }
        }
    }
}

/// The job and the ids that tell what this report is of.
pub fn job(plan: &Plan) -> Markup {
    let job = &plan.job;
    let row = |name: &str, value: String| html! { tr { th scope="row" { (name) } td { (value) } } };
    html! {
        section aria-labelledby="h-job" {
            h2 #h-job { "Job" }
            table #job {
                tbody {
                    (row("Surface", plan.surface.clone()))
                    (row("Strategy", plan.strategy.clone()))
                    (row("Pattern", plan.pattern.clone()))
                    (row("Tool", format!("{}, stick-out {} mm", tool_name(job.tool.cutter.r1, job.tool.cutter.r2), trimmed(job.tool.length * 1e3))))
                    (row("Feed", format!("{:.0} mm/min", job.feed * 60e3)))
                    (row("Spindle", format!("{:.0} rpm", job.spindle_speed * 60.0 / std::f64::consts::TAU)))
                    (row("Blocks with a motion", plan.program.block_count.to_string()))
                    (row("sha256 of program.ngc", plan.program_sha256.clone()))
                    (row("Job id", job.job_id.clone()))
                    (row("Surface id", job.surface_id.clone()))
                    (row("patchmill", plan.version.clone()))
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_and_tools_are_read_as_people_write_them() {
        assert_eq!(
            [clock(0.0), clock(59.96), clock(143.04), clock(3600.0)],
            ["0:00.0", "1:00.0", "2:23.0", "60:00.0"]
        );
        assert_eq!(tool_name(0.01305, 0.006), "38.1 mm bull-nose, corner 6 mm");
        assert_eq!(tool_name(0.0, 0.006), "12 mm ball-end");
        assert_eq!(tool_name(0.01, 0.0), "20 mm flat-end");
        assert_eq!(angle(-1e-9), "0.000°");
        assert_eq!([share(0.99996), share(1.0), share(0.9998)], ["99.99 %", "100.00 %", "99.98 %"]);
    }

    #[test]
    fn what_a_file_is_called_stays_text() {
        let said = warnings(&["</script><img onerror=alert(1) src=x>".to_owned()]).into_string();
        assert!(!said.contains("<img") && said.contains("&lt;img onerror=alert(1)"), "{said}");
    }
}
