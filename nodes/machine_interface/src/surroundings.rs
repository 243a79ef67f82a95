//! What must not collide while a program runs: the machine's links with each other, with the tool and with the part.

use patchmill_geometry::bvh::Bvh;
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_kinematics::Joints;
use rayon::prelude::*;

use crate::gcode::ReadBlock;
use crate::machine_collision::{MARGIN, MachineBodies};

/// Lever of the rotary axes from which the distance between looked-at positions follows, m.
const LEVER: f64 = 0.5;

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
        self.bodies.touch_at(q, self.mesh, &self.bvh)
    }

    /// Whether no link touches on a rapid that moves all axes in proportion.
    pub fn clears(&self, from: &Joints, to: &Joints) -> bool {
        self.bodies.is_empty() || between(from, to).all(|q| self.touch_at(&q).is_none())
    }

    /// The first line of a program on which links touch, and which; `None` when there is none. No link is ever farther than
    /// the bodies' margin from a position that is looked at.
    pub fn touch(&self, blocks: &[ReadBlock]) -> Option<String> {
        if self.bodies.is_empty() {
            return None;
        }
        let touch = |(line, q): (usize, Joints)| Some((line, self.touch_at(&q)?));
        let (line, who) = positions(blocks).into_par_iter().find_map_first(touch)?;
        Some(format!("the machine would collide in line {line} of its program: {who}"))
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
