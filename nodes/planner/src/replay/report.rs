//! What a comparison found, for people and as JSON.

use std::fmt::Write as _;

use serde::Serialize;

use super::tolerances::{RULES, Rule, Tolerance};

/// Differing places of a field that are shown.
const SHOWN: usize = 3;
/// Longest value that is shown, characters.
const LONGEST: usize = 160;

/// A place where recorded and live values differ.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Place {
    /// Where, in words: candidate, patch, index, line.
    pub at: String,
    /// What was recorded.
    pub recorded: String,
    /// What the live nodes gave.
    pub now: String,
}

/// What was found of one field.
#[derive(Clone, Debug)]
pub struct FieldReport {
    /// The table's line.
    pub rule: &'static Rule,
    /// Values compared.
    pub compared: u64,
    /// Values beyond the tolerance.
    pub differing: u64,
    /// Largest difference of numbers, in the tolerance's unit, or as a share where that is the tolerance.
    pub largest: f64,
    /// The first differing places.
    pub places: Vec<Place>,
}

impl FieldReport {
    fn found(&mut self, same: bool, at: impl FnOnce() -> String, values: impl FnOnce() -> [String; 2]) {
        self.compared += 1;
        if same {
            return;
        }
        self.differing += 1;
        if self.places.len() < SHOWN {
            let [recorded, now] = values().map(|text| shortened(&text));
            self.places.push(Place { at: at(), recorded, now });
        }
    }

    /// Compares values that must be the same.
    pub fn exact<T: PartialEq + std::fmt::Debug>(
        &mut self,
        at: impl FnOnce() -> String,
        recorded: &T,
        now: &T,
    ) {
        self.found(recorded == now, at, || [format!("{recorded:?}"), format!("{now:?}")]);
    }

    /// Compares numbers.
    pub fn number(&mut self, at: impl FnOnce() -> String, recorded: f64, now: f64) {
        self.difference((now - recorded).abs(), recorded.abs().max(now.abs()), at, || {
            [recorded.to_string(), now.to_string()]
        });
    }

    /// Compares points or vectors by their distance.
    pub fn vector(&mut self, at: impl FnOnce() -> String, recorded: [f64; 3], now: [f64; 3]) {
        let norm = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
        let distance = norm(std::array::from_fn(|i| now[i] - recorded[i]));
        self.difference(distance, norm(recorded).max(norm(now)), at, || {
            [recorded, now].map(|v| format!("{v:?}"))
        });
    }

    fn difference(
        &mut self,
        difference: f64,
        magnitude: f64,
        at: impl FnOnce() -> String,
        values: impl FnOnce() -> [String; 2],
    ) {
        let (measured, most) = match self.rule.tolerance {
            Tolerance::Exact => (difference, 0.0),
            Tolerance::Within(most, _) => (difference, most),
            Tolerance::Share(most) => {
                (if difference > 0.0 { difference / magnitude } else { difference }, most)
            }
        };
        // A difference that is no number counts as the largest.
        self.largest = if measured >= self.largest || measured.is_nan() { measured } else { self.largest };
        self.found(measured <= most, at, values);
    }

    /// Whether two lists can be compared element by element; if not, their lengths are the difference.
    pub fn same_length(&mut self, at: impl FnOnce() -> String, recorded: usize, now: usize) -> bool {
        if recorded != now {
            let count =
                |at: String| if at.is_empty() { "length".to_owned() } else { format!("{at}: length") };
            self.found(false, || count(at()), || [recorded.to_string(), now.to_string()]);
        }
        recorded == now
    }
}

