//! A scanned point cloud made into a smooth triangle mesh.
//!
//! Read top-down: [`cloud_surface`] → spacing → [`point_grid`](patchmill_geometry::point_grid) → islands → [`local_fit`] at every point → [`direction`] → [`triangulate`](mod@triangulate)
//! over the projection along it → holes filled where asked. The surface has to be a height field along its mean normal, smooth
//! over the radius of the fits.

pub mod direction;
pub mod local_fit;
pub mod triangulate;

use nalgebra::{Point3, Vector3};
use patchmill_geometry::curvature::SmoothFit;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_products::stage::{Progress, StageError};
use rayon::prelude::*;

use crate::cloud::direction::{STEEP_COSINE, directions};
use crate::cloud::local_fit::{LocalFit, Neighbours, fit};
use crate::cloud::triangulate::{Facets, Projection, fill, triangulate};
use crate::error_code::{BAD_CONTENT, BAD_TOPOLOGY, NOISY_CLOUD};
use crate::raw::RawCloud;
use patchmill_geometry::point_grid::Grid;

/// Fewest points of a cloud, and of a part of it that is not dropped as an outlier …
const POINTS_MIN: usize = 30;
/// … which also has at least this share of the points.
const PART_SHARE_MIN: f64 = 1e-3;
/// Radius of the fits, spacings: the least, and the most where noise asks for it.
const RADIUS_SPACINGS: f64 = 4.0;
const RADIUS_SPACINGS_MAX: f64 = 8.0;
/// The fits are as wide as it takes for the noise to turn the normals by no more than about this angle, rad (0.1°).
const NORMAL_NOISE: f64 = 1.75e-3;
/// Deviation of a fit's slopes in units of noise / spacing / (radius in spacings)²: 2/√π for a quadric over a full circle of evenly
/// weighted points, twice that with the weights used and borders among them (measured on scans of a bowl).
const SLOPE_NOISE: f64 = 2.4;
/// Share of the points that a full circle has that is wanted for a fit: borders have it, corners are fitted over a wider one.
const CIRCLE_SHARE: f64 = 0.4;
/// Points further apart than this, spacings, belong to different parts.
const PART_GAP_SPACINGS: f64 = 3.0;
/// Of the points in a cube of this side, spacings, one is kept.
const THIN_SPACINGS: f64 = 0.2;
/// Vertices keep this distance from one another, spacings.
const VERTEX_SPACINGS: f64 = 0.4;
/// Points at which the noise is measured for the radius, about, and its deviation in units of the median of its size.
const NOISE_PLACES: usize = 2000;
const NOISE_OF_MEDIAN: f64 = 1.4826;
/// Points at which the spacing is measured, and the neighbours counted at each.
const SPACING_PLACES: usize = 256;
const SPACING_NEIGHBOURS: usize = 12;
/// Share of the points that may be outliers, and that may lie further off the surface than the tolerance.
const OUTLIER_SHARE_MAX: f64 = 0.1;
const SPIKE_SHARE_MAX: f64 = 0.01;
/// Share of the vertices that may be torn before the surface folds over.
const TORN_SHARE_MAX: f64 = 2e-3;
/// Holes wider than this, spacings, are never bridged.
const BRIDGE_SPACINGS_MAX: f64 = 200.0;

/// How a cloud is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CloudParams {
    /// Largest distance by which a point is moved onto the surface, m. A cloud of which more than 1 % of the points lie further off
    /// is refused; single ones are dropped.
    pub noise_tolerance: f64,
    /// Holes up to this extent, m, are bridged by the surface around them; 0: none.
    pub bridge_holes: f64,
}

/// What was found in a cloud.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CloudReport {
    /// Points of the file.
    pub points: usize,
    /// Of these, marked as no return of the scanner.
    pub no_return: usize,
    /// Repeating another point.
    pub duplicates: usize,
    /// Isolated points and small groups apart from the rest, dropped.
    pub isolated: usize,
    /// Points further off the surface than the noise tolerance, dropped.
    pub spikes: usize,
    /// Typical distance of neighbouring points, m.
    pub spacing: f64,
    /// Root mean square distance of the points from the surface, m.
    pub noise: f64,
    /// Largest distance by which a vertex was moved, m.
    pub moved: f64,
    /// Holes bridged.
    pub holes_bridged: usize,
    /// Holes left open.
    pub holes_open: usize,
}

