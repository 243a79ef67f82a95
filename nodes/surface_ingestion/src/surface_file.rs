//! Analytic surfaces as JSON: kind `bezier`, `nurbs` or `algebraic`.
//!
//! ```json
//! {"kind": "bezier", "units": "mm", "control_points": [[[0, 0, 1], …4], …4]}
//! {"kind": "nurbs", "units": "mm", "degrees": [2, 3], "knots": [[0, 0, 0, 1, 1, 1], […]],
//!  "control_points": [[[0, 0, 1], …as v asks], …as u asks], "weights": [[1, …], …]}
//! {"kind": "algebraic", "units": "mm", "expression": "3*sin(2*pi*x/100)", "x": [0, 100], "y": [0, 40]}
//! ```
//! Row i of a net holds the points along v at u's i-th place; weights are 1 where there are none. `name`, `comment` and `description` may
//! be added. Any other key is refused: a key that is not understood
//! (weights, a transformation) could mean another surface than the one that would be cut.

use nalgebra::{Point3, Vector3};
use patchmill_products::stage::StageError;
use serde_json::{Map, Value};

use crate::algebraic::Algebraic;
use crate::bezier::Bezier;
use crate::error_code::{BAD_CONTENT, BAD_EXPRESSION};
use crate::expression::Expression;
use crate::nurbs::{Nurbs, RationalNet};
use crate::parametric::ParametricSurface;
use crate::units::metres_per_unit;

const KINDS: &str = "\"bezier\", \"nurbs\" or \"algebraic\"";
/// Largest coordinate that is taken for a workpiece, m.
const COORDINATE_MAX: f64 = 1e3;

/// The surface of a JSON file; `name` is the file's in errors, `units` hold where the file has none.
///
/// # Errors
/// What is wrong with the file, key by key.
pub fn parse(bytes: &[u8], name: &str, units: &str) -> Result<Box<dyn ParametricSurface>, StageError> {
    let bad = |text: String| StageError::new(BAD_CONTENT, format!("{name}: {text}"));
    let value: Value = serde_json::from_slice(bytes).map_err(|e| bad(format!("not valid JSON: {e}")))?;
    let Value::Object(object) = value else {
        return Err(bad(format!("a JSON object was expected, found {}", kind_of(&value))));
    };
    let kind = text(&object, "kind").map_err(bad)?.unwrap_or_default();
    let units = text(&object, "units").map_err(bad)?.unwrap_or(units);
    let scale = metres_per_unit(units).map_err(|e| StageError::new(e.code, format!("{name}: {}", e.text)))?;
    match kind {
        "bezier" => {
            known_keys(&object, &["control_points"]).map_err(bad)?;
            let net = control_net(&object, scale).map_err(bad)?;
            Ok(Box::new(Bezier::new(net, format!("the Bézier net of {name}"))?))
        }
        "nurbs" => {
            known_keys(&object, &["degrees", "knots", "control_points", "weights"]).map_err(bad)?;
            let net = rational_net(&object, scale).map_err(bad)?;
            Ok(Box::new(Nurbs::new(net, format!("the NURBS net of {name}"))?))
        }
        "algebraic" => {
            known_keys(&object, &["expression", "x", "y"]).map_err(bad)?;
            let formula = text(&object, "expression").map_err(bad)?.ok_or_else(|| {
                bad("the key 'expression' is missing; a formula z = f(x, y) was expected".to_owned())
            })?;
            let (x, y) = (range(&object, "x", scale).map_err(bad)?, range(&object, "y", scale).map_err(bad)?);
            let parsed = Expression::parse(formula).map_err(|e| {
                StageError::new(
                    BAD_EXPRESSION,
                    format!("{name}: the expression \"{}\" cannot be read: {e}", short(formula)),
                )
            })?;
            let title = format!("the expression \"{}\" of {name}", short(formula));
            let unit = if units.is_empty() { "mm" } else { units };
            Ok(Box::new(Algebraic::new(parsed, x, y, scale, unit.to_owned(), title)))
        }
        "" => Err(bad(format!("the key 'kind' is missing; {KINDS} was expected"))),
        other => Err(bad(format!("kind \"{}\" is unknown; {KINDS} was expected", short(other)))),
    }
}

fn short(text: &str) -> String {
    if text.chars().count() <= 120 {
        text.to_owned()
    } else {
        text.chars().take(117).chain("...".chars()).collect()
    }
}

fn kind_of(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(b) => format!("the truth value {b}"),
        Value::Number(n) => format!("the number {n}"),
        Value::String(s) => format!("the text \"{}\"", short(s)),
        Value::Array(a) => format!("a list of {}", a.len()),
        Value::Object(_) => "an object".to_owned(),
    }
}

fn text<'a>(object: &'a Map<String, Value>, key: &str) -> Result<Option<&'a str>, String> {
    match object.get(key) {
        None => Ok(None),
        Some(Value::String(s)) => Ok(Some(s)),
        Some(other) => Err(format!("'{key}' must be a text, found {}", kind_of(other))),
    }
}

fn known_keys(object: &Map<String, Value>, own: &[&str]) -> Result<(), String> {
    let common = ["kind", "units", "name", "comment", "description"];
    match object.keys().find(|k| !common.contains(&k.as_str()) && !own.contains(&k.as_str())) {
        None => Ok(()),
        Some(key) => Err(format!(
            "the key '{}' is unknown; known are {}, {}",
            short(key),
            common.join(", "),
            own.join(", ")
        )),
    }
}

