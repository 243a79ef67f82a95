//! Tool axis, feed direction and gouge-free passes of every patch of a candidate partition. Pure: no ROS, no I/O.
//!
//! Per patch: the paper's rule gives four orientations (normals' ellipse, both axes, both senses), the one of least
//! estimated time is kept; passes lie in parallel planes spaced by the scallop height; every cutter location is the exact
//! drop of the cutter on the whole mesh; the swept check measures what is left and spaces anew where that is too much.
//!
//! Where the tool has a shank or holder wider than its cutter, an orientation on which they would touch the part at the
//! patch's dense points or along its passes is refused, and more feed directions and leans than the paper's are tried
//! ([`axis_choice`]). When none is left the candidate is infeasible, and its reason names the least stick-out (or flute length)
//! that works: the exact raise along the axis ([`patchmill_geometry::tool_stack`]) of the orientation that lacks least.
//!
//! With [`Strategy::Fastest`](patchmill_products::job::Strategy) a patch's axis and feed direction come from a search over all that
//! keep the limits ([`patchmill_orientation::axis_search`]), its passes follow the surface ([`patchmill_orientation::pass_curves`]) and are cut back to what nothing else
//! cuts ([`pass_trimming`]), and only the candidates that begin as the quickest are worked on to the end
//! ([`candidate_ranking`]).
//!
//! With [`Strategy::FiveAxis`](patchmill_products::job::Strategy) the surface is one patch, and every cutter location has the
//! rolling ball's own tool axis ([`five_axis`]); with `Sturz` the least lead everywhere. With `ThreeAxis` it is one patch with the
//! axis along +z. [`least_length`] bounds what any of them that keeps the rolling ball's lead can reach.
//!
//! SI units, `workpiece` frame, curvature positive where concave as seen from the tool side.

pub mod assembly;
pub mod axis_choice;
pub mod candidate;
pub mod candidate_ranking;
pub mod cut_cover;
pub mod five_axis;
pub mod least_length;
pub mod linking;
pub mod node;
pub mod pass_cut;
pub mod pass_layout;
pub mod pass_trimming;
pub mod patch;
pub mod piece_order;
pub mod sample_interpolation;
pub mod step_profile;
pub mod strips;
pub mod surface_cloud;

use std::f64::consts::FRAC_PI_6;
use std::sync::Arc;

use nalgebra::{Point3, Vector4};
use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::extent::Extent;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_geometry::point_grid::Grid;
use patchmill_geometry::sweep::ProofPoints;
use patchmill_products::field::RollingBallField;
use patchmill_products::job::{Job, Strategy};
use patchmill_products::partition::feature;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::{Progress, StageError};
use patchmill_rolling_ball_analysis::local_balls::LocalBalls;
use patchmill_rolling_ball_analysis::rest_zone::{RestZone, tightest_fit};
use rayon::prelude::*;

use pass_trimming::fewer;
use patchmill_orientation::cloud_point::CloudPoint;
use sample_interpolation::SampleInterpolation;
use surface_cloud::surface_cloud;

pub use candidate::plan_candidate;
pub use candidate_ranking::plan_candidates;

/// Inputs do not belong together or are empty.
pub const BAD_INPUT: i32 = 401;
/// The mesh's facet error leaves nothing of the scallop height.
pub const NO_SCALLOP_BUDGET: i32 = 402;

/// The cutter is too small for so large a surface.
pub const TOO_MANY_PASSES: i32 = 403;

/// Distance of the points that passes are trimmed by, as a share of that of the swept check's: never the same points as the check's or
/// the program's proof's, whatever the size of the surface, or neither would see what is left between them.
const TRIMMING_SHARE: f64 = 0.5;

/// One in so many points of the swept check is looked at where candidates are compared.
const COMPARED: usize = 3;

/// Points of the swept check on small parts, where its spacing would give less.
const LEAST_CHECKED: f64 = 2e3;

/// Points of the swept check are no farther apart than this share of the step-over on a plane ...
const CHECKED_SHARE: f64 = 0.25;
/// ... at this lead, rad: a steep one.
const STEEP_LEAD: f64 = FRAC_PI_6;

/// How to compute (the job says what to make).
#[derive(Clone, Debug, PartialEq)]
pub struct PathParams {
    /// Dense points on which axes and step-overs are decided.
    pub cloud_points: usize,
    /// Distance of the swept check's points on the facets, m; less where the cutter's step-over is small, enlarged so that no more than
    /// `check_points` are used.
    pub check_spacing: f64,
    /// Largest number of points of the swept check.
    pub check_points: usize,
    /// Most rounds of spacing passes anew after the swept check.
    pub respacing_rounds: usize,
    /// Most passes side by side over a square of the surface's area: more lie closer together than the dense points they are laid by.
    pub max_passes: usize,
}

