//! Mesh files of any size, made by rule.

use std::fs;
use std::io;
use std::path::Path;

/// Corners of a facet, mm.
pub type Facet = [[f32; 3]; 3];

/// Writes a bowl as binary STL in mm: z = (x² + y²)/1000 over 120 × 120 mm, 2·n² triangles of 50 bytes.
///
/// # Errors
/// When the file cannot be written.
pub fn write_bowl(file: &Path, n: u32) -> io::Result<()> {
    let facets = sheet([120.0, 120.0], n, &|x, y| (x * x + y * y) / 1000.0);
    write_stl(file, &facets)
}

/// Writes the open top of [`write_block`] with a hole around the origin: without the facets whose centres are nearer than `radius`, mm.
///
/// # Errors
/// When the file cannot be written.
pub fn write_holed_top(file: &Path, n: u32, radius: f64) -> io::Result<()> {
    let mut facets = sheet([60.0, 40.0], n, &block_top);
    let centre = |facet: &Facet, k: usize| facet.iter().map(|p| f64::from(p[k])).sum::<f64>() / 3.0;
    facets.retain(|facet| centre(facet, 0).hypot(centre(facet, 1)) >= radius);
    write_stl(file, &facets)
}

/// The height of a block's top, mm.
pub fn block_top(x: f64, y: f64) -> f64 {
    25.0 + 1.5 * (x / 12.0).sin() * (y / 15.0).cos()
}

/// Writes a block of 60 × 40 mm with a free-form top as binary STL in mm: the 2·n² facets of the top first, then, if `closed`, walls and
/// a bottom at z = 0.
///
/// # Errors
/// When the file cannot be written.
pub fn write_block(file: &Path, n: u32, closed: bool) -> io::Result<()> {
    let mut facets = sheet([60.0, 40.0], n, &block_top);
    if closed {
        let at = |i: u32, size: f64| f64::from(i) / f64::from(n) * size - size / 2.0;
        let rim = (0..n)
            .map(|i| (i, 0))
            .chain((0..n).map(|j| (n, j)))
            .chain((0..n).map(|i| (n - i, n)))
            .chain((0..n).map(|j| (0, n - j)));
        let rim: Vec<[f64; 2]> = rim.map(|(i, j)| [at(i, 60.0), at(j, 40.0)]).collect();
        for (k, [x, y]) in rim.iter().enumerate() {
            let [u, v] = rim[(k + 1) % rim.len()];
            let high = [[*x, *y, block_top(*x, *y)], [u, v, block_top(u, v)]].map(|p| p.map(|c| c as f32));
            let low = [[*x, *y, 0.0], [u, v, 0.0]].map(|p| p.map(|c| c as f32));
            facets.extend([
                [low[0], low[1], high[1]],
                [low[0], high[1], high[0]],
                [[0.0; 3], low[1], low[0]],
            ]);
        }
    }
    write_stl(file, &facets)
}

/// A sheet over a rectangle around the origin, mm.
pub fn sheet(size: [f64; 2], n: u32, height: &dyn Fn(f64, f64) -> f64) -> Vec<Facet> {
    let vertex = |row: u32, column: u32| {
        let at = |i: u32, size: f64| f64::from(i) / f64::from(n) * size - size / 2.0;
        let (x, y) = (at(column, size[0]), at(row, size[1]));
        [x, y, height(x, y)].map(|v| v as f32)
    };
    let cell = |row: u32, column: u32| {
        let (a, b) = (vertex(row, column), vertex(row, column + 1));
        let (c, d) = (vertex(row + 1, column), vertex(row + 1, column + 1));
        [[a, b, c], [c, b, d]]
    };
    (0..n * n).flat_map(|k| cell(k / n, k % n)).collect()
}

fn write_stl(file: &Path, facets: &[Facet]) -> io::Result<()> {
    fs::write(file, stl(facets))
}

/// Facets as binary STL.
pub fn stl(facets: &[Facet]) -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend_from_slice(&(facets.len() as u32).to_le_bytes());
    for corners in facets {
        // No normal: the corners' order tells the side.
        bytes.extend_from_slice(&[0; 12]);
        corners.iter().flatten().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
        bytes.extend_from_slice(&[0; 2]);
    }
    bytes
}
