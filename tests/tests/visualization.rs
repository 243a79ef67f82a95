//! What viewers and robots see of a plan over DDS: a late joiner, one that is there from the start, a second plan, a
//! withdrawn job.
#![allow(clippy::unwrap_used, reason = "a test's own helpers may fail like the test")]

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use patchmill_geometry::mesh::TriangleMesh;
use patchmill_kinematics::{Accelerations, Machine};
use patchmill_msgs::action::{PlanSurface, PlanSurfaceGoal, PlanSurfaceResult};
use patchmill_msgs::builtin_interfaces::msg::Time;
use patchmill_msgs::geometry_msgs::msg::{Point, TransformStamped};
use patchmill_msgs::msg;
use patchmill_msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};
use patchmill_msgs::visualization_msgs::msg::Marker;
use patchmill_node_runtime::{
    ActionEnd, LargeProduct, Level, Node, NodeOptions, ProductReceiver, Qos, Received, block_on, free_domain,
    topics,
};
use patchmill_planner::stack::Stack;
use patchmill_products::evaluation::ResidualMap;
use patchmill_products::job::Job;
use patchmill_products::partition::Partition;
use patchmill_products::program::JointMotion;
use patchmill_products::samples::SurfaceSamples;
use patchmill_products::toolpath::CandidateToolpath;
use patchmill_tests::fixture;
use patchmill_tests::viewer::{MARKER_TOPICS, Scene, View, Viewer};

const PATIENCE: Duration = Duration::from_secs(120);

/// What a plan's products say, received apart from the visualization.
struct Plan {
    result: PlanSurfaceResult,
    mesh: TriangleMesh,
    samples: SurfaceSamples,
    partition: Partition,
    toolpath: CandidateToolpath,
    motion: JointMotion,
    residual: ResidualMap,
}

async fn plan(domain: u16, surface: &str, patches: u8) -> Plan {
    let node = Node::start(NodeOptions::local("client", domain)).unwrap();
    let client = node.action_client::<PlanSurface>(topics::PLAN_SURFACE).unwrap();
    let mut partitions =
        node.subscribe::<msg::PartitionCandidate>(topics::PARTITION_CANDIDATES, Qos::Product).unwrap();
    let job = Job { patches_min: patches, patches_max: patches, ..Job::default_for("") };
    let goal = PlanSurfaceGoal {
        path: fixture(surface).to_string_lossy().into_owned(),
        job: job.to_msg(Time::default()),
        ..PlanSurfaceGoal::default()
    };
    let end = client.execute(goal, PATIENCE, |_| {}, std::future::pending()).await.unwrap();
    let ActionEnd::Succeeded(result) = end else { panic!("the plan failed") };
    let stamp = result.program.header.stamp.clone();
    let partition = tokio::time::timeout(PATIENCE, async {
        loop {
            let candidate = partitions.next().await.unwrap();
            if candidate.header.stamp == stamp {
                return Partition::from_msg(&candidate).unwrap().1;
            }
        }
    });
    let plan = Plan {
        mesh: product(&node, &result).await,
        samples: product(&node, &result).await,
        partition: partition.await.unwrap(),
        toolpath: product(&node, &result).await,
        motion: product(&node, &result).await,
        residual: product(&node, &result).await,
        result,
    };
    node.shutdown().await;
    plan
}

/// The product of the result's run, as a late joiner gets it.
async fn product<P: LargeProduct>(node: &Node, result: &PlanSurfaceResult) -> P {
    let mut receiver = ProductReceiver::<P>::new(node).unwrap();
    let stamp = &result.program.header.stamp;
    let wanted = async {
        loop {
            if let Some(Received::Product { key, product, .. }) = receiver.next().await
                && key.surface_id == result.program.surface_id
                && (key.job_id.is_empty() || key.stamp == (stamp.sec, stamp.nanosec))
            {
                return product;
            }
        }
    };
    tokio::time::timeout(PATIENCE, wanted).await.unwrap_or_else(|_| panic!("no {}", P::WHAT))
}

