//! The data section of a STEP file (ISO 10303-21) as entity instances by number.

use std::collections::BTreeMap;

/// How a STEP file begins.
pub const MAGIC: &[u8] = b"ISO-10303-21";
/// Deepest nesting of lists.
const DEPTH_MAX: usize = 32;

/// A parameter of an entity.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// `#12`
    Reference(u64),
    /// A whole or real number.
    Number(f64),
    /// Text, its escapes as they are.
    Text(String),
    /// `.NAME.`
    Word(String),
    /// `(…)`
    List(Vec<Value>),
    /// `NAME(…)`
    Typed(String, Vec<Value>),
    /// `$` or `*`
    None,
}

/// An instance: its types with their parameters, one but for complex instances; never none.
pub type Instance = Vec<(String, Vec<Value>)>;

/// The instances of all data sections.
///
/// # Errors
/// When the text is no STEP file or breaks off, with the line.
pub fn parse(bytes: &[u8]) -> Result<BTreeMap<u64, Instance>, String> {
    if !bytes.trim_ascii_start().starts_with(MAGIC) {
        return Err("it is no STEP file: it does not begin with ISO-10303-21".to_owned());
    }
    let mut reader = Reader { bytes, at: 0 };
    let mut instances = BTreeMap::new();
    let mut sections = 0;
    reader.statement()?;
    loop {
        match reader.name_or_none()?.as_deref() {
            Some("DATA") => {
                reader.statement()?;
                sections += 1;
                reader.section(&mut instances)?;
            }
            Some("END-ISO-10303-21") | None => break,
            Some(_) => reader.statement()?,
        }
    }
    if sections == 0 {
        return Err("the STEP file has no DATA section".to_owned());
    }
    Ok(instances)
}

struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn fail<T>(&self, expected: &str) -> Result<T, String> {
        let line = self.bytes[..self.at.min(self.bytes.len())].iter().filter(|b| **b == b'\n').count() + 1;
        let found = match self.bytes.get(self.at) {
            Some(byte) => format!("'{}'", char::from(*byte).escape_default()),
            None => "the end".to_owned(),
        };
        Err(format!("line {line} of the STEP file: {expected} was expected, found {found}"))
    }

    /// The next byte after white space and comments.
    fn peek(&mut self) -> Option<u8> {
        loop {
            let rest = &self.bytes[self.at.min(self.bytes.len())..];
            if rest.first()?.is_ascii_whitespace() {
                self.at += 1;
            } else if rest.starts_with(b"/*") {
                self.at += rest.windows(2).position(|pair| pair == b"*/").map_or(rest.len(), |end| end + 2);
            } else {
                return rest.first().copied();
            }
        }
    }

    fn take(&mut self, wanted: u8) -> bool {
        let found = self.peek() == Some(wanted);
        self.at += usize::from(found);
        found
    }

    fn expect(&mut self, wanted: u8) -> Result<(), String> {
        if self.take(wanted) { Ok(()) } else { self.fail(&format!("'{}'", char::from(wanted))) }
    }

    /// The bytes of one kind that follow.
    fn run(&mut self, kind: impl Fn(u8) -> bool) -> String {
        let start = self.at;
        while self.bytes.get(self.at).is_some_and(|b| kind(*b)) {
            self.at += 1;
        }
        String::from_utf8_lossy(&self.bytes[start..self.at]).into_owned()
    }

    fn name_or_none(&mut self) -> Result<Option<String>, String> {
        match self.peek() {
            None => Ok(None),
            Some(byte) if byte.is_ascii_alphabetic() || byte == b'!' || byte == b'_' => {
                self.at += 1;
                let rest = self.run(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-');
                Ok(Some(format!("{}{rest}", char::from(byte)).to_ascii_uppercase()))
            }
            Some(_) => self.fail("a name"),
        }
    }

    fn name(&mut self) -> Result<String, String> {
        match self.name_or_none()? {
            Some(name) => Ok(name),
            None => self.fail("a name"),
        }
    }

    /// Passes over the rest of a statement, its `;` included.
    fn statement(&mut self) -> Result<(), String> {
        while !self.take(b';') {
            match self.peek() {
                None => return self.fail("';'"),
                Some(b'\'') => {
                    self.text()?;
                }
                Some(_) => self.at += 1,
            }
        }
        Ok(())
    }

    fn section(&mut self, instances: &mut BTreeMap<u64, Instance>) -> Result<(), String> {
        loop {
            if self.peek() != Some(b'#') {
                return match self.name_or_none()?.as_deref() {
                    Some("ENDSEC") => self.statement(),
                    _ => self.fail("'#' or ENDSEC"),
                };
            }
            let number = self.number()?;
            self.expect(b'=')?;
            let mut instance = Instance::new();
            if self.take(b'(') {
                while !self.take(b')') {
                    let name = self.name()?;
                    instance.push((name, self.list(0)?));
                }
                if instance.is_empty() {
                    return Err(format!("#{number} of the STEP file has no type"));
                }
            } else {
                let name = self.name()?;
                instance.push((name, self.list(0)?));
            }
            self.expect(b';')?;
            if instances.insert(number, instance).is_some() {
                return Err(format!("#{number} occurs twice in the STEP file"));
            }
        }
    }

    /// `#12`
    fn number(&mut self) -> Result<u64, String> {
        self.expect(b'#')?;
        let digits = self.run(|b| b.is_ascii_digit());
        digits.parse().or_else(|_| self.fail("an instance's number"))
    }

    fn text(&mut self) -> Result<String, String> {
        self.expect(b'\'')?;
        let mut text = String::new();
        loop {
            text += &self.run(|b| b != b'\'');
            if self.at >= self.bytes.len() {
                return self.fail("the text's end");
            }
            self.at += 1;
            if self.bytes.get(self.at) != Some(&b'\'') {
                return Ok(text);
            }
            text.push('\'');
            self.at += 1;
        }
    }

    fn list(&mut self, depth: usize) -> Result<Vec<Value>, String> {
        if depth > DEPTH_MAX {
            return self.fail("lists that are nested less");
        }
        self.expect(b'(')?;
        let mut values = Vec::new();
        if self.take(b')') {
            return Ok(values);
        }
        loop {
            values.push(self.value(depth)?);
            if self.take(b')') {
                return Ok(values);
            }
            self.expect(b',')?;
        }
    }

    fn value(&mut self, depth: usize) -> Result<Value, String> {
        match self.peek() {
            Some(b'#') => self.number().map(Value::Reference),
            Some(b'\'') => self.text().map(Value::Text),
            Some(b'(') => self.list(depth + 1).map(Value::List),
            Some(b'$' | b'*') => {
                self.at += 1;
                Ok(Value::None)
            }
            Some(b'"') => {
                self.at += 1;
                let bits = self.run(|b| b != b'"');
                self.expect(b'"')?;
                Ok(Value::Text(bits))
            }
            Some(b'.') => {
                self.at += 1;
                let word = self.run(|b| b.is_ascii_alphanumeric() || b == b'_');
                self.expect(b'.')?;
                Ok(Value::Word(word))
            }
            Some(byte) if byte.is_ascii_digit() || byte == b'+' || byte == b'-' => {
                let digits = self.run(|b| b.is_ascii_digit() || b"+-.eE".contains(&b));
                let number = digits.parse::<f64>().ok().filter(|x| x.is_finite());
                number.map_or_else(|| self.fail("a number"), |x| Ok(Value::Number(x)))
            }
            Some(_) => {
                let name = self.name()?;
                Ok(Value::Typed(name, self.list(depth + 1)?))
            }
            None => self.fail("a parameter"),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FILE: &str = "ISO-10303-21;\nHEADER;\nFILE_NAME('it''s; #1',$);\nENDSEC;\nDATA;\n/* a # comment */\n\
        #1=A('x''y',(1,-2.5E-1,.T.,$,*),#22,LENGTH_MEASURE(3.));\n#22 = (B()C(#1));\nENDSEC;\nEND-ISO-10303-21;\n";

    #[test]
    fn instances_are_read() {
        let instances = parse(FILE.as_bytes()).unwrap();
        let list =
            [Value::Number(1.0), Value::Number(-0.25), Value::Word("T".to_owned()), Value::None, Value::None];
        let typed = Value::Typed("LENGTH_MEASURE".to_owned(), vec![Value::Number(3.0)]);
        let parameters =
            vec![Value::Text("x'y".to_owned()), Value::List(list.to_vec()), Value::Reference(22), typed];
        assert_eq!(instances[&1], [("A".to_owned(), parameters)]);
        assert_eq!(instances[&22], [("B".to_owned(), vec![]), ("C".to_owned(), vec![Value::Reference(1)])]);
    }

    #[test]
    fn each_bad_file_is_one_clear_error() {
        for (from, to, words) in [
            ("ISO-10303-21;\nH", "solid\nH", "no STEP file"),
            ("DATA;", "DATE;", "a name was expected, found '#'"),
            ("#22,L", "#22 L", "line 7 of the STEP file: ',' was expected, found 'L'"),
            ("C(#1));", "C(#1))", "';' was expected"),
            ("#22 =", "#1 =", "#1 occurs twice"),
            ("(B()C(#1))", "()", "#22 of the STEP file has no type"),
            ("-2.5E-1", "-2.5E-", "a number"),
            ("END-ISO", "(", "a name"),
        ] {
            let text = parse(FILE.replace(from, to).as_bytes()).unwrap_err();
            assert!(text.contains(words), "{words}: {text}");
        }
        let deep = FILE.replace("(#1)", &format!("{}{}", "(".repeat(99), ")".repeat(99)));
        assert!(parse(deep.as_bytes()).unwrap_err().contains("nested"));
    }

    proptest! {
        #[test]
        fn no_file_panics(cut in 0usize..230, byte in any::<u8>()) {
            let mut bytes = FILE.as_bytes().to_vec();
            let at = cut % bytes.len();
            bytes[at] = byte;
            let _ = parse(&bytes);
            bytes.truncate(at);
            let _ = parse(&bytes);
        }
    }
}
