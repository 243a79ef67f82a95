//! The whole report: one HTML file that fetches nothing.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use nalgebra::Point3;
use patchmill_kinematics::{Accelerations, Machine};
use patchmill_visualization::simplify::simplified;
use serde::Serialize;
use sha2::{Digest, Sha256};

use crate::axes::{AxisUse, Moves};
use crate::blob::{Blob, Place, stepped};
use crate::plan::Plan;
use crate::sections;
use crate::shown_surface::{ShownSurface, bounds};
use crate::track::{Bands, Stop, bands, stops};
use crate::warnings::warnings;

/// Larger surfaces are shown coarser, with about this many triangles.
pub const TRIANGLES: usize = 80_000;
/// Points of all passes together, and of the moving tool's way.
const PASS_POINTS: usize = 60_000;
const STOPS: usize = 30_000;
/// Parts of the program's time in the charts.
const PARTS: usize = 1600;
/// One step of a stored leftover, m; `i16::MIN` stands for unknown.
const LEFTOVER_STEP: f64 = 1e-7;
/// One step of a stored part of a unit vector.
const UNIT_STEP: f64 = 1.0 / 32_000.0;
/// Largest whole number of a stored position within its range.
const RANGE: f64 = 65_535.0;

const THREE: &str = include_str!("../three/three.min.js");
const SCRIPT: &str = include_str!("../web/report.js");
const STYLE: &str = include_str!("../web/report.css");

/// What the page's script has to know beside the arrays. mm, degrees, s.
#[derive(Debug, Serialize)]
struct Scene {
    arrays: Vec<Place>,
    /// Origin and size of stored positions.
    origin: [f64; 3],
    size: [f64; 3],
    /// Least and largest corner of the surface.
    bounds: [[f64; 3]; 2],
    /// One step of a stored curvature, 1/mm.
    curvature_step: f64,
    leftover_step: f64,
    unit_step: f64,
    scallop_height: f64,
    gouge_tolerance: f64,
    duration: f64,
    parts: usize,
    patches: Vec<ScenePatch>,
    axes: Vec<SceneAxis>,
    tool: SceneTool,
}

/// A patch in cutting order.
#[derive(Debug, Serialize)]
struct ScenePatch {
    number: u32,
    colour: String,
    /// Darker or lighter, for its passes.
    passes: String,
    ends: f64,
}

#[derive(Debug, Serialize)]
struct SceneAxis {
    letter: char,
    unit: &'static str,
    speed_unit: &'static str,
    decimals: usize,
    limits: Option<[f64; 2]>,
    used: [f64; 2],
    speed: f64,
    fastest: f64,
}

/// The tool from the tip up, mm; sections: from, to, radius at both.
#[derive(Debug, Serialize)]
struct SceneTool {
    r1: f64,
    r2: f64,
    flutes: f64,
    shank: Option<[f64; 4]>,
    holder: Vec<[f64; 4]>,
}

/// The report of a plan.
///
/// # Errors
/// With one sentence when the plan's products do not fit each other.
pub fn report(plan: &Plan) -> Result<String, String> {
    let accelerations =
        Accelerations { linear: plan.job.acceleration_linear, rotary: plan.job.acceleration_rotary };
    let machine = Machine::from_urdf(&plan.program.machine_urdf, plan.job.tool.length, accelerations)
        .map_err(|e| e.to_string())?;
    let moves = Moves::of(&plan.motion, &machine)?;
    let axes = moves.uses(&machine);
    let surface = ShownSurface::of(plan, TRIANGLES)?;
    let stops = stops(&moves, &machine, STOPS);
    let (scene, data) = scene(plan, &surface, &stops, &bands(&moves, PARTS), &axes);
    let scene = serde_json::to_string(&scene).map_err(|e| format!("the report's data: {e}"))?;
    let said = warnings(plan, &axes);
    let view = view(&surface, &axes);
    let body = html! {
        (sections::heading(plan))
        main {
            (view)
            (sections::warnings(&said))
            (sections::patches(plan, &axes))
            (sections::candidates(plan))
            (sections::joints(&axes))
            (sections::proof(plan))
            (sections::job(plan))
        }
        script #scene type="application/json" { (PreEscaped(for_script(&scene))) }
        // base64 only: nothing in it can end the element.
        script #data type="text/plain" { (PreEscaped(data)) }
    };
    let title = plan.surface.rsplit(['/', '\\']).next().unwrap_or_default();
    Ok(page(title, &body).into_string())
}

fn page(title: &str, body: &Markup) -> Markup {
    let hash = |script: &str| STANDARD.encode(Sha256::digest(script.as_bytes()));
    // Nothing is fetched, and no script runs but these two, whatever a text might contain.
    let policy = format!(
        "default-src 'none'; script-src 'sha256-{}' 'sha256-{}'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'",
        hash(THREE),
        hash(SCRIPT)
    );
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(policy);
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                link rel="icon" href="data:,";
                title { (title) " – patchmill report" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                (body)
                script { (PreEscaped(THREE)) }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    }
}

