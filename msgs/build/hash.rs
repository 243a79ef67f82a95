//! Type hashes (RIHS01): sha256 over the type description of an interface as rosidl writes it in JSON.
//!
//! The description names every type that the interface needs, directly or not. Comments, constants and default values
//! do not enter it. Services and actions have the implicit types that rosidl gives them.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

use sha2::{Digest, Sha256};

use crate::parse::{Array, Base, Field};

/// Type ids of `type_description_interfaces/msg/FieldType`; arrays and sequences add to them.
const NESTED: u8 = 1;
const ARRAY: u8 = 48;
const BOUNDED_SEQUENCE: u8 = 96;
const SEQUENCE: u8 = 144;
const TYPE_IDS: [(&str, u8); 17] = [
    ("int8", 2),
    ("uint8", 3),
    ("int16", 4),
    ("uint16", 5),
    ("int32", 6),
    ("uint32", 7),
    ("int64", 8),
    ("uint64", 9),
    ("float32", 10),
    ("float64", 11),
    // A .msg file's char is an uint8.
    ("char", 3),
    ("bool", 15),
    ("byte", 16),
    ("string", 17),
    ("wstring", 18),
    ("string<=", 21),
    ("wstring<=", 22),
];

/// Types of an implicit member.
const UUID: &str = "unique_identifier_msgs/msg/UUID";
const TIME: &str = "builtin_interfaces/msg/Time";
const EVENT_INFO: &str = "service_msgs/msg/ServiceEventInfo";

/// One field as the description has it.
struct Member {
    name: String,
    type_id: u8,
    capacity: usize,
    string_capacity: usize,
    nested: String,
}

/// Every type by its full name.
#[derive(Default)]
pub struct Descriptions(BTreeMap<String, Vec<Member>>);

impl Descriptions {
    /// Adds a message, or a part of a service or an action.
    pub fn add(&mut self, name: impl Into<String>, fields: &[Field]) {
        let mut members: Vec<Member> = fields.iter().map(Member::of).collect();
        if members.is_empty() {
            members.push(Member::plain("structure_needs_at_least_one_member", "uint8"));
        }
        self.0.insert(name.into(), members);
    }

    /// Adds a service whose request and response are there already as `<name>_Request` and `<name>_Response`.
    pub fn add_service(&mut self, name: &str) {
        let [request, response, event] =
            ["Request", "Response", "Event"].map(|part| format!("{name}_{part}"));
        let of_event = vec![
            Member::nested("info", EVENT_INFO),
            Member::at_most_one("request", &request),
            Member::at_most_one("response", &response),
        ];
        self.0.insert(event.clone(), of_event);
        let members = vec![
            Member::nested("request_message", &request),
            Member::nested("response_message", &response),
            Member::nested("event_message", &event),
        ];
        self.0.insert(name.to_owned(), members);
    }

    /// Adds an action whose goal, result and feedback are there already as `<name>_Goal`, `<name>_Result` and
    /// `<name>_Feedback`.
    pub fn add_action(&mut self, name: &str) {
        let part = |part: &str| format!("{name}_{part}");
        let mut put = |name: &str, members: Vec<Member>| drop(self.0.insert(part(name), members));
        let goal_id = || Member::nested("goal_id", UUID);
        put("SendGoal_Request", vec![goal_id(), Member::nested("goal", &part("Goal"))]);
        put("SendGoal_Response", vec![Member::plain("accepted", "bool"), Member::nested("stamp", TIME)]);
        put("GetResult_Request", vec![goal_id()]);
        let result = vec![Member::plain("status", "int8"), Member::nested("result", &part("Result"))];
        put("GetResult_Response", result);
        put("FeedbackMessage", vec![goal_id(), Member::nested("feedback", &part("Feedback"))]);
        self.add_service(&part("SendGoal"));
        self.add_service(&part("GetResult"));
        let members = [
            ("goal", "Goal"),
            ("result", "Result"),
            ("feedback", "Feedback"),
            ("send_goal_service", "SendGoal"),
            ("get_result_service", "GetResult"),
            ("feedback_message", "FeedbackMessage"),
        ];
        let members = members.map(|(field, of)| Member::nested(field, &part(of)));
        self.0.insert(name.to_owned(), members.into());
    }

