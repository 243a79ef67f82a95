//! Running a program on a controller, real or simulated: the program and its path, what a controller is, and the run itself.

pub mod admission;
pub mod complaints;
pub mod controller;
pub mod known_programs;
pub mod orders;
pub mod program;
pub mod reach;
pub mod run;
pub mod setup;
pub mod simulated;

use crate::linuxcnc::client::{LinuxCnc, address};
use patchmill_products::stage::StageError;
use std::path::Path;

pub use admission::Admission;
pub use controller::{Activity, Controller, Report};
pub use known_programs::KnownPrograms;
pub use orders::Orders;
pub use program::{ExecutableProgram, Part, PartStore, sha256_hex};
pub use reach::Reach;
pub use run::{Outcome, Phase, Seen, execute};

/// A part of a program, or a program, that cannot be used: it does not read, or its hash is another.
pub const BAD_PROGRAM: i32 = 530;
/// The goal names a program that this node does not have.
pub const UNKNOWN_PROGRAM: i32 = 531;
/// The controller's name or the speed makes no sense, or the controller is not one that a goal may name.
pub const BAD_CONTROLLER: i32 = 532;
/// Another program runs or is being read, or the controller is at work.
pub const BUSY: i32 = 533;
/// The controller cannot be reached or does not talk as expected.
pub const NO_CONNECTION: i32 = 534;
/// The connection was lost while the program ran or the joints were homed: what the machine does is not known.
pub const CONNECTION_LOST: i32 = 535;
/// The controller reported an error, or stopped before the program's end.
pub const CONTROLLER_ERROR: i32 = 536;
/// The machine is not where the program is: work offset or tool length of the controller are others.
pub const ELSEWHERE: i32 = 537;
/// The run was aborted on demand.
pub const ABORTED: i32 = 538;
/// No program runs that could be held or resumed.
pub const NOT_RUNNING: i32 = 539;
/// A program was brought that this node has not proven and nobody has named at its start, or one that it has proven on another machine.
pub const UNPROVEN: i32 = 540;

/// The controller of a name: `sim`, its clock `speed` times as fast as ours (0 counts as 1), or `linuxcnc://HOST:PORT`, which reads
/// programs from `folder` and is one that `reach` lets a goal name. Nothing is connected yet.
///
/// # Errors
/// [`BAD_CONTROLLER`] for any other name, and for a speed that makes no sense.
pub fn controller_of(
    name: &str,
    speed: f64,
    folder: &Path,
    reach: &Reach,
) -> Result<Box<dyn Controller + Send>, StageError> {
    let bad = |text: String| Err(StageError::new(BAD_CONTROLLER, text));
    let speed = if speed == 0.0 { 1.0 } else { speed };
    if !(speed.is_finite() && speed > 0.0) {
        return bad(format!("the speed of the simulated machine is {speed}: a number above 0 was expected"));
    }
    match (name, address(name)) {
        ("sim", _) => Ok(Box::new(simulated::SimulatedMachine::new(speed))),
        (_, Some(_)) if speed != 1.0 => {
            bad(format!("{name} runs at its own speed: {speed} cannot be asked of it"))
        }
        (_, Some(address)) => {
            reach.check(address)?;
            Ok(Box::new(LinuxCnc::new(address, folder)))
        }
        _ => bad(format!("there is no controller `{name}`: sim or linuxcnc://HOST:PORT was expected")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn controllers_are_known_by_their_names() {
        let reach = Reach::parse("mill:5007").unwrap();
        let of = |name: &str, speed: f64| controller_of(name, speed, Path::new("/tmp"), &reach).map(|_| ());
        for (name, speed) in
            [("sim", 0.0), ("sim", 50.0), ("linuxcnc://127.0.0.1:5007", 1.0), ("linuxcnc://mill:5007", 1.0)]
        {
            of(name, speed).unwrap();
        }
        for (name, speed, words) in [
            ("sim", -1.0, "above 0"),
            ("sim", f64::NAN, "above 0"),
            ("linuxcnc://mill:5007", 2.0, "own speed"),
            ("fanuc", 1.0, "no controller `fanuc`"),
            ("linuxcnc://mill", 1.0, "linuxcnc://HOST:PORT"),
            ("linuxcnc://other:5007", 1.0, "`controllers`"),
        ] {
            let error = of(name, speed).unwrap_err();
            assert_eq!(error.code, BAD_CONTROLLER);
            assert!(error.text.contains(words), "{error}");
        }
    }
}
