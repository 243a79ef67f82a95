//! Meshes of 1, 10 and 50 MB as manifest and chunks from this process to others: to a reader that is there and to one that comes late.

use std::ffi::OsStr;
use std::process::{Command, Stdio};

use nalgebra::{Point3, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_node_runtime::{Node, ProductReceiver, ProductServer, Received, block_on, free_domain, status};
use patchmill_products::wire::{Chunked, Provenance};
use serde_json::{Value, json};

use crate::{Outcome, PATIENCE, clock, options, peer, ros_python, spread};

/// Vertices of a side for so many megabytes: 72 bytes a vertex, its two triangles included.
const SIDES: [(u32, u32); 3] = [(1, 118), (10, 373), (50, 834)];

/// A grid of n × n vertices.
fn grid(n: u32) -> TriangleMesh {
    let vertices =
        (0..n * n).map(|i| Point3::new(f64::from(i % n), f64::from(i / n), f64::from(i % 7))).collect();
    let corner = |row: u32, column: u32| row * n + column;
    let cell = |row: u32, column: u32| {
        let (a, b) = (corner(row, column), corner(row, column + 1));
        let (c, d) = (corner(row + 1, column), corner(row + 1, column + 1));
        [[a, b, c], [c, b, d]]
    };
    let triangles = (0..n - 1).flat_map(|row| (0..n - 1).flat_map(move |column| cell(row, column))).collect();
    TriangleMesh {
        vertices,
        normals: vec![Vector3::z(); (n * n) as usize],
        triangles,
        chord_error: 1e-6,
        check_only: Vec::new(),
    }
}

/// The other process in Rust: prints what it got as one line of JSON.
pub fn receive(domain: u16) -> Outcome<()> {
    let began = clock();
    let got = block_on(async {
        let node = Node::start(options("reader", domain)?)?;
        let mut meshes = ProductReceiver::<TriangleMesh>::new(&node)?;
        let got = match meshes.next().await {
            Some(Received::Product { manifest, product, .. }) => {
                let end = clock();
                json!({"began": began, "end": end, "whole": product.content_hash() == manifest.content_hash,
                    "chunks": manifest.chunk_count})
            }
            Some(Received::Failed { text, .. }) => json!({"whole": false, "text": text}),
            None => json!({"whole": false}),
        };
        node.shutdown().await;
        Outcome::Ok(got)
    })??;
    println!("{got}");
    Ok(())
}

/// A command, after the words of PATCHMILL_READER_PREFIX.
fn elsewhere(program: &OsStr) -> Command {
    let prefix = std::env::var("PATCHMILL_READER_PREFIX").unwrap_or_default();
    let mut words = prefix.split_whitespace();
    match words.next() {
        None => Command::new(program),
        Some(first) => {
            let mut command = Command::new(first);
            command.args(words).arg(program);
            command
        }
    }
}

/// One reader in its own process.
struct Reader {
    name: &'static str,
    command: fn(u16) -> Option<Command>,
}

const READERS: [Reader; 2] = [
    Reader {
        name: "Rust",
        command: |domain| {
            let mut command = elsewhere(std::env::current_exe().ok()?.as_os_str());
            command.args(["receive", &domain.to_string()]);
            Some(command)
        },
    },
    Reader {
        name: "rclpy",
        command: |domain| {
            let mut command = elsewhere(ros_python()?.as_ref());
            command.arg(peer("large_products.py")).env("ROS_DOMAIN_ID", domain.to_string());
            if std::env::var_os("ROS_AUTOMATIC_DISCOVERY_RANGE").is_none() {
                command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
            }
            Some(command)
        },
    },
];

/// One transfer: to a reader that is there, then to one that comes late. What each got, and when the first was sent.
async fn transfer(mesh: &TriangleMesh, reader: &Reader) -> Outcome<(f64, Value, Value)> {
    let lease = free_domain()?;
    let node = Node::start(options("sender", lease.domain())?)?;
    let server = ProductServer::<TriangleMesh>::new(&node)?;
    let (manifest, chunks) =
        mesh.split(&Provenance::of_surface(status::now(), "grid")).map_err(|e| e.text)?;
    let spawn = || {
        let mut command = (reader.command)(lease.domain()).ok_or("no such reader")?;
        let child = command.stdout(Stdio::piped()).spawn()?;
        Ok::<_, Box<dyn std::error::Error>>(tokio::task::spawn_blocking(move || child.wait_with_output()))
    };
    let there = spawn()?;
    if !server.wait_for_receivers(1, PATIENCE).await {
        return Err("the reader did not come".into());
    }
    let sent = clock();
    let count = chunks.len();
    let published = server.publish_parts(manifest, chunks).await;
    if published < count {
        eprintln!("{published} of {count} chunks were published: the reader stopped acknowledging");
    }
    let there = serde_json::from_slice(&there.await??.stdout)?;
    let late = serde_json::from_slice(&spawn()?.await??.stdout)?;
    node.shutdown().await;
    Ok((sent, there, late))
}

/// Prints the table; a mesh that came wrong or not at all is an error.
pub fn measure(runs: usize) -> Outcome<()> {
    println!("Meshes as chunked products, {runs} runs each: least / median / most");
    println!(
        "| MB | to | chunks | whole | reader there: time | rate | late joiner: whole | time from its process start | by service |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    let mut lost = 0;
    for (megabytes, side) in SIDES {
        let mesh = grid(side);
        for reader in READERS.iter().filter(|r| (r.command)(0).is_some()) {
            let mut rows = Vec::new();
            for _ in 0..runs {
                rows.push(block_on(transfer(&mesh, reader))??);
            }
            println!("{}", row(megabytes, reader.name, &rows));
            lost +=
                rows.iter().flat_map(|(_, there, late)| [there, late]).filter(|r| r["whole"] != true).count();
        }
    }
    if ros_python().is_none() {
        println!("rclpy was not measured: PATCHMILL_ROS_PYTHON is not set");
    }
    if lost > 0 {
        return Err(
            format!("{lost} meshes did not come whole, or with another content hash than announced").into()
        );
    }
    Ok(())
}

fn row(megabytes: u32, name: &str, rows: &[(f64, Value, Value)]) -> String {
    let number = |value: &Value, key: &str| value[key].as_f64().unwrap_or(f64::NAN);
    let whole =
        |of: fn(&(f64, Value, Value)) -> &Value| rows.iter().filter(|r| of(r)["whole"] == true).count();
    let there: Vec<f64> = rows.iter().map(|(sent, there, _)| number(there, "end") - sent).collect();
    let late: Vec<f64> = rows.iter().map(|(_, _, l)| number(l, "end") - number(l, "began")).collect();
    let mut sorted = there.clone();
    sorted.sort_by(f64::total_cmp);
    let rate = f64::from(megabytes) / sorted[sorted.len() / 2];
    // A reader that counts them tells how many chunks did not come by the topic.
    let asked: Vec<String> = rows
        .iter()
        .map(|(_, there, late)| format!("{} + {}", there["by_service"], late["by_service"]))
        .collect();
    format!(
        "| {megabytes} | {name} | {} | {}/{} | {} | {rate:.0} MB/s | {}/{} | {} | {} |",
        rows[0].1["chunks"],
        whole(|r| &r.1),
        rows.len(),
        spread(there),
        whole(|r| &r.2),
        rows.len(),
        spread(late),
        asked.join(", ").replace("null", "?"),
    )
}