impl std::fmt::Display for CloudReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} points {:.4} mm apart, noise {:.4} mm, moved by at most {:.4} mm",
            self.points,
            self.spacing * 1e3,
            self.noise * 1e3,
            self.moved * 1e3
        )?;
        for (count, what) in [
            (self.no_return, "without a return"),
            (self.duplicates, "repeated"),
            (self.isolated, "isolated ones dropped"),
            (self.spikes, "beyond the noise tolerance dropped"),
            (self.holes_bridged, "holes bridged"),
            (self.holes_open, "holes left open"),
        ] {
            if count > 0 {
                write!(f, ", {count} {what}")?;
            }
        }
        Ok(())
    }
}

/// The mesh of a cloud, with the normals and curvature of the fitted surface.
pub struct CloudSurface {
    /// Triangles and vertices, the normals those of `fit`; its `chord_error` is not yet known.
    pub mesh: TriangleMesh,
    /// Normals and curvature, no sharp vertices.
    pub fit: SmoothFit,
    /// What was found.
    pub report: CloudReport,
}

/// Makes the surface of `cloud` (m).
///
/// # Errors
/// Too few points, spacing too uneven for a surface, noise above the tolerance, a surface that folds over along its mean normal;
/// cancellation.
pub fn cloud_surface(
    cloud: RawCloud,
    params: &CloudParams,
    name: &str,
    progress: Progress<'_>,
) -> Result<CloudSurface, StageError> {
    let bad = |code: i32, text: String| StageError::new(code, format!("{name}: {text}"));
    let mut report = CloudReport {
        points: cloud.points.len() + cloud.no_return,
        no_return: cloud.no_return,
        ..CloudReport::default()
    };
    let mut points = without_repetitions(cloud.points);
    report.duplicates = report.points - report.no_return - points.len();
    if points.len() < POINTS_MIN {
        return Err(bad(
            BAD_CONTENT,
            format!(
                "{} different points are too few for a surface; at least {POINTS_MIN} were expected",
                points.len()
            ),
        ));
    }
    let spacing = spacing(&points);
    report.spacing = spacing;
    thin(&mut points, spacing);
    progress.check()?;
    let before = points.len();
    drop_islands(&mut points, spacing);
    (progress.report)(0.2);
    let radius = radius(&points, spacing);
    let grid = Grid::new(&points, radius);
    let fits = fit_all(&grid, &points, (radius, wanted(radius, spacing)), progress)?;
    let placed: Vec<LocalFit> = fits.iter().flatten().copied().collect();
    report.isolated = before - placed.len();
    if report.isolated as f64 > OUTLIER_SHARE_MAX * before as f64 {
        return Err(bad(
            BAD_CONTENT,
            format!(
                "{} of {before} points have no surface around them; evenly spaced points were expected (typical spacing {:.4} mm)",
                report.isolated,
                spacing * 1e3
            ),
        ));
    }
    let (kept, noise) =
        within_tolerance(&placed, params.noise_tolerance).map_err(|text| bad(NOISY_CLOUD, text))?;
    report.spikes = placed.len() - kept.len();
    report.noise = noise;
    (progress.report)(0.6);
    progress.check()?;

    let mut vertices = apart(&kept, VERTEX_SPACINGS * spacing);
    let (projection, mut facets) =
        height_field(&mut vertices, spacing).map_err(|text| bad(BAD_TOPOLOGY, text))?;
    progress.check()?;
    let holes = facets.holes.len();
    let most = params.bridge_holes.min(BRIDGE_SPACINGS_MAX * spacing);
    if facets.holes.iter().any(|hole| hole.extent <= most) {
        let filled = bridge(&facets, most, &vertices, &grid, &projection, spacing);
        vertices.extend(filled);
        facets = triangulate(&vertices, &projection, spacing).map_err(|text| bad(BAD_CONTENT, text))?;
    }
    report.holes_open = facets.holes.len();
    report.holes_bridged = holes.saturating_sub(facets.holes.len());
    report.moved = kept.iter().map(moved).fold(0.0, f64::max);
    (progress.report)(0.75);
    let (mesh, fit) = compact(&vertices, facets.triangles);
    if mesh.triangles.is_empty() {
        return Err(bad(
            BAD_CONTENT,
            "the points form no surface: no three of them are neighbours".to_owned(),
        ));
    }
    Ok(CloudSurface { mesh, fit, report })
}

