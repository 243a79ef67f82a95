//! What a controller complains of: the first errors in its words, of the others the number.

use std::fmt;

/// Errors that are kept.
const MOST: usize = 20;
/// Characters of each that are kept: far above LinuxCNC's.
const LONGEST: usize = 500;

/// Errors of a controller, bounded whatever it sends.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Complaints {
    first: Vec<String>,
    more: usize,
}

impl Complaints {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.first.is_empty()
    }
}

impl<'a> Extend<&'a String> for Complaints {
    fn extend<T: IntoIterator<Item = &'a String>>(&mut self, errors: T) {
        for error in errors {
            if self.first.len() < MOST {
                self.first.push(error.chars().take(LONGEST).collect());
            } else {
                self.more += 1;
            }
        }
    }
}

impl<'a> FromIterator<&'a String> for Complaints {
    fn from_iter<T: IntoIterator<Item = &'a String>>(errors: T) -> Self {
        let mut complaints = Self::default();
        complaints.extend(errors);
        complaints
    }
}

impl fmt::Display for Complaints {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.first.join("; "))?;
        if self.more > 0 { write!(f, "; and {} more", self.more) } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_are_kept_and_the_others_counted() {
        let mut complaints = Complaints::default();
        assert!(complaints.is_empty());
        let errors: Vec<String> = (0..MOST).map(|i| format!("error {i}")).collect();
        complaints.extend(&errors[..2]);
        assert_eq!(complaints.to_string(), "error 0; error 1");
        for _ in 0..1000 {
            complaints.extend(&errors);
        }
        let text = complaints.to_string();
        assert!(text.starts_with("error 0; error 1; error 0; error 1; error 2;"), "{text}");
        assert!(text.ends_with("error 17; and 19982 more"), "{text}");
        assert_eq!(
            [&"ä".repeat(70_000)].into_iter().collect::<Complaints>().to_string(),
            "ä".repeat(LONGEST)
        );
    }
}