impl Default for PathParams {
    fn default() -> Self {
        Self {
            cloud_points: 40_000,
            check_spacing: 0.6e-3,
            check_points: 250_000,
            respacing_rounds: 4,
            max_passes: 4000,
        }
    }
}

/// A surface made ready once a job, for all candidates.
pub struct PreparedSurface {
    mesh: Arc<TriangleMesh>,
    bvh: Bvh,
    shapes: SampleInterpolation,
    cloud: Vec<CloudPoint>,
    check: ProofPoints,
    /// Whether each of them lies where the tool does not fit and the job leaves what is there standing; empty where none does.
    rest: Vec<bool>,
    /// A share of them, by which candidates are compared.
    compared: ProofPoints,
    /// Points that passes are trimmed by: closer, as what lies between them is not seen. None where nothing is trimmed.
    trimming: ProofPoints,
    /// [x, y, z, κ*] of every point of the swept check.
    check_features: Vec<Vector4<f64>>,
}

impl PreparedSurface {
    /// Builds the hierarchy, the dense points and the swept check's points.
    ///
    /// # Errors
    /// [`BAD_INPUT`] for empty or mismatched inputs, [`TOO_MANY_PASSES`] for cutters tiny beside the surface, [`NO_SCALLOP_BUDGET`] where facet and chord error use up the
    /// scallop height on more than 0.05 % of the area; SUPERSEDED when cancelled.
    pub fn new(
        mesh: Arc<TriangleMesh>,
        samples: &SurfaceSamples,
        field: &RollingBallField,
        job: &Job,
        params: &PathParams,
        progress: Progress,
    ) -> Result<Self, StageError> {
        let n = samples.len();
        if n == 0 || mesh.triangles.is_empty() || field.pseudo_curvature.len() != n {
            let found = (mesh.triangles.len(), n, field.pseudo_curvature.len());
            return Err(StageError::new(
                BAD_INPUT,
                format!(
                    "path generation needs a mesh, samples and one pseudo-curvature a sample, found {} triangles, {} \
                     samples, {} values",
                    found.0, found.1, found.2
                ),
            ));
        }
        let area = mesh.finished_area();
        check_pass_count(&mesh, area, job, params.max_passes)?;
        let shapes = SampleInterpolation::new(samples, field);
        let mut cloud = surface_cloud(&mesh, &shapes, (area / params.cloud_points as f64).sqrt());
        check_scallop_budget(&mesh, &cloud, job)?;
        progress.check()?;
        cloud.extend((0..n).map(|i| border_point(samples, field, &shapes, i)));
        let bvh = Bvh::build(&mesh);
        let balls = job.leaves_rest().then(|| LocalBalls::of(&mesh, &bvh, job));
        progress.check()?;
        if let Some(balls) = &balls {
            cloud = where_it_fits(cloud, balls, job)?;
        }
        let spacing = check_spacing(params, job, area);
        let check = ProofPoints::on_finished(&mesh, spacing);
        let compared = fewer(&check, COMPARED);
        let trimming = match job.strategy {
            Strategy::Fastest => ProofPoints::on_finished(&mesh, TRIMMING_SHARE * spacing),
            _ => ProofPoints::default(),
        };
        progress.check()?;
        let zone = balls.map(|balls| RestZone::of(&balls, &check.points, &check.normals, job).within);
        let rest = zone.filter(|zone| zone.contains(&true)).unwrap_or_default();
        let trimming = if rest.is_empty() { trimming } else { outside(trimming, &check, &rest, spacing) };
        let check_features =
            check.points.par_iter().map(|p| feature(p, shapes.at(p).pseudo_curvature)).collect();
        progress.check()?;
        Ok(Self { mesh, bvh, shapes, cloud, check, rest, compared, trimming, check_features })
    }
}

/// Refuses what could only be cut in endless time, before it is tried.
fn check_pass_count(mesh: &TriangleMesh, area: f64, job: &Job, max_passes: usize) -> Result<(), StageError> {
    let cutter = job.tool.cutter;
    let step = cutter.step_over_on_plane(job.lead_min, job.scallop_height).min(cutter.radius());
    let count = area.sqrt() / step;
    if count <= max_passes as f64 {
        return Ok(());
    }
    let text = format!(
        "the cutter is too small for the surface: with a radius of {:.4} mm and a scallop height of {:.4} mm its passes lie about {:.4} \
         mm apart, some {count:.0} of them side by side on {:.1} mm²; at most {max_passes} (max_passes) are planned, a larger tool or scallop height or \
         a part of the surface (--select) was expected{}",
        cutter.radius() * 1e3,
        job.scallop_height * 1e3,
        step * 1e3,
        area * 1e6,
        Extent::of(&mesh.vertices).map_or_else(String::new, |extent| extent.doubt_of_unit(0.0))
    );
    Err(StageError::new(TOO_MANY_PASSES, text))
}