/// The points without exact repetitions, in order.
fn without_repetitions(points: Vec<Point3<f64>>) -> Vec<Point3<f64>> {
    // + 0.0 turns −0 into 0.
    let mut keyed: Vec<([u64; 3], u32)> = points
        .par_iter()
        .enumerate()
        .map(|(i, p)| ([p.x + 0.0, p.y + 0.0, p.z + 0.0].map(f64::to_bits), i as u32))
        .collect();
    keyed.par_sort_unstable();
    let mut first = vec![false; points.len()];
    keyed.chunk_by(|a, b| a.0 == b.0).for_each(|same| first[same[0].1 as usize] = true);
    points.into_iter().zip(first).filter_map(|(p, first)| first.then_some(p)).collect()
}

/// Typical distance of neighbours, m: the side of the square that a point has for itself, by its nearest neighbours; the median over
/// places spread through the file.
fn spacing(points: &[Point3<f64>]) -> f64 {
    let places = SPACING_PLACES.min(points.len());
    let mut sides: Vec<f64> = (0..places)
        .into_par_iter()
        .map(|k| {
            let place = points[k * points.len() / places];
            let mut distances: Vec<f64> = points.iter().map(|p| (p - place).norm_squared()).collect();
            let wanted = SPACING_NEIGHBOURS.min(points.len() - 1);
            let reach = *distances.select_nth_unstable_by(wanted, f64::total_cmp).1;
            (std::f64::consts::PI * reach / (wanted as f64 + 0.5)).sqrt()
        })
        .collect();
    let half = sides.len() / 2;
    *sides.select_nth_unstable_by(half, f64::total_cmp).1
}

/// Keeps the first point of every small cube: clusters must not make the fits slow.
fn thin(points: &mut Vec<Point3<f64>>, spacing: f64) {
    let mut first = vec![false; points.len()];
    for cube in Grid::new(points, THIN_SPACINGS * spacing).cubes() {
        first[cube[0].1 as usize] = true;
    }
    let mut number = 0;
    points.retain(|_| {
        number += 1;
        first[number - 1]
    });
}

/// Drops the points of small groups that keep a distance from all others.
fn drop_islands(points: &mut Vec<Point3<f64>>, spacing: f64) {
    let grid = Grid::new(points, PART_GAP_SPACINGS * spacing);
    let mut group: Vec<u32> = vec![u32::MAX; points.len()];
    let (mut sizes, mut queue) = (Vec::new(), Vec::new());
    for start in 0..points.len() {
        if group[start] != u32::MAX {
            continue;
        }
        let number = sizes.len() as u32;
        group[start] = number;
        queue.push(start as u32);
        let mut size = 0;
        while let Some(i) = queue.pop() {
            size += 1;
            grid.near(&points[i as usize], PART_GAP_SPACINGS * spacing, |_, j| {
                if group[j as usize] == u32::MAX {
                    group[j as usize] = number;
                    queue.push(j);
                }
            });
        }
        sizes.push(size);
    }
    let least = POINTS_MIN.max((points.len() as f64 * PART_SHARE_MIN) as usize);
    let mut number = 0;
    points.retain(|_| {
        number += 1;
        sizes[group[number - 1] as usize] >= least
    });
}

