//! The programs that can be run, by their sha256: those that this node has proven, and those that were brought.

use super::admission::Admission;
use super::program::ExecutableProgram;
use super::setup::Setup;
use patchmill_products::stage::StageError;
use std::sync::Arc;

/// Programs that are kept, the newest.
const KEPT: usize = 4;

/// Programs and who may bring more. One that was proven here is never replaced by one that is brought.
#[derive(Debug)]
pub struct KnownPrograms {
    kept: Vec<Arc<ExecutableProgram>>,
    admission: Admission,
}

impl KnownPrograms {
    /// None yet.
    pub fn new(admission: Admission) -> Self {
        Self { kept: Vec::new(), admission }
    }

    /// The program of a sha256.
    pub fn find(&self, sha256: &str) -> Option<Arc<ExecutableProgram>> {
        self.kept.iter().find(|known| known.sha256 == sha256).cloned()
    }

    /// Takes a program that has passed its proof here.
    pub fn prove(&mut self, program: ExecutableProgram) {
        self.admission.prove(&program.sha256, program.setup.clone());
        self.keep(Arc::new(program));
    }

    /// Whether a program of this sha256 may be brought at all.
    ///
    /// # Errors
    /// As [`Admission::check`].
    pub fn check(&self, sha256: &str) -> Result<(), StageError> {
        self.admission.check(sha256)
    }

    /// The program that was proven here, when it is still kept, for one that is brought with this setup.
    ///
    /// # Errors
    /// As [`Admission::admit`].
    pub fn own(&self, sha256: &str, setup: &Setup) -> Result<Option<Arc<ExecutableProgram>>, StageError> {
        let proven = self.admission.admit(sha256, setup)?;
        Ok(self.find(sha256).filter(|_| proven))
    }

    /// Takes a program that was brought, or keeps the own one in its stead; what is known by its sha256 from now on.
    ///
    /// # Errors
    /// As [`Admission::admit`].
    pub fn bring(&mut self, brought: Arc<ExecutableProgram>) -> Result<Arc<ExecutableProgram>, StageError> {
        let known = self.own(&brought.sha256, &brought.setup)?.unwrap_or(brought);
        self.keep(Arc::clone(&known));
        Ok(known)
    }

    fn keep(&mut self, program: Arc<ExecutableProgram>) {
        self.kept.retain(|known| known.sha256 != program.sha256);
        self.kept.push(program);
        let surplus = self.kept.len().saturating_sub(KEPT);
        self.kept.drain(..surplus);
    }
}

#[cfg(test)]
mod tests {
    use super::super::UNPROVEN;
    use super::super::program::tests::{SQUARE, dynamics, square};
    use super::*;
    use crate::DEFAULT_MACHINE_URDF;

    fn known(accepted: &str) -> KnownPrograms {
        KnownPrograms::new(Admission::parse(accepted).unwrap())
    }

    /// The square on a machine of the same text but for a longer tool.
    fn strangers() -> ExecutableProgram {
        let (text, urdf) = (SQUARE.to_owned(), DEFAULT_MACHINE_URDF.to_owned());
        ExecutableProgram::new(text, urdf, 0.101, dynamics(), 10).unwrap()
    }

    #[test]
    fn what_was_proven_here_stays_whoever_brings_it() {
        for accepted in ["", "any", &square().sha256] {
            let mut known = known(accepted);
            known.prove(square());
            let own = known.find(&square().sha256).unwrap();
            for again in [square(), strangers()] {
                let same = again.setup == square().setup;
                let brought = known.bring(Arc::new(again));
                assert_eq!(brought.is_ok(), same, "{accepted}");
                if let Err(e) = brought {
                    assert_eq!(e.code, UNPROVEN);
                    assert!(e.text.contains("another tool length"), "{e}");
                }
                assert!(Arc::ptr_eq(&known.find(&own.sha256).unwrap(), &own));
            }
        }
    }

    #[test]
    fn the_proof_outweighs_what_was_brought_before() {
        let mut known = known("any");
        let brought = known.bring(Arc::new(strangers())).unwrap();
        assert_eq!(brought.setup, strangers().setup);
        known.prove(square());
        assert_eq!(known.find(&brought.sha256).unwrap().setup, square().setup);
    }

    #[test]
    fn a_proven_program_that_is_no_longer_kept_comes_back_as_it_was_proven() {
        let mut known = known("any");
        known.prove(square());
        for number in 0..KEPT {
            let text = format!("(another, {number})\n{SQUARE}");
            let urdf = DEFAULT_MACHINE_URDF.to_owned();
            let other = ExecutableProgram::new(text, urdf, 0.1, dynamics(), 10).unwrap();
            known.bring(Arc::new(other)).unwrap();
        }
        assert!(known.find(&square().sha256).is_none());
        assert!(known.bring(Arc::new(strangers())).is_err());
        assert!(known.find(&square().sha256).is_none());
        known.bring(Arc::new(square())).unwrap();
        assert!(known.find(&square().sha256).is_some());
    }
}
