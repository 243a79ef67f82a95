//! Passes whose tool axis changes as joint motion: one solution of the rotary axes followed continuously.
//!
//! Between two cutter locations all joints run in proportion, as the control moves them; where that takes the cutter off
//! the straight way between both by more than `TOLERANCE` the move is halved. Near a singular position (tool along the
//! rotary axis nearest the workpiece) that axis may have to turn far within no way at all: where halving does not help the
//! piece ends, the machine leaves the part, turns in the air and goes on from there, so that the tool never spins on the part.

use nalgebra::{Point3, Unit, Vector3};
use patchmill_kinematics::{Joints, KinematicsError, Machine};
use patchmill_products::toolpath::Pass;

/// How far the cutter may be off the straight way between two cutter locations, m, measured at its contact.
const TOLERANCE: f64 = 1e-6;
/// Moves are not halved below this way of the tip, m, and this turn, rad.
const SHORTEST: f64 = 1e-6;
const SMALLEST: f64 = 1e-6;
/// Nor more often than this.
const MOST_SPLITS: u32 = 16;

/// A tool position on a pass.
#[derive(Clone, Copy, Debug)]
pub struct Station {
    /// Tool tip, m, `workpiece` frame.
    pub tip: Point3<f64>,
    /// Joint values, m and rad.
    pub joints: Joints,
}

/// A stretch of a pass without leaving the part.
pub type Piece = Vec<Station>;

/// One cutter location.
#[derive(Clone, Copy)]
struct Location {
    tip: Point3<f64>,
    contact: Point3<f64>,
    axis: Unit<Vector3<f64>>,
}

/// Why a pass cannot be followed.
#[derive(Clone, Debug, PartialEq)]
pub struct Blocked {
    /// For a person to read.
    pub reason: String,
    /// It needs more travel than the machine has.
    pub travel: bool,
}

/// The joint motion of a pass, from the rotary positions `near` (rad) on: of the solutions at its start the one with the
/// fewest pieces, of those the one that turns least.
///
/// # Errors
/// [`Blocked`] when every solution leaves the travel.
pub fn follow(machine: &Machine, pass: &Pass, near: [f64; 2]) -> Result<Vec<Piece>, Blocked> {
    let locations: Vec<Location> = (0..pass.cl.len())
        .map(|i| Location {
            tip: pass.cl[i],
            contact: pass.cc.get(i).copied().unwrap_or(pass.cl[i]),
            axis: Unit::new_normalize(pass.tool_axes.get(i).copied().unwrap_or_else(Vector3::z)),
        })
        .collect();
    let Some(first) = locations.first() else { return Ok(Vec::new()) };
    let mut best: Option<(usize, f64, Vec<Piece>)> = None;
    let mut blocked: Option<Blocked> = None;
    for start in machine.orientations(&first.axis, near).map_err(|e| refusal(&e))? {
        match (Follower { machine, pieces: Vec::new() }).along(&locations, start.rotary) {
            Ok(pieces) => {
                let turned = turn(near, &pieces);
                if best.as_ref().is_none_or(|b| (pieces.len(), turned) < (b.0, b.1)) {
                    best = Some((pieces.len(), turned, pieces));
                }
            }
            Err(why) => {
                blocked.get_or_insert(why);
            }
        }
    }
    match best {
        Some((_, _, pieces)) => Ok(pieces),
        None => Err(blocked.unwrap_or_else(|| refusal(&KinematicsError::Singular))),
    }
}

fn refusal(error: &KinematicsError) -> Blocked {
    Blocked { reason: error.to_string(), travel: matches!(error, KinematicsError::Limit(_)) }
}

/// What the rotary axes turn in all, rad.
fn turn(near: [f64; 2], pieces: &[Piece]) -> f64 {
    let mut at = near;
    let mut sum = 0.0;
    for station in pieces.iter().flatten() {
        sum += (station.joints[3] - at[0]).abs() + (station.joints[4] - at[1]).abs();
        at = [station.joints[3], station.joints[4]];
    }
    sum
}

