//! A run from preparation to end on any controller: one loop that looks at the controller, obeys orders and judges the end.

use super::complaints::Complaints;
use super::controller::{Activity, Controller, Report};
use super::orders::Orders;
use super::program::{Deviation, ExecutableProgram};
use super::{ABORTED, CONNECTION_LOST, CONTROLLER_ERROR, ELSEWHERE};
use patchmill_kinematics::Joints;
use patchmill_products::stage::StageError;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// The controller is asked so often.
const PERIOD: Duration = Duration::from_millis(20);
/// For a started program to be seen running, and for an aborted one to stop.
const PATIENCE: Duration = Duration::from_secs(10);
/// The path counts from where the machine first is within this of its beginning: m and rad.
const ARRIVED: Deviation = Deviation { linear: 1e-4, rotary: 1e-3 };
/// Blocks that are the path's beginning, of a short program its first half: a machine that stands where the program ends has
/// not begun it.
const BEGINNING: usize = 10;
/// By this block of the program the machine has to have been there. A controller names the line where an earlier program ended
/// until it moves; so a line counts once one up to this block has been named.
const LOST: usize = 200;
/// A machine this far from the path runs with another work offset or tool: m and rad.
const ASTRAY: Deviation = Deviation { linear: 1e-3, rotary: 0.02 };
/// The program has been run to its end when the machine stands within this of it: m and rad.
const AT_END: Deviation = Deviation { linear: 1e-5, rotary: 1e-4 };

/// Where a run is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The controller is made ready and the program loaded.
    Preparing,
    /// The program runs.
    Running,
    /// Its feed is on hold.
    Held,
    /// It is being ended on demand.
    Aborting,
}

impl Phase {
    /// As in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Preparing => "preparing",
            Self::Running => "running",
            Self::Held => "held",
            Self::Aborting => "aborting",
        }
    }
}

/// A look at a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Where the run is.
    pub phase: Phase,
    /// Line of the program, 1-based; 0: not known.
    pub line: u32,
    /// Share of the planned time.
    pub fraction: f64,
    /// Where the joints are, m and rad; `None` before the start.
    pub joints: Option<Joints>,
}

/// What is known of a run that was started, however it ended.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Outcome {
    /// From start to end on the controller's clock, s.
    pub run_time: f64,
    /// Of it until the first position that the program gives, s.
    pub approach_time: f64,
    /// Of it on hold, s.
    pub held_time: f64,
    /// Reported positions on the program's path.
    pub position_count: u32,
    /// The largest distances from the path that two of these in a row have.
    pub deviation: Deviation,
}

/// Runs a program to its end. `observe` sees every look at the controller; `outcome` holds what is known at any time.
///
/// # Errors
/// Of the controller; [`CONTROLLER_ERROR`] with its words when it stopped before the end; [`ELSEWHERE`]; [`ABORTED`].
pub fn execute(
    controller: &mut dyn Controller,
    program: &ExecutableProgram,
    orders: &Orders,
    observe: &mut dyn FnMut(&Seen),
    outcome: &Mutex<Outcome>,
) -> Result<(), StageError> {
    let seen = |phase| Seen { phase, line: 0, fraction: 0.0, joints: None };
    observe(&seen(Phase::Preparing));
    controller.prepare(program, orders)?;
    // What is on hold before its start does not start.
    while orders.wants_hold() && !orders.wants_abort() {
        observe(&seen(Phase::Held));
        std::thread::sleep(PERIOD);
    }
    orders.go_on()?;
    if let Err(e) = controller.start() {
        return Err(given_up(controller, e));
    }
    let mut run = Run {
        program,
        started: Instant::now(),
        begin: None,
        last_clock: 0.0,
        held: false,
        moved: false,
        begun: false,
        arrived: false,
        last_off: None,
        line: 0,
        errors: Complaints::default(),
        outcome: Outcome::default(),
    };
    loop {
        if orders.wants_abort() {
            observe(&Seen { phase: Phase::Aborting, line: run.line, ..seen(Phase::Aborting) });
            return Err(stop(controller, run.line));
        }
        let report = match run.obey(controller, orders).and_then(|()| controller.report()) {
            Ok(report) => report,
            Err(e) => return Err(given_up(controller, e)),
        };
        let ended = run.take(&report);
        *outcome.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = run.outcome;
        observe(&run.seen(&report));
        match ended {
            Ok(true) => return Ok(()),
            Ok(false) => {}
            Err(e) => return Err(given_up(controller, e)),
        }
        std::thread::sleep(PERIOD);
    }
}