/// Distance of the swept check's points, m: ridges between passes have to be seen, which small cutters leave close together.
fn check_spacing(params: &PathParams, job: &Job, area: f64) -> f64 {
    let ridges = CHECKED_SHARE * job.tool.cutter.step_over_on_plane(STEEP_LEAD, job.scallop_height);
    let spacing = if ridges > 0.0 { ridges.min(params.check_spacing) } else { params.check_spacing };
    let [most, least] = [params.check_points as f64, LEAST_CHECKED].map(|count| (area / count).sqrt());
    spacing.min(least).max(most)
}

/// The dense points at which the tool fits, each with the ball of its own place: beside tight places that changes fast.
///
/// # Errors
/// [`BAD_INPUT`] where there are none.
fn where_it_fits(
    cloud: Vec<CloudPoint>,
    balls: &LocalBalls,
    job: &Job,
) -> Result<Vec<CloudPoint>, StageError> {
    let (points, normals): (Vec<_>, Vec<_>) = cloud.iter().map(|p| (p.position, p.normal)).unzip();
    let curvatures = balls.curvatures(&points, &normals);
    let limit = tightest_fit(job);
    let own = cloud.into_iter().zip(curvatures);
    let fitting: Vec<CloudPoint> = own
        .filter(|(_, curvature)| *curvature <= limit)
        .map(|(p, pseudo_curvature)| CloudPoint { pseudo_curvature, ..p })
        .collect();
    if fitting.iter().any(|p| p.area > 0.0) {
        return Ok(fitting);
    }
    let text = format!(
        "the tool fits nowhere with leads up to {:.1}°; a smaller tool was expected",
        job.rest_lead.to_degrees()
    );
    Err(StageError::new(BAD_INPUT, text))
}

/// Of some points those that are not nearer to a point of the rest than to another one of the check, `spacing` (m) apart.
fn outside(points: ProofPoints, check: &ProofPoints, rest: &[bool], spacing: f64) -> ProofPoints {
    let grid = Grid::new(&check.points, 2.0 * spacing);
    let stays = |p: &Point3<f64>| {
        let mut nearest = (f64::INFINITY, 0);
        grid.near(p, 2.0 * spacing, |q, i| {
            let distance = (q - p).norm_squared();
            if (distance, i) < nearest {
                nearest = (distance, i);
            }
        });
        !(nearest.0.is_finite() && rest[nearest.1 as usize])
    };
    let stays: Vec<bool> = points.points.par_iter().map(stays).collect();
    points.only(&stays)
}

/// A sample as a dense point that stands for no area: samples lie on the border, the facets' points do not.
fn border_point(
    samples: &SurfaceSamples,
    field: &RollingBallField,
    shapes: &SampleInterpolation,
    i: usize,
) -> CloudPoint {
    CloudPoint {
        position: samples.points[i],
        normal: samples.normals[i],
        pseudo_curvature: field.pseudo_curvature[i],
        curvature: shapes.at(&samples.points[i]).curvature,
        facet_error: 0.0,
        area: 0.0,
    }
}

fn check_scallop_budget(mesh: &TriangleMesh, cloud: &[CloudPoint], job: &Job) -> Result<(), StageError> {
    let total: f64 = cloud.iter().map(|p| p.area).sum();
    let spent = |p: &&CloudPoint| p.facet_error + job.pass_chord >= 0.9 * job.scallop_height;
    let lacking: f64 = cloud.iter().filter(spent).map(|p| p.area).sum();
    if lacking <= 5e-4 * total {
        return Ok(());
    }
    let worst = cloud.iter().map(|p| p.facet_error).fold(0.0, f64::max);
    Err(StageError::new(
        NO_SCALLOP_BUDGET,
        format!(
            "the mesh is too coarse for a scallop height of {:.4} mm: its facets stand up to {:.4} mm off the smooth \
             surface, and with the chord of {:.4} mm that leaves less than a tenth of the scallop height on {:.1} % of the \
             area; expected a mesh of at most {:.4} mm facet error{}",
            job.scallop_height * 1e3,
            worst * 1e3,
            job.pass_chord * 1e3,
            100.0 * lacking / total,
            (0.9 * job.scallop_height - job.pass_chord).max(0.0) * 1e3,
            Extent::of(&mesh.vertices).map_or_else(String::new, |extent| extent.doubt_of_unit(0.0))
        ),
    ))
}
