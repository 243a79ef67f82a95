//! The tool in the frame of its tip.

use patchmill_products::job::Tool;

use crate::colours::{self, Rgb};
use crate::shape::{Form, Frame, Shape};

/// Discs that the corner's rounding is made of.
const DISCS: usize = 8;
/// Thickness of the shank as a share of the cutter's.
const SHANK_SHARE: f64 = 0.8;

/// The tool as cylinders about its axis: the cutting end in the namespace `cutter`, its rounded corner made of discs, each as
/// wide as the corner is in its middle; `shank`, from the top of the flutes (where the tool does not say it, one cutter
/// diameter above the tip) to the holder or the spindle's nose; and `holder`, its cones made of discs.
pub fn shapes(tool: &Tool) -> Vec<Shape> {
    let cutter = tool.cutter;
    let radius = cutter.radius();
    let nose = tool.holder_bottom();
    let top =
        if tool.flute_length > 0.0 { tool.flute_length } else { (2.0 * radius).max(cutter.r2).min(nose) };
    let shank = if tool.shank_radius > 0.0 { tool.shank_radius } else { SHANK_SHARE * radius };
    let mut shapes = Vec::new();
    let mut add = |ns: &str, colour: Rgb, low: f64, high: f64, radius: f64| {
        if high > low && radius > 0.0 {
            let id = shapes.iter().filter(|s: &&Shape| s.ns == ns).count() as i32;
            let form =
                Form::Cylinder { middle: 0.5 * (low + high), diameter: 2.0 * radius, height: high - low };
            shapes.push(Shape { ns: ns.to_owned(), id, frame: Frame::ToolTip, colour, form });
        }
    };
    let corner = cutter.r2.min(top);
    for disc in 0..DISCS {
        let at = |place: f64| corner * place / DISCS as f64;
        let below = cutter.r2 - at(disc as f64 + 0.5);
        let wide = cutter.r1 + (cutter.r2 * cutter.r2 - below * below).max(0.0).sqrt();
        add("cutter", colours::CUTTER, at(disc as f64), at(disc as f64 + 1.0), wide);
    }
    add("cutter", colours::CUTTER, corner, top, radius);
    add("shank", colours::SHANK, top, nose, shank);
    for part in tool.holder_frusta() {
        let discs = if part.radius_low == part.radius_high { 1 } else { DISCS };
        let at = |disc: f64, low: f64, high: f64| low + (high - low) * disc / discs as f64;
        for disc in 0..discs {
            let [low, middle, high] = [0.0, 0.5, 1.0].map(|share| disc as f64 + share);
            let wide = at(middle, part.radius_low, part.radius_high);
            add("holder", colours::HOLDER, at(low, part.low, part.high), at(high, part.low, part.high), wide);
        }
    }
    shapes
}

#[cfg(test)]
mod tests {
    use super::*;
    use patchmill_geometry::cutter::Cutter;

    fn cylinders(r1: f64, r2: f64, length: f64) -> Vec<(String, f64, f64, f64)> {
        let shapes = shapes(&Tool::bare(Cutter { r1, r2 }, length));
        let of = |s: &Shape| match s.form {
            Form::Cylinder { middle, diameter, height } => {
                (s.ns.clone(), middle - height / 2.0, middle + height / 2.0, diameter / 2.0)
            }
            _ => panic!(),
        };
        assert!(shapes.iter().all(|s| s.frame == Frame::ToolTip));
        shapes.iter().map(of).collect()
    }

    #[test]
    fn cylinders_fill_the_tool_from_tip_to_nose() {
        for (r1, r2) in [(0.01305, 0.006), (0.0, 0.008), (0.008, 0.0)] {
            let parts = cylinders(r1, r2, 0.1);
            let mut at = 0.0;
            for (ns, low, high, radius) in &parts {
                assert!((low - at).abs() < 1e-12 && high > low, "{ns} {low} {at}");
                let middle = 0.5 * (low + high);
                if ns == "cutter" && middle < r2 {
                    // The disc is as wide as the cutter's own profile in its middle.
                    let lift = Cutter { r1, r2 }.lift(*radius).unwrap();
                    assert!((lift - middle).abs() < 1e-9, "{lift} {middle}");
                } else {
                    assert!((radius - (r1 + r2) * if ns == "shank" { 0.8 } else { 1.0 }).abs() < 1e-12);
                }
                at = *high;
            }
            assert!((at - 0.1).abs() < 1e-12);
            assert_eq!(parts.last().unwrap().0, "shank");
        }
    }

    #[test]
    fn a_holder_reaches_from_the_shank_to_the_nose() {
        use patchmill_products::job::HolderSection;
        let holder = vec![
            HolderSection { length: 0.02, radius_low: 0.01, radius_high: 0.018 },
            HolderSection { length: 0.03, radius_low: 0.0315, radius_high: 0.0315 },
        ];
        let bare = Tool::bare(Cutter { r1: 0.002, r2: 0.006 }, 0.1);
        let shapes = shapes(&Tool { flute_length: 0.025, shank_radius: 0.007, holder, ..bare });
        let of = |ns: &str| -> Vec<(f64, f64, f64)> {
            let cylinders = shapes.iter().filter(|s| s.ns == ns).map(|s| match s.form {
                Form::Cylinder { middle, diameter, height } => {
                    (middle - height / 2.0, middle + height / 2.0, diameter)
                }
                _ => panic!(),
            });
            cylinders.collect()
        };
        let (shank, holder) = (of("shank"), of("holder"));
        assert_eq!((shank.len(), holder.len()), (1, DISCS + 1));
        assert!((shank[0].0 - 0.025).abs() < 1e-12 && (shank[0].1 - 0.05).abs() < 1e-12);
        assert!((holder[0].0 - 0.05).abs() < 1e-12 && (holder[0].2 - 0.021).abs() < 1e-12);
        assert!(holder.windows(2).all(|w| (w[1].0 - w[0].1).abs() < 1e-12 && w[1].2 > w[0].2));
        assert!((holder[DISCS].1 - 0.1).abs() < 1e-12 && (holder[DISCS].2 - 0.063).abs() < 1e-12);
    }

    #[test]
    fn a_stub_has_no_shank() {
        let parts = cylinders(0.02, 0.005, 0.03);
        assert!(parts.iter().all(|p| p.0 == "cutter") && (parts.last().unwrap().2 - 0.03).abs() < 1e-12);
    }
}