/// Ends the motion of a run that has failed: nobody would look at a machine that went on. The failure counts; when the controller
/// does not obey that is told too, with its code.
pub(crate) fn given_up(controller: &mut dyn Controller, failure: StageError) -> StageError {
    match controller.abort() {
        Err(e) if failure.code != CONNECTION_LOST => {
            StageError::new(e.code, format!("{}; {}", failure.text, e.text))
        }
        _ => failure,
    }
}

/// Ends the program on demand and waits until the machine stands.
fn stop(controller: &mut dyn Controller, line: u32) -> StageError {
    let stopped = controller.abort().and_then(|()| {
        let end = Instant::now() + PATIENCE;
        while controller.report()?.activity != Activity::Idle {
            if Instant::now() >= end {
                let text =
                    format!("the controller did not stop within {} s of being told to", PATIENCE.as_secs());
                return Err(StageError::new(CONTROLLER_ERROR, text));
            }
            std::thread::sleep(PERIOD);
        }
        Ok(())
    });
    stopped.err().unwrap_or_else(|| StageError::new(ABORTED, format!("the run was aborted in line {line}")))
}

struct Run<'a> {
    program: &'a ExecutableProgram,
    started: Instant,
    /// The controller's clock at the first report.
    begin: Option<f64>,
    last_clock: f64,
    held: bool,
    /// It was seen at work.
    moved: bool,
    /// The controller has named a line near the program's beginning.
    begun: bool,
    /// It was seen at the beginning of the program's path.
    arrived: bool,
    /// From the path in the last report.
    last_off: Option<Deviation>,
    line: u32,
    errors: Complaints,
    outcome: Outcome,
}

