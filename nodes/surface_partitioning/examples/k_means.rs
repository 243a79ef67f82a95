//! k-means of 1 to 8 clusters on a file of features:
//! `cargo run --release -p patchmill_surface_partitioning --example k_means -- FEATURES.f64`.
//!
//! The file holds little-endian f64, four to a sample, z-scored. Prints one JSON line; `tests/peers/bench.py` holds it beside
//! scikit-learn.

use std::time::Instant;

use nalgebra::Vector4;
use patchmill_surface_partitioning::{PartitionParams, k_means};

#[allow(clippy::print_stdout)]
fn main() -> std::process::ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match run(&arguments) {
        Ok(line) => {
            println!("{line}");
            std::process::ExitCode::SUCCESS
        }
        Err(e) => {
            eprintln!("{e}");
            std::process::ExitCode::FAILURE
        }
    }
}

fn run(arguments: &[String]) -> Result<String, Box<dyn std::error::Error>> {
    let [path] = arguments else { return Err("usage: k_means FEATURES.f64".into()) };
    let bytes = std::fs::read(path).map_err(|e| format!("{path}: {e}"))?;
    if bytes.is_empty() || bytes.len() % 32 != 0 {
        return Err(format!(
            "{path} has {} bytes, expected a multiple of 32: four f64 a sample",
            bytes.len()
        )
        .into());
    }
    let numbers: Vec<f64> =
        bytes.chunks_exact(8).map(|b| f64::from_le_bytes(std::array::from_fn(|i| b[i]))).collect();
    let points: Vec<Vector4<f64>> = numbers.chunks_exact(4).map(Vector4::from_column_slice).collect();
    if !numbers.iter().all(|x| x.is_finite()) {
        return Err(format!("{path} holds a number that is not finite").into());
    }
    let start = Instant::now();
    let inertias: Vec<f64> = (1..=8)
        .map(|k| k_means::cluster(&points, k, &PartitionParams::default()).map(|found| found.inertia))
        .collect::<Result<_, _>>()?;
    Ok(format!(
        "{{\"samples\":{},\"seconds\":{:.4},\"threads\":{},\"inertia\":{inertias:?}}}",
        points.len(),
        start.elapsed().as_secs_f64(),
        rayon::current_num_threads()
    ))
}
