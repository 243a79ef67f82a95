//! Loads a running stack: plans one after the other, service calls, a subscriber that never reads. `tests/benches/load_soak.py`
//! builds and runs it.
#![allow(clippy::print_stdout, missing_docs, reason = "a command line program")]

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use patchmill_geometry::mesh::TriangleMesh;
use patchmill_msgs::action::{PlanSurface, PlanSurfaceGoal};
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::geometry_msgs::msg::Vector3;
use patchmill_msgs::srv::{LoadSurface, LoadSurfaceRequest, SolvePose, SolvePoseRequest};
use patchmill_msgs::{RosType, ServiceType};
use patchmill_node_runtime::{
    ActionClient, ActionEnd, Arguments, LargeProduct, Node, NodeOptions, ParameterSet, ProductKey,
    ProductReceiver, Qos, Received, RuntimeError, ServiceClient, TopicVisitor, block_on, topics,
    visit_topics,
};
use patchmill_products::job::Job;

const USAGE: &str = "usage (ROS_DOMAIN_ID says where): load_client plans COUNT SURFACE... | calls COUNT SURFACE | deaf\n\
    plans: one after the other, the surfaces in turn, with 1 patch, then with 2; a line a plan: number, surface, patches, seconds, program's sha256\n\
    calls: COUNT calls of three services by four clients, none repeated; a line a service: name, calls, calls a second, slowest and median in ms\n\
    deaf: subscribes to every topic and takes at most one message of each; ends with its stdin";

/// For finding the nodes; for one plan; for one call, which is sent once.
const FIND: Duration = Duration::from_secs(30);
const PLAN: Duration = Duration::from_secs(300);
const CALL: Duration = Duration::from_secs(20);
const CLIENTS: usize = 4;

type Outcome<T> = Result<T, Box<dyn std::error::Error + Send + Sync>>;

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words.as_slice() {
        ["plans", count, surfaces @ ..] if !surfaces.is_empty() => block_on(plans(count.parse()?, surfaces))?,
        ["calls", count, surface] => block_on(calls(count.parse()?, surface))?,
        ["deaf"] => block_on(deaf())?,
        _ => Err(USAGE.into()),
    }
}

fn node(name: &str) -> Result<Node, RuntimeError> {
    let arguments = Arguments::parse([], name, |variable| std::env::var(variable).ok())?;
    Node::start(NodeOptions { arguments, parameters: ParameterSet::new() })
}

async fn plans(count: usize, surfaces: &[&str]) -> Outcome<()> {
    let node = node("load_plans")?;
    let client = node.action_client(topics::PLAN_SURFACE)?;
    for number in 0..count {
        let (surface, patches) = (surfaces[number % surfaces.len()], 1 + (number / surfaces.len()) % 2);
        let begun = Instant::now();
        let end = tokio::time::timeout(PLAN, plan(&client, surface, patches as u8)).await;
        let end = end.map_err(|_| format!("plan {number} did not end within {} s", PLAN.as_secs()))?;
        let hash = end.map_err(|e| format!("plan {number} of {surface}: {e}"))?;
        println!("{number} {surface} {patches} {:.3} {hash}", begun.elapsed().as_secs_f64());
    }
    node.shutdown().await;
    Ok(())
}

async fn plan(client: &ActionClient<PlanSurface>, surface: &str, patches: u8) -> Outcome<String> {
    let job = Job { patches_min: patches, patches_max: patches, ..Job::default_for("") };
    let goal = PlanSurfaceGoal {
        path: surface.to_owned(),
        job: job.to_msg(Time::default()),
        ..PlanSurfaceGoal::default()
    };
    match client.execute(goal, FIND, |_| {}, std::future::pending()).await? {
        ActionEnd::Succeeded(result) => Ok(result.program.content_hash),
        other => Err(format!("{} (code {})", other.result().text, other.result().code).into()),
    }
}

