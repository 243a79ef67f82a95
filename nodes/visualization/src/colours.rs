//! Colours: a palette for the patches, a map for the rolling ball's radius.

/// Red, green, blue, each 0 to 1.
pub type Rgb = [f32; 3];

/// A surface without patches.
pub const NEUTRAL: Rgb = [0.62, 0.62, 0.62];
/// What is not to be finished, only not to be gouged.
pub const CHECK_SURFACE: Rgb = [0.40, 0.40, 0.40];
/// The tool's cutting end.
pub const CUTTER: Rgb = [0.85, 0.65, 0.13];
/// Its shank.
pub const SHANK: Rgb = [0.45, 0.47, 0.50];
/// Its holder.
pub const HOLDER: Rgb = [0.25, 0.27, 0.32];
/// Arrows of the tool axes.
pub const TOOL_AXIS: Rgb = [0.10, 0.10, 0.10];
/// Arrows of the feed directions.
pub const FEED_DIRECTION: Rgb = [0.95, 0.95, 0.95];
/// The patches' numbers.
pub const NUMBER: Rgb = [0.0, 0.0, 0.0];

/// Paul Tol's qualitative scheme "muted", distinct for all common kinds of colour vision.
const PALETTE: [Rgb; 9] = [
    rgb(0x88_CC_EE),
    rgb(0xCC_66_77),
    rgb(0xDD_CC_77),
    rgb(0x11_77_33),
    rgb(0x33_22_88),
    rgb(0xAA_44_99),
    rgb(0x44_AA_99),
    rgb(0x99_99_33),
    rgb(0x88_22_55),
];

/// A ball of this radius or more counts as flat, m.
pub const RADIUS_LIMIT: f64 = 0.5;
/// Colours of a tight hollow (concave, radius to +0), of a flat and of a tight bump (convex, radius to −0).
const HOLLOW: Rgb = rgb(0xB2_18_2B);
const FLAT: Rgb = rgb(0xF7_F7_F7);
const BUMP: Rgb = rgb(0x21_66_AC);

const fn rgb(hex: u32) -> Rgb {
    let [_, r, g, b] = hex.to_be_bytes();
    [r as f32 / 255.0, g as f32 / 255.0, b as f32 / 255.0]
}

/// Colour of a patch by its number in the partition; the tenth patch has the first one's colour again.
pub fn patch(number: usize) -> Rgb {
    PALETTE[number % PALETTE.len()]
}

/// Colour of the passes of a patch: its own, darker on a light patch and lighter on a dark one.
pub fn passes(number: usize) -> Rgb {
    let colour = patch(number);
    let light = 0.2126 * colour[0] + 0.7152 * colour[1] + 0.0722 * colour[2];
    mix(colour, if light > 0.4 { [0.0; 3] } else { [1.0; 3] }, 0.6)
}

/// A radius, m, positive where concave, as it is shown: within ±[`RADIUS_LIMIT`]; of a curvature of 0 the positive limit.
pub fn shown_radius(curvature: f64) -> f64 {
    let radius = 1.0 / curvature;
    if radius.is_finite() { radius.clamp(-RADIUS_LIMIT, RADIUS_LIMIT) } else { RADIUS_LIMIT }
}

/// Colour of a radius, m: white where flat (either limit), the redder the tighter the hollow, the bluer the tighter the
/// bump. Nothing jumps where the curvature changes its sign.
pub fn of_radius(radius: f64) -> Rgb {
    let tightness = 1.0 - (radius.abs() / RADIUS_LIMIT).min(1.0);
    mix(FLAT, if radius >= 0.0 { HOLLOW } else { BUMP }, tightness as f32)
}

/// Colour of what is left, m: white on the surface, red at the scallop height and above, blue as far below the surface.
pub fn of_leftover(leftover: f64, scallop_height: f64) -> Rgb {
    let share = (leftover.abs() / scallop_height).min(1.0);
    mix(FLAT, if leftover >= 0.0 { HOLLOW } else { BUMP }, share as f32)
}

fn mix(from: Rgb, to: Rgb, share: f32) -> Rgb {
    // Exact at both ends.
    std::array::from_fn(|i| from[i] * (1.0 - share) + to[i] * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn palette_colours_differ_and_stand_off_from_grey_and_from_their_passes() {
        let distance = |a: Rgb, b: Rgb| (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f32::max);
        for i in 0..PALETTE.len() {
            assert!(distance(patch(i), NEUTRAL) > 0.12, "{i}");
            assert!(distance(patch(i), passes(i)) > 0.3, "{i}");
            for j in 0..i {
                assert!(distance(patch(i), patch(j)) > 0.12, "{i} {j}");
            }
        }
        assert_eq!(patch(0), patch(9));
    }

    #[test]
    fn the_map_ends_in_its_end_colours() {
        assert_eq!(of_radius(0.0), HOLLOW);
        assert_eq!(of_radius(-1e-9).map(|c| (c * 255.0).round()), BUMP.map(|c| (c * 255.0).round()));
        for flat in [RADIUS_LIMIT, -RADIUS_LIMIT, 3.0, -3.0, f64::INFINITY] {
            assert_eq!(of_radius(flat), FLAT);
        }
    }

    #[test]
    fn hollows_and_bumps_of_one_size_are_equally_far_from_white() {
        let share = |colour: Rgb, end: Rgb| (colour[1] - FLAT[1]) / (end[1] - FLAT[1]);
        let mut before = 1.1;
        for i in 1..20 {
            let radius = 0.025 * f64::from(i);
            let (hollow, bump) = (share(of_radius(radius), HOLLOW), share(of_radius(-radius), BUMP));
            assert!((hollow - bump).abs() < 1e-5, "{radius}: {hollow} {bump}");
            assert!(hollow < before);
            before = hollow;
        }
    }

    #[test]
    fn leftovers_are_coloured_by_their_share_of_the_scallop_height() {
        assert_eq!([0.0, 25e-6, 1e-3].map(|l| of_leftover(l, 25e-6)), [FLAT, HOLLOW, HOLLOW]);
        assert_eq!(of_leftover(-25e-6, 25e-6), BUMP);
    }

    #[test]
    fn radii_are_shown_within_the_limit() {
        assert_eq!(shown_radius(10.0), 0.1);
        assert_eq!(shown_radius(-4.0), -0.25);
        assert_eq!(shown_radius(1e-3), RADIUS_LIMIT);
        assert_eq!(shown_radius(-1e-3), -RADIUS_LIMIT);
        assert_eq!(shown_radius(0.0), RADIUS_LIMIT);
        assert_eq!(shown_radius(-0.0), RADIUS_LIMIT);
    }
}
