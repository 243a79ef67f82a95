//! The text of a job file: `key: value` or `key: [value, …]`, every key with its line. Values stay the text that they are: the options'
//! own parsers read them.

use yaml_rust2::parser::{Event, Parser};
use yaml_rust2::scanner::TScalarStyle;

/// A key with its values.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The key.
    pub key: String,
    /// Its line, counted from 1.
    pub line: usize,
    /// One value, or those of a list.
    pub values: Vec<String>,
    /// Whether they were given as a list.
    pub list: bool,
}

/// What a text holds, in its order.
///
/// # Errors
/// With line and expectation: no YAML, something else than keys with values, a key that comes twice.
pub fn entries(text: &str) -> Result<Vec<Entry>, String> {
    let mut reader = Reader::default();
    let mut events = Parser::new_from_str(text);
    // One by one: the parser's own loop takes a piece of the stack for each level of nesting.
    let mut more = true;
    while more {
        let (event, mark) = events.next_token().map_err(|e| format!("no YAML: {e}"))?;
        more = event != Event::StreamEnd;
        reader.take(event, mark.line());
    }
    match reader.wrong {
        Some((line, what)) => Err(format!("line {line}: {what}")),
        None => Ok(reader.entries),
    }
}

/// A value as a line of YAML has it: plain where that is safe, else in quotes.
pub fn quoted(value: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '/' | '-');
    let null = matches!(value, "null" | "Null" | "NULL");
    let starts = value.starts_with(|c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '/'));
    let number = value.parse::<f64>().is_ok();
    if number || (starts && value.chars().all(plain) && !null) {
        return value.to_owned();
    }
    // A JSON string is one of YAML too.
    serde_json::Value::from(value).to_string()
}

#[derive(Default)]
enum Expected {
    #[default]
    Mapping,
    Key,
    Value(String, usize),
    Item(Entry),
    Nothing,
}

#[derive(Default)]
struct Reader {
    expected: Expected,
    entries: Vec<Entry>,
    /// The first thing that is wrong, with its line.
    wrong: Option<(usize, String)>,
}

impl Reader {
    fn take(&mut self, event: Event, line: usize) {
        let boundary = matches!(
            event,
            Event::StreamStart | Event::StreamEnd | Event::DocumentStart | Event::DocumentEnd
        );
        if self.wrong.is_some() || boundary || event == Event::Nothing {
            return;
        }
        match self.next(event, line) {
            Ok(expected) => self.expected = expected,
            Err(what) => self.wrong = Some((line, what)),
        }
    }

    fn next(&mut self, event: Event, line: usize) -> Result<Expected, String> {
        match (std::mem::take(&mut self.expected), event) {
            (Expected::Mapping, Event::MappingStart(..)) => Ok(Expected::Key),
            // An empty document.
            (Expected::Mapping, Event::Scalar(text, TScalarStyle::Plain, ..)) if is_null(&text) => {
                Ok(Expected::Nothing)
            }
            (Expected::Key, Event::MappingEnd) => Ok(Expected::Nothing),
            (Expected::Key, Event::Scalar(key, ..)) => match self.entries.iter().find(|e| e.key == key) {
                Some(first) => Err(format!("{key} comes twice, first in line {}; give it once", first.line)),
                None => Ok(Expected::Value(key, line)),
            },
            (Expected::Value(key, line), Event::SequenceStart(..)) => {
                Ok(Expected::Item(Entry { key, line, values: Vec::new(), list: true }))
            }
            (Expected::Value(key, line), Event::Scalar(text, style, ..)) => {
                let value = value(&key, text, style)?;
                self.entries.push(Entry { key, line, values: vec![value], list: false });
                Ok(Expected::Key)
            }
            (Expected::Item(mut entry), Event::Scalar(text, style, ..)) => {
                entry.values.push(value(&entry.key, text, style)?);
                Ok(Expected::Item(entry))
            }
            (Expected::Item(entry), Event::SequenceEnd) => {
                self.entries.push(entry);
                Ok(Expected::Key)
            }
            (Expected::Value(key, _) | Expected::Item(Entry { key, .. }), _) => {
                Err(format!("{key}: expected a value or a list of values, nothing nested"))
            }
            (Expected::Mapping | Expected::Key, _) => Err("expected lines `key: value`".to_owned()),
            (Expected::Nothing, _) => {
                Err("expected the end of the file: a job file holds one job".to_owned())
            }
        }
    }
}

fn is_null(text: &str) -> bool {
    matches!(text, "" | "~" | "null" | "Null" | "NULL")
}

fn value(key: &str, text: String, style: TScalarStyle) -> Result<String, String> {
    if style == TScalarStyle::Plain && is_null(&text) {
        return Err(format!("{key}: expected a value; leave the line out for the default"));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_come_with_their_lines_and_values_as_text() {
        let text = "# a job\nsurface: a b.json\n\ntool:\n  - r1=0,r2=6\n  - \"r1=1,r2=2\"\nfeed: 2.50e3\nselect: [z=0..1]\ncloud: true\n";
        let read = entries(text).unwrap();
        let short: Vec<_> =
            read.iter().map(|e| (e.key.as_str(), e.line, e.values.join("|"), e.list)).collect();
        assert_eq!(
            short,
            [
                ("surface", 2, "a b.json".to_owned(), false),
                ("tool", 4, "r1=0,r2=6|r1=1,r2=2".to_owned(), true),
                ("feed", 7, "2.50e3".to_owned(), false),
                ("select", 8, "z=0..1".to_owned(), true),
                ("cloud", 9, "true".to_owned(), false),
            ]
        );
        for empty in ["", "# nothing\n", "---\n"] {
            assert_eq!(entries(empty).unwrap(), [], "{empty:?}");
        }
    }

    #[test]
    fn what_is_no_job_file_is_refused_with_its_line() {
        for (bad, words) in [
            ("a: 1\nb: 2\na: 3\n", "line 3: a comes twice, first in line 1"),
            ("a: 1\nb:\n", "b: expected a value"),
            ("a: {b: 1}\n", "line 1: a: expected a value or a list"),
            ("a:\n  - [1]\n", "line 2: a: expected a value or a list"),
            ("- a\n", "line 1: expected lines"),
            ("text\n", "line 1: expected lines"),
            ("a: 1\n---\nb: 2\n", "one job"),
            ("a: &x 1\nb: *x\n", "line 2: b: expected a value"),
            (&format!("a: {}{}\n", "[".repeat(200), "]".repeat(200)), "nothing nested"),
            (&format!("a:\n{}1\n", "- ".repeat(100_000)), "nothing nested"),
            ("a: \"1\n", "no YAML"),
            ("a: [1\nb: 2\n", "no YAML"),
        ] {
            let text = entries(bad).unwrap_err();
            assert!(text.contains(words), "{bad:?}: {text}");
        }
    }

    #[test]
    fn quoted_values_are_read_back() {
        for value in [
            "",
            "~",
            "null",
            "-1",
            "-x",
            "0.0254",
            "1e-7",
            "a: b",
            "a #b",
            "ä\n\"'\\",
            "../s 1.json",
            "*",
            "true",
            "1..8",
            "r1=0,r2=6",
        ] {
            let read = entries(&format!("key: {}\nlist:\n- {}\n", quoted(value), quoted(value))).unwrap();
            assert_eq!((&*read[0].values[0], &*read[1].values[0]), (value, value));
        }
        assert_eq!([quoted("0.0254"), quoted("-5"), quoted("1..8")], ["0.0254", "-5", "1..8"]);
    }
}
