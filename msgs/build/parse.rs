//! Reads the text of one section of an interface file: fields, constants, comments.

use std::path::Path;

/// One message: a `.msg` file or the part of a `.srv` or `.action` file between lines of `---`.
#[derive(Clone)]
pub struct Section {
    /// The text as it stands in the file.
    pub text: String,
    /// The comment that the section opens with.
    pub doc: Vec<String>,
    pub constants: Vec<Constant>,
    pub fields: Vec<Field>,
}

#[derive(Clone)]
pub struct Constant {
    pub base: Base,
    pub name: String,
    pub value: String,
    pub doc: Vec<String>,
}

#[derive(Clone)]
pub struct Field {
    pub base: Base,
    pub array: Array,
    pub name: String,
    /// Value in a new message when it is not zero; scalars only.
    pub default: Option<String>,
    pub doc: Vec<String>,
    /// The type as written.
    pub written: String,
}

/// Type of one element.
#[derive(Clone, PartialEq)]
pub enum Base {
    /// ROS name and Rust name of a number or bool.
    Primitive(&'static str, &'static str),
    /// With its bound in characters.
    String(Option<usize>),
    /// UTF-16, with its bound; known to the type hash only, no Rust type carries it.
    WideString(Option<usize>),
    /// Package and name of a message.
    Message(String, String),
}

#[derive(Clone, Copy)]
pub enum Array {
    Scalar,
    Fixed(usize),
    /// `[]`, or `[<=N]`, whose bound Rust does not hold.
    Sequence(Option<usize>),
}

const PRIMITIVES: [(&str, &str); 13] = [
    ("bool", "bool"),
    ("byte", "u8"),
    ("char", "u8"),
    ("int8", "i8"),
    ("int16", "i16"),
    ("int32", "i32"),
    ("int64", "i64"),
    ("uint8", "u8"),
    ("uint16", "u16"),
    ("uint32", "u32"),
    ("uint64", "u64"),
    ("float32", "f32"),
    ("float64", "f64"),
];

impl Section {
    pub fn parse(text: &str, package: &str, path: &Path, first_line: usize) -> Result<Self, String> {
        let mut section = Self { text: text.to_owned(), doc: vec![], constants: vec![], fields: vec![] };
        let mut comments: Vec<String> = Vec::new();
        let mut opening = true;
        for (number, line) in text.lines().enumerate() {
            let (code, comment) = split_comment(line);
            if code.is_empty() {
                match comment {
                    Some(comment) => comments.push(comment.to_owned()),
                    None if opening => {}
                    None => comments.clear(),
                }
                if comment.is_some() || !opening || comments.is_empty() {
                    continue;
                }
            }
            if opening {
                section.doc = std::mem::take(&mut comments);
                opening = false;
            }
            if !code.is_empty() {
                comments.extend(comment.map(str::to_owned));
                section
                    .declaration(code, std::mem::take(&mut comments), package)
                    .map_err(|e| format!("{}:{}: {e}", path.display(), first_line + number))?;
            }
        }
        Ok(section)
    }