impl Plan {
    fn stamp(&self) -> &Time {
        &self.result.program.header.stamp
    }

    fn pass_segments(&self) -> usize {
        self.toolpath.patches.iter().flat_map(|p| &p.passes).map(|p| p.cc.len().saturating_sub(1)).sum()
    }

    /// Whether all of this plan, and nothing else, has come.
    fn is_whole(&self, view: &View) -> bool {
        let own = |topic: &str| {
            let scene = view.scene(topic);
            !scene.markers.is_empty() && scene.markers.values().all(|m| m.header.stamp == *self.stamp())
        };
        let drawn: f64 = area(&view.scene(topics::VISUALIZATION_PATCHES), "patch_");
        let lines = view.scene(topics::VISUALIZATION_PASSES);
        let segments: usize = lines.markers.values().map(|m| m.points.len() - 1).sum();
        let axes = view.scene(topics::VISUALIZATION_TOOL_AXES).markers.len();
        MARKER_TOPICS.iter().all(|topic| own(topic))
            && (drawn / self.mesh_area() - 1.0).abs() < self.area_error()
            && segments == self.pass_segments()
            && axes == 3 * self.toolpath.patches.len()
            && [&view.clouds, &view.residuals]
                .iter()
                .all(|clouds| clouds.last().is_some_and(|c| c.header.stamp == *self.stamp()))
            && goal(&view.trajectory).len() == self.motion.times.len()
            && !view.tf_static.is_empty()
            && !view.descriptions.is_empty()
            && [view.tf.len(), view.joint_states.len(), view.tool_poses.len()].iter().all(|n| *n > 1)
    }

    /// Relative error of the area drawn: small meshes are drawn as they are.
    fn area_error(&self) -> f64 {
        if self.mesh.triangles.len() <= 20_000 { 1e-9 } else { 5e-3 }
    }

    fn mesh_area(&self) -> f64 {
        (0..self.mesh.triangles.len()).map(|t| triangle_area(&self.mesh.corners(t))).sum()
    }
}

fn triangle_area([a, b, c]: &[Point3<f64>; 3]) -> f64 {
    (b - a).cross(&(c - a)).norm() / 2.0
}

fn point(p: &Point) -> Point3<f64> {
    Point3::new(p.x, p.y, p.z)
}

fn triangles(marker: &Marker) -> impl Iterator<Item = [Point3<f64>; 3]> + '_ {
    marker.points.chunks_exact(3).map(|t| [point(&t[0]), point(&t[1]), point(&t[2])])
}

fn area(scene: &Scene, prefix: &str) -> f64 {
    scene.of(prefix).flat_map(triangles).map(|t| triangle_area(&t)).sum()
}

/// The points of the parts as one goal; a part that begins at time 0 begins a program.
fn goal(parts: &[JointTrajectory]) -> Vec<JointTrajectoryPoint> {
    let begins = |p: &JointTrajectory| p.points.first().is_some_and(|p| nanoseconds(p) == 0);
    let first = parts.iter().rposition(begins).unwrap_or(parts.len());
    parts[first..].iter().flat_map(|p| p.points.clone()).collect()
}

fn nanoseconds(point: &JointTrajectoryPoint) -> i64 {
    i64::from(point.time_from_start.sec) * 1_000_000_000 + i64::from(point.time_from_start.nanosec)
}

async fn whole(viewer: &Viewer, plan: &Plan) -> View {
    match viewer.when(PATIENCE, |view| plan.is_whole(view)).await {
        Ok(view) => view,
        Err(view) => {
            let scenes: Vec<_> =
                view.scenes.iter().map(|(t, s)| (t, s.messages.len(), s.markers.len())).collect();
            panic!(
                "{} was not seen whole: {scenes:?}, {} of {} m² drawn, {} clouds, {} of {} points of the trajectory",
                plan.result.program.surface_id,
                area(&view.scene(topics::VISUALIZATION_PATCHES), "patch_"),
                plan.mesh_area(),
                view.clouds.len(),
                goal(&view.trajectory).len(),
                plan.motion.times.len()
            )
        }
    }
}

