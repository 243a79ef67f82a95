//! Time of a program as read from its text: runs of feed or of rapid moves, standstill between them.

use crate::gcode::ReadBlock;
use nalgebra::Point3;
use patchmill_kinematics::{
    Accelerations, Control, Joints, LookAhead, Machine, PathPoint, Run, feed_run, rapid_run,
};
use patchmill_products::job::{self, Job};

/// How machine and control move: what the URDF does not say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dynamics {
    /// Of the axes, m/s² and rad/s².
    pub accelerations: Accelerations,
    /// The control.
    pub control: Control,
}

impl Dynamics {
    /// Those of a job.
    pub fn of(job: &Job) -> Self {
        Self {
            accelerations: Accelerations { linear: job.acceleration_linear, rotary: job.acceleration_rotary },
            control: Control {
                corner_tolerance: job.corner_tolerance(),
                jerk_linear: job.jerk_linear,
                jerk_rotary: job.jerk_rotary,
                block_time: job.block_time,
                look_ahead: look_ahead(job.look_ahead),
            },
        }
    }
}

/// A job's look-ahead as the time model has it.
pub fn look_ahead(asked: job::LookAhead) -> LookAhead {
    match asked {
        job::LookAhead::AllAxes => LookAhead::AllAxes,
        job::LookAhead::LinearAxes => LookAhead::LinearAxes,
    }
}

/// A program on the machine's clock. Time 0 is the first position in which every axis is given.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ProgramTiming {
    /// Machining time, s.
    pub duration: f64,
    /// When each block of the program ends, s.
    pub block_ends: Vec<f64>,
    /// Way of the tool tip in each block, m.
    pub block_lengths: Vec<f64>,
    /// Length cut at feed, m.
    pub cut_length: f64,
    /// Way of the tool tip in rapid moves, m.
    pub rapid_length: f64,
    /// Moves that change the tool orientation.
    pub index_moves: u32,
    /// Joint positions and speeds over time.
    pub trajectory: Vec<PathPoint>,
}

/// Times a program on a control.
pub fn time_program(blocks: &[ReadBlock], machine: &Machine, control: &Control) -> ProgramTiming {
    let limits = machine.limits(control);
    let tips: Vec<Point3<f64>> = blocks.iter().map(|b| machine.pose(&b.joints).tip).collect();
    let mut timing = ProgramTiming {
        block_ends: vec![0.0; blocks.len()],
        block_lengths: vec![0.0; blocks.len()],
        ..Default::default()
    };
    for i in 1..blocks.len() {
        let way = (tips[i] - tips[i - 1]).norm();
        timing.block_lengths[i] = way;
        *(if blocks[i].rapid { &mut timing.rapid_length } else { &mut timing.cut_length }) += way;
        let turned = blocks[i].joints[3..] != blocks[i - 1].joints[3..];
        timing.index_moves += u32::from(turned && blocks[i].rapid);
    }
    let mut first = 1;
    while first < blocks.len() {
        let rapid = blocks[first].rapid;
        let end = (first..blocks.len()).find(|&i| blocks[i].rapid != rapid).unwrap_or(blocks.len());
        let points: Vec<Joints> = blocks[first - 1..end].iter().map(|b| b.joints).collect();
        let run: Run = if rapid {
            rapid_run(&points, &limits)
        } else {
            let feeds: Vec<f64> = blocks[first..end].iter().map(|b| b.feed).collect();
            feed_run(&points, &timing.block_lengths[first..end], &feeds)
        };
        let run = run.time(&limits);
        for (end, arrival) in timing.block_ends[first..end].iter_mut().zip(&run.arrivals[1..]) {
            *end = timing.duration + arrival;
        }
        // A run begins where the one before it ended: the shared position appears once.
        let skip = usize::from(!timing.trajectory.is_empty());
        let start = timing.duration;
        timing
            .trajectory
            .extend(run.trajectory.iter().skip(skip).map(|p| PathPoint { time: start + p.time, ..*p }));
        timing.duration += run.duration;
        first = end;
    }
    timing
}
