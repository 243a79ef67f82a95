//! Time and memory of reading a mesh or a point cloud: `load FILE [--surface]` prints one line of JSON. Seconds are those of parsing
//! and welding, with `--surface` of all up to the mesh and the samples; reading the file itself is not counted.

use std::path::Path;
use std::time::Instant;

use patchmill_products::stage::{StageError, unobserved};
use patchmill_surface_ingestion::raw::Raw;
use patchmill_surface_ingestion::{IngestionParams, ingest, read_raw, read_source, weld};

fn main() -> Result<(), StageError> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, options @ ..] = arguments.as_slice() else {
        return Err(StageError::new(1, "usage: load FILE [--surface]"));
    };
    let file = Path::new(path);
    let directory = file.parent().filter(|d| !d.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let name = file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let source = read_source(directory, &name, "mm")?;
    let params = IngestionParams::default();
    let (start, cpu_start) = (Instant::now(), cpu_seconds());
    let (triangles, points, text) = if options.iter().any(|o| o == "--surface") {
        let surface = ingest(&source, &params, unobserved())?;
        let text = surface.cloud.map_or_else(String::new, |cloud| cloud.to_string());
        (surface.mesh.triangles.len(), surface.mesh.vertices.len(), text)
    } else {
        match read_raw(&source, &params)? {
            Raw::Mesh(mesh) => {
                let welded = weld::weld(&mesh);
                (welded.triangles.len(), welded.vertices.len(), String::new())
            }
            Raw::Cloud(cloud) => (0, cloud.points.len(), String::new()),
        }
    };
    let seconds = start.elapsed().as_secs_f64();
    let cpu = cpu_seconds().zip(cpu_start).map(|(end, start)| end - start);
    #[allow(clippy::print_stdout)]
    {
        println!(
            "{}",
            serde_json::json!({
                "file": path, "triangles": triangles, "points": points, "seconds": seconds, "cpu_seconds": cpu,
                "peak_memory_mb": peak_memory_mb(), "cloud": text,
            })
        );
    }
    Ok(())
}

/// Of all threads, in steps of 0.01 s; Linux only.
fn cpu_seconds() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = stat.rsplit(") ").next()?.split(' ').skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / 100.0)
}

/// Of the whole process, the file's bytes among it; Linux only.
fn peak_memory_mb() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<f64>().ok().map(|kb| kb / 1024.0)
}
