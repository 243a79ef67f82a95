//! Writes the Rust types.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use crate::Interfaces;
use crate::hash::Descriptions;
use crate::parse::{Array, Base, Field, Section};

/// Rust text of all interfaces: modules `msg`, `srv`, `action` of `package`, `<other>::msg` of the others, the table
/// `TYPE_HASHES` and the macro `for_every_message`.
pub fn rust(package: &str, interfaces: &Interfaces) -> Result<String, String> {
    let descriptions = descriptions(package, interfaces);
    let mut emitter =
        Emitter { package, interfaces, descriptions, list: String::new(), hashes: BTreeMap::new() };
    let mut out = String::new();
    out += &emitter.messages(package)?;
    out += &emitter.services()?;
    out += &emitter.actions()?;
    let others: BTreeSet<&String> =
        interfaces.messages.keys().map(|(p, _)| p).filter(|p| *p != package).collect();
    for other in others {
        let messages = emitter.messages(other)?;
        out += &format!("\n/// Messages of the package `{other}`.\npub mod {other} {{{messages}}}\n");
    }
    out += &emitter.hash_table();
    out += &format!(
        "\n/// Calls the macro `$call!(\"package/msg/Name\", path, [CONSTANTS])` for every message type.\n\
         #[macro_export]\nmacro_rules! for_every_message {{\n    ($call:ident) => {{{}\n    }};\n}}\n",
        emitter.list
    );
    Ok(out)
}

/// What the type hashes are made of.
fn descriptions(package: &str, interfaces: &Interfaces) -> Descriptions {
    let mut all = Descriptions::default();
    for ((package, name), section) in &interfaces.messages {
        all.add(format!("{package}/msg/{name}"), &section.fields);
    }
    for (name, [request, response]) in &interfaces.services {
        let name = format!("{package}/srv/{name}");
        all.add(format!("{name}_Request"), &request.fields);
        all.add(format!("{name}_Response"), &response.fields);
        all.add_service(&name);
    }
    for (name, parts) in &interfaces.actions {
        let name = format!("{package}/action/{name}");
        for (part, section) in ["Goal", "Result", "Feedback"].into_iter().zip(parts) {
            all.add(format!("{name}_{part}"), &section.fields);
        }
        all.add_action(&name);
    }
    all
}

struct Emitter<'a> {
    package: &'a str,
    interfaces: &'a Interfaces,
    descriptions: Descriptions,
    /// Type hash of what was emitted, by full name.
    hashes: BTreeMap<String, String>,
    /// Calls of `for_every_message`.
    list: String,
}