    fn declaration(&mut self, code: &str, doc: Vec<String>, package: &str) -> Result<(), String> {
        let (written, rest) =
            code.split_once(char::is_whitespace).ok_or_else(|| format!("'{code}' names no field"))?;
        let (base, array) = parse_type(written, package)?;
        if let Some((name, value)) = rest.split_once('=') {
            let name = name.trim();
            if !matches!(array, Array::Scalar) || matches!(base, Base::Message(..)) {
                return Err(format!("constant '{name}' must be a number, a bool or a string"));
            }
            self.check_name(name, |c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_')?;
            let value = literal(&base, value.trim())?;
            self.constants.push(Constant { base, name: name.to_owned(), value, doc });
            return Ok(());
        }
        let (name, default) = match rest.trim().split_once(char::is_whitespace) {
            Some((name, value)) => (name, Some(value.trim())),
            None => (rest.trim(), None),
        };
        self.check_name(name, |c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')?;
        let default = match (default, array, &base) {
            (None, _, _) => None,
            (Some(value), Array::Scalar, Base::Primitive(..)) => Some(literal(&base, value)?),
            _ => return Err(format!("the default of '{name}': only numbers and bools may have one here")),
        };
        let (name, written) = (name.to_owned(), written.to_owned());
        self.fields.push(Field { base, array, name, default, doc, written });
        Ok(())
    }

    fn check_name(&self, name: &str, allowed: impl Fn(char) -> bool) -> Result<(), String> {
        let well_formed = name.starts_with(|c: char| c.is_ascii_alphabetic()) && name.chars().all(allowed);
        if !well_formed || name.ends_with('_') || name.contains("__") {
            return Err(format!("'{name}' is no ROS name of a field (a_b1) or a constant (A_B1)"));
        }
        if self.fields.iter().any(|f| f.name == name) || self.constants.iter().any(|c| c.name == name) {
            return Err(format!("'{name}' is declared twice"));
        }
        Ok(())
    }
}

/// What stands before the first `#` outside quotes, and the comment after it.
fn split_comment(line: &str) -> (&str, Option<&str>) {
    let mut quote = None;
    for (at, c) in line.char_indices() {
        match (quote, c) {
            (None, '#') => return (line[..at].trim(), Some(line[at + 1..].trim_end())),
            (None, '"' | '\'') => quote = Some(c),
            (Some(open), c) if c == open => quote = None,
            _ => {}
        }
    }
    (line.trim(), None)
}

fn parse_type(written: &str, package: &str) -> Result<(Base, Array), String> {
    let number =
        |text: &str| text.parse::<usize>().map_err(|_| format!("'{written}': '{text}' is no number"));
    let (element, array) = match written.strip_suffix(']').and_then(|w| w.rsplit_once('[')) {
        None => (written, Array::Scalar),
        Some((element, "")) => (element, Array::Sequence(None)),
        Some((element, bound)) => match bound.strip_prefix("<=") {
            Some(bound) => (element, Array::Sequence(Some(number(bound)?))),
            // serde and Default stop at arrays of 32.
            None => match number(bound)? {
                n @ 1..=32 => (element, Array::Fixed(n)),
                n => return Err(format!("'{written}': arrays of 1 to 32 elements are supported, not {n}")),
            },
        },
    };
    if let Some((ros, rust)) = PRIMITIVES.iter().find(|(ros, _)| *ros == element) {
        return Ok((Base::Primitive(ros, rust), array));
    }
    for (name, wide) in [("string", false), ("wstring", true)] {
        let text = |bound| if wide { Base::WideString(bound) } else { Base::String(bound) };
        if let Some(rest) = element.strip_prefix(name) {
            return match rest.strip_prefix("<=") {
                Some(bound) => Ok((text(Some(number(bound)?)), array)),
                None if rest.is_empty() => Ok((text(None), array)),
                None => Err(format!("unknown type '{written}'")),
            };
        }
    }
    let base = match element.split('/').collect::<Vec<_>>()[..] {
        [name] if name.starts_with(|c: char| c.is_ascii_uppercase()) => (package, name),
        [package, name] | [package, "msg", name] => (package, name),
        _ => return Err(format!("unknown type '{written}'")),
    };
    Ok((Base::Message(base.0.to_owned(), base.1.to_owned()), array))
}

/// A value of an interface file as a Rust literal.
fn literal(base: &Base, value: &str) -> Result<String, String> {
    let bad = || format!("'{value}' is no value of its type");
    let Base::Primitive(ros, rust) = base else {
        let quoted = |q: char| value.strip_prefix(q).and_then(|v| v.strip_suffix(q));
        return Ok(format!("{:?}", quoted('"').or_else(|| quoted('\'')).unwrap_or(value)));
    };
    match *rust {
        "bool" => match value {
            "true" | "True" | "1" => Ok("true".to_owned()),
            "false" | "False" | "0" => Ok("false".to_owned()),
            _ => Err(bad()),
        },
        "f32" | "f64" => {
            let number: f64 = value.parse().map_err(|_| bad())?;
            if number.is_finite() { Ok(format!("{number:?}")) } else { Err(bad()) }
        }
        _ => {
            let number: i128 = value.parse().map_err(|_| bad())?;
            let bits: u32 = rust[1..].parse().map_err(|_| format!("unknown type '{ros}'"))?;
            let range = if rust.starts_with('u') {
                0..1i128 << bits
            } else {
                -(1i128 << (bits - 1))..1i128 << (bits - 1)
            };
            if range.contains(&number) { Ok(number.to_string()) } else { Err(bad()) }
        }
    }
}
