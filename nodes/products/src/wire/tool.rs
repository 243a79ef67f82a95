//! The tool assembly as a message.

use patchmill_geometry::cutter::Cutter;
use patchmill_msgs::msg;

use super::WireError;
use super::check::{expect, millimetres};
use crate::tool::{HolderSection, Tool};

/// Most sections of a holder.
const MAX_SECTIONS: usize = 32;

/// What the sum of flutes and holder may pass the tool's length by, m: sums of decimal millimetres.
const LENGTH_SLACK: f64 = 1e-9;

/// The tool's message.
pub(super) fn tool_msg(tool: &Tool) -> msg::Tool {
    let section = |s: &HolderSection| msg::HolderSection {
        length: s.length,
        radius_low: s.radius_low,
        radius_high: s.radius_high,
    };
    msg::Tool {
        r1: tool.cutter.r1,
        r2: tool.cutter.r2,
        length: tool.length,
        flute_length: tool.flute_length,
        shank_radius: tool.shank_radius,
        holder: tool.holder.iter().map(section).collect(),
    }
}

/// The tool of a message, not yet checked.
pub(super) fn tool_from_msg(msg: &msg::Tool) -> Tool {
    let section = |s: &msg::HolderSection| HolderSection {
        length: s.length,
        radius_low: s.radius_low,
        radius_high: s.radius_high,
    };
    Tool {
        cutter: Cutter { r1: msg.r1, r2: msg.r2 },
        length: msg.length,
        flute_length: msg.flute_length,
        shank_radius: msg.shank_radius,
        holder: msg.holder.iter().map(section).collect(),
    }
}

/// Whether every length is in its range and the parts fit into the tool's length.
///
/// # Errors
/// With the first one that is not, in mm.
pub(super) fn check_tool(tool: &Tool) -> Result<(), WireError> {
    let (cutter, length) = (tool.cutter, tool.length);
    millimetres("tool r1", cutter.r1, 0.0, 1.0)?;
    millimetres("tool r2", cutter.r2, 0.0, 1.0)?;
    millimetres("the tool's radius r1 + r2", cutter.radius(), 1e-6, 1.0)?;
    millimetres("the tool's length", length, 1e-3, 10.0)?;
    if tool.flute_length != 0.0 {
        millimetres("the tool's flute_length", tool.flute_length, cutter.r2, length)?;
    }
    if tool.shank_radius != 0.0 {
        millimetres("the tool's shank_radius", tool.shank_radius, 1e-6, 1.0)?;
        let shank = format!("{} mm", tool.shank_radius * 1e3);
        expect(tool.flute_length != 0.0, "without a flute_length, shank_radius", shank, "0 mm")?;
    }
    let sections = tool.holder.len();
    expect(sections <= MAX_SECTIONS, "the number of holder sections", sections, "at most 32")?;
    for (i, section) in tool.holder.iter().enumerate() {
        let i = i + 1;
        millimetres(&format!("the length of holder section {i}"), section.length, 1e-6, length)?;
        millimetres(&format!("the low radius of holder section {i}"), section.radius_low, 1e-6, 1.0)?;
        millimetres(&format!("the high radius of holder section {i}"), section.radius_high, 1e-6, 1.0)?;
    }
    let parts = tool.flute_length.max(cutter.r2) + tool.holder_length();
    let expected = format!("at most the tool's length of {} mm", length * 1e3);
    let sum = format!("{:.6} mm", parts * 1e3);
    let fits = tool.holder.is_empty() || parts <= length + LENGTH_SLACK;
    expect(fits, "the length of cutting part and holder together", sum, &expected)
}
