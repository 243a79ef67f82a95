//! Times the stages of one plan without DDS: `cargo run --release -p patchmill_tests --example stages -- SURFACE`
#![allow(clippy::print_stdout, missing_docs)]
use patchmill_products::job::Job;
use std::time::Instant;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args().nth(1).ok_or("usage: stages SURFACE")?;
    let begin = Instant::now();
    let planned = patchmill_tests::plan(file.as_ref(), Job::default_for(""))?;
    println!("{} triangles, {:.2} s", planned.surface.mesh.triangles.len(), begin.elapsed().as_secs_f64());
    for t in &planned.toolpaths {
        let length: f64 = t
            .patches
            .iter()
            .flat_map(|p| &p.passes)
            .flat_map(|p| p.cl.windows(2))
            .map(|w| (w[1] - w[0]).norm())
            .sum();
        let points: usize = t.patches.iter().flat_map(|p| &p.passes).map(|p| p.cl.len()).sum();
        let passes: usize = t.patches.iter().map(|p| p.passes.len()).sum();
        println!(
            "k={} length {:.1} mm, {} points, {} polylines, within {:.5}, gouge {:.2} um {}",
            t.patch_count,
            length * 1e3,
            points,
            passes,
            t.area_within_scallop,
            t.gouge_max * 1e6,
            t.infeasible_reason
        );
    }
    Ok(())
}
