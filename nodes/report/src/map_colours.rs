//! Colours of the maps, the same as in the page's script.

/// Red, green, blue, each 0 to 1.
pub type Rgb = [f64; 3];

/// Radii are shown within this, m.
pub const RADIUS_LIMIT: f64 = 0.5;

const WHITE: Rgb = [0.97, 0.97, 0.97];
const RED: Rgb = [0.70, 0.09, 0.17];
const BLUE: Rgb = [0.13, 0.40, 0.67];
const OVER: Rgb = [0.36, 0.0, 0.42];
const UNDER: Rgb = [0.02, 0.10, 0.30];
/// A leftover within this factor of its bound counts as at it.
const AT_BOUND: f64 = 1.0005;

/// Colour of a rolling-ball radius, m: MATLAB's jet over ±[`RADIUS_LIMIT`], as in the paper; dark red at the limit and above.
pub fn of_radius(radius: f64) -> Rgb {
    let t = (radius / RADIUS_LIMIT).clamp(-1.0, 1.0) * 0.5 + 0.5;
    [3.0, 2.0, 1.0].map(|peak| (1.5 - (4.0 * t - peak).abs()).clamp(0.0, 1.0))
}

/// Colour of a pseudo-curvature, 1/m, by its radius.
pub fn of_curvature(curvature: f64) -> Rgb {
    let flat = curvature.abs() * RADIUS_LIMIT <= 1.0;
    of_radius(if flat { RADIUS_LIMIT.copysign(curvature) } else { 1.0 / curvature })
}

/// Colour of what is left, m: white on the surface, red at the scallop height, blue at the gouge tolerance, violet and dark blue
/// beyond them.
pub fn of_leftover(leftover: f64, scallop_height: f64, gouge_tolerance: f64) -> Rgb {
    if leftover > scallop_height * AT_BOUND {
        return OVER;
    }
    if leftover < -gouge_tolerance * AT_BOUND {
        return UNDER;
    }
    let (end, share) =
        if leftover > 0.0 { (RED, leftover / scallop_height) } else { (BLUE, -leftover / gouge_tolerance) };
    std::array::from_fn(|k| WHITE[k] + (end[k] - WHITE[k]) * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flats_are_dark_red_and_tight_balls_green() {
        assert_eq!(of_radius(0.5), [0.5, 0.0, 0.0]);
        assert_eq!(of_radius(9.0), [0.5, 0.0, 0.0]);
        assert_eq!(of_radius(-0.5), [0.0, 0.0, 0.5]);
        assert_eq!(of_radius(0.0), [0.5, 1.0, 0.5]);
        assert_eq!(of_curvature(0.0), of_radius(0.5));
        assert_eq!(of_curvature(-1.0), of_radius(-0.5));
        assert_eq!(of_curvature(4.0), of_radius(0.25));
    }

    #[test]
    fn bounds_of_what_is_left_have_their_colours() {
        let of = |l: f64| of_leftover(l, 25e-6, 5e-6);
        assert_eq!([of(0.0), of(26e-6), of(-6e-6)], [WHITE, OVER, UNDER]);
        assert!(
            (0..3).all(|k| (of(25e-6)[k] - RED[k]).abs() < 1e-9 && (of(-5e-6)[k] - BLUE[k]).abs() < 1e-9)
        );
    }

    #[test]
    fn the_script_has_the_same_colours() {
        let script = include_str!("../web/report.js");
        for (name, colour) in
            [("white", WHITE), ("red", RED), ("over", OVER), ("blue", BLUE), ("under", UNDER)]
        {
            let at = script.find(&format!("{name}: [")).unwrap() + name.len() + 3;
            let numbers = script[at..].split(']').next().unwrap().split(',');
            let numbers: Vec<f64> = numbers.map(|n| n.trim().parse().unwrap()).collect();
            assert_eq!(numbers, colour, "{name}");
        }
    }
}