/// JSON that cannot end the element that it stands in.
fn for_script(json: &str) -> String {
    json.replace('<', "\\u003c").replace('>', "\\u003e").replace('&', "\\u0026")
}

/// The 3D view with its controls.
fn view(surface: &ShownSurface, axes: &[AxisUse]) -> Markup {
    let layers = [
        ("patches", "Patches"),
        ("radius", "Rolling-ball radius"),
        ("residual", "What is left"),
        ("plain", "Plain"),
    ];
    let parts = [("passes", "Passes", true), ("tool", "Tool", true), ("way", "Tool's way so far", false)];
    let shown = surface.triangles.len();
    let divided = if shown > surface.drawn {
        format!(" ({shown} after dividing those on the borders between patches)")
    } else {
        String::new()
    };
    let triangles = if surface.drawn < surface.whole {
        format!(
            "The view shows {} triangles in place of the surface's {}{divided}; plan and proof are made with all of them.",
            surface.drawn, surface.whole
        )
    } else {
        format!("All {} triangles of the surface are shown{divided}.", surface.whole)
    };
    html! {
        section #view aria-labelledby="h-view" {
            h2 #h-view { "Surface and tool" }
            div.stage {
                div #canvas tabindex="0" role="application" aria-label="3D view. Arrow keys turn, plus and minus zoom, Home resets, 1 to 4 choose the layer, Space plays." {
                    p #nothing { "The 3D view needs JavaScript and WebGL; the tables below work without them." }
                }
                div.controls {
                    fieldset #layers {
                        legend { "Layer" }
                        @for (i, (name, text)) in layers.into_iter().enumerate() {
                            label { input type="radio" name="layer" value=(name) checked[i == 0]; (text) kbd { (i + 1) } }
                        }
                    }
                    div #legend aria-live="polite" {}
                    fieldset #parts {
                        legend { "Show" }
                        @for (name, text, on) in parts {
                            label { input type="checkbox" name=(name) checked[on]; (text) }
                        }
                    }
                    div.clock {
                        button #play type="button" aria-pressed="false" { "Play" }
                        label { "speed " select #speed {
                            @for factor in [1, 2, 5, 10, 20] { option value=(factor) selected[factor == 5] { (factor) "×" } }
                        } }
                        output #now for="time" {}
                    }
                    table #readout {
                        caption { "Machine axes" }
                        tbody { @for axis in axes { tr {
                            th scope="row" { (axis.axis.letter) }
                            td.number {}
                            td.gauge { span.travel { span.needle {} } }
                            td.speed {}
                        } } }
                    }
                }
                div.timeline {
                    label.hidden for="time" { "Time in the program, s" }
                    input #time type="range" min="0" max="1" step="any" value="0";
                    div #strip aria-hidden="true" {}
                }
            }
            p.lead #triangles { (triangles) }
        }
    }
}

fn scene(
    plan: &Plan,
    surface: &ShownSurface,
    stops: &[Stop],
    bands: &Bands,
    axes: &[AxisUse],
) -> (Scene, String) {
    let mut blob = Blob::default();
    let lines: Vec<(usize, &[Point3<f64>])> = passes(plan);
    let (shown, _) = simplified(&lines.iter().map(|(_, line)| *line).collect::<Vec<_>>(), PASS_POINTS);
    let tips: Vec<Point3<f64>> = stops.iter().map(|s| s.tip).collect();
    let every: Vec<Point3<f64>> =
        surface.vertices.iter().chain(&tips).chain(shown.iter().flatten()).copied().collect();
    let [low, high] = bounds(&every);
    let size = high - low;
    let within = |p: &Point3<f64>| -> [u16; 3] {
        std::array::from_fn(|k| {
            if size[k] > 0.0 { ((p[k] - low[k]) / size[k] * RANGE).round() as u16 } else { 0 }
        })
    };
    let curvature_step =
        surface.curvature.iter().fold(1e-3, |m: f64, k| m.max(k.abs())) / f64::from(i16::MAX);
    blob.add("vertices", surface.vertices.iter().flat_map(within));
    blob.add("triangles", surface.triangles.iter().flatten().copied());
    blob.add("patches", surface.patches.iter().copied());
    blob.add("curvature", surface.curvature.iter().map(|k| stepped(*k, curvature_step)));
    let leftover = |l: &Option<f64>| l.map_or(i16::MIN, |l| stepped(l, LEFTOVER_STEP).max(i16::MIN + 1));
    blob.add("leftover", surface.leftover.iter().map(leftover));
    blob.add("pass_points", shown.iter().flatten().flat_map(within));
    blob.add("pass_counts", shown.iter().map(|line| line.len() as u32));
    blob.add("pass_patches", lines.iter().map(|(patch, _)| u8::try_from(*patch).unwrap_or(u8::MAX)));
    blob.add("times", stops.iter().map(|s| s.time as f32));
    blob.add("joints", stops.iter().flat_map(|s| scaled(&s.joints, axes)));
    blob.add("tips", tips.iter().flat_map(within));
    blob.add(
        "tool_axes",
        stops.iter().flat_map(|s| [s.axis.x, s.axis.y, s.axis.z].map(|v| stepped(v, UNIT_STEP))),
    );
    let band = |rows: &[[[f64; 2]; 5]], scale: &dyn Fn(&AxisUse) -> f64| -> Vec<f32> {
        let factors: Vec<f64> = axes.iter().map(scale).collect();
        rows.iter()
            .flat_map(|row| {
                row.iter()
                    .zip(&factors)
                    .flat_map(|(ends, f)| ends.map(|v| (v * f) as f32))
                    .collect::<Vec<_>>()
            })
            .collect()
    };
    blob.add("position_bands", band(&bands.positions, &AxisUse::scale));
    blob.add("speed_bands", band(&bands.velocities, &AxisUse::speed_scale));
    let (arrays, data) = blob.finish();
    let scene = Scene {
        arrays,
        origin: low.coords.map(|v| v * 1e3).into(),
        size: size.map(|v| v * 1e3 / RANGE).into(),
        bounds: surface.bounds().map(|p| p.coords.map(|v| v * 1e3).into()),
        curvature_step: curvature_step / 1e3,
        leftover_step: LEFTOVER_STEP * 1e3,
        unit_step: UNIT_STEP,
        scallop_height: plan.job.scallop_height * 1e3,
        gouge_tolerance: plan.job.gouge_tolerance * 1e3,
        duration: stops.last().map_or(0.0, |s| s.time),
        parts: PARTS,
        patches: scene_patches(plan),
        axes: axes.iter().map(scene_axis).collect(),
        tool: scene_tool(plan),
    };
    (scene, data)
}

