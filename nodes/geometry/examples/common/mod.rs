//! What the measuring examples share: a mesh from a binary STL, arguments, peak memory.

use nalgebra::{Point3, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use rayon::prelude::*;

/// What an example ends with when something is wrong: one line for standard error.
pub type Outcome<T> = Result<T, String>;

/// Most points of a run.
const MOST: usize = 100_000_000;

/// The mesh of a binary STL file in mm, corners with equal coordinates welded; normals are left as +z.
pub fn read_mesh(path: &str) -> Outcome<TriangleMesh> {
    let bytes = std::fs::read(path).map_err(|e| format!("{path} cannot be read: {e}"))?;
    let count = bytes.get(80..84).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    if count == 0 || bytes.len() != 84 + 50 * count {
        return Err(format!(
            "{path} is not a binary STL with triangles: {count} triangles need {} bytes, it has {}",
            84 + 50 * count,
            bytes.len()
        ));
    }
    let number = |at: usize| f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
    let mut corners: Vec<([f32; 3], usize)> = (0..3 * count)
        .map(|i| {
            let at = 84 + 50 * (i / 3) + 12 + 12 * (i % 3);
            // −0 becomes 0.
            ([number(at), number(at + 4), number(at + 8)].map(|c| c + 0.0), i)
        })
        .collect();
    if let Some((_, i)) = corners.iter().find(|(c, _)| !c.iter().all(|c| c.is_finite())) {
        return Err(format!("triangle {} of {path} is not finite", i / 3));
    }
    corners.par_sort_unstable_by(|a, b| a.partial_cmp(b).unwrap_or(std::cmp::Ordering::Equal));
    let mut mesh = TriangleMesh { triangles: vec![[0; 3]; count], ..Default::default() };
    for same in corners.chunk_by(|a, b| a.0 == b.0) {
        for &(_, i) in same {
            mesh.triangles[i / 3][i % 3] = mesh.vertices.len() as u32;
        }
        mesh.vertices.push(Point3::from(same[0].0.map(|c| f64::from(c) * 1e-3)));
        mesh.normals.push(Vector3::z());
    }
    Ok(mesh)
}

/// A number of points or samples.
pub fn count(name: &str, text: &str) -> Outcome<usize> {
    text.parse()
        .ok()
        .filter(|n| (1..=MOST).contains(n))
        .ok_or(format!("{name} is {text:?}, expected a whole number from 1 to {MOST}"))
}

/// A number of which `accept` approves.
pub fn number(name: &str, text: &str, expected: &str, accept: impl Fn(f64) -> bool) -> Outcome<f64> {
    text.parse()
        .ok()
        .filter(|&x: &f64| x.is_finite() && accept(x))
        .ok_or(format!("{name} is {text:?}, expected {expected}"))
}

/// `most` indices below `below`, or all of them; random, always the same.
pub fn some_of(below: usize, most: usize) -> Vec<usize> {
    if below <= most {
        return (0..below).collect();
    }
    let mut state = 1u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as usize * below) >> 31
    };
    (0..most).map(|_| next()).collect()
}

/// Peak resident memory of this process, MiB (Linux; 0 elsewhere).
pub fn peak_memory_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("VmHWM:")).unwrap_or_default();
    line.split_whitespace().nth(1).and_then(|kib| kib.parse::<f64>().ok()).map_or(0.0, |kib| kib / 1024.0)
}

/// The result line on standard output, or the error on standard error.
#[allow(clippy::print_stdout)]
pub fn finish(result: Outcome<String>) -> std::process::ExitCode {
    match result {
        Ok(line) => {
            println!("{line}");
            std::process::ExitCode::SUCCESS
        }
        Err(text) => {
            eprintln!("error: {text}");
            std::process::ExitCode::FAILURE
        }
    }
}
