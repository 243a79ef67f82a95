//! The corners of separate facets as vertices that facets share where coordinates are equal.

use std::hash::Hasher;

use nalgebra::Point3;
use rayon::prelude::*;

use crate::fast_hasher::FastHasher;
use crate::raw::RawMesh;

/// Corners are first looked up among those next to them in the file: most have their equals there, within the processor's cache …
const NEXT: usize = 3 << 13;
/// … and what is left in this many tables (a power of two).
const TABLES: u16 = 512;
const NONE: u32 = u32::MAX;

/// The facets of a file as triangles over vertices, one for all corners with the same coordinates, in order of first use.
///
/// # Panics
/// For more than 2³² / 3 facets.
pub fn share_vertices(facets: &[[Point3<f64>; 3]]) -> RawMesh {
    let corners = facets.as_flattened();
    assert!(corners.len() < NONE as usize, "corners are counted in 32 bits");
    let mut first = vec![0; corners.len()];
    first.par_chunks_mut(NEXT).enumerate().for_each_init(Vec::new, |slots, (chunk, first)| {
        let start = (chunk * NEXT) as u32;
        let members = start..start + first.len() as u32;
        find_first(members, corners, slots, |corner, same| first[(corner - start) as usize] = same);
    });
    let left: Vec<u32> = (0..corners.len() as u32)
        .into_par_iter()
        .filter(|corner| first[*corner as usize] == *corner)
        .collect();
    let found: Vec<Vec<(u32, u32)>> = by_table(&left, corners)
        .into_par_iter()
        .map_init(Vec::new, |slots, members| {
            let mut found = Vec::new();
            find_first(members.iter().copied(), corners, slots, |corner, same| {
                if same != corner {
                    found.push((corner, same));
                }
            });
            found
        })
        .collect();
    found.into_iter().flatten().for_each(|(corner, same)| first[corner as usize] = same);
    // From here on the number of the vertex stands in the place of an earlier corner that has it.
    let mut numbers = first;
    let mut vertices = Vec::with_capacity(facets.len() / 2 + 3);
    for corner in 0..corners.len() {
        let same = numbers[corner] as usize;
        numbers[corner] = if same == corner {
            vertices.push(corners[corner]);
            (vertices.len() - 1) as u32
        } else {
            numbers[same]
        };
    }
    RawMesh { vertices, triangles: numbers.as_chunks().0.to_vec() }
}

/// + 0.0 turns −0 into 0.
fn bits(p: &Point3<f64>) -> [u64; 3] {
    [p.x + 0.0, p.y + 0.0, p.z + 0.0].map(f64::to_bits)
}

fn hash(bits: [u64; 3]) -> u64 {
    let mut hasher = FastHasher::default();
    bits.into_iter().for_each(|word| hasher.write_u64(word));
    hasher.finish()
}

/// `members` of every table, in order.
fn by_table(members: &[u32], corners: &[Point3<f64>]) -> Vec<Vec<u32>> {
    let table = |corner: &u32| (hash(bits(&corners[*corner as usize])) >> 40) as u16 % TABLES;
    let of_member: Vec<u16> = members.par_iter().map(table).collect();
    let mut tables: Vec<Vec<u32>> = vec![Vec::new(); TABLES as usize];
    members.iter().zip(&of_member).for_each(|(corner, table)| tables[*table as usize].push(*corner));
    tables
}

/// Calls `found` with each of `members`, in order, and the first of them that has the same coordinates.
fn find_first(
    members: impl ExactSizeIterator<Item = u32>,
    corners: &[Point3<f64>],
    slots: &mut Vec<u32>,
    mut found: impl FnMut(u32, u32),
) {
    let size = (2 * members.len()).next_power_of_two();
    slots.clear();
    slots.resize(size, NONE);
    for corner in members {
        let place = bits(&corners[corner as usize]);
        let mut slot = hash(place) as usize & (size - 1);
        // Half of the slots at least are free, so this ends.
        while slots[slot] != NONE && bits(&corners[slots[slot] as usize]) != place {
            slot = (slot + 1) & (size - 1);
        }
        if slots[slot] == NONE {
            slots[slot] = corner;
        }
        found(corner, slots[slot]);
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn equal_corners_far_apart_in_the_file_become_one_vertex() {
        let facet = |i: usize| [i, i + 1, i + 2].map(|x| Point3::new((x % 20_000) as f64, 0.0, 0.0));
        let facets: Vec<_> = (0..50_000).map(facet).collect();
        let mesh = share_vertices(&facets);
        assert_eq!(mesh.vertices.len(), 20_000);
        for (facet, triangle) in facets.iter().zip(&mesh.triangles) {
            assert_eq!(*facet, triangle.map(|v| mesh.vertices[v as usize]));
        }
    }

    proptest! {
        #[test]
        fn equal_corners_become_one_vertex_in_order_of_first_use(
            facets in prop::collection::vec(prop::array::uniform3(prop::array::uniform3(-2i8..2)), 0..60),
        ) {
            let facets: Vec<_> = facets.iter().map(|f| f.map(|p| Point3::from(p.map(|x| f64::from(x) * -0.5)))).collect();
            let mesh = share_vertices(&facets);
            let mut expected = RawMesh::default();
            for facet in &facets {
                let corners = facet.map(|p| {
                    let known = expected.vertices.iter().position(|q| *q == p);
                    known.unwrap_or_else(|| {
                        expected.vertices.push(p);
                        expected.vertices.len() - 1
                    }) as u32
                });
                expected.triangles.push(corners);
            }
            prop_assert_eq!(mesh, expected);
        }
    }
}
