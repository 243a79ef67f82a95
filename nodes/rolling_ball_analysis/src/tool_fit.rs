//! Whether the tool fits into the part at all.

use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::extent::Extent;
use patchmill_products::field::RollingBallField;
use patchmill_products::job::Job;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::stage::StageError;

use crate::rest_zone::tightest_fit;
use crate::{CODE_TOOL_TOO_BIG, validate_field};

/// Share by which a tool must be smaller than the ball: beyond rounding, no more.
const TINY: f64 = 1e-9;

/// Refuses a tool whose radius R1 + R2 reaches a positive ball radius R* (less the stock allowance) anywhere: at
/// R* = R1 + R2 the tool would have to lie flat. Of a job that leaves such places standing one that has no other.
///
/// # Errors
/// Code 203 with the tightest place, its R* and the tool that would fit; 201 when samples and field do not match.
pub fn check_tool_fits(
    samples: &SurfaceSamples,
    field: &RollingBallField,
    job: &Job,
) -> Result<(), StageError> {
    validate_field(samples, field)?;
    let mut tightest = (0, f64::NEG_INFINITY);
    for (i, &curvature) in field.pseudo_curvature.iter().enumerate() {
        if curvature > tightest.1 {
            tightest = (i, curvature);
        }
    }
    let (place, curvature) = tightest;
    if job.leaves_rest() {
        return check_fits_somewhere(samples, field, job);
    }
    let cutter = job.tool.cutter;
    // A ball stopped by the stock that is left on the surface: smaller by the allowance.
    let room = 1.0 / curvature - job.stock_allowance;
    if curvature <= 0.0 || room > cutter.radius() * (1.0 + TINY) {
        return Ok(());
    }
    let p = samples.points[place] * 1e3;
    let allowance = if job.stock_allowance > 0.0 {
        format!(" less {:.3} mm stock allowance", job.stock_allowance * 1e3)
    } else {
        String::new()
    };
    Err(StageError::new(
        CODE_TOOL_TOO_BIG,
        format!(
            "the tool is too big for the part: at x={:.3} y={:.3} z={:.3} mm the largest ball that fits has \
             R*={:.3} mm{allowance}, the tool radius r1+r2 is {:.3} mm; {}; --allow-rest leaves such places standing and \
             lists them{}",
            p.x,
            p.y,
            p.z,
            1e3 / curvature,
            cutter.radius() * 1e3,
            fitting_tool(room, job),
            doubt_of_unit(samples, job)
        ),
    ))
}

/// Refuses a tool that fits nowhere.
fn check_fits_somewhere(
    samples: &SurfaceSamples,
    field: &RollingBallField,
    job: &Job,
) -> Result<(), StageError> {
    let limit = tightest_fit(job);
    let widest = (0..samples.len()).min_by(|&a, &b| {
        let [a, b] = [a, b].map(|i| field.pseudo_curvature[i]);
        a.total_cmp(&b)
    });
    let Some(widest) = widest.filter(|&i| field.pseudo_curvature[i] > limit) else { return Ok(()) };
    let p = samples.points[widest] * 1e3;
    let radius = 1.0 / field.pseudo_curvature[widest];
    Err(StageError::new(
        CODE_TOOL_TOO_BIG,
        format!(
            "the tool fits nowhere with leads up to {:.1} degrees: the largest ball of all samples has R*={:.3} mm, at x={:.3} \
             y={:.3} z={:.3} mm, the tool needs more than {:.3} mm; {}{}",
            job.rest_lead.to_degrees(),
            radius * 1e3,
            p.x,
            p.y,
            p.z,
            1e3 / limit,
            fitting_tool(radius - job.stock_allowance, job),
            doubt_of_unit(samples, job)
        ),
    ))
}

/// Whether the part may have come in a wrong unit: it is smaller than the cutter's diameter.
fn doubt_of_unit(samples: &SurfaceSamples, job: &Job) -> String {
    let small = 2.0 * job.tool.cutter.radius();
    Extent::of(&samples.points).map_or_else(String::new, |extent| extent.doubt_of_unit(small))
}

/// The largest tool of the same proportions for a ball of radius `room`: below it in any case, and with the
/// rolling-ball lead sin θ = R1/(R* − R2) within the job's largest inclination.
fn fitting_tool(room: f64, job: &Job) -> String {
    let cutter = job.tool.cutter;
    // Nothing of a whole micrometre.
    if room < 1e-6 {
        return "no tool fits there".into();
    }
    let fits = fitting_cutter(cutter, room, job.inclination_max);
    format!(
        "r1+r2 must be below {:.3} mm, and with leads up to {:.0} degrees a tool of the same shape fits up to \
         r1={:.3} r2={:.3} mm",
        floor(room) * 1e3,
        job.inclination_max.to_degrees(),
        fits.r1 * 1e3,
        fits.r2 * 1e3
    )
}

