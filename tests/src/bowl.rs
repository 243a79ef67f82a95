//! A mesh file of any size, made by rule.

use std::fs;
use std::io;
use std::path::Path;

/// Writes a bowl as binary STL in mm: z = (x² + y²)/1000 over 120 × 120 mm, 2·n² triangles of 50 bytes.
///
/// # Errors
/// When the file cannot be written.
pub fn write_bowl(file: &Path, n: u32) -> io::Result<()> {
    let vertex = |row: u32, column: u32| {
        let at = |i: u32| f64::from(i) / f64::from(n) * 120.0 - 60.0;
        let (x, y) = (at(column), at(row));
        [x, y, (x * x + y * y) / 1000.0].map(|v| v as f32)
    };
    let mut bytes = vec![0; 80];
    bytes.extend_from_slice(&(2 * n * n).to_le_bytes());
    let mut triangle = |corners: [[f32; 3]; 3]| {
        // No normal: the corners' order tells the side.
        bytes.extend_from_slice(&[0; 12]);
        corners.iter().flatten().for_each(|v| bytes.extend_from_slice(&v.to_le_bytes()));
        bytes.extend_from_slice(&[0; 2]);
    };
    for row in 0..n {
        for column in 0..n {
            let (a, b) = (vertex(row, column), vertex(row, column + 1));
            let (c, d) = (vertex(row + 1, column), vertex(row + 1, column + 1));
            triangle([a, b, c]);
            triangle([c, b, d]);
        }
    }
    fs::write(file, bytes)
}
