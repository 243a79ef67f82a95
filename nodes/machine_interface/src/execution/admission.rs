//! Which programs may run: those that this node has proven itself, on the machine of the proof, and those that its parameter
//! `accepted_programs` names.

use super::UNPROVEN;
use super::setup::Setup;
use patchmill_products::stage::StageError;

/// Proven programs that are remembered, the newest.
const REMEMBERED: usize = 1000;

/// Who may bring a program.
#[derive(Clone, Debug, PartialEq)]
pub struct Admission {
    named: Named,
    /// sha256 (hex digits) and setup of what was proven here, the newest last; a program counts as it was proven last.
    proven: Vec<(String, Setup)>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum Named {
    Any,
    These(Vec<String>),
}

impl Admission {
    /// Reads `accepted_programs`: empty (none), `any`, or sha256 sums with commas or blanks between them.
    ///
    /// # Errors
    /// One sentence that names the word that is none of these.
    pub fn parse(text: &str) -> Result<Self, String> {
        let text = text.trim();
        if text == "any" {
            return Ok(Self { named: Named::Any, proven: Vec::new() });
        }
        let words = text.split([',', ' ', '\t', '\n']).filter(|word| !word.is_empty());
        let sum = |word: &str| {
            let hex = word.len() == 64 && word.bytes().all(|b| b.is_ascii_hexdigit());
            let expected = "nothing, `any` or the 64 hex digits of programs' sha256 were expected";
            if hex { Ok(word.to_ascii_lowercase()) } else { Err(format!("`{word}`: {expected}")) }
        };
        Ok(Self { named: Named::These(words.map(sum).collect::<Result<_, _>>()?), proven: Vec::new() })
    }

    /// Remembers a program that has passed its proof here.
    pub fn prove(&mut self, sha256: &str, setup: Setup) {
        self.proven.retain(|(known, _)| known != sha256);
        self.proven.push((sha256.to_owned(), setup));
        let surplus = self.proven.len().saturating_sub(REMEMBERED);
        self.proven.drain(..surplus);
    }

    fn setup_of(&self, sha256: &str) -> Option<&Setup> {
        self.proven.iter().find(|(known, _)| known == sha256).map(|(_, setup)| setup)
    }

    /// Whether a program may be brought with this setup: what was proven here only as it was proven. `true`: it was proven here.
    ///
    /// # Errors
    /// [`UNPROVEN`].
    pub fn admit(&self, sha256: &str, setup: &Setup) -> Result<bool, StageError> {
        let Some(proven) = self.setup_of(sha256) else { return self.check(sha256).map(|()| false) };
        match proven.difference(setup) {
            None => Ok(true),
            Some(what) => {
                let text = format!(
                    "this node has proven the program with another {what} than it was brought with, and runs it only as it was proven"
                );
                Err(StageError::new(UNPROVEN, text))
            }
        }
    }

    /// Whether a program may be brought, whatever its machine.
    ///
    /// # Errors
    /// [`UNPROVEN`].
    pub fn check(&self, sha256: &str) -> Result<(), StageError> {
        let named = match &self.named {
            Named::Any => true,
            Named::These(sums) => sums.iter().any(|sum| sum == sha256),
        };
        if named || self.setup_of(sha256).is_some() {
            return Ok(());
        }
        let text = "this node has not proven the program, and its parameter `accepted_programs` names neither its sha256 nor `any`";
        Err(StageError::new(UNPROVEN, text))
    }
}

#[cfg(test)]
mod tests {
    use super::super::program::tests::dynamics;
    use super::*;

    const A: &str = "ca978112ca1bbdcafac231b39a23dc4da786eff8147c4e72b9807785afee48bb";
    const B: &str = "3e23e8160039594a33894f6564e1b1348bbd7a0088d42c4acb73eeaed59c009d";

    fn setup(tool_length: f64) -> Setup {
        Setup::new("<robot/>", tool_length, dynamics())
    }

    #[test]
    fn only_what_was_proven_or_named_may_come() {
        let mut none = Admission::parse("").unwrap();
        assert_eq!(none.check(A).unwrap_err().code, UNPROVEN);
        none.prove(A, setup(0.1));
        assert!(none.check(A).is_ok() && none.check(B).is_err() && none.check("").is_err());
        let both = Admission::parse(&format!(" {},\n{B} ", A.to_uppercase())).unwrap();
        assert!(both.check(A).is_ok() && both.check(B).is_ok() && both.check("any").is_err());
        assert!(Admission::parse("any").unwrap().check(B).is_ok());
    }

    #[test]
    fn what_was_proven_comes_as_it_was_proven_last() {
        for text in ["", "any", A] {
            let mut admission = Admission::parse(text).unwrap();
            admission.prove(A, setup(0.2));
            admission.prove(A, setup(0.1));
            assert_eq!(admission.admit(A, &setup(0.1)), Ok(true));
            let refused = admission.admit(A, &setup(0.2)).unwrap_err();
            assert_eq!(refused.code, UNPROVEN);
            assert!(refused.text.contains("another tool length"), "{refused}");
            assert_eq!(admission.admit(B, &setup(0.2)), admission.check(B).map(|()| false));
        }
    }

    #[test]
    fn other_words_are_refused() {
        for text in ["all", &A[1..], &format!("{A},any"), &A.replace('c', "g")] {
            assert!(Admission::parse(text).unwrap_err().contains("expected"), "{text}");
        }
    }

    #[test]
    fn the_newest_proven_are_remembered() {
        let mut admission = Admission::parse("").unwrap();
        for number in 0..=REMEMBERED {
            admission.prove(&number.to_string(), setup(0.1));
        }
        assert!(admission.check("0").is_err() && admission.check("1").is_ok());
        assert_eq!(admission.proven.len(), REMEMBERED);
    }
}
