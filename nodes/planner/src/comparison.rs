//! What `patchmill compare` finds: a row a method, all at the same conditions, and the ratios between them.

use patchmill_machine_interface::travel::MachineUse;
use patchmill_msgs::action::PlanSurfaceResult;
use patchmill_products::job::{Job, Strategy, Tool};
use serde::Serialize;

use crate::summary::RefusedTool;

/// The whole comparison, written to compare.json.
#[derive(Debug, Serialize)]
pub struct Comparison {
    /// patchmill's version.
    pub patchmill_version: &'static str,
    /// Surface file as it was named.
    pub surface: String,
    /// Content hash of the surface.
    pub surface_id: String,
    /// Job's scallop height, mm.
    pub scallop_height_mm: f64,
    /// Job's gouge tolerance, mm.
    pub gouge_tolerance_mm: f64,
    /// Feed of the tool tip, mm/min.
    pub feed_mm_per_min: f64,
    /// A row a method, in the order of the table.
    pub rows: Vec<Row>,
    /// Time at the programmed feed, s, if every point were cut by its own best orientation that keeps the rolling ball's lead, without
    /// links, retracts and machine limits; null where the cutter does not fit.
    pub lower_bound_s: Option<f64>,
    /// The fastest strategy's machining time over that of other rows.
    pub ratios: Vec<Ratio>,
}

/// A method and what came of it.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Name in the table.
    pub method: String,
    /// Folder of its program under programs/; null where there is none.
    pub folder: Option<String>,
    /// Diameter and corner radius of the tool, mm: the smallest one that the method needs.
    pub tool_mm: [f64; 2],
    /// Figures of a program that passed its proof.
    pub figures: Option<Figures>,
    /// Why there is no program: what it gouges or leaves; empty where there is one.
    pub reason: String,
    /// Larger tools that the method could not use, and why.
    pub refused: Vec<RefusedTool>,
}

/// Figures of a proven program.
#[derive(Clone, Debug, Serialize)]
pub struct Figures {
    /// Machining time with the machine's limits, s.
    pub machining_time_s: f64,
    /// Length of cut at the programmed feed, s.
    pub feed_time_s: f64,
    /// Length cut at feed, mm.
    pub cut_length_mm: f64,
    /// Number of patches.
    pub patches: u32,
    /// Number of passes.
    pub passes: u32,
    /// How often the tool leaves the part.
    pub retracts: u32,
    /// Moves to another tool orientation.
    pub indexings: u32,
    /// Largest depth below the surface by the proof, mm.
    pub gouge_max_mm: f64,
    /// Share of the area within the scallop height by the proof.
    pub area_within_scallop: f64,
    /// Time of planning, s.
    pub planned_s: f64,
}

/// Machining time of the fastest strategy over that of another row.
#[derive(Debug, Serialize)]
pub struct Ratio {
    /// The other row's method.
    pub to: String,
    /// The ratio: below 1 the fastest strategy is quicker.
    pub ratio: f64,
}

/// Name of the row that the ratios are of.
pub const FASTEST: &str = "fastest";

/// Name of a method's row.
pub fn method(job: &Job) -> String {
    match job.strategy {
        Strategy::RollingBall => match patches(job).as_str() {
            "1" => "rolling-ball, 1 patch".to_owned(),
            many => format!("rolling-ball, {many} patches"),
        },
        Strategy::Fastest if (job.patches_min, job.patches_max) == (1, 1) => {
            "3+2, one orientation".to_owned()
        }
        Strategy::Fastest => FASTEST.to_owned(),
        Strategy::FiveAxis => "five-axis rolling ball".to_owned(),
        Strategy::Sturz => format!("five-axis Sturz {:.0}°", job.lead_min.to_degrees()),
        Strategy::ThreeAxis if job.tool.cutter.r1 > 0.0 => "three-axis, toroid".to_owned(),
        Strategy::ThreeAxis => "three-axis, ball-end".to_owned(),
    }
}

fn patches(job: &Job) -> String {
    match (job.patches_min, job.patches_max) {
        (least, most) if least == most => most.to_string(),
        (least, most) => format!("{least}..{most}"),
    }
}

/// Diameter and corner radius, mm.
pub fn tool_mm(tool: &Tool) -> [f64; 2] {
    [tool.cutter.radius() * 2e3, tool.cutter.r2 * 1e3].map(|v| (v * 1e3).round() / 1e3)
}

impl Figures {
    /// Of a plan.
    pub fn of(result: &PlanSurfaceResult, machine: &MachineUse, job: &Job, planned_s: f64) -> Self {
        let program = &result.program;
        let chosen = usize::try_from(result.evaluation.chosen).ok();
        let chosen = chosen.and_then(|i| result.evaluation.candidates.get(i));
        Self {
            machining_time_s: program.machining_time,
            feed_time_s: program.cut_length / job.feed,
            cut_length_mm: program.cut_length * 1e3,
            patches: program.patches.len() as u32,
            passes: program.patches.iter().map(|patch| patch.plan.pass_count).sum(),
            retracts: machine.retracts,
            indexings: chosen.map_or(0, |c| c.index_moves),
            gouge_max_mm: program.proof.gouge_max * 1e3,
            area_within_scallop: program.proof.area_within_scallop,
            planned_s,
        }
    }
}

