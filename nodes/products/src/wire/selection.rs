//! A selection of facets as a message.

use std::f64::consts::PI;

use nalgebra::Unit;
use patchmill_msgs::cdr::to_cdr;
use patchmill_msgs::msg;

use super::WireError;
use super::check::{expect, millimetres, unit_vectors, within};
use super::hash::ContentHash;
use super::provenance::check_id;
use super::vectors::{vector, vector_msg};
use crate::selection::{MOST_REST_CELLS, NormalCone, RestArea, Seed, Selection};

/// Most runs of facets: a request stays below 128 KiB.
const MOST_RUNS: usize = 12_000;
/// Smallest cell, m.
const SMALLEST_CELL: f64 = 1e-5;
/// Largest height, m.
const FARTHEST: f64 = 1e3;

impl Selection {
    /// Its message.
    pub fn to_msg(&self) -> msg::Selection {
        let [z_min, z_max] = self.band.unwrap_or_default();
        msg::Selection {
            by_normal: self.cone.is_some(),
            normal: self.cone.map_or_else(Default::default, |cone| vector_msg(&cone.axis)),
            normal_angle: self.cone.map_or(0.0, |cone| cone.angle),
            by_height: self.band.is_some(),
            z_min,
            z_max,
            facets: self.facets.iter().flatten().copied().collect(),
            by_seed: self.seed.is_some(),
            seed: self.seed.map_or(0, |seed| seed.facet),
            crease: self.seed.map_or(0.0, |seed| seed.crease),
            rest_of: self.rest.as_ref().map_or_else(String::new, |rest| rest.surface_id.clone()),
            rest_cell: self.rest.as_ref().map_or(0.0, |rest| rest.cell),
            rest_overlap: self.rest.as_ref().map_or(0.0, |rest| rest.overlap),
            rest_cells: self.rest.iter().flat_map(|rest| rest.cells.iter().flatten().copied()).collect(),
        }
    }

    /// sha256 (hex) of the CDR of its message.
    pub fn content_hash(&self) -> String {
        let mut hash = ContentHash::default();
        hash.bytes(&to_cdr(&self.to_msg()));
        hash.hex()
    }

    /// The selection of a message.
    ///
    /// # Errors
    /// When a value of a condition that is given is out of its range.
    pub fn from_msg(msg: &msg::Selection) -> Result<Self, WireError> {
        let cone = if msg.by_normal {
            let axis = vector(&msg.normal);
            unit_vectors("the axis of the cone of normals", &[axis])?;
            within("the angle of the cone of normals [rad]", msg.normal_angle, 0.0, PI)?;
            Some(NormalCone { axis: Unit::new_unchecked(axis), angle: msg.normal_angle })
        } else {
            None
        };
        let band = if msg.by_height {
            millimetres("the band's lower end", msg.z_min, -FARTHEST, FARTHEST)?;
            millimetres("the band's upper end", msg.z_max, msg.z_min, FARTHEST)?;
            Some([msg.z_min, msg.z_max])
        } else {
            None
        };
        let seed = if msg.by_seed {
            within("the crease angle [rad]", msg.crease, 0.0, PI)?;
            Some(Seed { facet: msg.seed, crease: msg.crease })
        } else {
            None
        };
        let (runs, rest) = msg.facets.as_chunks::<2>();
        expect(
            rest.is_empty(),
            "the length of the list of facets",
            msg.facets.len(),
            "pairs of first and last",
        )?;
        let expected = format!("at most {MOST_RUNS}");
        expect(runs.len() <= MOST_RUNS, "the number of runs of facets", runs.len(), &expected)?;
        if let Some([first, last]) = runs.iter().find(|[first, last]| first > last || *last == u32::MAX) {
            return Err(WireError::new(format!(
                "a run of facets is {first} to {last}, the first up to the last was expected"
            )));
        }
        let rest = if msg.rest_of.is_empty() { None } else { Some(rest_area(msg)?) };
        Ok(Self { cone, band, facets: runs.to_vec(), seed, rest })
    }
}

fn rest_area(msg: &msg::Selection) -> Result<RestArea, WireError> {
    check_id("rest_of", &msg.rest_of)?;
    millimetres("rest_cell", msg.rest_cell, SMALLEST_CELL, 1.0)?;
    millimetres("rest_overlap", msg.rest_overlap, 0.0, 0.1)?;
    let (cells, odd) = msg.rest_cells.as_chunks::<3>();
    expect(odd.is_empty(), "the length of rest_cells", msg.rest_cells.len(), "three numbers a cell")?;
    let expected = format!("1 to {MOST_REST_CELLS}");
    expect((1..=MOST_REST_CELLS).contains(&cells.len()), "the number of rest cells", cells.len(), &expected)?;
    let sorted = cells.windows(2).all(|w| w[0] < w[1]);
    expect(sorted, "the order of rest_cells", "another", "ascending, each cell once")?;
    Ok(RestArea {
        surface_id: msg.rest_of.clone(),
        cell: msg.rest_cell,
        overlap: msg.rest_overlap,
        cells: cells.to_vec(),
    })
}
