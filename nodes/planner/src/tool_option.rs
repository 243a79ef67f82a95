//! The tool assembly as typed: `--tool` and `--holder`, in mm.

use patchmill_geometry::cutter::Cutter;
use patchmill_products::job::{HolderSection, Tool};

use crate::job_options::number;

/// Tools by size: the one of the largest radius first, of equally large ones the one with the larger bottom.
pub fn largest_first(mut tools: Vec<Tool>) -> Vec<Tool> {
    let size = |tool: &Tool| (tool.cutter.radius(), tool.cutter.r1);
    tools.sort_by(|a, b| {
        let (a, b) = (size(a), size(b));
        b.0.total_cmp(&a.0).then(b.1.total_cmp(&a.1))
    });
    tools
}

/// A tool by diameter and corner radius, for people.
pub fn named(tool: &Tool) -> String {
    format!("⌀{:.2} r{:.2} mm", tool.cutter.radius() * 2e3, tool.cutter.r2 * 1e3)
}

/// The sections of a holder, from the lowest up to the spindle nose.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct HolderSections(pub Vec<HolderSection>);

/// The tool of `r1=MM,r2=MM[,length=MM][,flute=MM][,shank=MM]`, without holder; `shank` is a diameter.
///
/// # Errors
/// With what is wrong and an example.
pub fn tool(text: &str) -> Result<Tool, String> {
    let expected =
        "expected r1=MM,r2=MM,length=MM and perhaps flute=MM,shank=MM, for example r1=13.05,r2=6,length=100";
    let (mut r1, mut r2, mut length, mut flute, mut shank) = (None, None, 0.1, None, None);
    for part in text.split(',') {
        let (key, value) = part.split_once('=').ok_or_else(|| format!("`{part}` has no `=`; {expected}"))?;
        let value = number(value).map_err(|e| format!("{e}; {expected}"))? / 1e3;
        match key.trim() {
            "r1" => r1 = Some(value),
            "r2" => r2 = Some(value),
            "length" => length = value,
            "flute" => flute = Some(value),
            "shank" => shank = Some(value),
            other => return Err(format!("a tool has no `{other}`; {expected}")),
        }
    }
    let (Some(r1), Some(r2)) = (r1, r2) else { return Err(format!("r1 and r2 are needed; {expected}")) };
    if r1 < 0.0 || r2 < 0.0 || r1 + r2 <= 0.0 || length <= 0.0 {
        return Err("r1 and r2 must not be negative, their sum and the length must be above 0".to_owned());
    }
    if flute.is_some_and(|flute| flute < r2 || flute <= 0.0 || flute > length) {
        return Err(format!(
            "flute must be above 0, at least r2 = {} and at most length = {}",
            r2 * 1e3,
            length * 1e3
        ));
    }
    if shank.is_some_and(|shank| shank <= 0.0) || (shank.is_some() && flute.is_none()) {
        return Err("shank must be above 0 and needs flute, where it begins".to_owned());
    }
    let (flute_length, shank_radius) = (flute.unwrap_or(0.0), shank.unwrap_or(0.0) / 2.0);
    Ok(Tool { flute_length, shank_radius, ..Tool::bare(Cutter { r1, r2 }, length) })
}

/// The holder of `d=MM,l=MM;d=MM..MM,l=MM;…`, sections from the lowest up.
///
/// # Errors
/// With what is wrong and an example.
pub fn holder(text: &str) -> Result<HolderSections, String> {
    text.split(';').map(section).collect::<Result<_, _>>().map(HolderSections)
}

fn section(text: &str) -> Result<HolderSection, String> {
    let expected = "expected sections d=MM,l=MM or d=MM..MM,l=MM with `;` between, from the lowest up, for example d=32..40,l=30;d=63,l=25";
    let positive = |text: &str| match number(text) {
        Ok(mm) if mm > 0.0 => Ok(mm / 1e3),
        Ok(mm) => Err(format!("{mm} is not above 0; {expected}")),
        Err(e) => Err(format!("{e}; {expected}")),
    };
    let (mut diameters, mut length) = (None, None);
    for part in text.split(',') {
        let (key, value) = part.split_once('=').ok_or_else(|| format!("`{part}` has no `=`; {expected}"))?;
        match key.trim() {
            "d" => {
                let (low, high) = value.split_once("..").unwrap_or((value, value));
                diameters = Some((positive(low)?, positive(high)?));
            }
            "l" => length = Some(positive(value)?),
            other => return Err(format!("a holder section has no `{other}`; {expected}")),
        }
    }
    let (Some((low, high)), Some(length)) = (diameters, length) else {
        return Err(format!("section `{text}` needs d and l; {expected}"));
    };
    Ok(HolderSection { length, radius_low: low / 2.0, radius_high: high / 2.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cones_and_cylinders_are_read_from_the_lowest_up() {
        let sections = holder("d=20..32, l=30; d=63,l=25").unwrap().0;
        let of = |s: &HolderSection| [s.radius_low, s.radius_high, s.length].map(|v| (v * 1e6).round() / 1e3);
        assert_eq!(sections.iter().map(of).collect::<Vec<_>>(), [[10.0, 16.0, 30.0], [31.5, 31.5, 25.0]]);
    }

    #[test]
    fn what_is_no_holder_or_tool_is_refused_with_an_example() {
        for bad in ["", "d=1", "l=1", "d=0,l=1", "d=1,l=-2", "d=1..x,l=1", "d=1,l=1;", "r=1,l=1", "d=1,l=inf"]
        {
            let error = holder(bad).unwrap_err();
            assert!(error.contains("for example d="), "{bad}: {error}");
        }
        for bad in ["r1=0,r2=6,flute=5", "r1=0,r2=6,length=20,flute=21", "r1=1,r2=0,flute=0"] {
            assert!(tool(bad).unwrap_err().contains("flute"), "{bad}");
        }
        for bad in ["r1=0,r2=6,shank=6", "r1=0,r2=6,flute=9,shank=0"] {
            assert!(tool(bad).unwrap_err().contains("shank"), "{bad}");
        }
    }
}
