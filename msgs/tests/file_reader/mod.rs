//! A reader of interface files that shares no code with the generator.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Text of every message and part of a service or action, by full ROS name.
pub struct Files(BTreeMap<String, String>);

impl Files {
    pub fn read() -> Self {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut all = BTreeMap::new();
        let mut add = |folder: &Path, package: &str, parts: &[&str]| {
            let kind = folder.file_name().unwrap().to_str().unwrap().to_owned();
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                let stem = path.file_stem().unwrap().to_str().unwrap();
                let text = std::fs::read_to_string(&path).unwrap();
                let texts: Vec<&str> = text.split("\n---\n").collect();
                assert_eq!(texts.len(), parts.len(), "{}", path.display());
                for (text, part) in texts.into_iter().zip(parts) {
                    all.insert(format!("{package}/{kind}/{stem}{part}"), text.to_owned());
                }
            }
        };
        add(&root.join("msg"), "patchmill_msgs", &[""]);
        add(&root.join("srv"), "patchmill_msgs", &["_Request", "_Response"]);
        add(&root.join("action"), "patchmill_msgs", &["_Goal", "_Result", "_Feedback"]);
        for entry in std::fs::read_dir(root.join("standard")).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                add(&path.join("msg"), path.file_name().unwrap().to_str().unwrap(), &[""]);
            }
        }
        Self(all)
    }

    pub fn names(&self) -> Vec<&str> {
        self.0.keys().map(String::as_str).collect()
    }

    pub fn text(&self, name: &str) -> &str {
        &self.0[name]
    }

    /// Declarations without comments: type and the rest of the line.
    fn lines(&self, name: &str) -> Vec<(&str, &str)> {
        let lines = self.text(name).lines().map(code_of).filter(|line| !line.is_empty());
        lines.map(|line| line.split_once(' ').unwrap()).map(|(a, b)| (a, b.trim())).collect()
    }

    /// Names and values, as written.
    pub fn constants(&self, name: &str) -> Vec<(String, String)> {
        let pairs = self.lines(name).into_iter().filter_map(|(_, rest)| rest.split_once('='));
        pairs.map(|(name, value)| (name.trim().to_owned(), value.trim().to_owned())).collect()
    }

    /// `{name:type,…}`, nested types written out, `[T;N]` for arrays, `[T]` for sequences.
    pub fn layout(&self, name: &str) -> String {
        let fields = self.lines(name).into_iter().filter(|(_, rest)| !rest.contains('='));
        let fields: Vec<String> = fields
            .map(|(kind, rest)| {
                let field = rest.split_whitespace().next().unwrap();
                let (element, array) = match kind.split_once('[') {
                    Some((element, array)) => (element, Some(array.trim_end_matches(']'))),
                    None => (kind, None),
                };
                let element = self.element(name, element);
                match array {
                    None => format!("{field}:{element}"),
                    Some("") => format!("{field}:[{element}]"),
                    Some(n) => format!("{field}:[{element};{n}]"),
                }
            })
            .collect();
        if fields.is_empty() {
            return "{structure_needs_at_least_one_member:u8}".to_owned();
        }
        format!("{{{}}}", fields.join(","))
    }

    fn element(&self, owner: &str, written: &str) -> String {
        let number = |written: &str| match written {
            "byte" | "char" => "u8".to_owned(),
            "bool" | "string" => written.to_owned(),
            _ => written.replace("uint", "u").replace("int", "i").replace("float", "f"),
        };
        match full_name(owner, written) {
            Some(nested) => self.layout(&nested),
            None => number(written),
        }
    }

    /// Every message that the type needs, directly or not, by name.
    pub fn needs(&self, name: &str) -> Vec<String> {
        let mut found = BTreeSet::new();
        let mut open = vec![name.to_owned()];
        while let Some(owner) = open.pop() {
            for (kind, _) in self.lines(&owner) {
                if let Some(nested) = full_name(&owner, kind.split('[').next().unwrap())
                    && found.insert(nested.clone())
                {
                    open.push(nested);
                }
            }
        }
        found.into_iter().collect()
    }
}

fn code_of(line: &str) -> &str {
    line.split('#').next().unwrap_or_default().trim()
}

/// Full name of a nested type, `None` of a primitive.
fn full_name(owner: &str, written: &str) -> Option<String> {
    match written.split_once('/') {
        Some((package, name)) => Some(format!("{package}/msg/{name}")),
        None if written.starts_with(|c: char| c.is_uppercase()) => {
            Some(format!("{}/msg/{written}", owner.split('/').next().unwrap()))
        }
        None => None,
    }
}
