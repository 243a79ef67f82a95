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
}
