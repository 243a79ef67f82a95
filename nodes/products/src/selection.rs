//! Which facets of a surface are to be finished; the others are check surface.

use nalgebra::{Unit, Vector3};

/// All conditions that are given must hold; without any all facets are finished.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Selection {
    /// The facet's normal lies within this cone.
    pub cone: Option<NormalCone>,
    /// All corners of the facet lie between these heights, m.
    pub band: Option<[f64; 2]>,
    /// First and last of runs of facets, by number as in the file, 0-based; empty: no condition.
    pub facets: Vec<[u32; 2]>,
    /// The facet is reached from a seed.
    pub seed: Option<Seed>,
    /// What an earlier plan has left standing.
    pub rest: Option<RestArea>,
}

/// Most cells of a rest: with the job's URDF a goal stays near 128 KiB.
pub const MOST_REST_CELLS: usize = 5_000;

/// What a plan has left standing, as the cells of a grid that hold it.
#[derive(Clone, Debug, PartialEq)]
pub struct RestArea {
    /// The surface that was planned; the same file and the other conditions give it.
    pub surface_id: String,
    /// Size of a cell, m.
    pub cell: f64,
    /// How far beyond the cells is finished too, m.
    pub overlap: f64,
    /// Place of every cell in cells from the origin, in order; at least one.
    pub cells: Vec<[i32; 3]>,
}

/// A cone of normals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NormalCone {
    /// Its axis.
    pub axis: Unit<Vector3<f64>>,
    /// Half of its opening, rad.
    pub angle: f64,
}

/// A facet from which a region grows over edges that bend by no more than an angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seed {
    /// By number as in the file, 0-based.
    pub facet: u32,
    /// Largest angle between the normals of neighbours, rad.
    pub crease: f64,
}

impl Selection {
    /// Whether no condition is given.
    pub fn is_all(&self) -> bool {
        *self == Self::default()
    }

    /// The same without what an earlier plan has left.
    pub fn without_rest(&self) -> Self {
        Self { rest: None, ..self.clone() }
    }
}
