//! What a controller is to whoever runs a program on it.

use super::orders::Orders;
use super::program::ExecutableProgram;
use patchmill_kinematics::Joints;
use patchmill_products::stage::StageError;

/// What a controller does with the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activity {
    /// Nothing: before the start, after the end, or after it gave up.
    Idle,
    /// It moves.
    Running,
    /// Its feed is on hold.
    Held,
}

/// What a controller says at a moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    /// What it does.
    pub activity: Activity,
    /// Line of the program, 1-based, not behind the axes; before the first move it may be where an earlier program ended.
    /// `None` where it does not know.
    pub line: Option<u32>,
    /// Where its joints are: m and rad, order of the machine's axes.
    pub joints: Joints,
    /// Errors since the last report, in its own words.
    pub errors: Vec<String>,
    /// Its clock, s, from any zero: does not stand still while a program is on hold.
    pub clock: f64,
}

/// A machine's control. Calls block for as long as the control needs; every error ends the run.
pub trait Controller {
    /// Makes the machine ready and loads the program: connected, switched on, homed, in automatic mode. What it has set moving
    /// by then it stops itself when it fails.
    ///
    /// # Errors
    /// When it cannot be reached, is at work, or refuses, in its own words where it has any; `ABORTED` as soon as `orders` says so.
    fn prepare(&mut self, program: &ExecutableProgram, orders: &Orders) -> Result<(), StageError>;

    /// Starts the loaded program.
    ///
    /// # Errors
    /// When it refuses or does not answer: it may run all the same.
    fn start(&mut self) -> Result<(), StageError>;

    /// Asks how it is.
    ///
    /// # Errors
    /// When it does not answer.
    fn report(&mut self) -> Result<Report, StageError>;

    /// Stops the feed.
    ///
    /// # Errors
    /// When it refuses.
    fn hold(&mut self) -> Result<(), StageError>;

    /// Continues after a hold.
    ///
    /// # Errors
    /// When it refuses.
    fn resume(&mut self) -> Result<(), StageError>;

    /// Ends the program where it is.
    ///
    /// # Errors
    /// When it refuses.
    fn abort(&mut self) -> Result<(), StageError>;
}
