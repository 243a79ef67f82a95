//! A program's text and the proof that it passed. Fields are private and [`PassedProof::of`] is the only way to one, so that what holds a
//! [`PassedProof`] cannot hold an unproven text, nor one that was changed since.

use patchmill_kinematics::{Joints, Machine};
use patchmill_products::evaluation::{Proof, ResidualMap};
use patchmill_products::job::Job;
use patchmill_products::stage::{Progress, StageError};
use patchmill_rolling_ball_analysis::local_balls::LocalBalls;

use crate::assembly_proof::assembly_touch;
use crate::clearance::PartBody;
use crate::gcode::{self, ReadBlock};
use crate::proof::{PartPoints, prove, shortcoming};
use crate::surroundings::Surroundings;

/// A program's text and its motions as read from it.
#[derive(Clone, Debug)]
pub struct ReadProgram {
    text: String,
    blocks: Vec<ReadBlock>,
}

impl ReadProgram {
    /// Reads a text of at most `max_moves` moves; `zero` is the machine's work offset.
    ///
    /// # Errors
    /// As [`gcode::read`].
    pub fn new(text: String, machine: &Machine, zero: &Joints, max_moves: usize) -> Result<Self, String> {
        let blocks = gcode::read(&text, machine, zero, max_moves)?;
        Ok(Self { text, blocks })
    }

    /// Its motions.
    pub fn blocks(&self) -> &[ReadBlock] {
        &self.blocks
    }
}

/// What programs of one job are proven against.
pub struct ProofBench<'a> {
    /// The machine.
    pub machine: &'a Machine,
    /// The part as a convex body.
    pub part: &'a PartBody,
    /// The part's surface and the machine's bodies.
    pub surroundings: &'a Surroundings<'a>,
    /// What was asked for.
    pub job: &'a Job,
    points: PartPoints,
    balls: Option<LocalBalls<'a>>,
}

impl<'a> ProofBench<'a> {
    /// Spreads the points at which programs are judged.
    pub fn new(
        machine: &'a Machine,
        part: &'a PartBody,
        surroundings: &'a Surroundings<'a>,
        job: &'a Job,
    ) -> Self {
        let mesh = surroundings.mesh;
        let balls = job.leaves_rest().then(|| LocalBalls::of(mesh, &surroundings.bvh, job));
        Self { machine, part, surroundings, job, points: PartPoints::of(mesh, job), balls }
    }
}

/// A program's text that has passed its proof.
#[derive(Clone, Debug, PartialEq)]
pub struct PassedProof {
    text: String,
    block_count: u32,
    proof: Proof,
    residual: ResidualMap,
}

impl PassedProof {
    /// Proves a program: cutter, shank and holder swept along what was read from its text. `Err` within: what it lacks.
    ///
    /// # Errors
    /// SUPERSEDED when cancelled.
    pub fn of(
        program: ReadProgram,
        bench: &ProofBench<'_>,
        progress: &Progress<'_>,
    ) -> Result<Result<Self, String>, StageError> {
        let ProofBench { machine, part, surroundings, job, points, balls } = bench;
        let ReadProgram { text, blocks } = program;
        let (proof, residual) = prove(&blocks, machine, part, points, balls.as_ref(), job, progress)?;
        if let Some(lacking) = shortcoming(&proof, job) {
            return Ok(Err(lacking));
        }
        if let Some(touch) = assembly_touch(&blocks, machine, part, surroundings, job, progress)? {
            return Ok(Err(touch));
        }
        Ok(Ok(Self { text, block_count: blocks.len() as u32, proof, residual }))
    }

    /// The program's text.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Lines with a motion from known position to known position.
    pub fn block_count(&self) -> u32 {
        self.block_count
    }

    /// What the swept check of the text found.
    pub fn proof(&self) -> &Proof {
        &self.proof
    }

    /// The same at every point.
    pub fn residual(&self) -> &ResidualMap {
        &self.residual
    }
}
