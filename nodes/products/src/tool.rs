//! The tool assembly: cutter, flutes, shank and holder.

use patchmill_geometry::cutter::Cutter;
use patchmill_geometry::tool_stack::{Frustum, ToolStack};

/// One cylinder or cone of a holder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HolderSection {
    /// Along the tool axis, m.
    pub length: f64,
    /// At its end towards the tip, m.
    pub radius_low: f64,
    /// At its end towards the spindle, m.
    pub radius_high: f64,
}

/// The tool of a job, from the tip up: cutter, flutes, shank, holder, spindle nose. A tool whose `flute_length`,
/// `shank_radius` and `holder` are zero and empty is the cutter's own cylinder up to the nose.
#[derive(Clone, Debug, PartialEq)]
pub struct Tool {
    /// Shape of the cutting end.
    pub cutter: Cutter,
    /// The stick-out: from the spindle nose to the tool tip, m.
    pub length: f64,
    /// From the tip to the top of the flutes, m; 0: the cutter's cylinder goes up to the holder.
    pub flute_length: f64,
    /// Radius of the shank between flutes and holder, m; 0: the cutter's.
    pub shank_radius: f64,
    /// The holder from its lowest section up to the nose; empty: none.
    pub holder: Vec<HolderSection>,
}

impl Tool {
    /// A cutter's cylinder of the given length (m) without shank and holder.
    pub fn bare(cutter: Cutter, length: f64) -> Self {
        Self { cutter, length, flute_length: 0.0, shank_radius: 0.0, holder: Vec::new() }
    }

    /// Height of the holder, m.
    pub fn holder_length(&self) -> f64 {
        self.holder.iter().map(|s| s.length).sum()
    }

    /// Height of the holder's lowest point above the tip, m; the tool's length where there is no holder.
    pub fn holder_bottom(&self) -> f64 {
        self.length - self.holder_length()
    }

    /// Height of the top of the flutes above the tip, m.
    pub fn flute_top(&self) -> f64 {
        if self.flute_length > 0.0 { self.flute_length } else { self.holder_bottom() }
    }

    /// The shank between flutes and holder; `None` where the flutes reach the holder.
    pub fn shank(&self) -> Option<Frustum> {
        let (low, high) = (self.flute_top(), self.holder_bottom());
        let radius = if self.shank_radius > 0.0 { self.shank_radius } else { self.cutter.radius() };
        (high > low).then_some(Frustum { low, high, radius_low: radius, radius_high: radius })
    }

    /// Undersides of shank and holder where they are wider than the cutter, grown by `margin` (m). What is no wider is within
    /// the cutter's own cylinder, which the drops and the swept check keep clear.
    pub fn wide_stacks(&self, margin: f64) -> [ToolStack; 2] {
        let wide = |frusta: &[Frustum]| {
            let radius = self.cutter.radius();
            let wide: Vec<Frustum> = frusta.iter().filter_map(|f| f.wider_than(radius)).collect();
            ToolStack::new(&wide, margin)
        };
        [wide(self.shank().as_slice()), wide(&self.holder_frusta())]
    }

    /// The holder's sections over the tip, from the lowest up.
    pub fn holder_frusta(&self) -> Vec<Frustum> {
        let mut low = self.holder_bottom();
        let frustum = |s: &HolderSection| {
            let from = low;
            low += s.length;
            Frustum { low: from, high: low, radius_low: s.radius_low, radius_high: s.radius_high }
        };
        self.holder.iter().map(frustum).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_parts_fill_the_tool_from_the_flutes_to_the_nose() {
        let section = |length, radius_low, radius_high| HolderSection { length, radius_low, radius_high };
        let tool = Tool {
            flute_length: 0.03,
            shank_radius: 0.008,
            holder: vec![section(0.02, 0.012, 0.016), section(0.025, 0.0315, 0.0315)],
            ..Tool::bare(Cutter { r1: 0.004, r2: 0.006 }, 0.1)
        };
        let shank = tool.shank().unwrap();
        assert_eq!((shank.low, shank.radius_low), (0.03, 0.008));
        let holder = tool.holder_frusta();
        assert!((shank.high - holder[0].low).abs() < 1e-15 && (holder[0].low - 0.055).abs() < 1e-15);
        assert_eq!(holder[0].high, holder[1].low);
        assert!((holder[1].high - 0.1).abs() < 1e-15);
        let bare = Tool::bare(tool.cutter, 0.1);
        assert!(bare.shank().is_none() && bare.holder_frusta().is_empty() && bare.flute_top() == 0.1);
    }
}