#[test]
fn plans_are_seen_whole_by_late_joiners_and_leave_nothing_behind() {
    block_on(async {
        let lease = free_domain().unwrap();
        let domain = lease.domain();
        let mut stack = Stack::start(domain, &fixture(""), "", Level::Warn).unwrap();
        stack.add_visualization(domain, Level::Warn).unwrap();
        let early = Viewer::start("early", domain).unwrap();

        let first = plan(domain, "small_bezier.json", 3).await;
        // Before the late joiner: everything has been drawn then.
        whole(&early, &first).await;
        let late = Viewer::start("late", domain).unwrap();
        let view = whole(&late, &first).await;
        check_patches(&view, &first);
        check_passes(&view, &first);
        check_axes(&view, &first);
        check_cloud(&view, &first);
        check_tool_and_frames(&view);
        check_trajectory(&view, &first);
        check_state(&view, &first);

        let second = plan(domain, "surface_3.json", 2).await;
        let view = whole(&early, &second).await;
        check_replacement(&view, &first, &second);
        let later = Viewer::start("later", domain).unwrap();
        let view = whole(&later, &second).await;
        check_patches(&view, &second);
        check_trajectory(&view, &second);
        check_history(&view, &second);
        check_residual(&view, &second);

        let jobs = later.node().publisher::<msg::Job>(topics::JOB, Qos::Status).unwrap();
        assert!(jobs.wait_for_subscriptions(1, PATIENCE).await);
        jobs.publish(msg::Job::default()).unwrap();
        let cleared = later.when(PATIENCE, |view| {
            MARKER_TOPICS.iter().all(|topic| view.scene(topic).markers.is_empty())
                && [&view.clouds, &view.residuals]
                    .iter()
                    .all(|clouds| clouds.last().is_some_and(|c| c.width == 0))
        });
        assert!(cleared.await.is_ok(), "a withdrawn job is still shown");
        for viewer in [early, late, later] {
            viewer.node().shutdown().await;
        }
        stack.shutdown().await;
    })
    .unwrap();
}

/// Names, colours, places: every patch of the program is drawn, where its samples are, and nothing twice.
fn check_patches(view: &View, plan: &Plan) {
    let scene = view.scene(topics::VISUALIZATION_PATCHES);
    let names: BTreeSet<&str> = scene.markers.values().map(|m| m.ns.as_str()).collect();
    let expected: BTreeSet<String> =
        plan.toolpath.patches.iter().map(|p| format!("patch_{}", p.patch)).collect();
    assert_eq!(names, expected.iter().map(String::as_str).collect());
    let colours: BTreeSet<_> =
        scene.markers.values().map(|m| (&m.ns, m.color.r.to_bits(), m.color.g.to_bits())).collect();
    assert_eq!(colours.len(), names.len(), "one colour a patch");
    assert!(scene.markers.values().all(|m| {
        m.r#type == Marker::TRIANGLE_LIST && m.color.a == 1.0 && m.header.frame_id == "workpiece"
    }));
    let (mut right, mut all) = (0, 0);
    for marker in scene.markers.values() {
        for [a, b, c] in triangles(marker) {
            let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0);
            let away = |i: &usize| (plan.samples.points[*i] - middle).norm_squared();
            let nearest = (0..plan.samples.len()).min_by(|i, j| away(i).total_cmp(&away(j))).unwrap();
            right += usize::from(marker.ns == format!("patch_{}", plan.partition.labels[nearest]));
            all += 1;
        }
    }
    assert!(
        right as f64 > 0.85 * f64::from(all),
        "{right} of {all} triangles have their nearest sample's patch"
    );
}

