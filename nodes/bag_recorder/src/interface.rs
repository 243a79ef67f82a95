//! Whether a bag's messages are those of this version of patchmill.

use std::collections::BTreeMap;

use mcap::Channel;
use patchmill_msgs::{RosType, for_every_message};

use crate::BagError;

/// Only these types are patchmill's own; the others are ROS's.
const OWN: &str = "patchmill_msgs/";
/// Line between the definitions of a schema.
const SEPARATOR: &str = "================================================================================";

/// Refuses a channel of one of patchmill's own types in another version: one whose type hash is another one, or, in a bag
/// without type hashes, whose definition has other fields.
///
/// # Errors
/// With topic, type and both hashes.
pub(crate) fn check(channel: &Channel<'_>) -> Result<(), BagError> {
    let Some(schema) = channel.schema.as_ref().filter(|schema| schema.name.starts_with(OWN)) else {
        return Ok(());
    };
    let recorded = channel.metadata.get("topic_type_hash").filter(|hash| hash.starts_with("RIHS01_"));
    let theirs = recorded.map_or("none", String::as_str);
    let refused = |what: String| {
        let text = format!(
            "the bag is of another version of patchmill's interfaces: {} on {} {what}",
            schema.name, channel.topic
        );
        Err(BagError { text })
    };
    let Some((hash, definition)) = known(&schema.name) else {
        return refused(format!("(type hash {theirs}) is unknown here"));
    };
    let same = match recorded {
        Some(theirs) => theirs == hash,
        None => fields(&String::from_utf8_lossy(&schema.data)) == fields(definition),
    };
    if same {
        return Ok(());
    }
    let where_seen = if recorded.is_some() { "" } else { ", its definition has other fields" };
    refused(format!("has the type hash {theirs} there and {hash} here{where_seen}"))
}

/// Hash and definition of a type by its full name.
fn known(name: &str) -> Option<(&'static str, &'static str)> {
    macro_rules! look {
        ($name:literal, $path:path, [$($constant:ident),*]) => {{
            type T = $path;
            if name == $name {
                return Some((T::TYPE_HASH, T::DEFINITION));
            }
        }};
    }
    for_every_message!(look);
    None
}

/// Types and names of the fields, by message (the outermost is called ""): a definition without comments, constants,
/// default values and order of the nested ones.
fn fields(definition: &str) -> BTreeMap<String, Vec<(String, String)>> {
    let mut all = BTreeMap::new();
    let mut message = String::new();
    let mut after_separator = false;
    for line in definition.lines() {
        let line = line.split('#').next().unwrap_or_default().trim();
        if line == SEPARATOR {
            after_separator = true;
        } else if after_separator {
            message = line.trim_start_matches("MSG:").trim().replace("/msg/", "/");
            after_separator = false;
        } else if let Some((kind, rest)) = line.split_once(char::is_whitespace)
            && !rest.contains('=')
        {
            let name = rest.split_whitespace().next().unwrap_or_default();
            let of_message: &mut Vec<_> = all.entry(message.clone()).or_default();
            of_message.push((kind.to_owned(), name.to_owned()));
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use patchmill_msgs::msg::{Job, Tool};

    use super::*;

    fn channel(name: &str, definition: &str, hash: Option<&str>) -> Channel<'static> {
        let schema = mcap::Schema {
            id: 1,
            name: name.to_owned(),
            encoding: "ros2msg".to_owned(),
            data: definition.as_bytes().to_vec().into(),
        };
        let hash = hash.map(|hash| ("topic_type_hash".to_owned(), hash.to_owned()));
        Channel {
            id: 1,
            topic: "/patchmill/job".to_owned(),
            schema: Some(Arc::new(schema)),
            message_encoding: "cdr".to_owned(),
            metadata: hash.into_iter().collect(),
        }
    }

    #[test]
    fn the_hash_decides_where_there_is_one() {
        assert!(check(&channel(Job::TYPE_NAME, "anything", Some(Job::TYPE_HASH))).is_ok());
        let other = format!("RIHS01_{}", "a".repeat(64));
        let text = check(&channel(Job::TYPE_NAME, Job::DEFINITION, Some(&other))).unwrap_err().text;
        for part in ["/patchmill/job", Job::TYPE_NAME, Job::TYPE_HASH, &other] {
            assert!(text.contains(part), "{part} in: {text}");
        }
    }

    #[test]
    fn fields_decide_where_there_is_no_hash() {
        for hash in [None, Some("")] {
            assert!(check(&channel(Job::TYPE_NAME, Job::DEFINITION, hash)).is_ok());
            let commented = Job::DEFINITION.replace("string job_id", "string   job_id  # another comment");
            assert!(check(&channel(Job::TYPE_NAME, &commented, hash)).is_ok());
            for (from, to) in [("float64 feed ", "float32 feed "), ("float64 r1 ", "float64 r9 ")] {
                let other = Job::DEFINITION.replace(from, to);
                assert_ne!(other, Job::DEFINITION);
                let text = check(&channel(Job::TYPE_NAME, &other, hash)).unwrap_err().text;
                assert!(text.contains("hash none") && text.contains(Job::TYPE_HASH), "{text}");
            }
        }
    }

    #[test]
    fn unknown_own_types_are_refused_and_foreign_ones_are_not() {
        assert!(check(&channel("patchmill_msgs/msg/Gone", Tool::DEFINITION, None)).is_err());
        assert!(check(&channel("other_msgs/msg/Gone", Tool::DEFINITION, None)).is_ok());
    }
}