fn number(value: &Value, what: &str) -> Result<f64, String> {
    value
        .as_f64()
        .filter(|x| x.is_finite())
        .ok_or_else(|| format!("{what} must be a number, found {}", kind_of(value)))
}

fn list<'a>(value: &'a Value, count: usize, what: &str) -> Result<&'a [Value], String> {
    match value {
        Value::Array(a) if a.len() == count => Ok(a),
        other => Err(format!("{what} was expected, found {}", kind_of(other))),
    }
}

fn control_net(object: &Map<String, Value>, scale: f64) -> Result<[[Vector3<f64>; 4]; 4], String> {
    let points = object
        .get("control_points")
        .ok_or("the key 'control_points' is missing; a 4 × 4 net of [x, y, z] was expected")?;
    let mut net = [[Vector3::zeros(); 4]; 4];
    for (i, row) in
        list(points, 4, "'control_points' is not a 4 × 4 net: a list of 4 rows")?.iter().enumerate()
    {
        let row = list(
            row,
            4,
            &format!("'control_points' is not a 4 × 4 net: in row {} a list of 4 points", i + 1),
        )?;
        for (j, point) in row.iter().enumerate() {
            let what = format!("control point {} of row {}", j + 1, i + 1);
            net[i][j] = control_point(point, &what, scale)?;
        }
    }
    Ok(net)
}

fn control_point(point: &Value, what: &str, scale: f64) -> Result<Vector3<f64>, String> {
    let mut place = Vector3::zeros();
    for (k, x) in list(point, 3, &format!("{what}: [x, y, z]"))?.iter().enumerate() {
        let x = number(x, what)? * scale;
        if x.abs() > COORDINATE_MAX {
            return Err(format!(
                "{what} lies {:.0} m from the origin; at most {COORDINATE_MAX} m is allowed",
                x.abs()
            ));
        }
        place[k] = x;
    }
    Ok(place)
}

fn rational_net(object: &Map<String, Value>, scale: f64) -> Result<RationalNet, String> {
    let pair = |key: &str, what: &str| {
        let value =
            object.get(key).ok_or_else(|| format!("the key '{key}' is missing; {what} was expected"))?;
        list(value, 2, &format!("'{key}': {what}"))
    };
    let degree = |value: &Value| {
        let degree = value.as_u64().and_then(|d| usize::try_from(d).ok());
        degree.ok_or_else(|| format!("a degree must be a whole number, found {}", kind_of(value)))
    };
    let degrees = pair("degrees", "the degrees [of u, of v]")?;
    let knots = pair("knots", "two lists of knots [of u, of v]")?;
    let numbers = |list: &Value| -> Result<Vec<f64>, String> {
        rows(list, "knots")?.iter().map(|knot| number(knot, "a knot")).collect()
    };
    let points = rows(object.get("control_points").unwrap_or(&Value::Null), "'control_points'")?;
    let weights = object.get("weights").map(|weights| rows(weights, "'weights'")).transpose()?;
    if let Some(weights) = weights.filter(|weights| weights.len() != points.len()) {
        return Err(format!(
            "there are {} rows of weights and {} of control points",
            weights.len(),
            points.len()
        ));
    }
    let mut net = Vec::with_capacity(points.len());
    for (i, row) in points.iter().enumerate() {
        let row = rows(row, &format!("row {} of 'control_points'", i + 1))?;
        let weights = weights.map(|weights| {
            list(&weights[i], row.len(), &format!("row {} of 'weights': a list of {}", i + 1, row.len()))
        });
        let weights = weights.transpose()?;
        let point = |(j, point): (usize, &Value)| {
            let what = format!("control point {} of row {}", j + 1, i + 1);
            let weight =
                weights.map_or(Ok(1.0), |weights| number(&weights[j], &format!("the weight of {what}")));
            Ok((Point3::from(control_point(point, &what, scale)?), weight?))
        };
        net.push(row.iter().enumerate().map(point).collect::<Result<Vec<_>, String>>()?);
    }
    RationalNet::new(
        [degree(&degrees[0])?, degree(&degrees[1])?],
        [numbers(&knots[0])?, numbers(&knots[1])?],
        &net,
    )
}

fn rows<'a>(value: &'a Value, what: &str) -> Result<&'a [Value], String> {
    match value {
        Value::Array(list) if !list.is_empty() => Ok(list),
        other => Err(format!("{what} must be a list, found {}", kind_of(other))),
    }
}

fn range(object: &Map<String, Value>, key: &str, scale: f64) -> Result<[f64; 2], String> {
    let value = object
        .get(key)
        .ok_or_else(|| format!("the key '{key}' is missing; its range [low, high] was expected"))?;
    let ends = list(value, 2, &format!("'{key}': a range [low, high]"))?;
    let (low, high) = (number(&ends[0], &format!("'{key}'"))?, number(&ends[1], &format!("'{key}'"))?);
    if low >= high {
        return Err(format!("the range of '{key}' is empty: low {low} must be less than high {high}"));
    }
    if low.abs().max(high.abs()) * scale > COORDINATE_MAX {
        return Err(format!("the range of '{key}' reaches beyond {COORDINATE_MAX} m"));
    }
    Ok([low, high])
}