fn shortened(text: &str) -> String {
    match text.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// What a comparison found.
#[derive(Clone, Debug)]
pub struct Report {
    /// One entry a line of the table.
    pub fields: Vec<FieldReport>,
    /// Products that were recorded and did not come.
    pub missing: Vec<String>,
    /// Products that came and were not recorded.
    pub unrecorded: Vec<String>,
    /// What else a reader has to know.
    pub notes: Vec<String>,
}

impl Default for Report {
    fn default() -> Self {
        let field = |rule| FieldReport { rule, compared: 0, differing: 0, largest: 0.0, places: Vec::new() };
        let fields = RULES.iter().map(field).collect();
        Self { fields, missing: Vec::new(), unrecorded: Vec::new(), notes: Vec::new() }
    }
}

impl Report {
    /// The entry of a field.
    ///
    /// # Panics
    /// When the table has no such field: a mistake in the comparison, which the tests find.
    pub fn field(&mut self, product: &str, field: &str) -> &mut FieldReport {
        let known = RULES.iter().position(|rule| rule.product == product && rule.field == field);
        match known {
            Some(at) => &mut self.fields[at],
            None => panic!("the table of tolerances has no {product}: {field}"),
        }
    }

    /// Whether nothing differs and nothing is missing.
    pub fn same(&self) -> bool {
        self.missing.is_empty() && self.unrecorded.is_empty() && self.fields.iter().all(|f| f.differing == 0)
    }

    /// A table, the differing places and the result, for a person.
    pub fn text(&self, heading: &str) -> String {
        let mut text = format!("{heading}\n");
        // Writing into a String cannot fail.
        let _ = writeln!(
            text,
            "{:<28} {:<30} {:>9}  {:<18} {:>18}",
            "product", "field", "compared", "tolerance", "largest difference"
        );
        let compared: Vec<&FieldReport> = self.fields.iter().filter(|f| f.compared > 0).collect();
        for f in &compared {
            let Rule { product, field, tolerance } = f.rule;
            let largest = if f.largest == 0.0 { "0".to_owned() } else { format!("{:.3e}", f.largest) };
            let verdict = if f.differing == 0 { "ok".to_owned() } else { format!("{} DIFFER", f.differing) };
            let tolerance = tolerance.to_string();
            let _ = writeln!(
                text,
                "{product:<28} {field:<30} {:>9}  {tolerance:<18} {largest:>18}  {verdict}",
                f.compared
            );
        }
        for f in &compared {
            for Place { at, recorded, now } in &f.places {
                let at = if at.is_empty() { String::new() } else { format!(" {at}:") };
                let _ = writeln!(
                    text,
                    "differs: {}: {}:{at} recorded {recorded}, now {now}",
                    f.rule.product, f.rule.field
                );
            }
        }
        self.missing
            .iter()
            .for_each(|name| text += &format!("differs: {name} was recorded and did not come\n"));
        self.unrecorded
            .iter()
            .for_each(|name| text += &format!("differs: {name} came and was not recorded\n"));
        self.notes.iter().for_each(|note| text += &format!("note: {note}\n"));
        let differing =
            compared.iter().filter(|f| f.differing > 0).count() + self.missing.len() + self.unrecorded.len();
        let result = match differing {
            0 => format!("the same: {} fields\n", compared.len()),
            _ => format!("NOT the same: {differing} of {} fields and products differ\n", compared.len()),
        };
        text + &result
    }

    /// The same as JSON; `heading` are the first keys.
    ///
    /// # Errors
    /// None that can be expected: the data are plain.
    pub fn json(&self, heading: &impl Serialize) -> Result<String, String> {
        let whole = Json {
            heading,
            same: self.same(),
            fields: self.fields.iter().filter(|f| f.compared > 0).map(JsonField::of).collect(),
            missing: &self.missing,
            unrecorded: &self.unrecorded,
            notes: &self.notes,
        };
        serde_json::to_string_pretty(&whole).map(|text| text + "\n").map_err(|e| format!("the report: {e}"))
    }
}

#[derive(Serialize)]
struct Json<'a, H: Serialize> {
    #[serde(flatten)]
    heading: &'a H,
    same: bool,
    fields: Vec<JsonField<'a>>,
    missing: &'a [String],
    unrecorded: &'a [String],
    notes: &'a [String],
}

#[derive(Serialize)]
struct JsonField<'a> {
    product: &'static str,
    field: &'static str,
    compared: u64,
    differing: u64,
    tolerance: String,
    /// Null when it is no number.
    largest_difference: Option<f64>,
    places: &'a [Place],
}

impl<'a> JsonField<'a> {
    fn of(f: &'a FieldReport) -> Self {
        Self {
            product: f.rule.product,
            field: f.rule.field,
            compared: f.compared,
            differing: f.differing,
            tolerance: f.rule.tolerance.to_string(),
            largest_difference: f.largest.is_finite().then_some(f.largest),
            places: &f.places,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tolerances::{FIELD, MESH, PARTITION, PROGRAM};
    use super::*;

    fn here() -> String {
        "here".to_owned()
    }

    #[test]
    fn numbers_are_held_against_their_tolerance() {
        let mut report = Report::default();
        let field = report.field(FIELD, "pseudo_curvature");
        field.number(here, 40.0, 40.0 + 0.9e-6);
        assert_eq!((field.compared, field.differing), (1, 0));
        field.number(here, 40.0, 40.0 + 1.1e-6);
        field.number(here, 40.0, f64::NAN);
        assert_eq!((field.compared, field.differing), (3, 2));
        assert!(field.largest.is_nan());
        let share = report.field(PARTITION, "inertia");
        share.number(here, 1e6, 1e6 + 0.9e-3);
        share.number(here, 0.0, 0.0);
        assert_eq!(share.differing, 0);
        share.number(here, 1e6, 1e6 + 1.1e-3);
        assert_eq!(share.differing, 1);
        let vertices = report.field(MESH, "vertices");
        vertices.vector(here, [1.0, 2.0, 3.0], [1.0, 2.0, 3.0 + 0.8e-9]);
        assert_eq!(vertices.differing, 0);
        vertices.vector(here, [1.0, 2.0, 3.0], [1.0 + 0.8e-9, 2.0, 3.0 + 0.8e-9]);
        assert_eq!(vertices.differing, 1);
        assert!(!report.same());
    }

    #[test]
    fn the_text_names_place_and_values_and_shows_only_the_first() {
        let mut report = Report::default();
        for line in 0..10 {
            report.field(PROGRAM, "text").exact(|| format!("line {line}"), &"G0", &"G1");
        }
        report.missing.push("machine/model".to_owned());
        let text = report.text("heading");
        assert!(
            text.contains("differs: machine/program: text: line 2: recorded \"G0\", now \"G1\""),
            "{text}"
        );
        assert!(!text.contains("line 3") && text.contains("10 DIFFER"), "{text}");
        assert!(text.contains("machine/model was recorded and did not come"), "{text}");
        assert!(!report.same() && Report::default().same());
    }
}
