//! What must not collide while a program runs: the machine's links with each other, with the tool and with the part.

use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_kinematics::Joints;
use rayon::prelude::*;

use crate::gcode::ReadBlock;
use crate::machine_collision::{MARGIN, MachineBodies};

/// Lever of the rotary axes from which the distance between looked-at positions follows, m.
const LEVER: f64 = 0.5;
/// Positions that are looked at one after another.
const STRETCH: usize = 512;

/// The machine's bodies around a part.
#[derive(Clone, Debug)]
pub struct Surroundings<'a> {
    /// The machine's collision shapes.
    pub bodies: MachineBodies,
    /// The part's surface.
    pub mesh: &'a TriangleMesh,
    /// Its hierarchy.
    pub bvh: Bvh,
}

impl<'a> Surroundings<'a> {
    /// Puts the part among the bodies.
    pub fn new(bodies: MachineBodies, mesh: &'a TriangleMesh) -> Self {
        Self { bodies, mesh, bvh: Bvh::build(mesh) }
    }

    /// Which links touch at a position; `None` when all are clear.
    pub fn touch_at(&self, q: &Joints) -> Option<String> {
        self.closer_at(q, MARGIN)
    }

    /// Whether no link touches on a rapid that moves all axes in proportion.
    pub fn clears(&self, from: &Joints, to: &Joints) -> bool {
        let on_the_way = || between(from, to).map(|q| (0, q)).collect::<Vec<_>>();
        self.bodies.is_empty() || self.first_touch(&on_the_way()).is_none()
    }

    /// The first line of a program on which links touch, and which; `None` when there is none. No link is ever farther than
    /// the bodies' margin from a position that is looked at.
    pub fn touch(&self, blocks: &[ReadBlock]) -> Option<String> {
        if self.bodies.is_empty() {
            return None;
        }
        let positions = positions(blocks);
        let (line, who) = positions.par_chunks(STRETCH).find_map_first(|part| self.first_touch(part))?;
        Some(format!("the machine would collide in line {line} of its program: {who}"))
    }

    /// The first of the positions at which links touch. A stretch whose middle is clear by as much as anything moves to its ends
    /// is clear as a whole.
    fn first_touch(&self, positions: &[(usize, Joints)]) -> Option<(usize, String)> {
        let middle = positions.len() / 2;
        let (line, q) = positions.get(middle)?;
        let length = |part: &[(usize, Joints)]| part.windows(2).map(|w| way(&w[0].1, &w[1].1)).sum::<f64>();
        let reach = length(&positions[..=middle]).max(length(&positions[middle..]));
        match self.closer_at(q, MARGIN + reach) {
            None => None,
            Some(who) if positions.len() == 1 => Some((*line, who)),
            Some(_) => {
                let (before, after) = positions.split_at(middle);
                self.first_touch(before).or_else(|| self.first_touch(after))
            }
        }
    }

    /// Which links come closer than `margin`, m.
    fn closer_at(&self, q: &Joints, margin: f64) -> Option<String> {
        self.bodies.touch_at(q, self.mesh, &self.bvh, margin)
    }
}

/// A bound of how far anything of the machine moves between two positions, m.
fn way(from: &Joints, to: &Joints) -> f64 {
    (0..5).map(|j| (to[j] - from[j]).abs() * if j < 3 { 1.0 } else { LEVER }).sum()
}

/// Positions after `from` up to `to`, at most the margin apart.
fn between(from: &Joints, to: &Joints) -> impl Iterator<Item = Joints> {
    let (from, to) = (*from, *to);
    let steps = (way(&from, &to) / MARGIN).ceil().max(1.0) as usize;
    let at = move |k: usize| -> Joints {
        std::array::from_fn(|j| from[j] + (to[j] - from[j]) * (k as f64 / steps as f64))
    };
    (1..=steps).map(at)
}

/// Positions along a program with their lines. Short moves are put together as long as they stay near one position.
fn positions(blocks: &[ReadBlock]) -> Vec<(usize, Joints)> {
    let Some(first) = blocks.first() else { return Vec::new() };
    let mut found = vec![(first.line, first.joints)];
    for (i, block) in blocks.iter().enumerate().skip(1) {
        let from = found[found.len() - 1].1;
        let next_is_near = blocks.get(i + 1).is_some_and(|next| way(&from, &next.joints) <= MARGIN);
        if way(&from, &block.joints) > MARGIN || !next_is_near {
            found.extend(between(&from, &block.joints).map(|q| (block.line, q)));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_point_of_a_program_is_farther_than_the_margin_from_a_position() {
        let at = |i: usize| {
            let t = i as f64;
            [0.3e-3 * t, 0.4e-3 * (t * 0.3).sin(), if i.is_multiple_of(40) { 0.03 } else { 0.0 }, 0.0, 0.0]
        };
        let block = |i: usize| ReadBlock { line: i, rapid: false, joints: at(i), feed: 1.0 };
        let blocks: Vec<ReadBlock> = (0..200).map(block).collect();
        let found = positions(&blocks);
        assert!(found.len() < 700 && found.windows(2).all(|w| w[0].0 <= w[1].0));
        for pair in blocks.windows(2) {
            for k in 0..=10 {
                let q = std::array::from_fn(|j| {
                    pair[0].joints[j] + (pair[1].joints[j] - pair[0].joints[j]) * f64::from(k) / 10.0
                });
                let nearest = found.iter().map(|(_, p)| way(p, &q)).fold(f64::INFINITY, f64::min);
                assert!(nearest <= MARGIN + 1e-12, "{nearest}");
            }
        }
        assert!(positions(&[]).is_empty());
    }
}