async fn calls(count: usize, surface: &str) -> Outcome<()> {
    let node = node("load_calls")?;
    let load = LoadSurfaceRequest { path: surface.to_owned(), ..LoadSurfaceRequest::default() };
    let client = node.service_client::<LoadSurface>(topics::LOAD_SURFACE)?;
    let loaded = client.call(&load, CALL, FIND).await?;
    if loaded.code != 0 {
        return Err(loaded.text.into());
    }
    let key = newest_mesh(&node, &loaded.surface_id).await?;
    let (chunks, poses, loads) = (count / 2, count * 2 / 5, count - count / 2 - count * 2 / 5);
    let chunk = TriangleMesh::request(&key, 0);
    measure::<<TriangleMesh as LargeProduct>::GetChunk>(
        &node,
        TriangleMesh::SERVICE_NAME,
        chunks,
        move |_| chunk.clone(),
        |answer| TriangleMesh::answered(answer).map(|_| ()),
    )
    .await?;
    let pose = |number: usize| {
        let tilt = number as f64 * 1e-4;
        let tool_axis = Vector3 { x: tilt.sin(), y: 0.0, z: tilt.cos() };
        SolvePoseRequest { tool_axis, ..SolvePoseRequest::default() }
    };
    let solved = |code: i32, text: String| if code == 0 { Ok(()) } else { Err(text) };
    measure::<SolvePose>(&node, topics::SOLVE_POSE, poses, pose, move |a| solved(a.code, a.text)).await?;
    // Surfaces are loaded one after the other: a newer request would supersede the older one.
    let begun = Instant::now();
    let mut seconds = Vec::with_capacity(loads);
    for _ in 0..loads {
        let begun = Instant::now();
        let answer = client.call(&load, CALL, CALL).await?;
        seconds.push(begun.elapsed().as_secs_f64());
        solved(answer.code, answer.text)?;
    }
    tell(topics::LOAD_SURFACE, begun.elapsed().as_secs_f64(), seconds);
    node.shutdown().await;
    Ok(())
}

async fn newest_mesh(node: &Node, surface_id: &str) -> Outcome<ProductKey> {
    let mut meshes = ProductReceiver::<TriangleMesh>::new(node)?;
    let wanted = async {
        while let Some(received) = meshes.next().await {
            match received {
                Received::Product { key, .. } if key.surface_id == surface_id => return Ok(key),
                Received::Failed { text, .. } => return Err(text),
                Received::Product { .. } => {}
            }
        }
        Err("the node was shut down".to_owned())
    };
    Ok(tokio::time::timeout(FIND, wanted).await.map_err(|_| "the mesh did not come")??)
}

/// Calls a service `count` times from [`CLIENTS`] clients at once; every request is sent once.
async fn measure<S: ServiceType>(
    node: &Node,
    name: &str,
    count: usize,
    request: impl Fn(usize) -> S::Request + Send + Sync + 'static,
    check: impl Fn(S::Response) -> Result<(), String> + Send + Sync + 'static,
) -> Outcome<()> {
    let (next, shared) = (Arc::new(AtomicUsize::new(0)), Arc::new((request, check)));
    let begun = Instant::now();
    let mut tasks = Vec::new();
    for _ in 0..CLIENTS {
        let client: ServiceClient<S> = node.service_client(name)?;
        let (next, shared) = (Arc::clone(&next), Arc::clone(&shared));
        tasks.push(tokio::spawn(async move {
            let mut seconds = Vec::new();
            loop {
                let number = next.fetch_add(1, Ordering::Relaxed);
                if number >= count {
                    return Ok::<_, String>(seconds);
                }
                let begun = Instant::now();
                let answer = client.call(&shared.0(number), CALL, CALL).await;
                seconds.push(begun.elapsed().as_secs_f64());
                answer
                    .map_err(|e| e.to_string())
                    .and_then(&shared.1)
                    .map_err(|e| format!("call {number}: {e}"))?;
            }
        }));
    }
    let mut seconds = Vec::with_capacity(count);
    for task in tasks {
        seconds.extend(task.await?.map_err(|e| format!("{name}: {e}"))?);
    }
    tell(name, begun.elapsed().as_secs_f64(), seconds);
    Ok(())
}

fn tell(name: &str, took: f64, mut seconds: Vec<f64>) {
    seconds.sort_by(f64::total_cmp);
    let at = |place: usize| seconds.get(place).copied().unwrap_or_default() * 1e3;
    let (slowest, median) = (at(seconds.len().saturating_sub(1)), at(seconds.len() / 2));
    println!("{name} {} {:.0} {slowest:.1} {median:.1}", seconds.len(), seconds.len() as f64 / took);
}

struct Deaf<'a>(&'a Node);

impl TopicVisitor for Deaf<'_> {
    fn topic<T: RosType>(&mut self, name: &str, qos: Qos) -> Result<(), RuntimeError> {
        // Blocks a thread of the runtime for good: nothing takes this reader's messages any more.
        self.0
            .subscribe_with(name, qos, |_: T| {
                loop {
                    std::thread::park();
                }
            })
            .map(|_| ())
    }

    fn product<P: LargeProduct>(&mut self) -> Result<(), RuntimeError> {
        self.topic::<P::Manifest>(P::MANIFEST_TOPIC, Qos::Product)?;
        self.topic::<P::Chunk>(P::CHUNK_TOPIC, Qos::Chunks)
    }
}

async fn deaf() -> Outcome<()> {
    let node = node("load_deaf")?;
    visit_topics(&mut Deaf(&node))?;
    println!("deaf");
    // The runtime's threads are blocked by now or soon; a process that cannot be shut down is ended.
    std::thread::spawn(|| {
        let mut line = String::new();
        while std::io::stdin().read_line(&mut line).is_ok_and(|read| read > 0) {}
        std::process::exit(0);
    });
    std::future::pending().await
}