impl Run<'_> {
    fn obey(&mut self, controller: &mut dyn Controller, orders: &Orders) -> Result<(), StageError> {
        let wanted = orders.wants_hold();
        // A program that does not run yet cannot be held.
        if wanted != self.held && self.moved {
            if wanted {
                controller.hold()?
            } else {
                controller.resume()?
            }
            self.held = wanted;
        }
        Ok(())
    }

    /// Takes a report in; whether the run has come to its end.
    fn take(&mut self, report: &Report) -> Result<bool, StageError> {
        let begin = *self.begin.get_or_insert(report.clock);
        if report.activity == Activity::Held {
            self.outcome.held_time += report.clock - self.last_clock;
        }
        self.last_clock = report.clock;
        self.outcome.run_time = report.clock - begin;
        self.errors.extend(&report.errors);
        self.moved |= report.activity != Activity::Idle;
        if let Some(line) = report.line.filter(|_| self.moved) {
            self.begun |= self.program.block_at(line).is_none_or(|place| place <= LOST);
            if self.begun {
                self.line = line;
            }
        }
        self.measure(report)?;
        if report.activity == Activity::Idle {
            return self.judge(&report.joints);
        }
        Ok(false)
    }

    fn measure(&mut self, report: &Report) -> Result<(), StageError> {
        let place = report.line.filter(|_| self.begun).and_then(|line| self.program.block_at(line));
        let Some(place) = place else { return Ok(()) };
        if !self.arrived && !self.arrives(place, &report.joints) {
            self.outcome.approach_time = self.outcome.run_time;
            return Ok(());
        }
        let off = self.program.deviation(place, &report.joints);
        // A controller may copy its joints while they move: what one report alone says is not believed.
        let believed = off.min(self.last_off.replace(off).unwrap_or_default());
        if believed.linear > ASTRAY.linear || believed.rotary > ASTRAY.rotary {
            return Err(self.astray(believed));
        }
        self.outcome.position_count += 1;
        self.outcome.deviation = self.outcome.deviation.max(believed);
        Ok(())
    }

    /// Whether the program's path has been reached, or must have been.
    fn arrives(&mut self, place: usize, joints: &Joints) -> bool {
        let beginning = BEGINNING.min(self.program.blocks.len() / 2);
        let off = self.program.deviation_within(0, beginning, joints);
        let near = off.linear <= ARRIVED.linear && off.rotary <= ARRIVED.rotary;
        self.arrived = near || place > LOST;
        self.arrived
    }

    fn astray(&self, off: Deviation) -> StageError {
        let text = format!(
            "the machine is {:.3} mm and {:.3}° from the program's path in line {}: work offset and tool length of the controller must \
             be those of the machine's configuration",
            off.linear * 1e3,
            off.rotary.to_degrees(),
            self.line
        );
        StageError::new(ELSEWHERE, text)
    }

    /// The controller rests: at the program's end, not started yet, or before its time.
    fn judge(&self, joints: &Joints) -> Result<bool, StageError> {
        let end = self.program.end();
        let off =
            |range: std::ops::Range<usize>| range.map(|j| (joints[j] - end[j]).abs()).fold(0.0, f64::max);
        let at_end = off(0..3) <= AT_END.linear && off(3..5) <= AT_END.rotary;
        let waits = !self.moved && self.errors.is_empty();
        if waits && self.started.elapsed() < PATIENCE {
            return Ok(false);
        }
        if at_end && self.errors.is_empty() && self.arrived {
            return Ok(true);
        }
        let place = if self.line > 0 { format!(" in line {}", self.line) } else { String::new() };
        let text = match (self.errors.is_empty(), at_end) {
            (false, false) => format!("the controller stopped{place}: {}", self.errors),
            (false, true) => format!("the controller ran to the end but reported: {}", self.errors),
            (true, _) if !self.moved => {
                format!("the controller did not start the program within {} s", PATIENCE.as_secs())
            }
            (true, _) => {
                format!("the controller stopped{place}, before the program's end, and gave no reason")
            }
        };
        Err(StageError::new(CONTROLLER_ERROR, text))
    }

    fn seen(&self, report: &Report) -> Seen {
        let phase = if report.activity == Activity::Held { Phase::Held } else { Phase::Running };
        let ended = report.activity == Activity::Idle && self.moved;
        let fraction = if ended { 1.0 } else { self.program.fraction(self.line) };
        Seen { phase, line: self.line, fraction, joints: Some(report.joints) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::program::tests::{dynamics, square};
    use super::super::simulated::{SimulatedMachine, position};
    use super::*;
    use crate::DEFAULT_MACHINE_URDF;

    /// Plays reports, one a look; the last again and again.
    struct Scripted {
        reports: Vec<Report>,
        told: Vec<&'static str>,
        /// What it does not do.
        refuses: &'static str,
    }

    impl Scripted {
        fn tell(&mut self, what: &'static str) -> Result<(), StageError> {
            self.told.push(what);
            if self.refuses == what {
                return Err(StageError::new(CONTROLLER_ERROR, format!("no {what}")));
            }
            Ok(())
        }
    }

    impl Controller for Scripted {
        fn prepare(&mut self, _: &ExecutableProgram, orders: &Orders) -> Result<(), StageError> {
            orders.go_on()
        }
        fn start(&mut self) -> Result<(), StageError> {
            self.tell("start")
        }
        fn report(&mut self) -> Result<Report, StageError> {
            Ok(if self.reports.len() > 1 { self.reports.remove(0) } else { self.reports[0].clone() })
        }
        fn hold(&mut self) -> Result<(), StageError> {
            self.tell("hold")
        }
        fn resume(&mut self) -> Result<(), StageError> {
            self.tell("resume")
        }
        fn abort(&mut self) -> Result<(), StageError> {
            self.tell("abort")?;
            self.reports = vec![Report { activity: Activity::Idle, ..self.reports[0].clone() }];
            Ok(())
        }
    }

    fn report(activity: Activity, line: u32, joints: Joints, clock: f64) -> Report {
        Report { activity, line: Some(line), joints, errors: Vec::new(), clock }
    }

    /// The square as a perfect controller would report it, with a line before the first position.
    fn perfect() -> Vec<Report> {
        let program = square();
        let times = [0.0, 0.05, 0.1, program.timing.duration];
        let mut reports = vec![report(Activity::Running, 3, [0.0; 5], 0.0)];
        for time in times {
            let line = 5 + program.timing.block_ends[1..].partition_point(|end| *end < time) as u32;
            reports.push(report(
                Activity::Running,
                line,
                position(&program.timing.trajectory, time),
                1.0 + time,
            ));
        }
        let last = reports[reports.len() - 1].clone();
        reports.push(Report { activity: Activity::Idle, ..last });
        reports
    }

    fn run(reports: Vec<Report>, orders: &Orders) -> (Result<(), StageError>, Outcome, Vec<&'static str>) {
        let mut controller = Scripted { reports, told: Vec::new(), refuses: "" };
        let outcome = Mutex::default();
        let result = execute(&mut controller, &square(), orders, &mut |_| {}, &outcome);
        (result, outcome.into_inner().unwrap(), controller.told)
    }

    #[test]
    fn the_simulated_machine_runs_to_the_end_on_the_path() {
        let (program, outcome, mut looks) = (square(), Mutex::default(), Vec::new());
        let mut machine = SimulatedMachine::new(10.0);
        execute(&mut machine, &program, &Orders::default(), &mut |seen| looks.push(*seen), &outcome).unwrap();
        let outcome = outcome.into_inner().unwrap();
        assert!(
            (outcome.run_time - program.timing.duration).abs() < 0.3 && outcome.held_time == 0.0,
            "{outcome:?}"
        );
        assert!(outcome.deviation.linear < 1e-12 && outcome.position_count > 0);
        assert_eq!(looks[0].phase, Phase::Preparing);
        let last = looks[looks.len() - 1];
        assert_eq!((last.fraction, last.joints.unwrap()), (1.0, program.end()));
    }

    #[test]
    fn a_run_on_the_path_succeeds_and_is_measured() {
        let (result, outcome, _) = run(perfect(), &Orders::default());
        result.unwrap();
        assert!(outcome.deviation.linear < 1e-12 && outcome.position_count >= 4, "{outcome:?}");
        let mut off = perfect();
        off[2].joints[2] += 5e-6;
        let (result, outcome, _) = run(off.clone(), &Orders::default());
        result.unwrap();
        assert!(outcome.deviation.linear < 1e-12, "one report alone: {outcome:?}");
        off[3].joints[2] += 3e-6;
        let (result, outcome, _) = run(off, &Orders::default());
        result.unwrap();
        assert!((outcome.deviation.linear - 3e-6).abs() < 1e-9, "{outcome:?}");
    }

    /// Until it moves a controller names the line where the program before ended.
    #[test]
    fn what_is_left_of_an_earlier_run_does_not_count() {
        let program = square();
        let last = program.blocks[program.blocks.len() - 1].line as u32;
        let mut again = vec![report(Activity::Running, last, program.end(), 0.0)];
        again.extend(perfect());
        // Between end and beginning, off the path.
        let between = std::array::from_fn(|j| 0.5 * (program.end()[j] + program.blocks[0].joints[j]) + 0.02);
        again.insert(1, report(Activity::Running, last, between, 0.5));
        again.insert(1, report(Activity::Running, last, between, 0.5));
        let (result, outcome, _) = run(again, &Orders::default());
        result.unwrap();
        assert!(outcome.deviation.linear < 1e-12 && outcome.position_count >= 4, "{outcome:?}");
        // A line far beyond: of a longer program.
        let steps: String = (1..300).map(|i| format!("X{}\n", f64::from(i) * 0.01)).collect();
        let text = format!("G21 G90\nG0 X0 Y0 Z380 A10 C20\nG1 F6000\n{steps}M30\n");
        let long =
            ExecutableProgram::new(text, DEFAULT_MACHINE_URDF.to_owned(), 0.1, dynamics(), 1000).unwrap();
        let mut reports = vec![report(Activity::Running, 290, [0.0; 5], 0.0); 2];
        for place in [0, 150, long.blocks.len() - 1] {
            let block = &long.blocks[place];
            reports.push(report(Activity::Running, block.line as u32, block.joints, 1.0 + place as f64));
        }
        reports.push(report(Activity::Idle, 302, long.end(), 400.0));
        let mut controller = Scripted { reports, told: Vec::new(), refuses: "" };
        let outcome = Mutex::default();
        execute(&mut controller, &long, &Orders::default(), &mut |_| {}, &outcome).unwrap();
        assert!(outcome.into_inner().unwrap().deviation.linear < 1e-9);
    }

    #[test]
    fn errors_early_ends_and_strayed_machines_fail_with_the_reason() {
        let failing = |change: &dyn Fn(&mut Vec<Report>)| {
            let mut reports = perfect();
            change(&mut reports);
            run(reports, &Orders::default()).0.unwrap_err()
        };
        let stopped = failing(&|reports| {
            reports.truncate(3);
            reports.push(Report {
                activity: Activity::Idle,
                errors: vec!["joint 2 following error".to_owned()],
                ..reports[2].clone()
            });
        });
        assert_eq!(stopped.code, CONTROLLER_ERROR);
        assert!(stopped.text.contains("line 5: joint 2 following error"), "{stopped}");
        let early = failing(&|reports| {
            reports.truncate(3);
            reports.push(Report { activity: Activity::Idle, ..reports[2].clone() });
        });
        assert!(early.text.contains("before the program's end"), "{early}");
        let astray = failing(&|reports| reports[2..5].iter_mut().for_each(|r| r.joints[2] += 0.1));
        assert_eq!(astray.code, ELSEWHERE);
        assert!(astray.text.contains("100.000 mm"), "{astray}");
    }

    #[test]
    fn a_machine_is_stopped_when_its_run_fails() {
        let orders = Orders::default();
        for (refuses, told) in [("hold", vec!["start", "hold", "abort"]), ("start", vec!["start", "abort"])] {
            let mut controller = Scripted { reports: perfect(), told: Vec::new(), refuses };
            let mut hold_once_running = |seen: &Seen| orders.set_hold(seen.phase == Phase::Running);
            let outcome = Mutex::default();
            let ended = execute(&mut controller, &square(), &orders, &mut hold_once_running, &outcome);
            assert_eq!((ended.unwrap_err().text, controller.told), (format!("no {refuses}"), told));
        }
    }

    #[test]
    fn a_machine_that_does_not_stop_when_its_run_fails_is_told() {
        let mut reports = perfect();
        reports[2..5].iter_mut().for_each(|r| r.joints[2] += 0.1);
        let mut controller = Scripted { reports, told: Vec::new(), refuses: "abort" };
        let (orders, outcome) = (Orders::default(), Mutex::default());
        let error = execute(&mut controller, &square(), &orders, &mut |_| {}, &outcome).unwrap_err();
        assert_eq!((error.code, controller.told), (CONTROLLER_ERROR, vec!["start", "abort"]));
        assert!(error.text.contains("100.000 mm") && error.text.ends_with("; no abort"), "{error}");
    }

    #[test]
    fn errors_without_end_are_counted() {
        let mut reports = perfect();
        reports.iter_mut().for_each(|r| r.errors = vec!["following error".to_owned(); 100]);
        let error = run(reports, &Orders::default()).0.unwrap_err();
        assert!(error.text.ends_with("following error; and 580 more"), "{error}");
    }

    #[test]
    fn orders_reach_the_controller() {
        let orders = Orders::default();
        let mut reports = perfect();
        reports[3].activity = Activity::Held;
        let mut controller = Scripted { reports, told: Vec::new(), refuses: "" };
        let outcome = Mutex::default();
        let mut hold_once_running = |seen: &Seen| orders.set_hold(seen.phase != Phase::Preparing);
        execute(&mut controller, &square(), &orders, &mut hold_once_running, &outcome).unwrap();
        assert_eq!(controller.told, ["start", "hold"]);
        assert!(outcome.into_inner().unwrap().held_time > 0.0);
        orders.set_hold(false);
        orders.abort();
        let (result, _, told) = run(perfect(), &orders);
        assert_eq!((result.unwrap_err().code, told), (ABORTED, vec![]));
    }

    #[test]
    fn a_program_on_hold_does_not_start() {
        let orders = Orders::default();
        orders.set_hold(true);
        let mut looks = 0;
        let mut resume_at_the_third = |seen: &Seen| {
            looks += usize::from(seen.phase == Phase::Held);
            orders.set_hold(looks < 3);
        };
        let mut controller = Scripted { reports: perfect(), told: Vec::new(), refuses: "" };
        execute(&mut controller, &square(), &orders, &mut resume_at_the_third, &Mutex::default()).unwrap();
        assert_eq!((looks, controller.told), (3, vec!["start"]));
        orders.set_hold(true);
        let mut controller = Scripted { reports: perfect(), told: Vec::new(), refuses: "" };
        let mut abort = |seen: &Seen| {
            if seen.phase == Phase::Held {
                orders.abort();
            }
        };
        let ended = execute(&mut controller, &square(), &orders, &mut abort, &Mutex::default());
        assert_eq!((ended.unwrap_err().code, controller.told), (ABORTED, vec![]));
    }
}