/// The cutter contact points of every pass with its patch.
fn passes(plan: &Plan) -> Vec<(usize, &[Point3<f64>])> {
    let all = plan.toolpath.patches.iter();
    let all = all.flat_map(|p| p.passes.iter().map(|pass| (p.patch as usize, pass.cc.as_slice())));
    all.filter(|(_, line)| line.len() > 1).collect()
}

fn scaled(joints: &[f64; 5], axes: &[AxisUse]) -> Vec<f32> {
    joints.iter().zip(axes).map(|(q, axis)| (q * axis.scale()) as f32).collect()
}

fn scene_patches(plan: &Plan) -> Vec<ScenePatch> {
    let hex = |colour: [f32; 3]| {
        let [r, g, b] = colour.map(|c| (c * 255.0).round() as u8);
        format!("#{r:02x}{g:02x}{b:02x}")
    };
    let mut ends = 0.0;
    let one = |patch: &patchmill_products::program::PatchProgram| {
        ends += patch.machining_time;
        let number = patch.plan.patch as usize;
        ScenePatch {
            number: patch.plan.patch,
            colour: sections::patch_colour(number),
            passes: hex(patchmill_visualization::colours::passes(number)),
            ends,
        }
    };
    plan.program.patches.iter().map(one).collect()
}

fn scene_axis(axis: &AxisUse) -> SceneAxis {
    SceneAxis {
        letter: axis.axis.letter,
        unit: axis.unit(),
        speed_unit: axis.speed_unit(),
        decimals: 3,
        limits: axis.axis.limits.map(|ends| ends.map(|v| v * axis.scale())),
        used: axis.used.map(|v| v * axis.scale()),
        speed: axis.axis.velocity * axis.speed_scale(),
        fastest: axis.fastest * axis.speed_scale(),
    }
}

fn scene_tool(plan: &Plan) -> SceneTool {
    let tool = &plan.job.tool;
    let section = |f: &patchmill_geometry::tool_stack::Frustum| {
        [f.low, f.high, f.radius_low, f.radius_high].map(|v| v * 1e3)
    };
    SceneTool {
        r1: tool.cutter.r1 * 1e3,
        r2: tool.cutter.r2 * 1e3,
        flutes: tool.flute_top() * 1e3,
        shank: tool.shank().as_ref().map(section),
        holder: tool.holder_frusta().iter().map(section).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_cannot_end_its_element() {
        let text = serde_json::to_string("</script><!-- <img onerror=x> &amp;").unwrap();
        let safe = for_script(&text);
        assert!(!safe.contains(['<', '>', '&']));
        assert_eq!(serde_json::from_str::<String>(&safe).unwrap(), "</script><!-- <img onerror=x> &amp;");
    }

    #[test]
    fn scripts_and_style_cannot_end_their_elements() {
        for text in [THREE, SCRIPT] {
            assert!(!text.contains("</script") && !text.contains("<!--"));
        }
        assert!(!STYLE.contains("</style") && !STYLE.contains("url("));
    }
}