fn check_passes(view: &View, plan: &Plan) {
    let scene = view.scene(topics::VISUALIZATION_PASSES);
    let mut drawn: BTreeMap<String, usize> = BTreeMap::new();
    for marker in scene.markers.values() {
        assert!(marker.r#type == Marker::LINE_STRIP && marker.scale.x > 0.0);
        *drawn.entry(marker.ns.clone()).or_default() += marker.points.len() - 1;
    }
    let expected: BTreeMap<String, usize> = plan
        .toolpath
        .patches
        .iter()
        .map(|p| (format!("passes_{}", p.patch), p.passes.iter().map(|pass| pass.cc.len() - 1).sum()))
        .collect();
    assert_eq!(drawn, expected);
}

fn check_axes(view: &View, plan: &Plan) {
    let scene = view.scene(topics::VISUALIZATION_TOOL_AXES);
    for patch in &plan.toolpath.patches {
        let marker = |ns: &str| &scene.markers[&(ns.to_owned(), patch.patch as i32)];
        for (ns, direction) in [("tool_axis", patch.tool_axis), ("feed_direction", patch.feed_direction)] {
            let arrow = marker(ns);
            assert!(arrow.r#type == Marker::ARROW && arrow.points.len() == 2);
            let way: Vector3<f64> = point(&arrow.points[1]) - point(&arrow.points[0]);
            assert!((way.normalize() - direction).norm() < 1e-9, "{ns} {}", patch.patch);
            let near = plan.samples.points.iter().map(|p| (p - point(&arrow.points[0])).norm());
            assert!(near.fold(1.0, f64::min) < 1e-12, "an arrow does not stand on a sample");
        }
        assert_eq!(marker("patch_number").text, format!("patch {}", patch.patch));
    }
}

fn check_cloud(view: &View, plan: &Plan) {
    let cloud = view.clouds.last().unwrap();
    assert_eq!(cloud.width as usize, plan.samples.len());
    assert_eq!(cloud.data.len(), plan.samples.len() * cloud.point_step as usize);
    assert_eq!(cloud.header.frame_id, "workpiece");
    let entry = |i: usize, e: usize| {
        let at = i * cloud.point_step as usize + cloud.fields[e].offset as usize;
        f32::from_le_bytes(cloud.data[at..at + 4].try_into().unwrap())
    };
    for (i, p) in plan.samples.points.iter().enumerate() {
        assert!((f64::from(entry(i, 0)) - p.x).abs() < 1e-6 && (f64::from(entry(i, 2)) - p.z).abs() < 1e-6);
        assert!(entry(i, 3).abs() <= 0.5);
    }
    assert_eq!(
        cloud.fields.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(),
        ["x", "y", "z", "radius", "rgb"]
    );
}

/// The cloud of what is left holds the worst of every few neighbouring points of the map, which is that of the proof.
fn check_residual(view: &View, plan: &Plan) {
    let (cloud, map, proof) = (view.residuals.last().unwrap(), &plan.residual, &plan.result.program.proof);
    let least = map.leftover.iter().copied().fold(0.0, f64::min);
    let most = map.leftover.iter().copied().fold(0.0, f64::max);
    assert_eq!((-least, most), (proof.gouge_max, proof.scallop_max));
    assert_eq!(proof.highest[0].leftover, most);
    let stride = map.points.len().div_ceil(cloud.width as usize);
    assert_eq!(cloud.width as usize, map.points.len().div_ceil(stride));
    let entry = |i: usize, e: usize| {
        let at = i * cloud.point_step as usize + cloud.fields[e].offset as usize;
        f32::from_le_bytes(cloud.data[at..at + 4].try_into().unwrap())
    };
    assert_eq!(cloud.fields[3].name, "leftover");
    let shown = (0..cloud.width as usize).map(|i| entry(i, 3)).fold(0.0, f32::max);
    assert_eq!(shown, most as f32);
}

/// The latest transform of every child frame.
fn transforms(view: &View) -> BTreeMap<String, TransformStamped> {
    let all = view.tf_static.iter().chain(&view.tf).flat_map(|m| &m.transforms);
    all.map(|t| (t.child_frame_id.clone(), t.clone())).collect()
}

/// base_from_frame.
fn chain(transforms: &BTreeMap<String, TransformStamped>, frame: &str) -> Isometry3<f64> {
    let (mut frame, mut total) = (frame.to_owned(), Isometry3::identity());
    while let Some(step) = transforms.get(&frame) {
        let (t, r) = (&step.transform.translation, &step.transform.rotation);
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(r.w, r.x, r.y, r.z));
        total = Isometry3::from_parts(Translation3::new(t.x, t.y, t.z), rotation) * total;
        frame.clone_from(&step.header.frame_id);
    }
    assert_eq!(frame, "base_link");
    total
}

fn check_tool_and_frames(view: &View) {
    let frames = transforms(view);
    let used: BTreeSet<String> = MARKER_TOPICS
        .iter()
        .flat_map(|topic| view.scene(topic).markers.into_values().map(|m| m.header.frame_id))
        .collect();
    assert_eq!(used, BTreeSet::from(["workpiece".to_owned(), "tool_tip".to_owned()]));
    assert!(used.iter().all(|frame| frames.contains_key(frame)));
    let tool = view.scene(topics::VISUALIZATION_TOOL);
    assert!(
        tool.markers
            .values()
            .all(|m| { m.header.frame_id == "tool_tip" && m.r#type == Marker::CYLINDER && m.frame_locked })
    );
    let ends = tool.markers.values().map(|m| m.pose.position.z + m.scale.z / 2.0);
    assert!((ends.fold(0.0, f64::max) - 0.1).abs() < 1e-9, "the tool does not reach the spindle");
}

/// The rules of ros2_control's joint trajectory controller, and that the motion is the program's.
fn check_trajectory(view: &View, plan: &Plan) {
    let points = goal(&view.trajectory);
    let machine = Machine::from_urdf(
        view.descriptions.last().unwrap(),
        0.1,
        Accelerations { linear: 5.0, rotary: 20.0 },
    )
    .unwrap();
    let names: Vec<&str> = machine.axes().iter().map(|a| a.joint_name.as_str()).collect();
    for part in &view.trajectory {
        assert_eq!(part.joint_names, names);
        assert_eq!(part.header.stamp, Time::default());
    }
    assert_eq!(nanoseconds(&points[0]), 0);
    for ends in [&points[0], &points[points.len() - 1]] {
        assert!(ends.velocities.iter().all(|v| *v == 0.0));
    }
    let duration = plan.result.program.machining_time;
    assert!((nanoseconds(&points[points.len() - 1]) as f64 / 1e9 - duration).abs() < 1e-6);
    for (at, point) in points.iter().enumerate() {
        assert!(point.positions.len() == 5 && point.velocities.len() == 5);
        assert!(point.accelerations.is_empty() && point.effort.is_empty());
        assert_eq!(point.positions, plan.motion.positions[5 * at..5 * at + 5]);
    }
    for pair in points.windows(2) {
        assert!(nanoseconds(&pair[0]) < nanoseconds(&pair[1]), "time stands still");
        check_step(&machine, pair);
    }
}

/// Positions and velocities of two points that follow each other belong together, within the axes' limits.
fn check_step(machine: &Machine, pair: &[JointTrajectoryPoint]) {
    // Times are whole nanoseconds.
    const ROUNDING: f64 = 1e-9;
    // A corner may change an axis' speed at once by √(8·δ·a) at a path tolerance δ of 2 µm; half of it at either side.
    let time = (nanoseconds(&pair[1]) - nanoseconds(&pair[0])) as f64 / 1e9;
    for (j, axis) in machine.axes().iter().enumerate() {
        let mean = (pair[1].positions[j] - pair[0].positions[j]) / time;
        let slack = axis.velocity * ROUNDING / time;
        assert!(mean.abs() <= axis.velocity * (1.0 + 1e-9) + slack, "{} runs at {mean}", axis.joint_name);
        let corner = 0.5 * (8.0 * 2e-6 * axis.acceleration).sqrt();
        for point in pair {
            let difference = (mean - point.velocities[j]).abs();
            assert!(point.velocities[j].abs() <= axis.velocity * (1.0 + 1e-9));
            assert!(
                difference <= axis.acceleration * time + corner + slack + 1e-9,
                "{}: {mean} on average, {} at an end, {time} s",
                axis.joint_name,
                point.velocities[j]
            );
        }
    }
}

/// Joint states, transforms and tool pose go on, with stamps of their own time, and agree.
fn check_state(view: &View, plan: &Plan) {
    let stamps: Vec<(i32, u32)> =
        view.joint_states.iter().map(|s| (s.header.stamp.sec, s.header.stamp.nanosec)).collect();
    assert!(stamps.windows(2).all(|w| w[0] < w[1]), "{stamps:?}");
    assert!(stamps[0] > (plan.stamp().sec, plan.stamp().nanosec));
    let state = view.joint_states.last().unwrap();
    assert_eq!((state.name.len(), state.position.len(), &state.velocity), (5, 5, &vec![0.0; 5]));
    assert_eq!(state.position, plan.motion.positions[..5]);
    let frames = transforms(view);
    let tool = chain(&frames, "workpiece").inverse() * chain(&frames, "tool_tip");
    let pose = view.tool_poses.last().unwrap();
    assert_eq!(pose.header.frame_id, "workpiece");
    let (p, o) = (&pose.pose.position, &pose.pose.orientation);
    assert!((tool.translation.vector - Vector3::new(p.x, p.y, p.z)).norm() < 1e-9);
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(o.w, o.x, o.y, o.z));
    assert!(rotation.angle_to(&tool.rotation) < 1e-9);
    // The program begins above the first patch, along whose tool axis the pose's z points.
    let axis = rotation * Vector3::z();
    assert!((axis - plan.toolpath.patches[0].tool_axis).norm() < 1e-5, "{axis:?}");
}

/// A late joiner sees nothing of the plan before.
fn check_history(view: &View, plan: &Plan) {
    for topic in MARKER_TOPICS {
        let scene = view.scene(topic);
        assert_eq!(scene.messages[0].markers[0].action, Marker::DELETEALL, "{topic}");
        let all = scene.messages.iter().flat_map(|m| &m.markers);
        assert!(all.clone().all(|m| m.header.stamp == *plan.stamp()), "{topic} has markers of another plan");
        assert_eq!(all.filter(|m| m.action == Marker::DELETEALL).count(), 1, "{topic}");
    }
    assert_eq!(view.trajectory.iter().map(|p| p.points.len()).sum::<usize>(), plan.motion.times.len());
}

/// Who was there all the time has the new plan's markers only, because its first message deletes the others.
fn check_replacement(view: &View, old: &Plan, new: &Plan) {
    for topic in MARKER_TOPICS {
        let scene = view.scene(topic);
        let of = |plan: &Plan| {
            scene.messages.iter().position(|m| m.markers.iter().any(|m| m.header.stamp == *plan.stamp()))
        };
        let (before, after) = (of(old).unwrap(), of(new).unwrap());
        assert!(before < after, "{topic}");
        assert_eq!(scene.messages[after].markers[0].action, Marker::DELETEALL, "{topic}");
        let rest = scene.messages[after..].iter().flat_map(|m| &m.markers);
        assert!(rest.into_iter().all(|m| m.header.stamp == *new.stamp()), "{topic}: the old plan came again");
    }
}