/// The ratios of the fastest strategy's time to all other rows'.
pub fn ratios(rows: &[Row]) -> Vec<Ratio> {
    let time = |row: &Row| row.figures.as_ref().map(|f| f.machining_time_s);
    let Some(fastest) = rows.iter().find(|row| row.method == FASTEST).and_then(time) else {
        return Vec::new();
    };
    let others = rows.iter().filter(|row| row.method != FASTEST);
    others.filter_map(|row| Some(Ratio { to: row.method.clone(), ratio: fastest / time(row)? })).collect()
}

impl Comparison {
    /// The table in Markdown, readable as it is, with the bound and the ratios below.
    pub fn table(&self) -> String {
        let mut text = format!(
            "surface {}, scallop height {} mm, gouge tolerance {} mm, {} mm/min; every program here has passed the swept check\n\n",
            self.surface, self.scallop_height_mm, self.gouge_tolerance_mm, self.feed_mm_per_min
        );
        let heads = [
            "method",
            "smallest tool mm",
            "time s",
            "at feed s",
            "length mm",
            "patches",
            "passes",
            "retracts",
            "indexings",
            "gouge mm",
            "within %",
            "planned s",
        ];
        let mut lines = vec![heads.map(str::to_owned).to_vec()];
        for row in &self.rows {
            let mut cells = vec![row.method.clone(), format!("{:.1} r{}", row.tool_mm[0], row.tool_mm[1])];
            match &row.figures {
                Some(f) => cells.extend([
                    format!("{:.1}", f.machining_time_s),
                    format!("{:.1}", f.feed_time_s),
                    format!("{:.0}", f.cut_length_mm),
                    f.patches.to_string(),
                    f.passes.to_string(),
                    f.retracts.to_string(),
                    f.indexings.to_string(),
                    format!("{:.4}", f.gouge_max_mm),
                    format!("{:.3}", f.area_within_scallop * 100.0),
                    format!("{:.1}", f.planned_s),
                ]),
                None => {
                    cells.push("none".to_owned());
                    cells.resize(heads.len(), "-".to_owned());
                }
            }
            lines.push(cells);
        }
        let width = |column: usize| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..heads.len()).map(width).collect();
        for (i, line) in lines.iter().enumerate() {
            let cells = line.iter().zip(&widths).enumerate().map(|(column, (cell, &width))| {
                if column == 0 { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
            });
            text += &format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "));
            if i == 0 {
                let rule = |(column, width): (usize, &usize)| {
                    if column == 0 { "-".repeat(*width) } else { "-".repeat(width - 1) + ":" }
                };
                text +=
                    &format!("| {} |\n", widths.iter().enumerate().map(rule).collect::<Vec<_>>().join(" | "));
            }
        }
        text.push('\n');
        for row in &self.rows {
            if !row.reason.is_empty() {
                text += &format!("{}: no program: {}\n\n", row.method, row.reason);
            }
            for refused in &row.refused {
                let (diameter, corner) = (2.0 * (refused.r1_mm + refused.r2_mm), refused.r2_mm);
                text += &format!("{} with {diameter:.1} r{corner}: {}\n\n", row.method, refused.reason);
            }
        }
        if let Some(bound) = self.lower_bound_s {
            text += &format!(
                "lower bound: {bound:.1} s (every point cut by its own best orientation that keeps the rolling ball's lead, at the \
                 programmed feed, without links, retracts and machine limits)\n\n"
            );
        }
        for Ratio { to, ratio } in &self.ratios {
            text += &format!("fastest / {to}: {ratio:.3}\n\n");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(method: &str, time: Option<f64>) -> Row {
        Row {
            method: method.to_owned(),
            folder: None,
            tool_mm: [38.1, 6.0],
            figures: time.map(|machining_time_s| Figures {
                machining_time_s,
                feed_time_s: 1.0,
                cut_length_mm: 2.0,
                patches: 3,
                passes: 4,
                retracts: 5,
                indexings: 6,
                gouge_max_mm: 0.001,
                area_within_scallop: 0.9995,
                planned_s: 7.0,
            }),
            reason: if time.is_some() { String::new() } else { "gouges 0.2 mm".to_owned() },
            refused: vec![RefusedTool { r1_mm: 19.0, r2_mm: 6.0, reason: "gouges 0.5 mm".to_owned() }],
        }
    }

    #[test]
    fn a_row_without_a_program_says_why_instead_of_a_time() {
        let rows = vec![row("other", Some(20.0)), row("broken", None), row(FASTEST, Some(15.0))];
        let ratios = ratios(&rows);
        assert_eq!(ratios.iter().map(|r| (r.to.as_str(), r.ratio)).collect::<Vec<_>>(), [("other", 0.75)]);
        let comparison = Comparison {
            patchmill_version: "0",
            surface: "s.json".to_owned(),
            surface_id: String::new(),
            scallop_height_mm: 0.0254,
            gouge_tolerance_mm: 0.005,
            feed_mm_per_min: 2000.0,
            rows,
            lower_bound_s: Some(9.0),
            ratios,
        };
        let table = comparison.table();
        assert!(table.contains("broken: no program: gouges 0.2 mm"), "{table}");
        assert!(table.contains("other with 50.0 r6: gouges 0.5 mm"), "{table}");
        assert!(table.contains("fastest / other: 0.750") && table.contains("lower bound: 9.0 s"), "{table}");
        let lines: Vec<&str> = table.lines().filter(|line| line.starts_with('|')).collect();
        assert_eq!(lines.len(), 5);
        assert!(lines.iter().all(|line| line.chars().count() == lines[0].chars().count()), "{table}");
        assert!(lines.iter().all(|line| line.matches('|').count() == 13), "{table}");
    }
}