/// Radius of the fits, m, by the noise at some of the points.
fn radius(points: &[Point3<f64>], spacing: f64) -> f64 {
    let least = RADIUS_SPACINGS * spacing;
    let grid = Grid::new(points, least);
    let step = points.len() / NOISE_PLACES + 1;
    let mut squares: Vec<f64> = points
        .par_iter()
        .step_by(step)
        .map_init(Neighbours::default, |neighbours, p| {
            fit(&grid, p, true, (least, wanted(least, spacing)), neighbours)
        })
        .flatten()
        .map(|fit| fit.residual * fit.residual / fit.variance)
        .collect();
    if squares.is_empty() {
        return least;
    }
    let half = squares.len() / 2;
    let noise = NOISE_OF_MEDIAN * squares.select_nth_unstable_by(half, f64::total_cmp).1.sqrt();
    let spacings = (SLOPE_NOISE * noise / spacing / NORMAL_NOISE).sqrt();
    spacings.clamp(RADIUS_SPACINGS, RADIUS_SPACINGS_MAX) * spacing
}

/// Points wanted for a fit.
fn wanted(radius: f64, spacing: f64) -> usize {
    (CIRCLE_SHARE * std::f64::consts::PI * (radius / spacing).powi(2)) as usize
}

fn fit_all(
    grid: &Grid,
    points: &[Point3<f64>],
    reach: (f64, usize),
    progress: Progress<'_>,
) -> Result<Vec<Option<LocalFit>>, StageError> {
    let mut fits = Vec::with_capacity(points.len());
    for part in points.chunks(1 << 16) {
        progress.check()?;
        fits.par_extend(
            part.par_iter()
                .map_init(Neighbours::default, |neighbours, p| fit(grid, p, true, reach, neighbours)),
        );
    }
    Ok(fits)
}

/// Distance by which the fit moved its point, m.
fn moved(fit: &LocalFit) -> f64 {
    fit.residual.abs() * (1.0 - fit.leverage)
}

/// The fits whose points lie within `tolerance` (m) of a fit without them, and the root mean square distance of these.
///
/// # Errors
/// When more than 1 % lie further off.
fn within_tolerance(fits: &[LocalFit], tolerance: f64) -> Result<(Vec<LocalFit>, f64), String> {
    let noise = |fits: &mut dyn Iterator<Item = &LocalFit>| {
        let (sum, count) = fits
            .fold((0.0, 0.0), |(sum, count), f| (sum + f.residual * f.residual / f.variance, count + 1.0));
        (sum / f64::max(count, 1.0)).sqrt()
    };
    let kept: Vec<LocalFit> = fits.iter().filter(|f| f.residual.abs() <= tolerance).copied().collect();
    let spikes = fits.len() - kept.len();
    if spikes as f64 > SPIKE_SHARE_MAX * fits.len() as f64 {
        return Err(format!(
            "the points are noisier than noise_tolerance_mm = {}: {:.1} % of them lie further than that from the smooth surface through \
             their neighbours (root mean square {:.4} mm); at most {} % may",
            tolerance * 1e3,
            spikes as f64 / fits.len() as f64 * 100.0,
            noise(&mut fits.iter()) * 1e3,
            SPIKE_SHARE_MAX * 100.0
        ));
    }
    let noise = noise(&mut kept.iter());
    Ok((kept, noise))
}

/// Turns all vertices to the side from which the surface is a height field, and triangulates them as seen from there.
///
/// # Errors
/// When there is no such side.
fn height_field(vertices: &mut [LocalFit], spacing: f64) -> Result<(Projection, Facets), String> {
    let normals: Vec<Vector3<f64>> = vertices.iter().map(|f| f.normal).collect();
    let mut first = None;
    for (direction, least) in directions(&normals) {
        let result = seen_along(&direction, least, vertices, spacing);
        match result {
            Ok(found) => return Ok(found),
            Err(text) => first = first.or(Some(text)),
        }
    }
    Err(first.unwrap_or_default())
}

