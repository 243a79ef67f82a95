//! `--select`: what of a surface is to be finished, in mm and degrees.

use std::path::Path;

use nalgebra::{Unit, Vector3};
use patchmill_node_runtime::regular_file;
use patchmill_products::selection::{NormalCone, Seed, Selection};

use crate::job_options::number;

/// Longest list of facets, bytes: one of two million.
const LIST_BYTES_MAX: u64 = 16 << 20;

const EXPECTED: &str =
    "expected normal=DEG, normal=X,Y,Z,DEG, z=MIN..MAX, facets=FILE or facet=N,crease=DEG (mm and degrees)";

/// One condition as typed.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// The text.
    pub text: String,
    /// What it says.
    pub rule: Rule,
}

/// What a condition says.
#[derive(Clone, Debug, PartialEq)]
pub enum Rule {
    /// The facet's normal lies within a cone.
    Normal(NormalCone),
    /// The facet lies within a band of heights, m.
    Height([f64; 2]),
    /// The facet's number is in one of these runs.
    Facets(Vec<[u32; 2]>),
    /// The facet is reached from a seed.
    Grown(Seed),
}

/// One condition of the command line.
///
/// # Errors
/// With what was expected; when the file of `facets=FILE` does not read.
pub fn condition(text: &str) -> Result<Condition, String> {
    let with = |what: String| format!("{what}; {EXPECTED}");
    let (key, value) = text.split_once('=').ok_or_else(|| with(format!("`{text}` is no condition")))?;
    let rule = match key {
        "normal" => cone(value).map(Rule::Normal).map_err(with),
        "z" => band(value).map(Rule::Height).map_err(with),
        "facets" => facets(Path::new(value)).map(Rule::Facets),
        "facet" => grown(value).map(Rule::Grown).map_err(with),
        other => Err(with(format!("`{other}` is no condition"))),
    };
    Ok(Condition { text: text.to_owned(), rule: rule? })
}

/// All conditions together.
///
/// # Errors
/// When one kind is given twice.
pub fn selection(conditions: &[Condition]) -> Result<Selection, String> {
    let mut all = Selection::default();
    for condition in conditions {
        let (kind, twice) = match &condition.rule {
            Rule::Normal(cone) => ("normal", all.cone.replace(*cone).is_some()),
            Rule::Height(band) => ("z", all.band.replace(*band).is_some()),
            Rule::Grown(seed) => ("facet", all.seed.replace(*seed).is_some()),
            Rule::Facets(runs) => ("facets", !std::mem::replace(&mut all.facets, runs.clone()).is_empty()),
        };
        if twice {
            return Err(format!(
                "--select {kind}=… is given twice; each kind of condition once was expected"
            ));
        }
    }
    Ok(all)
}

fn cone(text: &str) -> Result<NormalCone, String> {
    let numbers: Vec<f64> = text.split(',').map(number).collect::<Result<_, _>>()?;
    let (axis, degrees) = match numbers[..] {
        [degrees] => (Vector3::z(), degrees),
        [x, y, z, degrees] => (Vector3::new(x, y, z), degrees),
        _ => return Err(format!("`{text}` has {} numbers", numbers.len())),
    };
    let axis = Unit::try_new(axis, 1e-9).ok_or_else(|| format!("`{text}` names no direction"))?;
    if !(0.0..=180.0).contains(&degrees) {
        return Err(format!("{degrees} is not between 0 and 180 degrees"));
    }
    Ok(NormalCone { axis, angle: degrees.to_radians() })
}

fn band(text: &str) -> Result<[f64; 2], String> {
    let (low, high) = text.split_once("..").ok_or_else(|| format!("`{text}` is no range"))?;
    let (low, high) = (number(low)?, number(high)?);
    if low > high {
        return Err(format!("{low} is above {high}"));
    }
    Ok([low / 1e3, high / 1e3])
}

fn grown(text: &str) -> Result<Seed, String> {
    let (facet, crease) =
        text.split_once(",crease=").ok_or_else(|| format!("`{text}` lacks the angle of creases"))?;
    let degrees = number(crease)?;
    if !(0.0..=180.0).contains(&degrees) {
        return Err(format!("{degrees} is not between 0 and 180 degrees"));
    }
    Ok(Seed { facet: facet_number(facet)?, crease: degrees.to_radians() })
}

fn facet_number(text: &str) -> Result<u32, String> {
    text.trim().parse().map_err(|_| format!("`{text}` is no facet's number"))
}

/// Runs of numbers from a file of numbers and FIRST..LAST, separated by white space or commas, in order and merged.
fn facets(path: &Path) -> Result<Vec<[u32; 2]>, String> {
    let named = |e: String| format!("{}: {e}", path.display());
    let text = regular_file::read_text(path, LIST_BYTES_MAX)
        .map_err(|e| named(format!("{e}; expected a file that lists numbers of facets")))?;
    let words = text.split(|c: char| c.is_whitespace() || c == ',').filter(|word| !word.is_empty());
    let run = |word: &str| match word.split_once("..") {
        Some((first, last)) => Ok([facet_number(first)?, facet_number(last)?]),
        None => facet_number(word).map(|n| [n, n]),
    };
    let mut runs: Vec<[u32; 2]> = words.map(run).collect::<Result<_, String>>().map_err(named)?;
    if runs.is_empty() {
        return Err(named("it lists no facet; numbers from 0 on were expected".to_owned()));
    }
    runs.sort_unstable();
    let mut merged: Vec<[u32; 2]> = Vec::new();
    for [first, last] in runs {
        match merged.last_mut() {
            Some(run) if first <= run[1].saturating_add(1) => run[1] = run[1].max(last),
            _ => merged.push([first, last]),
        }
    }
    Ok(merged)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_are_read_and_put_together() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("facets.txt");
        std::fs::write(&file, "7, 3 4\n5..6\n\n10..12").unwrap();
        let picked = format!("facets={}", file.display());
        let typed = ["normal=60", "z=-5..20", &picked, "facet=8,crease=15"];
        let conditions: Vec<Condition> = typed.iter().map(|text| condition(text).unwrap()).collect();
        let all = selection(&conditions).unwrap();
        assert_eq!(all.cone, Some(NormalCone { axis: Vector3::z_axis(), angle: 60f64.to_radians() }));
        assert_eq!(all.band, Some([-0.005, 0.02]));
        assert_eq!(all.facets, [[3, 7], [10, 12]]);
        assert_eq!(all.seed, Some(Seed { facet: 8, crease: 15f64.to_radians() }));
        assert!(selection(&[]).unwrap().is_all());
        let twice = [condition("z=0..1").unwrap(), condition("z=1..2").unwrap()];
        assert!(selection(&twice).unwrap_err().contains("z=… is given twice"));
        match condition("normal=1,0,1,20").unwrap().rule {
            Rule::Normal(cone) => assert!((cone.axis.x - cone.axis.z).abs() < 1e-15),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn what_is_no_condition_is_refused_with_what_is() {
        for bad in [
            "",
            "up",
            "normal=",
            "normal=1,2",
            "normal=0,0,0,5",
            "normal=200",
            "z=5",
            "z=3..1",
            "facet=1",
            "facet=-1,crease=5",
            "side=1",
        ] {
            assert!(condition(bad).unwrap_err().contains("normal=X,Y,Z,DEG"), "{bad}");
        }
        assert!(condition("facets=/dev/zero").unwrap_err().contains("/dev/zero: it is not a regular file"));
        assert!(condition("facets=/no/such/file").unwrap_err().contains("/no/such/file"));
    }
}