struct Follower<'a> {
    machine: &'a Machine,
    pieces: Vec<Piece>,
}

impl Follower<'_> {
    fn along(mut self, locations: &[Location], start: [f64; 2]) -> Result<Vec<Piece>, Blocked> {
        let first = self.held(&locations[0], start)?;
        self.pieces.push(vec![first]);
        for pair in locations.windows(2) {
            self.go(&pair[0], &pair[1], MOST_SPLITS)?;
        }
        Ok(self.pieces)
    }

    /// The joints at a location with these rotary positions.
    fn held(&self, location: &Location, rotary: [f64; 2]) -> Result<Station, Blocked> {
        let fixed = self.machine.at_rotary(rotary).map_err(|e| refusal(&e))?;
        let joints = fixed.joints(&location.tip);
        match self.machine.violation(&joints) {
            Some(violation) => Err(Blocked { reason: violation.to_string(), travel: true }),
            None => Ok(Station { tip: location.tip, joints }),
        }
    }

    /// The joints at a location, rotary axes as near to `near` as can be.
    fn nearest(&self, location: &Location, near: &Joints) -> Result<Station, Blocked> {
        let found = self.machine.orientations(&location.axis, [near[3], near[4]]).map_err(|e| refusal(&e))?;
        let rotary = found.first().map(|o| o.rotary);
        self.held(location, rotary.ok_or_else(|| refusal(&KinematicsError::Singular))?)
    }

    /// From where the last piece ends, at `from`, to `to`.
    fn go(&mut self, from: &Location, to: &Location, splits: u32) -> Result<(), Blocked> {
        let Some(here) = self.pieces.last().and_then(|piece| piece.last()).copied() else { return Ok(()) };
        let there = self.nearest(to, &here.joints)?;
        let fits = |share| {
            let joints = std::array::from_fn(|j| here.joints[j] + (there.joints[j] - here.joints[j]) * share);
            off(self.machine, &joints, &between(from, to, share)) <= TOLERANCE
        };
        if fits(0.5) && fits(0.25) && fits(0.75) {
            self.push(there);
            return Ok(());
        }
        let short = (to.tip - from.tip).norm() <= SHORTEST && from.axis.angle(&to.axis) <= SMALLEST;
        if short || splits == 0 {
            // The tool would spin: leave the part here and come back with the axes turned.
            let turned = self.nearest(from, &there.joints)?;
            self.pieces.push(vec![turned, there]);
            return Ok(());
        }
        let middle = between(from, to, 0.5);
        self.go(from, &middle, splits - 1)?;
        self.go(&middle, to, splits - 1)
    }

    fn push(&mut self, station: Station) {
        if let Some(piece) = self.pieces.last_mut() {
            piece.push(station);
        }
    }
}

/// On the straight way from one location to the next.
fn between(from: &Location, to: &Location, share: f64) -> Location {
    Location {
        tip: from.tip + (to.tip - from.tip) * share,
        contact: from.contact + (to.contact - from.contact) * share,
        axis: Unit::new_normalize(
            from.axis.into_inner() + (to.axis.into_inner() - from.axis.into_inner()) * share,
        ),
    }
}

