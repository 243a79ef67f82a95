//! What machine_interface finds: time of every candidate, the choice, the program.

use nalgebra::Point3;

/// One candidate on the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct CandidateEvaluation {
    /// Place among the job's candidates, 0-based.
    pub index: u32,
    /// Number of patches.
    pub patch_count: u32,
    /// Whether it meets the job's tolerances on this machine.
    pub feasible: bool,
    /// Why not; empty when feasible.
    pub reason: String,
    /// Machining time with the machine's limits, s; 0 when infeasible.
    pub machining_time: f64,
    /// Length cut at feed, m; 0 when infeasible.
    pub cut_length: f64,
    /// Length of the rapid moves, m; 0 when infeasible.
    pub rapid_length: f64,
    /// Moves to another tool orientation.
    pub index_moves: u32,
}

/// All candidates and the choice.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// In order of index.
    pub candidates: Vec<CandidateEvaluation>,
    /// Place of the quickest feasible candidate whose program passed its proof.
    pub chosen: Option<u32>,
}

/// What the swept check of the written program found. Leftovers, shares and percentiles are of the area outside the rest regions; gouges are
/// looked for everywhere.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Proof {
    /// Largest depth below the surface, m, ≥ 0.
    pub gouge_max: f64,
    /// Largest leftover that any sample of the facets keeps, m.
    pub scallop_max: f64,
    /// Leftover that half of the area keeps within, m.
    pub scallop_p50: f64,
    /// Leftover that 90 % of the area keeps within, m.
    pub scallop_p90: f64,
    /// Leftover that 99 % of the area keeps within, m.
    pub scallop_p99: f64,
    /// Leftover that 99.9 % of the area keeps within, m.
    pub scallop_p999: f64,
    /// Share of the area whose leftover is within the scallop height.
    pub area_within_scallop: f64,
    /// Share of the area that no cut reached.
    pub uncut_area: f64,
    /// At most five places below the surface, the deepest first.
    pub deepest: Vec<ProofSpot>,
    /// At most five places where most is left, the highest first.
    pub highest: Vec<ProofSpot>,
    /// Left standing where the tool does not fit: all rest regions together, m².
    pub rest_area: f64,
    /// The largest rest regions, at most [`REST_REGIONS`], the largest first.
    pub rest: Vec<RestRegion>,
}

/// Most rest regions that a proof lists.
pub const REST_REGIONS: usize = 64;

/// A connected part of the surface that the tool does not fit: left standing, never gouged.
#[derive(Clone, Debug, PartialEq)]
pub struct RestRegion {
    /// Its tightest place, on the facets, `workpiece` frame, m.
    pub position: Point3<f64>,
    /// Corners of its bounding box, m.
    pub bounds: [Point3<f64>; 2],
    /// m².
    pub area: f64,
    /// Smallest rolling ball in it, as far as the samples tell, m: a tool whose radius is below it fits all of it.
    pub ball_radius: f64,
    /// Most that is left along the normal, m; at most [`UNTOUCHED`].
    pub leftover_max: f64,
}

/// A place of the surface and what the program leaves there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProofSpot {
    /// On the facets, `workpiece` frame, m.
    pub position: Point3<f64>,
    /// Along the normal, m; negative below the surface.
    pub leftover: f64,
}

/// What the program leaves at every point of the swept check, both arrays of the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ResidualMap {
    /// Points on the facets, `workpiece` frame, m.
    pub points: Vec<Point3<f64>>,
    /// Leftover along the normal, m, negative below the surface; at most [`UNTOUCHED`].
    pub leftover: Vec<f64>,
}

/// Leftover that counts as untouched, m.
pub const UNTOUCHED: f64 = 1e-3;
