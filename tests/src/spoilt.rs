//! Meshes as broken exports have them: a good one, spoilt in one way after the other.

use crate::bowl::{Facet, sheet};

/// One way of spoiling. Facets are told by a number of any size, lengths are in mm.
#[derive(Clone, Copy, Debug)]
pub enum Spoil {
    /// Every so many facets are there twice.
    Duplicate(usize),
    /// Every so many facets are inside out.
    Flip(usize),
    /// A facet's second corner is its first.
    Collapse(usize),
    /// A facet's third corner lies so far from the middle of the others: a needle.
    Needle(usize, f32),
    /// A facet is missing.
    Delete(usize),
    /// Written in another unit.
    Scale(f32),
    /// Far from the origin.
    Shift([f32; 3]),
    /// What lies beyond this x is folded back over by so many degrees about it.
    Fold(f32, f32),
    /// Edges of two facets are split on one side only, the new corner so far above the edge.
    TJunction(usize, f32),
    /// A wall of no thickness of this height stands on the facet's first edge.
    Fin(usize, f32),
    /// The same surface again, so much higher.
    Shell(f32),
    /// A corner has no number.
    NotFinite(usize, f32),
    /// Only one facet.
    Only(usize),
    /// Every corner of every facet is off by as much as this, and its neighbours' copies by something else: cracks.
    Cracks(f32),
    /// A vertex is drawn out along z: a spike.
    Spike(usize, f32),
    /// Upside down.
    Mirror,
    /// A bottom and walls so far below: a closed solid.
    Solid(f32),
    /// Facets in the order of their numbers times a large one.
    Shuffle,
}

/// A gently waved sheet of 24 × 16 mm, z from −1 to 1, 2·n² facets.
pub fn good(n: u32) -> Vec<Facet> {
    sheet([24.0, 16.0], n, &|x, y| (x / 9.0).sin() * (y / 12.0).cos())
}

/// Spoils the facets; what cannot be done to the ones that are left is left out.
pub fn spoil(facets: &mut Vec<Facet>, how: Spoil) {
    if facets.is_empty() {
        return;
    }
    let count = facets.len();
    match how {
        Spoil::Duplicate(every) => {
            let again: Vec<Facet> = facets.iter().step_by(every % 7 + 1).copied().collect();
            facets.extend(again);
        }
        Spoil::Flip(every) => facets.iter_mut().step_by(every % 7 + 1).for_each(|facet| facet.swap(1, 2)),
        Spoil::Collapse(i) => facets[i % count][1] = facets[i % count][0],
        Spoil::Needle(i, width) => {
            let [a, b, c] = &mut facets[i % count];
            *c = [0, 1, 2].map(|k| (a[k] + b[k]) / 2.0);
            c[1] += width;
        }
        Spoil::Delete(i) => {
            facets.swap_remove(i % count);
        }
        Spoil::Scale(factor) => each(facets, |p| p.iter_mut().for_each(|x| *x *= factor)),
        Spoil::Shift(by) => each(facets, |p| p.iter_mut().zip(by).for_each(|(x, by)| *x += by)),
        Spoil::Fold(from, degrees) => fold(facets, from, degrees),
        Spoil::TJunction(i, height) => {
            let [a, b, c] = facets[i % count];
            let mut middle = [0, 1, 2].map(|k| (a[k] + b[k]) / 2.0);
            middle[2] += height;
            facets[i % count] = [a, middle, c];
            facets.push([middle, b, c]);
        }
        Spoil::Fin(i, height) => {
            let [a, b, _] = facets[i % count];
            let high = |p: [f32; 3]| [p[0], p[1], p[2] + height];
            facets.extend([[a, b, high(b)], [a, high(b), high(a)]]);
        }
        Spoil::Shell(height) => {
            let mut other = facets.clone();
            each(&mut other, |p| p[2] += height);
            facets.extend(other);
        }
        Spoil::NotFinite(i, value) => facets[i % count][i % 3][i % 2] = value,
        Spoil::Only(i) => *facets = vec![facets[i % count]],
        Spoil::Cracks(size) => {
            let mut seed = 1u32;
            each(facets, |p| {
                for x in p {
                    seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    *x += size * (seed as f32 / u32::MAX as f32 - 0.5);
                }
            });
        }
        Spoil::Spike(i, height) => {
            let at = facets[i % count][i % 3];
            each(facets, |p| p[2] += if *p == at { height } else { 0.0 });
        }
        Spoil::Mirror => each(facets, |p| p[2] = -p[2]),
        Spoil::Solid(depth) => solid(facets, depth),
        Spoil::Shuffle => {
            let given = facets.clone();
            (0..count).for_each(|i| facets[i] = given[(i * 7919 + 13) % count]);
        }
    }
}

fn each(facets: &mut [Facet], mut change: impl FnMut(&mut [f32; 3])) {
    facets.iter_mut().flatten().for_each(&mut change);
}

fn fold(facets: &mut [Facet], from: f32, degrees: f32) {
    let (sine, cosine) = degrees.to_radians().sin_cos();
    each(facets, |p| {
        if p[0] > from {
            let out = p[0] - from;
            (p[0], p[2]) = (from + out * cosine, p[2] + out * sine);
        }
    });
}

/// The same facets below, upside down; walls where an edge has one facet.
fn solid(facets: &mut Vec<Facet>, depth: f32) {
    let low = |p: [f32; 3]| [p[0], p[1], p[2] - depth];
    let top = facets.clone();
    let edges = || top.iter().flat_map(|f| (0..3).map(|k| (f[k], f[(k + 1) % 3])));
    let all: Vec<_> = edges().collect();
    for (a, b) in edges().filter(|(a, b)| !all.contains(&(*b, *a))) {
        facets.extend([[a, low(a), b], [b, low(a), low(b)]]);
    }
    facets.extend(top.iter().map(|[a, b, c]| [low(*a), low(*c), low(*b)]));
}
