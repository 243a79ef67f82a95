//! Reading URDF text within bounds, and finding elements in it, so that an edit touches only what it means and the rest stays as its
//! author wrote it.

use std::ops::Range;

use crate::error::KinematicsError;

/// Longest URDF text, bytes.
const TEXT_BYTES_MAX: usize = 4 << 20;
/// Deepest nesting of its elements: the reader's time grows with its square.
const DEPTH_MAX: usize = 64;

/// The robot that URDF text describes.
///
/// # Errors
/// [`KinematicsError::Model`] when the text cannot be read, is too long, nested too deep or has a DOCTYPE (whose entities can stand for
/// any amount of text).
pub fn robot_of(text: &str) -> Result<urdf_rs::Robot, KinematicsError> {
    let bad = |what: String| KinematicsError::Model(format!("the machine's URDF cannot be read: {what}"));
    if text.len() > TEXT_BYTES_MAX {
        return Err(bad(format!("it has {} bytes; at most {TEXT_BYTES_MAX} were expected", text.len())));
    }
    if text.contains("<!DOCTYPE") {
        return Err(bad("it has a DOCTYPE, which is not read".to_owned()));
    }
    if deepest(text) > DEPTH_MAX {
        return Err(bad(format!("its elements are nested more than {DEPTH_MAX} deep")));
    }
    urdf_rs::read_from_string(text).map_err(|e| bad(e.to_string()))
}

/// Deepest nesting of the elements of a text, as far as it is well-formed.
fn deepest(text: &str) -> usize {
    let (mut depth, mut most, mut at) = (0usize, 0, 0);
    while let Some(open) = text[at..].find('<').map(|i| at + i) {
        let Some(end) = tag_end(text, open) else { break };
        let tag = &text[open..end];
        at = end;
        if tag.starts_with("</") {
            depth = depth.saturating_sub(1);
        } else if !(tag.starts_with("<!") || tag.starts_with("<?") || tag.ends_with("/>")) {
            depth += 1;
            most = most.max(depth);
        }
    }
    most
}

/// A direct child element of `<robot>`.
pub(crate) struct Child {
    /// Its tag's name.
    pub tag: String,
    /// Byte range of its opening tag.
    pub head: Range<usize>,
    /// Byte range of the whole element.
    pub whole: Range<usize>,
}

/// The children of the root element and the place of its closing tag.
pub(crate) fn children_of_robot(text: &str) -> Option<(Vec<Child>, usize)> {
    let mut children: Vec<Child> = Vec::new();
    let (mut depth, mut at) = (0usize, 0);
    while let Some(open) = text[at..].find('<').map(|i| at + i) {
        let end = tag_end(text, open)?;
        let tag = &text[open..end];
        at = end;
        if tag.starts_with("<!") || tag.starts_with("<?") {
            continue;
        }
        if tag.starts_with("</") {
            depth = depth.checked_sub(1)?;
            match depth {
                0 => return Some((children, open)),
                1 => children.last_mut()?.whole.end = end,
                _ => {}
            }
            continue;
        }
        if depth == 1 {
            let name = tag[1..].split(|c: char| c.is_whitespace() || c == '/' || c == '>').next()?;
            children.push(Child { tag: name.to_owned(), head: open..end, whole: open..end });
        }
        if !tag.ends_with("/>") {
            depth += 1;
        }
    }
    None
}

/// Where the markup that begins at `open` ends; comments, CDATA and quoted attribute values may hold `>`.
pub(crate) fn tag_end(text: &str, open: usize) -> Option<usize> {
    for (start, close) in [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")] {
        if text[open..].starts_with(start) {
            return text[open + start.len()..].find(close).map(|i| open + start.len() + i + close.len());
        }
    }
    let mut quote = None;
    for (i, c) in text[open..].char_indices() {
        match (quote, c) {
            (None, '"' | '\'') => quote = Some(c),
            (Some(q), _) if q == c => quote = None,
            (None, '>') => return Some(open + i + 1),
            _ => {}
        }
    }
    None
}

/// Value of an attribute of one opening tag.
pub(crate) fn attribute<'a>(tag: &'a str, name: &str) -> Option<&'a str> {
    let mut rest = tag;
    while let Some(i) = rest.find(name) {
        let before_is_space = rest[..i].ends_with(|c: char| c.is_whitespace());
        let after = rest[i + name.len()..].trim_start();
        rest = &rest[i + name.len()..];
        let Some(value) = after.strip_prefix('=').map(str::trim_start) else { continue };
        let quote = value.chars().next()?;
        if before_is_space && (quote == '"' || quote == '\'') {
            return value[1..].split(quote).next();
        }
    }
    None
}

/// The `link` of the `<child>` of a joint element.
pub(crate) fn child_link(joint: &str) -> Option<&str> {
    attribute(&joint[element(joint, "child")?], "link")
}

/// Byte range of the first opening tag of this name in `text`, comments skipped.
pub(crate) fn element(text: &str, name: &str) -> Option<Range<usize>> {
    let mut at = 0;
    while let Some(open) = text[at..].find('<').map(|i| at + i) {
        let end = tag_end(text, open)?;
        let rest = text[open + 1..end].strip_prefix(name);
        if rest.is_some_and(|rest| rest.starts_with(|c: char| c.is_whitespace() || c == '/' || c == '>')) {
            return Some(open..end);
        }
        at = end;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_made_to_take_time_or_memory_are_refused() {
        let refused = |text: &str| robot_of(text).unwrap_err().to_string();
        let robot = |inner: &str| format!("<robot name=\"m\">{inner}</robot>");
        assert!(robot_of(&robot(&format!("<link name=\"a\"/>{}", "<!-- <a> -->".repeat(100)))).is_ok());
        let deep = "<a>".repeat(30_000) + &"</a>".repeat(30_000);
        assert!(refused(&robot(&deep)).contains("nested more than 64 deep"));
        assert!(refused(&robot(&" ".repeat(TEXT_BYTES_MAX))).contains("at most 4194304 were expected"));
        assert!(refused(&format!("<!DOCTYPE robot>{}", robot(""))).contains("DOCTYPE"));
    }
}