/// How much nearer or farther the contact's place lies to the cutter at these joints than at the wanted location, m: along the
/// tool axis and across it, in which the cutter is round.
fn off(machine: &Machine, joints: &Joints, wanted: &Location) -> f64 {
    let place = |tip: &Point3<f64>, axis: &Unit<Vector3<f64>>| {
        let d = wanted.contact - tip;
        let height = d.dot(axis);
        (height, (d - axis.into_inner() * height).norm())
    };
    let pose = machine.pose(joints);
    let (found, asked) = (place(&pose.tip, &pose.axis), place(&wanted.tip, &wanted.axis));
    (found.0 - asked.0).hypot(found.1 - asked.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DEFAULT_MACHINE_URDF;
    use patchmill_kinematics::Accelerations;

    fn machine() -> Machine {
        Machine::from_urdf(DEFAULT_MACHINE_URDF, 0.1, Accelerations { linear: 5.0, rotary: 20.0 }).unwrap()
    }

    /// Along x over 60 mm; the axis leans by `lean(share)` in x and `tilt` in y.
    fn pass(lean: impl Fn(f64) -> f64, tilt: f64) -> Pass {
        let at = |k: i32| {
            let share = f64::from(k) / 60.0;
            let tip = Point3::new(0.06 * share, 0.05, 0.02);
            (tip, Vector3::new(lean(share).tan(), tilt.tan(), 1.0).normalize())
        };
        let points: Vec<(Point3<f64>, Vector3<f64>)> = (0..=60).map(at).collect();
        Pass {
            cl: points.iter().map(|p| p.0).collect(),
            cc: points.iter().map(|(tip, axis)| tip - axis.cross(&Vector3::y()) * 0.013).collect(),
            tool_axes: points.iter().map(|p| p.1).collect(),
            retract_height: 0.0,
        }
    }

    /// How far the cutter is off the pass at its contact at the worst of dense positions between the motion's stations.
    fn worst(machine: &Machine, pieces: &[Piece], pass: &Pass) -> f64 {
        let location = |i: usize| Location {
            tip: pass.cl[i],
            contact: pass.cc[i],
            axis: Unit::new_normalize(pass.tool_axes[i]),
        };
        let mut worst = 0.0f64;
        for pair in pieces.iter().flat_map(|piece| piece.windows(2)) {
            // Stations lie on the pass; between two of them all joints run in proportion, and the pass with them.
            let place = |station: &Station| (station.tip.x / 0.06 * 60.0).clamp(0.0, 60.0);
            let [from, to] = [place(&pair[0]), place(&pair[1])];
            for k in 0..=10 {
                let share = f64::from(k) / 10.0;
                let joints = |j: usize| pair[0].joints[j] + (pair[1].joints[j] - pair[0].joints[j]) * share;
                let at = from + (to - from) * share;
                let i = (at as usize).min(59);
                let wanted = between(&location(i), &location(i + 1), at - i as f64);
                worst = worst.max(off(machine, &std::array::from_fn(joints), &wanted));
            }
        }
        worst
    }

    #[test]
    fn the_tool_stays_on_the_pass_between_its_locations() {
        let machine = machine();
        let pass = pass(|s| 0.2 + 0.5 * s * s, 0.15);
        let pieces = follow(&machine, &pass, [0.0; 2]).unwrap();
        assert_eq!(pieces.len(), 1);
        assert!(pieces[0].len() > pass.cl.len());
        assert!(worst(&machine, &pieces, &pass) < 1.2 * TOLERANCE, "{}", worst(&machine, &pieces, &pass));
    }

    #[test]
    fn through_the_singular_position_the_tool_never_spins_on_the_part() {
        let machine = machine();
        // Straight through the vertical: A changes its sign and C stays; beside it C swings about.
        for tilt in [0.0, 1e-7, 1e-4, 0.02] {
            let pass = pass(|s| 0.4 * (s - 0.499), tilt);
            let pieces = follow(&machine, &pass, [0.0; 2]).unwrap();
            assert!(pieces.len() <= 2, "{}", pieces.len());
            assert!(
                worst(&machine, &pieces, &pass) < 1.2 * TOLERANCE,
                "{tilt} {}",
                worst(&machine, &pieces, &pass)
            );
        }
    }

    #[test]
    fn what_lies_outside_the_travel_is_told() {
        let mut pass = pass(|_| 0.3, 0.1);
        pass.cl.iter_mut().for_each(|tip| tip.x += 2.0);
        let blocked = follow(&machine(), &pass, [0.0; 2]).unwrap_err();
        assert!(blocked.travel && blocked.reason.contains('x'), "{blocked:?}");
    }
}
