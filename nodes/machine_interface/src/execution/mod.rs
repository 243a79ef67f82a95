//! Running a program on a controller, real or simulated: the program and its path, what a controller is, and the run itself.

pub mod controller;
pub mod program;
pub mod run;
pub mod simulated;

pub use controller::{Activity, Controller, Report};
pub use program::{ExecutableProgram, Part, PartStore, sha256_hex};
pub use run::{Orders, Outcome, Phase, Seen, execute};

/// A part of a program, or a program, that cannot be used: it does not read, or its hash is another.
pub const BAD_PROGRAM: i32 = 530;
/// The goal names a program that this node does not have.
pub const UNKNOWN_PROGRAM: i32 = 531;
/// The controller's name or the speed makes no sense.
pub const BAD_CONTROLLER: i32 = 532;
/// Another program runs, or the controller is at work.
pub const BUSY: i32 = 533;
/// The controller cannot be reached or does not talk as expected.
pub const NO_CONNECTION: i32 = 534;
/// The connection was lost while the program ran: what the machine does is not known.
pub const CONNECTION_LOST: i32 = 535;
/// The controller reported an error, or stopped before the program's end.
pub const CONTROLLER_ERROR: i32 = 536;
/// The machine is not where the program is: work offset or tool length of the controller are others.
pub const ELSEWHERE: i32 = 537;
/// The run was aborted on demand.
pub const ABORTED: i32 = 538;
/// No program runs that could be held or resumed.
pub const NOT_RUNNING: i32 = 539;