fn seen_along(
    direction: &Vector3<f64>,
    least: f64,
    vertices: &mut [LocalFit],
    spacing: f64,
) -> Result<(Projection, Facets), String> {
    let cosine = |f: &LocalFit| f.normal.dot(direction).abs();
    let named = format!("its mean normal ({:.3}, {:.3}, {:.3})", direction.x, direction.y, direction.z);
    if least < STEEP_COSINE {
        let steepest = vertices.iter().min_by(|a, b| cosine(a).total_cmp(&cosine(b)));
        return Err(format!(
            "the surface is no height field along {named}: more than 1 % of it stands steeper than 80° to that{}",
            place(steepest)
        ));
    }
    vertices.iter_mut().filter(|f| f.normal.dot(direction) < 0.0).for_each(|f| *f = f.turned());
    let projection = Projection::along(direction);
    let facets = triangulate(vertices, &projection, spacing)?;
    if facets.torn.len() as f64 > TORN_SHARE_MAX * vertices.len() as f64 {
        return Err(format!(
            "the surface folds over along {named}: {} of its {} points lie over or under another sheet of it{}",
            facets.torn.len(),
            vertices.len(),
            place(facets.torn.first().map(|v| &vertices[*v as usize]))
        ));
    }
    Ok((projection, facets))
}

fn place(fit: Option<&LocalFit>) -> String {
    fit.map_or_else(String::new, |fit| {
        let p = fit.position;
        format!(", as at x = {:.3} mm, y = {:.3} mm, z = {:.3} mm", p.x * 1e3, p.y * 1e3, p.z * 1e3)
    })
}

/// The fits whose positions keep `distance` (m) from those before them.
fn apart(fits: &[LocalFit], distance: f64) -> Vec<LocalFit> {
    let positions: Vec<Point3<f64>> = fits.iter().map(|f| f.position).collect();
    let grid = Grid::new(&positions, distance);
    let mut dropped = vec![false; fits.len()];
    for i in 0..fits.len() {
        if !dropped[i] {
            grid.near(&positions[i], distance, |_, j| dropped[j as usize] |= j as usize > i);
        }
    }
    fits.iter().zip(dropped).filter(|(_, dropped)| !dropped).map(|(f, _)| *f).collect()
}

/// Vertices within the holes of at most `most` (m), on the surface fitted to the points around them.
fn bridge(
    facets: &Facets,
    most: f64,
    vertices: &[LocalFit],
    grid: &Grid,
    projection: &Projection,
    spacing: f64,
) -> Vec<LocalFit> {
    let mut neighbours = Neighbours::default();
    let mut bridged = Vec::new();
    for hole in facets.holes.iter().filter(|hole| hole.extent <= most) {
        let radius = hole.extent + RADIUS_SPACINGS * spacing;
        for place in fill(hole, vertices, projection, spacing) {
            let Some(fit) = fit(grid, &place, false, (radius, 0), &mut neighbours) else { continue };
            bridged.push(if fit.normal.dot(projection.direction()) < 0.0 { fit.turned() } else { fit });
        }
    }
    bridged
}

/// The mesh of the vertices that triangles use.
fn compact(vertices: &[LocalFit], mut triangles: Vec<[u32; 3]>) -> (TriangleMesh, SmoothFit) {
    let mut number = vec![u32::MAX; vertices.len()];
    triangles.iter().flatten().for_each(|v| number[*v as usize] = 0);
    let (mut mesh, mut fit) = (TriangleMesh::default(), SmoothFit::default());
    for (slot, vertex) in number.iter_mut().zip(vertices).filter(|(slot, _)| **slot == 0) {
        *slot = mesh.vertices.len() as u32;
        mesh.vertices.push(vertex.position);
        fit.normals.push(vertex.normal);
        fit.curvature.push(vertex.curvature);
    }
    triangles.iter_mut().flatten().for_each(|v| *v = number[*v as usize]);
    fit.sharp = vec![false; mesh.vertices.len()];
    mesh.normals.clone_from(&fit.normals);
    mesh.triangles = triangles;
    (mesh, fit)
}

#[cfg(test)]
mod tests;
