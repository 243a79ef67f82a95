//! A simulated machine: it follows the program's own joint motion at any speed, perfectly.

use super::controller::{Activity, Controller, Report};
use super::orders::Orders;
use super::program::ExecutableProgram;
use patchmill_kinematics::{Joints, PathPoint};
use patchmill_products::stage::StageError;
use std::time::Instant;

/// The machine; its clock runs `speed` times as fast as ours.
pub struct SimulatedMachine {
    speed: f64,
    trajectory: Vec<PathPoint>,
    /// When each block ends (s of the program) and its line.
    block_ends: Vec<(f64, u32)>,
    /// Time of the program until the last hold, s.
    done: f64,
    /// Since when it moves.
    moving: Option<Instant>,
    loaded: bool,
    /// Since when it is on hold.
    held: Option<Instant>,
    /// On the machine's clock on hold before that, s.
    held_before: f64,
}

impl SimulatedMachine {
    /// A machine without a program. `speed` > 0.
    pub fn new(speed: f64) -> Self {
        Self {
            speed,
            trajectory: Vec::new(),
            block_ends: Vec::new(),
            done: 0.0,
            moving: None,
            loaded: false,
            held: None,
            held_before: 0.0,
        }
    }

    /// Time of the program, s, not beyond its end.
    fn program_time(&self) -> f64 {
        let moved = self.moving.map_or(0.0, |since| since.elapsed().as_secs_f64() * self.speed);
        (self.done + moved).min(self.duration())
    }

    fn duration(&self) -> f64 {
        self.trajectory.last().map_or(0.0, |point| point.time)
    }

    /// Time on hold, s of the machine's clock.
    fn held_time(&self) -> f64 {
        self.held_before + self.held.map_or(0.0, |since| since.elapsed().as_secs_f64() * self.speed)
    }

    fn freeze(&mut self) {
        self.done = self.program_time();
        self.moving = None;
    }
}

impl Controller for SimulatedMachine {
    fn prepare(&mut self, program: &ExecutableProgram, _: &Orders) -> Result<(), StageError> {
        self.trajectory.clone_from(&program.timing.trajectory);
        self.block_ends = program
            .timing
            .block_ends
            .iter()
            .zip(&program.blocks)
            .map(|(end, b)| (*end, b.line as u32))
            .collect();
        Ok(())
    }

    fn start(&mut self) -> Result<(), StageError> {
        self.loaded = true;
        self.moving = Some(Instant::now());
        Ok(())
    }

    fn report(&mut self) -> Result<Report, StageError> {
        let time = self.program_time();
        let activity = match (self.loaded, self.held.is_some()) {
            (false, _) => Activity::Idle,
            (true, true) => Activity::Held,
            (true, false) => Activity::Running,
        };
        // Seen once at its end before it rests, however quick.
        self.loaded &= time < self.duration() || self.held.is_some();
        let place = self.block_ends.partition_point(|(end, _)| *end < time);
        let line = self.block_ends.get(place).or(self.block_ends.last()).map(|(_, line)| *line);
        Ok(Report {
            activity,
            line,
            joints: position(&self.trajectory, time),
            errors: Vec::new(),
            clock: time + self.held_time(),
        })
    }

    fn hold(&mut self) -> Result<(), StageError> {
        self.freeze();
        self.held.get_or_insert_with(Instant::now);
        Ok(())
    }

    fn resume(&mut self) -> Result<(), StageError> {
        self.held_before = self.held_time();
        self.held = None;
        if self.loaded {
            self.moving = Some(Instant::now());
        }
        Ok(())
    }

    fn abort(&mut self) -> Result<(), StageError> {
        self.freeze();
        self.loaded = false;
        Ok(())
    }
}

/// Where the joints are at a time, straight between the points of the motion.
pub fn position(trajectory: &[PathPoint], time: f64) -> Joints {
    let next = trajectory.partition_point(|p| p.time < time);
    let Some(b) = trajectory.get(next) else { return trajectory.last().map_or([0.0; 5], |p| p.joints) };
    let Some(a) = next.checked_sub(1).and_then(|i| trajectory.get(i)) else { return b.joints };
    let share = (time - a.time) / (b.time - a.time);
    std::array::from_fn(|j| a.joints[j] + share * (b.joints[j] - a.joints[j]))
}
