//! Points sorted into cubes, for finding the points near a place.

use nalgebra::Point3;
use rayon::prelude::*;

/// Bits of a cube's number along an axis.
const BITS: u32 = 21;
const LAST: i64 = (1 << BITS) - 1;

/// An index over points: they lie sorted by cube, and within one by their number.
pub struct Grid {
    size: f64,
    middle: Point3<f64>,
    /// The points and their numbers, in the order of the cubes.
    points: Vec<(Point3<f64>, u32)>,
    /// The cubes that have points: key and first place in `points`; a last one ends the list.
    cubes: Vec<(u64, u32)>,
}

impl Grid {
    /// An index of `points` in cubes of side `size` (m, > 0).
    pub fn new(points: &[Point3<f64>], size: f64) -> Self {
        let middle = middle(points);
        let mut keyed: Vec<(u64, u32)> =
            points.par_iter().enumerate().map(|(i, p)| (key(cube(p, &middle, size)), i as u32)).collect();
        keyed.par_sort_unstable();
        let mut cubes: Vec<(u64, u32)> = Vec::new();
        for (place, (key, _)) in keyed.iter().enumerate() {
            if cubes.last().is_none_or(|(last, _)| last != key) {
                cubes.push((*key, place as u32));
            }
        }
        cubes.push((u64::MAX, keyed.len() as u32));
        let points = keyed.into_iter().map(|(_, i)| (points[i as usize], i)).collect();
        Self { size, middle, points, cubes }
    }

    /// The points of every cube that has any, each with its number.
    pub fn cubes(&self) -> impl Iterator<Item = &[(Point3<f64>, u32)]> {
        self.cubes.windows(2).map(|pair| &self.points[pair[0].1 as usize..pair[1].1 as usize])
    }

    /// Whether there is a point within `radius` (m) of `place`.
    pub fn has_near(&self, place: &Point3<f64>, radius: f64) -> bool {
        let mut has = false;
        self.near(place, radius, |_, _| has = true);
        has
    }

    /// Calls `found` with the points within `radius` of `place` and their numbers, in an order that depends on the points only.
    pub fn near(&self, place: &Point3<f64>, radius: f64, mut found: impl FnMut(&Point3<f64>, u32)) {
        let low = cube(&place.map(|x| x - radius), &self.middle, self.size);
        let high = cube(&place.map(|x| x + radius), &self.middle, self.size);
        for x in low[0]..=high[0] {
            for y in low[1]..=high[1] {
                // Cubes above one another are neighbours in the list.
                let (first, last) = (key([x, y, low[2]]), key([x, y, high[2]]));
                let from = self.cubes.partition_point(|(key, _)| *key < first);
                let to = from + self.cubes[from..].partition_point(|(key, _)| *key <= last);
                // The cube that ends the list has the largest of all keys, so `to` is in the list.
                for (point, number) in &self.points[self.cubes[from].1 as usize..self.cubes[to].1 as usize] {
                    if (point - place).norm_squared() <= radius * radius {
                        found(point, *number);
                    }
                }
            }
        }
    }
}

/// The median of each coordinate: far outliers must not push all other points into the last cube.
fn middle(points: &[Point3<f64>]) -> Point3<f64> {
    Point3::from([0, 1, 2].map(|k| {
        let mut all: Vec<f64> = points.iter().map(|p| p[k]).collect();
        let half = all.len() / 2;
        if all.is_empty() { 0.0 } else { *all.select_nth_unstable_by(half, f64::total_cmp).1 }
    }))
}

fn cube(point: &Point3<f64>, middle: &Point3<f64>, size: f64) -> [i64; 3] {
    [0, 1, 2].map(|k| {
        (((point[k] - middle[k]) / size).floor() as i64).saturating_add(1 << (BITS - 1)).clamp(0, LAST)
    })
}

fn key(cube: [i64; 3]) -> u64 {
    cube.iter().fold(0, |key, x| key << BITS | *x as u64)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn the_points_near_a_place_are_those_within_the_radius(
            points in prop::collection::vec(prop::array::uniform3(-1f64..1.0), 1..200),
            place in prop::array::uniform3(-1.2f64..1.2),
            radius in 0.01f64..1.0,
            size in prop::sample::select(vec![1e-9, 0.05, 0.3, 10.0]),
        ) {
            prop_assume!(radius < 1000.0 * size || size > 1e-3 || radius < 0.02);
            let points: Vec<_> = points.into_iter().map(Point3::from).collect();
            let place = Point3::from(place);
            let size = if size < 1e-3 { radius / 3.0 } else { size };
            let mut found = Vec::new();
            Grid::new(&points, size).near(&place, radius, |_, i| found.push(i as usize));
            found.sort_unstable();
            let expected: Vec<usize> =
                (0..points.len()).filter(|i| (points[*i] - place).norm_squared() <= radius * radius).collect();
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn far_points_do_not_fill_one_cube() {
        let mut points: Vec<_> = (0..1000).map(|i| Point3::new(f64::from(i), 0.0, 0.0)).collect();
        points.push(Point3::new(-1e12, 0.0, 0.0));
        assert_eq!(Grid::new(&points, 1.0).cubes().count(), 1001);
    }
}