/// The largest cutter of a shape that fits a ball of radius `room` (m) with leads up to `lead` (rad), in whole micrometres.
pub fn fitting_cutter(shape: Cutter, room: f64, lead: f64) -> Cutter {
    let sin = lead.sin().clamp(0.0, 1.0);
    let scale = room * sin / (shape.r1 + shape.r2 * sin);
    // A ball-end has no lead to limit: it must only stay below the ball.
    let scale = scale.min(room / shape.radius() * (1.0 - 1e-6)).max(0.0);
    Cutter { r1: floor(shape.r1 * scale), r2: floor(shape.r2 * scale) }
}

/// Whole micrometres, m.
fn floor(metres: f64) -> f64 {
    (metres * 1e6).floor() * 1e-6
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CODE_INPUT;
    use nalgebra::{Point3, Vector3};

    fn one_sample(radius: f64) -> (SurfaceSamples, RollingBallField) {
        let points = vec![Point3::new(0.001, 0.002, 0.0), Point3::new(0.010, -0.020, 0.0305)];
        let samples = SurfaceSamples {
            points: points.clone(),
            normals: vec![Vector3::z(); 2],
            curvature_max: vec![0.0; 2],
            curvature_min: vec![0.0; 2],
            direction_max: vec![Vector3::x(); 2],
            area: vec![1e-6; 2],
            ..SurfaceSamples::default()
        };
        let field = RollingBallField {
            pseudo_curvature: vec![-5.0, 1.0 / radius],
            contact: points,
            shadow_radius: 0.032,
        };
        (samples, field)
    }

    #[test]
    fn text_names_the_place_the_radius_and_a_tool_that_fits() {
        let (samples, field) = one_sample(0.0190);
        let mut job = Job::default_for("s");
        let error = check_tool_fits(&samples, &field, &job).unwrap_err();
        assert_eq!(error.code, CODE_TOOL_TOO_BIG);
        for part in ["x=10.000 y=-20.000 z=30.500", "R*=19.000 mm", "19.050 mm", "below 19.000 mm"] {
            assert!(error.text.contains(part), "{part} is not in {}", error.text);
        }
        // What it recommends is taken.
        let number = |key: &str| {
            let at = error.text.rfind(key).unwrap() + key.len();
            error.text[at..].split_whitespace().next().unwrap().parse::<f64>().unwrap() * 1e-3
        };
        job.tool.cutter.r1 = number("r1=");
        job.tool.cutter.r2 = number("r2=");
        assert!((job.tool.cutter.r2 / job.tool.cutter.r1 - 6.0 / 13.05).abs() < 1e-3);
        check_tool_fits(&samples, &field, &job).unwrap();
        let lead = (job.tool.cutter.r1 / (0.019 - job.tool.cutter.r2)).asin();
        assert!(lead <= job.inclination_max && lead > job.inclination_max - 0.01);
    }

    #[test]
    fn the_bar_is_the_tool_radius_plus_allowance() {
        let mut job = Job::default_for("s");
        let verdict = |radius: f64, job: &Job| {
            let (samples, field) = one_sample(radius);
            check_tool_fits(&samples, &field, job).map_err(|e| e.code)
        };
        assert_eq!(verdict(0.01905, &job), Err(CODE_TOOL_TOO_BIG));
        assert_eq!(verdict(0.01906, &job), Ok(()));
        assert_eq!(verdict(-0.010, &job), Ok(()));
        job.stock_allowance = 0.0005;
        assert_eq!(verdict(0.0194, &job), Err(CODE_TOOL_TOO_BIG));
        assert_eq!(verdict(0.0196, &job), Ok(()));
        // With a rest only what fits nowhere is refused: the other sample is convex.
        let resting = Job { stock_allowance: 0.0, rest_lead: 0.5, ..job.clone() };
        assert_eq!(verdict(0.0010, &resting), Ok(()));
        let (samples, mut field) = one_sample(0.0010);
        field.pseudo_curvature[0] = 500.0;
        let error = check_tool_fits(&samples, &field, &resting).unwrap_err();
        assert!(error.code == CODE_TOOL_TOO_BIG && error.text.contains("fits nowhere"), "{error}");
        let (samples, _) = one_sample(0.1);
        assert_eq!(
            check_tool_fits(&samples, &RollingBallField::default(), &job).map_err(|e| e.code),
            Err(CODE_INPUT)
        );
    }
}
