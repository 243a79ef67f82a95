//! `--rest-of DIR`: what the plan in a folder has left standing, as a condition on what of the surface is to be finished.

use std::path::Path;

use nalgebra::Point3;
use patchmill_machine_interface::rest_regions::standing_points;
use patchmill_products::selection::{MOST_REST_CELLS, RestArea, Selection};
use serde::{Deserialize, Serialize};

use crate::plan_folder;
use crate::report_command::finished_plan;
use crate::select_option::{Condition, condition, selection};

/// Size of the cells that hold what is left, m; doubled until they are few enough.
const CELL: f64 = 0.5e-3;
/// The second job goes on so far beyond what is left, m: over the seam, where the first one's last pass has its own.
const OVERLAP: f64 = 0.5e-3;

/// The plan whose rest is finished, in `summary.json`.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct RestOf {
    /// Its folder as it was named.
    pub plan: String,
    /// Content hash of the surface without the condition on the rest.
    pub surface_id: String,
}

/// What is needed of the earlier plan's `summary.json`.
#[derive(Deserialize)]
struct Summary {
    surface_id: String,
    #[serde(default)]
    select: Vec<String>,
    rest_of: Option<RestOf>,
}

/// What a job finishes.
pub struct Finished {
    /// For surface_ingestion.
    pub selection: Selection,
    /// The conditions of `--select`, as text.
    pub select: Vec<String>,
    /// The plan whose rest it is.
    pub rest_of: Option<RestOf>,
}

/// What a job finishes by `--select` and `--rest-of`.
///
/// # Errors
/// As [`selection`]; with `--rest-of` when the folder holds no plan or one that has left nothing, or when `--select` differs from that
/// plan's.
pub fn finished(select: &[Condition], rest_of: Option<&Path>) -> Result<Finished, String> {
    let texts = |conditions: &[Condition]| conditions.iter().map(|c| c.text.clone()).collect::<Vec<_>>();
    let Some(folder) = rest_of else {
        return Ok(Finished { selection: selection(select)?, select: texts(select), rest_of: None });
    };
    let earlier = summary_of(folder)?;
    if !select.is_empty() && texts(select) != earlier.select {
        return Err(format!(
            "--select differs from that of the plan in {} ({}); leave it away or give the same",
            folder.display(),
            if earlier.select.is_empty() { "everything".to_owned() } else { earlier.select.join(" ") }
        ));
    }
    let conditions: Vec<Condition> =
        earlier.select.iter().map(|text| condition(text)).collect::<Result<_, _>>()?;
    // Of a plan that finished a rest itself the surface is that of the first one.
    let surface_id = earlier.rest_of.map_or(earlier.surface_id, |first| first.surface_id);
    let area = area_of(folder, &surface_id)?;
    let selection = Selection { rest: Some(area), ..selection(&conditions)? };
    let plan = folder.display().to_string();
    Ok(Finished { selection, select: earlier.select, rest_of: Some(RestOf { plan, surface_id }) })
}

fn summary_of(folder: &Path) -> Result<Summary, String> {
    plan_folder::summary(folder).map_err(|e| format!("--rest-of {e}"))
}

fn area_of(folder: &Path, surface_id: &str) -> Result<RestArea, String> {
    let plan = finished_plan(folder).map_err(|e| format!("--rest-of {e}"))?;
    let points = if plan.job.leaves_rest() && plan.program.proof.rest_area > 0.0 {
        standing_points(&plan.mesh, &plan.residual, &plan.job)
    } else {
        Vec::new()
    };
    if points.is_empty() {
        return Err(format!(
            "--rest-of {}: its plan left nothing standing, there is nothing to finish; a plan made with --allow-rest that lists rest \
             regions was expected",
            folder.display()
        ));
    }
    let spacing = (plan.mesh.finished_area() / plan.residual.points.len().max(1) as f64).sqrt();
    let (cell, cells) = cells_of(&points, CELL.max(1.25 * spacing));
    Ok(RestArea { surface_id: surface_id.to_owned(), cell, overlap: OVERLAP.max(spacing), cells })
}

/// The cells that hold points, of this size (m) or of the least power of two of it with which they are few enough.
fn cells_of(points: &[Point3<f64>], mut size: f64) -> (f64, Vec<[i32; 3]>) {
    loop {
        let cell = |p: &Point3<f64>| [p.x, p.y, p.z].map(|x| (x / size).floor() as i32);
        let mut cells: Vec<[i32; 3]> = points.iter().map(cell).collect();
        cells.sort_unstable();
        cells.dedup();
        if cells.len() <= MOST_REST_CELLS {
            return (size, cells);
        }
        size *= 2.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_hold_all_points_and_stay_few() {
        let points: Vec<Point3<f64>> = (0..40_000)
            .map(|i| Point3::new(f64::from(i % 200) * 0.4e-3, f64::from(i / 200) * 0.4e-3 - 0.04, -1e-4))
            .collect();
        let (size, cells) = cells_of(&points, 0.5e-3);
        assert!(cells.len() <= MOST_REST_CELLS && cells.len() > MOST_REST_CELLS / 8, "{}", cells.len());
        assert!(cells.windows(2).all(|w| w[0] < w[1]) && size == 2e-3);
        let inside = |p: &Point3<f64>| {
            let cell = [p.x, p.y, p.z].map(|x| (x / size).floor() as i32);
            cells.binary_search(&cell).is_ok()
        };
        assert!(points.iter().all(inside));
    }

    #[test]
    fn a_folder_without_a_plan_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let Err(error) = finished(&[], Some(folder.path())) else { panic!("no error") };
        assert!(error.contains("summary.json") && error.contains("patchmill plan"), "{error}");
        std::fs::write(
            folder.path().join("summary.json"),
            r#"{"surface_id": "ab", "select": ["normal=60"], "rest_of": null}"#,
        )
        .unwrap();
        let Err(error) = finished(&[condition("normal=50").unwrap()], Some(folder.path())) else {
            panic!("no error")
        };
        assert!(error.contains("normal=60") && error.contains("the same"), "{error}");
    }
}