    /// `RIHS01_` and 64 hex digits.
    ///
    /// # Errors
    /// When a type is not there.
    pub fn hash(&self, name: &str) -> Result<String, String> {
        let mut json = format!("{{\"type_description\": {}", self.description(name)?);
        json += ", \"referenced_type_descriptions\": [";
        for (at, needed) in self.needs(name)?.into_iter().enumerate() {
            json += if at == 0 { "" } else { ", " };
            json += &self.description(needed)?;
        }
        json += "]}";
        let digest = Sha256::digest(json.as_bytes());
        let hex: String = digest.iter().map(|byte| format!("{byte:02x}")).collect();
        Ok(format!("RIHS01_{hex}"))
    }

    fn members(&self, name: &str) -> Result<&[Member], String> {
        let hint = "put its .msg file under standard/";
        self.0.get(name).map(Vec::as_slice).ok_or_else(|| format!("no type {name} for a type hash; {hint}"))
    }

    /// Every other type that the type needs, by name.
    fn needs(&self, name: &str) -> Result<BTreeSet<&str>, String> {
        let mut found = BTreeSet::new();
        let mut open: Vec<&[Member]> = vec![self.members(name)?];
        while let Some(members) = open.pop() {
            for nested in members.iter().map(|m| m.nested.as_str()).filter(|nested| !nested.is_empty()) {
                if found.insert(nested) {
                    open.push(self.members(nested)?);
                }
            }
        }
        Ok(found)
    }

    fn description(&self, name: &str) -> Result<String, String> {
        let mut json = format!("{{\"type_name\": \"{name}\", \"fields\": [");
        for (at, member) in self.members(name)?.iter().enumerate() {
            let Member { name, type_id, capacity, string_capacity, nested } = member;
            json += if at == 0 { "" } else { ", " };
            let _ = write!(
                json,
                "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {type_id}, \"capacity\": {capacity}, \
                 \"string_capacity\": {string_capacity}, \"nested_type_name\": \"{nested}\"}}}}"
            );
        }
        json += "]}";
        Ok(json)
    }
}

impl Member {
    fn of(field: &Field) -> Self {
        let (id, string_capacity, nested) = match &field.base {
            Base::Primitive(ros, _) => (id_of(ros), 0, String::new()),
            Base::String(None) => (id_of("string"), 0, String::new()),
            Base::String(Some(bound)) => (id_of("string<="), *bound, String::new()),
            Base::WideString(None) => (id_of("wstring"), 0, String::new()),
            Base::WideString(Some(bound)) => (id_of("wstring<="), *bound, String::new()),
            Base::Message(package, name) => (NESTED, 0, format!("{package}/msg/{name}")),
        };
        let (more, capacity) = match field.array {
            Array::Scalar => (0, 0),
            Array::Fixed(n) => (ARRAY, n),
            Array::Sequence(Some(bound)) => (BOUNDED_SEQUENCE, bound),
            Array::Sequence(None) => (SEQUENCE, 0),
        };
        Self { name: field.name.clone(), type_id: id + more, capacity, string_capacity, nested }
    }

    fn plain(name: &str, ros: &str) -> Self {
        Self {
            name: name.to_owned(),
            type_id: id_of(ros),
            capacity: 0,
            string_capacity: 0,
            nested: String::new(),
        }
    }

    fn nested(name: &str, nested: &str) -> Self {
        Self { type_id: NESTED, nested: nested.to_owned(), ..Self::plain(name, "") }
    }

    fn at_most_one(name: &str, nested: &str) -> Self {
        Self { type_id: BOUNDED_SEQUENCE + NESTED, capacity: 1, ..Self::nested(name, nested) }
    }
}

/// The id of a type that is no message; 0, which is no type, of another one.
fn id_of(ros: &str) -> u8 {
    TYPE_IDS.iter().find(|(name, _)| *name == ros).map_or(0, |(_, id)| *id)
}