impl Emitter<'_> {
    fn messages(&mut self, package: &str) -> Result<String, String> {
        let mut body = String::new();
        for ((_, name), section) in self.interfaces.messages.iter().filter(|((p, _), _)| p == package) {
            let path = self.path(package, name);
            body += &self.message(&format!("{package}/msg/{name}"), name, &path, section)?;
        }
        Ok(module("Messages.", "msg", &body))
    }

    fn services(&mut self) -> Result<String, String> {
        let mut body = String::new();
        for (name, [request, response]) in &self.interfaces.services {
            body += &self.part("srv", name, "Request", request)?;
            body += &self.part("srv", name, "Response", response)?;
            let hash = self.hash(&format!("{}/srv/{name}", self.package))?;
            body += &format!(
                "\n{}#[derive(Debug, Clone, Copy)]\npub struct {name};\n\
                 impl crate::ServiceType for {name} {{\n    type Request = {name}Request;\n    \
                 type Response = {name}Response;\n    const NAME: &'static str = \"{}/srv/{name}\";\n    \
                 const TYPE_HASH: &'static str = {hash:?};\n}}\n",
                doc("", &request.doc, &format!("The service `{name}`.")),
                self.package
            );
        }
        Ok(module("Services: each a marker type with its request and response.", "srv", &body))
    }

    fn actions(&mut self) -> Result<String, String> {
        let mut body = String::new();
        for (name, parts) in &self.interfaces.actions {
            for (part, section) in ["Goal", "Result", "Feedback"].into_iter().zip(parts) {
                body += &self.part("action", name, part, section)?;
            }
            let hash = self.hash(&format!("{}/action/{name}", self.package))?;
            body += &format!(
                "\n{}#[derive(Debug, Clone, Copy)]\npub struct {name};\n\
                 impl crate::ActionType for {name} {{\n    type Goal = {name}Goal;\n    \
                 type Result = {name}Result;\n    type Feedback = {name}Feedback;\n    \
                 const NAME: &'static str = \"{}/action/{name}\";\n    \
                 const TYPE_HASH: &'static str = {hash:?};\n}}\n",
                doc("", &parts[0].doc, &format!("The action `{name}`.")),
                self.package
            );
        }
        Ok(module("Actions: each a marker type with its goal, result and feedback.", "action", &body))
    }

    /// The struct `<name><part>` of a service or an action, ROS name `package/kind/name_part`.
    fn part(&mut self, kind: &str, name: &str, part: &str, section: &Section) -> Result<String, String> {
        let rust = format!("{name}{part}");
        let ros = format!("{}/{kind}/{name}_{part}", self.package);
        self.message(&ros, &rust, &format!("{kind}::{rust}"), section)
    }

    fn message(&mut self, ros: &str, name: &str, path: &str, section: &Section) -> Result<String, String> {
        let mut out = String::new();
        let defaults = section.fields.iter().any(|f| f.default.is_some());
        let derive = if defaults { "" } else { "Default, " };
        out += &format!(
            "\n{}#[derive(Debug, Clone, {derive}PartialEq, Serialize, Deserialize)]\npub struct {name} {{\n",
            doc("", &section.doc, &format!("`{ros}`."))
        );
        for field in &section.fields {
            out += &doc("    ", &field.doc, &format!("`{}`.", field.written));
            let _ = writeln!(out, "    pub {}: {},", identifier(&field.name), self.field_type(field)?);
        }
        if section.fields.is_empty() {
            out += "    /// DDS knows no empty struct: one byte without meaning.\n    \
                    pub structure_needs_at_least_one_member: u8,\n";
        }
        out += "}\n";
        if !section.constants.is_empty() {
            let _ = writeln!(out, "impl {name} {{");
            for constant in &section.constants {
                out += &doc("    ", &constant.doc, &format!("`{}`.", constant.name));
                let rust = match &constant.base {
                    Base::Primitive(_, rust) => rust,
                    _ => "&'static str",
                };
                let _ = writeln!(out, "    pub const {}: {rust} = {};", constant.name, constant.value);
            }
            out += "}\n";
        }
        if defaults {
            let _ = writeln!(out, "impl Default for {name} {{\n    fn default() -> Self {{\n        Self {{");
            for field in &section.fields {
                let value = field.default.as_deref().unwrap_or("Default::default()");
                let _ = writeln!(out, "            {}: {value},", identifier(&field.name));
            }
            out += "        }\n    }\n}\n";
        }
        let (definition, hash) = (self.definition(section), self.hash(ros)?);
        let _ = writeln!(
            out,
            "impl crate::RosType for {name} {{\n    const TYPE_NAME: &'static str = {ros:?};\n    \
             const DEFINITION: &'static str = {definition:?};\n    \
             const TYPE_HASH: &'static str = {hash:?};\n}}"
        );
        let constants: Vec<&str> = section.constants.iter().map(|c| c.name.as_str()).collect();
        let _ = write!(self.list, "\n        $call!({ros:?}, $crate::{path}, [{}]);", constants.join(", "));
        Ok(out)
    }

    /// The type hash of an interface, which is noted down.
    fn hash(&mut self, name: &str) -> Result<String, String> {
        let hash = self.descriptions.hash(name)?;
        self.hashes.insert(name.to_owned(), hash.clone());
        Ok(hash)
    }

    fn hash_table(&self) -> String {
        let rows: String =
            self.hashes.iter().map(|(name, hash)| format!("    ({name:?}, {hash:?}),\n")).collect();
        format!(
            "\n/// Full name and type hash (RIHS01) of every message, service and action and of their parts, by name.\n\
             pub const TYPE_HASHES: &[(&str, &str)] = &[\n{rows}];\n"
        )
    }

    /// Path of a message type inside the crate.
    fn path(&self, package: &str, name: &str) -> String {
        if package == self.package { format!("msg::{name}") } else { format!("{package}::msg::{name}") }
    }

    fn field_type(&self, field: &Field) -> Result<String, String> {
        let element = match &field.base {
            Base::Primitive(_, rust) => (*rust).to_owned(),
            Base::String(_) => "::std::string::String".to_owned(),
            Base::WideString(_) => return Err(format!("'{}': no Rust type carries UTF-16", field.written)),
            Base::Message(package, name) => {
                if !self.interfaces.messages.contains_key(&(package.clone(), name.clone())) {
                    let hint = "put its .msg file under standard/";
                    return Err(format!("'{}': no message {package}/{name}; {hint}", field.written));
                }
                format!("crate::{}", self.path(package, name))
            }
        };
        Ok(match field.array {
            Array::Scalar => element,
            Array::Fixed(n) => format!("[{element}; {n}]"),
            Array::Sequence(_) => format!("Vec<{element}>"),
        })
    }

    /// The text of the section and of every message that it needs, as a bag's schema wants it.
    fn definition(&self, section: &Section) -> String {
        let mut out = section.text.clone();
        let mut seen = BTreeSet::new();
        let mut queue = std::collections::VecDeque::from([section]);
        while let Some(section) = queue.pop_front() {
            for field in &section.fields {
                let Base::Message(package, name) = &field.base else { continue };
                let key = (package.clone(), name.clone());
                if let Some(needed) = self.interfaces.messages.get(&key)
                    && seen.insert(key)
                {
                    let gap = if out.ends_with('\n') { "" } else { "\n" };
                    let _ = write!(out, "{gap}{}\nMSG: {package}/{name}\n{}", "=".repeat(80), needed.text);
                    queue.push_back(needed);
                }
            }
        }
        out
    }
}

fn module(about: &str, name: &str, body: &str) -> String {
    let about = if body.is_empty() { "None." } else { about };
    let imports = if body.is_empty() { "" } else { "use serde::{Deserialize, Serialize};\n" };
    format!("\n/// {about}\npub mod {name} {{\n{imports}{body}}}\n")
}

/// The name of a field, raw where Rust keeps the word for itself.
fn identifier(name: &str) -> String {
    const KEYWORDS: [&str; 10] = ["as", "enum", "fn", "in", "loop", "match", "mod", "move", "ref", "type"];
    if KEYWORDS.contains(&name) { format!("r#{name}") } else { name.to_owned() }
}

/// Doc comment lines, `[` and the like escaped so that rustdoc takes units for text.
fn doc(indent: &str, lines: &[String], otherwise: &str) -> String {
    let text = if lines.iter().all(|l| l.trim().is_empty()) {
        otherwise.to_owned()
    } else {
        let lines: Vec<String> = lines.iter().map(|line| escape(line.trim())).collect();
        lines.join("\n")
    };
    format!("{indent}#[doc = {text:?}]\n")
}

fn escape(line: &str) -> String {
    let mut code = false;
    let mut out = String::new();
    for c in line.chars() {
        code ^= c == '`';
        if !code && "[]<>*_".contains(c) {
            out.push('\\');
        }
        out.push(c);
    }
    out
}
